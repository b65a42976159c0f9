from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from skidsteer.drive import Series
from skidsteer.gyro import GyroErrors, Turn, bias_at_rest, correlation_offset, rough_errors
from skidsteer.models import Differential

MODEL = Differential(0.4)
ERRORS = GyroErrors(time_offset=0.3, bias=0.05, scale=0.9)


def yaw(t: np.ndarray) -> np.ndarray:
    """What the robot turns: at rest until 3 s, then to and fro."""
    return np.where(t > 3.0, 0.8 * np.sin(0.9 * (t - 3.0)) ** 2, 0.0)


def rate(t: np.ndarray) -> np.ndarray:
    return np.where(t > 3.0, 0.8 * 0.9 * np.sin(1.8 * (t - 3.0)), 0.0)


def gyro_with(errors: GyroErrors, seconds: float = 30.0, dt: float = 0.005) -> Series:
    """Samples of a gyro that is wrong by ``errors``: measured = true / scale + bias, stamped late."""
    t = np.arange(0.0, seconds, dt)
    return Series(t + errors.time_offset, rate(t) / errors.scale + errors.bias, "gyro")


def wheels(seconds: float = 30.0) -> Series:
    t = np.arange(0.0, seconds, 0.01)
    half = 0.2 * rate(t + 0.005)  # held for 0.01 s: its middle is 0.005 s later
    return Series(t, np.c_[-half, half], "wheels")


@given(st.floats(0.5, 28.0), st.floats(0.0, 1.0))
def test_turn_is_the_true_turn(start: float, share: float) -> None:
    end = start + share * (29.0 - start)
    found = Turn.of(gyro_with(ERRORS)).between(np.array([start]), np.array([end]), ERRORS)
    assert_allclose(found, yaw(np.array([end])) - yaw(np.array([start])), atol=1e-4)


def test_turn_by_hand() -> None:
    turn = Turn.of(Series(np.array([0.0, 1.0, 2.0]), np.array([0.2, 0.4, 0.0])))
    assert_allclose(turn.yaw, [0.0, 0.3, 0.5])
    # from 0.5 to 1.5 on the wheels is 0.6 to 1.6 on the gyro's clock: 0.18 to 0.42, less a bias of 0.04, times 1.5
    errors = GyroErrors(time_offset=0.1, bias=0.04, scale=1.5)
    assert_allclose(turn.between(np.array([0.5]), np.array([1.5]), errors), [1.5 * (0.42 - 0.18 - 0.04)])
    assert_allclose(turn.rate_at(np.array([0.4]), errors), [1.5 * (0.3 - 0.04)])


def test_rate_is_the_true_rate() -> None:
    t = np.linspace(3.5, 29.0, 50)
    assert_allclose(Turn.of(gyro_with(ERRORS)).rate_at(t, ERRORS), rate(t), atol=1e-4)


@pytest.mark.parametrize("name", ["time_offset", "bias", "scale"])
def test_derivatives_that_the_fit_relies_on(name: str) -> None:
    """By the offset the rates at both ends, by the bias the time, by the scale the turn over the scale."""
    turn, h = Turn.of(gyro_with(ERRORS)), 1e-4
    a, b = np.array([4.0, 10.0]), np.array([6.0, 11.0])
    up, down = (replace(ERRORS, **{name: getattr(ERRORS, name) + sign * h}) for sign in (1, -1))
    slope = (turn.between(a, b, up) - turn.between(a, b, down)) / (2 * h)
    expected = {
        "time_offset": turn.rate_at(b, ERRORS) - turn.rate_at(a, ERRORS),
        "bias": -ERRORS.scale * (b - a),
        "scale": turn.between(a, b, ERRORS) / ERRORS.scale,
    }
    assert_allclose(slope, expected[name], atol=2e-3 if name == "time_offset" else 1e-9)


def test_nothing_is_turned_over_a_gap() -> None:
    turn = Turn.of(Series(np.array([0.0, 1.0, 3.0, 4.0]), np.ones(4)))
    assert_allclose(turn.yaw, [0.0, 1.0, 1.0, 2.0])
    known = turn.covers(np.array([0.0, 0.5, 3.0, 3.5, -0.1]), np.array([1.0, 3.5, 4.0, 4.1, 0.5]), GyroErrors())
    assert_array_equal(known, [True, False, True, False, False])
    late = turn.covers(np.array([0.0, 0.5, 2.5]), np.array([0.4, 1.0, 3.5]), GyroErrors(time_offset=0.5))
    assert_array_equal(late, [True, False, True])


@pytest.mark.parametrize("late", [0.0, 0.3, -1.234, 2.5])
def test_correlation_finds_the_offset(late: float) -> None:
    gyro = gyro_with(replace(ERRORS, time_offset=late))
    assert correlation_offset(wheels(), gyro, MODEL) == pytest.approx(late, abs=0.004)
    assert correlation_offset(wheels(), gyro, Differential(0.9)) == pytest.approx(late, abs=0.004)


def test_correlation_stays_inside_its_search() -> None:
    gyro = gyro_with(replace(ERRORS, time_offset=0.3))
    assert -0.11 <= correlation_offset(wheels(), gyro, MODEL, search=(-0.1, 0.1)) <= 0.11


def test_a_dead_gyro_is_not_shifted() -> None:
    dead = Series(np.arange(0.0, 30.0, 0.01), np.zeros(3000))
    assert correlation_offset(wheels(), dead, MODEL) == 0.0
    assert rough_errors(wheels(), dead, MODEL) == GyroErrors()


def test_bias_is_that_at_rest() -> None:
    gyro = gyro_with(ERRORS)
    assert bias_at_rest(wheels(), gyro, 0.3) == pytest.approx(0.05, abs=1e-12)
    moving = wheels().between(3.2, 30.0)
    assert moving is not None
    moving = Series(moving.t, moving.values + 0.3)
    assert bias_at_rest(moving, gyro.between(4.0, 30.0) or gyro, 0.3) == 0.0


def test_rough_errors_leave_the_scale() -> None:
    found = rough_errors(wheels(), gyro_with(ERRORS), MODEL)
    assert found.time_offset == pytest.approx(0.3, abs=0.004)
    assert found.bias == pytest.approx(0.05, abs=1e-6)
    assert found.scale == 1.0
