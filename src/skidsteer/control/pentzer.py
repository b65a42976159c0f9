"""PBR: Pentzer, Brennan, Reichard 2014: the path following of a unicycle by Canudas de Wit et al., at the ICR.

The point at icr_x ahead of the origin moves like a unicycle. It is steered by its errors,

    omega = -k1 v y_e sin(theta_e) / theta_e - k2 |v| theta_e

with y_e + icr_x sin(theta_e) in place of y_e, since robot and path are shifted by the ICR. As published the law has no
curvature in it: on a curve it needs an offset of about -c / k1 to turn the robot, and k2 icr_x c / k1 more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from numpy.typing import ArrayLike

from skidsteer.control.path_state import (
    CROWDED,
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

LOOP = 0.25  # least coefficient of omega for which the feed-forward is solved


@dataclass(frozen=True, slots=True)
class PentzerGains:
    """Gains of the law."""

    k1: float  # [1/m^2] of the offset
    k2: float  # [1/m] of the heading
    omega_max: float = math.inf  # [rad/s]

    def __post_init__(self) -> None:
        require_positive(self, "k1", "k2", "omega_max")


GAINS = {"published": PentzerGains(k1=5.0, k2=5.0, omega_max=0.6)}  # by the authors of Huskić 2017


@dataclass(frozen=True, slots=True)
class Pentzer:
    """Path following at the ICR, by projection."""

    gains: PentzerGains
    desired: float  # [m/s]
    icr_x: float = 0.0  # [m] ahead of the origin, see ``speed.icr_x_at``
    feed_forward: bool = False  # add the curvature of the path and the heading of steady motion
    deceleration: float = 0.5  # [m/s^2] at the end of the path

    def __post_init__(self) -> None:
        require_positive(self, "desired", "deceleration")

    begin = staticmethod(PathState.begin)  # see ``Controller``

    def command(self, pose: ArrayLike, twist: ArrayLike, state: PathState) -> Command:
        """See ``Controller``."""
        error = path_error(state, pose)
        finite("twist", twist)
        if state.arrived:
            return 0.0, 0.0
        v = braked(self.desired, state.remaining, self.deceleration)
        v, omega = turn_within(v, self._turn(error, v, state.direction * self.icr_x), self.gains.omega_max)
        return state.direction * v, omega

    def advance(
        self, state: PathState, pose: ArrayLike, twist: ArrayLike, dt: float, commanded: Command, reckoned: bool = False
    ) -> PathState:
        """See ``Controller``; this law does not use the command."""
        return state.projected(pose, twist, dt)

    def _turn(self, error: PathError, v: float, icr_x: float) -> float:
        """Omega [rad/s]."""
        heading, by_s = steady_heading(icr_x, error) if self.feed_forward else (0.0, 0.0)
        e = wrapped(error.theta_e - heading)
        aside = error.y_e + icr_x * (math.sin(error.theta_e) - math.sin(heading))
        sinc = math.sin(e) / e if e else 1.0
        back = -self.gains.k1 * v * aside * sinc - self.gains.k2 * abs(v) * e
        if not self.feed_forward:
            return back
        # omega = (c + heading') s' + back, with s' = (v cos(theta_e) + icr_x omega sin(theta_e)) / (1 - c y_e)
        turn = (error.curvature + by_s) / max(1.0 - error.curvature * error.y_e, CROWDED)
        ahead = turn * v * math.cos(error.theta_e)
        return (ahead + back) / max(1.0 - turn * icr_x * math.sin(error.theta_e), LOOP)
