"""Calibrated motion models for skid-steer robots, with honest uncertainty.

The names below are imported when they are first used, so that ``import skidsteer`` costs nothing.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # as the one of typing, whose import takes longer than all of this
if TYPE_CHECKING:
    from typing import Any

    from skidsteer.calibration import Calibration
    from skidsteer.drive import Drive, Series
    from skidsteer.errors import DataError, RequestError, SkidSteerError
    from skidsteer.evaluation import evaluate
    from skidsteer.identify.calibrate import calibrate
    from skidsteer.io.calibration_file import load_calibration, save_calibration
    from skidsteer.io.drives import load_drive
    from skidsteer.vehicle import Vehicle

_HOME = {
    "Calibration": "calibration",
    "DataError": "errors",
    "Drive": "drive",
    "RequestError": "errors",
    "Series": "drive",
    "SkidSteerError": "errors",
    "Vehicle": "vehicle",
    "calibrate": "identify.calibrate",
    "evaluate": "evaluation",
    "load_calibration": "io.calibration_file",
    "load_drive": "io.drives",
    "save_calibration": "io.calibration_file",
}

__all__ = [
    "Calibration",
    "DataError",
    "Drive",
    "RequestError",
    "Series",
    "SkidSteerError",
    "Vehicle",
    "calibrate",
    "evaluate",
    "load_calibration",
    "load_drive",
    "save_calibration",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'skidsteer' has no attribute '{name}'")
    return getattr(import_module(f"skidsteer.{_HOME[name]}"), name)
