from __future__ import annotations

import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bag_files import START, VEHICLE, example_drive, write_bag
from skidsteer.drive import Drive
from skidsteer.io.bag import list_bag, read_bag, read_bag_noted
from skidsteer.io.rosbag1_records import CHUNK, CONNECTION, INDEX, MAGIC, MESSAGE, parse_records, read_record

SYSTEM_PYTHON = "/usr/bin/python3"
PARTS = ("wheels", "pose", "gyro", "command")

# Runs where ROS 1 is installed, with that Python: numbers come in as text, one line a message.
WRITE = """
import sys
import rosbag, rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState

with rosbag.Bag(sys.argv[1], "w", compression=sys.argv[2], chunk_threshold=20000) as bag:
    for line in sys.stdin:
        topic, ns, *numbers = line.split()
        numbers = [float(number) for number in numbers]
        stamp = rospy.Time(int(ns) // 10**9, int(ns) % 10**9)
        if topic == "/joint_states":
            message = JointState(name=["left_wheel", "right_wheel"], velocity=numbers)
        elif topic == "/ground_truth/odom":
            message = Odometry(child_frame_id="base_link")
            message.pose.pose.position.x, message.pose.pose.position.y = numbers[:2]
            message.pose.pose.orientation.z, message.pose.pose.orientation.w = numbers[2:]
        elif topic == "/imu/data":
            message = Imu()
            message.angular_velocity.z = numbers[0]
        else:
            message = Twist()
            message.linear.x, message.angular.z = numbers
        if hasattr(message, "header"):
            message.header.stamp = stamp
        bag.write(topic, message, stamp)
"""


def has_ros1() -> bool:
    check = "import rosbag, rospy, geometry_msgs.msg, nav_msgs.msg, sensor_msgs.msg"
    try:
        return subprocess.run([SYSTEM_PYTHON, "-c", check], capture_output=True, timeout=60).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def lines(drive: Drive) -> str:
    rows: list[tuple[int, str]] = []

    def add(topic: str, t: float, *numbers: float) -> None:
        ns = START * 10**9 + round(t * 1e9)
        rows.append((ns, f"{topic} {ns} {' '.join(repr(float(number)) for number in numbers)}"))

    for t, speeds in zip(drive.wheels.t, drive.wheels.values, strict=True):
        add("/joint_states", t, *(speeds / VEHICLE.wheel_radius))
    for t, (x, y, yaw) in zip(drive.pose.t, drive.pose.values, strict=True):  # type: ignore[union-attr]
        add("/ground_truth/odom", t, x, y, np.sin(yaw / 2), np.cos(yaw / 2))
    for t, rate in zip(drive.gyro.t, drive.gyro.values, strict=True):  # type: ignore[union-attr]
        add("/imu/data", t, *rate)
    for t, command in zip(drive.command.t, drive.command.values, strict=True):  # type: ignore[union-attr]
        add("/cmd_vel", t, *command)
    return "\n".join(row for _, row in sorted(rows))


def assert_same(got: Drive, expected: Drive) -> None:
    for part in PARTS:
        assert_array_equal(getattr(got, part).t, getattr(expected, part).t)
        assert_allclose(getattr(got, part).values, getattr(expected, part).values, rtol=0, atol=4e-15)


@pytest.mark.skipif(not has_ros1(), reason="Debian's python3-rosbag is not installed")
@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_bag_of_the_original_writer(tmp_path: Path, compression: str) -> None:
    drive, path = example_drive(3.0), tmp_path / "original.bag"
    command = [SYSTEM_PYTHON, "-c", WRITE, str(path), compression]
    subprocess.run(command, input=lines(drive), text=True, check=True, capture_output=True, timeout=120)
    assert_same(read_bag(path, VEHICLE), drive)
    assert list_bag(path).kind == "rosbag1"
    # The same after the recorder died.
    data = path.read_bytes()
    path.write_bytes(without_index(data))
    got, contents = read_bag_noted(path, VEHICLE)
    assert_same(got, drive)
    assert contents.kind == "rosbag1, unfinished"


def without_index(data: bytes) -> bytes:
    """As a recorder leaves it that dies: no place of the index in the first record, no index at the end."""
    header = read_record(data, len(MAGIC))
    position = header.number("index_pos")
    head = data[: header.end].replace(b"index_pos=" + header.fields["index_pos"], b"index_pos=" + bytes(8))
    return head + data[header.end : position]


@pytest.mark.parametrize("kind", ["rosbag1", "rosbag1-bz2", "rosbag1-lz4"])
def test_file_without_index_is_read(tmp_path: Path, kind: str) -> None:
    drive = example_drive(2.0)
    path = write_bag(drive, tmp_path / "b", kind)
    path.write_bytes(without_index(path.read_bytes()))
    got, contents = read_bag_noted(path, VEHICLE)
    assert_same(got, drive)
    assert any("has no usable index" in note for note in contents.notes)


def test_index_of_the_first_message_may_point_to_its_connection(tmp_path: Path) -> None:
    # As the recorder in C++ has it: it takes down the place before it writes the connection.
    drive = example_drive(2.0)
    path = write_bag(drive, tmp_path / "b", "rosbag1")
    data = bytearray(path.read_bytes())
    chunk = read_record(data, read_record(data, len(MAGIC)).end)
    before = {}  # message -> connection before it
    records = list(parse_records(bytes(data[chunk.data : chunk.end])))
    for one, other in pairwise(records):
        if (one.op, other.op) == (CONNECTION, MESSAGE):
            before[other.start] = one.start
    position, changed = chunk.end, 0
    while (record := read_record(data, position)).op == INDEX:
        first = int.from_bytes(data[record.data + 8 : record.data + 12], "little")
        if first in before:
            data[record.data + 8 : record.data + 12] = before[first].to_bytes(4, "little")
            changed += 1
        position = record.end
    assert changed == 4
    path.write_bytes(data)
    got, contents = read_bag_noted(path, VEHICLE)
    assert_same(got, drive)
    assert not any("cannot be read" in note for note in contents.notes)


def test_chunks_without_index_are_walked(tmp_path: Path) -> None:
    drive = example_drive(2.0)
    path = write_bag(drive, tmp_path / "b", "rosbag1")
    data = without_index(path.read_bytes())
    kept, position = data[: len(MAGIC)], len(MAGIC)
    while position < len(data):
        record = read_record(data, position)
        if record.op != INDEX:
            kept += data[position : record.end]
        position = record.end
    path.write_bytes(kept)
    assert_same(read_bag(path, VEHICLE), drive)


def test_chunk_that_was_never_closed(tmp_path: Path) -> None:
    # The recorder fills in the length of a chunk when it closes it: its messages then stand in the file as they are.
    drive = example_drive(2.0)
    path = write_bag(drive, tmp_path / "b", "rosbag1")
    data = without_index(path.read_bytes())
    record = read_record(data, read_record(data, len(MAGIC)).end)
    assert record.op == CHUNK
    path.write_bytes(data[: record.data - 4] + bytes(4) + data[record.data : record.end])
    assert_same(read_bag(path, VEHICLE), drive)


def test_cut_file_gives_what_is_whole(tmp_path: Path) -> None:
    drive = example_drive(2.0)
    data = write_bag(drive, tmp_path / "b", "rosbag1").read_bytes()
    lengths = []
    for share in (0.3, 0.6, 0.99):
        (tmp_path / "cut.bag").write_bytes(data[: int(len(data) * share)])
        got, contents = read_bag_noted(tmp_path / "cut.bag", VEHICLE)
        lengths.append(len(got.wheels))
        assert contents.kind == "rosbag1, unfinished"
    assert 0 < lengths[0] < lengths[1] <= lengths[2] == len(drive.wheels)


def test_publishers_of_one_topic_are_one(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer

    from bag_files import STORES, build, drive_messages

    drive = example_drive(1.0)
    messages = sorted(drive_messages(drive), key=lambda message: message.bag_ns)
    with Writer(tmp_path / "two.bag") as writer:
        connections = {}
        for index, message in enumerate(messages):
            key = (message.topic, f"/publisher_{index % 2}")
            if key not in connections:
                connections[key] = writer.add_connection(
                    message.topic, message.type, typestore=STORES[1], callerid=key[1]
                )
            data = STORES[1].serialize_ros1(build(STORES[1], message.type, message.value), message.type)
            writer.write(connections[key], message.bag_ns, data)
    assert_same(read_bag(tmp_path / "two.bag", VEHICLE), drive)
