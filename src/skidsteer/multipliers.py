"""What a differential drive controller can know of a robot: three factors, and what is left out by them.

The ``diff_drive_controller`` of ROS 2 computes, with left_radius = left_wheel_radius_multiplier * wheel_radius,

    v_x = (left_radius w_l + right_radius w_r) / 2,   omega = (right_radius w_r - left_radius w_l) / separation

of the wheels' turning rates w, and v_y = 0. In rim speeds v_l = wheel_radius w_l that is `Multipliers`. A constant ICR,

    v_x = (alpha_l v_l + alpha_r v_r) / 2 + c omega,   v_y = -icr_x omega,   c = (icr_y_left + icr_y_right) / 2

is that and the lever arm of the point (icr_x, c): the controller with the radius multipliers alpha and the separation
icr_y_left - icr_y_right tells exactly how that point of the robot moves. Forced to stand for the origin it is wrong by
c omega and -icr_x omega, which adds up to twice the length of the lever arm at most, however long the drive. Any other
three factors get the yaw wrong, and with it positions, by ever more. So the yaw comes first, then speed and lever arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from skidsteer.drive import Drive
from skidsteer.models import MatrixModel, Model, Parameter
from skidsteer.se2 import FloatArray

MOVING = 1e-3  # [m/s] mean rim speed above which the robot moves
MOST_SAMPLES = 100_000  # of the motions that a model is compared over


@dataclass(frozen=True)
class Multipliers(MatrixModel):
    """A differential drive with a factor on the radius of each side and on the track width, as ROS 2 names them."""

    NAME: ClassVar[str] = "multipliers"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("left_wheel_radius_multiplier", "", 1.0, 0.5, 1.5, "true over nominal rim speed, left"),
        Parameter("right_wheel_radius_multiplier", "", 1.0, 0.5, 1.5, "true over nominal rim speed, right"),
        Parameter("wheel_separation_multiplier", "", 1.0, 0.4, 10.0, "effective track width over track width"),
    )

    left_wheel_radius_multiplier: float
    right_wheel_radius_multiplier: float
    wheel_separation_multiplier: float
    track_width: float  # [m]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 < value < np.inf:
                raise ValueError(f"need a finite {name} > 0, got {value}")

    @property
    def separation(self) -> float:
        """Effective track width [m]."""
        return self.wheel_separation_multiplier * self.track_width

    def matrix(self) -> FloatArray:  # noqa: D102
        left, right, width = self.left_wheel_radius_multiplier, self.right_wheel_radius_multiplier, self.separation
        return np.array([[0.5 * left, 0.5 * right], [0.0, 0.0], [-left / width, right / width]])

    def matrix_jacobian(self) -> FloatArray:  # noqa: D102
        A, width = self.matrix(), self.separation
        by_left = np.array([[0.5, 0.0], [0.0, 0.0], [-1.0 / width, 0.0]])
        by_right = np.array([[0.0, 0.5], [0.0, 0.0], [0.0, 1.0 / width]])
        by_separation = -A * [[0.0], [0.0], [1.0]] / self.wheel_separation_multiplier
        return np.stack([by_left, by_right, by_separation], axis=-1)


@dataclass(frozen=True, slots=True)
class Projection:
    """The multipliers nearest to a model over some motions, and the point of the robot that moves as they tell."""

    multipliers: Multipliers
    x: float  # [m] of that point, ahead of the origin
    y: float  # [m] to the left of the origin
    rim_speed: float  # [m/s] mean of both sides, over the motions
    yaw_rate: float  # [rad/s] RMS


def project(model: Model, rims: FloatArray, track_width: float) -> Projection:
    """The multipliers that lose least of a model: first of its yaw rate, then of its velocities, by least squares.

    For a model that is linear in the rim speeds the yaw rate is exact, and the motions do not matter. Otherwise it is
    a mean over them.

    Args:
        model: any.
        rims: (n, 2) rim speeds [m/s] of the motions to come, such as `moving_rims`; straights and turns.
        track_width: [m] that the separation multiplier is to be applied to.

    Raises:
        ValueError: motions, or a model, in which nothing turns or moves ahead as a differential drive can.
    """
    v_x, v_y, omega = np.moveaxis(model.twist(rims[:, 0], rims[:, 1]), -1, 0)
    left, right = np.linalg.lstsq(rims * [-1.0, 1.0], omega, rcond=None)[0]
    mean = 0.5 * rims @ [left, right]  # speed over effective track width
    width, y = np.linalg.lstsq(np.stack([mean, omega], axis=-1), v_x, rcond=None)[0]
    turning = float(omega @ omega)
    x = -float(v_y @ omega) / turning if turning > 0.0 else 0.0
    found = Multipliers(float(left * width), float(right * width), float(width) / track_width, track_width)
    return Projection(found, x, float(y), float(np.abs(rims).mean()), float(np.sqrt(np.mean(omega**2))))


def moving_rims(drives: Sequence[Drive]) -> FloatArray:
    """Rim speeds (n, 2) [m/s] of drives while they moved, at most about ``MOST_SAMPLES``; usual ones if none did."""
    rims = np.concatenate([drive.wheels.values for drive in drives])
    rims = rims[np.abs(rims).mean(axis=1) > MOVING]
    rims = rims[:: 1 + len(rims) // MOST_SAMPLES]
    turns = np.ptp(rims[:, 1] - rims[:, 0]) if len(rims) else 0.0
    ahead = np.ptp(rims.sum(axis=1)) if len(rims) else 0.0
    return rims if min(turns, ahead) > MOVING else usual_rims(0.5)


def usual_rims(speed: float) -> FloatArray:
    """Rim speeds (n, 2) [m/s] of each side from ``-speed`` to ``speed`` [m/s], each with each: all kinds of motion."""
    side = np.linspace(-speed, speed, 9)
    rims = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    return np.asarray(rims[np.abs(rims).mean(axis=1) > MOVING])
