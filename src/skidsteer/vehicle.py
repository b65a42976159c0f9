"""What is known of a robot before it has been driven: its measures and its factory settings."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from skidsteer.errors import RequestError


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Measures of a skid-steer robot, SI units. Fields that are None are unknown.

    ``track_width`` is the distance between the centre lines of the left and right wheels or tracks, the width an
    ideal differential drive would turn with. ``factory_multiplier`` is the correction of it that the robot ships with
    (``wheel_separation_multiplier`` of ROS), over ``factory_separation``, the width that correction is applied to.
    """

    name: str
    track_width: float  # [m] between wheel centre lines
    wheel_radius: float  # [m]
    wheels: int = 4
    wheel_base: float | None = None  # [m] first to last axle
    mass: float | None = None  # [kg]
    ticks_per_revolution: float | None = None  # encoder counts a wheel turn
    max_wheel_speed: float | None = None  # [m/s] at the rim
    factory_separation: float | None = None  # [m]
    factory_multiplier: float | None = None
    source: str = ""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("name", "source") or value is None:
                continue
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"vehicle {field.name} must be a positive number, got {value}")
        if self.wheels < 2:
            raise ValueError(f"vehicle wheels must be at least 2, got {self.wheels}")


PRESETS: dict[str, Vehicle] = {}


def preset(name: str) -> Vehicle:
    """The preset vehicle of that name.

    Raises:
        RequestError: no such preset; the message lists those there are.
    """
    if name not in PRESETS:
        raise RequestError(f"no vehicle preset '{name}'; there are: {', '.join(sorted(PRESETS))}, or give a YAML file")
    return PRESETS[name]
