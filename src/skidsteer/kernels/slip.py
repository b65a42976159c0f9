"""Two Kalman filters for a sliding robot: where it is, from poses that come late; and how it turns, from a gyro.

Equations and names are those of ``control.observer``. Seen in the direction of driving; all is done in place.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.kernels.lags import cascade, decay, mean_share
from skidsteer.kernels.stage import SHARPEST, SLOWEST
from skidsteer.se2 import FloatArray

# Places in the late state x: pose, sideways velocity, and how the robot slips
X, Y, YAW, SIDE, SCALE, LOSS, TURN_SCALE, ICR_X, COMPLIANCE, GIVE = range(10)
STATES = 10
# Places in the state t of the turn
OMEGA, GAIN, DRIFT, EASE = range(4)
TURNS = 4
# what is credible
LEAST_COMPLIANCE, GREATEST_COMPLIANCE = 0.0, 0.5  # [s^2/m]
LEAST_GAIN, GREATEST_GAIN = 0.3, 3.0
GREATEST_EASE = 1.6  # with the steepest slip angle it leaves a third of the resistance


@njit(cache=True)
def roll(x: FloatArray, dt: float, v: float, omega: float, F: FloatArray) -> None:
    """Move x (10,) by dt at a measured speed and yaw rate; F (10, 10) is the derivative with respect to x before."""
    turn = x[TURN_SCALE] * omega
    sharp = min(abs(turn) / max(abs(v), SLOWEST), SHARPEST)
    speed, k = (x[SCALE] + x[LOSS] * sharp) * v, x[COMPLIANCE] + x[GIVE] * sharp
    lag = max(k, 0.0) * abs(speed)
    c, f = decay(dt, lag), mean_share(dt, lag)
    icr_x = x[ICR_X] + k * speed * speed
    side = c * x[SIDE] - (1.0 - c) * icr_x * turn
    drift = (1.0 - f) * x[SIDE] + f * side
    middle = x[YAW] + 0.5 * turn * dt
    cos, sin = math.cos(middle), math.sin(middle)
    dx, dy = dt * (speed * cos - drift * sin), dt * (speed * sin + drift * cos)
    F[:] = 0.0
    for i in range(STATES):
        F[i, i] = 1.0
    F[SIDE, SIDE] = c
    F[SIDE, ICR_X] = -(1.0 - c) * turn
    F[SIDE, COMPLIANCE] = -(1.0 - c) * turn * speed * speed
    F[SIDE, TURN_SCALE] = -(1.0 - c) * icr_x * omega
    F[SIDE, SCALE] = -(1.0 - c) * turn * 2.0 * k * speed * v
    if lag > 0.0:  # the lag changes, too
        by_lag = (x[SIDE] + icr_x * turn) * c * dt / lag**2
        F[SIDE, COMPLIANCE] += by_lag * abs(speed)
        F[SIDE, SCALE] += by_lag * k * abs(v)
    F[SIDE, GIVE], F[SIDE, LOSS] = sharp * F[SIDE, COMPLIANCE], sharp * F[SIDE, SCALE]
    for j in range(SIDE, STATES):
        by = dt * (f * F[SIDE, j] + (1.0 - f if j == SIDE else 0.0))
        F[X, j], F[Y, j] = -sin * by, cos * by
    F[X, SCALE] += dt * v * cos
    F[Y, SCALE] += dt * v * sin
    F[X, LOSS] += dt * v * cos * sharp
    F[Y, LOSS] += dt * v * sin * sharp
    F[X, YAW], F[Y, YAW], F[YAW, TURN_SCALE] = -dy, dx, omega * dt
    F[X, TURN_SCALE] -= dy * 0.5 * omega * dt
    F[Y, TURN_SCALE] += dx * 0.5 * omega * dt
    if sharp < SHARPEST:  # the sharper the turn, the more speed is lost and the more the ground yields
        sharper = abs(omega) / max(abs(v), SLOWEST)
        for i in (X, Y, SIDE):
            F[i, TURN_SCALE] += sharper * (x[LOSS] * F[i, SCALE] + x[GIVE] * F[i, COMPLIANCE])
    x[X] += dx
    x[Y] += dy
    x[YAW] += turn * dt
    x[SIDE] = side


@njit(cache=True)
def predict(
    x: FloatArray, P: FloatArray, dt: float, v: float, omega: float, Q: FloatArray, usual: FloatArray, memory: float
) -> None:
    """Prediction; the slip states return to the ``usual`` (10,) within a memory [s]; variance Q (10,) a second."""
    F = np.empty((STATES, STATES))
    roll(x, dt, v, omega, F)
    kept = decay(dt, memory)
    for i in range(SCALE, STATES):
        x[i] = usual[i] + kept * (x[i] - usual[i])
        F[i] *= kept
    P[:] = F @ P @ F.T
    for i in range(STATES):
        P[i, i] += Q[i] * dt


@njit(cache=True)
def update(x: FloatArray, P: FloatArray, pose: FloatArray, R: FloatArray, jump: float) -> bool:
    """Update by a pose (3,) with variances R (3,); whether it was a jump, off by more than ``jump`` sigmas.

    A jump is taken over as it is: the map has leapt, which tells nothing of the slip.
    """
    gap = np.array([pose[0] - x[X], pose[1] - x[Y], (pose[2] - x[YAW] + math.pi) % (2.0 * math.pi) - math.pi])
    far = 0.0
    for i in range(3):
        far += gap[i] ** 2 / (P[i, i] + R[i])
    if far > jump**2:
        x[:3] += gap
        P[:3, :] = 0.0
        P[:, :3] = 0.0
        for i in range(3):
            P[i, i] = R[i]
        return True
    target = x[:3] + gap
    for i in range(3):
        K = P[:, i] / (P[i, i] + R[i])
        x += K * (target[i] - x[i])
        P -= np.outer(K, P[i].copy())
    P[:] = 0.5 * (P + P.T)
    x[COMPLIANCE] = min(max(x[COMPLIANCE], LEAST_COMPLIANCE), GREATEST_COMPLIANCE)
    return False


@njit(cache=True)
def late(
    x: FloatArray,
    P: FloatArray,
    steps: FloatArray,
    delay: float,
    pose: FloatArray,
    Q: FloatArray,
    R: FloatArray,
    usual: FloatArray,
    memory: float,
    jump: float,
    now: FloatArray,
) -> int:
    """Bring x and P to ``delay`` [s] before now, update them by a pose (3,) of then, and roll it forward to now (10,).

    Args:
        x: in and out, (10,) at the start of the steps.
        P: in and out, (10, 10).
        steps: (n, 3) dt [s], v, omega as told; oldest first. A step that is used in part is shortened.
        delay: of the pose.
        pose: (3,) measured; NaN: none came, nothing is updated.
        Q: (10,) variances that a second adds.
        R: (3,) variances of the pose.
        usual: (10,) see ``predict``.
        memory: see there.
        jump: see ``update``.
        now: out.

    Returns:
        How many of the steps are used up.
    """
    left, used = steps[:, 0].sum() - delay, 0
    while used < len(steps) and left > 1e-9:
        dt = min(steps[used, 0], left)
        predict(x, P, dt, steps[used, 1], steps[used, 2], Q, usual, memory)
        left -= dt
        if dt == steps[used, 0]:
            used += 1
        else:
            steps[used, 0] -= dt
    if not math.isnan(pose[0]):
        update(x, P, pose, R, jump)
    now[:] = x
    F = np.empty((STATES, STATES))
    for i in range(used, len(steps)):
        roll(now, steps[i, 0], steps[i, 1], steps[i, 2], F)
    return used


@njit(cache=True)
def turn(
    t: FloatArray,
    P: FloatArray,
    dt: float,
    rims: float,
    asked: float,
    lag: float,
    body_lag: float,
    slip: float,
    measured: float,
    Q: FloatArray,
    R: float,
    usual: FloatArray,
    memory: float,
) -> None:
    """Predict and update t (4,), P (4, 4) by a measured yaw rate.

    Args:
        t: in and out.
        P: in and out.
        dt: [s] of the step.
        rims: [rad/s] asked for, behind the lag of the rims, at its start.
        asked: [rad/s] held in it.
        lag: [s] of the rims.
        body_lag: [s] of the body behind them.
        slip: [rad] magnitude of the slip angle.
        measured: [rad/s] at its end.
        Q: (4,) variances that a second adds.
        R: variance of the measurement.
        usual: (4,) see ``predict``.
        memory: see there.
    """
    b, kept = decay(dt, body_lag), decay(dt, memory)
    A = np.eye(TURNS) * kept
    A[OMEGA, OMEGA], A[OMEGA, DRIFT], A[OMEGA, EASE] = b, 1.0 - b, (1.0 - b) * slip * t[OMEGA]
    A[OMEGA, GAIN] = (1.0 - b) * asked + cascade(dt, lag, body_lag) * (rims - asked)
    resists_less = (1.0 - b) * slip * t[EASE]
    t[:] = A @ t + (1.0 - kept) * usual
    A[OMEGA, OMEGA] += resists_less  # A t has the product of ease and omega once, its derivative twice
    P[:] = A @ P @ A.T
    for i in range(TURNS):
        P[i, i] += Q[i] * dt
    K = P[:, OMEGA] / (P[OMEGA, OMEGA] + R)
    t += K * (measured - t[OMEGA])
    P -= np.outer(K, P[OMEGA].copy())
    P[:] = 0.5 * (P + P.T)
    t[GAIN] = min(max(t[GAIN], LEAST_GAIN), GREATEST_GAIN)
    t[EASE] = min(max(t[EASE], 0.0), GREATEST_EASE)
