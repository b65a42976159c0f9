"""Measurements taken into the state of ``kernels.icr_filter``: a gyro's yaw rate, a reference pose or position.

All is done in place. A measurement outside its gate is refused; a reference that is refused for long anchors the pose.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.kernels.icr_filter import (
    ACCEPTED_FLAG,
    ADAPT,
    AGREED,
    ANCHORED_FLAG,
    CROSS,
    FORESEEN,
    FRESH,
    GATES,
    GYRO_SCALE,
    JUMPED,
    LEFT,
    LOST,
    PATIENCE,
    REFUSED,
    REFUSED_FLAG,
    RIGHT,
    SEEN,
    SINCE,
    SOON,
    TURN_VARIANCE,
    TURNED,
    Scratch,
    Setup,
    scratch,
    twist_of_state,
    unpacked,
)
from skidsteer.se2 import FloatArray


@njit(cache=True, error_model="numpy")
def _accept(x: FloatArray, setup: Setup, K: FloatArray, innovation: FloatArray) -> None:
    """Move x by K (n, r) times the innovation (r,); the parameters stay inside their bounds (q, 2)."""
    q = len(setup.free)
    if setup.settings[ADAPT] == 0.0:
        K[3 : 3 + q] = 0.0
    for i in range(len(x)):
        for k in range(len(innovation)):
            x[i] += K[i, k] * innovation[k]
    for m in range(q):
        x[3 + m] = min(max(x[3 + m], setup.bounds[m, 0]), setup.bounds[m, 1])


@njit(cache=True, error_model="numpy")
def update_yaw_rate(
    x: FloatArray,
    P: FloatArray,
    memory: FloatArray,
    setup: Setup,
    rate: float,
    variance: float,
    gain: FloatArray,
) -> tuple[float, float, int]:
    """Mean rate [rad/s] of a gyro over the last step, told right after it: turn / (scale dt) + bias.

    ``gain`` (n,) receives the gain, zero where it is refused. Returns the innovation, its variance and a flag.
    """
    n, per_turn = len(x), 1.0 / (setup.settings[GYRO_SCALE] * memory[SINCE])
    C = per_turn * memory[CROSS : CROSS + n] + P[:, n - 1]
    S = (
        variance
        + per_turn * per_turn * memory[TURN_VARIANCE]
        + 2.0 * per_turn * memory[CROSS + n - 1]
        + P[n - 1, n - 1]
    )
    innovation = rate - per_turn * memory[TURNED] - x[n - 1]
    memory[SINCE] = 0.0
    gain[:] = 0.0
    if not innovation * innovation <= setup.settings[GATES] * S:
        return innovation, S, REFUSED_FLAG
    K = (C / S).reshape(n, 1)
    _accept(x, setup, K, np.array([innovation]))
    for i in range(n):
        gain[i] = K[i, 0]
        for j in range(i + 1):
            change = S * K[i, 0] * K[j, 0] - K[i, 0] * C[j] - C[i] * K[j, 0]
            P[i, j] += change
            P[j, i] = P[i, j]
    return innovation, S, ACCEPTED_FLAG


@njit(cache=True, error_model="numpy")
def update_reference(
    x: FloatArray,
    P: FloatArray,
    memory: FloatArray,
    setup: Setup,
    room: Scratch,
    seen: FloatArray,
    covariance: FloatArray,
    stamp: float,
    mount: FloatArray,
) -> tuple[float, int]:
    """A reference pose (3,), or position (2,), of a sensor mounted at (3,) on the robot.

    Args:
        x: (n,) in and out.
        P: (n, n) in and out.
        memory: (CROSS + n,) in and out.
        setup: of the filter.
        room: to work in.
        seen: (r,) with r = 3 or 2.
        covariance: (r, r).
        stamp: [s] standard deviation of its time.
        mount: (3,) x, y [m], yaw [rad].

    Returns:
        The squared innovation and a flag.
    """
    r, settings = len(seen), setup.settings
    c, s = math.cos(x[2]), math.sin(x[2])
    lever = np.array([c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]])
    foreseen = np.array([x[0] + lever[0], x[1] + lever[1], x[2] + mount[2]])[:r]
    H = np.zeros((r, 3))
    for k in range(r):
        H[k, k] = 1.0
    H[0, 2], H[1, 2] = -lever[1], lever[0]
    innovation = seen - foreseen
    if r == 3:
        innovation[2] = _wrapped(innovation[2])
    R = covariance.copy()
    if stamp > 0.0:
        _blur(R, x, memory, setup, room, lever, stamp)
    C, S = _seen_covariance(P, H, R)
    K, squared = _gain(S, C, innovation)
    if squared <= settings[GATES + r - 1]:
        memory[REFUSED] = memory[AGREED] = memory[SINCE] = 0.0
        memory[JUMPED] = max(memory[JUMPED] - 1.0, 0.0)
        _accept(x, setup, K, innovation)
        _joseph(P, K, H, R)
        return squared, ACCEPTED_FLAG
    _remember(memory, settings, seen, foreseen, S)
    if memory[AGREED] < settings[PATIENCE] and memory[REFUSED] < settings[LOST]:
        return squared, REFUSED_FLAG
    if memory[JUMPED] > 0.0 or memory[AGREED] < settings[PATIENCE]:
        memory[FRESH] = 1.0  # jumps in short order, or a reference at odds with itself: the ground has changed
    memory[JUMPED] = settings[SOON]
    memory[REFUSED] = memory[AGREED] = memory[SINCE] = 0.0
    _anchor(x, P, innovation, R, lever)
    return squared, ANCHORED_FLAG


@njit(cache=True, error_model="numpy")
def _wrapped(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@njit(cache=True, error_model="numpy")
def _seen_covariance(P: FloatArray, H: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance of state and expected measurement, P H^T (n, r), and that of the innovation, H P H^T + R (r, r)."""
    n, r = len(P), len(H)
    C, S = np.zeros((n, r)), R.copy()
    for k in range(r):
        for a in range(3):
            for i in range(n):
                C[i, k] += P[i, a] * H[k, a]
    for k in range(r):
        for j in range(r):
            for a in range(3):
                S[k, j] += H[k, a] * C[a, j]
    return C, S


@njit(cache=True, error_model="numpy")
def _blur(
    R: FloatArray,
    x: FloatArray,
    memory: FloatArray,
    setup: Setup,
    room: Scratch,
    lever: FloatArray,
    stamp: float,
) -> None:
    """Add to R (r, r) what a stamp that is off by ``stamp`` [s] does: the sensor's velocity times that."""
    if math.isnan(memory[LEFT]):
        return
    twist_of_state(x, setup, room, memory[LEFT], memory[RIGHT])
    v, w, turn = stamp * room.twist[0], stamp * room.twist[1], stamp * room.twist[2]
    c, s = math.cos(x[2]), math.sin(x[2])
    along = (c * v - s * w - turn * lever[1], s * v + c * w + turn * lever[0], turn)
    for i in range(len(R)):
        for k in range(len(R)):
            R[i, k] += along[i] * along[k]


@njit(cache=True, error_model="numpy")
def _gain(S: FloatArray, C: FloatArray, innovation: FloatArray) -> tuple[FloatArray, float]:
    """C S^-1 (n, r) and the squared innovation by S (r, r), through a Cholesky factor."""
    L, K, squared = cholesky(S), C.copy(), 0.0
    white = innovation.copy()
    forward(L, white)
    for k in range(len(S)):
        squared += white[k] * white[k]
    for i in range(len(C)):
        forward(L, K[i])
        backward(L, K[i])
    return K, squared


@njit(cache=True, error_model="numpy")
def cholesky(S: FloatArray) -> FloatArray:
    """Lower factor (n, n) of a positive definite (n, n); NaN where it is none."""
    n = len(S)
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total / L[j, j] if j < i else (math.sqrt(total) if total > 0.0 else math.nan)
    return L


@njit(cache=True, error_model="numpy")
def forward(L: FloatArray, b: FloatArray) -> None:
    """Replace b (n,) by the solution of L y = b."""
    for k in range(len(b)):
        for j in range(k):
            b[k] -= L[k, j] * b[j]
        b[k] /= L[k, k]


@njit(cache=True, error_model="numpy")
def backward(L: FloatArray, b: FloatArray) -> None:
    """Replace b (n,) by the solution of L^T y = b."""
    for k in range(len(b) - 1, -1, -1):
        for j in range(k + 1, len(b)):
            b[k] -= L[j, k] * b[j]
        b[k] /= L[k, k]


@njit(cache=True, error_model="numpy")
def _joseph(P: FloatArray, K: FloatArray, H: FloatArray, R: FloatArray) -> None:
    """P = (I - K H) P (I - K H)^T + K R K^T: right for any gain, positive for any rounding."""
    n, r = K.shape
    M, KR = np.zeros((n, 3)), np.zeros((n, r))  # M: the first three columns of I - K H; the others are those of I
    for i in range(n):
        for k in range(r):
            for a in range(3):
                M[i, a] -= K[i, k] * H[k, a]
            for j in range(r):
                KR[i, j] += K[i, k] * R[k, j]
        if i < 3:
            M[i, i] += 1.0
    half = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            total = M[i, 0] * P[0, j] + M[i, 1] * P[1, j] + M[i, 2] * P[2, j]
            half[i, j] = total + P[i, j] if i >= 3 else total
    for i in range(n):
        for j in range(i + 1):
            total = half[i, 0] * M[j, 0] + half[i, 1] * M[j, 1] + half[i, 2] * M[j, 2]
            if j >= 3:
                total += half[i, j]
            for k in range(r):
                total += KR[i, k] * K[j, k]
            P[i, j] = P[j, i] = total


@njit(cache=True, error_model="numpy")
def _remember(memory: FloatArray, settings: FloatArray, seen: FloatArray, foreseen: FloatArray, S: FloatArray) -> None:
    """Count a refused reference, and how many in a row moved as the wheels say since the one before."""
    r = len(seen)
    agrees = False
    if memory[REFUSED] > 0.0:
        change = _since(seen, memory[SEEN : SEEN + r]) - _since(foreseen, memory[FORESEEN : FORESEEN + r])
        if r == 3:
            change[2] = _wrapped(change[2])
            c, s = math.cos(seen[2]), math.sin(seen[2])
            change[0], change[1] = c * change[0] - s * change[1], s * change[0] + c * change[1]
        agrees = _gain(2.0 * S, S, change)[1] <= settings[GATES + r - 1]
    memory[REFUSED] += 1.0
    memory[AGREED] = memory[AGREED] + 1.0 if agrees else 1.0
    memory[SEEN : SEEN + r] = seen
    memory[FORESEEN : FORESEEN + r] = foreseen


@njit(cache=True, error_model="numpy")
def _since(now: FloatArray, before: FloatArray) -> FloatArray:
    """Motion from one pose (3,) to another, seen from the first; of positions (2,) the difference."""
    change = now - before
    if len(now) == 3:
        c, s = math.cos(before[2]), math.sin(before[2])
        change[0], change[1] = c * change[0] + s * change[1], c * change[1] - s * change[0]
    return change


@njit(cache=True, error_model="numpy")
def _anchor(x: FloatArray, P: FloatArray, innovation: FloatArray, R: FloatArray, lever: FloatArray) -> None:
    """Set pose or position to where the reference sees it, as if nothing had been known of it; all else stays."""
    r, n = len(innovation), len(x)
    turned = innovation[2] if r == 3 else 0.0
    c, s = math.cos(turned), math.sin(turned)
    turned_lever = np.array([c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]])
    for k in range(2):
        x[k] += innovation[k] + lever[k] - turned_lever[k]
    x[2] += turned
    # With e the error of the reference, the new position errs by e - swing e_yaw; swing = (-l_y, l_x)
    swing = np.array([-turned_lever[1], turned_lever[0]])
    if r == 3:
        for i in range(3):
            P[i, :] = 0.0
            P[:, i] = 0.0
        P[2, 2] = R[2, 2]
    for i in range(2, n):
        for k in range(2):
            with_reference = R[k, 2] if r == 3 and i == 2 else 0.0
            P[k, i] = P[i, k] = with_reference - swing[k] * P[2, i]
    for i in range(2):
        for k in range(2):
            between = swing[i] * R[k, 2] + swing[k] * R[i, 2] if r == 3 else 0.0
            P[i, k] = R[i, k] - between + swing[i] * swing[k] * P[2, 2]


@njit(cache=True, error_model="numpy")
def take_yaw_rate(
    x: FloatArray, P: FloatArray, memory: FloatArray, flat: FloatArray, rate: float, variance: float
) -> tuple[float, float, int]:
    """``update_yaw_rate`` with a packed setup."""
    return update_yaw_rate(x, P, memory, unpacked(flat), rate, variance, np.zeros(len(x)))


@njit(cache=True, error_model="numpy")
def take_reference(
    x: FloatArray,
    P: FloatArray,
    memory: FloatArray,
    flat: FloatArray,
    seen: FloatArray,
    covariance: FloatArray,
    stamp: float,
    mount: FloatArray,
) -> tuple[float, int]:
    """``update_reference`` with a packed setup."""
    setup = unpacked(flat)
    return update_reference(x, P, memory, setup, scratch(setup, len(x)), seen, covariance, stamp, mount)
