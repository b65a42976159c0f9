from dataclasses import astuple, fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from noisy_drives import TRUE_NOISE, TRUTH, ones, residuals_of, simulated, true_residuals
from skidsteer.drive import Series
from skidsteer.models import Icr
from skidsteer.noise import BOUNDS, Noise, Residuals, Weights, deviance, fit_noise, residuals
from skidsteer.se2 import FloatArray
from skidsteer.windows import Sees, Timing, Windows, steps


def ratios(noise: Noise) -> FloatArray:
    """Over the truth, of all but the gyro's."""
    return np.array(astuple(noise)[:5]) / astuple(TRUE_NOISE)[:5]


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
