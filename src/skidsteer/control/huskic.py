"""The kinematic law of Huskić 2017, Eq. (10), corrected.

As printed the bracket of Eq. (10) has the wrong sign: V1 grows. Equation (9) differentiates
V1 = (x_e^2 + y_e^2) / 2 + |sin e| / lambda, e = theta_e - delta, with twice the last term of Eq. (8); for that V1 and
the law below dV1/dt = -k1 x_e^2 - k2 e^2 / lambda. With T = sign(e) / cos(e)

    omega = delta' + c s' - T (lambda y_e (v sin(theta_e) - icr_x omega cos(theta_e)) + k2 e^2)

omega appears on both sides; the equation is linear in it and is solved. Two things remain as published: close to the
path e decays like 1 / t only, since the damping is quadratic; and on curves the law has an offset where icr_x is not 0,
unless ``feed_forward`` adds the heading of steady motion to delta.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from numpy.typing import ArrayLike

from skidsteer.control.path_state import (
    Command,
    PathError,
    PathState,
    braked,
    finite,
    path_error,
    require_positive,
    steady_heading,
    turn_within,
    wrapped,
)
from skidsteer.control.speed import SaturationSpeed
from skidsteer.control.target import Approach, advanced, rate, turn_with_target

STEADY = math.radians(45.0)  # |e| up to which the speed is not reduced
FACING = math.radians(75.0)  # |e| beyond which it turns on the spot: Eq. (10) divides by cos(e)
LOOP = 0.25  # least coefficient of omega with which Eq. (10) is solved


@dataclass(frozen=True, slots=True)
class HuskicGains:
    """Gains of Eq. (10)."""

    k1: float  # [1/s] rate at which the target approaches the robot
    k2: float  # [1/s] damping of e^2
    lam: float  # [1/m^2] lambda, weight of y_e against e
    theta_a: float = math.pi / 4.0  # [rad] largest approach angle
    omega_max: float = math.inf  # [rad/s]

    def __post_init__(self) -> None:
        require_positive(self, "k1", "k2", "lam", "theta_a", "omega_max")


GAINS = {  # of the controller that the authors published: its defaults, and how they launch it
    "header": HuskicGains(k1=1.0, k2=1.0, lam=1.0, omega_max=0.8),
    "launch": HuskicGains(k1=8.0, k2=40.0, lam=1.0, omega_max=0.5),
}


@dataclass(frozen=True, slots=True)
class Huskic:
    """Path following with the ICR model."""

    gains: HuskicGains
    speed: SaturationSpeed
    icr_x: float = 0.0  # [m] ahead of the origin, see ``speed.icr_x_at``
    feed_forward: bool = False  # add the heading of steady motion on a curve to delta
    measured_omega: bool = False  # on the right-hand side, as in the authors' code, instead of solving
    approach_length: float = 1.0  # [m] see ``Approach``
    deceleration: float = 0.5  # [m/s^2] at the end of the path

    def __post_init__(self) -> None:
        require_positive(self, "approach_length", "deceleration")

    begin = staticmethod(PathState.begin)  # see ``Controller``

    def command(self, pose: ArrayLike, twist: ArrayLike, state: PathState) -> Command:
        """See ``Controller``. Beyond |e| = 45 deg it slows down, beyond 75 deg it turns on the spot."""
        error, (_, _, turning) = path_error(state, pose), finite("twist", twist)
        if state.arrived:
            return 0.0, 0.0
        v = self._speed(error, turning, state)
        omega = self._turn(error, v, state.direction * self.icr_x, turning)
        v, omega = turn_within(v, omega, self.gains.omega_max)
        return state.direction * v, omega

    def advance(
        self, state: PathState, pose: ArrayLike, twist: ArrayLike, dt: float, commanded: Command, reckoned: bool = False
    ) -> PathState:
        """See ``Controller``; this law does not use the command."""
        return advanced(state, pose, twist, dt, self.icr_x, self.gains.k1)

    def lyapunov(self, pose: ArrayLike, state: PathState) -> float:
        """V1 [m^2], which decreases along the law."""
        error = path_error(state, pose)
        return self._v1(error, self._deviation(error, state.direction * self.icr_x)[0], 1.0)

    def _v1(self, error: PathError, e: float, weight: float) -> float:
        return 0.5 * (error.x_e**2 + error.y_e**2) + weight * abs(math.sin(e)) / self.gains.lam

    def _deviation(self, error: PathError, icr_x: float) -> tuple[float, float, float]:
        """E = theta_e - delta [rad], and the derivatives of delta with respect to y_e and s [rad/m]."""
        approach = Approach(self.gains.theta_a, self.approach_length)
        steady, by_s = steady_heading(icr_x, error) if self.feed_forward else (0.0, 0.0)
        e = wrapped(error.theta_e - approach.angle(error.y_e, steady))
        return e, approach.slope(error.y_e), by_s

    def _speed(self, error: PathError, turning: float, state: PathState) -> float:
        """[m/s], in the direction of driving."""
        icr_x = state.direction * self.icr_x
        e, _, _ = self._deviation(error, icr_x)
        facing = min(max((FACING - abs(e)) / (FACING - STEADY), 0.0), 1.0)
        heading, _ = steady_heading(icr_x, error)
        asked = state.direction * error.curvature / math.cos(heading)  # omega / v_x, from Eq. (15)
        outer = state.direction * turning  # in reverse a left turn has its outer wheels on the left
        speed = self.speed.at(self._v1(error, e, 0.5), asked, outer)  # V1 of Eq. (8)
        return facing * braked(speed, state.remaining, self.deceleration)

    def _turn(self, error: PathError, v: float, icr_x: float, turning: float) -> float:
        """Omega [rad/s] of Eq. (10)."""
        gains, (e, by_y, by_s) = self.gains, self._deviation(error, icr_x)
        # T, the guarded |sin e| / (sin e cos e): 0 at e = 0, bounded beyond the domain of the law
        T = math.copysign(1.0 / max(math.cos(e), math.cos(FACING)), e) if e else 0.0
        lateral = gains.lam * error.y_e
        back = -T * (lateral * v * math.sin(error.theta_e) + gains.k2 * e**2)
        by_omega = T * lateral * icr_x * math.cos(error.theta_e)
        moves, stands = turn_with_target(error, v, icr_x, gains.k1, by_y, by_s)
        for a, b in (moves, stands):
            if self.measured_omega:
                omega = a + back + (b + by_omega) * turning
            else:
                omega = (a + back) / max(1.0 - b - by_omega, LOOP)
            if rate(error, v, icr_x, turning if self.measured_omega else omega, gains.k1) > 0.0:
                return omega
        return omega
