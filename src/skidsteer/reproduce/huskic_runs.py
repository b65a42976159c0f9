"""Robot, paths and calibrations for the experiments of Huskić 2017, section V: a simulated Summit XL.

The terrains ``grass``, ``tiles`` and ``gravel`` stand for grass, vinyl and macadam. Of the path on grass the paper
gives the length, and that it has straights and representative curvatures: ``COURSE`` is ours. Five lemniscates are
110.77 m.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from skidsteer.identify.calibrate import CalibrateOptions, calibrate
from skidsteer.models import Icr, Model
from skidsteer.paths import Path, arc, clothoid, join, lemniscate, line
from skidsteer.plants import PLANTS
from skidsteer.se2 import FloatArray
from skidsteer.simulate import Sensors, controller, rims_from_manoeuvres
from skidsteer.terramechanics.terrain import TERRAINS, Ground
from skidsteer.vehicle import preset

# URDF of summit_xl_common: a body of 25 kg, four wheels of 6.5 kg
VEHICLE = replace(preset("summit-xl"), mass=51.0)
GROUNDS = {"grass": "grass", "vinyl": "tiles", "macadam": "gravel"}  # of the paper: ours
LAPS, LAPS_LENGTH, COURSE_LENGTH = 5, 110.77, 159.83  # [m]
LEMNISCATE = lemniscate(LAPS_LENGTH / LAPS / (lemniscate(1.0).length))
SENSORS = Sensors(10.0, 0.005, float(np.radians(0.2)), encoder_rate=50.0, gyro_rate=50.0)
EASE = 1.0  # [m] of a turn, in which its curvature grows
SLOW, FAST = (0.15, 0.3, 0.45), (0.4, 0.8, 1.2, 1.6, 2.0)  # [m/s] of calibration drives

PUBLISHED = {  # ICRs of a Summit XL in the settings that the authors publish, as ``Icr``
    "grass": Icr(0.38178, -0.487, 0.2809, 0.9, 0.9128),
    "vinyl": Icr(0.4786, -0.3496, 0.259, 0.8045, 0.827),
    "macadam": Icr(0.4845, -0.474, 0.2244, 0.87974, 0.89856),
}


def bend(radius: float, angle: float) -> Path:
    """A turn by an angle [rad] at a radius [m]; its curvature grows from 0 and falls back over ``EASE``."""
    side = float(np.sign(angle))
    curvature, rest = side / radius, abs(angle) - EASE / radius
    return join(clothoid(EASE, 0.0, curvature), arc(radius, side * rest), clothoid(EASE, curvature, 0.0))


def course() -> Path:
    """159.83 m of straights and turns with radii from 1.5 to 6 m."""
    right_angle = 0.5 * np.pi
    turns = [(6.0, 1.0, 14.0), (4.0, 1.0, 8.0), (3.0, -1.0, 6.0), (2.0, 1.0, 6.0), (2.0, 2.0, 10.0)]
    slalom = [(1.5, -0.5, 0.2), (1.5, 1.0, 0.2), (1.5, -1.0, 0.2), (1.5, 0.5, 10.0), (5.0, -2.0, 8.0), (3.0, 1.0, 0.0)]
    parts = [line(12.0)]
    for radius, angle, straight in turns + slalom:
        parts.append(bend(radius, angle * right_angle))
        parts += [line(straight)] if straight else []
    way = join(*parts)
    return join(way, line(COURSE_LENGTH - way.length))


COURSE = course()


def manoeuvres(speeds: tuple[float, ...], turns: tuple[float, ...]) -> FloatArray:
    """Rows of duration [s], v [m/s], omega [rad/s]: turns to both sides at each speed, and on the spot."""
    rows = [[1.0, 0.0, 0.0]]
    for v in speeds:
        rows += [[4.0, v, s * w] for w in turns for s in (1.0, -1.0)] + [[2.0, v, 0.0]]
        rows += [[2.0, 0.0, s * turns[-1]] for s in (1.0, -1.0)]
    return np.array([*rows, [1.0, 0.0, 0.0]])


@cache
def calibrated(plant: str, terrain: str, model: str = "icr") -> Model:
    """Our calibration on a simulated drive: ``icr`` on a slow one, other models on one up to 2 m/s."""
    rows = manoeuvres(SLOW, (0.3, 0.6)) if model == "icr" else manoeuvres(FAST, (0.3, 0.6, 1.0))
    commands = rims_from_manoeuvres(rows, controller(VEHICLE), acceleration=1.0)
    drive = PLANTS[plant]("calibration", VEHICLE, Ground(TERRAINS[terrain]), commands, SENSORS, 0)
    return calibrate(drive, options=CalibrateOptions(model=model)).model


def icr(plant: str, terrain: str) -> Icr:
    """``calibrated``, as constant ICRs."""
    model = calibrated(plant, terrain, "icr")
    assert isinstance(model, Icr)
    return model
