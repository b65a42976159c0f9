"""Which figures determine a model best: experimental design for the worst-known parameter.

The information of a drive about parameters, lag and time offset is the Gauss-Newton matrix that a fit of it ends with
(``identify.problem``). Figures begin and end at rest, so that their information adds up but for the noisy poses that
they share, and so that how long to drive each is a convex problem (Atkinson, Donev, Tobias 2007, ch. 9).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.identify.least_squares import SUPPORTED
from skidsteer.identify.problem import Problem
from skidsteer.identify.start import FitOptions
from skidsteer.identify.unknowns import Unknowns
from skidsteer.models import Model
from skidsteer.noise import Noise, Weights
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Timing, Windows, predict

STEPS = 400  # towards the best mix
POWER = 7.0  # of squared shares in what is least
CAUTION = 0.1  # how fast the weights of the parameters follow their shares
NEGLIGIBLE = 1e-4  # share of the time that is not worth a figure
LEAST = 0.5  # of a figure that is driven at all


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

    def supported_sigmas(self, information: FloatArray) -> dict[str, float]:
        """The same of a fit that keeps only the optional parameters that the drive supports (``fit_supported``).

        Of those that it leaves out: what they would have if all were kept.
        """
        nominal, sigmas, kept = type(self.model).nominal(self.vehicle), self.sigmas(information), list(self.names)
        while True:
            strength = {
                name: abs(getattr(self.model, name) - getattr(nominal, name)) / sigmas[name]
                for name in self.model.OPTIONAL
                if name in kept
            }
            if not strength or min(strength.values()) >= SUPPORTED:
                return sigmas
            kept.remove(min(strength, key=lambda name: strength[name]))
            index = [self.names.index(name) for name in kept]
            covariance = np.linalg.inv((information + np.diag(self.prior))[np.ix_(index, index)])
            sigmas |= dict(zip(kept, np.sqrt(np.diag(covariance)).tolist(), strict=True))

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


TINY = np.finfo(float).tiny


def best_mix(rates: FloatArray, time: float, prior: FloatArray, wanted: FloatArray) -> FloatArray:
    """How long (n,) [s] to drive each of some figures in a time [s] so that the worst share of ``wanted`` is least.

    Least is the sum of the squared shares to the power ``POWER``: nearly the worst one alone, but where that cannot be
    had smaller the others count. It is convex in the times; multiplicative steps along its gradient (Silvey,
    Titterington, Torsney 1978) keep them positive and their sum as it is.

    Args:
        rates: (n, f, f) information a second of each figure.
        time: [s] of all.
        prior: (f,) information before the drive.
        wanted: (f,) sigmas; infinite where none is.
    """
    scale = wanted**-2.0
    times, weights = np.full(len(rates), time / len(rates)), np.where(np.isfinite(wanted), 1.0, 0.0)
    for _ in range(STEPS):
        C = np.linalg.inv(np.tensordot(times, rates, 1) + np.diag(prior))
        gains = np.tensordot(rates, C @ np.diag(weights * scale) @ C, 2)
        times = times * np.sqrt(np.maximum(gains, TINY))  # not below nothing by rounding
        times *= time / times.sum()
        weights = weights ** (1.0 - CAUTION / (POWER - 1.0)) * (np.diag(C) * scale) ** CAUTION
        weights /= weights.max()
    return np.asarray(times)


def choose(
    information: FloatArray, durations: FloatArray, time: float, prior: FloatArray, wanted: FloatArray
) -> dict[int, float]:
    """The best mix of figures each of which is driven at least half: index and how long [s].

    Of what the best mix has less of, the one that is shortest of a half is left out, until there is none.

    Args:
        information: (n, f, f) of each figure.
        durations: (n,) [s] of each, none longer than ``time``.
        time: [s] of all.
        prior: (f,) information before the drive.
        wanted: (f,) sigmas.
    """
    rates, left = information / durations[:, None, None], np.arange(len(durations))
    while True:
        times = best_mix(rates[left], time, prior, wanted)
        used = times > NEGLIGIBLE * time
        parts = np.where(used, times / durations[left], np.inf)
        if parts.min() >= LEAST:
            return dict(zip(left[used].tolist(), (times[used] * time / times[used].sum()).tolist(), strict=True))
        left = np.delete(left, int(np.argmin(parts)))
