"""Circle runs from a CSV file: the table of a circle test (Giannoccaro 2015, Tables 1 and 2) as one writes it down.

Columns, in any order, SI units: ``v_left``, ``v_right`` [m/s]; ``radius`` [m], or ``chord`` and ``sagitta`` [m] of
Eq. (16), or all three with cells left empty where the other was measured; optional ``surface`` (any text),
``direction`` (left or right, checked against the speeds), ``speed`` [m/s] over ground, ``name``. Others are ignored.
"""

from __future__ import annotations

import os

from skidsteer.errors import DataError
from skidsteer.io.csv_table import Table, numbers, read_table, rows
from skidsteer.io.text_file import listed, short
from skidsteer.models.slip_ratio import CircleRun

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
