"""The test on innovations of Thalmann 2016, Eq. (10)."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skidsteer.errors import RequestError
from skidsteer.models.transfer_factor import TransferFactor
from skidsteer.odometry.kinematic_ekf import KinematicEkf
from skidsteer.odometry.reference_update import threshold
from skidsteer.odometry.state import FilterState
from skidsteer.odometry.state_choice import SystemNoise
from skidsteer.se2 import FloatArray


def test_threshold_is_the_chi_square_quantile() -> None:
    assert_allclose(threshold(0.05, 2), -2.0 * np.log(0.05))
    assert threshold(0.0, 2) == np.inf
    for bad in (-0.1, 1.0, np.nan):
        with pytest.raises(RequestError, match="significance is a probability"):
            threshold(bad, 1)


def compatible(d: FloatArray, D: FloatArray, significance: float) -> tuple[float, list[bool]]:
    """T of all observations, and which to take: the one whose exclusion lowers T the most goes, again and again."""

    def statistic(index: list[int]) -> float:
        return float(d[index] @ np.linalg.solve(D[np.ix_(index, index)], d[index])) if index else 0.0

    kept = list(range(len(d)))
    while kept and threshold(significance, len(kept)) < statistic(kept):
        kept = min(([i for i in kept if i != out] for out in kept), key=statistic)
    return statistic(list(range(len(d)))), [i in kept for i in range(len(d))]


def test_the_share_of_false_alarms_is_the_significance() -> None:
    D = np.array([[2.0, 0.7], [0.7, 1.0]])
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(2), D, 4000)
    alarms = sum(not all(compatible(d, D, 0.05)[1]) for d in draws)
    assert abs(alarms / 4000 - 0.05) < 3.0 * np.sqrt(0.05 * 0.95 / 4000)


@pytest.mark.parametrize("choice", ["sides", "speed_difference", "speed_yaw_rate"])
def test_the_filters_exclude_what_the_test_excludes(choice: str) -> None:
    """The compiled step for two observations against the test as the paper tells it."""
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
        assert kept.tolist() == taken
        seen[all(taken)] += 1
    assert min(seen.values()) > 50
