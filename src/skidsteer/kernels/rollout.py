"""Wheel samples to the motion of windows, with sensitivities: the inner loop of every fit and every judgement."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.se2 import FloatArray

SMALL = 0.3  # [rad] half angle below which the series of sine and cosine are exact to 1e-14


@njit(cache=True, inline="always")
def _half_rotation(h: float) -> tuple[float, float, float, float]:
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
def lag_states(t: FloatArray, v: FloatArray, lag: float, restart: FloatArray) -> tuple[FloatArray, FloatArray]:
    """State of a first-order lag behind held speeds v (n, 2) at each sample, and its derivative by the lag [s].

    The state satisfies lag * f' = v - f; ``restart`` (n,) is 1 where nothing is known of the time before: f = v there.
    """
    f, g = np.empty_like(v), np.zeros_like(v)
    for i in range(len(t)):
        if i == 0 or restart[i] == 1.0:
            f[i] = v[i]
            continue
        dt = t[i] - t[i - 1]
        decay = math.exp(-dt / lag) if lag > 0.0 else 0.0
        slope = decay * dt / lag**2 if lag > 0.0 else 0.0
        for side in range(2):
            c = f[i - 1, side] - v[i - 1, side]
            f[i, side] = v[i - 1, side] + c * decay
            g[i, side] = g[i - 1, side] * decay + c * slope
    return f, g


@njit(cache=True)
def count_steps(t: FloatArray, start: FloatArray, end: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the sample that holds at each start (k,), and the offsets (k + 1,) of the steps of each window."""
    n, k = len(t), len(start)
    first = np.empty(k, np.int64)
    offsets = np.zeros(k + 1, np.int64)
    i = 0
    for w in range(k):
        if i > 0 and t[i] > start[w]:
            i = 0
        if t[i] <= start[w] and (i + 64 < n and t[i + 64] < start[w]):
            i = np.searchsorted(t, start[w], side="right") - 1
        while i + 1 < n and t[i + 1] <= start[w]:
            i += 1
        first[w] = i
        j = i
        while j + 1 < n and t[j + 1] < end[w]:
            j += 1
        offsets[w + 1] = offsets[w] + (j - i + 1)
    return first, offsets


@njit(cache=True)
def _lagged(lag: float, s: float) -> float:
    if s <= 0.0:
        return 1.0
    return math.exp(-s / lag) if lag > 0.0 else 0.0


@njit(cache=True)
def roll(
    t: FloatArray,
    v: FloatArray,
    f: FloatArray,
    g: FloatArray,
    lag: float,
    start: FloatArray,
    end: FloatArray,
    first: np.ndarray,
    offsets: np.ndarray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distances rolled by both sides in each step (s, 2) [m], their derivative by the lag, and the durations (s,).

    A window is cut at the wheel samples. Behind a lag the speed inside a step is v + (f - v) exp(-s / lag).
    """
    n, total = len(t), offsets[-1]
    distance, by_lag, duration = np.empty((total, 2)), np.zeros((total, 2)), np.empty(total)
    for w in range(len(start)):
        i = first[w]
        for step in range(offsets[w], offsets[w + 1]):
            a = start[w] if i == first[w] else t[i]
            b = end[w] if (i + 1 >= n or t[i + 1] >= end[w]) else t[i + 1]
            duration[step] = b - a
            if lag == 0.0 and a > t[i]:
                distance[step] = v[i] * (b - a)
            else:
                ea, eb = _lagged(lag, a - t[i]), _lagged(lag, b - t[i])
                sa, sb = max(a - t[i], 0.0), b - t[i]
                bend = (ea * sa - eb * sb) / lag if lag > 0.0 else 0.0
                for side in range(2):
                    c = f[i, side] - v[i, side]
                    distance[step, side] = v[i, side] * (b - a) + c * lag * (ea - eb)
                    by_lag[step, side] = (g[i, side] * lag + c) * (ea - eb) + c * bend
            i += 1
    return distance, by_lag, duration


@njit(cache=True)
def speeds_at(t: FloatArray, v: FloatArray, f: FloatArray, lag: float, query: FloatArray) -> FloatArray:
    """Speeds (k, 2) behind the lag at the times (k,): the held sample where there is no lag."""
    out = np.empty((len(query), 2))
    for k in range(len(query)):
        i = max(np.searchsorted(t, query[k], side="right") - 1, 0)
        decay = _lagged(lag, query[k] - t[i]) if lag > 0.0 else 0.0
        for side in range(2):
            out[k, side] = v[i, side] + (f[i, side] - v[i, side]) * decay
    return out


@njit(cache=True)
def rollout(increments: FloatArray, offsets: np.ndarray) -> FloatArray:
    """Motion (k, 3) of each window from the twists times durations (s, 3) of its steps, exact on SE(2)."""
    motion = np.zeros((len(offsets) - 1, 3))
    for w in range(len(offsets) - 1):
        x = y = yaw = 0.0
        c, s = 1.0, 0.0
        for i in range(offsets[w], offsets[w + 1]):
            ch, sh, sinc, _ = _half_rotation(0.5 * increments[i, 2])
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
            ch, sh, sinc, slope = _half_rotation(0.5 * increments[i, 2])
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
def rollout_matrix(
    A: FloatArray, distance: FloatArray, by_lag: FloatArray, offsets: np.ndarray
) -> tuple[FloatArray, FloatArray]:
    """Motion (k, 3) of a model that is linear in the rim speeds, and its derivative (k, 3, 7).

    The derivative is by the six entries of A, row by row, and by the lag. With e = exp(j yaw) at the middle of a step:
    position = sum sinc e (p dl + q dr), p = A11 + j A21, q = A12 + j A22; yaw = A31 L + A32 R.
    """
    k = len(offsets) - 1
    motion, jacobian = np.zeros((k, 3)), np.zeros((k, 3, 7))
    for w in range(k):
        x = y = left = right = yaw_lag = x_lag = y_lag = 0.0
        xl = yl = xr = yr = xa = ya = xb = yb = 0.0
        c, s = 1.0, 0.0
        for i in range(offsets[w], offsets[w + 1]):
            dl, dr = distance[i, 0], distance[i, 1]
            ch, sh, sinc, slope = _half_rotation(0.5 * (A[2, 0] * dl + A[2, 1] * dr))
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
            ll, lr = by_lag[i, 0], by_lag[i, 1]
            half = 0.5 * (A[2, 0] * ll + A[2, 1] * lr)
            lx, ly = A[0, 0] * ll + A[0, 1] * lr, A[1, 0] * ll + A[1, 1] * lr
            turn = sinc * (yaw_lag + half)
            x_lag += cs * lx - ss * ly - turn * uy + slope * half * ux
            y_lag += ss * lx + cs * ly + turn * ux + slope * half * uy
            yaw_lag += 2.0 * half
        x = A[0, 0] * xl + A[0, 1] * xr - A[1, 0] * yl - A[1, 1] * yr
        y = A[0, 0] * yl + A[0, 1] * yr + A[1, 0] * xl + A[1, 1] * xr
        motion[w] = x, y, A[2, 0] * left + A[2, 1] * right
        J = jacobian[w]
        J[0, 0], J[0, 1], J[0, 2], J[0, 3], J[0, 4], J[0, 5], J[0, 6] = xl, xr, -yl, -yr, xa, xb, x_lag
        J[1, 0], J[1, 1], J[1, 2], J[1, 3], J[1, 4], J[1, 5], J[1, 6] = yl, yr, xl, xr, ya, yb, y_lag
        J[2, 4], J[2, 5], J[2, 6] = left, right, yaw_lag
    return motion, jacobian
