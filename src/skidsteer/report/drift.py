"""Errors of dead reckoning after 10 m and after a full turn, from all stretches of that length in the drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skidsteer.metrics import aligned_rms
from skidsteer.report.tracks import DriveTracks, motion_between
from skidsteer.se2 import FloatArray, wrap

DISTANCES = (10.0, 5.0, 2.0, 1.0, 0.5)  # [m]; the longest with ``ENOUGH`` stretches is taken
TURNS = (360.0, 180.0, 90.0, 45.0)  # [deg]
ENOUGH = 3.0  # independent stretches


@dataclass(frozen=True, slots=True)
class Drift:
    """Median error of each model after ``whole`` metres or degrees, scaled from stretches of ``length``."""

    errors: Mapping[str, float]  # [m] or [deg]
    whole: float
    length: float
    stretches: float  # independent ones
    is_fitted: bool = False  # RMS distances along rigidly fitted stretches; nothing is scaled


def drift_per_10_m(tracks: Sequence[DriveTracks]) -> Drift | None:
    """Median error [m] of the end position after 10 m; None where the drives are too short.

    Every pose begins a stretch, which ends when the calibrated model has moved that far: overlapping stretches use all
    of the drive. Where there are too few of 10 m, shorter ones are scaled up. Where no reference has headings,
    consecutive stretches are rigidly fitted to the reference, and the result is the median of their RMS distances.
    """
    posed = [track for track in tracks if track.sees == "pose"]
    placed = [track for track in tracks if track.sees == "position"]
    for length in DISTANCES:
        found = [_position_errors(track, length) for track in posed] or [_fitted_errors(t, length) for t in placed]
        count = sum(number for _, number in found)
        if count >= ENOUGH:
            whole = DISTANCES[0] if posed else length
            return _drift([errors for errors, _ in found], whole, length, count, is_fitted=not posed)
    return None


def _position_errors(track: DriveTracks, length: float) -> tuple[dict[str, FloatArray], float]:
    """Errors (k,) [m] of each model over stretches of a track, and the number of independent ones."""
    i, end, count = _stretches(track, length)
    true = motion_between(track.poses["reference"], i, end[i])
    errors = {}
    for name in _models(track):
        error = motion_between(track.poses[name], i, end[i])[:, :2] - true[:, :2]
        errors[name] = np.hypot(error[:, 0], error[:, 1])
    return errors, count


def _stretches(track: DriveTracks, length: float) -> tuple[np.ndarray, np.ndarray, float]:
    """First index (k,) of each stretch, the index (n,) where one from each pose ends, and how many are independent."""
    here = track.poses["calibrated"][:, :2]
    step = np.hypot(*np.diff(here, axis=0, prepend=here[:1]).T)
    step[np.diff(track.piece, prepend=-1) != 0] = 0.0
    end = _ends(np.cumsum(step), length)
    i = np.flatnonzero(end < len(track))
    i = i[track.piece[end[i]] == track.piece[i]]
    lengths = np.bincount(track.piece, step)
    return i, end, float(np.floor(lengths / length).sum()) if len(i) else 0.0


def _fitted_errors(track: DriveTracks, length: float) -> tuple[dict[str, FloatArray], float]:
    """RMS distances (k,) [m] of each model along consecutive stretches, each rigidly fitted."""
    begins, end, _ = _stretches(track, length)
    reference = track.poses["reference"][:, :2]
    errors: dict[str, list[float]] = {name: [] for name in _models(track)}
    last = -1
    for i in begins.tolist():
        if i < last:
            continue
        last = int(end[i])
        for name, found in errors.items():
            found.append(aligned_rms(track.poses[name][i : last + 1, :2], reference[i : last + 1]))
    count = len(next(iter(errors.values()), []))
    return {name: np.array(found) for name, found in errors.items()}, float(count)


def yaw_per_turn(tracks: Sequence[DriveTracks]) -> Drift | None:
    """Median error [deg] of the yaw after 360 deg of turning to one side; None where drives hardly turn.

    Turns to the same side are joined, whatever lies between them.
    """
    posed = [track for track in tracks if track.sees != "position"]
    for length in TURNS:
        found = [_turn_errors(track, side, length) for track in posed for side in (1.0, -1.0)]
        count = sum(number for _, number in found)
        if count >= ENOUGH:
            return _drift([errors for errors, _ in found], TURNS[0], length, count)
    return None


def _turn_errors(track: DriveTracks, side: float, length: float) -> tuple[dict[str, FloatArray], float]:
    """Errors (k,) [deg] of each model over stretches of turning to one side, and the number of independent ones."""
    joined = np.diff(track.piece, prepend=-1) == 0
    steps = {name: np.diff(poses[:, 2], prepend=0.0) * joined for name, poses in track.poses.items()}
    steps["reference"] = wrap(steps["reference"])
    turning = np.sign(steps["calibrated"]) == side
    turned = np.degrees(np.cumsum(np.abs(steps["calibrated"]) * turning))
    end = _ends(turned, length)
    i = np.flatnonzero((end < len(track)) & turning)
    errors = {}
    for name in _models(track):
        astray = np.degrees(np.cumsum((steps[name] - steps["reference"]) * turning))
        errors[name] = np.abs(astray[end[i]] - astray[i])
    return errors, float(np.floor(turned[-1] / length)) if len(i) else 0.0


def _ends(travelled: FloatArray, length: float) -> np.ndarray:
    """First index (n,) at which ``length`` more is travelled; n where it never is."""
    return np.asarray(np.searchsorted(travelled, travelled + length - 1e-9))


def _models(track: DriveTracks) -> list[str]:
    return [name for name in track.poses if name != "reference"]


def _drift(
    parts: list[dict[str, FloatArray]], whole: float, length: float, count: float, is_fitted: bool = False
) -> Drift:
    names = parts[0].keys()
    pooled = {name: np.concatenate([part[name] for part in parts]) for name in names}
    return Drift({n: float(np.median(e)) * whole / length for n, e in pooled.items()}, whole, length, count, is_fitted)
