"""Outlines: rectangles in the plane, and the distance between them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import RequestError
from skidsteer.se2 import FloatArray, between, compose, invert, rotate
from skidsteer.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A robot or an obstacle seen from above; the origin of its frame is its centre.

    Raises:
        RequestError: a side that is not a positive length.
    """

    length: float  # [m] along x
    width: float  # [m] along y
    name: str = "rectangle"

    def __post_init__(self) -> None:
        if not all(math.isfinite(side) and side > 0.0 for side in (self.length, self.width)):
            raise RequestError(f"the {self.name} needs two positive lengths in m, got {self.length:g} x {self.width:g}")

    @property
    def half(self) -> FloatArray:
        """Half length and half width (2,) [m]."""
        return np.array([0.5 * self.length, 0.5 * self.width])

    @property
    def corners(self) -> FloatArray:
        """(4, 2) [m], counter-clockwise."""
        return self.half * [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]

    def at(self, pose: ArrayLike) -> FloatArray:
        """Corners (..., 4, 2) [m] of the rectangle at poses (..., 3)."""
        pose = np.asarray(pose, dtype=float)
        return np.asarray(pose[..., None, :2] + rotate(pose[..., None, 2], self.corners))


def footprint(vehicle: Vehicle) -> Rectangle:
    """Outer edges of the wheels, each a wheel radius wide; an unknown wheel base is taken as the track width."""
    base = vehicle.wheel_base if vehicle.wheel_base is not None else vehicle.track_width
    return Rectangle(base + 2.0 * vehicle.wheel_radius, vehicle.track_width + vehicle.wheel_radius, "footprint")


def gap(robot: Rectangle, poses: ArrayLike, obstacle: Rectangle, place: ArrayLike) -> FloatArray:
    """Distance (...) [m] from a robot at poses (..., 3) to an obstacle at a pose (3,).

    Where the two overlap it is negative: the least distance by which they would have to be moved apart.
    """
    there = between(np.asarray(place, dtype=float), poses)
    back = invert(there)
    outside = np.maximum(_beyond(there, robot, obstacle), _beyond(back, obstacle, robot))
    # The nearest points of two convex polygons that are apart: a corner of one of them is one.
    corners = np.minimum(_from(robot.at(there), obstacle), _from(obstacle.at(back), robot))
    return np.asarray(np.where(outside > 0.0, corners, outside))


def _beyond(there: FloatArray, robot: Rectangle, obstacle: Rectangle) -> FloatArray:
    """Width (...) of the gap along either axis of the obstacle, the larger one; negative: they overlap along both."""
    cos, sin = np.abs(np.cos(there[..., 2])), np.abs(np.sin(there[..., 2]))
    (a, b), (x, y) = robot.half, obstacle.half
    along = np.abs(there[..., 0]) - x - (a * cos + b * sin)
    across = np.abs(there[..., 1]) - y - (a * sin + b * cos)
    return np.asarray(np.maximum(along, across))


def _from(corners: FloatArray, rectangle: Rectangle) -> FloatArray:
    """Least distance (...) of corners (..., 4, 2) from a rectangle at the origin."""
    out = np.maximum(np.abs(corners) - rectangle.half, 0.0)
    return np.asarray(np.hypot(out[..., 0], out[..., 1]).min(axis=-1))


STEP = 1e-6  # [m, rad] of the derivative


def gap_slope(robot: Rectangle, poses: FloatArray, obstacle: Rectangle, place: ArrayLike) -> FloatArray:
    """Derivative (n, 3) of the gap by a small motion of the robot at poses (n, 3), in its own frame."""
    moved = compose(poses[:, None], np.concatenate([np.eye(3), -np.eye(3)]) * STEP)
    gaps = gap(robot, moved, obstacle, place)
    return np.asarray((gaps[:, :3] - gaps[:, 3:]) / (2.0 * STEP))
