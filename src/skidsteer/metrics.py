"""How far predictions are off: window errors, and the yaw against a gyro where there is one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.models import Model
from skidsteer.se2 import FloatArray, chain, wrap
from skidsteer.windows import Timing, Windows, judging_pairs, judging_windows, predict


@dataclass(frozen=True, slots=True)
class Spread:
    """Median, root mean square and 95 % quantile of the sizes of errors."""

    median: float
    rms: float
    p95: float

    @classmethod
    def of(cls, errors: FloatArray) -> Spread:
        """Of errors (k,); NaN throughout where there is none."""
        if not len(errors):
            return cls(float("nan"), float("nan"), float("nan"))
        size = np.abs(errors)
        return cls(float(np.median(size)), float(np.sqrt(np.mean(size**2))), float(np.quantile(size, 0.95)))


@dataclass(frozen=True, slots=True, eq=False)
class WindowErrors:
    """Errors of a prediction on the windows of drives."""

    start: FloatArray  # (k,) [s] when each window starts, on its drive's reference clock
    translation: FloatArray  # (k,) [m] end position; without heading the RMS distance after rigid alignment
    yaw: FloatArray  # (k,) [rad] end yaw, wrapped; empty without heading
    yaw_gyro: FloatArray  # (g,) [rad] turned angle against the integrated gyro; empty without a gyro

    def __len__(self) -> int:
        return len(self.translation)

    def where(self, keep: np.ndarray) -> WindowErrors:
        """Only the windows of a mask (k,)."""
        parts = (a[keep] if len(a) == len(keep) else a for a in (self.translation, self.yaw, self.yaw_gyro))
        return WindowErrors(self.start[keep], *parts)

    @staticmethod
    def join(parts: list[WindowErrors]) -> WindowErrors:
        """Errors of several drives or folds, one after the other."""
        fields = ("start", "translation", "yaw", "yaw_gyro")
        return WindowErrors(*(np.concatenate([getattr(p, f) for p in parts] or [np.zeros(0)]) for f in fields))


def window_errors(
    model: Model, drive: Drive, timing: Timing, length: float = 2.0, windows: Windows | None = None
) -> WindowErrors:
    """Errors of a model on the judging windows of a drive (or on given windows).

    A drive with reference poses is judged at the end of each window; one with positions only along each window after
    the best rigid alignment; a gyro-only drive by its turned angle.
    """
    if drive.pose is None:
        return _position_errors(model, drive, timing, length)
    windows = judging_windows(drive, length) if windows is None else windows
    predicted = predict(model, drive.wheels, windows, timing)
    error = windows.motion - predicted
    gyro = np.zeros(0)
    if drive.gyro is not None and len(windows):
        aligned = align_gyro(drive, model, timing)
        start, end = windows.start - timing.time_offset, windows.end - timing.time_offset
        gyro = predicted[:, 2] - aligned.turned(start, end)
    return WindowErrors(windows.start, np.hypot(error[:, 0], error[:, 1]), wrap(error[:, 2]), gyro)


def _position_errors(model: Model, drive: Drive, timing: Timing, length: float) -> WindowErrors:
    t = drive.position.t if drive.position is not None else np.arange(*drive.span, min(length, 0.1))
    pairs = judging_pairs(drive, t, length)
    if drive.position is None:
        windows = Windows(t[pairs[:, 0]], t[pairs[:, 1]], np.zeros((len(pairs), 3)), np.zeros(len(pairs), bool))
        turned = predict(model, drive.wheels, windows, timing)[:, 2]
        aligned = align_gyro(drive, model, timing)
        gyro = turned - aligned.turned(windows.start - timing.time_offset, windows.end - timing.time_offset)
        return WindowErrors(windows.start, np.zeros(0), np.zeros(0), gyro)
    starts, errors = [], []
    xy = drive.position.values
    for i, j in pairs:
        moved = float(np.hypot(*(xy[j] - xy[i])))
        if t[j] - t[i] < min(1.0, 0.5 * length) or moved < 0.1 or j - i < 2:
            continue
        inner = Windows(t[i:j], t[i + 1 : j + 1], np.zeros((j - i, 3)), np.ones(j - i, bool))
        path = chain(predict(model, drive.wheels, inner, timing))[:, :2]
        starts.append(t[i])
        errors.append(aligned_rms(path, xy[i : j + 1]))
    return WindowErrors(np.array(starts), np.array(errors), np.zeros(0), np.zeros(0))


def aligned_rms(path: FloatArray, reference: FloatArray) -> float:
    """RMS distance [m] of two paths (n, 2) after the rigid motion that brings them closest, Umeyama 1991, no scale."""
    a = (path - path.mean(axis=0)) @ [1.0, 1j]
    b = (reference - reference.mean(axis=0)) @ [1.0, 1j]
    turn = np.exp(1j * np.angle(np.vdot(a, b)))
    return float(np.sqrt(np.mean(np.abs(b - turn * a) ** 2)))


@dataclass(frozen=True, slots=True, eq=False)
class AlignedGyro:
    """Integrated gyro on the wheels' clock: yaw (n,) [rad] at times t (n,) [s], bias and scale removed."""

    t: FloatArray
    yaw: FloatArray
    time_offset: float  # [s] stamps of the gyro are late against the wheels by this
    scale: float  # true over measured rate
    bias: float  # [rad/s]

    def turned(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Angle (k,) turned between wheel times start and end (k,)."""
        return np.asarray(np.interp(end, self.t, self.yaw) - np.interp(start, self.t, self.yaw))


def align_gyro(drive: Drive, model: Model, timing: Timing, search: tuple[float, float] = (-1.0, 1.0)) -> AlignedGyro:
    """Bring the drive's gyro onto the wheels' clock.

    The time offset is the one at which the yaw rate predicted from the wheels correlates best with the gyro; the bias
    is the gyro's median at rest; the scale is that of the reference yaw over the integrated gyro (1 without one, or
    where the drive does not turn enough to tell).
    """
    assert drive.gyro is not None
    gyro = drive.gyro
    offset = _gyro_offset(drive.wheels, gyro, model, timing, search)
    bias = _bias_at_rest(drive.wheels, gyro, offset)
    t = gyro.t - offset
    rate = gyro.values[:, 0] - bias
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.minimum(np.diff(t), 0.5))])
    scale = _gyro_scale(drive, AlignedGyro(t, yaw, offset, 1.0, bias), timing)
    return AlignedGyro(t, scale * yaw, offset, scale, bias)


def _gyro_offset(wheels: Series, gyro: Series, model: Model, timing: Timing, search: tuple[float, float]) -> float:
    """Offset [s] of best correlation, from a grid of 0.02 s and a parabola through its best three points."""
    dt = max(0.02, (wheels.t[-1] - wheels.t[0]) / 50_000)
    t = np.arange(wheels.t[0] + 0.5 * dt, wheels.t[-1], dt)
    near = np.searchsorted(wheels.t, t)
    t = t[wheels.t[np.minimum(near, len(wheels) - 1)] - wheels.t[np.maximum(near - 1, 0)] < 1.0]
    windows = Windows(t - 0.5 * dt, t + 0.5 * dt, np.zeros((len(t), 3)), np.ones(len(t), bool))
    rate = predict(model, wheels, windows, Timing(0.0, timing.lag))[:, 2] / dt
    grid = np.arange(search[0], search[1] + 0.01, 0.02)
    score = np.array([_correlation(rate, np.interp(t + o, gyro.t, gyro.values[:, 0])) for o in grid])
    best = int(np.argmax(score))
    if not 0 < best < len(grid) - 1:
        return float(grid[best]) if score[best] > 0 else 0.0
    a, b, c = score[best - 1 : best + 2]
    bend = a - 2.0 * b + c
    return float(grid[best] + (0.02 * 0.5 * (a - c) / bend if bend < 0 else 0.0))


def _correlation(a: FloatArray, b: FloatArray) -> float:
    spread = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / spread if spread > 0 else 0.0


def _bias_at_rest(wheels: Series, gyro: Series, offset: float) -> float:
    """Median gyro rate [rad/s] where the wheels have stood still for half a second; 0 where they never do."""
    t = gyro.t - offset
    rest = np.ones(len(t), bool)
    for shift in (-0.5, -0.25, 0.0, 0.25):
        rest &= np.abs(wheels.hold(t + shift)).max(axis=1) < 1e-3
    return float(np.median(gyro.values[rest, 0])) if rest.sum() >= 20 else 0.0


def _gyro_scale(drive: Drive, unscaled: AlignedGyro, timing: Timing) -> float:
    if drive.pose is None:
        return 1.0
    windows = judging_windows(drive, 2.0)
    measured = windows.motion[:, 2]
    gyro = unscaled.turned(windows.start - timing.time_offset, windows.end - timing.time_offset)
    keep = (np.abs(wrap(gyro - measured)) < 0.5) & (np.abs(gyro) > 0.2)
    measured = gyro + wrap(measured - gyro)
    if keep.sum() < 10:
        return 1.0
    return float(np.median(measured[keep] / gyro[keep]))
