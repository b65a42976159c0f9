"""Decoding messages in bulk: the first of a kind shows where each number lies, the others are read without looking.

Two messages of one type have the same layout when they are equally long and agree in every length and text inside
them (frame names, joint names, sequence counts). Then each number lies at the same byte of all of them, and a column
of a byte matrix is that number for the whole log. The layout is found by walking the message definition over one
message, so it serves CDR of either byte order, the ROS 1 encoding and custom definitions alike.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skidsteer.io.raw import ByteArray, Definitions, IntArray, RawMessages, rows_of_bytes
from skidsteer.se2 import FloatArray

# Kinds of a field's description in rosbags' type system.
BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4

_CODES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "octet": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_TIME: Any = ([], [("sec", (BASE, ("int32", 0))), ("nanosec", (BASE, ("uint32", 0)))])
_BUILTIN: Definitions = {"builtin_interfaces/msg/Time": _TIME, "builtin_interfaces/msg/Duration": _TIME}

_MAX_DEPTH = 12
_MAX_FIELDS = 20_000
_LAYOUTS_TRIED = 32  # layouts compared with the whole batch; beyond that each message is walked by itself


class LayoutError(ValueError):
    """A message does not fit its definition."""


@dataclass(frozen=True, slots=True)
class Field:
    """Where numbers lie in a message."""

    offset: int
    dtype: np.dtype[np.generic]
    count: int | None  # None for a single number


@dataclass(frozen=True, slots=True)
class Layout:
    """Where everything lies in the messages that share this layout.

    ``fields`` and ``texts`` are named by their path: ``pose.pose.position.x``, ``transforms[0].child_frame_id``.
    ``fixed`` are the byte ranges in which all such messages agree.
    """

    fields: Mapping[str, Field]
    texts: Mapping[str, str]
    fixed: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Messages of one layout: one row of bytes each."""

    layout: Layout
    rows: IntArray  # (n,) which messages of the batch these are
    matrix: ByteArray  # (n, size)

    def column(self, name: str) -> NDArray[np.generic]:
        """Numbers of one field: (n,), or (n, count) where the field is an array or a sequence.

        Raises:
            LayoutError: the message type has no such number.
        """
        field = self.layout.fields.get(name)
        if field is None:
            raise LayoutError(f"no field {name}")
        width = 1 if field.count is None else field.count
        if width == 0:
            return np.zeros((len(self.matrix), 0), dtype=field.dtype)
        raw = self.matrix[:, field.offset : field.offset + field.dtype.itemsize * width]
        values = np.ascontiguousarray(raw).view(field.dtype)
        return values[:, 0] if field.count is None else values

    def numbers(self, names: tuple[str, ...]) -> FloatArray:
        """Single numbers side by side: (n, len(names)), as float64."""
        return np.stack([self.column(name).astype(np.float64) for name in names], axis=1)

    def text(self, name: str) -> str:
        """A text that all these messages have, "" where there is none of that name."""
        return self.layout.texts.get(name, "")


def read_layout(message: bytes, definitions: Definitions, type_name: str, encoding: str) -> Layout:
    """Walk one message along its definition.

    Args:
        message: one serialised message; bytes after its end are ignored.
        definitions: type name -> definition, of this type and all it is made of.
        type_name: such as ``sensor_msgs/msg/Imu``.
        encoding: "cdr" (either byte order) or "ros1".

    Raises:
        LayoutError: the message is shorter than its definition asks, or the definition is missing or unusual.
    """
    return _Walk(message, definitions, encoding).layout(type_name)


def fill(matrix: ByteArray, field: Field, values: ArrayLike) -> None:
    """Write one number into each row of a byte matrix (n, size) in place: the inverse of ``Block.column``."""
    table = np.ascontiguousarray(np.asarray(values).astype(field.dtype)).reshape(len(matrix), -1).view(np.uint8)
    matrix[:, field.offset : field.offset + table.shape[1]] = table


class _Walk:
    """A cursor over one message; ``fields``, ``texts`` and ``fixed`` grow as it advances."""

    def __init__(self, message: bytes, definitions: Definitions, encoding: str) -> None:
        self.message = message
        self.definitions = definitions
        self.cdr = encoding == "cdr"
        self.order = "<"
        self.position = 0
        self.fields: dict[str, Field] = {}
        self.texts: dict[str, str] = {}
        self.fixed: list[tuple[int, int]] = []
        if self.cdr:
            self._encapsulation()
        elif encoding != "ros1":
            raise LayoutError(f"encoding {encoding} cannot be decoded")

    def layout(self, type_name: str) -> Layout:
        self._struct("", type_name, 0)
        return Layout(self.fields, self.texts, tuple(_joined(self.fixed)))

    def _encapsulation(self) -> None:
        if self.message[:2] not in (b"\0\0", b"\0\1"):
            raise LayoutError("not plain CDR")
        self.order = "<" if self.message[1] else ">"
        self.fixed.append((0, 2))
        self.position = 4

    def _take(self, size: int, align: int = 1) -> int:
        """Advance over ``size`` bytes; return where they begin."""
        if self.cdr:
            self.position += -(self.position - 4) % align  # CDR aligns from the end of its 4-byte heading
        start, self.position = self.position, self.position + size
        if self.position > len(self.message):
            raise LayoutError(f"message of {len(self.message)} bytes ends early")
        return start

    def _length(self) -> int:
        start = self._take(4, 4)
        self.fixed.append((start, start + 4))
        (length,) = struct.unpack_from(self.order + "I", self.message, start)
        if length > len(self.message):
            raise LayoutError(f"length {length} in a message of {len(self.message)} bytes")
        return int(length)

    def _struct(self, prefix: str, type_name: str, depth: int) -> None:
        definition = _BUILTIN.get(type_name) or self.definitions.get(type_name)
        if definition is None or depth > _MAX_DEPTH:
            raise LayoutError(f"no definition of {type_name}")
        for name, description in definition[1]:
            self._field(prefix + name, description, depth)

    def _field(self, path: str, description: Any, depth: int) -> None:
        kind, detail = description
        if len(self.fields) + len(self.texts) > _MAX_FIELDS:
            raise LayoutError(f"more than {_MAX_FIELDS} fields")
        if kind == NAME:
            self._struct(path + ".", str(detail), depth + 1)
        elif kind == BASE:
            self._base(path, detail[0], None)
        else:
            element, number = detail
            count = int(number) if kind == ARRAY else self._length()
            if element[0] == BASE and element[1][0] not in ("string", "wstring"):
                self._base(path, element[1][0], count)
            else:
                for index in range(count):
                    self._field(f"{path}[{index}]", element, depth + 1)

    def _base(self, path: str, name: str, count: int | None) -> None:
        if name == "string":
            self.texts[path] = self._text()
            return
        code = _CODES.get(name)
        if code is None:
            raise LayoutError(f"fields of type {name} cannot be decoded")
        dtype: np.dtype[np.generic] = np.dtype(self.order + code)
        # An empty sequence is not padded to the size of the elements it does not have.
        start = self._take(dtype.itemsize * (1 if count is None else count), dtype.itemsize if count != 0 else 1)
        self.fields[path] = Field(start, dtype, count)

    def _text(self) -> str:
        length = self._length()
        start = self._take(length)
        self.fixed.append((start, start + length))
        raw = self.message[start : start + length]
        return raw.rstrip(b"\0").decode(errors="replace")


def _joined(ranges: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Ranges in ascending order, with those that touch as one."""
    joined: list[tuple[int, int]] = []
    for start, end in ranges:
        if joined and joined[-1][1] == start:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((start, end))
    return joined


class Decoder:
    """Decodes the messages of one topic; remembers the layouts it has met. ``undecoded`` counts those that fit none."""

    def __init__(self, definitions: Definitions, type_name: str, encoding: str) -> None:
        self.definitions = definitions
        self.type_name = type_name
        self.encoding = encoding
        self.undecoded = 0
        self.problem = ""
        self._known: dict[int, list[tuple[Layout, ByteArray]]] = {}

    def blocks(self, raw: RawMessages) -> Iterator[Block]:
        """The messages in blocks of one layout each; those that do not fit their definition are left out."""
        for size in np.unique(raw.size):
            rows = np.flatnonzero(raw.size == size)
            matrix = rows_of_bytes(raw.buffer, raw.start[rows], int(size))
            yield from self._of_one_size(rows, matrix)

    def _of_one_size(self, rows: IntArray, matrix: ByteArray) -> Iterator[Block]:
        known = self._known.setdefault(matrix.shape[1], [])
        tried = 0
        while len(rows):
            if tried == len(known) and not self._learn(known, matrix[0]):
                rows, matrix = rows[1:], matrix[1:]
                continue
            layout, example = known[tried]
            same = _agrees(layout, example, matrix)
            if same.any():
                yield Block(layout, rows[same], matrix[same])
                rows, matrix = rows[~same], matrix[~same]
            tried += 1
            if tried >= _LAYOUTS_TRIED:
                yield from self._one_by_one(rows, matrix)
                return

    def _one_by_one(self, rows: IntArray, matrix: ByteArray) -> Iterator[Block]:
        for index in range(len(rows)):
            own: list[tuple[Layout, ByteArray]] = []
            if self._learn(own, matrix[index]):
                yield Block(own[0][0], rows[index : index + 1], matrix[index : index + 1])

    def _learn(self, known: list[tuple[Layout, ByteArray]], message: ByteArray) -> bool:
        try:
            layout = read_layout(message.tobytes(), self.definitions, self.type_name, self.encoding)
        except LayoutError as error:
            self.undecoded += 1
            self.problem = self.problem or str(error)
            return False
        known.append((layout, message.copy()))
        return True


def _agrees(layout: Layout, example: ByteArray, matrix: ByteArray) -> NDArray[np.bool_]:
    same = np.ones(len(matrix), dtype=bool)
    for start, end in layout.fixed:
        whole = start + (end - start) // 8 * 8
        for first, last, word in ((start, whole, np.uint64), (whole, end, np.uint8)):
            if first < last:
                rows = np.ascontiguousarray(matrix[:, first:last]).view(word)
                same &= (rows == example[first:last].view(word)).all(axis=1)
    return same
