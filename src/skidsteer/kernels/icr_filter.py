"""One step of the filter whose states are pose, parameters and gyro bias: ``odometry.icr_filter``.

State x: x, y [m], yaw [rad], the q free parameters, and with a gyro its bias [rad/s]; covariance P. ``memory`` holds
what is not random: the lagged rim speeds, the turn of the last step, the record of refused references. All is done in
place.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from skidsteer.kernels.roll import yaw_path
from skidsteer.kernels.rollout import half_rotation
from skidsteer.kernels.twists import twist_of
from skidsteer.se2 import FloatArray


class Setup(NamedTuple):
    """What a filter was made from; ``packed`` lays it out as one array, which is quicker to hand over."""

    settings: FloatArray  # (SETTINGS,) at the places below
    theta: FloatArray  # (p,) all parameters of the model; the free ones are taken from the state
    free: FloatArray  # (q,) indices of those that the state holds
    bounds: FloatArray  # (q, 2) of the free ones
    ground: FloatArray  # (q, q) covariance that the free parameters come to have on ground unseen


# Places in ``settings``
KIND, TRACK, LAG, WALK, TURN, REACH, BIAS_WALK, GYRO_SCALE, LONGEST, GAP_WALK, GAP_TURN = range(11)
GATES, PATIENCE, LOST, SOON, ADAPT = 11, 14, 15, 16, 17
SETTINGS = 18

# Places in ``memory``; from CROSS on the covariance of the state with the turn of the last step
LEFT, RIGHT, SINCE, TURNED, TURN_VARIANCE, JUMPED, FRESH, REFUSED, AGREED = range(9)
SEEN, FORESEEN, CROSS = 9, 12, 15

AT_REST = 1e-9  # [m] rolled: no motion, but the decaying rest of a lag; as in ``skidsteer.noise``
REFUSED_FLAG, ACCEPTED_FLAG, ANCHORED_FLAG, UNUSED_FLAG = 0, 1, 2, -1


class Scratch(NamedTuple):
    """Working memory, so that no step allocates any."""

    theta: FloatArray  # (p,) all parameters as the state has them
    twist: FloatArray  # (3,)
    J: FloatArray  # (3, p) derivative of the twist; holds zeros where the model writes nothing
    moved: FloatArray  # (3,) change of the pose
    B: FloatArray  # (3, q) its derivative by the free parameters
    Z: FloatArray  # (3, n) first rows of F P


@njit(cache=True, error_model="numpy")
def scratch(setup: Setup, n: int) -> Scratch:
    """Room for a state of n numbers."""
    p, q = len(setup.theta), len(setup.free)
    B, Z = np.zeros((3, q)), np.zeros((3, n))
    return Scratch(setup.theta.copy(), np.zeros(3), np.zeros((3, p)), np.zeros(3), B, Z)


def packed(setup: Setup) -> FloatArray:
    """The setup as one array: numbers of parameters and of free ones, then the parts one after the other."""
    sizes = [len(setup.theta), len(setup.free)]
    return np.concatenate([sizes, *(part.ravel() for part in setup)])


@njit(cache=True, error_model="numpy")
def unpacked(flat: FloatArray) -> Setup:
    """The setup that was ``packed``, as views."""
    p, q = int(flat[0]), int(flat[1])
    a = 2 + SETTINGS
    b = a + p
    c = b + q
    d = c + 2 * q
    return Setup(flat[2:a], flat[a:b], flat[b:c], flat[c:d].reshape(q, 2), flat[d:].reshape(q, q))


@njit(cache=True, error_model="numpy")
def step(
    x: FloatArray, P: FloatArray, memory: FloatArray, flat: FloatArray, left: float, right: float, dt: float
) -> None:
    """``predict`` with a packed setup."""
    setup = unpacked(flat)
    predict(x, P, memory, setup, scratch(setup, len(x)), left, right, dt, np.zeros((0, 0)))


@njit(cache=True, forceinline=True, error_model="numpy")
def predict(
    x: FloatArray,
    P: FloatArray,
    memory: FloatArray,
    setup: Setup,
    room: Scratch,
    left: float,
    right: float,
    dt: float,
    cross: FloatArray,
) -> None:
    """One step of rim speeds [m/s] held for dt [s] > 0; NaN: they are unknown.

    Args:
        x: (n,) in and out.
        P: (n, n) in and out.
        memory: (CROSS + n,) in and out.
        setup: of the filter.
        room: to work in.
        left: [m/s].
        right: [m/s].
        dt: [s].
        cross: out, (n, n) covariance of the state before with the one after; or (0, 0): not wanted.
    """
    settings, n, q = setup.settings, len(x), len(setup.free)
    B, moved = room.B, room.moved
    if math.isnan(left) or math.isnan(right):
        rolled, walk, turn = dt, settings[GAP_WALK] * dt, settings[GAP_TURN] * dt
        memory[LEFT] = memory[RIGHT] = math.nan
        B[:], moved[:] = 0.0, 0.0
    else:
        rolled, apart = _roll(x, memory, setup, room, left, right, dt)
        walk, turn = settings[WALK] * rolled, settings[TURN] * apart
    _propagate(P, memory, room, walk, turn, _kept(memory, settings, rolled), setup.ground, cross)
    for i in range(3):
        x[i] += moved[i]
    memory[SINCE], memory[TURNED] = dt, moved[2]
    if n > 3 + q:
        P[n - 1, n - 1] += settings[BIAS_WALK] * dt


@njit(cache=True, error_model="numpy")
def _kept(memory: FloatArray, settings: FloatArray, rolled: float) -> float:
    """Share of their deviation that the parameters keep in a step: exp(-distance / reach); 0 on fresh ground."""
    if memory[FRESH] > 0.0:
        memory[FRESH] = 0.0
        return 0.0
    share = float(rolled / settings[REACH])
    if share < 1e-3:  # exact to rounding
        return 1.0 - share * (1.0 - share / 2.0 * (1.0 - share / 3.0 * (1.0 - share / 4.0)))
    return math.exp(-share)


@njit(cache=True, forceinline=True, error_model="numpy")
def _roll(
    x: FloatArray,
    memory: FloatArray,
    setup: Setup,
    room: Scratch,
    left: float,
    right: float,
    dt: float,
) -> tuple[float, float]:
    """Write change of the pose and its derivative by the free parameters into the room.

    Returns:
        Distances [m] with which the errors of the position and of the yaw grow.
    """
    lag, free = setup.settings[LAG], setup.free
    if lag == 0.0 or math.isnan(memory[LEFT]):
        memory[LEFT], memory[RIGHT] = left, right
    lost = -math.expm1(-dt / lag) if lag > 0.0 else 1.0
    behind_left, behind_right = memory[LEFT] - left, memory[RIGHT] - right
    roll_left, roll_right = left * dt + behind_left * lag * lost, right * dt + behind_right * lag * lost
    memory[LEFT], memory[RIGHT] = left + behind_left * (1.0 - lost), right + behind_right * (1.0 - lost)
    twist, J, moved, B = room.twist, room.J, room.moved, room.B
    twist_of_state(x, setup, room, roll_left / dt, roll_right / dt)
    ch, sh, sinc, slope = half_rotation(0.5 * twist[2] * dt)
    c, s = math.cos(x[2]), math.sin(x[2])
    cm, sm = c * ch - s * sh, s * ch + c * sh
    ux, uy = dt * (cm * twist[0] - sm * twist[1]), dt * (sm * twist[0] + cm * twist[1])
    moved[0], moved[1], moved[2] = sinc * ux, sinc * uy, twist[2] * dt
    for m in range(len(free)):
        k = int(free[m])
        dx, dy, half = dt * J[0, k], dt * J[1, k], 0.5 * dt * J[2, k]
        B[0, m] = sinc * (cm * dx - sm * dy - half * uy) + slope * half * ux
        B[1, m] = sinc * (sm * dx + cm * dy + half * ux) + slope * half * uy
        B[2, m] = 2.0 * half
    rolled = 0.5 * (abs(roll_left) + abs(roll_right))
    return (rolled, yaw_path(roll_left, roll_right)) if rolled > AT_REST else (0.0, 0.0)


@njit(cache=True, forceinline=True, error_model="numpy")
def twist_of_state(
    x: FloatArray,
    setup: Setup,
    room: Scratch,
    left: float,
    right: float,
) -> None:
    """Write the body twist with the parameters of the state, and its derivative by all of them, into the room."""
    for m in range(len(setup.free)):
        room.theta[int(setup.free[m])] = x[3 + m]
    kind, track = int(setup.settings[KIND]), setup.settings[TRACK]
    twist_of(kind, track, room.theta, left, right, room.twist, room.J)


@njit(cache=True, forceinline=True, error_model="numpy")
def _propagate(
    P: FloatArray,
    memory: FloatArray,
    room: Scratch,
    walk: float,
    turn: float,
    kept: float,
    ground: FloatArray,
    cross: FloatArray,
) -> None:
    """P = F P F^T + Q with F = [[A, B, 0], [0, kept, 0], [0, 0, 1]]; A moves the position by an error of the yaw.

    The parameters stay where they are; their deviation from that is a Gauss-Markov process: covariance
    kept^2 P + (1 - kept^2) ground, which grows to ``ground`` and no further.
    """
    B, Z, n, q = room.B, room.Z, len(P), room.B.shape[1]
    a, b = -room.moved[1], room.moved[0]
    for j in range(n):
        z0, z1, z2 = P[0, j] + a * P[2, j], P[1, j] + b * P[2, j], P[2, j]
        turned = 0.0
        for m in range(q):
            z0 += B[0, m] * P[3 + m, j]
            z1 += B[1, m] * P[3 + m, j]
            turned += B[2, m] * P[3 + m, j]
        Z[0, j], Z[1, j], Z[2, j] = z0, z1, z2 + turned
        memory[CROSS + j] = turned
    if len(cross):
        _store_cross(P, Z, kept, q, cross)
    variance = turn
    for m in range(q):
        variance += B[2, m] * memory[CROSS + 3 + m]
    for i in range(3):
        with_turn = 0.0
        for m in range(q):
            with_turn += Z[i, 3 + m] * B[2, m]
        last = (Z[i, 0] + a * Z[i, 2], Z[i, 1] + b * Z[i, 2], Z[i, 2] + with_turn)
        for k in range(i + 1):
            total = last[k]
            if k < 2:
                for m in range(q):
                    total += Z[i, 3 + m] * B[k, m]
            P[i, k] = total
        memory[CROSS + i] = with_turn
    P[0, 0] += walk
    P[1, 1] += walk
    P[2, 2] += turn
    memory[CROSS + 2] += turn
    memory[TURN_VARIANCE] = variance
    P[0, 1], P[0, 2], P[1, 2] = P[1, 0], P[2, 0], P[2, 1]
    for j in range(3, n):
        share = kept if j < 3 + q else 1.0
        memory[CROSS + j] *= share
        for i in range(3):
            P[i, j] = P[j, i] = share * Z[i, j]
    fresh = 1.0 - kept * kept
    for i in range(q):
        for j in range(i + 1):
            P[3 + i, 3 + j] = P[3 + j, 3 + i] = kept * kept * P[3 + i, 3 + j] + fresh * ground[i, j]
        if n > 3 + q:
            P[n - 1, 3 + i] = P[3 + i, n - 1] = kept * P[n - 1, 3 + i]


@njit(cache=True, error_model="numpy")
def _store_cross(P: FloatArray, Z: FloatArray, kept: float, q: int, cross: FloatArray) -> None:
    """P F^T, (n, n): rows of the state before, columns of the state after."""
    n = len(P)
    for i in range(n):
        for j in range(3):
            cross[i, j] = Z[j, i]
        for j in range(3, n):
            cross[i, j] = P[i, j] * (kept if j < 3 + q else 1.0)
