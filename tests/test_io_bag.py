from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bag_files import (
    KINDS,
    START,
    VEHICLE,
    Message,
    drive_messages,
    example_drive,
    pose,
    twist,
    write_bag,
    write_messages,
)
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.io.bag import BagOptions, is_bag, list_bag, read_bag, read_bag_noted
from skidsteer.io.folder import read_folder, write_folder

PARTS = ("wheels", "pose", "gyro", "command")
NS = START * 10**9


def assert_same_drive(got: Drive, expected: Drive, parts: tuple[str, ...] = PARTS) -> None:
    for part in parts:
        one, other = getattr(got, part), getattr(expected, part)
        assert_array_equal(one.t, other.t)
        # Rim speeds go through wheel rates, the yaw through a quaternion: a last digit may differ.
        assert_allclose(one.values, other.values, rtol=0, atol=1e-15 * 4)


@pytest.mark.parametrize("kind", KINDS)
def test_same_drive_from_every_container(tmp_path: Path, kind: str) -> None:
    drive = example_drive()
    path = write_bag(drive, tmp_path / "drive", kind)
    assert is_bag(path)
    got = read_bag(path, VEHICLE)
    assert_same_drive(got, drive)
    assert got.name == "drive"
    assert got.source == str(path)


def test_same_numbers_in_every_container_and_folder(tmp_path: Path) -> None:
    drive = example_drive(2.0)
    write_folder(drive, tmp_path / "folder")
    assert_same_drive(read_folder(tmp_path / "folder"), drive)
    drives = [read_bag(write_bag(drive, tmp_path / kind, kind), VEHICLE) for kind in KINDS]
    assert len({each.sha256 for each in drives}) == 1
    for part in PARTS:
        for each in drives[1:]:
            assert_array_equal(getattr(each, part).values, getattr(drives[0], part).values)


@pytest.mark.parametrize("reference", ["odometry", "pose", "pose_covariance", "transform"])
def test_every_pose_type_serves_as_reference(tmp_path: Path, reference: str) -> None:
    drive = example_drive(2.0)
    got = read_bag(write_bag(drive, tmp_path / "drive", "mcap", reference=reference), VEHICLE)
    assert_same_drive(got, drive)


def test_position_reference_without_heading(tmp_path: Path) -> None:
    drive = example_drive(2.0)
    drive = replace(drive, pose=None, position=Series(drive.pose.t, drive.pose.values[:, :2]))  # type: ignore[union-attr]
    got = read_bag(write_bag(drive, tmp_path / "drive", "sqlite3"), VEHICLE)
    assert got.pose is None
    assert_same_drive(got, drive, ("wheels", "position"))


def test_wheel_odometry_is_turned_back_with_the_multiplier_in_force(tmp_path: Path) -> None:
    drive = example_drive(1.0)
    path = write_bag(drive, tmp_path / "drive", "mcap", wheels="odometry")
    plain = read_bag(path, VEHICLE)
    assert_allclose(plain.wheels.values, drive.wheels.values, atol=1e-15)
    # By hand: the same twist under a width twice as large needs twice the difference between the sides.
    wide = read_bag(path, VEHICLE, BagOptions(separation=0.8, separation_multiplier=1.5))
    factory = read_bag(path, replace(VEHICLE, factory_separation=0.8, factory_multiplier=1.5))
    sides = drive.wheels.values
    assert_allclose(wide.wheels.values.sum(axis=1), sides.sum(axis=1), atol=1e-15)
    assert_allclose(np.diff(wide.wheels.values), 2.0 * np.diff(sides), atol=1e-15)
    assert_array_equal(wide.wheels.values, factory.wheels.values)


def test_twist_stamped_serves_as_wheels(tmp_path: Path) -> None:
    messages = [
        Message(
            "/wheel/velocity",
            "geometry_msgs/msg/TwistStamped",
            NS + i,
            {"header": (NS + i * 10**8, ""), "twist": twist(1.0, 0.5)},
        )
        for i in range(5)
    ]
    got = read_bag(write_messages(tmp_path / "b", "mcap", messages), VEHICLE)
    assert_allclose(got.wheels.values, [[0.85, 1.15]] * 5)


# --- time


def test_header_stamp_goes_before_time_of_recording(tmp_path: Path) -> None:
    drive = example_drive(1.0)
    late = [replace(message, bag_ns=message.bag_ns + 40_000_000) for message in drive_messages(drive)]
    got = read_bag(write_messages(tmp_path / "b", "sqlite3", late), VEHICLE)
    assert_same_drive(got, drive, ("wheels", "pose", "gyro"))
    assert_allclose(got.command.t, drive.command.t + 0.04, atol=1e-12)  # type: ignore[union-attr]


def without_header(message: Message) -> Message:
    return replace(message, value={**message.value, "header": (0, "")} if "header" in message.value else message.value)


def test_zero_stamps_fall_back_to_time_of_recording(tmp_path: Path) -> None:
    drive = example_drive(1.0)
    path = write_messages(tmp_path / "b", "mcap", map(without_header, drive_messages(drive)))
    assert_same_drive(read_bag(path, VEHICLE), drive)


def test_single_zero_stamps_fall_back_alone(tmp_path: Path) -> None:
    drive = example_drive(1.0)
    late = [replace(message, bag_ns=message.bag_ns + 1_000_000) for message in drive_messages(drive)]
    late[7] = without_header(late[7])
    got = read_bag(write_messages(tmp_path / "b", "mcap", late), VEHICLE)
    expected = drive.wheels.t.copy()
    expected[7] += 0.001
    assert_allclose(got.wheels.t, expected, atol=1e-12)


def test_simulated_clock_takes_messages_without_stamp_along(tmp_path: Path) -> None:
    drive = example_drive(1.0)
    simulated = []
    for message in drive_messages(drive):
        value = dict(message.value)
        if "header" in value:
            value["header"] = (message.bag_ns - NS + 5 * 10**9, value["header"][1])
        simulated.append(replace(message, value=value))
    got = read_bag(write_messages(tmp_path / "b", "mcap", simulated), VEHICLE)
    for part in PARTS:
        assert_allclose(getattr(got, part).t, getattr(drive, part).t + 5.0, atol=1e-6)


@pytest.mark.parametrize(("ahead", "used"), [(-1_600_000_000.0, False), (60.0, False), (2.0, True)])
def test_topic_on_another_clock_is_stamped_by_its_recording(tmp_path: Path, ahead: float, used: bool) -> None:
    drive = example_drive(1.0)
    messages = [
        replace(message, value={**message.value, "header": (message.bag_ns + round(ahead * 1e9), "imu_link")})
        if message.topic == "/imu/data"
        else message
        for message in drive_messages(drive)
    ]
    got, contents = read_bag_noted(write_messages(tmp_path / "b", "mcap", messages), VEHICLE)
    assert_same_drive(got, drive, ("wheels", "pose", "command"))
    assert_allclose(got.gyro.t, drive.gyro.t + ahead * used, atol=1e-9)  # type: ignore[union-attr]
    assert any("/imu/data: is stamped by another clock" in note for note in contents.notes) != used


def test_clock_set_back_is_noticed(tmp_path: Path) -> None:
    drive = example_drive(2.0)
    messages = [
        replace(message, value={**message.value, "header": (message.bag_ns - 5 * 10**9, "")})
        if message.topic == "/joint_states" and message.bag_ns > NS + 10**9
        else message
        for message in drive_messages(drive)
    ]
    got, contents = read_bag_noted(write_messages(tmp_path / "b", "mcap", messages), VEHICLE)
    assert_same_drive(got, drive)
    assert any("jump back" in note for note in contents.notes)


def test_nanoseconds_survive(tmp_path: Path) -> None:
    t = np.array([0.000000001, 0.100000003, 0.200000007])
    drive = Drive("d", VEHICLE, Series(t, np.ones((3, 2))))
    assert_array_equal(read_bag(write_bag(drive, tmp_path / "b", "mcap"), VEHICLE).wheels.t, t)


def test_unsorted_and_repeated_stamps_are_put_in_order_and_counted(tmp_path: Path) -> None:
    drive = example_drive(1.0)
    messages = drive_messages(drive)
    joints = [message for message in messages if message.topic == "/joint_states"]
    swapped = [replace(joints[4], bag_ns=joints[5].bag_ns), replace(joints[5], bag_ns=joints[4].bag_ns)]
    twice = [replace(joints[7], bag_ns=joints[7].bag_ns + 1)]
    rest = [message for message in messages if message not in (joints[4], joints[5])]
    got, contents = read_bag_noted(write_messages(tmp_path / "b", "mcap", rest + swapped + twice), VEHICLE)
    assert_same_drive(got, drive)
    assert "/joint_states: 1 of 51 samples repeat a time stamp; dropped" in contents.notes


# --- rows that cannot be used


def test_rows_with_nan_or_infinity_are_dropped_and_counted(tmp_path: Path) -> None:
    drive = example_drive(1.0)
    messages = drive_messages(drive)
    for index, bad in ((3, np.nan), (9, np.inf)):
        value = {**messages[index].value, "velocity": np.array([1.0, bad, 1.0, 1.0])}
        messages[index] = replace(messages[index], value=value)
    got, contents = read_bag_noted(write_messages(tmp_path / "b", "rosbag1", messages), VEHICLE)
    assert_array_equal(got.wheels.t, np.delete(drive.wheels.t, [3, 9]))
    assert any(note.startswith("/joint_states: 2 of 50 samples are NaN, infinite") for note in contents.notes)


def test_pose_without_rotation_is_dropped(tmp_path: Path) -> None:
    drive = example_drive(1.0)
    messages = drive_messages(drive, reference="pose")
    index = next(i for i, message in enumerate(messages) if message.topic == "/mocap")
    messages[index] = replace(messages[index], value={"header": (messages[index].bag_ns, "map")})
    got = read_bag(write_messages(tmp_path / "b", "mcap", messages), VEHICLE)
    assert_array_equal(got.pose.t, drive.pose.t[1:])  # type: ignore[union-attr]


# --- what serves as what


def test_bag_tells_what_it_offers(tmp_path: Path) -> None:
    path = write_bag(example_drive(1.0), tmp_path / "b", "mcap")
    contents = list_bag(path)
    assert contents.kind == "MCAP"
    assert dict(contents.chosen) == {
        "wheels": "/joint_states",
        "reference": "/ground_truth/odom",
        "imu": "/imu/data",
        "command": "/cmd_vel",
    }
    entry = next(topic for topic in contents.topics if topic.name == "/imu/data")
    assert (entry.type, entry.count, entry.serves, entry.used_as) == ("sensor_msgs/msg/Imu", 100, ("imu",), "imu")
    assert read_bag_noted(path, VEHICLE)[1].chosen == contents.chosen


def odometry(name: str, v: float = 0.0) -> list[Message]:
    value = {"pose": {"pose": pose(1.0, 2.0, 0.3)}, "twist": {"twist": twist(v, 0.1)}, "child_frame_id": "base_link"}
    return [
        Message(name, "nav_msgs/msg/Odometry", ns, {**value, "header": (ns, "odom")})
        for ns in range(NS, NS + 10**9, 10**8)
    ]


def joint_states(name: str, joints: list[str]) -> list[Message]:
    return [
        Message(
            name,
            "sensor_msgs/msg/JointState",
            ns,
            {"header": (ns, ""), "name": joints, "velocity": [1.0] * len(joints)},
        )
        for ns in range(NS, NS + 10**9, 10**8)
    ]


def commands(name: str) -> list[Message]:
    return [Message(name, "geometry_msgs/msg/Twist", ns, twist(1.0, 0.0)) for ns in range(NS, NS + 10**9, 10**8)]


WHEELS = joint_states("/joint_states", ["left_wheel", "right_wheel"])


@pytest.mark.parametrize(
    ("messages", "chosen"),
    [
        # The wheel odometry is no reference for the wheels, nor is what fuses it.
        (WHEELS + odometry("/odom"), {"wheels": "/joint_states"}),
        (WHEELS + odometry("/odometry/filtered"), {"wheels": "/joint_states"}),
        (WHEELS + odometry("/husky_velocity_controller/odom"), {"wheels": "/joint_states"}),
        (WHEELS + odometry("/icp_odom"), {"wheels": "/joint_states", "reference": "/icp_odom"}),
        (WHEELS + odometry("/fast_lio/path_pose"), {"wheels": "/joint_states", "reference": "/fast_lio/path_pose"}),
        (odometry("/odom") + odometry("/vicon/odom"), {"wheels": "/odom", "reference": "/vicon/odom"}),
        (odometry("/warthog/state"), {"wheels": "/warthog/state"}),
        # An arm is no wheel, and names tell which of two joint states has the wheels.
        (
            WHEELS + joint_states("/arm/joint_states", ["shoulder_left", "shoulder_right"]),
            {"wheels": "/joint_states"},
        ),
        (
            WHEELS + joint_states("/cmd/joint_states", ["left_wheel", "right_wheel"]),
            {"wheels": "/joint_states", "wheel_command": "/cmd/joint_states"},
        ),
        # Of the commands the one that reaches the wheels.
        (
            WHEELS + commands("/joy_teleop/cmd_vel") + commands("/cmd_vel") + commands("/platform/cmd_vel"),
            {"wheels": "/joint_states", "command": "/platform/cmd_vel"},
        ),
        (
            WHEELS + commands("/cmd_vel") + commands("/bt_teleop/cmd_vel"),
            {"wheels": "/joint_states", "command": "/cmd_vel"},
        ),
    ],
)
def test_topics_are_found_by_type_and_name(tmp_path: Path, messages: list[Message], chosen: dict[str, str]) -> None:
    contents = list_bag(write_messages(tmp_path / "b", "mcap", messages))
    assert dict(contents.chosen) == chosen


def test_a_single_pose_is_no_reference_beside_many(tmp_path: Path) -> None:
    one = Message("/dock_pose", "geometry_msgs/msg/PoseStamped", NS, {"header": (NS, "map"), "pose": pose(1, 2, 3)})
    drive = example_drive(1.0)
    path = write_messages(tmp_path / "b", "mcap", [*drive_messages(drive, reference="tf"), one])
    assert list_bag(path).chosen["reference"] == "/tf"


def test_part_of_another_day_does_not_move_the_start(tmp_path: Path) -> None:
    drive = example_drive(1.0)
    early = [replace(message, bag_ns=message.bag_ns - 3 * 86_400 * 10**9) for message in commands("/cmd_vel")]
    messages = [message for message in drive_messages(drive) if message.topic != "/cmd_vel"]
    got = read_bag(write_messages(tmp_path / "b", "mcap", messages + early), VEHICLE)
    assert_same_drive(got, drive, ("wheels", "pose", "gyro"))
    assert_allclose(got.command.t[0], -3 * 86_400)  # type: ignore[union-attr]


def test_choice_between_two_is_told_and_can_be_decided(tmp_path: Path) -> None:
    path = write_messages(tmp_path / "b", "mcap", WHEELS + odometry("/odom", 3.0) + odometry("/gt"))
    contents = list_bag(path)
    assert contents.chosen["wheels"] == "/joint_states"
    assert "wheels: /joint_states chosen over /odom; --wheels-topic decides" in contents.notes
    decided = read_bag(path, VEHICLE, BagOptions(wheels_topic="/odom"))
    assert_allclose(decided.wheels.values.mean(), 3.0)
    asked = list_bag(path, BagOptions(reference_topic="/odom"))
    assert any("reference: /odom came from the wheels, by its name" in note for note in asked.notes)
    assert not any("came from the wheels" in note for note in contents.notes)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (
            BagOptions(wheels_topic="/wheels"),
            "no topic /wheels for the wheels; the bag holds /gt \\(Odometry\\), /joint_states",
        ),
        (BagOptions(imu_topic="/gt"), "topic /gt is nav_msgs/msg/Odometry with 10 messages.* cannot serve as imu"),
        (BagOptions(wheels_topic="/gt,/joint_states"), "need one topic"),
        (BagOptions(reference_topic="/gt,/gt"), "need one topic"),
        (
            BagOptions(left_joints=("a",), right_joints=("b",)),
            "no topic serves as wheel speeds; name the wheels of /joint",
        ),
        (BagOptions(wheels_topic="/joint_states", left_joints=("a",), right_joints=("b",)), "has no message with a, b"),
    ],
)
def test_what_is_asked_for_and_not_there(tmp_path: Path, options: BagOptions, what: str) -> None:
    path = write_messages(tmp_path / "b", "mcap", WHEELS + odometry("/gt"))
    with pytest.raises(RequestError, match=what):
        read_bag(path, VEHICLE, options)


def test_no_wheels_lists_what_there_is(tmp_path: Path) -> None:
    path = write_messages(
        tmp_path / "b", "mcap", commands("/cmd_vel") + joint_states("/joints", ["wheel_1", "wheel_2"])
    )
    what = r"no topic serves as wheel speeds; name the wheels of /joints .* /cmd_vel \(Twist\), /joints \(JointState\)"
    with pytest.raises(RequestError, match=what):
        read_bag(path, VEHICLE)
    assert "wheels" not in list_bag(path).chosen
    named = read_bag(path, VEHICLE, BagOptions(left_joints=("wheel_1",), right_joints=("wheel_2",)))
    assert_allclose(named.wheels.values, VEHICLE.wheel_radius)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ({"separation": 0.0}, "separation must be a positive number"),
        ({"separation_multiplier": float("nan")}, "separation_multiplier must be a positive"),
        ({"left_joints": ("a",)}, "must be given together"),
        ({"wheel_signal": "torque"}, "wheel_signal must be"),
        ({"wheels_unit": "mph"}, "wheels_unit must be"),
    ],
)
def test_options_refuse_what_makes_no_sense(arguments: dict[str, Any], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        BagOptions(**arguments)


def test_recording_split_into_files_is_one_drive(tmp_path: Path) -> None:
    drive = example_drive(2.0)
    messages = sorted(drive_messages(drive), key=lambda message: message.bag_ns)
    for kind, suffix in (("mcap", ".mcap"), ("sqlite3", ".db3"), ("rosbag1", ".bag")):
        folder = tmp_path / kind
        folder.mkdir()
        for part, half in enumerate((messages[:300], messages[300:])):
            written = write_messages(tmp_path / f"{kind}-{part}", kind, half)
            (file,) = [written] if written.is_file() else written.glob(f"*{suffix}")
            file.rename(folder / f"part_{part}{suffix}")
        assert_same_drive(read_bag(folder, VEHICLE), drive)


def test_definitions_missing_from_the_bag_are_those_of_ros(tmp_path: Path) -> None:
    # Recordings of ROS 2 Humble and before in sqlite3 carry none.
    import sqlite3

    drive = example_drive(1.0)
    (file,) = write_bag(drive, tmp_path / "b", "sqlite3").glob("*.db3")
    with sqlite3.connect(file) as connection:
        connection.execute("DROP TABLE message_definitions")
        connection.execute("DROP TABLE schema")
    connection.close()
    assert_same_drive(read_bag(file, VEHICLE), drive)
