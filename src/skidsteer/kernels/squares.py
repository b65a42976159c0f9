"""Squared cost of windows with gradient and Gauss-Newton matrix, in one pass over steps that lie side by side."""

from __future__ import annotations

import numpy as np
from numba import njit

from skidsteer.kernels import lanes
from skidsteer.kernels.lanes import FAST, LANES, LX, LY, RX, RY, TOTAL, UX, UY, VX, VY, X, Y
from skidsteer.se2 import FloatArray

SUMS = 23  # see ``_add_products``
# Which of the sums is which entry of the upper triangle of the Gauss-Newton matrix, and of the gradient.
ROW = np.array([0, 1, 0, 2, 2, 3, 0, 0, 2, 0, 2, 1, 3, 1, 3, 4, 4, 5])
COLUMN = np.array([0, 1, 1, 2, 3, 3, 3, 4, 4, 5, 5, 4, 4, 5, 5, 4, 5, 5])
SUM = np.array([0, 1, 2, 0, 2, 1, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14])


@njit(cache=True)
def pack(
    distance: FloatArray, offsets: np.ndarray, starts: np.ndarray, rows: FloatArray, total: FloatArray
) -> tuple[float, float]:
    """Lay the steps of windows side by side, tile after tile.

    Args:
        distance: (s, 2) [m] rolled by both sides in each step.
        offsets: (k + 1,) steps offsets[i]:offsets[i + 1] belong to window i.
        starts: (n + 1,) rows starts[i]:starts[i + 1] belong to tile i.
        rows: out, (starts[n], 2 * LANES) [m].
        total: out, (n, 2 * LANES) [m] that both sides roll in each window.

    Returns:
        The largest distances [m] that both sides roll in a step.
    """
    left = right = 0.0
    for tile in range(len(starts) - 1):
        part = rows[starts[tile] : starts[tile + 1]]
        a, b = lanes.fill(distance, offsets, tile * LANES, 0, part, total[tile])
        left, right = max(left, a), max(right, b)
    return left, right


@njit(cache=True, fastmath=FAST)
def _add_products(A: FloatArray, state: FloatArray, measured: FloatArray, sums: FloatArray) -> None:
    """Add the windows of a tile to the sums over windows, (SUMS * LANES,).

    0 UU, 1 VV, 2 and 3 UV, 4-7 U with the derivatives of z by A31 and A32, 8-11 V with them, 12-14 theirs with each
    other; 15-20 all of them with the residual; 21 the squared residuals of the position, 22 of the yaw.
    """
    for m in range(LANES):
        x, y, left, right = state[X + m], state[Y + m], state[TOTAL + m], state[TOTAL + LANES + m]
        ux, uy, vx, vy = state[UX + m], state[UY + m], state[VX + m], state[VY + m]
        xa, ya = state[LY + m] - left * y, left * x - state[LX + m]
        xb, yb = state[RY + m] - right * y, right * x - state[RX + m]
        rx, ry = x - measured[m], y - measured[LANES + m]
        turn = A[2, 0] * left + A[2, 1] * right - measured[2 * LANES + m]
        sums[m] += ux * ux + uy * uy
        sums[LANES + m] += vx * vx + vy * vy
        sums[2 * LANES + m] += ux * vx + uy * vy
        sums[3 * LANES + m] += uy * vx - ux * vy
        sums[4 * LANES + m] += ux * xa + uy * ya
        sums[5 * LANES + m] += ux * ya - uy * xa
        sums[6 * LANES + m] += ux * xb + uy * yb
        sums[7 * LANES + m] += ux * yb - uy * xb
        sums[8 * LANES + m] += vx * xa + vy * ya
        sums[9 * LANES + m] += vx * ya - vy * xa
        sums[10 * LANES + m] += vx * xb + vy * yb
        sums[11 * LANES + m] += vx * yb - vy * xb
        sums[12 * LANES + m] += xa * xa + ya * ya + left * left
        sums[13 * LANES + m] += xa * xb + ya * yb + left * right
        sums[14 * LANES + m] += xb * xb + yb * yb + right * right
        sums[15 * LANES + m] += ux * rx + uy * ry
        sums[16 * LANES + m] += vx * rx + vy * ry
        sums[17 * LANES + m] += ux * ry - uy * rx
        sums[18 * LANES + m] += vx * ry - vy * rx
        sums[19 * LANES + m] += xa * rx + ya * ry + left * turn
        sums[20 * LANES + m] += xb * rx + yb * ry + right * turn
        sums[21 * LANES + m] += rx * rx + ry * ry
        sums[22 * LANES + m] += turn * turn


@njit(cache=True)
def squares(
    A: FloatArray, rows: FloatArray, starts: np.ndarray, total: FloatArray, measured: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Squared cost of Mandow 2007, Eq. (13), for steps by which no window turns more than 2 ``lanes.LIMIT``.

    Args:
        A: (3, 2) of the model.
        rows: (r, 2 * LANES) [m] from ``pack``.
        starts: (n + 1,) rows starts[i]:starts[i + 1] belong to tile i.
        total: (n, 2 * LANES) [m] from ``pack``.
        measured: (n, 3 * LANES) x, y [m] and yaw [rad] of each window; zero beyond the last window.

    Returns:
        cost (2,) of position [m^2] and yaw [rad^2]; half of its gradient (6,) by the entries of A, row by row; the
        Gauss-Newton matrix (6, 6).
    """
    state, sums = lanes.empty_state(), np.zeros(SUMS * LANES)
    for tile in range(len(starts) - 1):
        lanes.clear(state)
        state[TOTAL : TOTAL + 2 * LANES] = total[tile]
        for i in range(starts[tile], starts[tile + 1]):
            lanes.advance(A, rows[i], state, False)
        _add_products(A, state, measured[tile], sums)
    s = sums.reshape(SUMS, LANES).sum(axis=1)
    H = np.zeros((6, 6))
    for i in range(len(SUM)):
        H[ROW[i], COLUMN[i]] = H[COLUMN[i], ROW[i]] = s[SUM[i]]
    H[1, 2] = H[2, 1] = -s[3]
    return s[21:].copy(), s[15:21].copy(), H
