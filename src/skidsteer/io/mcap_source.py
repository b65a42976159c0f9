"""MCAP files as a source of messages, whole or unfinished.

Read here rather than through ``rosbags`` for three reasons: a file whose recorder died has no footer and is refused
there; what a damaged or malicious file claims about its sizes must not decide how much memory is taken; and with
images in the same chunks, only the bytes of the wanted messages should be read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from skidsteer.io.mcap_index import Chunk, McapFile, McapIndex, index_file
from skidsteer.io.mcap_records import (
    ChunkHead,
    DamagedError,
    MessageTable,
    Schema,
    message_starts,
    parse_message_indexes,
    parse_messages,
)
from skidsteer.io.raw import BATCH_BYTES, BagTopic, ByteArray, Definition, IntArray, RawMessages, shown

_NEAR = 32 << 10  # messages closer than this are read together, with what lies between them
_MAX_MESSAGE = 64 << 20
_KINDS = {"ros2msg": "msg", "ros1msg": "msg", "ros2idl": "idl", "omgidl": "idl"}


class McapSource:
    """One MCAP file, opened. See ``raw.Source``."""

    def __init__(self, path: Path) -> None:
        self._file = McapFile(path)
        try:
            self._index = index_file(self._file)
        except BaseException:
            self.close()
            raise
        self.kind = "MCAP" if self._index.finished else "MCAP, unfinished"
        self.notes = list(self._index.notes)
        self._topics = {key: _topic(self._index, key) for key in sorted(self._index.channels)}
        self.topics = tuple(self._topics.values())
        self._lost: dict[int, str] = {}  # start of a chunk -> why it cannot be read

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def read(self, topics: Sequence[BagTopic], limit: int | None = None) -> Iterator[tuple[BagTopic, RawMessages]]:
        """Messages of these topics, in the order of the file. See ``raw.Source``."""
        wanted = {key: topic for key, topic in self._topics.items() if topic in topics}
        left = dict.fromkeys(wanted, self._file.size if limit is None else limit)
        for key, piece in self._pieces(left):
            left[key] -= len(piece)
            yield wanted[key], piece
        self._report_lost()

    def _pieces(self, left: dict[int, int]) -> Iterator[tuple[int, RawMessages]]:
        for key in left:
            yield from self._loose_messages(key, left[key])
        for chunk in self._index.chunks:
            keys = [key for key, number in left.items() if number > 0]
            if not keys:
                return
            if chunk.channels is None or not chunk.channels.isdisjoint(keys):
                yield from self._chunk_messages(chunk, keys)

    def _loose_messages(self, key: int, limit: int) -> Iterator[tuple[int, RawMessages]]:
        spans = np.array(self._index.loose.get(key, ()), dtype=np.int64).reshape(-1, 2)[:limit]
        for buffer, table in self._picked(spans[:, 0], spans[:, 1]):
            yield key, RawMessages(table.log_ns, buffer, table.start, table.size)

    def _chunk_messages(self, chunk: Chunk, keys: Sequence[int]) -> Iterator[tuple[int, RawMessages]]:
        try:
            for buffer, table in self._opened(chunk, keys):
                for key in keys:
                    of_key = table.channel == key
                    if of_key.any():
                        parts = (table.start[of_key], table.size[of_key])
                        yield key, RawMessages(table.log_ns[of_key], buffer, *parts)
        except DamagedError as error:
            self._lost[chunk.start] = str(error)

    def _opened(self, chunk: Chunk, keys: Sequence[int]) -> Iterator[tuple[ByteArray, MessageTable]]:
        """The messages of these channels in one chunk, and maybe others."""
        head = self._file.chunk_head(chunk)
        indexes = self._message_indexes(chunk)
        if indexes is not None and head.compression == "" and not chunk.cut:
            yield from self._picked(*_record_spans(chunk, head, indexes, keys))
            return
        data = self._file.chunk_records(chunk)
        buffer = np.frombuffer(data, dtype=np.uint8)
        if indexes is not None:
            yield buffer, parse_messages(buffer, np.concatenate([indexes[key] for key in keys if key in indexes]))
        else:
            yield buffer, parse_messages(buffer, message_starts(data))

    def _message_indexes(self, chunk: Chunk) -> dict[int, IntArray] | None:
        if not chunk.index_size:
            return None
        return parse_message_indexes(self._file.read(chunk.index_start, chunk.index_size))

    def _picked(self, starts: IntArray, ends: IntArray) -> Iterator[tuple[ByteArray, MessageTable]]:
        """Read message records (n,) from where they lie in the file, skipping what lies between if it is much."""
        if (ends - starts > _MAX_MESSAGE).any():
            raise DamagedError(f"a message has more than {_MAX_MESSAGE} bytes")
        if not len(starts):
            return
        cost = np.cumsum(ends - starts + np.minimum(np.diff(starts, append=starts[-1]), _NEAR))
        for group in np.split(np.arange(len(starts)), np.flatnonzero(np.diff(cost // BATCH_BYTES)) + 1):
            data, where = self._read_spans(starts[group], ends[group])
            buffer = np.frombuffer(data, dtype=np.uint8)
            yield buffer, parse_messages(buffer, where)

    def _read_spans(self, starts: IntArray, ends: IntArray) -> tuple[bytes, IntArray]:
        """Spans of the file (n,), sorted: the bytes read, and where each span begins in them."""
        first = np.flatnonzero(np.concatenate([[True], starts[1:] - ends[:-1] > _NEAR]))
        last = np.append(first[1:], len(starts)) - 1
        runs = [
            self._file.read(start, end - start)
            for start, end in zip(starts[first].tolist(), ends[last].tolist(), strict=True)
        ]
        lengths = np.array([len(run) for run in runs], dtype=np.int64)
        shift = np.cumsum(lengths) - lengths - starts[first]
        return b"".join(runs), starts + np.repeat(shift, last - first + 1)

    def _report_lost(self) -> None:
        if self._lost:
            number = f"{len(self._lost)} of {len(self._index.chunks)} chunks"
            reason = shown(next(iter(self._lost.values())))
            self.notes.append(f"{self._file.path.name}: {number} cannot be read and were left out ({reason})")
            self._lost.clear()


def _record_spans(
    chunk: Chunk, head: ChunkHead, indexes: dict[int, IntArray], keys: Sequence[int]
) -> tuple[IntArray, IntArray]:
    """Where in the file the message records of these channels start, and where they end at the latest."""
    every = np.unique(np.concatenate(list(indexes.values())))
    wanted = np.unique(np.concatenate([indexes[key] for key in keys if key in indexes] or [every[:0]]))
    if len(every) and (every[0] < 0 or every[-1] >= head.packed):
        raise DamagedError("the index of a chunk points outside of it")
    ends = np.append(every, head.packed)[np.searchsorted(every, wanted, side="right")]
    base = chunk.start + head.head
    return base + wanted, base + ends


def _topic(index: McapIndex, key: int) -> BagTopic:
    channel = index.channels[key]
    schema = index.schemas.get(channel.schema, Schema("", "", ""))
    kind = _KINDS.get(schema.encoding)
    definition = Definition(kind, schema.text) if kind and schema.text else None
    return BagTopic(channel.topic, _ros2_type(schema.name), index.counts[key], channel.encoding, definition)


def _ros2_type(name: str) -> str:
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name
