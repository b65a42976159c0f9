import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_t

from skidsteer import student
from skidsteer.se2 import FloatArray


def test_deviance_is_the_density_by_hand() -> None:
    """Differences of -2 log density of scipy's, in two and in three dimensions."""
    points = np.random.default_rng(0).normal(size=(5, 3))
    for p in (2, 3):
        x = points[:, :p]
        told = [
            student.deviance((x**2).sum(axis=1), scale, dof, p)
            + 2.0 * multivariate_t.logpdf(x, shape=scale * np.eye(p), df=dof).sum()
            for scale, dof in ((1.0, 3.0), (0.4, 7.0), (2.5, 1.5))
        ]
        assert_allclose(told, told[0], atol=1e-10)  # what depends on neither scale nor degrees of freedom
    both = student.deviance(np.ones(2), 0.7, 3.0, np.array([2.0, 3.0]))
    assert both == pytest.approx(sum(student.deviance(np.ones(1), 0.7, 3.0, p) for p in (2, 3)))


def errors(count: int, scale: float, dof: float, dimensions: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Squared distances of errors of a Student t, and their dimensions."""
    rng = np.random.default_rng(seed)
    squared = scale * dof * rng.chisquare(dimensions, count) / rng.chisquare(dof, count)
    return squared, np.full(count, float(dimensions))


@pytest.mark.parametrize("dimensions", [1, 3])
@pytest.mark.parametrize(("scale", "dof"), [(0.5, 2.5), (2.0, 5.0)])
def test_many_errors_tell_scale_and_degrees_of_freedom(dimensions: int, scale: float, dof: float) -> None:
    found = student.lightest_tails(*errors(40000, scale, dof, dimensions, 1))
    assert_allclose(found, (scale, dof), rtol=0.08)


def test_the_degrees_of_freedom_are_an_upper_limit() -> None:
    """Of 1 % error: 198 of 200 times on average the true ones lie below, and where there are many not by a lot."""
    dofs = np.array([student.lightest_tails(*errors(150, 0.7, 3.0, 3, seed))[1] for seed in range(200)])
    assert (dofs > 3.0).sum() >= 194  # 99 % of a binomial distribution
    assert np.median(dofs) < 7.0


def test_errors_that_may_be_gaussian_are_taken_for_it() -> None:
    squared = 0.6 * np.random.default_rng(2).chisquare(3, 1000)
    scale, dof = student.lightest_tails(squared, np.full(1000, 3.0))
    assert scale == pytest.approx(0.6, rel=0.1)
    assert dof > 50.0
    few = student.lightest_tails(*errors(8, 1.0, 3.0, 3, 0))
    assert few[1] == pytest.approx(student.DOFS[1])
    assert student.lightest_tails(np.zeros(0), np.zeros(0))[1] == pytest.approx(student.DOFS[1])


def test_weights_by_hand() -> None:
    assert_allclose(student.weights(np.array([0.0, 6.0, 34.0]), 2.0, 3.0), [2.0, 1.0, 0.3])
    assert_allclose(student.weights(np.array([2.0]), 2.0, 3.0, 1.0), [1.0])  # as large as usual in one dimension
    rng = np.random.default_rng(3)
    squared = 0.5 * 4.0 * rng.chisquare(3, 10**5) / rng.chisquare(4.0, 10**5)
    assert student.weights(squared, 0.5, 4.0).mean() == pytest.approx(1.0, abs=0.01)
