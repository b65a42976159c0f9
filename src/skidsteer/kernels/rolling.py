"""A motion model driven through one step of time, its rims with a first-order lag and limited acceleration."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.kernels.rollout import half_rotation
from skidsteer.kernels.twists import twist_of
from skidsteer.se2 import FloatArray

LONGEST = 0.005  # [s] over which the twist of a rim that changes is taken for its mean


@njit(cache=True)
def follow(rim: float, asked: float, dt: float, lag: float, acceleration: float) -> tuple[float, float]:
    """Rim speed [m/s] after dt [s], and the distance [m] it rolled: exact for rim' = clip((asked - rim) / lag).

    Args:
        rim: [m/s] at the beginning.
        asked: [m/s], held.
        dt: [s].
        lag: [s]; 0: at once, where the acceleration reaches.
        acceleration: [m/s^2] limit; may be infinite.
    """
    gap = asked - rim
    ramp = min(dt, max(0.0, abs(gap) / acceleration - lag))  # [s] at the limit
    rolled = 0.0
    if ramp > 0.0:
        change = math.copysign(acceleration, gap) * ramp
        rolled = (rim + 0.5 * change) * ramp
        rim += change
        gap -= change
    rest = dt - ramp
    if rest <= 0.0:
        return rim, rolled
    if lag == 0.0:
        return asked, rolled + asked * rest
    gone = -math.expm1(-rest / lag)
    return rim + gap * gone, rolled + asked * rest - gap * lag * gone


@njit(cache=True)
def step(
    kind: int,
    track: float,
    theta: FloatArray,
    state: FloatArray,
    left: float,
    right: float,
    dt: float,
    lag: float,
    acceleration: float,
) -> FloatArray:
    """State (8,) dt [s] after a state: pose, twist, rim speeds; ``left`` and ``right`` [m/s] are asked for, held.

    ``kind``, ``track`` and ``theta`` tell the model, see ``twist_of``.
    """
    out, J = state.copy(), np.zeros((3, len(theta)))
    twist = out[3:6]
    at_once = lag == 0.0 and acceleration == math.inf
    parts = 1 if at_once else max(1, math.ceil(dt / LONGEST - 1e-9))
    part = dt / parts
    for _ in range(parts):
        if part <= 0.0:
            break
        out[6], rolled_left = follow(out[6], left, part, lag, acceleration)
        out[7], rolled_right = follow(out[7], right, part, lag, acceleration)
        twist_of(kind, track, theta, rolled_left / part, rolled_right / part, twist, J)
        half = 0.5 * twist[2] * part
        c, s = math.cos(out[2] + half), math.sin(out[2] + half)
        chord = half_rotation(half)[2] * part
        out[0] += chord * (c * twist[0] - s * twist[1])
        out[1] += chord * (s * twist[0] + c * twist[1])
        out[2] += 2.0 * half
    twist_of(kind, track, theta, out[6], out[7], twist, J)
    return out
