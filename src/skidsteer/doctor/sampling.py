"""How the sensors were sampled: held values, coarse steps, a reference or a side of the wheels that freezes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skidsteer.doctor.evidence import Evidence
from skidsteer.doctor.findings import Finding, Interval
from skidsteer.doctor.pauses import Rolled, parts_of
from skidsteer.doctor.signals import BREAK, BoolArray, sampling_period, starts_anew, typical
from skidsteer.se2 import FloatArray

FREEZE = 0.5  # [s] shorter repetitions are held samples
LONGEST_HOLD = 2.0  # [s] longer ones are a steady drive
MOST_HOLD = 40  # samples
FEWEST_RUNS = 15
COARSE = 0.02  # of the typical speed: steps finer than that do no harm
DEAD, DEAD_AT_REST = 10.0, 0.5  # [s] that one side stays at a speed, and share of the drive that it stays at zero
LIVE = 20  # values that the other one has meanwhile
LEVELS = 5  # fewer cannot be told from commands


def sampling_findings(evidence: Evidence) -> list[Finding]:
    """Findings about frozen references and wheels, held samples and coarse steps."""
    return [*_frozen(evidence), *_frozen_wheels(evidence), *_held(evidence), *_quantised(evidence)]


def runs_of_equal(values: FloatArray, cut: BoolArray | None = None) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First index and length (m,) of each run of equal rows of values (n, k), ended where ``cut`` (n - 1,) is set."""
    changed = (np.diff(values, axis=0) != 0.0).any(axis=1)
    first = np.r_[0, np.flatnonzero(changed if cut is None else changed | cut) + 1]
    return first, np.diff(np.r_[first, len(values)])


def _frozen(evidence: Evidence) -> list[Finding]:
    drive = evidence.drive
    if drive.reference is None:
        return []
    t = drive.reference.t
    first, length = runs_of_equal(drive.reference.values, starts_anew(t, drive))
    last = first + length - 1
    some = (length > 1) & (t[last] - t[first] > max(FREEZE, 2.0 * sampling_period(t)))
    first, last = first[some], last[some]
    frozen = Rolled.of(evidence).moved(t[first], t[last])
    where = tuple((float(t[i]), float(t[j])) for i, j in zip(first[frozen], last[frozen], strict=True))
    if not where:
        return []
    part = "pose" if drive.pose is not None else "position"
    return [
        Finding(
            "frozen_reference",
            f"The {part} repeats itself {len(where)} times while the wheels turn, up to"
            f" {max(end - start for start, end in where):.1f} s.",
            where,
            0.95,
            "error" if sum(end - start for start, end in where) > 0.1 * (t[-1] - t[0]) else "warning",
            "The robot seems to slip on the spot and then to leap: scale factors come out too small.",
            "Drop the repeated samples; look at why the reference lost track.",
            True,
            part,
        )
    ]


def _frozen_wheels(evidence: Evidence) -> list[Finding]:
    wheels, found = evidence.drive.wheels, []
    for side, (name, other) in enumerate((("left", "right"), ("right", "left"))):
        t, values, changing = wheels.t, wheels.values[:, side], wheels.values[:, 1 - side]
        first, length = runs_of_equal(values[:, None], np.diff(t) > BREAK)
        lasted = t[first + length - 1] - t[first]
        least = np.where(values[first] != 0.0, DEAD, max(DEAD, DEAD_AT_REST * (t[-1] - t[0])))
        some = [(i, n) for i, n in zip(first[lasted > least], length[lasted > least], strict=True)]
        where = tuple((float(t[i]), float(t[i + n - 1])) for i, n in some if len(set(changing[i : i + n])) > LIVE)
        if where:
            found.append(_frozen_side(name, other, where, float(values[np.searchsorted(t, where[0][0])])))
    return found


def _frozen_side(side: str, other: str, where: tuple[Interval, ...], speed: float) -> Finding:
    return Finding(
        "frozen_wheels",
        f"The speed of the {side} side stays at {speed:.3g} m/s for {sum(b - a for a, b in where):.0f} s while that of"
        f" the {other} side changes.",
        where,
        0.95,
        "error",
        "It is no measurement there: the model of that side comes out wrong, and clocks cannot be compared.",
        f"Look for a dead encoder or motor driver on the {side}; leave these times out.",
        False,
    )


def _held(evidence: Evidence) -> list[Finding]:
    found = []
    for part, series in parts_of(evidence.drive).items():
        columns = series.values.T[:, :, None] if part == "wheels" else series.values[None]
        holds = [hold_length(series.t, column) for column in columns]
        if max(holds) > 1:
            found.append(_held_finding(part, series.t, max(holds)))
    return found


def hold_length(t: FloatArray, values: FloatArray) -> int:
    """How many samples each value of values (n, k) is held for; 1 where it is not held.

    Held values change every so many samples, give or take one, or always at the same phase of a fixed count. Readings
    that happen to stay equal (coarse steps, steady drive) change at any sample.
    """
    first, _ = runs_of_equal(values)
    gaps = np.diff(first)
    if len(gaps) < FEWEST_RUNS:
        return 1
    period = sampling_period(t)
    gaps = gaps[gaps * period < LONGEST_HOLD]
    if len(gaps) < FEWEST_RUNS:
        return 1
    middle = round(float(np.median(gaps)))
    spread = max(1, round(0.25 * middle))
    near = np.abs(gaps - middle) <= spread
    early = gaps < middle - spread if middle > 2 else gaps < 2
    if middle >= 2 and near.mean() > 0.6 and early.mean() < 0.2:
        return middle
    if (gaps == 1).mean() > 0.05:
        return 1
    for count in range(min(MOST_HOLD, int(LONGEST_HOLD / period)), 1, -1):
        if (gaps % count == 0).mean() > 0.95 and (gaps == count).mean() > 0.1:
            return count
    return 1


def _held_finding(part: str, t: FloatArray, hold: int) -> Finding:
    rate = 1.0 / sampling_period(t)
    return Finding(
        "held_samples",
        f"Samples of the {part} come at {rate:.3g} Hz but change only every {hold}, at {rate / hold:.2g} Hz.",
        (),
        0.95,
        "info" if part == "wheels" else "warning",
        f"The readings are {0.5e3 * hold / rate:.0f} ms old on average; the fit sees that as a delay."
        if part in ("wheels", "gyro")
        else "Repeated poses say that the robot stood still, and then that it leapt.",
        "Record at the rate of the sensor or raise that rate."
        if part in ("wheels", "gyro")
        else "Drop the repeated samples.",
        part in ("pose", "position"),
        part,
        float(hold),
    )


def _quantised(evidence: Evidence) -> list[Finding]:
    wheels = evidence.drive.wheels
    speed = typical(wheels.values)
    step = max(coarse_step(wheels.t, column) for column in wheels.values.T)
    if speed == 0.0 or step < COARSE * speed:
        return []
    period = sampling_period(wheels.t)
    return [
        Finding(
            "quantised_wheels",
            f"The wheel speeds come in steps of {step:.3g} m/s, {100.0 * step / speed:.0f} % of the typical speed.",
            (),
            0.9,
            "info" if step < 0.1 * speed else "warning",
            f"Each sample is uncertain by {step / np.sqrt(12.0):.2g} m/s; over a window the steps average out where the"
            " speed is counted from whole ticks.",
            f"Count ticks over longer than {1e3 * period:.0f} ms, use wheel positions in place of speeds, or an encoder"
            " with more ticks a turn.",
            False,
            "wheels",
            step,
        )
    ]


def coarse_step(t: FloatArray, speeds: FloatArray) -> float:
    """The step [m/s] of which all speeds (n,), or all distances between samples, are multiples; 0 where none is."""
    if len(speeds) < 2:
        return 0.0
    dt = np.diff(t)
    near, period = dt < BREAK, float(np.median(dt))
    # Ticks are counted since the last sample, or, where speeds were logged ahead, until the next.
    by_distance = [lattice((v * dt)[near]) / period for v in (speeds[1:], speeds[:-1])]
    return max(lattice(speeds), *by_distance)


def lattice(values: FloatArray) -> float:
    """The step of which nearly all values (n,) are multiples; 0 where there is none, or it is too fine to matter."""
    size = np.abs(values)
    most = typical(size)
    if most == 0.0:
        return 0.0
    levels = np.unique(np.round(size / most, 7))
    steps = np.diff(levels)
    if len(steps) < LEVELS:
        return 0.0
    # Rounding of the file splits a level into neighbours; the true steps are the ones that are not tiny.
    large = steps[steps > 0.1 * COARSE]
    if len(large) < LEVELS:
        return 0.0
    step = float(np.quantile(large, 0.1))
    for _ in range(3):  # the multiples far out pin the step down
        count = np.round(size / most / step)
        step = float((count * size / most).sum() / max((count**2).sum(), 1.0))
    off = np.abs(size / most / step - np.round(size / most / step))
    return step * most if (off < 0.05).mean() > 0.98 and step < 1.0 else 0.0
