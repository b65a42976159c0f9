"""All that the tests of the doctor share: the signals of a drive and how they belong together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.doctor.alignment import REACH, Alignment, Hypothesis, Link, align
from skidsteer.doctor.drift import NO_DRIFT, Drift, drift_against
from skidsteer.doctor.folding import Folding, fold
from skidsteer.doctor.heading import travel_angle
from skidsteer.doctor.signals import (
    OUTLIER,
    Signal,
    Total,
    grid_step,
    sampled,
    signal_of_positions,
    total_of_gyro,
    total_of_poses,
    total_of_wheels,
    turned_by,
    typical,
)
from skidsteer.drive import Drive, Series
from skidsteer.se2 import FloatArray, wrap

ENOUGH = 12.0  # [nat] an alignment below this says nothing
CLEAR = 8.0  # [nat] a hypothesis must be ahead of the usual one by this
STRAIGHT = np.radians(45.0)  # a drive that turns by less in all
SPEED, TURN = 0, 1  # channels of the reference; and of the wheels: mean of both sides, right minus left
UNSIGNED = 2  # further channels of the wheels for a reference without heading: their absolute values


def _hypothesis(name: str, speed: tuple[int, int], turn: tuple[int, int]) -> Hypothesis:
    return Hypothesis(name, (Link(SPEED, *speed), Link(TURN, *turn)))


# With one side negated, the mean of the recorded speeds is the turn and their difference the speed.
BY_POSE = (
    _hypothesis("", (SPEED, 1), (TURN, 1)),
    _hypothesis("swapped_sides", (SPEED, 1), (TURN, -1)),
    _hypothesis("both_negated", (SPEED, -1), (TURN, -1)),
    _hypothesis("backwards", (SPEED, -1), (TURN, 1)),
    _hypothesis("left_negated", (TURN, 1), (SPEED, 1)),
    _hypothesis("right_negated", (TURN, -1), (SPEED, -1)),
    _hypothesis("swapped_sides left_negated", (TURN, 1), (SPEED, -1)),
    _hypothesis("swapped_sides right_negated", (TURN, -1), (SPEED, 1)),
)
BY_POSITION = (
    _hypothesis("", (SPEED + UNSIGNED, 1), (TURN, 1)),
    _hypothesis("turn_sign", (SPEED + UNSIGNED, 1), (TURN, -1)),
    _hypothesis("left_negated", (TURN + UNSIGNED, 1), (SPEED, 1)),
    _hypothesis("right_negated", (TURN + UNSIGNED, 1), (SPEED, -1)),
)
BY_GYRO = (
    Hypothesis("", (Link(0, TURN, 1),)),
    Hypothesis("turn_sign", (Link(0, TURN, -1),)),
    Hypothesis("left_negated", (Link(0, SPEED, 1),)),
    Hypothesis("right_negated", (Link(0, SPEED, -1),)),
)
GYRO_BY_REFERENCE = (Hypothesis("", (Link(TURN, 0, 1),)), Hypothesis("gyro_sign", (Link(TURN, 0, -1),)))
HEADING_STEP = 0.5  # [s]
MORE_ALONG = 0.05
FULL_TURNS = {
    "": 2.0 * np.pi,
    "reference_yaw_degrees": 360.0,
    "reference_yaw_sign": -2.0 * np.pi,
    "reference_yaw_degrees reference_yaw_sign": -360.0,  # of a compass
}


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two sensors and their alignments, the best hypothesis first; ``margin`` [nat] is its lead over the usual one."""

    a: Signal
    b: Signal
    best: Alignment
    margin: float

    @property
    def known(self) -> bool:
        """Whether the two agree enough to say anything."""
        return self.best.score >= ENOUGH

    @property
    def turns(self) -> bool:
        """Whether the first of the two, a gyro, turns: on a straight its bias alone goes with the speed."""
        return self.known and turned_by(self.a.values[:, -1], self.a.step) > STRAIGHT

    def samples(self, link: int) -> tuple[FloatArray, FloatArray]:
        """Both channels of a link of the best hypothesis at the same moments, (n,) each, where both are known."""
        chosen = self.best.hypothesis.links[link]
        t = self.a.t
        x, y = self.a.values[:, chosen.a], chosen.sign * self.b.at(t - self.best.lag(t))[:, chosen.b]
        known = np.isfinite(x) & np.isfinite(y)
        return x[known], y[known]


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """A drive, its signals, and every two of them aligned; None where a sensor is missing or shares no time."""

    drive: Drive  # with long pauses folded
    folding: Folding
    wheel_total: Total
    wheels: Signal
    reference: Signal | None
    gyro: Signal | None
    yaw_fault: str  # kinds of the findings about the reference yaw, or ""
    turned: float  # [rad] yaw of the sensor of the reference on the robot; 0: as it should be
    drift: Drift  # that was taken off the gyro
    by_reference: Pair | None  # reference against wheels
    by_gyro: Pair | None  # gyro against wheels
    reference_by_gyro: Pair | None  # reference against gyro


def gather(drive: Drive) -> Evidence:
    """Signals of a drive and how they belong together; all times are those of the folded drive."""
    drive, folding = fold(drive)
    step, reach = grid_step(drive), _reach(drive)
    total = total_of_wheels(drive)
    wheels = sampled(total, step)
    seen = _reference(drive, wheels, step, reach)
    turns = _gyro(drive, wheels, seen.signal, step, reach)
    return Evidence(
        drive,
        folding,
        total,
        wheels,
        seen.signal,
        turns.signal,
        seen.fault,
        seen.turned,
        turns.drift,
        seen.by_wheels,
        turns.by_wheels,
        turns.reference_by_it,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    """The reference read in one way: faults of its yaw, yaw of its sensor on the robot [rad], signal, beside wheels."""

    fault: str = ""
    turned: float = 0.0
    signal: Signal | None = None
    by_wheels: Pair | None = None

    @property
    def score(self) -> float:
        """[nat] of how well it goes with the wheels, less what a fault must be ahead by."""
        if self.by_wheels is None or (self.fault and not self.by_wheels.known):
            return -np.inf
        return self.by_wheels.best.score - (CLEAR if self.fault else 0.0)

    @property
    def wrong(self) -> tuple[float, float]:
        """How many faults of the wheels it takes, and [nat] how far these are ahead of none."""
        if self.by_wheels is None:
            return np.inf, np.inf
        return len(self.by_wheels.best.hypothesis.name.split()), self.by_wheels.margin


def _reference(drive: Drive, wheels: Signal, step: float, reach: float) -> _Reading:
    """The reference with its yaw read in the way that fits the wheels best."""
    if drive.position is not None and drive.pose is None:
        signal = signal_of_positions(drive.position, drive, step)
        both = Signal(wheels.start, wheels.step, np.concatenate([wheels.values, np.abs(wheels.values)], axis=1))
        return _Reading("", 0.0, signal, _pair(signal, both, BY_POSITION, reach))
    if drive.pose is None:
        return _Reading()
    pose, readings = drive.pose, []
    for fault, full_turn in _credible_turns(pose).items():
        angle = travel_angle(pose, drive, full_turn, step)
        # Which end of the line of travel is ahead: the one with which less of the wheels is wrong.
        ends = []
        for turned in (angle, float(wrap(angle + np.pi))) if angle else (0.0,):
            signal = sampled(total_of_poses(pose, drive, full_turn, turned), step)
            ends.append(_Reading(fault, turned, signal, _pair(signal, wheels, BY_POSE, reach)))
        readings.append(min(ends, key=lambda end: end.wrong))
    return max(readings, key=lambda reading: reading.score)


@dataclass(frozen=True, slots=True, eq=False)
class _Turns:
    """The gyro, read in one way: drift taken off, signal, beside wheels, and beside the reference."""

    drift: Drift = NO_DRIFT
    signal: Signal | None = None
    by_wheels: Pair | None = None
    reference_by_it: Pair | None = None

    @property
    def score(self) -> float:
        """[nat] of how well it goes with wheels and reference."""
        return sum(pair.best.score for pair in (self.by_wheels, self.reference_by_it) if pair is not None)


def _gyro(drive: Drive, wheels: Signal, reference: Signal | None, step: float, reach: float) -> _Turns:
    """The gyro as it is, or less a drift where that goes clearly better with wheels and reference."""
    if drive.gyro is None:
        return _Turns()
    raw = sampled(total_of_gyro(drive.gyro, drive), step)

    def read(drift: Drift) -> _Turns:
        gyro = drift.taken_off(raw)
        beside = _pair(reference, gyro, GYRO_BY_REFERENCE, reach)
        return _Turns(drift, gyro, _pair(gyro, wheels, BY_GYRO, reach), beside)

    usual = read(NO_DRIFT)
    drift = drift_against(raw, wheels if drive.pose is None or reference is None else reference)
    steady = read(drift) if drift.matters else usual
    return steady if steady.score > usual.score + CLEAR else usual


def _credible_turns(pose: Series) -> dict[str, float]:
    """The usual reading of the yaw, and those by which the robot travels along its heading better."""
    t = pose.t[0] + HEADING_STEP * np.arange(int((pose.t[-1] - pose.t[0]) / HEADING_STEP) + 1)
    some = pose.values[np.unique(np.searchsorted(pose.t, t).clip(0, len(pose) - 1))]
    way = np.diff(some[:, :2], axis=0)
    length = np.hypot(*way.T)
    length[length > OUTLIER * typical(length)] = 0.0
    course = np.arctan2(way[:, 1], way[:, 0])

    def along(full_turn: float) -> float:
        yaw = some[:, 2] * (2.0 * np.pi / full_turn)
        heading = yaw[:-1] + 0.5 * wrap(np.diff(yaw))
        # Twice the angle: driving back is along the heading, too.
        return float(np.abs((length * np.exp(2j * (course - heading))).sum()) / max(length.sum(), 1e-9))

    usual = along(FULL_TURNS[""])
    return {name: turn for name, turn in FULL_TURNS.items() if name == "" or along(turn) > usual + MORE_ALONG}


def _pair(a: Signal | None, b: Signal | None, hypotheses: tuple[Hypothesis, ...], reach: float) -> Pair | None:
    """The best alignment; the usual hypothesis, the first, unless another one is clearly ahead."""
    found = align(a, b, hypotheses, reach) if a is not None and b is not None else []
    if a is None or b is None or not found:
        return None
    usual = next(alignment for alignment in found if alignment.hypothesis is hypotheses[0])
    margin = found[0].score - usual.score
    if margin >= CLEAR and found[0].score >= ENOUGH:
        return Pair(a, b, found[0], margin)
    return Pair(a, b, usual, 0.0)


def _reach(drive: Drive) -> float:
    """How far to look for time offsets [s]: in a drive of segments not as far as the next, else over every pause."""
    if drive.segments is not None and len(drive.segments) > 1:
        return min(REACH, 0.49 * float(np.median(np.diff(drive.segments[:, 0]))))
    parts = [s for s in (drive.wheels, drive.reference, drive.gyro) if s is not None]
    return max(REACH, 1.3 * max(float(np.diff(s.t).max(initial=0.0)) for s in parts))
