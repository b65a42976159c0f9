"""The plate in each scan: centre, direction and their covariance. Wang 2015, section 3.2."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skidsteer.errors import DataError, RequestError
from skidsteer.laser.clusters import APART, GRAZING, Clusters, find_clusters
from skidsteer.laser.line import BoolArray, IntArray, Lines, Points, fit_lines
from skidsteer.laser.scans import LEAST_NOISE, Scans, range_noise
from skidsteer.se2 import FloatArray

Side = Literal["left", "right", "front", "back"]
SIDES: dict[str, tuple[float, float]] = {"left": (0, 1), "right": (0, -1), "front": (1, 0), "back": (-1, 0)}

FEWEST = 5  # points on a plate
WIDTH_SHARE = 0.05  # of the width by which the measured one may differ, plus five of its sigmas
ROUND = 1.5  # sigmas of the residuals beyond which a surface is not flat
STRAIGHT_SHARE = 0.8  # of the points of a cluster that must lie on its line
ROUGH_SHARE = 0.25  # of the width by which the chord of a cluster may differ before a line is fitted
FEW_SCANS = 100  # from which the noise on the plate is estimated
COARSER = (1.0, 3.0, 10.0)  # ratios of the noise on the plate to that elsewhere that are tried
CUT_OFF = 0.5 * math.sin(GRAZING)  # cosine of the largest slant of a ray on a plate, on the safe side
CHUNK = 256  # scans at a time, so that their points stay in the cache
NOTHING, NO_PLATE, CUT, SEVERAL, SEEN = range(5)
_SHOWN = (
    "nothing",
    "no plate of that width",
    "one cut by the edge of the field or hidden in part",
    "several of that width",
)


@dataclass(frozen=True, slots=True)
class Plate:
    """A thin upright plate on the robot, and where its centre sits in base_link.

    The plate extends along ``yaw`` in base_link; Wang's stands in the robot's plane of symmetry: all three are 0. Since
    it looks the same from both faces, the heading is known up to half a turn; ``side`` is the side of the robot on
    which the scanner stands at first.

    Raises:
        RequestError: a width that is not positive, measures that are not finite, no such side.
    """

    width: float  # [m]
    x: float = 0.0  # [m] ahead
    y: float = 0.0  # [m] left
    yaw: float = 0.0  # [rad]
    side: Side | None = None

    def __post_init__(self) -> None:
        numbers = (self.width, self.x, self.y, self.yaw)
        if not (all(map(math.isfinite, numbers)) and self.width > 0.0):
            raise RequestError(
                f"a plate needs a positive width and a place, finite numbers in m and rad; got {numbers}"
            )
        if self.side not in (None, *SIDES):
            raise RequestError(f"the scanner stands {', '.join(SIDES)} of the robot, not '{self.side}'")


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """The plate where it was seen, in the scanner's frame: k of n scans.

    ``parts`` are two independent parts of the covariance of a pose: one from the noise of the ranges, new in every
    scan; one from the edges, which lie anywhere between two rays, the same in every scan of a robot at rest. An error
    common to all ranges is in neither.
    """

    t: FloatArray  # (k,) [s] when the beam met the plate
    pose: FloatArray  # (k, 3) x, y of the centre [m]; direction [rad] of the plate, up to half a turn
    parts: FloatArray  # (k, 2, 3, 3)
    width: FloatArray  # (k,) [m] between the edges, each half a step beyond the last ray that hit
    chord: FloatArray  # (k,) [m] from the first point to the last, Wang 2015, Eq. (29)
    points: IntArray  # (k,) that the line was fitted to
    square_sum: FloatArray  # (k,) [m2] of their residuals along the rays
    status: NDArray[np.int8]  # (n,) NOTHING, NO_PLATE, CUT, SEVERAL or SEEN

    @property
    def covariance(self) -> FloatArray:
        """Of each pose: (k, 3, 3)."""
        return np.asarray(self.parts.sum(axis=1))

    @property
    def range_sigma(self) -> float:
        """Standard deviation [m] of one range about the lines."""
        return math.sqrt(self.square_sum.sum() / max(1, self.points.sum() - 2 * len(self.points)))

    def tally(self) -> str:
        """Number of scans in which the plate was seen, and what the others show."""
        number = np.bincount(self.status, minlength=5).tolist()
        rest = ", ".join(f"{n} show {what}" for n, what in zip(number, _SHOWN, strict=False) if n)
        return f"the plate is seen in {number[SEEN]} of {len(self.status)} scans" + (f" ({rest})" if rest else "")


def find_plate(scans: Scans | Sequence[Scans], width: float, range_sigma: float | None = None) -> Sightings:
    """Find the plate in each scan: cluster, fit a line, check the width, take the middle of the edges.

    A scan is left out where no cluster is straight and as wide as the plate, where several are, and where a candidate
    reaches the edge of the field.

    Args:
        scans: n scans; or several groups, in any order, of one scanner that changed its bearings.
        width: [m] of the plate.
        range_sigma: [m] standard deviation of one range; None: estimated from neighbouring rays.

    Raises:
        DataError: the plate is seen in no scan; with what the scans show.
        RequestError: the width is not positive.
    """
    Plate(width)
    lots = [scans] if isinstance(scans, Scans) else list(scans)
    sigma = _noise(max(lots, key=len), width) if range_sigma is None else range_sigma
    found = _in_order([_find(lot, width, sigma) for lot in lots], np.concatenate([lot.t for lot in lots]))
    if not len(found.t):
        raise DataError(f"scans: {found.tally()}; is the plate {width:g} m wide, in the field and as high as the beam?")
    return found


def _in_order(parts: Sequence[Sightings], t: FloatArray) -> Sightings:
    """Several groups as one, sorted by time; ``t`` (n,) are the times of all scans."""
    whole = _joined(parts)
    order = np.argsort(whole.t, kind="stable")
    columns = {field.name: getattr(whole, field.name)[order] for field in fields(Sightings) if field.name != "status"}
    return Sightings(**columns, status=whole.status[np.argsort(t, kind="stable")])


def _joined(parts: Sequence[Sightings]) -> Sightings:
    return Sightings(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Sightings)))


def _noise(scans: Scans, width: float) -> float:
    """Noise [m] of the ranges on the plate, or of all of them where the plate is not found among a few scans."""
    few, sigma = scans.rows(slice(None, None, -(-len(scans) // FEW_SCANS))), range_noise(scans)
    for factor in COARSER:
        found = _find(few, width, factor * sigma)
        if len(found.t):
            return max(LEAST_NOISE, found.range_sigma)
    return sigma


def _find(scans: Scans, width: float, sigma: float) -> Sightings:
    starts = range(0, len(scans), CHUNK)
    return _joined([_in_chunk(scans.rows(slice(start, start + CHUNK)), width, sigma) for start in starts])


def _in_chunk(scans: Scans, width: float, sigma: float) -> Sightings:
    clusters = find_clusters(scans, sigma)
    begin, end = clusters.range[clusters.first], clusters.range[clusters.last]
    span = scans.step * (clusters.ray[clusters.last] - clusters.ray[clusters.first])
    chord = np.sqrt((end - begin) ** 2 + 4.0 * begin * end * np.sin(0.5 * span) ** 2)  # Eq. (29)
    slack = ROUGH_SHARE * width + scans.step / math.sin(GRAZING) * begin + APART * sigma
    part = clusters.hidden | (clusters.ray[clusters.first] <= 1)
    part |= clusters.ray[clusters.last] >= len(scans.bearings) - 2
    enough = clusters.count >= FEWEST
    could_be = enough & ~part & (np.abs(chord - width) <= slack)
    cut = np.bincount(clusters.scan[enough & part & (chord <= width + slack)], minlength=len(scans)) > 0
    return _sightings(scans, clusters.where(could_be), chord[could_be], cut, width, sigma)


def _sightings(
    scans: Scans, clusters: Clusters, chord: FloatArray, cut: BoolArray, width: float, sigma: float
) -> Sightings:
    points = clusters.points(scans.bearings)
    lines = fit_lines(points, sigma)
    number = points.total(lines.kept).astype(np.int64)
    ends = _ends(points, lines, number, scans.step)
    measured, width_sigma = _width(lines, ends, scans.step, sigma)
    flat = (number >= np.maximum(FEWEST, STRAIGHT_SHARE * clusters.count)) & (np.abs(np.cos(ends)).min(0) > CUT_OFF)
    flat &= lines.square_sum <= (ROUND * sigma) ** 2 * number
    good = flat & (np.abs(measured - width) <= WIDTH_SHARE * width + 5.0 * width_sigma)
    plates = np.bincount(clusters.scan[good], minlength=len(scans))
    seen = good & (plates[clusters.scan] == 1)
    nothing = ~(scans.ranges > 0.0).any(axis=1)
    status = np.select([nothing, plates == 1, plates > 1, cut], [NOTHING, SEEN, SEVERAL, CUT], NO_PLATE)
    pose, parts = _pose(lines, ends, scans.step, sigma)
    middle = (clusters.ray[clusters.first] + clusters.ray[clusters.last]) // 2
    t = scans.t[clusters.scan] + np.asarray(scans.ray_delay)[middle]
    return Sightings(
        t[seen],
        pose[seen],
        parts[seen],
        measured[seen],
        chord[seen],
        number[seen],
        lines.square_sum[seen],
        status.astype(np.int8),
    )


def _ends(points: Points, lines: Lines, number: IntArray, step: float) -> FloatArray:
    """Slants (2, c) [rad] from the normal to both edges: half a step beyond the first and last ray on the line."""
    kept = np.append(points.bearing[lines.kept], 0.0)  # one more for a last cluster without points
    last = np.cumsum(number)
    return np.stack([kept[last - number] - 0.5 * step, kept[last - 1] + 0.5 * step]) - lines.normal


def _width(lines: Lines, ends: FloatArray, step: float, sigma: float) -> tuple[FloatArray, FloatArray]:
    """Width (c,) [m] between the edges, and its standard deviation."""
    tan, square = np.tan(ends), 1.0 / np.cos(ends) ** 2
    by_line = np.stack([lines.distance * (square[0] - square[1]), tan[1] - tan[0]], axis=-1)  # by normal, distance
    variance = sigma**2 * np.einsum("ci,cij,cj->c", by_line, lines.cofactor, by_line)
    variance += (lines.distance * step) ** 2 / 12.0 * (square**2).sum(axis=0)
    return lines.distance * (tan[1] - tan[0]), np.sqrt(variance)


def _pose(lines: Lines, ends: FloatArray, step: float, sigma: float) -> tuple[FloatArray, FloatArray]:
    """Middle of the edges and direction (c, 3) of the plate, and the covariance (c, 2, 3, 3) in two parts.

    The centre is d (n + u t) with the line's normal n, its direction t and the mean u of the edges' tangents.
    """
    n = np.stack([np.cos(lines.normal), np.sin(lines.normal)], axis=-1)
    t = np.stack([-n[:, 1], n[:, 0]], axis=-1)
    u, square = np.tan(ends).mean(axis=0)[:, None], 1.0 / np.cos(ends) ** 2
    d = lines.distance[:, None]
    pose = np.column_stack([d * (n + u * t), wrap_direction(lines.normal + 0.5 * np.pi)])
    by_normal = d * (t - u * n - square.mean(axis=0)[:, None] * t)
    by_edges = [0.5 * d * t * edge[:, None] for edge in square]
    by_line = np.zeros((len(d), 3, 2))
    by_line[:, :2] = np.stack([by_normal, n + u * t], axis=-1)
    by_line[:, 2, 0] = 1.0
    edges = np.zeros((len(d), 3, 2))
    edges[:, :2] = np.stack(by_edges, axis=-1)
    noise = sigma**2 * by_line @ lines.cofactor @ by_line.transpose(0, 2, 1)
    between_rays = step**2 / 12.0 * edges @ edges.transpose(0, 2, 1)
    return pose, np.stack([noise, between_rays], axis=1)


def wrap_direction(angle: FloatArray) -> FloatArray:
    """Directions of a line [rad], brought into [-pi/2, pi/2): half a turn makes no difference."""
    return np.asarray((angle + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
