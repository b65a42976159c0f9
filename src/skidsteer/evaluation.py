"""Errors of a calibration on drives: nothing is fitted but, on request, the time offset of each drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from skidsteer.calibration import Calibration, HeldOut
from skidsteer.drive import Drive
from skidsteer.errors import DataError
from skidsteer.identify.least_squares import FitOptions, fit
from skidsteer.metrics import WindowErrors, window_errors
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Mount, increment_windows

ALIKE = 0.005  # share by which the measures of a robot may differ from file to file


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Figures over all drives and of each, the time offset [s] that each was judged with, and what to know of them."""

    total: HeldOut
    drives: dict[str, HeldOut]
    time_offsets: dict[str, float]
    warnings: tuple[str, ...] = ()


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
        DataError: a drive has no reference, or no window to judge by.
    """
    parts: list[WindowErrors] = []
    figures: dict[str, HeldOut] = {}
    offsets: dict[str, float] = {}
    for drive in drives:
        if drive.reference is None and drive.gyro is None:
            raise DataError(
                f"{drive.name}: has nothing to judge by; add pose.csv (t, x, y, yaw), position.csv or imu.csv (gyro_z)"
            )
        timing = calibration.timing
        place = mount(calibration, drive)
        if fit_delay and drive.reference is not None:
            timing = replace(timing, time_offset=fit_offset(calibration, drive))
        errors = window_errors(calibration.model, drive, timing, length, place, calibration.uncertainty)
        if not len(errors):
            raise DataError(
                f"{drive.name}: no window of {length:g} s in which wheels and reference are there and the robot moves"
            )
        name = drive.name if drive.name not in figures else f"{drive.name}#{len(figures) + 1}"
        figures[name], offsets[name] = HeldOut.of(errors, calibration.regions), timing.time_offset
        parts.append(errors)
    total = HeldOut.of(WindowErrors.join(parts), calibration.regions)
    return Evaluation(total, figures, offsets, remarks(calibration, drives))


def mount(calibration: Calibration, drive: Drive) -> Mount:
    """Where the reference of a drive sits: where the drive tells, or where that of the calibration sat if it is alike.

    Antenna and pose sensor are two things: where the one kind calibrated, the other is taken to be of base_link.
    """
    told = drive.antenna if drive.sees == "position" else None
    if told is not None:
        return Mount(*told)
    return calibration.mount if _alike(calibration, drive) else Mount()


def _alike(calibration: Calibration, drive: Drive) -> bool:
    """Whether a drive has a reference of the kind that calibrated, as far as is known."""
    kinds = calibration.reference_kinds
    return not kinds or drive.sees in (*kinds, "turn")


def remarks(calibration: Calibration, drives: Sequence[Drive]) -> tuple[str, ...]:
    """What to know of a calibration that is used on drives: other robots, other references."""
    return (*other_robots(calibration, drives), *other_references(calibration, drives))


def other_references(calibration: Calibration, drives: Sequence[Drive]) -> tuple[str, ...]:
    """A sentence on each drive whose reference is taken to be of base_link, as the calibration is by another kind."""
    kinds = " and ".join(f"{kind}s" for kind in calibration.reference_kinds)
    taken = {
        "pose": "its poses are taken to be those of base_link",
        "position": "its positions are taken to be those of base_link, as nothing tells where the antenna sits; if it"
        " is elsewhere, give antenna_x and antenna_y [m] in its vehicle.yaml",
    }
    return tuple(
        f"{drive.name}: the calibration is by {kinds}; {taken[drive.sees]}"
        for drive in drives
        if not _alike(calibration, drive) and (drive.sees == "pose" or drive.antenna is None)
    )


def other_robots(calibration: Calibration, drives: Sequence[Drive]) -> tuple[str, ...]:
    """A sentence on each drive whose vehicle has other measures than that of the calibration.

    Rim speeds are encoder rates times the nominal wheel radius. They are taken as recorded: whether it is one robot
    with two configurations, whose speeds would have to be scaled, or two robots, no file tells.
    """
    known = calibration.vehicle
    return tuple(_other_robot(drive, known) for drive in drives if differ(drive.vehicle, known))


def differ(one: Vehicle, other: Vehicle) -> bool:
    """Whether two vehicles have other measures, by which their rim speeds or nominal models differ."""
    pairs = (one.track_width, other.track_width), (one.wheel_radius, other.wheel_radius)
    return any(abs(a - b) > ALIKE * b for a, b in pairs)


def _other_robot(drive: Drive, known: Vehicle) -> str:
    ratio = known.wheel_radius / drive.vehicle.wheel_radius
    scaled = f"; if it is one robot, multiply them by {ratio:.4g}" if abs(ratio - 1.0) > ALIKE else ""
    return (
        f"{drive.name}: recorded by {measures(drive.vehicle)}, but the calibration is of {measures(known)}; its rim"
        f" speeds are taken as they are{scaled}"
    )


def measures(vehicle: Vehicle) -> str:
    """A vehicle in words."""
    return f"{vehicle.name} (track width {vehicle.track_width:.4g} m, wheel radius {vehicle.wheel_radius:.4g} m)"


def fit_offset(calibration: Calibration, drive: Drive) -> float:
    """Time offset [s] of a drive with reference poses, by maximum likelihood with model and lag as they are."""
    options = FitOptions(lag=calibration.timing.lag, mount=mount(calibration, drive), fix_model=True)
    return fit(calibration.model, [drive], [increment_windows(drive)], options).timings[0].time_offset
