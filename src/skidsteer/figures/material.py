"""What figures are drawn from: a calibration, and drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.drive import Drive
from skidsteer.errors import DataError, RequestError
from skidsteer.report.reckoner import Reckoner, reckoners

LEAST_ROLLED = 1.0  # [m] by a side, for a part of a drive to be worth fitting


@dataclass(frozen=True, slots=True)
class Material:
    """Everything that a figure may need."""

    calibration: Calibration
    drives: tuple[Drive, ...] = ()
    restart: float = 0.0  # [s] after which dead reckoning begins anew at the reference; 0: never
    window: float = 2.0  # [s] of the judging windows

    def needed(self, figure: str) -> tuple[Drive, ...]:
        """The drives, with reference poses.

        Raises:
            RequestError: there is none.
        """
        drives = tuple(drive for drive in self.drives if drive.pose is not None)
        if not drives:
            raise RequestError(f"figure '{figure}' shows a drive with reference poses: give one with --drive DRIVE")
        return drives

    def reckoners(self, figure: str) -> tuple[Reckoner, ...]:
        """How each of these drives is predicted: held out, where the calibration was made from them.

        Raises:
            RequestError: there is none.
        """
        return reckoners(self.calibration, self.needed(figure))


def parse_part(text: str) -> tuple[float, float]:
    """Two times [s] from ``A,B``.

    Raises:
        RequestError: not two numbers.
    """
    try:
        start, end = (float(word) for word in text.split(","))
    except ValueError as error:
        raise RequestError(f"--show wants two times A,B in s, got '{text}'") from error
    return start, end


def parted(drives: Sequence[Drive], start: float, end: float) -> tuple[tuple[Drive, ...], tuple[Drive, ...]]:
    """The part of drives between two times [s] after their beginning, and the rest, in which the robot moves.

    Raises:
        RequestError: nothing is left on one of the two sides.
    """
    if not start < end:
        raise RequestError(f"need a part from an earlier to a later time [s], got {start:g} to {end:g}")
    shown, rest = [], []
    for drive in drives:
        first, last = drive.span
        name = f"{drive.name}, {start:g} to {end:g} s"  # not the drive that the rest is of
        shown += [replace(part, name=name) for part in _moving(drive, first + start, first + end)]
        rest += [*_moving(drive, first, first + start), *_moving(drive, first + end, last)]
    if not (shown and rest):
        where = "inside" if not shown else "outside"
        raise RequestError(f"the robot does not move {where} of {start:g} to {end:g} s: choose another part")
    return tuple(shown), tuple(rest)


def _moving(drive: Drive, start: float, end: float) -> list[Drive]:
    try:
        part = drive.between(start, end)
    except DataError:
        return []
    rolled = np.abs(part.wheels.values[:-1]).max(axis=1, initial=0.0) @ np.diff(part.wheels.t)
    return [part] if rolled >= LEAST_ROLLED and part.reference is not None else []


def held_out(known: Sequence[Reckoner]) -> str:
    """What a label says of predictions: ", held out" where none was fitted to what it predicts."""
    return ", held out" if all(one.is_held_out for one in known) else ""
