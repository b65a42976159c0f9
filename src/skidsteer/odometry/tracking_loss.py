"""Errors of a filter while tracking is lost: the study of Thalmann 2016, section 3.2, Figs. 12 and 13.

Tracking is lost in random windows of a drive. Before, the filter takes encoders and positions; in the window, encoders
only. The error of the window is the largest distance of the target from its measured position.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Series
from skidsteer.errors import DataError
from skidsteer.odometry.in_field import calibrate_around, start_on_track
from skidsteer.odometry.kinematic_ekf import KinematicEkf
from skidsteer.odometry.thalmann_replay import Replay, Tracking, replay
from skidsteer.se2 import FloatArray

SEEN_FIRST = 5.0  # [m] that the target moves before tracking is lost: positions of a robot at rest give no heading
LEAST_MOVE = 2.0  # [m] that it moves in a window
TRIES = 4000


@dataclass(frozen=True, slots=True, eq=False)
class LossStudy:
    """Errors of filters in lost windows."""

    durations: FloatArray  # (k,) [s]
    starts: FloatArray  # (k, count) [s] of the windows on the clock of the wheels
    errors: Mapping[str, FloatArray]  # name of the filter -> (k, count) [m]

    def medians(self, name: str) -> FloatArray:
        """Median (k,) [m] of a filter's errors for each duration."""
        return np.asarray(np.median(self.errors[name], axis=1))

    def ratio(self, name: str, other: str) -> FloatArray:
        """Median (k,) of the errors of a filter over those of another in the same windows."""
        return np.asarray(np.median(self.errors[name] / self.errors[other], axis=1))


def loss_study(
    filters: Mapping[str, KinematicEkf],
    wheels: Series,
    tracking: Tracking,
    durations: Sequence[float],
    count: int = 40,
    seed: int = 0,
) -> LossStudy:
    """Errors in random lost windows, the same for each filter.

    Args:
        filters: by name. One that estimates slips is calibrated for each window on what is seen before and after it.
        wheels: (n, 2) rim speeds [m/s].
        tracking: positions of the whole drive.
        durations: [s] of the windows.
        count: windows of each duration.
        seed: of the random windows.

    Raises:
        DataError: a duration with too few windows in which the robot moves.
    """
    rng = np.random.default_rng(seed)
    starts = np.array([lost_windows(wheels, tracking, duration, count, rng) for duration in durations])
    ends = starts + np.array(durations, dtype=float)[:, None]
    errors = {name: _errors(filter, wheels, tracking, starts, ends) for name, filter in filters.items()}
    return LossStudy(np.array(durations, dtype=float), starts, errors)


def _errors(
    filter: KinematicEkf, wheels: Series, tracking: Tracking, starts: FloatArray, ends: FloatArray
) -> FloatArray:
    """Largest error (k, count) [m] in each window."""
    tracks: dict[str, Replay] = {}
    errors = np.empty(starts.shape)
    for i in np.ndindex(*starts.shape):
        window = float(starts[i]), float(ends[i])
        used = calibrate_around(filter, wheels, tracking, *window).reckoner if filter.estimated else filter
        if used.fingerprint not in tracks:
            tracks = {used.fingerprint: tracked(used, wheels, tracking)}
        errors[i] = maximum_error(used, tracks[used.fingerprint], wheels, tracking, *window)
    return errors


def tracked(filter: KinematicEkf, wheels: Series, tracking: Tracking) -> Replay:
    """The drive with all positions.

    Raises:
        DataError: wheels and positions share no time, or the robot is not seen to move.
    """
    return replay(filter, start_on_track(filter, wheels, tracking), wheels, tracking)


def lost_windows(
    wheels: Series, tracking: Tracking, duration: float, count: int, rng: np.random.Generator
) -> FloatArray:
    """Random starts (count,) [s] of windows in which the robot moves, after it was seen to move.

    Raises:
        DataError: there are none.
    """
    t, seen = tracking.t, tracking.positions.values
    inside = (t >= wheels.t[0]) & (t <= wheels.t[-1])
    t, seen = t[inside], seen[inside]
    left = np.hypot(*(seen - seen[:1]).T) >= SEEN_FIRST if len(t) else np.zeros(0, bool)
    earliest, latest = (t[np.argmax(left)], t[-1] - duration) if left.any() else (0.0, -1.0)
    tries = rng.uniform(earliest, max(latest, earliest), TRIES) if latest > earliest else np.zeros(0)
    moving = [start for start in tries if _extent(t, seen, start, start + duration) >= LEAST_MOVE]
    if len(moving) < count:
        raise DataError(
            f"no windows of {duration:g} s in which the robot moves after it was seen to move {SEEN_FIRST} m"
        )
    return np.array(moving[:count])


def _extent(t: FloatArray, seen: FloatArray, start: float, end: float) -> float:
    first, last = np.searchsorted(t, [start, end])
    part = seen[first:last]
    return float(np.hypot(*(part - part[0]).T).max()) if len(part) else 0.0


def maximum_error(
    filter: KinematicEkf, track: Replay, wheels: Series, tracking: Tracking, start: float, end: float
) -> float:
    """Largest distance [m] of the target from its measured position, while tracking is lost from start to end [s].

    Args:
        filter: of the track.
        track: with all positions, and covariances.
        wheels: (n, 2) rim speeds [m/s].
        tracking: positions.
        start: [s] on the clock of the wheels.
        end: [s].

    Raises:
        DataError: no position in that time.
    """
    last = int(np.searchsorted(track.t, start, side="right")) - 1
    part = wheels.between(float(track.t[last]), end)
    if part is None:
        raise DataError(f"no wheel sample between {start:.3f} and {end:.3f} s")
    alone = replay(filter, track.state(filter, last), part, tracking, lost=(start, end), covariances=False)
    lost = alone.seen_t >= start
    if not lost.any():
        raise DataError(f"no position between {start:.3f} and {end:.3f} s")
    return float(np.hypot(*(alone.seen - alone.expected)[lost].T).max())
