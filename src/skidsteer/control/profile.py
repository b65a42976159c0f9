"""The fastest speeds along a path within limits of rim speeds and accelerations."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.control.path_state import require_positive
from skidsteer.control.speed import Wheels
from skidsteer.errors import RequestError
from skidsteer.kernels import profile as kernels
from skidsteer.kernels.stage import profile_at
from skidsteer.paths import Path
from skidsteer.se2 import FloatArray

STEP = 0.1  # [m] between the points of a profile
JUST = 1e-6  # [m] before and after them, where the curvature may jump
RESERVE = 0.7  # share of the rims' acceleration that the profile uses; the rest is for control
HEADROOM = 0.95  # share of their speed, likewise


@dataclass(frozen=True, slots=True)
class Limits:
    """Upper limits."""

    speed: float  # [m/s] along the path
    acceleration: float = 1.0  # [m/s^2] along the path, to speed up and to slow down
    rim_acceleration: float = 3.0  # [m/s^2] of the rims of each side
    lateral_acceleration: float = 3.0  # [m/s^2] v omega
    omega_max: float = math.inf  # [rad/s]

    def __post_init__(self) -> None:
        require_positive(self, "speed", "acceleration", "rim_acceleration", "lateral_acceleration", "omega_max")
        if not math.isfinite(self.speed):
            raise ValueError(f"need a finite speed [m/s], got {self.speed}")


@dataclass(frozen=True, slots=True, eq=False)
class SpeedProfile:
    """Speeds at equal distances, from one end of a path to the other."""

    path: Path
    speeds: FloatArray  # (m,) [m/s], 0 or more

    def at(self, s: float) -> float:
        """Speed [m/s] at s [m]."""
        return float(profile_at(self.speeds, self.path.length, self.path.closed, s))


def rims_by_speed(wheels: Wheels, speed: float, curvature: ArrayLike) -> FloatArray:
    """Rim speeds (..., 2) per m/s at a speed [m/s] (negative in reverse) and curvatures (...) [1/m].

    Raises:
        RequestError: the model has none.
    """
    curvature = np.asarray(curvature, dtype=float)
    rims = wheels.model.wheel_speeds(speed, abs(speed) * curvature) / abs(speed)
    if not np.isfinite(rims).all():
        raise RequestError(f"the model {wheels.model.NAME} tells no rim speeds at {speed} m/s; ask for a lower speed")
    return rims


def speed_profile(path: Path, wheels: Wheels, limits: Limits) -> SpeedProfile:
    """The fastest drive along a path within limits.

    The rims follow the curvature of the path; where it jumps they take about ``STEP`` to change.

    Raises:
        RequestError: the model has no rim speeds.
    """
    m = max(2, math.ceil(path.length / STEP))
    s, ds = np.linspace(0.0, path.length, m + 1), path.length / m
    before, after = path.curvature(s - JUST), path.curvature(s + JUST)
    sharpest = np.where(np.abs(before) > np.abs(after), before, after)
    speed = min(limits.speed, wheels.max_speed)
    by_speed = rims_by_speed(wheels, -speed if path.reverse else speed, sharpest)
    slopes = _slopes(by_speed, ds, path.closed)
    rim_acceleration = RESERVE * limits.rim_acceleration
    with np.errstate(divide="ignore"):
        speeds = np.min(
            [
                np.full(m + 1, limits.speed),
                *(HEADROOM * wheels.max_speed / np.abs(by_speed)).T,
                *np.sqrt(rim_acceleration / np.abs(slopes)).T,
                np.sqrt(limits.lateral_acceleration / np.abs(sharpest)),
                limits.omega_max / np.abs(sharpest),
            ],
            axis=0,
        )
    if not path.closed:
        speeds[-1] = 0.0
    kernels.sweep(speeds, ds, by_speed, slopes, path.closed, limits.acceleration, rim_acceleration)
    speeds.setflags(write=False)
    return SpeedProfile(path, speeds)


def _slopes(values: FloatArray, ds: float, closed: bool) -> FloatArray:
    """Greater derivative (m, 2) to either side of points ``ds`` [m] apart."""
    steps = np.abs(np.diff(values, axis=0)) / ds
    before = np.concatenate([steps[-1:] if closed else steps[:1], steps])
    after = np.concatenate([steps, steps[:1] if closed else steps[-1:]])
    return np.asarray(np.maximum(before, after))
