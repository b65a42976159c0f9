"""The filter with ICR states timed beside filterpy's on the same drive, and its live step from Python."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

import speed
from skidsteer.drive import Series
from skidsteer.kernels import icr_filter as kernel
from skidsteer.models import Icr
from skidsteer.noise import Noise
from skidsteer.odometry.icr_filter import IcrFilter
from skidsteer.odometry.log import Event, Log, Step
from skidsteer.odometry.state import FilterState
from skidsteer.odometry.trajectory import replay
from skidsteer.se2 import FloatArray

SIGMA = 0.003  # of each parameter at the start
NOISE = Noise(position=0.01, yaw=float(np.radians(0.5)), stamp=1e-4, walk=0.01, turn=0.01)
SHARE = 0.01  # of the samples that filterpy is given


@dataclass(frozen=True)
class FilterTimes:
    """Seconds of processor time."""

    batch: float  # a wheel sample, references included
    filterpy: float  # a wheel sample, references included
    live: float  # one predict from Python
    states: int
    difference: float  # of both last poses, in sigmas


def compare(repeats: int) -> FilterTimes:
    """The same filter on the same drive: ours over all samples, filterpy over the first hundredth."""
    drive = speed.drive()
    assert drive.pose is not None
    seen = Series(drive.pose.t - speed.TIMING.time_offset, drive.pose.values, "pose")
    covariance = np.diag([NOISE.position**2, NOISE.position**2, NOISE.yaw**2])
    log = Log(drive.wheels, seen, covariance)
    names = tuple(p.name for p in Icr.PARAMETERS)
    bounds = Icr.bounds(drive.vehicle)
    ours = IcrFilter(speed.TRUTH, names, SIGMA**2 * np.eye(5), bounds, NOISE, speed.TIMING.lag)
    start = ours.start(float(drive.wheels.t[0]), seen.values[0], 0.01 * np.eye(3))
    part = Log(_first(drive.wheels, SHARE), seen, covariance)
    events = [event for happens in part.events() for event in happens]
    begun = time.process_time()
    theirs = _filterpy(ours, start, covariance, events)
    other = (time.process_time() - begun) / len(part.wheels)
    last = replay(ours, start, part).last
    apart = np.abs(last.mean - theirs.x) / np.sqrt(np.diag(last.covariance))
    batch = speed.timed(lambda: replay(ours, start, log), repeats) / len(log.wheels)
    return FilterTimes(batch, other, _live(ours, start, repeats), len(start.mean), float(apart.max()))


def _first(wheels: Series, share: float) -> Series:
    count = int(share * len(wheels))
    return Series(wheels.t[:count], wheels.values[:count], wheels.name)


def _live(ours: IcrFilter, start: FilterState, repeats: int, steps: int = 2000) -> float:
    def drive_on() -> None:
        state = start
        for _ in range(steps):
            state = ours.predict(state, (0.4, 0.5), 0.01)

    return speed.timed(drive_on, repeats) / steps


def _filterpy(ours: IcrFilter, start: FilterState, covariance: FloatArray, events: list[Event]) -> ExtendedKalmanFilter:
    """The same steps with filterpy's update; lag, motion, F and Q by NumPy as one would write them."""
    ekf = ExtendedKalmanFilter(dim_x=8, dim_z=3)
    ekf.x, ekf.P, ekf.R = start.mean.copy(), start.covariance.copy(), covariance
    setup, behind, H = kernel.unpacked(ours.setup), None, np.eye(3, 8)
    reach, ground, Q = setup.settings[kernel.REACH], setup.ground, np.zeros((8, 8))
    for event in events:
        if not isinstance(event, Step):
            z = event.pose.copy()
            z[2] = ekf.x[2] + (z[2] - ekf.x[2] + np.pi) % (2.0 * np.pi) - np.pi
            ekf.update(z, lambda x: H, lambda x: x[:3])
            continue
        v, dt = np.array(event.wheels), event.dt
        behind = v if behind is None else behind
        decay = math.exp(-dt / ours.lag)
        distance = v * dt + (behind - v) * ours.lag * (1.0 - decay)
        behind = v + (behind - v) * decay
        rolled = 0.5 * np.abs(distance).sum()
        kept = math.exp(-rolled / reach)
        moved, ekf.F = _moved(ekf.x, distance)
        ekf.F[3:, 3:] *= kept
        Q[0, 0] = Q[1, 1] = NOISE.walk**2 * rolled
        Q[2, 2] = NOISE.turn**2 * (0.9 * 0.5 * abs(distance[1] - distance[0]) + 0.1 * rolled)
        Q[3:, 3:] = (1.0 - kept**2) * ground
        ekf.P = ekf.F @ ekf.P @ ekf.F.T + Q
        ekf.x = ekf.x + moved
    return ekf


def _moved(x: FloatArray, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Change of the state (8,) and its transition (8, 8)."""
    model = Icr(*x[3:])
    increment = model.twist(distance[0], distance[1])
    J = model.parameter_jacobian(distance[0], distance[1])
    half = 0.5 * increment[2]
    c, s = np.cos(x[2] + half), np.sin(x[2] + half)
    R, sinc = np.array([[c, -s], [s, c]]), np.sinc(half / np.pi)
    shift = sinc * (R @ increment[:2])
    F, moved = np.eye(8), np.zeros(8)
    moved[:2], moved[2] = shift, increment[2]
    F[:2, 2] = -shift[1], shift[0]
    F[:2, 3:] = sinc * (R @ J[:2]) + 0.5 * np.outer([-shift[1], shift[0]], J[2])
    F[2, 3:] = J[2]
    return moved, F


if __name__ == "__main__":
    print(compare(5))
