"""How far predictions are off: window errors, and the yaw against a gyro where there is one."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from skidsteer.drive import Drive
from skidsteer.gyro import GyroErrors, Turn, rough_errors
from skidsteer.models import Model
from skidsteer.prediction import Distances, Uncertainty, distances
from skidsteer.se2 import FloatArray, chain, compose, wrap
from skidsteer.windows import Mount, Timing, Windows, judging_windows, predict, stretches


@dataclass(frozen=True, slots=True)
class Spread:
    """Median, root mean square and 95 % quantile of the sizes of errors."""

    median: float
    rms: float
    p95: float

    @classmethod
    def of(cls, errors: FloatArray) -> Spread:
        """Of errors (k,), leaving out NaN; NaN throughout where none is left."""
        size = np.abs(errors[np.isfinite(errors)])
        if not len(size):
            return cls(float("nan"), float("nan"), float("nan"))
        return cls(float(np.median(size)), float(np.sqrt(np.mean(size**2))), float(np.quantile(size, 0.95)))


LEAST_TOLD = 0.5  # share of a window that a gyro must speak to judge it
LEAST_BLOCKS = 6  # below which resampling them tells nothing
RESAMPLES = 1000


def median_interval(errors: FloatArray, block: np.ndarray) -> tuple[float, float] | None:
    """95 % interval of the median size of errors (k,), NaN left out, by drawing whole blocks again and again.

    Windows inside a block are not independent, blocks nearly are. The same errors give the same interval.

    Args:
        errors: (k,) of any unit.
        block: (k,) number of the block that each lies in.

    Returns:
        Lower and upper end; None with fewer than ``LEAST_BLOCKS`` blocks.
    """
    told = np.isfinite(errors)
    names, number = np.unique(block[told], return_inverse=True)
    if len(names) < LEAST_BLOCKS:
        return None
    size = np.abs(errors[told])
    order = np.argsort(size)
    drawn = np.random.default_rng(0).multinomial(len(names), np.full(len(names), 1.0 / len(names)), RESAMPLES)
    medians = [_weighted_median(size[order], times[number[order]]) for times in drawn]
    low, high = np.quantile(medians, [0.025, 0.975])
    return float(low), float(high)


def _weighted_median(ascending: FloatArray, times: np.ndarray) -> float:
    """Median of numbers (k,) in ascending order, each of which counts several times (k,)."""
    count = np.cumsum(times)
    return float(ascending[np.searchsorted(2 * count, count[-1])])


@dataclass(frozen=True, slots=True, eq=False)
class WindowErrors:
    """Errors of a prediction on the windows of drives; NaN where the drive cannot tell."""

    start: FloatArray  # (k,) [s] of each window, on its drive's reference clock
    end: FloatArray  # (k,) [s]
    translation: FloatArray  # (k,) [m] end position; without heading the RMS distance after rigid alignment
    yaw: FloatArray  # (k,) [rad] end yaw, wrapped; needs a heading
    yaw_gyro: FloatArray  # (k,) [rad] turned angle against the integrated gyro; needs a gyro
    squared: FloatArray  # (k,) squared distance of the end pose by its predicted covariance; needs a pose and that
    turn_score: FloatArray  # (k,) and of what a turn that is off explains of it, see ``prediction.Distances``
    turn_information: FloatArray  # (k,)

    def __len__(self) -> int:
        return len(self.start)

    @property
    def distances(self) -> Distances:
        """Of the end poses, for regions."""
        return Distances(self.squared, self.turn_score, self.turn_information)

    def where(self, keep: np.ndarray) -> WindowErrors:
        """Only the windows of a mask (k,)."""
        return WindowErrors(*(getattr(self, f.name)[keep] for f in fields(self)))

    @staticmethod
    def join(parts: list[WindowErrors]) -> WindowErrors:
        """Errors of several drives or folds, one after the other."""
        names = [f.name for f in fields(WindowErrors)]
        return WindowErrors(*(np.concatenate([getattr(p, name) for p in parts] or [np.zeros(0)]) for name in names))


def window_errors(
    model: Model,
    drive: Drive,
    timing: Timing,
    length: float = 2.0,
    mount: Mount | None = None,
    uncertainty: Uncertainty | None = None,
) -> WindowErrors:
    """Errors of a model on the judging windows of a drive.

    A drive with reference poses is judged at the end of each window; one with positions only along each window after
    the best rigid alignment; a gyro-only drive by its turned angle.

    Args:
        model: that predicts.
        drive: with wheels and a reference or a gyro.
        timing: of the reference against the wheels.
        length: of the windows [s].
        mount: of the reference's sensor; None: at the origin.
        uncertainty: of the prediction, where errors are to be compared with it.
    """
    windows = judging_windows(drive, length)
    seen = (mount or Mount()).seen(predict(model, drive.wheels, windows, timing))
    translation = yaw = gyro = unknown = np.full(len(windows), np.nan)
    off = Distances(unknown, unknown, unknown)
    if windows.sees == "pose":
        error = windows.motion - seen
        translation, yaw = np.hypot(error[:, 0], error[:, 1]), wrap(error[:, 2])
    elif windows.sees == "position":
        translation = _position_errors(model, drive, timing, windows, mount or Mount())
    if drive.gyro is not None and len(windows):
        gyro = _gyro_errors(model, drive, timing, windows)
    if uncertainty is not None:
        of_body = replace(windows, motion=(mount or Mount()).body(windows.motion))
        off = distances(model, drive.wheels, of_body, timing, uncertainty)
    return WindowErrors(windows.start, windows.end, translation, yaw, gyro, off.squared, off.score, off.information)


def _gyro_errors(model: Model, drive: Drive, timing: Timing, windows: Windows) -> FloatArray:
    """Turned angle (k,) [rad] predicted less that of the gyro, over the part of each window where both speak.

    NaN where that is too little of the window.
    """
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
    told = end - start >= LEAST_TOLD * (windows.end - windows.start)
    return np.where(told, turned - turn.between(start, end, errors), np.nan)


def _position_errors(model: Model, drive: Drive, timing: Timing, windows: Windows, mount: Mount) -> FloatArray:
    """RMS distance (k,) [m] along each window between predicted and measured positions after rigid alignment."""
    assert drive.position is not None
    t, errors = drive.position.t, np.full(len(windows), np.nan)
    for k, (start, end) in enumerate(zip(windows.start, windows.end, strict=True)):
        i, j = np.searchsorted(t, [start, end])
        if j == i:
            continue
        inner = Windows(t[i:j], t[i + 1 : j + 1], np.zeros((j - i, 3)), np.ones(j - i, bool))
        body = chain(predict(model, drive.wheels, inner, timing))
        path = compose(body, [mount.x, mount.y, mount.yaw])[:, :2]
        errors[k] = aligned_rms(path, drive.position.values[i : j + 1])
    return errors


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
