"""Any DRIVE of the command line to a `Drive`: a folder, CSV files, ``sample:NAME``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from skidsteer.drive import Drive
from skidsteer.errors import DataError, RequestError
from skidsteer.io.folder import read_csv_files, read_folder
from skidsteer.samples import sample
from skidsteer.vehicle import Vehicle

PREFIX = "sample:"


def load_drive(path: str | os.PathLike[str], vehicle: Vehicle | None = None) -> Drive:
    """Read a drive.

    Args:
        path: a drive folder, CSV files joined by commas (``wheels.csv,pose.csv``), or ``sample:NAME``.
        vehicle: of the drive; None: what is written beside it.

    Raises:
        DataError: the files cannot be read as a drive.
        RequestError: no such sample.
    """
    text = os.fspath(path)
    if text.startswith(PREFIX):
        return sample(text.removeprefix(PREFIX))
    if Path(text).is_dir():
        return read_folder(text, vehicle)
    names = text.split(",")
    if all(name.lower().endswith(".csv") for name in names):
        return read_csv_files(names, vehicle)
    if not os.path.exists(text):
        raise DataError(f"{text}: no such drive; give a drive folder, CSV files or sample:NAME")
    raise DataError(f"{text}: not a drive folder and not CSV files")


def load_drives(paths: Sequence[str], vehicle: Vehicle | None = None) -> list[Drive]:
    """Read all drives named on a command line; CSV files that stand beside each other there are one drive.

    Raises:
        RequestError: none named, or drives of different robots.
    """
    if not paths:
        raise RequestError("no drive given")
    groups: list[str] = []
    was_csv = False
    for path in paths:
        is_csv = path.lower().endswith(".csv") and "," not in path
        if is_csv and was_csv:
            groups[-1] += "," + path
        else:
            groups.append(path)
        was_csv = is_csv
    drives = [load_drive(group, vehicle) for group in groups]
    widths = {d.vehicle.track_width for d in drives}
    if len(widths) > 1:
        named = ", ".join(f"{d.name}: {d.vehicle.name} {d.vehicle.track_width:g} m" for d in drives)
        raise RequestError(
            f"the drives are of different robots ({named}); calibrate them one by one, or give --vehicle"
        )
    return drives
