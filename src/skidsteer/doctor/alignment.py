"""How two sensors that see the same motion belong together: which channel, which sign, which scale, which time offset.

The drive is cut into blocks. For each block the mismatch of the two sensors is found at every time offset at once (by
FFT), and its likelihood; the most probable course of the offset along the drive is then a shortest path (Viterbi): it
may stay, slide by a little, or jump at a price. Each hypothesis about channels and signs is judged by its best path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from skidsteer.doctor.signals import Signal, typical
from skidsteer.se2 import FloatArray

MEMORY = 1.0  # [s] samples closer than this are not independent
MODEL_ERROR = 0.1  # share of the typical rate that no model explains
BLOCK = 10.0  # [s] of motion in a block
MOST_BLOCKS = 400
REACH = 30.0  # [s] offsets looked at on both sides of the drive's
SLIDE = 3  # steps of the grid that the offset may drift from block to block
SLIDE_COST = 0.7  # [nat] for each of them
JUMP_COST = 8.0  # [nat]
WORST = -1.5  # [nat] of a block: what does not fit at all (a spinning wheel, a lost reference) counts no more than that
MOST_SCORES = 1_500_000  # blocks times offsets: bounds the memory
NEAR = (-1.0, 1.5)  # [s] offsets taken for granted unless others are far better
FAR_COST = 15.0  # [nat] how much better


@dataclass(frozen=True, slots=True)
class Link:
    """Channel ``a`` of one signal is ``sign`` times a positive scale times channel ``b`` of the other."""

    a: int
    b: int
    sign: int


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """What relates two signals; ``name`` says what that means for the drive."""

    name: str
    links: tuple[Link, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The best time offsets of signal a against signal b under one hypothesis."""

    hypothesis: Hypothesis
    scales: FloatArray  # (links,) signed
    t: FloatArray  # (blocks,) [s] middle of each block on a's clock
    lags: FloatArray  # (k,) [s] a is late by this
    scores: FloatArray  # (blocks, k) [nat] log likelihood against "b tells nothing of a"
    path: NDArray[np.int64]  # (blocks,) indices of the most probable lags
    score: float  # [nat] of the path, what it cost taken off

    def lag(self, t: FloatArray) -> FloatArray:
        """Lags (m,) [s] along the path at times (m,) [s] of a's clock."""
        return np.asarray(np.interp(t, self.t, self.lags[self.path]))


@dataclass(frozen=True, slots=True, eq=False)
class _Products:
    """Sums over blocks at every lag, each (blocks, k): overlap and the three products of two channels."""

    count: FloatArray
    aa: FloatArray
    bb: FloatArray
    ab: FloatArray


def align(a: Signal, b: Signal, hypotheses: tuple[Hypothesis, ...], reach: float = REACH) -> list[Alignment]:
    """Alignments of two signals, one a hypothesis, the best first; empty where they share no time at any offset."""
    pairs = {(link.a, link.b) for h in hypotheses for link in h.links}
    center = _center(a, b, pairs)
    if center is None:
        return []
    size = _block_size(a)
    most = 0.5 * min(MOST_SCORES * size / len(a.values), max(len(a.values), len(b.values)))
    around = int(min(reach / a.step, most))
    lags = np.asarray(center + a.step * np.arange(-around, around + 1))
    products = {pair: _products(a, b, pair, size, center, around) for pair in pairs}
    t = np.asarray(a.start + a.step * size * (np.arange(len(products[next(iter(pairs))].count)) + 0.5))
    found = [_judged(h, t, lags, products, a) for h in hypotheses]
    return sorted(found, key=lambda alignment: -alignment.score)


def _block_size(a: Signal) -> int:
    known = np.isfinite(a.values).any(axis=1).mean()
    size = round(BLOCK / a.step / max(float(known), 0.05))
    return int(np.clip(size, len(a.values) // MOST_BLOCKS + 1, max(len(a.values), 1)))


def _judged(
    hypothesis: Hypothesis, t: FloatArray, lags: FloatArray, products: dict[tuple[int, int], _Products], a: Signal
) -> Alignment:
    best: Alignment | None = None
    for by_regression in (False, True):
        scales, scores = [], np.zeros((len(t), len(lags)))
        for link in hypothesis.links:
            p = products[link.a, link.b]
            scales.append(link.sign * _scale(p, link.sign, by_regression))
            scores += _log_likelihood(p, scales[-1], MODEL_ERROR * typical(a.values[:, link.a]), a.step)
        scores = np.maximum(scores, WORST)
        path, score = most_probable_path(scores)
        if best is None or score > best.score:
            best = Alignment(hypothesis, np.array(scales), t, lags, scores, path, score)
    assert best is not None
    return best


def _scale(p: _Products, sign: int, by_regression: bool) -> float:
    """Ratio of the energies, which needs no lag; or the slope at the best lag, which noise in b does not raise."""
    count, aa, bb, ab = (x.sum(axis=0) for x in (p.count, p.aa, p.bb, sign * p.ab))
    middle = int(np.argmax(count))
    if not (aa[middle] > 0 and bb[middle] > 0):
        return 0.0
    fair = (count > 0.5 * count[middle]) & (aa > 1e-3 * aa[middle]) & (bb > 1e-3 * bb[middle])
    cosine = np.where(fair, ab / np.sqrt(np.where(fair, aa * bb, 1.0)), -1.0)
    best = int(np.argmax(cosine))
    if by_regression and cosine[best] > 0:
        return float(ab[best] / bb[best])
    return float(np.sqrt(aa[middle] / bb[middle]))


def _log_likelihood(p: _Products, scale: float, floor: float, step: float) -> FloatArray:
    """Gain [nat] (blocks, k) of explaining a by scale * b, for Gaussian errors of unknown size above a floor."""
    left = np.maximum(p.aa - 2.0 * scale * p.ab + scale**2 * p.bb, 0.0)
    least = floor**2 * np.maximum(p.count, 1.0)
    ratio = np.divide(left + least, p.aa + least, out=np.ones_like(left), where=p.aa + least > 0)
    return -0.5 * p.count * step / MEMORY * np.log(np.maximum(ratio, 1e-12))


def most_probable_path(scores: FloatArray, slide: int = SLIDE) -> tuple[NDArray[np.int64], float]:
    """The most probable path through scores (blocks, k) by Viterbi, and its score [nat].

    From block to block the path slides by up to ``slide`` columns at ``SLIDE_COST`` each, or jumps at ``JUMP_COST``.

    Returns:
        Index of the column in each block (blocks,), and the sum of the scores on the path less what it cost.
    """
    blocks, k = scores.shape
    origin = np.zeros((blocks, k), dtype=np.int64)
    best = scores[0].copy()
    for i in range(1, blocks):
        top = int(np.argmax(best))
        come, value = np.full(k, top), np.full(k, best[top] - JUMP_COST)
        for shift in range(-slide, slide + 1):
            to = slice(max(shift, 0), k + min(shift, 0))
            since = slice(max(-shift, 0), k + min(-shift, 0))
            offered = best[since] - SLIDE_COST * abs(shift)
            better = offered > value[to]
            value[to][better] = offered[better]
            come[to][better] = np.arange(k)[since][better]
        origin[i], best = come, value + scores[i]
    path = np.empty(blocks, dtype=np.int64)
    path[-1] = int(np.argmax(best))
    for i in range(blocks - 1, 0, -1):
        path[i - 1] = origin[i, path[i]]
    return path, float(best[path[-1]])


def _products(a: Signal, b: Signal, pair: tuple[int, int], size: int, center: float, around: int) -> _Products:
    """Block sums of products of a at t and b at t - lag, for lags center - around ... center + around steps."""
    blocks = max(len(a.values) // size, 1)
    x = a.values[: blocks * size, pair[0]].reshape(blocks, -1)
    first = a.start + a.step * size * np.arange(blocks) - center
    times = first[:, None] + a.step * np.arange(-around, x.shape[1] + around)
    y = b.at(times.ravel())[:, pair[1]].reshape(blocks, -1)
    known_x, known_y = np.isfinite(x), np.isfinite(y)
    x, y = np.where(known_x, x, 0.0), np.where(known_y, y, 0.0)
    n = next_fast_len(y.shape[1], real=True)
    fx, fxx, fx1 = (np.conj(rfft(s, n, axis=1)) for s in (x, x * x, known_x.astype(float)))
    fy, fyy, fy1 = (rfft(s, n, axis=1) for s in (y, y * y, known_y.astype(float)))

    def cross(p: NDArray[np.complex128], q: NDArray[np.complex128]) -> FloatArray:
        return np.asarray(irfft(p * q, n, axis=1)[:, 2 * around :: -1])

    count, aa, bb = (np.maximum(cross(p, q), 0.0) for p, q in ((fx1, fy1), (fxx, fy1), (fx1, fyy)))
    return _Products(count, aa, bb, cross(fx, fy))


def _center(a: Signal, b: Signal, pairs: set[tuple[int, int]]) -> float | None:
    """Time offset [s] of the whole drive around which to look: 0 unless another one explains far more."""
    n = next_fast_len(len(a.values) + len(b.values), real=True)
    left = {i: _Spectra.of(a.values[:, i], n) for i in {i for i, _ in pairs}}
    right = {j: _Spectra.of(b.values[:, j], n) for j in {j for _, j in pairs}}
    explained, seconds = np.zeros(n), np.zeros(n)
    for i, j in pairs:
        seconds = np.maximum(irfft(left[i].known * np.conj(right[j].known), n), 0.0) * a.step
        explained -= 0.5 * seconds / MEMORY * np.log(1.0 - left[i].correlation(right[j], n) ** 2)
    order = np.r_[n - len(b.values) + 1 : n, 0 : len(a.values)]
    lags = a.start - b.start + a.step * np.arange(1 - len(b.values), len(a.values))
    seconds, explained = seconds[order], explained[order]
    enough = seconds > 0.2 * seconds.max(initial=0.0)
    if not enough.any():
        return None
    explained = np.where(enough, explained, -np.inf)
    near = (lags >= NEAR[0]) & (lags <= NEAR[1])
    best = int(np.argmax(explained))
    if near.any() and explained[best] - explained[near].max() < FAR_COST:
        return 0.0
    return float(lags[best])


@dataclass(frozen=True, slots=True, eq=False)
class _Spectra:
    """Fourier transforms of a channel less its mean, of its square, and of where it is known."""

    value: NDArray[np.complex128]
    square: NDArray[np.complex128]
    known: NDArray[np.complex128]
    energy: float  # mean square where known

    @classmethod
    def of(cls, x: FloatArray, n: int) -> _Spectra:
        known = np.isfinite(x)
        x = np.where(known, x, 0.0)
        x = np.where(known, x - x.sum() / max(int(known.sum()), 1), 0.0)
        return cls(rfft(x, n), rfft(x * x, n), rfft(known.astype(float), n), float(x @ x) / max(int(known.sum()), 1))

    def correlation(self, other: _Spectra, n: int) -> FloatArray:
        """Correlation (n,) with another channel at each lag; 0 where one of them does not vary."""
        xy = irfft(self.value * np.conj(other.value), n)
        xx = irfft(self.square * np.conj(other.known), n)
        yy = irfft(self.known * np.conj(other.square), n)
        count = irfft(self.known * np.conj(other.known), n)
        # A channel that hardly varies where the two overlap tells nothing; FFT rounding must not pass for variation.
        varies = (xx > 1e-3 * self.energy * count) & (yy > 1e-3 * other.energy * count) & (count > 0.5)
        found = np.where(varies, xy / np.sqrt(np.where(varies, xx * yy, 1.0)), 0.0)
        return np.clip(found, -0.999, 0.999)
