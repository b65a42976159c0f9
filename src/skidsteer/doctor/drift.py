"""How what a gyro reads at rest drifts along the drive: a straight line in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.doctor.signals import Signal

LEAST = 0.02  # [rad/s] over the drive; what drifts by less hides nothing
FEW = 20  # samples
OUTLIER = 3.0  # times the median error: wheels that spin, a reference that leaps


@dataclass(frozen=True, slots=True)
class Drift:
    """By how much more a gyro is wrong than at its ``start`` [s]: ``slope`` [rad/s^2] times the time since."""

    start: float = 0.0
    slope: float = 0.0
    span: float = 0.0  # [s] of the gyro

    @property
    def matters(self) -> bool:
        """Whether it is large enough to hide anything."""
        return abs(self.slope) * self.span > LEAST

    def taken_off(self, gyro: Signal) -> Signal:
        """The gyro without it."""
        return Signal(gyro.start, gyro.step, gyro.values - self.slope * (gyro.t - self.start)[:, None])


NO_DRIFT = Drift()


def drift_against(gyro: Signal, other: Signal) -> Drift:
    """What goes with time where a gyro is explained by all channels of another sensor; none for too few samples.

    Turns that a wrong time offset puts elsewhere do not go with time in the long run.

    Args:
        gyro: one channel.
        other: wheels or reference.
    """
    t = gyro.t
    share = (t - t[0]) / max(t[-1] - t[0], 1e-9)
    x, y = np.column_stack([other.at(t), np.ones(len(t)), share]), gyro.values[:, 0]
    known = np.isfinite(x).all(axis=1) & np.isfinite(y)
    if known.sum() < FEW:
        return NO_DRIFT
    x, y = x[known], y[known]
    keep = np.ones(len(y), bool)
    for _ in range(3):
        found = np.linalg.lstsq(x[keep], y[keep], rcond=None)[0]
        error = np.abs(y - x @ found)
        keep = error <= OUTLIER * np.median(error)
    span = float(t[-1] - t[0])
    return Drift(float(t[0]), float(found[-1] / max(span, 1e-9)), span)
