"""The engine against Coulomb's law, which our own equations give for patches of no size on ground that never yields."""

import sys
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares

from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.identify.calibrate import CalibrateOptions, calibrate
from skidsteer.models import Icr
from skidsteer.mujoco_plant import STEP, RollingEngine, roll
from skidsteer.se2 import FloatArray, chain, compose, exp
from skidsteer.simulate import Motion, Sensors, controller, recorded, rims_from_manoeuvres
from skidsteer.terramechanics.robot import Robot, robot
from skidsteer.terramechanics.steady_turn import rims_on_path, steady_turn
from skidsteer.terramechanics.terrain import TERRAINS, Area, Ground, Terrain
from skidsteer.vehicle import preset

engine = pytest.mark.skipif(find_spec("mujoco") is None, reason="mujoco is not installed")
P3AT = preset("pioneer-p3at")
SLOW = 0.2  # [m/s]


def coulomb(friction: float) -> Terrain:
    return Terrain("coulomb", friction, friction, 1e-9)


def held(left: float, right: float, duration: float) -> Series:
    return Series(np.array([0.0, duration]), np.array([[left, right]] * 2))


def steady(motion: Motion, after: float = 1.5) -> tuple[FloatArray, FloatArray]:
    """Mean twist (3,) and rim speeds (2,) once the robot moves evenly."""
    late = motion.t > after
    return motion.twist[late].mean(axis=0), motion.rims[late].mean(axis=0)


def chi_and_icr_x(made: Robot, friction: float, path_curvature: float, speed: float = SLOW) -> tuple[float, float]:
    left, right = rims_on_path(path_curvature, speed)
    twist, rims = steady(roll(made, coulomb(friction), held(left, right, 5.0)))
    return float((rims[1] - rims[0]) / twist[2] / made.vehicle.track_width), float(-twist[1] / twist[2])


def limit(made: Robot, friction: float, path_curvature: float) -> tuple[float, float]:
    left, right = rims_on_path(path_curvature, SLOW)
    point = replace(made, patch_length=1e-6, patch_width=1e-6)
    found = steady_turn(point, coulomb(friction), left, right)
    return float(found.icr_coefficient), float(found.icr_x)


@engine
@pytest.mark.parametrize("path_curvature", [0.0, 1.0, 2.0, 5.0, -5.0])
def test_turns_have_the_chi_of_coulombs_law(path_curvature: float) -> None:
    """1 + (L / B)^2 for four equal loads, 1.4556."""
    made = robot(P3AT)
    chi, icr_x = chi_and_icr_x(made, 0.44, path_curvature)
    wanted, ahead = limit(made, 0.44, path_curvature)
    assert wanted == pytest.approx(1.0 + (0.27 / 0.40) ** 2, abs=0.006)
    assert chi == pytest.approx(wanted, rel=0.02)
    assert icr_x == pytest.approx(ahead, abs=0.007)


@engine
@pytest.mark.parametrize("name", ["warthog", "jackal", "husky-a200", "panther"])
def test_other_robots_too(name: str) -> None:
    made = robot(preset(name))
    for path_curvature in (0.0, 2.0):
        assert chi_and_icr_x(made, 0.4, path_curvature)[0] == pytest.approx(
            limit(made, 0.4, path_curvature)[0], rel=0.02
        )


@engine
@pytest.mark.parametrize(("friction", "share"), [(0.1, 0.003), (0.3, 0.02), (0.5, 0.06), (0.65, 0.06), (0.8, 0.06)])
def test_chi_does_not_depend_on_the_friction(friction: float, share: float) -> None:
    assert chi_and_icr_x(robot(P3AT), friction, 2.0, 0.1)[0] == pytest.approx(1.4556, rel=share)


@engine
def test_where_the_loads_differ_the_engine_is_farther_from_coulombs_law() -> None:
    six = robot(replace(P3AT, wheels=6))
    assert chi_and_icr_x(six, 0.4, 2.0)[0] == pytest.approx(limit(six, 0.4, 2.0)[0], rel=0.12)
    for ahead in (-0.05, 0.02, 0.05):
        made = robot(P3AT, com_x=ahead)
        (chi, icr_x), (wanted, x) = chi_and_icr_x(made, 0.44, 2.0), limit(made, 0.44, 2.0)
        assert chi == pytest.approx(wanted, rel=0.12)
        assert icr_x == pytest.approx(x, abs=0.02)


@engine
def test_a_straight_is_rolled_and_a_robot_at_rest_stays() -> None:
    motion = roll(robot(P3AT, com_x=0.01, com_y=0.02), coulomb(0.44), held(0.3, 0.3, 3.0))
    assert_allclose(steady(motion)[0], [0.3, 0.0, 0.0], atol=1e-3)
    # A lag of 0.1 s, and 3 ms of the speed loop: 0.3 (3 - 0.1033) m.
    assert motion.pose[-1, 0] == pytest.approx(0.3 * 2.8967, abs=4e-3)
    assert_allclose(motion.pose[-1, 1:], 0.0, atol=3e-3)
    assert_allclose(motion.rims[np.searchsorted(motion.t, 0.1)], 0.3 * (1.0 - np.exp(-1.0)), atol=6e-3)
    rest = roll(robot(P3AT), coulomb(0.44), held(0.0, 0.0, 1.0))
    assert np.abs(rest.pose).max() < 1e-6
    assert rest.t[-1] == pytest.approx(1.0, abs=STEP)


@engine
def test_poses_are_the_integral_of_the_twists() -> None:
    motion = roll(robot(P3AT, com_x=0.03), coulomb(0.44), held(-0.1, 0.3, 4.0))
    between = 0.5 * (motion.twist[1:] + motion.twist[:-1]) * np.diff(motion.t)[:, None]
    assert motion.pose[-1, 2] > 2.0
    assert_allclose(chain(exp(between))[-1], motion.pose[-1], atol=5e-3)


@engine
def test_left_and_right_are_alike() -> None:
    left, right = (steady(roll(robot(P3AT), coulomb(0.4), held(*v, 4.0)))[0] for v in ((0.1, 0.3), (0.3, 0.1)))
    assert_allclose(right[[0, 1, 2]] * [1.0, -1.0, -1.0], left, rtol=0.02, atol=5e-4)


@engine
def test_ground_that_changes_under_the_wheels() -> None:
    """On ice a robot gathers and loses speed by mu g, whatever its wheels do."""
    stop = Series(np.array([0.0, 2.0, 3.0]), np.array([[0.6, 0.6], [0.0, 0.0], [0.0, 0.0]]))
    grip, slip, late, there = (
        roll(robot(P3AT), ground, stop).pose[-1, 0]
        for ground in (
            coulomb(0.44),
            coulomb(0.05),
            Ground(coulomb(0.44), (Area(coulomb(0.05), t=(1.9, np.inf)),)),
            Ground(coulomb(0.44), (Area(coulomb(0.05), x=(0.8, np.inf)),)),
        )
    )
    slowing = 0.05 * 9.81  # [m/s^2] on ice
    started = 2.0 * 0.6 - 0.5 * 0.6**2 / slowing  # [m] after 2 s on ice
    braked = 0.6 - 0.5 * slowing  # [m] in the last second: the robot still slides at its end
    assert grip == pytest.approx(1.2, abs=0.02)
    assert slip == pytest.approx(started + braked, abs=0.015)
    assert late == pytest.approx(2.0 * 0.6 - 0.1 * 0.6 + braked, abs=0.015)
    assert there == pytest.approx(late, abs=0.01)


@engine
def test_what_calibration_finds_are_the_icrs_of_the_engine() -> None:
    made = robot(P3AT, com_x=0.02)
    rows = [[1.0, 0.0, 0.0]]
    for v in (0.1, 0.2):
        rows += [[4.0, v, s * w] for w in (0.3, 0.5) for s in (1.0, -1.0)] + [[3.0, v, 0.0], [2.0, -v, 0.0]]
    commands = rims_from_manoeuvres(np.array(rows), controller(P3AT), acceleration=1.0)
    motion = roll(made, TERRAINS["lab"], commands)
    model, weight = Icr.nominal(P3AT), np.array([1.0, 1.0, 0.1])

    def off(theta: FloatArray) -> FloatArray:
        return np.asarray(((model.with_theta(theta).twist(*motion.rims.T) - motion.twist) / weight).ravel())

    own = least_squares(off, model.theta).x
    sensors = Sensors(10.0, 0.005, 0.004, encoder_rate=50.0, gyro_rate=50.0)
    drive = recorded("engine", P3AT, motion, sensors, 1, commands)
    found = calibrate(drive, options=CalibrateOptions(model="icr")).parameters
    errors = [(found[p.name].value - true) / found[p.name].sigma for p, true in zip(Icr.PARAMETERS, own, strict=True)]
    assert own[2] > 0.05  # the centre of mass draws it ahead
    assert np.abs(errors).max() < 2.0


@engine
def test_areas_lie_where_the_robot_is_told_to_stand() -> None:
    """Ice under the left wheels of a robot that sets off: the same whichever way it faces."""
    good, ice, here = coulomb(0.6), coulomb(0.05), np.array([1.0, 2.0, 0.5 * np.pi])
    left = RollingEngine(robot(P3AT), Ground(good, (Area(ice, y=(0.0, np.inf)),)))
    turned = RollingEngine(robot(P3AT), Ground(good, (Area(ice, x=(-np.inf, 1.0)),)), here)
    for _ in range(10):
        a, b = left.step((0.5, 0.5), 0.05), turned.step((0.5, 0.5), 0.05)
    assert a[2] > 0.02  # the right wheels push
    assert_allclose(b[:3], compose(here, a[:3]), atol=1e-3)


@engine
def test_the_same_commands_give_the_same_motion() -> None:
    first, again = (roll(robot(P3AT), coulomb(0.4), held(0.1, 0.3, 1.0)) for _ in range(2))
    assert_array_equal(first.pose, again.pose)
    assert np.isnan(first.power).all()


@engine
def test_what_cannot_be_driven() -> None:
    with pytest.raises(RequestError, match=r"the left wheels are asked for 0\.800 m/s"):
        roll(robot(P3AT), coulomb(0.4), held(0.8, 0.8, 1.0))
    with pytest.raises(RequestError, match="at least two commands"):
        roll(robot(P3AT), coulomb(0.4), Series(np.zeros(1), np.zeros((1, 2))))
    tall = robot(P3AT, com_height=0.6, lag=0.0)
    with pytest.raises(RequestError, match=r"^the robot falls over at \d.\d\d s; drive more gently or lower"):
        roll(tall, coulomb(0.9), Series(np.array([0.0, 2.0, 4.0]), np.array([[0.69, 0.69], [-0.69, -0.69], [0, 0]])))


def test_without_the_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(RequestError, match=r"^the plant mujoco needs the package: pip install 'skidsteer\[mujoco\]'$"):
        roll(robot(P3AT), coulomb(0.4), held(0.1, 0.2, 1.0))
