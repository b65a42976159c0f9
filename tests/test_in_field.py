from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from skidsteer.drive import Series
from skidsteer.errors import DataError, RequestError
from skidsteer.io.drives import load_drive
from skidsteer.models.transfer_factor import TransferFactor
from skidsteer.odometry.in_field import calibrate_around, calibrate_in_field, frozen, start_on_track, tune
from skidsteer.odometry.kinematic_ekf import KinematicEkf, thalmann_filter
from skidsteer.odometry.state_choice import SystemNoise
from skidsteer.odometry.thalmann_replay import Tracking, replay
from skidsteer.odometry.tracking_loss import loss_study, lost_windows, maximum_error, tracked
from skidsteer.se2 import rotate
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import Vehicle

VEHICLE = Vehicle("robot", track_width=0.6, wheel_radius=0.1)
TRUTH = TransferFactor(0.06, -0.03, 0.7, 0.6)
WANDER = (0.01, 0.01)
LEVER = np.array([0.2, -0.1])
NOISE = SystemNoise(2.0, 2.0, 0.01, 0.0, *WANDER)


def simulated(
    seed: int, heading: float = 0.0, delay: float = 0.0, duration: float = 8.0, stamp: float = 0.0
) -> tuple[Series, Tracking]:
    """A drive with turns to both sides, seen by positions of a target beside the middle."""
    rng = np.random.default_rng(seed)
    rows = [[2.0, 0.0, 0.0]]
    for _ in range(6):
        rows += [[duration, rng.uniform(0.4, 0.8), s * rng.uniform(0.2, 0.6)] for s in (1.0, 0.0, -1.0)]
    rims = rims_from_manoeuvres(np.array(rows), TRUTH, 20.0)
    sensors = Sensors(5.0, 0.01, 1e-6, stamp_sigma=stamp, reference_delay=delay)
    drive = kinematic_drive("simulated", VEHICLE, TRUTH, rims, sensors, 0.0, WANDER, seed)
    assert drive.pose is not None
    poses = drive.pose.values
    target = rotate(heading, poses[:, :2] + rotate(poses[:, 2], LEVER))
    return drive.wheels, Tracking(Series(drive.pose.t, target), 0.01, stamp, delay, (0.2, -0.1))


def estimating(name: str = "extended") -> KinematicEkf:
    return replace(thalmann_filter(name, 0.6, NOISE), significance=0.0)


@pytest.mark.parametrize("heading", [0.0, 2.0, -1.2, 3.1])
def test_the_heading_at_the_beginning_is_found(heading: float) -> None:
    wheels, tracking = simulated(1, heading)
    start = start_on_track(estimating(), wheels, tracking)
    assert abs(np.angle(np.exp(1j * (start.mean[2] - heading)))) < np.pi / 4
    found = calibrate_in_field(estimating(), wheels, tracking).replay
    truth = simulated(1)[1]
    assert_allclose(found.expected, rotate(heading, truth.positions.values), atol=0.1)


def test_slips_are_found_with_honest_sigmas() -> None:
    scores = []
    for seed in range(8):
        found = calibrate_in_field(estimating(), *simulated(seed, 0.4 * seed))
        error = np.array([found.slips[n].value for n in found.filter.estimated]) - TRUTH.theta
        P = found.replay.last.covariance[5:, 5:]
        scores.append(error @ np.linalg.solve(P, error))
        assert max(e.sigma for e in found.slips.values()) < 0.05
    assert chi2.ppf(0.001, 24) < np.sum(scores) < chi2.isf(0.001, 24)  # three parameters, eight drives


def test_a_second_drive_goes_on_from_the_first() -> None:
    first = calibrate_in_field(estimating(), *simulated(1))
    second = calibrate_in_field(estimating(), *simulated(2), first.replay.last)
    alone = calibrate_in_field(estimating(), *simulated(2))
    for name, e in second.slips.items():
        assert e.sigma < min(first.slips[name].sigma, alone.slips[name].sigma)
        assert abs(e.value - getattr(TRUTH, name)) < 4.0 * e.sigma
    with pytest.raises(RequestError, match="the state belongs to"):
        calibrate_in_field(estimating("transfer_difference"), *simulated(2), first.replay.last)


def test_delay_and_scatter_of_stamps_are_found() -> None:
    wheels, tracking = simulated(3, 0.5, delay=0.35, duration=5.0, stamp=0.1)
    filter, tuned = tune(estimating(), wheels, replace(tracking, time_offset=0.0, stamp_sigma=0.0))
    assert abs(tuned.time_offset - 0.35) < 0.06
    assert 0.05 < tuned.stamp_sigma < 0.2
    found = calibrate_in_field(filter, wheels, tuned).replay.deviance
    assert found < calibrate_in_field(estimating(), wheels, tracking).replay.deviance + 0.5  # the truth is not likelier


def test_the_reckoner_holds_what_was_found() -> None:
    found = calibrate_in_field(estimating(), *simulated(1))
    assert found.reckoner.estimated == ()
    assert_allclose(found.reckoner.model.theta, found.replay.last.mean[5:])
    assert found.reckoner.noise == found.filter.noise
    half = frozen(estimating(), {"slip_right": 0.1})
    assert_allclose(half.model.theta, [0.0, 0.1, 1.0])


def test_calibrating_around_a_window_does_not_look_into_it() -> None:
    wheels, tracking = simulated(4)
    values = tracking.positions.values.copy()
    inside = (tracking.t > 50.0) & (tracking.t < 90.0)
    values[inside] += 100.0
    spoilt = replace(tracking, positions=Series(tracking.positions.t, values))
    found = [calibrate_around(estimating(), wheels, t, 50.0, 90.0).slips for t in (tracking, spoilt)]
    assert found[0] == found[1]
    assert all(abs(e.value - getattr(TRUTH, name)) < 4.0 * e.sigma for name, e in found[0].items())
    with pytest.raises(DataError, match="seen to move neither before"):
        calibrate_around(estimating(), wheels, tracking, 1.0, 1e4)


def test_the_largest_error_of_a_window_step_by_step() -> None:
    wheels, tracking = simulated(5)
    filter = estimating("basic")
    track = tracked(filter, wheels, tracking)
    got = maximum_error(filter, track, wheels, tracking, 40.03, 60.0)
    last = int(np.searchsorted(track.t, 40.03)) - 1
    state, errors = track.state(filter, last), []
    stamps = tracking.t[(tracking.t >= 40.03) & (tracking.t <= 60.0)]
    for k in range(last, len(wheels.t) - 1):
        state, _, _ = filter.observe(state, wheels.values[k])
        for stamp in stamps[(stamps >= wheels.t[k]) & (stamps < wheels.t[k + 1])]:
            at = filter.predict(state, None, max(stamp - state.time, 0.0))
            seen = tracking.positions.values[np.argmin(abs(tracking.t - stamp))]
            errors.append(np.hypot(*(at.mean[:2] + rotate(at.mean[2], LEVER) - seen)))
        state = filter.predict(state, None, wheels.t[k + 1] - state.time)
    assert len(errors) == len(stamps) > 90
    assert_allclose(got, max(errors), rtol=1e-6)
    assert got > 1.0  # the basic model turns too far


def test_the_error_of_a_window_counts_all_of_it_and_nothing_else() -> None:
    wheels, tracking = simulated(5)
    filter = frozen(estimating(), dict(zip(("slip_left", "slip_right", "efficiency"), TRUTH.theta, strict=True)))
    track = tracked(filter, wheels, tracking)

    def spoilt(stamp: float) -> float:
        values = tracking.positions.values.copy()
        values[np.argmin(abs(tracking.t - stamp))] += 100.0
        other = replace(tracking, positions=Series(tracking.positions.t, values))
        return maximum_error(filter, track, wheels, other, 40.03, 60.0)

    for inside in (40.2, 59.8):
        assert spoilt(inside) > 130.0
    for outside in (39.5, 60.3):
        assert spoilt(outside) < 2.0


def test_calibrated_filters_stray_less() -> None:
    calibrated = calibrate_in_field(estimating(), *simulated(6)).reckoner
    wheels, tracking = simulated(7)
    filters = {"basic": estimating("basic"), "extended": calibrated, "around": estimating()}
    study = loss_study(filters, wheels, tracking, (20.0, 60.0), 3)
    assert study.errors["basic"].shape == (2, 3)
    assert study.starts.shape == (2, 3)
    for name in ("extended", "around"):
        assert (study.ratio(name, "basic") < 0.3).all()
        assert_allclose(study.medians(name), np.median(study.errors[name], axis=1))
    start = float(study.starts[1, 2])
    used = calibrate_around(estimating(), wheels, tracking, start, start + 60.0).reckoner
    error = maximum_error(used, tracked(used, wheels, tracking), wheels, tracking, start, start + 60.0)
    assert study.errors["around"][1, 2] == error
    again = loss_study({"extended": calibrated}, wheels, tracking, (20.0, 60.0), 3)
    assert_array_equal(again.errors["extended"], study.errors["extended"])


def test_windows_begin_after_the_robot_was_seen_to_move_and_it_moves_in_them() -> None:
    wheels, tracking = simulated(8)
    starts = lost_windows(wheels, tracking, 10.0, 50, np.random.default_rng(0))
    t, seen = tracking.t, tracking.positions.values
    for start in starts:
        assert np.hypot(*(seen[t <= start] - seen[0]).T).max() > 4.9
        part = seen[(t >= start) & (t < start + 10.0)]
        assert np.hypot(*(part - part[0]).T).max() >= 2.0
        assert start + 10.0 <= min(t[-1], wheels.t[-1])
    with pytest.raises(DataError, match=r"no windows of 1000 s in which the robot moves"):
        lost_windows(wheels, tracking, 1000.0, 1, np.random.default_rng(0))


def test_what_cannot_be_calibrated() -> None:
    wheels, tracking = simulated(1)
    still = replace(tracking, positions=Series(tracking.positions.t, np.zeros_like(tracking.positions.values)))
    later = replace(tracking, time_offset=-1e6)
    for bad in (still, later):
        with pytest.raises(DataError, match="do not show the robot moving"):
            calibrate_in_field(estimating(), wheels, bad)
    track = tracked(estimating(), wheels, tracking)
    with pytest.raises(DataError, match="no position between"):
        maximum_error(estimating(), track, wheels, tracking, 50.01, 50.02)
    start = start_on_track(estimating(), wheels, tracking)
    with pytest.raises(DataError, match="covariances of this replay were not kept"):
        replay(estimating(), start, wheels, covariances=False).state(estimating(), 0)


def test_real_drives_calibrated_on_one_reckoned_on_the_other(real: Callable[[str], Path]) -> None:
    """At most half of the basic model's error, in the median; delays as ``benchmarks/odometry_study.py`` finds them."""
    a, b = load_drive(real("warthog-grass-a")), load_drive(real("warthog-grass-b"))
    assert a.pose is not None
    assert b.pose is not None
    filter = replace(thalmann_filter("extended", 1.08, SystemNoise(2.0, 2.0, 0.02, 0.0, 0.04, 0.025)), significance=0.0)
    first = Tracking(Series(a.pose.t, a.pose.values[:, :2]), 0.02, 0.16, 0.3)
    second = Tracking(Series(b.pose.t, b.pose.values[:, :2]), 0.02, 0.16, 0.4)
    found = calibrate_in_field(filter, a.wheels, first)
    basic = replace(thalmann_filter("basic", 1.08, filter.noise), significance=0.0)
    study = loss_study({"basic": basic, "extended": found.reckoner}, b.wheels, second, (20.0, 60.0, 120.0), 9)
    assert (study.ratio("extended", "basic") <= 0.5).all()
