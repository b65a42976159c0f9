"""Runs of neighbouring rays that hit one surface."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skidsteer.laser.line import BoolArray, IntArray, Points
from skidsteer.laser.scans import Scans
from skidsteer.se2 import FloatArray

GRAZING = math.radians(12.0)  # least angle between ray and surface at which its points stay together
MISSING = 3  # rays in a row that may fail within a surface
APART = 7.0  # sigmas by which neighbouring points of a surface may differ: five sigmas of their difference
FEWEST_BEFORE = 3  # points of an object that can hide another; fewer are stray
SPIKE = 6.0  # sigmas of a ray off the mean of its two neighbours


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """Clusters of k points in c runs, sorted by scan, then by ray."""

    ray: IntArray  # (k,)
    range: FloatArray  # (k,) [m]
    first: IntArray  # (c,) index of the first point
    count: IntArray  # (c,) of its points
    scan: IntArray  # (c,)
    hidden: BoolArray  # (c,) whether a nearer object hides one of its ends

    @property
    def last(self) -> IntArray:
        """Index (c,) of the last point."""
        return self.first + self.count - 1

    def where(self, keep: BoolArray) -> Clusters:
        """The clusters chosen by a mask (c,)."""
        points = np.repeat(keep, self.count)
        count = self.count[keep]
        return Clusters(
            self.ray[points], self.range[points], np.cumsum(count) - count, count, self.scan[keep], self.hidden[keep]
        )

    def points(self, bearings: FloatArray) -> Points:
        """Their points, for a fit."""
        return Points(np.repeat(np.arange(len(self.count)), self.count), bearings[self.ray], self.range)


def find_clusters(scans: Scans, sigma: float) -> Clusters:
    """Cut each scan where neighbouring points lie too far apart for one surface, or too many rays fail.

    Points of a surface may be as far apart as on a wall that the rays meet at ``GRAZING``, plus noise. Single rays off
    two neighbours that agree are left out: rain, dust, a reflection.

    Args:
        scans: any number, each cut on its own.
        sigma: [m] standard deviation of a range.
    """
    reach = scans.step / math.sin(GRAZING)
    flat = np.flatnonzero((scans.ranges > 0.0) & ~_spikes(scans.ranges, reach, sigma))
    scan, ray = np.divmod(flat, len(scans.bearings))
    distance = scans.ranges.ravel()[flat]
    rays = np.diff(ray)
    near, far = np.minimum(distance[:-1], distance[1:]), np.maximum(distance[:-1], distance[1:])
    gap = np.hypot(far - near, near * scans.step * rays)
    cut = (np.diff(scan) != 0) | (rays > MISSING + 1) | (gap > near * reach * rays + APART * sigma)
    first = np.concatenate([[0], np.flatnonzero(cut) + 1]) if flat.size else np.zeros(0, dtype=np.int64)
    count = np.diff(np.append(first, flat.size))
    last = first + count - 1
    big, beside = count >= FEWEST_BEFORE, ray[first[1:]] - ray[last[:-1]] <= MISSING + 1
    beside &= (scan[first[1:]] == scan[first[:-1]]) & big[1:] & big[:-1]
    step = distance[first[1:]] - distance[last[:-1]]
    hidden = np.append(beside & (step < 0.0), False) | np.append(False, beside & (step > 0.0))[: len(first)]
    return Clusters(ray, distance, first, count, scan[first], hidden[: len(first)])


def _spikes(ranges: FloatArray, reach: float, sigma: float) -> BoolArray:
    left, middle, right = ranges[:, :-2], ranges[:, 1:-1], ranges[:, 2:]
    spikes = np.zeros(ranges.shape, dtype=bool)
    agree = np.abs(left - right) <= 2.0 * reach * left + APART * sigma
    off = np.abs(middle - 0.5 * (left + right)) > SPIKE * sigma + reach * left
    spikes[:, 1:-1] = agree & off & (left > 0.0) & (right > 0.0)
    return spikes
