"""Repeated encoder samples under acceleration, Thalmann 2016, section 3.1: which filter detects them?

Simulated straight runs: at rest, to 0.5 m/s at 0.25 m/s^2, on at that speed; encoders at 10 Hz with counts of half a
millimetre. In one of ten samples under acceleration one side repeats its last speed.

The basic model expects the last speed: a sample that repeats it is compatible and the others are not, the less so the
smaller its disturbance acceleration. By the difference of the sides, which is constant on a straight run, the
alternative model detects the side that stays behind.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Series
from skidsteer.odometry.kinematic_ekf import thalmann_filter
from skidsteer.odometry.state_choice import SystemNoise
from skidsteer.odometry.thalmann_replay import replay
from skidsteer.reproduce.thalmann_drives import ACCELERATION, ROBOT, counted, with_repeats

RUNS = 400
SHARE = 0.1  # of the samples under acceleration that repeat
SPEED = 0.5  # [m/s]
DIFFERENCE = 0.02  # [m/s^2] disturbance of the difference of the sides
ENCODER = 0.003  # [m/s]


@dataclass(frozen=True, slots=True)
class Detection:
    """Result of the compatibility test (significance 0.1 %) on samples under acceleration."""

    filter: str
    disturbance: float  # [m/s^2] of the speed, or of each side
    found: float  # share of repeated samples whose side, or whose difference of the sides, was excluded
    false: float  # share of the same observations excluded though no side repeats
    speed_excluded: float  # share of good samples whose other observation was excluded


def detection(name: str, disturbance: float) -> Detection:
    """Measure the filter ``basic`` or ``alternative`` with a disturbance acceleration [m/s^2]."""
    noise = SystemNoise(disturbance, DIFFERENCE, ENCODER)
    filter = thalmann_filter(name, ROBOT.track_width, noise)
    rng = np.random.default_rng(0)
    hits: list[bool] = []
    alarms: list[bool] = []
    others: list[bool] = []
    for _ in range(RUNS):
        wheels, repeated = with_repeats(counted(_run(rng)), SHARE, rng)
        start = filter.start(float(wheels.t[0]), np.zeros(3), 1e-6 * np.eye(3))
        excluded = ~replay(filter, start, wheels, covariances=False).taken
        accelerates = (wheels.t > 1.0) & (wheels.t < 1.0 + SPEED / ACCELERATION)
        any_side = repeated.any(axis=1)
        good = accelerates & ~any_side
        if name == "basic":
            hits += list(excluded[repeated])
            alarms += list(excluded[good].ravel())
        else:
            hits += list(excluded[any_side, 1])
            alarms += list(excluded[good, 1])
            others += list(excluded[good, 0])
    rest = float(np.mean(others)) if others else float("nan")
    return Detection(name, disturbance, float(np.mean(hits)), float(np.mean(alarms)), rest)


def _run(rng: np.random.Generator) -> Series:
    """Rim speeds (n, 2) at 100 Hz; the start of the counts is random."""
    t = np.arange(0.0, 12.0, 0.01)
    begin = 1.0 + rng.uniform(0.0, 0.1)
    v = np.clip(ACCELERATION * (t - begin), 0.0, SPEED)
    v = v + rng.uniform(0.0, 0.1, 2)[:, None] * (t < 0.01)[None]  # counts begin anywhere
    return Series(t, v.T, "wheels")
