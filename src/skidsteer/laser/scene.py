"""A simulated 2D scanner: rays cast to plates and walls, independent of how a plate is found again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.laser.scans import Scanner, Scans
from skidsteer.se2 import FloatArray

Wall = tuple[tuple[float, float], tuple[float, float]]  # [m] its two ends in the scanner's frame


def simulate_scans(
    scanner: Scanner,
    plates: Sequence[tuple[ArrayLike, float]],
    walls: Sequence[Wall] = (),
    dropouts: float = 0.0,
    stray: float = 0.0,
    seed: int = 0,
) -> Scans:
    """Scan moving plates in front of fixed walls, ``scanner.rate`` times a second from t = 0.

    Args:
        scanner: its field, noise, resolution and limits of the range, outside of which there is none.
        plates: of each, the poses (n, 3) of its centre and direction in the scanner's frame, and its width [m]. Poses
            (n, m, 3): one for each of the m rays, for a plate that moves during a scan.
        walls: opaque, as the plates are.
        dropouts: share of rays without a range.
        stray: share of rays that return from anywhere along the ray.
        seed: of the noise.

    Raises:
        ValueError: no plate.
    """
    if not plates:
        raise ValueError("plates must not be empty: give their poses for every scan")
    bearings, rng = scanner.bearings, np.random.default_rng(seed)
    rays = np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
    ranges = np.minimum.reduce([_to_plate(rays, np.asarray(pose, dtype=float), width) for pose, width in plates])
    for begin, end in walls:
        start = np.array(begin)
        ranges = np.minimum(ranges, _to_segment(rays, start, np.array(end) - start))
    ranges = ranges + scanner.range_sigma * rng.standard_normal(ranges.shape)
    odd = rng.random(ranges.shape) < stray
    ranges = np.where(odd, np.minimum(ranges, scanner.range_max) * rng.random(ranges.shape), ranges)
    ranges = np.where(np.isfinite(ranges), np.round(ranges / scanner.resolution) * scanner.resolution, np.inf)
    lost = (ranges < scanner.range_min) | (ranges > scanner.range_max) | (rng.random(ranges.shape) < dropouts)
    return Scans(np.arange(len(ranges)) / scanner.rate, bearings, np.where(lost, np.inf, ranges))


def _to_plate(rays: FloatArray, pose: FloatArray, width: float) -> FloatArray:
    pose = pose[:, None] if pose.ndim == 2 else pose
    along = width * np.stack([np.cos(pose[..., 2]), np.sin(pose[..., 2])], axis=-1)
    return _to_segment(rays, pose[..., :2] - 0.5 * along, along)


def _to_segment(rays: FloatArray, start: FloatArray, along: FloatArray) -> FloatArray:
    """Ranges at which rays (m, 2) meet segments (..., 2), broadcast against each other; infinity where they do not."""
    with np.errstate(divide="ignore", invalid="ignore"):
        facing = _cross(rays, along)
        distance = _cross(start, along) / facing  # start + s along = distance ray
        share = _cross(start, rays) / facing
        hit = (distance > 0.0) & (share >= 0.0) & (share <= 1.0)
    return np.where(hit, distance, np.inf)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
