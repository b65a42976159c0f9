import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import brentq, minimize

from skidsteer.errors import RequestError
from skidsteer.reproduce.wang2015 import TABLE_3
from skidsteer.se2 import FloatArray
from skidsteer.terramechanics import steady_turn as solver
from skidsteer.terramechanics.robot import Robot, robot, wang_robot
from skidsteer.terramechanics.shear import Quadrature, wheel_forces
from skidsteer.terramechanics.steady_turn import SteadyTurn, rims_on_path, steady_turn
from skidsteer.terramechanics.terrain import TERRAINS, Terrain
from skidsteer.vehicle import Vehicle, preset

LAB = TERRAINS["lab"]
P3AT = wang_robot()
RATIOS = np.arange(8.0)  # lambda
RIGID = Terrain("rigid", 0.4, 0.4, 1e-8)
SLOW = 0.005  # [m/s] no centrifugal force


def points(wheel_base: float = 0.275, track_width: float = 0.4, **measures: float) -> Robot:
    """A robot on wheels that touch the ground in a point each."""
    vehicle = Vehicle("points", track_width, 0.1, wheel_base=wheel_base, mass=31.0)
    return robot(vehicle, **({"patch_length": 1e-4, "patch_width": 1e-4, "com_height": 0.0} | measures))


def on_path(made: Robot, terrain: Terrain, ratio: FloatArray | float, speed: float = 0.3) -> SteadyTurn:
    rims = rims_on_path(ratio, speed)
    return steady_turn(made, terrain, rims[..., 0], rims[..., 1])


# Limits


@settings(deadline=None, max_examples=30)
@given(st.floats(0.2, 0.6), st.floats(0.3, 0.7), st.floats(-8.0, 8.0), st.floats(0.05, 1.0))
def test_point_contacts_without_resistance(base: float, track: float, ratio: float, friction: float) -> None:
    """Chi = 1 + (L / B)^2, by hand.

    With equal loads, y0 half the ICRs' distance and no side slip, every wheel slides with omega (y0 - B / 2) along and
    omega L / 2 across, so that the moments balance where (y0 - B / 2) B / 2 = (L / 2)^2, whatever lambda and mu.
    """
    made, terrain = points(base, track), replace(RIGID, friction=friction, friction_opposite=friction)
    assert on_path(made, terrain, ratio, SLOW).icr_coefficient == pytest.approx(1.0 + (base / track) ** 2, abs=1e-3)


@pytest.mark.parametrize("resistance", [0.03, 0.1])
def test_rolling_resistance_on_the_spot(resistance: float) -> None:
    """By hand: t = (chi - 1) B / L of along to across solves t - (mu_r / mu) sqrt(1 + t^2) = L / B."""
    t = brentq(lambda t: t - resistance / 0.4 * np.hypot(1.0, t) - 0.275 / 0.4, 0.0, 10.0)
    found = on_path(points(), replace(RIGID, rolling_resistance=resistance), 0.0)
    assert found.icr_coefficient == pytest.approx(1.0 + t * 0.275 / 0.4, abs=1e-3)


def test_straight_on_without_resistance_nothing_slips() -> None:
    found = steady_turn(P3AT, replace(LAB, rolling_resistance=0.0), 0.4, 0.4)
    assert_allclose(found.twist, [0.4, 0.0, 0.0], atol=1e-9)
    assert not np.isfinite(found.icr_coefficient)
    assert np.isinf(found.path_curvature)


@pytest.mark.parametrize("friction", [0.1, 1.0, 30.0, 1e3])
def test_straight_on_the_slip_pulls_against_rolling_resistance(friction: float) -> None:
    """By hand: mu_r / mu = 1 - (1 - exp(-a)) / a, a = slip * length / K; none is left as mu grows."""
    found = steady_turn(P3AT, replace(LAB, friction=friction), 0.4, 0.4)
    a = brentq(lambda a: 1.0 + np.expm1(-a) / a - 0.0371 / friction, 1e-9, 1e3)
    slip = 1.0 - found.twist[0] / 0.4
    assert slip == pytest.approx(a * 0.00054 / 0.035, rel=1e-3)
    assert_allclose(found.twist[1:], 0.0, atol=1e-9)


@settings(deadline=None, max_examples=25)
@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.03, 0.03))
def test_left_and_right_are_mirror_images(left: float, right: float, ahead: float) -> None:
    made = robot(preset("pioneer-p3at"), com_x=ahead, com_y=0.02)
    other = replace(made, com_y=-0.02)
    one, mirrored = steady_turn(made, LAB, left, right), steady_turn(other, LAB, right, left)
    assert_allclose(mirrored.twist * [1.0, -1.0, -1.0], one.twist, atol=1e-6)


@pytest.mark.parametrize(("ahead", "left_of"), [(0.02, 0.0), (-0.025, 0.03), (0.015, -0.05)])
@pytest.mark.parametrize("rims", [(-0.01, 0.01), (0.004, 0.016), (0.02, 0.025)])
def test_a_slow_turn_loses_the_least_power(ahead: float, left_of: float, rims: tuple[float, float]) -> None:
    """Independent: Coulomb friction, rims given, is in balance where the sum of mu N |slide| is least."""
    made = points(com_x=ahead, com_y=left_of)
    found = steady_turn(made, RIGID, *rims)

    def lost(twist: FloatArray) -> float:
        x, y = made.places.T
        slide = np.hypot(twist[0] - twist[2] * y - np.array(rims)[made.side], twist[1] + twist[2] * x)
        return float(made.loads([0.0, 0.0]) @ slide)

    start = [np.mean(rims), 0.0, np.diff(rims)[0] / 0.6]
    simplex = np.vstack([start, start + 0.01 * np.eye(3)])
    least = minimize(
        lost, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12, "initial_simplex": simplex}
    )
    turn = found.twist[2]
    assert_allclose(found.twist / turn, least.x / least.x[2], rtol=1e-3, atol=1e-3)
    assert turn == pytest.approx(least.x[2], rel=1e-3)


def test_a_centre_of_mass_ahead_moves_the_icr_ahead() -> None:
    """By more than itself, and by more the nearer it is to an axle. MuJoCo has 0.11 m for 0.05 m (L = 0.27)."""
    found = [float(on_path(wang_robot(com_x=x), LAB, 2.0, SLOW).icr_x) for x in (0.0, 0.02, 0.05, -0.05)]
    assert found[0] == pytest.approx(0.0, abs=1e-3)
    assert 0.02 < found[1] < found[2]
    assert found[2] == pytest.approx(0.11, abs=0.015)
    assert found[3] == pytest.approx(-found[2], abs=0.003)


# The balance, Eq. (16)


@pytest.mark.parametrize("height", [0.0, 0.15])
def test_the_printed_equations_hold(height: float) -> None:
    made = wang_robot(com_x=0.02, com_y=-0.01, com_height=height)
    found = steady_turn(made, LAB, 0.35, 0.55)
    v_x, v_y, omega = found.twist
    v_x, v_y = v_x - omega * -0.01, v_y + omega * 0.02  # of the centre of mass
    speed, beta, radius = np.hypot(v_x, v_y), np.arctan2(v_y, v_x), np.hypot(v_x, v_y) / omega
    forces = wheel_forces(made, LAB, found.twist, found.rims, found.loads)
    rolling = 0.0371 * found.loads
    centrifugal = 31.0 * speed**2 / radius
    assert centrifugal > 4.0
    assert forces[:, 0].sum() - rolling.sum() == pytest.approx(-centrifugal * np.sin(beta), abs=1e-4)
    assert forces[:, 1].sum() == pytest.approx(centrifugal * np.cos(beta), abs=1e-6)
    about_mass = forces[:, 2].sum() + made.places[:, 1] @ rolling
    about_mass -= 0.02 * forces[:, 1].sum() - -0.01 * (forces[:, 0].sum() - rolling.sum())
    assert about_mass == pytest.approx(0.0, abs=1e-4)
    acceleration = centrifugal / 31.0 * np.array([-np.sin(beta), np.cos(beta)])
    assert_allclose(found.loads, made.loads(acceleration), rtol=1e-6)


def test_centrifugal_force_pushes_the_robot_outwards() -> None:
    """A left turn drifts to the right: the ICR moves ahead. For small drifts by v omega / (mu g h'), by hand.

    Each wheel slides with (a, b) omega = (y0 - B / 2, L / 2) omega, so that a drift v_y changes the friction across by
    mu m g a^2 / (a^2 + b^2)^(3/2) / omega for each m/s.
    """
    terrain, speed = replace(RIGID, friction=0.6), 0.3
    found = on_path(points(), terrain, 4.0, speed)
    omega, b = found.twist[2], 0.1375
    a = 0.2 * (found.icr_coefficient - 1.0)
    drift = speed * omega**2 / (0.6 * 9.81 * a**2 / np.hypot(a, b) ** 3)
    assert found.icr_x == pytest.approx(drift / omega, rel=0.02)
    assert found.icr_x > 0.005
    assert on_path(P3AT, LAB, 4.0, 0.6).icr_x > 0.03
    assert abs(on_path(P3AT, LAB, 4.0, SLOW).icr_x) < 2e-3


# Figure 5


def test_the_curve_of_the_paper() -> None:
    """Within 10 % of Table 3, above it; the fall is that from the spot to a circle, by rolling resistance."""
    on_path(P3AT, LAB, RATIOS)
    start = time.process_time()
    found = on_path(P3AT, LAB, RATIOS)
    assert time.process_time() - start < 0.2
    chi = found.icr_coefficient
    assert_allclose(found.path_curvature, RATIOS, atol=1e-12)
    assert np.abs(chi / TABLE_3 - 1.0).max() < 0.1
    assert (chi > TABLE_3).all()
    assert chi[0] - chi[1:].max() > 0.09
    assert np.ptp(chi[1:]) < 0.02
    without = on_path(P3AT, replace(LAB, rolling_resistance=0.0), RATIOS, SLOW).icr_coefficient
    assert np.ptp(without) < 2e-3  # then nothing is left of the fall


def test_tyres_soft_sideways_give_the_fall_that_was_measured() -> None:
    """Wheels that hardly slip hold the less sideways the softer they are there; wheels that slip do not care."""
    speeds = rims_on_path(RATIOS[:, None], np.linspace(0.1, 0.5, 5))
    chi = steady_turn(P3AT, TERRAINS["tiles"], speeds[..., 0], speeds[..., 1]).icr_coefficient.mean(axis=1)
    assert_allclose(chi[[0, *range(2, 8)]], np.array(TABLE_3)[[0, *range(2, 8)]], atol=0.016)
    assert (np.diff(chi[2:]) < -0.003).all()
    same = replace(TERRAINS["tiles"], lateral_shear_modulus=None)
    assert np.ptp(on_path(P3AT, same, RATIOS, SLOW).icr_coefficient) < 2e-3


def test_what_the_nodes_leave_of_accuracy() -> None:
    rims = rims_on_path(RATIOS, 0.3)
    fine = steady_turn(P3AT, LAB, *rims.T, Quadrature(60, 20)).icr_coefficient
    assert_allclose(on_path(P3AT, LAB, RATIOS).icr_coefficient, fine, atol=2e-5)
    assert np.abs(steady_turn(P3AT, LAB, *rims.T, Quadrature(3, 1)).icr_coefficient - fine).max() > 1e-3


def test_rims_on_a_path() -> None:
    ratio = np.array([-3.0, -0.5, 0.0, 0.5, 1.0, 4.0])
    rims = rims_on_path(ratio, 0.3)
    assert_allclose(rims.sum(axis=1) / np.diff(rims)[:, 0], ratio)
    assert_allclose(rims[[2, 4, 5]], [[-0.3, 0.3], [0.0, 0.6], [0.225, 0.375]])
    assert_allclose(rims_on_path(np.inf, 0.3), [0.3, 0.3])


def test_a_batch_is_a_loop() -> None:
    left, right = np.meshgrid([-0.3, 0.1, 0.4], [0.2, 0.5])
    found = steady_turn(P3AT, LAB, left, right)
    assert found.twist.shape == (2, 3, 3)
    assert found.icr_y.shape == (2, 3, 2)
    for i in range(2):
        for j in range(3):
            assert_allclose(steady_turn(P3AT, LAB, left[i, j], right[i, j]).twist, found.twist[i, j], atol=1e-7)


# Bad requests


def test_on_ice_a_fast_turn_gets_as_wide_as_friction_demands() -> None:
    found = steady_turn(robot(preset("jackal")), TERRAINS["ice"], 1.5, 2.0)
    slow = steady_turn(robot(preset("jackal")), TERRAINS["ice"], 0.15, 0.2)
    acceleration = np.hypot(*found.twist[:2]) * found.twist[2]
    assert 0.5 < acceleration / (0.1 * 9.81) < 1.0
    assert found.icr_coefficient > 1.1 * slow.icr_coefficient
    assert found.icr_x > 0.5  # it slides more sideways than it drives ahead


def test_what_finds_no_balance_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver, "ITERATIONS", 2)
    with pytest.raises(
        RequestError, match=r"^the forces find no balance with rim speeds of 0.100 and 0.300 m/s \(1 of 2"
    ):
        steady_turn(P3AT, LAB, [0.0, 0.1], [0.0, 0.3])


def test_a_fast_spin_lifts_the_wheels_behind_a_high_load() -> None:
    """In a turn left or right none lifts: the less load the inner side has, the less the robot turns."""
    made = wang_robot(com_height=1.0, com_x=0.1)
    with pytest.raises(
        RequestError, match=r"^(left|right) wheel 2 lifts off the ground with rim speeds of -2.000 and 2"
    ):
        steady_turn(made, LAB, [-0.2, -2.0], [0.2, 2.0])


def test_speeds_must_be_finite() -> None:
    with pytest.raises(RequestError, match="rim speeds must be finite"):
        steady_turn(P3AT, LAB, np.nan, 0.1)
