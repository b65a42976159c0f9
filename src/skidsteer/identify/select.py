"""Which model a drive supports: the simplest that is not worse than the best on held-out windows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from skidsteer.identify.holdout import HeldOutErrors
from skidsteer.metrics import WindowErrors
from skidsteer.models import MODELS
from skidsteer.se2 import FloatArray

LEVEL = 0.05  # one-sided, for translation and yaw each
NEGLIGIBLE = 0.03  # a share of error not worth further parameters, however significant
MARGIN = 0.2  # an error larger by this share counts as worse even where the drive is too short to prove it


@dataclass(frozen=True, slots=True)
class Excess:
    """Typical error of one model over that of another, and the chance to see so much more if both were equal."""

    share: float  # ratio of the geometric means over windows, less one; negative: smaller
    low: float  # 95 % interval
    high: float
    p_worse: float  # one-sided
    rms: float  # ratio of the root mean squares, less one


@dataclass(frozen=True, slots=True)
class Comparison:
    """One model against the best, on the same held-out windows; None where the drives cannot tell."""

    translation: Excess | None
    yaw: Excess | None  # against the reference, or the gyro where that is all there is

    @property
    def worse(self) -> bool:
        """Worse in translation or in yaw: significantly, or by more than ``MARGIN`` and in the mean square as well."""
        told = (e for e in (self.translation, self.yaw) if e is not None)
        return self.surely_worse or any(e.share > MARGIN and e.rms > 0.0 for e in told)

    @property
    def surely_worse(self) -> bool:
        """Significantly worse in translation or in yaw, by more than ``NEGLIGIBLE``."""
        told = [e for e in (self.translation, self.yaw) if e is not None]
        return any(e.p_worse < LEVEL and e.share > NEGLIGIBLE for e in told)

    @property
    def largest(self) -> float:
        """Excess of the worse of the two, as a share; 0 where the drives cannot tell."""
        return max((e.share for e in (self.translation, self.yaw) if e is not None), default=0.0)

    def __str__(self) -> str:
        pairs = (("translation", self.translation), ("yaw", self.yaw))
        return ", ".join(f"{name} {100 * e.share:+.0f} % (p = {e.p_worse:.2g})" for name, e in pairs if e)


@dataclass(frozen=True, slots=True)
class Selection:
    """The chosen model, the sentence that says why, and each model against the best."""

    name: str
    because: str
    against_best: Mapping[str, Comparison]


def excess(error: FloatArray, other: FloatArray, block: np.ndarray) -> Excess | None:
    """Paired test of errors (k,) against others (k,) of the same windows, by the block (k,) each window lies in.

    Windows inside a block are not independent, blocks nearly are. The logarithm lets a share of error count alike in
    slow and fast windows, and makes outliers harmless.
    """
    told = np.isfinite(error) & np.isfinite(other)
    if not told.any():
        return None
    error, other, block = error[told], other[told], block[told]
    ratio, rms = _log_size(error) - _log_size(other), _ratio_less_one(error, other)
    number = np.unique(block, return_inverse=True)[1]
    count = np.bincount(number).astype(float)
    mean_of_block, share, blocks = np.bincount(number, ratio) / count, count / count.sum(), len(count)
    mean = float(share @ mean_of_block)
    sigma = float(np.sqrt(share**2 @ (mean_of_block - mean) ** 2 * blocks / max(blocks - 1, 1)))
    if sigma == 0.0 or blocks < 2:
        only = float(np.expm1(mean))
        return Excess(only, only, only, 1.0 if mean <= 0.0 else 0.5, rms)
    half = float(student.ppf(0.975, blocks - 1)) * sigma
    low, high = float(np.expm1(mean - half)), float(np.expm1(mean + half))
    return Excess(float(np.expm1(mean)), low, high, float(student.sf(mean / sigma, blocks - 1)), rms)


def _ratio_less_one(error: FloatArray, other: FloatArray) -> float:
    """Of the root mean squares."""
    square = float(other @ other)
    return float(np.sqrt(error @ error / square)) - 1.0 if square > 0.0 else 0.0


def compare_errors(errors: WindowErrors, other: WindowErrors, block: np.ndarray) -> Comparison:
    """Errors against others of the same windows, by the block (k,) that each window lies in."""
    return Comparison(excess(errors.translation, other.translation, block), excess(_yaw(errors), _yaw(other), block))


def select(results: Mapping[str, HeldOutErrors]) -> Selection:
    """Choose among the models of ``results`` (at least one), whose windows must be the same."""
    best = min(results, key=lambda name: _typical(results[name]))
    against = {name: compare_errors(r.errors, results[best].errors, r.block) for name, r in results.items()}
    simple = sorted(results, key=lambda name: len(MODELS[name].PARAMETERS))
    chosen = next(name for name in simple if name == best or not against[name].worse)
    return Selection(chosen, _sentence(chosen, best, against, simple), against)


def _yaw(errors: WindowErrors) -> FloatArray:
    return errors.yaw if np.isfinite(errors.yaw).any() else errors.yaw_gyro


def _log_size(errors: FloatArray) -> FloatArray:
    return np.asarray(np.log(np.maximum(np.abs(errors), np.finfo(float).tiny)))


def _typical(result: HeldOutErrors) -> float:
    """Mean log of translation and yaw errors: the unit of neither matters when models are compared."""
    channels = (result.errors.translation, _yaw(result.errors))
    return float(sum(_log_size(c[np.isfinite(c)]).mean() for c in channels if np.isfinite(c).any()))


def _sentence(chosen: str, best: str, against: Mapping[str, Comparison], simple: list[str]) -> str:
    count = len(MODELS[chosen].PARAMETERS)
    numbered = f"{chosen} ({count} parameter{'' if count == 1 else 's'})"
    rank = simple.index(chosen)
    below = f"; simpler {simple[rank - 1]} errs more: {against[simple[rank - 1]]}" if rank else ""
    if chosen == best:
        return f"{numbered} has the least held-out error of all models{below}"
    return (
        f"{numbered} is the simplest model that does as well on held-out windows as the best, {best}:"
        f" {against[chosen]}{below}"
    )
