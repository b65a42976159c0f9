"""A whole log through the filter of ``kernels.icr_filter``, and back again: batch replay and smoothing."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from skidsteer.kernels.icr_filter import (
    ACCEPTED_FLAG,
    ANCHORED_FLAG,
    GYRO_SCALE,
    LEFT,
    LONGEST,
    RIGHT,
    SINCE,
    UNUSED_FLAG,
    Scratch,
    Setup,
    predict,
    scratch,
    unpacked,
)
from skidsteer.kernels.icr_update import backward, cholesky, forward, update_reference, update_yaw_rate
from skidsteer.se2 import FloatArray

STANDSTILL, POSITION, POSE = 0, 2, 3  # kinds of measurement, by how many numbers they tell


class Told(NamedTuple):
    """Measurements in the order of time."""

    when: FloatArray  # (m,) [s]
    kind: np.ndarray  # (m,) ``POSE``, ``POSITION`` or ``STANDSTILL``
    seen: FloatArray  # (m, 3)
    covariance: FloatArray  # (m, 3, 3)
    stamp: FloatArray  # (m,) [s]
    mount: FloatArray  # (m, 3)


class Nodes(NamedTuple):
    """The state at the end of each step, and what the step was; the first is the start."""

    step: FloatArray  # (s, 6): time, rim speeds (NaN: unknown), dt, rate of the gyro (NaN: none), 1 if anchored
    x: FloatArray  # (s, n)
    P: FloatArray  # (s, n, n)
    memory: FloatArray  # (s, m)


@njit(cache=True, error_model="numpy")
def replay(
    x: FloatArray,
    P: FloatArray,
    memory: FloatArray,
    flat: FloatArray,
    t: FloatArray,
    v: FloatArray,
    gyro_t: FloatArray,
    gyro_rate: FloatArray,
    gyro_walk: float,
    told: Told,
    means: FloatArray,
    covariances: FloatArray,
    squared: FloatArray,
    flags: np.ndarray,
    gyro_told: FloatArray,
    nodes: Nodes,
) -> int:
    """Wheels, gyro and measurements in the order of time; the state is that at t[0] and becomes that at t[-1].

    Steps end at wheel and gyro stamps and at measurements; a gyro tells the mean rate between two of its stamps.

    Args:
        x: (n,) in and out.
        P: (n, n) in and out.
        memory: in and out.
        flat: the setup of the filter, packed.
        t: (k,) [s] of the wheels.
        v: (k, 2) [m/s].
        gyro_t: (g,) [s] on the clock of the wheels.
        gyro_rate: (g,) [rad/s].
        gyro_walk: [rad^2/s] variance of the gyro's turn.
        told: (m) measurements.
        means: out, (k, n) at the stamps of the wheels.
        covariances: out, (k, 3, 3) of the pose; or (0, 3, 3): not wanted.
        squared: out, (m,) squared innovations.
        flags: out, (m,).
        gyro_told: out, (3,): how many steps took a rate, how many refused one, sum of squared innovations.
        nodes: out; or of length 0: not wanted.

    Returns:
        How many nodes were written.
    """
    setup = unpacked(flat)
    now, g, k, count = t[0], np.searchsorted(gyro_t, t[0], side="right"), 0, 0
    room = scratch(setup, len(x))
    longest, gain, no_cross = setup.settings[LONGEST], np.zeros(len(x)), np.zeros((0, 0))
    while k < len(told.when) and told.when[k] < now:
        flags[k] = UNUSED_FLAG
        squared[k] = math.nan
        k += 1
    for i in range(len(t)):
        left = right = math.nan
        if i > 0 and t[i] - t[i - 1] <= longest:
            left, right = v[i - 1, 0], v[i - 1, 1]
        first = i == 0
        while now < t[i] or first:
            rate, dt = math.nan, 0.0
            if not first:
                until = t[i]
                if g < len(gyro_t) and gyro_t[g] < until:
                    until = gyro_t[g]
                if k < len(told.when) and told.when[k] < until:
                    until = told.when[k]
                dt = until - now
                predict(x, P, memory, setup, room, left, right, dt, no_cross)
                if 0 < g < len(gyro_t) and gyro_t[g] - gyro_t[g - 1] <= longest:
                    rate = 0.5 * (gyro_rate[g - 1] + gyro_rate[g])
                    miss, S, flag = update_yaw_rate(x, P, memory, setup, rate, gyro_walk / dt, gain)
                    gyro_told[0 if flag == ACCEPTED_FLAG else 1] += 1.0
                    gyro_told[2] += miss * miss / S
                if g < len(gyro_t) and gyro_t[g] <= until:
                    g += 1
                now = until
            anchored = False
            while k < len(told.when) and told.when[k] <= now:
                squared[k], flags[k] = _measure(x, P, memory, setup, room, told, k)
                anchored = anchored or flags[k] == ANCHORED_FLAG
                k += 1
            if len(nodes.step):
                nodes.step[count] = np.array([now, left, right, dt, rate, 1.0 if anchored else 0.0])
                nodes.x[count], nodes.P[count], nodes.memory[count] = x, P, memory
                count += 1
            first = False
        means[i] = x
        if len(covariances):
            covariances[i] = P[:3, :3]
    flags[k:] = UNUSED_FLAG
    squared[k:] = math.nan
    return count


@njit(cache=True, error_model="numpy")
def _measure(
    x: FloatArray, P: FloatArray, memory: FloatArray, setup: Setup, room: Scratch, told: Told, k: int
) -> tuple[float, int]:
    kind = told.kind[k]
    if kind == STANDSTILL:
        memory[LEFT] = memory[RIGHT] = memory[SINCE] = 0.0
        return 0.0, ACCEPTED_FLAG
    seen, R = told.seen[k, :kind], np.ascontiguousarray(told.covariance[k, :kind, :kind])
    return update_reference(x, P, memory, setup, room, seen, R, told.stamp[k], told.mount[k])


@njit(cache=True, error_model="numpy")
def smooth(flat: FloatArray, gyro_walk: float, nodes: Nodes, count: int) -> None:
    """Replace the filtered states of the nodes by those given the whole log: Rauch, Tung and Striebel 1965.

    Each step is made again from the filtered state before it. A gyro's rate in it tells of the state before as well;
    both ends of the step are conditioned on it. Nothing is carried back over an anchoring.
    """
    setup, n = unpacked(flat), nodes.x.shape[1]
    room, gain, D = scratch(setup, n), np.zeros(n), np.zeros((n, n))
    for j in range(count - 1, 0, -1):
        if nodes.step[j, 5] != 0.0:
            continue
        x, P, memory = nodes.x[j - 1].copy(), nodes.P[j - 1].copy(), nodes.memory[j - 1].copy()
        before_x, before_P = nodes.x[j - 1], nodes.P[j - 1]
        dt, rate = nodes.step[j, 3], nodes.step[j, 4]
        predict(x, P, memory, setup, room, nodes.step[j, 1], nodes.step[j, 2], dt, D)
        if not math.isnan(rate):
            per_turn = 1.0 / (setup.settings[GYRO_SCALE] * dt)
            C = per_turn * (D[:, 2] - before_P[:, 2]) + before_P[:, n - 1]
            miss, S, flag = update_yaw_rate(x, P, memory, setup, rate, gyro_walk / dt, gain)
            if flag == ACCEPTED_FLAG:
                for a in range(n):
                    before_x[a] += C[a] / S * miss
                    for b in range(n):
                        D[a, b] -= C[a] * gain[b]
                        before_P[a, b] -= C[a] * C[b] / S
        _carry_back(x, P, D, nodes.x[j], nodes.P[j], before_x, before_P)


@njit(cache=True, error_model="numpy")
def _carry_back(
    x: FloatArray,
    P: FloatArray,
    D: FloatArray,
    smoothed_x: FloatArray,
    smoothed_P: FloatArray,
    before_x: FloatArray,
    before_P: FloatArray,
) -> None:
    """x_b += G (x_s - x), P_b += G (P_s - P) G^T with G = D P^-1, in place."""
    n, L, G = len(x), cholesky(P), D.copy()
    for i in range(n):
        forward(L, G[i])
        backward(L, G[i])
        for k in range(n):
            before_x[i] += G[i, k] * (smoothed_x[k] - x[k])
    half = np.zeros((n, n))
    for i in range(n):
        for k in range(n):
            for j in range(n):
                half[i, j] += G[i, k] * (smoothed_P[k, j] - P[k, j])
    for i in range(n):
        for j in range(i + 1):
            total = before_P[i, j]
            for k in range(n):
                total += half[i, k] * G[j, k]
            before_P[i, j] = before_P[j, i] = total
