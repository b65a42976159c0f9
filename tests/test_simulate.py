import itertools
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.models import Differential, Icr
from skidsteer.samples import P3AT_LAG, P3AT_SENSORS, P3AT_TRUTH, SAMPLES, p3at_mandow, sample
from skidsteer.se2 import FloatArray, between, wrap
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import preset

P3AT = preset("pioneer-p3at")
TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)
NO_NOISE = Sensors(reference_rate=5.0, position_sigma=0.0, yaw_sigma=0.0)
ROWS = np.array([[2.0, 0.0, 0.0], [3.0, 0.5, 0.0], [3.0, 0.4, 0.7], [3.0, -0.2, -0.6], [2.0, 0.0, 0.0]])
RIMS = rims_from_manoeuvres(ROWS, Differential(P3AT.track_width))


def poses_of(drive: Drive) -> FloatArray:
    assert drive.pose is not None
    return drive.pose.values


def integral(t: FloatArray, lag: float) -> FloatArray:
    """Poses (n, 3) at times t by an ODE solver, in steps that end at every wheel sample and every t."""

    def slope(_: float, y: FloatArray, v: FloatArray) -> FloatArray:
        v_x, v_y, omega = TRUTH.matrix() @ (y[3:] if lag > 0 else v)
        c, s = np.cos(y[2]), np.sin(y[2])
        return np.array([c * v_x - s * v_y, s * v_x + c * v_y, omega, *((v - y[3:]) / lag if lag > 0 else 0 * v)])

    edges, y, found = np.unique(np.r_[RIMS.t[RIMS.t < t[-1]], t]), np.r_[np.zeros(3), RIMS.values[0]], {}
    for a, b in itertools.pairwise(edges):
        found[a] = y[:3]
        y = solve_ivp(slope, (a, b), y, rtol=1e-8, atol=1e-10, args=(RIMS.hold(a),)).y[:, -1]
    found[edges[-1]] = y[:3]
    return np.array([found[i] for i in t])


# The drive


@pytest.mark.parametrize("lag", [0.0, 0.15])
def test_a_drive_without_noise_is_the_integral(lag: float) -> None:
    drive = kinematic_drive("d", P3AT, TRUTH, RIMS, NO_NOISE, lag)
    assert drive.pose is not None
    expected = integral(drive.pose.t, lag)
    assert_allclose(drive.pose.values, between(expected[0], expected), atol=1e-5)
    assert_array_equal(drive.wheels.values, RIMS.values)
    assert np.ptp(drive.pose.values[:, :2], axis=0).min() > 0.5


def test_the_reference_comes_at_its_rate_inside_the_wheels() -> None:
    for rate in (5.0, 20.0):
        drive = kinematic_drive("d", P3AT, TRUTH, RIMS, replace(NO_NOISE, reference_rate=rate))
        assert drive.pose is not None
        assert_allclose(np.diff(drive.pose.t), 1.0 / rate)
        assert RIMS.t[0] < drive.pose.t[0] < RIMS.t[0] + 0.06
        assert RIMS.t[-1] - 0.06 - 1.0 / rate < drive.pose.t[-1] < RIMS.t[-1]


def test_a_late_reference_has_late_stamps_and_the_same_poses() -> None:
    late = kinematic_drive("d", P3AT, TRUTH, RIMS, replace(NO_NOISE, reference_delay=0.3))
    prompt = kinematic_drive("d", P3AT, TRUTH, RIMS, NO_NOISE)
    assert late.pose is not None
    assert prompt.pose is not None
    assert_allclose(late.pose.t, prompt.pose.t + 0.3)
    assert_array_equal(late.pose.values, prompt.pose.values)


def test_the_seed_decides_the_noise() -> None:
    def make(seed: int) -> Drive:
        return kinematic_drive("d", P3AT, TRUTH, RIMS, Sensors(stamp_sigma=0.01), 0.1, (0.02, 0.03), seed)

    assert_array_equal(poses_of(make(4)), poses_of(make(4)))
    assert np.abs(poses_of(make(4)) - poses_of(make(5))).max() > 0.005


def test_measured_poses_scatter_as_the_sensors_say() -> None:
    sensors = Sensors(50.0, position_sigma=0.02, yaw_sigma=0.01)
    truth = poses_of(kinematic_drive("d", P3AT, TRUTH, RIMS, replace(sensors, position_sigma=0.0, yaw_sigma=0.0)))
    error = between(truth, poses_of(kinematic_drive("d", P3AT, TRUTH, RIMS, sensors, seed=1)))
    assert len(error) > 600
    assert_allclose(error.std(axis=0) / [0.02, 0.02, 0.01], 1.0, atol=0.12)  # four standard errors
    assert_allclose(error.mean(axis=0) / [0.02, 0.02, 0.01], 0.0, atol=0.16)


def test_stamps_scatter_as_the_sensors_say() -> None:
    sensors = replace(NO_NOISE, stamp_sigma=0.03)  # far less than 0.2 s: the order is kept
    drive, prompt = (kinematic_drive("d", P3AT, TRUTH, RIMS, s, seed=2) for s in (sensors, NO_NOISE))
    assert drive.pose is not None
    assert prompt.pose is not None
    assert np.std(drive.pose.t - prompt.pose.t) == pytest.approx(0.03, rel=0.35)
    assert_array_equal(drive.pose.values, prompt.pose.values)


def test_motion_noise_grows_with_the_root_of_the_distance() -> None:
    """After rolling d at v = 1 m/s straight on, the yaw has strayed by turn * sqrt(d / 10)."""
    rims = Series(np.arange(0.0, 10.0, 0.1), np.ones((100, 2)))
    ends = [
        poses_of(kinematic_drive("d", P3AT, Differential(0.4), rims, NO_NOISE, 0.0, (0.01, 0.02), seed))[[20, -1]]
        for seed in range(300)
    ]
    start, middle, end = 0.05, 4.05, 9.85
    spread = np.std(np.array(ends)[:, :, 2], axis=0)
    assert_allclose(spread, 0.02 * np.sqrt([0.1 * (middle - start), 0.1 * (end - start)]), rtol=0.17)
    along = np.std(np.array(ends)[:, 0, 0])  # forwards, only the walk tells
    assert along == pytest.approx(0.01 * np.sqrt(4.0), rel=0.25)


def test_motion_noise_also_comes_with_turning_on_the_spot() -> None:
    rims = Series(np.arange(0.0, 10.0, 0.1), np.tile([-0.5, 0.5], (100, 1)))
    model = Differential(0.4)
    truth = poses_of(kinematic_drive("d", P3AT, model, rims, NO_NOISE))[-1]
    yaw = [poses_of(kinematic_drive("d", P3AT, model, rims, NO_NOISE, 0.0, (0.0, 0.02), s))[-1, 2] for s in range(300)]
    assert np.std(wrap(yaw - truth[2])) == pytest.approx(0.02 * np.sqrt(0.5 * 9.8), rel=0.17)


def test_encoders_count_whole_steps() -> None:
    step = 0.001
    drive = kinematic_drive("d", P3AT, TRUTH, RIMS, replace(NO_NOISE, encoder_step=step))
    counts = drive.wheels.values * 0.01 / step
    assert_allclose(counts, np.round(counts), atol=1e-6)
    rolled, true = (np.cumsum(v * 0.01, axis=0) for v in (drive.wheels.values, RIMS.values))
    assert np.abs(rolled - true).max() <= 0.5 * step + 1e-9
    assert np.abs(drive.wheels.values - RIMS.values).max() > 0.01
    perfect = kinematic_drive("d", P3AT, TRUTH, RIMS, NO_NOISE)
    assert_array_equal(poses_of(drive), poses_of(perfect))  # what is driven does not depend on the encoders


def test_a_simulated_drive_says_so() -> None:
    drive = kinematic_drive("mine", P3AT, TRUTH, RIMS, NO_NOISE, seed=12)
    assert drive.source == "simulated, seed 12"
    assert drive.name == "mine"
    assert drive.vehicle is P3AT


# Rims


def test_rims_follow_manoeuvres_within_the_acceleration() -> None:
    model = Differential(0.4)
    rims = rims_from_manoeuvres(np.array([[1.0, 0.3, 0.0], [2.0, 0.2, 0.5]]), model, rate=50.0, acceleration=0.6)
    assert_allclose(rims.t, np.arange(150) / 50.0)
    assert_allclose(rims.values[0], 0.0)
    assert np.abs(np.diff(rims.values, axis=0)).max() <= 0.6 / 50.0 + 1e-12
    assert_allclose(rims.values[25], 0.3)  # reached after half a second
    assert_allclose(rims.values[-1], [0.2 - 0.1, 0.2 + 0.1])
    assert_allclose(rims.values[51], 0.3 + np.array([-0.012, 0.0]) * 2, atol=1e-12)


@pytest.mark.parametrize("seconds", [8.3, 16.1, 33.7])
def test_rims_of_durations_that_round_up(seconds: float) -> None:
    rims = rims_from_manoeuvres(np.array([[seconds, 0.3, 0.0]]), Differential(0.4), rate=30.0)
    assert rims.t[-1] == pytest.approx(seconds, abs=0.04)
    assert_allclose(rims.values[-1], 0.3)


# The sample


def test_the_sample_is_the_same_every_time() -> None:
    first, second = sample("p3at-mandow"), sample("p3at-mandow")
    assert first.pose is not None
    assert second.pose is not None
    for a, b in ((first.wheels, second.wheels), (first.pose, second.pose)):
        assert_array_equal(a.t, b.t)
        assert_array_equal(a.values, b.values)


def test_the_sample_is_labelled_simulated() -> None:
    drive = sample("p3at-mandow")
    assert drive.source.startswith("simulated")
    assert "simulated" in SAMPLES["p3at-mandow"].text
    assert drive.vehicle == P3AT
    assert drive.name == "p3at-mandow"


def test_the_sample_was_driven_by_its_truth() -> None:
    """From the wheels, Mandow's Table I and the stated delay and lag, the reference follows to its stated noise."""
    drive = p3at_mandow()
    again = kinematic_drive("again", P3AT, P3AT_TRUTH, drive.wheels, NO_NOISE, P3AT_LAG)
    assert drive.pose is not None
    assert again.pose is not None
    assert_allclose(again.pose.t, drive.pose.t - P3AT_SENSORS.reference_delay, atol=1e-9)
    a, b = drive.pose.values, again.pose.values
    motion, expected = between(a[:-5], a[5:]), between(b[:-5], b[5:])
    assert np.abs(expected[:, 2]).max() > 0.5
    spread = np.sqrt(((motion - expected) ** 2).mean(axis=0))
    # of one second: two poses, the start's yaw seen from some decimetres away, and the motion
    assert_allclose(spread, [0.015, 0.015, np.radians(0.5) * np.sqrt(2)], rtol=0.15)
    assert P3AT_TRUTH == TRUTH  # and this is what the documentation says
    assert (P3AT_LAG, P3AT_SENSORS.reference_delay, P3AT_SENSORS.reference_rate) == (0.08, 0.15, 5.0)
    assert (P3AT_SENSORS.position_sigma, P3AT_SENSORS.yaw_sigma) == (0.01, pytest.approx(np.radians(0.5)))


def test_an_unknown_sample_lists_those_there_are() -> None:
    with pytest.raises(RequestError, match=r"^no sample 'p3at'; there are: .*p3at-mandow"):
        sample("p3at")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position_sigma": 100.0}, "sensors: position_sigma must be from 0 to 10 m, got 100"),
        ({"yaw_sigma": -0.1}, "sensors: yaw_sigma must be from 0 to 3.14 rad, got -0.1"),
        ({"gyro_bias": np.nan}, "sensors: gyro_bias must be from -10 to 10 rad/s, got nan"),
        ({"reference_rate": 0.0}, "sensors: reference_rate must be from 0.001 to 1e\\+04 Hz, got 0"),
    ],
)
def test_sensors_that_cannot_be(change: dict[str, float], message: str) -> None:
    with pytest.raises(RequestError, match=message):
        replace(NO_NOISE, **change)


@pytest.mark.parametrize("noise", [(100.0, 0.0), (0.01, 100.0), (-1e-3, 0.0), (np.nan, 0.0)])
def test_motion_noise_that_cannot_be(noise: tuple[float, float]) -> None:
    with pytest.raises(RequestError, match=r"motion noise must be from 0 to 1 m and 3.14 rad, each for a way of 1 m"):
        kinematic_drive("d", P3AT, TRUTH, RIMS, NO_NOISE, motion_noise=noise)
