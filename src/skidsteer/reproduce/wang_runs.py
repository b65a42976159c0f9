"""Wang's 40 runs, sections 3.1 and 3.4, and the dead reckoning of 3.5: a simulated robot before a simulated scanner.

Each run is as in the paper: the robot drives with constant rim speeds in sight of the scanner, encoder counts give what
the sides roll, the plate gives the angle. In place of the two ends of a turn, Eq. (25), a line is fitted to the angles
of all scans at constant speed. The scanner makes a third of its 270 scans a second.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from skidsteer import se2
from skidsteer.drive import Series
from skidsteer.errors import DataError
from skidsteer.identify.circle_test import CoefficientFit, chi_of_run, fit_coefficient, wang_protocol
from skidsteer.laser.plate import Plate
from skidsteer.laser.scans import SCANNERS
from skidsteer.laser.scene import simulate_scans
from skidsteer.laser.track import track_plate
from skidsteer.models import Model, SymmetricIcr
from skidsteer.se2 import FloatArray
from skidsteer.simulate import Motion, Sensors, recorded
from skidsteer.terramechanics.dynamics import move
from skidsteer.terramechanics.robot import wang_robot
from skidsteer.terramechanics.steady_turn import steady_turn
from skidsteer.terramechanics.terrain import TERRAINS, Terrain

ROBOT = wang_robot()
VEHICLE = ROBOT.vehicle
TILES = TERRAINS["tiles"]
SEED, SEED_EXAMPLE = 2015, 48  # of the scanner's noise in the runs, on the example path
COUNT = 2.0 * np.pi * VEHICLE.wheel_radius / 8192.0  # [m] rolled for one count of an encoder, section 3.2
PLATE = Plate(0.290, side="left")  # of the robot the scanner stands
SCANNER = replace(SCANNERS["lms400"], rate=90.0)
AHEAD = 2.2  # [m] of the scanner lies the middle between both ends of a run
HALF_CHORD = 1.1  # [m] between them at most, for the field
HALF_ANGLE = 1.0  # [rad] turned at most, for the plate to be seen
STAND = 0.5  # [s] before and after a run
SETTLE = 0.5  # [s] until the speed is constant, or the robot at rest
FACTORY_CHI = 1.5  # Eq. (46)
FACTORY_Y = 0.5 * FACTORY_CHI * VEHICLE.track_width  # [m] y0 of it
STRAIGHT = (0.3, 5.0)  # [m/s], [s] of the run that corrects the distances, Eq. (42)
EXAMPLE = np.array([[0.2, 0.15], [0.2, 0.1], [0.3, 0.1], [0.4, 0.0], [0.3, 0.2], [0.3, 0.25]])  # Eq. (48), 1 s each


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """A drive in front of the scanner, by encoders and plate."""

    wheels: Series  # (n, 2) rim speeds [m/s] by counts
    poses: Series  # (k, 3) in the scanner's frame, from the plate
    motion: Motion  # the true one, from the origin

    def rolled(self, t: FloatArray) -> FloatArray:
        """What the sides (k, 2) have rolled [m] at times t (k,)."""
        steps = self.wheels.values[:-1] * np.diff(self.wheels.t)[:, None]
        whole = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        return np.column_stack([np.interp(t, self.wheels.t, side) for side in whole.T])

    def between(self, start: float, end: float) -> Series:
        """The poses from one time to another [s].

        Raises:
            DataError: the plate was out of sight.
        """
        seen = self.poses.between(start, end)
        if seen is None:
            raise DataError(f"the plate is out of sight from {start:.2f} to {end:.2f} s")
        return seen


def watch(rims: ArrayLike, durations: ArrayLike, terrain: Terrain, seed: int) -> Watched:
    """Drive rim speeds (k, 2) [m/s] for durations (k,) [s] one after the other, in front of the scanner.

    Raises:
        RequestError: speeds beyond what the robot's wheels can do.
        DataError: the plate is seen in no scan.
    """
    times = np.cumsum([0.0, STAND, *np.asarray(durations, dtype=float), SETTLE + STAND])
    rest = np.zeros((1, 2))
    motion = move(ROBOT, terrain, Series(times, np.concatenate([rest, np.asarray(rims, dtype=float), rest, rest])))
    wheels = recorded("run", VEHICLE, motion, Sensors(encoder_step=COUNT, encoder_rate=100.0)).wheels
    middle = 0.5 * (motion.pose[0] + motion.pose[-1])
    place = se2.compose([AHEAD, 0.0, 0.5 * np.pi], se2.invert(middle))
    poses = se2.compose(place, motion.pose_at(np.arange(0.0, times[-1], 1.0 / SCANNER.rate)))
    scans = simulate_scans(SCANNER, [(poses, PLATE.width)], seed=seed)
    return Watched(wheels, track_plate(scans, PLATE, wheels, rate=SCANNER.rate).series(), motion)


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """The n runs and their results."""

    path_curvature: FloatArray  # lambda
    speed: FloatArray  # [m/s]
    chi: FloatArray  # by counts and scans, Eqs. (15), (25), (36)
    steady_chi: FloatArray  # of the plant itself, forces in balance
    scale: float  # by which the counted distances were corrected, Eq. (42)

    def of(self, path_curvature: float) -> FloatArray:
        """Chi of the runs of one lambda."""
        return np.asarray(self.chi[self.path_curvature == path_curvature])

    def fit(self) -> CoefficientFit:
        """Eq. (44) through the mean chi of each lambda, as Table 3 has them."""
        ratios = np.unique(self.path_curvature)
        return fit_coefficient(ratios, [float(self.of(ratio).mean()) for ratio in ratios])


def runs(protocol: ArrayLike | None = None, terrain: Terrain = TILES) -> Runs:
    """Drive the runs.

    Args:
        protocol: rows (n, 4) as `wang_protocol` gives them; None: those that the robot can drive, 37 of 40.
        terrain: the laboratory's floor.
    """
    rows = wang_protocol(VEHICLE.max_wheel_speed) if protocol is None else np.asarray(protocol, dtype=float)
    scale = _scale(terrain, SEED)
    chi = [_chi(row, scale, terrain, SEED + 1 + i) for i, row in enumerate(rows)]
    steady = steady_turn(ROBOT, terrain, rows[:, 2], rows[:, 3]).icr_coefficient
    return Runs(rows[:, 0], rows[:, 1], np.array(chi), steady, scale)


def _scale(terrain: Terrain, seed: int) -> float:
    """Distance over the ground for each metre counted, on a straight."""
    speed, duration = STRAIGHT
    seen = watch([[speed, speed]], [duration], terrain, seed)
    standing = [seen.between(0.0, STAND), seen.between(seen.wheels.t[-1] - STAND, seen.wheels.t[-1])]
    start, end = (poses.values[:, :2].mean(axis=0) for poses in standing)
    return float(np.hypot(*(end - start)) / seen.rolled(seen.wheels.t[-1:]).mean())


def _chi(row: FloatArray, scale: float, terrain: Terrain, seed: int) -> float:
    path_curvature, _, left, right = row.tolist()
    radius = path_curvature * FACTORY_Y  # Eq. (26)
    angle = 2.0 * np.arcsin(min(np.sin(HALF_ANGLE), HALF_CHORD / radius)) if radius else 2.0 * HALF_ANGLE
    duration = 2.0 * FACTORY_Y * angle / (right - left)
    seen = watch([[left, right]], [duration], terrain, seed)
    steady = seen.between(STAND + SETTLE, STAND + duration)
    rolled = scale * seen.rolled(steady.t)
    turn = np.polynomial.Polynomial.fit(rolled[:, 1] - rolled[:, 0], steady.values[:, 2], 1)
    ends = turn(np.array(turn.domain))
    return float(chi_of_run(0.0, turn.domain[1] - turn.domain[0], ends[1] - ends[0], VEHICLE.track_width))


@dataclass(frozen=True, slots=True, eq=False)
class Reckonings:
    """The example path: poses by the scanner, and by dead reckoning with two models.

    The models are "P3-AT" and "proposed"; of "P3-AT, slide known" and "proposed, slide known" the sideways speed is the
    plant's own.
    """

    t: FloatArray  # (k,) [s] from the first command
    seen: FloatArray  # (k, 3) in the scanner's frame
    by_model: dict[str, FloatArray]  # (k, 3) each
    slid: float  # [m] sideways motion of the robot, to its left

    def errors(self, model: str) -> FloatArray:
        """Root mean square errors (3,) across and along the scanner's axis [m], the X and Y of Fig. 14; yaw [rad]."""
        return np.asarray(np.sqrt(np.mean(self.off(model) ** 2, axis=0))[[1, 0, 2]])

    def off(self, model: str) -> FloatArray:
        """Errors (k, 3) of a model in the scanner's frame."""
        return np.asarray(self.by_model[model] - self.seen)


def reckonings(found: Runs) -> Reckonings:
    """The path of Eq. (48), and its dead reckoning by chi = 1.5, Eq. (46), and by the fitted curve, Eq. (47)."""
    seen = watch(EXAMPLE, np.ones(len(EXAMPLE)), TILES, SEED_EXAMPLE)
    models: dict[str, Model] = {
        "P3-AT": SymmetricIcr(FACTORY_Y, found.scale),
        "proposed": found.fit().model(VEHICLE, found.scale),
    }
    poses = seen.between(STAND, STAND + len(EXAMPLE) + SETTLE)
    start = seen.between(0.0, STAND).values.mean(axis=0)
    sideways = np.interp(seen.wheels.t[:-1], seen.motion.t, seen.motion.twist[:, 1])
    at = {}
    for label, v_y in (("", np.zeros_like(sideways)), (", slide known", sideways)):
        for name, model in models.items():
            line = _reckoned(model, seen.wheels, v_y, start)
            at[name + label] = np.column_stack([np.interp(poses.t, seen.wheels.t, x) for x in line.T])
    return Reckonings(poses.t - STAND, poses.values, at, float(sideways @ np.diff(seen.wheels.t)))


def _reckoned(model: Model, wheels: Series, v_y: FloatArray, start: FloatArray) -> FloatArray:
    """Poses (n, 3) at the wheel samples by a model and a sideways speed (n - 1,) [m/s]."""
    twist = model.twist(*wheels.values[:-1].T)
    twist[:, 1] += v_y
    return se2.chain(se2.exp(twist * np.diff(wheels.t)[:, None]), start)
