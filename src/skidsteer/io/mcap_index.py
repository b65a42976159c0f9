"""MCAP files: what one holds and where, from the index at its end or by searching a file that has none."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skidsteer.io.chunked import (
    BagIndex,
    ByteFile,
    Channel,
    Chunk,
    ChunkHead,
    DamagedError,
    Format,
    chunk_records,
    count_messages,
    ros2_type,
    with_channel,
)
from skidsteer.io.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    FOOTER_BYTES,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
    ChannelRecord,
    Content,
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
from skidsteer.io.raw import Definition

_MAX_DEFINITION = 16 << 20
_MAX_SUMMARY = 256 << 20
_KINDS = {"ros2msg": "msg", "ros1msg": "msg", "ros2idl": "idl", "omgidl": "idl"}


@dataclass(slots=True)
class _Found:
    """An index in the making: channels name their schemas by number until all are known."""

    index: BagIndex = field(default_factory=BagIndex)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)

    def define(self, op: int, data: bytes) -> None:
        """Take in a schema or channel record; others are ignored."""
        if op == SCHEMA:
            key, schema = parse_schema(data)
            self.schemas[key] = schema
        elif op == CHANNEL:
            number, channel = parse_channel(data)
            self.channels.setdefault(number, channel)

    def complete(self) -> BagIndex:
        for key, channel in self.channels.items():
            schema = self.schemas.get(channel.schema, Schema("", "", ""))
            kind = _KINDS.get(schema.encoding)
            definition = Definition(kind, schema.text) if kind and schema.text else None
            self.index.channels[key] = Channel(channel.topic, ros2_type(schema.name), channel.encoding, definition)
        return self.index


def index_mcap(file: ByteFile) -> BagIndex:
    """Find out what a file holds: by its own index where that is complete and sound, else by going through it."""
    notes = []
    try:
        found = _from_summary(file)
    except DamagedError as error:
        found, notes = None, [f"{file.path.name}: its index is damaged ({error}); the file was searched instead"]
    if found is None:
        found = _from_scan(file)
        _look_into_chunks(file, found)
    found.index.notes[:0] = notes
    return found.complete()


def _chunk_head(file: ByteFile, chunk: Chunk) -> ChunkHead:
    content = chunk.start + RECORD_HEAD.size
    head = parse_chunk_head(content, file.read(content, min(64, chunk.size - RECORD_HEAD.size)))
    if head.start + head.packed > chunk.start + chunk.size and not chunk.cut:
        raise DamagedError("the records of a chunk end outside it")
    return head


MCAP = Format("MCAP", index_mcap, _chunk_head, unpack_chunk, parse_message_indexes, message_starts, parse_messages)


# --- from the index at the end of the file


def _from_summary(file: ByteFile) -> _Found | None:
    tail = file.read(max(file.size - FOOTER_BYTES, 0), FOOTER_BYTES)
    if not (tail.startswith(RECORD_HEAD.pack(FOOTER, 20)) and tail.endswith(MAGIC)):
        return None
    start, end = int.from_bytes(tail[9:17], "little"), file.size - FOOTER_BYTES
    if start == 0:
        return None
    if not len(MAGIC) <= start <= end or end - start > _MAX_SUMMARY:
        raise DamagedError("it lies outside the file")
    found, expected = _parse_summary(file, file.read(start, end - start))
    return found if _is_complete(file, found, expected) else None


def _parse_summary(file: ByteFile, summary: bytes) -> tuple[_Found, int | None]:
    """The index, and the number of chunks it should have where that is stated."""
    found, expected = _Found(), None
    for op, start, end in parse_records(summary):
        content = summary[start:end]
        if op == CHUNK_INDEX:
            found.index.chunks.append(_indexed_chunk(file, content))
        elif op == STATISTICS:
            expected, counts = _parse_statistics(content)
            found.index.counts.update(counts)
        else:
            found.define(op, content)
    return found, expected


def _is_complete(file: ByteFile, found: _Found, expected: int | None) -> bool:
    """False where something is missing from an index; counts are added where there were no statistics."""
    chunks = found.index.chunks
    if not chunks or not found.channels or expected not in (None, len(chunks)):
        return False
    if expected is None:
        if any(chunk.channels is None for chunk in chunks):
            return False
        for chunk in chunks:
            found.index.counts.update(count_messages(file, MCAP, chunk))
    return True


def _indexed_chunk(file: ByteFile, data: bytes) -> Chunk:
    content = Content(data)
    content.take(16)
    start, size = content.number(8), content.number(8)
    offsets, index_size = content.block(), content.number(8)
    if size < RECORD_HEAD.size or start + size + index_size > file.size or _record(file, start)[0] != CHUNK:
        raise DamagedError("it points to no chunk")
    pairs = np.frombuffer(offsets, dtype=np.dtype("<u2, <u8"), count=len(offsets) // 10)
    channels = frozenset(pairs["f0"].tolist()) if index_size else None
    return Chunk(start, size, start + size, index_size, channels)


def _parse_statistics(data: bytes) -> tuple[int, dict[int, int]]:
    """Number of chunks, and of messages by channel."""
    content = Content(data)
    content.take(8 + 2 + 4 + 4 + 4)
    chunks = content.number(4)
    content.take(16)
    counts = np.frombuffer(block := content.block(), dtype=np.dtype("<u2, <u8"), count=len(block) // 10)
    return chunks, dict(zip(counts["f0"].tolist(), counts["f1"].tolist(), strict=True))


# --- by going through the file


def _record(file: ByteFile, position: int) -> tuple[int, int]:
    """Opcode and size of the content of the record at ``position``."""
    data = file.read(position, RECORD_HEAD.size)
    if len(data) < RECORD_HEAD.size:
        raise DamagedError("a record lies outside the file")
    op, size = RECORD_HEAD.unpack(data)
    return int(op), int(size)


def _from_scan(file: ByteFile) -> _Found:
    """Go from record to record, without opening chunks."""
    found, position = _Found(), len(MAGIC)
    index = found.index
    while position + RECORD_HEAD.size <= file.size:
        op, size = _record(file, position)
        if op in (DATA_END, FOOTER):
            return found
        if op == 0 or position + RECORD_HEAD.size + size > file.size:
            break
        _take_record(file, found, op, position, RECORD_HEAD.size + size)
        position += RECORD_HEAD.size + size
    if position + RECORD_HEAD.size < file.size and _record(file, position)[0] == CHUNK:
        index.chunks.append(Chunk(position, file.size - position, 0, 0, None, cut=True))
    index.finished = False
    index.notes.append(f"{file.path.name}: unfinished or cut short, whole as far as byte {position} of {file.size}")
    return found


def _take_record(file: ByteFile, found: _Found, op: int, start: int, size: int) -> None:
    """Take in a record that starts at ``start`` and has ``size`` bytes."""
    index, content = found.index, start + RECORD_HEAD.size
    if op == CHUNK:
        index.chunks.append(Chunk(start, size, start + size, 0, None))
    elif op == MESSAGE_INDEX and index.chunks and start == index.chunks[-1].index_start + index.chunks[-1].index_size:
        channel = int.from_bytes(file.read(content, 2), "little")
        index.chunks[-1] = with_channel(index.chunks[-1], channel, size)
    elif op == MESSAGE:
        index.add_loose(int.from_bytes(file.read(content, 2), "little"), start, start + size)
    elif op in (SCHEMA, CHANNEL) and size <= _MAX_DEFINITION:
        try:
            found.define(op, file.read(content, size - RECORD_HEAD.size))
        except DamagedError as error:
            index.notes.append(f"{file.path.name}: a definition is damaged and was left out ({error})")


def _look_into_chunks(file: ByteFile, found: _Found) -> None:
    """Open the chunks with channels that nothing outside of them describes, and count the messages of all."""
    for chunk in found.index.chunks:
        try:
            if chunk.channels is not None and chunk.channels <= found.channels.keys():
                found.index.counts.update(count_messages(file, MCAP, chunk))
                continue
            data = chunk_records(file, MCAP, chunk)
            for op, start, end in parse_records(data):
                if op in (SCHEMA, CHANNEL):
                    found.define(op, data[start:end])
            found.index.counts.update(count_messages(file, MCAP, chunk, data))
        except DamagedError as error:
            found.index.lost[chunk.start] = str(error)
