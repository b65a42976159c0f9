"""Which figures determine a model best: D-optimal experimental design with the timing marginalised.

The information of a drive about the parameters theta of a model, with lag and time offset tau as nuisance, is the
Schur complement of the Gauss-Newton matrix H that a fit of that drive ends with (``identify.problem``):
log det (H_tt - H_tn H_nn^-1 H_nt) = log det H - log det H_nn, D_s-optimality (Atkinson, Donev, Tobias 2007, 10.3).
Figures begin and end at rest, so that their information adds up but for the noisy poses that they share.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.identify.problem import Problem
from skidsteer.identify.start import FitOptions
from skidsteer.identify.unknowns import Unknowns
from skidsteer.models import Model
from skidsteer.noise import Noise, Weights
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Timing, Windows, predict

EXCHANGES = 200  # at most: each raises the criterion
CLOSEST = 3  # figures tried in the place of another
STRICTNESS = 100.0  # a hundredth of the worst share weighs as much as one of log det


@dataclass(frozen=True, slots=True)
class Setup:
    """The robot, what is expected of it, and what will measure it."""

    vehicle: Vehicle
    model: Model
    noise: Noise
    timing: Timing
    reference_rate: float = 10.0  # [Hz]

    @property
    def names(self) -> tuple[str, ...]:
        """What the rows of an information matrix stand for: the parameters, lag, time offset."""
        return (*(p.name for p in self.model.PARAMETERS), "lag", "time_offset")

    def information(self, rims: Series) -> FloatArray:
        """Gauss-Newton matrix (p + 2, p + 2) that a fit of a drive with these rim speeds would end with; no prior."""
        problem, state = self._problem(rims)
        weights = [Weights.ones(len(w)) for w in problem.windows]
        return problem.information(state, self.noise, weights)[0]

    @property
    def prior(self) -> FloatArray:
        """Information (p + 2,) on the diagonal that a fit takes for known before the drive."""
        at_rest = Series(np.arange(3.0), np.zeros((3, 2)), "wheels")
        problem, _ = self._problem(at_rest)
        return np.asarray(problem.prior[problem.free] ** -2.0)

    def sigmas(self, information: FloatArray) -> dict[str, float]:
        """Standard deviations that a fit would report for that information."""
        covariance = np.linalg.inv(information + np.diag(self.prior))
        return dict(zip(self.names, np.sqrt(np.diag(covariance)).tolist(), strict=True))

    def _problem(self, rims: Series) -> tuple[Problem, Unknowns]:
        """The fit of a noiseless drive with these rim speeds, at its truth."""
        t = np.arange(rims.t[0], rims.t[-1], 1.0 / self.reference_rate) + self.timing.time_offset
        joined = np.arange(len(t) - 1) > 0
        windows = Windows(t[:-1], t[1:], np.zeros((len(t) - 1, 3)), joined)
        motion = predict(self.model, rims, windows, self.timing)
        drive = Drive("designed", self.vehicle, rims)
        nuisance = [self.timing.lag, 0.0, 0.0, 0.0, self.timing.time_offset, 0.0, 0.0, 1.0]
        state = Unknowns(self.model, np.array([*self.model.theta, *nuisance]), 1)
        free = np.array([True] * (state.p + 1) + [False] * 3 + [True] + [False] * 3)
        told = [Windows(windows.start, windows.end, motion, joined)]
        limits, prior = state.bounds([drive]), state.prior_sigma([drive])
        return Problem([drive], told, [None], state, prior, free, limits, FitOptions()), state


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """Figures to choose from, and what a choice of them is worth."""

    information: FloatArray  # (n, f, f) of each figure
    durations: FloatArray  # (n,) [s]
    prior: FloatArray  # (f,) information before the drive
    enough: FloatArray  # (f,) sigmas: nothing should be left worse known than that

    def worth(self, information: FloatArray) -> FloatArray:
        """Criterion (...) of information (..., f, f): log det, less ``STRICTNESS`` times what misses ``enough`` most.

        D-optimality alone gives up a parameter that is dear for others that are cheap. So does the sum of what is
        missing, where two parameters are dear and three are cheap: the worst one alone counts.
        """
        H = information + np.diag(self.prior)
        sigma = np.sqrt(np.diagonal(np.linalg.inv(H), axis1=-2, axis2=-1))
        missing = np.log(np.maximum(sigma / self.enough, 1.0)).max(axis=-1)
        return np.asarray(log_det(H) - STRICTNESS * missing)

    def of(self, chosen: Sequence[int]) -> float:
        """Criterion of figures, each named as often as it is driven."""
        return float(self.worth(self._total(chosen)))

    def choose(self, time: float) -> list[int]:
        """The figures to drive in a time [s], by index: greedy, then exchanges as long as they help (Fedorov 1972).

        One figure makes room for another and for what else then fits; where that does not help, two do.
        """
        chosen = self._filled([], time)
        for _ in range(EXCHANGES):
            found = max((self._exchanged(chosen, time, count) for count in (1, 2)), key=self.of)
            if self.of(found) <= self.of(chosen) + 1e-9:
                break
            chosen = found
        return chosen

    def _total(self, chosen: Sequence[int]) -> FloatArray:
        return np.asarray(self.information[list(chosen)].sum(axis=0))

    def _filled(self, chosen: Sequence[int], time: float) -> list[int]:
        """More figures, as long as one fits, each the one that gains most a second."""
        chosen, left, H = list(chosen), time - float(self.durations[list(chosen)].sum()), self._total(chosen)
        while (fits := self.durations <= left).any():
            gains = np.where(fits, (self.worth(H + self.information) - self.worth(H)) / self.durations, -np.inf)
            i = int(np.argmax(gains))
            chosen.append(i)
            H, left = H + self.information[i], left - float(self.durations[i])
        return chosen

    def _exchanged(self, chosen: list[int], time: float, count: int) -> list[int]:
        """The best that follows when ``count`` figures make room for another, and for what else then fits."""
        options = [chosen]
        for out in set(itertools.combinations(sorted(chosen), count)):
            rest = list(chosen)
            for i in out:
                rest.remove(i)
            fits = self.durations <= time - float(self.durations[rest].sum())
            worth = np.where(fits, self.worth(self._total(rest) + self.information), -np.inf)
            best = [int(i) for i in np.argsort(worth)[-CLOSEST:] if fits[i] and i not in out]
            options += [self._filled([*rest, i], time) for i in best]
        return max(options, key=self.of)


def log_det(information: FloatArray) -> FloatArray:
    """Log det (...) of the information about the parameters in matrices (..., p + 2, p + 2), timing marginalised."""
    whole, nuisance = np.linalg.slogdet(information)[1], np.linalg.slogdet(information[..., -2:, -2:])[1]
    return np.asarray(whole - nuisance)
