"""Moments: one pass over the windows of a drive, then the squared cost of any matrix model in microseconds.

The motion that a model twist = A (v_left, v_right) predicts for a window is, as a complex number, p U + q V with
p = A11 + j A21, q = A12 + j A22, and its yaw A31 L + A32 R, where L, R are what the sides rolled. U and V, the
integrals of exp(j yaw) over L and R, depend on A31 and A32 alone. So eight sums over the windows (of |U|^2, |V|^2, and
U, V with each other and with the measured positions) are all that the cost of Mandow 2007, Eq. (13), needs of the
drive. They are entire functions of A31 and A32, band-limited by what the sides roll within a window, and kept as
Chebyshev series whose degree follows from the bounds.

Only for plain squares: a robust cost, a time offset or a lag change the sums themselves.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize

from skidsteer.drive import Drive
from skidsteer.errors import RequestError
from skidsteer.kernels import moments as kernels
from skidsteer.models import MatrixModel
from skidsteer.se2 import FloatArray, wrap
from skidsteer.windows import Steps, Timing, Windows, increment_windows, steps

MAX_NODES = 96  # in each direction: enough for 50 rad between the bounds and their middle
SLACK = 1e-9  # of the range: rounding in a matrix made from parameters on their bounds


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """All that the squared cost of matrix models needs of a drive; those of several drives on one ``box`` add up.

    The sums are exact to the ``tolerance`` of ``moments`` for A31 and A32 inside ``box``; outside they say nothing.
    """

    box: FloatArray  # (2, 2) [1/m] lower and upper bound of A31, of A32
    table: FloatArray  # (na, nb, 8) Chebyshev series of the sums in A31 and A32, [m^2]
    heading: FloatArray  # (3, 3) sums of products of L [m], R [m] and the measured yaw [rad]
    position: float  # [m^2] sum of the measured distances squared
    windows: int

    def __post_init__(self) -> None:
        for name in ("box", "table", "heading"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __add__(self, other: Moments) -> Moments:
        """Moments of both drives together.

        Raises:
            ValueError: they were made for different bounds.
        """
        if not np.array_equal(self.box, other.box):
            raise ValueError(f"moments of different boxes do not add up: {self.box.tolist()}, {other.box.tolist()}")
        shape = tuple(np.maximum(self.table.shape, other.table.shape))
        return Moments(
            self.box,
            _padded(self.table, shape) + _padded(other.table, shape),
            self.heading + other.heading,
            self.position + other.position,
            self.windows + other.windows,
        )

    def cost(self, A: ArrayLike) -> FloatArray:
        """Cost of matrices A (..., 3, 2): (...), Mandow 2007, Eq. (13): squared errors [m^2] + [rad^2], summed.

        Where the model fits to rounding, the result may be a little below zero.

        Raises:
            RequestError: A31 or A32 outside ``box``.
        """
        A = self._inside(A)
        flat = np.ascontiguousarray(A.reshape(-1, 3, 2))
        return np.asarray(kernels.costs(flat, self.box, self.table, self.heading, self.position).reshape(A.shape[:-2]))

    def cost_and_gradient(self, A: ArrayLike) -> tuple[float, FloatArray]:
        """Cost of one matrix A (3, 2) and its derivative (3, 2) by the entries.

        Raises:
            RequestError: A31 or A32 outside ``box``.
        """
        A = np.ascontiguousarray(self._inside(A))
        cost, gradient = kernels.cost_gradient(A, self.box, self.table, self.heading, self.position)
        return float(cost), np.asarray(gradient)

    def _inside(self, A: ArrayLike) -> FloatArray:
        A = np.asarray(A, dtype=np.float64)
        if A.shape[-2:] != (3, 2):
            raise ValueError(f"need matrices (..., 3, 2), got shape {A.shape}")
        lower, upper = self.box.T
        slack = SLACK * (1.0 + upper - lower)
        outside = ~((A[..., 2, :] >= lower - slack) & (A[..., 2, :] <= upper + slack))
        if outside.any():
            raise RequestError(
                f"the moments hold for A31 in [{lower[0]:.4g}, {upper[0]:.4g}] and A32 in"
                f" [{lower[1]:.4g}, {upper[1]:.4g}] 1/m, not for {A[..., 2, :][outside.any(axis=-1)][0].tolist()}"
            )
        return A


def moments(cut: Steps, windows: Windows, start: MatrixModel, bounds: ArrayLike, tolerance: float = 1e-10) -> Moments:
    """Sum up the windows of a drive for the models like ``start`` whose parameters lie inside ``bounds``.

    A measured yaw is known but for whole turns: the one nearest to that of ``start`` is taken. It is certain while
    ``start`` predicts each window to better than half a turn.

    Args:
        cut: what the sides rolled in the windows, for the timing wanted (``skidsteer.windows.steps``).
        windows: (k) measured motions, each in the frame of its start.
        start: any model of the family; its parameters only choose the whole turns.
        bounds: (p, 2) lower and upper bound of each parameter.
        tolerance: largest error of the sums, relative to those of the squared lengths of path.

    Raises:
        RequestError: the windows are too long for the bounds.
    """
    box = yaw_box(start, bounds)
    rolled, span = kernels.extents(cut.distance, cut.offsets)
    turn = 0.5 * (box[:, 1] - box[:, 0]) * span.max(axis=0, initial=0.0)
    shape = _count_nodes(turn, box, span, tolerance)
    nodes = [_nodes(count, *limits) for count, limits in zip(shape, box, strict=True)]
    grid = np.ascontiguousarray(np.stack(np.meshgrid(*nodes, indexing="ij")).reshape(2, -1))
    position = np.ascontiguousarray(windows.motion[:, :2])
    sums = kernels.gather(cut.distance, cut.offsets, position, grid).reshape(-1, *shape)
    table = np.einsum("ik,jl,mkl->ijm", _to_series(shape[0]), _to_series(shape[1]), sums)
    yaw = rolled @ start.matrix()[2]
    measured = np.column_stack([rolled, yaw + wrap(windows.motion[:, 2] - yaw)])
    return Moments(box, table, measured.T @ measured, float((position**2).sum()), len(windows))


def drive_moments(
    drive: Drive, start: MatrixModel, bounds: ArrayLike, timing: Timing | None = None, tolerance: float = 1e-10
) -> Moments:
    """Moments of the increments between neighbouring reference poses, the segments of Mandow 2007, Section III.

    Raises:
        RequestError: the drive has no reference with heading, or no window, or windows too long for the bounds.
    """
    if drive.pose is None:
        raise RequestError(f"{drive.name}: the cost of Mandow's Eq. (13) needs reference poses with heading")
    windows = increment_windows(drive)
    if len(windows) == 0:
        raise RequestError(f"{drive.name}: no two neighbouring reference poses with wheel samples between them")
    return moments(steps(drive.wheels, windows, timing or Timing()), windows, start, bounds, tolerance)


def yaw_box(start: MatrixModel, bounds: ArrayLike) -> FloatArray:
    """Range (2, 2) [1/m] of A31 and of A32 over parameters inside ``bounds`` (p, 2), from the corners.

    That is exact for models whose A31 and A32 are monotone in each parameter, as those of this package are.

    Raises:
        RequestError: the model does not exist at one of the corners.
    """
    corners = list(itertools.product(*checked_bounds(start, bounds)))
    try:
        rows = matrices(start, np.array(corners).reshape(len(corners), -1))[:, 2]
    except ValueError as error:
        raise RequestError(f"the bounds allow impossible models: {error}") from error
    return np.stack([rows.min(axis=0), rows.max(axis=0)], axis=1)


def matrices(start: MatrixModel, thetas: FloatArray) -> FloatArray:
    """Matrices (m, 3, 2) of models like ``start`` with the parameters ``thetas`` (m, p)."""
    return np.array([start.with_theta(theta).matrix() for theta in thetas]).reshape(-1, 3, 2)


@dataclass(frozen=True, slots=True)
class SquaresFit:
    """The model of least squared cost inside the bounds, found with the gradient from ``start``."""

    model: MatrixModel
    cost: float  # [m^2] + [rad^2], Mandow 2007, Eq. (13)
    converged: bool
    message: str


def fit_squares(total: Moments, start: MatrixModel, bounds: ArrayLike) -> SquaresFit:
    """Minimise the squared cost over the parameters inside ``bounds`` (p, 2); not converging is told, not hidden."""
    limits = checked_bounds(start, bounds)
    lower, width = limits[:, 0], limits[:, 1] - limits[:, 0]
    if len(lower) == 0:
        return SquaresFit(start, float(total.cost(start.matrix())), True, "no parameters")
    first = np.clip((start.theta - lower) / width, 0.0, 1.0)
    scale = max(float(total.cost(start.with_theta(lower + first * width).matrix())), np.finfo(float).tiny)

    def objective(unit: FloatArray) -> tuple[float, FloatArray]:
        model = start.with_theta(lower + unit * width)
        cost, by_entry = total.cost_and_gradient(model.matrix())
        return cost / scale, width * np.einsum("ij,ijp->p", by_entry, model.matrix_jacobian()) / scale

    unit_box = [(0.0, 1.0)] * len(lower)
    found = minimize(
        objective, first, jac=True, method="SLSQP", bounds=unit_box, options={"maxiter": 500, "ftol": 1e-14}
    )
    model = start.with_theta(lower + np.clip(found.x, 0.0, 1.0) * width)
    return SquaresFit(model, float(total.cost(model.matrix())), bool(found.success), str(found.message))


def checked_bounds(start: MatrixModel, bounds: ArrayLike) -> FloatArray:
    """The bounds (p, 2) of the parameters as an array.

    Raises:
        ValueError: not a pair for each parameter, or not lower < upper, both finite.
    """
    limits = np.asarray(bounds, dtype=np.float64).reshape(-1, 2)
    names = [p.name for p in start.PARAMETERS]
    if len(limits) != len(names):
        raise ValueError(f"need bounds (p, 2) for {', '.join(names) or 'no parameter'}, got shape {np.shape(bounds)}")
    for name, (lower, upper) in zip(names, limits, strict=True):
        if not (math.isfinite(lower) and math.isfinite(upper) and lower < upper):
            raise ValueError(f"bounds of {name} need lower < upper, got {lower}, {upper}")
    return limits


def _count_nodes(turn: FloatArray, box: FloatArray, span: FloatArray, tolerance: float) -> tuple[int, int]:
    """Nodes in A31 and in A32 for turns (2,) [rad] between the middle of the box and its sides."""
    counts = []
    for side, (name, z) in enumerate(zip(("left", "right"), turn, strict=True)):
        count = next((n for n in range(1, MAX_NODES + 1) if _remainder(float(z), n) <= tolerance), None)
        if count is None:
            raise RequestError(
                f"within a window the {name} side rolls {span[:, side].max():.3g} m, too far for yaw gains between"
                f" {box[side, 0]:.4g} and {box[side, 1]:.4g} 1/m: shorten the windows or narrow the bounds"
            )
        counts.append(count)
    return counts[0], counts[1]


def _remainder(z: float, n: int) -> float:
    """Bound on the error of interpolating exp(j z x), |x| <= 1, at n Chebyshev nodes: 4 sum of |J_m(z)|, m >= n.

    |J_m(z)| <= (z / 2)^m / m!, a series that falls at least geometrically once m > z / 2. Times 4, for the two
    directions and the growth of the error of one in the interpolation by the other.
    """
    ratio = 0.5 * z / (n + 1)
    if z == 0.0 or ratio >= 1.0:
        return 0.0 if z == 0.0 else math.inf
    return 16.0 * math.exp(n * math.log(0.5 * z) - math.lgamma(n + 1)) / (1.0 - ratio)


def _angles(count: int) -> FloatArray:
    return np.asarray(np.pi * (np.arange(count) + 0.5) / count)


def _nodes(count: int, lower: float, upper: float) -> FloatArray:
    """Chebyshev points of the first kind (count,) between the limits."""
    return np.asarray(0.5 * (lower + upper) + 0.5 * (upper - lower) * np.cos(_angles(count)))


def _to_series(count: int) -> FloatArray:
    """Matrix (count, count) from values at ``_nodes`` to the coefficients of the Chebyshev series."""
    series = 2.0 / count * np.cos(np.outer(np.arange(count), _angles(count)))
    series[0] *= 0.5
    return np.asarray(series)


def _padded(table: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    return np.pad(table, [(0, wanted - there) for wanted, there in zip(shape, table.shape, strict=True)])
