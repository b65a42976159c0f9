"""What each sensor says about speed and yaw rate, on even grids of its own clock, so that clocks can be compared.

Every sensor becomes a running total (distance rolled, angle turned) with breaks where nothing is known; rates are
differences of that total over a short width. So sampling, jitter and held samples drop out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skidsteer.drive import Drive, Series
from skidsteer.se2 import FloatArray, wrap

BoolArray = NDArray[np.bool_]

STEP = 0.1  # [s] of the grids
WIDTH = 0.5  # [s] over which rates are taken
BREAK = 1.0  # [s] without a sample: nothing is known of the motion between
LEAP, FASTEST = 0.5, 20.0  # [m], [m/s] no robot moves on like that
LEAST_TURN = np.radians(2.0)  # [rad/s] slower turns may be noise, bias, or a heading being kept
MOST = 200_000  # grid points: bounds time and memory for drives of many hours
OUTLIER = 4.0  # rates beyond this many times the typical one are cut: a jump of the reference is no motion


@dataclass(frozen=True, slots=True, eq=False)
class Total:
    """A running total: ``total`` (n, k) at times ``t`` (n,) [s]; ``piece`` (n,) numbers what hangs together."""

    t: FloatArray
    total: FloatArray
    piece: NDArray[np.int64]

    def at(self, t: FloatArray) -> FloatArray:
        """The total (m, k) at times (m,) [s]; beside the ends, that of the ends."""
        return np.asarray(np.stack([np.interp(t, self.t, column) for column in self.total.T], axis=-1))

    def rates(self, t: FloatArray, width: float) -> FloatArray:
        """Mean rates (m, k) over ``width`` [s] around times (m,); NaN where the piece does not reach that far."""
        low, high = t - 0.5 * width, t + 0.5 * width
        i = np.searchsorted(self.t, low, side="right") - 1
        j = np.searchsorted(self.t, high, side="left")
        inside = (i >= 0) & (j < len(self.t))
        i, j = np.maximum(i, 0), np.minimum(j, len(self.t) - 1)
        known = inside & (self.piece[i] == self.piece[j])
        return np.where(known[:, None], (self.at(high) - self.at(low)) / width, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """Rates of one sensor on an even grid: ``values`` (n, k) at ``start + step * arange(n)``, NaN where unknown."""

    start: float  # [s]
    step: float  # [s]
    values: FloatArray

    @property
    def t(self) -> FloatArray:
        """Times (n,) [s]."""
        return np.asarray(self.start + self.step * np.arange(len(self.values)))

    def at(self, t: FloatArray) -> FloatArray:
        """Values (m, k) at times (m,) by linear interpolation; NaN beside unknown ones and outside."""
        x = (t - self.start) / self.step
        i = np.clip(np.floor(x).astype(np.int64), 0, len(self.values) - 1)
        j = np.minimum(i + 1, len(self.values) - 1)
        f = (x - i)[:, None]
        inside = ((x >= 0) & (x <= len(self.values) - 1))[:, None]
        return np.where(inside, (1.0 - f) * self.values[i] + f * self.values[j], np.nan)


def sampling_period(t: FloatArray) -> float:
    """Median distance of samples [s]; 0 for a single one."""
    return float(np.median(np.diff(t))) if len(t) > 1 else 0.0


def starts_anew(t: FloatArray, drive: Drive) -> BoolArray:
    """Whether a segment of the drive begins between sample i and i + 1, (n - 1,)."""
    new = np.zeros(max(len(t) - 1, 0), dtype=bool)
    if drive.segments is not None:
        first = np.searchsorted(t, drive.segments[:, 0] - 1e-9)
        new[first[(first > 0) & (first < len(t))] - 1] = True
    return new


def breaks(t: FloatArray, drive: Drive) -> BoolArray:
    """Whether sample i + 1 does not continue sample i, (n - 1,): a pause of the sensor or a new segment."""
    return np.asarray((np.diff(t) > max(BREAK, 5.0 * sampling_period(t))) | starts_anew(t, drive))


def leaps(t: FloatArray, steps: FloatArray) -> BoolArray:
    """Whether steps (n - 1, 2) of a reference are no motion (n - 1,): farther and faster than a robot drives."""
    way = np.hypot(*steps.T)
    leap = (way > LEAP) & (way > FASTEST * np.diff(t))
    # Where most of them are, the unit is wrong rather than the reference.
    return np.asarray(leap if leap.sum() < 0.5 * (way > 1e-3).sum() else np.zeros(len(way), dtype=bool))


def total_of_wheels(drive: Drive) -> Total:
    """Running total of both sides' mean and of right minus left [m], each speed held to the next sample."""
    left, right = drive.wheels.values.T
    return _held(drive.wheels.t, np.stack([0.5 * (left + right), right - left], axis=-1), drive)


def total_of_gyro(gyro: Series, drive: Drive) -> Total:
    """Running total of the yaw rate of the gyro [rad]."""
    return _held(gyro.t, gyro.values, drive)


def total_of_poses(pose: Series, drive: Drive, full_turn: float = 2.0 * np.pi, turned: float = 0.0) -> Total:
    """Running total of the way forward [m] and of the yaw [rad] of reference poses recorded with that full turn.

    ``turned`` [rad] is the yaw of their sensor on the robot.
    """
    yaw = pose.values[:, 2] * (2.0 * np.pi / full_turn) - turned
    turn = wrap(np.diff(yaw))
    heading = yaw[:-1] + 0.5 * turn
    step = np.diff(pose.values[:, :2], axis=0)
    forward = step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading)
    return _total(pose.t, np.stack([forward, turn], axis=-1), breaks(pose.t, drive) | leaps(pose.t, step))


def _held(t: FloatArray, rates: FloatArray, drive: Drive) -> Total:
    return _total(t, rates[:-1] * np.diff(t)[:, None], breaks(t, drive))


def _total(t: FloatArray, steps: FloatArray, cut: BoolArray) -> Total:
    steps = np.where(cut[:, None], 0.0, steps)
    total = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
    return Total(t, total, np.concatenate([[0], np.cumsum(cut)]))


def grid_step(drive: Drive) -> float:
    """Step [s] of the grids of a drive: ``STEP``, more where it would take too many points or samples are sparse.

    In a drive of segments no more than leaves room for several rates in each.
    """
    parts = [s for s in (drive.wheels, drive.reference, drive.gyro) if s is not None]
    longest = max(s.t[-1] - s.t[0] for s in parts)
    sparse = 0.4 * max(sampling_period(s.t) for s in parts)
    if drive.segments is not None:
        sparse = min(sparse, STEP / WIDTH * 0.4 * float(np.median(np.diff(drive.segments, axis=1))))
    return max(STEP, float(longest) / MOST, sparse)


def sampled(total: Total, step: float) -> Signal:
    """Rates of a running total on an even grid over its whole time, over a width that spans two samples or more."""
    grid = _grid(total.t, step)
    return Signal(float(grid[0]), step, _cut_outliers(total.rates(grid, _width(step))))


def signal_of_positions(position: Series, drive: Drive, step: float) -> Signal:
    """Unsigned speed [m/s] and rate of the course [rad/s], the latter only where it moves, of reference positions."""
    steps = np.diff(position.values, axis=0)
    total = _total(position.t, steps, breaks(position.t, drive) | leaps(position.t, steps))
    grid, width = _grid(position.t, step), _width(step)
    velocity = total.rates(grid, width)
    before, after = total.rates(grid - 0.5 * width, width), total.rates(grid + 0.5 * width, width)
    speed = np.hypot(*velocity.T)
    least = 0.2 * np.nanquantile(speed, 0.95) if np.isfinite(speed).any() else 0.0
    turned = wrap(np.arctan2(*after.T[::-1]) - np.arctan2(*before.T[::-1]))
    slow = np.minimum(np.hypot(*before.T), np.hypot(*after.T)) < max(least, 0.05)
    rate = np.where(slow | (np.abs(turned) > 0.5 * np.pi), np.nan, turned / width)
    return Signal(float(grid[0]), step, _cut_outliers(np.stack([speed, rate], axis=-1)))


def _width(step: float) -> float:
    return WIDTH * step / STEP


def _grid(t: FloatArray, step: float) -> FloatArray:
    return np.asarray(t[0] + step * np.arange(int((t[-1] - t[0]) / step) + 1))


def _cut_outliers(values: FloatArray) -> FloatArray:
    most = np.array([OUTLIER * typical(column) for column in values.T])
    return np.clip(values, -most, most)


def typical(values: FloatArray, share: float = 0.5) -> float:
    """The rate below which that share of the way was made; 0 without motion. Rest does not count."""
    size = np.sort(np.abs(values[np.isfinite(values)]))
    way = np.cumsum(size)
    return float(size[np.searchsorted(way, share * way[-1])]) if len(size) and way[-1] > 0 else 0.0


def turned_by(rates: FloatArray, step: float) -> float:
    """Angle [rad] that yaw rates (n,) on a grid of that step turn by, unsigned; NaN and slow turns do not count."""
    size = max(round(1.0 / step), 1)
    seconds = rates[: len(rates) // size * size].reshape(-1, size)
    known = np.isfinite(seconds)
    turns = np.abs(np.where(known, seconds, 0.0).sum(axis=1) * step)
    return float(turns[turns > LEAST_TURN * known.sum(axis=1) * step].sum())
