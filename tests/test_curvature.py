import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.models import Curvature, SymmetricIcr
from skidsteer.models.curvature import CREEP, icr_coefficient

WANG = (0.4728, 0.0538)  # Wang 2015, Eq. (45)
TABLE_3 = (1.4662, 1.4480, 1.4394, 1.4341, 1.4215, 1.4232, 1.4165, 1.4115)  # Wang 2015, chi at lambda 0 to 7
models = st.builds(
    Curvature,
    a=st.floats(-0.5, 5.0),
    b=st.floats(0.0, 2.0),
    alpha=st.floats(0.5, 1.5),
    track_width=st.floats(0.1, 2.0),
)
speeds = st.floats(-2.0, 2.0)
brisk = st.floats(0.2, 2.0)


def test_printed_function_is_near_table_three() -> None:
    chi = icr_coefficient(np.arange(8), *WANG)
    assert float(np.sqrt(np.mean((chi - TABLE_3) ** 2))) == pytest.approx(0.0032, abs=5e-5)
    assert_allclose(chi, TABLE_3, atol=0.0067)
    assert_allclose(chi[[0, 4]], [1.4728, 1 + 0.4728 / 1.1076], atol=1e-12)


def test_by_hand() -> None:
    # lambda = 1.6 / 0.4 = 4
    model = Curvature(a=0.6, b=0.25, alpha=0.9, track_width=0.5)
    # chi = 1 + 0.6 / 1.5 = 1.4; omega = 0.9 * 0.4 / (0.5 * 1.4); v_x = 0.9 * 0.8
    assert_allclose(model.twist(0.6, 1.0), [0.72, 0.0, 0.36 / 0.7], atol=3e-6)
    assert_allclose(model.twist(1.0, 0.6), [0.72, 0.0, -0.36 / 0.7], atol=3e-6)
    assert_allclose(model.twist(-0.6, -1.0), [-0.72, 0.0, -0.36 / 0.7], atol=3e-6)


@given(brisk, brisk, st.booleans(), st.floats(0.0, 5.0), st.floats(0.0, 2.0))
def test_obeys_wangs_equations_above_creep(total: float, apart: float, left: bool, a: float, b: float) -> None:
    """Eqs. (11), (13), (15), (44) as they stand."""
    d = apart if left else -apart
    twist = Curvature(a, b, 1.0, 0.4).twist(0.5 * (total - d), 0.5 * (total + d))
    y0 = 0.4 * float(icr_coefficient(total / d, a, b)) / 2.0
    assert_allclose(twist, [total / 2.0, 0.0, d / (2.0 * y0)], rtol=3e-4)


@given(models, speeds)
def test_turns_on_the_spot_by_chi_of_zero(model: Curvature, rim: float) -> None:
    expected = 2.0 * model.alpha * rim / (model.track_width * (1.0 + model.a))
    assert_allclose(model.twist(-rim, rim), [0.0, 0.0, expected], rtol=1e-12, atol=1e-15)


@given(models, speeds)
def test_straight_stays_straight(model: Curvature, rim: float) -> None:
    assert_allclose(model.twist(rim, rim), [model.alpha * rim, 0.0, 0.0], atol=1e-15)
    assert_allclose(model.wheel_speeds(rim, 0.0), [rim / model.alpha] * 2, rtol=1e-15, atol=1e-300)


@given(models, speeds, speeds)
def test_is_odd_and_mirrors(model: Curvature, v_left: float, v_right: float) -> None:
    v_x, v_y, omega = model.twist(v_left, v_right)
    assert_allclose(model.twist(-v_left, -v_right), [-v_x, 0.0, -omega], atol=1e-14)
    assert_allclose(model.twist(v_right, v_left), [v_x, 0.0, -omega], atol=1e-14)
    assert v_y == 0.0


@given(models, st.sampled_from([0.0, 5e-324, 1e-300, 1e-12, CREEP, 0.5]), st.sampled_from([0.0, 1e-300, 1e-9, 1.0]))
def test_finite_everywhere(model: Curvature, total: float, apart: float) -> None:
    for s, d in ((total, apart), (-total, apart), (total, -apart)):
        rims = (0.5 * (s - d), 0.5 * (s + d))
        for values in (model.twist(*rims), model.speed_jacobian(*rims), model.parameter_jacobian(*rims)):
            assert np.isfinite(values).all()
        assert np.isfinite(model.wheel_speeds(s, d)).all()


@given(models, st.floats(0.0, 4.0))
def test_turns_faster_the_more_the_sides_differ(model: Curvature, total: float) -> None:
    """The inverse has one solution: omega grows with the difference, for positive and negative a."""
    apart = np.linspace(-4.0, 4.0, 801)
    omega = model.twist(0.5 * (total - apart), 0.5 * (total + apart))[:, 2]
    assert (np.diff(omega) > 0.0).all()


@given(models, st.floats(-3.0, 3.0), st.floats(-12.0, 12.0))
def test_wheel_speeds_undo_the_twist(model: Curvature, v: float, omega: float) -> None:
    rims = model.wheel_speeds(v, omega)
    assert_allclose(model.twist(*rims)[[0, 2]], [v, omega], rtol=1e-13, atol=1e-13)


@given(models)
def test_chi_lies_between_its_limits(model: Curvature) -> None:
    left, right = np.random.default_rng(0).uniform(-2.0, 2.0, (2, 200))
    chi = model.alpha * (right - left) / (model.track_width * model.twist(left, right)[:, 2])
    low, high = sorted((1.0, 1.0 + model.a))
    assert (chi >= low - 1e-9).all()
    assert (chi <= high + 1e-9).all()


@given(st.floats(-0.5, 5.0), st.floats(0.5, 1.5), speeds, speeds)
def test_without_b_it_is_a_constant_icr(a: float, alpha: float, v_left: float, v_right: float) -> None:
    constant = SymmetricIcr(0.5 * 0.4 * (1.0 + a), alpha)
    twist = Curvature(a, 0.0, alpha, 0.4).twist(v_left, v_right)
    assert_allclose(twist, constant.twist(v_left, v_right), atol=1e-13)


def test_coefficient_beyond_wangs_range() -> None:
    chi = icr_coefficient([10.0, 100.0, 1e8, np.inf], *WANG)
    assert (np.diff(chi) < 0.0).all()
    assert chi[-1] == 1.0
    assert_allclose(icr_coefficient([-4.0, 4.0], *WANG), 1 + 0.4728 / 1.1076)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1.0, 0.1, 1.0, 0.4), "need a > -1 and b >= 0, got -1.0, 0.1"),
        ((0.4, -0.1, 1.0, 0.4), "need a > -1 and b >= 0, got 0.4, -0.1"),
        ((np.nan, 0.1, 1.0, 0.4), "need a > -1 and b >= 0, got nan, 0.1"),
        ((0.4, 0.1, 0.0, 0.4), "need alpha > 0 and track_width > 0 [m], got 0.0, 0.4"),
        ((0.4, 0.1, 1.0, -0.4), "need alpha > 0 and track_width > 0 [m], got 1.0, -0.4"),
    ],
)
def test_refuses(arguments: tuple[float, float, float, float], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        Curvature(*arguments)
