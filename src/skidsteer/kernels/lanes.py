"""Windows side by side: the same step of ``LANES`` windows at once, without branches, for the compiler to vectorise.

With e = exp(j yaw), a window ends at z = p U + q V, U = sum of e dl, V = sum of e dr, p = A11 + j A21, q = A12 + j A22.
The derivatives by A31 and A32 follow by parts: dz/dA31 = j int e L (p dl + q dr) = j (L z - int z dL), so that the
sums need the running z, not its derivatives. Shorter windows are filled up with zeros: a step of zero changes nothing.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from skidsteer.se2 import FloatArray

LANES = 32  # windows in a tile: state and steps of a tile stay in the first-level cache
LINE = 8  # numbers in a cache line
LIMIT = 0.2  # [rad] half angle of a step up to which the series are exact to 1e-13
FILLED = 8  # lanes pay while at least one in this many of a tile's places holds a step
ROWS = 20  # of state: see the constants below, LANES numbers each
C, S, X, Y, UX, UY, VX, VY, LX, LY, RX, RY, QX, QY, IX, IY, TOTAL, _, LAG_TOTAL, _ = range(0, ROWS * LANES, LANES)
FAST = {"contract", "nsz"}  # fused multiply-add; nothing that changes what NaN or the order of sums mean


@njit(cache=True, fastmath=FAST)
def advance(A: FloatArray, row: FloatArray, state: FloatArray, lagged: bool) -> None:
    """One step of every window of a tile.

    Args:
        A: (3, 2) of the model.
        row: (2 * LANES,) [m] what the left sides roll, what the right sides roll; where ``lagged`` (4 * LANES,), the
            derivatives of both by the lag behind them.
        state: (ROWS * LANES,) C, S: cos and sin of the yaw; X, Y: z; UX .. VY: U and V; LX, LY: int z dL; RX, RY:
            int z dR. Where ``lagged`` also QX, QY: int z d turn, with turn the derivative of the yaw by the lag; IX,
            IY: int e (p, q) of the derivatives. That of z is then j (turn z - Q) + I.
        lagged: whether the derivatives by the lag are wanted.
    """
    a, b = 0.5 * A[2, 0], 0.5 * A[2, 1]
    px, py, qx, qy = A[0, 0], A[1, 0], A[0, 1], A[1, 1]
    for m in range(LANES):
        dl, dr = row[m], row[LANES + m]
        c, s, x, y = state[C + m], state[S + m], state[X + m], state[Y + m]
        h = a * dl + b * dr
        h2 = h * h
        sinc = 1.0 - h2 * (1 / 6 - h2 * (1 / 120 - h2 * (1 / 5040 - h2 * (1 / 362880))))
        cos = 1.0 - h2 * (1 / 2 - h2 * (1 / 24 - h2 * (1 / 720 - h2 * (1 / 40320))))
        lean = h * (1 / 3 + h2 * (1 / 45 + h2 * (2 / 945 + h2 * (1 / 4725 + h2 * (2 / 93555)))))  # 1/h - cot h
        sin = h * sinc
        cm, sm = c * cos - s * sin, s * cos + c * sin
        state[C + m], state[S + m] = cm * cos - sm * sin, sm * cos + cm * sin
        cs, ss = sinc * cm, sinc * sm
        state[UX + m] += cs * dl
        state[UY + m] += ss * dl
        state[VX + m] += cs * dr
        state[VY + m] += ss * dr
        bx, by = px * dl + qx * dr, py * dl + qy * dr
        ux, uy = cs * bx - ss * by, ss * bx + cs * by
        state[X + m], state[Y + m] = x + ux, y + uy
        mx, my = x + 0.5 * (ux + lean * uy), y + 0.5 * (uy - lean * ux)  # mean of z over the step
        state[LX + m] += mx * dl
        state[LY + m] += my * dl
        state[RX + m] += mx * dr
        state[RY + m] += my * dr
        if lagged:
            ll, lr = row[2 * LANES + m], row[3 * LANES + m]
            lx, ly, turn = px * ll + qx * lr, py * ll + qy * lr, 2.0 * (a * ll + b * lr)
            state[IX + m] += cs * lx - ss * ly
            state[IY + m] += ss * lx + cs * ly
            state[QX + m] += mx * turn
            state[QY + m] += my * turn


@njit(cache=True)
def empty_state() -> FloatArray:
    """State of a tile, uninitialised; at the start of a cache line, for vectors that span two are slow."""
    room = np.empty(ROWS * LANES + LINE)
    first = (-room.ctypes.data // 8) % LINE
    return room[first : first + ROWS * LANES]


@njit(cache=True)
def clear(state: FloatArray) -> None:
    """Every window at its start."""
    state[:] = 0.0
    state[C : C + LANES] = 1.0


@njit(cache=True)
def longest(offsets: np.ndarray, first: int) -> int:
    """Most steps of a window in the tile from ``first``; 0 where they differ so much that lanes do not pay."""
    behind = min(first + LANES, len(offsets) - 1)
    most = 0
    for w in range(first, behind):
        most = max(most, offsets[w + 1] - offsets[w])
    return most if most * LANES <= FILLED * (offsets[behind] - offsets[first]) else 0


@njit(cache=True)
def fill(
    values: FloatArray, offsets: np.ndarray, first: int, column: int, rows: FloatArray, total: FloatArray
) -> tuple[float, float]:
    """Put the steps (s, 2) of the windows from ``first`` side by side into ``rows`` (n, ...), from ``column`` on.

    Zeros fill up shorter windows, and the lanes beyond the last window.

    Args:
        values: (s, 2).
        offsets: (k + 1,) of the windows in ``values``.
        first: window in the first lane.
        column: of ``rows``.
        rows: out, of at least as many steps as any of the windows has.
        total: out, (2 * LANES,) sums of both columns of ``values`` over each window.

    Returns:
        The largest absolute values in both columns.
    """
    reach_left = reach_right = 0.0
    for m in range(LANES):
        w, steps = first + m, 0
        left = right = 0.0
        if w < len(offsets) - 1:
            low, steps = offsets[w], offsets[w + 1] - offsets[w]
            for i in range(steps):
                dl, dr = values[low + i, 0], values[low + i, 1]
                rows[i, column + m], rows[i, column + LANES + m] = dl, dr
                left += dl
                right += dr
                reach_left, reach_right = max(reach_left, abs(dl)), max(reach_right, abs(dr))
        for i in range(steps, len(rows)):
            rows[i, column + m] = rows[i, column + LANES + m] = 0.0
        total[m], total[LANES + m] = left, right
    return reach_left, reach_right
