"""Student's t, by squared distances alone: errors that are Gaussian, each of a scale of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, minimize_scalar
from scipy.special import gammaln
from scipy.stats import chi2

from skidsteer.se2 import FloatArray

SCALES = 1e-2, 1e2
DOFS = 1.0, 1e3  # the last: Gaussian


def deviance(squared: FloatArray, scale: float, dof: float, dimensions: ArrayLike = 3.0) -> float:
    """-2 log likelihood, less what does not depend on scale and degrees of freedom.

    Args:
        squared: (k,) squared distances from none, by the covariance that ``scale`` multiplies.
        scale: of the covariance.
        dof: degrees of freedom; large: Gaussian.
        dimensions: of the errors, one number or (k,).
    """
    n, p = dof, np.asarray(dimensions)
    each = (n + p) * np.log1p(squared / (scale * n)) + p * np.log(scale * n)
    return float((each + 2.0 * (gammaln(0.5 * n) - gammaln(0.5 * (n + p)))).sum())


def lightest_tails(squared: FloatArray, dimensions: FloatArray) -> tuple[float, float]:
    """Scale, and the most degrees of freedom that a likelihood-ratio test at 1 % (one-sided) does not rule out.

    A few errors are taken for Gaussian, unless they clearly are not.

    Args:
        squared: (k,) squared distances from none.
        dimensions: (k,) of the errors.
    """
    limits = tuple(np.log(SCALES).tolist())

    def scaled(log_dof: float) -> tuple[float, float]:
        dof = float(np.exp(log_dof))
        found = minimize_scalar(lambda x: deviance(squared, np.exp(x), dof, dimensions), bounds=limits)
        return float(found.fun), float(np.exp(found.x))

    low, high = np.log(DOFS)
    likeliest = minimize_scalar(lambda x: scaled(x)[0], bounds=(low, high))
    limit = float(likeliest.fun) + chi2.ppf(0.98, 1)
    if scaled(high)[0] <= limit:
        return scaled(high)[1], DOFS[1]
    edge = brentq(lambda x: scaled(x)[0] - limit, float(likeliest.x), high, xtol=1e-3)
    return scaled(edge)[1], float(np.exp(edge))


def weights(squared: FloatArray, scale: float, dof: float, dimensions: ArrayLike = 3.0) -> FloatArray:
    """Expected shares (k,) of the information that errors keep, one on average (Lange, Little and Taylor 1989)."""
    return np.asarray((dof + np.asarray(dimensions)) / (dof + squared / scale))
