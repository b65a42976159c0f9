"""Mandow's experiment, sections III and IV: identify four models on one drive, predict another one by them.

Table III can be read in two ways. By Eq. (13) each segment is predicted from the reference pose at its beginning. Along
the path, the increments are those of one dead reckoning from start to end, in its initial frame, so that a drift of the
heading rotates all later increments.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.identify.calibrate import CalibrateOptions, calibrate
from skidsteer.identify.genetic import search_drives
from skidsteer.identify.turn_test import StretchOptions, SymmetricFit, symmetric_from_drive
from skidsteer.models import Icr, Model
from skidsteer.reproduce.mandow2007_printed import ASYMMETRIC, DEFAULT, P3AT, SYMMETRIC
from skidsteer.se2 import FloatArray, between, chain, compose, invert, wrap
from skidsteer.simulate import Sensors, controller, kinematic_drive, rims_from_manoeuvres
from skidsteer.windows import Timing, Windows, increment_windows, predict

GPS_SIGMA = 0.007  # [m] each axis: "a precision under 1 cm"
YAW_SIGMA = float(np.radians(0.5))  # of the reference for identification; how the paper measured headings is not said
TICK = 1.0 / 138_000.0  # [m] Eq. (14): 138 ticks a millimetre
WANDER = (0.004, 0.008)  # [m/sqrt(m)], [rad/sqrt(m)] random walk of the motion
START = 10  # positions, 2 s, whose chord is the initial heading of dead reckoning
PIVOTS = (0.1, 0.2, 0.3, 0.5)  # of ``StretchOptions``, the strictest first
OURS = "ours"


def training_drive(truth: Model, seed: int) -> Drive:
    """A simulated P3-AT: turns on the spot, straights, circles and S-curves at three speeds, 4 min."""
    rows = [[1.0, 0.0, 0.0]]
    for v in (0.2, 0.35, 0.5):
        stop = [1.0, 0.0, 0.0]
        rows += [[6.0, v, 0.0], stop, [5.0, 0.0, 0.8], stop, [6.0, v, 0.6 * v], [6.0, v, -0.6 * v], stop]
        rows += [[5.0, 0.0, -0.8], stop, [5.0, -v, 0.0], stop, [5.0, v, 1.2 * v], [5.0, v, -1.2 * v]]
        rows += [[2.0, v, side * 0.5] for side in (1.0, -1.0, 1.0, -1.0)] + [[5.0, 0.5 * v, 0.4], stop]
    sensors = Sensors(5.0, GPS_SIGMA, YAW_SIGMA, encoder_step=TICK)
    rims = rims_from_manoeuvres(np.array(rows), controller(P3AT))
    return kinematic_drive("training", P3AT, truth, rims, sensors, motion_noise=WANDER, seed=seed)


def validation_drive(truth: Model, seed: int) -> Drive:
    """Another path, a minute at 0.45 m/s, measured by one GPS antenna: the heading is that of the track."""
    rows = [row for side in (1.0, -1.0, 1.0, 1.0, -1.0, -1.0) for row in ([4.0, 0.45, 0.0], [6.0, 0.45, 0.35 * side])]
    sensors = Sensors(5.0, GPS_SIGMA, 1e-6, encoder_step=TICK)
    rims = rims_from_manoeuvres(np.array(rows), controller(P3AT))
    seen = kinematic_drive("validation", P3AT, truth, rims, sensors, motion_noise=WANDER, seed=seed)
    assert seen.pose is not None
    x, y, _ = seen.pose.values[seen.pose.t > 1.0].T  # it moves
    t = seen.pose.t[seen.pose.t > 1.0]
    heading = np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
    heading[0] = np.arctan2(y[START] - y[0], x[START] - x[0])  # it drives straight at first
    return replace(seen, pose=Series(t[:-1], np.column_stack([x[:-1], y[:-1], heading]), "pose"))


@dataclass(frozen=True, slots=True)
class Identified:
    """The models of Fig. 6 and ours, and how the reference lies against the wheels in time."""

    models: dict[str, Model]
    timing: Timing
    turns: SymmetricFit | None  # None: no turn on the spot
    pivot: float  # of ``StretchOptions`` that was needed


def identify(drive: Drive, default: Model, model: str, timing: Timing | None = None) -> Identified:
    """Identify on a drive.

    Args:
        drive: with reference poses.
        default: the model before any drive.
        model: ours, or auto.
        timing: of the reference against the wheels; None: what our calibration finds.
    """
    ours = calibrate(drive, options=CalibrateOptions(model=model))
    timing = timing or ours.timing
    turns, pivot = _turns(drive, timing)
    found, _ = search_drives(Icr.nominal(drive.vehicle), [drive], [increment_windows(drive)], [timing])
    symmetric = {} if turns is None else {SYMMETRIC: turns.model}
    return Identified({DEFAULT: default, **symmetric, ASYMMETRIC: found.model, OURS: ours.model}, timing, turns, pivot)


def _turns(drive: Drive, timing: Timing) -> tuple[SymmetricFit | None, float]:
    """The symmetric model, Eqs. (11), (12), by turns as near to the spot as the drive has them."""
    for pivot in PIVOTS:
        try:
            return symmetric_from_drive(drive, timing, StretchOptions(pivot=pivot)), pivot
        except RequestError:
            continue
    return None, PIVOTS[-1]


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Mean squared errors (3,) of x [m^2], y [m^2] and heading [rad^2] of increments, x to the right, y forward."""

    along: FloatArray  # of one dead reckoning along the path
    segments: FloatArray  # Eq. (13): each segment from its own start
    line: FloatArray  # (n, 3) poses of the dead reckoning
    off: float  # [m] by which it ends wrong


def score(model: Model, drive: Drive, timing: Timing) -> Score:
    """Judge a model on a drive with reference poses; whole turns of the heading's error do not count."""
    assert drive.pose is not None
    t, poses = drive.pose.t, drive.pose.values
    windows = Windows(t[:-1], t[1:], between(poses[:-1], poses[1:]), np.ones(len(t) - 1, bool))
    motion = predict(model, drive.wheels, windows, timing)
    line = chain(motion, poses[0])
    home = invert(poses[0])
    seen, reckoned = (np.diff(compose(home, path), axis=0) for path in (poses, line))
    off = float(np.hypot(*(line[-1] - poses[-1])[:2]))
    return Score(_mean_squares(seen - reckoned), _mean_squares(windows.motion - motion), line, off)


def _mean_squares(error: FloatArray) -> FloatArray:
    """Of errors (n, 3) forward, left, heading: those to the right, forward, heading, as Mandow has the axes."""
    squares = np.mean(np.column_stack([error[:, :2], wrap(error[:, 2])]) ** 2, axis=0)
    return np.asarray(squares[[1, 0, 2]])


def halves(drive: Drive) -> tuple[Drive, Drive]:
    """A continuous drive with reference poses, cut in the middle of its time: the first half, the second.

    Raises:
        RequestError: no reference poses, or separate segments.
    """
    if drive.pose is None or drive.segments is not None:
        raise RequestError(f"{drive.name}: Mandow's experiment needs one continuous drive with reference poses")
    first, last = drive.span
    middle = 0.5 * (first + last)
    return drive.between(first, middle), drive.between(middle, last)
