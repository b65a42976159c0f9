"""Mandow's identification as published: a binary genetic search for the least squared cost, Eq. (13).

Each parameter is a string of 8 bits between its bounds, five parameters a chromosome of 40 bits (Section IV.C). The
paper leaves open the operators and their rates, the size of the population and the bounds: those here are ours.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skidsteer.drive import Drive
from skidsteer.errors import RequestError
from skidsteer.identify.moments import Moments, checked_bounds, fit_squares, matrices, moments
from skidsteer.models import MatrixModel
from skidsteer.se2 import FloatArray
from skidsteer.windows import Timing, Windows, steps

if TYPE_CHECKING:
    from skidsteer.identify.least_squares import Fit

Bits = NDArray[np.bool_]
Levels = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class GeneticOptions:
    """How the search goes. Parents win tournaments, swap what lies between two cut points, and mutate bit by bit."""

    bits: int = 8  # a gene: 2 ** bits values of each parameter, ends included
    population: int = 100
    generations: int = 200
    crossover: float = 0.9  # chance that two parents swap the bits between two points
    mutation: float = 0.02  # chance of each bit of a child to flip
    elite: int = 2  # best chromosomes carried over unchanged
    tournament: int = 3  # chromosomes drawn for each parent, of which the best is taken
    gray: bool = True  # neighbouring values differ in one bit: in plain binary the search sticks at 127 | 128
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("population", 2), ("generations", 0), ("elite", 0), ("tournament", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, got {getattr(self, name)}")
        if not 1 <= self.bits <= 32:
            raise ValueError(f"bits must lie in 1..32, got {self.bits}")
        if self.elite >= self.population:
            raise ValueError(f"elite must be below population = {self.population}, got {self.elite}")
        for name in ("crossover", "mutation"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must lie in 0..1, got {getattr(self, name)}")


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """The values that genes of ``bits`` can stand for: level 0 is the lower bound, 2 ** bits - 1 the upper one."""

    bounds: FloatArray  # (p, 2)
    bits: int

    @property
    def levels(self) -> int:
        """Values of each parameter."""
        return int(2**self.bits)

    @property
    def resolution(self) -> FloatArray:
        """Distance (p,) between neighbouring values of each parameter."""
        return np.asarray((self.bounds[:, 1] - self.bounds[:, 0]) / (self.levels - 1))

    def theta(self, level: Levels) -> FloatArray:
        """Parameters (..., p) at levels (..., p)."""
        share = level / (self.levels - 1)
        return np.asarray(self.bounds[:, 0] * (1.0 - share) + self.bounds[:, 1] * share)

    def nearest(self, theta: ArrayLike) -> Levels:
        """Levels (..., p) nearest to parameters (..., p)."""
        level = np.rint((np.asarray(theta, dtype=float) - self.bounds[:, 0]) / self.resolution)
        return np.asarray(np.clip(level, 0, self.levels - 1).astype(np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class GeneticResult:
    """The best chromosome that the search came upon."""

    model: MatrixModel
    cost: float  # [m^2] + [rad^2], Mandow 2007, Eq. (13)
    history: FloatArray  # (generations + 1,) best cost so far
    evaluations: int  # different chromosomes judged
    resolution: FloatArray  # (p,) distance between neighbouring values of each parameter
    options: GeneticOptions


@dataclass(frozen=True, slots=True)
class GridOptimum:
    """The best point of the grid around the continuous optimum."""

    model: MatrixModel
    cost: float
    moves: int


@dataclass(frozen=True, slots=True)
class Shortfall:
    """What the genetic search and its grid lose, as fractions: 0.01 is a cost one per cent above the better one."""

    genetic_cost: float
    grid_cost: float
    squares_cost: float

    @property
    def search(self) -> float:
        """Genetic result over the best point of its grid."""
        return _over(self.genetic_cost, self.grid_cost)

    @property
    def grid(self) -> float:
        """Best point of the grid over the continuous optimum."""
        return _over(self.grid_cost, self.squares_cost)


def genetic_fit(
    found: Fit, drives: Sequence[Drive], windows: Sequence[Windows], options: GeneticOptions | None = None
) -> tuple[Fit, str]:
    """Put the result of the genetic search in place of the parameters of a fit, at the timing that the fit found.

    Returns:
        The fit with Mandow's parameters, its covariance unchanged, and what the search loses, in words.

    Raises:
        RequestError: a model that is not linear in the rim speeds, or without parameters.
    """
    if not isinstance(found.model, MatrixModel):
        raise RequestError(f"the genetic search needs a model linear in the rim speeds, not '{found.model.NAME}'")
    of_body = [replace(w, motion=found.mount.body(w.motion)) for w in windows]
    result, loss = search_drives(found.model, drives, of_body, found.timings, options)
    values = found.values.copy()
    values[: len(result.model.theta)] = result.model.theta
    note = (
        f"genetic search: cost {100.0 * loss.search:.2g} % above the best point of its {result.options.bits}-bit grid,"
        f" that {100.0 * loss.grid:.2g} % above the least squares; sigmas are those of the least-squares fit"
    )
    return replace(found, model=result.model, values=values), note


def search_drives(
    start: MatrixModel,
    drives: Sequence[Drive],
    windows: Sequence[Windows],
    timings: Sequence[Timing],
    options: GeneticOptions | None = None,
    bounds: ArrayLike | None = None,
) -> tuple[GeneticResult, Shortfall]:
    """Mandow's experiment on drives of one robot, and how far its result is from the optima.

    Args:
        start: any model of the family to search; it only chooses the whole turns of long windows.
        drives: at least one.
        windows: of each drive, the segments of Eq. (13): between neighbouring reference poses in the paper.
        timings: of each drive, how the reference lies against the wheels: ``Timing()`` in the paper.
        options: of the search.
        bounds: (p, 2) of the parameters; by default those of the model for the first drive's vehicle.

    Raises:
        RequestError: no drive, windows too long for the bounds, or a model without parameters.
    """
    if not drives:
        raise RequestError("no drive to search over")
    limits = type(start).bounds(drives[0].vehicle) if bounds is None else bounds
    parts = (
        moments(steps(drive.wheels, cut, timing), cut, start, limits)
        for drive, cut, timing in zip(drives, windows, timings, strict=True)
    )
    total = reduce(add, parts)
    result = search(total, start, limits, options)
    return result, measure_shortfall(result, total, limits)


def search(
    total: Moments, start: MatrixModel, bounds: ArrayLike, options: GeneticOptions | None = None
) -> GeneticResult:
    """Binary genetic search over the parameters of models like ``start``; the seed decides everything.

    Args:
        total: moments made for the same bounds.
        start: any model of the family; its parameters play no role.
        bounds: (p, 2) lower and upper bound of each parameter.
        options: of the search.

    Raises:
        RequestError: the model has no parameters.
    """
    options = options or GeneticOptions()
    grid = Grid(checked_bounds(start, bounds), options.bits)
    if len(grid.bounds) == 0:
        raise RequestError(f"the model '{start.NAME}' has no parameters to search for")
    rng = np.random.default_rng(options.seed)
    known: dict[bytes, float] = {}
    population = rng.random((options.population, len(grid.bounds) * options.bits)) < 0.5
    cost = _judge(_decode(population, options), known, total, start, grid)
    history = [cost.min()]
    for _ in range(options.generations):
        population = _breed(population, cost, options, rng)
        cost = _judge(_decode(population, options), known, total, start, grid)
        history.append(min(history[-1], cost.min()))
    best = np.frombuffer(min(known, key=known.__getitem__), dtype=np.int64)
    model = start.with_theta(grid.theta(best))
    return GeneticResult(model, float(history[-1]), np.array(history), len(known), grid.resolution, options)


def grid_optimum(total: Moments, start: MatrixModel, bounds: ArrayLike, bits: int = 8, reach: int = 2) -> GridOptimum:
    """The best point of the grid around ``start``, usually the continuous optimum.

    All points within ``reach`` levels in every parameter are judged and the best is moved to, until none is better.
    """
    grid = Grid(checked_bounds(start, bounds), bits)
    known: dict[bytes, float] = {}
    moves_to = np.array(list(itertools.product(range(-reach, reach + 1), repeat=len(grid.bounds))), dtype=np.int64)
    here, cost, moves = grid.nearest(start.theta), np.inf, -1
    while True:
        around = np.clip(here + moves_to, 0, grid.levels - 1)
        costs = _judge(around, known, total, start, grid)
        best = int(np.argmin(costs))
        if not costs[best] < cost:
            return GridOptimum(start.with_theta(grid.theta(here)), cost, moves)
        here, cost, moves = around[best], float(costs[best]), moves + 1


def measure_shortfall(result: GeneticResult, total: Moments, bounds: ArrayLike) -> Shortfall:
    """How far the genetic result is from the best point of its grid, and that from the continuous optimum."""
    squares = fit_squares(total, result.model, bounds)
    around = [grid_optimum(total, model, bounds, result.options.bits) for model in (squares.model, result.model)]
    return Shortfall(result.cost, min(optimum.cost for optimum in around), squares.cost)


def _over(cost: float, best: float) -> float:
    """The fraction by which a cost lies above a better one; infinite above one that is zero but for rounding."""
    if best <= 0.0:
        return 0.0 if cost <= best else math.inf
    return cost / best - 1.0


def _judge(level: Levels, known: dict[bytes, float], total: Moments, start: MatrixModel, grid: Grid) -> FloatArray:
    """Costs (m,) of chromosomes (m, p); ``known`` holds those judged before and is added to."""
    keys = [row.tobytes() for row in level]
    fresh = {key: i for i, key in enumerate(keys) if key not in known}
    if fresh:
        thetas = grid.theta(level[list(fresh.values())])
        known.update(zip(fresh, total.cost(matrices(start, thetas)).tolist(), strict=True))
    return np.array([known[key] for key in keys])


def _decode(population: Bits, options: GeneticOptions) -> Levels:
    """Levels (m, p) of chromosomes (m, p * bits), the most significant bit of each gene first."""
    genes = population.reshape(len(population), -1, options.bits)
    if options.gray:
        genes = np.logical_xor.accumulate(genes, axis=-1)
    return np.asarray(genes @ (1 << np.arange(options.bits, dtype=np.int64)[::-1]))


def _breed(population: Bits, cost: FloatArray, options: GeneticOptions, rng: np.random.Generator) -> Bits:
    """The next generation: the elite, and children of the winners of tournaments."""
    size, length = population.shape
    pairs = (size - options.elite + 1) // 2
    drawn = rng.integers(size, size=(2, pairs, options.tournament))
    winners = np.take_along_axis(drawn, np.argmin(cost[drawn], axis=-1)[..., None], axis=-1)[..., 0]
    mother, father = population[winners]
    swap = _between_cuts(pairs, length, rng) & (rng.random((pairs, 1)) < options.crossover)
    children = np.concatenate([np.where(swap, father, mother), np.where(swap, mother, father)])
    children ^= rng.random(children.shape) < options.mutation
    elite = population[np.argsort(cost, kind="stable")[: options.elite]]
    return np.concatenate([elite, children[: size - options.elite]])


def _between_cuts(pairs: int, length: int, rng: np.random.Generator) -> Bits:
    """Mask (pairs, length) of the bits between two cut points drawn for each pair."""
    cuts = np.sort(rng.integers(length + 1, size=(pairs, 2, 1)), axis=1)
    place = np.arange(length)
    return np.asarray((place >= cuts[:, 0]) & (place < cuts[:, 1]))
