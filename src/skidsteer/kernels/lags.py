"""First-order lags over one step of time; a lag of 0 follows at once."""

from __future__ import annotations

import math

from numba import njit

ALIKE = 1e-3  # relative difference of two lags that count as equal
SHORT, LONG = 1e-3, 30.0  # steps over lags beyond which a series and the limit are exact to double precision


@njit(cache=True)
def decay(dt: float, lag: float) -> float:
    """Share of a deviation that is left after dt [s]."""
    return math.exp(-dt / lag) if lag > 0.0 else 0.0


@njit(cache=True)
def cascade(dt: float, first: float, second: float) -> float:
    """Share of a deviation from the end value behind the first lag that dt [s] later stands behind the second one, too.

    At the start there is none behind the second one.
    """
    if first <= 0.0:
        return 0.0
    if abs(first - second) < ALIKE * first:
        return dt / first * math.exp(-dt / first)
    return float((decay(dt, first) - decay(dt, second)) * first / (first - second))


@njit(cache=True)
def mean_share(dt: float, lag: float) -> float:
    """Weight of the end value in the mean over dt [s] of what decays with a lag; the rest is that of the start."""
    x = dt / lag if lag > 0.0 else math.inf
    if x > LONG:
        return 1.0 - 1.0 / x
    if x < SHORT:
        return 0.5 + x / 12.0
    return 1.0 / (-math.expm1(-x)) - 1.0 / x
