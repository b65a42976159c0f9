"""The wheel log cut at the ends of windows: what each side rolled in each step, after a first-order lag."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.se2 import FloatArray

MEMORY = 40.0  # lags after which the past is forgotten: exp(-40) is below rounding


@njit(cache=True)
def count_gaps(t: FloatArray, longest: float) -> int:
    """How many neighbours in t (n,) [s] are further apart than ``longest`` [s]."""
    count = 0
    for i in range(len(t) - 1):
        count += t[i + 1] - t[i] > longest
    return count


@njit(cache=True)
def _locate(t: FloatArray, query: float, guess: int) -> int:
    """Last index with t <= query, or 0: steps that double from the guess, then halving."""
    n = len(t)
    low = min(max(guess, 0), n - 1)
    high, reach = low + 1, 1
    while low > 0 and t[low] > query:
        high = low
        low = max(low - reach, 0)
        reach *= 2
    while high < n and t[high] <= query:
        low = high
        high = min(high + reach, n)
        reach *= 2
    while high - low > 1:
        middle = (low + high) // 2
        if t[middle] <= query:
            low = middle
        else:
            high = middle
    return low


@njit(cache=True)
def count_steps(t: FloatArray, start: FloatArray, end: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the sample that holds at each start (k,), and the offsets (k + 1,) of the steps of each window."""
    k = len(start)
    first, offsets = np.empty(k, np.int64), np.zeros(k + 1, np.int64)
    at, rate = 0, 0.0  # [1/s] of the samples in the window before: where to look for the end of the next
    for w in range(k):
        i = _locate(t, start[w], at)
        at = _locate(t, end[w], i + int(rate * (end[w] - start[w])))
        if t[at] >= end[w]:
            at -= 1
        at = max(at, i)
        first[w] = i
        offsets[w + 1] = offsets[w] + (at - i + 1)
        rate = (at - i) / (t[at] - t[i]) if at > i else 0.0
    return first, offsets


@njit(cache=True)
def roll_held(
    t: FloatArray,
    v: FloatArray,
    restart: np.ndarray,
    start: FloatArray,
    end: FloatArray,
    first: np.ndarray,
    offsets: np.ndarray,
    distance: FloatArray,
    by_lag: FloatArray,
    duration: FloatArray,
    start_speeds: FloatArray,
    end_speeds: FloatArray,
) -> None:
    """As ``roll_lagged`` for a lag of zero: the speed is that of the sample held, the derivative that by a lag above 0.

    A lag takes effect in the step that begins with a sample: there the speed of the sample before fades away.
    """
    n, slopes = len(t), len(by_lag) > 0
    for w in range(len(start)):
        low, high, i = offsets[w], offsets[w + 1], first[w]
        shift = i - low
        for s in range(low, high):
            a = t[s + shift] if s > low else start[w]
            b = t[s + shift + 1] if s < high - 1 else end[w]
            duration[s] = b - a
            distance[s, 0] = v[s + shift, 0] * (b - a)
            distance[s, 1] = v[s + shift, 1] * (b - a)
        if slopes:
            for s in range(low, high):
                m = s + shift
                moves = (s > low or start[w] <= t[m]) and (s < high - 1 or end[w] > t[m])
                before = m - 1 if m > 0 and moves and not restart[m] else m
                by_lag[s, 0] = v[before, 0] - v[m, 0]
                by_lag[s, 1] = v[before, 1] - v[m, 1]
        last = high - 1 + shift
        if last + 1 < n and t[last + 1] <= end[w]:
            last += 1
        start_speeds[w] = v[i]
        end_speeds[w] = v[last]


@njit(cache=True, inline="always")
def _decay(x: float, known: float, its_decay: float) -> tuple[float, float, float]:
    """exp(-x), by a series about a known one where x is near it: clocks are nearly regular. And the one now known."""
    d = x - known
    if abs(d) < 0.01:  # exact to 2e-15
        near = 1.0 - d * (1.0 - d / 2.0 * (1.0 - d / 3.0 * (1.0 - d / 4.0 * (1.0 - d / 5.0))))
        return its_decay * near, known, its_decay
    exact = math.exp(-x)
    return exact, x, exact


@njit(cache=True)
def roll_lagged(
    t: FloatArray,
    v: FloatArray,
    restart: np.ndarray,
    lag: float,
    start: FloatArray,
    end: FloatArray,
    first: np.ndarray,
    offsets: np.ndarray,
    distance: FloatArray,
    by_lag: FloatArray,
    duration: FloatArray,
    start_speeds: FloatArray,
    end_speeds: FloatArray,
) -> None:
    """Cut windows at the wheel samples: what the body follows in each step behind a first-order lag above zero.

    The state f behind the lag satisfies lag * f' = v - f, so that inside a step it is v + (f - v) exp(-s / lag). It is
    carried from window to window; where one begins before, or long after, it starts ``MEMORY`` lags earlier.

    Args:
        t: (n,) [s] of the samples.
        v: (n, 2) [m/s] held from sample to sample.
        restart: (n,) bool: nothing is known of the time before the sample, f = v.
        lag: [s], above zero.
        start: (k,) [s] of the windows.
        end: (k,) [s].
        first: (k,) from ``count_steps``.
        offsets: (k + 1,) from ``count_steps``.
        distance: out, (s, 2) [m] rolled in each step.
        by_lag: out, (s, 2) [m/s] its derivative by the lag; or (0, 2): not wanted.
        duration: out, (s,) [s].
        start_speeds: out, (k, 2) [m/s] behind the lag at the start.
        end_speeds: out, (k, 2) [m/s] at the end.
    """
    n, slopes, rate = len(t), len(by_lag) > 0, 1.0 / lag
    # At sample ``at``: c, the state less the speed held; g, the derivative of the state by log(lag); [m/s]
    at, cl, cr, gl, gr = n, 0.0, 0.0, 0.0, 0.0
    known, its_decay = 0.0, 1.0
    for w in range(len(start)):
        i, low, high = first[w], offsets[w], offsets[w + 1]
        if at > i or (t[i] - t[at]) * rate > MEMORY:
            at = _locate(t, t[i] - MEMORY * lag, min(at, i))
            cl, cr, gl, gr = 0.0, 0.0, 0.0, 0.0
        s, since, before, x, decay = low, 0.0, 1.0, 0.0, 1.0
        while True:
            last = s == high - 1
            if at == i and s == low:
                since = max(start[w] - t[i], 0.0) * rate
                before = math.exp(-since)
                start_speeds[w, 0], start_speeds[w, 1] = v[i, 0] + cl * before, v[i, 1] + cr * before
            if at >= i:
                a, b = (t[at] if s > low else start[w]), (end[w] if last else t[at + 1])
                x = max(b - t[at], 0.0) * rate
                decay, known, its_decay = _decay(x, known, its_decay)
                lost, bend = before - decay, before * since - decay * x
                duration[s] = b - a
                distance[s, 0] = v[at, 0] * (b - a) + cl * lag * lost
                distance[s, 1] = v[at, 1] * (b - a) + cr * lag * lost
                if slopes:
                    by_lag[s, 0] = (gl + cl) * lost + cl * bend
                    by_lag[s, 1] = (gr + cr) * lost + cr * bend
                if last:
                    break
                since, before = 0.0, 1.0
                s += 1
            else:
                x = (t[at + 1] - t[at]) * rate
                decay, known, its_decay = _decay(x, known, its_decay)
            kept = 0.0 if restart[at + 1] else 1.0
            gl, gr = kept * decay * (gl + cl * x), kept * decay * (gr + cr * x)
            cl = kept * (v[at, 0] - v[at + 1, 0] + cl * decay)
            cr = kept * (v[at, 1] - v[at + 1, 1] + cr * decay)
            at += 1
        anew = at + 1 < n and t[at + 1] <= end[w] and restart[at + 1]
        end_speeds[w, 0] = v[at + 1, 0] if anew else v[at, 0] + cl * decay
        end_speeds[w, 1] = v[at + 1, 1] if anew else v[at, 1] + cr * decay


STRAIGHT = 0.1  # share of the distance rolled straight that counts for the error of the yaw


@njit(cache=True, inline="always")
def yaw_path(left: float, right: float) -> float:
    """Distance [m] with which the error of the yaw grows: how far the sides roll apart, and a share of the rest."""
    rolled, apart = 0.5 * (abs(left) + abs(right)), 0.5 * abs(right - left)
    return apart + STRAIGHT * (rolled - apart)


@njit(cache=True)
def paths(distance: FloatArray, offsets: np.ndarray) -> FloatArray:
    """Distances (k, 2) [m] of windows: the mean of what both sides roll (s, 2) [m] either way, and ``yaw_path``."""
    out = np.zeros((len(offsets) - 1, 2))
    for w in range(len(out)):
        for i in range(offsets[w], offsets[w + 1]):
            left, right = distance[i, 0], distance[i, 1]
            out[w, 0] += 0.5 * (abs(left) + abs(right))
            out[w, 1] += yaw_path(left, right)
    return out
