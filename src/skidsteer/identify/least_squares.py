"""Robust Gauss-Newton over the reference increments of drives: model, time offset and lag with one covariance.

The cost is the negative log likelihood of all increments as one chain per drive (``kernels.chain``), so that the pose
two neighbours share is counted once; the noise is estimated with the parameters; wrong poses and wrong motions are
weighed down where they happened.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2

from skidsteer.drive import Drive
from skidsteer.errors import DataError
from skidsteer.gyro import Turn
from skidsteer.identify.problem import Problem
from skidsteer.identify.start import FitOptions, find_offset, first_guess, with_headings
from skidsteer.identify.unknowns import Unknowns
from skidsteer.models import Model
from skidsteer.noise import Noise, Weights
from skidsteer.outliers import EPISODE
from skidsteer.prediction import Uncertainty
from skidsteer.se2 import FloatArray
from skidsteer.windows import Mount, Timing, Windows

__all__ = ["Fit", "FitOptions", "find_offset", "fit", "fit_supported"]

log = logging.getLogger(__name__)

DEFAULTS = FitOptions()
ROUGH = 0.05  # [sigma] parameters need not settle better than this while noise and weights still change


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Estimates and their covariance; ``names`` orders the rows, see ``Unknowns``."""

    model: Model
    timings: tuple[Timing, ...]  # one for each drive
    mount: Mount
    names: tuple[str, ...]
    values: FloatArray  # (m,)
    covariance: FloatArray  # (m, m)
    prior_sigma: FloatArray  # (m,) what was known before; a sigma near it says that the drive told nothing
    free: np.ndarray  # (m,) bool: estimated, not fixed
    noise: Noise
    weights: tuple[Weights, ...] = field(repr=False)
    deviance: float
    windows: int
    iterations: int
    converged: bool
    stretches: int  # of ``FitOptions.block`` seconds that told something
    block: float  # [s] of the stretches whose scatter was looked at
    inflated: float  # factor on the variances by that scatter; 1 where the noise model explains it

    @property
    def told(self) -> np.ndarray:
        """Which entries (m,) are worth telling: model, lag, time offsets, a mounting off the origin, all estimated.

        Who uses the model needs to know where the sensor sat, also where that was given.
        """
        always = np.array([n == "lag" or n.split(":")[0] == "time_offset" for n in self.names])
        always[: len(self.model.PARAMETERS)] = True
        mounted = np.array([n.startswith("mount_") for n in self.names]) & (self.values != 0.0)
        return np.asarray(always | mounted | self.free)

    def uncertainty(self, drive: int) -> Uncertainty:
        """What a prediction of one of the drives may be wrong by."""
        p = len(self.model.PARAMETERS)
        index = [*range(p), p + 4 + 4 * drive, p]
        return Uncertainty(self.noise, self.covariance[np.ix_(index, index)])

    def named(self, name: str) -> tuple[float, float]:
        """Value and sigma of one unknown."""
        i = self.names.index(name)
        return float(self.values[i]), float(np.sqrt(self.covariance[i, i]))


def fit(model: Model, drives: list[Drive], windows: list[Windows], options: FitOptions = DEFAULTS) -> Fit:
    """Estimate the model's parameters from the windows of drives, starting at ``model``.

    Args:
        model: start, and the class of model.
        drives: at least one, all of the same vehicle.
        windows: of each drive, between neighbouring reference poses.
        options: what is fixed and how hard to try.

    Raises:
        DataError: no windows, or the robot did not move in any.
    """
    if not any(len(w) for w in windows):
        raise DataError(f"{drives[0].name}: wheels and reference share no stretch of time; check their clocks")
    start, free = first_guess(model, drives, windows, options)
    turns = [Turn.of(d.gyro) if d.gyro is not None and options.use_gyro else None for d in drives]
    windows = [with_headings(model, d, w, start, i) for i, (d, w) in enumerate(zip(drives, windows, strict=True))]
    problem = Problem(drives, windows, turns, start, start.prior_sigma(drives), free, start.bounds(drives), options)
    state, noise = start, options.noise or Noise()
    weights = [Weights.ones(len(w)) for w in windows]
    count = 0
    for round_ in range(options.rounds):
        state, moved, used = problem.gauss_newton(state, noise, weights, ROUGH)
        count += used
        if round_ > 1 and moved < 2.0 * ROUGH:
            break
        noise, weights = problem.reweighed(state, noise, weights)
        problem = problem.headed(state, noise, weights)
    state, told, used = _tempered(problem, state, noise) if options.robust else (state, weights, 0)
    count += used
    state, _, used = problem.gauss_newton(state, noise, told, options.tolerance)
    return _result(problem, state, noise, weights, count + used, used < options.iterations)


def _tempered(problem: Problem, state: Unknowns, noise: Noise) -> tuple[Unknowns, list[Weights], int]:
    """State by the weights of ``outliers.temper``, those weights, and the steps taken.

    They serve the estimate alone: noise and covariance are those of ``outliers.reweigh``.
    """
    count, told = 0, problem.tempered(state, noise)
    for _ in range(problem.options.rounds):
        state, moved, used = problem.gauss_newton(state, noise, told, ROUGH)
        count += used
        if moved < 2.0 * ROUGH:
            break
        told = problem.tempered(state, noise)
    return state, told, count


SUPPORTED = 1.5  # [sigma] above nominal that an optional parameter is kept from
OPPOSED = 3.0  # [sigma] below it, where it works against its own meaning, or against other terms


def fit_supported(model: Model, drives: list[Drive], windows: list[Windows], options: FitOptions = DEFAULTS) -> Fit:
    """As ``fit``, with only those of the model's optional parameters that the drives support.

    Backward elimination: the least significant one by the honest covariance is left out (stays nominal) and the rest is
    fitted again, until every one that is left is ``SUPPORTED`` sigmas above nominal or ``OPPOSED`` below. One that is
    pressed against a bound of what is credible makes up for something else: it goes first.
    """
    limits = dict(zip((p.name for p in model.PARAMETERS), type(model).bounds(drives[0].vehicle).tolist(), strict=True))
    while True:
        found = fit(model, drives, windows, options)
        left = [name for name in model.OPTIONAL if name not in options.without]
        strength = {name: _strength(found, model, name) for name in left}
        strength |= {name: 0.0 for name in left if found.named(name)[0] in limits[name]}
        if not strength or min(strength.values()) >= 1.0:
            return found
        options = replace(options, without=(*options.without, min(strength, key=lambda name: strength[name])))


def _strength(found: Fit, start: Model, name: str) -> float:
    """How far a parameter is from where it started, over how far it must be to be kept."""
    value, sigma = found.named(name)
    away = (value - float(getattr(start, name))) / sigma if sigma > 0.0 else 0.0
    return max(away / SUPPORTED, -away / OPPOSED)


def _result(
    problem: Problem, state: Unknowns, noise: Noise, weights: list[Weights], iterations: int, converged: bool
) -> Fit:
    """The fit at a state that the search ended in."""
    H, scores, deviance = problem.information(state, noise, weights)
    free, stretches = problem.free, _telling(scores)
    covariance = np.zeros((len(state.x), len(state.x)))
    fine = _finely(problem)
    if fine.options.block < problem.options.block:
        scores = fine.information(state, noise, weights)[1]
    of_free, inflated = _covariance(H, scores, problem.prior[free])
    covariance[np.ix_(free, free)] = of_free
    log.debug("%s: %d steps, deviance %.1f, %s", state.family.NAME, iterations, deviance, noise)
    return Fit(
        model=state.model,
        timings=tuple(state.timing(i) for i in range(len(problem.drives))),
        mount=state.mount,
        names=state.names(problem.drives),
        values=state.x,
        covariance=covariance,
        prior_sigma=problem.prior,
        free=free,
        noise=noise,
        weights=tuple(weights),
        deviance=deviance,
        windows=sum(map(len, problem.windows)),
        iterations=iterations,
        converged=converged,
        stretches=stretches,
        block=fine.options.block,
        inflated=inflated,
    )


def _enough(unknowns: int) -> int:
    """Least number of blocks whose scatter says anything of a covariance."""
    return 2 * unknowns + 4


def _finely(problem: Problem) -> Problem:
    """The same problem cut into shorter blocks where it is too short for enough of the usual ones.

    What lasts at all lasts longer than an episode, so that blocks do not get shorter than that.
    """
    time = sum(float((w.end - w.start).sum()) for w in problem.windows)
    block = min(problem.options.block, max(EPISODE, time / (_enough(int(problem.free.sum())) + 1)))
    return replace(problem, options=replace(problem.options, block=block))


def _telling(scores: FloatArray) -> int:
    """How many blocks have scores (blocks, f) other than zero."""
    return int((np.abs(scores).sum(axis=1) > 0).sum())


def _covariance(H: FloatArray, scores: FloatArray, prior: FloatArray) -> tuple[FloatArray, float]:
    """Inverse information; replaced by the block sandwich where the scores scatter more than the noise explains.

    With independent blocks the sum of s^T H^-1 s has the number of unknowns p as its mean; it is a weighted sum of
    chi-squares whose effective degrees of freedom follow from how evenly the blocks weigh. Above its 99.9 % quantile
    errors last longer than the model of the noise thinks.
    """
    p, known = len(H), np.diag(1.0 / prior**2)
    bread: FloatArray = np.asarray(np.linalg.inv(H + known))
    blocks = _telling(scores)
    if p == 0 or blocks < _enough(p):
        return bread, 1.0
    meat = scores.T @ scores * blocks / (blocks - 1)
    ratio = float(np.trace(bread @ meat)) / p
    leverage = np.einsum("bi,ij,bj->b", scores, bread, scores)
    effective = leverage.sum() ** 2 / (leverage**2).sum() * p
    if ratio <= chi2.ppf(0.999, effective) / effective:
        return bread, 1.0
    return np.asarray(bread @ (meat + known) @ bread), ratio  # what nothing tells stays as uncertain as before
