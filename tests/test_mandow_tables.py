"""Figures printed in Mandow 2007: Tables I and II, and the integers of the Pioneer P3-AT."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.models import SymmetricIcr
from skidsteer.p3at import P3at, from_model, printed_ticksmm, revcount, ticksmm
from skidsteer.reproduce.mandow2007_printed import TABLES, Column, model_of


@pytest.mark.parametrize("column", [column for table in TABLES.values() for column in table])
def test_matrix_is_that_of_the_paper(column: Column) -> None:
    y, right, left, alpha_r, alpha_l = column[:5]
    paper = np.array(  # Eq. (7): rows v_x (to the right), v_y (forward), omega
        [[-y * alpha_l, y * alpha_r], [right * alpha_l, -left * alpha_r], [-alpha_l, alpha_r]]
    ) / (right - left)
    forward, leftward, turning = paper[1], -paper[0], paper[2]
    assert_allclose(model_of(column).matrix(), [forward, leftward, turning], rtol=1e-12)


def test_factory_integers() -> None:
    """Section IV.B: alpha = 1, r = 110 mm, x_ICR = 300 mm."""
    assert ticksmm(1.0, 0.110) == 138
    assert printed_ticksmm(1.0, 0.110) == 138  # Eq. (14)
    assert revcount(0.300, 138) == 32515  # Eq. (15)
    assert from_model(SymmetricIcr(0.3, 1.0)) == P3at(138, 32515)


def test_integers_of_another_wheel_and_alpha_by_hand() -> None:
    """15180 / (0.9 * 95) = 177.54; as printed 0.9 * 95 * 138 / 110 = 107.26; 2 pi 275 * 178 / 8 = 38445.2."""
    assert ticksmm(0.9, 0.095) == 178
    assert printed_ticksmm(0.9, 0.095) == 107
    assert from_model(SymmetricIcr(0.275, 0.9), 0.095) == P3at(178, 38445)


def test_a_robot_with_these_integers_knows_where_it_is() -> None:
    """Ticks of a wheel: 138 a mm of nominal travel. True travel is alpha times that."""
    model = SymmetricIcr(0.275, 0.91)
    integers = from_model(model)
    nominal, angle = 1000.0, 2.0 * np.pi  # [mm] rolled, [rad] turned
    assert_allclose(138 * nominal / integers.ticksmm, model.alpha * nominal, rtol=0.005)
    rolled = angle * model.icr_y / model.alpha  # [m] by each side, from Eq. (8)
    assert_allclose(138 * 1e3 * rolled / 8.0, integers.revcount, rtol=0.005)


@given(st.floats(0.1, 1.0), st.floats(0.5, 1.5), st.floats(0.05, 0.2))
def test_integers_are_rounded_to_the_nearest(icr_y: float, alpha: float, radius: float) -> None:
    integers = from_model(SymmetricIcr(icr_y, alpha), radius)
    assert abs(integers.ticksmm - 15.18 / (alpha * radius)) <= 0.5 + 1e-9  # 138 * 0.110 m
    assert abs(integers.revcount - 250.0 * np.pi * icr_y * integers.ticksmm) <= 0.5 + 1e-9  # 2 pi 1e3 / 8


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ticksmm(0.0), "alpha > 0, got 0.0"),
        (lambda: ticksmm(1.0, -0.1), "wheel_radius > 0, got -0.1"),
        (lambda: printed_ticksmm(float("nan")), "alpha > 0, got nan"),
        (lambda: revcount(-0.3, 138), "icr_y > 0, got -0.3"),
        (lambda: P3at(0, 32515), "at least 1, got 0, 32515"),
    ],
)
def test_impossible_numbers_are_refused(call: object, message: str) -> None:
    assert callable(call)
    with pytest.raises(ValueError, match=message):
        call()
