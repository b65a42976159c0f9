"""Plain least squares: the cost of Mandow 2007, Eq. (13), minimised by Gauss-Newton steps over the samples themselves.

Nothing is robust here and the timing is given; ``least_squares`` is the estimator to use on a real log. This one is for
clean logs and simulations, and for Mandow's experiment without a grid: the samples are read once a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import DataError
from skidsteer.identify.moments import checked_bounds
from skidsteer.kernels import lanes
from skidsteer.kernels import rollout as rolling
from skidsteer.kernels import squares as kernels
from skidsteer.models import MatrixModel
from skidsteer.se2 import FloatArray, wrap
from skidsteer.windows import Steps, Windows

FILLED = 2.0  # steps are laid side by side where that takes at most so many times their memory
SETTLED = 1e-12  # converged: the next step would lower the cost by no more than this share of it
FEW = 16  # one tile in this many tells most of what all of them tell
SINGULAR = 1e12  # condition above which the windows do not determine the parameters


@dataclass(frozen=True, slots=True, eq=False)
class PlainFit:
    """The model of least squared cost inside the bounds."""

    model: MatrixModel
    cost: float  # [m^2] + [rad^2], Mandow 2007, Eq. (13)
    covariance: FloatArray  # (p, p) see ``Squares.covariance``
    iterations: int
    converged: bool


@dataclass(frozen=True, slots=True, eq=False)
class Value:
    """Squared cost at one matrix A, and what a Gauss-Newton step needs, by the entries of A row by row."""

    cost: FloatArray  # (2,) of position [m^2] and yaw [rad^2]
    gradient: FloatArray  # (6,) half the derivative of the cost
    information: FloatArray  # (6, 6) Gauss-Newton matrix


@dataclass(frozen=True, slots=True, eq=False)
class Tiles:
    """Steps of windows side by side, see ``skidsteer.kernels.lanes``."""

    rows: FloatArray  # (r, 2 * LANES) [m]
    starts: np.ndarray  # (n + 1,) rows starts[i]:starts[i + 1] belong to tile i
    total: FloatArray  # (n, 2 * LANES) [m]
    measured: FloatArray  # (n, 3 * LANES)
    reach: tuple[float, float]  # [m] the largest steps of both sides


@dataclass(frozen=True, slots=True, eq=False)
class Squares:
    """The squared cost of windows as a function of the matrix of the model."""

    cut: Steps
    measured: FloatArray  # (k, 3) yaw unwrapped
    rolled: FloatArray  # (k, 2) [m] by both sides
    tiles: Tiles | None  # None where the windows are too uneven in number of steps

    @classmethod
    def of(cls, cut: Steps, windows: Windows, start: MatrixModel) -> Squares:
        """Prepare windows. A yaw is known but for whole turns: the one nearest to that of ``start`` is taken."""
        measured = windows.motion.copy()
        # a window has at least one step, so that reduceat adds up each
        rolled = np.asarray(np.add.reduceat(cut.distance, cut.offsets[:-1], axis=0))
        yaw = rolled @ start.matrix()[2]
        measured[:, 2] = yaw + wrap(measured[:, 2] - yaw)
        return cls(cut, measured, rolled, _tiles(cut, measured))

    def at(self, A: FloatArray) -> Value:
        """Value for the matrix A (3, 2); steps of any angle, though small ones are faster."""
        tiles = self.tiles
        if tiles is not None and 0.5 * np.abs(A[2]) @ tiles.reach < lanes.LIMIT:
            return Value(*kernels.squares(A, tiles.rows, tiles.starts, tiles.total, tiles.measured))
        k = len(self.measured)
        motion, jacobian = np.empty((k, 3)), np.empty((k, 3, 7))
        rolling.rollout_matrix(A, self.cut.distance, self.cut.by_lag[:0], self.cut.offsets, motion, jacobian)
        error, J = motion - self.measured, jacobian[..., :6].reshape(-1, 6)
        cost = np.array([(error[:, :2] ** 2).sum(), (error[:, 2] ** 2).sum()])
        return Value(cost, J.T @ error.ravel(), J.T @ J)

    def thinned(self, share: int) -> Squares | None:
        """One tile in ``share``, those in between left out; None where too few would be left to fit a model to."""
        tiles = self.tiles
        if tiles is None or len(tiles.total) < 10 * share:
            return None
        kept = np.arange(0, len(tiles.total), share)
        low, count = tiles.starts[kept], tiles.starts[kept + 1] - tiles.starts[kept]
        starts = np.concatenate([[0], np.cumsum(count)])
        rows = tiles.rows[np.repeat(low - starts[:-1], count) + np.arange(starts[-1])]
        some = Tiles(rows, starts, tiles.total[kept], tiles.measured[kept], tiles.reach)
        return Squares(self.cut, self.measured, self.rolled, some)

    def covariance(self, value: Value, by_parameter: FloatArray) -> FloatArray:
        """Covariance (p, p) of the parameters at the minimum; infinite where the windows do not determine them.

        Position and yaw are taken to err with the variance that each was found to have, independently from window to
        window. Windows that share a noisy pose do not: there ``least_squares`` is honest, this is not.

        Args:
            value: at the minimum.
            by_parameter: (6, p) derivative of the entries of A.
        """
        p, k = by_parameter.shape[1], len(self.measured)
        of_yaw = by_parameter[4:].T @ (self.rolled.T @ self.rolled) @ by_parameter[4:]
        H = by_parameter.T @ value.information @ by_parameter
        scale = np.sqrt(np.diag(H))
        if not (scale > 0).all() or np.linalg.cond(H / np.outer(scale, scale)) > SINGULAR or 3 * k <= p:
            return np.full((p, p), np.inf)
        bread = np.linalg.inv(H)
        # The p parameters take their share of the 3 k residuals.
        position, yaw = value.cost / (np.array([2 * k, k]) * (1.0 - p / (3 * k)))
        return np.asarray(bread @ (position * (H - of_yaw) + yaw * of_yaw) @ bread)


def fit_squares(cut: Steps, windows: Windows, start: MatrixModel, bounds: ArrayLike, iterations: int = 50) -> PlainFit:
    """Minimise the squared cost over parameters inside ``bounds``, by Levenberg-Marquardt from ``start``.

    Args:
        cut: what the sides rolled in the windows, for the timing wanted (``skidsteer.windows.steps``).
        windows: (k) measured motions, each in the frame of its start.
        start: where the search begins.
        bounds: (p, 2) lower and upper bound of each parameter.
        iterations: at most so many steps; not converging is told, not hidden.

    Raises:
        DataError: no windows.
    """
    if not len(windows):
        raise DataError("no windows to fit a model to")
    squares, limits = Squares.of(cut, windows, start), checked_bounds(start, bounds)
    model = start.with_theta(np.clip(start.theta, *limits.T))
    few = squares.thinned(FEW)
    if few is not None:  # most of the way on a share of the windows, the rest on all
        model = _descend(few, model, limits, iterations)[0]
    model, value, done, converged = _descend(squares, model, limits, iterations)
    covariance = squares.covariance(value, _by_parameter(model))
    return PlainFit(model, float(value.cost.sum()), covariance, done, converged)


def _descend(
    squares: Squares, model: MatrixModel, limits: FloatArray, iterations: int
) -> tuple[MatrixModel, Value, int, bool]:
    """Where the steps lead, the value there, how many there were, whether they converged."""
    value, damping = squares.at(model.matrix()), 1e-9
    for done in range(1, iterations + 1):
        step, gain = _step(model, value, limits, damping)
        if gain <= SETTLED * value.cost.sum() or (np.abs(step) <= 1e-14 * (limits[:, 1] - limits[:, 0])).all():
            return model, value, done, True
        trial = model.with_theta(model.theta + step)
        found = squares.at(trial.matrix())
        if found.cost.sum() < value.cost.sum():
            model, value, damping = trial, found, max(0.1 * damping, 1e-12)
        else:
            damping = max(30.0 * damping, 1e-4)
    return model, value, iterations, False


def _step(model: MatrixModel, value: Value, limits: FloatArray, damping: float) -> tuple[FloatArray, float]:
    """Damped step (p,) of the parameters, inside their limits, and by how much the cost should fall."""
    C, theta = _by_parameter(model), model.theta
    gradient, H = C.T @ value.gradient, C.T @ value.information @ C
    free = ~((theta <= limits[:, 0]) & (gradient > 0)) & ~((theta >= limits[:, 1]) & (gradient < 0))
    damped = (H + damping * np.diag(np.diag(H)))[np.ix_(free, free)]
    step = np.zeros_like(theta)
    step[free] = -np.linalg.lstsq(damped, gradient[free], rcond=None)[0]
    step = np.clip(theta + step, *limits.T) - theta
    return step, -float(step @ (2.0 * gradient + H @ step))


def _by_parameter(model: MatrixModel) -> FloatArray:
    return model.matrix_jacobian().reshape(6, -1)


def _tiles(cut: Steps, measured: FloatArray) -> Tiles | None:
    """Windows side by side; None where filling up the shorter ones would take too much memory."""
    k = len(measured)
    count = -(-k // lanes.LANES)
    steps, columns = np.zeros(count * lanes.LANES, np.int64), np.zeros((count * lanes.LANES, 3))
    steps[:k], columns[:k] = np.diff(cut.offsets), measured
    starts = np.concatenate([[0], np.cumsum(steps.reshape(count, lanes.LANES).max(axis=1))])
    if starts[-1] * lanes.LANES > FILLED * len(cut.distance):
        return None
    rows, total = np.empty((int(starts[-1]), 2 * lanes.LANES)), np.empty((count, 2 * lanes.LANES))
    reach = kernels.pack(cut.distance, cut.offsets, starts, rows, total)
    side_by_side = np.ascontiguousarray(columns.reshape(count, lanes.LANES, 3).transpose(0, 2, 1))
    return Tiles(rows, starts, total, side_by_side.reshape(count, -1), reach)
