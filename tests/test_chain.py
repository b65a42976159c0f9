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
    """Arguments of ``information``: motion, joined, residual, jacobian, process, noise_start, noise_end."""

    motion: FloatArray
    joined: np.ndarray
    residual: FloatArray
    jacobian: FloatArray
    process: FloatArray
    noise_start: FloatArray
    noise_end: FloatArray

    def without_jacobian(self) -> tuple[FloatArray, ...]:
        return (*self[:3], *self[4:])


def covariances(rng: np.random.Generator, count: int) -> FloatArray:
    """Random positive definite (count, 3, 3), far from diagonal."""
    a = rng.standard_normal((count, 3, 3)) * [0.02, 0.03, 0.01]
    return np.swapaxes(a, 1, 2) @ a + np.diag([1e-4, 1e-4, 1e-5])


def problem(joined: list[bool], seed: int = 0, at_rest: tuple[int, ...] = ()) -> Problem:
    rng, k = np.random.default_rng(seed), len(joined)
    process = rng.uniform(1e-5, 1e-3, (k, 3))
    process[list(at_rest)] = 0.0
    return Problem(
        rng.uniform([-0.5, -0.3, -3.0], [0.8, 0.3, 3.0], (k, 3)),
        np.array(joined, dtype=bool),
        rng.standard_normal((k, 3)) * [0.05, 0.04, 0.03],
        rng.standard_normal((k, 3, PARAMETERS)),
        process,
        covariances(rng, k),
        covariances(rng, k),
    )


class Dense(NamedTuple):
    """The same written out: residual (3 k,) = by_motion @ w + by_pose @ e, with w and e independent."""

    by_motion: FloatArray
    by_pose: FloatArray
    motion_cov: FloatArray
    pose_cov: FloatArray
    start: list[int | None]  # number of the pose each window begins with, where it is not joined
    end: list[int]

    @property
    def covariance(self) -> FloatArray:
        w, e = self.by_motion, self.by_pose
        return w @ self.motion_cov @ w.T + e @ self.pose_cov @ e.T


def dense(p: Problem) -> Dense:
    """From z = x exp(e), x' = x T exp(w), to first order: r = E (w + e') - G e, in the frame of the start pose."""
    k = len(p.motion)
    poses = k + int((~p.joined).sum())
    W, S, N, Q = np.zeros((3 * k, 3 * k)), np.zeros((3 * k, 3 * poses)), np.zeros((3 * poses,) * 2), np.zeros(3 * k)
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
        Q[rows] = p.process[i]
    return Dense(W, S, np.diag(Q), N, start, end)


JOINED = [
    [False],
    [False, True, True, True],
    [False, False, False],
    [False, True, True, False, True, False, False, True],
]


@pytest.mark.parametrize("joined", JOINED)
@pytest.mark.parametrize("at_rest", [(), (0,)])
def test_information_is_generalised_least_squares(joined: list[bool], at_rest: tuple[int, ...]) -> None:
    p = problem(joined, at_rest=at_rest)
    C, r, J = dense(p).covariance, p.residual.ravel(), p.jacobian.reshape(-1, PARAMETERS)
    H, scores, deviance = information(*p, np.zeros(len(joined), np.int64), 1)
    assert_allclose(H, J.T @ np.linalg.solve(C, J), rtol=1e-9)
    assert_allclose(scores, [J.T @ np.linalg.solve(C, r)], rtol=1e-9)
    assert deviance == pytest.approx(np.linalg.slogdet(C)[1] + r @ np.linalg.solve(C, r), rel=1e-11)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.booleans(), min_size=0, max_size=7), st.integers(0, 10**6))
def test_information_of_any_chain(later: list[bool], seed: int) -> None:
    p = problem([False, *later], seed)
    C, r = dense(p).covariance, p.residual.ravel()
    H, scores, deviance = information(*p, np.zeros(len(p.motion), np.int64), 1)
    J = p.jacobian.reshape(-1, PARAMETERS)
    assert_allclose(H, J.T @ np.linalg.solve(C, J), rtol=1e-8)
    assert_allclose(scores[0], J.T @ np.linalg.solve(C, r), rtol=1e-8, atol=1e-8 * np.abs(scores).max())
    assert deviance == pytest.approx(np.linalg.slogdet(C)[1] + r @ np.linalg.solve(C, r), rel=1e-9)


def test_blocks_share_the_score_among_them() -> None:
    """Each block has the score of its innovations: what its windows tell beyond those before them."""
    joined = [False, True, True, False, True, True]
    p, block = problem(joined), np.array([0, 0, 1, 1, 2, 0])
    C = dense(p).covariance
    L = np.linalg.cholesky(C)
    white = np.linalg.solve(L, np.c_[p.jacobian.reshape(-1, PARAMETERS), p.residual.ravel()]).reshape(6, 3, -1)
    each = np.einsum("kip,ki->kp", white[:, :, :-1], white[:, :, -1])
    H, scores, deviance = information(*p, block, 3)
    assert_allclose(scores, [each[block == b].sum(axis=0) for b in range(3)], rtol=1e-9)
    whole = information(*p, np.zeros(6, np.int64), 1)
    assert_allclose(scores.sum(axis=0), whole[1][0], rtol=1e-12)
    assert_allclose(H, whole[0], atol=0)
    assert deviance == whole[2]


def test_separate_chains_add_up() -> None:
    p = problem([False, True, False, True, True])
    whole = information(*p, np.zeros(5, np.int64), 1)
    parts = [information(*(a[s] for a in p), np.zeros(5, np.int64)[s], 1) for s in (slice(0, 2), slice(2, 5))]
    for i in range(3):
        assert_allclose(parts[0][i] + parts[1][i], whole[i], rtol=1e-10)


def test_start_noise_counts_only_where_a_chain_begins() -> None:
    p = problem([False, True, True])
    other = p._replace(noise_start=np.concatenate([p.noise_start[:1], 7.0 * p.noise_start[1:]]))
    block = np.zeros(3, np.int64)
    for a, b in zip(information(*p, block, 1), information(*other, block, 1), strict=True):
        assert_allclose(a, b, atol=0)


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
    )
    H, scores, deviance = information(*p, np.zeros(1, np.int64), 1)
    # along: 1 + 2 + 1 = 4e-4; across: 1 + 1 + 1 + 4 * 0.25 = 4e-4; yaw: 0.25 + 0.5 + 0.25 = 1e-4;
    # across and yaw share the start's yaw error: 2 * 0.25 = 0.5e-4
    assert_allclose(H, [[1 / 4e-4]])
    assert_allclose(scores, [[0.02 / 4e-4]])
    determinant = 4e-4 * (4e-4 * 1e-4 - 0.25e-8)
    across = 0.01**2 * 1e-4 / (4e-4 * 1e-4 - 0.25e-8)
    assert deviance == pytest.approx(np.log(determinant) + 0.02**2 / 4e-4 + across)


@pytest.mark.parametrize("joined", JOINED)
@pytest.mark.parametrize("at_rest", [(), (0,)])
def test_smooth_is_the_conditional_expectation(joined: list[bool], at_rest: tuple[int, ...]) -> None:
    p = problem(joined, seed=1, at_rest=at_rest)
    d = dense(p)
    pull = np.linalg.solve(d.covariance, p.residual.ravel())
    poses = (d.pose_cov @ d.by_pose.T @ pull).reshape(-1, 3)
    motions = (d.motion_cov @ d.by_motion.T @ pull).reshape(-1, 3)
    start, end, moved = smooth(*p.without_jacobian())
    assert_allclose(start, [np.zeros(3) if i is None else poses[i] for i in d.start], atol=1e-12)
    assert_allclose(end, poses[d.end], atol=1e-12)
    assert_allclose(moved, motions, atol=1e-12)


@pytest.mark.parametrize("moving", [1.0, 0.0])
def test_a_long_chain_stays_exact(moving: float) -> None:
    """Three hundred joined windows, moving or at rest (no motion noise at all): no rounding builds up."""
    p = problem([False] + [True] * 299, seed=2)
    p = p._replace(process=moving * p.process, motion=p.motion * [0.1, 0.1, 0.01])
    d = dense(p)
    H, _, deviance = information(*p, np.zeros(300, np.int64), 1)
    r, J = p.residual.ravel(), p.jacobian.reshape(-1, PARAMETERS)
    assert_allclose(H, J.T @ np.linalg.solve(d.covariance, J), rtol=1e-6)
    quadratic = r @ np.linalg.solve(d.covariance, r)
    assert deviance == pytest.approx(np.linalg.slogdet(d.covariance)[1] + quadratic, rel=1e-6)
    end = smooth(*p.without_jacobian())[1]
    poses = (d.pose_cov @ d.by_pose.T @ np.linalg.solve(d.covariance, r)).reshape(-1, 3)
    assert_allclose(end, poses[d.end], atol=1e-7 * np.abs(poses).max())


def test_no_windows_tell_nothing() -> None:
    p = Problem(*(a[:0] for a in problem([False])))
    H, scores, deviance = information(*p, np.zeros(0, np.int64), 1)
    assert_allclose(H, np.zeros((PARAMETERS, PARAMETERS)), atol=0)
    assert_allclose(scores, np.zeros((1, PARAMETERS)), atol=0)
    assert deviance == 0.0
    assert all(a.shape == (0, 3) for a in smooth(*p.without_jacobian()))


def test_the_linear_model_holds_for_real_noise() -> None:
    """Exact motions with noise composed on SE(2): the covariance of the residuals is that of the linear model.

    Pose noise of 2 cm and 1 deg, motion noise of 2 cm and 2 deg, turns of up to 1.7 rad: three joined windows.
    """
    rng, trials, k = np.random.default_rng(5), 40_000, 3
    motion = np.array([[0.5, 0.1, 0.6], [0.3, -0.2, -1.7], [0.8, 0.0, 0.1]])
    noise = np.diag([0.02, 0.02, np.radians(1.0)]) ** 2 + 0.01**2 * np.outer([1.0, -0.3, 0.5], [1.0, -0.3, 0.5])
    process = np.tile(np.array([0.02, 0.02, np.radians(2.0)]) ** 2, (k, 1))
    N = np.tile(noise, (k, 1, 1))
    p = Problem(motion, np.array([False, True, True]), np.zeros((k, 3)), np.zeros((k, 3, 0)), process, N, N)
    w = np.sqrt(process) * rng.standard_normal((trials, k, 3))
    e = rng.multivariate_normal(np.zeros(3), noise, (trials, k + 1))
    truth = np.array([chain(step) for step in compose(motion, exp(w))])
    measured = compose(truth, exp(e))
    residual = between(measured[:, :-1], measured[:, 1:]) - motion
    L = np.linalg.cholesky(dense(p).covariance)
    white = np.linalg.solve(L, residual.reshape(trials, -1).T)
    # standard errors: 0.5 % of a mean, 0.7 % of a variance, 0.5 % of a correlation
    assert_allclose(white.mean(axis=1), 0.0, atol=0.03)
    assert_allclose(np.cov(white), np.eye(3 * k), atol=0.03)
