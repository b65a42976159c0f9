"""Straights and arcs of a plan, each at constant rim speeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.models import Model
from skidsteer.plan.encoding import Encoding
from skidsteer.se2 import FloatArray, chain, exp
from skidsteer.vehicle import Vehicle

PERIOD = 0.05  # [s] between commands, at most
REST = 1.0  # [s] at rest before and after


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """A straight or an arc: what is wanted, the rim speeds for it, and the motion they make by the model."""

    name: str
    v: float  # [m/s] wanted along the robot
    omega: float  # [rad/s] wanted
    amount: float  # [m] length of a straight, [rad] angle of an arc
    asked: FloatArray  # (2,) [m/s] rim speeds by the model
    rims: FloatArray  # (2,) [m/s] the same, rounded to those of the integers if it takes integers
    k: tuple[int, int] | None  # left and right integer
    twist: FloatArray  # (3,) expected at ``rims``

    @property
    def curved(self) -> bool:
        """Whether it is an arc."""
        return self.omega != 0.0

    @property
    def duration(self) -> float:
        """[s] in which ``rims`` complete ``amount``."""
        rate = abs(self.twist[2]) if self.curved else np.hypot(*self.twist[:2])
        return float(self.amount / rate)

    @property
    def radius(self) -> float:
        """[m] lateral distance of the centre of the turn at ``rims``; infinite on a straight."""
        return float(abs(self.twist[0] / self.twist[2])) if self.curved else float("inf")

    @property
    def length(self) -> float:
        """[m] of the path of the origin."""
        return float(np.hypot(*self.twist[:2]) * self.duration)

    @property
    def motion(self) -> FloatArray:
        """Motion (3,) in the frame of its beginning, without lag."""
        return exp(self.twist * self.duration)


def stretch(
    name: str, model: Model, v: float, omega: float, amount: float, vehicle: Vehicle, encoding: Encoding | None
) -> Stretch:
    """A stretch by a model, in integers where the robot takes those.

    Raises:
        RequestError: speeds beyond the model, the wheels or the integers.
    """
    asked = model.wheel_speeds(v, omega)
    what = f"{v:.3g} m/s" + (f" on an arc of {abs(v / omega):.3f} m" if omega else " straight on")
    if not np.isfinite(asked).all():
        raise RequestError(f"the model {model.NAME} knows no wheel speeds for {what}; change --radius or the speeds")
    limit = vehicle.max_wheel_speed
    if limit is not None and float(np.abs(asked).max()) > limit:
        raise RequestError(
            f"{what} asks {np.abs(asked).max():.3f} m/s of a wheel, but {vehicle.name} reaches {limit:g} m/s; give a"
            " lower --speed" + (" or --curve-speed" if omega else "")
        )
    k = None if encoding is None else encoding.nearest(asked)
    rims = asked if encoding is None or k is None else encoding.speeds(k)
    twist = model.twist(rims[0], rims[1])
    if not (np.isfinite(twist).all() and (twist[2] * omega > 0.0 or (omega == 0.0 and twist[0] > 0.0))):
        raise RequestError(
            f"rim speeds of {rims[0]:.3f} and {rims[1]:.3f} m/s do not drive {what} by {model.NAME}; change --radius or"
            " the speeds"
        )
    return Stretch(name, v, omega, amount, asked, rims, k, twist)


def poses_of(stretches: Sequence[Stretch]) -> FloatArray:
    """Poses (n + 1, 3) between stretches one after the other, from the origin, without lag."""
    return chain([s.motion for s in stretches])


def commands(stretches: Sequence[Stretch]) -> Series:
    """Rim speeds (n, 2) [m/s] of stretches one after the other, held from sample to sample, between two rests."""
    still = PERIOD * np.arange(round(REST / PERIOD) + 1)
    t, rims, begin = [still[:-1]], [np.zeros((len(still) - 1, 2))], REST
    for each in stretches:
        count = int(np.ceil(each.duration / PERIOD - 1e-9))
        t.append(begin + each.duration / count * np.arange(count))
        rims.append(np.tile(each.rims, (count, 1)))
        begin += each.duration
    return Series(np.concatenate([*t, begin + still]), np.concatenate([*rims, np.zeros((len(still), 2))]), "plan")
