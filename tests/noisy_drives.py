"""A simulated drive whose noise is known, and its residuals."""

import functools
from dataclasses import replace

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.models import Differential, Icr
from skidsteer.noise import Noise, Residuals, Weights, residuals
from skidsteer.se2 import FloatArray, between, compose
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import preset
from skidsteer.windows import Timing, increment_windows, predict, steps

P3AT = preset("pioneer-p3at")
TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)
LAG = Timing(0.0, 0.08)
TRUE_NOISE = Noise(position=0.01, yaw=0.009, stamp=0.02, walk=0.02, turn=0.03)


def simulated(noise: Noise, seed: int) -> Drive:
    """Four minutes of straights, turns and stops, at 5 Hz."""
    rows = [[2.0, 0.0, 0.0], [8.0, 0.5, 0.0], [6.0, 0.0, 0.8], [8.0, 0.5, 0.3], [8.0, 0.6, -0.3], [6.0, -0.4, 0.0]]
    rims = rims_from_manoeuvres(np.array([*rows, [6.0, 0.0, -0.8], *rows[::-1]] * 3), Differential(P3AT.track_width))
    sensors = Sensors(5.0, noise.position, noise.yaw, noise.stamp)
    return kinematic_drive("d", P3AT, TRUTH, rims, sensors, LAG.lag, (noise.walk, noise.turn), seed)


def residuals_of(drive: Drive) -> Residuals:
    windows = increment_windows(drive)
    cut = steps(drive.wheels, windows, LAG)
    return residuals(TRUTH, windows, cut, predict(TRUTH, drive.wheels, windows, LAG))


@functools.cache
def true_residuals(seed: int) -> Residuals:
    return residuals_of(simulated(TRUE_NOISE, seed))


def ones(part: Residuals) -> Weights:
    return Weights.ones(len(part.residual))


def spoiled(change: FloatArray, first: int, last: int, globally: bool = False) -> Residuals:
    """Residuals of a drive whose reference poses first..last - 1 are wrong by a motion."""
    drive = simulated(TRUE_NOISE, 7)
    assert drive.pose is not None
    values = drive.pose.values.copy()
    values[first:last] = compose(change, values[first:last]) if globally else compose(values[first:last], change)
    return residuals_of(replace(drive, pose=Series(drive.pose.t, values)))


def slipping(step: FloatArray, first: int, last: int) -> Residuals:
    """Residuals of a drive whose body moves by ``step`` beside what the wheels say, in each of a run of motions."""
    drive = simulated(TRUE_NOISE, 7)
    assert drive.pose is not None
    values = drive.pose.values.copy()
    for i in range(first, last):
        after = compose(compose(values[i], step), between(values[i], values[i + 1 :]))
        values[i + 1 :] = after
    return residuals_of(replace(drive, pose=Series(drive.pose.t, values)))
