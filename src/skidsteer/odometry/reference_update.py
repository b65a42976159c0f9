"""Updates of a state that begins with a pose, by a reference, a gyro or a standstill, in Joseph's form.

Measurements are tested first, as in Thalmann 2016: where they are compatible with the prediction, the innovation d has
mean zero and the covariance D = H P H' + R, and T = d' D^-1 d, Eq. (10), is chi-square with as many degrees of freedom
as d has elements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.stats import chi2

from skidsteer.errors import DataError, RequestError
from skidsteer.odometry.state import (
    SAME_TIME,
    FilterState,
    Innovation,
    Measurement,
    Pose,
    Position,
    Standstill,
    YawRate,
    refuse_indefinite,
)
from skidsteer.se2 import FloatArray, rotate, wrap

STANDSTILL = 1e-3  # [m/s] standard deviation of each rim's speed of a robot at rest


@lru_cache
def threshold(significance: float, count: int) -> float:
    """Value that T of ``count`` compatible observations exceeds with this probability; infinite for zero.

    Raises:
        RequestError: a significance outside [0, 1).
    """
    if not 0.0 <= significance < 1.0:
        raise RequestError(f"a significance is a probability from 0 (no test) to below 1, got {significance}")
    return float(chi2.isf(significance, count)) if significance > 0.0 else math.inf


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """The motion in a state (n,), linearised."""

    v: float  # [m/s]
    omega: float  # [rad/s]
    turning: FloatArray  # (n,) derivative of omega
    rims: FloatArray  # (2,) rim speeds [m/s]
    rolling: FloatArray  # (2, n) derivative of the rim speeds


def innovation(state: FilterState, moving: Moving, seen: Measurement) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Measured less expected (k,), derivative H (k, n) of the expected, and covariance (k, k) of the noise."""
    if isinstance(seen, YawRate):
        return np.array([seen.rate - moving.omega]), moving.turning[None], np.array([[seen.variance]])
    if isinstance(seen, Standstill):
        return -moving.rims, moving.rolling, STANDSTILL**2 * np.eye(2)
    yaw = float(state.mean[2])
    lever = rotate(yaw, [seen.mount.x, seen.mount.y])
    H = np.eye(len(state.mean))[:3]
    H[:2, 2] = -lever[1], lever[0]
    path = np.r_[rotate(yaw, [moving.v, 0.0]) + moving.omega * rotate(0.5 * np.pi, lever), moving.omega]
    late = seen.stamp**2 * np.outer(path, path)  # a scatter of the stamp moves it along its own path
    if isinstance(seen, Position):
        return seen.position - state.mean[:2] - lever, H[:2], seen.covariance + late[:2, :2]
    assert isinstance(seen, Pose)
    turned = wrap(seen.pose[2] - seen.mount.yaw - yaw)
    return np.r_[seen.pose[:2] - state.mean[:2] - lever, turned], H, seen.covariance + late


def updated(state: FilterState, moving: Moving, seen: Measurement, gate: float) -> tuple[FilterState, Innovation]:
    """The state with a measurement, unless it is incompatible at the significance ``gate`` (0: take all).

    Raises:
        DataError: the measurement holds at another time, is not finite, or its covariance not positive definite.
    """
    if not abs(seen.time - state.time) <= SAME_TIME:
        raise DataError(f"the measurement holds at {seen.time} s, the state at {state.time} s; predict first")
    d, H, R = innovation(state, moving, seen)
    if not np.isfinite(d).all():
        raise DataError(f"the measurement at {state.time:.3f} s is NaN or infinite; leave it out")
    R, P = refuse_indefinite("measurement", R), state.covariance
    S = H @ P @ H.T + R
    squared = float(d @ np.linalg.solve(S, d))
    if squared > threshold(gate, len(d)):
        return state, Innovation(squared, len(d), accepted=False)
    K = np.linalg.solve(S, H @ P).T
    A = np.eye(len(P)) - K @ H
    joseph = A @ P @ A.T + K @ R @ K.T
    kept = FilterState(state.filter, state.time, state.mean + K @ d, 0.5 * (joseph + joseph.T))
    return kept, Innovation(squared, len(d), accepted=True)
