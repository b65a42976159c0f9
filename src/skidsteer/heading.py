"""Headings for a reference that tells positions only: a first guess from the shape of the path, then a smoother's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skidsteer.noise import Residuals
from skidsteer.se2 import FloatArray, chain, rotate, wrap
from skidsteer.windows import Windows

REACH = 1.5  # [m] of path on either side by which a heading is guessed


def guess_headings(windows: Windows, predicted: FloatArray) -> Windows:
    """Turn motions along the axes of the reference into motions seen from the body.

    Around each position the predicted path is laid over the measured one by the best rotation; the predicted yaw turned
    by it is the heading.

    Args:
        windows: with ``sees == "position"`` and motions (k, 3) whose yaw is zero, as ``increment_windows`` gives them.
        predicted: (k, 3) motions that a model predicts.
    """
    motion = windows.motion.copy()
    starts = np.flatnonzero(~windows.joined)
    for first, last in zip(starts, np.r_[starts[1:], len(windows)], strict=True):
        part = slice(first, last)
        path = chain(predicted[part])
        measured = np.concatenate([np.zeros((1, 2)), np.cumsum(windows.motion[part, :2], axis=0)])
        heading = path[:, 2] + _turns(path[:, :2] @ [1.0, 1j], measured @ [1.0, 1j])
        motion[part, :2] = rotate(-heading[:-1], windows.motion[part, :2])
        motion[part, 2] = wrap(np.diff(heading))
    return replace(windows, motion=motion)


def _turns(path: np.ndarray, measured: np.ndarray) -> FloatArray:
    """Rotation (n,) [rad] that lays path (n,) best over measured (n,), both complex [m], around each sample."""
    rolled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path)))])
    low = np.searchsorted(rolled, rolled - REACH)
    high = np.searchsorted(rolled, rolled + REACH, side="right")
    count = (high - low).astype(float)

    def total(values: np.ndarray) -> np.ndarray:
        sums = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(sums[high] - sums[low])

    moment = total(np.conj(path) * measured) - np.conj(total(path)) * total(measured) / count
    return np.asarray(np.unwrap(np.angle(moment)))


def correct_headings(windows: Windows, start_error: FloatArray, end_error: FloatArray) -> Windows:
    """Take smoothed heading errors (k,) [rad] at both ends of each window off its motion."""
    motion = windows.motion.copy()
    motion[:, :2] = rotate(start_error, motion[:, :2])
    motion[:, 2] = wrap(motion[:, 2] - end_error + start_error)
    return replace(windows, motion=motion)


def headings_of(part: Residuals, start: FloatArray, end: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Heading errors (k,) at start and end of each window from the smoothed pose errors (k, 3) of ``kernels.chain``."""
    before = np.concatenate([[0.0], end[:-1, 2]])
    return np.where(part.windows.joined, before, start[:, 2]), end[:, 2]
