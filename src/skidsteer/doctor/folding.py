"""Long pauses of the whole log cut short, so that a clock set forward by years does not make a grid of years."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.se2 import FloatArray

LONGEST = 60.0  # [s] that a pause of all sensors keeps
BEYOND = 1e6  # [s] that times may lie before the first and after the last sample
PARTS = ("wheels", "pose", "position", "gyro", "command", "wheel_command")


@dataclass(frozen=True, slots=True, eq=False)
class Folding:
    """A clock without long pauses: knots (n,) [s] of the recorded and of the folded one, straight lines between."""

    recorded: FloatArray
    folded: FloatArray

    def fold(self, t: FloatArray) -> FloatArray:
        """Folded times of recorded ones."""
        return np.asarray(np.interp(t, self.recorded, self.folded))

    def unfold(self, t: float) -> float:
        """The recorded time of a folded one."""
        return float(np.interp(t, self.folded, self.recorded)) if len(self.folded) else t


def fold(drive: Drive) -> tuple[Drive, Folding]:
    """The drive with pauses of all its sensors cut to ``LONGEST``, and the way back; mostly the drive itself."""
    parts = {name: series for name in PARTS if (series := getattr(drive, name)) is not None}
    t = np.unique(np.concatenate([s.t for name, s in parts.items() if "command" not in name]))
    long = np.flatnonzero(np.diff(t) > LONGEST)
    if not len(long):
        return drive, Folding(np.zeros(0), np.zeros(0))
    removed = np.repeat(np.r_[0.0, np.cumsum(np.diff(t)[long] - LONGEST)], 2)
    knots = np.r_[t[0] - BEYOND, np.stack([t[long], t[long + 1]], axis=-1).ravel(), t[-1] + BEYOND]
    folding = Folding(knots, knots - removed)
    shorter: dict[str, Any] = {name: _folded(series, folding) for name, series in parts.items()}
    if drive.segments is not None:
        shorter["segments"] = folding.fold(drive.segments)
    return replace(drive, **shorter), folding


def _folded(series: Series, folding: Folding) -> Series:
    """The series on the folded clock; commands within a pause may fall together there, then the first one stays."""
    t = folding.fold(series.t)
    first = np.r_[True, np.diff(t) > 0]
    return Series(t[first], series.values[first], series.name)
