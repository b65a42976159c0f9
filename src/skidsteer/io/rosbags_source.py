"""rosbag1 and rosbag2 (sqlite3) as sources of messages, through ``rosbags``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from skidsteer.errors import DataError, RequestError, SkidSteerError
from skidsteer.io.messages import type_store
from skidsteer.io.raw import BATCH_BYTES, BATCH_MESSAGES, BagTopic, Definition, RawMessages, from_list, shown


class RosbagsSource:
    """Files that ``rosbags.highlevel.AnyReader`` opens, as one source. See ``raw.Source``."""

    def __init__(self, paths: Sequence[Path], kind: str) -> None:
        ros_version = 1 if kind == "rosbag1" else 2
        store = type_store(ros_version)
        from rosbags.highlevel import AnyReader

        self.kind = kind
        self.notes: list[str] = []
        self._path = paths[0]
        with refusing(self._path, kind):
            self._reader = AnyReader(list(paths), default_typestore=store)
            self._reader.open()
            encoding = "ros1" if ros_version == 1 else "cdr"
            self._connections: dict[BagTopic, list[Any]] = _by_topic(self._reader.connections, encoding)
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
        owner = {(connection.topic, connection.msgtype): topic for topic in topics for connection in self._of(topic)}
        waiting: dict[BagTopic, tuple[list[int], list[bytes]]] = {topic: ([], []) for topic in topics}
        load = 0
        for connection, bag_ns, message in self._messages(topics, limit):
            stamps, messages = waiting[owner[connection.topic, connection.msgtype]]
            stamps.append(bag_ns)
            messages.append(message)
            load += len(message) + BATCH_BYTES // BATCH_MESSAGES
            if load > BATCH_BYTES:
                load = 0
                yield from self._flushed(waiting)
        yield from self._flushed(waiting)

    def _of(self, topic: BagTopic) -> list[Any]:
        return self._connections.get(topic, [])

    def _messages(self, topics: Sequence[BagTopic], limit: int | None) -> Iterator[tuple[Any, int, bytes]]:
        connections = [connection for topic in topics for connection in self._of(topic)]
        if not connections:  # none would mean all to the library
            return
        with refusing(self._path, self.kind):
            yield from islice(self._reader.messages(connections=connections), limit)

    def _flushed(
        self, waiting: dict[BagTopic, tuple[list[int], list[bytes]]]
    ) -> Iterator[tuple[BagTopic, RawMessages]]:
        for topic, (stamps, messages) in waiting.items():
            if messages:
                with refusing(self._path, self.kind):
                    piece = from_list(stamps, messages)
                stamps.clear()
                messages.clear()
                yield topic, piece


def _by_topic(connections: Sequence[Any], encoding: str) -> dict[BagTopic, list[Any]]:
    """Connections (one a publisher) grouped to topics of one type."""
    groups: dict[tuple[str, str], list[Any]] = {}
    for connection in connections:
        groups.setdefault((str(connection.topic), str(connection.msgtype)), []).append(connection)
    topics = {}
    for (name, type_name), group in groups.items():
        count = sum(int(connection.msgcount) for connection in group)
        topics[BagTopic(name, type_name, count, encoding, _definition(group[0].msgdef))] = group
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
