"""Integer commands for the speeds of both sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.errors import RequestError
from skidsteer.se2 import FloatArray


@dataclass(frozen=True, slots=True)
class Encoding:
    """Rim speed = ``slope`` k + ``offset`` [m/s] for whole k from ``least`` to ``most``; 0 is rest."""

    slope: float  # [m/s]
    offset: float  # [m/s]
    least: int
    most: int
    source: str = ""

    def speeds(self, k: tuple[int, int]) -> FloatArray:
        """Rim speeds (2,) [m/s]."""
        return np.array([self.slope * i + self.offset if i else 0.0 for i in k])

    def nearest(self, rims: FloatArray) -> tuple[int, int]:
        """The integers whose speeds are nearest to rim speeds (2,) [m/s].

        Raises:
            RequestError: a speed out of their range.
        """
        k = [round((float(v) - self.offset) / self.slope) for v in rims]
        for i, v, side in zip(k, rims.tolist(), ("left", "right"), strict=True):
            if not self.least <= i <= self.most:
                low, high = (self.slope * end + self.offset for end in (self.least, self.most))
                raise RequestError(
                    f"the {side} side is asked for {v:.3f} m/s, k = {i}, but its commands go from k = {self.least}"
                    f" ({low:.3f} m/s) to {self.most} ({high:.3f} m/s); change --speed, --curve-speed or --radius"
                )
        return k[0], k[1]


# Giannoccaro 2015, Table 1 [m/s], without k = 80, which lies off the line (see ``reproduce``); k below 5 does not move
# the robot. Its calibration ends in the text, 0.02 m/s at 5 and 1.3 m/s at 125, lie 0.019 and 0.014 m/s off this line.
ROVER_COMMANDS = {20: 0.191, 40: 0.410, 60: 0.632, 100: 1.059, 120: 1.249}


def _rover() -> Encoding:
    slope, offset = np.polyfit(list(ROVER_COMMANDS), list(ROVER_COMMANDS.values()), 1)
    return Encoding(float(slope), float(offset), 5, 127, "Giannoccaro 2015, Table 1, a line through all but k = 80")


ENCODINGS: dict[str, Encoding] = {"rover-4wd1": _rover()}  # by the name of the vehicle
