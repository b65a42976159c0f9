"""rosbag2 recordings in sqlite3 as sources of messages."""

from __future__ import annotations

import shutil
import sqlite3
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import compress, islice
from pathlib import Path

import numpy as np

from skidsteer.errors import DataError
from skidsteer.io.raw import BagTopic, Definition, RawMessages, from_list, shown
from skidsteer.io.sqlite_pages import Row, rows_in_pages

_AT_A_TIME = 512  # rows; more no longer fit the cache and take longer
_LONGEST = 64 << 20  # bytes of one value; SQLite refuses longer ones
_LOGS = ("-wal", "-journal")  # beside the file of a recorder that died: what to write into it yet, what to take back
_KINDS = {"ros2msg": "msg", "ros2idl": "idl"}


class SqliteSource:
    """One ``.db3`` file, opened for reading only. See ``raw.Source``."""

    kind = "rosbag2 sqlite3"

    def __init__(self, path: Path) -> None:
        self._path = path
        self.notes: list[str] = []
        self._open = ExitStack()
        self._broken = False  # not all messages can be counted
        self._ids: set[int] | None = None  # of the messages that a torn file still leads to; None for a whole file
        try:
            self._connection = self._connected()
            self._guard()
            self._topics = self._list_topics()
            self._count_the_rest()
        except sqlite3.Error as error:
            self.close()
            raise DataError(f"{path}: cannot be read as {self.kind}, it is damaged: {shown(error)}") from error
        except BaseException:
            self.close()
            raise
        self.topics = tuple(self._topics.values())

    def _connected(self) -> sqlite3.Connection:
        """The database as it lies there; with the logs that a dead recorder left beside it, a copy that takes them in.

        SQLite would write to the user's files otherwise.
        """
        path, words = self._path, "mode=ro&immutable=1"
        logs = [log for end in _LOGS if (log := path.with_name(path.name + end)).is_file() and log.stat().st_size]
        if logs:
            folder = Path(self._open.enter_context(tempfile.TemporaryDirectory(prefix="skidsteer-")))
            if sum(file.stat().st_size for file in (path, *logs)) > shutil.disk_usage(folder).free // 2:
                self.notes.append(f"{path.name}: {logs[0].name} beside it was not read; there is no room for a copy")
            else:
                for file in (path, *logs):
                    shutil.copyfile(file, folder / file.name)
                self.notes.append(f"{path.name}: the recorder left {logs[0].name} behind; what is in it was read, too")
                path, words = folder / path.name, "mode=rw"
        connection = sqlite3.connect(f"{path.resolve().as_uri()}?{words}", uri=True)
        self._open.callback(connection.close)
        self._file = path
        return connection

    def close(self) -> None:
        """Close the file."""
        self._open.close()

    def read(self, topics: Sequence[BagTopic], limit: int | None = None) -> Iterator[tuple[BagTopic, RawMessages]]:
        """Messages of these topics, in the order in which they were recorded. See ``raw.Source``."""
        wanted = {key: topic for key, topic in self._topics.items() if topic in topics}
        groups = [list(wanted)] if limit is None else [[key] for key in wanted]
        try:
            for keys in groups:
                for rows in self._batches(keys, -1 if limit is None else limit):
                    for key, messages in _by_topic(rows):
                        yield wanted[key], messages
        except sqlite3.Error as error:
            note = f"{self._path.name}: damaged; not all of its messages can be read ({shown(error)})"
            self.notes += [note] if note not in self.notes else []
        if self._ids is not None:
            rest = islice((row[1:] for row in self._rest() if row[1] in wanted), limit)
            while rows := list(islice(rest, _AT_A_TIME)):
                for key, messages in _by_topic(rows):
                    yield wanted[key], messages

    def _rest(self) -> Iterator[Row]:
        """Messages of a torn file that it does not lead to."""
        return (row for row in rows_in_pages(self._file) if row[0] not in (self._ids or ()))

    def _count_the_rest(self) -> None:
        """Where the file is torn, find what it no longer leads to, and add that to the counts."""
        if not self._is_torn():
            return
        self._ids = self._ids_by_tree()
        counts = Counter(row[1] for row in self._rest())
        self._topics = {key: replace(topic, count=topic.count + counts[key]) for key, topic in self._topics.items()}
        if found := sum(counts[key] for key in self._topics):
            self.notes.append(
                f"{self._path.name}: cut, or its recorder died while it wrote; {found} messages were found that the"
                " file no longer leads to, none of more than 4 kB"
            )

    def _is_torn(self) -> bool:
        """Whether the file has pages beyond its end, or an index of more messages than it leads to."""
        ask, indexed = self._connection.execute, 0
        try:
            ((pages,), (size,)) = (ask(f"PRAGMA page_{what}").fetchone() for what in ("count", "size"))
            ((indexed,),) = ask("SELECT count(*) FROM messages INDEXED BY timestamp_idx")
        except sqlite3.OperationalError:  # no such index: not of rosbag2's own hand
            pass
        except sqlite3.Error:
            return True
        counted = sum(topic.count for topic in self._topics.values())
        return self._broken or self._file.stat().st_size > pages * size or indexed > counted

    def _ids_by_tree(self) -> set[int]:
        """Of the messages that can be read whole, up to the first that cannot."""
        found: set[int] = set()
        try:
            for key, _ in self._connection.execute("SELECT id, data FROM messages NOT INDEXED"):
                found.add(key)
        except sqlite3.Error:
            pass
        return found

    def _batches(self, keys: Sequence[int], limit: int) -> Iterator[list[tuple[int, int, bytes]]]:
        """So many rows of these topics at a time."""
        marks = ",".join("?" * len(keys))
        query = f"SELECT topic_id, timestamp, data FROM messages NOT INDEXED WHERE topic_id IN ({marks}) LIMIT ?"
        cursor = self._connection.execute(query, (*keys, limit))
        while True:
            rows: list[tuple[int, int, bytes]] = []
            error = None
            try:
                rows.extend(islice(cursor, _AT_A_TIME))
            except sqlite3.Error as caught:  # those before it are sound
                error = caught
            if rows:
                yield rows
            if error is not None:
                raise error
            if len(rows) < _AT_A_TIME:
                return

    def _guard(self) -> None:
        """Take from the file nothing but data, and nothing absurdly long."""
        self._connection.text_factory = lambda raw: raw.decode(errors="replace")
        self._connection.execute("PRAGMA trusted_schema = OFF")
        if sys.version_info >= (3, 11):
            self._connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
        tables = self._tables()
        if not {"topics", "messages"} <= tables:
            held = shown(", ".join(sorted(map(str, tables)))) or "none"
            raise DataError(f"{self._path}: is no rosbag2 recording; its tables are {held}, not topics and messages")

    def _tables(self) -> set[str]:
        ask = "SELECT name FROM sqlite_master WHERE type = 'table'"
        try:
            return {name for (name,) in self._connection.execute(ask)}
        except sqlite3.DatabaseError:
            # Shorter than it says, as after a copy that was cut: SQLite opens such a file in this mode only.
            self._connection.execute("PRAGMA writable_schema = ON")
            return {name for (name,) in self._connection.execute(ask)}

    def _list_topics(self) -> dict[int, BagTopic]:
        definitions, counts = self._definitions(), self._counts()
        rows = self._connection.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
        return {
            int(key): BagTopic(str(name), str(kind), counts[key], str(encoding), definitions.get(kind))
            for key, name, kind, encoding in rows
        }

    def _definitions(self) -> dict[str, Definition]:
        """Those of the bag's own; recordings of ROS 2 before Iron have none."""
        try:
            rows = self._connection.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            ).fetchall()
        except sqlite3.OperationalError:
            return {}
        return {str(name): Definition(_KINDS[kind], str(text)) for name, kind, text in rows if kind in _KINDS and text}

    def _counts(self) -> Counter[int]:
        """Messages by topic; where the file is damaged, those before the damage."""
        try:
            return Counter(dict(self._connection.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id")))
        except sqlite3.Error:
            self._broken = True
            found: Counter[int] = Counter()
            try:
                for (key,) in self._connection.execute("SELECT topic_id FROM messages"):
                    found[key] += 1
            except sqlite3.Error:
                pass
            return found


def _by_topic(rows: list[tuple[int, int, bytes]]) -> Iterator[tuple[int, RawMessages]]:
    """Rows by topic; those with anything but numbers and bytes in them, as a column can hold any type, are left out."""
    try:
        parts = list(_split(rows))
    except (TypeError, ValueError, OverflowError):
        sound = [row for row in rows if isinstance(row[1], int) and isinstance(row[2], bytes)]
        parts = list(_split(sound))
    yield from parts


def _split(rows: list[tuple[int, int, bytes]]) -> Iterator[tuple[int, RawMessages]]:
    # Everything that is done once a message is done in C.
    owner, stamps, messages = zip(*rows, strict=True) if rows else ((), (), ())
    keys, times = np.array(owner, dtype=np.int64), np.array(stamps, dtype=np.int64)
    for key in np.unique(keys).tolist():
        of_key = keys == key
        yield key, from_list(times[of_key], tuple(compress(messages, of_key.tolist())))
