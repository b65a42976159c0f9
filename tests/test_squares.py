import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from skidsteer.drive import Series
from skidsteer.errors import DataError
from skidsteer.identify import moments as by_moments
from skidsteer.identify.squares import PlainFit, Squares, Value, fit_squares
from skidsteer.kernels import rollout as kernels
from skidsteer.kernels.lanes import LANES, LIMIT
from skidsteer.kernels.roll import MEMORY, count_steps, paths
from skidsteer.models import Icr, Linear
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import preset
from skidsteer.windows import Steps, Timing, Windows, linearize, predict, steps

P3AT = preset("pioneer-p3at")
TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)
BOUNDS = Icr.bounds(P3AT)


def make_cut(counts: list[int], step: float, seed: int = 0) -> Steps:
    rng = np.random.default_rng(seed)
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    size, k = (offsets[-1], 2), len(counts)
    distance, by_lag = step * rng.uniform(-1.0, 1.0, size), rng.normal(size=size)
    return Steps(distance, by_lag, np.full(offsets[-1], 0.01), offsets, np.ones((k, 2)), np.ones((k, 2)))


def one_by_one(A: FloatArray, cut: Steps) -> tuple[FloatArray, FloatArray]:
    """The scalar loop: a window alone never fills the lanes, so that no two are rolled out side by side."""
    motion, J = np.empty((len(cut.offsets) - 1, 3)), np.empty((len(cut.offsets) - 1, 3, 7))
    for w, (a, b) in enumerate(zip(cut.offsets[:-1], cut.offsets[1:], strict=True)):
        alone = np.array([0, b - a])
        kernels.rollout_matrix(A, cut.distance[a:b], cut.by_lag[a:b], alone, motion[w : w + 1], J[w : w + 1])
    return motion, J


def side_by_side(A: FloatArray, cut: Steps) -> tuple[FloatArray, FloatArray]:
    motion, J = np.empty((len(cut.offsets) - 1, 3)), np.empty((len(cut.offsets) - 1, 3, 7))
    kernels.rollout_matrix(A, cut.distance, cut.by_lag, cut.offsets, motion, J)
    return motion, J


def windows_with(motion: FloatArray) -> Windows:
    t = np.arange(len(motion) + 1.0)
    return Windows(t[:-1], t[1:], motion, np.zeros(len(motion), bool))


def noisy(cut: Steps, sigma: float = 0.01, seed: int = 1) -> Windows:
    motion = side_by_side(TRUTH.matrix(), cut)[0]
    return windows_with(motion + sigma * np.random.default_rng(seed).normal(size=motion.shape))


# Windows side by side


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=4 * LANES), st.sampled_from([0.001, 0.03, 0.11, 0.12, 0.5]))
def test_side_by_side_equals_one_by_one(counts: list[int], step: float) -> None:
    cut = make_cut(counts, step)
    for a, b in zip(side_by_side(TRUTH.matrix(), cut), one_by_one(TRUTH.matrix(), cut), strict=True):
        assert_allclose(a, b, atol=1e-12, rtol=1e-12)


def test_just_below_the_limit_of_the_series() -> None:
    cut = make_cut([30] * LANES, 1.0)
    cut.distance[:] *= 1.999 * LIMIT / np.abs(cut.distance @ TRUTH.matrix()[2]).max()
    reach = 0.5 * np.abs(TRUTH.matrix()[2]) @ np.abs(cut.distance).max(axis=0)
    cut.distance[:] *= 0.999 * LIMIT / reach
    for a, b in zip(side_by_side(TRUTH.matrix(), cut), one_by_one(TRUTH.matrix(), cut), strict=True):
        assert_allclose(a, b, atol=1e-12)


def test_a_long_window_among_short_ones() -> None:
    cut = make_cut([1] * 40 + [5000] + [2] * 40, 0.002)
    for a, b in zip(side_by_side(TRUTH.matrix(), cut), one_by_one(TRUTH.matrix(), cut), strict=True):
        assert_allclose(a, b, atol=1e-11)


def test_motion_alone_and_without_lag() -> None:
    cut = make_cut([7, 9] * LANES, 0.02)
    motion, J = side_by_side(TRUTH.matrix(), cut)
    alone, scratch = np.empty_like(motion), np.empty((0, 3, 7))
    kernels.rollout_matrix(TRUTH.matrix(), cut.distance, cut.by_lag[:0], cut.offsets, alone, scratch)
    assert_array_equal(alone, motion)
    without = np.empty_like(J)
    kernels.rollout_matrix(TRUTH.matrix(), cut.distance, cut.by_lag[:0], cut.offsets, alone, without)
    assert_array_equal(without[..., 6], 0.0)
    assert_allclose(without[..., :6], J[..., :6], atol=1e-15)


# Cutting the log


@settings(deadline=None)
@given(st.integers(1, 60), st.integers(0, 2**31), st.booleans())
def test_count_steps_is_the_search(n: int, seed: int, ordered: bool) -> None:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([0.01, 0.1, 3.0], n))
    start = rng.choice(np.r_[t, rng.uniform(t[0] - 1, t[-1] + 1, n)], 20)
    end = start + rng.choice([0.0, 0.01, 0.1, 5.0], 20)
    if ordered:
        start, end = np.sort(start), np.sort(end)
    first, offsets = count_steps(t, start, end)
    expected = np.maximum(np.searchsorted(t, start, side="right") - 1, 0)
    assert_array_equal(first, expected)
    last = np.maximum(np.searchsorted(t, end, side="left") - 1, expected)
    assert_array_equal(np.diff(offsets), last - expected + 1)


@pytest.mark.parametrize("lag", [0.0, 0.05, 0.6])
def test_windows_overlap_and_lie_far_apart(lag: float) -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.01, 0.03, 5000))  # 100 s: many times the memory of a short lag
    wheels = Series(t, rng.normal(size=(5000, 2)))
    start = np.array([1.0, 1.2, 0.7, 40.0, 39.0, 90.0, 3.0])
    windows = windows_with(np.zeros((7, 3)))
    together = Windows(start, start + 2.0, windows.motion, windows.joined)
    timing = Timing(0.01, lag)
    cut = steps(wheels, together, timing)
    for w in range(7):
        whole = together.where(np.arange(7) == w)
        early = Windows(np.array([t[0]]), np.array([start[w]]), whole.motion, whole.joined)  # carries the state along
        both = Windows(*(np.r_[getattr(early, f), getattr(whole, f)] for f in ("start", "end", "motion", "joined")))
        alone = steps(wheels, both, timing)
        part, tail = slice(*cut.offsets[w : w + 2]), slice(alone.offsets[1], None)
        assert_allclose(cut.distance[part], alone.distance[tail], atol=1e-14)
        assert_allclose(cut.by_lag[part], alone.by_lag[tail], atol=1e-11)
        assert_allclose(cut.end_speeds[w], alone.end_speeds[1], atol=1e-13)
    assert np.exp(-MEMORY) < np.finfo(float).eps


def test_steps_without_slopes() -> None:
    wheels = Series(0.02 * np.arange(500), np.random.default_rng(0).normal(size=(500, 2)))
    windows = windows_with(np.zeros((8, 3)))
    for lag in (0.0, 0.1):
        full, lean = steps(wheels, windows, Timing(0.0, lag)), steps(wheels, windows, Timing(0.0, lag), slopes=False)
        assert_array_equal(full.distance, lean.distance)
        assert len(lean.by_lag) == 0
        assert_array_equal(linearize(TRUTH, full)[0], predict(TRUTH, wheels, windows, Timing(0.0, lag)))


def test_paths_count_forwards_and_backwards() -> None:
    """What is rolled apart counts whole for the yaw, a straight metre a tenth: 0.05 + 0.1 (0.15 - 0.05)."""
    distance = np.array([[1.0, -1.0], [-0.5, 0.3], [0.2, 0.1]])
    assert_allclose(paths(distance, np.array([0, 2, 3])), [[1.4, 1.4], [0.15, 0.06]])


# Squared cost


def dense(A: FloatArray, cut: Steps, windows: Windows) -> Value:
    motion, J = one_by_one(A, cut)
    error, by_entry = motion - windows.motion, J[..., :6].reshape(-1, 6)
    cost = np.array([(error[:, :2] ** 2).sum(), (error[:, 2] ** 2).sum()])
    return Value(cost, by_entry.T @ error.ravel(), by_entry.T @ by_entry)


@pytest.mark.parametrize("count", [1, LANES - 1, LANES, 3 * LANES + 5])
@pytest.mark.parametrize("step", [0.01, 0.4])  # on lanes, and one by one
def test_squares_equal_the_dense_products(count: int, step: float) -> None:
    cut = make_cut([17 + i % 5 for i in range(count)], step, seed=count)
    windows = noisy(cut)
    A = TRUTH.matrix() + 0.01 * np.arange(6).reshape(3, 2)
    squares = Squares.of(cut, windows, TRUTH)
    found, expected = squares.at(A), dense(A, cut, windows)
    assert (squares.tiles is not None) == (count >= LANES - 1)
    assert_allclose(found.cost, expected.cost, rtol=1e-11)
    scale = np.sqrt(np.diag(expected.information))
    assert_allclose(found.gradient / scale, expected.gradient / scale, atol=1e-11)
    assert_allclose(
        found.information / np.outer(scale, scale), expected.information / np.outer(scale, scale), atol=1e-12
    )


def test_squares_by_hand() -> None:
    # One step of one metre on both sides, straight ahead, told to be 0.9, 0.2, -0.3.
    cut = make_cut([1] * LANES, 0.0)
    cut.distance[0] = 0.1
    windows = windows_with(np.zeros((LANES, 3)))
    windows.motion[0] = 0.09, 0.02, -0.3
    straight = Icr(0.3, -0.3, 0.1, 1.0, 1.0)
    value = Squares.of(cut, windows, straight).at(straight.matrix())
    assert_allclose(value.cost, [0.01**2 + 0.02**2, 0.3**2], rtol=1e-12)
    # along: 0.01 too far; the yaw of the middle turns the step by half
    assert_allclose(value.gradient, [1e-3, 1e-3, -2e-3, -2e-3, 0.03 - 0.02 * 0.005, 0.03 - 0.02 * 0.005], rtol=1e-12)
    assert_allclose(np.diag(value.information), [0.01] * 4 + [0.01 + 0.005**2] * 2, rtol=1e-12)


def test_yaws_are_unwrapped_to_the_start() -> None:
    cut = make_cut([20] * 60, 0.05)
    windows = noisy(cut)
    turned = windows_with(np.add(windows.motion, [0.0, 0.0, 2 * np.pi]))
    assert_allclose(
        Squares.of(cut, turned, TRUTH).at(TRUTH.matrix()).cost, Squares.of(cut, windows, TRUTH).at(TRUTH.matrix()).cost
    )


@pytest.mark.parametrize("step", [0.02, 0.4])
def test_fit_finds_the_minimum_that_moments_find(step: float) -> None:
    cut = make_cut([20, 22, 21] * 40, step)
    windows = noisy(cut)
    start = Icr.nominal(P3AT)
    found = fit_squares(cut, windows, start, BOUNDS)
    assert found.converged
    total = by_moments.moments(cut, windows, start, BOUNDS)
    other = by_moments.fit_squares(total, found.model, BOUNDS)
    assert found.cost == pytest.approx(other.cost, rel=1e-9)
    assert_allclose(found.model.theta, other.model.theta, atol=1e-4)


def test_fit_stays_inside_its_bounds() -> None:
    cut = make_cut([20] * 80, 0.02)
    narrow = BOUNDS.copy()
    narrow[0] = 0.3, 0.35  # the truth is 0.2553
    found = fit_squares(cut, noisy(cut), Icr.nominal(P3AT), narrow)
    assert found.converged
    assert found.model.theta[0] == 0.3


def fits(seeds: int) -> list[PlainFit]:
    cut = make_cut([25] * 300, 0.02)
    exact = side_by_side(TRUTH.matrix(), cut)[0]
    found = []
    for seed in range(seeds):
        noise = np.random.default_rng(seed).normal(size=exact.shape) * [0.01, 0.01, 0.03]
        found.append(fit_squares(cut, windows_with(exact + noise), TRUTH, BOUNDS))
    return found


def test_covariance_is_that_of_the_estimates() -> None:
    found = fits(200)
    error = np.array([f.model.theta - TRUTH.theta for f in found])
    nees = [e @ np.linalg.solve(f.covariance, e) for e, f in zip(error, found, strict=True)]
    assert all(f.converged for f in found)
    assert np.mean(nees) == pytest.approx(5.0, abs=4 * np.sqrt(2 * 5 / 200))
    assert_allclose(error.mean(axis=0) / error.std(axis=0) * np.sqrt(200), 0.0, atol=4.0)


def test_what_the_windows_do_not_determine_is_infinitely_uncertain() -> None:
    cut = make_cut([20] * 60, 0.02)
    cut.distance[:, 1] = cut.distance[:, 0]
    still = fit_squares(cut, noisy(cut), Linear.nominal(P3AT), Linear.bounds(P3AT))
    assert np.isinf(still.covariance).all()


def test_exact_windows_give_the_truth() -> None:
    cut = make_cut([20] * 60, 0.02)
    found = fit_squares(cut, noisy(cut, sigma=0.0), Icr.nominal(P3AT), BOUNDS)
    assert found.converged
    assert_allclose(found.model.theta, TRUTH.theta, atol=1e-9)


def test_no_windows_and_not_enough_steps() -> None:
    cut = make_cut([20] * 60, 0.02)
    windows = noisy(cut)
    none = windows.where(np.zeros(60, bool))
    with pytest.raises(DataError, match=r"^no windows to fit a model to$"):
        fit_squares(make_cut([], 0.02), none, TRUTH, BOUNDS)
    hasty = fit_squares(cut, windows, Icr.nominal(P3AT), BOUNDS, iterations=1)
    assert not hasty.converged
    assert hasty.iterations == 1


def test_many_windows_begin_with_a_share_of_them() -> None:
    cut = make_cut([4, 5, 6] * 2000, 0.05)
    windows = noisy(cut)
    start = Icr.nominal(P3AT)
    squares = Squares.of(cut, windows, start)
    few = squares.thinned(16)
    assert few is not None
    assert few.tiles is not None
    assert squares.tiles is not None
    assert len(few.tiles.total) == -(-len(squares.tiles.total) // 16)
    part = np.concatenate([np.arange(i, min(i + LANES, 6000)) for i in range(0, 6000, 16 * LANES)])
    taken = [cut.distance[a:b] for a, b in zip(cut.offsets[part], cut.offsets[part + 1], strict=True)]
    counts = [len(t) for t in taken]
    alone = make_cut(counts, 0.0)
    alone.distance[:] = np.concatenate(taken)
    keep = np.zeros(6000, bool)
    keep[part] = True
    expected = dense(TRUTH.matrix(), alone, windows.where(keep))
    assert_allclose(few.at(TRUTH.matrix()).cost, expected.cost, rtol=1e-11)
    found = fit_squares(cut, windows, start, BOUNDS)
    other = by_moments.fit_squares(by_moments.moments(cut, windows, start, BOUNDS), found.model, BOUNDS)
    assert found.converged
    assert found.cost == pytest.approx(other.cost, rel=1e-9)
    assert squares.thinned(400) is None
