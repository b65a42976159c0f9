"""The filters that ``skidsteer odometry --filter`` knows by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from skidsteer.calibration import Calibration
from skidsteer.odometry.icr_filter import FilterOptions, IcrFilter
from skidsteer.odometry.kinematic_ekf import TABLE_1, thalmann_filter
from skidsteer.odometry.state import Filter
from skidsteer.odometry.state_choice import SystemNoise


def icr(calibration: Calibration, gyro: bool) -> Filter:
    """The parameters of the calibrated model are states."""
    return IcrFilter.of(calibration, gyro)


def frozen(calibration: Calibration, gyro: bool) -> Filter:
    """The parameters stay as calibrated; their uncertainty is in the covariance."""
    return IcrFilter.of(calibration, gyro, FilterOptions(adapt=False))


def thalmann(name: str, calibration: Calibration, gyro: bool) -> Filter:
    """A filter of Thalmann 2016, which knows the nominal track width only and follows the encoders closely.

    The random walk of its yaw does not distinguish straights from turns: all distance counts as turned. A gyro is left
    out, as there is no state for its bias. The test of the encoders is off, since wheels that are measured less often
    than logged would fail it at every step.
    """
    noise = SystemNoise(2.0, 2.0, 0.02, walk=calibration.noise.walk, turn=calibration.noise.turn)
    return replace(thalmann_filter(name, calibration.vehicle.track_width, noise), significance=0.0)


KNOW_BIAS = ("icr", "frozen")  # filters that use a gyro
# name -> a filter for a calibration, and for a drive with a gyro or without
FILTERS: dict[str, Callable[[Calibration, bool], Filter]] = {
    "icr": icr,
    "frozen": frozen,
    **{name: partial(thalmann, name) for name in TABLE_1},
}
