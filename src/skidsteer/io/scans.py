"""Laser scans from CSV files and bags, and the poses of a robot whose plate they show.

In a CSV file the first column is the time ``t`` [s]; the other columns are named by the bearings of the rays [rad] and
hold ranges [m]. Where nothing came back, a cell is empty, ``nan``, ``inf`` or 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from skidsteer.drive import Series
from skidsteer.errors import DataError, RequestError
from skidsteer.io.csv_table import Table, line_of
from skidsteer.io.messages import Samples
from skidsteer.io.raw import BagTopic, shown
from skidsteer.io.stamps import SECOND, Clock, Timed, to_series
from skidsteer.io.text_file import short
from skidsteer.laser.plate import Plate
from skidsteer.laser.scans import Scans
from skidsteer.laser.track import track_plate
from skidsteer.se2 import FloatArray

SCANS_FILE = "scans.csv"
LOTS = 64  # of scans with bearings of their own that one log may have


def is_scan_table(table: Table) -> bool:
    """Whether the columns beside ``t`` are named by numbers."""
    return table.header[0] == "t" and len(table.header) > 3 and all(map(_is_number, table.header[1:]))


def scans_of(table: Table) -> Scans:
    """The scans of a CSV file.

    Raises:
        DataError: its columns are no bearings, a cell is no number, or the times do not increase.
    """
    if not is_scan_table(table):
        raise DataError(f"{table.path}: the columns of scans are t and, for each ray, its bearing in rad as a name")
    values = _numbers(table)
    bad = ~np.isfinite(values[:, 0]) | (np.diff(values[:, 0], prepend=-np.inf) <= 0.0)
    if bad.any():
        line = line_of(table, int(np.argmax(bad)))
        raise DataError(f"{table.path}: line {line}: t is no number or not later than in the line before; sort by t")
    with _told_of(str(table.path)):
        return Scans(values[:, 0], np.array(table.header[1:], dtype=float), values[:, 1:])


def plate_poses(
    topic: BagTopic, tables: Sequence[Samples], wheels: Timed, plate: Plate | None, clock: Clock, notes: list[str]
) -> Timed:
    """Poses (n, 3) of the robot in the frame of the scanner whose ``LaserScan`` messages show the plate on it.

    Raises:
        DataError: the plate is not to be seen in them.
        RequestError: no plate was told, or not which way round it is.
    """
    if plate is None:
        raise RequestError(f"{shown(topic.name)}: scans of a plate on the robot need its measures: --plate WIDTH")
    name, start = shown(topic.name), int(wheels.ns[0])
    frame = max(tables, key=lambda samples: len(samples.bag_ns)).label
    timed = [clock.timed(samples, name, notes) for samples in tables if samples.label == frame]
    with _told_of(name):
        lots = [lot for each in timed for lot in _lots(each, start)]
        track = track_plate(lots, plate, to_series(wheels, start, "wheels"))
    notes += [f"{name}: {note}" for note in track.notes]
    return Timed(start + np.round(track.t * SECOND).astype(np.int64), track.pose)


def plate_series(table: Table, wheels: Series, plate: Plate) -> tuple[Series, tuple[str, ...]]:
    """Poses of the robot from a CSV file of scans on the clock of the wheels, and notes on what was left out.

    Raises:
        DataError: the file cannot be used, or does not show the plate.
        RequestError: nothing tells which way round the plate is.
    """
    scans = scans_of(table)
    with _told_of(str(table.path)):
        track = track_plate(scans, plate, wheels)
    return track.series(), track.notes


@contextmanager
def _told_of(where: str) -> Iterator[None]:
    try:
        yield
    except (DataError, RequestError) as error:
        raise type(error)(f"{where}: {error}") from error


def _lots(timed: Timed, start: int) -> list[Scans]:
    """Messages with the same number of rays as scans, those with the same bearings together."""
    heads, which = np.unique(timed.values[:, :2], axis=0, return_inverse=True)
    if len(heads) > LOTS:
        raise DataError(f"the scans have {len(heads)} sets of bearings; a scanner that stands still has one or a few")
    lots = []
    for number, (first, step) in enumerate(heads):
        mine = timed.where(which.ravel() == number)
        rays = np.arange(mine.values.shape[1] - 3)
        delay = float(np.median(mine.values[:, 2])) * rays
        lots.append(Scans((mine.ns - start) / SECOND, first + step * rays, mine.values[:, 3:], delay))
    return lots


def _numbers(table: Table) -> FloatArray:
    """All cells (n, 1 + m); empty ones are NaN."""
    lines = [_filled(line, table.delimiter) for line in table.lines[table.top :] if line.strip()]
    if not lines:
        raise DataError(f"{table.path}: has a header and no rows")
    try:
        values = np.loadtxt(lines, delimiter=table.delimiter, comments=None, ndmin=2, encoding=None)
    except ValueError:
        raise DataError(_fault(table)) from None
    if values.shape[1] != len(table.header):
        raise DataError(_fault(table))
    return values


def _filled(line: str, delimiter: str) -> str:
    twice = delimiter + delimiter
    if twice in line or line.endswith(delimiter):
        line = line.replace(twice, f"{delimiter}nan{delimiter}").replace(twice, f"{delimiter}nan{delimiter}")
        return line + "nan" if line.endswith(delimiter) else line
    return line


def _fault(table: Table) -> str:
    """The first line that is not all numbers, or not as long as the header."""
    for row, line in enumerate(line for line in table.lines[table.top :] if line.strip()):
        cells = _filled(line, table.delimiter).split(table.delimiter)
        where = f"{table.path}: line {line_of(table, row)}"
        if len(cells) != len(table.header):
            return f"{where} has {len(cells)} cells, the header {len(table.header)}; complete or delete that line"
        for name, cell in zip(table.header, cells, strict=True):
            if not _is_number(cell):
                return f"{where}, column '{name}': {short(cell)} is not a number; correct or delete that line"
    return f"{table.path}: cannot be read as numbers"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
