"""Chains of windows that share noisy poses: whitening, likelihood and smoothing in one pass each.

Pose k is measured as z_k = x_k exp(e_k), the body moves as x_k+1 = x_k T_k exp(w_k). For d_k = log(z_k^-1 x_k) = -e_k,
seen in the body frame at k, and the residual r_k = z_k^-1 z_k+1 - T_k (in the frame at k) this gives, to first order,

    d_k+1 = F_k d_k - b_k + w_k,    F_k = E_k^T G_k,    b_k = E_k^T r_k,

with E_k the rotation by the yaw of the window and G_k the effect of a start pose error on its end. That is a linear
Kalman filter with the measurement 0 = d_k + e_k: its innovations are the residuals freed of the correlation that
neighbouring windows have through the pose they share, and the same filter frees each column of the Jacobian.

A gyro that tells the yaw of a window measures the yaw of w_k itself: g_k = w_k,yaw + n_k is its turn less that of T_k.
It is taken into the prior of w_k before the window is chained, and counts in the likelihood by its own.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.se2 import FloatArray


@njit(cache=True)
def _transition(motion: FloatArray, F: FloatArray) -> tuple[float, float]:
    px, py = motion[0], motion[1]
    c, s = math.cos(motion[2]), math.sin(motion[2])
    F[0, 0], F[0, 1], F[0, 2] = c, s, -c * py + s * px
    F[1, 0], F[1, 1], F[1, 2] = -s, c, s * py + c * px
    F[2, 0], F[2, 1], F[2, 2] = 0.0, 0.0, 1.0
    return c, s


@njit(cache=True)
def _propagate(F: FloatArray, P: FloatArray, process: FloatArray, out: FloatArray) -> None:
    """Out = F P F^T + Q with Q diagonal."""
    for i in range(3):
        for j in range(3):
            total = process[i] if i == j else 0.0
            for a in range(3):
                for b in range(3):
                    total += F[i, a] * P[a, b] * F[j, b]
            out[i, j] = total


@njit(cache=True)
def _cholesky(S: FloatArray, L: FloatArray) -> None:
    """Lower factor of a positive definite (3, 3)."""
    L[0, 0] = math.sqrt(S[0, 0])
    L[1, 0] = S[1, 0] / L[0, 0]
    L[1, 1] = math.sqrt(S[1, 1] - L[1, 0] ** 2)
    L[2, 0] = S[2, 0] / L[0, 0]
    L[2, 1] = (S[2, 1] - L[2, 0] * L[1, 0]) / L[1, 1]
    L[2, 2] = math.sqrt(S[2, 2] - L[2, 0] ** 2 - L[2, 1] ** 2)


@njit(cache=True)
def _forward(L: FloatArray, x: FloatArray) -> None:
    """Replace x (3,) by the solution of L y = x."""
    x[0] = x[0] / L[0, 0]
    x[1] = (x[1] - L[1, 0] * x[0]) / L[1, 1]
    x[2] = (x[2] - L[2, 0] * x[0] - L[2, 1] * x[1]) / L[2, 2]


@njit(cache=True)
def _whitened_gain(L: FloatArray, P: FloatArray, K: FloatArray) -> None:
    """K (3, 3) = P L^-T, so that the Kalman gain is K L^-1."""
    for i in range(3):
        K[i, 0] = P[i, 0] / L[0, 0]
        K[i, 1] = (P[i, 1] - L[1, 0] * K[i, 0]) / L[1, 1]
        K[i, 2] = (P[i, 2] - L[2, 0] * K[i, 0] - L[2, 1] * K[i, 1]) / L[2, 2]


@njit(cache=True)
def _update(K: FloatArray, L: FloatArray, Pm: FloatArray, noise: FloatArray, P: FloatArray) -> None:
    """P = (I - G) Pm (I - G)^T + G N G^T with the gain G = K L^-1: stays positive where the yaw is hardly known."""
    G, A = np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        G[i, 2] = K[i, 2] / L[2, 2]
        G[i, 1] = (K[i, 1] - G[i, 2] * L[2, 1]) / L[1, 1]
        G[i, 0] = (K[i, 0] - G[i, 1] * L[1, 0] - G[i, 2] * L[2, 0]) / L[0, 0]
        for j in range(3):
            A[i, j] = (1.0 if i == j else 0.0) - G[i, j]
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += A[i, a] * Pm[a, b] * A[j, b] + G[i, a] * noise[a, b] * G[j, b]
            P[i, j] = total
            P[j, i] = total


@njit(cache=True)
def information(
    motion: FloatArray,
    joined: np.ndarray,
    residual: FloatArray,
    jacobian: FloatArray,
    process: FloatArray,
    noise_start: FloatArray,
    noise_end: FloatArray,
    gyro: FloatArray,
    gyro_jacobian: FloatArray,
    gyro_variance: FloatArray,
    block: np.ndarray,
    blocks: int,
) -> tuple[FloatArray, FloatArray, float]:
    """Gauss-Newton matrix, score of each block, and -2 log likelihood (less its constant) of a chain.

    Args:
        motion: (k, 3) measured motion of each window in its start frame.
        joined: (k,) bool: the window begins with the pose that the one before ended with.
        residual: (k, 3) measured less predicted motion, start frame, yaw wrapped.
        jacobian: (k, 3, p) derivative of the predicted motion.
        process: (k, 3) variance of the motion in the body frame at its end.
        noise_start: (k, 3, 3) covariance of the pose a window begins with, body frame; used where it is not joined.
        noise_end: (k, 3, 3) covariance of the pose a window ends with, body frame.
        gyro: (k,) turn that the gyro tells less the predicted yaw.
        gyro_jacobian: (k, p) derivative of ``gyro``.
        gyro_variance: (k,) of the gyro's turn; infinite where it tells nothing.
        block: (k,) number of the block that a window belongs to, below ``blocks``.
        blocks: how many blocks there are.

    Returns:
        information (p, p), scores (blocks, p) whose sum is the Gauss-Newton right-hand side, and the deviance.
    """
    count, p = len(motion), jacobian.shape[2]
    H, scores, deviance = np.zeros((p, p)), np.zeros((blocks, p)), 0.0
    D, B, P, F, S, L, K = (
        np.zeros((3, p + 1)),
        np.zeros(3),
        np.zeros((3, 3)),
        np.zeros((3, 3)),
        np.zeros((3, 3)),
        np.zeros((3, 3)),
        np.zeros((3, 3)),
    )
    Pm, white = np.zeros((3, 3)), np.zeros((4, p + 1))
    column, Q = np.zeros(3), np.zeros(3)
    for k in range(count):
        if not joined[k]:
            D[:] = 0.0
            P[:] = noise_start[k]
        c, s = _transition(motion[k], F)
        Q[:] = process[k]
        spread = Q[2] + gyro_variance[k]
        told = spread < np.inf and spread > 0.0
        share = Q[2] / spread if told else 0.0
        if told:
            Q[2] *= 1.0 - share
            deviance += math.log(spread)
        white[3] = 0.0
        _propagate(F, P, Q, Pm)
        for i in range(3):
            for j in range(3):
                S[i, j] = Pm[i, j] + noise_end[k, i, j]
        _cholesky(S, L)
        _whitened_gain(L, Pm, K)
        deviance += 2.0 * math.log(L[0, 0] * L[1, 1] * L[2, 2])
        for m in range(p + 1):
            if m == p:
                u, v, q = residual[k, 0], residual[k, 1], residual[k, 2]
            else:
                u, v, q = -jacobian[k, 0, m], -jacobian[k, 1, m], -jacobian[k, 2, m]
            B[0], B[1], B[2] = c * u + s * v, -s * u + c * v, q
            for i in range(3):
                column[i] = F[i, 0] * D[0, m] + F[i, 1] * D[1, m] + F[i, 2] * D[2, m] - B[i]
            if told:
                turn = gyro[k] if m == p else gyro_jacobian[k, m]
                column[2] += share * turn
                white[3, m] = turn / math.sqrt(spread)
            D[0, m], D[1, m], D[2, m] = column[0], column[1], column[2]
            _forward(L, column)
            for i in range(3):
                white[i, m] = -column[i]
                D[i, m] -= K[i, 0] * column[0] + K[i, 1] * column[1] + K[i, 2] * column[2]
        _update(K, L, Pm, noise_end[k], P)
        for m in range(p):
            for i in range(4):
                scores[block[k], m] -= white[i, m] * white[i, p]
                for n in range(m + 1):
                    H[m, n] += white[i, m] * white[i, n]
        for i in range(4):
            deviance += white[i, p] ** 2
    for m in range(p):
        for n in range(m):
            H[n, m] = H[m, n]
    return H, scores, deviance


@njit(cache=True)
def smooth(
    motion: FloatArray,
    joined: np.ndarray,
    residual: FloatArray,
    process: FloatArray,
    noise_start: FloatArray,
    noise_end: FloatArray,
    gyro: FloatArray,
    gyro_variance: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Most probable errors given the whole chain: of start poses (k, 3), end poses (k, 3) and motions (k, 3).

    Arguments as in ``information``. Poses in the body frame at the pose, motions in the body frame at the end of the
    window. Start poses are filled in where the window is not joined, else zero. Rauch-Tung-Striebel.
    """
    count = len(motion)
    d, dm = np.zeros((count, 3)), np.zeros((count, 3))  # filtered state at the end; predicted before its measurement
    P, Pm, F = np.zeros((count, 3, 3)), np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
    L, K, S, P0, column = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    b, Q = np.zeros((count, 3)), np.zeros(3)
    for k in range(count):
        Q[:] = process[k]
        spread = Q[2] + gyro_variance[k]
        share = Q[2] / spread if spread < np.inf and spread > 0.0 else 0.0
        Q[2] *= 1.0 - share
        before = np.zeros(3)
        P0[:] = noise_start[k]
        if joined[k]:
            before[:] = d[k - 1]
            P0[:] = P[k - 1]
        c, s = _transition(motion[k], F[k])
        _propagate(F[k], P0, Q, Pm[k])
        for i in range(3):
            for j in range(3):
                S[i, j] = Pm[k, i, j] + noise_end[k, i, j]
        _cholesky(S, L)
        _whitened_gain(L, Pm[k], K)
        u, v = residual[k, 0], residual[k, 1]
        b[k, 0], b[k, 1], b[k, 2] = c * u + s * v, -s * u + c * v, residual[k, 2]
        for i in range(3):
            dm[k, i] = F[k, i, 0] * before[0] + F[k, i, 1] * before[1] + F[k, i, 2] * before[2] - b[k, i]
            if i == 2:
                dm[k, i] += share * gyro[k]
            column[i] = dm[k, i]
        _forward(L, column)
        for i in range(3):
            d[k, i] = dm[k, i] - (K[i, 0] * column[0] + K[i, 1] * column[1] + K[i, 2] * column[2])
        _update(K, L, Pm[k], noise_end[k], P[k])
    start, end, moved = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    for k in range(count - 1, -1, -1):
        last = k + 1 >= count or not joined[k + 1]
        smoothed = d[k].copy()
        if not last:  # start[k + 1] holds the smoothed state at this pose until it is cleared below
            smoothed[:] = start[k + 1]
            start[k + 1] = 0.0
        end[k] = -smoothed
        _cholesky(Pm[k], L)
        lead = smoothed - dm[k]
        _forward(L, lead)
        lead[2] = lead[2] / L[2, 2]
        lead[1] = (lead[1] - L[2, 1] * lead[2]) / L[1, 1]
        lead[0] = (lead[0] - L[1, 0] * lead[1] - L[2, 0] * lead[2]) / L[0, 0]
        P0[:] = P[k - 1] if joined[k] else noise_start[k]
        for i in range(3):
            start[k, i] = d[k - 1, i] if joined[k] else 0.0
            for a in range(3):
                for j in range(3):
                    start[k, i] += P0[i, a] * F[k, j, a] * lead[j]
        for i in range(3):
            moved[k, i] = smoothed[i] + b[k, i]
            for j in range(3):
                moved[k, i] -= F[k, i, j] * start[k, j]
        if not joined[k]:
            start[k] = -start[k]
    return start, end, moved
