"""Manoeuvres for a drive that is to calibrate a robot: what it may do, what it can do, as rim speeds over time.

Every manoeuvre starts and ends at rest and keeps the ratio of its rim speeds, and every figure is driven there and
back: whatever the robot's tread ICRs are, however late its body follows its rims, it comes back to where it was, up to
noise and to slip that depends on the speed. That is what makes a table of commands safe to play on a robot that is not
calibrated yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.models import Model
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle

PERIOD = 0.05  # [s] of the commands
WALKING = 1.5  # [m/s] the pace of someone who walks beside the robot, a hand at the stop button
LATERAL = 0.5  # [m/s^2] speed times yaw rate, up to which constant ICRs hold well enough
LEVELS = (1.0, 0.6, 0.3)  # of the highest speed that a figure allows
SWINGS = (2, 4, 8)  # to and fro on the fastest straight before the robot stops in the middle again
# radii of arcs over the expected ICR distance; at 0.5 the inner side rests
SHARPNESS = (0.25, 0.375, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0)
SWEEPS = (np.pi / 4, np.pi / 2, np.pi, 2 * np.pi, 4 * np.pi)  # [rad] of arcs
TURNS = (1.0, 2.0)  # on the spot
SETTLED = 20  # steps towards the highest speed that the rims allow


@dataclass(frozen=True, slots=True)
class Limits:
    """What the robot may do.

    Raises:
        RequestError: a limit that is not a positive number.
    """

    speed: float  # [m/s] of the body
    omega: float  # [rad/s] of the body
    wheel_speed: float  # [m/s] of a rim
    acceleration: float  # [m/s^2] of a rim
    lateral_acceleration: float = LATERAL  # [m/s^2] speed times yaw rate, of the body

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value > 0.0):
                raise RequestError(f"the limit of the {field.name.replace('_', ' ')} must be positive, got {value}")

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        speed: float | None = None,
        omega: float = 1.5,
        acceleration: float = 1.5,
        lateral: float = LATERAL,
    ) -> Limits:
        """Limits of a vehicle: its rims, and no faster than ``WALKING`` unless asked for.

        Raises:
            RequestError: the speed asked for is beyond the rims, or nothing tells how fast they can be.
        """
        top = vehicle.max_wheel_speed
        if top is None and speed is None:
            raise RequestError(
                f"{vehicle.name}: how fast its wheels can be is not known; give --max-speed, or max_wheel_speed in its"
                " vehicle file"
            )
        if top is not None and speed is not None and speed > top:
            raise RequestError(f"--max-speed {speed:g} m/s is beyond the {top:g} m/s of the wheels of {vehicle.name}")
        rims = top if top is not None else speed
        assert rims is not None
        return cls(min(rims, WALKING) if speed is None else speed, omega, rims, acceleration, lateral)


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """One operating point, held for a while, with ramps from rest and back to it.

    ``duration`` is how long the operating point would have to be held without ramps to get as far. ``v`` and ``omega``
    are what the expected model does at these rim speeds.
    """

    v: float  # [m/s]
    omega: float  # [rad/s]
    rims: tuple[float, float]  # [m/s] left, right
    duration: float  # [s]

    def back(self) -> Manoeuvre:
        """The same in reverse: what retraces it."""
        return Manoeuvre(-self.v, -self.omega, (-self.rims[0], -self.rims[1]), self.duration)

    def profile(self, acceleration: float) -> FloatArray:
        """Rim speeds (n, 2) [m/s], one for each ``PERIOD``: the mean of a trapezoid of that slope in it."""
        ramp = max(abs(r) for r in self.rims) / acceleration
        whole = self.duration + ramp if self.duration >= ramp else 2.0 * np.sqrt(self.duration * ramp)
        edge = min(ramp, 0.5 * whole)  # a short one is a triangle
        t = PERIOD * np.arange(int(np.ceil(whole / PERIOD - 1e-9)) + 1)
        rise, fall = np.clip(t, 0.0, edge), np.clip(t - (whole - edge), 0.0, edge)
        flat = np.clip(t - edge, 0.0, whole - 2.0 * edge)
        covered = (rise**2 / 2.0 + edge * flat + edge * fall - fall**2 / 2.0) / ramp  # [s] at full speed
        return np.outer(np.diff(covered) / PERIOD, self.rims)

    def words(self) -> str:
        """What it is, for people."""
        angle = abs(self.omega) * self.duration
        if abs(self.v) < 1e-6:
            side = "left" if self.omega > 0 else "right"
            return f"turn on the spot to the {side}, {_turns(angle)} at {abs(self.omega):.2f} rad/s"
        way = "ahead" if self.v > 0 else "back"
        if abs(self.omega) < 1e-6:
            return f"straight {way}, {abs(self.v) * self.duration:.1f} m at {abs(self.v):.2f} m/s"
        side = "left" if self.v * self.omega > 0 else "right"
        radius = abs(self.v / self.omega)
        return f"arc {way} about the {side}, radius {radius:.2f} m, {_turns(angle)} at {abs(self.v):.2f} m/s"


def _turns(angle: float) -> str:
    turns = angle / (2.0 * np.pi)
    return f"{np.degrees(angle):.0f} deg" if turns < 0.99 else f"{turns:.3g} turn{'' if abs(turns - 1) < 0.01 else 's'}"


@dataclass(frozen=True, slots=True)
class Figure:
    """Manoeuvres that end where they begin."""

    parts: tuple[Manoeuvre, ...]

    @classmethod
    def retraced(cls, *parts: Manoeuvre) -> Figure:
        """There and back."""
        return cls((*parts, *(part.back() for part in reversed(parts))))

    def words(self) -> str:
        """What it is, for people."""
        first = self.parts[0].words()
        if len(self.parts) % 2:
            swings = len(self.parts) // 2
            often = f", {swings} times to and fro," if swings > 1 else ","
            return f"{first}, back through the middle to the other end{often} and to the middle"
        return f"{first}, and back" + ("; the same backwards about the right" if len(self.parts) == 4 else "")

    def profile(self, acceleration: float) -> FloatArray:
        """Rim speeds (n, 2) [m/s], one for each ``PERIOD``."""
        return np.concatenate([part.profile(acceleration) for part in self.parts])


def rims_of(figures: Sequence[Figure], acceleration: float, rest: float = 1.0) -> Series:
    """Rim speeds of figures one after the other, with a rest [s] before and behind."""
    still = np.zeros((round(rest / PERIOD), 2))
    rims = np.concatenate([still, *(figure.profile(acceleration) for figure in figures), still])
    return Series(PERIOD * np.arange(len(rims), dtype=float), rims, "wheels")


def library(model: Model, limits: Limits, reach: float) -> list[Figure]:
    """Figures to choose from: straights, turns on the spot, arcs and S-curves, to both sides and at several speeds.

    Args:
        model: what the robot is expected to do; turns v and omega into rim speeds.
        limits: none of the figures goes beyond.
        reach: [m] that straights go to either side of the start.
    """
    turn = model.wheel_speeds(0.0, 1.0)
    width = float(turn[1] - turn[0])  # ICR distance
    out = [_shuttle(_held(model, limits, 1.0, 0.0, 1.0, reach), swings) for swings in SWINGS]
    for level in LEVELS:
        out += [_shuttle(_held(model, limits, 1.0, 0.0, level, share * reach), 1) for share in (1.0, 0.5)]
        for turns in TURNS:
            sides = (_held(model, limits, 0.0, side, level, 2.0 * np.pi * turns) for side in (1.0, -1.0))
            out += [Figure.retraced(part) for part in sides]
        for radius in width * np.array(SHARPNESS):
            out += [_both_sides(model, _held(model, limits, radius, 1.0, level, sweep)) for sweep in SWEEPS]
    return [figure for figure in out if all(np.isfinite(part.rims).all() for part in figure.parts)]


def _shuttle(run: Manoeuvre, swings: int) -> Figure:
    """To the far end, all the way to the other one and back ``swings`` times less a half, and to the middle again."""
    whole = replace(run, duration=2.0 * run.duration)
    return Figure((run, *([whole.back(), whole] * swings)[:-1], run))


def _both_sides(model: Model, arc: Manoeuvre) -> Figure:
    """Along an arc and back, then along the arc that it is turned into by half a turn of the robot.

    Where the robot slips to the outside, each of the two comes back beside its start, by the opposite of the other.
    """
    left, right = model.wheel_speeds(-arc.v, arc.omega)
    other = Manoeuvre(-arc.v, arc.omega, (float(left), float(right)), arc.duration)
    return Figure((arc, arc.back(), other, other.back()))


def _held(model: Model, limits: Limits, v: float, omega: float, level: float, amount: float) -> Manoeuvre:
    """The fastest motion within the limits along (v, omega), times ``level``, until ``amount`` of it is done."""
    top = min(limits.speed / abs(v) if v else np.inf, limits.omega / abs(omega) if omega else np.inf)
    top = min(top, float(np.sqrt(limits.lateral_acceleration / abs(v * omega)))) if v * omega else top
    for _ in range(SETTLED):  # the rims of some models are not in proportion
        top *= min(1.0, limits.wheel_speed / float(np.abs(model.wheel_speeds(top * v, top * omega)).max()))
    left, right = model.wheel_speeds(level * top * v, level * top * omega)
    return Manoeuvre(level * top * v, level * top * omega, (float(left), float(right)), amount / (level * top))
