import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from skidsteer.errors import DataError, RequestError
from skidsteer.models.transfer_factor import TransferFactor
from skidsteer.odometry.compatibility import compatible, statistic, threshold
from skidsteer.odometry.kinematic_ekf import KinematicEkf
from skidsteer.odometry.state import FilterState
from skidsteer.odometry.state_choice import SystemNoise


def test_statistic_by_hand() -> None:
    # D^-1 of [2, 1; 1, 3] is [3, -1; -1, 2] / 5; d = (1, 2): (3 - 4 + 8) / 5
    assert_allclose(statistic([1.0, 2.0], [[2.0, 1.0], [1.0, 3.0]]), 1.4)
    assert statistic([], np.zeros((0, 0))) == 0.0


def test_threshold_is_the_chi_square_quantile() -> None:
    assert_allclose(threshold(0.05, 2), -2.0 * np.log(0.05))
    assert threshold(0.0, 2) == np.inf
    for bad in (-0.1, 1.0, np.nan):
        with pytest.raises(RequestError, match="significance is a probability"):
            threshold(bad, 1)


def test_the_share_of_false_alarms_is_the_significance() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(3, 3))
    D = A @ A.T + np.eye(3)
    draws = rng.multivariate_normal(np.zeros(3), D, 4000)
    alarms = sum(not compatible(d, D, 0.05)[1].all() for d in draws)
    assert abs(alarms / 4000 - 0.05) < 3.0 * np.sqrt(0.05 * 0.95 / 4000)


def test_the_one_that_does_not_fit_is_excluded() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(4, 4))
    D = A @ A.T + np.eye(4)
    for i in range(4):
        d = rng.multivariate_normal(np.zeros(4), D)
        d[i] += 30.0 * np.sqrt(D[i, i])
        T, taken = compatible(d, D, 0.001)
        assert chi2.isf(0.001, 4) < T
        assert taken.tolist() == [j != i for j in range(4)]


def test_two_that_do_not_fit_are_excluded_and_nothing_may_be_left() -> None:
    assert compatible([50.0, 0.1, -40.0], np.eye(3), 0.01)[1].tolist() == [False, True, False]
    assert compatible([50.0, -50.0], np.eye(2), 0.01)[1].tolist() == [False, False]
    assert compatible([50.0, -50.0], np.eye(2), 0.0)[1].tolist() == [True, True]


def test_what_is_no_innovation_is_refused() -> None:
    with pytest.raises(DataError, match="finite and of the size"):
        compatible([np.nan, 0.0], np.eye(2), 0.01)
    with pytest.raises(DataError, match="finite and of the size"):
        compatible([0.0], np.eye(2), 0.01)
    with pytest.raises(DataError, match="not positive definite"):
        compatible([0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]], 0.01)


@pytest.mark.parametrize("choice", ["sides", "speed_difference", "speed_yaw_rate"])
def test_the_filters_exclude_what_the_test_excludes(choice: str) -> None:
    """The compiled step for two observations against the general test."""
    rng = np.random.default_rng(2)
    seen = {True: 0, False: 0}
    for _ in range(300):
        model = TransferFactor(0.0, 0.0, 1.0, 0.6)
        f = KinematicEkf(model, choice, noise=SystemNoise(encoder=rng.uniform(0.1, 1.0)), significance=0.05)
        A = rng.normal(size=(5, 5))
        state = FilterState(f.fingerprint, 0.0, rng.normal(size=5), A @ A.T * 0.1)
        wheels = rng.normal(size=2) * 3.0
        z = f.observed(wheels)
        D = state.covariance[3:5, 3:5] + np.diag(f.encoders[0])
        T, taken = compatible(z - state.mean[3:5], D, 0.05)
        _, found, kept = f.observe(state, wheels)
        assert_allclose(found, T)
        assert kept.tolist() == taken.tolist()
        seen[bool(taken.all())] += 1
    assert min(seen.values()) > 50
