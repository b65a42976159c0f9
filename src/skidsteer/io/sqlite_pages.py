"""Messages out of the pages of a torn rosbag2 database, past the tree that no longer leads to all of them.

rosbag2 keeps no journal on the disk unless it is told to (storage preset "resilient"). When it dies while it writes,
some pages are new and some are old: rows are whole, but the tree above them is not, and SQLite finds a part of them or
calls the file malformed. The format of pages and records: https://www.sqlite.org/fileformat.html, 1.6 and 2.1.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

_LEAF = 0x0D  # page of a table that holds rows
_HEADER = 100  # bytes before the first page's own
_INT_SIZES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}
_CONSTANTS = {8: 0, 9: 1}
_AT_A_TIME = 256  # pages

Row = tuple[int, int, int, bytes]  # id of the message, of its topic, time of recording [ns], serialised message


def rows_in_pages(path: Path) -> Iterator[Row]:
    """Rows of the table of messages that fit on one page, about 4 kB, in the order of the file; each id once.

    Rows of other tables do not look like these: a number left to the id of the row, two numbers, bytes.
    """
    seen: set[int] = set()
    with path.open("rb") as file:
        head = file.read(_HEADER)
        size = int.from_bytes(head[16:18], "big")
        size = 65536 if size == 1 else size
        if size < 512:
            return
        usable, number = size - head[20], 0
        file.seek(0)
        while pages := file.read(size * _AT_A_TIME):
            for start in range(0, len(pages) - size + 1, size):
                for row in _rows(pages[start : start + size], usable, _HEADER if number == 0 else 0):
                    if row[0] not in seen:
                        seen.add(row[0])
                        yield row
                number += 1


def _rows(page: bytes, usable: int, base: int) -> Iterator[Row]:
    if page[base] != _LEAF:
        return
    count = int.from_bytes(page[base + 3 : base + 5], "big")
    for at in range(base + 8, min(base + 8 + 2 * count, usable - 1), 2):
        row = _row(page, int.from_bytes(page[at : at + 2], "big"), usable)
        if row is not None:
            yield row


def _row(page: bytes, start: int, usable: int) -> Row | None:
    """The row of a cell; None where it is of another table, goes on on other pages, or is no row at all."""
    try:
        length, at = _varint(page, start)
        key, at = _varint(page, at)
        if length > usable - 35 or at + length > usable:
            return None
        head_size, position = _varint(page, at)
        kinds = []
        while position < at + head_size:
            kind, position = _varint(page, position)
            kinds.append(kind)
        if len(kinds) != 4 or kinds[0] != 0 or kinds[3] < 12 or kinds[3] % 2:
            return None
        topic, position = _integer(page, position, kinds[1])
        stamp, position = _integer(page, position, kinds[2])
    except (IndexError, KeyError):
        return None
    data = page[position : position + (kinds[3] - 12) // 2]
    return (key, topic, stamp, data) if position + len(data) == at + length else None


def _varint(page: bytes, at: int) -> tuple[int, int]:
    """A number of up to nine bytes, and where the next one begins."""
    value = 0
    for index in range(8):
        byte = page[at + index]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + index + 1
    return value << 8 | page[at + 8], at + 9


def _integer(page: bytes, at: int, kind: int) -> tuple[int, int]:
    if kind in _CONSTANTS:
        return _CONSTANTS[kind], at
    end = at + _INT_SIZES[kind]
    return int.from_bytes(page[at:end], "big", signed=True), end
