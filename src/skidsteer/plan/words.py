"""Plans from the options of the command line."""

from __future__ import annotations

import os

from skidsteer.errors import RequestError
from skidsteer.identify.circle_test import runs_on
from skidsteer.io.calibration_file import load_calibration
from skidsteer.io.circle_runs import circle_table
from skidsteer.io.folder import vehicle as find_vehicle
from skidsteer.plan.driver import Driver
from skidsteer.plan.outline import Rectangle
from skidsteer.plan.slip_table import SlipTable


def rectangle(word: str, name: str) -> Rectangle:
    """Two lengths [m] written as LxW.

    Raises:
        RequestError: not two positive lengths.
    """
    try:
        length, width = (float(side) for side in word.lower().split("x"))
    except ValueError:
        raise RequestError(f"--{name} {word!r} is not two lengths in m; write it as 0.70x1.25") from None
    return Rectangle(length, width, name)


def driver_of(
    calibration: str | os.PathLike[str] | None, circles: str | None, vehicle: str | None, profile: str | None
) -> Driver:
    """The driver: by a calibration file, or by the slip ratios of circle runs.

    Args:
        calibration: its path.
        circles: CSV file or sample of circle runs.
        vehicle: name or file, of the circle runs; None: beside them.
        profile: of the calibration, or surface of the circle runs.

    Raises:
        DataError: a file that cannot be used.
        RequestError: both or none of them, a vehicle beside a calibration, a file that is no such table, or no such
            profile or surface.
    """
    if (calibration is None) == (circles is None):
        raise RequestError("give either --calibration FILE or --circles TABLE")
    if calibration is not None:
        if vehicle is not None:
            raise RequestError("--vehicle is of circle runs; a calibration knows its own: leave it out")
        return Driver.of(load_calibration(calibration).profile(profile))
    table = circle_table([circles or ""], None if vehicle is None else find_vehicle(vehicle))
    if table is None:
        raise RequestError(f"--circles {circles}: no table of circle runs; it needs a column radius, and no clock")
    there = list(dict.fromkeys(run.surface for run in table.runs))
    if profile is None and len(there) > 1:
        raise RequestError(f"the circle runs are of several surfaces; add --profile with one of {', '.join(there)}")
    runs = table.runs if profile is None else runs_on(table.runs, profile)
    return Driver.of_circles(SlipTable(runs, table.vehicle.track_width), table.vehicle)
