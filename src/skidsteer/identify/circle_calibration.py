"""A calibration from circle runs alone, each surface a profile.

A radius tells where the tread ICRs lie, symmetric about the origin: R = x_ICR lambda, Giannoccaro 2015, Eq. (12). It
tells nothing of scale, clocks or lag; with speeds over ground there is a scale factor, too. Where the ICR distance
falls with lambda as Wang 2015, Eq. (44), has it, that is followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as fisher

from skidsteer.calibration import Calibration, DriveRecord, Estimate
from skidsteer.drive import Drive
from skidsteer.errors import RequestError
from skidsteer.identify.calibrate import provenance
from skidsteer.identify.circle_test import (
    CoefficientFit,
    SurfaceResult,
    circle_test,
    fit_coefficient,
    runs_from_drive,
    runs_on,
)
from skidsteer.identify.judged import DETERMINED
from skidsteer.identify.least_squares import find_offset
from skidsteer.identify.start import FitOptions
from skidsteer.identify.unknowns import PRIOR_SIGMA, UNITS
from skidsteer.models import Model, Multiplier, SymmetricIcr
from skidsteer.models.slip_ratio import CircleRun
from skidsteer.noise import Noise
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Timing, increment_windows

METHOD = "circle-test"
ABLE = ("icr_symmetric", "curvature")
LEVEL = 0.05  # at which Eq. (44) must describe the runs better than a constant
MISFIT = 0.2  # share of a radius


@dataclass(frozen=True, slots=True)
class CircleCalibration:
    """A calibration, with a profile for each surface where there are several, and the test it was made from."""

    calibration: Calibration
    surfaces: tuple[SurfaceResult, ...]


def serves(model: str, method: str, is_drive: bool) -> bool:
    """Whether circle runs are to be calibrated from as such; where they are laid out as a drive, too, it may serve.

    Raises:
        RequestError: a method that circle runs alone do not support.
    """
    if is_drive:
        return method == METHOD or (method == "least-squares" and model in ("auto", *ABLE))
    if method not in ("least-squares", METHOD):
        raise RequestError(f"--method {method} needs a drive; a table of circle runs tells radii only")
    return True


def calibrate_circles(
    runs: Sequence[CircleRun], vehicle: Vehicle, records: tuple[DriveRecord, ...], model: str = "auto"
) -> CircleCalibration:
    """Calibrate a model from circle runs.

    Args:
        runs: of any surfaces; a surface of a single run gets no profile.
        vehicle: that they were driven with.
        records: where they come from.
        model: one of ``ABLE``, or auto: Wang's curve where the runs of every surface follow it, else a constant.

    Raises:
        RequestError: a model that circles cannot tell, fewer than two runs, or too few for the model.
    """
    if model not in ("auto", *ABLE):
        raise RequestError(f"circle runs cannot tell the model '{model}'; choose one of auto, {', '.join(ABLE)}")
    if len(runs) < 2:
        raise RequestError(f"{records[0].name}: {len(runs)} circle run cannot tell its own error; record at least 2")
    surfaces = circle_test(runs, vehicle.track_width)
    groups = {s.surface: runs_on(runs, s.surface) for s in surfaces}
    groups = {name or "unnamed": group for name, group in groups.items() if len(group) > 1}
    chosen, because = _choose(model, runs, list(groups.values()), vehicle)
    profiles = {}
    if len(surfaces) > 1:
        profiles = {n: _calibration(chosen, because, g, vehicle, records) for n, g in groups.items()}
    whole = _calibration(chosen, because, runs, vehicle, records)
    return CircleCalibration(replace(whole, profiles=profiles), surfaces)


def calibrate_circles_in(drives: Sequence[Drive], model: str = "auto") -> CircleCalibration:
    """Calibrate a model from the runs along circles in drives of one robot, each drive a surface.

    Raises:
        RequestError: as ``circle_runs_in`` and ``calibrate_circles``.
    """
    found = [circle_runs_in(drive) for drive in drives]
    records = tuple(
        DriveRecord(d.name, d.source, d.sha256, d.span[1] - d.span[0], len(runs), 0)
        for d, runs in zip(drives, found, strict=True)
    )
    return calibrate_circles([run for runs in found for run in runs], drives[0].vehicle, records, model)


def circle_runs_in(drive: Drive) -> tuple[CircleRun, ...]:
    """The runs along circles in a drive with reference poses, its name as their surface.

    Raises:
        RequestError: no reference poses, or no such run.
    """
    offset = 0.0
    if drive.pose is not None:
        start = Multiplier.nominal(drive.vehicle)
        offset = find_offset(start, drive, increment_windows(drive), FitOptions().search)
    circles = [run.circle(drive.name) for run in runs_from_drive(drive, Timing(offset))]
    found = tuple(circle for circle in circles if circle is not None)
    if not found:
        raise RequestError(f"{drive.name}: turns on the spot only; record circles, with both sides running one way")
    return found


# Which model


def _choose(
    model: str, runs: Sequence[CircleRun], groups: Sequence[Sequence[CircleRun]], vehicle: Vehicle
) -> tuple[str, str]:
    if model != "auto":
        return model, "asked for"
    refusals = [why for group in groups or [runs] if (why := _why_constant(group, vehicle))]
    if refusals:
        return "icr_symmetric", refusals[0]
    return "curvature", "the ICR distance falls with lambda as Eq. (44) of Wang 2015 has it, significantly"


def _why_constant(runs: Sequence[CircleRun], vehicle: Vehicle) -> str:
    """Why a constant ICR distance describes runs as well as Wang's curve does; empty where it does not."""
    try:
        curve = _curve(runs, vehicle)
    except RequestError as refusal:
        return f"no curve through these runs: {refusal}"
    if curve.at_bound:
        return "the ICR distance does not fall with lambda as Eq. (44) of Wang 2015 has it"
    chi = np.array([1.0 / run.steering_efficiency(vehicle.track_width) for run in runs])
    left, freedom = curve.rms**2 * len(chi), len(chi) - 2
    gained = float(((chi - chi.mean()) ** 2).sum()) - left
    p = float(fisher.sf(gained / (left / freedom), 1, freedom)) if left > 0.0 else 0.0
    return "" if p < LEVEL else f"no significant fall of the ICR distance with lambda (p = {p:.2g})"


def _curve(runs: Sequence[CircleRun], vehicle: Vehicle) -> CoefficientFit:
    """Wang's a and b through circle runs; his chi is the inverse of the steering efficiency."""
    chi = [1.0 / run.steering_efficiency(vehicle.track_width) for run in runs]
    return fit_coefficient([run.path_curvature for run in runs], chi)


# The calibration of a group of runs


def _calibration(
    name: str, because: str, runs: Sequence[CircleRun], vehicle: Vehicle, records: tuple[DriveRecord, ...]
) -> Calibration:
    alpha, alpha_sigma = _scale(runs)
    model, covariance, notes = _curved(runs, vehicle, alpha) if name == "curvature" else _constant(runs, alpha)
    nuisance = ("lag", "time_offset")
    sigmas = [alpha_sigma, *(PRIOR_SIGMA[n] for n in nuisance)]
    size = len(covariance)
    whole = np.diag([*np.zeros(size), *np.square(sigmas)])
    whole[:size, :size] = covariance
    names = (*(p.name for p in model.PARAMETERS), *nuisance)
    values = [*model.theta, 0.0, 0.0]
    units = [*(p.unit for p in model.PARAMETERS), *(UNITS[n] for n in nuisance)]
    limits = type(model).bounds(vehicle)
    prior = [*(np.diff(limits, axis=1)[:, 0] / np.sqrt(12.0)), *(PRIOR_SIGMA[n] for n in nuisance)]
    sigma = np.sqrt(np.diag(whole))
    estimates = {
        n: Estimate(float(v), float(s), unit, bool(s < DETERMINED * before))
        for n, v, s, unit, before in zip(names, values, sigma, units, prior, strict=True)
    }
    return Calibration(
        vehicle=vehicle,
        model=model,
        names=names,
        estimates=estimates,
        covariance=whole,
        noise=Noise(),
        provenance=provenance(records, {"model": name, "method": METHOD}),
        method=METHOD,
        selected_because=because,
        warnings=(*notes, *_open(estimates)),
    )


def _open(estimates: dict[str, Estimate]) -> tuple[str, ...]:
    weak = [name for name, e in estimates.items() if not e.determined]
    scale = "; measure speeds over ground (column speed), or add a drive with a straight" if "alpha" in weak else ""
    return (
        f"not determined by circle runs: {', '.join(weak)}; the values given are assumptions, see sigma{scale}",
        "circle runs tell no noise: the predicted regions rest on an assumption",
    )


def _scale(runs: Sequence[CircleRun]) -> tuple[float, float]:
    """Scale factor of the rims and its sigma, from speeds over ground; 1 and what is known before where too few are."""
    ratios = np.array([2.0 * run.speed / (run.outer + run.inner) for run in runs if run.speed is not None])
    if len(ratios) < 2:
        prior = next(p for p in SymmetricIcr.PARAMETERS if p.name == "alpha")
        return 1.0, (prior.upper - prior.lower) / float(np.sqrt(12.0))
    return float(ratios.mean()), float(ratios.std(ddof=1) / np.sqrt(len(ratios)))


Part = tuple[Model, FloatArray, list[str]]  # model, covariance of all its parameters but alpha, notes


def _curved(runs: Sequence[CircleRun], vehicle: Vehicle, alpha: float) -> Part:
    curve = _curve(runs, vehicle)
    notes = ["a or b stands at a limit of its search: a constant ICR describes the runs as well"]
    return curve.model(vehicle, alpha), curve.covariance, notes if curve.at_bound else []


def _constant(runs: Sequence[CircleRun], alpha: float) -> Part:
    """The ICR distance with the least relative errors of the radii: of their squares wide arcs alone would decide."""
    logs = np.log([run.icr_y for run in runs])
    icr_y, spread = float(np.exp(logs.mean())), float(logs.std(ddof=1))
    covariance = np.array([[(icr_y * spread) ** 2 / len(logs)]])
    misfit = float(np.abs(np.expm1(logs.mean() - logs)).max())
    note = (
        f"one ICR distance misses a radius by {100.0 * misfit:.0f} %: no constant ICR describes these runs;"
        " use circles like those that will be driven"
    )
    return SymmetricIcr(icr_y, alpha), covariance, [note] if misfit > MISFIT else []
