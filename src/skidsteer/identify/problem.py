"""Drives and what is searched for in them: residuals, information, Gauss-Newton steps, noise and weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from skidsteer.drive import Drive
from skidsteer.gyro import GyroErrors, Turn
from skidsteer.heading import correct_headings, headings_of
from skidsteer.identify.start import FitOptions
from skidsteer.identify.unknowns import Unknowns
from skidsteer.kernels import chain
from skidsteer.noise import Noise, Residuals, Weights, fit_noise, residuals
from skidsteer.outliers import reweigh, smoothed, temper
from skidsteer.se2 import FloatArray
from skidsteer.windows import Mount, Timing, Windows, covered, linearize, seen_by, steps

RESTRICTED = 1500  # windows up to which the noise is estimated by restricted likelihood
Compared = tuple[Residuals, FloatArray, FloatArray]  # residuals of a drive, derivatives of its motions and of its gyro


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Drives, and what is searched for in them."""

    drives: list[Drive]
    windows: list[Windows]
    turns: list[Turn | None]
    start: Unknowns
    prior: FloatArray
    free: np.ndarray
    limits: FloatArray
    options: FitOptions

    def compare(self, state: Unknowns, i: int) -> Compared:
        """Residuals of one drive, derivative (k, 3, f) of its predicted motions and (k, f) of its gyro residual.

        Columns are the free ones of ``Unknowns.columns``.
        """
        drive, windows, timing, errors = self.drives[i], self.windows[i], state.timing(i), state.gyro(i)
        cut = steps(drive.wheels, windows, timing)
        motion, jacobian = linearize(state.model, cut)
        seen, by_all = _seen(state.mount, motion, jacobian, bool(self.free[state.p + 1 : state.p + 4].any()))
        p, k = state.p, len(motion)
        mounted = range(p + 2, p + 5) if by_all.shape[2] > p + 2 else [NOTHING] * 3
        source = np.array([*range(p), p + 1, *mounted, p, NOTHING, NOTHING, NOTHING])  # of Unknowns.columns
        free = self.free[state.columns(i)]
        out = np.zeros((k, 3, int(free.sum())))
        known = source[free] != NOTHING
        out[..., known] = by_all[..., source[free][known]]
        turn = np.zeros((k, len(source)))
        turn[:, source != NOTHING] = -by_all[:, 2, source[source != NOTHING]]
        del jacobian, by_all  # as large as the log
        turned, by_gyro = self._gyro(i, timing, errors, turn)
        part = residuals(state.model, windows, cut, seen, turned)
        return part, out, np.ascontiguousarray(by_gyro[:, free])

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
        return self._information(state, self._compared(state), noise, weights)

    def _compared(self, state: Unknowns) -> list[Compared]:
        return [self.compare(state, i) for i in range(len(self.drives))]

    def _information(
        self,
        state: Unknowns,
        compared: list[Compared],
        noise: Noise,
        weights: list[Weights],
        held: list[Residuals] | None = None,
    ) -> tuple[FloatArray, FloatArray, float]:
        rank = np.cumsum(self.free) - 1
        size = int(self.free.sum())
        H, scores, deviance = np.zeros((size, size)), [], 0.0
        for i, (windows, (part, jacobian, by_gyro)) in enumerate(zip(self.windows, compared, strict=True)):
            number, count = _blocks(windows, self.options.block)
            h, s, d = chain.information(
                windows.motion,
                windows.joined,
                part.residual,
                jacobian,
                *(held[i] if held else part).covariances(noise, weights[i]),
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
        """Levenberg-Marquardt for fixed noise and weights; returns the state, how far it moved in sigmas, the steps.

        The covariances are held at those of the start: late poses make them depend on the model, and steps whose
        gradient knows nothing of that would end where the likelihood counts it.
        """
        free, weight = self.free, 1.0 / self.prior[self.free] ** 2
        begin, origin, damping = state.x[free], self.start.x[free], 1e-6
        compared = self._compared(state)
        held = [replace(part, residual=NONE, gyro=NONE, gyro_time=NONE) for part, _, _ in compared]
        H, scores, deviance = self._information(state, compared, noise, weights)
        del compared  # as large as the log
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
            H_new, scores_new, deviance_new = self._information(trial, self._compared(trial), noise, weights, held)
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
        compared = self._compared(state)
        parts = [part for part, _, _ in compared]
        if self.options.noise is None:
            noise = fit_noise(parts, noise, weights, self._restricted(state, compared, weights))
        if self.options.robust:
            weights = reweigh(parts, noise)
            if self.options.noise is None:
                noise = fit_noise(parts, noise, weights, self._restricted(state, compared, weights))
        return noise, weights

    def tempered(self, state: Unknowns, noise: Noise) -> list[Weights]:
        """Weights of ``outliers.temper`` for the residuals at a state."""
        return temper([part for part, _, _ in self._compared(state)], noise)

    def _restricted(
        self, state: Unknowns, compared: list[Compared], weights: list[Weights]
    ) -> Callable[[Noise], float] | None:
        """Restricted deviance: what the parameters took from the residuals is given back to the noise (REML).

        Matters where there are few windows for each parameter; None where there are so many that it does not.
        """
        if sum(map(len, self.windows)) > RESTRICTED:
            return None
        prior = np.diag(1.0 / self.prior[self.free] ** 2)

        def deviance(noise: Noise) -> float:
            H, _, total = self._information(state, compared, noise, weights)
            return total + float(np.linalg.slogdet(H + prior)[1])

        return deviance

    def headed(self, state: Unknowns, noise: Noise, weights: list[Weights]) -> Problem:
        """The same problem with better headings where the reference does not tell them."""
        windows = list(self.windows)
        for i, old in enumerate(self.windows):
            if old.sees == "position":
                part = self.compare(state, i)[0]
                start, end, _ = smoothed(part, noise, weights[i])
                windows[i] = correct_headings(old, *headings_of(part, start, end))
        return replace(self, windows=windows)


NOTHING = -1  # column of a derivative that is zero
NONE = np.zeros(0)


def _seen(mount: Mount, motion: FloatArray, jacobian: FloatArray, free: bool) -> tuple[FloatArray, FloatArray]:
    """Motions and derivatives as the reference's sensor sees them; as they are where it sits at the origin."""
    return seen_by(mount, motion, jacobian) if free or mount != Mount() else (motion, jacobian)


def _blocks(windows: Windows, length: float) -> tuple[np.ndarray, int]:
    """Number (k,) of the stretch of ``length`` [s] that each window begins in, and how many there are."""
    if not len(windows):
        return np.zeros(0, np.int64), 1
    stretch, number = np.unique((windows.start // length).astype(np.int64), return_inverse=True)
    return number, len(stretch)
