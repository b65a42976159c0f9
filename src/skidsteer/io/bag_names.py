"""What the names of files promise: the kind of a bag, whether it is finished, whether it is compressed as a whole."""

from __future__ import annotations

from pathlib import Path

from skidsteer.errors import DataError

KINDS = {".mcap": "MCAP", ".db3": "rosbag2 sqlite3", ".bag": "rosbag1"}
PACKED = ".zstd"
# rosbag leaves the second behind when it dies, and rosbag2 the last two where it was told to compress files.
_ENDINGS = {**{kind: kind for kind in KINDS}, ".bag.active": ".bag", ".mcap.zstd": ".mcap", ".db3.zstd": ".db3"}
_MAGIC = {".mcap": b"\x89MCAP0\r\n", ".db3": b"SQLite format 3\0", ".bag": b"#ROSBAG V2.0\n"}
_OLD_MAGIC = b"#ROSBAG V1"


def kind_of(path: Path) -> str:
    """The kind of bag that a file is by its name, one of ``KINDS``; "" for none."""
    return _ENDINGS.get(_ending(path), "")


def name_of(path: Path) -> str:
    """The name of a recording: that of its folder, or of its file without what tells the kind."""
    return path.name if path.is_dir() else path.name[: len(path.name) - len(_ending(path))]


def _ending(path: Path) -> str:
    name = path.name.lower()
    return max((ending for ending in _ENDINGS if name.endswith(ending)), key=len, default="")


def is_packed(path: Path) -> bool:
    """Whether a file is compressed as a whole, by its name."""
    return path.name.lower().endswith(PACKED)


def refuse_other_files(path: Path) -> None:
    """Say what a file is when it is not the bag that its name promises.

    Raises:
        DataError: it is something else, or empty.
    """
    kind = kind_of(path)
    if not kind:
        raise DataError(f"{path}: is no bag; bags are named {', '.join(sorted(KINDS))}, or are a rosbag2 folder")
    if not path.is_file():
        raise DataError(f"{path}: is a folder, a device or a pipe, not a file")
    with path.open("rb") as file:
        start = file.read(512)
    if not start:
        raise DataError(f"{path}: has 0 bytes; nothing was recorded, or the copy failed")
    if not is_packed(path) and not start.startswith(_MAGIC[kind]):
        raise DataError(f"{path}: {_what_it_is(path, kind, start)}")


def _what_it_is(path: Path, kind: str, start: bytes) -> str:
    for other, magic in _MAGIC.items():
        if start.startswith(magic):
            return f"is a {KINDS[other]} file; rename it to {name_of(path)}{other}"
    if start.startswith(_OLD_MAGIC):
        return "is a rosbag1 file of before 2010; bring it up to date with `rosbag fix` of ROS 1"
    text = all(byte >= 32 or byte in b"\t\r\n" for byte in start)
    what = "a text file" if text else "something else, or its beginning is damaged"
    return f"is not a {KINDS[kind]} file but {what}"
