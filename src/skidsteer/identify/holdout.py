"""Judging models on what their fit did not see: blocks of time, fitted on one half and judged on the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Drive
from skidsteer.identify.least_squares import Fit, FitOptions, fit_supported
from skidsteer.metrics import WindowErrors, window_errors
from skidsteer.models import Model
from skidsteer.se2 import FloatArray
from skidsteer.windows import increment_windows, pieces

MOST_BLOCKS, LEAST_BLOCKS = 20, 4  # of a drive; even ones are fitted while odd ones are judged, and the other way round
BLOCK = 12.0  # [s] of a block, where that gives a number between the two
SHORTEST_BLOCK = 4.0  # [s]


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutErrors:
    """Errors of one model on held-out windows, the block (k,) that each window lies in, and the fits."""

    errors: WindowErrors
    block: np.ndarray
    folds: Folds


def block_edges(drive: Drive) -> FloatArray:
    """Times (b + 1,) [s] that cut a drive into blocks; segments are kept whole.

    Blocks hold equal shares of the time in which wheels and reference are both there.
    """
    stretches = pieces(drive)
    total = float(np.diff(stretches, axis=1).sum())
    count = int(min(max(total // BLOCK, LEAST_BLOCKS), MOST_BLOCKS, total // SHORTEST_BLOCK))
    if drive.segments is not None:
        count = min(MOST_BLOCKS, len(stretches))
        first = stretches[np.linspace(0, len(stretches), count + 1).astype(int)[1:-1], 0]
    else:
        lasted = np.concatenate([[0.0], np.cumsum(np.diff(stretches, axis=1))])
        wanted = np.linspace(0.0, total, max(count, 1) + 1)[1:-1]
        piece = np.minimum(np.searchsorted(lasted, wanted, side="right") - 1, len(stretches) - 1)
        first = stretches[piece, 0] + wanted - lasted[piece]
    return np.concatenate([[-np.inf], first, [np.inf]])


@dataclass(frozen=True, slots=True, eq=False)
class Folds:
    """Two fits, each to every other block of the drives; ``edges`` (b + 1,) [s] cut each drive into blocks."""

    edges: tuple[FloatArray, ...]
    fits: tuple[Fit, Fit]  # the first has not seen the even blocks, the second not the odd ones

    def block(self, drive: int, t: FloatArray) -> np.ndarray:
        """Number (k,) of the block that each time t (k,) [s] of a drive lies in."""
        return _block(t, self.edges[drive])


def _block(t: FloatArray, edges: FloatArray) -> np.ndarray:
    return np.asarray(np.searchsorted(edges, t, side="right") - 1)


def fold_fits(start: Model, drives: list[Drive], options: FitOptions, spacing: float = 0.0) -> Folds | None:
    """Fit a model to the odd and to the even blocks of drives; None where they are too short to be cut into four.

    Args:
        start: where the fits begin.
        drives: at least one.
        options: of the fits.
        spacing: of the reference poses that are fitted to [s], see ``increment_windows``.
    """
    edges = tuple(block_edges(drive) for drive in drives)
    if sum(len(e) - 1 for e in edges) < 4:
        return None
    increments = [increment_windows(drive, spacing) for drive in drives]
    seen = [[w.where(_block(w.start, e) % 2 != f) for w, e in zip(increments, edges, strict=True)] for f in (0, 1)]
    if not all(any(map(len, train)) for train in seen):
        return None
    without_even, without_odd = (fit_supported(start, drives, train, options) for train in seen)
    return Folds(edges, (without_even, without_odd))


def held_out(
    start: Model, drives: list[Drive], options: FitOptions, length: float = 2.0, spacing: float = 0.0
) -> HeldOutErrors | None:
    """Errors on all judging windows, each predicted by a fit to the blocks it does not lie in.

    Args:
        start: where the fit begins.
        drives: at least one.
        options: of the fit.
        length: of the judging windows [s].
        spacing: of the reference poses that are fitted to [s], see ``increment_windows``.

    Returns:
        None where the drives are too short to be cut into four blocks or more.
    """
    folds = fold_fits(start, drives, options, spacing)
    return None if folds is None else held_out_errors(folds, drives, length)


def held_out_errors(
    folds: Folds, drives: list[Drive], length: float = 2.0, form: Callable[[Model], Model] | None = None
) -> HeldOutErrors:
    """Errors on the judging windows of ``length`` [s], each predicted by the fit that has not seen its block.

    With ``form`` its model is forced into another form first; such a prediction has no covariance.
    """
    errors, blocks = [], []
    for fold, found in enumerate(folds.fits):
        model = found.model if form is None else form(found.model)
        for i, drive in enumerate(drives):
            uncertainty = found.uncertainty(i) if form is None else None
            judged = window_errors(model, drive, found.timings[i], length, found.mount, uncertainty)
            first, last = folds.block(i, judged.start), folds.block(i, np.nextafter(judged.end, -np.inf))
            test = (first % 2 == fold) & (first == last)
            errors.append(judged.where(test))
            blocks.append(1000 * i + first[test])
    return HeldOutErrors(WindowErrors.join(errors), np.concatenate(blocks), folds)
