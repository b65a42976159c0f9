"""How far predictions are off: window errors, and the yaw against a gyro where there is one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skidsteer.drive import Drive
from skidsteer.gyro import GyroErrors, Turn, rough_errors
from skidsteer.models import Model
from skidsteer.se2 import FloatArray, chain, wrap
from skidsteer.windows import Timing, Windows, judging_pairs, judging_windows, predict, stretches


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
    gyro = _gyro_errors(model, drive, timing, windows) if drive.gyro is not None and len(windows) else np.zeros(0)
    return WindowErrors(windows.start, np.hypot(error[:, 0], error[:, 1]), wrap(error[:, 2]), gyro)


def _gyro_errors(model: Model, drive: Drive, timing: Timing, windows: Windows) -> FloatArray:
    """Turned angle (k,) [rad] predicted less that of the gyro, over the part of each window where both speak."""
    assert drive.gyro is not None
    errors, turn = align_gyro(drive, model, timing), Turn.of(drive.gyro)
    start, end = windows.start - timing.time_offset, windows.end - timing.time_offset
    middle = 0.5 * (start + end)
    for stretch in (stretches(drive.wheels.t), stretches(turn.t) - errors.time_offset):
        around = stretch[np.clip(np.searchsorted(stretch[:, 0], middle, side="right") - 1, 0, None)]
        start, end = np.maximum(start, around[:, 0]), np.minimum(end, around[:, 1])
    start = np.minimum(start, end)
    clipped = Windows(start, end, windows.motion, windows.joined)
    turned = predict(model, drive.wheels, clipped, Timing(0.0, timing.lag))[:, 2]
    return np.asarray(turned - turn.between(start, end, errors))


def _position_errors(model: Model, drive: Drive, timing: Timing, length: float) -> WindowErrors:
    t = drive.position.t if drive.position is not None else np.arange(*drive.span, min(length, 0.1))
    pairs = judging_pairs(drive, t, length)
    if drive.position is None:
        windows = Windows(t[pairs[:, 0]], t[pairs[:, 1]], np.zeros((len(pairs), 3)), np.zeros(len(pairs), bool))
        gyro = _gyro_errors(model, drive, Timing(0.0, timing.lag), windows)
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


def align_gyro(drive: Drive, model: Model, timing: Timing) -> GyroErrors:
    """What the drive's gyro is wrong by, so that it can judge the yaw of a model.

    The time offset is the one at which the yaw rate predicted from the wheels correlates best with the gyro; the bias
    is the gyro's median at rest; the scale is that of the reference yaw over the integrated gyro (1 without one, or
    where the drive does not turn enough to tell).
    """
    assert drive.gyro is not None
    found = rough_errors(drive.wheels, drive.gyro, model, timing.lag, (-1.0, 1.0))
    if drive.pose is None:
        return found
    windows = judging_windows(drive, 2.0)
    start, end = windows.start - timing.time_offset, windows.end - timing.time_offset
    turn = Turn.of(drive.gyro)
    gyro = turn.between(start, end, found)
    measured = gyro + wrap(windows.motion[:, 2] - gyro)
    keep = (np.abs(measured - gyro) < 0.5) & (np.abs(gyro) > 0.2) & turn.covers(start, end, found)
    if keep.sum() < 10:
        return found
    return replace(found, scale=float(np.median(measured[keep] / gyro[keep])))
