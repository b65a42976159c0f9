"""The same tuning for every controller: a cross-entropy search over the logarithms of its gains, with a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from path_following_cases import Case, Gains, Place, cost, scores, with_speed
from path_following_laws import LAWS

SPEEDS = (1.0, 1.5, 2.0)  # [m/s] over which errors are averaged
GENERATIONS, CANDIDATES, ELITE = 10, 10, 3
SPREAD = 0.7  # standard deviation of the logarithm of a gain in the first generation
LEAST = 0.08  # that it keeps
SEED = 7


@dataclass(frozen=True, slots=True)
class Tuned:
    """Best gains found, and what they cost."""

    gains: Gains
    cost: float  # [cm]
    before: float  # [cm] of the gains that the search began with


def costs(law: str, candidates: list[Gains], place: Place) -> list[float]:
    """Mean cost [cm] of each set of gains, one lap at each of ``SPEEDS``, with 0.1 s lag and 60 ms delay."""
    cases = [case for gains in candidates for case in with_speed(Case(law, gains, 1.0, place, laps=1), SPEEDS)]
    each = np.array([cost(found) for found in scores(cases)]).reshape(len(candidates), len(SPEEDS))
    return [float(mean) for mean in each.mean(axis=1)]


def tune(law: str, place: Place) -> Tuned:
    """The best of ``GENERATIONS * CANDIDATES`` sets of gains, the first of which is the one it begins with."""
    rng, begin = np.random.default_rng(SEED), LAWS[law].begin
    names, mean = list(begin), np.log(list(begin.values()))
    spread = np.full(len(names), SPREAD)
    best, least, before = mean, np.inf, np.inf
    for generation in range(GENERATIONS):
        tried = mean + spread * rng.standard_normal((CANDIDATES, len(names)))
        tried[0] = mean if generation == 0 else best  # known: costs nothing
        if generation:
            tried[1] = mean
        found = np.array(costs(law, [_gains(names, row) for row in tried], place))
        before = found[0] if generation == 0 else before
        order = np.argsort(found, kind="stable")
        if found[order[0]] < least:
            best, least = tried[order[0]], found[order[0]]
        elite = tried[order[:ELITE]]
        mean = elite.mean(axis=0)
        spread = np.maximum(0.5 * spread + 0.5 * np.sqrt(((elite - mean) ** 2).mean(axis=0)), LEAST)
    return Tuned(_gains(names, best), float(least), float(before))


def _gains(names: list[str], logs: np.ndarray) -> Gains:
    return tuple((name, float(f"{np.exp(value):.4g}")) for name, value in zip(names, logs, strict=True))
