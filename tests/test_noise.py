import functools
from dataclasses import astuple, fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from skidsteer.drive import Drive, Series
from skidsteer.models import Differential, Icr
from skidsteer.noise import BOUNDS, Noise, Residuals, Weights, deviance, fit_noise, residuals, reweigh
from skidsteer.se2 import FloatArray, between, compose
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import preset
from skidsteer.windows import Sees, Timing, Windows, increment_windows, predict, steps

P3AT = preset("pioneer-p3at")
TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)
LAG = Timing(0.0, 0.08)
TRUE_NOISE = Noise(position=0.01, yaw=0.009, stamp=0.02, walk=0.02, turn=0.03)


def simulated(noise: Noise, seed: int) -> Drive:
    """Four minutes of straights, turns and stops, at 5 Hz."""
    rows = [[2.0, 0.0, 0.0], [8.0, 0.5, 0.0], [6.0, 0.0, 0.8], [8.0, 0.5, 0.3], [8.0, 0.6, -0.3], [6.0, -0.4, 0.0]]
    rims = rims_from_manoeuvres(np.array([*rows, [6.0, 0.0, -0.8], *rows[::-1]] * 3), Differential(P3AT.track_width))
    sensors = Sensors(5.0, noise.position, noise.yaw, noise.stamp)
    return kinematic_drive("d", P3AT, TRUTH, rims, sensors, LAG.lag, (noise.walk, noise.turn), seed)


def residuals_of(drive: Drive) -> Residuals:
    windows = increment_windows(drive)
    cut = steps(drive.wheels, windows, LAG)
    return residuals(TRUTH, windows, cut, predict(TRUTH, drive.wheels, windows, LAG))


@functools.cache
def true_residuals(seed: int) -> Residuals:
    return residuals_of(simulated(TRUE_NOISE, seed))


def ratios(noise: Noise) -> FloatArray:
    """Over the truth, of all but the gyro's."""
    return np.array(astuple(noise)[:5]) / astuple(TRUE_NOISE)[:5]


def ones(part: Residuals) -> Weights:
    return Weights.ones(len(part.residual))


# Noise and covariances


@pytest.mark.parametrize("name", [f.name for f in fields(Noise)])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_noise_must_be_positive(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"^noise {name} must be positive, got {value}$"):
        Noise(**{name: value})


def some_residuals(joined: bool = False, sees: Sees = "pose") -> Residuals:
    """Two windows, the first a left turn forwards, the second backwards."""
    motion = np.array([[0.4, 0.1, 0.5], [-0.3, 0.05, -0.2]])
    windows = Windows(np.array([0.0, 1.0]), np.array([1.0, 2.0]), motion, np.array([False, joined]), sees)
    residual = np.array([[0.01, -0.02, 0.03], [0.02, 0.01, -0.01]])
    start = np.array([[0.4, 0.1, 0.5], [0.0, 0.0, 0.0]])
    end = np.array([[0.5, -0.2, 0.6], [-0.3, 0.1, -0.2]])
    gyro, gyro_time = np.array([0.02, 0.0]), np.array([0.9, np.inf])
    return Residuals(windows, residual, np.array([[0.5, 0.5, 0.3], [0.25, 0.25, 0.1]]), start, end, gyro, gyro_time)


WEIGHTS = Weights(np.array([1.0, 0.5]), np.array([0.25, 1.0]), np.array([0.5, 1.0]))


def test_covariances_by_hand() -> None:
    noise = Noise(position=0.01, yaw=0.02, stamp=0.1, walk=0.04, turn=0.08)
    process, start, end = some_residuals().covariances(noise, WEIGHTS)
    # motion: variance a metre times 0.5 m (yaw: 0.3 m), doubled by its weight of a half; 0.25 m (0.1 m)
    assert_allclose(process, [[16e-4, 16e-4, 38.4e-4], [4e-4, 4e-4, 6.4e-4]])
    # stamps of 0.1 s at (0.4, 0.1, 0.5): outer product of (0.04, 0.01, 0.05)
    moved = np.array([[16e-4, 4e-4, 20e-4], [4e-4, 1e-4, 5e-4], [20e-4, 5e-4, 25e-4]])
    fixed = np.diag([1e-4, 1e-4, 4e-4])
    assert_allclose(start, [fixed + moved, 2.0 * fixed], atol=1e-16)
    moved = np.array([[25e-4, -10e-4, 30e-4], [-10e-4, 4e-4, -12e-4], [30e-4, -12e-4, 36e-4]])
    assert_allclose(end[0], 4.0 * (fixed + moved), atol=1e-16)
    moved = np.array([[9e-4, -3e-4, 6e-4], [-3e-4, 1e-4, -2e-4], [6e-4, -2e-4, 4e-4]])
    assert_allclose(end[1], fixed + moved, atol=1e-16)


def test_what_the_reference_does_not_see_weighs_nothing() -> None:
    """Positions without heading tell no yaw; a gyro alone tells neither. The stamps stay."""
    noise = Noise(position=0.01, yaw=0.02, stamp=0.1, walk=0.04, turn=0.08)
    pose, position, turn = (some_residuals(sees=s).covariances(noise, WEIGHTS) for s in ("pose", "position", "turn"))
    assert_array_equal(position[0], pose[0])
    for i, weight in ((1, WEIGHTS.start), (2, WEIGHTS.end)):
        hidden = (position[i] - pose[i]) * weight[:, None, None]
        assert_allclose(hidden[:, :2], 0.0, atol=1e-12)
        assert (hidden[:, 2, 2] > 1.0).all()
        hidden = (turn[i] - position[i]) * weight[:, None, None]
        assert (np.minimum(hidden[:, 0, 0], hidden[:, 1, 1]) > 1e3).all()


def test_residuals_by_hand() -> None:
    wheels = Series(np.arange(4.0), np.array([[0.2, 0.4], [-0.2, 0.6], [0.5, 0.5], [0.0, 0.0]]))
    motion = np.array([[1.0, 2.0, 3.1], [0.5, 0.0, 0.0]])
    windows = Windows(np.array([0.5, 1.5]), np.array([1.5, 3.0]), motion, np.array([False, True]))
    model = Icr(0.5, -0.5, 0.1, 1.0, 1.0)
    part = residuals(model, windows, steps(wheels, windows, Timing()), np.array([[0.9, 2.2, -3.1], [0.4, 0.1, 0.2]]))
    assert_allclose(part.residual, [[0.1, -0.2, 6.2 - 2 * np.pi], [0.1, -0.1, -0.2]], atol=1e-15)
    # mean of the rims, whichever way they turn: 0.5 s at 0.3 and 0.5 s at 0.4; 0.5 s at 0.4 and 1 s at 0.5
    # of the yaw: 0.5 s at 0.1 apart and a tenth of 0.2, 0.5 s at 0.4 apart; the same, and 1 s at a tenth of 0.5
    assert_allclose(part.paths, [[0.35, 0.35, 0.26], [0.7, 0.7, 0.25]], atol=1e-15)
    assert_allclose(part.start_twist, [[0.3, -0.02, 0.2], [0.2, -0.08, 0.8]], atol=1e-15)
    assert_allclose(part.end_twist, [[0.2, -0.08, 0.8], [0.0, 0.0, 0.0]], atol=1e-15)
    assert_array_equal(part.windows.motion, motion)
    assert_array_equal(part.gyro, [0.0, 0.0])
    assert_array_equal(part.gyro_time, [np.inf, np.inf])


def test_residuals_of_a_gyro_by_hand() -> None:
    wheels = Series(np.arange(4.0), np.zeros((4, 2)))
    windows = Windows(np.array([0.5, 1.0]), np.array([0.9, 3.0]), np.zeros((2, 3)), np.zeros(2, bool))
    predicted = np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 7.0]])
    cut = steps(wheels, windows, Timing())
    part = residuals(TRUTH, windows, cut, predicted, np.array([0.5, 6.9]))
    assert_allclose(part.gyro, [0.2, -0.1], atol=1e-15)  # whole turns count: nothing is wrapped
    assert_allclose(part.gyro_time, [0.4, 2.0])
    part = residuals(TRUTH, windows, cut, predicted, np.array([np.nan, 6.9]))
    assert_allclose(part.gyro, [0.0, -0.1], atol=1e-15)
    assert_array_equal(part.gyro_time, [np.inf, 2.0])


def test_deviance_is_the_normal_density() -> None:
    part, noise = some_residuals(), Noise(0.01, 0.02, 0.03, 0.04, 0.08, 0.05)
    process, start, end = part.covariances(noise, WEIGHTS)
    expected = 0.0
    for i, (x, y, yaw) in enumerate(part.windows.motion):
        E = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        G = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        C = np.zeros((4, 4))
        C[:3, :3] = E @ (np.diag(process[i]) + end[i]) @ E.T + G @ start[i] @ G.T
        # the gyro sees the turn's error too, and adds its own
        C[2, 3] = C[3, 2] = process[i, 2]
        C[3, 3] = process[i, 2] + 0.05**2 * 0.9
        measured = np.r_[part.residual[i], part.gyro[i]]
        if i == 1:  # it is silent
            C, measured = C[:3, :3], measured[:3]
        expected += np.linalg.slogdet(C)[1] + measured @ np.linalg.solve(C, measured)
    assert deviance([part], noise, [WEIGHTS]) == pytest.approx(expected, rel=1e-12)
    assert deviance([part, part], noise, [WEIGHTS] * 2) == pytest.approx(2 * expected, rel=1e-12)
    assert deviance([some_residuals(joined=True)], noise, [WEIGHTS]) != pytest.approx(expected, rel=1e-3)


# Maximum likelihood


def test_residuals_of_the_truth_are_as_large_as_the_noise_says() -> None:
    """Chi-square: the deviance at the true noise, less that of zero residuals, is 3 a window on average."""
    part = true_residuals(0)
    quiet = replace(part, residual=np.zeros_like(part.residual))
    excess = [deviance([p], TRUE_NOISE, [ones(p)]) for p in (part, quiet)]
    count = 3 * len(part.residual)
    assert (excess[0] - excess[1]) / count == pytest.approx(1.0, abs=4 * np.sqrt(2 / count))


def test_fit_noise_recovers_what_was_simulated() -> None:
    """To their standard errors: 1.5 % of the position, 3 to 6 % of the others, for one drive."""
    seeds = range(5)
    ratio = np.array([ratios(fit_noise([p], Noise(), [ones(p)])) for p in map(true_residuals, seeds)])
    assert_allclose(ratio, 1.0, atol=0.2)
    assert_allclose(ratio[:, 0], 1.0, atol=0.06)
    assert_allclose(ratio.mean(axis=0), 1.0, atol=0.06)


def test_fit_noise_finds_the_least_deviance() -> None:
    part = true_residuals(1)
    found = fit_noise([part], Noise(), [ones(part)])
    least = deviance([part], found, [ones(part)])
    for name in ("position", "yaw", "stamp", "walk", "turn"):
        for factor in (0.9, 1.1):
            other = replace(found, **{name: factor * getattr(found, name)})
            assert deviance([part], other, [ones(part)]) > least


def test_fit_noise_joins_drives() -> None:
    parts = [true_residuals(seed) for seed in (2, 3, 4)]
    found = fit_noise(parts, Noise(), [ones(p) for p in parts])
    assert_allclose(ratios(found), 1.0, atol=0.1)


def test_fit_noise_of_a_perfect_drive_stays_at_its_bounds() -> None:
    part = replace(true_residuals(0), residual=np.zeros_like(true_residuals(0).residual))
    found = fit_noise([part], Noise(), [ones(part)])
    assert_allclose(astuple(found)[:5], astuple(BOUNDS[0])[:5], rtol=1e-6)
    assert found.gyro == pytest.approx(Noise().gyro)  # there is none


def test_fit_noise_recovers_that_of_a_gyro() -> None:
    """The gyro tells the turn that was driven, motion noise and all."""
    drive = simulated(TRUE_NOISE, 0)
    truth = simulated(replace(TRUE_NOISE, position=1e-12, yaw=1e-12, stamp=1e-12), 0)
    assert truth.pose is not None
    part = residuals_of(drive)
    rng, count = np.random.default_rng(0), len(part.residual)
    assert count == len(truth.pose) - 1
    turned = residuals_of(truth).residual[:, 2] + 0.02 * np.sqrt(0.2) * rng.standard_normal(count)
    part = replace(part, gyro=turned, gyro_time=np.full(count, 0.2))
    found = fit_noise([part], Noise(), [ones(part)])
    assert found.gyro == pytest.approx(0.02, rel=0.1)
    assert_allclose(ratios(found), 1.0, atol=0.2)


def test_fit_noise_ignores_what_is_weighed_down() -> None:
    part = true_residuals(0)
    wrong = part.residual.copy()
    wrong[100:104] += [0.5, -0.4, 0.3]
    weights = ones(part)
    weights.motion[100:104] = 1e-6
    spoiled = fit_noise([replace(part, residual=wrong)], Noise(), [ones(part)])
    assert spoiled.walk > 2.0 * TRUE_NOISE.walk
    healed = fit_noise([replace(part, residual=wrong)], Noise(), [weights])
    assert_allclose(ratios(healed), 1.0, atol=0.2)


def test_fit_noise_takes_the_middle_of_a_long_drive() -> None:
    part = true_residuals(0)
    count = len(part.residual)
    wrong = part.residual.copy()
    wrong[: count // 2 - 300] = wrong[count // 2 + 300 :] = 0.7
    found = fit_noise([replace(part, residual=wrong)], Noise(), [ones(part)], most=500)
    assert_allclose(ratios(found), 1.0, atol=0.35)


# Outliers


def spoiled(change: FloatArray, first: int, last: int, globally: bool = False) -> Residuals:
    """Residuals of a drive whose reference poses first..last - 1 are wrong by a motion."""
    drive = simulated(TRUE_NOISE, 7)
    assert drive.pose is not None
    values = drive.pose.values.copy()
    values[first:last] = compose(change, values[first:last]) if globally else compose(values[first:last], change)
    return residuals_of(replace(drive, pose=Series(drive.pose.t, values)))


@pytest.mark.parametrize("change", [[0.4, 0.0, 0.0], [0.0, -0.4, 0.0], [0.0, 0.0, 0.4], [0.3, 0.3, -0.3]])
def test_a_single_wrong_pose_is_an_outlier_of_the_pose(change: list[float]) -> None:
    weights = reweigh([spoiled(np.array(change), 300, 301)], TRUE_NOISE)[0]
    assert weights.end[299] < 0.05  # window 299 ends with pose 300
    # its neighbours share the blame a little; nothing else does, and nothing as much
    far = np.abs(np.arange(len(weights.end)) - 299) > 4
    assert (weights.end[far] > 0.5).all()
    assert (weights.motion[far] > 0.5).all()
    assert np.delete(weights.end, 299).min() > 3.0 * weights.end[299]
    assert weights.motion.min() > 3.0 * weights.end[299]
    assert (weights.start == 1.0).all()


@pytest.mark.parametrize("change", [[0.8, 0.0, 0.0], [0.0, -0.8, 0.0], [0.1, 0.1, 0.1]])
def test_a_jump_of_the_reference_is_an_outlier_of_the_motion(change: list[float]) -> None:
    weights = reweigh([spoiled(np.array(change), 301, 10**6, globally=True)], TRUE_NOISE)[0]
    assert weights.motion[300] < 0.1  # window 300 leads from pose 300 to pose 301
    assert np.argmin(weights.motion) == 300
    assert weights.end.min() > weights.motion[300]
    far = np.abs(np.arange(len(weights.motion)) - 300) > 20
    assert (weights.motion[far] > 0.5).all()
    assert (weights.end[far] > 0.5).all()


def test_a_wrong_first_pose_is_found() -> None:
    weights = reweigh([spoiled(np.array([0.4, 0.0, 0.0]), 0, 1)], TRUE_NOISE)[0]
    assert weights.start[0] < 0.05
    assert (weights.start[1:] == 1.0).all()
    assert (weights.end > 0.5).all()


def test_noise_alone_is_hardly_ever_an_outlier() -> None:
    """By chance one pose in a thousand; none by much."""
    parts = [true_residuals(seed) for seed in range(5)]
    for part, weights in zip(parts, reweigh(parts, TRUE_NOISE), strict=True):
        assert len(weights.end) == len(part.residual)
        for share in (weights.start, weights.end, weights.motion):
            assert ((share > 0.0) & (share <= 1.0)).all()
            assert (share < 1.0).mean() < 0.004
            assert (share > 0.5).all()


def test_weights_fall_with_the_squared_distance() -> None:
    shares = [reweigh([spoiled(np.array([d, 0.0, 0.0]), 300, 301)], TRUE_NOISE)[0].end[299] for d in (0.4, 0.8)]
    assert shares[0] / shares[1] == pytest.approx(4.0, rel=0.2)


def slipping(step: FloatArray, first: int, last: int) -> Residuals:
    """Residuals of a drive whose body moves by ``step`` beside what the wheels say, in each of a run of motions."""
    drive = simulated(TRUE_NOISE, 7)
    assert drive.pose is not None
    values = drive.pose.values.copy()
    for i in range(first, last):
        after = compose(compose(values[i], step), between(values[i], values[i + 1 :]))
        values[i + 1 :] = after
    return residuals_of(replace(drive, pose=Series(drive.pose.t, values)))


@pytest.mark.parametrize("step", [[0.0, 0.0, 0.05], [0.03, 0.0, -0.03], [0.03, -0.03, 0.0]])
def test_an_episode_of_slip_is_found_by_its_sum(step: list[float]) -> None:
    """A side that spins for 3 s: no motion is odd by itself, all of them together are."""
    part, first, last = slipping(np.array(step), 300, 315), 300, 315
    weights = reweigh([part], TRUE_NOISE)[0]
    assert np.median(weights.motion[first:last]) < 0.5
    assert (weights.motion < 0.7).sum() <= 2 * (last - first)
    quiet = replace(part, windows=replace(part.windows, joined=np.zeros(len(part.residual), bool)))
    alone = reweigh([quiet], TRUE_NOISE)[0]  # each motion for itself
    assert np.median(alone.motion[first:last]) == 1.0


def test_errors_that_all_episodes_share_make_none_odd() -> None:
    """A model that is wrong everywhere is no reason to leave out what drives most."""
    part = slipping(np.array([0.0, 0.0, 0.02]), 0, 1229)
    weights = reweigh([part], fit_noise([part], TRUE_NOISE, [ones(part)]))[0]
    assert (weights.motion < 1.0).mean() < 0.03  # 0.08 if each were held against the noise alone
