"""How wrong references and motion predictions are: six standard deviations, found by maximum likelihood."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass, fields

import numpy as np
from scipy.optimize import minimize

from skidsteer.drive import Series
from skidsteer.kernels import chain, roll
from skidsteer.models import Model
from skidsteer.se2 import FloatArray, wrap
from skidsteer.windows import Sees, Steps, Windows


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations. The reference errs anew at each pose; the motion's error grows with the distance rolled.

    ``stamp`` is the scatter of the reference's time stamps: at speed it moves a pose along its own path.
    The distance rolled is the mean of what the two rims rolled, so that a turn on the spot counts. The error of the yaw
    grows with half the difference of what they rolled, and with a tenth of the distance rolled straight on. (On eight
    real drives, docs/yaw-noise.md, that is far likelier than all of that distance; less is often likelier still, but a
    tenth leaves room for what makes a straight path bend.)
    """

    position: float = 0.02  # [m] of a reference position, each axis
    yaw: float = 0.01  # [rad] of a reference yaw
    stamp: float = 0.02  # [s]
    walk: float = 0.05  # [m / sqrt(m)] of the position, each axis, after a metre rolled
    turn: float = 0.05  # [rad / sqrt(m)] of the yaw, after each rim rolled a metre, one ahead, one back
    gyro: float = 0.01  # [rad / sqrt(s)] of a gyro's turn, after a second

    def __post_init__(self) -> None:
        for f in fields(self):
            if not getattr(self, f.name) > 0.0:
                raise ValueError(f"noise {f.name} must be positive, got {getattr(self, f.name)}")


BOUNDS = Noise(1e-5, 1e-5, 1e-4, 1e-4, 1e-4, 1e-4), Noise(1.0, 1.0, 0.5, 1.0, 2.0, 0.5)


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Weights (k,) in (0, 1] left to outliers: the pose a window starts with, the one it ends with, its motion."""

    start: FloatArray
    end: FloatArray
    motion: FloatArray

    @classmethod
    def ones(cls, count: int) -> Weights:
        """Nothing is an outlier."""
        return cls(np.ones(count), np.ones(count), np.ones(count))


yaw_path = roll.yaw_path  # [m] for the distances that both sides rolled

AT_REST = 1e-9  # [m] rolled: no motion, but the decaying rest of a lag


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Measured less predicted motions of one drive, and what their covariance depends on."""

    windows: Windows
    residual: FloatArray  # (k, 3) in the frame of the start pose, yaw wrapped
    paths: FloatArray  # (k, 3) [m] with which the errors of x, y and yaw grow, see ``paths_of``
    start_twist: FloatArray  # (k, 3) body twist at the start
    end_twist: FloatArray  # (k, 3) body twist at the end
    gyro: FloatArray  # (k,) [rad] turn of the gyro less the predicted one; 0 where there is none
    gyro_time: FloatArray  # (k,) [s] that the gyro integrated; infinite where there is no turn of it

    def pose_covariances(self, noise: Noise) -> tuple[FloatArray, FloatArray]:
        """Covariance (k, 3, 3) of the reference's pose at the start and at the end, each in its body frame."""
        sees = self.windows.sees
        return _pose_covariance(noise, self.start_twist, sees), _pose_covariance(noise, self.end_twist, sees)

    def covariances(self, noise: Noise, weights: Weights) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Variance of the motion (k, 3), covariance of start and end pose (k, 3, 3), for ``kernels.chain``."""
        growth = np.array([noise.walk**2, noise.walk**2, noise.turn**2])
        process = self.paths * growth / weights.motion[:, None]
        start, end = self.pose_covariances(noise)
        return process, start / weights.start[:, None, None], end / weights.end[:, None, None]


def paths_of(cut: Steps) -> FloatArray:
    """Distances (k, 3) [m] in windows with which the motion's errors of x, y and yaw grow; zero at rest."""
    path = roll.paths(cut.distance, cut.offsets)
    return np.where(path[:, :1] > AT_REST, path, 0.0)[:, [0, 0, 1]]


def paths_between(rims: Series, t: FloatArray) -> FloatArray:
    """Distances (n - 1, 3) [m] as in ``paths_of``, between times (n,) [s], of held rim speeds (m, 2) [m/s]."""
    held = rims.values[:-1] * np.diff(rims.t)[:, None]
    grown = np.cumsum(roll.paths(held, np.arange(len(held) + 1)), axis=0)
    position, yaw = (np.diff(np.interp(t, rims.t, np.r_[0.0, column])) for column in grown.T)
    return np.stack([position, position, yaw], axis=1)


def residuals(
    model: Model, windows: Windows, cut: Steps, predicted: FloatArray, turned: FloatArray | None = None
) -> Residuals:
    """Compare predicted motions with measured ones.

    Args:
        model: for the twists at both ends.
        windows: with the measured motions.
        cut: their wheel samples.
        predicted: (k, 3) motion of the reference's sensor that the model predicts.
        turned: (k,) turn measured by a gyro; NaN where there is none.
    """
    residual = windows.motion - predicted
    residual[:, 2] = wrap(residual[:, 2])
    first, last = (model.twist(s[:, 0], s[:, 1]) for s in (cut.start_speeds, cut.end_speeds))
    gyro = np.full(len(windows), np.nan) if turned is None else turned - predicted[:, 2]
    speaks = np.isfinite(gyro)
    gyro_time = np.where(speaks, windows.end - windows.start, np.inf)
    return Residuals(windows, residual, paths_of(cut), first, last, np.where(speaks, gyro, 0.0), gyro_time)


BLIND = (1e3, 10.0)  # [m], [rad]: sigma of what a reference does not tell


def _pose_covariance(noise: Noise, twist: FloatArray, sees: Sees) -> FloatArray:
    position = BLIND[0] if sees == "turn" else noise.position
    yaw = noise.yaw if sees == "pose" else BLIND[1]
    fixed = np.diag([position**2, position**2, yaw**2])
    return fixed + noise.stamp**2 * twist[:, :, None] * twist[:, None, :]


def deviance(parts: list[Residuals], noise: Noise, weights: list[Weights]) -> float:
    """-2 log likelihood of the residuals, less its constant."""
    total = 0.0
    for part, weight in zip(parts, weights, strict=True):
        count = len(part.residual)
        block = np.zeros(count, np.int64)
        total += chain.information(
            part.windows.motion,
            part.windows.joined,
            part.residual,
            np.zeros((count, 3, 0)),
            *part.covariances(noise, weight),
            part.gyro,
            np.zeros((count, 0)),
            noise.gyro**2 * part.gyro_time,
            block,
            1,
        )[2]
    return total


def fit_noise(
    parts: list[Residuals],
    start: Noise,
    weights: list[Weights],
    restricted: Callable[[Noise], float] | None = None,
    most: int = 2500,
) -> Noise:
    """Maximum-likelihood noise for given residuals, kept off zero.

    A short drive may be likeliest without any motion noise, which is not credible: a prior that grows with ``walk`` and
    ``turn`` (Chung et al. 2013, gamma of shape 2) rules that out and hardly moves what the drive determines well.

    Args:
        parts: residuals of each drive.
        start: where the search begins.
        weights: of the outliers of each drive.
        restricted: what to minimise instead of the plain ``deviance``.
        most: number of windows, from the middle of each drive, that the plain deviance is summed over.
    """
    some, light = zip(*(_middle(p, w, most) for p, w in zip(parts, weights, strict=True)), strict=True)
    low, high = (np.log(astuple(b)) for b in BOUNDS)

    def cost(x: FloatArray) -> float:
        noise = Noise(*np.exp(x).tolist())
        told = deviance(list(some), noise, list(light)) if restricted is None else restricted(noise)
        return told - 2.0 * math.log(noise.walk * noise.turn)

    x0 = np.clip(np.log(astuple(start)), low, high)
    bounds = list(zip(low, high, strict=True))
    found = minimize(cost, x0, method="L-BFGS-B", bounds=bounds, options={"eps": 1e-4, "ftol": 1e-6})
    best = np.exp(found.x if found.fun < cost(x0) else x0)
    return Noise(*(float(f"{value:.3g}") for value in best))  # rounding in the log must not move the estimates


def _middle(part: Residuals, weights: Weights, most: int) -> tuple[Residuals, Weights]:
    count = len(part.residual)
    if count <= most:
        return part, weights
    first = (count - most) // 2
    keep = np.zeros(count, bool)
    keep[first : first + most] = True
    arrays = (part.residual, part.paths, part.start_twist, part.end_twist, part.gyro, part.gyro_time)
    kept = Residuals(part.windows.where(keep), *(a[keep] for a in arrays))
    return kept, Weights(weights.start[keep], weights.end[keep], weights.motion[keep])
