from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from bag_files import START, VEHICLE, Message, write_messages
from skidsteer.drive import Drive
from skidsteer.errors import DataError, RequestError
from skidsteer.io.bag import BagOptions, read_bag, read_bag_noted
from skidsteer.io.counters import roll
from skidsteer.io.wheels import Sides, match_sides, side_of
from skidsteer.vehicle import Vehicle

NS = START * 10**9
TURN = 2 * math.pi


@pytest.mark.parametrize(
    ("name", "side"),
    [
        ("front_left_wheel", "left"),
        ("frontRightWheel", "right"),
        ("fl_wheel_joint", "left"),
        ("rl_wheel_joint", "left"),
        ("lr_wheel_joint", "left"),
        ("wheel_rr", "right"),
        ("FR", "right"),
        ("RLWheel", "left"),
        ("l", "left"),
        ("r_wheel_2", "right"),
        ("robot1/LEFT_TRACK", "left"),
        ("wheel_1", None),
        ("left_of_right_wheel", None),
        ("bl_and_br", None),
        ("", None),
    ],
)
def test_side_is_told_by_the_name(name: str, side: str | None) -> None:
    assert side_of(name) == side


@pytest.mark.parametrize(
    ("names", "sides"),
    [
        (["left_wheel", "right_wheel"], Sides(("left_wheel",), ("right_wheel",))),
        (["fl", "fr", "rl", "rr"], Sides(("fl", "rl"), ("fr", "rr"))),
        (
            ["lf_wheel", "lm_wheel", "lr_wheel", "rf_wheel", "rm_wheel", "rr_wheel"],
            Sides(("lf_wheel", "lm_wheel", "lr_wheel"), ("rf_wheel", "rm_wheel", "rr_wheel")),
        ),
        # Arms and casters have sides too.
        (["left_wheel", "right_wheel", "left_finger_joint", "l_elbow"], Sides(("left_wheel",), ("right_wheel",))),
        (["left_caster", "right_caster"], None),
        # Joints that are named wheels go before joints that merely have a side.
        (["left_wheel", "right_wheel", "left_door", "right_door"], Sides(("left_wheel",), ("right_wheel",))),
        (["left_wheel"], None),
        ([], None),
    ],
)
def test_sides_are_matched_by_name(names: list[str], sides: Sides | None) -> None:
    assert match_sides(names) == sides


# --- counters


def clock(n: int, dt: float = 0.05) -> np.typing.NDArray[np.int64]:
    return np.arange(n, dtype=np.int64) * round(dt * 1e9)


@given(
    st.sampled_from([2.0**8, 2.0**16, 2.0**24, 2.0**32]),
    st.lists(st.integers(-100, 100), min_size=2, max_size=40),
    st.integers(0, 2**32),
    st.booleans(),
)
def test_wrapped_counter_rolls_like_an_endless_one(span: float, steps: list[int], start: int, signed: bool) -> None:
    endless = start + np.concatenate([[0], np.cumsum(steps)]).astype(float)
    wrapped = endless % span - (span / 2 if signed else 0)
    rolled = roll(clock(len(wrapped)), wrapped[:, None], largest_rate=1e9)
    jumps = np.abs(np.diff(wrapped)) > span / 2
    if span > 2**8 or not jumps.any():  # 100 counts in a range of 256 may be a step or a wrap
        assert_allclose(rolled.steps[:, 0], steps)
        assert (rolled.wraps, rolled.resets) == (jumps.sum(), 0)


@example([-2.0, -0.24921113927147287, -2.5], 0.0)  # lands near zero after a wrap: no reset
@given(st.lists(st.floats(-2.5, 2.5), min_size=2, max_size=60), st.floats(0.0, TURN))
def test_angle_within_one_turn_is_unwrapped(steps: list[float], start: float) -> None:
    angle = start + np.concatenate([[0.0], np.cumsum(steps)])
    rolled = roll(clock(len(angle)), ((angle + math.pi) % TURN - math.pi)[:, None], largest_rate=1e3)
    if rolled.wraps or np.ptp(angle) < 3.0:
        assert_allclose(rolled.steps[:, 0], steps, atol=1e-9)


def test_reset_is_bridged_with_the_speed_before_it() -> None:
    # By hand: 2 rad a step, at sample 5 the driver restarts from zero.
    angle = np.array([100.0, 102.0, 104.0, 106.0, 108.0, 0.0, 2.0, 4.0])
    rolled = roll(clock(8), np.stack([angle, angle + 1.0], axis=1), largest_rate=1000.0)
    assert_allclose(rolled.steps, 2.0)
    assert (rolled.wraps, rolled.resets) == (0, 2)


def test_restart_at_zero_is_noticed_where_it_is_not_too_fast() -> None:
    angle = np.array([6.0, 6.5, 7.0, 7.5, 0.0, 0.5, 1.0])
    rolled = roll(clock(7, dt=0.5), angle[:, None], largest_rate=100.0)
    assert_allclose(rolled.steps[:, 0], 0.5)
    assert rolled.resets == 1


def test_bridge_keeps_the_speed_over_steps_of_any_length() -> None:
    ns = (np.array([0.0, 1.0, 2.0, 5.0, 6.0]) * 1e9).astype(np.int64)
    steps = roll(ns, np.array([[1000.0], [1002.0], [1004.0], [-5000.0], [-4998.0]]), largest_rate=100.0).steps
    assert_allclose(steps[:, 0], [2.0, 2.0, 6.0, 2.0])


def test_impossible_jump_is_bridged_also_at_the_start() -> None:
    angle = np.array([0.0, 5000.0, 5001.0, 5003.0])
    assert_allclose(roll(clock(4), angle[:, None], largest_rate=100.0).steps[:, 0], [1.0, 1.0, 2.0])


def test_messages_in_a_bunch_are_no_jump() -> None:
    ns = np.array([0, 50, 50.01, 150, 200]) * 1_000_000
    steps = roll(ns.astype(np.int64), np.array([[0.0], [1.0], [2.0], [3.0], [4.0]]), largest_rate=40.0).steps
    assert_allclose(steps[:, 0], 1.0)


@pytest.mark.parametrize("n", [1, 2])
def test_few_samples_roll_what_they_can(n: int) -> None:
    assert roll(clock(n), np.zeros((n, 2)), 1.0).steps.shape == (n - 1, 2)


# --- joint states in a bag


def joint_bag(tmp_path: Path, rows: list[dict[str, Any]], kind: str = "mcap") -> Path:
    messages = [
        Message("/joint_states", "sensor_msgs/msg/JointState", NS + i, {"header": (NS + i * 100_000_000, ""), **row})
        for i, row in enumerate(rows)
    ]
    return write_messages(tmp_path / "b", kind, messages)


def read(path: Path, **options: Any) -> tuple[Drive, str]:
    drive, contents = read_bag_noted(path, VEHICLE, BagOptions(**options))
    return drive, "\n".join(contents.notes)


def test_positions_become_the_speed_until_the_next(tmp_path: Path) -> None:
    # By hand: 0.1 s apart, radius 0.15 m; left 0.2 and 0.6 rad a step and wheel, right 1 rad.
    rows = [{"name": ["fl", "rl", "fr"], "position": [0.2 * i, 0.6 * i, 1.0 * i]} for i in range(4)]
    drive, notes = read(joint_bag(tmp_path, rows))
    assert_allclose(drive.wheels.values, [[0.6, 1.5]] * 4)
    assert "differences of the recorded positions" in notes


def test_six_wheels_are_two_sides(tmp_path: Path) -> None:
    names = ["lf", "rf", "lm", "rm", "lr", "rr"]
    drive, _ = read(joint_bag(tmp_path, [{"name": names, "velocity": [1.0, 2.0, 2.0, 4.0, 3.0, 9.0]}] * 3))
    assert_allclose(drive.wheels.values, [[2.0 * 0.15, 5.0 * 0.15]] * 3)


def test_joints_in_any_order_and_among_messages_of_others(tmp_path: Path) -> None:
    rows = [
        {"name": ["left_wheel", "right_wheel"], "velocity": [1.0, 2.0]},
        {"name": ["arm"], "velocity": [9.0]},
        {"name": ["right_wheel", "arm", "left_wheel"], "velocity": [2.0, 9.0, 1.0]},
    ]
    drive, _ = read(joint_bag(tmp_path, rows))
    assert_allclose(drive.wheels.values, [[0.15, 0.3]] * 2)
    assert_allclose(drive.wheels.t, [0.0, 0.2])


def both(position: Any, velocity: Any) -> list[dict[str, Any]]:
    return [
        {"name": ["l", "r"], "position": [p, p], "velocity": [v, v]} for p, v in zip(position, velocity, strict=True)
    ]


@pytest.mark.parametrize(
    ("position", "velocity", "speed", "note"),
    [
        (0.2 * np.arange(10), np.full(10, 2.1), 2.0, "differences of the recorded positions"),
        (np.zeros(10), np.full(10, 2.0), 2.0, "the positions do not change"),
        (0.3 * np.arange(10), np.full(10, 2.0), 2.0, "the positions tell of"),
        (np.repeat(0.4 * np.arange(5), 2), np.full(10, 2.0), 2.0, "are only repeated"),
        (0.2 * np.arange(10), np.full(10, np.nan), 2.0, "differences of the recorded positions"),
        (np.full(10, np.nan), np.full(10, 2.0), 2.0, ""),
        (0.2 * np.arange(10), np.zeros(10), 2.0, "differences of the recorded positions"),
    ],
)
def test_better_of_positions_and_velocities_is_taken(
    tmp_path: Path, position: Any, velocity: Any, speed: float, note: str
) -> None:
    drive, notes = read(joint_bag(tmp_path, both(position, velocity)))
    assert_allclose(drive.wheels.values, speed * 0.15)
    assert note in notes


def test_user_decides_between_positions_and_velocities(tmp_path: Path) -> None:
    path = joint_bag(tmp_path, both(0.3 * np.arange(10), np.full(10, 2.0)))
    assert_allclose(read(path, wheel_signal="position")[0].wheels.values, 0.45)
    assert_allclose(read(path, wheel_signal="velocity")[0].wheels.values, 0.30)


def test_reset_and_wrap_in_a_bag_are_undone_and_told(tmp_path: Path) -> None:
    angle = 0.5 * np.arange(40)
    reset = np.where(np.arange(40) < 30, angle + 50.0, angle - 15.0)
    rows = [{"name": ["l", "r"], "position": [(a + 3) % TURN - 3, b]} for a, b in zip(angle, reset, strict=True)]
    drive, notes = read(joint_bag(tmp_path, rows))
    assert_allclose(drive.wheels.values, 5.0 * 0.15)
    assert "3 wrap-arounds" in notes
    assert "1 jumps of the count" in notes


def test_joints_without_numbers_are_refused(tmp_path: Path) -> None:
    path = joint_bag(tmp_path, [{"name": ["l", "r"], "effort": [1.0, 1.0]}] * 3)
    with pytest.raises(DataError, match="/joint_states: none of its 3 messages holds finite numbers"):
        read_bag(path, VEHICLE)


def test_single_joint_state_is_a_drive_of_one_sample(tmp_path: Path) -> None:
    drive, _ = read(joint_bag(tmp_path, [{"name": ["l", "r"], "position": [1.0, 1.0]}]))
    assert_allclose(drive.wheels.values, [[0.0, 0.0]])


# --- a topic for each side


def counter_bag(tmp_path: Path, kind: str = "Int32", names: tuple[str, str] = ("/left/ticks", "/right/ticks")) -> Path:
    messages = []
    for index in range(11):
        for name, step, late in ((names[0], 100, 0), (names[1], 200, 1000)):
            value: Any = {"data": (step * index + 2**31 - 300 + 2**31) % 2**32 - 2**31}
            if kind.startswith("Float"):
                value = {"data": step / 100.0}
            messages.append(Message(name, f"std_msgs/msg/{kind}", NS + index * 100_000_000 + late, value))
    return write_messages(tmp_path / "b", "mcap", messages)


def test_tick_topics_of_two_sides_wrap_around(tmp_path: Path) -> None:
    robot = Vehicle("r", 0.6, 0.15, ticks_per_revolution=1000)
    drive, contents = read_bag_noted(counter_bag(tmp_path), robot)
    assert contents.chosen["wheels"] == "/left/ticks,/right/ticks"
    # By hand: 1000 and 2000 ticks a second are 1 and 2 turns of 2 pi 0.15 m.
    assert_allclose(drive.wheels.values, [[TURN * 0.15, 2 * TURN * 0.15]] * len(drive.wheels), rtol=1e-9)
    assert sum("wrap-arounds" in note for note in contents.notes) == 2


def test_ticks_need_to_know_how_many_make_a_turn(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="needs ticks_per_revolution"):
        read_bag(counter_bag(tmp_path), VEHICLE)


def test_plain_numbers_need_a_unit(tmp_path: Path) -> None:
    path = counter_bag(tmp_path, "Float64", ("/lwheel", "/rwheel"))
    with pytest.raises(RequestError, match="no topic serves as wheel speeds"):
        read_bag(path, VEHICLE)
    with pytest.raises(RequestError, match="say what they are: rad, rad/s"):
        read_bag(path, VEHICLE, BagOptions(wheels_topic="/lwheel,/rwheel"))
    drive = read_bag(path, VEHICLE, BagOptions(wheels_topic="/lwheel, /rwheel", wheels_unit="rad/s"))
    assert_allclose(drive.wheels.values, [[0.15, 0.3]] * len(drive.wheels))
    with pytest.raises(RequestError, match="need a left and a right topic"):
        read_bag(path, VEHICLE, BagOptions(wheels_topic="/lwheel"))


# --- one driver a motor: no message has all wheels


def by_motor(topics: dict[str, str], signal: str) -> list[Message]:
    """Four motors of their own messages, 5 ms apart, at 50 Hz; left 2 rad/s, right 1 rad/s faster from 1 s on.

    ``topics`` tells the topic of each side.
    """
    messages = []
    for index, name in enumerate(("front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel")):
        right = "right" in name
        for step in range(100):
            t = 0.02 * step + 0.005 * index
            rate = 2.0 + right * (t >= 1.0)
            angle = 2.0 * t + right * max(0.0, t - 1.0) + 7.0 * index
            numbers = {"position": [angle]} if signal == "position" else {"velocity": [rate]}
            ns = NS + round(t * 1e9)
            value = {"header": (ns, ""), "name": [name], **numbers}
            messages.append(
                Message(topics["right" if right else "left"], "sensor_msgs/msg/JointState", ns + 10**6, value)
            )
    return messages


@pytest.mark.parametrize("signal", ["position", "velocity"])
@pytest.mark.parametrize("kind", ["mcap", "rosbag1"])
def test_motors_that_tell_of_themselves_alone(tmp_path: Path, signal: str, kind: str) -> None:
    """Each wheel is held from its own stamp to its next one: rolled distances are whole, speeds those of the sides."""
    path = write_messages(tmp_path / "b", kind, by_motor({"left": "/motors", "right": "/motors"}, signal))
    drive, contents = read_bag_noted(path, VEHICLE)
    assert contents.chosen["wheels"] == "/motors"
    assert sum("left wheels front_left_wheel, rear_left_wheel" in note for note in contents.notes) == 1
    t, speeds = drive.wheels.t, drive.wheels.values / VEHICLE.wheel_radius
    assert_allclose(t[0], 0.015, atol=1e-9)  # where the last of the four has begun
    assert_allclose(np.diff(t), 0.005, atol=1e-9)
    assert_allclose(speeds[:, 0], 2.0)
    before, after = t < 0.98, t > 1.02
    assert_allclose(speeds[before, 1], 2.0)
    assert_allclose(speeds[after, 1], 3.0)
    rolled = (drive.wheels.values[:-1] * np.diff(t)[:, None]).sum(axis=0) / VEHICLE.wheel_radius
    assert_allclose(rolled, [2.0 * (t[-1] - t[0]), 2.0 * (t[-1] - t[0]) + t[-1] - 1.0], atol=0.02)


def test_joint_states_of_two_topics_are_joined_where_asked_for(tmp_path: Path) -> None:
    path = write_messages(tmp_path / "b", "mcap", by_motor({"left": "/port", "right": "/starboard"}, "velocity"))
    with pytest.raises(RequestError, match="no topic serves as wheel speeds"):
        read_bag(path, VEHICLE)
    drive = read_bag(path, VEHICLE, BagOptions(wheels_topic="/port,/starboard"))
    assert_allclose(drive.wheels.values[-1] / VEHICLE.wheel_radius, [2.0, 3.0])


def test_arms_that_tell_of_themselves_alone_are_no_wheels(tmp_path: Path) -> None:
    """Of two messages, names must say that they roll."""
    messages = [
        Message(
            "/joint_states",
            "sensor_msgs/msg/JointState",
            NS + i,
            {"name": [f"{side}_s0"], "velocity": [1.0], "header": (NS + i, "")},
        )
        for i, side in enumerate(("left", "right") * 10)
    ]
    with pytest.raises(RequestError, match="no topic serves as wheel speeds; name the wheels of /joint_states"):
        read_bag(write_messages(tmp_path / "b", "mcap", messages), VEHICLE)
    drive = read_bag(tmp_path / "b", VEHICLE, BagOptions(left_joints=("left_s0",), right_joints=("right_s0",)))
    assert_allclose(drive.wheels.values, VEHICLE.wheel_radius)
