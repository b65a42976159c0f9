"""Rim speeds of the two sides from what robots record: joint states, encoder counts, wheel-odometry twists."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skidsteer.errors import DataError, RequestError
from skidsteer.io.counters import Rolled, roll, top_speed
from skidsteer.io.messages import COUNTERS, Samples
from skidsteer.io.options import BagOptions
from skidsteer.io.raw import BagTopic, shown
from skidsteer.io.stamps import SECOND, Clock, Timed, clock_of, concatenated
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle

_LEFT = {"left", "l", "lf", "fl", "lr", "rl", "bl", "lb", "ml", "lm", "cl", "lc"}
_RIGHT = {"right", "r", "rf", "fr", "rr", "br", "rb", "mr", "rm", "cr", "rc"}
_ROLLING = {"wheel", "wheels", "track", "tread", "drive", "sprocket"}
_NO_WHEEL = {"caster", "castor", "steer", "steering", "gripper", "finger", "arm", "flipper", "shoulder", "elbow"}
_NO_WHEEL |= {"wrist", "knuckle", "camera", "head", "pan", "tilt", "suspension", "rocker", "bogie", "mast"}
_AGREE = 0.2  # positions and velocities whose distances differ by less than this share are one signal
_HELD = 0.2  # share of moving samples whose position does not change, above which velocities are the better signal


@dataclass(frozen=True, slots=True)
class Sides:
    """Names of the joints of each side."""

    left: tuple[str, ...]
    right: tuple[str, ...]


def words(name: str) -> list[str]:
    """Lower-case words of a topic or joint name: ``frontLeft_wheel1`` is front, left, wheel, 1."""
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", name)
    return [part.lower() for part in parts]


def side_of(name: str) -> str | None:
    """The side that a name tells, "left" or "right", None where it tells none."""
    lower = name.lower()
    if ("left" in lower) != ("right" in lower):
        return "left" if "left" in lower else "right"
    found = {("left" if word in _LEFT else "right") for word in words(name) if word in _LEFT | _RIGHT}
    return found.pop() if len(found) == 1 else None


def match_sides(names: Sequence[str]) -> Sides | None:
    """Which joints are the wheels of which side, by their names; None unless there are some on both sides."""
    sided = {name: side for name in names if (side := side_of(name)) and not _NO_WHEEL & set(words(name))}
    rolling = {name: side for name, side in sided.items() if any(part in name.lower() for part in _ROLLING)}
    chosen = rolling or sided
    left = tuple(sorted(name for name, side in chosen.items() if side == "left"))
    right = tuple(sorted(name for name, side in chosen.items() if side == "right"))
    return Sides(left, right) if left and right else None


def sides_in(tables: Sequence[Samples], options: BagOptions) -> Sides | None:
    """The wheels of JointState messages: those the user names, or the table that has the most on both sides.

    Where no message has both, as with one driver a motor, the joints of all are taken whose names say that they roll.
    """
    if options.left_joints:
        return Sides(options.left_joints, options.right_joints)
    found = [sides for table in tables if (sides := match_sides(table.label))]
    if not found:
        return match_sides([joint for joint in joints_in(tables) if any(part in joint.lower() for part in _ROLLING)])
    return max(found, key=lambda sides: len(sides.left) + len(sides.right))


def joints_in(tables: Sequence[Samples]) -> list[str]:
    """Names of all joints, in alphabetical order."""
    return sorted({joint for table in tables for joint in table.label})


def joint_wheels(
    name: str, tables: Sequence[Samples], vehicle: Vehicle, options: BagOptions, notes: list[str]
) -> tuple[Timed, Clock]:
    """Rim speeds (n, 2) [m/s] from JointState, and the clock they are stamped with.

    Several wheels of a side are averaged. Positions are preferred, since the distance between two of them is exact;
    velocities are used where positions are missing, do not move, disagree, or are held between updates. Where no
    message has all of the wheels, each wheel is read by itself and held until its next message.

    Raises:
        RequestError: the sides cannot be told from the names, or the joints the user names are not there.
        DataError: neither positions nor velocities are usable.
    """
    sides, every = sides_in(tables, options), joints_in(tables)
    joints = (*sides.left, *sides.right) if sides else ()
    if sides is None or not set(joints) <= set(every):
        missing = f"has no message with {shown(', '.join(joints))}" if joints else "does not tell left from right"
        raise RequestError(f"{name}: {missing}; its joints are {shown(', '.join(every))}; name them by side")
    notes.append(f"{name}: left wheels {shown(', '.join(sides.left))}; right wheels {shown(', '.join(sides.right))}")
    widths = (len(sides.left), len(sides.right))
    together = any(set(joints) <= set(table.label) for table in tables)
    parts = [joints] if together else [(joint,) for joint in joints]
    angles = [_of_joints(tables, part, 0) for part in parts]
    rates = [_of_joints(tables, part, 1) for part in parts]
    signal = _JointSignal(name, vehicle, clock_of(angles[0]), widths if together else (1,))
    heard: list[str] = []
    found = [signal.speeds(*both, options.wheel_signal, heard) for both in zip(angles, rates, strict=True)]
    notes.extend(dict.fromkeys(heard))
    if together:
        return found[0], signal.clock
    wheels = _held_together(found)
    return wheels.with_values(_means(wheels.values, widths)), signal.clock


def _of_joints(tables: Sequence[Samples], joints: Sequence[str], part: int) -> Samples:
    """Positions (part 0) or velocities (part 1) of these joints, from all messages that have all of them."""
    return concatenated([_columns(table, joints, part) for table in tables if set(joints) <= set(table.label)])


def _columns(table: Samples, joints: Sequence[str], part: int) -> Samples:
    """Positions (part 0) or velocities (part 1) of these joints, in their order."""
    width = len(table.label)
    index = [part * width + table.label.index(joint) for joint in joints]
    return replace(table, label=tuple(joints), values=table.values[:, index])


@dataclass(frozen=True, slots=True)
class _JointSignal:
    """Chooses between the positions and the velocities of the same joints, of which so many are of each side."""

    name: str
    vehicle: Vehicle
    clock: Clock
    widths: tuple[int, ...]

    def speeds(self, angles: Samples, rates: Samples, wanted: str | None, notes: list[str]) -> Timed:
        has_angles, has_rates = (bool(np.isfinite(part.values).all(axis=1).any()) for part in (angles, rates))
        if wanted == "position" or (has_angles and not has_rates):
            return self._from_angles(angles, notes)
        if wanted == "velocity" or not has_angles:
            return self._from_rates(rates, notes)
        heard: list[str] = []
        by_angle, by_rate = self._from_angles(angles, heard), self._from_rates(rates, notes)
        reason = _why_not_positions(by_angle, by_rate)
        if reason is None:
            notes.extend(note for note in heard if note not in notes)
            return by_angle
        notes.append(f"{self.name}: wheel speeds are the recorded velocities, since {reason}")
        return by_rate

    def _from_rates(self, rates: Samples, notes: list[str]) -> Timed:
        timed = self.clock.timed(rates, self.name, notes)
        return timed.with_values(_means(timed.values * self.vehicle.wheel_radius, self.widths))

    def _from_angles(self, angles: Samples, notes: list[str]) -> Timed:
        timed = self.clock.timed(angles, self.name, notes)
        rolled = roll(timed.ns, timed.values, top_speed(self.vehicle) / self.vehicle.wheel_radius)
        note_jumps(self.name, rolled, notes)
        notes.append(f"{self.name}: wheel speeds are differences of the recorded positions")
        return _held_speeds(timed.ns, _means(rolled.steps * self.vehicle.wheel_radius, self.widths))


def _means(wheels: FloatArray, widths: tuple[int, ...]) -> FloatArray:
    """Means (n, k) of neighbouring columns, so many of each side."""
    return np.stack([side.mean(axis=1) for side in np.split(wheels, np.cumsum(widths)[:-1], axis=1)], axis=1)


def _held_together(parts: Sequence[Timed]) -> Timed:
    """Columns (n, 1) of different times side by side, each held until its next one, from where all have begun."""
    ns = np.unique(np.concatenate([part.ns for part in parts]))
    ns = ns[ns >= max(part.ns[0] for part in parts)]
    columns = [part.values[np.searchsorted(part.ns, ns, side="right") - 1, 0] for part in parts]
    return Timed(ns, np.stack(columns, axis=1))


def _held_speeds(ns: np.typing.NDArray[np.int64], distances: FloatArray) -> Timed:
    """Distances (n - 1, 2) rolled between n samples as speeds (n, 2), each held to the next sample."""
    if not len(distances):
        return Timed(ns, np.zeros((len(ns), 2)))
    speeds = distances / (np.diff(ns) / SECOND)[:, None]
    return Timed(ns, np.concatenate([speeds, speeds[-1:]]))


def _why_not_positions(by_angle: Timed, by_rate: Timed) -> str | None:
    """What makes positions the worse signal, None where nothing does."""
    travelled, promised = (
        float((np.abs(part.values[:-1]) * np.diff(part.ns)[:, None]).sum() / SECOND) for part in (by_angle, by_rate)
    )
    if promised == 0.0:
        return None
    if travelled == 0.0:
        return "the positions do not change"
    if abs(travelled / promised - 1.0) > _AGREE:
        return f"the positions tell of {travelled:.2f} m where the velocities tell of {promised:.2f} m"
    moving = np.interp(by_angle.ns, by_rate.ns, np.abs(by_rate.values).max(axis=1)) > 0.02
    still = (by_angle.values == 0.0).all(axis=1)
    held = float(still[moving].mean()) if moving.any() else 0.0
    return f"{100 * held:.0f} % of the positions are only repeated" if held > _HELD else None


def note_jumps(name: str, rolled: Rolled, notes: list[str]) -> None:
    """Tell of what was undone in a counter."""
    if rolled.wraps:
        notes.append(f"{name}: {rolled.wraps} wrap-arounds of the count undone")
    if rolled.resets:
        notes.append(f"{name}: {rolled.resets} jumps of the count bridged with the speed before them")


def twist_wheels(
    name: str, samples: Samples, vehicle: Vehicle, options: BagOptions, notes: list[str]
) -> tuple[Timed, Clock]:
    """Rim speeds (n, 2) [m/s] from the twist of wheel odometry: the last two columns of ``samples``, v and omega.

    A differential-drive controller reports omega = (v_right - v_left) / (multiplier * separation). That width must be
    the one that was in force, or the rim speeds come out wrong: it is taken from the options, or else from the
    factory setting of the vehicle, or else its track width.
    """
    multiplier = options.separation_multiplier or vehicle.factory_multiplier or 1.0
    separation = options.separation or vehicle.factory_separation or vehicle.track_width
    clock = clock_of(samples)
    timed = clock.timed(replace(samples, values=samples.values[:, -2:]), name, notes)
    v, omega = timed.values.T
    half = 0.5 * multiplier * separation
    notes.append(
        f"{name}: wheel speeds are taken back from its twist with separation {separation:g} m"
        f" times multiplier {multiplier:g}"
    )
    return timed.with_values(np.stack([v - half * omega, v + half * omega], axis=1)), clock


def pair_wheels(
    topics: Sequence[BagTopic], tables: Sequence[Samples], vehicle: Vehicle, options: BagOptions, notes: list[str]
) -> tuple[Timed, Clock]:
    """Rim speeds (n, 2) [m/s] from two topics of numbers, left and right, each held until its next message.

    Raises:
        RequestError: the unit is not known, or counts a turn are needed and not known.
    """
    clock = Clock()  # these messages carry no stamp
    sides = [
        _counter_speeds(topic, clock.timed(table, shown(topic.name), notes), vehicle, options, notes)
        for topic, table in zip(topics, tables, strict=True)
    ]
    return _held_together(sides), clock


def _counter_speeds(topic: BagTopic, timed: Timed, vehicle: Vehicle, options: BagOptions, notes: list[str]) -> Timed:
    unit = options.wheels_unit or ("ticks" if topic.type in COUNTERS else None)
    if unit is None:
        raise RequestError(f"{shown(topic.name)}: holds plain numbers; say what they are: rad, rad/s, m/s or ticks")
    scale = {"m/s": 1.0, "rad/s": vehicle.wheel_radius, "rad": vehicle.wheel_radius}.get(unit)
    if scale is None:
        if vehicle.ticks_per_revolution is None:
            raise RequestError(f"{shown(topic.name)}: holds encoder counts; the vehicle needs ticks_per_revolution")
        scale = 2.0 * math.pi * vehicle.wheel_radius / vehicle.ticks_per_revolution
    if unit in ("m/s", "rad/s"):
        return timed.with_values(timed.values * scale)
    rolled = roll(timed.ns, timed.values, top_speed(vehicle) / scale)
    note_jumps(shown(topic.name), rolled, notes)
    if not len(rolled.steps):
        raise DataError(f"{shown(topic.name)}: one count tells no speed")
    return _held_speeds(timed.ns, rolled.steps * scale)
