"""rosbag2 recordings compressed file by file or message by message, unpacked no further than there is room for."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skidsteer.errors import DataError, SkidSteerError
from skidsteer.io.bag_names import is_packed
from skidsteer.io.raw import BagTopic, RawMessages, Source, from_list, rows_of_bytes, shown

_MAX_MESSAGE = 64 << 20
_PIECE = 1 << 20
_MAGIC = np.frombuffer(b"\x28\xb5\x2f\xfd", dtype=np.uint8)  # of zstd; a message in CDR begins with 0
_LOOK = 8  # messages of a topic that are looked at


def _decompressor() -> Any:
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd

    return zstd.ZstdDecompressor()


def has_packed_messages(source: Source) -> bool:
    """Whether the messages of a source are each compressed with zstd, by the first ones of its longest topic."""
    longest = max(source.topics, key=lambda topic: topic.count, default=None)
    if longest is None or longest.encoding != "cdr":
        return False
    for _, piece in source.read([longest], _LOOK):
        starts = piece.start[piece.size >= len(_MAGIC)]
        return len(starts) > 0 and bool((rows_of_bytes(piece.buffer, starts, len(_MAGIC)) == _MAGIC).all(axis=1).any())
    return False


class CompressedMessages:
    """A source whose messages are each compressed with zstd. See ``raw.Source``."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._lost: dict[str, int] = {}  # topic -> messages that cannot be unpacked
        self.kind = f"{source.kind}, compressed by message"
        self.topics = source.topics

    @property
    def notes(self) -> list[str]:
        """What was wrong with the file. See ``raw.Source``."""
        lost = [f"{shown(name)}: {number} messages cannot be unpacked; left out" for name, number in self._lost.items()]
        return [*self._source.notes, *lost]

    def read(self, topics: Sequence[BagTopic], limit: int | None = None) -> Iterator[tuple[BagTopic, RawMessages]]:
        """Messages of these topics, unpacked. See ``raw.Source``."""
        self._lost.clear()
        for topic, packed in self._source.read(topics, limit):
            stamps, messages = [], []
            for stamp, start, size in zip(packed.bag_ns.tolist(), packed.start, packed.size, strict=True):
                message = _unpack_message(packed.buffer[start : start + size].tobytes())
                if message is None:
                    self._lost[topic.name] = self._lost.get(topic.name, 0) + 1
                    continue
                stamps.append(stamp)
                messages.append(message)
            yield topic, from_list(stamps, messages)

    def close(self) -> None:
        """Close the files."""
        self._source.close()


def _unpack_message(data: bytes) -> bytes | None:
    """A message, or None where it cannot be had or is absurdly long."""
    try:
        decompressor = _decompressor()
        message: bytes = decompressor.decompress(data, max_length=_MAX_MESSAGE)
    except Exception:  # the library has its own errors
        return None
    return message if decompressor.eof else None


class UnpackedFiles:
    """A source of files of which some were compressed with zstd and are unpacked to a temporary folder.

    See ``raw.Source``.
    """

    def __init__(self, paths: Sequence[Path], opened: Callable[[Sequence[Path]], Source]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="skidsteer-")
        self._cut: list[str] = []
        try:
            folder = Path(self._folder.name)
            self._source = opened([_unpack_file(p, folder, self._cut) if is_packed(p) else p for p in paths])
        except SkidSteerError as error:
            self._folder.cleanup()
            # The user knows the folder of the recording, not the temporary one.
            raise type(error)(str(error).replace(self._folder.name, str(paths[0].parent))) from error
        except BaseException:
            self._folder.cleanup()
            raise
        self.kind = f"{self._source.kind}, compressed by file"
        self.topics = self._source.topics

    @property
    def notes(self) -> list[str]:
        """What was wrong with the files. See ``raw.Source``."""
        return [*self._cut, *self._source.notes]

    def read(self, topics: Sequence[BagTopic], limit: int | None = None) -> Iterator[tuple[BagTopic, RawMessages]]:
        """Messages of these topics. See ``raw.Source``."""
        return self._source.read(topics, limit)

    def close(self) -> None:
        """Close and delete the unpacked files."""
        self._source.close()
        self._folder.cleanup()


def _unpack_file(path: Path, folder: Path, cut: list[str]) -> Path:
    """Unpack to a file of the same name without its suffix, to half the room there is at the most.

    ``cut`` takes a note where the file ends early.
    """
    target, room = folder / path.stem, shutil.disk_usage(folder).free // 2
    decompressor = _decompressor()
    try:
        with path.open("rb") as packed, target.open("xb") as file:
            while not decompressor.eof and (data := packed.read(_PIECE)):
                room -= file.write(decompressor.decompress(data, max_length=_PIECE))
                while not decompressor.needs_input and not decompressor.eof:
                    room -= file.write(decompressor.decompress(b"", max_length=_PIECE))
                    _refuse_if_full(path, room)
                _refuse_if_full(path, room)
    except DataError:
        raise
    except Exception as error:  # the library has its own errors
        raise DataError(f"{path}: cannot be unpacked, it is damaged or not zstd: {shown(error)}") from error
    if not decompressor.eof:
        cut.append(f"{path.name}: cut short; what could be unpacked of it is read")
    return target


def _refuse_if_full(path: Path, room: int) -> None:
    if room < 0:
        raise DataError(f"{path}: unpacks to more than half the room on the disk of temporary files")
