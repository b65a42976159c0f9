from __future__ import annotations

import os
import sqlite3
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from bag_files import START, VEHICLE, Message, example_drive, wheel_messages, write_bag, write_messages
from skidsteer.errors import DataError, RequestError, SkidSteerError
from skidsteer.io import compressed, open_bag
from skidsteer.io.bag import is_bag, list_bag, read_bag, read_bag_noted
from skidsteer.io.drives import load_drive
from skidsteer.io.folder import write_folder
from skidsteer.io.mcap_writer import _pack

MCAP = b"\x89MCAP0\r\n"


def refusal(path: Path) -> str:
    """The one line that both readings end in."""
    with pytest.raises(SkidSteerError) as listing:
        list_bag(path)
    with pytest.raises(SkidSteerError) as reading:
        read_bag(path, VEHICLE)
    assert str(listing.value) == str(reading.value)
    assert str(reading.value).isprintable()
    return str(reading.value)


@pytest.mark.parametrize(
    ("name", "data", "what"),
    [
        ("a.mcap", b"", "has 0 bytes; nothing was recorded"),
        ("a.bag", b"", "has 0 bytes"),
        ("a.db3", b"", "has 0 bytes"),
        ("a.mcap", b"t,x,y\n1,2,3\n", "is not a MCAP file but a text file"),
        ("a.db3", b"\0\1\2\3" * 9, "is not a rosbag2 sqlite3 file but something else, or its beginning is damaged"),
        ("a.mcap", b"#ROSBAG V2.0\n" + bytes(99), "is a rosbag1 file; rename it to a.bag"),
        ("a.bag", MCAP + bytes(99), "is a MCAP file; rename it to a.mcap"),
        ("a.mcap", b"SQLite format 3\0" + bytes(99), "is a rosbag2 sqlite3 file; rename it to a.db3"),
        ("a.db3", b"SQLite format 3\0" + b"\xff" * 99, "it is damaged"),
        ("a.csv", b"t,x\n", "is no bag; bags are named .bag, .db3, .mcap"),
        ("a.bag", b"#ROSBAG V1.2\n", "is a rosbag1 file of before 2010; bring it up to date with `rosbag fix`"),
    ],
)
def test_files_that_are_no_bags(tmp_path: Path, name: str, data: bytes, what: str) -> None:
    (tmp_path / name).write_bytes(data)
    assert what in refusal(tmp_path / name)


@pytest.mark.parametrize("data", [MCAP, MCAP + bytes(500), MCAP + b"\xff" * 500, MCAP + b"\6" + b"\xff" * 500])
def test_mcap_without_anything_whole(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.mcap").write_bytes(data)
    with pytest.raises(DataError, match=r"holds no messages .*unfinished or cut short, whole as far as byte 8"):
        read_bag(tmp_path / "a.mcap", VEHICLE)
    assert list_bag(tmp_path / "a.mcap").topics == ()


@pytest.mark.parametrize("data", [b"", bytes(500), b"\xff" * 500])
def test_rosbag1_without_anything_whole(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + data)
    with pytest.raises(DataError, match="holds no messages"):
        read_bag(tmp_path / "a.bag", VEHICLE)


def test_what_is_not_there(tmp_path: Path) -> None:
    assert "no such file or folder" in refusal(tmp_path / "a.mcap")
    assert "a?.mcap: no such file or folder" in refusal(Path("a\0.mcap"))
    assert "holds no metadata.yaml and no file named .bag, .db3, .mcap" in refusal(tmp_path)


def test_folder_is_a_bag_only_with_bags_in_it(tmp_path: Path) -> None:
    assert not is_bag(tmp_path)
    assert not is_bag(tmp_path / "a.csv")
    assert is_bag(tmp_path / "a.mcap")
    (tmp_path / "a.db3").touch()
    assert is_bag(tmp_path)


def test_what_a_drive_is_read_as(tmp_path: Path) -> None:
    """A folder of bags without a list is a bag; one with wheels.csv is a drive folder, whatever bags lie in it."""
    drive = example_drive(0.3)
    write_bag(drive, tmp_path / "loose" / "a", "mcap")
    (bag,) = (path for path in tmp_path.rglob("*.mcap"))
    (bag.parent / "metadata.yaml").unlink(missing_ok=True)
    assert len(load_drive(bag.parent, VEHICLE).wheels) == len(drive.wheels)
    write_folder(drive, tmp_path / "folder")
    (tmp_path / "folder" / "left.bag").touch()
    assert load_drive(tmp_path / "folder").sha256 != load_drive(bag.parent, VEHICLE).sha256
    (tmp_path / "A.MCAP").touch()
    with pytest.raises(DataError, match="has 0 bytes"):
        load_drive(tmp_path / "A.MCAP", VEHICLE)


# --- rosbag2 metadata


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_bag(example_drive(0.3), tmp_path / "b", "mcap")


def change(recording: Path, **changes: Any) -> Path:
    path = recording / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    content["rosbag2_bagfile_information"].update(changes)
    path.write_text(yaml.safe_dump(content))
    return recording


@pytest.mark.parametrize(
    "name",
    ["../b.mcap", "/etc/passwd", "a/../../b.mcap", "..\\b.mcap", "C:/b.mcap", "C:\\b.mcap", "//host/b.mcap", ".."],
)
def test_paths_out_of_the_folder_are_refused(recording: Path, name: str) -> None:
    assert "outside of the bag's folder; refused" in refusal(change(recording, relative_file_paths=["b.mcap", name]))


def test_old_recordings_name_their_folder_too(recording: Path) -> None:
    drive = read_bag(change(recording, relative_file_paths=["b/b.mcap"]), VEHICLE)
    assert len(drive.wheels) == 15


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"relative_file_paths": ["c.mcap"]}, "c.mcap listed in metadata.yaml is missing"),
        ({"relative_file_paths": []}, "must be a list of file names"),
        ({"relative_file_paths": "b.mcap"}, "must be a list of file names"),
        ({"relative_file_paths": [7]}, "must be a list of file names"),
        ({"relative_file_paths": ["metadata.yaml"]}, "its files are of the kinds ['.yaml']; need .mcap or .db3"),
        (
            {"compression_mode": "FILE", "compression_format": "rar"},
            "compressed by file with rar; only file or message with zstd",
        ),
    ],
)
def test_metadata_that_make_no_sense(recording: Path, changes: dict[str, Any], what: str) -> None:
    assert what in refusal(change(recording, **changes))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "is no metadata of a rosbag2 recording"),
        ("a: [", "is no metadata of a rosbag2 recording"),
        ("a: 1", "is no metadata of a rosbag2 recording"),
        ("rosbag2_bagfile_information: 3", "is no mapping"),
        ("rosbag2_bagfile_information: {}", "must be a list of file names"),
        ("a: &a [x, x]\nrosbag2_bagfile_information: [*a, *a]", "aliases are not accepted"),
        (
            "rosbag2_bagfile_information: !!python/object/apply:os.system ['true']",
            "is no metadata of a rosbag2 recording",
        ),
        ("[" * 20_000, "is no metadata of a rosbag2 recording"),
        ("#" * (5 << 20), "is larger than 4194304 bytes"),
    ],
)
def test_metadata_that_are_none(recording: Path, text: str, what: str) -> None:
    (recording / "metadata.yaml").write_text(text)
    assert what in refusal(recording)


def test_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mcap")
    assert "is a folder, a device or a pipe" in refusal(tmp_path / "a.mcap")


def test_compressed_file_damaged(tmp_path: Path) -> None:
    path = write_bag(example_drive(0.3), tmp_path / "b", "mcap-file")
    (file,) = path.glob("*.zstd")
    data = file.read_bytes()
    file.write_bytes(data[:4] + b"\xff" * 500)
    assert "b.mcap.zstd: cannot be unpacked" in refusal(path)
    file.write_bytes(data[:50])
    assert refusal(path).startswith(f"{path / 'b.mcap'}: has 0 bytes")


def test_compressed_file_cut_short(tmp_path: Path) -> None:
    path = write_bag(example_drive(6.0), tmp_path / "b", "mcap-file")
    (file,) = path.glob("*.zstd")
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 4 // 5])
    drive, contents = read_bag_noted(path, VEHICLE)
    assert 0 < len(drive.wheels) < 300
    assert contents.notes[0] == "b.mcap.zstd: cut short; what could be unpacked of it is read"


def test_compressed_messages_damaged(tmp_path: Path) -> None:
    path = write_bag(example_drive(0.3), tmp_path / "b", "mcap-message")
    (file,) = path.glob("*.mcap")
    data = file.read_bytes()
    start = data.index(b"\x28\xb5\x2f\xfd")  # the first message
    file.write_bytes(data[: start + 5] + bytes(3) + data[start + 8 :])
    _, contents = read_bag_noted(path, VEHICLE)
    assert any("1 messages cannot be unpacked; left out" in note for note in contents.notes)


def test_message_cut_short_is_not_taken_for_whole() -> None:
    packed = _pack(b"0123456789" * 50, "zstd")
    assert compressed._unpack_message(packed) == b"0123456789" * 50
    assert compressed._unpack_message(packed[:-3]) is None
    assert compressed._unpack_message(b"") is None


def test_file_that_unpacks_beyond_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bag(example_drive(0.3), tmp_path / "b", "mcap-file")
    monkeypatch.setattr(compressed.shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    assert "unpacks to more than half the room" in refusal(path)


def test_temporary_files_are_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bag(example_drive(0.3), tmp_path / "b", "mcap-file")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(compressed.tempfile, "tempdir", str(tmp_path / "temporary"))
    read_bag(path, VEHICLE)
    assert list((tmp_path / "temporary").iterdir()) == []


# --- sqlite3


def database(tmp_path: Path, *statements: str) -> Path:
    path = tmp_path / "a.db3"
    connection = sqlite3.connect(path)
    for statement in statements:
        connection.execute(statement)
    connection.commit()
    connection.close()
    return path


TOPICS = "CREATE TABLE topics (id INTEGER, name TEXT, type TEXT, serialization_format TEXT)"
JOINTS = "INSERT INTO topics VALUES (1, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr')"


def test_database_of_something_else(tmp_path: Path) -> None:
    path = database(tmp_path, "CREATE TABLE people (name TEXT)")
    assert "is no rosbag2 recording; its tables are people, not topics and messages" in refusal(path)


def test_view_that_never_ends_is_not_asked(tmp_path: Path) -> None:
    endless = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x, 1 AS topic_id FROM n"
    assert "is no rosbag2 recording" in refusal(database(tmp_path, TOPICS, f"CREATE VIEW messages AS {endless}"))


def test_rows_of_wrong_types_are_left_out(tmp_path: Path) -> None:
    (whole,) = write_messages(tmp_path / "b", "sqlite3", wheel_messages(example_drive(0.3), "velocity")).glob("*.db3")
    connection = sqlite3.connect(whole)
    connection.execute("UPDATE messages SET data = 'text' WHERE id = 2")
    connection.execute("UPDATE messages SET timestamp = 1.5 WHERE id = 3")
    connection.execute("UPDATE messages SET data = zeroblob(7) WHERE id = 4")
    connection.commit()
    connection.close()
    drive, contents = read_bag_noted(whole, VEHICLE)
    assert len(drive.wheels) == 12
    assert any("1 messages do not fit sensor_msgs/msg/JointState" in note for note in contents.notes)


@pytest.mark.skipif(sys.version_info < (3, 11), reason="sqlite3 has no limits before Python 3.11")
def test_value_of_absurd_size_is_not_taken(tmp_path: Path) -> None:
    huge = "INSERT INTO messages VALUES (1, 1, zeroblob(100000000))"
    messages = "CREATE TABLE messages (topic_id INTEGER, timestamp INTEGER, data BLOB)"
    with pytest.raises(DataError, match=r"damaged; not all of its messages can be read \(string or blob too big\)"):
        read_bag(database(tmp_path, TOPICS, JOINTS, messages, huge), VEHICLE)


def test_cut_database(tmp_path: Path) -> None:
    """A copy that was cut: what is whole of it is read, as long as its first pages are there."""
    drive = example_drive(8.0)
    (whole,) = write_bag(drive, tmp_path / "b", "sqlite3").glob("*.db3")
    data = whole.read_bytes()
    (tmp_path / "cut.db3").write_bytes(data[: len(data) * 2 // 3 + 17])
    got, contents = read_bag_noted(tmp_path / "cut.db3", VEHICLE)
    assert any("cut.db3: damaged; not all of its messages can be read" in note for note in contents.notes)
    assert 0.5 * len(drive.wheels) < len(got.wheels) < len(drive.wheels)
    kept = np.isin(drive.wheels.t, got.wheels.t)
    np.testing.assert_allclose(got.wheels.values, drive.wheels.values[kept], atol=4e-15)
    (tmp_path / "cut.db3").write_bytes(data[:9000])
    with pytest.raises(DataError, match=r"cut.db3.*damaged"):
        read_bag(tmp_path / "cut.db3", VEHICLE)


def test_log_that_was_left_behind_is_told(tmp_path: Path) -> None:
    (whole,) = write_bag(example_drive(0.3), tmp_path / "b", "sqlite3").glob("*.db3")
    whole.with_name(whole.name + "-wal").write_bytes(b"x")
    assert any("left b.db3-wal behind" in note for note in list_bag(whole).notes)


# --- messages and definitions


def test_every_message_damaged(tmp_path: Path) -> None:
    messages = [
        Message(
            "/joint_states", "sensor_msgs/msg/JointState", START * 10**9 + i, {"name": ["l", "r"], "velocity": [1, 1]}
        )
        for i in range(3)
    ]
    (whole,) = write_messages(tmp_path / "b", "sqlite3", messages).glob("*.db3")
    connection = sqlite3.connect(whole)
    connection.execute("UPDATE messages SET data = substr(data, 1, 20)")
    connection.commit()
    connection.close()
    with pytest.raises(RequestError, match="no topic serves as wheel speeds; name the wheels of /joint_states"):
        read_bag(whole, VEHICLE)


def test_custom_definition_under_a_standard_name(tmp_path: Path) -> None:
    (whole,) = write_bag(example_drive(0.3), tmp_path / "b", "sqlite3").glob("*.db3")

    def define(text: str) -> None:
        connection = sqlite3.connect(whole)
        change = "UPDATE message_definitions SET encoded_message_definition = ? WHERE topic_type LIKE '%Imu'"
        connection.execute(change, (text,))
        connection.commit()
        connection.close()

    for text, what in (
        ("float64 rate\n", "imu left out: /imu/data: 30 messages do not fit sensor_msgs/msg/Imu (no field header"),
        ("float64[ x\n@@@\n", "imu left out: /imu/data: the definition of sensor_msgs/msg/Imu in the bag cannot"),
        ("x" * (2 << 20), "imu left out: /imu/data: the definition of sensor_msgs/msg/Imu in the bag has 2097152"),
        ("std_msgs/Header header\nmissing_msgs/Thing thing\n", "no definition of missing_msgs/msg/Thing"),
    ):
        define(text)
        drive, contents = read_bag_noted(whole, VEHICLE)
        assert drive.gyro is None
        assert any(what in note for note in contents.notes), contents.notes


def test_infinite_and_nan_everywhere(tmp_path: Path) -> None:
    messages = [
        Message(
            "/joint_states",
            "sensor_msgs/msg/JointState",
            START * 10**9 + i,
            {"header": (START * 10**9 + i, ""), "name": ["l", "r"], "velocity": [np.nan, np.inf]},
        )
        for i in range(3)
    ]
    with pytest.raises(DataError, match="none of its 3 messages holds finite numbers"):
        read_bag(write_messages(tmp_path / "b", "mcap", messages), VEHICLE)


def test_foreign_names_stay_on_one_line(tmp_path: Path) -> None:
    message = Message("/a\nb\x1b[31m" + "c" * 500, "geometry_msgs/msg/Twist", START * 10**9, {})
    path = write_messages(tmp_path / "b", "mcap", [message])
    with pytest.raises(RequestError, match="no topic serves") as refused:
        read_bag(path, VEHICLE)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 1000


def test_missing_packages_name_the_extra(tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from skidsteer.io import messages

    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    messages.standard_definitions.cache_clear()
    with pytest.raises(RequestError, match=r"pip install 'skidsteer\[bags\]'"):
        read_bag(recording, VEHICLE)


def test_files_are_closed_whatever_happens(tmp_path: Path, recording: Path) -> None:
    with pytest.raises(RuntimeError, match="mine"), open_bag.open_bag(recording) as source:
        raise RuntimeError("mine")
    with pytest.raises(ValueError, match="closed file"):
        list(source.read(source.topics))
