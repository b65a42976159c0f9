"""Speeds along a path that accelerations allow: a pass ahead and one back."""

from __future__ import annotations

import math

from numba import njit

from skidsteer.se2 import FloatArray


@njit(cache=True)
def _growth(v: float, by_speed: FloatArray, slopes: FloatArray, acceleration: float, rims: float) -> float:
    """Greatest growth [m/s^2] of a speed v, with rim speeds by_speed (2,) v that change by slopes (2,) v a metre."""
    most = acceleration
    for side in range(2):
        most = min(most, (rims - slopes[side] * v * v) / max(abs(by_speed[side]), 1e-9))
    return max(most, 0.0)


@njit(cache=True)
def sweep(
    v: FloatArray,
    ds: float,
    by_speed: FloatArray,
    slopes: FloatArray,
    closed: bool,
    acceleration: float,
    rims: float,
) -> None:
    """Lower speeds v (n,), in place, until each can be reached from its neighbours.

    Args:
        v: [m/s] at points ``ds`` [m] apart, from one end of the path to the other.
        ds: between them.
        by_speed: (n, 2) rim speeds for each m/s.
        slopes: (n, 2) [1/m] magnitude of their derivative by the arc length, to either side the greater one.
        closed: the last point is the first one.
        acceleration: [m/s^2] along the path, to speed up and to slow down.
        rims: [m/s^2] of the rims.
    """
    n = len(v)
    for _ in range(2 if closed else 1):  # the second lap begins as fast as the first one ended
        for i in range(n - 1):
            a = _growth(v[i], by_speed[i], slopes[i], acceleration, rims)
            v[i + 1] = min(v[i + 1], math.sqrt(v[i] ** 2 + 2.0 * a * ds))
        for i in range(n - 1, 0, -1):
            a = _growth(v[i], by_speed[i], slopes[i], acceleration, rims)
            v[i - 1] = min(v[i - 1], math.sqrt(v[i] ** 2 + 2.0 * a * ds))
        if closed:
            v[0] = v[n - 1] = min(v[0], v[n - 1])
