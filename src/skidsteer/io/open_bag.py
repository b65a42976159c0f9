"""Opening a bag of any kind: a file, or a rosbag2 folder with its list of files."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import yaml

from skidsteer.errors import DataError
from skidsteer.io.bag_names import KINDS, PACKED, is_packed, kind_of, refuse_other_files
from skidsteer.io.chunked import ChunkedSource
from skidsteer.io.compressed import CompressedMessages, UnpackedFiles, has_packed_messages
from skidsteer.io.mcap_index import MCAP
from skidsteer.io.raw import BagTopic, RawMessages, Source, shown
from skidsteer.io.rosbag1_index import ROSBAG1
from skidsteer.io.sqlite_source import SqliteSource
from skidsteer.io.text_file import decode, read_bytes

_METADATA = "metadata.yaml"
_MAX_METADATA = 4 << 20


def is_bag(path: str | os.PathLike[str]) -> bool:
    """True for a file that is named like a bag, and for a folder with rosbag2's metadata or with bag files in it."""
    path = Path(path)
    if not path.is_dir():
        return bool(kind_of(path))
    return (path / _METADATA).is_file() or any(kind_of(entry) for entry in path.iterdir())


@contextmanager
def open_bag(path: str | os.PathLike[str]) -> Iterator[Source]:
    """Open a bag: a ``.mcap``, ``.db3`` or ``.bag`` file, or a folder of them.

    Raises:
        DataError: there is no such file, it is no bag, or it is damaged beyond use.
    """
    source = _source(Path(path))
    try:
        yield source
    finally:
        source.close()


def _source(path: Path) -> Source:
    try:
        if not path.exists():
            raise DataError(f"{shown(path)}: no such file or folder")
        if path.is_dir():
            return _folder(path)
        return _files([path])
    except (OSError, ValueError) as error:  # ValueError: a NUL byte in the path
        raise DataError(f"{shown(path)}: cannot be opened: {shown(error)}") from error


def _file(path: Path) -> Source:
    kind = kind_of(path)
    return SqliteSource(path) if kind == ".db3" else ChunkedSource(path, MCAP if kind == ".mcap" else ROSBAG1)


def _files(paths: Sequence[Path]) -> Source:
    """Files of one recording as a source. What is compressed tells so itself: the list of files may be lost."""
    for path in paths:
        refuse_other_files(path)
    if any(map(is_packed, paths)):
        return UnpackedFiles(paths, _files)
    source = _file(paths[0]) if len(paths) == 1 else _Several(paths)
    return CompressedMessages(source) if has_packed_messages(source) else source


def _folder(path: Path) -> Source:
    if not (path / _METADATA).is_file():
        return _files(_bag_files(path))
    information = _metadata(path / _METADATA)
    paths = _listed_files(path, information)
    mode, packing = (str(information.get(f"compression_{part}") or "").lower() for part in ("mode", "format"))
    if mode not in ("", "none") and (mode not in ("file", "message") or packing != "zstd"):
        how = f"{shown(mode, 20)} with {shown(packing, 20)}"
        raise DataError(f"{path / _METADATA}: compressed by {how}; only file or message with zstd can be read")
    kinds = sorted({kind_of(file) or file.suffix for file in paths})
    if kinds not in ([".mcap"], [".db3"]):
        raise DataError(f"{path}: its files are of the kinds {shown(kinds)}; need .mcap or .db3")
    return _files(paths)


def _bag_files(path: Path) -> list[Path]:
    """The bag files of a folder without metadata, all of the first kind that there is."""
    for kind in KINDS:
        files = sorted(entry for entry in path.iterdir() if kind_of(entry) == kind and entry.is_file())
        if files:
            return [file for file in files if not _is_original(file)]
    raise DataError(f"{path}: holds no {_METADATA} and no file named {', '.join(sorted(KINDS))}")


def _is_original(path: Path) -> bool:
    """Whether a file is what ``rosbag compress``, ``reindex`` or ``fix`` keep beside the file they made of it."""
    return path.name.endswith(".orig.bag") and path.with_name(path.name.removesuffix(".orig.bag") + ".bag").is_file()


class _Loader(yaml.SafeLoader):
    """Safe YAML without aliases, by which a small file can stand for an endless one.

    Not the loader in C: deep nesting ends that one, and the process with it, where this one raises an error.
    """

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases are not accepted")
        return super().compose_node(parent, index)


def _metadata(path: Path) -> dict[str, Any]:
    try:
        content = yaml.load(decode(path, read_bytes(path, _MAX_METADATA)), Loader=_Loader)
        information = content["rosbag2_bagfile_information"]
    except DataError:
        raise
    except Exception as error:  # the library raises many kinds on damaged text
        raise DataError(f"{path}: is no metadata of a rosbag2 recording: {shown(error)}") from error
    if not isinstance(information, dict):
        raise DataError(f"{path}: rosbag2_bagfile_information is no mapping")
    return information


def _listed_files(folder: Path, information: dict[str, Any]) -> list[Path]:
    """The files that the metadata list, which must lie in the folder itself."""
    listed = information.get("relative_file_paths")
    if not isinstance(listed, list) or not listed or not all(isinstance(name, str) for name in listed):
        raise DataError(f"{folder / _METADATA}: relative_file_paths must be a list of file names")
    paths = []
    for name in listed:
        outside = PurePosixPath(name).is_absolute() or PureWindowsPath(name).anchor or "\\" in name
        if outside or ".." in PurePosixPath(name).parts:
            raise DataError(f"{folder / _METADATA}: lists {shown(name)}, outside of the bag's folder; refused")
        # Old versions prefix the name of the folder the bag was recorded to; the files lie beside the metadata.
        paths.append(_as_it_lies_there(folder / PurePosixPath(name).name))
    missing = [path.name for path in paths if not path.is_file()]
    if missing:
        raise DataError(f"{folder}: {shown(', '.join(missing))} listed in {_METADATA} is missing")
    return paths


def _as_it_lies_there(path: Path) -> Path:
    """The file itself, or the compressed or uncompressed one that is there in its place."""
    other = path.with_suffix("") if is_packed(path) else path.with_name(path.name + PACKED)
    return other if other.is_file() and not path.is_file() else path


class _Several:
    """The parts of a recording that was split into several files, as one source."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._sources: list[Source] = []
        try:
            self._sources.extend(_file(path) for path in paths)
        except BaseException:
            self.close()
            raise
        self.kind = self._sources[0].kind
        self.topics = self._merged_topics()

    def _merged_topics(self) -> tuple[BagTopic, ...]:
        merged: dict[tuple[str, str, str], BagTopic] = {}
        for topic in (topic for source in self._sources for topic in source.topics):
            key = (topic.name, topic.type, topic.encoding)
            first = merged.get(key)
            count = topic.count + (first.count if first else 0)
            definition = first.definition if first else topic.definition
            merged[key] = BagTopic(*key[:2], count, topic.encoding, definition)
        return tuple(merged.values())

    @property
    def notes(self) -> list[str]:
        return [note for source in self._sources for note in source.notes]

    def read(self, topics: Sequence[BagTopic], limit: int | None = None) -> Iterator[tuple[BagTopic, RawMessages]]:
        by_key = {(topic.name, topic.type, topic.encoding): topic for topic in topics}
        for source in self._sources:
            own = [topic for topic in source.topics if (topic.name, topic.type, topic.encoding) in by_key]
            for topic, piece in source.read(own, limit):
                yield by_key[topic.name, topic.type, topic.encoding], piece

    def close(self) -> None:
        for source in self._sources:
            source.close()
