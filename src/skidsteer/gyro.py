"""A gyro beside the wheels: its integrated turn, its bias at rest, its time offset against the wheels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Series
from skidsteer.models import Model
from skidsteer.se2 import FloatArray
from skidsteer.windows import MAX_GAP, Timing, Windows, covered, predict, stretches


@dataclass(frozen=True, slots=True)
class GyroErrors:
    """What a yaw gyro's samples are wrong by: true rate = scale * (measured - bias), stamps late by time_offset."""

    time_offset: float = 0.0  # [s]
    bias: float = 0.0  # [rad/s]
    scale: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """Integral of a gyro's samples as they are: yaw (n,) [rad] and rate (n,) [rad/s] at its stamps t (n,) [s]."""

    t: FloatArray
    yaw: FloatArray
    rate: FloatArray

    @classmethod
    def of(cls, gyro: Series) -> Turn:
        """Integrate by the trapezoidal rule; nothing is added over gaps."""
        t, rate = gyro.t, gyro.values[:, 0]
        dt = np.diff(t)
        step = np.where(dt <= MAX_GAP, 0.5 * (rate[1:] + rate[:-1]) * dt, 0.0)
        return cls(t, np.concatenate([[0.0], np.cumsum(step)]), rate)

    def between(self, start: FloatArray, end: FloatArray, errors: GyroErrors) -> FloatArray:
        """True turn (k,) [rad] between wheel times start and end (k,) [s]."""
        a, b = start + errors.time_offset, end + errors.time_offset
        raw = np.interp(b, self.t, self.yaw) - np.interp(a, self.t, self.yaw)
        return np.asarray(errors.scale * (raw - errors.bias * (end - start)))

    def rate_at(self, t: FloatArray, errors: GyroErrors) -> FloatArray:
        """True yaw rate (k,) [rad/s] at wheel times t (k,) [s]."""
        return np.asarray(errors.scale * (np.interp(t + errors.time_offset, self.t, self.rate) - errors.bias))

    def covers(self, start: FloatArray, end: FloatArray, errors: GyroErrors) -> np.ndarray:
        """Whether the gyro speaks all through each of the wheel times start to end (k,) [s]."""
        return covered(self.t, start + errors.time_offset, end + errors.time_offset)


def rough_errors(
    wheels: Series, gyro: Series, model: Model, lag: float = 0.0, search: tuple[float, float] = (-3.0, 3.0)
) -> GyroErrors:
    """First guess of what the gyro is wrong by: bias from rest, time offset from correlation with the wheels."""
    offset = correlation_offset(wheels, gyro, model, lag, search)
    return GyroErrors(offset, bias_at_rest(wheels, gyro, offset), 1.0)


def correlation_offset(
    wheels: Series, gyro: Series, model: Model, lag: float = 0.0, search: tuple[float, float] = (-3.0, 3.0)
) -> float:
    """Time offset [s] at which the yaw rate predicted from the wheels correlates best with the gyro's.

    A grid of 0.02 s and a parabola through its best three points; 0 where nothing turns.
    """
    dt = max(0.02, (wheels.t[-1] - wheels.t[0]) / 50_000)
    t = np.concatenate([np.arange(a + 0.5 * dt, b, dt) for a, b in stretches(wheels.t)])
    windows = Windows(t - 0.5 * dt, t + 0.5 * dt, np.zeros((len(t), 3)), np.zeros(len(t), bool))
    rate = predict(model, wheels, windows, Timing(0.0, lag))[:, 2] / dt
    turn = Turn.of(gyro)
    grid = np.arange(search[0], search[1] + 0.01, 0.02)
    score = np.zeros(len(grid))
    for i, offset in enumerate(grid):
        told = turn.covers(t, t, GyroErrors(float(offset)))
        if told.sum() > 10:
            score[i] = _correlation(rate[told], turn.rate_at(t[told], GyroErrors(float(offset))))
    best = int(np.argmax(score))
    if score[best] <= 0.1:
        return 0.0
    if not 0 < best < len(grid) - 1:
        return float(grid[best])
    a, b, c = score[best - 1 : best + 2]
    bend = a - 2.0 * b + c
    return float(grid[best] + (0.02 * 0.5 * (a - c) / bend if bend < 0 else 0.0))


def _correlation(a: FloatArray, b: FloatArray) -> float:
    spread = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / spread if spread > 0 else 0.0


def bias_at_rest(wheels: Series, gyro: Series, offset: float) -> float:
    """Median gyro rate [rad/s] where the wheels have stood still for half a second; 0 where they never do."""
    t = gyro.t - offset
    rest = np.ones(len(t), bool)
    for shift in (-0.5, -0.25, 0.0, 0.25):
        rest &= np.abs(wheels.hold(t + shift)).max(axis=1) < 1e-3
    return float(np.median(gyro.values[rest, 0])) if rest.sum() >= 20 else 0.0
