"""Any DRIVE of the command line to a `Drive`: a folder, CSV and TUM files, a bag, ``sample:NAME``."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError, RequestError
from skidsteer.io.folder import TRAJECTORY, read_csv_files, read_folder
from skidsteer.io.options import AUTOMATIC, BagOptions
from skidsteer.samples import sample
from skidsteer.vehicle import Vehicle

if TYPE_CHECKING:
    from skidsteer.io.bag import BagContents

log = logging.getLogger(__name__)

SURELY_TURNS = 2.0  # [rad] by the nominal track width

PREFIX = "sample:"
TABLES = (".csv", TRAJECTORY)  # files that hold parts of a drive
NOT_A_DRIVE = "give a drive folder, CSV or .tum files, a bag (.bag, .mcap, .db3 or a rosbag2 folder) or sample:NAME"


def load_drive(
    path: str | os.PathLike[str],
    vehicle: Vehicle | None = None,
    bag: BagOptions = AUTOMATIC,
    otherwise: Vehicle | None = None,
) -> Drive:
    """Read a drive. What was chosen in a bag is logged.

    A pose whose yaw never changes while the wheels turn is read as a position: receivers and converters that know no
    heading write such.

    Args:
        path: a drive folder, files joined by commas (``wheels.csv,pose.csv`` or ``wheels.csv,pose.tum``), a bag, or
            ``sample:NAME``.
        vehicle: of the drive; None: what is written beside it. A bag needs it.
        bag: topics, joints and frames of a bag, where the automatic choice does not fit; and the plate on the robot
            that the laser scans of any drive show.
        otherwise: vehicle where there is neither that nor one written beside the drive.

    Raises:
        DataError: the files cannot be read as a drive.
        RequestError: no such sample, a bag without a vehicle, or without what the options name.
    """
    text = os.fspath(path)
    if text.startswith(PREFIX):
        return sample(text.removeprefix(PREFIX))
    return _without_false_heading(_read(text, vehicle, bag, otherwise))


def _read(text: str, vehicle: Vehicle | None, bag: BagOptions, otherwise: Vehicle | None) -> Drive:
    names = text.split(",")
    if all(name.lower().endswith(TABLES) for name in names):
        return read_csv_files(names, vehicle, bag.plate, otherwise)
    if not os.path.exists(text):
        raise DataError(f"{text}: no such drive; {NOT_A_DRIVE}")
    if _is_bag(text):
        return _load_bag(text, vehicle or otherwise, bag)
    if Path(text).is_dir():
        return read_folder(text, vehicle, bag.plate, otherwise)
    raise DataError(f"{text}: not a drive; {NOT_A_DRIVE}")


def _without_false_heading(drive: Drive) -> Drive:
    pose, wheels = drive.pose, drive.wheels
    if pose is None or len(pose) < 2 or np.ptp(pose.values[:, 2]) > 0.0:
        return drive
    rolled = np.abs(np.diff(wheels.values[:-1], axis=1)[:, 0]) @ np.minimum(np.diff(wheels.t), 1.0)
    if rolled < SURELY_TURNS * drive.vehicle.track_width:
        return drive
    log.info("%s: the yaw of the pose never changes while the wheels turn: taken for positions only", drive.name)
    return replace(drive, pose=None, position=Series(pose.t, pose.values[:, :2], "position"))


def _is_bag(path: str) -> bool:
    """Whether a path is a bag, and no drive folder that a bag was left in."""
    from skidsteer.io.open_bag import is_bag

    return is_bag(path) and not os.path.exists(os.path.join(path, "wheels.csv"))


def bag_contents(path: str, options: BagOptions = AUTOMATIC) -> BagContents | None:
    """What a bag offers, and what would be used; None where the path is no bag.

    Raises:
        DataError: the bag cannot be read.
        RequestError: a topic that the options name is not there.
    """
    if not _is_bag(path) or not os.path.exists(path):
        return None
    from skidsteer.io.bag import list_bag

    return list_bag(path, options)


def _load_bag(path: str, vehicle: Vehicle | None, options: BagOptions) -> Drive:
    from skidsteer.io.bag import read_bag_noted  # its readers take a while to import

    if vehicle is None:
        raise RequestError(f"{path}: a bag does not tell the robot's measures; give --vehicle NAME|FILE")
    drive, contents = read_bag_noted(path, vehicle, options)
    for role, topic in contents.chosen.items():
        log.info("%s: %s from %s", drive.name, role, topic)
    for note in contents.notes:
        log.info("%s: %s", drive.name, note)
    return drive


def load_drives(
    paths: Sequence[str],
    vehicle: Vehicle | None = None,
    bag: BagOptions = AUTOMATIC,
    otherwise: Vehicle | None = None,
) -> list[Drive]:
    """Read all drives named on a command line; CSV and TUM files that stand beside each other there are one drive.

    With ``otherwise``, the vehicle that a calibration is of, the drives may be of any robots.

    Raises:
        RequestError: none named, or without ``otherwise`` drives of different robots, or one twice.
    """
    if not paths:
        raise RequestError("no drive given")
    groups: list[str] = []
    was_table = False
    for path in paths:
        is_table = path.lower().endswith(TABLES) and "," not in path
        if is_table and was_table:
            groups[-1] += "," + path
        else:
            groups.append(path)
        was_table = is_table
    drives = [load_drive(group, vehicle, bag, otherwise) for group in groups]
    if otherwise is None:
        _refuse_other_robots(drives)
        _refuse_twice(drives)
    return drives


def load_grounds(
    words: Sequence[str], vehicle: Vehicle | None = None, bag: BagOptions = AUTOMATIC
) -> dict[str, list[Drive]]:
    """Read drives by the ground they were driven on.

    Args:
        words: ``GROUND=DRIVE``, several of one ground if need be; a drive alone is a ground of its own name.
        vehicle: of the drives.
        bag: as in ``load_drive``.

    Raises:
        RequestError: a word without a ground or a drive, or drives of different robots.
    """
    grounds: dict[str, list[Drive]] = {}
    for word in words:
        ground, separator, path = word.rpartition("=")
        if separator and not (ground.strip() and path.strip()):
            raise RequestError(f"'{word}': give GROUND=DRIVE, such as grass=drives/monday")
        drive = load_drive(path, vehicle, bag)
        grounds.setdefault(ground.strip() or drive.name, []).append(drive)
    _refuse_other_robots([drive for drives in grounds.values() for drive in drives])
    return grounds


def _refuse_twice(drives: Sequence[Drive]) -> None:
    """A recording that counts twice makes sigmas too small, and is judged by itself."""
    first: dict[str, Drive] = {}
    for drive in drives:
        recording = drive.sha256 or drive.source
        if recording and recording in first:
            where = f"{first[recording].source} and {drive.source}"
            raise RequestError(f"{where}: are the same recording, which would count twice; leave one of them out")
        first[recording] = drive


def _refuse_other_robots(drives: Sequence[Drive]) -> None:
    widths = {d.vehicle.track_width for d in drives}
    if len(widths) > 1:
        named = ", ".join(f"{d.name}: {d.vehicle.name} {d.vehicle.track_width:g} m" for d in drives)
        raise RequestError(
            f"the drives are of different robots ({named}); calibrate them one by one, or give --vehicle"
        )
