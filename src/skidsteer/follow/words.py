"""What a command line says of a closed loop, read; and what came of one, in sentences."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Sequence

from skidsteer.calibration import Calibration
from skidsteer.errors import RequestError, printable
from skidsteer.evaluation import differ, measures
from skidsteer.follow.run import Run, Summary
from skidsteer.follow.sensing import Jump, Triple
from skidsteer.follow.task import Task
from skidsteer.io.open_bag import is_bag
from skidsteer.io.vehicle_file import vehicle
from skidsteer.io.waypoints import read_path
from skidsteer.paths import Path, lemniscate, line, stadium
from skidsteer.vehicle import Vehicle, preset

log = logging.getLogger(__name__)

USUAL = "summit-xl"  # robot of Huskić 2017
LAP = 110.77 / 5.0  # [m] of the lemniscate of Huskić 2017, V.B
FAR = 1e6  # [m] no start is farther away
SHAPES: dict[str, tuple[float, Callable[[float], Path]]] = {  # size [m] unless it is told, and what it is the size of
    "lemniscate": (LAP / lemniscate(1.0).length, lemniscate),  # from end to end
    "stadium": (10.0, lambda size: stadium(size, 0.25 * size)),  # its straights; the radius is a quarter of them
    "line": (20.0, line),
}


def course(name: str, size: float | None = None, closed: bool = False, topic: str | None = None) -> Path:
    """A path of ``SHAPES``, or one through waypoints.

    Args:
        name: of ``SHAPES``, or of a file.
        size: [m] of a path of ``SHAPES``: from end to end, or of its straights; None: its usual one.
        closed: waypoints go on from the last to the first.
        topic: of the waypoints in a bag.

    Raises:
        DataError: a file that cannot be used.
        RequestError: no such path or file, a size that is not positive, or one of the others where it is of no use.
    """
    if name in SHAPES:
        if closed or topic is not None:
            raise RequestError(
                f"--{'closed' if closed else 'topic'} is of waypoints in a file; leave it out of a {name}"
            )
        usual, make = SHAPES[name]
        return make(usual if size is None else size)
    if not os.path.exists(name):
        raise RequestError(
            f"no path '{name}'; there are: {', '.join(SHAPES)}, or give a CSV file with columns x, y, or a bag"
        )
    if size is not None:
        raise RequestError("--size is of a lemniscate, stadium or line; waypoints are driven as they are: leave it out")
    if topic is not None and not is_bag(name):
        raise RequestError(f"--topic is of a bag, and {name} is none: leave it out")
    return read_path(name, closed, topic)


def driven(name: str | None, known: Calibration | None) -> Vehicle:
    """The robot to drive; None: that of the calibration, or ``USUAL``. A calibration of another one is logged.

    Raises:
        RequestError: neither a preset nor a file.
        DataError: the file is not a vehicle.
    """
    if name is None:
        return preset(USUAL) if known is None else known.vehicle
    robot = vehicle(name)
    if known is not None and differ(robot, known.vehicle):
        log.warning("Note: the calibration is of %s, but %s is driven.", measures(known.vehicle), measures(robot))
    return robot


def parse_jumps(text: str) -> tuple[Jump, ...]:
    """Leaps of the localization: ``LEFT@S`` or ``AHEAD/LEFT/TURN@S``; in place of seconds a share of the way, ``50%``.

    Raises:
        RequestError: something else.
    """
    return tuple(_jump(word.strip()) for word in text.split(",")) if text.strip() else ()


def _jump(word: str) -> Jump:
    size, at, when = word.partition("@")
    try:
        if not at:
            raise ValueError
        ahead, left, turn = [float(part) for part in (size if "/" in size else f"0/{size}/0").split("/")]
        if when.endswith("%"):
            return Jump(left, ahead, turn, share=0.01 * float(when[:-1]))
        return Jump(left, ahead, turn, time=float(when))
    except ValueError:
        raise RequestError(
            f"jump '{word}': write METRES@SECONDS or METRES@PERCENT%, such as 0.886@20 or 0.886@50% to the left, or"
            " AHEAD/LEFT/RADIANS@SECONDS"
        ) from None


def parse_spans(text: str) -> tuple[tuple[float, float], ...]:
    """Times without poses [s], such as ``8-9,20-20.5``.

    Raises:
        RequestError: something else.
    """
    words = [word.strip().partition("-") for word in text.split(",")] if text.strip() else []
    try:
        return tuple((float(start), float(end)) for start, _, end in words)
    except ValueError:
        raise RequestError(f"times without poses '{text}': write FROM-TO in s, such as 8-9,20-20.5") from None


def parse_start(text: str) -> Triple:
    """A start ``X,Y`` or ``X,Y,YAW`` [m, rad].

    Raises:
        RequestError: something else.
    """
    try:
        x, y, yaw = [float(word) for word in (text if text.count(",") == 2 else f"{text},0").split(",")]
        if not max(abs(x), abs(y), abs(yaw)) < FAR:
            raise ValueError
    except ValueError:
        raise RequestError(f"start '{text}': write X,Y or X,Y,YAW in m and rad, such as 0,0.5,0.3") from None
    return x, y, yaw


def sentences(task: Task, run: Run, found: Summary) -> Sequence[str]:
    """What was driven, by whom, and how well."""
    laps = f", {found.laps:.2f} laps" if run.path.closed else ""
    energy = "" if found.energy is None else f", {found.energy:.0f} J by the rims"
    limit = task.wheels.max_speed
    told = (
        f"{task.vehicle.name} on {task.plant}, by {task.law}: {found.outcome}; {found.reason}.",
        f"believed: {task.belief.model.NAME}, from {task.belief.source}",
        f"driven: {found.way:.2f} m of the path in {found.duration:.2f} s{laps}; mean speed {found.speed:.2f} m/s",
        f"cross-track error: mean {100.0 * found.mean:.1f} cm, largest {100.0 * found.largest:.1f} cm,"
        f" RMS {100.0 * found.rms:.1f} cm; heading RMS {math.degrees(found.heading_rms):.1f} deg",
        f"wheels: fastest {found.fastest:.2f} of {limit:g} m/s, effort {found.effort:.2f} m/s^2{energy}",
    )
    return tuple(map(printable, told))
