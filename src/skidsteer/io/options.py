"""What the user may decide about reading a bag."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from skidsteer.errors import RequestError
from skidsteer.laser.plate import SIDES, Plate, Side

WHEEL_UNITS = ("rad", "rad/s", "m/s", "ticks")


@dataclass(frozen=True, slots=True)
class BagOptions:
    """Choices where the automatic ones do not fit. None leaves the choice to what the bag offers.

    ``wheels_topic`` may also be two topics of counters, floats or joint states, left and right, joined by a comma;
    ``wheels_unit`` says what the first two count. ``reference_topic`` may be ``/tf`` (or another topic of transforms).
    """

    wheels_topic: str | None = None
    reference_topic: str | None = None
    imu_topic: str | None = None
    command_topic: str | None = None
    left_joints: tuple[str, ...] = ()
    right_joints: tuple[str, ...] = ()
    wheel_signal: str | None = None  # "position" or "velocity" of JointState
    wheels_unit: str | None = None  # of a pair of wheel topics: one of WHEEL_UNITS
    base_frame: str | None = None
    map_frame: str | None = None
    separation: float | None = None  # [m] wheel separation in the robot's controller, for wheels from a twist
    separation_multiplier: float | None = None  # that was in force, for wheels from a twist
    plate: Plate | None = None  # on the robot, seen by a scanner beside the field: its scans are the reference

    def __post_init__(self) -> None:
        for name in ("separation", "separation_multiplier"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be a positive number, got {value}")
        if bool(self.left_joints) != bool(self.right_joints):
            raise ValueError("left_joints and right_joints must be given together")
        if self.wheel_signal not in (None, "position", "velocity"):
            raise ValueError(f"wheel_signal must be position or velocity, got {self.wheel_signal}")
        if self.wheels_unit not in (None, *WHEEL_UNITS):
            raise ValueError(f"wheels_unit must be one of {', '.join(WHEEL_UNITS)}, got {self.wheels_unit}")


AUTOMATIC = BagOptions()


def parse_options(words: Mapping[str, str | None]) -> BagOptions:
    """Options from the words of a command line; lists are joined by commas, None is left out.

    Raises:
        RequestError: an option that cannot be.
    """
    given: dict[str, Any] = {name: word for name, word in words.items() if word is not None}
    for name in ("left_joints", "right_joints"):
        if name in given:
            given[name] = tuple(given[name].split(","))
    if "plate" in given:
        given["plate"] = parse_plate(given["plate"])
    try:
        for name in ("separation", "separation_multiplier"):
            if name in given:
                given[name] = _number(name, given[name])
        return BagOptions(**given)
    except ValueError as error:
        typed = re.sub(
            "|".join(sorted(words, key=len, reverse=True)), lambda m: "--" + m[0].replace("_", "-"), str(error)
        )
        raise RequestError(typed) from error


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name} must be a positive number, got {text}") from None


def parse_plate(text: str) -> Plate:
    """A plate from ``WIDTH[,X,Y,YAW][,SIDE]``, lengths in m and yaw in rad.

    Raises:
        RequestError: it is none.
    """
    words = [word.strip() for word in text.split(",")]
    side = words.pop() if words[-1] in SIDES else None
    try:
        numbers = [float(word) for word in words]
        if len(numbers) not in (1, 4):
            raise ValueError(text)
    except ValueError as error:
        sides = "|".join(SIDES)
        raise RequestError(f"--plate takes WIDTH[,X,Y,YAW][,{sides}] in m and rad; got '{text}'") from error
    width, x, y, yaw = numbers if len(numbers) == 4 else (*numbers, 0.0, 0.0, 0.0)
    return Plate(width, x, y, yaw, cast("Side | None", side))
