"""Errors of a calibration on drives: nothing is fitted but, on request, the time offset of each drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from skidsteer.calibration import Calibration, HeldOut
from skidsteer.drive import Drive
from skidsteer.errors import DataError
from skidsteer.identify.least_squares import find_offset
from skidsteer.metrics import WindowErrors, window_errors
from skidsteer.se2 import wrap
from skidsteer.windows import Timing, increment_windows, judging_windows, predict


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Figures over all drives and of each, and the time offset [s] that each was judged with."""

    total: HeldOut
    drives: dict[str, HeldOut]
    time_offsets: dict[str, float]


def evaluate(
    calibration: Calibration, drives: Sequence[Drive], length: float = 2.0, fit_delay: bool = False
) -> Evaluation:
    """Judge a calibration on drives.

    Args:
        calibration: its model, lag and, unless ``fit_delay``, time offset are used as they are.
        drives: with any reference.
        length: of the windows [s].
        fit_delay: find the time offset of each drive first; it belongs to the logging set-up, not to the robot.

    Raises:
        DataError: a drive has no window to judge by.
    """
    parts: list[WindowErrors] = []
    figures: dict[str, HeldOut] = {}
    offsets: dict[str, float] = {}
    for drive in drives:
        timing = calibration.timing
        if fit_delay and drive.pose is not None:
            timing = replace(timing, time_offset=fit_offset(calibration, drive, length))
        errors = window_errors(calibration.model, drive, timing, length)
        if not len(errors.translation) and not len(errors.yaw_gyro):
            raise DataError(
                f"{drive.name}: no window of {length:g} s in which wheels and reference are there and the robot moves"
            )
        name = drive.name if drive.name not in figures else f"{drive.name}#{len(figures) + 1}"
        figures[name], offsets[name] = HeldOut.of(errors), timing.time_offset
        parts.append(errors)
    return Evaluation(HeldOut.of(WindowErrors.join(parts)), figures, offsets)


def fit_offset(calibration: Calibration, drive: Drive, length: float = 2.0) -> float:
    """Time offset [s] of a drive that brings prediction and reference closest: a search, then a robust refinement."""
    model, lag = calibration.model, calibration.timing.lag
    increments, judged = increment_windows(drive), judging_windows(drive, length)
    rough = find_offset(model, drive, increments, (-1.0, 1.5), lag=lag)
    if not len(judged):
        return rough
    unit = np.array([0.1, 0.1, np.radians(5.0)])

    def cost(offset: float) -> float:
        error = judged.motion - predict(model, drive.wheels, judged, Timing(offset, lag))
        error[:, 2] = wrap(error[:, 2])
        return float(np.mean(np.log1p(((error / unit) ** 2).sum(axis=1))))

    found = minimize_scalar(cost, bounds=(rough - 0.3, rough + 0.3), method="bounded", options={"xatol": 1e-3})
    return float(found.x)
