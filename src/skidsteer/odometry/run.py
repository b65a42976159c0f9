"""Odometry of a drive by a calibration: the trajectory, and its distance from the reference."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.drive import Drive
from skidsteer.errors import DataError, RequestError, named
from skidsteer.evaluation import fit_offset
from skidsteer.models import Differential
from skidsteer.noise import Noise
from skidsteer.odometry.begin import HERE, begin, closest
from skidsteer.odometry.filters import FILTERS, KNOW_BIAS
from skidsteer.odometry.icr_filter import IcrFilter
from skidsteer.odometry.log import Log, log_of
from skidsteer.odometry.state import Filter
from skidsteer.odometry.trajectory import Trajectory, replay, smooth
from skidsteer.progress import Progress, silent
from skidsteer.se2 import FloatArray, compose, invert


@dataclass(frozen=True, slots=True)
class OdometryOptions:
    """Which parts of a drive are used, and how."""

    filter: str = "icr"  # of ``FILTERS``
    reference: bool = True  # False: it is only used to measure the errors
    gyro: bool = True  # where the filter has a state for its bias
    smooth: bool = False  # each pose given the whole drive
    lose_after: float | None = None  # [s] from the start, after which the reference only measures the errors
    fit_delay: bool = False  # find the time offset of the reference first; needs reference poses

    def __post_init__(self) -> None:
        named(self.filter, "filter", FILTERS)
        if self.lose_after is not None and not 0.0 <= self.lose_after < np.inf:
            raise RequestError(f"the reference is lost after a time of 0 s or more, got {self.lose_after}")


@dataclass(frozen=True, slots=True)
class Distance:
    """Distance [m] of positions from the reference."""

    rms: float
    most: float


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """A trajectory, and its distance from the reference where the drive has one.

    Distances are measured from ``since`` on: where the reference was lost, else the start. Both begin there at the same
    pose.
    """

    filter: Filter
    trajectory: Trajectory
    since: float  # [s]
    distance: Distance | None = None
    nominal: Distance | None = None  # of dead reckoning by the nominal track width


def run(
    calibration: Calibration,
    drive: Drive,
    options: OdometryOptions = OdometryOptions(),
    progress: Progress = silent,
) -> Odometry:
    """The odometry of a drive; progress is told as it goes on.

    Raises:
        RequestError: a drive of separate windows; smoothing by a filter that cannot; a delay to be fitted without
            reference poses; a reference that is lost after the drive has ended.
    """
    if options.fit_delay and drive.pose is None:
        raise RequestError(f"{drive.name}: a delay is fitted to reference poses, and it has none")
    progress("finding the delay" if options.fit_delay else "reading", 0, 1)
    offset = fit_offset(calibration, drive) if options.fit_delay else None
    whole = log_of(calibration, drive, offset, gyro=options.gyro and options.filter in KNOW_BIAS)
    log, since = _taken(whole, options)
    filter = FILTERS[options.filter](calibration, log.gyro is not None)
    start = begin(filter, log, calibration.model, calibration.timing.lag)
    progress("smoothing" if options.smooth else "filtering", 0, 1)
    trajectory = smooth(filter, start, log) if options.smooth else replay(filter, start, log, progress)
    if whole.reference is None:
        return Odometry(filter, trajectory, since)
    nominal = _reckoned(calibration, log, trajectory, since)
    return Odometry(filter, trajectory, since, *_distances(whole, (trajectory, nominal), since, log.reference is None))


def _taken(whole: Log, options: OdometryOptions) -> tuple[Log, float]:
    """The log without the reference that is not used, and the time from which the errors are measured."""
    first, last = float(whole.wheels.t[0]), float(whole.wheels.t[-1])
    if not options.reference:
        return replace(whole, reference=None), first
    if options.lose_after is None:
        return whole, first
    since = first + options.lose_after
    if since >= last:
        raise RequestError(
            f"the reference is lost after {options.lose_after:g} s, the drive lasts {last - first:.1f} s"
        )
    return whole.without((since, np.inf)), since


def _reckoned(calibration: Calibration, log: Log, trajectory: Trajectory, since: float) -> Trajectory:
    """Dead reckoning by the nominal track width from the pose of a trajectory at ``since``."""
    at = int(np.searchsorted(trajectory.t, since))
    wheels = log.wheels.between(float(trajectory.t[at]), np.inf)
    if wheels is None:
        raise DataError(f"no wheel sample after {since:.3f} s")
    model = Differential.nominal(calibration.vehicle)
    plain = IcrFilter(model, (), np.zeros((0, 0)), np.zeros((0, 2)), Noise())
    return replay(plain, plain.start(float(wheels.t[0]), trajectory.poses[at], HERE), Log(wheels))


def _distances(
    whole: Log, trajectories: tuple[Trajectory, ...], since: float, ignored: bool
) -> tuple[Distance | None, ...]:
    """Distance of each trajectory; one that began at the origin is aligned with the reference first."""
    assert whole.reference is not None
    seen = whole.reference.between(max(since, float(trajectories[-1].t[0])), float(trajectories[0].t[-1]))
    if seen is None or (ignored and len(seen) < 2):
        return (None,) * len(trajectories)
    out = []
    for trajectory in trajectories:
        body = np.stack([np.interp(seen.t, trajectory.t, column) for column in trajectory.poses.T], axis=-1)
        path = compose(body, np.array([whole.mount.x, whole.mount.y, whole.mount.yaw]))
        if ignored:
            path = _laid(path, seen.values)
        out.append(distance(path[:, :2], seen.values[:, :2]))
    return tuple(out)


def distance(path: FloatArray, seen: FloatArray) -> Distance:
    """Distance of positions (m, 2) [m], at least one, from those of the reference (m, 2)."""
    away = np.hypot(*(path - seen).T)
    return Distance(float(np.sqrt(np.mean(away**2))), float(away.max()))


def _laid(path: FloatArray, seen: FloatArray) -> FloatArray:
    """A path (m, 3) aligned with the reference: by its first pose, or with positions by the best rigid motion."""
    if seen.shape[1] == 3:
        return compose(compose(seen[0], invert(path[0])), path)
    return compose(closest(path[:, :2], seen), path)
