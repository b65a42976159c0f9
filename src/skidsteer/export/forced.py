"""A calibration forced into three multipliers, and what that loses: measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from skidsteer.calibration import Calibration, HeldOut
from skidsteer.drive import Drive
from skidsteer.errors import DataError, RequestError
from skidsteer.evaluation import fit_offset, mount
from skidsteer.metrics import WindowErrors, window_errors
from skidsteer.models import Differential, Model
from skidsteer.multipliers import Projection, moving_rims, project, usual_rims


@dataclass(frozen=True, slots=True)
class Measured:
    """Errors on the same windows: of the nominal differential drive, of the multipliers, of the model itself."""

    windows: str  # which they were
    nominal: HeldOut
    forced: HeldOut
    model: HeldOut


@dataclass(frozen=True, slots=True)
class Forced:
    """The multipliers of a calibration, over which motions they were found, and what they lose, where that is known."""

    projection: Projection
    motions: str
    measured: Measured | None


def force(calibration: Calibration, drives: Sequence[Drive] = (), length: float = 2.0) -> Forced:
    """Find the multipliers nearest to a calibrated model and what they lose.

    Args:
        calibration: its own drives are what the multipliers were found and judged on, if it knows them.
        drives: others to find and judge them on instead; the time offset of each is fitted.
        length: of the judging windows on those [s].

    Raises:
        DataError: a drive has no window to judge by.
        RequestError: the model does not move as a differential drive at all.
    """
    vehicle = calibration.vehicle
    if drives:
        projection = _project(calibration.model, moving_rims(drives), vehicle.track_width)
        return Forced(projection, f"the motions of {_names(drives)}", _measure(calibration, projection, drives, length))
    if calibration.controller is not None:
        return Forced(calibration.controller.projection, "the motions of its drives", _held_out(calibration))
    speed = 0.5 * (vehicle.max_wheel_speed or 1.0)
    rims = usual_rims(speed)
    return Forced(_project(calibration.model, rims, vehicle.track_width), f"all motions up to {speed:g} m/s", None)


def _project(model: Model, rims: object, track_width: float) -> Projection:
    try:
        return project(model, rims, track_width)  # type: ignore[arg-type]
    except ValueError as error:
        raise RequestError(f"the {model.NAME} model cannot be told by multipliers: {error}") from error


def _held_out(calibration: Calibration) -> Measured | None:
    """Figures that the calibration holds."""
    forced = None if calibration.controller is None else calibration.controller.held_out
    nominal, model = (calibration.held_out.get(name) for name in (Differential.NAME, calibration.model.NAME))
    if forced is None or nominal is None or model is None:
        return None
    length = calibration.provenance.options.get("window")
    return Measured(f"windows of {length} s that the fit did not see", nominal, forced, model)


def _measure(calibration: Calibration, projection: Projection, drives: Sequence[Drive], length: float) -> Measured:
    models = (Differential(calibration.vehicle.track_width), projection.multipliers, calibration.model)
    parts: list[list[WindowErrors]] = [[], [], []]
    for drive in drives:
        offset = calibration.timing.time_offset if drive.reference is None else fit_offset(calibration, drive)
        timing = replace(calibration.timing, time_offset=offset)
        for part, model in zip(parts, models, strict=True):
            part.append(window_errors(model, drive, timing, length, mount(calibration, drive)))
        if not len(parts[0][-1]):
            raise DataError(
                f"{drive.name}: no window of {length:g} s in which wheels and reference are there and the robot moves"
            )
    figures = (HeldOut.of(WindowErrors.join(part)) for part in parts)
    return Measured(f"windows of {length:g} s of {_names(drives)}", *figures)


def _names(drives: Sequence[Drive]) -> str:
    return ", ".join(drive.name for drive in drives)
