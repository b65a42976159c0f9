from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.highlevel import AnyReader

from bag_files import STORES, VEHICLE, example_drive, write_bag
from skidsteer import se2
from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError
from skidsteer.io.bag import list_bag, read_bag, read_bag_noted
from skidsteer.io.chunked import ByteFile, ChunkedSource
from skidsteer.io.mcap_index import MCAP
from skidsteer.io.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    RECORD_HEAD,
    SCHEMA,
    parse_chunk_head,
    parse_records,
    unpack_chunk,
)
from skidsteer.io.mcap_writer import _pack, write_mcap

PARTS = ("wheels", "pose", "gyro", "command")
HEADS = len(MAGIC)


def records(data: bytes) -> list[tuple[int, bytes]]:
    """Opcode and content of each record of a file."""
    body = data[HEADS:-HEADS]
    return [(op, body[start:end]) for op, start, end in parse_records(body)]


def joined(parts: list[tuple[int, bytes]], end: bytes = MAGIC) -> bytes:
    return MAGIC + b"".join(RECORD_HEAD.pack(op, len(content)) + content for op, content in parts) + end


def unpacked_chunk(content: bytes) -> bytes:
    head = parse_chunk_head(0, content[:64])
    return unpack_chunk(head, content[head.start :])


@pytest.fixture
def drive() -> Drive:
    return example_drive(2.0)


def assert_same(got: Drive, expected: Drive) -> None:
    for part in PARTS:
        assert_array_equal(getattr(got, part).t, getattr(expected, part).t)
        assert_allclose(getattr(got, part).values, getattr(expected, part).values, rtol=0, atol=4e-15)


# --- written by us


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
def test_written_drive_reads_back(tmp_path: Path, drive: Drive, compression: str) -> None:
    command = Series(drive.wheels.t, drive.wheels.values + 0.1)
    drive = replace(drive, wheel_command=command)
    write_mcap(tmp_path / "a.mcap", drive, drive.pose, compression)
    got = read_bag(tmp_path / "a.mcap", VEHICLE)
    assert_same(got, drive)
    assert got.wheel_command is not None
    assert_allclose(got.wheel_command.values, command.values, atol=1e-15)
    assert not list(tmp_path.glob(".skidsteer*"))


def test_own_odometry_is_never_taken_for_a_reference(tmp_path: Path, drive: Drive) -> None:
    path = tmp_path / "a.mcap"
    write_mcap(path, replace(drive, pose=None), drive.pose)
    assert "reference" not in list_bag(path).chosen
    position = Series(drive.pose.t, drive.pose.values[:, :2])  # type: ignore[union-attr]
    write_mcap(path, replace(drive, pose=None, position=position), drive.pose)
    assert list_bag(path).chosen["reference"] == "/reference/position"
    assert_array_equal(read_bag(path, VEHICLE).position.values, position.values)  # type: ignore[union-attr]


def test_library_reads_what_was_written(tmp_path: Path) -> None:
    # By hand: three poses on an arc to the left, 90 deg in two seconds, radius 2 m, beside an odometry that starts
    # elsewhere, one metre to the left of its origin.
    omega, v = np.pi / 4, np.pi / 2
    t = np.array([1.5, 2.5, 3.5])
    arc = se2.exp(np.array([[0, 0, 0], [v, 0, omega], [2 * v, 0, 2 * omega]]))
    wheels = Series(np.array([1.0, 2.0]), np.array([[0.3, 0.6], [0.9, 1.2]]))
    reference = Series(t, se2.compose(np.array([5.0, 1.0, np.pi]), arc))
    drive = Drive("d", VEHICLE, wheels, pose=reference, gyro=Series(t, np.array([0.1, 0.2, 0.3])))
    write_mcap(tmp_path / "a.mcap", drive, Series(t, arc + np.array([0.0, 1.0, 0.0])))
    found: dict[str, list[Any]] = {}
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        for connection, ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
            stamped = message.transforms[0] if connection.topic == "/tf_static" else message
            assert stamped.header.stamp.sec * 10**9 + stamped.header.stamp.nanosec == ns
    joints = found["/joint_states"]
    assert joints[0].name == ["left_wheel", "right_wheel"]
    assert_allclose([message.velocity for message in joints], [[2.0, 4.0], [6.0, 8.0]])
    ours, theirs = found["/skidsteer/odom"], found["/reference/odom"]
    assert [ours[0].header.frame_id, theirs[0].header.frame_id, ours[0].child_frame_id] == ["odom", "map", "base_link"]
    for odometry in (ours, theirs):
        for message in odometry:
            twist = message.twist.twist
            assert_allclose([twist.linear.x, twist.linear.y, twist.angular.z], [v, 0.0, omega], atol=1e-12)
    assert_allclose([ours[2].pose.pose.position.x, ours[2].pose.pose.position.y], [2.0, 3.0], atol=1e-12)
    assert_allclose([ours[2].pose.pose.orientation.z, ours[2].pose.pose.orientation.w], [np.sin(omega), np.cos(omega)])
    move = found["/tf_static"][0].transforms[0].transform
    assert_allclose(
        [move.translation.x, move.translation.y, move.rotation.z, move.rotation.w], [5, 2, 1, 0], atol=1e-12
    )
    assert [message.angular_velocity.z for message in found["/imu/data"]] == [0.1, 0.2, 0.3]
    assert found["/imu/data"][0].orientation_covariance[0] == -1


def test_long_drive_fills_several_chunks(tmp_path: Path) -> None:
    drive = long_drive()
    write_mcap(tmp_path / "a.mcap", drive)
    assert sum(op == CHUNK for op, _ in records((tmp_path / "a.mcap").read_bytes())) > 1
    assert_allclose(read_bag(tmp_path / "a.mcap", VEHICLE).wheels.values, drive.wheels.values, atol=1e-15)
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        assert reader.message_count == 20_000


def test_negative_times_are_shifted_by_whole_seconds(tmp_path: Path, drive: Drive) -> None:
    early = Drive("d", VEHICLE, Series(drive.wheels.t - 3.5, drive.wheels.values), gyro=drive.gyro)
    write_mcap(tmp_path / "a.mcap", early)
    got = read_bag(tmp_path / "a.mcap", VEHICLE)
    assert_allclose(got.wheels.t, early.wheels.t + 4.0, atol=1e-9)
    assert_allclose(got.gyro.t, early.gyro.t + 4.0, atol=1e-9)  # type: ignore[union-attr]


def test_writing_says_what_is_wrong(tmp_path: Path, drive: Drive) -> None:
    with pytest.raises(ValueError, match="compression must be"):
        write_mcap(tmp_path / "a.mcap", drive, compression="gzip")
    with pytest.raises(ValueError, match="beyond what a ROS stamp"):
        write_mcap(tmp_path / "a.mcap", Drive("d", VEHICLE, Series([1e10], [[0.0, 0.0]])))  # type: ignore[arg-type]
    with pytest.raises(DataError, match=r"cannot write .*No such file"):
        write_mcap(tmp_path / "no" / "a.mcap", drive)
    assert list(tmp_path.iterdir()) == []


# --- unfinished and unusual files


@pytest.fixture(params=["zstd", "lz4", ""])
def written(request: pytest.FixtureRequest, tmp_path: Path, drive: Drive) -> bytes:
    write_mcap(tmp_path / "whole.mcap", drive, compression=request.param)
    return (tmp_path / "whole.mcap").read_bytes()


def read_bytes(tmp_path: Path, data: bytes) -> tuple[Drive, str, str]:
    (tmp_path / "given.mcap").write_bytes(data)
    got, contents = read_bag_noted(tmp_path / "given.mcap", VEHICLE)
    return got, contents.kind, "\n".join(contents.notes)


def test_file_without_index_is_read(tmp_path: Path, drive: Drive, written: bytes) -> None:
    body = records(written)
    end = next(index for index, (op, _) in enumerate(body) if op == DATA_END)
    # The recorder died before it wrote what comes after the data.
    got, kind, notes = read_bytes(tmp_path, joined(body[:end], end=b""))
    assert_same(got, drive)
    assert kind == "MCAP, unfinished"
    assert "unfinished or cut short" in notes
    # A finished file with an empty summary; and one whose chunks have no index of their own.
    footer = (FOOTER, struct.pack("<QQI", 0, 0, 0))
    got, kind, _ = read_bytes(tmp_path, joined([*body[: end + 1], footer]))
    assert (kind, len(got.wheels)) == ("MCAP", len(drive.wheels))
    bare = [record for record in body[: end + 1] if record[0] != MESSAGE_INDEX]
    assert_same(read_bytes(tmp_path, joined([*bare, footer]))[0], drive)


def long_drive() -> Drive:
    t = np.arange(20_000) / 100.0
    return Drive("long", VEHICLE, Series(t, np.stack([np.sin(t), np.cos(t)], axis=1)))


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
def test_cut_file_gives_what_is_whole(tmp_path: Path, compression: str) -> None:
    write_mcap(tmp_path / "a.mcap", long_drive(), compression=compression)
    data = (tmp_path / "a.mcap").read_bytes()
    lengths = []
    for share in (0.4, 0.7, 0.999):
        got, kind, _ = read_bytes(tmp_path, data[: int(len(data) * share)])
        lengths.append(len(got.wheels))
        assert_allclose(got.wheels.values, long_drive().wheels.values[: len(got.wheels)], atol=1e-15)
    assert 0 < lengths[0] < lengths[1] <= lengths[2] == 20_000
    assert kind == "MCAP, unfinished"


def test_messages_outside_of_chunks(tmp_path: Path, drive: Drive, written: bytes) -> None:
    body = records(written)
    loose = [body[0]]
    for op, content in body:
        if op == CHUNK:
            inner = unpacked_chunk(content)
            loose += [(kind, inner[start:end]) for kind, start, end in parse_records(inner)]
    got, _, _ = read_bytes(tmp_path, joined([*loose, (DATA_END, bytes(4))], end=b""))
    assert_same(got, drive)


def test_damaged_summary_falls_back_to_the_data(tmp_path: Path, drive: Drive, written: bytes) -> None:
    footer = len(written) - HEADS - 20
    wrong = bytearray(written)
    wrong[footer : footer + 8] = struct.pack("<Q", 2**62)
    got, _, notes = read_bytes(tmp_path, bytes(wrong))
    assert_same(got, drive)
    assert "its index is damaged" in notes


def test_summary_that_lacks_a_chunk_is_not_trusted(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", long_drive())
    body = records((tmp_path / "a.mcap").read_bytes())
    last = max(index for index, (op, _) in enumerate(body) if op == CHUNK_INDEX)
    assert len(read_bytes(tmp_path, joined(body[:last] + body[last + 1 :]))[0].wheels) == 20_000


def test_chunk_shorter_than_it_says_is_left_out(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", long_drive())
    body = records((tmp_path / "a.mcap").read_bytes())
    index, content = [(i, content) for i, (op, content) in enumerate(body) if op == CHUNK][1]
    # One byte more than there is, and no checksum to notice by.
    size = int.from_bytes(content[16:24], "little") + 1
    body[index] = (CHUNK, content[:16] + struct.pack("<QI", size, 0) + content[28:])
    got, _, notes = read_bytes(tmp_path, joined(body))
    assert 0 < len(got.wheels) < 20_000
    assert f"1 of 3 chunks cannot be read and were left out (a chunk of {size} bytes unpacks to {size - 1})" in notes


def test_damaged_chunk_is_left_out_and_told(tmp_path: Path) -> None:
    for compression in ("zstd", "lz4"):
        write_mcap(tmp_path / "a.mcap", long_drive(), compression=compression)
        data = bytearray((tmp_path / "a.mcap").read_bytes())
        data[2000] ^= 0xFF
        got, _, notes = read_bytes(tmp_path, bytes(data))
        assert 0 < len(got.wheels) < 20_000
        assert notes.count("1 of 3 chunks cannot be read and were left out") == 1


@pytest.mark.parametrize("compression", ["zstd", ""])
def test_chunk_whose_index_points_astray_is_walked(tmp_path: Path, drive: Drive, compression: str) -> None:
    write_mcap(tmp_path / "a.mcap", drive, compression=compression)
    data = (tmp_path / "a.mcap").read_bytes()
    at = data.index(RECORD_HEAD.pack(MESSAGE_INDEX, 6 + 16 * len(drive.wheels)))
    wrong = bytearray(data)
    wrong[at + 9 + 6 + 8] ^= 0x10  # the offset of the first message
    assert_same(read_bytes(tmp_path, bytes(wrong))[0], drive)


def test_chunk_of_absurd_size_is_refused_without_trying(tmp_path: Path, drive: Drive) -> None:
    write_mcap(tmp_path / "a.mcap", drive)
    body = records((tmp_path / "a.mcap").read_bytes())
    index, content = next((i, content) for i, (op, content) in enumerate(body) if op == CHUNK)
    body[index] = (CHUNK, content[:16] + struct.pack("<Q", 2**50) + content[24:])
    with pytest.raises(DataError, match="claims 1125899906842624 bytes"):
        read_bytes(tmp_path, joined(body))


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_chunk_that_unpacks_to_more_than_it_says_is_cut_there(tmp_path: Path, compression: str) -> None:
    import tracemalloc

    write_mcap(tmp_path / "a.mcap", example_drive(1.0), compression=compression)
    body = records((tmp_path / "a.mcap").read_bytes())
    index, content = next((i, content) for i, (op, content) in enumerate(body) if op == CHUNK)
    head = parse_chunk_head(0, content[:64])
    bomb = _pack(bytes(1 << 28), compression)
    start = head.start - 8
    body[index] = (CHUNK, content[:start] + struct.pack("<Q", len(bomb)) + bomb)
    tracemalloc.start()
    with pytest.raises(DataError, match="a chunk fails its checksum"):
        read_bytes(tmp_path, joined(body))
    assert tracemalloc.get_traced_memory()[1] < 64 << 20
    tracemalloc.stop()


def test_index_that_repeats_a_message_is_not_believed(tmp_path: Path, drive: Drive) -> None:
    # A million times one large message would be more than there is memory.
    string = struct.pack("<I", 6) + b"/noise"
    channel = (CHANNEL, struct.pack("<HH", 7, 0) + string + struct.pack("<I", 3) + b"cdr" + bytes(4))
    message = struct.pack("<HIQQ", 7, 0, 0, 0) + bytes(1 << 20)
    inner = joined([channel, (MESSAGE, message)], end=b"")[HEADS:]
    offset = len(inner) - len(message) - RECORD_HEAD.size
    entries = struct.pack("<QQ", 0, offset) * 100_000
    chunk = struct.pack("<QQQI", 0, 0, len(inner), 0) + struct.pack("<I", 4) + b"zstd"
    packed = _pack(inner, "zstd")
    index = struct.pack("<HI", 7, len(entries)) + entries
    data = joined([channel, (CHUNK, chunk + struct.pack("<Q", len(packed)) + packed), (MESSAGE_INDEX, index)])
    (tmp_path / "a.mcap").write_bytes(data)
    source = ChunkedSource(tmp_path / "a.mcap", MCAP)
    assert source.topics[0].count == 100_000
    (read,) = source.read(source.topics)
    source.close()
    assert len(read[1]) == 1


def test_topic_of_two_channels_is_one(tmp_path: Path, drive: Drive) -> None:
    write_mcap(tmp_path / "a.mcap", drive, compression="")
    body = records((tmp_path / "a.mcap").read_bytes())
    inner: list[tuple[int, bytes]] = []
    number = 0
    for op, content in body:
        if op == CHUNK:
            chunk = unpacked_chunk(content)
            for kind, start, end in parse_records(chunk):
                record = chunk[start:end]
                if kind == CHANNEL and record[:2] == b"\1\0":
                    inner.append((kind, b"\x63\0" + record[2:]))
                if kind == MESSAGE and record[:2] == b"\1\0":
                    number += 1
                    record = (b"\x63\0" if number % 2 else b"\1\0") + record[2:]
                inner.append((kind, record))
    got, _, _ = read_bytes(tmp_path, joined([body[0], *inner], end=b""))
    assert_same(got, drive)


def test_ros1_messages_in_mcap(tmp_path: Path) -> None:
    store = STORES[1]
    types = store.types
    text, _ = store.generate_msgdef("sensor_msgs/msg/JointState", ros_version=1)

    def string(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    schema = struct.pack("<H", 1) + string("sensor_msgs/JointState") + string("ros1msg") + string(text)
    channel = struct.pack("<HH", 5, 1) + string("/joint_states") + string("ros1") + struct.pack("<I", 0)
    messages = []
    for index in range(3):
        stamp = types["builtin_interfaces/msg/Time"](100 + index, 0)
        header = types["std_msgs/msg/Header"](seq=index, stamp=stamp, frame_id="")
        rates = np.array([1.0, 2.0])
        message = types["sensor_msgs/msg/JointState"](header, ["left", "right"], np.zeros(0), rates, np.zeros(0))
        data = bytes(store.serialize_ros1(message, "sensor_msgs/msg/JointState"))
        messages.append((MESSAGE, struct.pack("<HIQQ", 5, index, index, index) + data))
    got, _, _ = read_bytes(tmp_path, joined([(SCHEMA, schema), (CHANNEL, channel), *messages, (DATA_END, bytes(4))]))
    assert_allclose(got.wheels.values, [[0.15, 0.3]] * 3)
    assert_allclose(got.wheels.t, [100, 101, 102])


def test_other_encodings_are_listed_and_not_used(tmp_path: Path, drive: Drive) -> None:
    write_mcap(tmp_path / "a.mcap", drive, compression="")
    data = (tmp_path / "a.mcap").read_bytes().replace(b"\3\0\0\0cdr", b"\3\0\0\0xyz")
    body = [(op, content) for op, content in records(data) if op != CHUNK]
    chunk = next(content for op, content in records(data) if op == CHUNK)
    body.insert(1, (CHUNK, chunk[:24] + bytes(4) + chunk[28:]))  # without the checksum
    (tmp_path / "b.mcap").write_bytes(joined(body))
    contents = list_bag(tmp_path / "b.mcap")
    assert {topic.name for topic in contents.topics} >= {"/joint_states", "/imu/data"}
    assert all(topic.serves == () for topic in contents.topics)


def test_images_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from bag_files import START, Message, drive_messages, write_messages

    drive = example_drive(1.0)
    image = Message(
        "/camera/image", "sensor_msgs/msg/Image", START * 10**9, {"data": np.zeros(400_000, dtype=np.uint8)}
    )
    images = [replace(image, bag_ns=START * 10**9 + index * 10**8) for index in range(10)]
    path = write_messages(tmp_path / "b", "mcap", drive_messages(drive) + images)
    taken: list[int] = []
    original = ByteFile.read

    def counting(file: ByteFile, start: int, size: int) -> bytes:
        data = original(file, start, size)
        taken.append(len(data))
        return data

    monkeypatch.setattr(ByteFile, "read", counting)
    got = read_bag(path, VEHICLE)
    assert len(got.wheels) == len(drive.wheels)
    assert sum(file.stat().st_size for file in path.iterdir()) > 4_000_000
    # The messages are read about twice, once to find the wheels.
    assert sum(taken) < 1_000_000


def test_bag_of_the_library_reads_the_same_with_and_without_its_metadata(tmp_path: Path, drive: Drive) -> None:
    path = write_bag(drive, tmp_path / "b", "mcap")
    (path / "metadata.yaml").unlink()
    assert_same(read_bag(path, VEHICLE), drive)
    (file,) = path.iterdir()
    assert_same(read_bag(file, VEHICLE), drive)
