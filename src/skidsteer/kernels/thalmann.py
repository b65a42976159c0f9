"""Thalmann's Kalman filters over a whole drive: time updates, encoders and positions as updates, and their loop.

State: x, y, yaw, two motion parameters m, then the slip parameters that are estimated. C m are the rim speeds of both
sides; the encoders, brought to C^-1 (v_left, v_right), observe m itself. ``skidsteer.odometry.kinematic_ekf`` derives
the equations.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.kernels.rollout import half_rotation
from skidsteer.se2 import FloatArray

POSE = 3  # first motion parameter
SLIPS = 5  # first slip parameter that is estimated


@njit(cache=True, inline="always")
def _slip(mean: FloatArray, slips: FloatArray, where: np.ndarray, i: int) -> float:
    return float(mean[where[i]] if where[i] >= 0 else slips[i])


@njit(cache=True)
def twist(
    mean: FloatArray, C: FloatArray, slips: FloatArray, where: np.ndarray, track: float, D: FloatArray
) -> tuple[float, float, float]:
    """Speed, yaw rate, mean magnitude of the rim speeds; out: derivative D (2, n) with respect to the state."""
    left = C[0, 0] * mean[POSE] + C[0, 1] * mean[POSE + 1]
    right = C[1, 0] * mean[POSE] + C[1, 1] * mean[POSE + 1]
    tau_left, tau_right = 1.0 - _slip(mean, slips, where, 0), 1.0 - _slip(mean, slips, where, 1)
    turn = _slip(mean, slips, where, 2) / track
    D[:] = 0.0
    for i in range(2):
        D[0, POSE + i] = 0.5 * (tau_left * C[0, i] + tau_right * C[1, i])
        D[1, POSE + i] = turn * (tau_right * C[1, i] - tau_left * C[0, i])
    if where[0] >= 0:
        D[0, where[0]], D[1, where[0]] = -0.5 * left, turn * left
    if where[1] >= 0:
        D[0, where[1]], D[1, where[1]] = -0.5 * right, -turn * right
    if where[2] >= 0:
        D[1, where[2]] = (tau_right * right - tau_left * left) / track
    v, omega = 0.5 * (tau_left * left + tau_right * right), turn * (tau_right * right - tau_left * left)
    return v, omega, 0.5 * (abs(left) + abs(right))


@njit(cache=True)
def advance(
    mean: FloatArray,
    P: FloatArray,
    dt: float,
    C: FloatArray,
    arc: bool,
    slips: FloatArray,
    where: np.ndarray,
    track: float,
    disturbance: FloatArray,
    drift: FloatArray,
    wander: FloatArray,
) -> None:
    """Time update in place, P to F P F^T + Q.

    Args:
        mean: (n,) state.
        P: (n, n) its covariance.
        dt: [s].
        C: (2, 2) rim speeds by the motion parameters.
        arc: draw arcs, else tangents.
        slips: (3,) slip of the left and of the right side, steering efficiency; used where not estimated.
        where: (3,) place of each in the state, or -1.
        track: [m].
        disturbance: (2,) standard deviation of the accelerations, constant through the step, of the motion parameters.
        drift: (3,) variance a second by which each slip parameter wanders.
        wander: (2,) variance a metre rolled of the position, each axis, and of the yaw.
    """
    n = len(mean)
    D, E, A = np.empty((2, n)), np.zeros((3, n)), np.empty((3, n))
    v, omega, size = twist(mean, C, slips, where, track, D)
    path, half = v * dt, 0.5 * omega * dt
    ch, sh, sinc, slope = half_rotation(half) if arc else (1.0, 0.0, 1.0, 0.0)
    cos, sin = math.cos(mean[2]), math.sin(mean[2])
    c, s = cos * ch - sin * sh, sin * ch + cos * sh  # heading of the chord
    bend = 1.0 if arc else 0.0
    for j in range(POSE, n):  # E = F - I
        d_path, d_half = D[0, j] * dt, 0.5 * D[1, j] * dt
        E[0, j] = sinc * c * d_path + path * (slope * c - bend * sinc * s) * d_half
        E[1, j] = sinc * s * d_path + path * (slope * s + bend * sinc * c) * d_half
        E[2, j] = 2.0 * d_half
    E[0, 2], E[1, 2] = -path * sinc * s, path * sinc * c
    mean[0] += path * sinc * c
    mean[1] += path * sinc * s
    mean[2] += 2.0 * half
    for i in range(3):
        for j in range(n):
            A[i, j] = P[i, j]
            for k in range(2, n):
                A[i, j] += E[i, k] * P[k, j]
    for i in range(3):
        for j in range(POSE, n):
            P[i, j] = A[i, j]
            P[j, i] = A[i, j]
        for j in range(i + 1):
            total = A[i, j]
            for k in range(2, n):
                total += A[i, k] * E[j, k]
            P[i, j] = total
            P[j, i] = total
    for m in range(2):  # Q = G G^T, G = (E / 2, 1) dt times the acceleration
        column, g = POSE + m, disturbance[m] * dt
        for i in range(3):
            for j in range(3):
                P[i, j] += 0.25 * E[i, column] * E[j, column] * g * g
            P[i, column] += 0.5 * E[i, column] * g * g
            P[column, i] = P[i, column]
        P[column, column] += g * g
    for i in range(3):
        if where[i] >= 0:
            P[where[i], where[i]] += drift[i] * dt
    rolled = size * dt
    P[0, 0] += wander[0] * rolled
    P[1, 1] += wander[0] * rolled
    P[2, 2] += wander[1] * rolled


@njit(cache=True)
def _correct(mean: FloatArray, P: FloatArray, h: FloatArray, innovation: float, variance: float) -> None:
    """Take one observation with row h (n,) into the state, in place; Joseph's form, so that P stays positive."""
    n = len(mean)
    K, row = np.zeros(n), np.zeros(n)
    for i in range(n):
        for j in range(n):
            row[i] += P[i, j] * h[j]
    S = variance
    for i in range(n):
        S += h[i] * row[i]
    for i in range(n):
        K[i] = row[i] / S
        mean[i] += K[i] * innovation
    A, rest = np.empty((n, n)), np.zeros(n)
    for i in range(n):
        for j in range(n):
            A[i, j] = P[i, j] - K[i] * row[j]
            rest[i] += A[i, j] * h[j]
    for i in range(n):
        for j in range(i + 1):
            P[i, j] = A[i, j] - rest[i] * K[j] + variance * K[i] * K[j]
            P[j, i] = P[i, j]


@njit(cache=True)
def observe(
    mean: FloatArray,
    P: FloatArray,
    z: FloatArray,
    variance: FloatArray,
    limits: FloatArray,
    patience: float,
    taken: np.ndarray,
) -> float:
    """Take both encoder observations into the state in place, except what the compatibility test excludes.

    Args:
        mean: (n,) state.
        P: (n, n) its covariance.
        z: (2,) observed motion parameters.
        variance: (2,) of the observations, uncorrelated.
        limits: (2,) chi-square thresholds of one and two observations.
        patience: excluded samples in a row after which a lasting disagreement is believed.
        taken: (2,) bool, out: what was accepted.

    Returns:
        The test statistic of both, Thalmann 2016, Eq. (10).
    """
    d0, d1 = z[0] - mean[POSE], z[1] - mean[POSE + 1]
    S00, S11 = P[POSE, POSE] + variance[0], P[POSE + 1, POSE + 1] + variance[1]
    S01 = P[POSE, POSE + 1]
    T = (S11 * d0 * d0 - 2.0 * S01 * d0 * d1 + S00 * d1 * d1) / (S00 * S11 - S01 * S01)
    taken[:] = True
    if limits[1] < T:
        alone = np.array([d0 * d0 / S00, d1 * d1 / S11])
        kept = 0 if alone[0] <= alone[1] else 1
        taken[1 - kept] = False
        taken[kept] = alone[kept] <= limits[0]
    h = np.zeros(len(mean))
    for i in range(2):
        d = z[i] - mean[POSE + i]
        if taken[i]:
            h[:] = 0.0
            h[POSE + i] = 1.0
            _correct(mean, P, h, d, variance[i])
    for i in range(2):
        if not taken[i]:
            P[POSE + i, POSE + i] += (z[i] - mean[POSE + i]) ** 2 / (limits[0] * patience)
    return float(T)


@njit(cache=True)
def step(
    mean: FloatArray,
    P: FloatArray,
    left: float,
    right: float,
    dt: float,
    inverse: FloatArray,
    variance: FloatArray,
    limits: FloatArray,
    patience: float,
    C: FloatArray,
    arc: bool,
    slips: FloatArray,
    where: np.ndarray,
    track: float,
    disturbance: FloatArray,
    drift: FloatArray,
    wander: FloatArray,
) -> None:
    """Take rim speeds left, right [m/s] into the state, then ``advance`` it, in place; ``inverse`` is C^-1."""
    z, taken = np.empty(2), np.empty(2, np.bool_)
    for i in range(2):
        z[i] = inverse[i, 0] * left + inverse[i, 1] * right
    observe(mean, P, z, variance, limits, patience, taken)
    advance(mean, P, dt, C, arc, slips, where, track, disturbance, drift, wander)


@njit(cache=True)
def see_position(
    mean: FloatArray,
    P: FloatArray,
    z: FloatArray,
    R: FloatArray,
    lever: FloatArray,
    limit: float,
) -> tuple[float, float, bool]:
    """Take a position into the state in place, unless its normalised innovation squared is above the limit.

    Args:
        mean: (n,) state.
        P: (n, n) its covariance.
        z: (2,) [m] position of the sensor.
        R: (2, 2) its covariance.
        lever: (2,) [m] place of the sensor on the robot.
        limit: chi-square threshold of two observations; infinite: take all.

    Returns:
        The normalised innovation squared, the determinant of the innovation's covariance, whether it was taken.
    """
    n = len(mean)
    c, s = math.cos(mean[2]), math.sin(mean[2])
    rx, ry = c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]
    H = np.zeros((2, n))
    H[0, 0], H[0, 2], H[1, 1], H[1, 2] = 1.0, -ry, 1.0, rx
    d = np.array([z[0] - mean[0] - rx, z[1] - mean[1] - ry])
    S = R.copy()
    for a in range(2):
        for b in range(2):
            for i in range(3):
                for j in range(3):
                    S[a, b] += H[a, i] * P[i, j] * H[b, j]
    det = S[0, 0] * S[1, 1] - S[0, 1] ** 2
    T = (S[1, 1] * d[0] ** 2 - 2.0 * S[0, 1] * d[0] * d[1] + S[0, 0] * d[1] ** 2) / det
    if limit < T:
        return T, det, False
    # Whitened by the Cholesky factor of R, the two are observations of unit variance, taken one after the other.
    l00 = math.sqrt(R[0, 0])
    l10 = R[1, 0] / l00
    l11 = math.sqrt(R[1, 1] - l10 * l10)
    d[0] /= l00
    d[1] = (d[1] - l10 * d[0]) / l11
    for i in range(3):
        H[0, i] /= l00
        H[1, i] = (H[1, i] - l10 * H[0, i]) / l11
    before = mean[:3].copy()
    _correct(mean, P, H[0], d[0], 1.0)
    for i in range(3):
        d[1] -= H[1, i] * (mean[i] - before[i])
    _correct(mean, P, H[1], d[1], 1.0)
    return T, det, True


@njit(cache=True)
def replay(
    t: FloatArray,
    z: FloatArray,
    seen_t: FloatArray,
    seen: FloatArray,
    used: np.ndarray,
    noise: FloatArray,
    lever: FloatArray,
    limit: float,
    mean: FloatArray,
    P: FloatArray,
    C: FloatArray,
    arc: bool,
    slips: FloatArray,
    where: np.ndarray,
    track: float,
    disturbance: FloatArray,
    drift: FloatArray,
    wander: FloatArray,
    variance: FloatArray,
    limits: FloatArray,
    patience: float,
    means: FloatArray,
    covariances: FloatArray,
    statistic: FloatArray,
    taken: np.ndarray,
    seen_means: FloatArray,
    seen_statistic: FloatArray,
    seen_deviance: FloatArray,
    seen_taken: np.ndarray,
) -> None:
    """Run the filter over wheel samples and positions, both in order of time.

    At a wheel sample the encoders are taken into the state, then time is advanced until the next, with a stop at each
    position in between. Further arguments as in ``advance``, ``observe``, ``see_position``; these are of its own::

        t: (n,) [s] of the wheel samples.
        z: (n, 2) observed motion parameters.
        seen_t: (p,) [s] of positions, wheel time, none before the first wheel sample.
        seen: (p, 2) [m].
        used: (p,) bool: take it into the state; else only tell where the robot is thought to be.
        noise: (2,) standard deviation [m] of a position, each axis, and [s] of its stamp.
        mean: (m,) state at t[0], changed in place to that after everything.
        P: (m, m) the same.
        means: out, (n, m) before the encoders of each sample are taken.
        covariances: out, (n, m, m), or (0, m, m): not wanted.
        statistic: out, (n,) of the compatibility test.
        taken: out, (n, 2) bool.
        seen_means: out, (p, m) at each position, after it was taken where it was.
        seen_statistic: out, (p,) NaN where not used.
        seen_deviance: out, (p,) -2 log of its likelihood, less a constant; zero where not used.
        seen_taken: out, (p,) bool.
    """
    n, at = len(t), 0
    D, R = np.empty((2, len(mean))), np.empty((2, 2))
    for k in range(n):
        means[k] = mean
        if len(covariances):
            covariances[k] = P
        statistic[k] = observe(mean, P, z[k], variance, limits, patience, taken[k])
        now = t[k]
        while at < len(seen_t) and (k == n - 1 or seen_t[at] < t[k + 1]):
            advance(mean, P, seen_t[at] - now, C, arc, slips, where, track, disturbance, drift, wander)
            now = seen_t[at]
            seen_statistic[at], seen_deviance[at], seen_taken[at] = math.nan, 0.0, False
            if used[at]:
                v, omega, _ = twist(mean, C, slips, where, track, D)
                along, aside = noise[1] * (v - omega * lever[1]), noise[1] * omega * lever[0]
                c, s = math.cos(mean[2]), math.sin(mean[2])
                ux, uy = c * along - s * aside, s * along + c * aside
                R[0, 0], R[1, 1] = noise[0] ** 2 + ux * ux, noise[0] ** 2 + uy * uy
                R[0, 1] = R[1, 0] = ux * uy
                T, det, seen_taken[at] = see_position(mean, P, seen[at], R, lever, limit)
                seen_statistic[at], seen_deviance[at] = T, T + math.log(det)
            seen_means[at] = mean
            at += 1
        if k < n - 1:
            advance(mean, P, t[k + 1] - now, C, arc, slips, where, track, disturbance, drift, wander)
