"""Wrong poses, wrong motions and episodes of slip, told apart by the most probable errors of a chain of motions.

Smoothing tells a wrong pose (both motions beside it disagree with the wheels, their sum agrees) from a wrong motion (a
jump of the reference): each is weighed down where it happened. An episode (a spinning side) shows in the sum of its
motions, none of which need be out of the ordinary.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from skidsteer import student
from skidsteer.kernels import chain
from skidsteer.noise import Noise, Residuals, Weights
from skidsteer.se2 import FloatArray
from skidsteer.windows import Windows

OUTLIER = 16.27  # squared distance in three dimensions that one sample in a thousand exceeds
ODD = 11.34  # squared distance in three dimensions that one episode in a hundred exceeds
EPISODE = 2.0  # [s] about what a spinning side or a patch of slippery ground lasts
MANY = 100  # episodes in motion, below which the estimate does not follow those that agree


def smoothed(part: Residuals, noise: Noise, weights: Weights) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Most probable errors (k, 3) of start poses, end poses and motions of one drive, see ``kernels.chain.smooth``."""
    process, noise_start, noise_end = part.covariances(noise, weights)
    known = (part.windows.motion, part.windows.joined, part.residual)
    gyro = (part.gyro, noise.gyro**2 * part.gyro_time)
    start, end, moved = chain.smooth(*known, process, noise_start, noise_end, *gyro)
    return start, end, moved


def reweigh(parts: list[Residuals], noise: Noise) -> list[Weights]:
    """Weights from the most probable errors: 1 for all that the noise explains, falling as 1 / distance^2 beyond."""
    out = []
    for part in parts:
        single = _single(part, noise)
        slip = _Episodes.of(part, noise, single)
        slipped = _kept(slip.squared(np.maximum(slip.usual, 1.0)), ODD)
        out.append(Weights(single.start, single.end, np.minimum(single.motion, slipped[slip.number])))
    return out


def temper(parts: list[Residuals], noise: Noise) -> list[Weights]:
    """Weights by which the estimate follows the many episodes that agree, not the mean of all.

    Of real robots the sums of errors over an episode have tails as heavy as a Student t of two to four degrees of
    freedom: each keeps the weight that this gives it. Where they may be Gaussian, or where there are less than ``MANY``
    (those that agree may then be those without turns), the weights are those of ``reweigh``.
    """
    singles = [_single(part, noise) for part in parts]
    slips = [_Episodes.of(part, noise, single) for part, single in zip(parts, singles, strict=True)]
    squared = [slip.squared(slip.usual) for slip in slips]
    dimensions = [np.full(len(s), float((slip.usual > 0.0).sum())) for s, slip in zip(squared, slips, strict=True)]
    every = np.concatenate(squared)
    moved = every > 0.0
    scale, dof = student.lightest_tails(every[moved], np.concatenate(dimensions)[moved])
    if dof >= student.DOFS[1] or moved.sum() < MANY:
        return reweigh(parts, noise)
    return [
        Weights(w.start, w.end, w.motion * student.weights(s, scale, dof, d)[slip.number])
        for w, slip, s, d in zip(singles, slips, squared, dimensions, strict=True)
    ]


def _single(part: Residuals, noise: Noise) -> Weights:
    """Weights of poses and motions that are wrong each by itself."""
    ones = Weights.ones(len(part.residual))
    process, noise_start, noise_end = part.covariances(noise, ones)
    start, end, moved = smoothed(part, noise, ones)
    distances = (
        np.einsum("ki,kij,kj->k", start, np.linalg.inv(noise_start), start),
        np.einsum("ki,kij,kj->k", end, np.linalg.inv(noise_end), end),
        _shares(moved, process).sum(axis=1),
    )
    return Weights(*(_kept(d, OUTLIER) for d in distances))


@dataclass(frozen=True, slots=True, eq=False)
class _Episodes:
    """Errors of motions, summed over stretches of at most ``EPISODE`` s; chains do not share one."""

    number: np.ndarray  # (k,) of the episode that each window lies in
    shares: FloatArray  # (n, 3) summed errors, squared, over their variance; 0 at rest
    usual: FloatArray  # (3,) the middle one of these over that of a Gaussian: more where errors last

    @classmethod
    def of(cls, part: Residuals, noise: Noise, weights: Weights) -> _Episodes:
        number, moved = _numbered(part.windows), smoothed(part, noise, weights)[2]
        total, variance = (
            np.stack([np.bincount(number, a).astype(float) for a in of.T], axis=1)
            for of in (moved, part.covariances(noise, weights)[0])
        )
        shares = _shares(total, variance)
        usual = [np.median(s[v > 0.0]) if (v > 0.0).any() else 0.0 for s, v in zip(shares.T, variance.T, strict=True)]
        return cls(number, shares, np.array(usual) / chi2.median(1))

    def squared(self, scale: FloatArray) -> FloatArray:
        """Squared distances (n,) from none, where the variances of the three are ``scale`` (3,) times theirs."""
        each = np.divide(self.shares, scale, out=np.zeros_like(self.shares), where=scale > 0.0)
        return np.asarray(each.sum(axis=1))


def _numbered(windows: Windows) -> np.ndarray:
    new = ~windows.joined
    begin = windows.start[new][np.cumsum(new) - 1]
    part = (windows.start - begin) // EPISODE
    return np.asarray(np.cumsum(new | (np.diff(part, prepend=0.0) != 0.0)) - 1)


def _kept(distance: FloatArray, limit: float) -> FloatArray:
    return np.asarray(limit / np.maximum(distance, limit))


def _shares(error: FloatArray, variance: FloatArray) -> FloatArray:
    """error^2 / variance; 0 at rest, where both are 0."""
    return np.divide(error**2, variance, out=np.zeros_like(error), where=variance > 0.0)
