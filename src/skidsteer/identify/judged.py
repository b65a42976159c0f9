"""A fit as drives are judged by it: by a model as free as a constant ICR, whatever simpler one was fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skidsteer.drive import Drive
from skidsteer.gyro import Turn
from skidsteer.identify.least_squares import Fit
from skidsteer.identify.problem import Problem
from skidsteer.identify.start import FitOptions, with_headings
from skidsteer.identify.unknowns import SHARED, Unknowns
from skidsteer.models import Differential, Icr, Model, Multiplier, SymmetricIcr
from skidsteer.se2 import FloatArray
from skidsteer.windows import Windows

DETERMINED = 0.25  # a sigma above this share of what was known before the drive: not determined


def is_determined(found: Fit) -> np.ndarray:
    """Which entries (m,) of a fit are given, or known much better than before the drive.

    What is assumed of a gyro is knowledge, not ignorance.
    """
    assumed = np.array([name.startswith(("gyro_bias", "gyro_scale")) for name in found.names])
    known = np.diag(found.covariance) < (DETERMINED * found.prior_sigma) ** 2
    return np.asarray(assumed | ~found.free | known)


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A fit, or what it would be with a freer model: the state, and the covariance (m, m) of all its entries."""

    problem: Problem
    state: Unknowns
    found: Fit
    names: tuple[str, ...]
    covariance: FloatArray
    determined: np.ndarray  # (m,) bool
    told: np.ndarray  # (m,) bool: worth telling

    @property
    def sigma(self) -> FloatArray:
        """Standard deviation (m,) of each entry."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def named(self, which: np.ndarray) -> dict[str, float]:
        """Sigma of the entries of a mask (m,) that are worth telling."""
        return {self.names[i]: float(self.sigma[i]) for i in np.flatnonzero(which & self.told)}

    @property
    def model(self) -> Model:
        """The model at the estimates."""
        return self.state.model

    @property
    def p(self) -> int:
        """Number of the model's parameters."""
        return self.state.p


def judge(found: Fit, drives: list[Drive], windows: list[Windows], options: FitOptions) -> Judged:
    """The fit's own covariance where its model is free enough, else the information about the freer one.

    A fit that estimates where the reference sits is judged as if that were known: no drive could tell it from the ICRs.
    """
    model = _freer(found, windows)
    own = len(found.model.PARAMETERS)
    state = Unknowns(model, np.concatenate([model.theta, found.values[own:]]), len(drives))
    free = np.concatenate([np.ones(state.p, bool), found.free[own:]])
    if model is found.model:
        free = found.free.copy()
    place = [state.p + SHARED.index(name) for name in ("mount_x", "mount_y")]
    as_found = model is found.model and not free[place].any()
    free[place] = False
    turns = [Turn.of(d.gyro) if d.gyro is not None and options.use_gyro else None for d in drives]
    headed = [with_headings(model, d, w, state, i) for i, (d, w) in enumerate(zip(drives, windows, strict=True))]
    prior, names = state.prior_sigma(drives), state.names(drives)
    problem = Problem(drives, headed, turns, state, prior, free, state.bounds(drives), options)
    covariance = found.covariance if as_found else _covariance(problem, state, found)
    as_fit = replace(
        found, model=model, names=names, values=state.x, covariance=covariance, prior_sigma=prior, free=free
    )
    return Judged(problem, state, found, names, covariance, is_determined(as_fit), as_fit.told)


def _freer(found: Fit, windows: list[Windows]) -> Model:
    """The same motion by a model as free as the reference allows to judge."""
    model = found.model
    if not isinstance(model, Differential | Multiplier | SymmetricIcr):
        return model
    if all(w.sees == "turn" for w in windows):
        return Multiplier(1.0, model.track_width) if isinstance(model, Differential) else model
    A = model.matrix()
    alpha = float(A[0].sum())
    half = alpha / float(A[2, 1] - A[2, 0])
    return Icr(half, -half, 0.0, alpha, alpha)


def _covariance(problem: Problem, state: Unknowns, found: Fit) -> FloatArray:
    H = problem.information(state, found.noise, list(found.weights))[0] / found.inflated
    free, prior = problem.free, problem.prior[problem.free]
    covariance = np.zeros((len(state.x), len(state.x)))
    covariance[np.ix_(free, free)] = np.linalg.inv(H + np.diag(1.0 / prior**2))
    return covariance
