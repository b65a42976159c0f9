"""From sightings of the plate to poses of the robot: which face is seen, base_link's frame, means over scans."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skidsteer import se2
from skidsteer.drive import Series
from skidsteer.errors import DataError, RequestError
from skidsteer.laser.line import BoolArray, IntArray
from skidsteer.laser.plate import SIDES, Plate, Sightings, find_plate, wrap_direction
from skidsteer.laser.scans import Scans
from skidsteer.se2 import FloatArray

RATE = 25.0  # [Hz] of the poses of a drive: faster scans are averaged
NEIGHBOURS = 2  # sightings before and after that must be near
TOP_SPEED = 3.0  # [m/s] of the robot; a sighting that would need more is of another object
BRIDGE = 1.5  # [s] without a sighting over which the yaw rate before it is extrapolated
BASELINE = 0.3  # [s] over which that rate is taken
CLEAR = 5.0  # sigmas by which one orientation must explain the motion better than the other
ALIKE = 0.5  # least correlation of rolling and moving that decides
STEEP = 0.2  # least sine of the angle between plate and line of sight at which a side of the robot decides


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Poses of base_link in the scanner's frame, where the plate was seen."""

    t: FloatArray  # (k,) [s]
    pose: FloatArray  # (k, 3) x, y [m], yaw [rad], continuous within a stretch
    parts: FloatArray  # (k, 2, 3, 3) of the covariance; see `Sightings`
    stretch: IntArray  # (k,) numbered from 0; a long time out of sight ends a stretch
    notes: tuple[str, ...] = ()  # what was left out, for the user

    @property
    def covariance(self) -> FloatArray:
        """Of each pose: (k, 3, 3)."""
        return np.asarray(self.parts.sum(axis=1))

    def series(self) -> Series:
        """The poses as a reference."""
        return Series(self.t, self.pose, "pose")

    def stretch_of(self, number: int) -> Track:
        """One stretch alone."""
        inside = self.stretch == number
        return Track(self.t[inside], self.pose[inside], self.parts[inside], self.stretch[inside])

    def turned(self, start: float, end: float) -> float:
        """Rotation [rad] between two times [s], Wang 2015, Eq. (36), full turns included.

        Raises:
            DataError: the plate was out of sight at one of them or for long between them.
        """
        before = int(np.searchsorted(self.t, start, side="right")) - 1
        behind = int(np.searchsorted(self.t, end))
        inside = 0 <= before <= behind < len(self.t)
        if not (start <= end and inside and self.stretch[before] == self.stretch[behind]):
            raise DataError(f"the plate was not in sight all the time from {start:.2f} to {end:.2f} s")
        return float(np.diff(np.interp([start, end], self.t, self.pose[:, 2]))[0])


def track_plate(
    scans: Scans | Sequence[Scans], plate: Plate, wheels: Series | None = None, rate: float = RATE
) -> Track:
    """Poses of the robot from scans of the plate on it.

    Args:
        scans: of one scanner at rest; several groups where it changed its bearings.
        plate: on the robot. Its ``side`` decides which face is seen at first.
        wheels: (n, 2) v_left, v_right [m/s] on the clock of the scans. They decide where the side is not given, and
            after the plate was out of sight for more than ``BRIDGE``.
        rate: [Hz] to about which scans are averaged; infinity: not at all.

    Raises:
        DataError: the plate is seen in no scan.
        RequestError: nothing decides which face of the plate is seen.
    """
    found = find_plate(scans, plate.width)
    near = _near_neighbours(found)
    notes = [found.tally()]
    if not near.all():
        notes.append(f"{int((~near).sum())} sightings left out: too far from those before and after for a robot")
    t, pose = found.t[near], found.pose[near]
    yaw, stretch = _followed(t, pose[:, 2] - plate.yaw)
    track = Track(t, np.column_stack([pose[:, :2], yaw]), found.parts[near], stretch)
    track, left_out = _oriented(track, plate, wheels)
    return replace(_averaged(_in_base(track, plate), rate), notes=(*notes, *left_out))


def _near_neighbours(found: Sightings) -> BoolArray:
    """Whether a robot could be at each sighting (k,), judged by the median of those around it."""
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(np.column_stack([found.t, found.pose[:, :2]]), ((NEIGHBOURS, NEIGHBOURS), (0, 0)), mode="edge"),
        2 * NEIGHBOURS + 1,
        axis=0,
    )
    off = np.hypot(*(found.pose[:, :2] - np.median(around[:, 1:], axis=2)).T)
    sigma = np.sqrt(found.covariance[:, 0, 0] + found.covariance[:, 1, 1])
    return np.asarray(off <= CLEAR * sigma + TOP_SPEED * np.abs(around[:, 0] - found.t[:, None]).max(axis=1))


def _followed(t: FloatArray, direction: FloatArray) -> tuple[FloatArray, IntArray]:
    """Directions (k,), known up to half turns, made continuous; and the stretch of each.

    A gap of more than ``BASELINE`` is bridged by the yaw rate before it; where it is longer than ``BRIDGE``, or the
    direction after it is more than an eighth of a turn off, a new stretch begins.
    """
    steps, gaps = wrap_direction(np.diff(direction)), np.diff(t)
    ends = np.zeros(len(t), dtype=np.int64)
    for i in np.flatnonzero(gaps > BASELINE).tolist():
        before = np.searchsorted(t, t[i] - BASELINE)
        expected = gaps[i] * steps[before:i].sum() / (t[i] - t[before]) if before < i else 0.0
        off = float(wrap_direction(steps[i] - expected))
        steps[i] = expected + off
        ends[i + 1] = gaps[i] > BRIDGE or abs(off) > 0.25 * np.pi
    return direction[0] + np.concatenate([[0.0], np.cumsum(steps)]), np.cumsum(ends)


def _oriented(track: Track, plate: Plate, wheels: Series | None) -> tuple[Track, list[str]]:
    """The track by the right face, without the stretches for which nothing decides that, and a note on those."""
    turns = [_half_turn(track.stretch_of(k), plate, wheels, k == 0) for k in range(track.stretch[-1] + 1)]
    known = np.array([turn is not None for turn in turns])[track.stretch]
    if not known.any():
        raise RequestError(
            "scans: a plate looks the same both ways, and the wheels do not tell how the robot stands; say on which"
            f" side of it the scanner is at first ({', '.join(SIDES)}), or roll some way in sight of it"
        )
    lost = int((~known).sum())
    why = f"{lost} sightings left out: the plate was out of sight before, and could be either way round"
    half = np.pi * np.array([float(turn or 0) for turn in turns])[track.stretch]
    pose = np.column_stack([track.pose[:, :2], track.pose[:, 2] + half])
    return Track(track.t[known], pose[known], track.parts[known], track.stretch[known]), [why] if lost else []


def _half_turn(track: Track, plate: Plate, wheels: Series | None, is_first: bool) -> int | None:
    """Whether a stretch must be turned by half a turn, 0 or 1; None where nothing decides."""
    if is_first and plate.side is not None:
        towards = float(se2.rotate(track.pose[0, 2], SIDES[plate.side]) @ -track.pose[0, :2])
        towards /= float(np.hypot(*track.pose[0, :2]))
        if abs(towards) < STEEP:
            raise RequestError(f"scans: with this plate the scanner can hardly stand {plate.side} of the robot")
        return int(towards < 0.0)
    return None if wheels is None else _rolled_backwards(track, plate, wheels)


def _rolled_backwards(track: Track, plate: Plate, wheels: Series) -> int | None:
    """1 where, by the wheels, the robot stands the other way round, 0 where not, None where they do not decide."""
    at = np.unique(np.searchsorted(track.t, np.arange(track.t[0], track.t[-1], BASELINE)))
    rolled = np.diff(np.interp(track.t[at], wheels.t, _rolled(wheels)))
    moved = []
    for half in (0.0, np.pi):
        pose = _base(track.pose[at] + [0.0, 0.0, half], plate)
        yaw = 0.5 * (pose[1:, 2] + pose[:-1, 2])
        moved.append((np.diff(pose[:, :2], axis=0) * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)).sum(axis=1))
    ahead = 0.5 * (moved[0] - moved[1])
    agreement, length = float(rolled @ ahead), float(np.hypot.reduce(rolled)) if rolled.size else 0.0
    sigma = math.sqrt(2.0 * np.trace(track.covariance[:, :2, :2].mean(axis=0)))
    likeness = float(np.hypot.reduce(ahead)) * length if rolled.size else 0.0
    if abs(agreement) <= max(CLEAR * sigma * length, ALIKE * likeness):
        return None
    return int(agreement < 0.0)


def _rolled(wheels: Series) -> FloatArray:
    """Distance (n,) [m] that the middle of the rims has rolled."""
    return np.concatenate([[0.0], np.cumsum(wheels.values[:-1].mean(axis=1) * np.diff(wheels.t))])


def _base(pose: FloatArray, plate: Plate) -> FloatArray:
    """Poses (k, 3) of base_link from its yaw and the position of the plate's centre."""
    return se2.compose(pose, [-plate.x, -plate.y, 0.0])


def _in_base(track: Track, plate: Plate) -> Track:
    jacobian = np.tile(np.eye(3), (len(track.t), 1, 1))
    jacobian[:, :2, 2] = -se2.rotate(track.pose[:, 2] + 0.5 * np.pi, [plate.x, plate.y])
    parts = jacobian[:, None] @ track.parts @ jacobian.transpose(0, 2, 1)[:, None]
    return replace(track, pose=_base(track.pose, plate), parts=parts)


def _averaged(track: Track, rate: float) -> Track:
    """Means over as many scans as bring their rate closest to ``rate`` [Hz], with less noise."""
    step = float(np.median(np.diff(track.t))) if len(track.t) > 1 else 1.0
    count = round(1.0 / (rate * step))
    if count <= 1:
        return track
    block = np.floor((track.t - track.t[0]) / (count * step) + 0.5 / count).astype(np.int64)
    _, first, block = np.unique([track.stretch, block], axis=1, return_index=True, return_inverse=True)
    number = np.bincount(block.ravel())

    def mean(values: FloatArray) -> FloatArray:
        columns = values.reshape(len(values), -1).T
        total = np.stack([np.bincount(block.ravel(), column) for column in columns], axis=-1)
        return (total / number[:, None]).reshape(-1, *values.shape[1:])

    parts = mean(track.parts)
    parts[:, 0] /= number[:, None, None]
    return Track(mean(track.t), mean(track.pose), parts, track.stretch[first])
