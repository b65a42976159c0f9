import math

import numpy as np
import pytest
from scipy.optimize import fsolve

from control_loop import CENTRED, PLANT, follow
from skidsteer.control import PathState, Soetanto, SoetantoGains, Wheels, path_error
from skidsteer.control.soetanto import GAINS
from skidsteer.control.target import rate
from skidsteer.paths import arc, clothoid, lemniscate, line
from skidsteer.se2 import FloatArray, compose, exp

CURVE = clothoid(6.0, -0.5, 0.6, (1.0, -2.0, 0.7))
GAINS_BY_HAND = SoetantoGains(k1=2.0, k2=3.0, gamma=4.0, b=0.3, theta_a=0.6, epsilon=1e6)
LAW = Soetanto(GAINS_BY_HAND, desired=1.2)
STILL = np.zeros(3)


def test_the_law_by_hand() -> None:
    """c = 0.05 at s = 3; x_e, y_e, theta_e = 0.1, -0.2, 0.3."""
    v, omega = LAW.command(compose(CURVE.at(3.0), (0.1, -0.2, 0.3)), STILL, PathState(CURVE, 3.0))
    speed = 1.2 / (1.0 + 0.3 * 0.05)
    delta, by_y = 0.6 * math.tanh(0.2), -0.6 * (1.0 - math.tanh(0.2) ** 2)
    s_rate = speed * math.cos(0.3) + 2.0 * 0.1
    y_rate = speed * math.sin(0.3) - 0.05 * s_rate * 0.1
    chord = (math.sin(0.3) - math.sin(delta)) / (0.3 - delta)
    by_hand = by_y * y_rate + 0.05 * s_rate - 4.0 * -0.2 * speed * chord - 3.0 * (0.3 - delta)
    assert (v, omega) == pytest.approx((speed, by_hand), abs=1e-12)
    assert omega == pytest.approx(0.248037, abs=1e-6)


def test_the_law_waits_with_its_target() -> None:
    """Far behind it the target stands, s' = 0: then omega = delta' - gamma ... - k2 e."""
    v, omega = LAW.command(compose(CURVE.at(3.0), (-1.0, -0.2, 0.3)), STILL, PathState(CURVE, 3.0))
    delta, by_y = 0.6 * math.tanh(0.2), -0.6 * (1.0 - math.tanh(0.2) ** 2)
    chord = (math.sin(0.3) - math.sin(delta)) / (0.3 - delta)
    assert omega == pytest.approx(by_y * v * math.sin(0.3) + 4.0 * 0.2 * v * chord - 3.0 * (0.3 - delta), abs=1e-12)


def test_at_no_deviation_the_quotient_is_a_cosine() -> None:
    """(sin(theta_e) - sin(delta)) / (theta_e - delta) is 0 / 0 there."""
    state, y_e = PathState(CURVE, 3.0), -0.2
    delta = 0.6 * math.tanh(0.2)
    at, near = (LAW.command(compose(CURVE.at(3.0), (0.0, y_e, delta + e)), STILL, state)[1] for e in (0.0, 1e-6))
    assert at == pytest.approx(near, abs=1e-5)


@pytest.mark.parametrize("turned", np.radians([-175.0, -90.0, 60.0, 90.0, 135.0, 179.0]))
def test_it_turns_back_however_it_faces(turned: float) -> None:
    _, omega = LAW.command(compose(CURVE.at(3.0), (0.0, 0.0, turned)), STILL, PathState(CURVE, 3.0))
    assert -np.sign(turned) * omega > 1.0


def test_v1_falls_as_proved() -> None:
    """dV1/dt = -k1 x_e^2 - k2 e^2 / gamma + y_e v sin(delta), on the exact kinematics with icr_x = 0."""
    for seed in range(100):
        rng = np.random.default_rng(seed)
        state = PathState(CURVE, rng.uniform(0.5, 5.5))
        pose = compose(CURVE.at(state.s), rng.uniform([-0.2, -1.5, -1.0], [0.5, 1.5, 1.0]))
        v, omega = LAW.command(pose, STILL, state)
        error = path_error(state, pose)
        delta = -0.6 * math.tanh(error.y_e)
        e = error.theta_e - delta
        ahead, before = (_v1_after(pose, state, v, omega, h) for h in (1e-6, -1e-6))
        proved = -2.0 * error.x_e**2 - 3.0 / 4.0 * e**2 + error.y_e * v * math.sin(delta)
        assert (ahead - before) / 2e-6 == pytest.approx(proved, abs=1e-6)
        assert proved < 0.0


def _v1_after(pose: FloatArray, state: PathState, v: float, omega: float, h: float) -> float:
    s = state.s + h * rate(path_error(state, pose), v, 0.0, omega, 2.0)
    return LAW.lyapunov(compose(pose, exp(np.array([v, 0.0, omega]) * h)), PathState(CURVE, s))


def test_far_from_the_path_it_drives_at_half_the_speed() -> None:
    law = Soetanto(GAINS["launch"], desired=1.2)
    state = PathState(CURVE, 5.0)
    c = -0.5 + 1.1 / 6.0 * 5.0
    assert law.command(CURVE.at(5.0), STILL, state)[0] == pytest.approx(min(1.2 / (1.0 + 0.2 * c), 1.0))
    assert law.command(compose(CURVE.at(5.0), (0.0, 1.1, 0.0)), STILL, state)[0] == pytest.approx(0.6)


@pytest.mark.parametrize("gains", ["header", "launch"])
def test_it_follows_the_lemniscate_if_icr_x_is_0(gains: str) -> None:
    path, wheels = lemniscate(110.77 / 5.0 / 2.622057), Wheels(CENTRED, 3.0)
    run = follow(Soetanto(GAINS[gains], 1.0), wheels, path, path.at(0.0) + [0.2, -0.6, 0.5], 35.0)
    assert run.s[-1] > path.length
    assert abs(run.aside[0]) > 0.2
    assert np.abs(run.aside[700:]).max() < 0.003


def test_where_icr_x_is_not_0_curves_have_an_offset() -> None:
    """At rest x_e', y_e', theta_e' of Eq. (7) are 0: about 13 cm at a radius of 2 m."""
    law, ring = Soetanto(GAINS["header"], 1.0), arc(2.0, 8.0 * math.pi)

    def rates(error: FloatArray) -> FloatArray:
        state = PathState(ring, 10.0)
        v, omega = law.command(compose(ring.at(10.0), error), STILL, state)
        x_e, y_e, theta_e = error
        s_rate = v * math.cos(theta_e) + x_e  # k1 = 1; the law does not know icr_x
        aside = v * math.sin(theta_e) - 0.28 * omega * math.cos(theta_e) - 0.5 * s_rate * x_e
        along = v * math.cos(theta_e) + 0.28 * omega * math.sin(theta_e) - s_rate * (1.0 - 0.5 * y_e)
        return np.array([along, aside, omega - 0.5 * s_rate])

    x_e, y_e, _ = fsolve(rates, [0.0, -0.1, 0.1])
    offset = math.hypot(x_e, 2.0 - y_e) - 2.0  # from the circle
    run = follow(law, Wheels(PLANT, 3.0), ring, (0.0, 0.0, 0.0), 40.0)
    assert offset > 0.1
    assert run.aside[-1] == pytest.approx(-offset, abs=2e-3)


@pytest.mark.parametrize("start", [(0.0, 4.0, 0.3), (2.0, -1.0, math.pi), (1.0, -6.0, 2.5)])
def test_it_comes_to_a_line_from_anywhere(start: tuple[float, float, float]) -> None:
    run = follow(Soetanto(GAINS["launch"], 1.0), Wheels(PLANT, 3.0), line(40.0), start, 30.0)
    assert np.abs(run.aside[-50:]).max() < 0.01
    assert run.poses[-1, 0] > 10.0


def test_gains_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="need gamma > 0"):
        SoetantoGains(1.0, 1.0, 0.0)
    with pytest.raises(ValueError, match="need b >= 0"):
        SoetantoGains(1.0, 1.0, 1.0, -0.1)
    with pytest.raises(ValueError, match="need desired > 0"):
        Soetanto(GAINS["header"], desired=math.nan)
