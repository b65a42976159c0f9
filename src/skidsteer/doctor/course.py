"""How the time offset of two sensors runs along the drive: constant, a steady drift, or steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skidsteer.doctor.alignment import MEMORY, MODEL_ERROR, Alignment, most_probable_path
from skidsteer.doctor.evidence import CLEAR, Pair
from skidsteer.doctor.signals import BoolArray, typical
from skidsteer.se2 import FloatArray

CREDIBLE = (-0.6, 1.0)  # [s] offsets that delays of sensors and drives explain
WANDER = 0.3  # [s] by which the delay of a sensor varies for reasons of its own, up and down
WANDER_COST = 4.0  # [nat/s]
LEAST = 0.8  # [s] smaller drifts and jumps are taken for varying delays
FASTEST_DRIFT = 0.05  # share by which a clock may run fast
DRIFT_COST = 4.0  # [nat]
SEEN_PAUSE = 12.0  # [nat] for a jump ahead whose pause is in the stamps
SEVERAL = 12.0  # [nat] for a drift where there would be several jumps the same way
SURE = 3.0  # [nat] a moment of a jump that is less likely than the best by that is left out
WORST_MOMENT = 0.2  # [nat] no single moment counts for more


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened to the offset of two clocks; the first of them is late by ``amount`` [s], or [s/s]."""

    kind: str
    start: float  # [s] on the clock of the first
    end: float
    amount: float
    gain: float  # [nat] over not assuming it
    lags: tuple[float, float] = (0.0, 0.0)  # [s] at start and end
    paused: bool = False  # a pause of that length is in the stamps


def events_of(pair: Pair, t_a: FloatArray, t_b: FloatArray, unfold: Callable[[float], float]) -> list[Event]:
    """Offset, drift and jumps of a pair: the simplest course that explains it.

    Args:
        pair: two sensors, aligned.
        t_a: (n,) stamps of the first [s].
        t_b: (m,) stamps of the second.
        unfold: recorded times of folded ones.
    """
    alignment = pair.best
    scores = tolerant(alignment)
    constant = scores.sum(axis=0)
    drift, begin, lined = _line(alignment, scores)
    path, stepped = most_probable_path(scores, slide=0)
    steps = [_with_pause(step, t_a, t_b) for step in _steps(pair, scores, path)]
    same_way = len(steps) > 1 and len({step.amount > 0.0 for step in steps}) == 1
    stepped += SEEN_PAUSE * sum(step.paused for step in steps) - SEVERAL * same_way
    t, span = alignment.t, float(alignment.t[-1] - alignment.t[0])
    level, events = float(alignment.lags[np.argmax(constant)]), []
    if lined - constant.max() > CLEAR and abs(drift) > LEAST and lined - DRIFT_COST >= stepped:
        lags = begin, begin + drift
        events = [Event("clock_drift", float(t[0]), float(t[-1]), drift / span, float(lined - constant.max()), lags)]
        level, scores = begin, _sheared(alignment, scores, drift)
    elif steps:
        events, level = [_unfolded(step, unfold) for step in steps], steps[0].lags[0]
        scores = scores[t < 0.5 * (steps[0].start + steps[0].end)]
    return [*_offset(alignment, scores, level, unfold), *events]


def tolerant(alignment: Alignment) -> FloatArray:
    """Scores (blocks, k) that allow the delay of each block to differ a little from the lag."""
    step, best = _step(alignment), alignment.scores.copy()
    for shift in range(1, min(round(WANDER / step), best.shape[1] - 1) + 1):
        cost = WANDER_COST * shift * step
        best[:, shift:] = np.maximum(best[:, shift:], alignment.scores[:, :-shift] - cost)
        best[:, :-shift] = np.maximum(best[:, :-shift], alignment.scores[:, shift:] - cost)
    return best


def _step(alignment: Alignment) -> float:
    return float(alignment.lags[1] - alignment.lags[0]) if len(alignment.lags) > 1 else 1.0


def _true_lag(t: float, lag: float, unfold: Callable[[float], float]) -> float:
    return unfold(t) - unfold(t - lag)


def _unfolded(step: Event, unfold: Callable[[float], float]) -> Event:
    old, new = (_true_lag(t, lag, unfold) for t, lag in zip((step.start, step.end), step.lags, strict=True))
    return Event(step.kind, step.start, step.end, new - old, step.gain, step.lags, step.paused)


def _offset(alignment: Alignment, scores: FloatArray, level: float, unfold: Callable[[float], float]) -> list[Event]:
    total = scores.sum(axis=0)
    usual = max(float(total[_credible(alignment)].max(initial=-np.inf)), 0.0)
    gain = float(total.max()) - usual
    if CREDIBLE[0] <= level <= CREDIBLE[1] or gain < CLEAR:
        return []
    best = alignment.t[np.argmax(scores[:, np.argmax(total)])]
    amount = _true_lag(float(best), level, unfold)
    return [Event("clock_offset", float(alignment.t[0]), float(alignment.t[-1]), amount, gain, (level, level))]


def _line(alignment: Alignment, scores: FloatArray) -> tuple[float, float, float]:
    """The best steady drift: over the drive [s], the lag at its start [s], and its score [nat].

    A line that starts at a credible lag is taken unless another one is clearly better.
    """
    span, step = alignment.t[-1] - alignment.t[0], _step(alignment)
    # A drift shows in the most probable path, too; so only drifts of its size need to be tried.
    most = min(FASTEST_DRIFT * span, 2.0 * LEAST + 1.5 * np.ptp(alignment.lags[alignment.path]))
    drifts = 2.0 * step * np.arange(-int(0.5 * most / step), int(0.5 * most / step) + 1)
    totals = np.stack([_sheared(alignment, scores, drift).sum(axis=0) for drift in drifts])
    usual = np.where(_credible(alignment), totals, -np.inf)
    chosen = usual if usual.max() > totals.max() - CLEAR else totals
    i, j = np.unravel_index(int(np.argmax(chosen)), chosen.shape)
    return float(drifts[i]), float(alignment.lags[j]), float(chosen[i, j])


def _credible(alignment: Alignment) -> BoolArray:
    return np.asarray((alignment.lags >= CREDIBLE[0]) & (alignment.lags <= CREDIBLE[1]))


def _sheared(alignment: Alignment, scores: FloatArray, drift: float) -> FloatArray:
    """Scores (blocks, k) of lags that grow by a drift [s] over the drive, by the lag at its start; 0 outside."""
    t, k = alignment.t, scores.shape[1]
    share = (t - t[0]) / max(t[-1] - t[0], 1e-9)
    column = np.arange(k) + np.round(drift * share / _step(alignment)).astype(np.int64)[:, None]
    inside = (column >= 0) & (column < k)
    return np.where(inside, np.take_along_axis(scores, np.clip(column, 0, k - 1), axis=1), 0.0)


def _steps(pair: Pair, scores: FloatArray, path: NDArray[np.int64]) -> list[Event]:
    """Jumps of a path that are large and that both sides support."""
    alignment = pair.best
    bounds = [0, *(np.flatnonzero(np.diff(path)) + 1).tolist(), len(path)]
    events = []
    for before, edge, after in zip(bounds[:-2], bounds[1:-1], bounds[2:], strict=True):
        old, new = path[edge - 1], path[edge]
        lost = (scores[before:edge, old] - scores[before:edge, new]).sum()
        won = (scores[edge:after, new] - scores[edge:after, old]).sum()
        lags = float(alignment.lags[old]), float(alignment.lags[new])
        if abs(lags[1] - lags[0]) < LEAST or min(lost, won) < CLEAR:
            continue
        start, end = _moment(pair, lags, (float(alignment.t[before]), float(alignment.t[after - 1])))
        events.append(Event("clock_jump", start, end, lags[1] - lags[0], float(min(lost, won)), lags))
    return events


def _moment(pair: Pair, lags: tuple[float, float], span: tuple[float, float]) -> tuple[float, float]:
    """Between which times the lag changed [s]: where the likelihood of the split stays near its best."""
    t = pair.a.t
    t = t[(t >= span[0]) & (t <= span[1])]
    gained = np.cumsum(_fit(pair, t, lags[0]) - _fit(pair, t, lags[1]))
    best = int(np.argmax(gained))
    unlikely = np.flatnonzero(gained < gained[best] - SURE)
    first = unlikely[unlikely < best].max(initial=-1) + 1
    last = unlikely[unlikely > best].min(initial=len(t) - 1)
    return float(t[first]), float(t[last])


def _fit(pair: Pair, t: FloatArray, lag: float) -> FloatArray:
    """Log likelihood [nat] (n,) of each moment at a lag, against "b tells nothing of a"; 0 where one is unknown."""
    total = np.zeros(len(t))
    a, b = pair.a.at(t), pair.b.at(t - lag)
    for link, scale in zip(pair.best.hypothesis.links, pair.best.scales, strict=True):
        floor = (MODEL_ERROR * typical(pair.a.values[:, link.a])) ** 2
        if floor > 0.0:
            x, y = a[:, link.a], scale * b[:, link.b]
            total += np.nan_to_num(np.log((x**2 + floor) / ((x - y) ** 2 + floor)))
    return np.clip(0.5 * pair.a.step / MEMORY * total, -WORST_MOMENT, WORST_MOMENT)


def _with_pause(step: Event, t_a: FloatArray, t_b: FloatArray) -> Event:
    """The jump at the pause that the clock which was set forward left in its stamps, if there is one of its length."""
    size, ahead = abs(step.amount), step.amount > 0.0
    stamps, late = (t_a, 0.0) if ahead else (t_b, step.lags[0])
    low, high = step.start - late - size, step.end - late + size
    dt = np.diff(stamps)
    here = (stamps[:-1] >= low) & (stamps[1:] <= high + size) & (np.abs(dt - size) < max(0.5, 0.1 * size))
    if not here.any():
        return step
    pause = int(np.flatnonzero(here)[np.argmin(np.abs(dt[here] - size))])
    start = float(stamps[pause]) + late
    end = start + dt[pause] if ahead else start
    return Event(step.kind, start, float(end), step.amount, step.gain, step.lags, True)
