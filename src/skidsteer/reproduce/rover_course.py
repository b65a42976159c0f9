"""Giannoccaro 2015, section V, on simulated rovers: circle tests, a plan from them, and where five laps end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from skidsteer.calibration import DriveRecord
from skidsteer.drive import Drive, Series
from skidsteer.identify.circle_calibration import calibrate_circles, circle_runs_in
from skidsteer.models.slip_ratio import CircleRun
from skidsteer.plan.circumnavigation import Plan, Request, circumnavigate
from skidsteer.plan.driver import Driver
from skidsteer.plan.encoding import ENCODINGS
from skidsteer.plan.outline import Rectangle
from skidsteer.plan.slip_table import SlipTable
from skidsteer.plants import plant, usual_sensors
from skidsteer.se2 import FloatArray
from skidsteer.simulate import Sensors
from skidsteer.terramechanics.terrain import Ground, terrain
from skidsteer.vehicle import preset

# Neither measure is in the paper; both are assumed.
ROVER = replace(preset("rover-4wd1"), wheel_base=0.19, mass=3.0)
CODE = ENCODINGS["rover-4wd1"]
PAIRS = ((40, 60), (40, 80), (20, 80), (20, 100), (20, 120))  # k of the inner and the outer side, Table 1
OBSTACLE = Rectangle(0.70, 1.25, "obstacle")
RADIUS, STRAIGHT, TURN = 0.90, 0.63, 0.5  # [m]; [m/s] at k = 60, 10.5 rad/s; [rad/s]
CLEARANCE = 0.3  # [m] that the course leaves, at least
EXPERIMENTS = 5
HELD, REST = 5.0, 1.0  # [s] of a circle run, and between two
PERIOD = 0.05  # [s]
TRUTH = Sensors(reference_rate=20.0, position_sigma=1e-9, yaw_sigma=1e-9)
FLOORS = {"kinematic": "tiles", "terramechanic": "tiles"}  # by plant


def paper_request() -> Request:
    """The course of Fig. 10, driven to the left."""
    return Request(OBSTACLE, CLEARANCE, STRAIGHT, TURN * RADIUS, RADIUS)


def circle_commands() -> Series:
    """Rim speeds (n, 2) of the ten runs of Table 1, one after the other, a rest between two."""
    rest, held = np.zeros((round(REST / PERIOD), 2)), round(HELD / PERIOD)
    pairs = [*PAIRS, *((outer, inner) for inner, outer in PAIRS)]
    rims = [np.concatenate([rest, np.tile(CODE.speeds(pair), (held, 1))]) for pair in pairs]
    values = np.concatenate([*rims, rest])
    return Series(PERIOD * np.arange(len(values), dtype=float), values, "circles")


@cache
def circles(name: str, seed: int) -> tuple[CircleRun, ...]:
    """The circle runs of a simulated rover, as measured by its reference."""
    return circle_runs_in(_driven(name, circle_commands(), usual_sensors(ROVER), seed))


def by_slip_ratio(name: str, seed: int) -> Driver:
    """As the paper plans: by the slips of the circle runs."""
    return Driver.of_circles(SlipTable(circles(name, seed), ROVER.track_width), ROVER)


def by_calibration(name: str, seed: int) -> Driver:
    """By the motion model that the same runs calibrate."""
    record = DriveRecord("circles", "simulated", "", 0.0, 0, 0)
    return Driver.of(calibrate_circles(circles(name, seed), ROVER, (record,)).calibration)


WAYS: dict[str, Callable[[str, int], Driver]] = {"slip ratio": by_slip_ratio, "ICR model": by_calibration}


@dataclass(frozen=True, slots=True, eq=False)
class Laps:
    """A plan for each repetition of the circle test, and the lap that the plant drove."""

    plans: tuple[Plan, ...]
    paths: tuple[FloatArray, ...]  # (n, 3) of each, from its start

    @property
    def errors(self) -> FloatArray:
        """Distance [m] of the ends from the start."""
        return np.array([float(np.hypot(*path[-1, :2])) for path in self.paths])


@cache
def laps(name: str, way: str) -> Laps:
    """Five laps on the plant of a name, planned by one of ``WAYS`` in whole k."""
    plans = tuple(circumnavigate(WAYS[way](name, seed), paper_request()) for seed in range(EXPERIMENTS))
    drives = [_driven(name, plan.rims, TRUTH, 0) for plan in plans]
    return Laps(plans, tuple(np.array(d.pose.values) for d in drives if d.pose is not None))


def _driven(name: str, rims: Series, sensors: Sensors, seed: int) -> Drive:
    return plant(name)("rover", ROVER, Ground(terrain(FLOORS[name])), rims, sensors, seed)
