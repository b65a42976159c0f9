"""A plan over a horizon of stages: differential dynamic programming with a bounded input.

After Tassa, Mansard, Todorov 2014 (ICRA, "Control-limited differential dynamic programming"), without the second
derivatives of the motion (Gauss-Newton). Each plan is a simulated one, no worse than the one it began with: it can be
driven whether or not the search has come to rest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from skidsteer.kernels import stage
from skidsteer.kernels.stage import EFFORT, END, ROW, SPEED_ASKED, STEERED, STEP, U
from skidsteer.se2 import FloatArray

SHARES = (1.0, 0.4, 0.16, 0.064)  # of a step, tried one after the other until the cost falls
UNKNOWN = -1  # no finite cost


class Road(NamedTuple):
    """What is driven on: the knots of a path, whether it is closed, the speeds (m,) from its one end to the other."""

    knots: FloatArray
    closed: bool
    profile: FloatArray


class Course(NamedTuple):
    """A simulated plan."""

    u: FloatArray  # (n,) [rad/s^2]
    rows: FloatArray  # (n + 1, 9)
    D: FloatArray  # (n, 6, 7)
    bounds: FloatArray  # (n, 2)
    wanted: FloatArray  # (n,)


class Change(NamedTuple):
    """How to change a plan: steps (n,) of u, and feedback (n, 6) of rows that come out otherwise."""

    steps: FloatArray
    feedback: FloatArray


@njit(cache=True)
def _course(n: int) -> Course:
    room = np.zeros((n + 1, ROW)), np.zeros((n, STEERED, STEERED + 1)), np.zeros((n, 2)), np.zeros(n)
    return Course(np.zeros(n), *room)


@njit(cache=True)
def _roll(
    start: FloatArray,
    body: FloatArray,
    weights: FloatArray,
    road: Road,
    old: Course,
    change: Change,
    share: float,
    new: Course,
) -> float:
    """Simulate the old plan with a share of a change into a new one, and tell its cost."""
    at, h = np.empty(5), body[STEP]
    length = road.knots[-1, 0]
    new.rows[0] = start
    total = 0.0
    for j in range(len(old.u)):
        row, after = new.rows[j], new.rows[j + 1]
        stage.ask_speed(row, body, road.profile, length, road.closed, after)
        stage.bounds(row, after[SPEED_ASKED], body, new.bounds[j])
        u = old.u[j] + share * change.steps[j]
        for k in range(STEERED):
            u += change.feedback[j, k] * (row[k] - old.rows[j, k])
        u = min(max(u, new.bounds[j, 0]), new.bounds[j, 1])
        stage.move(row, u, body, road.knots, road.closed, at, after, new.D[j])
        growth = (after[SPEED_ASKED] - row[SPEED_ASKED]) / h
        new.u[j], new.wanted[j] = u, stage.wanted(after, growth, body, road.knots, road.closed, at)
        total += h * (stage.cost(after, body, weights) + weights[EFFORT] * (u - new.wanted[j]) ** 2)
    return float(total + weights[END] * stage.cost(new.rows[-1], body, weights))


@njit(cache=True)
def _improve(body: FloatArray, weights: FloatArray, course: Course, change: Change) -> float:
    """Fill the change that lowers the cost, from the end to the beginning; how much it should, to first order."""
    n, h = len(course.u), body[STEP]
    G, H = np.zeros(STEERED), np.zeros((STEERED, STEERED))
    g, Q = np.empty(STEERED + 1), np.empty((STEERED + 1, STEERED + 1))
    stage.add_cost(course.rows[n], body, weights, weights[END], G, H)
    gain = 0.0
    for j in range(n - 1, -1, -1):
        stage.add_cost(course.rows[j + 1], body, weights, h, G, H)
        _expand(course.D[j], G, H, g, Q)
        effort = 2.0 * h * weights[EFFORT]
        g[U] += effort * (course.u[j] - course.wanted[j])
        Q[U, U] += effort
        low, high = course.bounds[j, 0] - course.u[j], course.bounds[j, 1] - course.u[j]
        step = -g[U] / Q[U, U]
        free = low < step < high
        step = min(max(step, low), high)
        change.steps[j] = step
        gain -= step * g[U]
        for k in range(STEERED):
            change.feedback[j, k] = -Q[U, k] / Q[U, U] if free else 0.0
        for r in range(STEERED):  # what is left to pay from here on, with the input put in
            G[r] = g[r] + Q[U, r] * step + change.feedback[j, r] * (g[U] + Q[U, U] * step)
            for k in range(STEERED):
                H[r, k] = Q[r, k] + change.feedback[j, r] * Q[U, k]
    return gain


@njit(cache=True)
def _expand(F: FloatArray, G: FloatArray, H: FloatArray, g: FloatArray, Q: FloatArray) -> None:
    """Gradient g (7,) = F' G and matrix Q (7, 7) = F' H F of what is left to pay, by row and input of a stage."""
    HF = np.empty((STEERED, STEERED + 1))
    for r in range(STEERED):
        for k in range(STEERED + 1):
            total = 0.0
            for i in range(STEERED):
                total += H[r, i] * F[i, k]
            HF[r, k] = total
    for r in range(STEERED + 1):
        total = 0.0
        for i in range(STEERED):
            total += F[i, r] * G[i]
        g[r] = total
        for k in range(r + 1):
            total = 0.0
            for i in range(STEERED):
                total += F[i, r] * HF[i, k]
            Q[r, k] = Q[k, r] = total


@njit(cache=True)
def plan(
    start: FloatArray,
    u: FloatArray,
    body: FloatArray,
    weights: FloatArray,
    knots: FloatArray,
    closed: bool,
    profile: FloatArray,
    iterations: int,
    tolerance: float,
    rows: FloatArray,
) -> int:
    """Improve a plan.

    Args:
        start: (9,) row, see ``kernels.stage``.
        u: in and out, (n,) [rad/s^2] rate of the yaw rate asked for, in each stage.
        body: numbers of the robot, see ``kernels.stage``.
        weights: of the cost, see there.
        knots: of the path, see ``kernels.paths``.
        closed: whether the path is.
        profile: (m,) [m/s] from its one end to the other.
        iterations: at most.
        tolerance: share of the cost that a further iteration must promise to save.
        rows: out, (n + 1, 9).

    Returns:
        Iterations that lowered the cost; ``UNKNOWN`` where there is no finite one, with u as it was.
    """
    road, n = Road(knots, closed, profile), len(u)
    best, new, change = _course(n), _course(n), Change(np.zeros(n), np.zeros((n, STEERED)))
    first = _course(n)
    first.u[:] = u
    least = _roll(start, body, weights, road, first, change, 0.0, best)
    rows[:] = best.rows
    if not math.isfinite(least):
        return UNKNOWN
    done = 0
    while done < iterations and _improve(body, weights, best, change) > tolerance * least:
        found = False
        for share in SHARES:
            total = _roll(start, body, weights, road, best, change, share, new)
            if total < least:
                found = True
                break
        if not found:
            break
        best, new, least = new, best, total
        done += 1
    u[:], rows[:] = best.u, best.rows
    return done
