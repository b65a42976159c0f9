"""Bags of several robots: what is chosen beside the wheels is of the same robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose

from bag_files import START, VEHICLE, Message, pose, write_messages
from skidsteer.io.bag import BagOptions, list_bag, read_bag

NS = START * 10**9
IMU, POSE, TWIST = "sensor_msgs/msg/Imu", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"


def often(topic: str, kind: str, value: dict[str, Any], count: int = 20) -> list[Message]:
    return [Message(topic, kind, ns, {"header": (ns, "x"), **value}) for ns in range(NS, NS + count * 10**8, 10**8)]


def wheels(topic: str) -> list[Message]:
    return often(topic, "sensor_msgs/msg/JointState", {"name": ["left_wheel", "right_wheel"], "velocity": [1.0, 1.0]})


@pytest.mark.parametrize("robot", ["a200_1", "a200_2"])
def test_topics_of_the_robot_of_the_wheels_come_first(tmp_path: Path, robot: str) -> None:
    messages = wheels("/a200_1/joint_states") + wheels("/a200_2/joint_states")
    messages += often("/a200_1/imu/data", IMU, {}) + often("/a200_2/imu/data_raw", IMU, {}, 30)
    messages += often("/vrpn/a200_1/pose", POSE, {"pose": pose(0, 0, 0)})
    messages += often("/vrpn/a200_2/pose", POSE, {"pose": pose(0, 0, 0)})
    messages += often("/a200_1/cmd_vel_out", TWIST, {}) + often("/a200_2/cmd_vel", TWIST, {})
    path = write_messages(tmp_path / "b", "mcap", messages)
    chosen = dict(list_bag(path, BagOptions(wheels_topic=f"/{robot}/joint_states")).chosen)
    own = {"a200_1": ("imu/data", "cmd_vel_out"), "a200_2": ("imu/data_raw", "cmd_vel")}[robot]
    assert chosen == {
        "wheels": f"/{robot}/joint_states",
        "reference": f"/vrpn/{robot}/pose",
        "imu": f"/{robot}/{own[0]}",
        "command": f"/{robot}/{own[1]}",
    }


def test_a_namespace_makes_no_better_sensor(tmp_path: Path) -> None:
    """A camera's IMU stays behind the robot's, a pose of localisation behind that of motion capture."""
    messages = wheels("/robot/joint_states") + often("/robot/camera/imu", IMU, {}) + often("/imu/data", IMU, {})
    messages += often("/robot/pose", POSE, {"pose": pose(0, 0, 0)}) + often("/mocap", POSE, {"pose": pose(0, 0, 0)})
    chosen = list_bag(write_messages(tmp_path / "b", "mcap", messages)).chosen
    assert (chosen["imu"], chosen["reference"]) == ("/imu/data", "/mocap")


def test_a_topic_without_namespace_has_no_robot(tmp_path: Path) -> None:
    messages = wheels("/joint_states") + often("/joint_states/imu", IMU, {}) + often("/imu/data", IMU, {})
    assert list_bag(write_messages(tmp_path / "b", "mcap", messages)).chosen["imu"] == "/imu/data"


@pytest.mark.parametrize(("robot", "x"), [("a", 1.0), ("b", 5.0)])
def test_transforms_are_those_of_the_robot_of_the_wheels(tmp_path: Path, robot: str, x: float) -> None:
    """Both have a frame base_link in a frame map, and a gyro that is mounted the one or the other way round."""
    up, down = {"w": 1.0}, {"x": 1.0}
    messages = wheels("/a/joint_states") + wheels("/b/joint_states")
    for name, place, turn in (("a", 1.0, up), ("b", 5.0, down)):
        messages += often(f"/{name}/imu/data", IMU, {"angular_velocity": {"z": 0.5}})
        mount = {"header": (NS, "base_link"), "child_frame_id": "x", "transform": {"rotation": turn}}
        messages.append(Message(f"/{name}/tf_static", "tf2_msgs/msg/TFMessage", NS, {"transforms": [mount]}))
        for step in range(20):
            ns = NS + step * 10**8
            move = {"translation": {"x": place, "y": 0.1 * step}, "rotation": up}
            link = {"header": (ns, "map"), "child_frame_id": "base_link", "transform": move}
            messages.append(Message(f"/{name}/tf", "tf2_msgs/msg/TFMessage", ns, {"transforms": [link]}))
    path = write_messages(tmp_path / "b", "sqlite3", messages)
    drive = read_bag(path, VEHICLE, BagOptions(wheels_topic=f"/{robot}/joint_states"))
    assert drive.pose is not None
    assert drive.gyro is not None
    assert_allclose(drive.pose.values[:, 0], x)
    assert_allclose(drive.gyro.values, 0.5 if robot == "a" else -0.5)
