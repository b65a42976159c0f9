"""What an MCAP file holds and where: from the index at its end, or by searching a file that has none."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from skidsteer.errors import DataError
from skidsteer.io.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    FOOTER_BYTES,
    MAGIC,
    MAX_CHUNK,
    MESSAGE,
    MESSAGE_INDEX,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
    Channel,
    ChunkHead,
    Content,
    DamagedError,
    Schema,
    message_starts,
    parse_channel,
    parse_chunk_head,
    parse_message_indexes,
    parse_messages,
    parse_records,
    parse_schema,
    unpack_chunk,
)

_MAX_DEFINITION = 16 << 20
_MAX_SUMMARY = 256 << 20


@dataclass(frozen=True, slots=True)
class Chunk:
    """Where a chunk lies. ``channels`` are those that have messages in it, None where only opening it would tell."""

    start: int  # of its content
    size: int
    index_start: int
    index_size: int
    channels: frozenset[int] | None
    cut: bool = False  # the file ends inside it


@dataclass(slots=True)
class McapIndex:
    """What an MCAP file holds and where."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    loose: dict[int, array[int]] = field(default_factory=dict)  # channel -> start, end of records outside of chunks
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel
    finished: bool = True
    notes: list[str] = field(default_factory=list)

    def define(self, op: int, data: bytes) -> None:
        """Take in a schema or channel record; others are ignored."""
        if op == SCHEMA:
            key, schema = parse_schema(data)
            self.schemas[key] = schema
        elif op == CHANNEL:
            number, channel = parse_channel(data)
            self.channels.setdefault(number, channel)


class McapFile:
    """The bytes of an open MCAP file; never reads more than the file has."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = path.stat().st_size
        self._file = path.open("rb")
        if self.read(0, len(MAGIC)) != MAGIC:
            self.close()
            raise DataError(f"{path}: is not an MCAP file (it does not begin like one)")

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def read(self, start: int, size: int) -> bytes:
        """The bytes of a range, fewer where the file ends inside it."""
        if start >= self.size:
            return b""
        self._file.seek(start)
        return self._file.read(min(size, self.size - start))

    def record(self, position: int) -> tuple[int, int]:
        """Opcode and size of the content of the record at ``position``."""
        data = self.read(position, RECORD_HEAD.size)
        if len(data) < RECORD_HEAD.size:
            raise DamagedError("a record lies outside the file")
        op, size = RECORD_HEAD.unpack(data)
        return int(op), int(size)

    def chunk_head(self, chunk: Chunk) -> ChunkHead:
        """What precedes the records of a chunk."""
        head = parse_chunk_head(self.read(chunk.start, min(64, chunk.size)))
        if head.head + head.packed > chunk.size and not chunk.cut:
            raise DamagedError("the records of a chunk end outside it")
        return head

    def chunk_records(self, chunk: Chunk) -> bytes:
        """The records of a chunk, unpacked.

        Raises:
            DamagedError: they cannot be had.
        """
        head = self.chunk_head(chunk)
        if head.packed > MAX_CHUNK:
            raise DamagedError(f"a chunk claims {head.packed} bytes; more than {MAX_CHUNK} are not read")
        return unpack_chunk(head, self.read(chunk.start + head.head, head.packed), chunk.cut)


def index_file(file: McapFile) -> McapIndex:
    """Find out what a file holds: by its own index where that is complete and sound, else by going through it."""
    notes = []
    try:
        index = _from_summary(file)
    except DamagedError as error:
        index, notes = None, [f"{file.path.name}: its index is damaged ({error}); the file was searched instead"]
    if index is None:
        index = _from_scan(file)
        _look_into_chunks(file, index)
    index.notes[:0] = notes
    return index


# --- from the index at the end of the file


def _from_summary(file: McapFile) -> McapIndex | None:
    tail = file.read(max(file.size - FOOTER_BYTES, 0), FOOTER_BYTES)
    if not (tail.startswith(RECORD_HEAD.pack(FOOTER, 20)) and tail.endswith(MAGIC)):
        return None
    start, end = int.from_bytes(tail[9:17], "little"), file.size - FOOTER_BYTES
    if start == 0:
        return None
    if not len(MAGIC) <= start <= end or end - start > _MAX_SUMMARY:
        raise DamagedError("it lies outside the file")
    return _complete(file, _parse_summary(file, file.read(start, end - start)))


def _parse_summary(file: McapFile, summary: bytes) -> tuple[McapIndex, int | None]:
    """The index, and the number of chunks it should have where that is stated."""
    index, expected = McapIndex(), None
    for op, start, end in parse_records(summary):
        content = summary[start:end]
        if op == CHUNK_INDEX:
            index.chunks.append(_indexed_chunk(file, content))
        elif op == STATISTICS:
            expected, counts = _parse_statistics(content)
            index.counts.update(counts)
        else:
            index.define(op, content)
    return index, expected


def _complete(file: McapFile, found: tuple[McapIndex, int | None]) -> McapIndex | None:
    """The index if nothing is missing from it; counts are added where there were no statistics."""
    index, expected = found
    if not index.chunks or not index.channels or expected not in (None, len(index.chunks)):
        return None
    if expected is None:
        for chunk in index.chunks:
            if chunk.channels is None:
                return None
            starts = parse_message_indexes(file.read(chunk.index_start, chunk.index_size))
            index.counts.update({key: len(offsets) for key, offsets in starts.items()})
    return index


def _indexed_chunk(file: McapFile, data: bytes) -> Chunk:
    content = Content(data)
    content.take(16)
    start, size = content.number(8), content.number(8)
    offsets, index_size = content.block(), content.number(8)
    if size < RECORD_HEAD.size or start + size + index_size > file.size or file.record(start)[0] != CHUNK:
        raise DamagedError("it points to no chunk")
    pairs = np.frombuffer(offsets, dtype=np.dtype("<u2, <u8"), count=len(offsets) // 10)
    channels = frozenset(pairs["f0"].tolist()) if index_size else None
    return Chunk(start + RECORD_HEAD.size, size - RECORD_HEAD.size, start + size, index_size, channels)


def _parse_statistics(data: bytes) -> tuple[int, dict[int, int]]:
    """Number of chunks, and of messages by channel."""
    content = Content(data)
    content.take(8 + 2 + 4 + 4 + 4)
    chunks = content.number(4)
    content.take(16)
    counts = np.frombuffer(block := content.block(), dtype=np.dtype("<u2, <u8"), count=len(block) // 10)
    return chunks, dict(zip(counts["f0"].tolist(), counts["f1"].tolist(), strict=True))


# --- by going through the file


def _from_scan(file: McapFile) -> McapIndex:
    """Go from record to record, without opening chunks."""
    index, position = McapIndex(), len(MAGIC)
    while position + RECORD_HEAD.size <= file.size:
        op, size = file.record(position)
        start = position + RECORD_HEAD.size
        if op in (DATA_END, FOOTER):
            return index
        if op == 0 or start + size > file.size:
            break
        _take_record(file, index, op, start, size)
        position = start + size
    if position + RECORD_HEAD.size < file.size and file.record(position)[0] == CHUNK:
        start = position + RECORD_HEAD.size
        index.chunks.append(Chunk(start, file.size - start, 0, 0, None, cut=True))
    index.finished = False
    index.notes.append(
        f"{file.path.name}: unfinished or cut short; whole records end at byte {position} of {file.size}"
    )
    return index


def _take_record(file: McapFile, index: McapIndex, op: int, start: int, size: int) -> None:
    if op == CHUNK:
        index.chunks.append(Chunk(start, size, start + size, 0, None))
    elif op == MESSAGE_INDEX and index.chunks:
        index.chunks[-1] = _with_index(file, index.chunks[-1], start, size)
    elif op == MESSAGE and size >= 22:
        channel = int.from_bytes(file.read(start, 2), "little")
        index.loose.setdefault(channel, array("q")).extend((start - RECORD_HEAD.size, start + size))
        index.counts[channel] += 1
    elif op in (SCHEMA, CHANNEL) and size <= _MAX_DEFINITION:
        try:
            index.define(op, file.read(start, size))
        except DamagedError as error:
            index.notes.append(f"{file.path.name}: a definition is damaged and was left out ({error})")


def _with_index(file: McapFile, chunk: Chunk, start: int, size: int) -> Chunk:
    """The chunk with one more message index record, which must follow the last one."""
    if start - RECORD_HEAD.size != chunk.index_start + chunk.index_size or size < 6:
        return chunk
    channel = int.from_bytes(file.read(start, 2), "little")
    known = (chunk.channels or frozenset()) | {channel}
    return replace(chunk, index_size=chunk.index_size + RECORD_HEAD.size + size, channels=known)


def _look_into_chunks(file: McapFile, index: McapIndex) -> None:
    """Open the chunks with channels that nothing outside of them describes, and count the messages of all."""
    for chunk in index.chunks:
        try:
            if chunk.channels is not None and chunk.channels <= index.channels.keys():
                starts = parse_message_indexes(file.read(chunk.index_start, chunk.index_size))
                index.counts.update({key: len(offsets) for key, offsets in starts.items()})
                continue
            data = file.chunk_records(chunk)
            for op, start, end in parse_records(data):
                if op in (SCHEMA, CHANNEL):
                    index.define(op, data[start:end])
            messages = parse_messages(np.frombuffer(data, dtype=np.uint8), message_starts(data))
            keys, numbers = np.unique(messages.channel, return_counts=True)
            index.counts.update(dict(zip(keys.tolist(), numbers.tolist(), strict=True)))
        except DamagedError:
            continue  # reported when its messages are read
