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
from skidsteer.gyro import GyroErrors, Turn, rough_errors
from skidsteer.heading import correct_headings, guess_headings, headings_of
from skidsteer.identify.unknowns import Unknowns
from skidsteer.kernels import chain
from skidsteer.models import Model
from skidsteer.noise import Noise, Residuals, Weights, fit_noise, residuals, reweigh, smoothed
from skidsteer.prediction import Uncertainty
from skidsteer.se2 import FloatArray
from skidsteer.windows import Mount, Timing, Windows, covered, linearize, predict, seen_by, steps

log = logging.getLogger(__name__)

ROUGH = 0.05  # [sigma] parameters need not settle better than this while noise and weights still change


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How a model is fitted; the defaults suit real logs."""

    time_offset: float | None = None  # [s] fixed to this; None: estimated, one for each drive
    lag: float | None = None  # [s] fixed to this; None: estimated
    mount: Mount | None = field(
        default_factory=Mount
    )  # of the reference's sensor; None: estimated (models symmetric about the origin)
    use_gyro: bool = True  # a gyro, where there is one, tells turns beside the reference
    fix_model: bool = False  # keep the model's parameters, estimate only the timing
    without: tuple[str, ...] = ()  # parameters of the model that stay as they are
    noise: Noise | None = None  # fixed to this; None: estimated
    robust: bool = True  # weigh down outliers
    search: tuple[float, float] = (-1.0, 1.5)  # [s] where the time offset is looked for
    rounds: int = 6  # of parameters, then noise and weights
    iterations: int = 40  # Gauss-Newton steps in a round
    tolerance: float = 1e-3  # converged: no parameter moves by more than this share of its sigma
    block: float = 10.0  # [s] stretches that are taken as independent for the check of the covariance


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
    inflated: float  # factor on the variances by the scatter between blocks; 1 where the noise model explains it

    @property
    def told(self) -> np.ndarray:
        """Which entries (m,) are worth telling: the model, the lag, the time offsets, and what else was estimated."""
        always = np.array([n == "lag" or n.split(":")[0] == "time_offset" for n in self.names])
        always[: len(self.model.PARAMETERS)] = True
        return np.asarray(always | self.free)

    def uncertainty(self, drive: int) -> Uncertainty:
        """What a prediction of one of the drives may be wrong by."""
        p = len(self.model.PARAMETERS)
        index = [*range(p), p + 4 + 4 * drive, p]
        return Uncertainty(self.noise, self.covariance[np.ix_(index, index)])

    def named(self, name: str) -> tuple[float, float]:
        """Value and sigma of one unknown."""
        i = self.names.index(name)
        return float(self.values[i]), float(np.sqrt(self.covariance[i, i]))


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
    start, free = _start(model, drives, windows, options)
    turns = [Turn.of(d.gyro) if d.gyro is not None and options.use_gyro else None for d in drives]
    windows = [_headed(model, d, w, start, i) for i, (d, w) in enumerate(zip(drives, windows, strict=True))]
    problem = _Problem(drives, windows, turns, start, start.prior_sigma(drives), free, start.bounds(drives), options)
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
    state, _, used = problem.gauss_newton(state, noise, weights, options.tolerance)
    return problem.result(state, noise, weights, count + used, used < options.iterations)


SUPPORTED = 1.5  # [sigma] that an optional parameter must differ from nothing by


def fit_supported(model: Model, drives: list[Drive], windows: list[Windows], options: FitOptions = FitOptions()) -> Fit:
    """As ``fit``, with only those of the model's optional parameters that the drives support.

    Backward elimination: the least significant one by the honest covariance is left out (stays nominal) and the rest is
    fitted again, until every one that is left differs from nominal by ``SUPPORTED`` sigmas.
    """
    while True:
        found = fit(model, drives, windows, options)
        left = [name for name in model.OPTIONAL if name not in options.without]
        strength = {name: abs(_difference(found, model, name)) for name in left}
        if not strength or min(strength.values()) >= SUPPORTED:
            return found
        options = replace(options, without=(*options.without, min(strength, key=lambda name: strength[name])))


def _difference(found: Fit, start: Model, name: str) -> float:
    """By how many sigmas a parameter differs from where it started."""
    value, sigma = found.named(name)
    return (value - float(getattr(start, name))) / sigma if sigma > 0.0 else 0.0


def _start(
    model: Model, drives: list[Drive], windows: list[Windows], options: FitOptions
) -> tuple[Unknowns, np.ndarray]:
    """Where the search begins, and which entries (m,) of it are free."""
    own, free_own = [], []
    for drive, w in zip(drives, windows, strict=True):
        offset, known = options.time_offset, options.time_offset is not None or w.sees == "turn"
        if offset is None:
            offset = 0.0 if w.sees == "turn" else find_offset(model, drive, w, options.search)
        with_gyro = drive.gyro is not None and options.use_gyro
        gyro = rough_errors(drive.wheels, drive.gyro, model) if with_gyro and drive.gyro is not None else GyroErrors()
        own += [offset, gyro.time_offset, gyro.bias, gyro.scale]
        free_own += [not known, with_gyro, with_gyro, with_gyro]
    mount = options.mount or Mount()
    x = np.array([*model.theta, 0.05 if options.lag is None else options.lag, mount.x, mount.y, mount.yaw, *own])
    shared = [not options.fix_model and p.name not in options.without for p in model.PARAMETERS]
    shared += [options.lag is None]
    shared += [options.mount is None] * 2 + [options.mount is None and any(w.sees == "pose" for w in windows)]
    return Unknowns(model, x, len(drives)), np.array(shared + free_own)


def _headed(model: Model, drive: Drive, windows: Windows, start: Unknowns, i: int) -> Windows:
    """Windows with a first guess of the headings that the reference does not tell."""
    if windows.sees != "position":
        return windows
    return guess_headings(windows, start.mount.seen(predict(model, drive.wheels, windows, start.timing(i))))


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
    measured = _speeds(some.motion, some.sees) * rate
    scores = []
    for offset in candidates:
        predicted = _speeds(predict(model, drive.wheels, some, Timing(float(offset), lag)), some.sees) * rate
        scores.append(sum(_explained(measured[:, i], predicted[:, i]) for i in range(2)))
    return float(candidates[int(np.argmax(scores))]) if max(scores) > 0.2 else 0.0


def _speeds(motion: FloatArray, sees: str) -> FloatArray:
    """Forward and yaw part (k, 2) of motions; without headings the distance covered, and no yaw."""
    if sees == "pose":
        return motion[:, [0, 2]]
    distance = np.hypot(motion[:, 0], motion[:, 1])
    return np.stack([distance, np.zeros_like(distance)], axis=1)


def _explained(a: FloatArray, b: FloatArray) -> float:
    """Squared correlation after clipping the outliers of a; 0 where one of them does not vary."""
    a = np.clip(a, *np.quantile(a, [0.01, 0.99])) if len(a) else a
    spread = float(np.std(a) * np.std(b)) if len(a) else 0.0
    return float(np.mean((a - a.mean()) * (b - b.mean())) / spread) ** 2 if spread > 1e-9 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Drives, and what is searched for in them."""

    drives: list[Drive]
    windows: list[Windows]
    turns: list[Turn | None]
    start: Unknowns
    prior: FloatArray
    free: np.ndarray
    limits: FloatArray
    options: FitOptions

    def compare(self, state: Unknowns, i: int) -> tuple[Residuals, FloatArray, FloatArray]:
        """Residuals of one drive, derivative (k, 3, f) of its predicted motions and (k, f) of its gyro residual.

        Columns are the free ones of ``Unknowns.columns``.
        """
        drive, windows, timing, errors = self.drives[i], self.windows[i], state.timing(i), state.gyro(i)
        cut = steps(drive.wheels, windows, timing)
        motion, jacobian = linearize(state.model, cut)
        p = state.p
        seen, by_all = seen_by(state.mount, motion, jacobian[..., np.r_[0:p, p + 1, p]])
        order = np.r_[0:p, p, p + 2 : p + 5, p + 1]  # parameters, lag, mount, time offset
        by_all = np.concatenate([by_all[..., order], np.zeros((len(motion), 3, 3))], axis=-1)
        turned, by_gyro = self._gyro(i, timing, errors, -by_all[:, 2])
        free = self.free[state.columns(i)]
        part = residuals(state.model, windows, cut, seen, turned)
        return part, np.ascontiguousarray(by_all[..., free]), np.ascontiguousarray(by_gyro[:, free])

    def _gyro(
        self, i: int, timing: Timing, errors: GyroErrors, by_prediction: FloatArray
    ) -> tuple[FloatArray | None, FloatArray]:
        """Turn (k,) of the gyro over the windows, NaN where wheels or gyro are silent; derivative of its residual."""
        turn, windows = self.turns[i], self.windows[i]
        if turn is None:
            return None, by_prediction
        start, end = windows.start - timing.time_offset, windows.end - timing.time_offset
        slide = turn.rate_at(end, errors) - turn.rate_at(start, errors)
        by = by_prediction.copy()
        by[:, -4] -= slide
        by[:, -3] += slide
        by[:, -2] -= errors.scale * (end - start)
        turned = turn.between(start, end, errors)
        by[:, -1] += turned / errors.scale
        known = turn.covers(start, end, errors) & covered(self.drives[i].wheels.t, start, end)
        return np.where(known, turned, np.nan), by

    def information(
        self, state: Unknowns, noise: Noise, weights: list[Weights]
    ) -> tuple[FloatArray, FloatArray, float]:
        """Gauss-Newton matrix (f, f), scores (blocks, f) and deviance at a state, of the free unknowns; no prior."""
        rank = np.cumsum(self.free) - 1
        size = int(self.free.sum())
        H, scores, deviance = np.zeros((size, size)), [], 0.0
        for i, windows in enumerate(self.windows):
            part, jacobian, by_gyro = self.compare(state, i)
            number, count = _blocks(windows, self.options.block)
            h, s, d = chain.information(
                windows.motion,
                windows.joined,
                part.residual,
                jacobian,
                *part.covariances(noise, weights[i]),
                part.gyro,
                by_gyro,
                noise.gyro**2 * part.gyro_time,
                number,
                count,
            )
            columns = state.columns(i)
            index = rank[columns[self.free[columns]]]
            H[np.ix_(index, index)] += h
            wide = np.zeros((len(s), size))
            wide[:, index] = s
            scores.append(wide)
            deviance += d
            deviance += self._scale_of_gyro(state, i, part, rank, H, wide, number)
        return H, np.concatenate(scores), deviance

    def _scale_of_gyro(
        self,
        state: Unknowns,
        i: int,
        part: Residuals,
        rank: np.ndarray,
        H: FloatArray,
        scores: FloatArray,
        block: np.ndarray,
    ) -> float:
        """Add to H and scores what the change of variables from the gyro's samples to true turns contributes.

        The residual is in units of the true turn, scale times the measured one: without this term a small scale would
        make all residuals small.
        """
        at = int(state.columns(i)[-1])
        told = np.isfinite(part.gyro_time)
        scale, count = state.gyro(i).scale, int(told.sum())
        if self.free[at] and count:
            H[rank[at], rank[at]] += count / scale**2
            scores[:, rank[at]] += np.bincount(block[told], minlength=len(scores)) / scale
        return -2.0 * count * float(np.log(scale))

    def gauss_newton(
        self, state: Unknowns, noise: Noise, weights: list[Weights], tolerance: float
    ) -> tuple[Unknowns, float, int]:
        """Levenberg-Marquardt for fixed noise and weights; returns the state, how far it moved in sigmas, the steps."""
        free, weight = self.free, 1.0 / self.prior[self.free] ** 2
        begin, origin, damping = state.x[free], self.start.x[free], 1e-6
        H, scores, deviance = self.information(state, noise, weights)
        cost = deviance + weight @ (begin - origin) ** 2
        steps_done = 0
        while steps_done < self.options.iterations:
            steps_done += 1
            gradient = scores.sum(axis=0) - weight * (state.x[free] - origin)
            step = self._step(state.x[free], H + np.diag(weight), gradient, damping)
            x = state.x.copy()
            x[free] = np.clip(state.x[free] + step, *self.limits[free].T)
            small = bool((np.abs(x - state.x)[free] * np.sqrt(np.diag(H) + weight) < tolerance).all())
            trial = state.at(x)
            H_new, scores_new, deviance_new = self.information(trial, noise, weights)
            cost_new = deviance_new + weight @ (x[free] - origin) ** 2
            if cost_new <= cost + 1e-9 * abs(cost):
                state, H, scores, cost = trial, H_new, scores_new, cost_new
                damping = max(damping * 0.1, 1e-9)
            else:
                damping = max(damping * 30.0, 1e-4)
            if small:
                break
        moved = np.abs(state.x[free] - begin) * np.sqrt(np.diag(H) + weight)
        return state, float(moved.max(initial=0.0)), steps_done

    def _step(self, x: FloatArray, H: FloatArray, gradient: FloatArray, damping: float) -> FloatArray:
        """Damped step of the free unknowns that are not pressed against a limit."""
        low, high = self.limits[self.free].T
        active = ~((x <= low) & (gradient < 0)) & ~((x >= high) & (gradient > 0))
        damped = H[np.ix_(active, active)]
        step = np.zeros_like(x)
        step[active] = np.linalg.solve(damped + damping * np.diag(np.diag(damped)), gradient[active])
        return step

    def reweighed(self, state: Unknowns, noise: Noise, weights: list[Weights]) -> tuple[Noise, list[Weights]]:
        """Noise and outlier weights that fit the residuals at a state."""
        parts = [self.compare(state, i)[0] for i in range(len(self.drives))]
        if self.options.noise is None:
            noise = fit_noise(parts, noise, weights)
        if self.options.robust:
            weights = reweigh(parts, noise)
            if self.options.noise is None:
                noise = fit_noise(parts, noise, weights)
        return noise, weights

    def headed(self, state: Unknowns, noise: Noise, weights: list[Weights]) -> _Problem:
        """The same problem with better headings where the reference does not tell them."""
        windows = list(self.windows)
        for i, old in enumerate(self.windows):
            if old.sees == "position":
                part = self.compare(state, i)[0]
                start, end, _ = smoothed(part, noise, weights[i])
                windows[i] = correct_headings(old, *headings_of(part, start, end))
        return replace(self, windows=windows)

    def result(self, state: Unknowns, noise: Noise, weights: list[Weights], iterations: int, converged: bool) -> Fit:
        """The fit at a state that the search ended in."""
        H, scores, deviance = self.information(state, noise, weights)
        covariance = np.zeros((len(state.x), len(state.x)))
        of_free, inflated = _covariance(H, scores, self.prior[self.free])
        covariance[np.ix_(self.free, self.free)] = of_free
        log.debug("%s: %d steps, deviance %.1f, %s", state.family.NAME, iterations, deviance, noise)
        return Fit(
            model=state.model,
            timings=tuple(state.timing(i) for i in range(len(self.drives))),
            mount=state.mount,
            names=state.names(self.drives),
            values=state.x,
            covariance=covariance,
            prior_sigma=self.prior,
            free=self.free,
            noise=noise,
            weights=tuple(weights),
            deviance=deviance,
            windows=sum(map(len, self.windows)),
            iterations=iterations,
            converged=converged,
            inflated=inflated,
        )


def _blocks(windows: Windows, length: float) -> tuple[np.ndarray, int]:
    """Number (k,) of the stretch of ``length`` [s] that each window begins in, and how many there are."""
    if not len(windows):
        return np.zeros(0, np.int64), 1
    stretch, number = np.unique((windows.start // length).astype(np.int64), return_inverse=True)
    return number, len(stretch)


def _covariance(H: FloatArray, scores: FloatArray, prior: FloatArray) -> tuple[FloatArray, float]:
    """Inverse information; replaced by the block sandwich where the scores scatter more than the noise explains.

    With independent blocks the sum of s^T H^-1 s has the number of unknowns p as its mean; it is a weighted sum of
    chi-squares whose effective degrees of freedom follow from how evenly the blocks weigh. Above its 99.9 % quantile
    errors last longer than the model of the noise thinks.
    """
    p = len(H)
    bread: FloatArray = np.asarray(np.linalg.inv(H + np.diag(1.0 / prior**2)))
    blocks = int((np.abs(scores).sum(axis=1) > 0).sum())
    if p == 0 or blocks < 2 * p + 4:
        return bread, 1.0
    meat = scores.T @ scores * blocks / (blocks - 1)
    ratio = float(np.trace(bread @ meat)) / p
    leverage = np.einsum("bi,ij,bj->b", scores, bread, scores)
    effective = leverage.sum() ** 2 / (leverage**2).sum() * p
    if ratio <= chi2.ppf(0.999, effective) / effective:
        return bread, 1.0
    return np.asarray(bread @ meat @ bread), ratio
