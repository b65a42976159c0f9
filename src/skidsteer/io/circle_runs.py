"""Circle runs from a CSV file: the table of a circle test (Giannoccaro 2015, Tables 1 and 2) as one writes it down.

Columns, in any order, SI units: ``v_left``, ``v_right`` [m/s]; ``radius`` [m], or ``chord`` and ``sagitta`` [m] of
Eq. (16), or all three with cells left empty where the other was measured; optional ``surface`` (any text),
``direction`` (left or right, checked against the speeds), ``speed`` [m/s] over ground, ``name``. Others are ignored.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skidsteer.calibration import DriveRecord
from skidsteer.errors import DataError, RequestError
from skidsteer.io.csv_table import Table, numbers, read_table, rows
from skidsteer.io.text_file import listed, short
from skidsteer.io.vehicle_file import read_vehicle
from skidsteer.models.slip_ratio import CircleRun
from skidsteer.samples import SAMPLES, rover_runs
from skidsteer.vehicle import Vehicle, preset

WORDS = ("surface", "direction", "name")
NUMBERS = ("radius", "chord", "sagitta", "speed")
AGREE = 0.05  # share by which a radius and that of chord and sagitta may differ


def read_circle_runs(path: str | os.PathLike[str]) -> tuple[CircleRun, ...]:
    """Read the circle runs of a CSV file, in its order.

    Raises:
        DataError: the file cannot be read, has no radius and no chord and sagitta, or a run in it describes no circle;
            with its line.
    """
    table = read_table(path)
    numbers(table, ("v_left", "v_right"))  # names missing columns, missing rows and rows of unequal length
    twice = [name for name in (*NUMBERS, *WORDS) if table.header.count(name) > 1]
    if twice:
        raise DataError(f"{table.path}: two columns are named '{twice[0]}'; rename or delete one")
    there = set(table.header)
    if "radius" not in there and not there >= {"chord", "sagitta"}:
        given = listed(table.header)
        raise DataError(f"{table.path}: no column 'radius', and not both 'chord' and 'sagitta'; there are: {given}")
    return tuple(_run(table, line, cells) for line, cells in rows(table))


@dataclass(frozen=True, slots=True)
class CircleTable:
    """Circle runs of one robot, and where they come from."""

    runs: tuple[CircleRun, ...]
    vehicle: Vehicle
    record: DriveRecord
    is_drive: bool = False  # whether the same is a drive, too: the runs laid out as arcs


SAMPLE = "sample:rover-4wd1"


def circle_table(paths: Sequence[str], vehicle: Vehicle | None = None) -> CircleTable | None:
    """The circle runs that a command line names; None where it names a drive.

    A table is a single CSV file without a clock in which a radius, a chord or a sagitta is a column.

    Args:
        paths: as given.
        vehicle: of the runs; None: ``vehicle.yaml`` beside the table.

    Raises:
        DataError: a table that cannot be used.
        RequestError: nothing tells the vehicle, or no such surface of the sample.
    """
    if len(paths) != 1:
        return None
    (path,) = paths
    if path.startswith(SAMPLE):
        return _sample(path.removeprefix("sample:"), vehicle)
    if not path.lower().endswith(".csv") or "," in path:
        return None
    table = read_table(path)
    if "t" in table.header or not {"radius", "chord", "sagitta"} & set(table.header):
        return None
    runs = read_circle_runs(path)
    sha256 = hashlib.sha256(table.data).hexdigest()
    return CircleTable(runs, vehicle or _beside(table.path), _record(table.path.stem, path, sha256, len(runs)))


def _sample(name: str, vehicle: Vehicle | None) -> CircleTable | None:
    if name not in SAMPLES:
        return None
    surface = name.removeprefix("rover-4wd1").removeprefix("-")
    runs = tuple(run for run in rover_runs() if surface in ("", run.surface))
    record = _record(name, "measured circle runs of Giannoccaro 2015, Tables 1, 2 and 4", "", len(runs))
    return CircleTable(runs, vehicle or preset("rover-4wd1"), record, is_drive=True)


def _record(name: str, source: str, sha256: str, count: int) -> DriveRecord:
    return DriveRecord(name, source, sha256, 0.0, count, 0)


def _beside(path: Path) -> Vehicle:
    file = path.parent / "vehicle.yaml"
    if not file.exists():
        raise RequestError(f"{path}: circle runs do not tell the robot's measures; give --vehicle NAME|FILE")
    return read_vehicle(file)


def _run(table: Table, line: int, cells: list[str]) -> CircleRun:
    row = dict(zip(table.header, (cell.strip() for cell in cells), strict=True))
    where = f"{table.path}: line {line}"
    v_left, v_right = (_number(where, row, name) or 0.0 for name in ("v_left", "v_right"))
    measured = {name: _number(where, row, name) for name in NUMBERS}
    words = {name: row.get(name, "") for name in WORDS}
    try:
        run = _made(v_left, v_right, measured, words["surface"], words["name"])
    except DataError as error:
        raise DataError(f"{where}: {error}") from None
    _refuse_other_side(where, run, words["direction"])
    return run


def _made(v_left: float, v_right: float, measured: dict[str, float | None], surface: str, name: str) -> CircleRun:
    """The run, by its radius where there is one.

    Raises:
        DataError: neither radius nor chord and sagitta, or a radius that contradicts them.
    """
    radius, chord, sagitta = (measured[key] for key in ("radius", "chord", "sagitta"))
    by_chord = None
    if chord is not None and sagitta is not None:
        by_chord = CircleRun.from_chord(v_left, v_right, chord, sagitta, surface, measured["speed"], name)
    if radius is None:
        if by_chord is None:
            raise DataError("has no radius, and not both chord and sagitta; fill them in or delete that line")
        return by_chord
    run = CircleRun(v_left, v_right, radius, surface, measured["speed"], name=name)
    if chord is not None and chord > 2.0 * radius:
        raise DataError(f"a chord of {chord:g} m is longer than the diameter, {2.0 * radius:g} m; correct one of them")
    if by_chord is not None and abs(by_chord.radius - radius) > AGREE * radius:
        raise DataError(
            f"radius {radius:g} m contradicts chord and sagitta, {by_chord.radius:.4g} m by Eq. (16);"
            " leave one of them empty"
        )
    return run


def _number(where: str, row: dict[str, str], name: str) -> float | None:
    """A cell as a number; None where it is empty or there is no such column."""
    cell = row.get(name, "")
    if not cell:
        return None
    try:
        if "_" in cell or not cell.isascii():
            raise ValueError(cell)
        return float(cell)
    except ValueError:
        raise DataError(f"{where}, column '{name}': {short(cell)} is not a number; correct it") from None


def _refuse_other_side(where: str, run: CircleRun, direction: str) -> None:
    side = direction.lower()
    if side and side not in ("left", "right"):
        raise DataError(f"{where}, column 'direction': {short(direction)} is neither left nor right")
    if side and side != run.direction:
        raise DataError(
            f"{where}: v_left {run.v_left:g} and v_right {run.v_right:g} m/s curve to the {run.direction}, not to the"
            f" {side}; are the sides swapped?"
        )
