"""Straight lines through clusters of laser points, well conditioned in every direction.

Wang 2015, Eqs. (31)-(35), fits y = k x + a. The slope is not defined for a line along y, and near that is biased
towards 0 by the noise of x. Here total least squares gives the start, and least squares along the rays, where the noise
is, the result: r = d / cos(bearing - normal), with d the distance of the line from the scanner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skidsteer.se2 import FloatArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

OUTLIER = 4.0  # sigmas from the line beyond which a point does not belong to it
SINGULAR = 1e-9  # least 1 - squared correlation of normal and distance: below it rounding decides
STEPS = 3  # of Gauss-Newton; the start is close enough for two


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Points of clusters, sorted by cluster, then by ray."""

    cluster: IntArray  # (k,) numbered from 0 without a gap
    bearing: FloatArray  # (k,) [rad]
    range: FloatArray  # (k,) [m]

    @property
    def clusters(self) -> int:
        """Number of clusters."""
        return int(self.cluster[-1]) + 1 if self.cluster.size else 0

    def total(self, values: FloatArray | BoolArray) -> FloatArray:
        """Sums (c,) over each cluster of values (k,)."""
        return np.asarray(np.bincount(self.cluster, values, self.clusters), dtype=float)


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """One line for each of c clusters.

    ``cofactor`` (c, 2, 2) times the variance of a range is the covariance of normal and distance.
    """

    normal: FloatArray  # (c,) direction [rad] from the scanner to the nearest point of the line
    distance: FloatArray  # (c,) [m] of that point
    cofactor: FloatArray
    kept: BoolArray  # (k,) points that are no outliers
    square_sum: FloatArray  # (c,) [m2] of their residuals along the rays


def total_least_squares(points: Points) -> tuple[FloatArray, FloatArray]:
    """Normal [rad] and distance [m], each (c,), of total least squares lines.

    In place of the slope of Wang 2015, Eqs. (31)-(34); it fails for no direction.
    """
    x, y = points.range * np.cos(points.bearing), points.range * np.sin(points.bearing)  # Eq. (30)
    count = points.total(np.ones_like(x))
    mean_x, mean_y = points.total(x) / count, points.total(y) / count  # Eq. (32)
    x, y = x - mean_x[points.cluster], y - mean_y[points.cluster]
    along = 0.5 * np.arctan2(2.0 * points.total(x * y), points.total(x * x) - points.total(y * y))
    normal = along + 0.5 * np.pi
    distance = mean_x * np.cos(normal) + mean_y * np.sin(normal)
    return np.where(distance < 0.0, normal - np.pi, normal), np.abs(distance)


def fit_lines(points: Points, sigma: float) -> Lines:
    """Least squares along the rays, without the points that lie more than ``OUTLIER`` sigmas off.

    Args:
        points: at least three in each cluster.
        sigma: [m] standard deviation of a range.

    Returns:
        The lines; all NaN for one that runs through the scanner or has fewer than two points left.
    """
    normal, distance = total_least_squares(points)
    kept = np.ones(points.range.shape, dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(STEPS):
            residual, by_normal, by_distance = _residuals(points, normal, distance)
            kept = np.abs(residual) <= OUTLIER * max(sigma, 1e-9)
            step, _ = _solve(points, residual, by_normal, by_distance, kept)
            normal, distance = normal + step[0], distance + step[1]
        residual, by_normal, by_distance = _residuals(points, normal, distance)
        _, cofactor = _solve(points, residual, by_normal, by_distance, kept)
    bad = ~_is_sound(distance, cofactor)
    normal[bad], distance[bad], cofactor[bad] = np.nan, np.nan, np.nan
    return Lines(normal, distance, cofactor, kept, points.total(np.where(kept, residual**2, 0.0)))


def _is_sound(distance: FloatArray, cofactor: FloatArray) -> BoolArray:
    """Whether the points determine each line (c,), and it runs neither through the scanner nor behind it."""
    a, b, c = cofactor[:, 0, 0], cofactor[:, 0, 1], cofactor[:, 1, 1]
    with np.errstate(invalid="ignore", over="ignore"):
        known = (a > 0.0) & (c > 0.0) & (a * c - b * b > SINGULAR * a * c)
    return np.asarray(known & np.isfinite(a) & np.isfinite(c) & (distance > 0.0) & (distance < np.inf))


def _residuals(points: Points, normal: FloatArray, distance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Range minus that of the line (k,), and the derivatives of the latter with respect to normal and distance."""
    slant = points.bearing - normal[points.cluster]
    by_distance = 1.0 / np.cos(slant)
    expected = distance[points.cluster] * by_distance
    return points.range - expected, -expected * np.tan(slant), by_distance


def _solve(
    points: Points, residual: FloatArray, by_normal: FloatArray, by_distance: FloatArray, kept: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Step (2, c) of normal and distance, and the inverse (c, 2, 2) of the normal equations."""
    a, b = np.where(kept, by_normal, 0.0), np.where(kept, by_distance, 0.0)
    residual = np.where(kept, residual, 0.0)
    aa, ab, bb = points.total(a * a), points.total(a * b), points.total(b * b)
    right = np.stack([points.total(a * residual), points.total(b * residual)])
    determinant = aa * bb - ab * ab
    inverse = np.stack([bb, -ab, -ab, aa], axis=-1).reshape(-1, 2, 2) / determinant[:, None, None]
    return np.einsum("cij,jc->ic", inverse, right), inverse
