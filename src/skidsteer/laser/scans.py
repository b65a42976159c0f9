"""2D laser scanners and their scans.

The scanner's frame is REP-103's: x ahead, y left, bearings counter-clockwise from x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from skidsteer.errors import DataError
from skidsteer.se2 import FloatArray

EVEN = 0.05  # share of a step by which the steps between bearings may differ
LEAST_NOISE = 0.0005  # [m] of any scanner
NEAREST, FARTHEST = 0.001, 1e4  # [m] ranges of any scanner
LOOKED_AT = 200  # number of scans from which the noise is estimated


@dataclass(frozen=True, slots=True)
class Scanner:
    """A 2D laser scanner by its data sheet. The field is symmetric about the x axis."""

    field: float  # [rad] of view
    step: float  # [rad] between rays
    range_min: float  # [m]
    range_max: float  # [m]
    range_sigma: float  # [m] standard deviation of one range
    rate: float  # [Hz] scans a second
    resolution: float = 0.001  # [m] of a range as it is sent

    @property
    def bearings(self) -> FloatArray:
        """Directions (m,) of the rays [rad], ascending."""
        rays = round(self.field / self.step) + 1
        return np.asarray(self.step * (np.arange(rays) - 0.5 * (rays - 1)))


def _degrees(field: float, step: float, near: float, far: float, sigma: float, rate: float) -> Scanner:
    return Scanner(math.radians(field), math.radians(step), near, far, sigma, rate)


SCANNERS: dict[str, Scanner] = {
    "lms400": _degrees(70.0, 0.1, 0.7, 3.0, 0.003, 270.0),  # Wang 2015, 3.2
    "lms111": _degrees(270.0, 0.25, 0.5, 20.0, 0.012, 25.0),  # SICK's data sheet
    "utm-30lx": _degrees(270.0, 0.25, 0.1, 30.0, 0.010, 40.0),  # Hokuyo's data sheet
}


@dataclass(frozen=True, slots=True, eq=False)
class Scans:
    """Scans of one scanner at rest. Immutable.

    Ranges that are not finite, negative or beyond those of any scanner mean that nothing came back; they are kept as 0.
    Descending bearings, as of a scanner mounted upside down, are reversed.

    Raises:
        DataError: shapes that do not fit, no scan, fewer than three rays, bearings that are not evenly spaced or span
            more than a turn, times that are not finite or do not increase.
    """

    t: FloatArray  # (n,) [s] of the first ray
    bearings: FloatArray  # (m,) [rad] ascending, evenly spaced
    ranges: FloatArray  # (n, m) [m], 0 where nothing came back
    ray_delay: FloatArray | float = 0.0  # (m,) [s] from the stamp of a scan to each ray

    def __post_init__(self) -> None:
        t, bearings = np.array(self.t, dtype=float), np.array(self.bearings, dtype=float)
        ranges = np.array(self.ranges, dtype=float)
        if t.ndim != 1 or bearings.ndim != 1 or ranges.shape != (len(t), len(bearings)) or ranges.size == 0:
            raise DataError(f"scans: times {t.shape}, bearings {bearings.shape}, ranges {ranges.shape} do not fit")
        if not np.isfinite(t).all() or (np.diff(t) <= 0).any():
            raise DataError("scans: times must be finite and increase")
        delay = np.broadcast_to(np.asarray(self.ray_delay, dtype=float), bearings.shape).copy()
        if len(bearings) > 1 and bearings[0] > bearings[-1]:
            bearings, ranges, delay = bearings[::-1].copy(), ranges[:, ::-1].copy(), delay[::-1].copy()
        _refuse_uneven(bearings)
        ranges[~((ranges > NEAREST) & (ranges < FARTHEST))] = 0.0
        for name, array in (("t", t), ("bearings", bearings), ("ranges", ranges), ("ray_delay", delay)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.t)

    @property
    def step(self) -> float:
        """Angle [rad] between rays."""
        return float(self.bearings[-1] - self.bearings[0]) / (len(self.bearings) - 1)

    def rows(self, keep: slice) -> Scans:
        """Some of the scans."""
        return Scans(self.t[keep], self.bearings, self.ranges[keep], self.ray_delay)


def _refuse_uneven(bearings: FloatArray) -> None:
    if len(bearings) < 3:
        raise DataError(f"scans: {len(bearings)} rays; a plate needs more")
    steps = np.diff(bearings)
    mean = (bearings[-1] - bearings[0]) / len(steps)
    if not (mean > 0.0 and np.abs(steps - mean).max() <= EVEN * mean):
        raise DataError("scans: the bearings must be evenly spaced numbers in rad, ascending or descending")
    if mean * len(steps) > 2.0 * np.pi + 0.5 * mean:
        raise DataError(f"scans: the bearings span {mean * len(steps):.1f} rad, more than a turn; are they in degrees?")


def range_noise(scans: Scans) -> float:
    """Standard deviation [m] of a range, from the scatter of neighbouring rays about straight surfaces.

    Second differences of three neighbouring ranges, the largest tenth (edges, corners) left out; exact for normal noise
    where nine of ten triples lie on one surface. At least ``LEAST_NOISE``.
    """
    ranges = scans.ranges[:: max(1, len(scans) // LOOKED_AT)]
    left, middle, right = ranges[:, :-2], ranges[:, 1:-1], ranges[:, 2:]
    bend = np.abs(left - 2.0 * middle + right)[(left > 0) & (middle > 0) & (right > 0)]
    if not bend.size:
        return LEAST_NOISE
    inner = bend[bend <= np.quantile(bend, 0.9)]
    share = 0.6230  # of the variance of a normal variable that is left when its outer tenth is cut off
    return max(LEAST_NOISE, float(np.sqrt(np.mean(inner**2) / share / 6.0)))


def edge_filter(scans: Scans, jump: float) -> Scans:
    """Edge filter as scanners have it: no range where a neighbouring ray has none, or differs by ``jump`` [m] or more.

    Removes rays that hit two objects at once. A plate loses a ray at each end.
    """
    ranges, edge = scans.ranges, np.zeros(scans.ranges.shape, dtype=bool)
    apart = (np.abs(np.diff(ranges, axis=1)) >= jump) | (ranges[:, 1:] == 0.0) | (ranges[:, :-1] == 0.0)
    edge[:, 1:] |= apart
    edge[:, :-1] |= apart
    return replace(scans, ranges=np.where(edge, 0.0, ranges))


def median_filter(scans: Scans) -> Scans:
    """Median filter as scanners have it: over each ray and its two neighbours; no range for the first and the last."""
    ranges = scans.ranges
    middle = np.median(np.stack([ranges[:, :-2], ranges[:, 1:-1], ranges[:, 2:]]), axis=0)
    return replace(scans, ranges=np.pad(middle, ((0, 0), (1, 1))))


def mean_filter(scans: Scans, count: int) -> Scans:
    """Mean filter as scanners have it: over blocks of ``count`` scans, of the rays that came back.

    For a robot at rest: a moving one is smeared. Scans that do not fill a block are left out.

    Raises:
        ValueError: count is not from 1 to the number of scans.
    """
    if not 1 <= count <= len(scans):
        raise ValueError(f"count must be from 1 to {len(scans)}, the number of scans, got {count}")
    blocks = len(scans) // count
    ranges = scans.ranges[: blocks * count].reshape(blocks, count, -1)
    hits = (ranges > 0.0).sum(axis=1)
    mean = ranges.sum(axis=1) / np.maximum(hits, 1)
    return Scans(scans.t[: blocks * count].reshape(blocks, count).mean(axis=1), scans.bearings, mean, scans.ray_delay)
