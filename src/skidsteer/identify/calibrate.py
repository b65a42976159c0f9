"""From drives to a calibration: fit, judge on held-out windows, choose the model, say what the drives do not tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from datetime import datetime, timezone
from importlib.metadata import version
from typing import Literal, cast

import numpy as np

from skidsteer.calibration import Calibration, DriveRecord, Estimate, HeldOut, Observability, Provenance
from skidsteer.doctor import EXCITATION, Finding, examine, fix
from skidsteer.drive import Drive
from skidsteer.errors import DataError, RequestError
from skidsteer.identify.alignment import is_turned
from skidsteer.identify.as_controller import as_controller
from skidsteer.identify.genetic import GeneticOptions, genetic_fit
from skidsteer.identify.holdout import Folds, HeldOutErrors, held_out
from skidsteer.identify.judged import is_determined
from skidsteer.identify.least_squares import Fit, FitOptions, fit_supported
from skidsteer.identify.observability import observe, observe_drive
from skidsteer.identify.select import Selection, select
from skidsteer.identify.spacing import choose_spacing
from skidsteer.identify.unknowns import UNITS
from skidsteer.models import MODELS
from skidsteer.prediction import fit_regions
from skidsteer.progress import Progress as Progress
from skidsteer.windows import MAX_GAP, Mount, increment_windows, pieces

Method = Literal["least-squares", "genetic"]
BASELINES = ("differential", "multiplier", "icr")
YAW_ONLY = ("differential", "multiplier")  # all that a gyro alone can tell apart
LEAST_MOVE = 0.5  # [m] rolled in all, below which there is nothing to calibrate


@dataclass(frozen=True, slots=True)
class CalibrateOptions:
    """What to calibrate and how; the defaults work."""

    model: str = "auto"  # name of a model, or auto: chosen by held-out errors
    method: Method = "least-squares"
    window: float = 2.0  # [s] length of the judging windows
    seed: int = 0  # of the genetic search
    mount: Mount | Literal["free"] | None = None  # of the reference's sensor; None: see ``mounting``
    align: bool | None = None  # estimate the yaw of a sensor whose place is given; None: where the drives show it
    fix: bool = False  # apply the doctor's safe cures first
    spacing: float | None = None  # [s] least distance of reference poses used; None: chosen by the drives
    fit: FitOptions = field(default_factory=FitOptions)

    def __post_init__(self) -> None:
        if self.model != "auto" and self.model not in MODELS:
            raise RequestError(f"no model '{self.model}'; there are: auto, {', '.join(MODELS)}")
        if self.method not in ("least-squares", "genetic"):
            raise RequestError(f"no method '{self.method}'; there are: least-squares, genetic, circle-test")
        if not (np.isfinite(self.window) and self.window > 0.0):
            raise RequestError(f"--window must be a positive time in s, got {self.window}")


def calibrate(
    drive: Drive | Sequence[Drive],
    model: str = "auto",
    options: CalibrateOptions | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a motion model from one drive or several of the same robot.

    Args:
        drive: with wheels and any reference; each has its own time offset, all share model, lag and mounting.
        model: name of a model, or auto. Ignored where ``options`` are given.
        options: everything that can be chosen.
        progress: called as work goes on.

    Raises:
        DataError: no reference, no common time, nothing moved.
        RequestError: no such model or method, or a method that the model does not support.
    """
    drives = [drive] if isinstance(drive, Drive) else list(drive)
    return calibrate_with_folds(drives, options or CalibrateOptions(model=model), progress)[0]


def calibrate_with_folds(
    drives: list[Drive], options: CalibrateOptions, progress: Progress | None = None
) -> tuple[Calibration, Folds | None]:
    """The calibration, and the fits of its model that each have seen one half only; None where nothing was held out."""
    for d in drives:
        refuse_unusable(d)
    _tell(progress, "looking at the log", 0, 1)
    drives, complaints = _examined(drives, options.fix)
    options = settled(drives, options)
    windows = [increment_windows(d, options.spacing or 0.0) for d in drives]
    names = candidates(drives, options)
    judged = judge_models(names, drives, options, progress)
    chosen, because = _choose(options, judged)
    _tell(progress, f"fitting {chosen}", len(names), len(names) + 1)
    start = MODELS[chosen].nominal(drives[0].vehicle)
    found = fit_supported(start, drives, windows, options.fit)
    verdict = observe(found, drives, windows, options.fit)
    notes = []
    if options.method == "genetic":
        found, note = genetic_fit(found, drives, windows, GeneticOptions(seed=options.seed))
        notes.append(note)
    _tell(progress, "done", len(names) + 1, len(names) + 1)
    calibration = Calibration(
        vehicle=drives[0].vehicle,
        model=found.model,
        names=tuple(np.array(found.names)[found.told].tolist()),
        estimates=_estimates(found),
        covariance=found.covariance[np.ix_(found.told, found.told)],
        noise=found.noise,
        provenance=_provenance(drives, found, options),
        method=options.method,
        selected_because=because,
        warnings=(*complaints, *_warnings(found, verdict, judged, chosen, drives), *notes),
        held_out={name: HeldOut.of(e.errors, block=e.block) for name, e in judged.items()},
        regions=fit_regions(judged[chosen].errors.distances) if chosen in judged else None,
        observability=verdict,
        controller=as_controller(found.model, drives, judged.get(chosen), options.window),
    )
    return calibration, judged[chosen].folds if chosen in judged else None


def _examined(drives: list[Drive], cure: bool) -> tuple[list[Drive], list[str]]:
    """The drives, cured if asked for, and what the doctor says of them or did to them.

    Of how they were driven the verdict says more: what one drive leaves open another may tell.
    """
    out, said = [], []
    for drive in drives:
        findings = [f for f in examine(drive) if f.severity != "info" and f.kind not in EXCITATION]
        if cure:
            drive, done = fix(drive, findings)
            said += [f"{drive.name}: cured: {line}" for line in done]
            findings = [f for f in findings if not f.fixable]
        said += [f"{drive.name}: {f.what} {f.effect} {f.cure}".rstrip(".") for f in findings]
        out.append(drive)
    return out, said


def mounting(drives: Sequence[Drive], wanted: Mount | Literal["free"] | None) -> Mount | None:
    """Where the reference's sensor sits; None: to be estimated.

    Unless told, a reference with heading is taken to be of base_link, and a single antenna or prism to be somewhere.
    Motion alone cannot tell where the sensor sits from where the ICRs are, only how far they are apart: where both
    are estimated, what is known before the drive tells the rest, and their sigmas say so.
    Where the logs of all drives put their antenna at one place, it is there.
    """
    if isinstance(wanted, Mount):
        return wanted
    places = {d.antenna if d.pose is None and d.position is not None else (0.0, 0.0) for d in drives}
    (place, *others) = places
    return None if wanted == "free" or others or place is None else Mount(*place)


def candidates(drives: Sequence[Drive], options: CalibrateOptions) -> list[str]:
    """Names of the models that the reference can tell apart, from the simplest; with the one asked for."""
    able = list(YAW_ONLY) if all(d.reference is None for d in drives) else list(MODELS)
    if options.model == "auto":
        return able
    return sorted({*(name for name in BASELINES if name in able), options.model}, key=list(MODELS).index)


def settled(drives: list[Drive], options: CalibrateOptions) -> CalibrateOptions:
    """The same options with mounting and spacing settled by the drives."""
    options = replace(options, fit=replace(options.fit, mount=mounting(drives, options.mount)))
    if options.spacing is None:
        options = replace(options, spacing=choose_spacing(drives, options.fit))
    align = is_turned(drives, options.fit, options.spacing or 0.0) if options.align is None else options.align
    return replace(options, fit=replace(options.fit, align=align))


def judge_models(
    names: Sequence[str], drives: list[Drive], options: CalibrateOptions, progress: Progress | None = None
) -> dict[str, HeldOutErrors]:
    """Held-out errors of the named models; empty where the drives are too short to hold anything out."""
    judged: dict[str, HeldOutErrors] = {}
    for i, name in enumerate(names):
        _tell(progress, f"judging {name}", i, len(names) + 1)
        start = MODELS[name].nominal(drives[0].vehicle)
        result = held_out(start, drives, options.fit, options.window, options.spacing or 0.0)
        if result is None or not len(result.errors):
            return {}
        judged[name] = result
    return judged


def _tell(progress: Progress | None, what: str, done: int, total: int) -> None:
    if progress is not None:
        progress(what, done, total)


def judge_drive(drive: Drive, findings: Sequence[Finding]) -> Observability | str:
    """What a drive tells of the robot, or why that cannot be said."""
    if any(f.severity == "error" and f.kind not in EXCITATION for f in findings):
        return "cure the errors first"
    try:
        refuse_unusable(drive)
    except DataError as refusal:
        return str(refusal).removeprefix(f"{drive.name}: ")
    return observe_drive(drive, align=any(f.kind == "turned_reference" for f in findings))


def refuse_unusable(drive: Drive) -> None:
    """Refuse a drive that cannot be calibrated from."""
    reference = drive.reference or drive.gyro
    if reference is None:
        raise DataError(
            f"{drive.name}: has no reference; add pose.csv (t, x, y, yaw), position.csv or imu.csv (gyro_z)"
        )
    period = float(np.median(np.diff(drive.wheels.t)))
    if period > MAX_GAP:
        raise DataError(
            f"{drive.name}: wheel samples are {period:.3g} s apart; beyond {MAX_GAP:g} s the motion between is unknown;"
            " is t in seconds?"
        )
    if not len(pieces(drive)) or not len(windows := increment_windows(drive)):
        a, b = reference.t[[0, -1]]
        raise DataError(
            f"{drive.name}: wheels ({drive.span[0]:.1f} to {drive.span[1]:.1f} s) and {reference.name} ({a:.1f} to"
            f" {b:.1f} s) share no time with two reference samples in it; bring them onto one clock"
        )
    rolled = float(np.abs(drive.wheels.values[:-1]).mean(axis=1) @ np.minimum(np.diff(drive.wheels.t), 1.0))
    moved = rolled if windows.sees == "turn" else float(np.abs(windows.motion).sum())
    if rolled < LEAST_MOVE or moved < 0.2 * LEAST_MOVE:
        what, much = ("wheels", rolled) if rolled < LEAST_MOVE else ("reference", moved)
        raise DataError(
            f"{drive.name}: the robot stands still (the {what} moved by {much:.2f} m in all);"
            " record a drive with straights and turns both ways"
        )
    span = windows.end[-1] - windows.start[0]
    if span < 4.0:
        raise DataError(f"{drive.name}: only {span:.1f} s of reference; at least 4 s needed")


def _choose(options: CalibrateOptions, judged: Mapping[str, HeldOutErrors]) -> tuple[str, str]:
    if not judged:
        name = "multiplier" if options.model == "auto" else options.model
        return name, "the drive is too short to hold anything out: no comparison was possible"
    selection = select(judged)
    if options.model == "auto":
        return selection.name, selection.because
    told = "and chosen by held-out errors, too" if selection.name == options.model else "by held-out errors it would be"
    return options.model, f"asked for; {told}: {selection.because}"


def _estimates(found: Fit) -> dict[str, Estimate]:
    units = {p.name: p.unit for p in found.model.PARAMETERS}
    estimates, determined = {}, is_determined(found)
    for i in np.flatnonzero(found.told):
        name = found.names[i]
        value, sigma = found.named(name)
        estimates[name] = Estimate(
            value, sigma, units.get(name) or UNITS.get(name.split(":")[0], ""), bool(determined[i])
        )
    return estimates


def _warnings(
    found: Fit, verdict: Observability, judged: Mapping[str, HeldOutErrors], chosen: str, drives: Sequence[Drive]
) -> tuple[str, ...]:
    notes = []
    open_ = [name for name in verdict.undetermined if name in found.names]
    if open_:
        notes.append(f"not determined by this drive: {', '.join(open_)}; the values given are assumptions, see sigma")
    notes += verdict.sentences
    if not found.converged:
        notes.append("the fit did not converge; look at the log with `skidsteer check` before using the result")
    if found.inflated > 1.0:
        notes.append(
            f"errors last longer than the noise model explains: variances were raised {found.inflated:.1f}-fold"
            f" by the scatter between stretches of {found.block:.2g} s"
        )
    notes += _unseen(drives, found)
    outliers = sum(int((w.end < 1).sum()) for w in found.weights)
    if outliers > 0.1 * found.windows:
        notes.append(f"{outliers} of {found.windows} reference poses are outliers: the reference is poor")
    if {"multiplier", "icr"} <= judged.keys() and chosen not in ("multiplier", "differential"):
        notes += _simple_enough(judged)
    if not judged:
        notes.append("too short to hold anything out: no honest figure of its errors on new ground")
    return tuple(notes)


def _unseen(drives: Sequence[Drive], found: Fit) -> list[str]:
    """What the kind of reference cannot tell, whatever the drive."""
    if all(d.reference is None for d in drives):
        return [
            "a gyro alone tells the effective track width only, to about the scale of the gyro (taken as known to 1 %):"
            " icr_x, alpha_left, alpha_right and every translation are not observable"
        ]
    free = {name for name, is_free in zip(found.names, found.free, strict=True) if is_free}
    if "mount_yaw" in free and "mount_x" not in free:
        yaw, sigma = np.degrees(found.named("mount_yaw"))
        return [f"the reference's sensor is turned by {yaw:.1f} +- {sigma:.1f} deg against the way the robot drives"]
    if "mount_x" in free:
        return [
            "where the reference sits on the robot was not given, and motion alone cannot tell it from where the ICRs"
            " are: only how far they are apart is known well; give --mount X,Y to know each"
        ]
    return []


def _simple_enough(judged: Mapping[str, HeldOutErrors]) -> list[str]:
    pair = select({name: judged[name] for name in ("multiplier", "icr")})
    return ["one multiplier does as well as the five ICR parameters here"] if pair.name == "multiplier" else []


def _provenance(drives: Sequence[Drive], found: Fit, options: CalibrateOptions) -> Provenance:
    records = tuple(
        DriveRecord(d.name, d.source, d.sha256, d.span[1] - d.span[0], len(w.end), int((w.end < 1).sum()))
        for d, w in zip(drives, found.weights, strict=True)
    )
    chosen: dict[str, str | float | int | bool | None] = {
        "model": options.model,
        "method": options.method,
        "window": options.window,
        "seed": options.seed,
        "spacing": options.spacing,
        "time_offset": options.fit.time_offset,
        "lag": options.fit.lag,
        "mount": "free" if options.fit.mount is None else ",".join(f"{v:g}" for v in astuple(options.fit.mount)),
        "reference": ",".join(sorted({d.sees for d in drives if d.reference is not None})) or None,
        "align": options.fit.align,
        "robust": options.fit.robust,
        "fix": options.fix,
    }
    return provenance(records, chosen)


def provenance(records: tuple[DriveRecord, ...], options: Mapping[str, str | float | int | bool | None]) -> Provenance:
    """How a calibration is made here and now."""
    created = datetime.now(timezone.utc).isoformat(timespec="seconds")
    return Provenance(records, options, f"skidsteer {version('skidsteer')}", created)


def make_options(
    model: str = "auto",
    method: str = "least-squares",
    window: float = 2.0,
    seed: int = 0,
    time_offset: float | None = None,
    lag: float | None = None,
    mount: str | None = None,
    fix: bool = False,
) -> CalibrateOptions:
    """Options from the words of a command line; time offset and lag [s] are estimated where they are None.

    Raises:
        RequestError: a word or number that cannot be.
    """
    for name, value in (("time offset", time_offset), ("lag", lag)):
        if value is not None and not (np.isfinite(value) and abs(value) <= 5.0 and (name != "lag" or value >= 0.0)):
            raise RequestError(f"the {name} must be a time in s of at most 5 s (a lag not negative), got {value}")
    fit_options = FitOptions(time_offset=time_offset, lag=lag)
    align = False if mount is not None and mount.count(",") == 2 else None  # a yaw that is given is kept
    place = _parse_mount(mount)
    return CalibrateOptions(model, cast("Method", method), window, seed, place, align, fix, fit=fit_options)


def _parse_mount(text: str | None) -> Mount | Literal["free"] | None:
    """The words ``X,Y``, ``X,Y,YAW`` (m, m, rad) or ``free``."""
    if text is None or text == "free":
        return text  # type: ignore[return-value]
    try:
        numbers = [float(word) for word in text.split(",")]
        if len(numbers) not in (2, 3):
            raise ValueError
        return Mount(*numbers)
    except ValueError as error:
        raise RequestError(f"--mount takes X,Y or X,Y,YAW in m and rad, or free; got '{text}'") from error


def compare_models(
    drives: list[Drive], length: float = 2.0, progress: Progress | None = None
) -> tuple[dict[str, HeldOut], Selection]:
    """Held-out figures of every model, and which one the drives support.

    Raises:
        DataError: a drive that cannot be calibrated from, or too little to hold anything out.
    """
    for drive in drives:
        refuse_unusable(drive)
    options = settled(drives, CalibrateOptions(window=length))
    judged = judge_models(candidates(drives, options), drives, options, progress)
    if not judged:
        raise DataError(f"{drives[0].name}: too short to hold anything out; at least 16 s in motion are needed")
    return {name: HeldOut.of(e.errors, block=e.block) for name, e in judged.items()}, select(judged)
