"""What the recorders of ROS 1 and ROS 2 leave behind, finished or not."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bag_files import VEHICLE, drive_messages, example_drive, write_bag, write_messages
from skidsteer.drive import Drive
from skidsteer.errors import DataError
from skidsteer.io.bag import is_bag, list_bag, read_bag, read_bag_noted
from skidsteer.io.bag_names import kind_of, name_of
from skidsteer.io.drives import load_drive
from skidsteer.io.sqlite_pages import _rows, rows_in_pages
from test_io_bag_rosbag1 import assert_same, without_index


@pytest.fixture(scope="module")
def drive() -> Drive:
    return example_drive(2.0)


def field(name: str, value: bytes) -> bytes:
    return struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value


# What `rosbag record` writes on topics that stay silent: 4117 bytes, padded, its index at the end and nothing in it.
SILENT = b"#ROSBAG V2.0\n"
_head = field("chunk_count", bytes(4)) + field("conn_count", bytes(4))
_head += field("index_pos", struct.pack("<Q", 4117)) + field("op", b"\x03")
SILENT += struct.pack("<I", len(_head)) + _head + struct.pack("<I", 4096 - len(_head)) + b" " * (4096 - len(_head))


def test_bag_of_silent_topics_holds_no_messages(tmp_path: Path) -> None:
    assert len(SILENT) == 4117
    (tmp_path / "a.bag").write_bytes(SILENT)
    assert list_bag(tmp_path / "a.bag").kind == "rosbag1"
    with pytest.raises(DataError, match=r"a\.bag: holds no messages$"):
        read_bag(tmp_path / "a.bag", VEHICLE)


@pytest.mark.parametrize(
    ("name", "kind", "recording"),
    [
        ("husky.bag", ".bag", "husky"),
        ("husky_2024-01-01-10-00-00_0.bag.active", ".bag", "husky_2024-01-01-10-00-00_0"),
        ("HUSKY.BAG", ".bag", "HUSKY"),
        ("v1.2_0.mcap", ".mcap", "v1.2_0"),
        ("husky_3.mcap.zstd", ".mcap", "husky_3"),
        ("husky_3.db3.zstd", ".db3", "husky_3"),
        ("husky_3.db3-wal", "", "husky_3.db3-wal"),
        ("husky.bag.orig.active", "", "husky.bag.orig.active"),
        ("husky.bag.zstd", "", "husky.bag.zstd"),
        ("husky.mcap.active", "", "husky.mcap.active"),
    ],
)
def test_names_tell_kind_and_recording(tmp_path: Path, name: str, kind: str, recording: str) -> None:
    (tmp_path / name).touch()
    assert (kind_of(tmp_path / name), name_of(tmp_path / name)) == (kind, recording)
    assert is_bag(tmp_path / name) is is_bag(tmp_path) is bool(kind)


def test_bag_of_a_killed_recorder(tmp_path: Path, drive: Drive) -> None:
    path = write_bag(drive, tmp_path / "b", "rosbag1")
    active = path.rename(path.with_name("b.bag.active"))
    active.write_bytes(without_index(active.read_bytes()))
    got = load_drive(active, VEHICLE)
    assert_same(got, drive)
    assert got.name == "b"


def test_folder_of_a_split_recording_that_was_killed(tmp_path: Path, drive: Drive) -> None:
    """A silent part, one that `rosbag compress` made anew, and an unfinished one at the end."""
    messages = sorted(drive_messages(drive), key=lambda message: message.bag_ns)
    folder = tmp_path / "recording"
    folder.mkdir()
    (folder / "b_0.bag").write_bytes(SILENT)
    write_messages(folder / "b_1", "rosbag1-lz4", messages[:300])
    shutil.copy(write_messages(tmp_path / "b", "rosbag1", messages[:300]), folder / "b_1.orig.bag")
    last = write_messages(folder / "b_2", "rosbag1", messages[300:])
    last.rename(folder / "b_2.bag.active").write_bytes(without_index((folder / "b_2.bag.active").read_bytes()))
    got, contents = read_bag_noted(folder, VEHICLE)
    assert_same(got, drive)
    assert not any("repeat a time stamp" in note for note in contents.notes)


def test_original_alone_is_read(tmp_path: Path, drive: Drive) -> None:
    write_bag(drive, tmp_path / "b.orig", "rosbag1").rename(tmp_path / "b.orig.bag")
    assert_same(read_bag(tmp_path, VEHICLE), drive)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_compressed_files_whose_list_is_lost(tmp_path: Path, drive: Drive, kind: str) -> None:
    """rosbag2 compresses each file when it is full: that of a dead recorder is not, and there is no metadata."""
    from skidsteer.io.mcap_writer import _pack

    messages = sorted(drive_messages(drive), key=lambda message: message.bag_ns)
    folder = tmp_path / "recording"
    folder.mkdir()
    for part, half in enumerate((messages[:300], messages[300:])):
        (file,) = write_messages(tmp_path / f"b_{part}", kind, half).glob("b_*")
        shutil.move(file, folder)
    first, _ = files = sorted(folder.iterdir())
    first.with_name(first.name + ".zstd").write_bytes(_pack(first.read_bytes(), "zstd"))
    first.unlink()
    assert_same(read_bag(folder, VEHICLE), drive)
    assert len(read_bag(first.with_name(first.name + ".zstd"), VEHICLE).wheels) < len(drive.wheels)
    # A list that names the files as they were before, or as they were meant to be.
    for names in ([file.name for file in files], [f"{file.name}.zstd" for file in files]):
        listed = "".join(f"  - {name}\n" for name in names)
        (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{listed}")
        assert_same(read_bag(folder, VEHICLE), drive)


def test_compressed_messages_whose_list_is_lost(tmp_path: Path, drive: Drive) -> None:
    path = write_bag(drive, tmp_path / "b", "mcap-message")
    (path / "metadata.yaml").unlink()
    got, contents = read_bag_noted(path, VEHICLE)
    assert_same(got, drive)
    assert contents.kind == "MCAP, compressed by message"


def test_database_of_a_killed_recorder(tmp_path: Path, drive: Drive) -> None:
    """With rosbag2's storage preset "resilient", what was recorded last stands in a log beside the file."""
    (whole,) = write_bag(drive, tmp_path / "b", "sqlite3").glob("*.db3")
    left, live = tmp_path / "left", sqlite3.connect(whole)
    try:
        live.execute("PRAGMA journal_mode = WAL")
        live.execute("CREATE TABLE rest AS SELECT * FROM messages WHERE id > 100")
        live.execute("DELETE FROM messages WHERE id > 100")
        live.commit()
        live.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        live.execute("INSERT INTO messages SELECT * FROM rest")
        live.commit()
        left.mkdir()
        for end in ("", "-wal"):
            shutil.copy(f"{whole}{end}", left)
    finally:
        live.close()
    before = {file.name: file.read_bytes() for file in left.iterdir()}
    assert sorted(before) == ["b.db3", "b.db3-wal"]
    got, contents = read_bag_noted(left / "b.db3", VEHICLE)
    assert_same(got, drive)
    assert any("the recorder left b.db3-wal behind; what is in it was read, too" in note for note in contents.notes)
    assert {file.name: file.read_bytes() for file in left.iterdir()} == before
    (left / "b.db3-wal").unlink()
    assert len(read_bag(left / "b.db3", VEHICLE).wheels) < len(drive.wheels)


def test_log_is_left_alone_where_there_is_no_room(
    tmp_path: Path, drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    (whole,) = write_bag(drive, tmp_path / "b", "sqlite3").glob("*.db3")
    whole.with_name("b.db3-wal").write_bytes(b"x")
    monkeypatch.setattr("skidsteer.io.sqlite_source.shutil.disk_usage", lambda _: shutil._ntuple_diskusage(9, 9, 9))
    got, contents = read_bag_noted(whole, VEHICLE)
    assert_same(got, drive)
    assert any("b.db3-wal beside it was not read; there is no room for a copy" in note for note in contents.notes)


def test_transaction_that_was_not_finished_is_taken_back(tmp_path: Path, drive: Drive) -> None:
    """A rollback journal beside the file: without it, half of what was being changed would stand there."""
    (whole,) = write_bag(drive, tmp_path / "b", "sqlite3").glob("*.db3")
    left, live = tmp_path / "left", sqlite3.connect(whole, isolation_level=None)
    try:
        live.execute("PRAGMA journal_mode = DELETE")
        live.execute("PRAGMA cache_size = 1")
        live.execute("BEGIN")
        live.execute("UPDATE messages SET timestamp = timestamp + 7")
        left.mkdir()
        for end in ("", "-journal"):
            shutil.copy(f"{whole}{end}", left)
    finally:
        live.close()
    assert_same(read_bag(left / "b.db3", VEHICLE), drive)
    (left / "b.db3-journal").unlink()
    half = read_bag(left / "b.db3", VEHICLE)
    assert half.command is not None
    assert drive.command is not None
    assert not np.array_equal(half.command.t, drive.command.t)


def torn(whole: Path, path: Path, committed: int) -> Path:
    """A file as it lies on the disk when rosbag2 is killed: no journal, the last transaction written in part."""
    source, live = sqlite3.connect(whole), sqlite3.connect(path.with_suffix(".live"), isolation_level=None)
    try:
        live.execute("PRAGMA journal_mode = MEMORY")
        live.execute("PRAGMA cache_size = 1")
        for (statement,) in source.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall():
            live.execute(statement)
        live.execute("CREATE INDEX IF NOT EXISTS timestamp_idx ON messages (timestamp ASC)")
        live.execute("BEGIN")
        live.executemany("INSERT INTO topics VALUES (?,?,?,?,?,?)", source.execute("SELECT * FROM topics"))
        rows = source.execute("SELECT * FROM messages").fetchall()
        live.executemany("INSERT INTO messages VALUES (?,?,?,?)", rows[:committed])
        live.execute("COMMIT")
        live.execute("BEGIN")
        live.executemany("INSERT INTO messages VALUES (?,?,?,?)", rows[committed:])
        shutil.copy(path.with_suffix(".live"), path)
    finally:
        source.close()
        live.close()
    return path


def test_torn_database_is_read_page_by_page(tmp_path: Path) -> None:
    """All but what had not left the recorder's memory; every number that is found is right."""
    drive = example_drive(20.0)
    (whole,) = write_bag(drive, tmp_path / "b", "sqlite3").glob("*.db3")
    for committed in (400, 1200, 2800):
        path = torn(whole, tmp_path / f"torn{committed}.db3", committed)
        got, contents = read_bag_noted(path, VEHICLE)
        (note,) = (note for note in contents.notes if "its recorder died while it wrote" in note)
        assert int(note.split("; ")[1].split()[0]) > 3000 - committed
        for part in ("wheels", "pose", "gyro"):
            found, expected = getattr(got, part), getattr(drive, part)
            assert len(expected) - 25 < len(found) < len(expected)
            np.testing.assert_array_equal(found.t, expected.t[: len(found)])
            np.testing.assert_allclose(found.values, expected.values[: len(found)], atol=4e-15)


def test_whole_database_is_not_searched(tmp_path: Path, drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    (whole,) = write_bag(drive, tmp_path / "b", "sqlite3").glob("*.db3")
    monkeypatch.setattr("skidsteer.io.sqlite_source.rows_in_pages", lambda _: pytest.fail("searched"))
    assert_same(read_bag(whole, VEHICLE), drive)


@settings(max_examples=30, deadline=None)
@given(
    rows=st.lists(
        st.tuples(
            st.one_of(st.sampled_from([0, 1, 2, -1, 127, 128, 2**15, 2**23, 2**31, 2**40]), st.integers(0, 2**62)),
            st.one_of(st.sampled_from([0, 1, -129, 2**47, 2**63 - 1]), st.integers(-(2**63), 2**63 - 1)),
            st.binary(max_size=300),
        ),
        min_size=1,
        max_size=80,
    ),
    size=st.sampled_from([512, 1024, 4096, 65536]),
    first=st.integers(1, 2**40),
)
def test_pages_hold_the_rows_that_sqlite_wrote(
    rows: list[tuple[int, int, bytes]], size: int, first: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Of any integers and bytes, on pages of any size; not those of other tables, nor what goes on on other pages."""
    path = tmp_path_factory.mktemp("pages") / "a.db3"
    numbered = [(first + index, *row) for index, row in enumerate(rows)]
    connection = sqlite3.connect(path)
    connection.execute(f"PRAGMA page_size = {size}")
    connection.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB)")
    connection.execute("CREATE TABLE others (a INTEGER PRIMARY KEY, b TEXT, c BLOB)")
    connection.executemany("INSERT INTO messages VALUES (?,?,?,?)", numbered)
    connection.execute("INSERT INTO messages VALUES (?,?,?,?)", (first + 2**41, 1, 1, bytes(70_000)))
    connection.execute("INSERT INTO others VALUES (1, 'x', x'00')")
    connection.commit()
    connection.close()
    assert sorted(rows_in_pages(path)) == numbered


@settings(max_examples=200, deadline=None)
@given(st.binary(min_size=512, max_size=512), st.sampled_from([b"\x0d", b""]))
def test_pages_of_anything_do_no_harm(data: bytes, leaf: bytes) -> None:
    page = leaf + data[len(leaf) :]
    assert all(len(row) == 4 and isinstance(row[3], bytes) for row in _rows(page, 512, 0))
