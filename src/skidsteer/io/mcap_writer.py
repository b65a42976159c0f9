"""Drives to MCAP, to be opened in Foxglove, by rosbag2, or by ``bag.read_bag``."""

from __future__ import annotations

import os
import sys
from binascii import crc32
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO
from uuid import uuid4

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError
from skidsteer.io.drive_messages import Encoded, encode_drive
from skidsteer.io.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
)

_CHUNK_BYTES = 1 << 20


def write_mcap(
    path: str | os.PathLike[str], drive: Drive, odometry: Series | None = None, compression: str = "zstd"
) -> None:
    """Write a drive as MCAP in one step, with the odometry of the calibrated model beside its reference.

    The wheels become JointState, reference and odometry nav_msgs/Odometry; a static transform lays the start of the
    odometry onto the reference. Times are whole nanoseconds; if there are negative ones, all are shifted by whole
    seconds. Segments and their labels have no place in a bag and are not written.

    Args:
        path: the file, usually named ``.mcap``.
        drive: with any of its parts.
        odometry: poses (m, 3) x [m], y [m], yaw [rad] of the base.
        compression: of the chunks: "zstd", "lz4" or "" for none.

    Raises:
        ValueError: no such compression.
        DataError: the file cannot be written.
        RequestError: the packages for bags are not installed.
    """
    if compression not in ("zstd", "lz4", ""):
        raise ValueError(f"compression must be zstd, lz4 or empty, got {compression!r}")
    channels = encode_drive(drive, odometry)
    with _replacing(Path(path)) as file:
        write_messages(file, channels, compression)


@contextmanager
def _replacing(path: Path) -> Iterator[IO[bytes]]:
    """A file that takes the place of ``path`` when it is complete."""
    target = Path(os.path.realpath(path))
    temporary = target.parent / f".skidsteer-{uuid4().hex}.tmp"
    try:
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def write_messages(file: IO[bytes], channels: Sequence[Encoded], compression: str) -> None:
    """Write all messages of all channels, in order of time, as an MCAP file with chunks and an index."""
    writer = _Writer(file, compression)
    types = sorted({channel.type for channel in channels})
    schemas = {name: index for index, name in enumerate(types, start=1)}
    texts = {channel.type: channel.definition for channel in channels}
    for name, key in schemas.items():
        writer.define(SCHEMA, _number(key, 2) + _text(name) + _text("ros2msg") + _text(texts[name]))
    for key, channel in enumerate(channels, start=1):
        content = _number(key, 2) + _number(schemas[channel.type], 2) + _text(channel.topic) + _text("cdr")
        writer.define(CHANNEL, content + _block(b""))
    times = np.concatenate([channel.ns for channel in channels])
    keys = np.repeat(np.arange(len(channels)), [len(channel.ns) for channel in channels])
    rows = np.concatenate([np.arange(len(channel.ns)) for channel in channels])
    order = np.argsort(times, kind="stable")
    for ns, key, row in zip(times[order].tolist(), keys[order].tolist(), rows[order].tolist(), strict=True):
        writer.message(key + 1, row, ns, channels[key].matrix[row].tobytes())
    writer.finish()


@dataclass(slots=True)
class _Pending:
    """A chunk that is being filled."""

    data: bytearray = field(default_factory=bytearray)
    first: int = 0
    last: int = 0
    index: dict[int, list[int]] = field(default_factory=dict)  # channel -> time, offset, time, offset, ...


class _Writer:
    """Writes the records of one file in the order the format asks for."""

    def __init__(self, file: IO[bytes], compression: str) -> None:
        self.file = file
        self.compression = compression
        self.position = 0
        self.definitions: list[tuple[int, bytes]] = []
        self.chunk = _Pending()
        self.chunk_indexes: list[bytes] = []
        self.counts: dict[int, int] = {}
        self.span = (0, 0)
        self._write(MAGIC)
        self._record(HEADER, _text("ros2") + _text("skidsteer"))

    def define(self, op: int, content: bytes) -> None:
        """A schema or channel: into the first chunk, and again into the summary."""
        self.definitions.append((op, content))
        self.chunk.data += RECORD_HEAD.pack(op, len(content)) + content

    def message(self, channel: int, sequence: int, ns: int, data: bytes) -> None:
        chunk = self.chunk
        if not chunk.index:
            chunk.first = ns
        chunk.last = ns
        chunk.index.setdefault(channel, []).extend((ns, len(chunk.data)))
        head = _number(channel, 2) + _number(sequence, 4) + 2 * _number(ns, 8)
        chunk.data += RECORD_HEAD.pack(MESSAGE, len(head) + len(data)) + head + data
        if not self.counts:
            self.span = (ns, ns)
        self.counts[channel] = self.counts.get(channel, 0) + 1
        self.span = (self.span[0], ns)
        if len(chunk.data) >= _CHUNK_BYTES:
            self._close_chunk()

    def finish(self) -> None:
        if self.chunk.data:
            self._close_chunk()
        self._record(DATA_END, _number(0, 4))
        start = self.position
        for op, content in self.definitions:
            self._record(op, content)
        self._record(STATISTICS, self._statistics())
        for content in self.chunk_indexes:
            self._record(CHUNK_INDEX, content)
        self._record(FOOTER, _number(start, 8) + _number(0, 8) + _number(0, 4))
        self._write(MAGIC)

    def _close_chunk(self) -> None:
        chunk, self.chunk = self.chunk, _Pending()
        data = bytes(chunk.data)
        packed = _pack(data, self.compression)
        span = _number(chunk.first, 8) + _number(chunk.last, 8)
        start = self.position
        content = span + _number(len(data), 8) + _number(crc32(data), 4) + _text(self.compression)
        self._record(CHUNK, content + _number(len(packed), 8) + packed)
        end = self.position
        offsets = b""
        for channel, entries in chunk.index.items():
            offsets += _number(channel, 2) + _number(self.position, 8)
            self._record(MESSAGE_INDEX, _number(channel, 2) + _block(np.array(entries, dtype="<u8").tobytes()))
        where = _number(start, 8) + _number(end - start, 8) + _block(offsets) + _number(self.position - end, 8)
        sizes = _text(self.compression) + _number(len(packed), 8) + _number(len(data), 8)
        self.chunk_indexes.append(span + where + sizes)

    def _statistics(self) -> bytes:
        schemas = sum(op == SCHEMA for op, _ in self.definitions)
        numbers = _number(sum(self.counts.values()), 8) + _number(schemas, 2)
        numbers += _number(len(self.definitions) - schemas, 4) + 2 * _number(0, 4) + _number(len(self.chunk_indexes), 4)
        counts = b"".join(_number(channel, 2) + _number(count, 8) for channel, count in sorted(self.counts.items()))
        return numbers + _number(self.span[0], 8) + _number(self.span[1], 8) + _block(counts)

    def _record(self, op: int, content: bytes) -> None:
        self._write(RECORD_HEAD.pack(op, len(content)) + content)

    def _write(self, data: bytes) -> None:
        self.file.write(data)
        self.position += len(data)


def _number(value: int, size: int) -> bytes:
    return value.to_bytes(size, "little")


def _block(data: bytes) -> bytes:
    return _number(len(data), 4) + data


def _text(text: str) -> bytes:
    return _block(text.encode())


def _pack(data: bytes, compression: str) -> bytes:
    if compression == "lz4":
        from lz4.frame import compress  # type: ignore[import-untyped]

        return bytes(compress(data))
    if compression == "zstd":
        if sys.version_info >= (3, 14):
            from compression import zstd
        else:
            from backports import zstd
        return zstd.compress(data)
    return data
