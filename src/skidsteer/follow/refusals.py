"""What cannot be driven, told before the robot moves."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.control import Wheels, icr_x_at
from skidsteer.control.path_state import STEEPEST
from skidsteer.errors import RequestError
from skidsteer.paths import Path

CRAWL = 0.05  # [m/s] slower than which no wheels should have to drive a curve
BEYOND = 0.3  # [m] past the end of a path, from which on nothing of it is left to drive
SLOW = 0.3  # [m/s] at which a model tells where its ICR is


def refuse_path(path: Path, wheels: Wheels) -> None:
    """Refuse curves that a robot cannot drive, by what is believed of it.

    Raises:
        RequestError: a curve that the wheels can only crawl around, or so tight that no heading keeps the origin on it.
    """
    s, curvature = sharpest(path)
    tightest = curvature[np.argmax(np.abs(curvature))]
    for at, c in zip(s.tolist(), curvature.tolist(), strict=True):
        if c and (speed := wheels.reachable(c)) < CRAWL:
            raise RequestError(
                f"the path has a radius of {1.0 / abs(c):.3g} m at {at:.2f} m, where wheels of {wheels.max_speed:g} m/s"
                f" drive {speed:.2g} m/s; widen that curve"
            )
    icr_x = abs(icr_x_at(wheels.model, SLOW)) if tightest else 0.0
    if icr_x * abs(tightest) >= STEEPEST:
        at = s[np.argmax(np.abs(curvature))]
        raise RequestError(
            f"the path has a radius of {1.0 / abs(tightest):.3g} m at {at:.2f} m, but the robot turns about a point"
            f" {icr_x:.3g} m ahead or behind its origin: no heading keeps the origin there; widen that curve to"
            f" {icr_x / STEEPEST:.2f} m"
        )


def sharpest(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Where the path turns most to the left and to the right: s (2,) [m] and curvature (2,) [1/m] there."""
    rows = path.knots[:-1]
    length = np.diff(path.knots[:, 0])
    s = np.concatenate([rows[:, 0], path.knots[1:, 0]])
    curvature = np.concatenate([rows[:, 4], rows[:, 4] + rows[:, 5] * length])
    ends = [int(curvature.argmax()), int(curvature.argmin())]
    return s[ends], curvature[ends]


def refuse_start(path: Path, start: ArrayLike, off: float) -> None:
    """Refuse a start (3,) farther from the path than ``off`` [m], or beyond its end.

    Raises:
        RequestError: it is.
    """
    x, y, _ = np.asarray(start, dtype=float).tolist()
    s = path.project((x, y))
    at = path.frame(s)
    ahead = math.cos(at.yaw) * (x - at.x) + math.sin(at.yaw) * (y - at.y)
    if not path.closed and s == path.length and ahead > BEYOND:
        raise RequestError(
            f"the start ({x:g}, {y:g}) is {ahead:.2f} m beyond the end of the path; begin before it, or drive the path"
            " the other way"
        )
    if (distance := math.hypot(x - at.x, y - at.y)) > off:
        raise RequestError(
            f"the start ({x:g}, {y:g}) is {distance:.2f} m off the path, more than {off:g} m; begin nearer to it, or"
            " allow to be farther off"
        )
