"""The filters that ``skidsteer odometry --filter`` knows by name."""

from __future__ import annotations

from collections.abc import Callable

from skidsteer.calibration import Calibration
from skidsteer.odometry.icr_filter import FilterOptions, IcrFilter
from skidsteer.odometry.state import Filter


def icr(calibration: Calibration, gyro: bool) -> Filter:
    """The parameters of the calibrated model are states."""
    return IcrFilter.of(calibration, gyro)


def frozen(calibration: Calibration, gyro: bool) -> Filter:
    """The parameters stay as calibrated; what they may be wrong by is in the covariance."""
    return IcrFilter.of(calibration, gyro, FilterOptions(adapt=False))


# name -> a filter for a calibration, and for a drive with a gyro or without
FILTERS: dict[str, Callable[[Calibration, bool], Filter]] = {
    "icr": icr,
    "frozen": frozen,
}
