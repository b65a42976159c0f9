import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from control_loop import CENTRED, PLANT, follow
from skidsteer.control import Huskic, HuskicGains, PathState, SaturationSpeed, Wheels, path_error
from skidsteer.control.huskic import GAINS
from skidsteer.control.target import rate
from skidsteer.paths import arc, clothoid, lemniscate, line
from skidsteer.se2 import FloatArray, compose, exp

WHEELS = Wheels(PLANT, 3.0)
CURVE = clothoid(6.0, -0.5, 0.6, (1.0, -2.0, 0.7))  # its curvature changes all along
SPEED = SaturationSpeed(WHEELS, desired=1.0, epsilon=1e6)  # 1 m/s whatever V1
GAINS_BY_HAND = HuskicGains(k1=2.0, k2=3.0, lam=0.7, theta_a=0.6)
LAUNCH = replace(GAINS["launch"], omega_max=math.inf)
STILL = np.zeros(3)
HUNDRED_STATES = range(100)


def state_off(path_s: float, error: tuple[float, float, float]) -> tuple[PathState, FloatArray]:
    """A target at path_s on ``CURVE``, and the pose with these x_e, y_e, theta_e."""
    return PathState(CURVE, path_s), compose(CURVE.at(path_s), error)


def random_state(seed: int) -> tuple[PathState, FloatArray]:
    rng = np.random.default_rng(seed)
    return state_off(rng.uniform(0.5, 5.5), tuple(rng.uniform([-0.3, -0.6, -0.5], [0.3, 0.6, 0.5])))


def slope_of_v1(law: Huskic, state: PathState, pose: FloatArray, v: float, omega: float, h: float = 1e-6) -> float:
    """dV1/dt on the exact kinematics of ``PLANT``, by central differences; the target moves by Eq. (10)."""
    s_rate = rate(path_error(state, pose), v, law.icr_x, omega, law.gains.k1)
    twist = np.array([v, -PLANT.icr_x * omega, omega])
    ahead, before = (
        law.lyapunov(compose(pose, exp(k * twist)), PathState(state.path, state.s + k * s_rate)) for k in (h, -h)
    )
    return (ahead - before) / (2.0 * h)


def deviation(law: Huskic, state: PathState, pose: FloatArray) -> tuple[float, float, float]:
    """e, and the slopes of delta by y_e and by s, without and with the heading of steady motion."""
    error = path_error(state, pose)
    x = law.icr_x if law.feed_forward else 0.0
    sine = x * (error.curvature + x * error.slope)
    e = error.theta_e + law.gains.theta_a * math.tanh(error.y_e) - math.asin(sine)
    return e, -law.gains.theta_a / math.cosh(error.y_e) ** 2, x * error.slope / math.sqrt(1.0 - sine**2)


def bracket_law(law: Huskic, state: PathState, pose: FloatArray, v: float, sign: float) -> float:
    """Omega of Eq. (10), by a search for its root; sign = -1 as printed, 1 corrected."""
    error, (e, by_y, by_s) = path_error(state, pose), deviation(law, state, pose)
    x_e, y_e, theta_e, c, _ = error
    lam, x = law.gains.lam, law.icr_x

    def miss(omega: float) -> float:
        s_rate = max(0.0, v * math.cos(theta_e) + x * omega * math.sin(theta_e) + law.gains.k1 * x_e)
        delta_rate = by_y * (v * math.sin(theta_e) - x * omega * math.cos(theta_e) - c * s_rate * x_e) + by_s * s_rate
        T = abs(math.sin(e)) / (math.sin(e) * math.cos(e))
        bracket = lam * y_e * (v * math.sin(theta_e) - x * omega * math.cos(theta_e)) + law.gains.k2 * e**2
        return delta_rate - sign * T * bracket - (omega - c * s_rate)

    return float(brentq(miss, -1e3, 1e3, xtol=1e-13))


def test_the_law_by_hand() -> None:
    """c = -0.5 + 1.1 / 6 s at s = 3; x_e, y_e, theta_e = 0.1, -0.2, 0.3; icr_x = 0.28, v = 1."""
    state, pose = state_off(3.0, (0.1, -0.2, 0.3))
    c, sin, cos = 0.05, math.sin(0.3), math.cos(0.3)
    e = 0.3 - 0.6 * math.tanh(0.2)  # 0.1815748
    by_y = -0.6 * (1.0 - math.tanh(0.2) ** 2)
    T = 1.0 / math.cos(e)
    s_a, s_b = cos + 2.0 * 0.1, 0.28 * sin
    y_a, y_b = sin - c * 0.1 * s_a, -0.28 * cos - c * 0.1 * s_b
    a = by_y * y_a + c * s_a - T * (0.7 * -0.2 * sin + 3.0 * e**2)
    b = by_y * y_b + c * s_b + T * 0.7 * -0.2 * 0.28 * cos
    v, omega = Huskic(GAINS_BY_HAND, SPEED, 0.28).command(pose, STILL, state)
    assert (v, omega) == pytest.approx((1.0, a / (1.0 - b)), abs=1e-12)
    assert omega == pytest.approx(-0.190804, abs=1e-6)
    measured = Huskic(GAINS_BY_HAND, SPEED, 0.28, measured_omega=True)
    assert measured.command(pose, [1.0, 0.0, 0.4], state)[1] == pytest.approx(a + 0.4 * b, abs=1e-12)


@pytest.mark.parametrize("feed_forward", [False, True])
def test_the_law_is_equation_10_with_the_other_sign(feed_forward: bool) -> None:
    law = Huskic(GAINS_BY_HAND, SPEED, 0.28, feed_forward)
    for seed in HUNDRED_STATES:
        state, pose = random_state(seed)
        v, omega = law.command(pose, STILL, state)
        assert omega == pytest.approx(bracket_law(law, state, pose, v, 1.0), abs=1e-9)


@pytest.mark.parametrize("feed_forward", [False, True])
def test_v1_falls_as_proved(feed_forward: bool) -> None:
    """Not only falls: dV1/dt = -k1 x_e^2 - k2 e^2 / lambda, where the target moves."""
    law = Huskic(GAINS_BY_HAND, SPEED, 0.28, feed_forward)
    for seed in HUNDRED_STATES:
        state, pose = random_state(seed)
        v, omega = law.command(pose, STILL, state)
        error, (e, _, by_s) = path_error(state, pose), deviation(law, state, pose)
        gained = v * math.cos(error.theta_e) + 0.28 * omega * math.sin(error.theta_e)
        by_target = error.x_e * (-2.0 * error.x_e if gained + 2.0 * error.x_e > 0.0 else gained)
        assert (by_s != 0.0) is feed_forward
        slope = slope_of_v1(law, state, pose, v, omega)
        assert slope == pytest.approx(by_target - 3.0 / 0.7 * e**2, abs=1e-6)


def test_v1_grows_along_the_law_as_printed() -> None:
    """The counter-example: Eq. (10) with the sign of its bracket as printed."""
    law = Huskic(GAINS_BY_HAND, SPEED, 0.28)
    slopes = []
    for seed in HUNDRED_STATES:
        state, pose = random_state(seed)
        slopes.append(slope_of_v1(law, state, pose, 1.0, bracket_law(law, state, pose, 1.0, -1.0)))
    assert np.mean(np.array(slopes) > 1e-6) > 0.3


def test_at_no_deviation_it_turns_with_the_path() -> None:
    """The printed Eq. (10) is 0 / 0 at e = 0."""
    law = Huskic(LAUNCH, SPEED)
    state = PathState(CURVE, 3.0)
    on_path = CURVE.at(3.0)
    assert path_error(state, on_path).theta_e == 0.0
    assert law.command(on_path, STILL, state) == pytest.approx((1.0, 0.05), abs=1e-12)
    for e in (-1e-9, 1e-9):
        assert law.command(on_path + [0.0, 0.0, e], STILL, state)[1] == pytest.approx(0.05, abs=1e-6)


@pytest.mark.parametrize("turned", np.radians([80.0, 90.0, 91.0, 120.0, 179.0, -80.0, -90.0, -100.0, -175.0]))
def test_beyond_its_domain_it_stands_and_turns_back(turned: float) -> None:
    """The printed Eq. (10) divides by cos(e): 0 at 90 deg, of the other sign beyond."""
    law = Huskic(GAINS["launch"], SPEED, 0.28)
    v, omega = law.command(compose(CURVE.at(3.0), (0.0, 0.0, turned)), STILL, PathState(CURVE, 3.0))
    assert v == 0.0
    assert -np.sign(turned) * omega == pytest.approx(0.5)
    _, free = Huskic(LAUNCH, SPEED, 0.28).command(
        compose(CURVE.at(3.0), (0.0, 0.0, turned)), STILL, PathState(CURVE, 3.0)
    )
    assert abs(free) < 2.0 * 40.0 * turned**2 / math.cos(math.radians(75.0))  # large, but no pole at 90 deg


def test_the_command_has_no_step_where_it_begins_to_stand() -> None:
    law = Huskic(GAINS["header"], SPEED, 0.28)
    state = PathState(CURVE, 3.0)
    angles = np.radians(np.arange(20.0, 170.0, 0.05))
    commands = np.array([law.command(compose(CURVE.at(3.0), (0.1, -0.2, a)), STILL, state) for a in angles])
    assert np.abs(np.diff(commands, axis=0)).max() < 0.01


def test_a_fast_turn_slows_the_drive_and_keeps_its_curvature() -> None:
    state, pose = state_off(3.0, (0.0, 0.4, 0.3))
    free = Huskic(LAUNCH, SPEED, 0.28).command(pose, STILL, state)
    held = Huskic(GAINS["launch"], SPEED, 0.28).command(pose, STILL, state)
    assert abs(held[1]) == pytest.approx(0.5)
    assert abs(free[1]) > 1.0
    assert held[1] / held[0] == pytest.approx(free[1] / free[0])


def test_the_speed_is_equation_17() -> None:
    """On the path Eq. (16) with omega / v_x = c / cos(theta_e) (Eq. (15)), far from it with standing inner wheels."""
    law = Huskic(LAUNCH, SaturationSpeed(WHEELS, epsilon=0.5), 0.28, deceleration=100.0)
    state = PathState(CURVE, 5.0)
    c = -0.5 + 1.1 / 6.0 * 5.0
    heading = math.asin(0.28 * (c + 0.28 * 1.1 / 6.0))
    v, _ = law.command(CURVE.at(5.0), [1.0, 0.0, 0.3], state)
    assert v == pytest.approx(0.93 * 3.0 / (1.0 + 0.42 * c / math.cos(heading)))
    for omega, expected in ((0.3, 0.93 * 0.48 * 3.0 / 0.9), (-0.3, 0.9 * 0.42 * 3.0 / 0.9)):
        v, _ = law.command(compose(CURVE.at(5.0), (0.0, 1.0, -0.6)), [1.0, 0.0, omega], state)
        assert v == pytest.approx(expected)
    # epsilon is one of Eq. (8) as printed: 0.5 |sin e| / lambda = 0.32 at e = 0.7, not yet half of 1.2
    wide = replace(law, speed=SaturationSpeed(WHEELS, epsilon=1.2))
    assert wide.command(compose(CURVE.at(5.0), (0.0, 0.0, 0.7)), STILL, state)[0] == pytest.approx(
        WHEELS.reachable(c / math.cos(heading))
    )


@pytest.mark.parametrize("gains", ["header", "launch"])
def test_where_icr_x_is_not_0_curves_have_an_offset_that_feed_forward_takes(gains: str) -> None:
    """Proposition 1 fails: the law rests at e = 0, where x_e' and y_e' of Eq. (7) are 0, not y_e: 13 and 17 cm."""
    law = Huskic(replace(GAINS[gains], omega_max=math.inf), SaturationSpeed(WHEELS, desired=1.0), 0.28)
    c, ring = 0.5, arc(2.0, 8.0 * math.pi)

    def target(y_e: float) -> tuple[float, float]:
        """theta_e = delta(y_e), and the speed of the target with omega = c s'."""
        theta_e = -0.25 * math.pi * math.tanh(y_e)
        return theta_e, math.cos(theta_e) / (1.0 - 0.28 * c * math.sin(theta_e) - c * y_e)

    def aside(y_e: float) -> float:
        theta_e, s_rate = target(y_e)
        return math.sin(theta_e) - 0.28 * c * s_rate * math.cos(theta_e) - (c * s_rate) ** 2 * y_e / law.gains.k1

    y_e = float(brentq(aside, -0.5, 0.0))
    x_e = c * y_e * target(y_e)[1] / law.gains.k1
    offset = math.hypot(x_e, 2.0 - y_e) - 2.0  # outside of the circle
    plain = follow(law, WHEELS, ring, (0.0, 0.0, 0.0), 30.0)
    assert plain.aside[-200:].mean() == pytest.approx(-offset, abs=0.01)  # steps of 20 ms leave a deviation e
    assert 0.12 < offset < 0.18
    ahead = follow(replace(law, feed_forward=True), WHEELS, ring, (0.0, 0.0, 0.0), 30.0)
    assert np.abs(ahead.aside[-200:]).max() < 0.03
    assert abs(ahead.aside[-1]) < 0.6 * abs(ahead.aside[750])  # and it goes on to 0, like 1 / t


def test_it_follows_the_lemniscate_of_the_paper() -> None:
    """Five of them are 110.77 m long."""
    path = lemniscate(110.77 / 5.0 / 2.622057)
    wheels = Wheels(CENTRED, 3.0)
    law = Huskic(LAUNCH, SaturationSpeed(wheels, desired=1.0))
    run = follow(law, wheels, path, path.at(0.0) + [0.2, -0.6, 0.5], 35.0)
    assert np.abs(run.rims).max() <= 3.0
    assert run.s[-1] > path.length
    assert abs(run.aside[0]) > 0.2
    assert np.abs(run.aside[700:]).max() < 0.01


@pytest.mark.parametrize("start", [(0.0, 4.0, 0.3), (2.0, -1.0, math.pi), (0.5, 0.1, -1.6), (1.0, -6.0, 2.5)])
def test_it_comes_to_a_line_from_anywhere(start: tuple[float, float, float]) -> None:
    law = Huskic(LAUNCH, SaturationSpeed(WHEELS, desired=1.0), 0.28)
    run = follow(law, WHEELS, line(40.0), start, 25.0)
    assert np.abs(run.aside[-50:]).max() < 0.05
    assert run.poses[-1, 0] > 10.0
