"""Paths to follow: curves in the plane by arc length, with heading, curvature and its slope.

A path is a sequence of clothoids: from knot to knot the curvature changes linearly with the arc length. Lines, arcs,
clothoids and stadiums are such sequences exactly; lemniscate and spline are cut into pieces of ``STEP``, whose knots
lie on the curve and have its headings.

Positive curvature turns left. A path driven in reverse is the same curve, along which the robot's rear leads.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.special import ellipk, ellipkinc

from skidsteer.errors import DataError, RequestError
from skidsteer.kernels import paths as kernels
from skidsteer.se2 import FloatArray, between, chain, compose, invert, wrap

if TYPE_CHECKING:
    from typing_extensions import Self

STEP = 0.02  # [m] between knots, at most
LONGEST = 1e5  # [m] of a path, or of a leg between waypoints
WINDOW = 2.0  # [m] of path, to either side of the last place, in which the robot is searched
KINK = 1e-3  # [rad] by which headings may differ where pieces meet
GAP = 1e-4  # [m] by which they may be apart there
SAME = 1e-6  # [m] within which two points are one
SHARPEST = np.radians(150.0)  # turn between legs of waypoints, beyond which the path goes back
ORIGIN = (0.0, 0.0, 0.0)
NODES, WEIGHTS = kernels.NODES, kernels.WEIGHTS  # of a Gauss-Legendre quadrature on [0, 1]


class Frame(NamedTuple):
    """A point of a path."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # [rad] of the tangent, unwrapped
    curvature: float  # [1/m]
    slope: float  # [1/m^2] of the curvature by arc length


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A curve by arc length s [m].

    ``knots`` (n, 6) are rows of s [m], x, y [m], yaw [rad] (of the tangent, unwrapped), curvature [1/m] and its slope
    [1/m^2]; each row begins a piece, the last one ends the path. Curvature may jump where pieces meet, position and yaw
    may not. On a closed path s counts on lap after lap; beyond its ends an open path continues straight.

    Raises:
        RequestError: fewer than two knots, numbers that are not finite, an arc length that does not increase, a gap or
            a kink; a closed path that does not close.
    """

    knots: FloatArray
    closed: bool = False
    reverse: bool = False  # driven with the rear ahead

    def __post_init__(self) -> None:
        knots = np.array(self.knots, dtype=float)
        if knots.ndim != 2 or knots.shape[1] != 6 or len(knots) < 2 or not np.isfinite(knots).all():
            raise RequestError(f"a path needs at least two rows of six finite numbers, got an array {knots.shape}")
        if knots[0, 0] != 0.0 or (np.diff(knots[:, 0]) <= 0.0).any():
            raise RequestError("the arc length of a path must begin at 0 and increase from knot to knot")
        _refuse_breaks(knots)
        if self.closed:
            _refuse_open(knots)
        knots.setflags(write=False)
        object.__setattr__(self, "knots", knots)

    @property
    def length(self) -> float:
        """[m], of one lap if closed."""
        return float(self.knots[-1, 0])

    @property
    def end(self) -> FloatArray:
        """Pose (3,) of the tangent at the end."""
        return np.array(self.knots[-1, 1:4])

    def at(self, s: ArrayLike) -> FloatArray:
        """Poses (..., 3) of the tangent at s (...) [m]: the Serret-Frenet frames; the yaw is unwrapped."""
        return self._points(s)[..., :3]

    def frame(self, s: float) -> Frame:
        """The Serret-Frenet frame at one s [m], curvature and its slope there; fast."""
        return Frame(*kernels.frame(self.knots, self.closed, s))

    def curvature(self, s: ArrayLike) -> FloatArray:
        """Curvature (...) [1/m] at s (...) [m]; where it jumps, that of the piece that begins."""
        return self._points(s)[..., 3]

    def curvature_slope(self, s: ArrayLike) -> FloatArray:
        """Derivative (...) [1/m^2] of the curvature by the arc length at s (...) [m]."""
        return self._points(s)[..., 4]

    def robot(self, s: ArrayLike) -> FloatArray:
        """Poses (..., 3) of a robot that follows the path exactly: turned by 180 deg where it drives in reverse."""
        return self.at(s) + [0.0, 0.0, np.pi if self.reverse else 0.0]

    def error(self, pose: ArrayLike, s: ArrayLike) -> FloatArray:
        """Errors of robots at poses (..., 3) in the Serret-Frenet frames at s (...).

        Returns:
            (..., 3): x_e [m] ahead of and y_e [m] to the left of the point at s, along the tangent, and theta_e [rad]
            from the tangent to the direction of driving (the rear in reverse), wrapped.
        """
        error = between(self.at(s), pose)
        error[..., 2] = wrap(np.asarray(pose)[..., 2] - self.robot(s)[..., 2])
        return error

    def project(self, point: ArrayLike, near: float | None = None, window: float = WINDOW) -> float:
        """Arc length of the nearest point of the path.

        Args:
            point: x, y [m].
            near: [m] the last arc length; only the path within ``window`` about it is searched, so that the robot stays
                on its branch where the path crosses itself. If the nearest point lies at the edge of that window, the
                whole path is searched. None: the whole path.
            window: [m] of path to either side.

        Returns:
            s in [0, length]; of a closed path, in the lap about ``near``.

        Raises:
            ValueError: a point that is not two finite numbers, a window that is not positive.
        """
        x, y = point if isinstance(point, tuple) else np.asarray(point, dtype=float).tolist()
        about = math.nan if near is None else near
        if not (math.isfinite(x + y) and window > 0.0 and (near is None or math.isfinite(near))):
            raise ValueError(f"need a finite point, near and window > 0, got {point!r}, {near}, {window}")
        return float(kernels.project(self.knots, self.closed, x, y, about, window))

    def placed(self, start: ArrayLike) -> Self:
        """The same curve, moved rigidly so that it begins at a pose (3,)."""
        moved = self.knots.copy()
        moved[:, 1:4] = compose(compose(np.asarray(start, dtype=float), invert(self.knots[0, 1:4])), moved[:, 1:4])
        return replace(self, knots=moved)

    def in_reverse(self) -> Self:
        """The same curve, driven with the other end of the robot ahead."""
        return replace(self, reverse=not self.reverse)

    def _points(self, s: ArrayLike) -> FloatArray:
        s = np.asarray(s, dtype=float)
        out = np.empty((s.size, 5))
        kernels.points(self.knots, self.closed, np.ascontiguousarray(s).ravel(), out)
        return out.reshape(*s.shape, 5)


def _refuse_breaks(knots: FloatArray) -> None:
    """Refuse knots that do not lie where the piece before ends."""
    led = compose(knots[:-1, 1:4], _pieces(np.diff(knots[:, 0]), knots[:-1, 4], knots[:-1, 5]))
    gap = np.hypot(*(led - knots[1:, 1:4])[:, :2].T)
    kink = np.abs(wrap(led[:, 2] - knots[1:, 3]))
    if (bad := np.flatnonzero((gap > GAP) | (kink > KINK))).size:
        i = bad[0]
        raise RequestError(
            f"the path has a gap of {gap[i]:.4f} m and a kink of {np.degrees(kink[i]):.2f} deg at s ="
            f" {knots[i + 1, 0]:.2f} m; round it off or move what follows to where it leads"
        )


def _refuse_open(knots: FloatArray) -> None:
    gap, kink = np.hypot(*(knots[-1, 1:3] - knots[0, 1:3])), abs(float(wrap(knots[-1, 3] - knots[0, 3])))
    if gap > GAP or kink > KINK:
        raise RequestError(
            f"a closed path must end where it begins: {gap:.4f} m and {np.degrees(kink):.2f} deg are missing"
        )


def _pieces(length: ArrayLike, curvature: ArrayLike, slope: ArrayLike) -> FloatArray:
    """Motion (n, 3) along clothoid pieces, each in the frame where it begins."""
    length, curvature, slope = (np.asarray(a, dtype=float)[:, None] for a in (length, curvature, slope))
    u = length * NODES
    angle = u * (curvature + 0.5 * slope * u)
    dx, dy = (length[:, 0] * (f(angle) @ WEIGHTS) for f in (np.cos, np.sin))
    return np.stack([dx, dy, (length * (curvature + 0.5 * slope * length))[:, 0]], axis=1)


def line(length: float, start: ArrayLike = ORIGIN) -> Path:
    """A straight line of a length [m] from a pose (3,)."""
    return clothoid(length, 0.0, 0.0, start)


def arc(radius: float, angle: float, start: ArrayLike = ORIGIN) -> Path:
    """An arc of a radius [m] by an angle [rad], to the left where it is positive.

    Raises:
        RequestError: a radius that is not positive, an angle of 0.
    """
    radius, angle = _positive("radius", radius), float(angle)
    curvature = float(np.sign(angle)) / radius
    return clothoid(radius * abs(angle), curvature, curvature, start)


def clothoid(length: float, first: float, last: float, start: ArrayLike = ORIGIN) -> Path:
    """A curve whose curvature changes from the first to the last [1/m] linearly with the arc length (Euler's spiral).

    Raises:
        RequestError: a length that is not positive or far too long, a curvature that is not finite.
    """
    length = _positive("length", length)
    if not np.isfinite([first, last]).all():
        raise RequestError(f"the curvature of a path must be finite, got {first} and {last} 1/m")
    slope = (last - first) / length
    s = np.linspace(0.0, length, _count(length) + 1)
    curvature = first + slope * s
    poses = chain(_pieces(np.diff(s), curvature[:-1], np.full(len(s) - 1, slope)))
    return Path(np.column_stack([s, poses, curvature, np.full(len(s), slope)])).placed(start)


def stadium(straight: float, radius: float, start: ArrayLike = ORIGIN) -> Path:
    """Two straights [m] joined by half circles of a radius [m] to the left; closed; begins with a straight."""
    half = (line(straight), arc(radius, np.pi))
    return replace(join(*half, *half), closed=True).placed(start)


def lemniscate(width: float, start: ArrayLike = ORIGIN) -> Path:
    """Bernoulli's lemniscate, a figure of eight of a width [m]; closed; begins where it crosses itself.

    With a = width / 2: x = a cos t / (1 + sin^2 t), y = x sin t, s = a F(t | -1), yaw = 3 atan(sin t) + pi / 2,
    curvature 3 cos t / (a sqrt(1 + sin^2 t)); the first loop turns left, the second right. Its length is 2.622 width.

    Raises:
        RequestError: a width that is not positive.
    """
    a = 0.5 * _positive("width", width)
    length = 4.0 * a * float(ellipk(-1.0))
    s = np.linspace(0.0, length, 4 * _count(length / 4.0) + 1)
    t = _lemniscate_parameter(s / a) - 0.5 * np.pi
    sin, cos = np.sin(t), np.cos(t)
    x = a * cos / (1.0 + sin**2)
    poses = np.stack([x, x * sin, 3.0 * np.arctan(sin) + 0.5 * np.pi], axis=1)
    poses[[0, -1], :2] = 0.0
    curvature = 3.0 * cos / (a * np.sqrt(1.0 + sin**2))
    return Path(_knots(s, poses, curvature), closed=True).placed(start)


def _lemniscate_parameter(s: FloatArray) -> FloatArray:
    """Parameter t + pi / 2 at the arc length s (n,) of the lemniscate with a = 1, by Newton's method."""
    t = s * 0.5 * np.pi / float(ellipk(-1.0))
    for _ in range(30):
        reached = ellipkinc(t - 0.5 * np.pi, -1.0) + ellipk(-1.0)
        t = t - (reached - s) * np.sqrt(1.0 + np.cos(t) ** 2)  # ds / dt = 1 / sqrt(1 + sin^2(t - pi / 2))
    return np.asarray(t)


def spline(waypoints: ArrayLike, closed: bool = False) -> Path:
    """A curve of continuous curvature through waypoints (n, 2) [m]: a cubic spline over the lengths of the legs.

    Args:
        waypoints: at least two, of a closed path at least three.
        closed: continues from the last one to the first, which need not be repeated.

    Raises:
        DataError: too few waypoints, numbers that are not finite, one that is repeated, legs that go back.
    """
    points = _waypoints(waypoints, closed)
    legs = np.hypot(*np.diff(points, axis=0).T)
    knots = np.concatenate([[0.0], np.cumsum(legs)])
    curve = CubicSpline(knots, points, bc_type="periodic" if closed else "natural")
    s, u = _by_arc_length(curve, knots)
    (dx, dy), (ddx, ddy) = curve(u, 1).T, curve(u, 2).T
    yaw = np.unwrap(np.arctan2(dy, dx))
    curvature = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
    return Path(_knots(s, np.column_stack([curve(u), yaw]), curvature), closed=closed)


def _waypoints(waypoints: ArrayLike, closed: bool) -> FloatArray:
    points = np.array(waypoints, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise DataError(f"waypoints must be rows of finite x, y [m], got an array {points.shape}")
    if closed and len(points) > 1 and np.hypot(*(points[-1] - points[0])) > SAME:
        points = np.concatenate([points, points[:1]])
    if len(points) < (4 if closed else 2):
        raise DataError(f"a path needs at least {3 if closed else 2} different waypoints, got {len(points) - closed}")
    legs = np.diff(points, axis=0)
    if (same := np.flatnonzero(np.hypot(*legs.T) < SAME)).size:
        i = same[0]
        raise DataError(
            f"waypoints {i + 1} and {i + 2} are the same point ({points[i, 0]:g}, {points[i, 1]:g}); delete one"
        )
    if closed:
        legs = np.concatenate([legs, legs[:1]])
    turns = np.abs(wrap(np.diff(np.arctan2(legs[:, 1], legs[:, 0]))))
    if (back := np.flatnonzero(turns > SHARPEST)).size:
        i = back[0]
        raise DataError(
            f"the path goes back by {np.degrees(turns[i]):.0f} deg at waypoint {(i + 1) % (len(points) - closed) + 1};"
            " delete it, or make two paths of it, one of them driven in reverse"
        )
    return points


def _by_arc_length(curve: CubicSpline, knots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Arc lengths (m,) not more than ``STEP`` apart, and the parameters (m,) of the curve there."""
    _count(float(knots[-1] - knots[0]))
    fine = [np.linspace(a, b, _count(b - a) + 1)[:-1] for a, b in itertools.pairwise(knots)]
    grid = np.concatenate([*fine, knots[-1:]])

    def covered(a: FloatArray, b: FloatArray) -> FloatArray:
        speed = np.linalg.norm(curve(a[:, None] + (b - a)[:, None] * NODES, 1), axis=-1)
        return np.asarray((b - a) * (speed @ WEIGHTS))

    reached = np.concatenate([[0.0], np.cumsum(covered(grid[:-1], grid[1:]))])
    ends = reached[np.searchsorted(grid, knots)]  # the curvature has corners at the waypoints: they become knots
    legs = [np.linspace(a, b, _count(b - a) + 1)[:-1] for a, b in itertools.pairwise(ends)]
    s = np.concatenate([*legs, ends[-1:]])
    cell = np.clip(np.searchsorted(reached, s, side="right") - 1, 0, len(grid) - 2)
    u = np.interp(s, reached, grid)
    for _ in range(4):
        u = u - (reached[cell] + covered(grid[cell], u) - s) / np.linalg.norm(curve(u, 1), axis=-1)
    return s, np.asarray(u)


def _knots(s: FloatArray, poses: FloatArray, curvature: FloatArray) -> FloatArray:
    """Knots (n, 6) of a smooth curve, with curvatures such that each piece ends at the heading of the next knot."""
    ds = np.diff(s)
    slope = np.diff(curvature) / ds
    met = np.diff(poses[:, 2]) / ds - 0.5 * slope * ds
    return np.column_stack([s, poses, np.append(met, curvature[-1]), np.append(slope, slope[-1])])


def join(*paths: Path) -> Path:
    """Open paths one after the other, each moved to where the one before ends: position and heading are continuous.

    Raises:
        RequestError: no path, a closed one, or some driven ahead and some in reverse.
    """
    if not paths or any(path.closed for path in paths) or len({path.reverse for path in paths}) > 1:
        raise RequestError("only open paths can be joined, all of them driven ahead or all in reverse")
    rows: list[FloatArray] = [paths[0].knots]
    for path in paths[1:]:
        last = rows[-1][-1]
        moved = path.placed(last[1:4]).knots + [last[0], 0.0, 0.0, 0.0, 0.0, 0.0]
        rows = [*rows[:-1], rows[-1][:-1], moved]
    return replace(paths[0], knots=np.concatenate(rows))


def _count(length: float) -> int:
    """Number of pieces no longer than ``STEP``.

    Raises:
        RequestError: too many of them.
    """
    if length > LONGEST:
        raise RequestError(f"a path of {length:.3g} m is too long, at most {LONGEST:g} m; lengths are in m")
    return max(1, int(np.ceil(length / STEP - 1e-9)))


def _positive(name: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0.0):
        raise RequestError(f"the {name} of a path must be a positive number of metres, got {value}")
    return float(value)
