"""The two integers by which a Pioneer P3-AT is calibrated, Mandow 2007, Section IV.B: Ticksmm and Revcount.

Eq. (14) is printed upside down. Ticksmm is the number of encoder ticks for a millimetre of travel, and the robot
divides by it: a wheel that travels alpha * r for each radian makes 138 * 110 / (alpha * r) ticks a millimetre, fewer
for a larger wheel. As printed, round(alpha * r * 138 / 110), a robot with alpha = 0.9 would be told to report 1 / 0.9
of the nominal distance where it should report 0.9 of it. Both agree for the pneumatic wheel and alpha = 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from skidsteer.models import SymmetricIcr

TICKS_MM = 138  # factory value of Ticksmm, for the pneumatic wheel
WHEEL_RADIUS = 0.110  # [m] of the pneumatic wheel
REVCOUNT_SCALE = 8  # Revcount counts in units of 8 ticks, Eq. (15)


@dataclass(frozen=True, slots=True)
class P3at:
    """Ticksmm: encoder ticks for a millimetre of travel. Revcount: an eighth of the ticks for a turn on the spot."""

    ticksmm: int
    revcount: int

    def __post_init__(self) -> None:
        if self.ticksmm < 1 or self.revcount < 1:
            raise ValueError(f"need ticksmm and revcount of at least 1, got {self.ticksmm}, {self.revcount}")


def ticksmm(alpha: float, wheel_radius: float = WHEEL_RADIUS) -> int:
    """Mandow 2007, Eq. (14), corrected (see above).

    Args:
        alpha: true over nominal rim speed.
        wheel_radius: [m] nominal, the one that the rim speeds were computed with.
    """
    return round(
        TICKS_MM
        * _positive(WHEEL_RADIUS, "wheel_radius")
        / (_positive(alpha, "alpha") * _positive(wheel_radius, "wheel_radius"))
    )


def printed_ticksmm(alpha: float, wheel_radius: float = WHEEL_RADIUS) -> int:
    """Mandow 2007, Eq. (14), as printed: for comparison with the paper, not for a robot."""
    return round(_positive(alpha, "alpha") * _positive(wheel_radius, "wheel_radius") * TICKS_MM / WHEEL_RADIUS)


def revcount(icr_y: float, ticks: int) -> int:
    """Mandow 2007, Eq. (15), for icr_y [m] and Ticksmm; the paper's x_ICR has to be put in in mm."""
    return round(2.0 * math.pi * 1e3 * _positive(icr_y, "icr_y") * ticks / REVCOUNT_SCALE)


def from_model(model: SymmetricIcr, wheel_radius: float = WHEEL_RADIUS) -> P3at:
    """The integers for a symmetric model of a robot with that nominal wheel radius [m]."""
    ticks = ticksmm(model.alpha, wheel_radius)
    return P3at(ticks, revcount(model.icr_y, ticks))


def _positive(value: float, name: str) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"need {name} > 0, got {value}")
    return value
