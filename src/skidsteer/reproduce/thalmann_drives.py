"""Simulated drives after Thalmann 2016, section 3: 6 to 7 minutes of straight lines and arcs at about 0.5 m/s.

The paper prints neither the dimensions of the robot nor its slip: both are assumed. The effective track width is the
nominal one; the right side slips a little more than the left one. Encoders count at 10 Hz and sometimes repeat the last
speed of one side under acceleration (section 3.1); a total station measures the target on the robot at 5 Hz, without a
gap. Slip and random walk are chosen so that the errors after three minutes are about the paper's: the method is tested.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Series
from skidsteer.models.transfer_factor import TransferFactor
from skidsteer.odometry.state_choice import SystemNoise
from skidsteer.odometry.thalmann_replay import Tracking
from skidsteer.se2 import FloatArray
from skidsteer.simulate import Sensors, kinematic_drive
from skidsteer.vehicle import Vehicle

ROBOT = Vehicle("thalmann-ssmr", track_width=0.40, wheel_radius=0.11, source="assumed; the paper prints none")
FACTOR = 10  # samples of the simulation to one of the encoders: 100 Hz to 10 Hz
ACCELERATION = 0.25  # [m/s^2]: two seconds to 0.5 m/s, as in Figs. 8 and 9
TURNING = 0.1  # [m/s^2] by which the difference of the sides changes
COUNT = 0.0005  # [m] rolled for one count of an encoder
REPEATED = 0.02  # share of samples under acceleration in which one side repeats its last speed
SENSORS = Sensors(reference_rate=5.0, position_sigma=0.005, yaw_sigma=1e-6)
WANDER = (0.002, 0.002)  # [m/sqrt(m)], [rad/sqrt(m)] random walk of the pose, which no calibration removes
NOISE = SystemNoise(ACCELERATION, 2.0 * TURNING, encoder=0.003, walk=WANDER[0], turn=WANDER[1])


@dataclass(frozen=True, slots=True)
class Site:
    """Where the robot drives: slip of the right side, and length of the lines."""

    name: str
    slip: float  # of the right side; Thalmann's transfer-factor difference
    line: float  # [m] of the longest straight lines


LABORATORY = Site("laboratory", 0.0007, 5.0)
ROOFTOP = Site("rooftop", 0.0005, 8.0)


def drive(site: Site, seed: int) -> tuple[Series, Tracking]:
    """Wheels (n, 2) [m/s] at 10 Hz by the encoders, and the track of the target, of one drive."""
    rng = np.random.default_rng([seed, int(1e6 * site.slip)])
    rims = _rims(_rounds(site.line, rng))
    truth = TransferFactor(0.0, site.slip, 1.0, ROBOT.track_width)
    noise = int(rng.integers(2**31))
    seen = kinematic_drive(site.name, ROBOT, truth, rims, SENSORS, motion_noise=WANDER, seed=noise)
    assert seen.pose is not None
    positions = Series(seen.pose.t, seen.pose.values[:, :2], "positions")
    return with_repeats(counted(rims), REPEATED, rng)[0], Tracking(positions, SENSORS.position_sigma)


def _rounds(line: float, rng: np.random.Generator) -> FloatArray:
    """Rows of duration [s], v [m/s], difference of the sides [m/s]: rectangles with round corners, to both sides."""
    rows: list[list[float]] = [[3.0, 0.0, 0.0]]
    while sum(row[0] for row in rows) < 385.0:
        v, radius, side = rng.uniform(0.45, 0.6), rng.uniform(0.8, 1.5), rng.choice([-1.0, 1.0])
        for length in (line, 0.6 * line, line, 0.6 * line):
            corner = [0.5 * np.pi * radius / v, v, side * v * ROBOT.track_width / radius]
            rows += [[length / v, v, 0.0], corner]
        rows += [[4.0, 0.0, 0.0]]
    return np.array(rows)


def _rims(rows: FloatArray) -> Series:
    """Rim speeds (n, 2) at 100 Hz that follow rows of duration, v, difference, each with its own acceleration."""
    t = np.arange(0.0, rows[:, 0].sum(), 0.01)
    wanted = rows[np.minimum(np.searchsorted(np.cumsum(rows[:, 0]), t, side="right"), len(rows) - 1), 1:]
    motion = np.zeros_like(wanted)
    most = 0.01 * np.array([ACCELERATION, TURNING])
    for i in range(1, len(t)):
        motion[i] = motion[i - 1] + np.clip(wanted[i] - motion[i - 1], -most, most)
    return Series(t, motion @ [[1.0, 1.0], [-0.5, 0.5]], "wheels")


def counted(rims: Series) -> Series:
    """Speeds at 10 Hz by whole counts of the encoders, each over the time until the next."""
    rolled = np.concatenate([np.zeros((1, 2)), np.cumsum(rims.values / 100.0, axis=0)])[::FACTOR]
    speeds = np.diff(np.round(rolled / COUNT) * COUNT, axis=0) * 100.0 / FACTOR
    return Series(rims.t[::FACTOR][: len(speeds)], speeds, "wheels")


def with_repeats(wheels: Series, share: float, rng: np.random.Generator) -> tuple[Series, np.ndarray]:
    """Let one side repeat its last speed in a share of the samples under acceleration.

    Returns:
        The wheels, and a mask (n, 2) of the samples that repeat.
    """
    faster = np.abs(np.diff(wheels.values.mean(axis=1), prepend=wheels.values[0].mean())) > 0.5 * ACCELERATION * 0.1
    hit = faster & (rng.random(len(wheels)) < share)
    hit[0] = False
    side = rng.integers(0, 2, len(wheels))
    repeated = np.zeros((len(wheels), 2), bool)
    repeated[np.flatnonzero(hit), side[hit]] = True
    values = np.where(repeated, np.roll(wheels.values, 1, axis=0), wheels.values)
    return Series(wheels.t, values, "wheels"), repeated
