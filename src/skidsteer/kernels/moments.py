"""Sums over windows that carry the squared cost of every model linear in the rim speeds, and the cost from those sums.

With e = exp(j yaw), a window ends at p U + q V with U = sum of e dl, V = sum of e dr, p = A11 + j A21, q = A12 + j A22,
and yaw = A31 L + A32 R. U and V depend on A31 and A32 only.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from skidsteer.se2 import FloatArray

SMALL = 0.3  # [rad] half angle of a step below which the series of sine and cosine are exact to 1e-13
SUMS = 8  # UU, VV, Re UV', Im UV', Re Ud', Im Ud', Re Vd', Im Vd' (' conjugates; d is the measured position)


@njit(cache=True)
def extents(distance: FloatArray, offsets: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """What each side rolls (s, 2) [m], window by window: in all (k, 2), and between its extremes (k, 2)."""
    k = len(offsets) - 1
    rolled, span = np.zeros((k, 2)), np.zeros((k, 2))
    for w in range(k):
        for side in range(2):
            at = lowest = highest = 0.0
            for i in range(offsets[w], offsets[w + 1]):
                at += distance[i, side]
                lowest, highest = min(lowest, at), max(highest, at)
            rolled[w, side] = at
            span[w, side] = highest - lowest
    return rolled, span


@njit(cache=True, fastmath={"contract", "nsz"})
def _advance(half: FloatArray, dl: float, dr: float, state: FloatArray) -> None:
    """One step of every node: heading and the integrals U, V in ``state`` (6, n). Exact for |h| < SMALL.

    The loop is free of branches and library calls, so that the compiler handles several nodes at once.
    """
    half_a, half_b = half[0], half[1]
    C, S, UX, UY, VX, VY = state[0], state[1], state[2], state[3], state[4], state[5]
    for n in range(len(half_a)):
        h = half_a[n] * dl + half_b[n] * dr
        h2 = h * h
        chord = 1.0 - h2 * (1 / 6 - h2 * (1 / 120 - h2 * (1 / 5040 - h2 * (1 / 362880))))  # sin(h) / h
        cos = 1.0 - h2 * (1 / 2 - h2 * (1 / 24 - h2 * (1 / 720 - h2 * (1 / 40320 - h2 * (1 / 3628800)))))
        sin = h * chord
        cm, sm = C[n] * cos - S[n] * sin, S[n] * cos + C[n] * sin  # heading at the middle of the step
        C[n], S[n] = cm * cos - sm * sin, sm * cos + cm * sin
        UX[n] += chord * cm * dl
        UY[n] += chord * sm * dl
        VX[n] += chord * cm * dr
        VY[n] += chord * sm * dr


@njit(cache=True, fastmath={"contract", "nsz"})
def _add_products(state: FloatArray, dx: float, dy: float, sums: FloatArray) -> None:
    UX, UY, VX, VY = state[2], state[3], state[4], state[5]
    for n in range(state.shape[1]):
        ux, uy, vx, vy = UX[n], UY[n], VX[n], VY[n]
        sums[0, n] += ux * ux + uy * uy
        sums[1, n] += vx * vx + vy * vy
        sums[2, n] += ux * vx + uy * vy
        sums[3, n] += uy * vx - ux * vy
        sums[4, n] += ux * dx + uy * dy
        sums[5, n] += uy * dx - ux * dy
        sums[6, n] += vx * dx + vy * dy
        sums[7, n] += vy * dx - vx * dy


@njit(cache=True)
def gather(distance: FloatArray, offsets: np.ndarray, position: FloatArray, nodes: FloatArray) -> FloatArray:
    """Sums over windows (8, n), see ``SUMS``, for each pair A31, A32 in ``nodes`` (2, n) [1/m].

    Args:
        distance: (s, 2) [m] rolled by the left and the right side in each step.
        offsets: (k + 1,) steps offsets[i]:offsets[i + 1] belong to window i.
        position: (k, 2) [m] measured at the end of each window, in the frame of its start.
        nodes: (2, n) [1/m].
    """
    half = 0.5 * nodes
    reach_a, reach_b = np.abs(half[0]).max(), np.abs(half[1]).max()
    state, sums = np.zeros((6, nodes.shape[1])), np.zeros((SUMS, nodes.shape[1]))
    for w in range(len(offsets) - 1):
        state[:] = 0.0
        state[0] = 1.0
        for i in range(offsets[w], offsets[w + 1]):
            dl, dr = distance[i, 0], distance[i, 1]
            # Rim speeds are constant in a step, so that parts of it chain to the same motion.
            parts = 1 + int((reach_a * abs(dl) + reach_b * abs(dr)) / SMALL)
            for _ in range(parts):
                _advance(half, dl / parts, dr / parts, state)
        _add_products(state, position[w, 0], position[w, 1], sums)
    return sums


@njit(cache=True)
def _chebyshev(x: float, T: FloatArray, D: FloatArray) -> None:
    """Values T and slopes D (n,) of the Chebyshev polynomials at x."""
    T[0], D[0] = 1.0, 0.0
    if len(T) > 1:
        T[1], D[1] = x, 1.0
    for n in range(2, len(T)):
        T[n] = 2.0 * x * T[n - 1] - T[n - 2]
        D[n] = 2.0 * T[n - 1] + 2.0 * x * D[n - 1] - D[n - 2]


@njit(cache=True)
def _scaled(value: float, lower: float, upper: float) -> tuple[float, float]:
    """The value brought to [-1, 1] between the limits, and the slope of that; 0 where the limits coincide."""
    if upper == lower:
        return 0.0, 0.0
    slope = 2.0 / (upper - lower)
    return slope * (value - 0.5 * (lower + upper)), slope


@njit(cache=True, fastmath={"contract", "nsz"})
def _sums_at(table: FloatArray, TA: FloatArray, TB: FloatArray, out: FloatArray) -> None:
    """Series ``table`` (na, nb, 8) in T(a) T(b) summed up: (8,)."""
    out[:] = 0.0
    for i in range(len(TA)):
        for j in range(len(TB)):
            weight = TA[i] * TB[j]
            for m in range(SUMS):
                out[m] += weight * table[i, j, m]


@njit(cache=True, inline="always")
def _position_weights(A: FloatArray, w: FloatArray) -> None:
    """Weights (8,) of the sums in sum |p U + q V - d|^2 - sum |d|^2."""
    px, py, qx, qy = A[0, 0], A[1, 0], A[0, 1], A[1, 1]
    w[0], w[1] = px * px + py * py, qx * qx + qy * qy
    w[2], w[3] = 2.0 * (px * qx + py * qy), -2.0 * (py * qx - px * qy)
    w[4], w[5], w[6], w[7] = -2.0 * px, 2.0 * py, -2.0 * qx, 2.0 * qy


@njit(cache=True)
def costs(A: FloatArray, box: FloatArray, table: FloatArray, heading: FloatArray, position: float) -> FloatArray:
    """Cost (m,) of Mandow 2007, Eq. (13), for matrices A (m, 3, 2), from the sums of ``skidsteer.identify.moments``."""
    TA, TB = np.empty(table.shape[0]), np.empty(table.shape[1])
    DA, DB = np.empty(table.shape[0]), np.empty(table.shape[1])
    s, w, out = np.empty(SUMS), np.empty(SUMS), np.empty(len(A))
    for m in range(len(A)):
        a, b = A[m, 2, 0], A[m, 2, 1]
        _chebyshev(_scaled(a, box[0, 0], box[0, 1])[0], TA, DA)
        _chebyshev(_scaled(b, box[1, 0], box[1, 1])[0], TB, DB)
        _sums_at(table, TA, TB, s)
        _position_weights(A[m], w)
        yaw = a * a * heading[0, 0] + b * b * heading[1, 1] + heading[2, 2]
        yaw += 2.0 * (a * b * heading[0, 1] - a * heading[0, 2] - b * heading[1, 2])
        out[m] = yaw + position + (w * s).sum()
    return out


@njit(cache=True)
def cost_gradient(
    A: FloatArray, box: FloatArray, table: FloatArray, heading: FloatArray, position: float
) -> tuple[float, FloatArray]:
    """As ``costs`` for one A (3, 2), with the derivative (3, 2) by its entries."""
    TA, TB = np.empty(table.shape[0]), np.empty(table.shape[1])
    DA, DB = np.empty(table.shape[0]), np.empty(table.shape[1])
    s, by_a, by_b, w = np.empty(SUMS), np.empty(SUMS), np.empty(SUMS), np.empty(SUMS)
    a, b = A[2, 0], A[2, 1]
    x, slope_a = _scaled(a, box[0, 0], box[0, 1])
    y, slope_b = _scaled(b, box[1, 0], box[1, 1])
    _chebyshev(x, TA, DA)
    _chebyshev(y, TB, DB)
    _sums_at(table, TA, TB, s)
    _sums_at(table, DA, TB, by_a)
    _sums_at(table, TA, DB, by_b)
    _position_weights(A, w)
    px, py, qx, qy = A[0, 0], A[1, 0], A[0, 1], A[1, 1]
    yaw_a = a * heading[0, 0] + b * heading[0, 1] - heading[0, 2]
    yaw_b = a * heading[0, 1] + b * heading[1, 1] - heading[1, 2]
    yaw = a * (yaw_a - heading[0, 2]) + b * (yaw_b - heading[1, 2]) + heading[2, 2]
    gradient = np.empty((3, 2))
    gradient[0, 0] = 2.0 * (px * s[0] + qx * s[2] + qy * s[3] - s[4])
    gradient[1, 0] = 2.0 * (py * s[0] + qy * s[2] - qx * s[3] + s[5])
    gradient[0, 1] = 2.0 * (qx * s[1] + px * s[2] - py * s[3] - s[6])
    gradient[1, 1] = 2.0 * (qy * s[1] + py * s[2] + px * s[3] + s[7])
    gradient[2, 0] = 2.0 * yaw_a + slope_a * (w * by_a).sum()
    gradient[2, 1] = 2.0 * yaw_b + slope_b * (w * by_b).sum()
    return yaw + position + (w * s).sum(), gradient
