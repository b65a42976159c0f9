"""Robots stepped from outside do what the plants do in one go."""

import math
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.kernels.rolling import follow
from skidsteer.models import Icr, ScheduledIcr
from skidsteer.mujoco_plant import RollingEngine, roll
from skidsteer.plants import begin, point_contacts
from skidsteer.rolling import OverturnedError, Rolling, RollingModel
from skidsteer.se2 import compose, exp
from skidsteer.simulate import controller, rims_from_manoeuvres
from skidsteer.terramechanics.dynamics import RollingRobot, move
from skidsteer.terramechanics.robot import robot
from skidsteer.terramechanics.terrain import TERRAINS, Area, Ground, parse_ground
from skidsteer.vehicle import preset

engine = pytest.mark.skipif(find_spec("mujoco") is None, reason="mujoco is not installed")
SUMMIT = preset("summit-xl")
ROWS = np.array([[0.6, 1.0, 0.0], [0.8, 0.8, 0.9], [0.6, -0.5, -1.0]])
COMMANDS = rims_from_manoeuvres(ROWS, controller(SUMMIT), rate=50.0, acceleration=3.0)
GRASS, GROUND = parse_ground("grass"), parse_ground("grass,asphalt@1")
MODEL = Icr(0.48, -0.42, 0.28, 0.9, 0.93)


def stepped(rolling: Rolling, commands: Series) -> np.ndarray:
    states = [rolling.state]
    for asked, dt in zip(commands.values, np.diff(commands.t), strict=False):
        states.append(rolling.step(asked, dt))
    return np.array(states)


def test_the_terramechanic_robot_moves_as_in_one_go() -> None:
    made = robot(SUMMIT, com_x=0.02, lag=0.15)
    whole = move(made, GROUND, COMMANDS)
    states = stepped(RollingRobot(made, GROUND), COMMANDS)
    kept = np.searchsorted(whole.t, COMMANDS.t - 1e-9)
    assert_allclose(states[:, :3], whole.pose[kept], atol=1e-9)
    assert_allclose(states[:, 3:6], whole.twist[kept], atol=1e-9)
    assert_allclose(states[:, 6:], whole.rims[kept], atol=1e-9)


def test_the_power_is_the_mean_over_the_step() -> None:
    made = robot(SUMMIT)
    whole, rolling = move(made, GROUND, COMMANDS), RollingRobot(made, GROUND)
    power = []
    for asked, dt in zip(COMMANDS.values, np.diff(COMMANDS.t), strict=False):
        rolling.step(asked, dt)
        power.append(rolling.power)
    assert_allclose(np.mean(power, axis=0), whole.power[1:].mean(axis=0), rtol=1e-9)


@engine
def test_the_engines_robot_moves_as_in_one_go() -> None:
    made = robot(SUMMIT, com_x=0.02)
    whole = roll(made, GROUND, COMMANDS)
    states = stepped(RollingEngine(made, GROUND), COMMANDS)
    kept = np.searchsorted(whole.t, COMMANDS.t - 1e-9)
    assert_allclose(states, np.column_stack([whole.pose, whole.twist, whole.rims])[kept], atol=1e-9)


@engine
def test_whole_steps_of_the_engine_keep_up_with_the_clock() -> None:
    """A period of 33.3 ms is 16 or 17 steps of 2 ms."""
    made, held = robot(SUMMIT), Series(np.array([0.0, 2.0]), np.array([[0.5, 0.6]] * 2))
    rolling = RollingEngine(made, GROUND)
    for _ in range(60):
        rolling.step((0.5, 0.6), 1.0 / 30.0)
    assert_allclose(rolling.state[:3], roll(made, GROUND, held).pose[-1], atol=1e-9)


@pytest.mark.parametrize("name", ["kinematic", "terramechanic", pytest.param("mujoco", marks=engine)])
def test_a_start_elsewhere_is_the_same_way_from_there(name: str) -> None:
    start = np.array([3.0, -2.0, 2.5])
    here, there = (stepped(begin(name, SUMMIT, GRASS, s), COMMANDS) for s in (np.zeros(3), start))
    assert_allclose(there[:, :3], compose(start, here[:, :3]), atol=2e-3 if name == "mujoco" else 1e-9)
    assert_allclose(there[0, :3], start)
    assert_allclose(begin(name, SUMMIT, GRASS, start).step((0.0, 0.0), 0.0)[:3], start, atol=1e-12)


@pytest.mark.parametrize("name", ["terramechanic", pytest.param("mujoco", marks=engine)])
def test_areas_of_the_ground_lie_where_the_start_is_told(name: str) -> None:
    icy = Ground(TERRAINS["concrete"], (Area(TERRAINS["ice"], x=(4.0, math.inf)),))
    on, off = (stepped(begin(name, SUMMIT, icy, (x, 0.0, 0.0)), COMMANDS) for x in (5.0, 0.0))
    ice, concrete = (stepped(begin(name, SUMMIT, parse_ground(g)), COMMANDS) for g in ("ice", "concrete"))
    assert_allclose(on[:, 3:], ice[:, 3:], atol=2e-3)
    assert_allclose(off[:, 3:], concrete[:, 3:], atol=2e-3)
    assert np.abs(ice[:, 3:] - concrete[:, 3:]).max() > 0.3


@pytest.mark.parametrize("name", ["kinematic", "terramechanic", pytest.param("mujoco", marks=engine)])
def test_no_time_moves_nothing(name: str) -> None:
    rolling = begin(name, SUMMIT, GROUND)
    before = rolling.step((0.5, 0.7), 0.2)
    assert_allclose(rolling.step((0.1, 0.1), 0.0), before, atol=1e-12)


@pytest.mark.parametrize("name", ["kinematic", "terramechanic", pytest.param("mujoco", marks=engine)])
def test_the_lag_is_the_one_that_is_asked_for(name: str) -> None:
    rolling = begin(name, SUMMIT, GROUND, lag=0.25)
    rolling.step((0.4, 0.4), 0.25)
    assert_allclose(rolling.state[6:], 0.4 * (1.0 - math.exp(-1.0)), atol=6e-3)


# The model


def test_a_model_without_lag_is_exact() -> None:
    rolling, pose = RollingModel(MODEL, (1.0, 2.0, 0.5)), np.array([1.0, 2.0, 0.5])
    for left, right in COMMANDS.values:
        pose = compose(pose, exp(MODEL.twist(left, right) * 0.02))
        rolling.step((left, right), 0.02)
        assert_allclose(rolling.state, [*pose, *MODEL.twist(left, right), left, right], atol=1e-12)


@pytest.mark.parametrize(
    "model", [MODEL, ScheduledIcr(0.48, -0.42, 0.28, 0.9, 0.93, 0.05, 0.1, 0.1, 0.1, 0.5), point_contacts(SUMMIT)]
)
@pytest.mark.parametrize("acceleration", [math.inf, 2.0])
def test_a_model_behind_its_lag_moves_as_an_integrator_says(model: Icr, acceleration: float) -> None:
    lag, asked = 0.12, np.array([-0.4, 0.9])

    def slope(_: float, z: np.ndarray) -> np.ndarray:
        v_x, v_y, omega = model.twist(z[3], z[4])
        c, s = np.cos(z[2]), np.sin(z[2])
        change = np.clip((asked - z[3:]) / lag, -acceleration, acceleration)
        return np.array([c * v_x - s * v_y, s * v_x + c * v_y, omega, *change])

    done = solve_ivp(slope, (0.0, 0.8), [1.0, 2.0, 0.5, 0.0, 0.0], rtol=1e-10, atol=1e-12, max_step=0.01).y[:, -1]
    rolling = RollingModel(model, (1.0, 2.0, 0.5), lag, acceleration)
    for _ in range(40):
        state = rolling.step(asked, 0.02)
    assert_allclose(state[[0, 1, 2, 6, 7]], done, atol=2e-5)


@given(
    *(st.floats(-3.0, 3.0),) * 2, st.floats(1e-3, 0.5), st.floats(0.0, 0.4), st.floats(0.1, 50.0), st.floats(0.1, 0.9)
)
def test_a_rim_may_be_stepped_in_parts(
    rim: float, asked: float, dt: float, lag: float, acceleration: float, share: float
) -> None:
    at, rolled = follow(rim, asked, dt, lag, acceleration)
    middle, first = follow(rim, asked, share * dt, lag, acceleration)
    end, second = follow(middle, asked, dt - share * dt, lag, acceleration)
    assert end == pytest.approx(at, abs=1e-9)
    assert first + second == pytest.approx(rolled, abs=1e-9)
    assert abs(at - rim) <= acceleration * dt + 1e-9
    assert min(rim, asked) - 1e-12 <= at <= max(rim, asked) + 1e-12


def test_a_rim_at_its_limit_by_hand() -> None:
    """From 0 to 1 m/s at 2 m/s^2 with a lag of 0.1 s: 0.4 s of ramp, then the rest of 0.2 m/s fades."""
    assert_allclose(follow(0.0, 1.0, 0.4, 0.1, 2.0), [0.8, 0.16])
    assert_allclose(follow(0.0, 1.0, 0.6, 0.1, 2.0), [1.0 - 0.2 * math.exp(-2.0), 0.36 - 0.02 * (1 - math.exp(-2.0))])
    assert_allclose(follow(0.0, -1.0, 0.75, 0.0, 2.0), [-1.0, -0.5])


def test_states_are_new_arrays() -> None:
    for rolling in (RollingModel(MODEL), RollingRobot(robot(SUMMIT), GROUND)):
        before = rolling.state
        kept = before.copy()
        rolling.step((0.3, 0.5), 0.02)
        assert_array_equal(before, kept)


# What cannot be


def test_what_cannot_begin() -> None:
    with pytest.raises(
        RequestError, match=r"a start needs three finite numbers, x, y \[m\] and yaw \[rad\]; got \[nan"
    ):
        begin("kinematic", SUMMIT, GROUND, (math.nan, 0.0, 0.0))
    with pytest.raises(RequestError, match="a start needs three finite numbers"):
        begin("terramechanic", SUMMIT, GROUND, (0.0, 0.0))
    with pytest.raises(RequestError, match=r"^no plant 'gazebo'; there are: kinematic, terramechanic, mujoco$"):
        begin("gazebo", SUMMIT, GROUND)
    with pytest.raises(RequestError, match=r"need a lag of at least 0 s and an acceleration above 0, got -0\.1, inf"):
        begin("kinematic", SUMMIT, GROUND, lag=-0.1)
    with pytest.raises(RequestError, match="lag must be at least 0, got nan"):
        begin("terramechanic", SUMMIT, GROUND, lag=math.nan)


@pytest.mark.parametrize("plant", [RollingRobot, pytest.param(RollingEngine, marks=engine)])
def test_a_robot_that_falls_over_says_so(plant: type[RollingRobot] | type[RollingEngine]) -> None:
    rolling = plant(robot(SUMMIT, com_height=0.9, lag=0.0), parse_ground("concrete"))

    def there_and_back() -> None:
        for speed in [2.0] * 100 + [-2.0] * 100:
            rolling.step((speed, speed), 0.02)

    with pytest.raises(OverturnedError, match=r"(lifts off the ground|falls over) .* lower the centre of mass"):
        there_and_back()
