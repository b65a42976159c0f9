"""The records of a rosbag1 file, http://wiki.ros.org/Bags/Format/2.0: parsing them from bytes, and opening chunks."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skidsteer.io.chunked import ChunkHead, DamagedError, MessageTable, unpack_lz4, unpacked
from skidsteer.io.raw import ByteArray, IntArray
from skidsteer.io.stamps import SECOND

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
MAX_HEADER = 1 << 16
_PATTERNS = 64  # ways in which the heads of messages in one chunk may be written
_CONNECTIONS = 8  # connection records that may stand before a message
_U32 = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class Record:
    """A record: its header fields, and where its data lie in what it was read from."""

    fields: dict[str, bytes]
    start: int  # of the record
    data: int
    end: int

    @property
    def op(self) -> int:
        """What the record is, 0 if it does not say."""
        return int.from_bytes(self.fields.get("op", b""), "little")

    def number(self, name: str) -> int:
        """An unsigned integer of the header.

        Raises:
            DamagedError: there is none of that name.
        """
        if name not in self.fields:
            raise DamagedError(f"a record has no field {name}")
        return int.from_bytes(self.fields[name], "little")

    def text(self, name: str) -> str:
        """A text of the header, "" where there is none of that name."""
        return self.fields.get(name, b"").decode(errors="replace")


def parse_header(data: bytes) -> dict[str, tuple[int, int]]:
    """Where the value of each field of a record's header starts and ends."""
    places, position = {}, 0
    while position < len(data):
        if position + 4 > len(data):
            raise DamagedError("a record's header ends early")
        start = position + 4
        position = start + _U32.unpack_from(data, position)[0]
        name, mark, _ = data[start:position].partition(b"=")
        if not mark or position > len(data):
            raise DamagedError("a record's header is not one")
        places[name.decode(errors="replace")] = (start + len(name) + 1, position)
    return places


def fields_of(data: bytes) -> dict[str, bytes]:
    """The fields of a record's header."""
    return {name: data[start:end] for name, (start, end) in parse_header(data).items()}


def read_record(data: bytes, position: int, base: int = 0) -> Record:
    """The record at ``position`` of ``data``, which need not hold its data, only its header and their length.

    ``base`` is added to the places it tells.

    Raises:
        DamagedError: there is no record.
    """
    head = position + 4
    if head > len(data):
        raise DamagedError("a record lies outside the file")
    length = _U32.unpack_from(data, position)[0]
    if length > MAX_HEADER or head + length + 4 > len(data):
        raise DamagedError("a record's header is too long")
    start = head + length + 4
    size = _U32.unpack_from(data, start - 4)[0]
    return Record(fields_of(data[head : head + length]), base + position, base + start, base + start + size)


def parse_records(data: bytes) -> Iterator[Record]:
    """Each whole record in ``data``; a record cut short ends it."""
    position = 0
    while position < len(data):
        try:
            record = read_record(data, position)
        except DamagedError:
            return
        if record.end > len(data):
            return
        yield record
        position = record.end


def parse_message_indexes(data: bytes) -> dict[int, IntArray]:
    """Index records of one chunk: connection -> where its message records start inside the chunk."""
    offsets: dict[int, IntArray] = {}
    for record in parse_records(data):
        if record.op != INDEX:
            break
        entries = np.frombuffer(data, dtype="<u4", count=(record.end - record.data) // 12 * 3, offset=record.data)
        offsets[record.number("conn")] = entries[2::3].astype(np.int64)
    return offsets


def message_starts(data: bytes) -> IntArray:
    """Where the message records start in the unpacked bytes of a chunk, found by walking over them."""
    return np.array([record.start for record in parse_records(data) if record.op == MESSAGE], dtype=np.int64)


def parse_messages(buffer: ByteArray, starts: IntArray) -> MessageTable:
    """Read the heads of the message records that start at ``starts`` (n,) in ``buffer``.

    For the first message of a connection the index of the original recorder points to the connection record before
    it, which is passed over.

    Raises:
        DamagedError: one of them is not a message record, or does not end inside the buffer.
    """
    table = MessageTable(*(np.zeros(len(starts), dtype=np.int64) for _ in range(4)))
    rows, starts = np.arange(len(starts)), starts.copy()
    for _ in range(_CONNECTIONS):
        if not len(rows):
            return table
        rows = _fill_table(table, buffer, rows, starts[rows])
        starts[rows] = table.start[rows] + table.size[rows]
    raise DamagedError("the index of a chunk points to no message")


def _fill_table(table: MessageTable, buffer: ByteArray, rows: IntArray, starts: IntArray) -> IntArray:
    """Parse the records at ``starts`` into these rows; returns the rows that turn out to be connections."""
    if starts.min() < 0 or starts.max() > buffer.size - 8:
        raise DamagedError("a message lies outside its chunk")
    lengths = _u32(np.lib.stride_tricks.sliding_window_view(buffer, 4)[starts])[:, 0]
    if lengths.max() > MAX_HEADER or (starts + lengths + 8 > buffer.size).any():
        raise DamagedError("a message lies outside its chunk")
    connections: list[IntArray] = []
    for length in np.unique(lengths).tolist():
        of_length = lengths == length
        heads = np.lib.stride_tricks.sliding_window_view(buffer, length + 4)[starts[of_length] + 4]
        table.start[rows[of_length]] = starts[of_length] + length + 8
        connections.append(_fill_alike(table, rows[of_length], heads))
    if (table.start[rows] + table.size[rows] > buffer.size).any():
        raise DamagedError("a message ends outside its chunk")
    return np.concatenate(connections)


def _fill_alike(table: MessageTable, rows: IntArray, heads: ByteArray) -> IntArray:
    """Parse heads (n, k) of one length, header and size of the data: those that are written alike all at once."""
    connections = [rows[:0]]
    for _ in range(_PATTERNS):
        if not len(rows):
            return np.concatenate(connections)
        conn, time, op = _places(heads[0, :-4].tobytes())
        fixed = np.ones(heads.shape[1], dtype=bool)
        fixed[slice(*conn)] = fixed[slice(*time)] = fixed[-4:] = False
        same = (heads[:, fixed] == heads[0, fixed]).all(axis=1)
        alike, at = heads[same], rows[same]
        table.size[at] = _u32(alike[:, -4:])[:, 0]
        if alike[0, op] == CONNECTION:
            connections.append(at)
        elif alike[0, op] == MESSAGE and time[1] - time[0] == 8:
            stamp = _u32(alike[:, slice(*time)])
            table.channel[at] = _u32(alike[:, slice(*conn)])[:, 0]
            table.log_ns[at] = stamp[:, 0] * SECOND + stamp[:, 1]
        else:
            raise DamagedError("the index of a chunk points to no message")
        rows, heads = rows[~same], heads[~same]
    raise DamagedError("the messages of a chunk are written in too many ways")


def _places(header: bytes) -> tuple[tuple[int, int], tuple[int, int], int]:
    """Where connection, time and opcode stand in the header of a record; an empty range for a time it has not."""
    places = parse_header(header)
    conn, op = places.get("conn", (0, 0)), places.get("op", (0, 0))
    if conn[1] - conn[0] != 4 or op[1] - op[0] != 1:
        raise DamagedError("the index of a chunk points to no message")
    return conn, places.get("time", (0, 0)), op[0]


def _u32(columns: ByteArray) -> IntArray:
    return np.ascontiguousarray(columns).view("<u4").astype(np.int64)


def unpack_chunk(head: ChunkHead, data: bytes, cut: bool = False) -> bytes:
    """Decompress the records of a chunk, to no more bytes than the chunk declares; see ``mcap_records``."""
    return unpacked(head, data, cut, {"bz2": _unpack_bz2, "lz4": unpack_lz4})


def _unpack_bz2(data: bytes, size: int) -> bytes:
    return bz2.BZ2Decompressor().decompress(data, max_length=size)
