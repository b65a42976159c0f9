"""Wheel samples to the motion of windows, with sensitivities: the inner loop of every fit and every judgement."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.kernels import lanes
from skidsteer.se2 import FloatArray

SMALL = 0.3  # [rad] half angle below which the series of sine and cosine are exact to 1e-14


@njit(cache=True, inline="always")
def half_rotation(h: float) -> tuple[float, float, float, float]:
    """Cos(h), sin(h), sinc(h) = sin(h)/h and its derivative, without a library call for the small angles of a step."""
    h2 = h * h
    if h2 < SMALL * SMALL:
        sinc = 1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0 * (1.0 - h2 / 72.0 * (1.0 - h2 / 110.0))))
        cos = 1.0 - h2 / 2.0 * (1.0 - h2 / 12.0 * (1.0 - h2 / 30.0 * (1.0 - h2 / 56.0 * (1.0 - h2 / 90.0))))
        slope = -h / 3.0 * (1.0 - h2 / 10.0 * (1.0 - h2 / 28.0 * (1.0 - h2 / 54.0 * (1.0 - h2 / 88.0))))
        return cos, h * sinc, sinc, slope
    sin, cos = math.sin(h), math.cos(h)
    return cos, sin, sin / h, (cos - sin / h) / h


@njit(cache=True)
def rollout(increments: FloatArray, offsets: np.ndarray) -> FloatArray:
    """Motion (k, 3) of each window from the twists times durations (s, 3) of its steps, exact on SE(2)."""
    motion = np.zeros((len(offsets) - 1, 3))
    for w in range(len(offsets) - 1):
        x = y = yaw = 0.0
        c, s = 1.0, 0.0
        for i in range(offsets[w], offsets[w + 1]):
            ch, sh, sinc, _ = half_rotation(0.5 * increments[i, 2])
            cm, sm = c * ch - s * sh, s * ch + c * sh
            dx, dy = sinc * increments[i, 0], sinc * increments[i, 1]
            x += cm * dx - sm * dy
            y += sm * dx + cm * dy
            yaw += increments[i, 2]
            c, s = cm * ch - sm * sh, sm * ch + cm * sh
        motion[w] = x, y, yaw
    return motion


@njit(cache=True)
def rollout_sensitivities(
    increments: FloatArray, by_parameter: FloatArray, offsets: np.ndarray
) -> tuple[FloatArray, FloatArray]:
    """As ``rollout``, with the derivative (k, 3, p) from that of the increments (s, 3, p)."""
    k, p = len(offsets) - 1, by_parameter.shape[2]
    motion, jacobian = np.zeros((k, 3)), np.zeros((k, 3, p))
    for w in range(k):
        x = y = yaw = 0.0
        c, s = 1.0, 0.0
        J = jacobian[w]
        for i in range(offsets[w], offsets[w + 1]):
            ch, sh, sinc, slope = half_rotation(0.5 * increments[i, 2])
            cm, sm = c * ch - s * sh, s * ch + c * sh
            ux, uy = cm * increments[i, 0] - sm * increments[i, 1], sm * increments[i, 0] + cm * increments[i, 1]
            for m in range(p):
                dx, dy, half = by_parameter[i, 0, m], by_parameter[i, 1, m], 0.5 * by_parameter[i, 2, m]
                turn = sinc * (J[2, m] + half)
                J[0, m] += sinc * (cm * dx - sm * dy) - turn * uy + slope * half * ux
                J[1, m] += sinc * (sm * dx + cm * dy) + turn * ux + slope * half * uy
                J[2, m] += 2.0 * half
            x += sinc * ux
            y += sinc * uy
            yaw += increments[i, 2]
            c, s = cm * ch - sm * sh, sm * ch + cm * sh
        motion[w] = x, y, yaw
    return motion, jacobian


@njit(cache=True)
def _one_window(
    A: FloatArray, distance: FloatArray, by_lag: FloatArray, low: int, high: int, motion: FloatArray, J: FloatArray
) -> None:
    """Motion (3,) over the steps from low to high, and its derivative (3, 7); see ``rollout_matrix``.

    With e = exp(j yaw) at the middle of a step: position = sum sinc e (p dl + q dr), p = A11 + j A21, q = A12 + j A22;
    yaw = A31 L + A32 R.
    """
    x = y = left = right = yaw_lag = x_lag = y_lag = 0.0
    xl = yl = xr = yr = xa = ya = xb = yb = 0.0
    c, s = 1.0, 0.0
    for i in range(low, high):
        dl, dr = distance[i, 0], distance[i, 1]
        ch, sh, sinc, slope = half_rotation(0.5 * (A[2, 0] * dl + A[2, 1] * dr))
        cm, sm = c * ch - s * sh, s * ch + c * sh
        c, s = cm * ch - sm * sh, sm * ch + cm * sh
        cs, ss = sinc * cm, sinc * sm
        xl += cs * dl
        yl += ss * dl
        xr += cs * dr
        yr += ss * dr
        bx, by = A[0, 0] * dl + A[0, 1] * dr, A[1, 0] * dl + A[1, 1] * dr
        ux, uy = cm * bx - sm * by, sm * bx + cm * by
        turn_l, turn_r = sinc * (left + 0.5 * dl), sinc * (right + 0.5 * dr)
        xa += -turn_l * uy + 0.5 * slope * dl * ux
        ya += turn_l * ux + 0.5 * slope * dl * uy
        xb += -turn_r * uy + 0.5 * slope * dr * ux
        yb += turn_r * ux + 0.5 * slope * dr * uy
        left += dl
        right += dr
        ll, lr = (by_lag[i, 0], by_lag[i, 1]) if len(by_lag) else (0.0, 0.0)
        half = 0.5 * (A[2, 0] * ll + A[2, 1] * lr)
        lx, ly = A[0, 0] * ll + A[0, 1] * lr, A[1, 0] * ll + A[1, 1] * lr
        turn = sinc * (yaw_lag + half)
        x_lag += cs * lx - ss * ly - turn * uy + slope * half * ux
        y_lag += ss * lx + cs * ly + turn * ux + slope * half * uy
        yaw_lag += 2.0 * half
    x = A[0, 0] * xl + A[0, 1] * xr - A[1, 0] * yl - A[1, 1] * yr
    y = A[0, 0] * yl + A[0, 1] * yr + A[1, 0] * xl + A[1, 1] * xr
    motion[0], motion[1], motion[2] = x, y, A[2, 0] * left + A[2, 1] * right
    J[0, 0], J[0, 1], J[0, 2], J[0, 3], J[0, 4], J[0, 5], J[0, 6] = xl, xr, -yl, -yr, xa, xb, x_lag
    J[1, 0], J[1, 1], J[1, 2], J[1, 3], J[1, 4], J[1, 5], J[1, 6] = yl, yr, xl, xr, ya, yb, y_lag
    J[2, 0] = J[2, 1] = J[2, 2] = J[2, 3] = 0.0
    J[2, 4], J[2, 5], J[2, 6] = left, right, yaw_lag


@njit(cache=True)
def _store(A: FloatArray, state: FloatArray, m: int, motion: FloatArray, J: FloatArray) -> None:
    """Motion (3,) and derivative (3, 7) of the window in lane m of a tile."""
    x, y = state[lanes.X + m], state[lanes.Y + m]
    left, right = state[lanes.TOTAL + m], state[lanes.TOTAL + lanes.LANES + m]
    ux, uy, vx, vy = state[lanes.UX + m], state[lanes.UY + m], state[lanes.VX + m], state[lanes.VY + m]
    turn = A[2, 0] * state[lanes.LAG_TOTAL + m] + A[2, 1] * state[lanes.LAG_TOTAL + lanes.LANES + m]
    motion[0], motion[1], motion[2] = x, y, A[2, 0] * left + A[2, 1] * right
    J[0, 0], J[0, 1], J[0, 2], J[0, 3] = ux, vx, -uy, -vy
    J[1, 0], J[1, 1], J[1, 2], J[1, 3] = uy, vy, ux, vx
    J[0, 4], J[0, 5] = state[lanes.LY + m] - left * y, state[lanes.RY + m] - right * y
    J[1, 4], J[1, 5] = left * x - state[lanes.LX + m], right * x - state[lanes.RX + m]
    J[0, 6] = state[lanes.IX + m] + state[lanes.QY + m] - turn * y
    J[1, 6] = state[lanes.IY + m] - state[lanes.QX + m] + turn * x
    J[2, 0] = J[2, 1] = J[2, 2] = J[2, 3] = 0.0
    J[2, 4], J[2, 5], J[2, 6] = left, right, turn


@njit(cache=True)
def _roll_tile(
    A: FloatArray,
    distance: FloatArray,
    by_lag: FloatArray,
    offsets: np.ndarray,
    first: int,
    state: FloatArray,
    tile: FloatArray,
    motion: FloatArray,
    J: FloatArray,
) -> None:
    """Motion (m, 3) and derivative (m, 3, 7) of the m windows of a tile: side by side, or one by one where they cannot.

    ``state`` and ``tile`` (longest window, 4 * LANES) are room to work in.
    """
    wide, steps = 2 * lanes.LANES, lanes.longest(offsets, first)
    rows, total = tile[:steps], state[lanes.TOTAL : lanes.TOTAL + wide]
    lanes.clear(state)
    left, right = lanes.fill(distance, offsets, first, 0, rows, total) if steps > 0 else (np.inf, np.inf)
    if not 0.5 * (abs(A[2, 0]) * left + abs(A[2, 1]) * right) < lanes.LIMIT:
        for m in range(len(motion)):
            _one_window(A, distance, by_lag, offsets[first + m], offsets[first + m + 1], motion[m], J[m])
        return
    lagged = len(by_lag) > 0
    if lagged:
        lanes.fill(by_lag, offsets, first, wide, rows, state[lanes.LAG_TOTAL : lanes.LAG_TOTAL + wide])
    for i in range(steps):
        lanes.advance(A, rows[i], state, lagged)
    for m in range(len(motion)):
        _store(A, state, m, motion[m], J[m])


@njit(cache=True)
def _room(offsets: np.ndarray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """State, tile and derivatives for ``_roll_tile``."""
    steps = 0
    for first in range(0, len(offsets) - 1, lanes.LANES):
        steps = max(steps, lanes.longest(offsets, first))
    return lanes.empty_state(), np.empty((steps, 4 * lanes.LANES)), np.empty((lanes.LANES, 3, 7))


@njit(cache=True)
def rollout_matrix(
    A: FloatArray, distance: FloatArray, by_lag: FloatArray, offsets: np.ndarray, motion: FloatArray, J: FloatArray
) -> None:
    """Motion of a model that is linear in the rim speeds, and its derivative.

    Args:
        A: (3, 2) of the model.
        distance: (s, 2) [m] rolled by the left and the right side in each step.
        by_lag: (s, 2) [m/s] its derivative by the lag; or (0, 2): taken as zero.
        offsets: (k + 1,) steps offsets[i]:offsets[i + 1] belong to window i.
        motion: out, (k, 3).
        J: out, (k, 3, 7) derivative by the six entries of A, row by row, and by the lag; or (0, 3, 7): not wanted.
    """
    k = len(offsets) - 1
    state, tile, scratch = _room(offsets)
    for first in range(0, k, lanes.LANES):
        behind = min(first + lanes.LANES, k)
        out = J[first:behind] if len(J) else scratch
        _roll_tile(A, distance, by_lag, offsets, first, state, tile, motion[first:behind], out)


@njit(cache=True)
def linearize_matrix(
    A: FloatArray,
    C: FloatArray,
    distance: FloatArray,
    by_lag: FloatArray,
    offsets: np.ndarray,
    start: FloatArray,
    end: FloatArray,
    motion: FloatArray,
    out: FloatArray,
) -> None:
    """As ``rollout_matrix``, with the derivative by the parameters of the model, the time offset and the lag.

    Args:
        A: (3, 2) of the model.
        C: (6, p) derivative of its entries, row by row, by the parameters.
        distance: as for ``rollout_matrix``.
        by_lag: as for ``rollout_matrix``.
        offsets: as for ``rollout_matrix``.
        start: (k, 3) body twist at the start.
        end: (k, 3) body twist at the end.
        motion: out, (k, 3).
        out: out, (k, 3, p + 2).
    """
    k, p = len(offsets) - 1, C.shape[1]
    state, tile, scratch = _room(offsets)
    for first in range(0, k, lanes.LANES):
        behind = min(first + lanes.LANES, k)
        _roll_tile(A, distance, by_lag, offsets, first, state, tile, motion[first:behind], scratch)
        for w in range(first, behind):
            for i in range(3):
                J = scratch[w - first, i]
                for m in range(p):
                    by_yaw = J[4] * C[4, m] + J[5] * C[5, m]
                    out[w, i, m] = J[0] * C[0, m] + J[1] * C[1, m] + J[2] * C[2, m] + J[3] * C[3, m] + by_yaw
                out[w, i, p + 1] = J[6]
            _slide(motion[w], start[w], end[w], out[w, :, p])


@njit(cache=True)
def _slide(motion: FloatArray, start: FloatArray, end: FloatArray, out: FloatArray) -> None:
    """Derivative (3,) of a motion (3,) by the time offset: a shifted window gains at one end and loses at the other.

    From T(a, b): dT/db is the body twist at b turned by the yaw of T, dT/da is minus that at a, moved to the end.
    """
    c, s = math.cos(motion[2]), math.sin(motion[2])
    out[0] = start[0] - start[2] * motion[1] - (c * end[0] - s * end[1])
    out[1] = start[1] + start[2] * motion[0] - (s * end[0] + c * end[1])
    out[2] = start[2] - end[2]


@njit(cache=True)
def slide(motion: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Derivative (k, 3) of motions (k, 3) by the time offset, from the body twists (k, 3) at both ends."""
    out = np.empty_like(motion)
    for w in range(len(motion)):
        _slide(motion[w], start[w], end[w], out[w])
    return out
