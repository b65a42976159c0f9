"""Distances of outlines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skidsteer.errors import RequestError
from skidsteer.plan.outline import Rectangle, footprint, gap, gap_slope
from skidsteer.se2 import FloatArray, compose
from skidsteer.vehicle import preset

sides = st.floats(0.1, 2.0)
poses = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-4.0, 4.0))


def border(rectangle: Rectangle, pose: FloatArray, count: int = 60) -> FloatArray:
    """Points all along the border of a rectangle at a pose."""
    corners = rectangle.at(pose)
    share = np.linspace(0.0, 1.0, count)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])


@settings(max_examples=60, deadline=None)
@given(sides, sides, poses, sides, sides, poses)
def test_gap_is_that_of_the_nearest_points(
    a: float, b: float, here: tuple[float, ...], c: float, d: float, there: tuple[float, ...]
) -> None:
    robot, obstacle, pose, place = Rectangle(a, b), Rectangle(c, d), np.array(here), np.array(there)
    found = float(gap(robot, pose, obstacle, place))
    points, others = border(robot, pose), border(obstacle, place)
    nearest = float(np.hypot(*(points[:, None] - others[None]).T).min())
    if found > 0.0:  # points of a border lie no more than 2 / 59 m apart
        assert found <= nearest + 1e-9
        assert nearest <= found + 0.04
    assert gap(obstacle, place, robot, pose) == pytest.approx(found, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(sides, sides, poses, sides, sides, poses)
def test_a_gap_is_negative_where_they_overlap(
    a: float, b: float, here: tuple[float, ...], c: float, d: float, there: tuple[float, ...]
) -> None:
    robot, obstacle, pose, place = Rectangle(a, b), Rectangle(c, d), np.array(here), np.array(there)
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 41)] * 2), axis=-1).reshape(-1, 2) * robot.half
    inside = compose(pose, np.column_stack([grid, np.zeros(len(grid))]))[:, :2]
    seen = np.column_stack([*(inside - place[:2]).T])
    cos, sin = np.cos(place[2]), np.sin(place[2])
    local = seen @ np.array([[cos, -sin], [sin, cos]])
    if (np.abs(local) < obstacle.half).all(axis=1).any():
        assert gap(robot, pose, obstacle, place) < 0.0


def test_gaps_by_hand() -> None:
    obstacle, robot, place = Rectangle(1.25, 0.7), Rectangle(0.4, 0.34), (1.0, 2.0, 0.5 * np.pi)
    # beside: obstacle from x = 0.65 to 1.35, robot to x = 0.17 across
    assert gap(robot, (0.0, 2.0, 0.5 * np.pi), obstacle, place) == pytest.approx(0.65 - 0.17)
    # corner to corner: obstacle's (1.35, 2.625), robot's corner at (1.9 - 0.2, 3.0 - 0.17)
    assert gap(robot, (1.9, 3.0, 0.0), obstacle, place) == pytest.approx(np.hypot(0.35, 0.205))
    # crossing without a corner of one in the other: 0.4 + 0.7 wide about the same middle
    assert gap(Rectangle(3.0, 0.1), (1.0, 2.0, 0.0), obstacle, place) == pytest.approx(-(0.05 + 0.625))


def test_slope_of_the_gap() -> None:
    obstacle, robot = Rectangle(1.25, 0.7), Rectangle(0.4, 0.34)
    pose = np.array([[0.3, -0.9, 0.2]])
    slope = gap_slope(robot, pose, obstacle, (0.0, 0.0, 0.0))[0]
    # nearest is the left front or left rear corner, at y = -0.9 +- 0.2 sin 0.2 + 0.17 cos 0.2: the front one, in front
    assert slope == pytest.approx([-np.sin(0.2), -np.cos(0.2), -(0.2 * np.cos(0.2) - 0.17 * np.sin(0.2))], abs=1e-6)


def test_footprint_is_that_of_the_wheels() -> None:
    assert (footprint(preset("jackal")).length, footprint(preset("jackal")).width) == pytest.approx((0.458, 0.47359))
    rover = footprint(preset("rover-4wd1"))
    assert rover.length >= 0.28 + 0.12 - 1e-9
    assert rover.width == pytest.approx(0.34)


@pytest.mark.parametrize("side", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rectangle_has_two_sides(side: float) -> None:
    with pytest.raises(RequestError, match="two positive lengths"):
        Rectangle(1.0, side, "obstacle")
