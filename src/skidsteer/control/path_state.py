"""What all controllers share: the position on the path, the errors there, and the interface.

A path in reverse is driven with the rear ahead. Seen from the rear the robot drives forward: its speed and icr_x change
sign, its yaw rate does not. The laws are written for that view, so that driving in reverse mirrors driving ahead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import DataError
from skidsteer.paths import Path

ARRIVED = 0.01  # [m] from the end of an open path, where driving stops
CROWDED = 0.2  # lower bound of 1 - c y_e, which vanishes at the centre of curvature
BRANCHES = 0.2  # [m] difference in distance up to which the heading decides between branches of a path
STEEPEST = 0.95  # upper bound of icr_x c: at 1 the ICR lies ahead by the radius of the path, and no heading follows it


@dataclass(frozen=True, slots=True, eq=False)
class PathState:
    """A path and the arc length of its moving frame: the nearest point, or the target of a Lyapunov law."""

    path: Path
    s: float  # [m]

    @classmethod
    def begin(cls, path: Path, pose: ArrayLike) -> PathState:
        """At the point nearest to a pose (3,); where the path crosses itself, on the branch along which it heads.

        Raises:
            DataError: a pose that is not finite.
        """
        return cls(path, nearest_branch(path, finite("pose", pose)))

    @property
    def direction(self) -> float:
        """1 ahead, -1 in reverse."""
        return -1.0 if self.path.reverse else 1.0

    @property
    def remaining(self) -> float:
        """[m] to the end of the path; infinite where it is closed."""
        return math.inf if self.path.closed else self.path.length - self.s

    @property
    def arrived(self) -> bool:
        """Whether the end is reached: every controller stops there."""
        return self.remaining <= ARRIVED

    def projected(self, pose: ArrayLike, twist: ArrayLike, dt: float) -> PathState:
        """At the nearest point of the path, searched around the last one: ``Controller.advance`` without a target."""
        (x, y, _), _ = finite("pose", pose), finite("twist", twist)
        return replace(self, s=self.path.project((x, y), near=self.s)) if elapsed(dt) > 0.0 else self


class PathError(NamedTuple):
    """The robot in the moving frame, Huskić 2017, Fig. 1 and Eq. (7), and the path there."""

    x_e: float  # [m] ahead of the frame
    y_e: float  # [m] to its left
    theta_e: float  # [rad] by which the direction of driving is turned to the left of the tangent, in [-pi, pi)
    curvature: float  # [1/m]
    slope: float  # [1/m^2] of the curvature along the path


Command = tuple[float, float]  # v [m/s], omega [rad/s]
State = TypeVar("State", bound=PathState)  # of a controller: a PathState, or one with memory besides


class Controller(Protocol[State]):
    """A controller: its options are its fields, its place on the path is in the state. Every function is pure."""

    def begin(self, path: Path, pose: ArrayLike) -> State:
        """The state of a robot that stands at a pose (3,), before its first command.

        Raises:
            DataError: a pose that is not finite.
        """

    def command(self, pose: ArrayLike, twist: ArrayLike, state: State) -> Command:
        """The command.

        Args:
            pose: (3,) x, y [m], yaw [rad] of base_link in the frame of the path.
            twist: (3,) v_x, v_y [m/s], omega [rad/s] of base_link, as measured.
            state: where it is on the path.

        Returns:
            v = v_x [m/s], negative in reverse, and omega [rad/s]; both 0 at the end of the path.

        Raises:
            DataError: a pose or twist that is not finite: stop, and wait for the localization.
        """

    def advance(
        self, state: State, pose: ArrayLike, twist: ArrayLike, dt: float, commanded: Command, reckoned: bool = False
    ) -> State:
        """The state dt [s] later; a dt of 0 moves no target.

        Args:
            state: before the step.
            pose: (3,) measured after it.
            twist: (3,) measured after it.
            dt: [s] that it took.
            commanded: v [m/s], omega [rad/s] that were sent for it, within the limits of the wheels.
            reckoned: the pose was not measured, but predicted from the last one by twists.

        Raises:
            DataError: a pose, twist or dt that is not finite, or a dt below 0.
        """


def nearest_branch(path: Path, pose: tuple[float, float, float]) -> float:
    """Arc length [m] of the nearest point; among branches within ``BRANCHES``, on one along which the robot heads."""
    s = np.linspace(0.0, path.length, math.ceil(path.length / BRANCHES) + 1)
    errors = path.error(pose, s)
    far = np.hypot(errors[:, 0], errors[:, 1])
    ahead = (far <= far.min() + BRANCHES) & (np.abs(errors[:, 2]) < 0.25 * math.pi)
    if not ahead.any():
        return path.project(pose[:2])
    return path.project(pose[:2], near=float(s[ahead][far[ahead].argmin()]), window=BRANCHES)


def path_error(state: PathState, pose: ArrayLike) -> PathError:
    """A pose (3,) in the frame of the state: ``Path.error`` for one sample.

    Raises:
        DataError: a pose that is not finite.
    """
    x, y, yaw = finite("pose", pose)
    at = state.path.frame(state.s)
    cos, sin, dx, dy = math.cos(at.yaw), math.sin(at.yaw), x - at.x, y - at.y
    turned = yaw - at.yaw + (math.pi if state.path.reverse else 0.0)
    return PathError(cos * dx + sin * dy, cos * dy - sin * dx, wrapped(turned), at.curvature, at.slope)


def wrapped(angle: float) -> float:
    """[rad] in [-pi, pi), for one number."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def finite(name: str, values: ArrayLike) -> tuple[float, float, float]:
    """Pose or twist as three floats.

    Raises:
        DataError: they are not three finite numbers.
    """
    three = values if isinstance(values, tuple) else np.asarray(values, dtype=float).ravel().tolist()
    if len(three) != 3 or not (math.isfinite(three[0]) and math.isfinite(three[1]) and math.isfinite(three[2])):
        raise DataError(f"the {name} is {three}, not three finite numbers; stop until it is known again")
    return three[0], three[1], three[2]


def elapsed(dt: float) -> float:
    """A time step [s], 0 or more.

    Raises:
        DataError: another one.
    """
    if not (math.isfinite(dt) and dt >= 0.0):
        raise DataError(f"the time step is {dt} s; a controller needs stamps that do not go back")
    return dt


def steady_heading(icr_x: float, error: PathError) -> tuple[float, float]:
    """Heading error [rad] with which the origin stays on a curve, and its slope [rad/m] along the path.

    With v_y = -icr_x omega the origin stays on the path where sin(theta_e) = icr_x (c + dtheta_e / ds): its solution
    to second order in icr_x. Proposition 1 of Huskić 2017, theta_e = 0, holds on straights, or for icr_x = 0.
    """
    sine = icr_x * (error.curvature + icr_x * error.slope)
    if abs(sine) >= STEEPEST:
        return math.copysign(math.asin(STEEPEST), sine), 0.0
    return math.asin(sine), icr_x * error.slope / math.sqrt(1.0 - sine**2)


def turn_within(v: float, omega: float, omega_max: float) -> tuple[float, float]:
    """A command slowed so that abs(omega) <= omega_max [rad/s]; its curvature is kept.

    The authors of Huskić 2017 clamp omega alone, and so leave every curve of more than omega_max / v.
    """
    scale = min(1.0, omega_max / abs(omega)) if omega else 1.0
    return scale * v, scale * omega


def braked(speed: float, remaining: float, deceleration: float) -> float:
    """The speed [m/s], or the one from which a deceleration [m/s^2] stops it within the distance that remains [m]."""
    return min(speed, math.sqrt(2.0 * deceleration * max(remaining, 0.0)))


def require_positive(owner: object, *names: str) -> None:
    """Refuse options that are not above 0 (infinite is allowed).

    Raises:
        ValueError: one of them is not.
    """
    for name in names:
        if not getattr(owner, name) > 0.0:
            raise ValueError(f"need {name} > 0, got {getattr(owner, name)}")
