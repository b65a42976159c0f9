import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from control_loop import CENTRED, PLANT, follow
from skidsteer.control import PathState, Pentzer, PentzerGains, Wheels
from skidsteer.control.pentzer import GAINS
from skidsteer.paths import Path, arc, clothoid, lemniscate, line
from skidsteer.se2 import FloatArray, compose, exp

CURVE = clothoid(6.0, -0.5, 0.6, (1.0, -2.0, 0.7))
FREE = replace(GAINS["published"], omega_max=math.inf)
STILL = np.zeros(3)
RING = arc(2.0, 8.0 * math.pi)


def test_the_law_by_hand() -> None:
    """c = 0.05 and c' = 1.1 / 6 at s = 3; y_e, theta_e = -0.2, 0.3; icr_x = 0.28; v = 1.2."""
    law = Pentzer(PentzerGains(4.0, 3.0), 1.2, 0.28)
    pose, state = compose(CURVE.at(3.0), (0.0, -0.2, 0.3)), PathState(CURVE, 3.0)
    shifted = -0.2 + 0.28 * math.sin(0.3)
    by_hand = -4.0 * 1.2 * shifted * math.sin(0.3) / 0.3 - 3.0 * 1.2 * 0.3
    assert law.command(pose, STILL, state) == pytest.approx((1.2, by_hand), abs=1e-12)
    assert by_hand == pytest.approx(-0.525584, abs=1e-6)

    sine, slope = 0.28 * (0.05 + 0.28 * 1.1 / 6.0), 1.1 / 6.0
    heading = math.asin(sine)
    e, by_s = 0.3 - heading, 0.28 * slope / math.sqrt(1.0 - sine**2)
    aside = -0.2 + 0.28 * (math.sin(0.3) - sine)
    back = -4.0 * 1.2 * aside * math.sin(e) / e - 3.0 * 1.2 * e
    turn = (0.05 + by_s) / (1.0 + 0.05 * 0.2)
    omega = (turn * 1.2 * math.cos(0.3) + back) / (1.0 - turn * 0.28 * math.sin(0.3))
    ahead = replace(law, feed_forward=True)
    assert ahead.command(pose, STILL, state) == pytest.approx((1.2, omega), abs=1e-12)
    # and omega is that of the path, of its heading, and back: omega = (c + heading') s' + back
    s_rate = (1.2 * math.cos(0.3) + 0.28 * omega * math.sin(0.3)) / (1.0 + 0.05 * 0.2)
    assert omega == pytest.approx((0.05 + by_s) * s_rate + back)


def test_at_no_heading_error_the_quotient_is_1() -> None:
    law, state = Pentzer(FREE, 1.0), PathState(CURVE, 3.0)
    assert law.command(compose(CURVE.at(3.0), (0.0, -0.2, 0.0)), STILL, state)[1] == pytest.approx(1.0)


@pytest.mark.parametrize(("path", "feed_forward"), [(line(9.0), False), (line(9.0), True), (CURVE, True)])
def test_its_lyapunov_function_falls(path: Path, feed_forward: bool) -> None:
    """V = (k1 y_e^2 + theta_e^2) / 2 has dV/dt = -k2 |v| theta_e^2 if icr_x is 0; on curves with feed-forward only."""
    law = Pentzer(FREE, 1.0, feed_forward=feed_forward)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        s, y_e, theta_e = rng.uniform([1.0, -0.8, -3.0], [5.0, 0.8, 3.0])
        pose = compose(path.at(s), (0.0, y_e, theta_e))
        v, omega = law.command(pose, STILL, PathState(path, s))
        twist = np.array([v, 0.0, omega])
        ahead, before = (_energy(path, compose(pose, exp(h * twist)), s) for h in (1e-5, -1e-5))
        assert (ahead - before) / 2e-5 == pytest.approx(-5.0 * theta_e**2, abs=1e-5)


def _energy(path: Path, pose: FloatArray, near: float) -> float:
    _, y_e, theta_e = path.error(pose, path.project(pose[:2], near=near))
    return 0.5 * float(5.0 * y_e**2 + theta_e**2)


@pytest.mark.parametrize("icr_x", [0.0, 0.28])
def test_as_published_it_has_an_offset_on_curves(icr_x: float) -> None:
    """At rest omega is that of the circle it drives: 8.7 cm outside of a radius of 2 m, 27 cm with icr_x = 0.28 m."""

    def miss(y_e: float) -> float:
        curvature = 0.5 / (1.0 - 0.5 * y_e)
        sine = icr_x * curvature
        theta_e = math.asin(sine)
        turn = curvature / math.cos(theta_e)  # omega / v_x
        return -5.0 * (y_e + icr_x * sine) * np.sinc(theta_e / np.pi) - 5.0 * theta_e - turn

    offset = float(brentq(miss, -1.0, 0.0))
    wheels = Wheels(PLANT if icr_x else CENTRED, 3.0)
    run = follow(Pentzer(FREE, 1.0, icr_x), wheels, RING, (0.0, 0.0, 0.0), 20.0)
    assert run.aside[-1] == pytest.approx(offset, abs=2e-3)
    assert offset < -0.08
    ahead = follow(Pentzer(FREE, 1.0, icr_x, feed_forward=True), wheels, RING, (0.0, 0.0, 0.0), 20.0)
    assert abs(ahead.aside[-1]) < 1e-3


@pytest.mark.parametrize("icr_x", [0.0, 0.28])
def test_with_feed_forward_it_follows_the_lemniscate(icr_x: float) -> None:
    path = lemniscate(110.77 / 5.0 / 2.622057)
    wheels = Wheels(PLANT if icr_x else CENTRED, 3.0)
    start = path.at(0.0) + [0.2, -0.6, 0.5]
    ahead = follow(Pentzer(FREE, 1.0, icr_x, feed_forward=True), wheels, path, start, 35.0)
    assert abs(ahead.aside[0]) > 0.2
    assert ahead.s[-1] > path.length
    assert np.abs(ahead.aside[700:]).max() < 0.005
    plain = follow(Pentzer(FREE, 1.0, icr_x), wheels, path, start, 35.0)
    assert np.abs(plain.aside[700:]).mean() > 0.05


def test_a_fast_turn_slows_the_drive() -> None:
    v, omega = Pentzer(GAINS["published"], 1.0).command(
        compose(CURVE.at(3.0), (0.0, -0.5, 0.0)), STILL, PathState(CURVE, 3.0)
    )
    assert (v, omega) == pytest.approx((0.6 / 2.5, 0.6))


@pytest.mark.parametrize("y_e", [1.0, 1.9, 2.0, 2.5])
def test_near_the_centre_of_curvature_the_command_stays_finite(y_e: float) -> None:
    law = Pentzer(FREE, 1.0, 0.28, feed_forward=True)
    v, omega = law.command(compose(RING.at(3.0), (0.0, y_e, 0.2)), STILL, PathState(RING, 3.0))
    assert v == 1.0
    assert abs(omega) < 60.0


def test_where_the_feed_forward_has_no_solution_it_is_held() -> None:
    """omega = turn (v cos(theta_e) + icr_x omega sin(theta_e)) + back has none at turn icr_x sin(theta_e) = 1."""
    law, tight = Pentzer(FREE, 1.0, 0.28, feed_forward=True), arc(1.0, 6.0)
    _, omega = law.command(compose(tight.at(3.0), (0.0, 1.0, 1.2)), STILL, PathState(tight, 3.0))
    heading = math.asin(0.28)
    e, aside = 1.2 - heading, 1.0 + 0.28 * (math.sin(1.2) - 0.28)
    back = -5.0 * aside * math.sin(e) / e - 5.0 * e
    assert omega == pytest.approx((math.cos(1.2) / 0.2 + back) / 0.25)


def test_gains_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="need k2 > 0"):
        PentzerGains(1.0, -1.0)
    with pytest.raises(ValueError, match="need desired > 0"):
        Pentzer(FREE, desired=0.0)
