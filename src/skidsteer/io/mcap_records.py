"""The records of an MCAP file, https://mcap.dev/spec: parsing them from bytes, and opening chunks."""

from __future__ import annotations

import struct
import sys
from binascii import crc32
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skidsteer.io.chunked import ChunkHead, DamagedError, MessageTable, unpack_lz4, unpacked
from skidsteer.io.raw import ByteArray, IntArray

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
METADATA, STATISTICS, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = 0x0C, 0x0B, 0x0D, 0x0E, 0x0F

RECORD_HEAD = struct.Struct("<BQ")  # opcode, size of the content
MESSAGE_HEAD = RECORD_HEAD.size + 22  # channel, sequence, two times
FOOTER_BYTES = RECORD_HEAD.size + 20 + len(MAGIC)


@dataclass(frozen=True, slots=True)
class Schema:
    """Name and definition of a message type."""

    name: str
    encoding: str
    text: str


@dataclass(frozen=True, slots=True)
class ChannelRecord:
    """A topic, the schema of its messages, and how they are encoded."""

    topic: str
    schema: int
    encoding: str


class Content:
    """A cursor over the content of one record."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.position = 0

    def take(self, size: int) -> bytes:
        """The next ``size`` bytes."""
        part = self.data[self.position : self.position + size]
        if len(part) < size:
            raise DamagedError("a record ends early")
        self.position += size
        return part

    def number(self, size: int) -> int:
        """An unsigned little-endian integer of ``size`` bytes."""
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        """A length-prefixed UTF-8 string."""
        return self.take(self.number(4)).decode(errors="replace")

    def block(self) -> bytes:
        """A length-prefixed run of bytes."""
        return self.take(self.number(4))


def parse_schema(data: bytes) -> tuple[int, Schema]:
    """Schema record: its id and what it says."""
    content = Content(data)
    return content.number(2), Schema(content.text(), content.text(), content.text())


def parse_channel(data: bytes) -> tuple[int, ChannelRecord]:
    """Channel record: its id and what it says."""
    content = Content(data)
    key, schema = content.number(2), content.number(2)
    return key, ChannelRecord(content.text(), schema, content.text())


def parse_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of the content of each whole record in ``data``; a record cut short ends it."""
    position, end = 0, len(data)
    while position + RECORD_HEAD.size <= end:
        op, size = RECORD_HEAD.unpack_from(data, position)
        start = position + RECORD_HEAD.size
        if start + size > end:
            return
        yield op, start, start + size
        position = start + size


def parse_message_indexes(data: bytes) -> dict[int, IntArray]:
    """Message index records of one chunk: channel -> where its message records start inside the chunk."""
    offsets: dict[int, IntArray] = {}
    for op, start, end in parse_records(data):
        if op != MESSAGE_INDEX or end - start < 6 or (end - start - 6) % 16:
            raise DamagedError("the index of a chunk is not one")
        entries = np.frombuffer(data, dtype="<i8", count=(end - start - 6) // 8, offset=start + 6)
        offsets[int.from_bytes(data[start : start + 2], "little")] = entries[1::2].astype(np.int64)
    return offsets


def message_starts(data: bytes) -> IntArray:
    """Where the message records start in the unpacked bytes of a chunk, found by walking over them."""
    starts = [start - RECORD_HEAD.size for op, start, _ in parse_records(data) if op == MESSAGE]
    return np.array(starts, dtype=np.int64)


def parse_messages(buffer: ByteArray, starts: IntArray) -> MessageTable:
    """Read the heads of the message records that start at ``starts`` (n,) in ``buffer``.

    Raises:
        DamagedError: one of them is not a message record, or does not end inside the buffer.
    """
    if not len(starts):
        empty = np.zeros(0, dtype=np.int64)
        return MessageTable(empty, empty, empty, empty)
    if starts.min() < 0 or starts.max() > buffer.size - MESSAGE_HEAD:
        raise DamagedError("a message lies outside its chunk")
    heads = np.lib.stride_tricks.sliding_window_view(buffer, MESSAGE_HEAD)[starts]
    size = np.ascontiguousarray(heads[:, 1:9]).view("<u8")[:, 0]
    start = starts + MESSAGE_HEAD
    room = (buffer.size - start + 22).astype(np.uint64)
    if (heads[:, 0] != MESSAGE).any() or (size < 22).any() or (size > room).any():
        raise DamagedError("the index of a chunk points to no message")
    channel = np.ascontiguousarray(heads[:, 9:11]).view("<u2")[:, 0].astype(np.int64)
    log_ns = np.ascontiguousarray(heads[:, 15:23]).view("<i8")[:, 0].astype(np.int64)
    return MessageTable(channel, log_ns, start, size.astype(np.int64) - 22)


def parse_chunk_head(start: int, data: bytes) -> ChunkHead:
    """The head of a chunk whose content starts at byte ``start`` of the file, from its first bytes (64 are enough)."""
    content = Content(data)
    content.take(16)
    size, crc = content.number(8), content.number(4)
    compression = content.text()
    packed = content.number(8)
    return ChunkHead(start + content.position, packed, size, compression, crc)


def unpack_chunk(head: ChunkHead, data: bytes, cut: bool = False) -> bytes:
    """Decompress the records of a chunk, to no more bytes than the chunk declares.

    Args:
        head: what the chunk says of itself.
        data: its records as they stand in the file.
        cut: the file ends inside the chunk: return what can be had.

    Raises:
        DamagedError: unknown compression, data that cannot be unpacked or fail their checksum.
    """
    raw = unpacked(head, data, cut, {"lz4": unpack_lz4, "zstd": _unpack_zstd})
    if head.crc and not cut and crc32(raw) != head.crc:
        raise DamagedError("a chunk fails its checksum")
    return raw


def _unpack_zstd(data: bytes, size: int) -> bytes:
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd

    return zstd.ZstdDecompressor().decompress(data, max_length=size)
