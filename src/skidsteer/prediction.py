"""How far a predicted motion may be off: parameters, motion noise and reference noise in one covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2
from scipy.stats import f as fisher

from skidsteer import student
from skidsteer.drive import Series
from skidsteer.models import Model
from skidsteer.noise import Noise, paths_of, residuals
from skidsteer.se2 import FloatArray, chain, exp, invert, log
from skidsteer.windows import Timing, Windows, linearize, steps

SUBSTEPS = 10  # of a window, in which the motion noise enters


def motion_covariance(motion: FloatArray, paths: FloatArray, noise: Noise) -> FloatArray:
    """Covariance (k, 3, 3) that the motion noise accumulates over motions, in the body frame at their end.

    Args:
        motion: (k, 3) predicted motions.
        paths: (k, 3) [m] with which the errors of x, y and yaw grow, see ``noise.paths_of``.
        noise: its ``walk`` and ``turn``.
    """
    part = exp(log(motion) / SUBSTEPS)
    F = _transition(part)
    Q = (paths / SUBSTEPS)[:, :, None] * np.diag([noise.walk**2, noise.walk**2, noise.turn**2])
    P = np.zeros((len(motion), 3, 3))
    for _ in range(SUBSTEPS):
        P = F @ P @ np.swapaxes(F, 1, 2) + Q
    return P


def _transition(motion: FloatArray) -> FloatArray:
    """Effect (k, 3, 3) of an error before a motion (k, 3) on the error after it, each in its own body frame."""
    back = invert(motion)
    F = _rotation(-motion[:, 2])
    F[:, 0, 2], F[:, 1, 2] = back[:, 1], -back[:, 0]
    return F


def turn_effect(motion: FloatArray) -> FloatArray:
    """Change (k, 3) of motions (k, 3), in the body frame at their end, per relative error of the yaw rate.

    Exact for a constant twist (u, w): p = int R(w s) u ds is the displacement, and integration by parts of
    w dp/dw = int w s R'(w s) u ds gives R(w) u - p in the frame at the start.
    """
    back = invert(motion)
    return np.column_stack([log(motion)[:, :2] + back[:, :2], motion[:, 2]])


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """By how much a prediction of one drive may be wrong: noise, and the covariance of what was estimated.

    ``covariance`` (p + 2, p + 2) is of the model's parameters, the time offset and the lag, in the order of
    ``windows.linearize``.
    """

    noise: Noise
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Expected poses from a start, and the covariance of each in its own body frame, by source."""

    path: Series  # (n, 3)
    of_parameters: FloatArray  # (n, 3, 3) model and lag: the same error all along
    of_turns: FloatArray  # (n, 3, 3) relative error of turns beyond that: the same all along, too
    of_motion: FloatArray  # (n, 3, 3) motion noise

    @property
    def covariances(self) -> FloatArray:
        """(n, 3, 3) of all three."""
        return self.of_parameters + self.of_turns + self.of_motion


def forecast(
    model: Model, wheels: Series, t: FloatArray, lag: float, uncertainty: Uncertainty, turning: float = 0.0
) -> Forecast:
    """Where a model drives to from the origin, and how far each pose may be off: parameters, lag and motion noise.

    Args:
        model: that predicts.
        wheels: (m, 2) rim speeds [m/s].
        t: (n + 1,) [s] increasing, within those of the wheels; the robot is at the origin at the first.
        lag: [s] with which the body follows the rims.
        uncertainty: its time offset does not matter: times are those of the wheels.
        turning: relative error of its turns, the same all along, see ``Regions``.
    """
    windows = Windows(t[:-1], t[1:], np.zeros((len(t) - 1, 3)), np.ones(len(t) - 1, bool))
    cut = steps(wheels, windows, Timing(0.0, lag))
    motion, jacobian = linearize(model, cut)
    F, Q = _transition(motion), motion_covariance(motion, paths_of(cut), uncertainty.noise)
    by_parameters = _rotation(-motion[:, 2]) @ np.delete(jacobian, -2, axis=2)
    lasting = np.concatenate([by_parameters, turning * turn_effect(motion)[:, :, None]], axis=2)
    known = np.delete(np.delete(uncertainty.covariance, -2, axis=0), -2, axis=1)
    P, J = np.zeros((len(t), 3, 3)), np.zeros((len(t), *lasting.shape[1:]))
    for i in range(len(motion)):
        P[i + 1], J[i + 1] = F[i] @ P[i] @ F[i].T + Q[i], F[i] @ J[i] + lasting[i]
    of_parameters = J[:, :, :-1] @ known @ np.swapaxes(J[:, :, :-1], 1, 2)
    of_turns = J[:, :, -1:] @ np.swapaxes(J[:, :, -1:], 1, 2)
    return Forecast(Series(t, chain(motion), "path"), of_parameters, of_turns, P)


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """How far measured end poses are from predicted ones by their covariance C, and how much of it turns explain.

    With the error e of an end pose and the effect g of a turn that is off (``turn_effect``): all (k,), NaN where the
    reference tells no pose.
    """

    squared: FloatArray  # e^T C^-1 e, chi-square with 3 degrees of freedom if all is Gaussian
    score: FloatArray  # g^T C^-1 e
    information: FloatArray  # g^T C^-1 g

    def told(self) -> Distances:
        """Only those that are known."""
        known = np.isfinite(self.squared)
        return Distances(self.squared[known], self.score[known], self.information[known])

    def allowing(self, turning: float) -> FloatArray:
        """Squared distances (k,) by C + turning^2 g g^T (Sherman and Morrison)."""
        return np.asarray(self.squared - turning**2 * self.score**2 / (1.0 + turning**2 * self.information))


def distances(model: Model, wheels: Series, windows: Windows, timing: Timing, uncertainty: Uncertainty) -> Distances:
    """Distances of measured from predicted end poses, by the covariance of prediction and both reference poses."""
    if windows.sees != "pose" or not len(windows):
        return Distances(*np.full((3, len(windows)), np.nan))
    cut = steps(wheels, windows, timing)
    motion, jacobian = linearize(model, cut)
    part = residuals(model, windows, cut, motion)
    before, after = part.pose_covariances(uncertainty.noise)
    F, turn = _transition(motion), _rotation(-motion[:, 2])
    jacobian = turn @ jacobian
    total = motion_covariance(motion, part.paths, uncertainty.noise) + after + F @ before @ np.swapaxes(F, 1, 2)
    total += jacobian @ uncertainty.covariance @ np.swapaxes(jacobian, 1, 2)
    both = np.stack([(turn @ part.residual[..., None])[..., 0], turn_effect(motion)], axis=2)
    products = np.swapaxes(both, 1, 2) @ np.linalg.solve(total, both)
    return Distances(products[:, 0, 0], products[:, 0, 1], products[:, 1, 1])


def _rotation(yaw: FloatArray) -> FloatArray:
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.zeros((len(yaw), 3, 3))
    R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1], R[:, 2, 2] = c, -s, s, c, 1.0
    return R


@dataclass(frozen=True, slots=True)
class Regions:
    """Regions of the end pose that hold the share they claim: ellipsoids of a Student t, fitted to held-out distances.

    The error of a model at one operating point lasts as long as that does: ``turning`` is the relative error of a turn,
    the same throughout it (standard deviation), beyond what parameters and noise explain. Real errors
    have heavier tails than a Gaussian, too: ``scale`` multiplies the predicted covariance with that of the turn,
    ``dof`` is the number of degrees of freedom (large: Gaussian).
    """

    scale: float
    dof: float
    turning: float = 0.0

    def limit(self, share: float) -> float:
        """Squared distance that a share of end poses lies within."""
        return float(3.0 * self.scale * fisher.ppf(share, 3, self.dof))

    def coverage(self, found: Distances, share: float) -> float:
        """Share of end poses inside the region that claims ``share``; NaN where there are none."""
        squared = found.told().allowing(self.turning)
        return float(np.mean(squared <= self.limit(share))) if len(squared) else float("nan")


LEAST_TOLD = 20  # held-out end poses; from fewer no regions are fitted
SHARES = np.linspace(0.5, 0.95, 10)  # whose quantiles the regions are fitted to
DOFS = np.geomspace(1.0, 100.0, 200)
NO_TURNING, MOST_TURNING = 1e-5, 0.5


def fit_regions(found: Distances) -> Regions | None:
    """Regions whose limits are, by least squares of logarithms, those of held-out distances; None with too few."""
    found = found.told()
    if len(found.squared) < LEAST_TOLD:
        return None
    turning = fit_turning(found)
    quantiles = np.log(np.quantile(found.allowing(turning), SHARES))
    apart = quantiles - np.log(3.0 * fisher.ppf(SHARES, 3, DOFS[:, None]))
    best = int(np.argmin(apart.var(axis=1)))
    return Regions(float(np.exp(apart[best].mean())), float(DOFS[best]), turning)


def fit_turning(found: Distances) -> float:
    """Relative error of turns, the same throughout each of them, by maximum likelihood of a Student t.

    0 where a likelihood-ratio test at 5 % (one-sided) does not call for it.
    """

    def cost(x: FloatArray) -> float:
        scale, dof, turning = np.exp(x)
        wider = float(np.log1p(turning**2 * found.information).sum())
        return student.deviance(found.allowing(turning), scale, dof) + wider

    def best(low: float, high: float, start: float) -> tuple[float, float]:
        limits = np.log([(1e-2, 1e3), (DOFS[0], DOFS[-1]), (low, high)])
        x0 = np.log([1.0, 4.0, start])
        least = minimize(cost, x0, method="L-BFGS-B", bounds=list(zip(*limits.T, strict=True)))
        return float(least.fun), float(np.exp(least.x[2]))

    (without, _), (freed, turning) = best(NO_TURNING, NO_TURNING, NO_TURNING), best(NO_TURNING, MOST_TURNING, 0.03)
    return float(f"{turning:.3g}") if without - freed > chi2.ppf(0.9, 1) else 0.0
