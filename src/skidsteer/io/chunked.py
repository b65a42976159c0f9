"""Bags that are files of chunks (MCAP, rosbag1): reading the wanted messages, and little else, out of the chunks.

Read here rather than through ``rosbags`` for three reasons: a file whose recorder died has no index and is refused
there; what a damaged or malicious file claims about its sizes must not decide how much memory is taken; and with
images in the same chunks, only the bytes of the wanted messages should be read, many messages at a time.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from skidsteer.io.raw import BATCH_BYTES, BagTopic, ByteArray, Definition, IntArray, RawMessages, shown

# A chunk larger than this once unpacked is refused: recorders write chunks of one to a few megabytes.
MAX_CHUNK = 256 << 20
_MAX_MESSAGE = 64 << 20
_NEAR = 32 << 10  # messages closer than this are read together, with what lies between them


class DamagedError(ValueError):
    """Bytes that are not what the format asks for."""


class ByteFile:
    """The bytes of an open file; never reads more than the file has."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = path.stat().st_size
        self._file = path.open("rb")

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def read(self, start: int, size: int) -> bytes:
        """The bytes of a range, fewer where the file ends inside it."""
        if start >= self.size:
            return b""
        self._file.seek(start)
        return self._file.read(min(size, self.size - start))


@dataclass(frozen=True, slots=True)
class Chunk:
    """Where a chunk record lies. ``channels`` have messages in it; None where only opening it would tell."""

    start: int
    size: int
    index_start: int
    index_size: int
    channels: frozenset[int] | None
    cut: bool = False  # the file ends inside it


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """What a chunk says of itself: its records begin at byte ``start`` of the file and take ``packed`` bytes there."""

    start: int
    packed: int
    unpacked: int
    compression: str  # "" for none
    crc: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class MessageTable:
    """Heads of message records: (n,) each."""

    channel: IntArray
    log_ns: IntArray
    start: IntArray  # of the serialised message
    size: IntArray


@dataclass(frozen=True, slots=True)
class Channel:
    """A stream of messages of one type, by one publisher or several."""

    topic: str
    type: str
    encoding: str
    definition: Definition | None


@dataclass(slots=True)
class BagIndex:
    """What a file holds and where."""

    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    loose: dict[int, array[int]] = field(default_factory=dict)  # channel -> start, end of records outside of chunks
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel
    finished: bool = True
    notes: list[str] = field(default_factory=list)
    lost: dict[int, str] = field(default_factory=dict)  # start of a chunk -> why it cannot be read

    def add_loose(self, channel: int, start: int, end: int) -> None:
        """Take in a message record that lies in no chunk."""
        self.loose.setdefault(channel, array("q")).extend((start, end))
        self.counts[channel] += 1


@dataclass(frozen=True, slots=True)
class Format:
    """What sets one format apart from another. All functions raise ``DamagedError``."""

    name: str
    index: Callable[[ByteFile], BagIndex]
    chunk_head: Callable[[ByteFile, Chunk], ChunkHead]
    unpack: Callable[[ChunkHead, bytes, bool], bytes]
    message_indexes: Callable[[bytes], dict[int, IntArray]]  # channel -> offsets of its records in the chunk
    message_starts: Callable[[bytes], IntArray]  # of the records in an unpacked chunk
    parse_messages: Callable[[ByteArray, IntArray], MessageTable]  # heads of records in a buffer


def chunk_records(file: ByteFile, form: Format, chunk: Chunk) -> bytes:
    """The records of a chunk, unpacked.

    Raises:
        DamagedError: they cannot be had.
    """
    head = form.chunk_head(file, chunk)
    if max(head.packed, head.unpacked) > MAX_CHUNK:
        raise DamagedError(f"a chunk claims {max(head.packed, head.unpacked)} bytes; {MAX_CHUNK} are the limit")
    return form.unpack(head, file.read(head.start, head.packed), chunk.cut)


def count_messages(file: ByteFile, form: Format, chunk: Chunk, data: bytes | None = None) -> Counter[int]:
    """Messages by channel in one chunk: by its index, or in ``data``, its unpacked records."""
    if data is None:
        starts = form.message_indexes(file.read(chunk.index_start, chunk.index_size))
        return Counter({key: len(offsets) for key, offsets in starts.items()})
    messages = form.parse_messages(np.frombuffer(data, dtype=np.uint8), form.message_starts(data))
    keys, numbers = np.unique(messages.channel, return_counts=True)
    return Counter(dict(zip(keys.tolist(), numbers.tolist(), strict=True)))


class ChunkedSource:
    """One file, opened. See ``raw.Source``."""

    def __init__(self, path: Path, form: Format) -> None:
        self._form = form
        self._file = ByteFile(path)
        try:
            self._index = form.index(self._file)
        except BaseException:
            self.close()
            raise
        self.kind = form.name if self._index.finished else f"{form.name}, unfinished"
        self._owner = _topics_by_channel(self._index)
        self.topics = tuple(dict.fromkeys(self._owner.values()))
        self._lost = self._index.lost

    @property
    def notes(self) -> list[str]:
        """What was wrong with the file. See ``raw.Source``."""
        if not self._lost:
            return self._index.notes
        number, reason = len(self._lost), shown(next(iter(self._lost.values())))
        lost = f"{number} of {len(self._index.chunks)} chunks cannot be read and were left out ({reason})"
        return [*self._index.notes, f"{self._file.path.name}: {lost}"]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def read(self, topics: Sequence[BagTopic], limit: int | None = None) -> Iterator[tuple[BagTopic, RawMessages]]:
        """Messages of these topics, in the order of the file. See ``raw.Source``."""
        left = dict.fromkeys(topics, self._file.size if limit is None else limit)
        for key, piece in self._pieces(left):
            left[self._owner[key]] -= len(piece)
            yield self._owner[key], piece

    def _pieces(self, left: dict[BagTopic, int]) -> Iterator[tuple[int, RawMessages]]:
        wanted = [key for key, topic in self._owner.items() if topic in left]
        for key in wanted:
            yield from self._loose_messages(key, left[self._owner[key]])
        for chunk in self._index.chunks:
            keys = [key for key in wanted if left[self._owner[key]] > 0]
            if not keys:
                return
            if chunk.channels is None or not chunk.channels.isdisjoint(keys):
                yield from self._chunk_messages(chunk, keys)

    def _loose_messages(self, key: int, limit: int) -> Iterator[tuple[int, RawMessages]]:
        spans = np.array(self._index.loose.get(key, ()), dtype=np.int64).reshape(-1, 2)[: max(limit, 0)]
        try:
            for buffer, table in self._picked(spans[:, 0], spans[:, 1]):
                yield key, RawMessages(table.log_ns, buffer, table.start, table.size)
        except DamagedError as error:
            self._lost[-1] = str(error)

    def _chunk_messages(self, chunk: Chunk, keys: Sequence[int]) -> Iterator[tuple[int, RawMessages]]:
        """The messages of these channels in one chunk; where its index proves wrong, those found without it."""
        begun = False
        for index_size in dict.fromkeys((chunk.index_size, 0)):
            try:
                for buffer, table in self._opened(chunk, index_size, keys):
                    messages = RawMessages(table.log_ns, buffer, table.start, table.size)
                    for key in keys:
                        if (of_key := table.channel == key).any():
                            begun = True
                            yield key, messages.where(of_key)
                self._lost.pop(chunk.start, None)
                return
            except DamagedError as error:
                self._lost[chunk.start] = str(error)
                if begun:
                    return

    def _opened(self, chunk: Chunk, index_size: int, keys: Sequence[int]) -> Iterator[tuple[ByteArray, MessageTable]]:
        """The messages of these channels in one chunk, and maybe others."""
        head = self._form.chunk_head(self._file, chunk)
        index = self._file.read(chunk.index_start, index_size)
        offsets = (self._form.message_indexes(index) if index else None) or None
        if offsets is not None and head.compression == "" and not chunk.cut:
            yield from self._picked(*_record_spans(head, offsets, keys))
            return
        data = chunk_records(self._file, self._form, chunk)
        buffer = np.frombuffer(data, dtype=np.uint8)
        if offsets is None:
            yield buffer, self._parsed(buffer, self._form.message_starts(data))
        elif starts := [offsets[key] for key in keys if key in offsets]:
            yield buffer, self._parsed(buffer, np.concatenate(starts))

    def _parsed(self, buffer: ByteArray, starts: IntArray) -> MessageTable:
        table = self._form.parse_messages(buffer, starts)
        # Else a small file could stand for more messages than there is memory.
        if int(table.size.sum()) > buffer.size:
            raise DamagedError("the messages of a chunk overlap")
        return table

    def _picked(self, starts: IntArray, ends: IntArray) -> Iterator[tuple[ByteArray, MessageTable]]:
        """Read message records (n,) from where they lie in the file, skipping what lies between if it is much."""
        if (ends - starts > _MAX_MESSAGE).any():
            raise DamagedError(f"a message has more than {_MAX_MESSAGE} bytes")
        if not len(starts):
            return
        cost = np.cumsum(np.minimum(np.diff(starts, append=ends[-1]), ends - starts + _NEAR))
        for group in np.split(np.arange(len(starts)), np.flatnonzero(np.diff(cost // BATCH_BYTES)) + 1):
            data, where = self._read_spans(starts[group], ends[group])
            buffer = np.frombuffer(data, dtype=np.uint8)
            yield buffer, self._parsed(buffer, where)

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


def _record_spans(head: ChunkHead, offsets: dict[int, IntArray], keys: Sequence[int]) -> tuple[IntArray, IntArray]:
    """Where in the file the message records of these channels start, and where they end at the latest."""
    every = np.sort(np.concatenate(list(offsets.values())))
    wanted = np.sort(np.concatenate([offsets[key] for key in keys if key in offsets] or [every[:0]]))
    if len(every) and (every[0] < 0 or every[-1] >= head.packed or (np.diff(every) == 0).any()):
        raise DamagedError("the index of a chunk is wrong")
    ends = np.append(every, head.packed)[np.searchsorted(every, wanted, side="right")]
    return head.start + wanted, head.start + ends


def _topics_by_channel(index: BagIndex) -> dict[int, BagTopic]:
    """Each channel's topic; channels of one name, type and encoding share one."""
    groups: dict[tuple[str, str, str], list[int]] = {}
    for key, channel in sorted(index.channels.items()):
        groups.setdefault((channel.topic, channel.type, channel.encoding), []).append(key)
    owner: dict[int, BagTopic] = {}
    for (name, type_name, encoding), keys in groups.items():
        definition = index.channels[keys[0]].definition
        count = sum(index.counts[key] for key in keys)
        owner.update(dict.fromkeys(keys, BagTopic(name, type_name, count, encoding, definition)))
    return owner


def ros2_type(name: str) -> str:
    """The ROS 2 spelling of a message type: ``sensor_msgs/Imu`` is ``sensor_msgs/msg/Imu``."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name


def with_channel(chunk: Chunk, channel: int, size: int) -> Chunk:
    """The chunk with ``size`` more bytes of index behind it, which tell of this channel."""
    return replace(chunk, index_size=chunk.index_size + size, channels=(chunk.channels or frozenset()) | {channel})


def unpacked(head: ChunkHead, data: bytes, cut: bool, codecs: dict[str, Callable[[bytes, int], bytes]]) -> bytes:
    """Decompress to no more bytes than the chunk declares; all of them, unless the file was cut inside the chunk."""
    if head.compression == "":
        raw = data[: head.unpacked]
    elif head.compression not in codecs:
        raise DamagedError(f"compression {head.compression!r} is not one of {', '.join(codecs)}")
    else:
        try:
            raw = codecs[head.compression](data, head.unpacked)
        except Exception as error:  # each library has its own errors
            raise DamagedError(f"a chunk cannot be unpacked ({error})") from error
    if len(raw) != head.unpacked and not cut:
        raise DamagedError(f"a chunk of {head.unpacked} bytes unpacks to {len(raw)}")
    return raw


def unpack_lz4(data: bytes, size: int) -> bytes:
    """LZ4 frames, to no more than ``size`` bytes."""
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

    return bytes(LZ4FrameDecompressor().decompress(data, max_length=size))
