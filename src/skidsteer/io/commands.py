"""Commands to play to a plant: from a CSV file, or from manoeuvres written in one line."""

from __future__ import annotations

import os

import numpy as np

from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.io.csv_table import numbers, read_table
from skidsteer.io.text_file import short
from skidsteer.simulate import controller, rims_from_manoeuvres
from skidsteer.vehicle import Vehicle

LONGEST = 86400.0  # [s] of manoeuvres
RIMS, BODY = ("v_left", "v_right"), ("v", "omega")


def read_commands(path: str | os.PathLike[str], vehicle: Vehicle) -> Series:
    """Rim speeds (n, 2) [m/s] from a CSV file with ``t`` [s] and ``v_left, v_right`` or else ``v, omega``.

    The latter become rim speeds as the robot's own controller makes them, by its factory width.

    Raises:
        DataError: the file cannot be used.
    """
    table = read_table(path)
    names = BODY if set(table.header) >= set(BODY) and not set(table.header) >= set(RIMS) else RIMS
    values = numbers(table, ("t", *names))
    speeds = values[:, 1:] if names == RIMS else controller(vehicle).wheel_speeds(*values[:, 1:].T)
    return Series(values[:, 0], speeds, str(path))


def parse_manoeuvres(text: str, vehicle: Vehicle) -> Series:
    """Rim speeds (n, 2) [m/s] at 100 Hz from ``DURATION,V,OMEGA:...`` [s, m/s, rad/s], between ramps of 0.6 m/s^2.

    Raises:
        RequestError: not three finite numbers each, a duration that is not above 0, or more than a day.
    """
    try:
        rows = np.array([[float(word) for word in row.split(",")] for row in text.strip().strip(":").split(":")])
        fits = rows.ndim == 2 and rows.shape[1] == 3 and bool(np.isfinite(rows).all() and (rows[:, 0] > 0.0).all())
    except ValueError:
        fits = False
    if not fits:
        raise RequestError(
            f"manoeuvres {short(text)}: write DURATION,V,OMEGA:... in s, m/s, rad/s, such as 8,0.4,0:6,0,0.8"
        )
    if (lasts := float(rows[:, 0].sum())) > LONGEST:
        raise RequestError(f"manoeuvres {short(text)}: {lasts:.3g} s are more than a day; durations are in s")
    return rims_from_manoeuvres(rows, controller(vehicle))
