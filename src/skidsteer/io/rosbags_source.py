"""rosbag2 recordings whose files or messages are compressed, as sources of messages, through ``rosbags``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from skidsteer.errors import DataError, RequestError, SkidSteerError
from skidsteer.io.messages import type_store
from skidsteer.io.raw import BagTopic, Definition, RawMessages, from_list, shown

_AT_A_TIME = 2048


class RosbagsSource:
    """A folder that ``rosbags.highlevel.AnyReader`` opens. See ``raw.Source``."""

    def __init__(self, path: Path, kind: str) -> None:
        store = type_store(2)
        from rosbags.highlevel import AnyReader

        self.kind = kind
        self.notes: list[str] = []
        self._path = path
        with refusing(self._path, kind):
            self._reader = AnyReader([path], default_typestore=store)
            self._reader.open()
            self._connections: dict[BagTopic, list[Any]] = _by_topic(self._reader.connections)
        self.topics = tuple(self._connections)

    def close(self) -> None:
        """Close the files."""
        with refusing(self._path, self.kind):
            self._reader.close()

    def read(self, topics: Sequence[BagTopic], limit: int | None = None) -> Iterator[tuple[BagTopic, RawMessages]]:
        """Messages of these topics, in order of recording time. See ``raw.Source``."""
        if limit is None:
            yield from self._read(topics, None)
            return
        for topic in topics:
            yield from self._read([topic], limit)

    def _read(self, topics: Sequence[BagTopic], limit: int | None) -> Iterator[tuple[BagTopic, RawMessages]]:
        owner = {(topic.name, topic.type): topic for topic in topics}
        messages = self._messages(topics, limit)
        while batch := list(islice(messages, _AT_A_TIME)):
            # Sorted to topics by the identity of their connections: everything done once a message is in C.
            connections, stamps, raw = zip(*batch, strict=True)
            with refusing(self._path, self.kind):
                joined = from_list(stamps, raw)
            identity = np.fromiter(map(id, connections), dtype=np.int64, count=len(connections))
            by_identity = dict(zip(identity.tolist(), connections, strict=True))
            for key, connection in by_identity.items():
                yield owner[connection.topic, connection.msgtype], joined.where(identity == key)

    def _messages(self, topics: Sequence[BagTopic], limit: int | None) -> Iterator[tuple[Any, int, bytes]]:
        connections = [connection for topic in topics for connection in self._connections.get(topic, ())]
        if not connections:  # none would mean all to the library
            return
        with refusing(self._path, self.kind):
            yield from islice(self._reader.messages(connections=connections), limit)


def _by_topic(connections: Sequence[Any]) -> dict[BagTopic, list[Any]]:
    """Connections (one a publisher) grouped to topics of one type."""
    groups: dict[tuple[str, str], list[Any]] = {}
    for connection in connections:
        groups.setdefault((str(connection.topic), str(connection.msgtype)), []).append(connection)
    topics = {}
    for (name, type_name), group in groups.items():
        count = sum(int(connection.msgcount) for connection in group)
        topics[BagTopic(name, type_name, count, "cdr", _definition(group[0].msgdef))] = group
    return topics


def _definition(given: Any) -> Definition | None:
    kind = given.format.name.lower()
    return Definition(kind, given.data) if kind in ("msg", "idl") and given.data else None


@contextmanager
def refusing(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a reader of foreign files raises into one line that names the file.

    Every kind of exception is taken: on damaged files the libraries raise nearly all there are.
    """
    try:
        yield
    except SkidSteerError:
        raise
    except PermissionError as error:
        raise RequestError(f"{path}: permission denied; make the file readable") from error
    except Exception as error:
        reason = shown(error) or type(error).__name__
        raise DataError(
            f"{path}: cannot be read as {kind}: {reason}; the file is damaged, or something else"
        ) from error
