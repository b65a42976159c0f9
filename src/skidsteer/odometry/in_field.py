"""Two phases, Thalmann 2016, section 3.2: calibrate while a total station sees the robot, then reckon without it.

In the first phase the slip parameters are states of the filter, corrected by positions alone; initial heading, delay of
the positions and noise are found by maximum likelihood of the same filter. In the second phase the slips are constants,
and the wheels are all there is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from skidsteer.calibration import Estimate
from skidsteer.drive import Series
from skidsteer.errors import DataError
from skidsteer.models.transfer_factor import TransferFactor
from skidsteer.odometry.kinematic_ekf import KinematicEkf
from skidsteer.odometry.state import FilterState
from skidsteer.odometry.thalmann_replay import Replay, Tracking, replay
from skidsteer.se2 import FloatArray, rotate

HEADINGS = 8  # initial headings that are tried, each with half the step to the next as its sigma
OFFSETS = np.arange(-0.3, 1.25, 0.15)  # [s] delays of the positions that are tried
FIRST_NOISE = np.log([0.1, 0.03, 0.02])  # stamps [s], walk [m/sqrt(m)], turn [rad/sqrt(m)]: start of the search
LIMITS = np.log([1e-4, 1.0])  # of the search
ROUNDS = 2  # of relinearisation
LEAST_TRAVEL = 1.0  # [m] of motion, seen by the reference, that a calibration needs


@dataclass(frozen=True, slots=True, eq=False)
class InField:
    """Result of the first phase."""

    filter: KinematicEkf
    replay: Replay

    @property
    def slips(self) -> dict[str, Estimate]:
        """The slip parameters at the end."""
        last = self.replay.last
        sigmas = np.sqrt(np.diag(last.covariance))
        return {
            name: Estimate(float(last.mean[i]), float(sigmas[i]), "") for i, name in enumerate(self.filter.estimated, 5)
        }

    @property
    def reckoner(self) -> KinematicEkf:
        """The filter of the second phase: the same with the slips as constants."""
        return frozen(self.filter, {name: e.value for name, e in self.slips.items()})


def frozen(filter: KinematicEkf, slips: dict[str, float]) -> KinematicEkf:
    """The same filter with slip parameters that are constants."""
    names = [p.name for p in TransferFactor.PARAMETERS]
    values = [slips.get(name, value) for name, value in zip(names, filter.model.theta, strict=True)]
    return replace(filter, model=filter.model.with_theta(np.array(values)), estimated=())


def start_on_track(
    filter: KinematicEkf, wheels: Series, tracking: Tracking, known: FilterState | None = None
) -> FilterState:
    """The state at the first position within the wheel samples, with the most likely heading.

    Args:
        filter: of the state.
        wheels: (n, 2) rim speeds [m/s].
        tracking: positions.
        known: a state from an earlier drive, whose slips are taken over.

    Raises:
        DataError: wheels and positions share no time, or the robot is not seen to move.
    """
    starts = _starts(filter, wheels, tracking, known)
    return min(starts, key=lambda start: _deviance(filter, start, wheels, tracking))


def _starts(filter: KinematicEkf, wheels: Series, tracking: Tracking, known: FilterState | None) -> list[FilterState]:
    """States with headings all around."""
    if not _seen_to_move(wheels, tracking):
        raise DataError(f"the positions do not show the robot moving by {LEAST_TRAVEL} m while wheels were recorded")
    first = int(np.searchsorted(tracking.t, wheels.t[0]))
    at = float(wheels.t[int(np.searchsorted(wheels.t, tracking.t[first], side="right")) - 1])
    headings = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
    poses = np.column_stack([tracking.positions.values[first] - rotate(headings, np.array(tracking.lever)), headings])
    spread = np.diag([tracking.sigma, tracking.sigma, np.pi / HEADINGS]) ** 2
    return [filter.start(at, pose, spread, known) for pose in poses]


def _seen_to_move(wheels: Series, tracking: Tracking) -> bool:
    seen = tracking.positions.values[(tracking.t >= wheels.t[0]) & (tracking.t <= wheels.t[-1])]
    return bool(len(seen) and np.hypot(*(seen - seen[0]).T).max() >= LEAST_TRAVEL)


def _deviance(filter: KinematicEkf, start: FilterState, wheels: Series, tracking: Tracking) -> float:
    return replay(filter, start, wheels, tracking, covariances=False).deviance


def calibrate_in_field(
    filter: KinematicEkf, wheels: Series, tracking: Tracking, known: FilterState | None = None
) -> InField:
    """The first phase: estimate the slips of a filter while the robot is seen.

    The filter linearises about its estimate, which is poor at the beginning: it is run again, linearised about the
    slips found and the most likely initial heading, with the same prior covariance.

    Args:
        filter: with ``estimated`` slips.
        wheels: (n, 2) rim speeds [m/s].
        tracking: positions, with what is known of their noise and delay (see ``tune``).
        known: the state at the end of an earlier drive, to continue from its slips.

    Raises:
        DataError: wheels and positions share no time, or the robot is not seen to move.
        RequestError: ``known`` is a state of another filter.
    """
    start = start_on_track(filter, wheels, tracking, known)
    for _ in range(ROUNDS):
        slips = replay(filter, start, wheels, tracking, covariances=False).last.mean[5:]
        start = _about(filter, start, slips, wheels, tracking)
    return InField(filter, replay(filter, start, wheels, tracking))


def _about(
    filter: KinematicEkf, start: FilterState, slips: FloatArray, wheels: Series, tracking: Tracking
) -> FilterState:
    """The same start, linearised about slips and the most likely initial heading."""
    yaw, half = float(start.mean[2]), np.pi / HEADINGS
    target = start.mean[:2] + rotate(yaw, tracking.lever)

    def heading(angle: float) -> FilterState:
        mean = np.r_[target - rotate(angle, tracking.lever), angle, start.mean[3:5], slips]
        return replace(start, mean=mean)

    def deviance(angle: float) -> float:
        return _deviance(filter, heading(angle), wheels, tracking)

    return heading(float(minimize_scalar(deviance, bounds=(yaw - half, yaw + half), options={"xatol": 0.005}).x))


def calibrate_around(filter: KinematicEkf, wheels: Series, tracking: Tracking, start: float, end: float) -> InField:
    """The first phase on what was seen before ``start`` and after ``end`` [s], as two drives.

    Raises:
        DataError: the robot is seen to move neither before nor after it.
    """
    found: InField | None = None
    for part in (wheels.between(-np.inf, start), wheels.between(end, np.inf)):
        if part is not None and _seen_to_move(part, tracking):
            found = calibrate_in_field(filter, part, tracking, found.replay.last if found else None)
    if found is None:
        raise DataError(f"the robot is seen to move neither before {start:.1f} s nor after {end:.1f} s")
    return found


def tune(filter: KinematicEkf, wheels: Series, tracking: Tracking) -> tuple[KinematicEkf, Tracking]:
    """Maximum-likelihood delay and scatter of the stamps, and random walk of the pose.

    Args:
        filter: its ``noise.walk`` and ``noise.turn`` are estimated.
        wheels: (n, 2) rim speeds [m/s].
        tracking: its ``time_offset`` and ``stamp_sigma`` are estimated; ``sigma`` is kept.

    Raises:
        DataError: wheels and positions share no time, or the robot is not seen to move.
    """

    def at(x: FloatArray) -> tuple[KinematicEkf, Tracking]:
        stamp, walk, turn = np.exp(np.clip(x[1:], *LIMITS))
        noise = replace(filter.noise, walk=float(walk), turn=float(turn))
        return replace(filter, noise=noise), replace(tracking, time_offset=float(x[0]), stamp_sigma=float(stamp))

    def first_try(x: FloatArray) -> float:
        tuned, seen = at(x)
        return _deviance(tuned, start_on_track(tuned, wheels, seen), wheels, seen)

    x0 = min((np.array([offset, *FIRST_NOISE]) for offset in OFFSETS), key=first_try)
    tuned, seen = at(x0)
    begin = calibrate_in_field(tuned, wheels, seen).replay.state(tuned, 0)

    def cost(x: FloatArray) -> float:
        tuned, seen = at(x)
        return _deviance(tuned, replace(begin, filter=tuned.fingerprint), wheels, seen)

    simplex = np.vstack([x0, x0 + np.diag([0.1, 0.5, 0.5, 0.5])])
    options: Any = {"initial_simplex": simplex, "xatol": 0.01, "fatol": 0.1}
    return at(minimize(cost, x0, method="Nelder-Mead", options=options).x)
