import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose
from scipy.linalg import expm

from skidsteer.se2 import FloatArray, between, chain, compose, exp, invert, log, rotate, wrap

poses = arrays(np.float64, (3,), elements=st.floats(-10.0, 10.0))
batches = arrays(np.float64, (4, 3), elements=st.floats(-10.0, 10.0))
# A turn of pi exactly is reached by two twists; log may answer with either.
short_turns = arrays(np.float64, (3,), elements=st.floats(-3.14, 3.14))
steps = arrays(np.float64, st.tuples(st.integers(0, 6), st.just(3)), elements=st.floats(-4.0, 4.0))


def matrix(pose: FloatArray) -> FloatArray:
    """Homogeneous transform (3, 3), the independent representation."""
    x, y, yaw = pose
    return np.array([[np.cos(yaw), -np.sin(yaw), x], [np.sin(yaw), np.cos(yaw), y], [0.0, 0.0, 1.0]])


def assert_same_pose(a: FloatArray, b: FloatArray, atol: float = 1e-12) -> None:
    assert_allclose(a[..., :2], b[..., :2], atol=atol)
    assert_allclose(wrap(a[..., 2] - b[..., 2]), 0.0, atol=atol)


@given(poses, poses)
def test_compose_is_the_matrix_product(a: FloatArray, b: FloatArray) -> None:
    assert_allclose(matrix(compose(a, b)), matrix(a) @ matrix(b), atol=1e-12)


@given(poses)
def test_invert_is_the_matrix_inverse(a: FloatArray) -> None:
    assert_allclose(matrix(invert(a)), np.linalg.inv(matrix(a)), atol=1e-12)


@given(short_turns)
def test_exp_is_the_matrix_exponential(twist: FloatArray) -> None:
    v_x, v_y, omega = twist
    generator = np.array([[0.0, -omega, v_x], [omega, 0.0, v_y], [0.0, 0.0, 0.0]])
    assert_allclose(matrix(exp(twist)), expm(generator), atol=1e-12)


@pytest.mark.parametrize("omega", [0.0, 1e-300, 1e-12, 1e-5, -1e-5, 3.0, np.pi, 2 * np.pi])
def test_exp_is_exact_near_and_far_from_zero(omega: float) -> None:
    generator = np.array([[0.0, -omega, 2.0], [omega, 0.0, -3.0], [0.0, 0.0, 0.0]])
    assert_allclose(matrix(exp([2.0, -3.0, omega])), expm(generator), atol=1e-14, rtol=1e-13)


def test_exp_by_hand() -> None:
    # A quarter turn about (0, 2), and one about (1, 2): the centre lies at (-v_y / omega, v_x / omega).
    quarter = np.pi / 2
    assert_allclose(exp([np.pi, 0.0, quarter]), [2.0, 2.0, quarter], atol=1e-15)
    assert_allclose(exp([np.pi, -quarter, quarter]), [3.0, 1.0, quarter], atol=1e-15)


@given(short_turns)
def test_log_undoes_exp(twist: FloatArray) -> None:
    assert_allclose(log(exp(twist)), twist, atol=1e-11)


@given(poses)
def test_exp_undoes_log_up_to_whole_turns(pose: FloatArray) -> None:
    assert_same_pose(exp(log(pose)), pose, atol=1e-11)


@pytest.mark.parametrize("yaw", [np.pi, -np.pi, 3 * np.pi, 0.0])
def test_log_of_half_a_turn_is_finite_and_right(yaw: float) -> None:
    twist = log([2.0, -1.0, yaw])
    assert abs(twist[2]) <= np.pi
    assert_same_pose(exp(twist), np.array([2.0, -1.0, yaw]))


@given(poses)
def test_inverse_from_both_sides(a: FloatArray) -> None:
    assert_allclose(compose(a, invert(a)), 0.0, atol=1e-12)
    assert_allclose(compose(invert(a), a), 0.0, atol=1e-12)


@given(poses, poses, poses)
def test_compose_is_associative(a: FloatArray, b: FloatArray, c: FloatArray) -> None:
    assert_allclose(compose(compose(a, b), c), compose(a, compose(b, c)), atol=1e-11)


@given(poses, poses)
def test_between_leads_from_one_to_the_other(a: FloatArray, b: FloatArray) -> None:
    motion = between(a, b)
    assert -np.pi <= motion[2] < np.pi
    assert_same_pose(compose(a, motion), b, atol=1e-11)


def test_between_by_hand() -> None:
    # At (1, 2) looking along +y, a point one ahead and three to the right of it.
    assert_allclose(between([1.0, 2.0, np.pi / 2], [4.0, 3.0, -np.pi]), [1.0, -3.0, np.pi / 2], atol=1e-15)


def test_compose_leaves_yaw_unwrapped() -> None:
    assert compose([0.0, 0.0, 3.0], [0.0, 0.0, 3.0])[2] == 6.0
    assert invert([0.0, 0.0, 5.0])[2] == -5.0


@given(steps, poses)
def test_chain_is_a_loop_of_compose(motions: FloatArray, start: FloatArray) -> None:
    expected = [start]
    for motion in motions:
        expected.append(compose(expected[-1], motion))
    assert_allclose(chain(motions, start), expected, atol=1e-11)


def test_chain_starts_at_the_origin_unless_told() -> None:
    assert_allclose(chain([[1.0, 0.0, 0.0]]), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])


@given(batches, batches)
def test_batch_equals_loop(a: FloatArray, b: FloatArray) -> None:
    for two in (compose, between):
        assert_allclose(two(a, b), [two(p, q) for p, q in zip(a, b, strict=True)], atol=0)
        assert_allclose(two(a.reshape(2, 2, 3), b.reshape(2, 2, 3)).reshape(4, 3), two(a, b), atol=0)
        assert_allclose(two(a[0], b), [two(a[0], q) for q in b], atol=0)
    for one in (invert, exp, log):
        assert_allclose(one(a), [one(p) for p in a], atol=1e-14)
    assert_allclose(rotate(a[:, 2], b[:, :2]), [rotate(p[2], q[:2]) for p, q in zip(a, b, strict=True)], atol=0)


@given(batches, batches)
def test_nothing_is_mutated(a: FloatArray, b: FloatArray) -> None:
    kept_a, kept_b = a.copy(), b.copy()
    for result in (compose(a, b), between(a, b), invert(a), exp(a), log(a), chain(a, b[0]), wrap(a)):
        result[...] = np.nan
    assert_allclose(a, kept_a, atol=0)
    assert_allclose(b, kept_b, atol=0)


@given(st.floats(-1e6, 1e6))
def test_wrap_range_and_angle(angle: float) -> None:
    wrapped = float(wrap(angle))
    assert -np.pi <= wrapped < np.pi
    assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-9)


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(0.0, 0.0), (np.pi, -np.pi), (-np.pi, -np.pi), (3 * np.pi, -np.pi), (4.0, 4.0 - 2 * np.pi), (-4.0, 2 * np.pi - 4)],
)
def test_wrap_by_hand(angle: float, wrapped: float) -> None:
    assert wrap(angle) == pytest.approx(wrapped, abs=1e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("towards", [0.0, 10.0, -10.0])
def test_wrap_stays_below_pi_beside_half_a_turn(sign: float, towards: float) -> None:
    wrapped = wrap(np.nextafter(sign * np.pi, towards))
    assert -np.pi <= wrapped < np.pi


def test_wrap_keeps_nan() -> None:
    assert np.isnan(wrap(np.nan))


def test_rotate_by_hand() -> None:
    assert_allclose(rotate(np.pi / 2, [1.0, 2.0]), [-2.0, 1.0], atol=1e-15)


def test_empty_batches_stay_empty() -> None:
    empty = np.zeros((0, 3))
    for result in (compose(empty, empty), between(empty, empty), invert(empty), exp(empty), log(empty)):
        assert result.shape == (0, 3)
    assert_allclose(chain(empty, [1.0, 2.0, 3.0]), [[1.0, 2.0, 3.0]])
