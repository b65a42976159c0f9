"""Do observations fit a prediction? The test on innovations of Thalmann 2016, Eq. (10), and what to exclude.

Where prediction and observations are compatible, the innovation d has mean zero and the covariance D = H P H' + R, and

    T = d' D^-1 d      Eq. (10)

is chi-square with as many degrees of freedom as there are observations. Above its threshold either the system or an
observation is at fault. The one whose exclusion lowers T the most goes first: T falls by w_i^2 = (D^-1 d)_i^2 /
(D^-1)_ii, and the rest is tested again, on its own block of D.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from skidsteer.errors import DataError, RequestError
from skidsteer.odometry.state import refuse_indefinite


@lru_cache
def threshold(significance: float, count: int) -> float:
    """Value that T of ``count`` compatible observations exceeds with this probability; infinite for zero.

    Raises:
        RequestError: a significance outside [0, 1).
    """
    if not 0.0 <= significance < 1.0:
        raise RequestError(f"a significance is a probability from 0 (no test) to below 1, got {significance}")
    return float(chi2.isf(significance, count)) if significance > 0.0 else math.inf


def statistic(innovation: ArrayLike, covariance: ArrayLike) -> float:
    """T of Eq. (10) of an innovation (n,) with its covariance (n, n); zero for no observation."""
    d = np.asarray(innovation, dtype=float)
    return float(d @ np.linalg.solve(np.asarray(covariance, dtype=float), d)) if d.size else 0.0


def compatible(innovation: ArrayLike, covariance: ArrayLike, significance: float) -> tuple[float, np.ndarray]:
    """Test observations, and exclude one after the other until the rest is compatible.

    Args:
        innovation: (n,) observed less predicted.
        covariance: (n, n) of it, positive definite.
        significance: probability with which compatible observations fail the first test; 0: no test.

    Returns:
        T of all, and a mask (n,) of those to take; all False where even the best one alone is incompatible.

    Raises:
        DataError: an innovation that is not finite or does not fit its covariance, a covariance that is none.
    """
    d, D = np.asarray(innovation, dtype=float), refuse_indefinite("innovation", covariance)
    if d.shape != D.shape[:1] or not np.isfinite(d).all():
        raise DataError(f"an innovation is finite and of the size of its covariance {D.shape}, got {d}")
    index = np.arange(len(d))
    first = T = statistic(d, D)
    while index.size and threshold(significance, index.size) < T:
        block = D[np.ix_(index, index)]
        fall = np.linalg.solve(block, d[index]) ** 2 / np.diag(np.linalg.inv(block))
        index = np.delete(index, np.argmax(fall))
        T = statistic(d[index], D[np.ix_(index, index)])
    return first, np.isin(np.arange(len(d)), index)
