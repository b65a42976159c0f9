"""What is known of a robot before it has been driven: its measures and its factory settings."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from numbers import Real

from skidsteer.errors import RequestError


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Measures of a skid-steer robot, SI units. Fields that are None are unknown.

    ``track_width`` is the distance between the centre lines of the left and right wheels or tracks, the width an
    ideal differential drive would turn with. ``factory_multiplier`` is the correction of it that the robot ships with
    (``wheel_separation_multiplier`` of ROS), over ``factory_separation``, the width that correction is applied to.

    Raises:
        ValueError: a measure that is not a positive finite number, or fewer than two wheels.
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
    source: str = ""  # where the numbers come from

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("name", "source") or value is None:
                continue
            is_number = isinstance(value, Real) and not isinstance(value, bool)
            if not (is_number and 0 < value < math.inf):
                raise ValueError(f"vehicle {field.name} must be a positive number, got {value}")
        if self.wheels < 2:
            raise ValueError(f"vehicle wheels must be at least 2, got {self.wheels}")


def _presets(*vehicles: Vehicle) -> dict[str, Vehicle]:
    return {vehicle.name: vehicle for vehicle in vehicles}


# Compared with the vendors' published ROS configurations (clearpath_common, husky, husarion_ugv_ros, scout_ros,
# summit_xl_common). The limits that these set to commands are settings rather than measures, and left out: for a Husky
# 3 m/s^2 and 6 rad/s^2 in ROS 1, 1 m/s^2 and 1 rad/s^2 in ROS 2; a Jackal 20 m/s^2, a Warthog 50 m/s^2, a Panther
# 2.7 m/s^2, a Summit XL 3 m/s^2 (and 1.5 m/s, half of what its wheels reach).
PRESETS: dict[str, Vehicle] = _presets(
    Vehicle(
        "pioneer-p3at",
        track_width=0.40,
        wheel_radius=0.11,
        wheel_base=0.27,
        mass=23.6,
        max_wheel_speed=0.69,
        factory_separation=0.40,
        factory_multiplier=1.5,
        source="Mandow 2007, section IV: pneumatic tyres, one wheel turn a second, factory x_ICR 0.3 m",
    ),
    Vehicle(
        "rover-4wd1",
        track_width=0.28,
        wheel_radius=0.06,
        source="Giannoccaro 2015: wheels of 120 mm; the track follows from its Table 3",
    ),
    Vehicle(
        "summit-xl",
        track_width=0.462,
        wheel_radius=0.11,
        wheel_base=0.458,
        mass=51.0,
        max_wheel_speed=3.0,
        source="Robotnik summit_xl_common, summit_xl_skid_control.yaml (wheels at most 27.27 rad/s) and URDF (mass of"
        " body and wheels)",
    ),
    Vehicle(
        "husky-a200",
        track_width=0.5708,
        wheel_radius=0.1651,
        wheel_base=0.512,
        mass=50.0,
        ticks_per_revolution=80_913.0,
        max_wheel_speed=1.0,
        factory_separation=0.555,
        factory_multiplier=1.875,
        source="clearpath_common, a200 control.yaml and URDF; Husky A200 user manual (50 kg, 78000 ticks/m, 1 m/s)",
    ),
    Vehicle(
        "jackal",
        track_width=0.37559,
        wheel_radius=0.098,
        wheel_base=0.262,
        mass=18.4,
        max_wheel_speed=2.0,
        factory_separation=0.37559,
        factory_multiplier=1.5,
        source="clearpath_common, j100 control.yaml and URDF (mass of chassis and wheels); Jackal user manual (2 m/s)",
    ),
    Vehicle(
        "warthog",
        track_width=1.1364,
        wheel_radius=0.30,
        wheel_base=0.9147,
        mass=280.0,
        max_wheel_speed=5.0,
        factory_separation=1.5,
        factory_multiplier=1.125,
        source="clearpath_common, w200 control.yaml and URDF; Warthog user manual (280 kg, 18 km/h)",
    ),
    Vehicle(
        "scout-2.0",
        track_width=0.58306,
        wheel_radius=0.165,
        wheel_base=0.498,
        max_wheel_speed=1.5,
        source="AgileX scout_ros, scout_params.hpp",
    ),
    Vehicle(
        "panther",
        track_width=0.697,
        wheel_radius=0.1825,
        wheel_base=0.44,
        mass=55.0,
        ticks_per_revolution=48_128.0,
        max_wheel_speed=2.0,
        factory_separation=0.697,
        factory_multiplier=1.5,
        source="Husarion panther_ros, WH01_controller.yaml and URDF (mass of body and wheels; 1600 counts, gear 30.08)",
    ),
)


def preset(name: str) -> Vehicle:
    """The preset vehicle of that name; a leading ``clearpath-`` and capitals are accepted.

    Raises:
        RequestError: no such preset; the message lists those there are.
    """
    key = name.lower().removeprefix("clearpath-")
    if key not in PRESETS:
        raise RequestError(f"no vehicle preset '{name}'; there are: {', '.join(sorted(PRESETS))}, or give a YAML file")
    return PRESETS[key]
