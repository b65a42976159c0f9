"""Which model a drive supports: the simplest that is not significantly worse than the best on held-out windows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from skidsteer.identify.holdout import HeldOutErrors
from skidsteer.models import MODELS
from skidsteer.se2 import FloatArray

LEVEL = 0.05  # one-sided: worse only if chance would make it look so in fewer than one case in twenty


@dataclass(frozen=True, slots=True)
class Comparison:
    """Typical held-out error of one model over that of another, and the chance to see so much if both were equal."""

    excess: float  # share by which the error is larger (geometric mean over windows); negative: smaller
    low: float  # 95 % interval of the excess
    high: float
    p_worse: float  # one-sided


@dataclass(frozen=True, slots=True)
class Selection:
    """The chosen model, the sentence that says why, and each model against the best."""

    name: str
    because: str
    against_best: Mapping[str, Comparison]


def scores(results: Mapping[str, HeldOutErrors]) -> dict[str, FloatArray]:
    """Logarithm (k,) of one error a window: translation and yaw together, each in units of its median.

    The logarithm makes a model's share of error count alike in slow and fast windows, and outliers harmless.
    """
    t_unit = float(np.median([np.median(r.errors.translation) for r in results.values()]))
    y_unit = float(np.median([np.median(np.abs(r.errors.yaw)) for r in results.values()]))
    return {name: np.log(np.hypot(r.errors.translation / t_unit, r.errors.yaw / y_unit)) for name, r in results.items()}


def compare(score: FloatArray, best: FloatArray, block: np.ndarray) -> Comparison:
    """Paired test over blocks: windows inside a block are not independent, blocks nearly are.

    Args:
        score: (k,) log errors of a model.
        best: (k,) log errors of the other on the same windows.
        block: (k,) which block a window lies in.
    """
    number = np.unique(block, return_inverse=True)[1]
    weight = np.bincount(number).astype(float)
    difference = np.bincount(number, score - best) / weight
    share = weight / weight.sum()
    mean, count = float(share @ difference), len(weight)
    variance = float(share**2 @ (difference - mean) ** 2) * count / max(count - 1, 1)
    if variance == 0.0 or count < 2:
        return Comparison(*[float(np.expm1(mean))] * 3, 1.0 if mean <= 0 else 0.5)
    sigma = float(np.sqrt(variance))
    half = float(student.ppf(0.975, count - 1)) * sigma
    p = float(student.sf(mean / sigma, count - 1))
    return Comparison(*(float(np.expm1(m)) for m in (mean, mean - half, mean + half)), p)


def select(results: Mapping[str, HeldOutErrors]) -> Selection:
    """Choose among the models of ``results`` (at least one), whose windows must be the same."""
    score = scores(results)
    best = min(score, key=lambda name: float(np.mean(score[name])))
    block = results[best].block
    against = {name: compare(s, score[best], block) for name, s in score.items()}
    simple = sorted(score, key=lambda name: len(MODELS[name].PARAMETERS))
    chosen = next(name for name in simple if name == best or against[name].p_worse > LEVEL)
    return Selection(chosen, _sentence(chosen, best, against, simple), against)


def _sentence(chosen: str, best: str, against: Mapping[str, Comparison], simple: list[str]) -> str:
    count = len(MODELS[chosen].PARAMETERS)
    rank = simple.index(chosen)
    below = ""
    if rank:
        c = against[simple[rank - 1]]
        below = f"; the next simpler, {simple[rank - 1]}, errs {100 * c.excess:.0f} % more (p = {c.p_worse:.2g})"
    if chosen == best:
        return f"{chosen} ({count} parameters) has the least held-out error of all models{below}"
    c = against[chosen]
    return (
        f"{chosen} ({count} parameters) is the simplest model that is not significantly worse on held-out windows than"
        f" the best, {best}: {100 * c.excess:+.0f} % (95 % interval {100 * c.low:+.0f} to {100 * c.high:+.0f} %,"
        f" p = {c.p_worse:.2g}){below}"
    )
