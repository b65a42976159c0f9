"""An unplanned drive: someone with a joystick, who turns round where the area ends."""

from __future__ import annotations

import numpy as np

from skidsteer.drive import Series
from skidsteer.identify.manoeuvres import PERIOD, Limits
from skidsteer.se2 import wrap

HOLD = (1.0, 5.0)  # [s] that the stick stays where it is
REST = 0.25  # share of holds at rest
BACKWARDS = 0.2  # of the others
SPOT = 0.05  # of the others, turns on the spot
STRAIGHT = 0.4  # of the others
SPEED = (0.1, 0.6)  # [m/s]
OMEGA = 0.25  # [rad/s] standard deviation of the yaw rate
AHEAD = 1.5  # [s] that a driver looks ahead


def unplanned_drive(width: float, limits: Limits, room: tuple[float, float], time: float, seed: int) -> Series:
    """Rim speeds of a person's drive without a plan.

    The stick is held for 1 to 5 s, then moved: to rest for 25 %, else to 0.1 to 0.6 m/s, for 20 % in reverse; straight
    for 40 %, turning on the spot for 5 %, and with a random yaw rate otherwise. Where the robot would leave the room it
    is slowed down and turned towards the middle.

    These figures are chosen after recorded drives of people (the continuous ones of DRIVE and BorealTC and a
    laboratory's), beside which docs/design.md shows this driver: about as often at rest and as fast, turning more.

    Args:
        width: [m] distance of the tread ICRs, which the driver sees the robot turn with.
        limits: that are kept.
        room: [m] that base_link may get from its start along x and y.
        time: [s].
        seed: of the driver.
    """
    rng = np.random.default_rng(seed)
    rims, wanted, left = np.zeros((round(time / PERIOD), 2)), (0.0, 0.0), 0.0
    x, y, yaw, now = 0.0, 0.0, 0.0, np.zeros(2)
    slope = limits.acceleration * PERIOD
    for i in range(len(rims)):
        left -= PERIOD
        if left <= 0.0:
            left, wanted = float(rng.uniform(*HOLD)), _stick(rng, limits)
        v, omega = _turned_round(wanted, (x, y, yaw), room)
        target = np.array([v - 0.5 * width * omega, v + 0.5 * width * omega])
        target *= min(1.0, limits.wheel_speed / max(abs(v) + 0.5 * width * abs(omega), limits.wheel_speed))
        now = now + np.clip(target - now, -slope, slope)
        rims[i] = now
        v, yaw = 0.5 * float(now[0] + now[1]), yaw + float(now[1] - now[0]) / width * PERIOD
        x, y = x + v * np.cos(yaw) * PERIOD, y + v * np.sin(yaw) * PERIOD
    return Series(PERIOD * np.arange(len(rims), dtype=float), rims, "wheels")


def _stick(rng: np.random.Generator, limits: Limits) -> tuple[float, float]:
    """Where the stick goes next: v and omega."""
    rest, backwards, spot, straight = rng.random(4) < (REST, BACKWARDS, SPOT, STRAIGHT)
    speed = min(float(rng.uniform(*SPEED)), limits.speed)
    omega = float(np.clip(OMEGA * rng.standard_normal(), -limits.omega, limits.omega))
    if rest:
        return 0.0, 0.0
    if spot:
        return 0.0, float(np.sign(omega)) * min(2.0 * OMEGA, limits.omega)
    return -speed if backwards else speed, 0.0 if straight else omega


def _turned_round(
    wanted: tuple[float, float], pose: tuple[float, float, float], room: tuple[float, float]
) -> tuple[float, float]:
    """The same, or slower and towards the middle where it would lead out of the room."""
    v, (x, y, yaw) = wanted[0], pose
    heading = yaw + (np.pi if v < 0 else 0.0)
    ahead = AHEAD * abs(v)
    outside = abs(x + ahead * np.cos(heading)) > room[0] or abs(y + ahead * np.sin(heading)) > room[1]
    if v == 0.0 or not outside:
        return wanted
    aside = float(wrap(np.arctan2(-y, -x) - heading))
    return v * max(float(np.cos(aside)), 0.2), float(np.clip(aside, -2.0 * OMEGA, 2.0 * OMEGA))
