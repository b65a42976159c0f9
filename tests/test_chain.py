from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.kernels.chain import information, smooth
from skidsteer.se2 import FloatArray, between, chain, compose, exp

PARAMETERS = 4


class Problem(NamedTuple):
    """Arguments of ``information`` before the blocks, in its order."""

    motion: FloatArray
    joined: np.ndarray
    residual: FloatArray
    jacobian: FloatArray
    process: FloatArray
    noise_start: FloatArray
    noise_end: FloatArray
    gyro: FloatArray
    gyro_jacobian: FloatArray
    gyro_variance: FloatArray

    def for_smooth(self) -> tuple[FloatArray, ...]:
        return (*self[:3], *self[4:8], self.gyro_variance)


def covariances(rng: np.random.Generator, count: int) -> FloatArray:
    """Random positive definite (count, 3, 3), far from diagonal."""
    a = rng.standard_normal((count, 3, 3)) * [0.02, 0.03, 0.01]
    return np.swapaxes(a, 1, 2) @ a + np.diag([1e-4, 1e-4, 1e-5])


def problem(joined: list[bool], seed: int = 0, at_rest: tuple[int, ...] = (), told: float = 0.0) -> Problem:
    """A random chain; ``told`` is the share of its windows over which a gyro speaks."""
    rng, k = np.random.default_rng(seed), len(joined)
    process = rng.uniform(1e-5, 1e-3, (k, 3))
    process[list(at_rest)] = 0.0
    speaks = np.random.default_rng(seed + 1).uniform(size=k) < told
    return Problem(
        rng.uniform([-0.5, -0.3, -3.0], [0.8, 0.3, 3.0], (k, 3)),
        np.array(joined, dtype=bool),
        rng.standard_normal((k, 3)) * [0.05, 0.04, 0.03],
        rng.standard_normal((k, 3, PARAMETERS)),
        process,
        covariances(rng, k),
        covariances(rng, k),
        np.where(speaks, 0.02 * rng.standard_normal(k), 0.0),
        rng.standard_normal((k, PARAMETERS)),
        np.where(speaks, rng.uniform(1e-5, 1e-3, k), np.inf),
    )


class Dense(NamedTuple):
    """The same written out: measured = by_motion @ w + by_pose @ e + gyro noise, all three independent.

    ``measured`` are the residuals (3 k,) and below them those of the gyro where it speaks.
    """

    measured: FloatArray
    slope: FloatArray  # derivative of measured by the parameters
    by_motion: FloatArray
    by_pose: FloatArray
    motion_cov: FloatArray
    pose_cov: FloatArray
    gyro_cov: FloatArray
    start: list[int | None]  # number of the pose each window begins with, where it is not joined
    end: list[int]

    @property
    def covariance(self) -> FloatArray:
        w, e = self.by_motion, self.by_pose
        return w @ self.motion_cov @ w.T + e @ self.pose_cov @ e.T + self.gyro_cov

    def gauss_newton(self) -> tuple[FloatArray, FloatArray, float]:
        """Matrix, right-hand side and deviance of generalised least squares."""
        pull = np.linalg.solve(self.covariance, np.c_[self.slope, self.measured])
        deviance = np.linalg.slogdet(self.covariance)[1] + self.measured @ pull[:, -1]
        return self.slope.T @ pull[:, :-1], -self.slope.T @ pull[:, -1], float(deviance)


def dense(p: Problem) -> Dense:
    """From z = x exp(e), x' = x T exp(w), to first order: r = E (w + e') - G e, in the frame of the start pose.

    The gyro tells the yaw of w, and errs: g = w_yaw + n.
    """
    k, told = len(p.motion), np.flatnonzero(np.isfinite(p.gyro_variance))
    poses, rows_in_all = k + int((~p.joined).sum()), 3 * k + len(told)
    W, S = np.zeros((rows_in_all, 3 * k)), np.zeros((rows_in_all, 3 * poses))
    N = np.zeros((3 * poses, 3 * poses))
    start: list[int | None] = []
    end: list[int] = []
    number = -1
    for i, (x, y, yaw) in enumerate(p.motion):
        rows = slice(3 * i, 3 * i + 3)
        if not p.joined[i]:
            number += 1
            N[3 * number : 3 * number + 3, 3 * number : 3 * number + 3] = p.noise_start[i]
        start.append(None if p.joined[i] else number)
        E = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        G = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        S[rows, 3 * number : 3 * number + 3] = -G
        number += 1
        end.append(number)
        S[rows, 3 * number : 3 * number + 3] = W[rows, rows] = E
        N[3 * number : 3 * number + 3, 3 * number : 3 * number + 3] = p.noise_end[i]
    W[3 * k + np.arange(len(told)), 3 * told + 2] = 1.0
    return Dense(
        np.r_[p.residual.ravel(), p.gyro[told]],
        np.r_[-p.jacobian.reshape(3 * k, -1), p.gyro_jacobian[told]],
        W,
        S,
        np.diag(p.process.ravel()),
        N,
        np.diag(np.r_[np.zeros(3 * k), p.gyro_variance[told]]),
        start,
        end,
    )


def one_block(p: Problem) -> tuple[FloatArray, FloatArray, float]:
    return information(*p, np.zeros(len(p.motion), np.int64), 1)


JOINED = [
    [False],
    [False, True, True, True],
    [False, False, False],
    [False, True, True, False, True, False, False, True],
]


@pytest.mark.parametrize("joined", JOINED)
@pytest.mark.parametrize("at_rest", [(), (0,)])
@pytest.mark.parametrize("told", [0.0, 0.6, 1.0])
def test_information_is_generalised_least_squares(joined: list[bool], at_rest: tuple[int, ...], told: float) -> None:
    p = problem(joined, at_rest=at_rest, told=told)
    H, score, deviance = dense(p).gauss_newton()
    found = one_block(p)
    assert_allclose(found[0], H, rtol=1e-9)
    assert_allclose(found[1], [score], rtol=1e-9, atol=1e-9 * np.abs(score).max())
    assert found[2] == pytest.approx(deviance, rel=1e-11)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.booleans(), min_size=0, max_size=7), st.integers(0, 10**6), st.sampled_from([0.0, 0.5]))
def test_information_of_any_chain(later: list[bool], seed: int, told: float) -> None:
    p = problem([False, *later], seed, told=told)
    H, score, deviance = dense(p).gauss_newton()
    found = one_block(p)
    assert_allclose(found[0], H, rtol=1e-8)
    assert_allclose(found[1][0], score, rtol=1e-8, atol=1e-8 * np.abs(score).max())
    assert found[2] == pytest.approx(deviance, rel=1e-9)


@pytest.mark.parametrize("told", [0.0, 0.6])
def test_blocks_share_the_score_among_them(told: float) -> None:
    """Each block has the score of its innovations: what its windows and their gyro tell beyond those before them."""
    joined = [False, True, True, False, True, True]
    p, block = problem(joined, told=told), np.array([0, 0, 1, 1, 2, 0])
    d = dense(p)
    of_window = np.r_[np.repeat(np.arange(6), 3), np.flatnonzero(np.isfinite(p.gyro_variance))]
    order = np.argsort(of_window, kind="stable")
    L = np.linalg.cholesky(d.covariance[np.ix_(order, order)])
    white = np.linalg.solve(L, np.c_[d.slope, d.measured][order])
    each = -white[:, :-1] * white[:, -1:]
    H, scores, deviance = information(*p, block, 3)
    number = block[of_window[order]]
    assert_allclose(scores, [each[number == b].sum(axis=0) for b in range(3)], rtol=1e-9)
    whole = one_block(p)
    assert_allclose(scores.sum(axis=0), whole[1][0], rtol=1e-12)
    assert_allclose(H, whole[0], atol=0)
    assert deviance == whole[2]


def test_separate_chains_add_up() -> None:
    p = problem([False, True, False, True, True], told=0.5)
    whole = one_block(p)
    parts = [one_block(Problem(*(a[s] for a in p))) for s in (slice(0, 2), slice(2, 5))]
    for i in range(3):
        assert_allclose(parts[0][i] + parts[1][i], whole[i], rtol=1e-10)


def test_start_noise_counts_only_where_a_chain_begins() -> None:
    p = problem([False, True, True])
    other = p._replace(noise_start=np.concatenate([p.noise_start[:1], 7.0 * p.noise_start[1:]]))
    for a, b in zip(one_block(p), one_block(other), strict=True):
        assert_allclose(a, b, atol=0)
    for a, b in zip(smooth(*p.for_smooth()), smooth(*other.for_smooth()), strict=True):
        assert_allclose(a, b, atol=0)


def test_a_silent_gyro_is_none() -> None:
    """Its residual, its slope and its place in the log do not matter where its variance is infinite."""
    p = problem([False, True, True])
    other = p._replace(gyro=p.gyro + 3.0, gyro_jacobian=7.0 * p.gyro_jacobian)
    for a, b in zip(one_block(p), one_block(other), strict=True):
        assert_allclose(a, b, atol=0)
    for a, b in zip(smooth(*p.for_smooth()), smooth(*other.for_smooth()), strict=True):
        assert_allclose(a, b, atol=0)


def test_gyro_by_hand() -> None:
    """One window; turn told by the gyro with variance 1e-4 where the motion's is 3e-4 and the poses tell no yaw."""
    p = problem([False])
    blind = np.diag([1e-4, 1e-4, 1e6])[None]
    p = p._replace(
        motion=np.zeros((1, 3)), residual=np.zeros((1, 3)), jacobian=np.zeros((1, 3, 1)), noise_start=blind,
        noise_end=blind, process=np.full((1, 3), 3e-4), gyro=np.array([0.02]), gyro_jacobian=np.array([[-2.0]]),
        gyro_variance=np.array([1e-4]),
    )  # fmt: skip
    H, scores, _ = one_block(p)
    assert_allclose(H, [[4.0 / 4e-4]], rtol=1e-6)  # the turn's own variance and the gyro's: 4e-4 in all
    assert_allclose(scores, [[2.0 * 0.02 / 4e-4]], rtol=1e-6)
    assert_allclose(smooth(*p.for_smooth())[2], [[0.0, 0.0, 0.75 * 0.02]], atol=1e-8)


def test_one_straight_window_by_hand() -> None:
    # 2 m ahead: the yaw error of the start moves the end sideways by 2 m times it. Variances 4, 1 and 0.25 e-4.
    N = np.diag([1e-4, 1e-4, 0.25e-4])
    p = Problem(
        np.array([[2.0, 0.0, 0.0]]),
        np.array([False]),
        np.array([[0.02, 0.01, 0.0]]),
        np.array([[[1.0], [0.0], [0.0]]]),
        np.array([[2e-4, 1e-4, 0.5e-4]]),
        N[None],
        N[None],
        np.zeros(1),
        np.zeros((1, 1)),
        np.full(1, np.inf),
    )
    H, scores, deviance = one_block(p)
    # along: 1 + 2 + 1 = 4e-4; across: 1 + 1 + 1 + 4 * 0.25 = 4e-4; yaw: 0.25 + 0.5 + 0.25 = 1e-4;
    # across and yaw share the start's yaw error: 2 * 0.25 = 0.5e-4
    assert_allclose(H, [[1 / 4e-4]])
    assert_allclose(scores, [[0.02 / 4e-4]])
    determinant = 4e-4 * (4e-4 * 1e-4 - 0.25e-8)
    across = 0.01**2 * 1e-4 / (4e-4 * 1e-4 - 0.25e-8)
    assert deviance == pytest.approx(np.log(determinant) + 0.02**2 / 4e-4 + across)


@pytest.mark.parametrize("joined", JOINED)
@pytest.mark.parametrize("at_rest", [(), (0,)])
@pytest.mark.parametrize("told", [0.0, 0.6, 1.0])
def test_smooth_is_the_conditional_expectation(joined: list[bool], at_rest: tuple[int, ...], told: float) -> None:
    p = problem(joined, seed=1, at_rest=at_rest, told=told)
    d = dense(p)
    pull = np.linalg.solve(d.covariance, d.measured)
    poses = (d.pose_cov @ d.by_pose.T @ pull).reshape(-1, 3)
    motions = (d.motion_cov @ d.by_motion.T @ pull).reshape(-1, 3)
    start, end, moved = smooth(*p.for_smooth())
    assert_allclose(start, [np.zeros(3) if i is None else poses[i] for i in d.start], atol=1e-12)
    assert_allclose(end, poses[d.end], atol=1e-12)
    assert_allclose(moved, motions, atol=1e-12)


@pytest.mark.parametrize("moving", [1.0, 0.0])
def test_a_long_chain_stays_exact(moving: float) -> None:
    """Three hundred joined windows, moving or at rest (no motion noise at all): no rounding builds up."""
    p = problem([False] + [True] * 299, seed=2, told=0.3)
    p = p._replace(process=moving * p.process, motion=p.motion * [0.1, 0.1, 0.01])
    d = dense(p)
    expected, found = d.gauss_newton(), one_block(p)
    assert_allclose(found[0], expected[0], rtol=1e-6)
    assert found[2] == pytest.approx(expected[2], rel=1e-6)
    end = smooth(*p.for_smooth())[1]
    poses = (d.pose_cov @ d.by_pose.T @ np.linalg.solve(d.covariance, d.measured)).reshape(-1, 3)
    assert_allclose(end, poses[d.end], atol=1e-7 * np.abs(poses).max())


def test_no_windows_tell_nothing() -> None:
    p = Problem(*(a[:0] for a in problem([False])))
    H, scores, deviance = one_block(p)
    assert_allclose(H, np.zeros((PARAMETERS, PARAMETERS)), atol=0)
    assert_allclose(scores, np.zeros((1, PARAMETERS)), atol=0)
    assert deviance == 0.0
    assert all(a.shape == (0, 3) for a in smooth(*p.for_smooth()))


def test_the_linear_model_holds_for_real_noise() -> None:
    """Exact motions with noise composed on SE(2): the covariance of the residuals is that of the linear model.

    Pose noise of 2 cm and 1 deg, motion noise of 2 cm and 2 deg, turns of up to 1.7 rad, a gyro: three joined windows.
    """
    rng, trials, k = np.random.default_rng(5), 40_000, 3
    motion = np.array([[0.5, 0.1, 0.6], [0.3, -0.2, -1.7], [0.8, 0.0, 0.1]])
    noise = np.diag([0.02, 0.02, np.radians(1.0)]) ** 2 + 0.01**2 * np.outer([1.0, -0.3, 0.5], [1.0, -0.3, 0.5])
    process = np.tile(np.array([0.02, 0.02, np.radians(2.0)]) ** 2, (k, 1))
    N = np.tile(noise, (k, 1, 1))
    spread = np.full(k, np.radians(1.0) ** 2)  # of a gyro
    told = (np.zeros(k), np.zeros((k, 0)), spread)
    p = Problem(motion, np.array([False, True, True]), np.zeros((k, 3)), np.zeros((k, 3, 0)), process, N, N, *told)
    w = np.sqrt(process) * rng.standard_normal((trials, k, 3))
    e = rng.multivariate_normal(np.zeros(3), noise, (trials, k + 1))
    truth = np.array([chain(step) for step in compose(motion, exp(w))])
    measured = compose(truth, exp(e))
    residual = between(measured[:, :-1], measured[:, 1:]) - motion
    gyro = w[:, :, 2] + np.sqrt(spread) * rng.standard_normal((trials, k))
    L = np.linalg.cholesky(dense(p).covariance)
    white = np.linalg.solve(L, np.c_[residual.reshape(trials, -1), gyro].T)
    # standard errors: 0.5 % of a mean, 0.7 % of a variance, 0.5 % of a correlation
    assert_allclose(white.mean(axis=1), 0.0, atol=0.03)
    assert_allclose(np.cov(white), np.eye(4 * k), atol=0.03)
