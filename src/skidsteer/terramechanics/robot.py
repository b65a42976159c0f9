"""A robot as the ground feels it: positions and loads of the wheels, limits of the motors."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import RequestError
from skidsteer.kernels.ground import GRAVITY
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle, preset

SIDES = ("left", "right")


@dataclass(frozen=True, slots=True)
class Robot:
    """Properties that determine the forces. The wheels of a side turn together; axles are evenly spaced.

    The origin lies in the middle of all wheels, on the ground.

    Raises:
        RequestError: a measure that cannot be, or a centre of mass that lifts a wheel off at rest.
    """

    vehicle: Vehicle
    mass: float  # [kg]
    yaw_inertia: float  # [kg m^2] about the centre of mass
    patch_length: float  # [m] of the contact of each wheel
    patch_width: float  # [m]
    com_x: float = 0.0  # [m] centre of mass ahead of the origin
    com_y: float = 0.0  # [m] to the left of it
    com_height: float = 0.0  # [m] above the ground
    lag: float = 0.1  # [s] of the speed control of the wheels; 0: none, as far as the torque suffices
    torque_limit: float = math.inf  # [N m] of the wheels of one side together
    wheel_inertia: float = 0.02  # [kg m^2] of the wheels of one side together, their motor included

    def __post_init__(self) -> None:
        for name in ("mass", "yaw_inertia", "patch_length", "patch_width", "torque_limit", "wheel_inertia"):
            if not getattr(self, name) > 0.0:
                raise RequestError(f"robot {self.vehicle.name}: {name} must be above 0, got {getattr(self, name)}")
        for name in ("com_height", "lag"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise RequestError(f"robot {self.vehicle.name}: {name} must be at least 0, got {getattr(self, name)}")
        if not all(map(math.isfinite, (self.mass, self.yaw_inertia, self.com_x, self.com_y))):
            raise RequestError(f"robot {self.vehicle.name}: mass, yaw_inertia, com_x and com_y must be finite")
        if self.vehicle.wheels % 2 or self.vehicle.wheel_base is None or self.vehicle.wheels < 4:
            raise RequestError(f"robot {self.vehicle.name}: needs an even number of wheels from 4 on, and a wheel_base")
        if self.patch_length >= self.axles[0] - self.axles[1]:
            raise RequestError(f"robot {self.vehicle.name}: patches of {self.patch_length} m overlap along the robot")
        if self.loads().min() < 0.0:
            raise RequestError(
                f"robot {self.vehicle.name}: a wheel is off the ground at rest; bring the centre of mass"
                f" ({self.com_x}, {self.com_y}) m nearer to the middle of the wheels"
            )

    @property
    def axles(self) -> FloatArray:
        """Positions x [m] of the axles, front first."""
        half = 0.5 * (self.vehicle.wheel_base or 0.0)
        return np.linspace(half, -half, self.vehicle.wheels // 2)

    @property
    def places(self) -> FloatArray:
        """Middle of the patch of each wheel (w, 2) [m]: the left side from front to rear, then the right side."""
        y = np.repeat([0.5, -0.5], len(self.axles)) * self.vehicle.track_width
        return np.column_stack([np.tile(self.axles, 2), y])

    @property
    def side(self) -> np.ndarray:
        """0 for each wheel (w,) of the left side, 1 for the right one."""
        return np.repeat([0, 1], len(self.axles))

    def load_slopes(self) -> FloatArray:
        """Derivative (w, 2) [kg] of the loads with respect to the acceleration of the centre of mass along x and y."""
        x, y = self.places.T
        return np.asarray(-self.mass * self.com_height * np.column_stack([x / (x @ x), y / (y @ y)]))

    def loads(self, acceleration: ArrayLike = (0.0, 0.0)) -> FloatArray:
        """Load (..., w) [N] of each wheel, as on springs of equal stiffness: linear in the position of the wheel.

        Args:
            acceleration: (..., 2) [m/s^2] of the centre of mass, in the frame of the body; default: at rest.
        """
        x, y = self.places.T
        lever = self.com_x * x / (x @ x) + self.com_y * y / (y @ y)
        at_rest = self.mass * GRAVITY * (1.0 / len(x) + lever)
        return np.asarray(at_rest + np.asarray(acceleration, dtype=float) @ self.load_slopes().T)

    def name_of(self, wheel: int) -> str:
        """Such as 'left wheel 1' for the one in front on the left."""
        return f"{SIDES[self.side[wheel]]} wheel {wheel % len(self.axles) + 1}"


def robot(vehicle: Vehicle, **measures: Any) -> Robot:
    """The robot of a vehicle; what is neither known of the vehicle nor given is assumed.

    Assumed are a contact patch a third of the wheel's radius long and half of it wide, a centre of mass at the height
    of the axles, the yaw inertia of a homogeneous box around the wheels, and a torque that just spins the wheels where
    friction is 1.

    Args:
        vehicle: with a wheel base, and a mass unless that is given.
        measures: fields of `Robot`.

    Raises:
        RequestError: mass or wheel base are not known, or a measure cannot be.
    """
    mass = measures.pop("mass", vehicle.mass)
    if mass is None or vehicle.wheel_base is None:
        missing = "mass" if mass is None else "wheel_base"
        raise RequestError(f"vehicle {vehicle.name} has no {missing}; give it in a vehicle file")
    r = vehicle.wheel_radius
    length, width = vehicle.wheel_base + 2.0 * r, vehicle.track_width + 0.5 * r
    assumed = {
        "yaw_inertia": mass * (length**2 + width**2) / 12.0,
        "patch_length": r / 3.0,
        "patch_width": r / 2.0,
        "com_height": r,
        "torque_limit": 0.5 * mass * GRAVITY * r,
    }
    return Robot(vehicle, mass, **(assumed | measures))


def wang_robot(
    outer: float = 0.31, inner: float = 0.24, patch_width: float = 0.05, mass: float = 31.0, **measures: Any
) -> Robot:
    """The Pioneer P3-AT of Wang 2015, Table 1, without load transfer as there.

    Args:
        outer: [m] L, between the outer edges of front and rear patches.
        inner: [m] C, between their inner edges; the patches are (L - C) / 2 long, the axles (L + C) / 2 apart.
        patch_width: [m] b.
        mass: [kg].
        measures: other fields of `Robot`.

    Raises:
        RequestError: L is not above C, or a measure cannot be.
    """
    if not outer > inner > 0.0:
        raise RequestError(f"need L > C > 0 [m], got L = {outer}, C = {inner}: the patches lie between them")
    vehicle = replace(preset("pioneer-p3at"), wheel_base=0.5 * (outer + inner))
    own = {"patch_length": 0.5 * (outer - inner), "patch_width": patch_width, "com_height": 0.0}
    made = robot(vehicle, mass=mass, **(own | measures))
    return replace(made, vehicle=replace(vehicle, mass=mass))
