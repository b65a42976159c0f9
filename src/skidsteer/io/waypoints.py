"""Waypoints of a path from a CSV file."""

from __future__ import annotations

import os

import numpy as np

from skidsteer.errors import DataError
from skidsteer.io.csv_table import numbers, read_table
from skidsteer.paths import Path, spline

CLOSE = 0.01  # [m] between first and last waypoint, within which the path is closed


def read_path(path: str | os.PathLike[str], closed: bool = False) -> Path:
    """A spline through the waypoints ``x, y`` [m] of a CSV file; closed if asked, or where the last one is the first.

    Raises:
        DataError: the file cannot be used, or no curve goes through its points.
    """
    points = numbers(read_table(path), ("x", "y"))
    meets = len(points) > 3 and float(np.hypot(*(points[-1] - points[0]))) < CLOSE
    try:
        return spline(points[:-1] if meets else points, closed or meets)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error
