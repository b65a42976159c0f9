"""Reference and dead reckoning of a drive, and their thinning without hiding outliers."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skidsteer.gyro import Turn
from skidsteer.metrics import align_gyro
from skidsteer.models import Model
from skidsteer.report.reckoner import Reckoner
from skidsteer.se2 import FloatArray, between, chain, compose, invert
from skidsteer.windows import Sees, Windows, increment_windows

WORTH_KEEPING = 7  # poses of a stretch: first, extremes of x and y, largest error of position and of yaw


@dataclass(frozen=True, slots=True, eq=False)
class DriveTracks:
    """Reference and dead reckoning of a drive, at the stamps of the reference.

    In each ``piece`` dead reckoning begins with the reference's first pose. Where the reference has positions
    only, its yaw is 0 and dead reckoning begins with that: it must be rotated to fit before the two are compared. Where
    there is only a gyro, the positions of the reference are 0.
    """

    name: str
    sees: Sees
    is_held_out: bool
    t: FloatArray  # (n,) [s]
    piece: np.ndarray  # (n,) number of the piece; between two there is a gap
    poses: Mapping[str, FloatArray]  # reference and models (n, 3), x, y [m] and yaw [rad] unwrapped in the models'

    def __len__(self) -> int:
        return len(self.t)

    def where(self, keep: np.ndarray) -> DriveTracks:
        """Only the poses of a mask (n,) or of indices."""
        poses = {name: values[keep] for name, values in self.poses.items()}
        return DriveTracks(self.name, self.sees, self.is_held_out, self.t[keep], self.piece[keep], poses)


def tracks_of(reckoner: Reckoner, models: Mapping[str, Model]) -> DriveTracks | None:
    """Dead reckoning along a drive by the calibrated model and by others; None without reference and gyro.

    Args:
        reckoner: of the drive.
        models: others, by name.
    """
    drive = reckoner.drive
    if drive.reference is None and drive.gyro is None:
        return None
    windows = increment_windows(drive)
    if not len(windows):
        return None
    first = np.flatnonzero(~windows.joined)
    index = np.insert(np.arange(len(windows)), first, -1)  # -1: a piece begins
    begin = np.flatnonzero(index < 0)
    t = np.where(index < 0, 0.0, windows.end[index])
    t[begin] = windows.start[first]
    piece = np.cumsum(index < 0) - 1
    reference = _reference(reckoner, windows, t, begin, first)
    motions = {name: reckoner.motions(windows, model) for name, model in models.items()}
    motions["calibrated"] = reckoner.motions(windows)
    poses = {"reference": reference}
    poses |= {name: _chains(motion, reference, begin, first) for name, motion in motions.items()}
    return DriveTracks(drive.name, windows.sees, reckoner.is_held_out, t, piece, poses)


def _reference(reckoner: Reckoner, windows: Windows, t: FloatArray, begin: np.ndarray, first: np.ndarray) -> FloatArray:
    """Poses (n, 3) of the reference at its stamps t (n,), with zeros for what it does not measure."""
    drive = reckoner.drive
    if drive.reference is not None:
        at = drive.reference.values[np.searchsorted(drive.reference.t, t)]
        return at if windows.sees == "pose" else np.column_stack([at, np.zeros(len(at))])
    assert drive.gyro is not None
    errors = align_gyro(drive, reckoner.parts[0].model, reckoner.timing)
    turned = Turn.of(drive.gyro).between(windows.start, windows.end, errors)
    motion = np.column_stack([np.zeros((len(turned), 2)), turned])
    return _chains(motion, np.zeros((len(t), 3)), begin, first)


def _chains(motion: FloatArray, reference: FloatArray, begin: np.ndarray, first: np.ndarray) -> FloatArray:
    ends = np.append(first[1:], len(motion))
    parts = [chain(motion[a:b], reference[i]) for i, a, b in zip(begin, first, ends, strict=True)]
    return np.concatenate(parts)


def step_errors(track: DriveTracks, name: str) -> FloatArray:
    """Error (n, 3) of each motion of a model, in the frame where it begins; 0 at the first pose of a piece."""
    out = np.zeros((len(track), 3))
    joined = np.flatnonzero(track.piece[1:] == track.piece[:-1]) + 1
    here, there = track.poses[name], track.poses["reference"]
    moved = between(here[joined - 1], here[joined])
    if track.sees == "pose":
        true = between(there[joined - 1], there[joined])
        out[joined] = moved - true
        out[joined, 2] = (out[joined, 2] + np.pi) % (2.0 * np.pi) - np.pi
    else:
        step = there[joined, :2] - there[joined - 1, :2]
        out[joined, 0] = np.hypot(moved[:, 0], moved[:, 1]) - np.hypot(step[:, 0], step[:, 1])
    return out


def thin(track: DriveTracks, most: int) -> DriveTracks:
    """At most about ``most`` poses, none of them moved.

    Of each stretch the first pose is kept, those where the reference lies farthest to each side, and those where the
    motion of the calibrated model errs most, so that no outlier is hidden. First and last pose of each piece stay while
    there is room for them.
    """
    n = len(track)
    if n <= most:
        return track
    edges = np.unique(np.linspace(0, n, max(most // WORTH_KEEPING, 1) + 1).astype(int))
    error = np.abs(step_errors(track, "calibrated"))
    x, y = track.poses["reference"][:, 0], track.poses["reference"][:, 1]
    scores = (x, -x, y, -y, np.hypot(error[:, 0], error[:, 1]), error[:, 2])
    keep = np.zeros(n, bool)
    keep[edges[:-1]] = keep[-1] = True
    for a, b in itertools.pairwise(edges.tolist()):
        keep[[a + int(np.argmax(score[a:b])) for score in scores]] = True
    ends = np.flatnonzero(np.diff(track.piece))
    if len(ends) < most // 4:
        keep[ends] = keep[ends + 1] = True
    return track.where(keep)


def motion_between(poses: FloatArray, i: np.ndarray, j: np.ndarray) -> FloatArray:
    """Motions (k, 3) from poses i to poses j (k,) of a track, yaw not wrapped."""
    return compose(invert(poses[i]), poses[j])
