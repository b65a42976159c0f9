"""Planar rigid motions as arrays: poses (..., 3) are x [m], y [m], yaw [rad]; twists (..., 3) are v_x, v_y, omega.

Reference for exp and log: Sola, Deray, Atchuthan, "A micro Lie theory", arXiv:1812.01537, Eqs. (156)-(158).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def wrap(angle: ArrayLike) -> FloatArray:
    """Angles of any shape [rad] brought into [-pi, pi)."""
    wrapped = (np.asarray(angle, dtype=float) + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(np.where(wrapped >= np.pi, -np.pi, wrapped))  # just below -pi the remainder rounds up


def rotate(yaw: ArrayLike, vector: ArrayLike) -> FloatArray:
    """Rotate vectors (..., 2) by angles (...) [rad]."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = np.moveaxis(np.asarray(vector, dtype=float), -1, 0)
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def compose(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Pose b given in the frame of pose a, brought into a's parent frame: (..., 3). Yaw is left unwrapped."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    position = a[..., :2] + rotate(a[..., 2], b[..., :2])
    return np.concatenate([position, (a[..., 2] + b[..., 2])[..., None]], axis=-1)


def invert(pose: ArrayLike) -> FloatArray:
    """Inverse motion (..., 3): composed with the pose it gives zero."""
    pose = np.asarray(pose, dtype=float)
    position = -rotate(-pose[..., 2], pose[..., :2])
    return np.concatenate([position, -pose[..., 2:]], axis=-1)


def between(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Motion (..., 3) from pose a to pose b seen in a's frame, yaw wrapped to [-pi, pi)."""
    motion = compose(invert(a), b)
    motion[..., 2] = wrap(motion[..., 2])
    return motion


def exp(twist: ArrayLike) -> FloatArray:
    """Pose (..., 3) reached from the origin by a twist (..., 3) held for one second."""
    dx, dy, dyaw = np.moveaxis(np.asarray(twist, dtype=float), -1, 0)
    # sinc forms of sin(a)/a and (1 - cos(a))/a: exact at a = 0, so no branch.
    half = 0.5 * dyaw
    s, c = np.sinc(dyaw / np.pi), np.sin(half) * np.sinc(half / np.pi)
    return np.stack([s * dx - c * dy, c * dx + s * dy, dyaw], axis=-1)


def log(pose: ArrayLike) -> FloatArray:
    """Twist (..., 3) that reaches the pose in one second; the yaw is wrapped first, so |omega| <= pi."""
    pose = np.asarray(pose, dtype=float)
    yaw = wrap(pose[..., 2])
    half = 0.5 * yaw
    a = np.cos(half) / np.sinc(half / np.pi)  # (yaw / 2) / tan(yaw / 2), exact at zero
    x, y = pose[..., 0], pose[..., 1]
    return np.stack([a * x + half * y, a * y - half * x, yaw], axis=-1)


def chain(motions: ArrayLike, start: ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
    """Poses (n + 1, 3) reached by motions (n, 3), each given in the frame where it begins; yaw is unwrapped."""
    motions, start = np.asarray(motions, dtype=float).reshape(-1, 3), np.asarray(start, dtype=float)
    yaw = start[2] + np.concatenate([[0.0], np.cumsum(motions[:, 2])])
    steps = rotate(yaw[:-1], motions[:, :2])
    position = start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.concatenate([position, yaw[:, None]], axis=1)
