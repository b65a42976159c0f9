"""Wheel angles and encoder counts to the distances rolled between samples: wrap-around and resets undone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skidsteer.io.raw import IntArray
from skidsteer.io.stamps import SECOND
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle

_TURN = 2.0 * math.pi
_COUNTER_RANGES = (2.0**8, 2.0**16, 2.0**24, 2.0**32)
_TOP_SPEED = 20.0  # [m/s] at the rim; no skid-steer robot is faster
_NEAR_ZERO = 10.0  # a counter that restarts lands within this many usual steps of zero


@dataclass(frozen=True, slots=True, eq=False)
class Rolled:
    """Steps (n - 1, k) between samples of k counters, in their unit, and what was undone to get them."""

    steps: FloatArray
    wraps: int
    resets: int


def top_speed(vehicle: Vehicle) -> float:
    """Rim speed [m/s] that no intact log of this robot exceeds."""
    return 2.0 * vehicle.max_wheel_speed if vehicle.max_wheel_speed else _TOP_SPEED


def roll(ns: IntArray, counts: FloatArray, largest_rate: float) -> Rolled:
    """Steps of counters that may wrap around or start again.

    A counter wraps when it stays inside a range it could have (one turn, 2^8, 2^16, 2^24, 2^32 counts) and jumps by
    more than half of it. What then is still faster than possible, or lands at zero from far away, is a reset: the
    wheel is taken to have kept its speed.

    Args:
        ns: (n,) times [ns], increasing.
        counts: (n, k) readings.
        largest_rate: of a counter, in its unit per second.

    Returns:
        Steps (n - 1, k); empty for one sample.
    """
    dt = np.diff(ns) / SECOND
    steps = np.diff(counts, axis=0)
    wraps = resets = 0
    for column in range(counts.shape[1]):
        unwrapped = _unwrap(counts[:, column], steps[:, column])
        wrapped = unwrapped != steps[:, column]
        wraps += int(wrapped.sum())
        bad = _impossible(dt, counts[:, column], unwrapped, wrapped, largest_rate)
        resets += int(bad.sum())
        steps[:, column] = _bridged(dt, unwrapped, bad)
    return Rolled(steps, wraps, resets)


def _unwrap(counts: FloatArray, steps: FloatArray) -> FloatArray:
    whole = bool((counts == np.rint(counts)).all())
    spread = float(np.ptp(counts))
    for span in _COUNTER_RANGES if whole else (_TURN,):
        jumps = np.abs(steps) > 0.5 * span
        # A tenth of a percent for angles that were rounded before they were recorded.
        if jumps.any() and spread <= span * (1.0 if whole else 1.001):
            return np.where(jumps, steps - span * np.rint(steps / span), steps)
    return steps


def _impossible(
    dt: FloatArray, counts: FloatArray, steps: FloatArray, wrapped: np.typing.NDArray[np.bool_], rate: float
) -> np.typing.NDArray[np.bool_]:
    """Steps (n - 1,) that are too fast, or land at zero from far away without having wrapped on the way."""
    if not len(steps):
        return np.zeros(0, dtype=bool)
    # Messages that arrive in a bunch are not faster wheels: no step is judged by less than the usual time.
    too_fast = np.abs(steps) > rate * np.maximum(dt, np.median(dt))
    size = np.abs(steps)
    around = np.maximum(np.append(0.0, size[:-1]), np.append(size[1:], 0.0))
    usual = _NEAR_ZERO * np.maximum(around, 1e-3 * rate * np.median(dt))
    restarts = (np.abs(counts[1:]) <= usual) & (size > np.maximum(usual, 0.05 * rate * np.median(dt)))
    return np.asarray(too_fast | (restarts & ~wrapped))


def _bridged(dt: FloatArray, steps: FloatArray, bad: np.typing.NDArray[np.bool_]) -> FloatArray:
    """Steps with the bad ones replaced by those at the speed of the last good one before (or else the first after)."""
    good = np.flatnonzero(~bad)
    if not len(good):
        return np.zeros_like(steps)
    nearest = good[np.maximum(np.searchsorted(good, np.arange(len(steps)), side="right") - 1, 0)]
    return np.where(bad, steps[nearest] / dt[nearest] * dt, steps)
