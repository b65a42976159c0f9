"""What is believed of a plant's robot: a model fitted to slow steady turns, as a calibration at low speed finds it."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from skidsteer.models import Icr
from skidsteer.plants import begin, point_contacts
from skidsteer.se2 import FloatArray
from skidsteer.terramechanics.terrain import Ground
from skidsteer.vehicle import Vehicle

SLOW = 0.3  # [m/s]
CURVATURES = (0.0, 0.3, -0.3, 0.7, -0.7)  # [1/m] asked of point contacts
SETTLING, TOLD = 1.0, 1.0  # [s] until a turn is steady, and over which it is told
STEP = 0.1  # [s]
WEIGHTS = np.array([1.0, 1.0, 0.2])  # [m/s, m/s, rad/s] of equal weight


def low_speed(plant: str, vehicle: Vehicle, ground: Ground) -> Icr:
    """ICRs of a plant on the ground where it begins, by least squares over steady turns at ``SLOW``.

    Raises:
        RequestError: no such plant, or one that cannot be begun.
    """
    here = Ground(ground.everywhere)
    rims = point_contacts(vehicle).wheel_speeds(SLOW, SLOW * np.array(CURVATURES))
    turns = [_steady(plant, vehicle, here, pair) for pair in rims]
    twists, speeds = (np.array(column) for column in zip(*turns, strict=True))
    model = Icr.nominal(vehicle)
    low, high = Icr.bounds(vehicle).T

    def off(theta: FloatArray) -> FloatArray:
        return np.asarray(((model.with_theta(theta).twist(*speeds.T) - twists) / WEIGHTS).ravel())

    return model.with_theta(least_squares(off, model.theta, bounds=(low, high)).x)


def _steady(plant: str, vehicle: Vehicle, ground: Ground, rims: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean twist (3,) and rim speeds (2,) of a turn, once it is steady."""
    rolling = begin(plant, vehicle, ground)
    rolling.step(rims, SETTLING)
    states = [rolling.step(rims, STEP) for _ in range(round(TOLD / STEP))]
    mean = np.mean(states, axis=0)
    return mean[3:6], mean[6:]
