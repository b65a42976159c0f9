"""A closed loop in full: which robot follows which path by which law, on what, and what is believed of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skidsteer.control import Predictive, Wheels
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.follow.belief import low_speed
from skidsteer.follow.laws import Known, controller
from skidsteer.follow.loop import Ends, follow
from skidsteer.follow.run import Run
from skidsteer.follow.sensing import IDEAL, Sensing, Triple
from skidsteer.models import Model
from skidsteer.paths import Path
from skidsteer.plants import begin, plant, point_contacts, usual_sensors
from skidsteer.progress import Progress, silent
from skidsteer.simulate import recorded
from skidsteer.terramechanics.terrain import Ground
from skidsteer.vehicle import Vehicle

SLOWEST = 0.25  # of the speed asked for, on average: slower than that the time is up
SPARE = 30.0  # [s] more
SHORTEST = 0.5  # [s] that can be recorded
LARGEST_LAG = 10.0  # [s] of wheels that still follow
LONGEST = 3600.0  # [s] of a drive at the speed asked for


@dataclass(frozen=True, slots=True)
class Belief:
    """What the controller believes of its robot, and where that comes from."""

    model: Model
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What is to be driven.

    Raises:
        RequestError: a vehicle whose wheel speed is not known or less than is asked for, wheels that cannot be, laps of
            an open path, or a drive of more than an hour.
    """

    path: Path
    vehicle: Vehicle
    ground: Ground
    belief: Belief
    speed: float  # [m/s] asked for
    law: str = "huskic"
    gains: str | None = None  # of the law; None: as it is launched
    plant: str = "kinematic"
    lag: float = 0.1  # [s] of the wheels
    start: Triple | None = None  # None: on the path, at its beginning
    sensing: Sensing = IDEAL
    laps: float = 1.0  # of a closed path
    off: float = 3.0  # [m] from the path, beyond which it is lost
    acceleration: float = math.inf  # [m/s^2] of the rims
    seed: int = 0

    def __post_init__(self) -> None:
        limit = self.vehicle.max_wheel_speed
        if limit is None:
            raise RequestError(f"vehicle {self.vehicle.name} has no max_wheel_speed; give it in a vehicle file")
        if self.speed > limit:
            raise RequestError(f"{self.speed:g} m/s are asked for, but {self.vehicle.name} reaches {limit:g} m/s")
        if not 0.0 <= self.lag <= LARGEST_LAG:
            raise RequestError(f"the lag of the wheels must be from 0 to {LARGEST_LAG:g} s, got {self.lag:g}")
        if not self.acceleration > 0.0:
            raise RequestError(f"the acceleration of the wheels must be above 0 m/s^2, got {self.acceleration}")
        if self.laps > 0.0 and self.laps != 1.0 and not self.path.closed:
            raise RequestError(f"{self.laps:g} laps of a path that is open; waypoints are closed by --closed")
        if self.way > LONGEST * self.speed > 0.0:
            raise RequestError(
                f"{self.way:.3g} m at {self.speed:g} m/s take longer than an hour; give a shorter path, fewer --laps or"
                " a higher --speed"
            )

    @property
    def way(self) -> float:
        """Length of all laps [m]."""
        return self.path.length * (self.laps if self.path.closed else 1.0)

    @property
    def wheels(self) -> Wheels:
        """What is believed of the robot, and the limit of its wheels."""
        return Wheels(self.belief.model, self.vehicle.max_wheel_speed or math.nan)

    @property
    def ends(self) -> Ends:
        """When driving ends."""
        return Ends(self.laps, self.way / (SLOWEST * self.speed) + SPARE, self.off)


def run_task(task: Task, progress: Progress = silent) -> Run:
    """Drive a task; progress is told once a second of it.

    Raises:
        RequestError: as ``follow`` does, or no such plant, law or gains.
    """
    known = Known(task.wheels, task.lag, task.sensing.delay, 1.0 / task.sensing.rate, task.acceleration)
    law = controller(task.law, task.gains, task.speed, known)
    start = task.path.robot(0.0) if task.start is None else np.array(task.start)
    rolling = begin(task.plant, task.vehicle, task.ground, start, task.lag)
    wheels = law.wheels if isinstance(law, Predictive) else task.wheels  # its plans are of rims by a constant ICR
    return follow(rolling, law, wheels, task.path, task.sensing, task.ends, task.acceleration, task.seed, progress)


def believed(name: str, vehicle: Vehicle, ground: Ground) -> Belief:
    """What to believe of a plant's robot where there is no calibration of it.

    Raises:
        RequestError: no such plant, or one that cannot be begun.
    """
    plant(name)
    if name == "kinematic":
        return Belief(point_contacts(vehicle), "the plant's own ICRs")
    return Belief(low_speed(name, vehicle, ground), f"steady turns at 0.3 m/s on {ground.everywhere.name}")


def recorded_drive(name: str, task: Task, run: Run) -> Drive:
    """What a robot's usual sensors record of a run, with the ``wheel_command`` that was sent.

    Raises:
        RequestError: a run that ended at once.
    """
    if run.t[-1] < SHORTEST:
        raise RequestError(f"the drive ended after {run.t[-1]:.2f} s: {run.outcome}, {run.reason}")
    commands = Series(run.t, run.sent, "wheel_command")
    return recorded(name, task.vehicle, run.motion, usual_sensors(task.vehicle), task.seed, commands)
