"""SLPINL: Soetanto, Lapierre, Pascoal 2003, with the speed of Indiveri, Nüchter, Lingemann 2007.

The law that Huskić 2017 compares with. For a unicycle dV1/dt = -k1 x_e^2 - k2 e^2 / gamma + y_e v sin(delta), no term
of which is positive, where V1 = (x_e^2 + y_e^2) / 2 + e^2 / (2 gamma) and e = theta_e - delta. The law does not know
icr_x: where that is not 0 it has an offset on curves.
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
    turn_within,
    wrapped,
)
from skidsteer.control.target import Approach, advanced, rate, turn_with_target


@dataclass(frozen=True, slots=True)
class SoetantoGains:
    """Gains of the law and of its speed."""

    k1: float  # [1/s] rate at which the target approaches the robot
    k2: float  # [1/s] rate at which the heading approaches delta
    gamma: float  # [1/m^2] weight of y_e against e
    b: float = 0.0  # [m] decrease of the speed with the curvature
    theta_a: float = math.pi / 4.0  # [rad] largest approach angle
    epsilon: float = 0.5  # [m^2] V1 above which it drives at half the speed

    def __post_init__(self) -> None:
        require_positive(self, "k1", "k2", "gamma", "theta_a", "epsilon")
        if not self.b >= 0.0:
            raise ValueError(f"need b >= 0 [m], got {self.b}")


GAINS = {  # of the controller that the authors of Huskić 2017 published: its defaults, and how they launch it
    "header": SoetantoGains(k1=1.0, k2=1.0, gamma=1.0),
    "launch": SoetantoGains(k1=3.0, k2=5.0, gamma=5.0, b=0.2),
}


@dataclass(frozen=True, slots=True)
class Soetanto:
    """Path following of a unicycle, without the singularity of a projection."""

    gains: SoetantoGains
    desired: float  # [m/s]
    omega_max: float = math.inf  # [rad/s]
    approach_length: float = 1.0  # [m] see ``Approach``
    deceleration: float = 0.5  # [m/s^2] at the end of the path

    def __post_init__(self) -> None:
        require_positive(self, "desired", "omega_max", "approach_length", "deceleration")

    begin = staticmethod(PathState.begin)  # see ``Controller``

    def command(self, pose: ArrayLike, twist: ArrayLike, state: PathState) -> Command:
        """See ``Controller``."""
        error = path_error(state, pose)
        finite("twist", twist)
        if state.arrived:
            return 0.0, 0.0
        v = braked(self._speed(error), state.remaining, self.deceleration)
        v, omega = turn_within(v, self._turn(error, v), self.omega_max)
        return state.direction * v, omega

    def advance(
        self, state: PathState, pose: ArrayLike, twist: ArrayLike, dt: float, commanded: Command, reckoned: bool = False
    ) -> PathState:
        """See ``Controller``; this law does not use the command."""
        return advanced(state, pose, twist, dt, 0.0, self.gains.k1)

    def lyapunov(self, pose: ArrayLike, state: PathState) -> float:
        """V1 [m^2], which decreases along the law if icr_x is 0."""
        return self._v1(path_error(state, pose))

    def _approach(self) -> Approach:
        return Approach(self.gains.theta_a, self.approach_length)

    def _v1(self, error: PathError) -> float:
        e = wrapped(error.theta_e - self._approach().angle(error.y_e))
        return 0.5 * (error.x_e**2 + error.y_e**2 + e**2 / self.gains.gamma)

    def _speed(self, error: PathError) -> float:
        far = self._v1(error) >= self.gains.epsilon
        return self.desired / (2.0 if far else 1.0 + self.gains.b * abs(error.curvature))

    def _turn(self, error: PathError, v: float) -> float:
        """Omega [rad/s]."""
        gains, delta = self.gains, self._approach().angle(error.y_e)
        e = wrapped(error.theta_e - delta)
        # (sin theta_e - sin delta) / e, exact at e = 0
        chord = math.cos(delta + 0.5 * e) * (math.sin(0.5 * e) / (0.5 * e) if e else 1.0)
        moves, stands = turn_with_target(error, v, 0.0, gains.k1, self._approach().slope(error.y_e), 0.0)
        kept = moves[0] if rate(error, v, 0.0, 0.0, gains.k1) > 0.0 else stands[0]
        return kept - gains.gamma * error.y_e * v * chord - gains.k2 * e
