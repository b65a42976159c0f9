"""Both phases on one drive: in-field calibration until the reference is lost, dead reckoning after it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.evaluation import mount
from skidsteer.models import Differential
from skidsteer.odometry.in_field import calibrate_in_field, tune
from skidsteer.odometry.kinematic_ekf import thalmann_filter
from skidsteer.odometry.reckoning import reckon
from skidsteer.odometry.run import Odometry, OdometryOptions, distance
from skidsteer.odometry.state_choice import SystemNoise
from skidsteer.odometry.thalmann_replay import Replay, Tracking, replay
from skidsteer.odometry.trajectory import Trajectory
from skidsteer.progress import Progress, silent
from skidsteer.se2 import FloatArray, compose

LEAST_SIGMA = 0.01  # [m] of a position: errors that repeat from one to the next are not in the calibration's noise


def run_phases(
    calibration: Calibration,
    drive: Drive,
    after: float,
    options: OdometryOptions | None = None,
    progress: Progress = silent,
) -> Odometry:
    """Odometry by Thalmann's extended filter, which learns the robot's slips from positions until they are lost.

    Only the vehicle, the noise of positions and the place of the sensor are taken from the calibration. Slips, delay of
    the reference, scatter of its stamps and random walk of the pose are estimated on the first part of the drive. After
    it the slips stay, and their uncertainty is in the covariance.

    Args:
        calibration: of the robot.
        drive: continuous, with reference positions or poses, whose headings are not used.
        after: [s] from the start, after which the reference is only used to measure the errors.
        options: the defaults.
        progress: called as work goes on.

    Returns:
        The odometry, with distances from then on; its last state holds the slips.

    Raises:
        RequestError: a drive of separate windows or without reference, or one that ends before; other options.
        DataError: the robot is not seen to move before.
    """
    if options not in (None, OdometryOptions()):
        raise RequestError("two phases go with no other option of filter, reference, gyro, delay or smoothing")
    if drive.segments is not None or drive.reference is None:
        raise RequestError(f"{drive.name}: two phases need one continuous drive with reference positions")
    first, last = drive.span
    since = first + after
    if not first < since < last:
        raise RequestError(f"the first phase must end inside the drive of {last - first:.1f} s, got {after:g} s")
    wheels, place = drive.wheels, mount(calibration, drive)
    before = wheels.between(first, since)
    assert before is not None
    seen = Series(drive.reference.t, drive.reference.values[:, :2], "positions")
    sigma = max(calibration.noise.position, LEAST_SIGMA)
    width = calibration.vehicle.track_width
    plain = replace(thalmann_filter("extended", width, SystemNoise(2.0, 2.0, 0.02)), significance=0.0)
    progress("finding the noise of the filter", 0, 3)
    filter, tracking = tune(plain, before, Tracking(seen, sigma, lever=(place.x, place.y)))
    progress("learning the slips", 1, 3)
    found = calibrate_in_field(filter, before, tracking)
    progress("filtering", 2, 3)
    whole = replay(filter, found.replay.state(filter, 0), wheels, tracking, lost=(since, np.inf))
    nominal = _reckoned(Differential(width), wheels, whole, tracking, since)
    lost = whole.seen_t >= since
    distances = [distance(path[lost], whole.seen[lost]) if lost.any() else None for path in (whole.expected, nominal)]
    return Odometry(filter, _trajectory(whole, filter.names), since, *distances)


def _reckoned(model: Differential, wheels: Series, whole: Replay, tracking: Tracking, since: float) -> FloatArray:
    """Positions (p, 2) of the target by dead reckoning from the filter's pose at the last sample before ``since``."""
    at = int(np.searchsorted(whole.t, since, side="right")) - 1
    part = wheels.between(float(whole.t[at]), np.inf)
    assert part is not None
    poses = reckon(model, part, start=whole.means[at, :3])
    body = np.stack([np.interp(whole.seen_t, part.t, column) for column in poses.T], axis=-1)
    return compose(body, np.array([*tracking.lever, 0.0]))[:, :2]


def _trajectory(whole: Replay, names: tuple[str, ...]) -> Trajectory:
    used = np.isfinite(whole.seen_statistic)
    return Trajectory(
        names=names,
        t=whole.t,
        means=whole.means,
        covariances=whole.covariances[:, :3, :3],
        seen_t=whole.seen_t[used],
        squared=whole.seen_statistic[used],
        dof=2,
        accepted=whole.seen_taken[used],
        anchored=np.zeros(int(used.sum()), dtype=np.bool_),
        rates=(0, 0),
        last=whole.last,
    )
