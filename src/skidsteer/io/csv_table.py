"""CSV files: columns of numbers found by their names in the first line, every fault named with its line."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from skidsteer.errors import DataError
from skidsteer.io.text_file import decode, listed, read_bytes, short
from skidsteer.se2 import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A CSV file cut into lines; ``top`` is the number of the one with the header, counted from 1."""

    path: Path
    data: bytes
    lines: list[str]
    top: int
    header: tuple[str, ...]
    delimiter: str


def read_table(path: str | os.PathLike[str]) -> Table:
    """Read a CSV file up to its header, the first line that is not blank.

    Comma, semicolon and tab separate; a byte order mark, any line ends and a leading ``#`` are accepted.

    Raises:
        DataError: the file cannot be read, is no text, or is empty.
    """
    path = Path(path)
    data = read_bytes(path)
    lines = decode(path, data).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    title = next((line for line in lines if line.strip()), "")
    table = Table(path, data, lines, 0, (), max(",;\t", key=title.count))
    top, cells = next(rows(table), (0, []))
    if not cells:
        raise DataError(f"{path}: is empty; the first line must name the columns")
    names = [cell.strip() for cell in cells]
    return replace(table, top=top, header=(names[0].lstrip("# "), *names[1:]))


def rows(table: Table) -> Iterator[tuple[int, list[str]]]:
    """Number of its (first) line and cells of each row below the header that is not blank."""
    reader = csv.reader(islice(table.lines, table.top, None), delimiter=table.delimiter)
    line = table.top + 1
    try:
        for cells in reader:
            if any(map(str.strip, cells)):
                yield line, cells
            line = table.top + reader.line_num + 1
    except csv.Error as error:
        raise DataError(f"{table.path}: line {line}: {error}; is a quote missing?") from error


def line_of(table: Table, row: int) -> int:
    """Number in the file of the line of a row, counted from 0 below the header."""
    return next(islice(rows(table), row, None))[0]


def numbers(table: Table, names: Sequence[str]) -> FloatArray:
    """The named columns (n, k) as numbers, n at least 1; what other columns hold does not matter.

    Raises:
        DataError: no such column, no rows, rows of unequal length, or a cell that is no finite number.
    """
    columns = [_column(table, name) for name in names]
    if next(rows(table), None) is None:
        raise DataError(f"{table.path}: has a header and no rows")
    try:
        values = np.loadtxt(table.lines[table.top :], delimiter=table.delimiter, comments=None, ndmin=2, encoding=None)
    except ValueError:
        values = np.empty((0, 0))
    if values.shape[1] == len(table.header):
        values = values[:, columns]
    else:  # text in other columns, quotes, or a fault that must be named
        values = np.array([_row_numbers(table, line, cells, columns) for line, cells in rows(table)])
    _refuse_nonfinite(table, names, values)
    return values


def column_if_numeric(table: Table, name: str) -> FloatArray | None:
    """A column (n,), NaN and infinity included, or None where a cell is no number. The rows must be of equal length."""
    index = table.header.index(name)
    try:
        column = np.array([float(cells[index]) for _, cells in rows(table)])
    except ValueError:
        return None
    column.setflags(write=False)
    return column


def _column(table: Table, name: str) -> int:
    count = table.header.count(name)
    if count == 0:
        raise DataError(f"{table.path}: no column '{name}'; the first line names: {listed(table.header)}")
    if count > 1:
        raise DataError(f"{table.path}: {count} columns are named '{name}'; rename or delete all but one")
    return table.header.index(name)


def _row_numbers(table: Table, line: int, cells: list[str], columns: list[int]) -> list[float]:
    if len(cells) != len(table.header):
        lengths = f"line {line} has {len(cells)} cells, the header {len(table.header)}"
        raise DataError(f"{table.path}: {lengths}; complete or delete that line")
    return [_number(table, line, cells[column], table.header[column]) for column in columns]


def _number(table: Table, line: int, cell: str, name: str) -> float:
    where = f"{table.path}: line {line}, column '{name}'"
    if not cell.strip():
        raise DataError(f"{where} is empty; fill it in or delete that line")
    try:
        if "_" in cell or not cell.isascii():  # Python would read 1_0 as 10, which is a damaged file rather
            raise ValueError(cell)
        return float(cell)
    except ValueError:
        cure = "write a decimal point" if "," in cell else "correct or delete that line"
        raise DataError(f"{where}: {short(cell)} is not a number; {cure}") from None


def _refuse_nonfinite(table: Table, names: Sequence[str], values: FloatArray) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        row, column = bad[0]
        where = f"{table.path}: line {line_of(table, row)}, column '{names[column]}'"
        raise DataError(
            f"{where} is {values[row, column]}; delete the lines without a number ({len(np.unique(bad[:, 0]))} in all)"
        )
