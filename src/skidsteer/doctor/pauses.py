"""Breaks: samples that are missing, a clock of the whole log that was set forward meanwhile, a reference that leaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.doctor.evidence import SPEED, Evidence
from skidsteer.doctor.findings import Finding, Interval
from skidsteer.doctor.signals import BREAK, BoolArray, sampling_period, typical
from skidsteer.drive import Drive, Series
from skidsteer.se2 import FloatArray, wrap
from skidsteer.windows import leaps

REFERENCE_GAPS = (1.2, 1.5)  # [s] longer than for the wheels; the last where many increments are long
USUAL, UNUSUAL = 0.98, 2.0  # share of its increments that is usual, and how much longer than those a pause is
MOVED = (0.1, np.radians(10.0))  # [m, rad] less than this is rest
STOOD = 0.3  # share of the way that the speed before and after a pause promises; less says that no time went by
SAME_HEADING = np.radians(45.0)
AROUND = 1.0  # [s] before and after a pause over which its speed is taken


@dataclass(frozen=True, slots=True, eq=False)
class Rolled:
    """How far the wheels rolled and turned, unsigned, by the clock of the reference."""

    t: FloatArray  # (n,) [s]
    way: FloatArray  # (n, 2) [m], and [rad] as of a track twice as wide as nominal

    @classmethod
    def of(cls, evidence: Evidence) -> Rolled:
        """From the wheels and their time offset against the reference."""
        total, pair = evidence.wheel_total, evidence.by_reference
        steps = np.abs(np.diff(total.total, axis=0)) / [1.0, 2.0 * evidence.drive.vehicle.track_width]
        late = pair.best.lag(total.t) if pair is not None and pair.known else 0.0
        way = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        return cls(np.maximum.accumulate(total.t + late), way)

    def moved(self, start: FloatArray, end: FloatArray) -> BoolArray:
        """Whether the robot moved between times (m,), allowing for 0.3 s of further delay."""
        ways = [self._at(end + shift) - self._at(start + shift) for shift in (-0.3, 0.0, 0.3)]
        return np.asarray((np.min(ways, axis=0) > MOVED).any(axis=1))

    def _at(self, t: FloatArray) -> FloatArray:
        return np.stack([np.interp(t, self.t, column) for column in self.way.T], axis=-1)


def parts_of(drive: Drive) -> dict[str, Series]:
    """The recorded sensors by the names of their parts."""
    parts = {"wheels": drive.wheels, "pose": drive.pose, "position": drive.position, "gyro": drive.gyro}
    return {name: series for name, series in parts.items() if series is not None}


def pause_findings(evidence: Evidence) -> list[Finding]:
    """Findings about samples missing while the robot moved, the clock of the whole log, and leaps of the reference."""
    drive, rolled = evidence.drive, Rolled.of(evidence)
    gaps = {part: _pauses(series, drive, part) for part, series in parts_of(drive).items()}
    jumps = [(start, end) for start, end in gaps["wheels"] if _no_time_went_by(evidence, start, end)]
    found = [_jump_finding(evidence, start, end) for start, end in jumps]
    for part, pauses in gaps.items():
        missing = [pause for pause in pauses if not any(_overlap(pause, jump) for jump in jumps)]
        start, end = np.array(missing).reshape(-1, 2).T
        moving = _moving_at(drive.wheels, start, end) if part == "wheels" else rolled.moved(start, end)
        where = [pause for pause, moves in zip(missing, moving, strict=True) if moves]
        found += [_gap_finding(evidence, part, where)] if where else []
    return [*found, *_leap_findings(evidence)]


def _leap_findings(evidence: Evidence) -> list[Finding]:
    """Leaps of the reference, but those from one segment to the next, and those that a yaw in degrees only seems."""
    drive = evidence.drive
    where = leaps(drive)
    if drive.segments is not None:
        where = where[
            np.searchsorted(drive.segments[:, 0], where[:, 0], side="right")
            == np.searchsorted(drive.segments[:, 0], where[:, 1], side="right")
        ]
    if not len(where) or evidence.yaw_fault:
        return []
    part, first = "pose" if drive.pose is not None else "position", evidence.folding.unfold(where[0, 0])
    often = f"once, at {first:.1f} s" if len(where) == 1 else f"{len(where)} times, first at {first:.1f} s"
    return [
        Finding(
            "leap",
            f"The {part} leaps {often}: farther from sample to sample than the robot moves.",
            tuple(map(tuple, where.tolist())),
            0.95,
            "warning",
            "The drive is cut there, and goes on from the new place.",
            "Look for a localization that started anew, a lost fix, or a change of frames.",
            False,
            part,
        )
    ]


def _pauses(series: Series, drive: Drive, part: str) -> list[Interval]:
    t = series.t
    least = _least_of_reference(t) if part in ("pose", "position") else BREAK
    index = np.flatnonzero(np.diff(t) > max(least, 5.0 * sampling_period(t)))
    pauses = [(float(t[i]), float(t[i + 1])) for i in index]
    if drive.segments is None:
        return pauses
    # Between the segments nothing needs to be recorded.
    return [(a, b) for a, b in pauses if ((drive.segments[:, 0] <= a) & (drive.segments[:, 1] >= b)).any()]


def _least_of_reference(t: FloatArray) -> float:
    """How long [s] a pause of a reference is at least; where it always comes unevenly, longer."""
    usual = float(np.quantile(np.diff(t), USUAL)) if len(t) > 1 else 0.0
    return min(max(UNUSUAL * usual, REFERENCE_GAPS[0]), REFERENCE_GAPS[1])


def _overlap(a: Interval, b: Interval) -> bool:
    return min(a[1], b[1]) - max(a[0], b[0]) > 0.5 * (a[1] - a[0])


def _moving_at(wheels: Series, start: FloatArray, end: FloatArray) -> BoolArray:
    """Whether the wheels turned just before or just after."""
    speed = np.abs(wheels.values).max(axis=1)
    edges = [speed[np.searchsorted(wheels.t, t)] for t in (start, end)]
    return np.asarray(np.maximum(*edges) > 0.05 * typical(wheels.values))


def _no_time_went_by(evidence: Evidence, start: float, end: float) -> bool:
    """Whether all sensors pause, at speed, and the reference finds the robot where it was."""
    drive, reference = evidence.drive, evidence.drive.reference
    if reference is None or drive.segments is not None:
        return False
    pauses = {part: _pause_near(series, start, end) for part, series in parts_of(drive).items()}
    pause = pauses["pose" if drive.pose is not None else "position"]
    if pause is None or None in pauses.values():
        return False
    rates = evidence.wheels.at(np.array([start - AROUND, end + AROUND]))[:, SPEED]
    before, after = reference.values[np.searchsorted(reference.t, pause)]
    way, speed = float(np.hypot(*(after - before)[:2])), float(np.abs(rates).min())
    promised = speed * (pause[1] - pause[0])
    if not promised > MOVED[SPEED]:  # NaN where it did not drive on for long enough
        return False
    turned = abs(float(wrap(after - before)[2])) if drive.pose is not None else 0.0
    return way < min(STOOD * promised, 2.0 * speed * AROUND + MOVED[SPEED]) and turned < SAME_HEADING


def _pause_near(series: Series, start: float, end: float) -> Interval | None:
    """The pause of a series that covers most of a time."""
    middle = 0.5 * (start + end)
    i = int(np.searchsorted(series.t, middle))
    if i == 0 or i == len(series.t):
        return None
    first, last = float(series.t[i - 1]), float(series.t[i])
    return (first, last) if min(last, end) - max(first, start) > 0.5 * (end - start) else None


def _jump_finding(evidence: Evidence, start: float, end: float) -> Finding:
    size = evidence.folding.unfold(end) - evidence.folding.unfold(start) - sampling_period(evidence.drive.wheels.t)
    return Finding(
        "clock_jump",
        f"The clock of the whole log jumps ahead by {size:.4g} s at {evidence.folding.unfold(start):.1f} s: all sensors"
        " pause, and afterwards the robot is where it was, at speed.",
        ((start, end),),
        0.95,
        "error",
        "The drive is cut there; whatever integrates over the jump takes the robot to have driven on.",
        f"Take {size:.4g} s off all stamps after the jump; set the clock before recording.",
        True,
        "all",
        size,
    )


def _gap_finding(evidence: Evidence, part: str, where: list[Interval]) -> Finding:
    longest = max(evidence.folding.unfold(end) - evidence.folding.unfold(start) for start, end in where)
    effect = {
        "wheels": "What the wheels did there is unknown; the drive is cut at each gap.",
        "gyro": "The yaw there is unknown to whatever integrates the gyro.",
    }.get(part, "Windows that long tell little of how the robot moved, and a turn of more than 180 degrees is lost.")
    return Finding(
        "gap",
        f"{len(where)} {'gap' if len(where) == 1 else 'gaps'} in the {part} while the robot moved,"
        f" up to {longest:.4g} s.",
        tuple(where),
        0.95,
        "warning",
        effect,
        "Look for dropped messages, a full disk or a lost tracker; the rest of the drive is good.",
        False,
        part,
    )
