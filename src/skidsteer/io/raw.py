"""Messages as they stand in a bag: bytes and where they lie, before anything is decoded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]
# What rosbags' type system makes of a message definition: type name -> (constants, [(field, (kind, description))]).
Definitions = dict[str, Any]

# Decoded together: enough to hide the cost of a NumPy call, little enough to stay in the cache.
BATCH_MESSAGES = 4096
BATCH_BYTES = 4 << 20


@dataclass(frozen=True, slots=True)
class Definition:
    """The text that defines a message type, as the bag carries it: ``kind`` is "msg" or "idl"."""

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class BagTopic:
    """One topic of a bag, of one type. ``encoding`` is "cdr", "ros1", or another that cannot be decoded here."""

    name: str
    type: str  # ROS 2 spelling: sensor_msgs/msg/JointState
    count: int
    encoding: str
    definition: Definition | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RawMessages:
    """Serialised messages of one topic: message i is ``buffer[start[i] : start[i] + size[i]]``."""

    bag_ns: IntArray  # (n,) time of recording [ns]
    buffer: ByteArray
    start: IntArray  # (n,)
    size: IntArray  # (n,)

    def __len__(self) -> int:
        return len(self.start)

    def where(self, keep: NDArray[np.bool_]) -> RawMessages:
        """Those messages that a mask (n,) chooses, in the same buffer."""
        return RawMessages(self.bag_ns[keep], self.buffer, self.start[keep], self.size[keep])

    def packed(self) -> RawMessages:
        """The same messages in a buffer of their own, without what lay between them, those of one size together."""
        if not len(self):
            return replace(self, buffer=self.buffer[:0])
        if int(self.size.sum()) == self.buffer.size:
            return self
        order = np.argsort(self.size, kind="stable")
        sizes, first = np.unique(self.size[order], return_index=True)
        groups = np.split(self.start[order], first[1:])
        rows = [rows_of_bytes(self.buffer, group, size) for size, group in zip(sizes.tolist(), groups, strict=True)]
        size = self.size[order]
        packed = np.concatenate([row.ravel() for row in rows])
        return RawMessages(self.bag_ns[order], packed, np.cumsum(size) - size, size)


def rows_of_bytes(buffer: ByteArray, start: IntArray, size: int) -> ByteArray:
    """Messages of one size as a matrix (n, size); a copy."""
    if size == 0:
        return np.zeros((len(start), 0), dtype=np.uint8)
    return np.lib.stride_tricks.sliding_window_view(buffer, size)[start]


class Source(Protocol):
    """An open bag of any kind."""

    @property
    def kind(self) -> str:
        """Such as "MCAP", for the user."""
        ...

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """What the bag holds."""
        ...

    @property
    def notes(self) -> Sequence[str]:
        """What was wrong with the file, for the user; complete only when everything has been read."""
        ...

    def read(self, topics: Sequence[BagTopic], limit: int | None = None) -> Iterator[tuple[BagTopic, RawMessages]]:
        """Messages of these topics in pieces of any size; with a limit, about that many of each topic and no more."""
        ...

    def close(self) -> None:
        """Close the files."""
        ...


def from_list(bag_ns: ArrayLike, messages: Sequence[bytes]) -> RawMessages:
    """Join messages that come one by one."""
    size = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    buffer = np.frombuffer(b"".join(messages), dtype=np.uint8)
    return RawMessages(np.array(bag_ns, dtype=np.int64), buffer, np.cumsum(size) - size, size)


def join(parts: Sequence[RawMessages]) -> RawMessages:
    """Several pieces of one topic as one. The parts must not be empty."""
    if len(parts) == 1:
        return parts[0]
    shift = np.cumsum([0, *(part.buffer.size for part in parts[:-1])])
    return RawMessages(
        np.concatenate([part.bag_ns for part in parts]),
        np.concatenate([part.buffer for part in parts]),
        np.concatenate([part.start + by for part, by in zip(parts, shift, strict=True)]),
        np.concatenate([part.size for part in parts]),
    )


def in_batches(pieces: Iterator[tuple[BagTopic, RawMessages]]) -> Iterator[tuple[BagTopic, RawMessages]]:
    """The same messages in fewer, larger pieces, so that decoding has something to work on at a time."""
    waiting: dict[BagTopic, list[RawMessages]] = {}
    load: dict[BagTopic, int] = {}
    for topic, piece in pieces:
        waiting.setdefault(topic, []).append(piece.packed())
        cost = len(piece) * (BATCH_BYTES // BATCH_MESSAGES) + int(piece.size.sum())
        load[topic] = load.get(topic, 0) + cost
        if load[topic] >= BATCH_BYTES:
            load[topic] = 0
            yield topic, join(waiting.pop(topic))
    for topic, parts in waiting.items():
        yield topic, join(parts)


def shown(text: object, limit: int = 200) -> str:
    """Foreign text made fit for one line of a message: control characters replaced, length limited."""
    line = "".join(mark if mark.isprintable() else "?" for mark in " ".join(str(text).split()))
    return line if len(line) <= limit else line[: limit - 3] + "..."
