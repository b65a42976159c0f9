"""Where a fit begins: options, first guesses of clocks, gyro and headings."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skidsteer.drive import Drive
from skidsteer.gyro import GyroErrors, rough_errors
from skidsteer.heading import guess_headings
from skidsteer.identify.unknowns import Unknowns
from skidsteer.models import Model
from skidsteer.noise import Noise
from skidsteer.se2 import FloatArray
from skidsteer.windows import Mount, Timing, Windows, predict


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How a model is fitted; the defaults suit real logs."""

    time_offset: float | None = None  # [s] fixed to this; None: estimated, one for each drive
    lag: float | None = None  # [s] fixed to this; None: estimated
    mount: Mount | None = field(default_factory=Mount)  # of the reference's sensor; None: estimated
    align: bool = False  # estimate the yaw of the reference's sensor though its place is given
    use_gyro: bool = True  # a gyro, where there is one, tells turns beside the reference
    fix_model: bool = False  # keep the model's parameters, estimate only the timing
    without: tuple[str, ...] = ()  # parameters of the model that stay as they are
    noise: Noise | None = None  # fixed to this; None: estimated
    robust: bool = True  # weigh down outliers
    search: tuple[float, float] = (-1.0, 1.5)  # [s] where the time offset is looked for
    rounds: int = 6  # of parameters, then noise and weights
    iterations: int = 40  # Gauss-Newton steps in a round
    tolerance: float = 1e-3  # converged: no parameter moves by more than this share of its sigma
    block: float = 10.0  # [s] stretches that are taken as independent for the check of the covariance


def first_guess(
    model: Model, drives: list[Drive], windows: list[Windows], options: FitOptions
) -> tuple[Unknowns, np.ndarray]:
    """Where the search begins, and which entries (m,) of it are free."""
    own, free_own = [], []
    for drive, w in zip(drives, windows, strict=True):
        offset, known = options.time_offset, options.time_offset is not None or w.sees == "turn"
        if offset is None:
            offset = 0.0 if w.sees == "turn" else find_offset(model, drive, w, options.search)
        with_gyro = drive.gyro is not None and options.use_gyro
        gyro = rough_errors(drive.wheels, drive.gyro, model) if with_gyro and drive.gyro is not None else GyroErrors()
        own += [offset, gyro.time_offset, gyro.bias, gyro.scale]
        free_own += [not known, with_gyro, with_gyro, with_gyro]
    mount = options.mount or Mount()
    x = np.array([*model.theta, 0.05 if options.lag is None else options.lag, mount.x, mount.y, mount.yaw, *own])
    shared = [not options.fix_model and p.name not in options.without for p in model.PARAMETERS]
    shared += [options.lag is None]
    turned = options.mount is None or (options.align and not model.CRABS)
    shared += [options.mount is None] * 2 + [turned and any(w.sees == "pose" for w in windows)]
    return Unknowns(model, x, len(drives)), np.array(shared + free_own)


def with_headings(model: Model, drive: Drive, windows: Windows, start: Unknowns, i: int) -> Windows:
    """Windows with a first guess of the headings that the reference does not tell."""
    if windows.sees != "position":
        return windows
    return guess_headings(windows, start.mount.seen(predict(model, drive.wheels, windows, start.timing(i))))


def find_offset(
    model: Model, drive: Drive, windows: Windows, search: tuple[float, float], lag: float = 0.0, most: int = 3000
) -> float:
    """Time offset [s] at which predicted and measured increments agree best, on a grid of 0.05 s.

    Yaw and forward increments each vote with the share of their variance that the prediction explains, so that the
    scale factors of the model do not matter.
    """
    some = windows.where(np.arange(len(windows)) < most) if len(windows) > most else windows
    candidates = np.arange(search[0], search[1] + 0.025, 0.05)
    rate = 1.0 / np.maximum(some.end - some.start, 1e-3)[:, None]
    measured = _speeds(some.motion, some.sees) * rate
    scores = []
    for offset in candidates:
        predicted = _speeds(predict(model, drive.wheels, some, Timing(float(offset), lag)), some.sees) * rate
        scores.append(sum(_explained(measured[:, i], predicted[:, i]) for i in range(2)))
    best = candidates[np.array(scores) > max(scores) - 1e-6]  # several where nothing changes speed: the least of them
    return float(best[np.argmin(np.abs(best))]) if max(scores) > 0.2 else 0.0


def _speeds(motion: FloatArray, sees: str) -> FloatArray:
    """Forward and yaw part (k, 2) of motions; without headings the distance covered, and no yaw."""
    if sees == "pose":
        return motion[:, [0, 2]]
    distance = np.hypot(motion[:, 0], motion[:, 1])
    return np.stack([distance, np.zeros_like(distance)], axis=1)


def _explained(a: FloatArray, b: FloatArray) -> float:
    """Squared correlation after clipping the outliers of a; 0 where one of them does not vary."""
    a = np.clip(a, *np.quantile(a, [0.01, 0.99])) if len(a) else a
    spread = float(np.std(a) * np.std(b)) if len(a) else 0.0
    return float(np.mean((a - a.mean()) * (b - b.mean())) / spread) ** 2 if spread > 1e-9 else 0.0
