"""The law of Huskić 2017, Eq. (10), printed and corrected: whether its Lyapunov function decreases in random states."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from skidsteer.control import Huskic, SaturationSpeed, Wheels
from skidsteer.control.huskic import GAINS
from skidsteer.follow import Ends, follow
from skidsteer.models import Icr
from skidsteer.paths import arc
from skidsteer.rolling import RollingModel
from skidsteer.se2 import FloatArray

COUNT = 100_000
SEED = 2017
GENTLE = np.radians(75.0)  # |e|, within its domain of 90 deg
STRAIGHT = 0.1  # [m] beside a straight line, from where the printed law drives away


@dataclass(frozen=True, slots=True, eq=False)
class States:
    """Random errors, gains and robots, each (n,), SI units."""

    x_e: FloatArray
    y_e: FloatArray
    theta_e: FloatArray
    e: FloatArray  # theta_e - delta
    by_y: FloatArray  # derivative of delta by y_e
    v: FloatArray
    curvature: FloatArray
    icr_x: FloatArray
    k1: FloatArray
    k2: FloatArray
    lam: FloatArray


def states(count: int = COUNT) -> States:
    """Errors within 1 m and 75 deg of e, up to 2.5 m/s and 0.7 1/m, |icr_x| up to 0.3 m, gains from 0.5 to 10."""
    rng = np.random.default_rng(SEED)
    x_e, y_e = rng.uniform(-1.0, 1.0, (2, count))
    e, theta_a = rng.uniform(-GENTLE, GENTLE, count), 0.25 * np.pi
    delta, by_y = -theta_a * np.tanh(y_e), -theta_a * (1.0 - np.tanh(y_e) ** 2)
    v, curvature, icr_x = (rng.uniform(low, high, count) for low, high in ((0.1, 2.5), (-0.7, 0.7), (-0.3, 0.3)))
    k1, k2, lam = np.exp(rng.uniform(np.log(0.5), np.log(10.0), (3, count)))
    return States(x_e, y_e, delta + e, e, by_y, v, curvature, icr_x, k1, k2, lam)


def lyapunov_rate(at: States, sign: float, weight: float) -> FloatArray:
    """dV1 / dt (n,) [m^2/s] of V1 = (x_e^2 + y_e^2) / 2 + weight |sin e| / lambda along Eq. (10), by Eqs. (7) and (9).

    Args:
        at: the states.
        sign: of the bracket lambda y_e (v sin theta_e - icr_x omega cos theta_e) + k2 e^2: -1 as printed, 1 corrected.
        weight: 1/2 in Eq. (8), 1 in Eq. (9).
    """
    sin, cos = np.sin(at.theta_e), np.cos(at.theta_e)
    T = np.sign(at.e) / np.cos(at.e)  # |sin e| / (sin e cos e)
    # y_e' = a + b omega with s' = v cos + icr_x omega sin + k1 x_e, and theta_e' = omega - c s' = delta' - T (...)
    s_0, s_1 = at.v * cos + at.k1 * at.x_e, at.icr_x * sin
    y_0, y_1 = at.v * sin - at.curvature * at.x_e * s_0, -at.icr_x * cos - at.curvature * at.x_e * s_1
    bracket_0 = at.lam * at.y_e * at.v * sin + at.k2 * at.e**2
    bracket_1 = -at.lam * at.y_e * at.icr_x * cos
    free = at.curvature * s_0 + at.by_y * y_0 - sign * T * bracket_0
    omega = free / (1.0 - at.curvature * s_1 - at.by_y * y_1 + sign * T * bracket_1)
    s, y = s_0 + s_1 * omega, y_0 + y_1 * omega
    x = at.v * cos + at.icr_x * omega * sin - s * (1.0 - at.curvature * at.y_e)
    turning = omega - at.curvature * s - at.by_y * y  # of e
    return np.asarray(at.x_e * x + at.y_e * y + weight / at.lam * np.sign(at.e) * np.cos(at.e) * turning)


def printed_departure() -> float:
    """|y_e| [m] of a unicycle that began 10 s ago 0.1 m beside a straight line at 1 m/s, along Eq. (10) as printed.

    Gains 1, 1, 1; it ends where |e| reaches 75 deg.
    """
    y, theta, dt = STRAIGHT, 0.0, 1e-3
    for _ in range(10_000):
        by_y = -0.25 * np.pi * (1.0 - np.tanh(y) ** 2)
        e = theta + 0.25 * np.pi * np.tanh(y)
        if abs(e) > GENTLE:
            break
        bracket = -y * np.sin(theta) - e**2
        theta += dt * (by_y * np.sin(theta) - np.sign(e) / np.cos(e) * bracket)
        y += dt * np.sin(theta)
    return abs(float(y))


def offset_on_circle(icr_x: float, curvature: float, gains: str = "header", feed_forward: bool = False) -> float:
    """Cross-track error [m] that stays on a circle, the robot an exact ICR model at 1 m/s without lag or delay."""
    circle = replace(arc(1.0 / curvature, 2.0 * np.pi), closed=True)
    model = Icr(0.48, -0.48, icr_x, 1.0, 1.0)
    wheels = Wheels(model, 5.0)
    law = Huskic(replace(GAINS[gains], omega_max=math.inf), SaturationSpeed(wheels, 1.0), icr_x, feed_forward)
    done = follow(RollingModel(model), law, wheels, circle, ends=Ends(laps=4.0))
    return abs(float(done.cross_track[-1]))
