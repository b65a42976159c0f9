"""Trajectories in the TUM format, as evo and others read them: ``t x y z qx qy qz qw`` a line, # for comments."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.drive import Series
from skidsteer.errors import DataError
from skidsteer.io import atomic, tf
from skidsteer.io.csv_table import Table
from skidsteer.io.text_file import decode, read_bytes, short
from skidsteer.se2 import FloatArray

_COLUMNS = 8


def read_tum(path: str | os.PathLike[str]) -> Series:
    """Read a trajectory: poses (m, 3) x [m], y [m], yaw [rad], the yaw unwrapped; times [s] as they stand.

    Raises:
        DataError: the file cannot be read, is empty, or a line of it is not eight finite numbers with a rotation.
    """
    _, t, poses = _parsed(path, read_bytes(path))
    return Series(t, poses, f"{path}")


def read_tum_table(path: str | os.PathLike[str]) -> Table:
    """Read a trajectory as a table of ``t, x, y, yaw`` without a header, whose lines are those of the file.

    Raises:
        DataError: as ``read_tum``, but for the order of times.
    """
    data = read_bytes(path)
    numbers, t, poses = _parsed(path, data)
    lines = [""] * numbers[-1]
    for number, row in zip(numbers, np.column_stack([t, poses]).tolist(), strict=True):
        lines[number - 1] = ",".join(map(repr, row))
    return Table(Path(path), data, lines, 0, ("t", "x", "y", "yaw"), ",")


def _parsed(path: str | os.PathLike[str], data: bytes) -> tuple[list[int], FloatArray, FloatArray]:
    """Numbers of the lines that hold poses, counted from 1, times (m,) and poses (m, 3)."""
    lines = [
        (number, cells)
        for number, line in enumerate(decode(path, data).splitlines(), start=1)
        if (cells := line.split("#")[0].replace(",", " ").split())
    ]
    if not lines:
        raise DataError(f"{path}: has no line 't x y z qx qy qz qw'")
    table = np.array([_numbers(path, number, cells) for number, cells in lines])
    transforms = tf.normalised(table[:, 1:])
    unturned = np.flatnonzero(~np.isfinite(transforms).all(axis=1))
    if unturned.size:
        raise DataError(f"{path}: line {lines[unturned[0]][0]} has a quaternion of length 0; delete that line")
    return [number for number, _ in lines], table[:, 0], tf.planar(transforms)


def _numbers(path: str | os.PathLike[str], number: int, cells: list[str]) -> FloatArray:
    if len(cells) != _COLUMNS:
        raise DataError(f"{path}: line {number} has {len(cells)} columns; need 8: t x y z qx qy qz qw")
    try:
        values = np.array([float(cell) for cell in cells])
    except ValueError:
        text = short(" ".join(cells))
        raise DataError(f"{path}: line {number} is not eight numbers ({text}); correct or delete it") from None
    if not np.isfinite(values).all():
        raise DataError(f"{path}: line {number} holds NaN or infinity; delete it")
    return values


def write_tum(path: str | os.PathLike[str], t: ArrayLike, poses: ArrayLike) -> None:
    """Write poses (m, 3) x [m], y [m], yaw [rad] at times t (m,) [s], in one step; z is 0. No poses make an empty file.

    Raises:
        ValueError: times and poses do not belong together.
        DataError: the file cannot be written.
    """
    t, poses = np.asarray(t, dtype=float), np.asarray(poses, dtype=float).reshape(-1, 3)
    if t.shape != (len(poses),):
        raise ValueError(f"need one time for each pose, got {t.shape} times and {len(poses)} poses")
    rows = zip(t.tolist(), tf.from_planar(poses).tolist(), strict=True)
    atomic.write_text(path, "".join(f"{time:.9f} {' '.join(map(repr, row))}\n" for time, row in rows))
