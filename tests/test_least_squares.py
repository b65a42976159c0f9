import functools
from dataclasses import astuple, dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from noisy_drives import TRUE_NOISE, simulated
from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError
from skidsteer.identify.calibrate import calibrate
from skidsteer.identify.least_squares import OPPOSED, SUPPORTED, Fit, FitOptions, find_offset, fit, fit_supported
from skidsteer.identify.problem import Problem
from skidsteer.identify.unknowns import Unknowns
from skidsteer.models import Differential, Icr, ScheduledIcr, SymmetricIcr
from skidsteer.noise import Noise, Weights
from skidsteer.outliers import EPISODE
from skidsteer.samples import P3AT_LAG, P3AT_MOTION_NOISE, P3AT_TRUTH, on_ground, sample
from skidsteer.se2 import FloatArray, chain, compose, exp
from skidsteer.simulate import Sensors, controller, kinematic_drive, rims_from_manoeuvres
from skidsteer.terramechanics.dynamics import terramechanic_drive
from skidsteer.terramechanics.robot import robot
from skidsteer.terramechanics.terrain import terrain
from skidsteer.vehicle import preset
from skidsteer.windows import Mount, Timing, Windows, increment_windows, predict

P3AT = preset("pioneer-p3at")
SEEDS = 200
WALK, TURN = P3AT_MOTION_NOISE
NOISE = Noise(position=0.01, yaw=float(np.radians(0.5)), stamp=0.005, walk=WALK, turn=TURN)
SENSORS = Sensors(5.0, NOISE.position, NOISE.yaw, NOISE.stamp, encoder_step=1.0 / 138_000.0)
NAMES = ("icr_y_left", "icr_y_right", "icr_x", "alpha_left", "alpha_right", "lag", "time_offset")
# duration [s], v [m/s], omega [rad/s]: 69 s of straights, circles, turns on the spot, S-curves, forwards and backwards
MANOEUVRES = [
    *([1, 0, 0], [4, 0.5, 0], [5, 0, 0.8], [5, 0.5, 0.4], [5, 0.5, -0.4], [5, 0, -0.8], [4, -0.4, 0]),
    *([2, 0.4, 0.9], [2, 0.4, -0.9], [2, 0.6, 0.6], [2, 0.6, -0.6], [5, 0.3, 0.4], [5, 0.3, -0.4], [4, 0.6, 0]),
    *([3, 0, 1.2], [3, 0, -1.2], [4, -0.5, 0.4], [4, -0.5, -0.4], [3, 0.2, 0.2], [1, 0, 0]),
]
STRAIGHTS = [[1, 0, 0], [5, 0.5, 0], [1, 0, 0], [5, 0.3, 0], [1, 0, 0], [5, -0.5, 0], [2, 0, 0], [5, 0.6, 0], [1, 0, 0]]


def rims_of(manoeuvres: list[list[float]]) -> Series:
    return rims_from_manoeuvres(np.array(manoeuvres, dtype=float), Differential(P3AT.track_width))


RIMS = rims_of(MANOEUVRES)
START, DEFAULT = Icr.nominal(P3AT), FitOptions()


def offset_of(seed: int) -> float:
    return float(np.random.default_rng(10_000 + seed).uniform(-0.3, 0.3))


def drive_of(seed: int, name: str = "d", late: float | None = None) -> Drive:
    late = offset_of(seed) if late is None else late
    sensors = replace(SENSORS, reference_delay=late)
    return kinematic_drive(name, P3AT, P3AT_TRUTH, RIMS, sensors, P3AT_LAG, P3AT_MOTION_NOISE, seed)


def fit_of(drive: Drive, options: FitOptions = DEFAULT) -> Fit:
    return fit(START, [drive], [increment_windows(drive)], options)


def errors_of(found: Fit, late: float) -> tuple[FloatArray, FloatArray]:
    """Errors (7,) of ``NAMES`` and their reported covariance (7, 7)."""
    index = [found.names.index(name) for name in NAMES]
    truth = np.array([*P3AT_TRUTH.theta, P3AT_LAG, late])
    return found.values[index] - truth, found.covariance[np.ix_(index, index)]


def squared_distance(error: FloatArray, covariance: FloatArray) -> float:
    """NEES: 7 on average for errors that the covariance tells."""
    return float(error @ np.linalg.solve(covariance, error))


# Two hundred drives


@dataclass(frozen=True)
class Trials:
    """Fits of drives that differ in their noise and time offset only."""

    errors: FloatArray  # (n, 7)
    distances: FloatArray  # (n,)
    sigmas: FloatArray  # (n, 7)
    noises: FloatArray  # (n, 5) found over true
    converged: np.ndarray
    inflated: FloatArray


@functools.cache
def trials(count: int, options: FitOptions = DEFAULT) -> Trials:
    rows = []
    for seed in range(count):
        found = fit_of(drive_of(seed), options)
        error, covariance = errors_of(found, offset_of(seed))
        sigma, ratio = np.sqrt(np.diag(covariance)), np.array(astuple(found.noise)[:5]) / astuple(NOISE)[:5]
        rows.append((error, squared_distance(error, covariance), sigma, ratio, found.converged, found.inflated))
    return Trials(*(np.array(column) for column in zip(*rows, strict=True)))


@functools.cache
def cramer_rao() -> FloatArray:
    """Least covariance (7, 7) of any unbiased estimate: the Fisher information of all increments written out.

    Slopes are finite differences; the covariance is dense, with the pose that neighbours share, to first order.
    """
    ideal = replace(SENSORS, position_sigma=0.0, yaw_sigma=0.0, stamp_sigma=0.0)
    drive = kinematic_drive("ideal", P3AT, P3AT_TRUTH, RIMS, ideal, P3AT_LAG)
    windows = increment_windows(drive)
    k, h = len(windows), 1e-6

    def motions(x: FloatArray, w: Windows = windows) -> FloatArray:
        return predict(Icr(*x[:5]), RIMS, w, Timing(x[6], x[5]))

    truth = np.array([*P3AT_TRUTH.theta, P3AT_LAG, 0.0])
    slopes = [(motions(truth + h * e) - motions(truth - h * e)) / (2 * h) for e in np.eye(7)]
    t, short = np.r_[windows.start, windows.end[-1]], 1e-4
    around = Windows(t - short, t + short, np.zeros((k + 1, 3)), np.zeros(k + 1, bool))
    twist = motions(truth, around) / (2 * short)
    fixed = np.diag([NOISE.position**2, NOISE.position**2, NOISE.yaw**2])
    of_pose, by_pose, of_motion = (
        np.zeros((3 * k + 3, 3 * k + 3)),
        np.zeros((3 * k, 3 * k + 3)),
        np.zeros((3 * k, 3 * k)),
    )
    for i in range(k + 1):
        pose = slice(3 * i, 3 * i + 3)
        of_pose[pose, pose] = fixed + NOISE.stamp**2 * np.outer(twist[i], twist[i])
    rolled, apart = np.abs(RIMS.values[:-1]).mean(axis=1), 0.5 * np.abs(np.diff(RIMS.values[:-1], axis=1)[:, 0])
    paths = np.stack([rolled, rolled, 0.9 * apart + 0.1 * rolled]) * np.diff(RIMS.t)
    grown = np.array([np.interp(t, RIMS.t, np.r_[0.0, np.cumsum(path)]) for path in paths])
    for i, (x, y, yaw) in enumerate(motions(truth)):
        rows = slice(3 * i, 3 * i + 3)
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        by_pose[rows, rows] = -np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        by_pose[rows, 3 * i + 3 : 3 * i + 6] = turn
        growth = np.diag((grown[:, i + 1] - grown[:, i]) * [WALK**2, WALK**2, TURN**2])
        of_motion[rows, rows] = turn @ growth @ turn.T
    covariance = of_motion + by_pose @ of_pose @ by_pose.T
    J = np.stack([s.ravel() for s in slopes], axis=1)
    return np.asarray(np.linalg.inv(J.T @ np.linalg.solve(covariance, J)))


def test_estimates_are_unbiased() -> None:
    errors = trials(SEEDS).errors
    standard_error = errors.std(axis=0, ddof=1) / np.sqrt(SEEDS)
    assert (np.abs(errors.mean(axis=0)) < 3.0 * standard_error).all()


def test_errors_reach_the_cramer_rao_bound() -> None:
    rms = np.sqrt((trials(SEEDS).errors ** 2).mean(axis=0))
    ratio = rms / np.sqrt(np.diag(cramer_rao()))
    assert (ratio < 1.15).all()
    assert (ratio > 0.85).all()  # three standard errors: nothing beats it, or the bound is wrong


def test_errors_scatter_as_the_bound_says() -> None:
    """All seven together, correlations and all: the mean squared distance lies in its 95 % chi-square band."""
    distances = [squared_distance(e, cramer_rao()) for e in trials(SEEDS).errors]
    low, high = chi2.ppf([0.025, 0.975], 7 * SEEDS) / SEEDS
    assert low < np.mean(distances) < high


def test_reported_covariance_is_honest_when_the_noise_is_known() -> None:
    known = trials(SEEDS // 2, FitOptions(noise=NOISE))
    low, high = chi2.ppf([0.025, 0.975], 7 * SEEDS // 2) / (SEEDS // 2)
    assert low < known.distances.mean() < high
    assert_allclose(np.median(known.sigmas, axis=0), np.sqrt(np.diag(cramer_rao())), rtol=0.03)


def test_reported_covariance_is_honest_when_the_noise_is_estimated() -> None:
    low, high = chi2.ppf([0.025, 0.975], 7 * SEEDS) / SEEDS
    assert low < trials(SEEDS).distances.mean() < high
    ratio = np.median(trials(SEEDS).sigmas, axis=0) / np.sqrt(np.diag(cramer_rao()))
    assert_allclose(ratio, 1.0, atol=0.05)


def test_noise_is_found_with_the_parameters() -> None:
    """Restricted likelihood: what the parameters take up of the slow errors is given back to walk and turn."""
    ratio = trials(SEEDS).noises.mean(axis=0)
    assert_allclose(ratio[:2], 1.0, atol=0.02)
    assert_allclose(ratio[2:], 1.0, atol=0.06)


def test_every_fit_converges_and_none_is_inflated() -> None:
    """By chance the test of the covariance cries wolf in one fit of a thousand."""
    assert trials(SEEDS).converged.all()
    assert (trials(SEEDS).inflated > 1.0).sum() <= 2


def lasting_errors(seed: int) -> Drive:
    """Three minutes in which the ground changes every ten seconds, and with it both scale factors by 2 %."""
    rims, rng = rims_of(MANOEUVRES * 3), np.random.default_rng(seed)
    t = np.arange(0.05, rims.t[-1] - 0.05, 0.2)
    windows = Windows(t[:-1], t[1:], np.zeros((len(t) - 1, 3)), np.ones(len(t) - 1, bool))
    ground = (t[:-1] // 10.0).astype(int)
    scale = P3AT_TRUTH.theta[3:] * (1.0 + 0.02 * rng.standard_normal((ground.max() + 1, 2)))
    models = [replace(P3AT_TRUTH, alpha_left=a, alpha_right=b) for a, b in scale]
    motions = np.array([predict(m, rims, windows, Timing(0.0, P3AT_LAG)) for m in models])
    poses = chain(motions[ground, np.arange(len(ground))])
    noise = np.array([NOISE.position, NOISE.position, NOISE.yaw]) * rng.standard_normal(poses.shape)
    return Drive("d", P3AT, rims, pose=Series(t, compose(poses, exp(noise)), "pose"))


def test_errors_that_last_are_noticed_and_reported() -> None:
    """The noise model knows errors of each metre only; the scatter between stretches gives the honest sigma."""
    scores, reported, inflated = [], [], []
    for seed in range(10):
        found = fit_of(lasting_errors(seed))
        values, sigmas = zip(*(found.named(name) for name in ("alpha_left", "alpha_right")), strict=True)
        scores.append((np.array(values) - P3AT_TRUTH.theta[3:]) / sigmas)
        reported.append(sigmas)
        inflated.append(found.inflated)
    assert (np.array(inflated) > 2.0).mean() > 0.7
    # twenty grounds of 2 %, of which straights and turns tell different shares
    assert 0.02 / np.sqrt(20.0) * 0.6 < np.median(reported) < 0.02 / np.sqrt(20.0) * 2.0
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.7


# What is fixed


def test_fixed_timing_is_kept() -> None:
    drive = drive_of(1)
    found = fit_of(drive, FitOptions(time_offset=0.05, lag=0.02))
    assert found.timings == (Timing(0.05, 0.02),)
    assert found.named("time_offset") == (0.05, 0.0)
    assert found.named("lag") == (0.02, 0.0)
    assert not found.free[[found.names.index("time_offset"), found.names.index("lag")]].any()
    assert found.free[:5].all()
    right = fit_of(drive, FitOptions(time_offset=offset_of(1), lag=P3AT_LAG))
    assert right.deviance < found.deviance - 100.0
    assert right.deviance < fit_of(drive).deviance + 20.0


def test_a_known_lag_makes_the_offset_sharper() -> None:
    """Together, lag and time offset are told apart only by what the lag does to changes of speed."""
    drive = drive_of(2)
    both, one = fit_of(drive), fit_of(drive, FitOptions(lag=P3AT_LAG))
    assert one.named("time_offset")[1] < 0.3 * both.named("time_offset")[1]
    assert abs(one.named("time_offset")[0] - offset_of(2)) < 4.0 * one.named("time_offset")[1]
    i, j = (both.names.index(name) for name in ("lag", "time_offset"))
    assert both.covariance[i, j] < -0.9 * np.sqrt(both.covariance[i, i] * both.covariance[j, j])


def test_a_fixed_model_is_kept() -> None:
    found = fit(P3AT_TRUTH, [drive_of(3)], [increment_windows(drive_of(3))], FitOptions(fix_model=True, lag=P3AT_LAG))
    assert found.model == P3AT_TRUTH
    assert abs(found.named("time_offset")[0] - offset_of(3)) < 4.0 * found.named("time_offset")[1]
    assert_array_equal(np.diag(found.covariance)[:5], 0.0)


def test_fixed_noise_is_kept() -> None:
    assert fit_of(drive_of(4), FitOptions(noise=NOISE)).noise == NOISE


def test_what_was_known_before_weighs_against_poor_data() -> None:
    """With a noise said to be 150 times as large, estimates lie between start and truth as their covariances say."""
    drive, free = drive_of(8), slice(0, 5)
    timing = {"time_offset": offset_of(8), "lag": P3AT_LAG, "robust": False}
    loud = Noise(*(150.0 * v for v in astuple(NOISE)))
    sharp = fit_of(drive, FitOptions(noise=NOISE, **timing))
    poor = fit_of(drive, FitOptions(noise=loud, **timing))
    prior = np.diag(1.0 / poor.prior_sigma[free] ** 2)
    pull = poor.covariance[free, free] @ prior @ (START.theta - sharp.values[free])
    assert np.abs(pull).max() > 0.02
    assert_allclose(poor.values[free] - sharp.values[free], pull, atol=0.25 * np.abs(pull).max())
    information = np.linalg.inv(sharp.covariance[free, free]) / 150.0**2
    assert_allclose(np.linalg.inv(poor.covariance[free, free]), information + prior, rtol=0.2, atol=3.0)


def test_the_same_drive_gives_the_same_fit() -> None:
    a, b = fit_of(drive_of(5)), fit_of(drive_of(5))
    assert_array_equal(a.values, b.values)
    assert_array_equal(a.covariance, b.covariance)


def test_the_start_does_not_matter() -> None:
    drive = drive_of(6)
    far = fit(Icr(0.5, -0.7, 0.2, 1.2, 0.7), [drive], [increment_windows(drive)])
    near = fit(P3AT_TRUTH, [drive], [increment_windows(drive)])
    sigma = np.sqrt(np.diag(near.covariance))
    assert (np.abs(far.values - near.values) <= 0.1 * sigma).all()


def test_find_offset_comes_within_its_grid() -> None:
    for seed in range(5):
        drive = drive_of(seed)
        found = find_offset(START, drive, increment_windows(drive), (-1.0, 1.5))
        assert abs(found - offset_of(seed) - P3AT_LAG) < 0.08  # the lag looks like a delay


def test_estimates_shrink_with_more_data() -> None:
    drive = drive_of(7)
    half = drive.between(0.0, 35.0)
    whole, part = fit_of(drive), fit_of(half)
    assert (np.diag(whole.covariance)[:5] < np.diag(part.covariance)[:5]).all()


def test_no_windows_are_refused() -> None:
    windows = increment_windows(drive_of(0)).where(np.zeros(len(increment_windows(drive_of(0))), bool))
    with pytest.raises(DataError, match=r"^d: wheels and reference share no stretch of time; check their clocks$"):
        fit(START, [drive_of(0)], [windows])


# Several drives


def test_two_drives_share_the_model_but_not_the_offset() -> None:
    drives = [drive_of(11, "a", late=0.25), drive_of(12, "b", late=-0.2)]
    windows = [increment_windows(d) for d in drives]
    both = fit(START, drives, windows)
    assert [t.lag for t in both.timings] == [both.named("lag")[0]] * 2
    for name, late, timing in (("a", 0.25, both.timings[0]), ("b", -0.2, both.timings[1])):
        value, sigma = both.named(f"time_offset:{name}")
        assert timing.time_offset == value
        assert abs(value - late) < 4.0 * sigma < 0.1
    assert (np.abs(both.values[:5] - P3AT_TRUTH.theta) < 4.0 * np.sqrt(np.diag(both.covariance)[:5])).all()
    # twice the information about all that is shared: sigmas smaller by the root of two
    alone = np.mean([np.linalg.inv(fit_of(d).covariance[:5, :5]) for d in drives], axis=0)
    ratio = np.sqrt(np.diag(both.covariance)[:5] / np.diag(np.linalg.inv(alone)))
    assert_allclose(ratio, np.sqrt(0.5), rtol=0.15)


def test_the_order_of_drives_does_not_matter() -> None:
    drives = [drive_of(13, "a"), drive_of(14, "b")]
    windows = [increment_windows(d) for d in drives]
    one, other = fit(START, drives, windows), fit(START, drives[::-1], windows[::-1])
    for name in (*NAMES[:6], "time_offset:a", "time_offset:b"):
        assert abs(one.named(name)[0] - other.named(name)[0]) < 0.02 * one.named(name)[1]


# A gyro, a sensor beside the origin, positions alone


def with_gyro(drive: Drive, late: float, bias: float, scale: float, seed: int) -> Drive:
    """At 200 Hz, of the turn without motion noise, wrong by ``GyroErrors`` and 5 mrad/s of white noise a sample."""
    t = np.arange(0.5, 68.0, 0.005)
    around = Windows(t - 0.001, t + 0.001, np.zeros((len(t), 3)), np.zeros(len(t), bool))
    rate = predict(P3AT_TRUTH, RIMS, around, Timing(0.0, P3AT_LAG))[:, 2] / 0.002
    noise = 5e-3 * np.random.default_rng(seed).standard_normal(len(t))
    return replace(drive, gyro=Series(t + late, rate / scale + bias + noise, "gyro"))


def test_a_gyro_is_estimated_with_the_model() -> None:
    scores = []
    for seed in range(5):
        ideal = kinematic_drive("d", P3AT, P3AT_TRUTH, RIMS, SENSORS, P3AT_LAG, (WALK, 1e-6), seed)
        drive = with_gyro(ideal, late=0.12, bias=0.01, scale=0.99, seed=seed)
        found = fit_of(drive)
        truth = {"gyro_time_offset": 0.12, "gyro_bias": 0.01, "gyro_scale": 0.99}
        truth |= dict(zip(NAMES, [*P3AT_TRUTH.theta, P3AT_LAG, 0.0], strict=True))
        scores.append([(found.named(name)[0] - value) / found.named(name)[1] for name, value in truth.items()])
        assert found.converged
        assert found.noise.gyro == pytest.approx(5e-3 * np.sqrt(0.005), rel=0.3)
        assert found.named("lag")[1] < 0.003  # from the poses alone 0.017
    assert np.abs(scores).max() < 4.5
    assert np.sqrt(np.mean(np.square(scores))) < 1.5
    without = fit_of(drive, FitOptions(use_gyro=False))
    assert_array_equal(without.values[:6], fit_of(ideal).values[:6])


def test_the_place_of_the_sensor_is_found_with_a_symmetric_model() -> None:
    truth, place = SymmetricIcr(0.28, 0.92), [0.25, -0.15, 0.0]
    drive = kinematic_drive("d", P3AT, truth, RIMS, SENSORS, P3AT_LAG, P3AT_MOTION_NOISE, 3)
    poses = pose_of(drive)
    antenna = Series(poses.t, compose(poses.values, place)[:, :2], "position")
    expected = {"icr_y": 0.28, "alpha": 0.92, "lag": P3AT_LAG, "time_offset": 0.0, "mount_x": 0.25, "mount_y": -0.15}
    for seen in (
        replace(drive, pose=Series(poses.t, compose(poses.values, place), "pose")),
        replace(drive, pose=None, position=antenna),
    ):
        start = SymmetricIcr.nominal(P3AT)
        found = fit(start, [seen], [increment_windows(seen)], FitOptions(mount=None))
        for name, value in expected.items():
            estimate, sigma = found.named(name)
            assert abs(estimate - value) < 4.5 * sigma < 0.2
        assert (found.mount.x, found.mount.y) == (found.named("mount_x")[0], found.named("mount_y")[0])
        told = fit(start, [seen], [increment_windows(seen)], FitOptions(mount=Mount(*place)))
        assert told.mount == Mount(*place)
        assert abs(told.named("icr_y")[0] - 0.28) < 4.5 * told.named("icr_y")[1] < 0.05


# Outliers


def test_gross_outliers_do_not_bias() -> None:
    """One reference pose in twenty is anywhere within a metre and a radian: errors stay what the sigmas say."""
    scores, distances = [], []
    for seed in range(12):
        drive, rng = drive_of(seed), np.random.default_rng(seed)
        assert drive.pose is not None
        values = drive.pose.values.copy()
        wrong = rng.uniform(size=len(values)) < 0.05
        values[wrong] = compose(values[wrong], rng.uniform(-1.0, 1.0, (wrong.sum(), 3)))
        drive = replace(drive, pose=Series(drive.pose.t, values))
        found = fit_of(drive)
        error, covariance = errors_of(found, offset_of(seed))
        scores.append(error / np.sqrt(np.diag(covariance)))
        distances.append(squared_distance(error, covariance))
        spoiled = np.isin(increment_windows(drive).end, drive.pose.t[wrong])
        marked = found.weights[0].end < 0.5
        assert marked[spoiled].mean() > 0.75
        assert marked[~spoiled].mean() < 0.1
    assert (np.abs(np.mean(scores, axis=0)) < 1.0).all()  # and so far from 2 sigma
    assert (np.abs(scores) < 4.5).all()
    assert np.mean(distances) < 2.0 * 7.0
    assert np.sqrt(np.mean(np.square(scores), axis=0)).max() < 2.0


def test_jumps_of_the_reference_do_not_bias() -> None:
    scores = []
    for seed in range(6):
        drive = drive_of(seed)
        assert drive.pose is not None
        values = drive.pose.values.copy()
        for first in (len(values) // 4, len(values) // 2, 3 * len(values) // 4):
            values[first:] = compose([0.5, -0.3, 0.4], values[first:])
        found = fit_of(replace(drive, pose=Series(drive.pose.t, values)))
        error, covariance = errors_of(found, offset_of(seed))
        scores.append(error / np.sqrt(np.diag(covariance)))
        assert (np.abs(error[:5]) < 0.01).all()
    assert (np.abs(scores) < 4.0).all()


def test_without_robustness_outliers_do_harm() -> None:
    """The test above would see it."""
    drive, rng = drive_of(0), np.random.default_rng(0)
    assert drive.pose is not None
    values = drive.pose.values.copy()
    wrong = rng.uniform(size=len(values)) < 0.05
    values[wrong] = compose(values[wrong], rng.uniform(-1.0, 1.0, (wrong.sum(), 3)))
    found = fit_of(replace(drive, pose=Series(drive.pose.t, values)), FitOptions(robust=False))
    assert (found.weights[0].end == 1.0).all()
    assert found.noise.position > 0.1


# Calibration: what a drive does not tell, and what is refused


def test_straights_alone_do_not_tell_the_icrs() -> None:
    truth = SymmetricIcr(0.28, 0.92)
    drive = kinematic_drive("straight", P3AT, truth, rims_of(STRAIGHTS), SENSORS, P3AT_LAG, P3AT_MOTION_NOISE, 1)
    calibration = calibrate(drive, "icr")
    determined = {name: e.determined for name, e in calibration.parameters.items()}
    assert determined == {
        "icr_y_left": False,
        "icr_y_right": False,
        "icr_x": False,
        "alpha_left": True,
        "alpha_right": True,
    }
    assert any(
        w.startswith("not determined by this drive: icr_y_left, icr_y_right, icr_x") for w in calibration.warnings
    )
    for name in ("alpha_left", "alpha_right"):
        estimate = calibration.parameters[name]
        assert abs(estimate.value - 0.92) < 4.0 * estimate.sigma < 0.02


def test_a_varied_drive_tells_everything() -> None:
    calibration = calibrate(drive_of(20), "icr")
    assert all(e.determined for e in calibration.estimates.values())
    truth = dict(zip(NAMES, [*P3AT_TRUTH.theta, P3AT_LAG, offset_of(20)], strict=True))
    for name, value in truth.items():
        estimate = calibration.estimates[name]
        assert abs(estimate.value - value) < 4.0 * estimate.sigma
    assert calibration.estimates["icr_y_left"].unit == "m"
    assert calibration.estimates["lag"].unit == "s"


def test_calibrate_takes_two_drives() -> None:
    calibration = calibrate([drive_of(21, "a", late=0.3), drive_of(22, "b", late=-0.1)], "icr")
    assert calibration.estimates["time_offset:a"].value == pytest.approx(0.3, abs=0.05)
    assert calibration.estimates["time_offset:b"].value == pytest.approx(-0.1, abs=0.05)
    middle = np.mean([calibration.estimates[f"time_offset:{name}"].value for name in "ab"])
    assert calibration.timing == Timing(float(middle), calibration.estimates["lag"].value)
    assert [r.name for r in calibration.provenance.drives] == ["a", "b"]


def still(seconds: float) -> Series:
    t = np.arange(0.0, seconds, 0.05)
    return Series(t, np.zeros((len(t), 2)), "wheels")


def pose_of(drive: Drive) -> Series:
    assert drive.pose is not None
    return drive.pose


@pytest.mark.parametrize(
    ("drive", "message"),
    [
        (replace(drive_of(0), pose=None), r"^d: has no reference; "),
        (
            replace(drive_of(0, late=0.0), pose=Series(pose_of(drive_of(0)).t + 500.0, pose_of(drive_of(0)).values)),
            r"^d: wheels \(0\.0 to 69\.0 s\) and .* \(5\d\d\.\d to 56\d\.\d s\) share no time .* onto one clock$",
        ),
        (
            replace(drive_of(0), wheels=still(69.0)),
            r"^d: the robot stands still \(the wheels moved by 0\.00 m in all\); record a drive with straights",
        ),
        (
            replace(drive_of(0), pose=Series(np.arange(0.0, 60.0, 0.2), np.zeros((300, 3)), "pose")),
            r"^d: the robot stands still \(the reference moved by 0\.00 m in all\)",
        ),
        (drive_of(0, late=0.0).between(1.0, 4.0), r"^d: only [23]\.\d s of reference; at least 4 s needed$"),
    ],
)
def test_calibrate_refuses(drive: Drive, message: str) -> None:
    with pytest.raises(DataError, match=message):
        calibrate(drive)


# Drives that no constant ICR describes


def test_a_short_drive_that_no_constant_describes_is_known_less_well() -> None:
    """96 s are too short for enough stretches of 10 s; straights and curves on simulated gravel part all the same."""
    made = robot(preset("warthog"))
    rows = [[1.0, 0.0, 0.0]]
    for v in (0.1, 0.2, 0.3):
        rows += [[5.0, v, side * rate] for rate in (0.3, 0.6) for side in (1.0, -1.0)]
        rows += [[3.0, v, 0.0], [2.0, -v, 0.0], [3.0, 0.0, 0.6], [3.0, 0.0, -0.6]]
    commands = rims_from_manoeuvres(np.array(rows), controller(made.vehicle), acceleration=1.0)
    sensors = Sensors(10.0, 0.005, float(np.radians(0.2)), encoder_rate=50.0, gyro_rate=50.0)
    drive = terramechanic_drive("gravel", made, terrain("gravel"), commands, sensors)
    windows = increment_windows(drive)
    found = fit(Icr.nominal(made.vehicle), [drive], [windows])
    assert EPISODE <= found.block < 10.0
    assert found.inflated > 2.0
    alone = fit(Icr.nominal(made.vehicle), [drive], [windows.where(windows.end < 30.0)])
    assert alone.block == EPISODE
    assert alone.inflated == 1.0  # 14 stretches of 2 s say nothing


def test_stretches_are_of_ten_seconds_where_the_drive_has_enough_of_them() -> None:
    long = sample("p3at-mandow")
    assert fit(Icr.nominal(long.vehicle), [long], [increment_windows(long)]).block == 10.0


def test_a_term_that_stands_at_its_bound_is_left_out() -> None:
    """Slow on simulated grass, a load gain makes up for the straight gain held back: 0.5 is all it may be."""
    drive = on_ground("pioneer-p3at", "grass", (0.2, 0.3, 0.4), (0.3, 0.6))
    model, windows = ScheduledIcr.nominal(drive.vehicle), increment_windows(drive)
    without = replace(DEFAULT, without=("straight_gain",))
    value, sigma = fit(model, [drive], [windows], without).named("load_gain")
    assert value == 0.5
    assert sigma < 0.2  # by its sigma alone it would be kept
    kept = fit_supported(model, [drive], [windows], without)
    assert kept.named("load_gain") == (0.0, 0.0)
    assert all(kept.named(name)[1] > 0.0 for name in ("turn_loss", "side_slip"))


def test_slow_drives_by_the_forces_show_that_icrs_move_inwards_on_straighter_paths() -> None:
    """Wang 2015, 5.3, by a plant that knows no such term, at no more than 0.4 m/s."""
    drive = sample("p3at-lab")
    found = fit_supported(ScheduledIcr.nominal(drive.vehicle), [drive], [increment_windows(drive)])
    value, sigma = found.named("straight_gain")
    assert 0.1 < value < 0.3
    assert value > 5.0 * sigma


JACKAL = preset("jackal")
FAST = [[1, 0, 0], *([4, v, s * w] for v in (0.5, 1.0, 1.6) for w in (0.4, 0.9, 1.4) for s in (1, -1)), [4, 1.5, 0]]


def with_load_gain(load_gain: float, seed: int) -> Drive:
    """105 s of curves of up to 2.2 m/s^2 both ways, turns on the spot and straights."""
    model = ScheduledIcr(0.27, -0.27, -0.02, 0.97, 0.97, 0.05, 0.2, 0.05, load_gain, 0.0)
    rows = np.array([*FAST, [4, -1, 0], [5, 0, 1.2], [5, 0, -1.2], [1, 0, 0]], dtype=float)
    rims = rims_from_manoeuvres(rows, Differential(1.4 * JACKAL.track_width))
    return kinematic_drive("fast", JACKAL, model, rims, Sensors(10.0, 0.01, 0.01), 0.1, (0.02, 0.03), seed)


def test_a_load_loss_is_found() -> None:
    drive = with_load_gain(-0.8, 0)
    value, sigma = fit_supported(ScheduledIcr.nominal(JACKAL), [drive], [increment_windows(drive)]).named("load_gain")
    assert abs(value + 0.8) < 3.0 * sigma
    assert sigma < 0.1


def test_a_term_below_nominal_needs_more_support_than_one_above() -> None:
    drive = with_load_gain(-0.1, 1)
    start, windows = ScheduledIcr.nominal(JACKAL), [increment_windows(drive)]
    value, sigma = fit(start, [drive], windows).named("load_gain")
    assert -OPPOSED < value / sigma < -SUPPORTED
    assert fit_supported(start, [drive], windows).named("load_gain") == (0.0, 0.0)


def test_the_search_ends_where_no_step_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stamps that scatter make the covariances depend on the model: the likelihood that they are a part of once stopped
    the search two sigmas too early."""
    last: list[tuple[Problem, Unknowns, Noise, list[Weights]]] = []
    search = Problem.gauss_newton

    def watched(
        self: Problem, state: Unknowns, noise: Noise, weights: list[Weights], tolerance: float
    ) -> tuple[Unknowns, float, int]:
        found = search(self, state, noise, weights, tolerance)
        last[:] = [(self, found[0], noise, weights)]
        return found

    monkeypatch.setattr(Problem, "gauss_newton", watched)
    drive = simulated(replace(TRUE_NOISE, stamp=0.4), 0)
    fit(ScheduledIcr.nominal(P3AT), [drive], [increment_windows(drive)])
    ((problem, state, noise, weights),) = last
    H, scores, _ = problem.information(state, noise, weights)
    free, x = problem.free, state.x[problem.free]
    prior = 1.0 / problem.prior[free] ** 2
    gradient = scores.sum(axis=0) - prior * (x - problem.start.x[free])
    low, high = problem.limits[free].T
    inside = ~((x <= low) & (gradient < 0.0)) & ~((x >= high) & (gradient > 0.0))
    covariance = np.linalg.inv((H + np.diag(prior))[np.ix_(inside, inside)])
    assert (np.abs(covariance @ gradient[inside]) < 0.01 * np.sqrt(np.diag(covariance))).all()
