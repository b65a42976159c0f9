"""Readings that are no free measurements: clipped at a limit, or commands in place of measurements."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skidsteer.doctor.evidence import SPEED, TURN, Evidence, Pair
from skidsteer.doctor.findings import Finding, Interval
from skidsteer.doctor.sampling import hold_length, runs_of_equal
from skidsteer.doctor.signals import BREAK, BoolArray, Total, typical
from skidsteer.drive import Drive, Series
from skidsteer.se2 import FloatArray

FLAT = 4  # equal samples in a row, and three times as many as the sensor holds, are flat
FLAT_TIME = 1.0  # [s]
FLAT_SHARE = 0.02  # of the motion
FLAT_ELSEWHERE = 0.2  # of the flat time: more says that the sensor is flat without a limit, too
CLEAR_EXCESS = 0.1  # share of the limit by which the robot is faster than clipped wheels say
EXCESS = 0.03  # the same where the readings are flat at the limit only
FEWEST_RUNS = 15  # of equal readings off the limit, or there is nothing to compare with
FEW = 20  # samples of a grid
FAR = 5.0  # times the median error
EXACT = 1e-3  # of the typical speed: nearer to the command than any measurement


def limit_findings(evidence: Evidence) -> list[Finding]:
    """Findings about clipped readings and commanded wheels."""
    drive = evidence.drive
    if is_commanded(drive):
        return [_commanded(), *_clipped_gyro(drive)]
    return [*_clipped_wheels(evidence), *_clipped_gyro(drive)]


def is_commanded(drive: Drive) -> bool:
    """Whether the wheel speeds are an exact linear function of the recorded commands."""
    given = drive.wheel_command if drive.wheel_command is not None else drive.command
    if given is None or len(drive.wheels) < FEW:
        return False
    x, y = given.hold(drive.wheels.t), drive.wheels.values
    if np.linalg.matrix_rank(x) < x.shape[1] or typical(y) == 0.0:
        return False
    factors = np.linalg.lstsq(x, y, rcond=None)[0]
    return bool(np.quantile(np.abs(y - x @ factors), 0.95) < EXACT * typical(y))


def _commanded() -> Finding:
    return Finding(
        "commanded_wheels",
        "The wheel speeds are an exact function of the recorded commands: nothing of them is measured.",
        (),
        0.95,
        "warning",
        "The model takes in how the motors follow and the time offset their delay; it is good for commands only.",
        "Record joint states or wheel encoders; or use this calibration for prediction from commands only.",
        False,
    )


def _clipped_gyro(drive: Drive) -> list[Finding]:
    if drive.gyro is None:
        return []
    where, limit = clipped(drive.gyro.t, drive.gyro.values[:, 0])
    return [_finding("gyro", where, limit, "rad/s")] if where else []


def _clipped_wheels(evidence: Evidence) -> list[Finding]:
    wheels = evidence.drive.wheels
    limits = np.abs(wheels.values).max(axis=0)
    excess = _excess(evidence, limits)
    if excess > CLEAR_EXCESS:
        return [_finding("wheels", _flat_times(wheels, limits), float(limits.max()), "m/s")]
    # Flat may be because the speed is steady; a gyro alone cannot tell, unless one side turns on.
    if excess < EXCESS or (np.isnan(excess) and evidence.by_reference is None):
        return []
    sides = [clipped(wheels.t, column) for column in wheels.values.T]
    where = sorted({interval for side in sides for interval in side[0]})
    return [_finding("wheels", where, max(side[1] for side in sides), "m/s")] if where else []


def _finding(part: str, where: list[Interval], limit: float, unit: str) -> Finding:
    seconds = sum(end - start for start, end in where)
    return Finding(
        "saturated",
        f"The {part} is clipped at {limit:.3g} {unit}, for {seconds:.1f} s in all."
        if part == "gyro"
        else f"The wheel speeds are clipped at {limit:.3g} {unit}, for {seconds:.1f} s in all.",
        tuple(where),
        0.9,
        "warning",
        "There the robot is faster than the log says: scale factors come out too large, mostly at speed.",
        "Raise the range of the sensor or the limit of the driver; leave these times out of the calibration.",
        False,
        part,
        limit,
    )


def clipped(t: FloatArray, values: FloatArray) -> tuple[list[Interval], float]:
    """Times at which readings (n,) stay exactly at their highest or lowest value, and that value.

    Only where they are never as flat at other values: a measurement has noise, unless it is clipped.
    """
    dt = np.append(np.diff(t), 0.0)
    dt[dt > BREAK] = 0.0
    first, length = runs_of_equal(values[:, None])
    level, seconds = values[first], np.add.reduceat(dt, first)
    flat = length >= max(FLAT, 3 * hold_length(t, values[:, None]))
    moving = np.abs(level) > 0.1 * typical(values)
    where, limit = [], 0.0
    elsewhere = flat & moving & (level < values.max()) & (level > values.min())
    for extreme in (values.max(), values.min()):
        top = flat & moving & (level == extreme)
        spent = float(seconds[top].sum())
        enough = max(FLAT_TIME, FLAT_SHARE * float(seconds[moving].sum()))
        free = level[moving & (level != extreme)]
        # Coarse steps come back to the same few levels, and are flat at any speed that is steady.
        noisy = len(free) >= FEWEST_RUNS and len(np.unique(free)) > 0.5 * len(free)
        if noisy and spent >= enough and seconds[elsewhere].sum() < FLAT_ELSEWHERE * spent:
            where += _intervals(t, first[top], length[top])
            limit = max(limit, abs(float(extreme)))
    return sorted(where), limit


def _intervals(t: FloatArray, first: NDArray[np.int64], length: NDArray[np.int64]) -> list[Interval]:
    return [(float(t[i]), float(t[i + n - 1])) for i, n in zip(first, length, strict=True)]


def _excess(evidence: Evidence, limits: FloatArray) -> float:
    """By which share of its limit (2,) a side at it is faster than it reads, against when it is not; NaN: unknown."""
    for pair, sides in ((evidence.by_reference, _sides_by_reference), (evidence.by_gyro, _sides_by_gyro)):
        if pair is None or not pair.known or pair.best.hypothesis.name or not limits.all():
            continue
        at_limit = _at_limit(evidence, pair, limits)
        seen, read = sides(pair, at_limit)
        excess = (seen - read) * np.sign(read) / limits
        known = np.isfinite(excess) & (np.abs(read) > 0.5 * limits)
        struck, free = known & at_limit, known & ~at_limit
        if struck.sum() >= FEW and free.sum() >= FEW:
            return float(np.median(excess[struck]) - np.median(excess[free]))
    return np.nan


def _at_limit(evidence: Evidence, pair: Pair, limits: FloatArray) -> BoolArray:
    """Whether each side (n, 2) is at its limit all through the width of the samples of a pair's first signal."""
    wheels = evidence.drive.wheels
    at = (np.abs(wheels.values) >= limits * (1.0 - 1e-9)).astype(float)
    steps = at[:-1] * np.diff(wheels.t)[:, None]
    total = Total(wheels.t, np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), evidence.wheel_total.piece)
    t = pair.a.t - pair.best.lag(pair.a.t)
    return np.asarray(np.nan_to_num(total.rates(t, 0.5)) > 0.95)


def _sides_by_reference(pair: Pair, at_limit: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Speeds of both sides (n, 2) as the reference sees them, and as the wheels tell them."""
    read = pair.b.at(pair.a.t - pair.best.lag(pair.a.t))
    free = np.asarray(~at_limit.any(axis=1))
    speed = _of_the_middle(pair.a.values, read[:, SPEED], free)
    seen = [_scaled(rate, read[:, c], free) for rate, c in ((speed, SPEED), (pair.a.values[:, TURN], TURN))]
    return _sides(*seen), _sides(read[:, SPEED], read[:, TURN])


def _of_the_middle(seen: FloatArray, read: FloatArray, free: BoolArray) -> FloatArray:
    """The speed (n,) that a reference sees, less what goes with its yaw rate: a sensor at y on the robot sees -y omega.

    So does one that is turned a little and sits ahead. Least squares over what the free wheels read, (n,), twice: the
    second time without the samples that the first leaves far off, where the robot is stuck or the reference lost.
    """
    good = free & np.isfinite(seen).all(axis=1) & np.isfinite(read)
    regressors = np.stack([read, seen[:, TURN]], axis=-1)
    lever = 0.0
    for _ in range(2):
        if good.sum() < FEW:
            break
        factors = np.linalg.lstsq(regressors[good], seen[good, SPEED], rcond=1e-6)[0]
        lever, left = factors[1], np.abs(seen[:, SPEED] - regressors @ factors)
        good &= left <= max(FAR * float(np.median(left[good])), EXACT * typical(read))
    return np.asarray(seen[:, SPEED] - lever * seen[:, TURN])


def _sides_by_gyro(pair: Pair, at_limit: BoolArray) -> tuple[FloatArray, FloatArray]:
    """The same from the gyro: each side as the other one and the gyro tell it, if the other is not at its limit."""
    read = pair.b.at(pair.a.t - pair.best.lag(pair.a.t))
    turn = _scaled(pair.a.values[:, 0], read[:, TURN], np.asarray(~at_limit.any(axis=1)))
    sides = _sides(read[:, SPEED], read[:, TURN])
    seen = np.stack([sides[:, 1] - turn, sides[:, 0] + turn], axis=-1)
    return np.where(at_limit[:, ::-1], np.nan, seen), sides


def _sides(speed: FloatArray, turn: FloatArray) -> FloatArray:
    return np.stack([speed - 0.5 * turn, speed + 0.5 * turn], axis=-1)


def _scaled(seen: FloatArray, read: FloatArray, free: BoolArray) -> FloatArray:
    """What a sensor saw (n,), divided by its median ratio to what the wheels read, where these are free."""
    good = free & np.isfinite(seen) & np.isfinite(read)
    large = good & (np.abs(read) > 0.3 * typical(read[good]))
    ratio = float(np.median(seen[large] / read[large])) if large.sum() >= FEW else 0.0
    return seen / ratio if ratio > 0.0 else np.full_like(seen, np.nan)


def _flat_times(wheels: Series, limits: FloatArray) -> list[Interval]:
    where = []
    for column, limit in zip(wheels.values.T, limits, strict=True):
        struck = np.abs(column) >= limit * (1.0 - 1e-9)
        first, length = runs_of_equal(struck[:, None])
        flat = (length >= FLAT) & struck[first]
        where += _intervals(wheels.t, first[flat], length[flat])
    return sorted(set(where))
