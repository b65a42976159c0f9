"""The drive folder, the product's own format: one CSV file for each part of a drive, and ``vehicle.yaml``.

SI units and radians. The columns of a file are found by their names in its first line, in any order; others are
ignored. Every fault of a file is a `DataError` of one line that names the file, the line and the cure.
"""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError
from skidsteer.io import atomic
from skidsteer.io.csv_table import Table, column_if_numeric, line_of, numbers, read_table
from skidsteer.io.scans import SCANS_FILE, is_scan_table, plate_series
from skidsteer.io.text_file import listed, names_in, read_bytes, short
from skidsteer.io.tum import read_tum_table
from skidsteer.io.vehicle_file import LARGEST, parse_antenna, parse_vehicle, read_vehicle, vehicle, vehicle_text
from skidsteer.laser.plate import Plate
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import PRESETS, Vehicle

__all__ = ["check_replaceable", "read_csv_files", "read_folder", "read_vehicle", "vehicle", "write_folder"]

log = logging.getLogger(__name__)

COLUMNS: dict[str, tuple[str, tuple[str, ...]]] = {  # part of a drive -> its file and its columns beside t
    "wheels": ("wheels.csv", ("v_left", "v_right")),
    "pose": ("pose.csv", ("x", "y", "yaw")),
    "position": ("position.csv", ("x", "y")),
    "gyro": ("imu.csv", ("gyro_z",)),
    "command": ("cmd.csv", ("v", "omega")),
    "wheel_command": ("cmdwheels.csv", ("v_left_cmd", "v_right_cmd")),
}
FILES = {part: file for part, (file, _) in COLUMNS.items()} | {"segments": "segments.csv"}
READ = FILES | {"scans": SCANS_FILE}  # raw scans are read only: a folder that holds them is never replaced
TRAJECTORY = ".tum"  # ending of the name of a file with poses in that format
VEHICLE_FILE = "vehicle.yaml"
MARK = "# written by skidsteer, SHA-256: "  # begins the last line of it, by which a written drive is known
SEGMENT_COLUMNS = ("seg", "t_start", "t_end")

LATEST_TIME = 1e11  # [s] after 1970: the year 5138, while milliseconds since 1970 passed it in 1973


def read_folder(
    path: str | os.PathLike[str],
    vehicle: Vehicle | None = None,
    plate: Plate | None = None,
    otherwise: Vehicle | None = None,
) -> Drive:
    """Read a drive folder.

    Args:
        path: the folder. ``pose.csv`` is preferred to ``position.csv``. The numeric columns of ``segments.csv`` beside
            ``seg``, ``t_start`` and ``t_end`` become ``Drive.labels``.
        vehicle: taken in place of ``vehicle.yaml``.
        plate: on the robot: its poses in ``scans.csv`` are the reference, not those of any other file.
        otherwise: vehicle where there is neither that nor ``vehicle.yaml``.

    Returns:
        The drive, named after the folder. Its ``sha256`` is that of what was recorded: the files used, one after the
        other in the order of ``READ``, without ``vehicle.yaml``.

    Raises:
        DataError: no such folder, no ``wheels.csv`` in it, no vehicle, or a file that cannot be used.
    """
    path = Path(path)
    names = names_in(path)
    if FILES["wheels"] not in names:
        raise DataError(f"{path}: no wheels.csv (t, v_left, v_right); there are: {listed(sorted(names))}")
    there = {part: path / file for part, file in READ.items() if file in names}
    tables = {part: read_table(there[part]) for part in _used(there, plate, str(path))}
    return _assemble(_folder_name(path), str(path), tables, vehicle, plate, otherwise)


def read_csv_files(
    paths: Sequence[str | os.PathLike[str]],
    vehicle: Vehicle | None = None,
    plate: Plate | None = None,
    otherwise: Vehicle | None = None,
) -> Drive:
    """Read files that together are one drive, each recognised by its name or else by its columns.

    They are CSV files; poses may be a trajectory in the TUM format. A file may hold several parts on one clock. Its
    ``v, omega`` are taken as a command only where nothing else is in it: beside a pose they are most likely measured.

    Args:
        paths: the files.
        vehicle: taken in place of the ``vehicle.yaml`` beside the file with the wheel speeds.
        plate: as of ``read_folder``.
        otherwise: as of ``read_folder``.

    Returns:
        The drive, named after the file with the wheel speeds, or after its folder where that is ``wheels.csv``.

    Raises:
        DataError: no wheel speeds, a file that is no part of a drive, two for one part, no vehicle, or a file that
            cannot be used.
    """
    tables: dict[str, Table] = {}
    for path in paths:
        table = read_tum_table(path) if os.fspath(path).lower().endswith(TRAJECTORY) else read_table(path)
        for part in _parts_in(table):
            if part in tables:
                raise DataError(f"{tables[part].path} and {table.path} both have {part} columns; leave one of them out")
            tables[part] = table
    if "wheels" not in tables:
        given = listed(map(os.path.basename, paths))
        raise DataError(f"no columns t, v_left, v_right in: {given}; add the file of the wheel speeds")
    used = _used(tables, plate, ", ".join(map(str, paths)))
    wheels = tables["wheels"].path
    name = _folder_name(wheels.parent) if wheels.name == FILES["wheels"] else wheels.stem
    return _assemble(name, ", ".join(map(str, paths)), {part: tables[part] for part in used}, vehicle, plate, otherwise)


def write_folder(drive: Drive, path: str | os.PathLike[str], force: bool = False) -> None:
    """Write a drive folder that reads back to the last bit; nothing half-written is left if it fails.

    An older drive folder of that name is replaced as a whole where this function wrote it and nobody changed it since,
    which the last line of ``vehicle.yaml`` tells; others, such as a recorded one, with ``force`` only.

    Raises:
        DataError: as ``check_replaceable``, or the folder cannot be written to.
    """
    check_replaceable(path, force)
    files = {
        file: _series_text(series, columns)
        for part, (file, columns) in COLUMNS.items()
        if (series := getattr(drive, part)) is not None
    }
    if drive.segments is not None:
        files[FILES["segments"]] = _segments_text(drive.segments, drive.labels)
    robot = vehicle_text(drive.vehicle, drive.antenna)
    files[VEHICLE_FILE] = robot + _mark({name: text.encode() for name, text in files.items()}, robot.encode())
    atomic.write_folder(path, files)


def check_replaceable(path: str | os.PathLike[str], force: bool = False) -> None:
    """Refuse a place where ``write_folder`` would not write; for before a long calculation.

    Raises:
        DataError: the path is a file, a folder with other things in it than a drive, or, without ``force``, a drive
            that was not written by ``write_folder`` as it stands.
    """
    path = Path(path)
    if not os.path.lexists(path):
        return
    names = names_in(path)
    foreign = names - {*FILES.values(), VEHICLE_FILE}
    if foreign or (names and FILES["wheels"] not in names):
        held = listed(sorted(foreign or names))
        raise DataError(f"{path}: is not just a drive, it holds {held}; choose another folder")
    if names and not force and not _is_ours(path, names):
        raise DataError(
            f"{path}: holds a drive that skidsteer did not write; choose another folder, or --force to lose it"
        )


def _used(parts: Iterable[str], plate: Plate | None, where: str) -> list[str]:
    """The parts of a drive to use: of several references one."""
    parts = list(parts)
    if plate is not None and "scans" not in parts:
        raise DataError(f"{where}: no {SCANS_FILE} to see a plate in; its columns are t and the bearings of the rays")
    if plate is None and "scans" in parts and not {"pose", "position"} & set(parts):
        raise DataError(f"{where}: scans of a plate on the robot need its measures: --plate WIDTH")
    unused = {"pose", "position"} if plate is not None else {"scans", *(["position"] if "pose" in parts else [])}
    return [part for part in parts if part not in unused]


def _assemble(
    name: str,
    source: str,
    tables: Mapping[str, Table],
    vehicle: Vehicle | None,
    plate: Plate | None,
    otherwise: Vehicle | None,
) -> Drive:
    contents = {tables[part].path: tables[part].data for part in READ if part in tables}
    antenna = None
    if vehicle is None:
        file = tables["wheels"].path.parent / VEHICLE_FILE
        if otherwise and not os.path.lexists(file):
            vehicle = otherwise
        else:
            told = _vehicle_bytes(file)
            vehicle, antenna = parse_vehicle(file, told), parse_antenna(file, told)
    series = {part: _series(tables[part], part) for part in COLUMNS if part in tables}
    wheels = series.pop("wheels")
    if len(wheels) < 2:
        raise DataError(f"{tables['wheels'].path}: has a single row; a drive needs at least two wheel samples")
    if plate is not None:
        series["pose"], notes = plate_series(tables["scans"], wheels, plate)
        for note in notes:
            log.info("%s: %s", name, note)
    segments, labels = _segments(tables["segments"]) if "segments" in tables else (None, {})
    return Drive(
        name,
        vehicle,
        wheels,
        **series,
        segments=segments,
        labels=labels,
        source=source,
        antenna=antenna,
        sha256=hashlib.sha256(b"".join(contents.values())).hexdigest(),
    )


def _parts_in(table: Table) -> list[str]:
    for part, file in READ.items():
        if table.path.name == file:
            return [part]
    if is_scan_table(table):
        return ["scans"]
    header = set(table.header)
    parts = [part for part, (_, columns) in COLUMNS.items() if header >= {"t", *columns}]
    if "pose" in parts:
        parts.remove("position")
    if "command" in parts and len(parts) > 1:
        parts.remove("command")
    if header >= {"t_start", "t_end"}:
        parts.append("segments")
    if not parts:
        known = "; ".join(", ".join(("t", *columns)) for _, columns in COLUMNS.values())
        given = listed(table.header)
        raise DataError(f"{table.path}: no part of a drive in its columns {given}; rename them to: {known}")
    return parts


def _vehicle_bytes(file: Path) -> bytes:
    if not os.path.lexists(file):
        names = ", ".join(sorted(PRESETS))
        raise DataError(f"{file.parent}: no vehicle.yaml; name the robot with --vehicle NAME|FILE (presets: {names})")
    return read_bytes(file, LARGEST)


def _series(table: Table, part: str) -> Series:
    values = numbers(table, ("t", *COLUMNS[part][1]))
    t = values[:, 0]
    _refuse_far_times(table, t)
    step = np.diff(t)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 1
        what = "repeats the time of" if step[row - 1] == 0 else "is earlier than"
        where = f"{table.path}: line {line_of(table, row)} (t = {t[row]:.3f} s)"
        raise DataError(f"{where} {what} the one before; sort by t and keep one line of each")
    return Series(t, values[:, 1:], part)


def _segments(table: Table) -> tuple[FloatArray, dict[str, FloatArray]]:
    spans = numbers(table, SEGMENT_COLUMNS[1:])
    _refuse_far_times(table, spans)
    faults = (spans[:, 1] <= spans[:, 0]) | (spans[:, 0] < np.concatenate([[-np.inf], spans[:-1, 1]]))
    if faults.any():
        line = line_of(table, int(np.argmax(faults)))
        raise DataError(f"{table.path}: line {line}: a segment must end after it starts and follow the one before it")
    names = [name for name in table.header if name and name not in SEGMENT_COLUMNS]
    columns = {name: column_if_numeric(table, name) for name in names}
    return spans, {name: column for name, column in columns.items() if column is not None}


def _refuse_far_times(table: Table, times: FloatArray) -> None:
    far = np.argwhere(np.abs(times) > LATEST_TIME)
    if far.size:
        where = f"{table.path}: line {line_of(table, far[0, 0])}"
        raise DataError(f"{where}: {times[tuple(far[0])]:.6g} is no time in seconds; is it in milli- or nanoseconds?")


def _folder_name(path: Path) -> str:
    return os.path.basename(os.path.realpath(path)) or str(path)


def _is_ours(path: Path, names: set[str]) -> bool:
    if VEHICLE_FILE not in names:
        return False
    contents = {name: read_bytes(path / name) for name in names}
    robot, begin, told = contents.pop(VEHICLE_FILE).rpartition(MARK.encode())
    return bool(begin) and begin + told == _mark(contents, robot).encode()


def _mark(contents: Mapping[str, bytes], robot: bytes) -> str:
    """The last line of ``vehicle.yaml``: the drive's files as they were written, and that file above the line."""
    digest = hashlib.sha256(robot)
    for name in sorted(contents):
        digest.update(name.encode() + contents[name])
    return f"{MARK}{digest.hexdigest()}\n"


def _series_text(series: Series, columns: Sequence[str]) -> str:
    return _csv_text(("t", *columns), np.column_stack([series.t, series.values]).tolist())


def _segments_text(segments: FloatArray, labels: Mapping[str, FloatArray]) -> str:
    for name in labels:
        if name.strip() != name or name in ("", *SEGMENT_COLUMNS) or set(name) & set('",;\t\r\n'):
            raise DataError(f"the segment label {short(name)} cannot be the name of a CSV column; rename it")
    rows = np.column_stack([segments, *labels.values()]).tolist()
    return _csv_text((*SEGMENT_COLUMNS, *labels), [[k, *row] for k, row in enumerate(rows)])


def _csv_text(header: Sequence[str], rows: Sequence[Sequence[float]]) -> str:
    lines = [",".join(map(repr, row)) for row in rows]
    return "\n".join([",".join(header), *lines, ""])
