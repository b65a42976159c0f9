import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from control_loop import CENTRED, PLANT
from skidsteer.control import SaturationSpeed, Wheels, icr_x_at
from skidsteer.control.speed import CLOSE
from skidsteer.models import Curvature, Icr, Model, ScheduledIcr

SCHEDULED = ScheduledIcr(0.48, -0.42, 0.28, 0.9, 0.93, 0.02, 0.05, 0.1, 0.1, 0.3)
MODELS = {"icr": PLANT, "scheduled_icr": SCHEDULED, "curvature": Curvature(0.5, 0.05, 0.95, 0.6)}
LIMIT = 1.5
icrs = st.builds(
    Icr, st.floats(0.2, 0.9), st.floats(-0.9, -0.2), st.floats(-0.4, 0.4), st.floats(0.7, 1.2), st.floats(0.7, 1.2)
)


@given(icrs, st.floats(-1.5, 1.5))
def test_the_reachable_speed_is_equation_16(icr: Icr, curvature: float) -> None:
    y_l, y_r, _, a_l, a_r = icr.theta
    by_right = a_r * LIMIT / (1.0 + abs(y_r * curvature))  # the outer wheels of a left turn
    by_left = a_l * LIMIT / (1.0 + abs(y_l * curvature))
    reached = Wheels(icr, LIMIT).reachable(curvature)
    outer, other = (by_right, a_l) if curvature > 0.0 else (by_left, a_r)
    inner = other * LIMIT / abs(1.0 - abs((y_l if curvature > 0.0 else y_r) * curvature) or 1e-12)
    assert_allclose(reached, min(outer, inner), rtol=1e-9)  # the weaker side where the alphas differ more


def test_far_from_the_path_the_inner_wheels_stand() -> None:
    wheels = Wheels(PLANT, LIMIT)
    assert_allclose(wheels.turning(1.0), 0.93 * 0.48 * LIMIT / 0.9)  # Eq. (17), omega > 0
    assert_allclose(wheels.turning(-1.0), 0.9 * 0.42 * LIMIT / 0.9)  # omega < 0
    assert_allclose(wheels.turning(0.0), 0.5 * (wheels.turning(1.0) + wheels.turning(-1.0)))


def test_equation_17_on_both_sides_of_epsilon() -> None:
    speed = SaturationSpeed(Wheels(CENTRED, LIMIT), epsilon=0.4)
    assert_allclose(speed.at(0.1, 0.6, 1.0), 0.93 * LIMIT / (1.0 + 0.42 * 0.6))
    assert_allclose(speed.at(0.1, -0.6, -1.0), 0.9 * LIMIT / (1.0 + 0.48 * 0.6))
    assert_allclose(speed.at(0.4, 0.6, 1.0), 0.93 * 0.48 * LIMIT / 0.9)
    assert_allclose(speed.at(9.0, 0.6, -1.0), 0.9 * 0.42 * LIMIT / 0.9)
    assert SaturationSpeed(Wheels(CENTRED, LIMIT), desired=0.3).at(0.0, 0.0, 0.0) == 0.3


def test_the_speed_does_not_jump() -> None:
    """The printed Eq. (17) does, with the sign of omega and where V1 crosses epsilon."""
    speed = SaturationSpeed(Wheels(PLANT, LIMIT))
    n = 2001
    for v1, c, omega in (
        (np.linspace(0.0, 1.0, n), np.full(n, 0.5), np.full(n, 0.3)),
        (np.full(n, 0.4), np.full(n, 0.1), np.linspace(-1.0, 1.0, n)),
        (np.full(n, 0.1), np.linspace(-1.0, 1.0, n), np.full(n, 0.2)),
    ):
        values = [speed.at(*row) for row in np.column_stack([v1, c, omega]).tolist()]
        assert np.ptp(values) > 0.05
        assert np.abs(np.diff(values)).max() < 0.02 * LIMIT


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@given(v=st.floats(-5.0, 5.0), omega=st.floats(-8.0, 8.0))
@settings(max_examples=60)
def test_no_wheel_is_ever_too_fast_and_the_curvature_is_kept(model: Model, v: float, omega: float) -> None:
    speeds = Wheels(model, LIMIT).speeds(v, omega)
    assert np.abs(speeds).max() <= LIMIT  # exactly, whatever rounding did
    reached = model.twist(*speeds)
    size = math.hypot(v, omega)
    assert abs(reached[0] * omega - reached[2] * v) <= 1e-5 * (1e-9 + size) * (1.0 + math.hypot(reached[0], reached[2]))
    assert reached[0] * v + reached[2] * omega >= -1e-9  # slowed, never turned round
    asked = model.wheel_speeds(v, omega)
    if np.abs(asked).max() <= LIMIT:
        assert_allclose(speeds, asked)
    else:
        assert np.abs(speeds).max() > (1.0 - 1.01 * CLOSE) * LIMIT  # and not slower than need be


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_the_reachable_speed_has_a_wheel_at_its_limit(model: Model) -> None:
    for curvature in (-0.8, 0.0, 0.3):
        v = Wheels(model, LIMIT).reachable(curvature)
        assert_allclose(np.abs(model.wheel_speeds(v, v * curvature)).max(), LIMIT, rtol=1.01 * CLOSE)


def test_a_linear_model_reaches_the_limit_exactly() -> None:
    assert np.abs(Wheels(PLANT, LIMIT).speeds(3.0, -2.0)).max() == pytest.approx(LIMIT, rel=1e-15)


def test_where_the_icr_lies() -> None:
    assert_allclose(icr_x_at(PLANT, 1.0), 0.28)
    assert_allclose(icr_x_at(PLANT, -1.0, 0.5), 0.28)
    gain = 1.0 + 0.1  # of SCHEDULED, almost straight
    assert_allclose(icr_x_at(SCHEDULED, 1.0), 0.28 + 0.05 / 1.3 / gain, rtol=1e-3)


def test_what_is_refused() -> None:
    with pytest.raises(ValueError, match="finite max_speed > 0"):
        Wheels(PLANT, math.inf)
    for v, omega in ((math.nan, 0.0), (1.0, math.inf)):
        with pytest.raises(ValueError, match="finite v and omega"):
            Wheels(PLANT, LIMIT).speeds(v, omega)
    with pytest.raises(ValueError, match="epsilon > 0"):
        SaturationSpeed(Wheels(PLANT, LIMIT), epsilon=0.0)
    with pytest.raises(ValueError, match="a turn at some speed"):
        icr_x_at(PLANT, 0.0)
