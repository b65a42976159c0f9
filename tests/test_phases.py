from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skidsteer.calibration import Calibration, Estimate, Provenance
from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError, RequestError
from skidsteer.models import Differential
from skidsteer.models.transfer_factor import TransferFactor
from skidsteer.noise import Noise
from skidsteer.odometry.filters import FILTERS
from skidsteer.odometry.kinematic_ekf import TABLE_1
from skidsteer.odometry.phases import run_phases
from skidsteer.odometry.run import Odometry, OdometryOptions, run
from skidsteer.se2 import compose, rotate
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import Vehicle

VEHICLE = Vehicle("robot", track_width=0.6, wheel_radius=0.1)
TRUTH = TransferFactor(0.06, -0.03, 0.7, 0.6)
MOUNT = {"mount_x": Estimate(0.2, 0.0, "m"), "mount_y": Estimate(-0.1, 0.0, "m")}


def known(mounted: bool) -> Calibration:
    """A calibration that knows no more than the nominal robot, and where the target sits."""
    estimates = {n: Estimate(getattr(TRUTH, n), 0.1, "") for n in ("slip_left", "slip_right", "efficiency")}
    estimates |= MOUNT if mounted else {}
    names = tuple(estimates)
    noise = Noise(position=0.01, walk=0.01, turn=0.01)
    return Calibration(
        VEHICLE, TRUTH, names, estimates, 0.01 * np.eye(len(names)), noise, Provenance((), {}, "test", "")
    )


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Two minutes, seen by a target beside the middle, 0.25 s late."""
    rng = np.random.default_rng(3)
    rows = [[2.0, 0.0, 0.0]]
    for _ in range(8):
        rows += [[5.0, rng.uniform(0.4, 0.8), s * rng.uniform(0.2, 0.6)] for s in (1.0, 0.0, -1.0)]
    rims = rims_from_manoeuvres(np.array(rows), TRUTH, 10.0)
    sensors = Sensors(5.0, 0.01, 1e-6, reference_delay=0.25)
    made = kinematic_drive("two-phases", VEHICLE, TRUTH, rims, sensors, 0.0, (0.01, 0.01), 3)
    assert made.pose is not None
    poses = made.pose.values
    target = poses[:, :2] + rotate(poses[:, 2], np.array([0.2, -0.1]))
    return replace(made, pose=None, position=Series(made.pose.t, target, "position"))


@pytest.fixture(scope="module")
def result(drive: Drive) -> Odometry:
    return run_phases(known(True), drive, 60.0)


def test_slips_are_learned_until_the_reference_is_lost(drive: Drive, result: Odometry) -> None:
    track = result.trajectory
    mean = dict(zip(track.names, track.last.mean, strict=True))
    sigma = dict(zip(track.names, np.sqrt(np.diag(track.last.covariance)), strict=True))
    for name in ("slip_left", "slip_right", "efficiency"):
        assert abs(mean[name] - getattr(TRUTH, name)) < 4.0 * sigma[name]
        assert sigma[name] < 0.1
    assert result.since == pytest.approx(drive.span[0] + 60.0)
    assert track.seen_t.max() <= result.since
    assert result.distance is not None
    assert result.nominal is not None
    assert result.distance.most < 0.3 * result.nominal.most
    assert np.sqrt(track.covariances[-1, 0, 0] + track.covariances[-1, 1, 1]) > 0.2 * result.distance.rms


def test_a_nominal_robot_is_judged_where_its_target_sits() -> None:
    """Where nothing slips dead reckoning leads the target, 0.5 m off the middle, to where it is seen."""
    nominal = Differential(0.6)
    rims = rims_from_manoeuvres(np.array([[12.0, 0.5, 0.4], [18.0, 0.5, -0.4]]), nominal, 10.0)
    made = kinematic_drive("nominal", VEHICLE, nominal, rims, Sensors(5.0, 0.002, 1e-6), seed=1)
    assert made.pose is not None
    target = compose(made.pose.values, np.array([0.3, -0.4, 0.0]))[:, :2]
    mounted = {"mount_x": Estimate(0.3, 0.0, "m"), "mount_y": Estimate(-0.4, 0.0, "m")}
    calibration = replace(known(True), estimates=known(False).estimates | mounted)
    seen = replace(made, pose=None, position=Series(made.pose.t, target, "position"))
    result = run_phases(calibration, seen, 15.0)
    assert result.nominal is not None
    assert result.nominal.most < 0.1


def test_what_comes_after_the_loss_changes_nothing(drive: Drive, result: Odometry) -> None:
    assert drive.position is not None
    values = drive.position.values.copy()
    values[drive.position.t > 61.0] += 50.0
    spoilt = replace(drive, position=Series(drive.position.t, values, "position"))
    again = run_phases(known(True), spoilt, 60.0)
    assert_allclose(again.trajectory.means, result.trajectory.means)
    assert again.distance is not None
    assert again.distance.most > 40.0


def test_what_is_refused(drive: Drive) -> None:
    with pytest.raises(RequestError, match="two phases go with no other option"):
        run_phases(known(True), drive, 60.0, OdometryOptions(smooth=True))
    with pytest.raises(RequestError, match="must end inside the drive"):
        run_phases(known(True), drive, 1e4)
    with pytest.raises(RequestError, match="one continuous drive with reference positions"):
        run_phases(known(True), replace(drive, position=None), 60.0)
    with pytest.raises(DataError, match="do not show the robot moving"):
        run_phases(known(True), drive, 1.0)


@pytest.mark.parametrize("name", TABLE_1)
def test_thalmanns_filters_run_by_name(name: str, drive: Drive) -> None:
    assert name in FILTERS
    result = run(known(False), drive, OdometryOptions(name, lose_after=60.0))
    assert result.filter.names[:3] == ("x", "y", "yaw")
    assert len(result.trajectory.t) == len(drive.wheels)
    assert np.linalg.eigvalsh(result.trajectory.last.covariance)[0] > 0.0
    assert result.distance is not None
    assert result.nominal is not None
    estimated = TABLE_1[name][2]
    if not estimated:  # the nominal robot, as dead reckoning has it
        assert_allclose(result.distance.rms, result.nominal.rms, rtol=0.05)
    elif "efficiency" in estimated:
        assert result.distance.rms < 0.5 * result.nominal.rms
