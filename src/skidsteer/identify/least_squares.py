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
from skidsteer.kernels import chain
from skidsteer.models import Model
from skidsteer.noise import Noise, Residuals, Weights, fit_noise, residuals, reweigh
from skidsteer.se2 import FloatArray
from skidsteer.windows import Timing, Windows, linearize, predict, steps

log = logging.getLogger(__name__)

ROUGH = 0.05  # [sigma] parameters need not settle better than this while noise and weights still change


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How a model is fitted; the defaults suit real logs."""

    time_offset: float | None = None  # [s] fixed to this; None: estimated, one for each drive
    lag: float | None = None  # [s] fixed to this; None: estimated
    fix_model: bool = False  # keep the model's parameters, estimate only the timing
    noise: Noise | None = None  # fixed to this; None: estimated
    robust: bool = True  # weigh down outliers
    search: tuple[float, float] = (-1.0, 1.5)  # [s] where the time offset is looked for
    rounds: int = 6  # of parameters, then noise and weights
    iterations: int = 40  # Gauss-Newton steps in a round
    tolerance: float = 1e-3  # converged: no parameter moves by more than this share of its sigma
    block: float = 10.0  # [s] stretches that are taken as independent for the check of the covariance


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Estimates and their covariance; ``names`` orders the rows: parameters, lag, time offset of each drive."""

    model: Model
    timings: tuple[Timing, ...]  # one for each drive
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
    inflated: float  # factor on the variances by the scatter between blocks; 1 where the noise model explains it


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """One point of the search: all unknowns in a vector (m,), and how they map to model and timings."""

    model: Model
    x: FloatArray
    drives: int

    def at(self, x: FloatArray) -> _State:
        return _State(self.model.with_theta(x[: len(self.model.theta)]), x, self.drives)

    def timing(self, drive: int) -> Timing:
        p = len(self.model.theta)
        return Timing(float(self.x[p + 1 + drive]), float(self.x[p]))


def fit(model: Model, drives: list[Drive], windows: list[Windows], options: FitOptions = FitOptions()) -> Fit:
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
    state, prior, free, limits = _start(model, drives, windows, options)
    noise = options.noise or Noise()
    weights = [Weights.ones(len(w)) for w in windows]
    problem = _Problem(drives, windows, prior, free, limits, state.x)
    count = 0
    rough = replace(options, tolerance=ROUGH)
    for round_ in range(options.rounds):
        state, moved, used = problem.gauss_newton(state, noise, weights, rough)
        count += used
        if round_ > 1 and moved < 2.0 * ROUGH:
            break
        noise, weights = problem.reweighed(state, noise, weights, options)
    state, _, used = problem.gauss_newton(state, noise, weights, options)
    return problem.result(state, noise, weights, options, count + used, used < options.iterations)


def _start(
    model: Model, drives: list[Drive], windows: list[Windows], options: FitOptions
) -> tuple[_State, FloatArray, np.ndarray, FloatArray]:
    p, n = len(model.theta), len(drives)
    offsets = [
        find_offset(model, drive, w, options.search) if options.time_offset is None else options.time_offset
        for drive, w in zip(drives, windows, strict=True)
    ]
    x = np.concatenate([model.theta, [0.05 if options.lag is None else options.lag], offsets])
    bounds = type(model).bounds(drives[0].vehicle)
    prior = np.concatenate([(bounds[:, 1] - bounds[:, 0]) / np.sqrt(12.0), [0.5], np.full(n, 1.0)])
    free = np.concatenate([np.full(p, not options.fix_model), [options.lag is None], np.full(n, options.time_offset is None)])
    limits = np.concatenate([bounds, [[0.0, 2.0]], np.tile([-5.0, 5.0], (n, 1))])
    return _State(model, x, n), prior, free, limits


def find_offset(
    model: Model, drive: Drive, windows: Windows, search: tuple[float, float], lag: float = 0.0, most: int = 3000
) -> float:
    """Time offset [s] at which predicted and measured increments agree best, on a grid of 0.05 s.

    Yaw and forward increments each vote with the share of their variance that the prediction explains, so that the
    scale factors of the model do not matter.
    """
    some = windows.where(np.arange(len(windows)) < most) if len(windows) > most else windows
    candidates = np.arange(search[0], search[1] + 0.025, 0.05)
    rate = 1.0 / np.maximum(some.end - some.start, 1e-3)[:, None]
    measured = some.motion[:, [0, 2]] * rate
    scores = []
    for offset in candidates:
        predicted = predict(model, drive.wheels, some, Timing(float(offset), lag))[:, [0, 2]] * rate
        scores.append(sum(_explained(measured[:, i], predicted[:, i]) for i in range(2)))
    return float(candidates[int(np.argmax(scores))]) if max(scores) > 0.2 else 0.0


def _explained(a: FloatArray, b: FloatArray) -> float:
    """Squared correlation after clipping the outliers of a; 0 where one of them does not vary."""
    a = np.clip(a, *np.quantile(a, [0.01, 0.99])) if len(a) else a
    spread = float(np.std(a) * np.std(b)) if len(a) else 0.0
    return float(np.mean((a - a.mean()) * (b - b.mean())) / spread) ** 2 if spread > 1e-9 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    drives: list[Drive]
    windows: list[Windows]
    prior: FloatArray
    free: np.ndarray
    limits: FloatArray
    x0: FloatArray

    def residuals(self, state: _State) -> tuple[list[Residuals], list[FloatArray]]:
        parts, jacobians = [], []
        for i, (drive, windows) in enumerate(zip(self.drives, self.windows, strict=True)):
            cut = steps(drive.wheels, windows, state.timing(i))
            predicted, jacobian = linearize(state.model, cut)
            parts.append(residuals(state.model, windows, cut, predicted))
            jacobians.append(jacobian)
        return parts, jacobians

    def information(
        self, state: _State, noise: Noise, weights: list[Weights], block: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """Gauss-Newton matrix (m, m), scores (blocks, m) and deviance at a state; no prior."""
        m, p = len(state.x), len(state.model.theta)
        H, scores, deviance = np.zeros((m, m)), [], 0.0
        parts, jacobians = self.residuals(state)
        for i, (part, jacobian) in enumerate(zip(parts, jacobians, strict=True)):
            w, columns = part.windows, np.r_[0:p, p + 1 + i, p]
            number = np.unique((w.start // block).astype(int), return_inverse=True)[1] if len(w) else np.zeros(0, int)
            h, s, d = chain.information(
                w.motion,
                w.joined,
                part.residual,
                np.ascontiguousarray(jacobian),
                *part.covariances(noise, weights[i]),
                number,
                int(number.max(initial=0)) + 1,
            )
            H[np.ix_(columns, columns)] += h
            wide = np.zeros((len(s), m))
            wide[:, columns] = s
            scores.append(wide)
            deviance += d
        return H, np.concatenate(scores), deviance

    def gauss_newton(
        self, state: _State, noise: Noise, weights: list[Weights], options: FitOptions
    ) -> tuple[_State, float, int]:
        """Levenberg-Marquardt for fixed noise and weights; returns the state, how far it moved in sigmas, the steps."""
        begin, damping = state.x.copy(), 1e-6
        weight = 1.0 / self.prior**2
        H, scores, deviance = self.information(state, noise, weights, options.block)
        cost = deviance + weight @ (state.x - self.x0) ** 2
        steps_done = 0
        while steps_done < options.iterations:
            steps_done += 1
            gradient = scores.sum(axis=0) - weight * (state.x - self.x0)
            active = self._active(state.x, gradient)
            full = H + np.diag(weight)
            step = np.zeros_like(state.x)
            damped = full[np.ix_(active, active)]
            step[active] = np.linalg.solve(damped + damping * np.diag(np.diag(damped)), gradient[active])
            x = np.clip(state.x + step, self.limits[:, 0], self.limits[:, 1])
            x[~self.free] = state.x[~self.free]
            sigma = np.sqrt(1.0 / np.diag(full))
            small = bool((np.abs(x - state.x) < options.tolerance * sigma).all())
            trial = state.at(x)
            H_new, scores_new, deviance_new = self.information(trial, noise, weights, options.block)
            cost_new = deviance_new + weight @ (x - self.x0) ** 2
            if cost_new <= cost + 1e-9 * abs(cost):
                state, H, scores, cost = trial, H_new, scores_new, cost_new
                damping = max(damping * 0.1, 1e-9)
            else:
                damping = max(damping * 30.0, 1e-4)
            if small:
                break
        moved = np.abs(state.x - begin) * np.sqrt(np.diag(H) + weight)
        return state, float(moved.max()), steps_done

    def _active(self, x: FloatArray, gradient: FloatArray) -> np.ndarray:
        """Free unknowns that are not pressed against a limit."""
        low = (x <= self.limits[:, 0]) & (gradient < 0)
        high = (x >= self.limits[:, 1]) & (gradient > 0)
        return np.asarray(self.free & ~low & ~high)

    def reweighed(
        self, state: _State, noise: Noise, weights: list[Weights], options: FitOptions
    ) -> tuple[Noise, list[Weights]]:
        parts, _ = self.residuals(state)
        if options.noise is None:
            noise = fit_noise(parts, noise, weights)
        if options.robust:
            weights = reweigh(parts, noise)
        if options.noise is None and options.robust:
            noise = fit_noise(parts, noise, weights)
        return noise, weights

    def result(
        self,
        state: _State,
        noise: Noise,
        weights: list[Weights],
        options: FitOptions,
        iterations: int,
        converged: bool,
    ) -> Fit:
        H, scores, deviance = self.information(state, noise, weights, options.block)
        covariance, inflated = self._covariance(H, scores)
        offsets = ["time_offset"] if state.drives == 1 else [f"time_offset:{d.name}" for d in self.drives]
        names = (*(q.name for q in state.model.PARAMETERS), "lag", *offsets)
        timings = tuple(state.timing(i) for i in range(state.drives))
        log.debug("%s: %d steps, deviance %.1f, %s", type(state.model).NAME, iterations, deviance, noise)
        return Fit(
            state.model, timings, names, state.x, covariance, self.prior, self.free, noise, tuple(weights),
            deviance, sum(map(len, self.windows)), iterations, converged, inflated,
        )  # fmt: skip

    def _covariance(self, H: FloatArray, scores: FloatArray) -> tuple[FloatArray, float]:
        """Inverse information; replaced by the block sandwich where the scores scatter more than the noise explains.

        With B independent blocks, sum of s^T H^-1 s is about p on average (chi-square with p degrees of freedom for
        each of B sums of unequal weight); more than the 99.9 % quantile says that errors last longer than the model
        of the noise thinks.
        """
        free = self.free
        full = H + np.diag(1.0 / self.prior**2)
        bread = np.linalg.inv(full[np.ix_(free, free)])
        covariance = np.zeros_like(H)
        covariance[np.ix_(free, free)] = bread
        s, p = scores[:, free], int(free.sum())
        blocks = int((np.abs(s).sum(axis=1) > 0).sum())
        if p == 0 or blocks < 2 * p + 4:
            return covariance, 1.0
        meat = s.T @ s * blocks / (blocks - 1)
        ratio = float(np.trace(bread @ meat)) / p
        leverage = np.einsum("bi,ij,bj->b", s, bread, s)
        effective = leverage.sum() ** 2 / max((leverage**2).sum(), 1e-300) * p
        if ratio <= chi2.ppf(0.999, effective) / effective:
            return covariance, 1.0
        covariance[np.ix_(free, free)] = bread @ meat @ bread
        return covariance, ratio


def fixed(options: FitOptions, timing: Timing) -> FitOptions:
    """The same options with time offset and lag held at known values."""
    return replace(options, time_offset=timing.time_offset, lag=timing.lag)
