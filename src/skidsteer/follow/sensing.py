"""What a controller is told of the robot: poses that are late, noisy, leap or fail to come, and a measured twist.

A leap of the localization is one of its map: from then on the path lies elsewhere on the ground. How far the robot is
off the path is told in that map, as the localization itself would tell it without noise and delay.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skidsteer.errors import RequestError
from skidsteer.models import MatrixModel, Model
from skidsteer.se2 import FloatArray, compose, invert

Triple = tuple[float, float, float]
BLOCK = 1000  # samples of noise drawn at once
LIMITS = {  # the most that is taken, above which a number is in another unit; all of them are at least 0
    "delay": (10.0, "delay of the poses", "10 s"),
    "position_sigma": (10.0, "noise of the positions", "10 m"),
    "yaw_sigma": (math.pi, "noise of the yaw", "180 deg"),
    "wheel_sigma": (10.0, "noise of the rim speeds", "10 m/s"),
    "gyro_sigma": (10.0, "noise of the gyro", "10 rad/s"),
}
FAR = 1e4  # [m], [rad] of a jump
RATES = 0.1, 1000.0  # [Hz] of the controller
SELDOM = 0.01  # [Hz] poses come at least that often


@dataclass(frozen=True, slots=True)
class Jump:
    """A leap of the localization, in the frame of the robot, at a time or when a share of the way is driven."""

    left: float  # [m]
    ahead: float = 0.0  # [m]
    turn: float = 0.0  # [rad]
    time: float = math.inf  # [s]
    share: float = math.inf  # of the way

    def __post_init__(self) -> None:
        sizes = self.ahead, self.left, self.turn
        if not all(abs(size) <= FAR for size in sizes):
            raise RequestError(
                f"a jump needs numbers of at most {FAR:g}, got {sizes[0]:g} m ahead, {sizes[1]:g} m left,"
                f" {sizes[2]:g} rad"
            )
        if math.isnan(self.time) or math.isnan(self.share):
            raise RequestError("a jump needs a time in s, or a share of the way in %, got nan")


@dataclass(frozen=True, slots=True)
class Sensing:
    """Of the closed loop: how often it runs, and what is wrong with what it is told.

    Raises:
        RequestError: a rate, delay or sigma beyond ``RATES``, ``SELDOM`` or ``LIMITS``, a time without poses that ends
            before it begins.
    """

    rate: float = 50.0  # [Hz] of the controller
    delay: float = 0.0  # [s] of the pose
    position_sigma: float = 0.0  # [m] each axis, white
    yaw_sigma: float = 0.0  # [rad]
    wheel_sigma: float = 0.0  # [m/s] of each rim speed
    gyro_sigma: float = 0.0  # [rad/s]
    jumps: tuple[Jump, ...] = ()
    lost: tuple[tuple[float, float], ...] = ()  # [s] from and to: no pose comes
    pose_rate: float | None = None  # [Hz] None, or more than the controller's: one comes in each of its samples

    def __post_init__(self) -> None:
        if not RATES[0] <= self.rate <= RATES[1]:
            raise RequestError(
                f"the rate of the controller must be from {RATES[0]:g} to {RATES[1]:g} Hz, got {self.rate:g}"
            )
        if self.pose_rate is not None and not SELDOM <= self.pose_rate < math.inf:
            raise RequestError(f"the rate of the poses must be at least {SELDOM} Hz, got {self.pose_rate:g}")
        for name, (most, words, told) in LIMITS.items():
            if not 0.0 <= getattr(self, name) <= most:
                raise RequestError(f"the {words} must be at least 0 and at most {told}, got {getattr(self, name):g}")
        for start, end in self.lost:
            if not start < end:
                raise RequestError(f"poses are lost from one time to a later one, got {start} to {end} s")

    @property
    def poses(self) -> float:
        """Rate [Hz] at which poses come."""
        return self.rate if self.pose_rate is None else min(self.pose_rate, self.rate)


IDEAL = Sensing()


class Localization:
    """Poses that the controller is told. It remembers those of the delay, and how far its map has leapt."""

    def __init__(self, sensing: Sensing, seed: int) -> None:
        self._sensing, self._waiting = sensing, list(sensing.jumps)
        self._offset: FloatArray | None = None  # of the map
        self._past: list[Triple] = []  # poses in the map
        self._late = sensing.delay * sensing.rate  # [samples]
        self._share = sensing.poses / sensing.rate  # of the samples at which a pose comes
        self._sigma = np.array([sensing.position_sigma, sensing.position_sigma, sensing.yaw_sigma])
        self._rng = np.random.default_rng([seed, 0]) if self._sigma.any() else None
        self._noise: list[Triple] = []

    def place(self, pose: Triple, t: float, share: float) -> Triple:
        """Where a robot at a pose is in the map, at a time [s], when a share of the way is driven."""
        placed = pose if self._offset is None else _triple(compose(self._offset, pose))
        for jump in [j for j in self._waiting if t >= j.time or share >= j.share]:
            self._waiting.remove(jump)
            placed = _triple(compose(placed, (jump.ahead, jump.left, jump.turn)))
            self._offset = compose(placed, invert(pose))
        return placed

    def see(self, placed: Triple, t: float) -> Triple | None:
        """The pose told at a time [s], late and noisy; None where none comes. Called once a sample."""
        self._past.append(placed)
        if not self._due() or any(start <= t < end for start, end in self._sensing.lost):
            return None
        pose = self._delayed() if self._late > 0.0 else placed
        if self._rng is None:
            return pose
        if not self._noise:
            self._noise = (self._sigma * self._rng.standard_normal((BLOCK, 3))).tolist()
        dx, dy, turn = self._noise.pop()
        return pose[0] + dx, pose[1] + dy, pose[2] + turn

    def _due(self) -> bool:
        """Whether a pose comes in this sample: the first one at or after each period of the poses."""
        n = len(self._past) - 1
        return math.floor(n * self._share + 1e-9) > math.floor((n - 1) * self._share + 1e-9)

    def _delayed(self) -> Triple:
        at = max(len(self._past) - 1 - self._late, 0.0)
        i, share = int(at), at % 1.0
        if share == 0.0:
            return self._past[i]
        a, b = self._past[i], self._past[i + 1]
        return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])


def _triple(pose: FloatArray) -> Triple:
    x, y, yaw = pose.tolist()
    return x, y, yaw


def twist_meter(model: Model, sensing: Sensing, seed: int) -> Callable[[list[float]], Triple]:
    """How a twist is measured: v_x and v_y by a model from rim speeds, omega by a gyro.

    Returns:
        From v_x, v_y, omega and both rim speeds the measured twist.
    """
    twist = twist_function(model)
    if not (sensing.wheel_sigma or sensing.gyro_sigma):
        return lambda moving: (*twist(moving[3], moving[4])[:2], moving[2])
    sigma = np.array([sensing.wheel_sigma, sensing.wheel_sigma, sensing.gyro_sigma])
    rng = np.random.default_rng([seed, 1])
    noise: list[Triple] = []

    def measured(moving: list[float]) -> Triple:
        if not noise:
            noise.extend((sigma * rng.standard_normal((BLOCK, 3))).tolist())
        left, right, gyro = noise.pop()
        return *twist(moving[3] + left, moving[4] + right)[:2], moving[2] + gyro

    return measured


def twist_function(model: Model) -> Callable[[float, float], Triple]:
    """Twist of left and right rim speed [m/s], of one sample in plain numbers."""
    if not isinstance(model, MatrixModel):
        return lambda left, right: _triple(model.twist(left, right))
    (a, b), (c, d), (e, f) = model.matrix().tolist()
    return lambda left, right: (a * left + b * right, c * left + d * right, e * left + f * right)
