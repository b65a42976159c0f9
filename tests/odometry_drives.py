"""Simulated drives for filters: two grounds in one drive, or a ground that wanders as a filter assumes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from skidsteer.drive import Series
from skidsteer.models import Differential, Icr
from skidsteer.noise import Noise
from skidsteer.odometry.icr_filter import FilterOptions, IcrFilter
from skidsteer.odometry.log import Log
from skidsteer.se2 import FloatArray, chain, compose, exp
from skidsteer.simulate import rims_from_manoeuvres
from skidsteer.vehicle import preset
from skidsteer.windows import Timing, Windows, linearize, steps

VEHICLE = preset("pioneer-p3at")
ASPHALT = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)  # Mandow 2007, Table I
SAND = Icr(0.36, -0.40, -0.06, 0.86, 0.84)  # wider by 35 %, behind by 5 cm, 7 % less of the rims: made up
LAG = 0.08  # [s]
NOISE = Noise(position=0.01, yaw=float(np.radians(0.5)), stamp=1e-4, walk=0.004, turn=0.008, gyro=0.002)
SIGMA = 0.01  # of each parameter at the start
NAMES = tuple(p.name for p in Icr.PARAMETERS)
REFERENCE = np.diag([NOISE.position**2, NOISE.position**2, NOISE.yaw**2])


@dataclass(frozen=True, eq=False)
class Truth:
    """A drive, and where the robot really was at the stamps t (m,) of its reference, with which parameters."""

    log: Log
    t: FloatArray
    poses: FloatArray  # (m, 3)
    theta: FloatArray  # (m, 5), of the interval that begins there

    def before(self, end: float) -> Log:
        """The log up to a time."""
        wheels = self.log.wheels.between(0.0, end)
        assert wheels is not None
        return Log(wheels, self.log.reference, self.log.covariance, gyro=self.log.gyro, gyro_walk=self.log.gyro_walk)


def turning(duration: float, rng: np.random.Generator, rate: float = 50.0) -> Series:
    """Rim speeds of curves left and right, at most 0.8 rad/s."""
    rows: list[list[float]] = []
    while sum(row[0] for row in rows) < duration:
        rows.append([rng.uniform(3.0, 6.0), rng.uniform(0.1, 0.5), rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.8)])
    return rims_from_manoeuvres(np.array(rows), Differential(VEHICLE.track_width), rate)


def simulated(rims: Series, theta: FloatArray, rng: np.random.Generator, rate: float = 5.0, sees: int = 3) -> Truth:
    """A drive whose parameters in each interval of the reference are the rows of theta (m, 5); one row: in all."""
    t = np.arange(0.0, rims.t[-1], 1.0 / rate)
    windows = Windows(t[:-1], t[1:], np.zeros((len(t) - 1, 3)), np.ones(len(t) - 1, bool))
    theta = np.broadcast_to(theta, (len(t), 5))
    cut = steps(rims, windows, Timing(0.0, LAG))
    grounds, ground = np.unique(theta[:-1], axis=0, return_inverse=True)
    if len(grounds) <= 2:
        by_ground = np.array([linearize(ASPHALT.with_theta(row), cut)[0] for row in grounds])
        motion = by_ground[ground.ravel(), np.arange(len(t) - 1)]
    else:  # small deviations
        motion, J = linearize(ASPHALT.with_theta(theta[0]), cut)
        motion = motion + np.einsum("kij,kj->ki", J[..., :5], theta[:-1] - theta[0])
    rolled, apart = 0.5 * np.abs(cut.distance).sum(axis=1), 0.5 * np.abs(cut.distance[:, 1] - cut.distance[:, 0])
    steps_ = np.stack([rolled, rolled, 0.9 * apart + 0.1 * rolled], axis=1)
    paths = np.array([steps_[a:b].sum(axis=0) for a, b in pairwise(cut.offsets)])
    spread = np.sqrt(paths) * [NOISE.walk, NOISE.walk, NOISE.turn]
    poses = chain(compose(motion, exp(spread * rng.standard_normal(motion.shape))))
    seen = poses + np.sqrt(np.diag(REFERENCE)) * rng.standard_normal(poses.shape)
    wheels = rims.between(0.0, t[-1])
    assert wheels is not None
    log = Log(wheels, Series(t[1:], seen[1:, :sees]), REFERENCE[:sees, :sees])
    return Truth(log, t, poses, theta)


def two_grounds(seed: int, change: float = 100.0, duration: float = 250.0) -> Truth:
    """Asphalt up to ``change`` [s], then sand."""
    rng = np.random.default_rng(seed)
    rims = turning(duration, rng)
    t = np.arange(0.0, rims.t[-1], 0.2)
    return simulated(rims, np.where((t < change - 1e-9)[:, None], ASPHALT.theta, SAND.theta), rng)


def make_filter(sigma: float = SIGMA, gyro: bool = False, lag: float = LAG, **options: float | bool) -> IcrFilter:
    """The filter that was calibrated on asphalt."""
    P, bounds = sigma**2 * np.eye(5), Icr.bounds(VEHICLE)
    return IcrFilter(ASPHALT, NAMES, P, bounds, NOISE, lag, gyro, options=FilterOptions(**options))  # type: ignore[arg-type]
