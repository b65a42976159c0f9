"""Points of a path and the nearest of them: a path is a row of clothoid pieces, see ``skidsteer.paths``.

A row of ``knots`` is s, x, y, yaw, curvature and its slope: the piece that begins there has the curvature
kappa + slope u at u metres behind its beginning, up to the next knot.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.se2 import FloatArray

NODES, WEIGHTS = (0.5 * (np.polynomial.legendre.leggauss(5)[0] + 1.0), 0.5 * np.polynomial.legendre.leggauss(5)[1])
STEPS = 60  # of the search between two knots; bisection alone would need 50


@njit(cache=True)
def _piece(knots: FloatArray, s: float) -> int:
    """Number of the piece that holds s; the first or last one beyond the ends."""
    low, high = 0, len(knots) - 2
    while low < high:
        middle = (low + high + 1) // 2
        if knots[middle, 0] <= s:
            low = middle
        else:
            high = middle - 1
    return low


@njit(cache=True)
def _on_piece(knots: FloatArray, i: int, u: float, out: FloatArray) -> None:
    """x, y, yaw, curvature, slope at u [m] behind knot i."""
    yaw, curvature, slope = knots[i, 3], knots[i, 4], knots[i, 5]
    dx, dy = 0.0, 0.0
    for k in range(len(NODES)):
        v = u * NODES[k]
        angle = yaw + v * (curvature + 0.5 * slope * v)
        dx += WEIGHTS[k] * math.cos(angle)
        dy += WEIGHTS[k] * math.sin(angle)
    out[0], out[1] = knots[i, 1] + u * dx, knots[i, 2] + u * dy
    out[2], out[3], out[4] = yaw + u * (curvature + 0.5 * slope * u), curvature + slope * u, slope


@njit(cache=True)
def point(knots: FloatArray, closed: bool, s: float, out: FloatArray) -> None:
    """x, y, yaw, curvature, slope at s: lap after lap if closed, straight on beyond the ends if not."""
    length, last = knots[-1, 0], len(knots) - 1
    if closed:
        lap = math.floor(s / length)
        rest = s - lap * length
        i = _piece(knots, rest)
        _on_piece(knots, i, rest - knots[i, 0], out)
        out[2] += lap * (knots[last, 3] - knots[0, 3])
    elif 0.0 <= s <= length:
        i = _piece(knots, s)
        _on_piece(knots, i, s - knots[i, 0], out)
    else:
        end, over = (0, s) if s < 0.0 else (last, s - length)
        out[0] = knots[end, 1] + over * math.cos(knots[end, 3])
        out[1] = knots[end, 2] + over * math.sin(knots[end, 3])
        out[2], out[3], out[4] = knots[end, 3], 0.0, 0.0


@njit(cache=True)
def frame(knots: FloatArray, closed: bool, s: float) -> tuple[float, float, float, float, float]:
    """``point`` as plain numbers."""
    out = np.empty(5)
    point(knots, closed, s, out)
    return out[0], out[1], out[2], out[3], out[4]


@njit(cache=True)
def points(knots: FloatArray, closed: bool, s: FloatArray, out: FloatArray) -> None:
    """Points (m, 5) at each of s (m,)."""
    for k in range(len(s)):
        point(knots, closed, s[k], out[k])


@njit(cache=True)
def _ahead(knots: FloatArray, closed: bool, s: float, x: float, y: float, at: FloatArray) -> float:
    """How far (x, y) lies ahead of the point at s, along the tangent there."""
    point(knots, closed, s, at)
    return float((x - at[0]) * math.cos(at[2]) + (y - at[1]) * math.sin(at[2]))


@njit(cache=True)
def _nearest_knot(knots: FloatArray, closed: bool, x: float, y: float, low: float, high: float) -> float:
    """The s in [low, high] of the knot nearest to (x, y), or ``low`` where there is none."""
    length, last = knots[-1, 0], len(knots) - 1
    lap = math.floor(low / length) * length if closed else 0.0
    i = _piece(knots, low - lap)
    best, least = low, math.inf
    while lap + knots[i, 0] <= high:
        s = lap + knots[i, 0]
        far = (knots[i, 1] - x) ** 2 + (knots[i, 2] - y) ** 2
        if far < least and s >= low:
            best, least = s, far
        i += 1
        if i > last or (closed and i == last):
            if not closed:
                break
            i, lap = 0, lap + length
    return best


@njit(cache=True)
def nearest(knots: FloatArray, closed: bool, x: float, y: float, low: float, high: float) -> float:
    """The s in [low, high] whose point is nearest to (x, y): the nearest knot, then Newton steps in a bracket."""
    at = np.empty(5)
    length = knots[-1, 0]
    knot = _nearest_knot(knots, closed, x, y, low, high)
    rest = knot - math.floor(knot / length) * length if closed else knot
    i = _piece(knots, rest)
    if rest >= knots[i + 1, 0]:  # the last one
        i += 1
    before = knots[i, 0] - knots[i - 1, 0] if i > 0 else knots[-1, 0] - knots[-2, 0]
    after = knots[i + 1, 0] - knots[i, 0] if i < len(knots) - 1 else 0.0
    a, b = float(max(low, knot - before)), float(min(high, knot + after))
    if _ahead(knots, closed, a, x, y, at) <= 0.0:
        return a
    if _ahead(knots, closed, b, x, y, at) >= 0.0:
        return b
    s = float(min(max(knot, a), b))
    for _ in range(STEPS):
        ahead = _ahead(knots, closed, s, x, y, at)
        if ahead > 0.0:
            a = s
        else:
            b = s
        aside = (y - at[1]) * math.cos(at[2]) - (x - at[0]) * math.sin(at[2])
        slope = 1.0 - at[3] * aside  # Newton's step is ahead / slope
        step = s + ahead / slope if slope > 1e-3 else a - 1.0
        new = step if a < step < b else 0.5 * (a + b)
        if abs(new - s) < 1e-12 * (1.0 + abs(s)):
            return float(new)
        s = float(new)
    return s


@njit(cache=True)
def project(knots: FloatArray, closed: bool, x: float, y: float, near: float, window: float) -> float:
    """The s of the nearest point within a window [m] to either side of ``near``, or else of the whole path.

    The whole is searched where ``near`` is NaN, where the nearest point lies at the edge of the window, and where a
    closed path is no longer than the window; then s lies in the lap about ``near``.
    """
    length = knots[-1, 0]
    known = not math.isnan(near)
    if known and closed and 2.0 * window < length:
        low, high = near - window, near + window
        s = nearest(knots, closed, x, y, low, high)
        if low < s < high:
            return float(s)
    elif known and not closed:
        middle = min(max(near, 0.0), length)
        low, high = max(middle - window, 0.0), min(middle + window, length)
        s = nearest(knots, closed, x, y, low, high)
        if (s > low or low == 0.0) and (s < high or high == length):
            return float(s)
    s = nearest(knots, closed, x, y, 0.0, length)
    if known and closed:
        s += length * round((near - s) / length)
    return float(s)


@njit(cache=True)
def ahead(
    knots: FloatArray, closed: bool, s: float, last: float, x: float, y: float, distance: float, steps: int
) -> tuple[float, float]:
    """From (x, y) to the first point of the path, from s on, that is a distance away; of the chords of its steps.

    The path is looked at every ``distance / steps`` for twice the distance, and up to ``last``. Where it begins farther
    away it is the point at s, where none is so far away the last one looked at.
    """
    at = np.empty(5)
    near_x, near_y = 0.0, 0.0
    for k in range(2 * steps + 1):
        point(knots, closed, min(s + k * distance / steps, last), at)
        dx, dy = at[0] - x, at[1] - y
        rest = distance**2 - dx * dx - dy * dy
        if rest <= 0.0 and k == 0:
            return dx, dy
        if rest <= 0.0:  # the chord from within a circle about (x, y) crosses it
            leg_x, leg_y = dx - near_x, dy - near_y
            half, within = near_x * leg_x + near_y * leg_y, distance**2 - near_x**2 - near_y**2
            share = within / (half + math.sqrt(half**2 + (leg_x**2 + leg_y**2) * within))
            return near_x + share * leg_x, near_y + share * leg_y
        near_x, near_y = dx, dy
    return near_x, near_y
