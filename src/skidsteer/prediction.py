"""How far a predicted motion may be off: parameters, motion noise and reference noise in one covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as fisher

from skidsteer.drive import Series
from skidsteer.models import Model
from skidsteer.noise import Noise, residuals
from skidsteer.se2 import FloatArray, chain, exp, invert, log
from skidsteer.windows import Timing, Windows, linearize, steps

SUBSTEPS = 10  # of a window, in which the motion noise enters


def motion_covariance(motion: FloatArray, rolled: FloatArray, noise: Noise) -> FloatArray:
    """Covariance (k, 3, 3) that the motion noise adds up to over motions, in the body frame at their end.

    Args:
        motion: (k, 3) predicted motions.
        rolled: (k,) [m] mean distance rolled by the rims.
        noise: its ``walk`` and ``turn``.
    """
    part = exp(log(motion) / SUBSTEPS)
    F = _transition(part)
    Q = (rolled / SUBSTEPS)[:, None, None] * np.diag([noise.walk**2, noise.walk**2, noise.turn**2])
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


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """What a prediction of one drive may be wrong by: noise, and the covariance of what was estimated.

    ``covariance`` (p + 2, p + 2) is of the model's parameters, the time offset and the lag, in the order of
    ``windows.linearize``.
    """

    noise: Noise
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Expected poses from a start, and the covariances of each in its own body frame, by what they come from."""

    path: Series  # (n, 3)
    of_parameters: FloatArray  # (n, 3, 3) model and lag: the same error all along
    of_motion: FloatArray  # (n, 3, 3) motion noise

    @property
    def covariances(self) -> FloatArray:
        """(n, 3, 3) of both."""
        return self.of_parameters + self.of_motion


def forecast(model: Model, wheels: Series, t: FloatArray, lag: float, uncertainty: Uncertainty) -> Forecast:
    """Where a model drives to from the origin, and how far each pose may be off: parameters, lag and motion noise.

    Args:
        model: that predicts.
        wheels: (m, 2) rim speeds [m/s].
        t: (n + 1,) [s] increasing, within those of the wheels; the robot is at the origin at the first.
        lag: [s] with which the body follows the rims.
        uncertainty: its time offset does not matter: times are those of the wheels.
    """
    windows = Windows(t[:-1], t[1:], np.zeros((len(t) - 1, 3)), np.ones(len(t) - 1, bool))
    cut = steps(wheels, windows, Timing(0.0, lag))
    motion, jacobian = linearize(model, cut)
    rolled = residuals(model, windows, cut, motion).rolled
    F, Q = _transition(motion), motion_covariance(motion, rolled, uncertainty.noise)
    by_parameters = _rotation(-motion[:, 2]) @ np.delete(jacobian, -2, axis=2)
    known = np.delete(np.delete(uncertainty.covariance, -2, axis=0), -2, axis=1)
    P, J = np.zeros((len(t), 3, 3)), np.zeros((len(t), *by_parameters.shape[1:]))
    for i in range(len(motion)):
        P[i + 1], J[i + 1] = F[i] @ P[i] @ F[i].T + Q[i], F[i] @ J[i] + by_parameters[i]
    return Forecast(Series(t, chain(motion), "path"), J @ known @ np.swapaxes(J, 1, 2), P)


def squared_distances(
    model: Model, wheels: Series, windows: Windows, timing: Timing, uncertainty: Uncertainty
) -> FloatArray:
    """Squared Mahalanobis distance (k,) of measured from predicted end poses; chi-square with 3 if all is Gaussian.

    The covariance is that of the prediction and of both reference poses. NaN where the reference tells no pose.
    """
    if windows.sees != "pose" or not len(windows):
        return np.full(len(windows), np.nan)
    cut = steps(wheels, windows, timing)
    motion, jacobian = linearize(model, cut)
    part = residuals(model, windows, cut, motion)
    before, after = part.pose_covariances(uncertainty.noise)
    F, turn = _transition(motion), _rotation(-motion[:, 2])
    jacobian = turn @ jacobian
    total = motion_covariance(motion, part.rolled, uncertainty.noise) + after + F @ before @ np.swapaxes(F, 1, 2)
    total += jacobian @ uncertainty.covariance @ np.swapaxes(jacobian, 1, 2)
    error = (turn @ part.residual[..., None])[..., 0]
    return np.asarray(np.einsum("ki,ki->k", error, np.linalg.solve(total, error[..., None])[..., 0]))


def _rotation(yaw: FloatArray) -> FloatArray:
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.zeros((len(yaw), 3, 3))
    R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1], R[:, 2, 2] = c, -s, s, c, 1.0
    return R


@dataclass(frozen=True, slots=True)
class Regions:
    """Regions of the end pose that hold the share they claim: ellipsoids of a Student t, fitted to held-out distances.

    Real errors have heavier tails than a Gaussian, and last longer than a random walk: ``scale`` multiplies the
    predicted covariance, ``dof`` is the number of degrees of freedom (large: Gaussian).
    """

    scale: float
    dof: float

    def limit(self, share: float) -> float:
        """Squared distance that a share of end poses lies within."""
        return float(3.0 * self.scale * fisher.ppf(share, 3, self.dof))

    def coverage(self, squared: FloatArray, share: float) -> float:
        """Share of distances (k,) inside the region that claims ``share``; NaN where there are none."""
        told = squared[np.isfinite(squared)]
        return float(np.mean(told <= self.limit(share))) if len(told) else float("nan")


def fit_regions(squared: FloatArray) -> Regions | None:
    """Regions whose 68 % and 95 % limits are those of held-out distances (k,); None with fewer than 20 of them."""
    told = squared[np.isfinite(squared)]
    if len(told) < 20:
        return None
    q68, q95 = np.quantile(told, [0.68, 0.95])
    dofs = np.geomspace(0.5, 1e4, 400)
    ratio = fisher.ppf(0.95, 3, dofs) / fisher.ppf(0.68, 3, dofs)
    dof = float(dofs[int(np.argmin(np.abs(np.log(ratio * q68 / q95))))])
    return Regions(float(q68 / (3.0 * fisher.ppf(0.68, 3, dof))), dof)
