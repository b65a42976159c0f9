"""Path following timed: a step of each law from Python, and closed loops over the time they simulate."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

import speed
from skidsteer.control import Controller, Wheels
from skidsteer.follow import Run, Sensing, follow
from skidsteer.follow.laws import Known, controller
from skidsteer.paths import lemniscate
from skidsteer.plants import PLANTS, begin, point_contacts
from skidsteer.terramechanics.terrain import TERRAINS, Ground
from skidsteer.vehicle import preset

ROBOT, GRASS = preset("summit-xl"), Ground(TERRAINS["grass"])
PATH = lemniscate(8.45)
SPEED, LAG = 1.5, 0.1  # [m/s], [s]
SENSING = Sensing(delay=0.06, position_sigma=0.01, yaw_sigma=0.01, wheel_sigma=0.01, gyro_sigma=0.01)
STEPS = 2000  # timed at once
NAMES = ("huskic", "soetanto", "pentzer", "pure_pursuit")
WHEELS = Wheels(point_contacts(ROBOT), ROBOT.max_wheel_speed or 3.0)


@dataclass(frozen=True)
class FollowTimes:
    """Steps in seconds of processor time; loops in seconds simulated for each of them, at the default 50 Hz."""

    steps: dict[str, float]  # by law: advance, command, rim speeds
    loops: dict[str, float]  # by law, on the kinematic plant
    plants: dict[str, float]  # by plant, with the first law
    plan: tuple[float, float]  # mean and 99th percentile of a step of the predictive law on its way


def measure(repeats: int) -> FollowTimes:
    """Medians of repeated steps, the best of a few loops: what disturbs a run only makes it slower."""
    laws = {name: controller(name, None, SPEED, Known(WHEELS, LAG)) for name in NAMES}
    steps = {name: speed.timed(_step(law), repeats) / STEPS for name, law in laws.items()}
    loops = {name: _ratio(partial(_drive, "kinematic", law), repeats) for name, law in laws.items()}
    first = next(iter(laws.values()))
    plants = {name: _ratio(partial(_drive, name, first), 3) for name in PLANTS}
    return FollowTimes(steps, loops, plants, _plan())


def _step(law: Controller[Any]) -> Callable[[], None]:
    pose, twist, sent = (0.8, 0.3, 0.4), (1.2, 0.02, 0.5), (1.2, 0.5)
    state = law.begin(PATH, pose)

    def steps() -> None:
        for _ in range(STEPS):
            WHEELS.speeds(*law.command(pose, twist, law.advance(state, pose, twist, 0.02, sent)))

    return steps


def _plan() -> tuple[float, float]:
    """Seconds of advance and command, on the poses and twists of a lap on grass; the first second compiles."""
    law = controller("predictive", None, SPEED, Known(WHEELS, LAG, SENSING.delay))
    run = _drive("terramechanic", law)
    state, took = law.begin(PATH, run.seen[0]), []
    for before, after in zip(range(len(run.t) - 1), range(1, len(run.t)), strict=True):
        v, _, omega = WHEELS.model.twist(*run.sent[before]).tolist()
        v_x, v_y, _ = WHEELS.model.twist(*run.states[after, 6:]).tolist()
        told = (v_x, v_y, float(run.states[after, 5]))
        start = time.process_time()
        state = law.advance(state, run.seen[after], told, 0.02, (v, omega))
        law.command(run.seen[after], told, state)
        took.append(time.process_time() - start)
    return float(np.mean(took[50:])), float(np.percentile(took[50:], 99.0))


def _drive(plant: str, law: Controller[Any]) -> Run:
    rolling = begin(plant, ROBOT, GRASS, PATH.robot(0.0), LAG)
    return follow(rolling, law, WHEELS, PATH, SENSING)


def _ratio(drive: Callable[[], Run], repeats: int) -> float:
    drive()
    best = 0.0
    for _ in range(repeats):
        start = time.process_time()
        run = drive()
        best = max(best, float(run.t[-1]) / (time.process_time() - start))
    return best
