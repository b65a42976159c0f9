"""How far off a scanner may put the robot: the chain of bounds of Wang 2015, Eqs. (37)-(41).

The paper adds largest errors, each bound on its own. Eq. (41) is the error of the bearing of a single point at the
nearest distance, not that of a line through all points on the plate, which is what the method uses: see
`heading_sigma`.
"""

from __future__ import annotations

import math


def point_error(range_error: float, bearing_error: float, distance: float) -> float:
    """Bound [m] of the error of one coordinate of a point, as Eq. (37) has it: both terms at their largest.

    Args:
        range_error: [m].
        bearing_error: [rad].
        distance: [m] of the farthest point.
    """
    return range_error + distance * bearing_error


def least_point_error(range_error: float, bearing_error: float, distance: float) -> float:
    """The least bound [m] in place of Eq. (37), whose two terms are largest at bearings a quarter turn apart."""
    return math.hypot(range_error, distance * bearing_error)


def motion_error(speed: float, interval: float) -> float:
    """Eq. (38): way [m] of the robot at ``speed`` [m/s] in the ``interval`` [s] of a scan."""
    return speed * interval


def bearing_error(point: float, distance: float) -> float:
    """Bound [rad] of the error of a point's bearing, as Eq. (41) has it.

    Both partial derivatives are added, (|x| + |y|) / (x^2 + y^2) being at most sqrt(2) / distance. (Printed with the
    derivative by x twice; the second is by y.)

    Args:
        point: [m] error of each of its coordinates, Eq. (39): of the ranges and of the motion.
        distance: [m] of the nearest point.
    """
    return math.sqrt(2.0) * point / distance


def heading_sigma(range_sigma: float, width: float, points: int, slant: float = 0.0) -> float:
    """Standard deviation [rad] of the heading of a line through evenly spread points on a plate.

    Noise along the rays is cos(slant) of itself across the plate; the points scatter along it by width / sqrt(12).

    Args:
        range_sigma: [m] of one range.
        width: [m] of the plate; small beside its distance.
        points: on it.
        slant: [rad] between the rays and the normal of the plate.
    """
    return range_sigma * math.cos(slant) * math.sqrt(12.0 / points) / width
