"""How far apart reference poses should be for a fit: as close as the drive's errors allow."""

from __future__ import annotations

import logging

import numpy as np

from skidsteer.drive import Drive
from skidsteer.identify.least_squares import Fit, FitOptions, fit
from skidsteer.models import Model, Multiplier, ScheduledIcr, SymmetricIcr
from skidsteer.windows import Windows, increment_windows

log = logging.getLogger(__name__)

CANDIDATES = (0.5, 1.0, 2.0, 4.0)  # [s]
COVER = 0.8  # share of the time at full rate that windows of a spacing must still cover
GAIN = 0.1  # a wider spacing must lower the mean log sigma by this much


def choose_spacing(drives: list[Drive], options: FitOptions) -> float:
    """Least spacing [s] of reference poses for ``increment_windows``; 0: all of them.

    With the right model of the noise every pose helps. Where a fit on all of them finds that errors last longer than
    that model explains (``Fit.inflated``: speeds that were commanded, not measured; slip that builds up), short
    increments mostly repeat each other's error. The spacing is then the one whose estimate is most certain by its own
    block sandwich covariance, the honest one. The freest model is fitted: what a simpler one misfits at speed would
    pass for errors that last.
    """
    full = [increment_windows(drive) for drive in drives]
    family: type[Model] = SymmetricIcr if options.mount is None else ScheduledIcr
    if all(drive.reference is None for drive in drives):
        family = Multiplier
    start = family.nominal(drives[0].vehicle)
    found = fit(start, drives, full, options)
    if found.inflated <= 1.0:
        return 0.0
    best, least = 0.0, spread(found)
    for spacing in CANDIDATES:
        windows = [increment_windows(drive, spacing) for drive in drives]
        if _time(windows) < COVER * _time(full):
            break
        found = fit(start, drives, windows, options)
        log.debug("spacing %g s: inflated %.2f, mean log sigma %.3f", spacing, found.inflated, spread(found))
        if spread(found) < least - GAIN:
            best, least = spacing, spread(found)
    return best


def _time(windows: list[Windows]) -> float:
    return float(sum((w.end - w.start).sum() for w in windows))


def spread(found: Fit) -> float:
    """Mean logarithm of the model's sigmas, along the axes of their ellipsoid."""
    p = len(found.model.theta)
    return float(0.5 * np.linalg.slogdet(found.covariance[:p, :p])[1] / p)
