"""What the report shows of drives, computed once: dead reckoning, errors, circle runs, findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.doctor import Finding, examine, fix
from skidsteer.drive import Drive
from skidsteer.errors import DataError, RequestError
from skidsteer.evaluation import remarks
from skidsteer.export import Forced, force
from skidsteer.identify.circle_test import SurfaceResult, chi_of_run, runs_from_drive
from skidsteer.identify.holdout import Folds
from skidsteer.kernels import moments as kernels
from skidsteer.metrics import WindowErrors
from skidsteer.models import Differential, Model
from skidsteer.progress import Progress, silent
from skidsteer.report.drift import Drift, drift_per_10_m, yaw_per_turn
from skidsteer.report.reckoner import Reckoner, reckoners, uncalibrated
from skidsteer.report.tracks import DriveTracks, thin, tracks_of
from skidsteer.se2 import FloatArray, wrap
from skidsteer.windows import Windows, judging_windows, predict, steps

MOST_POSES = 12_000  # shown of all drives together
LEAST_TURN = np.radians(20.0)  # of a window from which chi is taken


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Errors on the judging windows of one drive, and how the robot moved in each."""

    drive: str
    calibrated: WindowErrors
    nominal: WindowErrors
    v: FloatArray  # (k,) [m/s] mean, by the calibrated model
    omega: FloatArray  # (k,) [rad/s]


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """Stretches of turning, lambda and chi of each: Wang 2015, Eqs. (13), (15). ``found`` says what they are."""

    path_curvature: FloatArray  # (k,)
    chi: FloatArray  # (k,)
    group: tuple[str, ...]  # (k,) drive or surface
    found: str


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """All of a report beside the calibration itself."""

    calibration: Calibration
    drives: tuple[str, ...]
    models: dict[str, Model]  # uncalibrated ones, by name
    forced: Forced | None
    tracks: tuple[DriveTracks, ...]
    judged: tuple[Judged, ...]
    window: float  # [s] of the judging windows
    drift: Drift | None
    turn: Drift | None
    turns: Turns | None
    speed: float  # [m/s] 90 % quantile of the faster rim; 0 without a drive
    findings: tuple[tuple[str, tuple[Finding, ...]], ...]
    is_held_out: bool
    is_seen: bool  # some of the drives are the calibration's own
    notes: tuple[str, ...]  # on calibration and drives


def gather(
    calibration: Calibration,
    drives: Sequence[Drive] = (),
    surfaces: Sequence[SurfaceResult] = (),
    window: float | None = None,
    fit_delay: bool = False,
    folds: Folds | None = None,
    progress: Progress = silent,
) -> Evidence:
    """Compute what the report shows.

    Args:
        calibration: to report on.
        drives: on which it is judged: its own (then held out) or others.
        surfaces: the circle test that it was made from, if any.
        window: [s] of the judging windows; None: those of the calibration.
        fit_delay: find the time offset of foreign drives first.
        folds: fits to the odd and even blocks of its own drives; None: computed if the drives are its own.
        progress: called as work goes on.
    """
    total = len(drives) + 2
    progress("fitting to parts of the drives", 0, total)
    chosen = calibration.provenance.options
    length = float(window or chosen.get("window") or 2.0)
    cured = [fix(drive, examine(drive))[0] for drive in drives] if chosen.get("fix") else list(drives)
    known = reckoners(calibration, cured, fit_delay, folds)
    models = uncalibrated(calibration.vehicle)
    tracks = [way for reckoner in known if (way := tracks_of(reckoner, models)) is not None]
    judged = []
    for i, reckoner in enumerate(known):
        progress(f"judging {reckoner.drive.name}", i + 1, total)
        judged += [] if (errors := _judged(reckoner, length)) is None else [errors]
    progress("looking at the log", total - 1, total)
    turns = _circles(surfaces, calibration.vehicle.track_width) if surfaces else _turns(known, length)
    share = MOST_POSES // max(len(tracks), 1)
    return Evidence(
        calibration=calibration,
        drives=tuple(drive.name for drive in drives),
        models=models,
        forced=_forced(calibration),
        tracks=tuple(thin(t, share) for t in tracks if t.sees != "turn"),
        judged=tuple(judged),
        window=length,
        drift=drift_per_10_m(tracks),
        turn=yaw_per_turn(tracks),
        turns=turns,
        speed=_speed(drives),
        findings=tuple((drive.name, examine(drive)) for drive in drives),
        is_held_out=bool(known) and all(reckoner.is_held_out for reckoner in known),
        is_seen=any(reckoner.seen for reckoner in known),
        notes=(*calibration.warnings, *remarks(calibration, drives)),
    )


def _forced(calibration: Calibration) -> Forced | None:
    """Its multipliers; None where no differential drive approximates the model."""
    try:
        return force(calibration)
    except RequestError:
        return None


def _speed(drives: Sequence[Drive]) -> float:
    fastest = np.concatenate([np.abs(d.wheels.values).max(axis=1) for d in drives] or [np.zeros(1)])
    moving = fastest[fastest > 0.0]
    return float(np.quantile(moving, 0.9)) if len(moving) else 0.0


def _judged(reckoner: Reckoner, length: float) -> Judged | None:
    drive = reckoner.drive
    if drive.reference is None and drive.gyro is None:
        return None
    calibrated = reckoner.errors(length)
    if not len(calibrated):
        return None
    nominal = reckoner.errors(length, Differential(drive.vehicle.track_width))
    cut, rolled = _rolled(reckoner, Windows(calibrated.start, calibrated.end, *_nothing(len(calibrated))))
    twist = reckoner.parts[0].model.twist(*(rolled / cut[:, None]).T)
    return Judged(drive.name, calibrated, nominal, twist[:, 0], twist[:, 2])


def _nothing(count: int) -> tuple[FloatArray, np.ndarray]:
    return np.zeros((count, 3)), np.zeros(count, bool)


def _rolled(reckoner: Reckoner, windows: Windows) -> tuple[FloatArray, FloatArray]:
    """Durations (k,) [s] of windows, and what each side rolled (k, 2) [m] in them."""
    cut = steps(reckoner.drive.wheels, windows, reckoner.timing, slopes=False)
    rolled, _ = kernels.extents(cut.distance, cut.offsets)
    return windows.end - windows.start, rolled


def _circles(surfaces: Sequence[SurfaceResult], track_width: float) -> Turns:
    runs = [(run, s.surface) for s in surfaces for side in (s.left, s.right) if side is not None for run in side.runs]
    return Turns(
        np.array([run.path_curvature for run, _ in runs]),
        np.array([1.0 / run.steering_efficiency(track_width) for run, _ in runs]),
        tuple(surface or "unnamed" for _, surface in runs),
        "circle runs",
    )


def _turns(known: Sequence[Reckoner], length: float) -> Turns | None:
    """Runs of constant rim speeds; where the drives have none, all windows that turn."""
    posed = [r for r in known if r.drive.pose is not None]
    for rows, found in ((_runs, "runs of constant rim speeds"), (_windows, f"windows of up to {length:g} s")):
        parts = [(r.drive.name, rows(r, length)) for r in posed]
        table = np.concatenate([values for _, values in parts] or [np.zeros((0, 2))])
        if len(table) >= 3:
            group = tuple(name for name, values in parts for _ in values)
            return Turns(table[:, 0], table[:, 1], group, found)
    return None


def _runs(reckoner: Reckoner, _: float) -> FloatArray:
    """Rows (k, 2) of lambda and chi of the runs of constant rim speeds in a drive."""
    try:
        runs = runs_from_drive(reckoner.drive, reckoner.timing)
    except (RequestError, DataError):
        return np.zeros((0, 2))
    width = reckoner.drive.vehicle.track_width
    return np.array([[run.path_curvature, run.chi(width)] for run in runs])


def _windows(reckoner: Reckoner, length: float) -> FloatArray:
    """Rows (k, 2) of lambda and chi of the judging windows that turn."""
    windows = judging_windows(reckoner.drive, length)
    if not len(windows):
        return np.zeros((0, 2))
    part = reckoner.parts[0]
    predicted = predict(part.model, reckoner.drive.wheels, windows, reckoner.timing)[:, 2]
    angle = predicted + wrap(windows.motion[:, 2] - predicted)
    _, rolled = _rolled(reckoner, windows)
    turns = (np.abs(angle) > LEAST_TURN) & (rolled[:, 0] != rolled[:, 1])
    left, right = rolled[turns].T
    chi = chi_of_run(left, right, angle[turns], reckoner.drive.vehicle.track_width)
    return np.stack([(left + right) / (right - left), chi], axis=1)
