import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skidsteer.control import PathState, path_error
from skidsteer.control.target import Approach, advanced, rate, turn_with_target
from skidsteer.paths import arc
from skidsteer.se2 import FloatArray, compose, exp

RING = arc(2.0, 4.0 * math.pi)
TWIST = np.array([0.9, -0.28 * 0.4, 0.4])


def test_the_rate_by_hand() -> None:
    error = path_error(PathState(RING, 3.0), compose(RING.at(3.0), (0.1, -0.2, 0.3)))
    assert rate(error, 0.9, 0.28, 0.4, 2.0) == pytest.approx(0.9 * math.cos(0.3) + 0.28 * 0.4 * math.sin(0.3) + 0.2)
    assert rate(error._replace(x_e=-1.0), 0.9, 0.28, 0.4, 2.0) == 0.0  # it never goes back


def test_delta_and_its_slope() -> None:
    approach = Approach(0.6, 2.0)
    assert approach.angle(0.5, 0.1) == pytest.approx(0.1 - 0.6 * math.tanh(0.25))
    assert approach.slope(0.5) == pytest.approx((approach.angle(0.5 + 1e-6) - approach.angle(0.5 - 1e-6)) / 2e-6)


def test_the_turn_keeps_the_heading_at_delta() -> None:
    """omega = delta' + c s' holds e: differences of delta along the exact kinematics, for both kinds of target."""
    approach, s, k1, v, x = Approach(0.6, 2.0), 3.0, 2.0, 0.9, 0.28
    pose = compose(RING.at(s), (0.1, -0.2, 0.3))
    error = path_error(PathState(RING, s), pose)
    both = turn_with_target(error, v, x, k1, approach.slope(error.y_e), 0.0)
    for (a, b), moves in zip(both, (True, False), strict=True):
        omega = a / (1.0 - b)
        twist = np.array([v, -x * omega, omega])
        s_rate = rate(error, v, x, omega, k1) if moves else 0.0

        def deviation(h: float, twist: FloatArray = twist, s_rate: float = s_rate) -> float:
            at = path_error(PathState(RING, s + h * s_rate), compose(pose, exp(h * twist)))
            return at.theta_e - approach.angle(at.y_e)

        assert deviation(1e-5) == pytest.approx(deviation(-1e-5), abs=1e-9)


@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_the_target_moves_as_its_differential_equation_says(dt: float) -> None:
    pose, state = compose(RING.at(1.0), (0.3, -0.2, 0.1)), PathState(RING, 1.0)

    def slope(t: float, s: FloatArray) -> list[float]:
        return [rate(path_error(PathState(RING, s[0]), compose(pose, exp(t * TWIST))), 0.9, 0.28, 0.4, 3.0)]

    exact = solve_ivp(slope, (0.0, 2.0), [1.0], rtol=1e-9, atol=1e-9).y[0, -1]
    for k in range(round(2.0 / dt)):
        state = advanced(state, compose(pose, exp((k + 1) * dt * TWIST)), TWIST, dt, 0.28, 3.0)
    assert state.s == pytest.approx(exact, abs=0.1 * dt)


def test_no_step_is_too_long() -> None:
    """Plain Euler steps of k1 x_e overshoot beyond k1 dt = 1 and grow beyond 2."""
    state = advanced(PathState(RING, 1.0), compose(RING.at(1.0), (0.3, 0.0, 0.0)), np.zeros(3), 10.0, 0.28, 8.0)
    assert 1.2 < state.s < 1.31
