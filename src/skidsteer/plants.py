"""Plants by name: what can be driven in place of a robot, from rim speeds asked for to a recorded drive."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from numpy.typing import ArrayLike

from skidsteer.drive import Drive, Series
from skidsteer.errors import named
from skidsteer.models import Model, SymmetricIcr
from skidsteer.mujoco_plant import RollingEngine, roll
from skidsteer.rolling import Rolling, RollingModel
from skidsteer.simulate import Sensors, kinematic_drive, recorded, refuse_fast
from skidsteer.terramechanics.dynamics import RollingRobot, terramechanic_drive
from skidsteer.terramechanics.robot import robot
from skidsteer.terramechanics.terrain import Ground
from skidsteer.vehicle import Vehicle

LAG = 0.1  # [s] of the kinematic plant
USUAL = Sensors(reference_rate=10.0, encoder_rate=50.0, gyro_rate=50.0, gyro_sigma=0.003, gyro_bias=0.002)

Plant = Callable[[str, Vehicle, Ground, Series, Sensors, int], Drive]


def kinematic(name: str, vehicle: Vehicle, ground: Ground, commands: Series, sensors: Sensors, seed: int) -> Drive:
    """Constant ICRs where point contacts would have them, chi = 1 + (L / B)^2, whatever the ground."""
    refuse_fast(vehicle, commands)
    drive = kinematic_drive(name, vehicle, point_contacts(vehicle), commands, sensors, LAG, seed=seed)
    return replace(drive, wheel_command=commands)


def terramechanic(name: str, vehicle: Vehicle, ground: Ground, commands: Series, sensors: Sensors, seed: int) -> Drive:
    """Shear stress under the patches; what is not known of the vehicle is assumed, see ``robot``."""
    return terramechanic_drive(name, robot(vehicle), ground, commands, sensors, seed)


def mujoco(name: str, vehicle: Vehicle, ground: Ground, commands: Series, sensors: Sensors, seed: int) -> Drive:
    """Coulomb friction at points in the physics engine MuJoCo; needs ``skidsteer[mujoco]``."""
    return recorded(name, vehicle, roll(robot(vehicle), ground, commands), sensors, seed, commands)


def point_contacts(vehicle: Vehicle) -> SymmetricIcr:
    """ICRs of a robot on four points with equal loads, chi = 1 + (L / B)^2."""
    chi = 1.0 + ((vehicle.wheel_base or 0.0) / vehicle.track_width) ** 2
    return SymmetricIcr(0.5 * chi * vehicle.track_width, 1.0)


PLANTS: dict[str, Plant] = {"kinematic": kinematic, "terramechanic": terramechanic, "mujoco": mujoco}


def plant(name: str) -> Plant:
    """The plant of that name.

    Raises:
        RequestError: no such plant; the message lists those there are.
    """
    return named(name, "plant", PLANTS)


def begin(
    name: str,
    vehicle: Vehicle,
    ground: Ground,
    start: ArrayLike = (0.0, 0.0, 0.0),
    lag: float = LAG,
    model: Model | None = None,
) -> Rolling:
    """A robot on its way in the plant of that name, at rest, for a closed loop.

    Args:
        name: of the plant.
        vehicle: what is not known of it is assumed, see ``robot``.
        ground: its areas lie in the frame in which ``start`` is told, its times count from the beginning.
        start: (3,) pose.
        lag: [s] with which the rims follow what they are asked for.
        model: of the kinematic plant; None: ``point_contacts``.

    Raises:
        RequestError: no such plant, or one that cannot be begun so.
    """
    plant(name)
    if name == "kinematic":
        return RollingModel(model or point_contacts(vehicle), start, lag)
    made = robot(vehicle, lag=lag)
    return RollingRobot(made, ground, start) if name == "terramechanic" else RollingEngine(made, ground, start)


def usual_sensors(vehicle: Vehicle) -> Sensors:
    """A reference at 10 Hz (1 cm, 0.5 deg), encoders and a gyro at 50 Hz; counts where the vehicle's are known."""
    ticks = vehicle.ticks_per_revolution
    return USUAL if ticks is None else replace(USUAL, encoder_step=2.0 * math.pi * vehicle.wheel_radius / ticks)
