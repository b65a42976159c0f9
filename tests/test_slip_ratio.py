import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.errors import DataError
from skidsteer.models import MODELS
from skidsteer.models.slip_ratio import (
    CircleRun,
    radius_of_arc,
    rims_on_circle,
    slip_coefficient,
    slip_ratio,
    slip_ratio_from_slips,
    turn_radius,
)

B = 0.28
rims = st.floats(0.05, 2.0)
radii = st.floats(0.2, 20.0)

# Worked by hand


def test_radius_by_hand() -> None:
    # v_o = 1.2, K v_i = 2 * 0.3 = 0.6: R = 0.14 * 1.8 / 0.6
    assert float(turn_radius(1.2, 0.3, 2.0, B)) == pytest.approx(0.42, abs=1e-15)
    assert float(slip_ratio(1.2, 0.3, 0.42, B)) == pytest.approx(2.0, abs=1e-14)


def test_slip_by_hand() -> None:
    # inner dragged to 0.45 from 0.3 m/s, outer spins: 0.9 of 1.2 m/s
    assert float(slip_coefficient(0.3, 0.45)) == pytest.approx(-0.5)
    assert float(slip_coefficient(1.2, 0.9)) == pytest.approx(0.25)
    assert float(slip_ratio_from_slips(-0.5, 0.25)) == pytest.approx(2.0)


def test_arc_by_hand() -> None:
    # quarter of a circle of 2 m: the end lies 2 m ahead and 2 m beside, chord 2 sqrt 2
    radius, sigma = radius_of_arc(2.0 * np.sqrt(2.0), 2.0, 0.01, 0.02)
    assert float(radius) == pytest.approx(2.0)
    assert float(sigma) == pytest.approx(2.0 * np.hypot(0.02 / 2.0 / np.sqrt(2.0), 0.01), rel=1e-12)


def test_run_by_hand() -> None:
    run = CircleRun(0.3, 1.2, 0.42, "floor", speed=0.63)
    assert (run.direction, run.outer, run.inner) == ("left", 1.2, 0.3)
    assert run.path_curvature == pytest.approx(1.5 / 0.9)
    assert run.icr_y == pytest.approx(0.252)  # 0.42 * 0.9 / 1.5
    assert run.steering_efficiency(B) == pytest.approx(0.28 / 0.504)
    assert run.slip_ratio(B) == pytest.approx(2.0)
    # omega = 1.5: inner 1.5 * 0.28 = 0.42 of 0.3, outer 1.5 * 0.56 = 0.84 of 1.2
    assert run.slip_coefficients(B) == pytest.approx((-0.4, 0.3))


# Laws


@given(rims, rims, st.floats(0.5, 4.0))
def test_ratio_of_the_radius_is_the_ratio(outer: float, inner: float, ratio: float) -> None:
    if abs(outer - ratio * inner) > 1e-3:
        assert_allclose(slip_ratio(outer, inner, turn_radius(outer, inner, ratio, B), B), ratio, rtol=1e-9)


@given(rims, st.floats(1.01, 5.0), radii, st.floats(0.1, 1.0))
def test_coefficients_give_the_ratio_of_the_radius(inner: float, factor: float, radius: float, share: float) -> None:
    """Eq. (14) of Eq. (22) is Eq. (15), whatever the speed over ground."""
    run = CircleRun(inner, inner * factor, radius, speed=share * inner * factor)
    slips = run.slip_coefficients(B)
    assert slips is not None
    assert slips[0] is not None
    assert_allclose(slip_ratio_from_slips(slips[0], slips[1]), run.slip_ratio(B), rtol=1e-9)


@given(radii, st.floats(1e-3, np.pi))
def test_arcs_of_any_angle_give_their_radius(radius: float, angle: float) -> None:
    chord, beside = 2.0 * radius * np.sin(angle / 2.0), 2.0 * radius * np.sin(angle / 2.0) ** 2
    assert_allclose(radius_of_arc(chord, beside)[0], radius, rtol=1e-12)


@given(radii, st.floats(0.1, 3.0))
def test_classic_chord_and_height_by_the_recipe(radius: float, half_angle: float) -> None:
    c, h = 2.0 * radius * np.sin(half_angle), radius * (1.0 - np.cos(half_angle))
    assert_allclose(radius_of_arc(np.hypot(c / 2.0, h), h)[0], radius, rtol=1e-9)


def test_sigma_of_the_radius_is_that_of_many_measurements() -> None:
    rng = np.random.default_rng(0)
    chord, sagitta = 1.5 + 0.01 * rng.standard_normal(20_000), 0.3 + 0.004 * rng.standard_normal(20_000)
    _, sigma = radius_of_arc(1.5, 0.3, 0.01, 0.004)
    assert float(np.std(radius_of_arc(chord, sagitta)[0])) == pytest.approx(float(sigma), rel=0.03)


@given(st.floats(0.2, 5.0), st.floats(-3.0, 3.0), st.floats(0.5, 4.0), st.floats(-0.5, 0.9))
def test_planned_rims_drive_the_circle(radius: float, omega: float, ratio: float, slip: float) -> None:
    left, right = rims_on_circle(radius, omega, ratio, B, slip)
    outer, inner = (right, left) if omega >= 0 else (left, right)
    assert_allclose(outer * (1.0 - slip), abs(omega) * (radius + B / 2), atol=1e-12)
    if abs(omega) > 1e-3:
        assert_allclose(turn_radius(outer, inner, ratio, B), radius, rtol=1e-9)


def test_planning_of_section_five() -> None:
    """R = 0.9 m at 0.5 rad/s with k = 65 and 26, 0.66 and 0.244 m/s by the calibration: K_s between runs 2L and 3L."""
    ratio = float(slip_ratio(0.66, 0.244, 0.9, B))
    assert 1.83 < ratio < 2.71
    assert_allclose(rims_on_circle(0.9, 0.5, ratio, B, 1.0 - 0.52 / 0.66), [0.244, 0.66], rtol=1e-12)


@given(rims, st.floats(0.1, 0.9), radii)
def test_mirrored_and_backward_runs_are_the_same(outer: float, share: float, radius: float) -> None:
    inner = outer * share
    left, right = CircleRun(inner, outer, radius), CircleRun(outer, inner, radius)
    back = CircleRun(-inner, -outer, radius)
    assert (left.direction, right.direction, back.direction) == ("left", "right", "left")
    for run in (right, back):
        assert (run.path_curvature, run.slip_ratio(B)) == (left.path_curvature, left.slip_ratio(B))


def test_one_ratio_is_an_ideal_drive_and_equal_thrust_is_straight() -> None:
    assert float(turn_radius(1.0, 0.5, 1.0, B)) == pytest.approx(B / 2 * 3)
    assert float(turn_radius(1.0, 0.5, 2.0, B)) == np.inf
    assert float(turn_radius(1.0, 0.5, 2.5, B)) < 0.0  # curves to the other side


# Why it is no motion model


def test_a_constant_ratio_turns_run_1l_to_the_wrong_side() -> None:
    assert float(turn_radius(0.632, 0.410, 2.5, B)) < 0.0
    assert not any("slip" in name for name in MODELS)


# Refusals


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.5, 0.5, 1.0), "both sides run at 0.5 m/s: a straight run has no radius, leave it out"),
        ((0.0, 0.0, 1.0), "both sides are at rest: no circle was driven"),
        (
            (-0.5, 0.5, 1.0),
            "the sides run against each other (v_left -0.5, v_right 0.5 m/s): there is no inner one, use the turn test",
        ),
        ((0.2, 0.5, 0.0), "the radius must be a positive length in m, got 0"),
        ((0.2, 0.5, -1.0), "the radius must be a positive length in m, got -1"),
        ((0.2, 0.5, np.nan), "the radius must be a positive length in m, got nan"),
        ((0.2, 0.5, np.inf), "the radius must be a positive length in m, got inf"),
        ((np.nan, 0.5, 1.0), "a circle run needs finite rim speeds, got v_left nan, v_right 0.5 m/s"),
        ((0.2, 0.5, 1.0, "", 0.0), "the speed over ground must be positive, in m/s, got 0"),
    ],
)
def test_runs_that_are_no_circle_are_refused(arguments: tuple[float, float, float], message: str) -> None:
    with pytest.raises(DataError, match=f"^{re.escape(message)}$"):
        CircleRun(*arguments)


@pytest.mark.parametrize(
    ("chord", "sagitta", "message"),
    [
        (1.0, -0.1, "chord and sagitta must be positive lengths in m, got 1 and -0.1"),
        (1.0, 0.0, "chord and sagitta must be positive lengths in m, got 1 and 0; a sagitta of 0 is a straight"),
        (0.0, 0.1, "chord and sagitta must be positive lengths in m, got 0 and 0.1"),
        (np.nan, 0.1, "chord and sagitta must be positive lengths in m, got nan and 0.1"),
        (0.5, 1.0, "the chord would be longer than the diameter, 0.25 m; are the two columns swapped?"),
    ],
)
def test_arcs_that_are_no_arc_are_refused(chord: float, sagitta: float, message: str) -> None:
    with pytest.raises(DataError, match=re.escape(message)):
        CircleRun.from_chord(0.2, 0.5, chord, sagitta)


def test_half_a_circle_is_the_longest_arc() -> None:
    assert float(radius_of_arc(2.0, 2.0)[0]) == 1.0


def test_inner_side_at_rest_leaves_the_ratio_open() -> None:
    run = CircleRun(0.0, 0.6, 0.4, speed=0.3)
    assert run.slip_ratio(B) is None
    slips = run.slip_coefficients(B)
    assert slips is not None
    assert slips[0] is None
    assert slips[1] == pytest.approx(1.0 - 0.3 * (1 + 0.35) / 0.6)
    assert CircleRun(0.1, 0.6, 0.4).slip_coefficients(B) is None


def test_functions_refuse_by_name() -> None:
    with pytest.raises(ValueError, match="need a v_inner other than 0"):
        slip_ratio(0.5, 0.0, 1.0, B)
    with pytest.raises(ValueError, match="need a rim speed other than 0"):
        slip_coefficient([0.5, 0.0], 0.3)
    with pytest.raises(ValueError, match="need a slip_outer other than 1"):
        slip_ratio_from_slips(0.5, 1.0)
    with pytest.raises(ValueError, match="need finite radii above half the track width"):
        rims_on_circle(0.1, 0.5, 2.0, B)
    with pytest.raises(ValueError, match=r"need slip_ratio > 0 and slip_outer < 1, got 2\.0, 1\.0"):
        rims_on_circle(1.0, 0.5, 2.0, B, 1.0)


def test_chord_with_an_error_carries_it() -> None:
    run = CircleRun.from_chord(0.2, 0.5, 1.0, 0.2, "grass", sigma=0.005)
    assert run.radius == pytest.approx(2.5)
    assert run.radius_sigma == pytest.approx(2.5 * np.hypot(0.01, 0.025))
    assert CircleRun.from_chord(0.2, 0.5, 1.0, 0.2).radius_sigma is None
