"""Predictions of a drive for the report: by the calibration, or held out, by fits that have not seen the block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.drive import Drive
from skidsteer.evaluation import fit_offset, mount
from skidsteer.identify.holdout import Folds, fold_fits
from skidsteer.identify.start import FitOptions
from skidsteer.metrics import WindowErrors, window_errors
from skidsteer.models import Differential, Model
from skidsteer.prediction import Uncertainty
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import PRESETS, Vehicle
from skidsteer.windows import Mount, Timing, Windows, predict


@dataclass(frozen=True, slots=True)
class Part:
    """Model and timing that predict a drive."""

    model: Model
    timing: Timing
    mount: Mount
    uncertainty: Uncertainty | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Reckoner:
    """Predictions of one drive.

    With two ``parts`` the even blocks between ``edges`` (b + 1,) [s] are predicted by the first, which has not seen
    them, the odd ones by the second: every block is held out.
    """

    drive: Drive
    parts: tuple[Part, ...]
    edges: FloatArray
    seen: bool  # the calibration was made from this drive, too

    @property
    def is_held_out(self) -> bool:
        """Whether no prediction was fitted to what it predicts."""
        return len(self.parts) == 2 or not self.seen

    @property
    def timing(self) -> Timing:
        """Time offset and lag; the mean over the parts."""
        offset, lag = np.mean([[p.timing.time_offset, p.timing.lag] for p in self.parts], axis=0).tolist()
        return Timing(offset, lag)

    def motions(self, windows: Windows, model: Model | None = None) -> FloatArray:
        """Motions (k, 3) of windows as the reference's sensor sees them, by the calibrated model or by another."""
        block = _block(windows.start, self.edges)
        out = np.empty((len(windows), 3))
        for i, part in enumerate(self.parts):
            mine = block % len(self.parts) == i
            some = windows.where(mine)
            out[mine] = part.mount.seen(predict(model or part.model, self.drive.wheels, some, part.timing))
        return out

    def errors(self, length: float, model: Model | None = None) -> WindowErrors:
        """Errors on the judging windows of ``length`` [s]; those across the edge of two blocks are left out."""
        found = []
        for part in self.parts:
            known = part.uncertainty if model is None else None
            found.append(window_errors(model or part.model, self.drive, part.timing, length, part.mount, known))
        first, last = _block(found[0].start, self.edges), _block(np.nextafter(found[0].end, -np.inf), self.edges)
        mine = first % len(self.parts)
        chosen = {f.name: np.choose(mine, [getattr(e, f.name) for e in found]) for f in fields(WindowErrors)}
        return WindowErrors(**chosen).where(first == last)


def _block(t: FloatArray, edges: FloatArray) -> np.ndarray:
    return np.asarray(np.searchsorted(edges, t, side="right") - 1)


def reckoners(
    calibration: Calibration, drives: Sequence[Drive], fit_delay: bool = False, folds: Folds | None = None
) -> tuple[Reckoner, ...]:
    """Predictions of each drive: held out, where the drives are those of the calibration.

    Args:
        calibration: of the robot.
        drives: any.
        fit_delay: find the time offset of the drives that the calibration was not made from.
        folds: fits to the odd and even blocks of its own drives; None: computed here.
    """
    records = {record.sha256 or record.name for record in calibration.provenance.drives}
    seen = [(drive.sha256 or drive.name) in records for drive in drives]
    referenced = all(drive.reference is not None or drive.gyro is not None for drive in drives)
    if folds is None and drives and referenced and all(seen) and len(drives) == len(records):
        folds = _folds(calibration, [replace(drive, vehicle=calibration.vehicle) for drive in drives])
    if folds is not None:
        return tuple(Reckoner(d, _parts(folds, i), folds.edges[i], True) for i, d in enumerate(drives))
    whole = np.array([-np.inf, np.inf])
    return tuple(
        Reckoner(drive, (_whole(calibration, drive, known, fit_delay),), whole, known)
        for drive, known in zip(drives, seen, strict=True)
    )


def _folds(calibration: Calibration, drives: list[Drive]) -> Folds | None:
    chosen = calibration.provenance.options
    start = type(calibration.model).nominal(drives[0].vehicle)
    return fold_fits(start, drives, fit_options(chosen), float(chosen.get("spacing") or 0.0))


def _parts(folds: Folds, drive: int) -> tuple[Part, ...]:
    return tuple(Part(f.model, f.timings[drive], f.mount, f.uncertainty(drive)) for f in folds.fits)


def _whole(calibration: Calibration, drive: Drive, seen: bool, fit_delay: bool) -> Part:
    timing = calibration.timing
    own = calibration.estimates.get(f"time_offset:{drive.name}")
    if seen and own is not None:
        timing = replace(timing, time_offset=own.value)
    elif fit_delay and drive.reference is not None:
        timing = replace(timing, time_offset=fit_offset(calibration, drive))
    return Part(calibration.model, timing, mount(calibration, drive), calibration.uncertainty)


def fit_options(chosen: Mapping[str, str | float | int | bool | None]) -> FitOptions:
    """The options that a calibration was fitted with, from its provenance."""
    where = str(chosen.get("mount", "0,0,0"))
    place = None if where == "free" else Mount(*(float(word) for word in where.split(",")))
    offset, lag = (None if chosen.get(name) is None else float(chosen[name] or 0.0) for name in ("time_offset", "lag"))
    return FitOptions(
        time_offset=offset,
        lag=lag,
        mount=place,
        align=bool(chosen.get("align", False)),
        robust=bool(chosen.get("robust", True)),
    )


def known_vehicle(vehicle: Vehicle) -> Vehicle:
    """The vehicle, with wheel base and factory settings of the preset of its name where it has none."""
    preset = PRESETS.get(vehicle.name.lower().removeprefix("clearpath-"))
    if preset is None:
        return vehicle
    base = vehicle.wheel_base or preset.wheel_base
    if vehicle.factory_multiplier is not None:
        return replace(vehicle, wheel_base=base)
    return replace(
        vehicle,
        wheel_base=base,
        factory_separation=preset.factory_separation,
        factory_multiplier=preset.factory_multiplier,
    )


def uncalibrated(vehicle: Vehicle) -> dict[str, Model]:
    """Models of a robot before calibration: its track width, and the settings it ships with."""
    models: dict[str, Model] = {"nominal": Differential(vehicle.track_width)}
    known = known_vehicle(vehicle)
    if known.factory_separation is not None and known.factory_multiplier is not None:
        models["shipped"] = Differential(known.factory_separation * known.factory_multiplier)
    return models
