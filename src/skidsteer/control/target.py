"""The target that a Lyapunov law drives along its path: Huskić 2017, section III, after Soetanto et al. 2003.

It is no projection: its arc length has its own dynamics, so that the law holds near the centre of curvature, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from numpy.typing import ArrayLike

from skidsteer.control.path_state import PathError, PathState, elapsed, finite, path_error


@dataclass(frozen=True, slots=True)
class Approach:
    """delta(y_e) = steady - theta_a tanh(y_e / length): the heading error with which to approach the path.

    Since the laws are written for the direction of driving, the sign of v in delta(y_e, v) is not needed.
    """

    theta_a: float  # [rad] far from the path
    length: float  # [m] from the path at which it is 76 % of that

    def angle(self, y_e: float, steady: float = 0.0) -> float:
        """Delta [rad]."""
        return steady - self.theta_a * math.tanh(y_e / self.length)

    def slope(self, y_e: float) -> float:
        """Its derivative [rad/m] with respect to y_e."""
        return -self.theta_a / self.length * (1.0 - math.tanh(y_e / self.length) ** 2)


def rate(error: PathError, v: float, icr_x: float, omega: float, k1: float) -> float:
    """Speed [m/s] of the target, Huskić 2017, Eq. (10); never negative."""
    return max(0.0, v * math.cos(error.theta_e) + icr_x * omega * math.sin(error.theta_e) + k1 * error.x_e)


def turn_with_target(
    error: PathError, v: float, icr_x: float, k1: float, by_y: float, by_s: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Yaw rate delta' + c s' = a + b omega that keeps theta_e - delta, for a moving target and for one at rest.

    Args:
        error: in the frame of the target.
        v: [m/s] in the direction of driving.
        icr_x: [m] ahead of the origin in that direction.
        k1: [1/s] of the target.
        by_y: derivative [rad/m] of delta with respect to y_e.
        by_s: derivative [rad/m] of delta with respect to the arc length.

    Returns:
        (a [rad/s], b) with s' of Eq. (10), and with s' = 0.
    """
    cos, sin = math.cos(error.theta_e), math.sin(error.theta_e)
    stands = by_y * v * sin, -by_y * icr_x * cos  # y_e', Eq. (7)
    turn = error.curvature + by_s - by_y * error.curvature * error.x_e  # per metre of s
    moves = stands[0] + turn * (v * cos + k1 * error.x_e), stands[1] + turn * icr_x * sin
    return moves, stands


def advanced(state: PathState, pose: ArrayLike, twist: ArrayLike, dt: float, icr_x: float, k1: float) -> PathState:
    """The target dt [s] later, and the robot at a pose with a twist, both (3,), that brought it there.

    Eq. (10) takes x_e at the beginning of the step: the advance of the robot in the step is subtracted first. The rest
    decays by exp(-k1 dt), as x_e' = -k1 x_e does, whatever the length of the step.

    Raises:
        DataError: a pose, twist or dt that is not finite, or a dt below 0.
    """
    error, (v, _, omega) = path_error(state, pose), finite("twist", twist)
    if elapsed(dt) == 0.0:
        return state
    v, icr_x = state.direction * v, state.direction * icr_x
    gained = v * math.cos(error.theta_e) + icr_x * omega * math.sin(error.theta_e)
    left = error._replace(x_e=error.x_e - gained * dt)
    return replace(state, s=state.s + dt * rate(left, v, icr_x, omega, -math.expm1(-k1 * dt) / dt))
