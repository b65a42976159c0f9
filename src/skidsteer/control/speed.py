"""Longitudinal speed of Huskić 2017, IV.C, and wheel speeds within their limits.

Equation (17) as printed jumps with the sign of omega and where V1 crosses epsilon, and does not by itself keep the
wheels within their limits. Here both jumps are smoothed, and ``Wheels`` scales commands in wheel space, so that no
limit is exceeded and the curvature is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from skidsteer.models import MatrixModel, Model
from skidsteer.se2 import FloatArray

STEPS = 50  # at most, to bring a nonlinear model within the limit
CLOSE = 1e-4  # share of the limit by which a nonlinear model may stay below it: each step costs an inverse
BLEND = 0.1  # [rad/s] of yaw rate to either side of 0, over which Eq. (17) passes from one side to the other
PROBE = 1e-3  # [1/m] curvature that stands for a straight, where an ICR is not defined


def icr_x_at(model: Model, v: float, curvature: float = PROBE) -> float:
    """Position icr_x [m] of a model's ICR at a speed v [m/s], from v_y = -icr_x omega (Huskić 2017, Eq. (2)).

    Raises:
        ValueError: a v or curvature [1/m] of 0.
    """
    if v * curvature == 0.0:
        raise ValueError(f"an ICR needs a turn at some speed, got v = {v}, curvature = {curvature}")
    _, v_y, omega = model.twist(*model.wheel_speeds(v, v * curvature)).tolist()
    return float(-v_y / omega)


@dataclass(frozen=True, slots=True)
class Wheels:
    """A motion model and the greatest rim speed."""

    model: Model
    max_speed: float  # [m/s] at the rim
    _inverse: tuple[float, ...] = field(init=False, repr=False, compare=False)  # rims of v and omega; empty: nonlinear
    _outer: tuple[float, ...] = field(init=False, repr=False, compare=False)  # [m/s] v_x of one side at its limit

    def __post_init__(self) -> None:
        if not 0.0 < self.max_speed < math.inf:
            raise ValueError(f"need a finite max_speed > 0 [m/s], got {self.max_speed}")
        linear = isinstance(self.model, MatrixModel)
        inverse = self.model.wheel_speeds([1.0, 0.0], [0.0, 1.0]).T.ravel() if linear else np.empty(0)
        outer = self.model.twist([0.0, self.max_speed], [self.max_speed, 0.0])[:, 0]
        object.__setattr__(self, "_inverse", tuple(inverse.tolist()))
        object.__setattr__(self, "_outer", tuple(outer.tolist()))

    def _rims(self, v: float, omega: float) -> tuple[float, float]:
        """Rim speeds of a linear model, whatever their limit."""
        a, b, c, d = self._inverse
        return a * v + b * omega, c * v + d * omega

    def speeds(self, v: float, omega: float) -> FloatArray:
        """Rim speeds (2,) [m/s], left and right, for v [m/s] and omega [rad/s], scaled down where one is too fast.

        Neither ever exceeds ``max_speed``; the curvature omega / v is kept.

        Raises:
            ValueError: v or omega that are not finite.
        """
        if not (math.isfinite(v) and math.isfinite(omega)):
            raise ValueError(f"need finite v and omega, got {v}, {omega}")
        if self._inverse:
            left, right = self._rims(v, omega)
            scale = self.max_speed / max(abs(left), abs(right), self.max_speed)
            return np.array([self._within(scale * left), self._within(scale * right)])
        rims = self.model.wheel_speeds(v, omega)
        fastest = float(np.abs(rims).max())
        if fastest <= self.max_speed:
            return rims
        scale = self._scale(v, omega, self.max_speed / fastest)
        return np.clip(self.model.wheel_speeds(scale * v, scale * omega), -self.max_speed, self.max_speed)

    def _within(self, rim: float) -> float:
        """Clipped to the limit, so that rounding does not exceed it."""
        return min(max(rim, -self.max_speed), self.max_speed)

    def _scale(self, v: float, omega: float, guess: float) -> float:
        """Greatest scale in [0, 1] of a command within the limit; one that a model has no rim speeds for is too fast.

        Rim speeds are nearly proportional to the command; where that fails the bracket is halved.
        """
        low, high, scale = 0.0, 1.0, guess if guess > 0.0 else 0.5
        for _ in range(STEPS):
            fastest = float(np.abs(self.model.wheel_speeds(scale * v, scale * omega)).max())
            low, high = (scale, high) if fastest <= self.max_speed else (low, scale)
            if (1.0 - CLOSE) * self.max_speed <= fastest <= self.max_speed:
                break
            guess = scale * (1.0 - 0.5 * CLOSE) * self.max_speed / fastest
            scale = guess if low < guess < high else 0.5 * (low + high)
        return low

    def reachable(self, curvature: float) -> float:
        """Greatest v_x [m/s] at a curvature omega / v_x [1/m], Huskić 2017, Eq. (16), of whichever side is faster."""
        if self._inverse:
            left, right = self._rims(1.0, curvature)
            return self.max_speed / max(abs(left), abs(right))
        rims = self.speeds(2.0 * self.max_speed, 2.0 * self.max_speed * curvature)
        return float(self.model.twist(rims[0], rims[1])[0])

    def turning(self, omega: float) -> float:
        """v_x [m/s] with the outer wheels at their limit and the inner ones at rest, Eq. (17) for V1 >= epsilon.

        Within ``BLEND`` of a yaw rate omega [rad/s] of 0 the two sides are interpolated.
        """
        right = min(max(0.5 + 0.5 * omega / BLEND, 0.0), 1.0)
        return right * self._outer[0] + (1.0 - right) * self._outer[1]


@dataclass(frozen=True, slots=True)
class SaturationSpeed:
    """Huskić 2017, Eq. (17), made continuous: as fast as the wheels allow on the path, slower while far from it."""

    wheels: Wheels
    desired: float = math.inf  # [m/s] upper limit
    epsilon: float = 0.5  # [m^2] V1 above which the robot is far from the path

    def __post_init__(self) -> None:
        if not (self.desired > 0.0 and self.epsilon > 0.0):
            raise ValueError(f"need desired > 0 [m/s] and epsilon > 0 [m^2], got {self.desired}, {self.epsilon}")

    def at(self, v1: float, curvature: float, omega: float) -> float:
        """Speed [m/s].

        Args:
            v1: [m^2] the Lyapunov function, Eq. (8).
            curvature: [1/m] omega / v_x on the path.
            omega: [rad/s] measured; its sign says which side is the outer one.
        """
        speed, near = self.wheels.reachable(curvature), min(max(2.0 - 2.0 * v1 / self.epsilon, 0.0), 1.0)
        if near < 1.0:  # blended over the upper half of epsilon
            speed = near * speed + (1.0 - near) * self.wheels.turning(omega)
        return min(self.desired, speed)
