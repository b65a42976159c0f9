"""Results as plain dictionaries: what ``--json`` prints. Keys name their unit; NaN becomes null."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from skidsteer.calibration import Calibration, Estimate, HeldOut, Observability
from skidsteer.doctor import Finding
from skidsteer.drive import Drive
from skidsteer.errors import printable
from skidsteer.evaluation import Evaluation
from skidsteer.follow.run import Run, summarize
from skidsteer.follow.task import Task
from skidsteer.identify.circle_calibration import CircleCalibration
from skidsteer.identify.circle_test import SideResult, SurfaceResult
from skidsteer.identify.design import Design
from skidsteer.identify.select import Selection
from skidsteer.identify.terrain import Terrains
from skidsteer.plan.circumnavigation import Plan
from skidsteer.plan.stretches import Stretch
from skidsteer.report.markup import plain
from skidsteer.reproduce.figure import Curve
from skidsteer.reproduce.rows import Reproduction, tally

if TYPE_CHECKING:
    from skidsteer.io.bag import BagContents
    from skidsteer.odometry.run import Odometry

Document = dict[str, Any]


def calibration_document(calibration: Calibration) -> Document:
    """What ``calibrate --json`` prints."""
    width = calibration.effective_track_width
    return {
        "model": calibration.model.NAME,
        "parameters": {name: _estimate(e) for name, e in calibration.parameters.items()},
        "nuisance": {name: _estimate(e) for name, e in calibration.nuisance.items()},
        "derived": {"effective_track_width": _estimate(width)} if width else {},
        "noise": asdict(calibration.noise),
        "regions": None if calibration.regions is None else asdict(calibration.regions),
        "observability": None if calibration.observability is None else asdict(calibration.observability),
        "controller": None if calibration.controller is None else asdict(calibration.controller),
        "method": calibration.method,
        "selected_because": calibration.selected_because,
        "warnings": list(calibration.warnings),
        "held_out": {name: _held_out(h) for name, h in calibration.held_out.items()},
        "vehicle": asdict(calibration.vehicle),
        "drives": [asdict(d) for d in calibration.provenance.drives],
        "software": calibration.provenance.software,
        "profiles": {name: calibration_document(profile) for name, profile in calibration.profiles.items()},
    }


def circles_document(found: CircleCalibration) -> Document:
    """What ``calibrate --json`` prints of circle runs: the calibration, and the test surface by surface."""
    width = found.calibration.vehicle.track_width
    return {**calibration_document(found.calibration), "circle_test": [_surface(s, width) for s in found.surfaces]}


def _surface(result: SurfaceResult, track_width: float) -> Document:
    sides = {"left": result.left, "right": result.right}
    return {"surface": result.surface, **{n: None if s is None else _side(s, track_width) for n, s in sides.items()}}


def _side(result: SideResult, track_width: float) -> Document:
    return {
        "icr_y_m": result.icr_y,
        "icr_y_sigma_m": result.icr_y_sigma,
        "equivalent_track_width_m": 2.0 * result.icr_y,
        "chi": result.steering_efficiency,
        "misfit": result.misfit,
        "runs": [
            {
                "name": run.name,
                "v_left": run.v_left,
                "v_right": run.v_right,
                "radius_m": run.radius,
                "chi": run.steering_efficiency(track_width),
                "slip_ratio": ratio,
            }
            for run, ratio in zip(result.runs, result.slip_ratios, strict=True)
        ],
    }


def evaluation_document(evaluation: Evaluation, length: float) -> Document:
    """What ``evaluate --json`` prints."""
    drives = {
        name: {**_held_out(h), "time_offset_s": evaluation.time_offsets[name]} for name, h in evaluation.drives.items()
    }
    warnings = list(evaluation.warnings)
    return {"window_s": length, **_held_out(evaluation.total), "drives": drives, "warnings": warnings}


def comparison_document(held_out: dict[str, HeldOut], selection: Selection) -> Document:
    """What ``compare --json`` prints."""
    return {
        "selected": selection.name,
        "selected_because": selection.because,
        "models": {
            name: {**_held_out(h), "against_best": asdict(selection.against_best[name])} for name, h in held_out.items()
        },
    }


def terrains_document(found: Terrains) -> Document:
    """What ``terrains --json`` prints; ``a_on_b`` is the calibration of a on drives of b against b's own."""
    return {
        "model": found.model,
        "grounds": list(found.names),
        **asdict(found.difference),
        "profiles_needed": found.needed,
        "because": found.because,
        "pairs": [asdict(pair) for pair in found.pairs],
    }


def odometry_document(result: Odometry, warnings: Sequence[str] = ()) -> Document:
    """What ``odometry --json`` prints; ``warnings`` are of calibration and drive."""
    track = result.trajectory
    return {
        "filter": result.filter.fingerprint,
        "poses": len(track.t),
        "reference": {
            "accepted": int(track.accepted.sum()),
            "rejected": int((~track.accepted).sum()),
            "anchored": int(track.anchored.sum()),
            "nis_per_dof": {
                "mean": float(np.mean(track.squared) / track.dof),
                "median": float(np.median(track.squared) / track.dof),
            }
            if len(track.squared)
            else None,
        },
        "gyro": {"accepted": track.rates[0], "rejected": track.rates[1], "nis_mean": track.rate_squared},
        "last": {
            "t": track.last.time,
            "mean": dict(zip(track.names, track.last.mean.tolist(), strict=True)),
            "sigma": dict(zip(track.names, np.sqrt(np.diag(track.last.covariance)).tolist(), strict=True)),
        },
        "since": result.since,
        "distance_m": None if result.distance is None else asdict(result.distance),
        "nominal_distance_m": None if result.nominal is None else asdict(result.nominal),
        "warnings": list(warnings),
    }


def check_document(
    drive: Drive,
    findings: Sequence[Finding],
    topics: BagContents | None,
    cures: Sequence[str],
    verdict: Observability | str,
) -> Document:
    """What ``check --json`` prints."""
    return {
        "drive": drive.name,
        "findings": [asdict(f) for f in findings],
        "cures": list(cures),
        "observability": None if isinstance(verdict, str) else asdict(verdict),
        "not_judged_because": verdict if isinstance(verdict, str) else None,
        "topics": [] if topics is None else [asdict(t) for t in topics.topics],
        "notes": [] if topics is None else list(topics.notes),
    }


def design_document(design: Design) -> Document:
    """What ``design --json`` prints."""
    units = {p.name: p.unit for p in design.setup.model.PARAMETERS}
    return {
        "vehicle": design.setup.vehicle.name,
        "model": design.setup.model.NAME,
        "area_m": list(design.request.area),
        "duration_s": design.duration,
        "manoeuvres": [
            {"start_s": start, "duration_s": duration, "what": figure.words()}
            for start, duration, figure in design.schedule
        ],
        "predicted": {
            name: {"sigma": sigma, "unplanned_sigma": design.unplanned[name], "unit": units.get(name, "s")}
            for name, sigma in design.sigmas.items()
        },
        "reaches_m": asdict(design.excursion),
        "controller_width_m": design.controller.track_width,
        "limits": asdict(design.limits),
        "noise": asdict(design.setup.noise),
    }


def plan_document(plan: Plan) -> Document:
    """What ``plan --json`` prints."""
    return {
        "vehicle": plan.driver.vehicle.name,
        "model": plan.driver.model.NAME,
        "direction": plan.request.side,
        "laps": plan.request.laps,
        "radius_m": plan.radius,
        "obstacle": {"length_m": plan.obstacle.length, "width_m": plan.obstacle.width, "pose": plan.place.tolist()},
        "footprint_m": [plan.robot.length, plan.robot.width],
        "stretches": [_stretch(float(t), s) for t, s in zip(plan.starts, plan.stretches, strict=True)],
        "duration_s": float(plan.starts[-1] + plan.stretches[-1].duration),
        "clearance_m": {"asked": plan.request.clearance, "least": float(plan.gaps.min()), "least_95": plan.sure_gap},
        "end": {
            "pose": plan.end.tolist(),
            "sigma_ahead_m": plan.end_sigmas[0],
            "sigma_left_m": plan.end_sigmas[1],
            "sigma_yaw_rad": plan.end_sigmas[2],
            "rounding_misses": plan.misses.tolist() if plan.driver.encoding else None,
        },
        "warnings": list(plan.notes),
    }


def _stretch(start: float, stretch: Stretch) -> Document:
    return {
        "name": stretch.name,
        "start_s": start,
        "duration_s": stretch.duration,
        "radius_m": stretch.radius,
        "length_m": stretch.length,
        "asked_m_s": stretch.asked.tolist(),
        "k": None if stretch.k is None else list(stretch.k),
        "rims_m_s": stretch.rims.tolist(),
        "twist": stretch.twist.tolist(),
    }


def follow_document(task: Task, run: Run) -> Document:
    """What ``follow --json`` prints."""
    found, model = summarize(run), task.belief.model
    return {
        "vehicle": task.vehicle.name,
        "plant": task.plant,
        "terrain": task.ground.words(),
        "controller": {"law": task.law, "gains": task.gains, "speed_mps": task.speed},
        "believed": {
            "model": model.NAME,
            "parameters": {p.name: float(v) for p, v in zip(model.PARAMETERS, model.theta, strict=True)},
            "from": task.belief.source,
        },
        "path": {"length_m": run.path.length, "closed": run.path.closed, "reverse": run.path.reverse},
        "lag_s": task.lag,
        "wheel_limits": {"speed_mps": task.wheels.max_speed, "acceleration_mps2": task.acceleration},
        "sensing": asdict(task.sensing),
        "seed": task.seed,
        "outcome": run.outcome,
        "reason": run.reason,
        "duration_s": found.duration,
        "way_m": found.way,
        "laps": found.laps,
        "cross_track_m": {"mean": found.mean, "max": found.largest, "rms": found.rms},
        "heading_rms_rad": found.heading_rms,
        "mean_speed_mps": found.speed,
        "wheels": {"fastest_mps": found.fastest, "effort_mps2": found.effort, "energy_j": found.energy},
    }


def reproduction_document(paper: str, done: Reproduction) -> Document:
    """What ``reproduce --json`` prints."""
    return {
        "paper": paper,
        "rows": [{**asdict(row), "difference": row.difference} for row in done.rows],
        "verdicts": tally(done.rows),
        "places": [
            {
                **asdict(place),
                "rows": [row.what for row in done.rows_of(place)],
                "figures": [figure.name for figure in done.figures_of(place)],
            }
            for place in done.places
        ],
        "tables": [asdict(table) for table in done.tables],
        "notes": list(done.notes),
        "figures": [
            {
                "name": figure.name,
                "title": figure.title,
                "x": figure.x_label,
                "y": figure.y_label,
                "curves": [_curve(curve) for curve in figure.curves],
            }
            for figure in done.figures
        ],
    }


def reproductions_document(done: Mapping[str, Reproduction]) -> Document:
    """What ``reproduce all --json`` prints."""
    return {"papers": {name: reproduction_document(name, reproduction) for name, reproduction in done.items()}}


def _curve(curve: Curve) -> Document:
    bars = {n: v.tolist() for n, v in (("low", curve.low), ("high", curve.high)) if v is not None}
    return {"label": curve.label, "x": curve.x.tolist(), "y": curve.y.tolist(), **bars}


def _estimate(e: Estimate) -> Document:
    return {"value": e.value, "sigma": e.sigma, "unit": e.unit, "determined": e.determined}


def _held_out(figures: HeldOut) -> Document:
    return {key: value for key, value in asdict(figures).items() if value is not None}


def to_json(document: Document) -> str:
    """Strict JSON of a document, without control characters."""
    text = json.dumps(plain(document), indent=2, allow_nan=False, ensure_ascii=False)
    return re.sub(r"[^ -~\n]", lambda c: c[0] if printable(c[0]) == c[0] else json.dumps(c[0])[1:-1], text)
