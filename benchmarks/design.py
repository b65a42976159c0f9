"""Designed drives against unplanned ones: predicted, reported and actual errors. Writes docs/design.md."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.identify import unplanned
from skidsteer.identify.design import Design, Request, design_drive, setup_of, unplanned_sigmas
from skidsteer.identify.excursion import (
    expected_icr_distance,
    footprint_radius,
    possible_models,
    trajectory,
)
from skidsteer.identify.least_squares import FitOptions, fit_supported
from skidsteer.identify.manoeuvres import PERIOD, Limits
from skidsteer.identify.spacing import choose_spacing
from skidsteer.io.drives import load_drive
from skidsteer.models import MODELS, Icr, Model, ScheduledIcr
from skidsteer.plants import plant, usual_sensors
from skidsteer.se2 import FloatArray, between
from skidsteer.simulate import Sensors, kinematic_drive
from skidsteer.terramechanics.terrain import parse_ground
from skidsteer.vehicle import preset
from skidsteer.windows import MAX_GAP, increment_windows

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("SKIDSTEER_DATA", ROOT.parent / "shared" / "data"))
ROBOTS = int(os.environ.get("SKIDSTEER_ROBOTS", "12"))
CASES = (  # vehicle, model, area [m], highest speed [m/s]; None: the command's own
    ("jackal", "icr", 10.0, None),
    ("jackal", "icr", 20.0, 2.0),
    ("jackal", "scheduled_icr", 20.0, 2.0),
    ("husky-a200", "icr", 10.0, None),
)
RECORDED = ("warthog-asphalt", "warthog-grass-a", "warthog-grass-b", "husky-mocap", "husky-gyro-asphalt")
RECORDED += ("husky-gyro-flooring", "husky-gyro-ice", "husky-gyro-snow")
LAG, DELAY = 0.1, 0.15  # [s] of the simulated robots


def simulated(name: str, design: Design, robot: Model, rims: Series, seed: int) -> Drive:
    noise = design.setup.noise
    sensors = Sensors(design.setup.reference_rate, noise.position, noise.yaw, noise.stamp, DELAY)
    return kinematic_drive(name, design.setup.vehicle, robot, rims, sensors, LAG, (noise.walk, noise.turn), seed)


def calibrated(design: Design, robot: Model, rims: Series, seed: int) -> FloatArray:
    """Sigmas and errors (2, p) of a fit to a simulated drive, by the steps of ``calibrate`` without its judging."""
    drive, options = simulated("drive", design, robot, rims, seed), FitOptions()
    windows = [increment_windows(drive, choose_spacing([drive], options))]
    found = fit_supported(type(robot).nominal(drive.vehicle), [drive], windows, options)
    p = len(robot.theta)
    return np.stack([np.sqrt(np.diag(found.covariance))[:p], found.values[:p] - robot.theta])


def truth(design: Design, robot: Model) -> Model:
    assert isinstance(robot, ScheduledIcr)
    return robot.constant if design.setup.model.NAME == "icr" else robot


def case(vehicle_name: str, family: str, side: float, speed: float | None) -> list[str]:
    vehicle = preset(vehicle_name)
    limits, request = Limits.of(vehicle, speed), Request((side, side), 180.0)
    design = design_drive(setup_of(vehicle, MODELS[family]), limits, request)
    width, room = expected_icr_distance(vehicle), request.room(vehicle)
    ours, theirs = [], []
    for seed, robot in enumerate(possible_models(vehicle, 77)[:ROBOTS]):
        true = truth(design, robot)
        driven = unplanned.unplanned_drive(width, limits, room, design.duration, 1000 + seed)
        ours.append(calibrated(design, true, design.rims, seed))
        theirs.append(calibrated(design, true, driven, seed))
        print(vehicle_name, family, seed, flush=True)
    lines = [
        "",
        f"## {vehicle_name}, {family}, {side:g} x {side:g} m, 3 minutes, at most {limits.speed:g} m/s",
        "",
        "| | designed | | | unplanned | | | shares | |",
        "|---|---|---|---|---|---|---|---|---|",
        "| parameter | predicted | reported | actual | reported | actual | supported | reported | actual |",
    ]
    for i, parameter in enumerate(design.setup.model.PARAMETERS):
        sigma, other = (median([e[0, i] for e in part if e[0, i] > 0.0]) for part in (ours, theirs))
        kept = sum(e[0, i] > 0.0 for e in theirs)
        rms, other_rms = (float(np.sqrt(np.mean([e[1, i] ** 2 for e in part]))) for part in (ours, theirs))
        lines.append(
            f"| {parameter.name} | {design.sigmas[parameter.name]:.4f} | {sigma:.4f} | {rms:.4f} | {other:.4f} |"
            f" {other_rms:.4f} | {kept} of {ROBOTS} | {sigma / other:.2f} | {rms / other_rms:.2f} |"
        )
    lines = [line.replace(" nan ", " - ") for line in lines]  # never supported
    return [*lines, "", *staying_inside(design), *livelier(design)]


def median(values: list[float]) -> float:
    return float(np.median(values)) if values else float("nan")


def staying_inside(design: Design) -> list[str]:
    """How many robots that the design did not imagine stay inside the area, footprint included."""
    vehicle = design.setup.vehicle
    edge = 0.5 * np.array(design.request.area) - footprint_radius(vehicle)
    inside = []
    for seed in (1, 2, 3):
        for i, robot in enumerate(possible_models(vehicle, 5000 + seed)):
            path = trajectory(robot, design.rims, LAG, design.setup.noise, 1000 * seed + i).values
            inside.append(bool((np.abs(path[:, :2]).max(axis=0) <= edge).all()))
    return [
        f"Of {len(inside)} other robots that play the commands, {100 * np.mean(inside):.0f} % stay inside the area."
        f" Path driven: {np.abs(design.rims.values.mean(axis=1)).sum() * PERIOD:.0f} m.",
    ]


def livelier(design: Design) -> list[str]:
    """Against a driver who drives half as fast again."""
    slow, fast = unplanned.SPEED, tuple(1.5 * v for v in unplanned.SPEED)
    try:
        unplanned.SPEED = fast  # type: ignore[assignment]
        other = unplanned_sigmas(design.setup, design.limits, design.request)
    finally:
        unplanned.SPEED = slow
    shares = ", ".join(f"{p.name} {design.sigmas[p.name] / other[p.name]:.2f}" for p in design.setup.model.PARAMETERS)
    return [f"Against a driver half as fast again, predicted: {shares}.", ""]


def recorded() -> list[str]:
    """Statistics of drives of people, and what a designed drive would have told in the same time."""
    lines = [
        "",
        "## Drives that people recorded",
        "",
        "What an unplanned drive is: statistics of recorded drives, and of the driver imagined here. The shares are",
        "those of the sigmas of icr that a designed drive of the same length (at most 5 minutes) would leave, no",
        "faster than the fastest 1 % of the recorded one, in 20 x 20 m: both by the information of their wheel speeds,",
        "for the same reference and noise. Where people drove at one constant speed all the time, no design that is",
        "not faster can tell much more of the scale factors.",
        "",
        f"| drive | seconds | at rest | speed | turn | {' | '.join(p.name for p in Icr.PARAMETERS)} |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in RECORDED:
        drive = load_drive(DATA / name)
        vehicle = preset(drive.vehicle.name)
        dt = np.minimum(np.diff(drive.wheels.t, append=drive.wheels.t[-1]), MAX_GAP)
        lines.append(
            f"| {name} | {statistics(drive.wheels.values, dt, expected_icr_distance(vehicle))} | "
            + shares(drive)
            + " |"
        )
        print(lines[-1], flush=True)
    vehicle = preset("jackal")
    room, width = Request((10.0, 10.0), 180.0).room(vehicle), expected_icr_distance(vehicle)
    rims = np.concatenate(
        [unplanned.unplanned_drive(width, Limits.of(vehicle), room, 180.0, seed).values for seed in range(20)]
    )
    return [*lines, f"| the driver imagined | {statistics(rims, np.full(len(rims), PERIOD), width, 180.0)} | | | | | |"]


def statistics(rims: FloatArray, dt: FloatArray, width: float, length: float | None = None) -> str:
    time = float(dt.sum())
    rest = float(dt[np.abs(rims).max(axis=1) < 0.03].sum()) / time
    speed = float(np.abs(rims.mean(axis=1)) @ dt) / time
    turn = float(np.abs(rims[:, 1] - rims[:, 0]) @ dt) / width / time
    return f"{length or time:.0f} | {100 * rest:.0f} % | {speed:.2f} m/s | {turn:.2f} rad/s"


def shares(drive: Drive) -> str:
    vehicle = preset(drive.vehicle.name)
    start, end = drive.span
    wheels = drive.between(start, min(end, start + 300.0)).wheels
    rims = Series(wheels.t - wheels.t[0], wheels.values, "wheels")
    fastest = float(np.quantile(np.abs(rims.values.mean(axis=1)), 0.99))
    setup = setup_of(vehicle, MODELS["icr"])
    limits = Limits.of(vehicle, min(fastest, vehicle.max_wheel_speed or fastest))
    design = design_drive(setup, limits, Request((20.0, 20.0), float(rims.t[-1])))
    other = setup.sigmas(setup.information(rims))
    return " | ".join(f"{design.sigmas[p.name] / other[p.name]:.2f}" for p in setup.model.PARAMETERS)


def on_grounds() -> list[str]:
    """The commands played on wheels with shear and friction, of which the design knows nothing."""
    lines = [
        "",
        "## On a plant with slip that the design knows nothing of",
        "",
        "The commands for icr, 10 x 10 m, 3 minutes, played on the terramechanic plant with its usual sensors (1 cm,",
        "0.5 deg, 10 Hz): how far the robot gets from the start, where it ends, and the mean share over two seeds",
        "of the sigmas that a designed drive leaves, of those that an unplanned one on the same ground leaves. This",
        "plant has no motion noise: what the fit takes for it is where constant ICRs do not hold. Above 1, the faster",
        "and sharper motions show more of that than a slow drive does; scheduled_icr, the model that `design` serves",
        "unless told, is made for it.",
        "",
        f"| vehicle, ground | ahead, behind | to the sides | ends at | {' | '.join(p.name for p in Icr.PARAMETERS)} |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name in ("jackal", "husky-a200"):
        for ground in ("lab", "grass"):
            lines.append(f"| {name}, {ground}{played(name, ground)} |")
            print(lines[-1], flush=True)
    return lines


def played(name: str, ground: str) -> str:
    vehicle, request = preset(name), Request((10.0, 10.0), 180.0)
    limits = Limits.of(vehicle)
    design = design_drive(setup_of(vehicle, MODELS["icr"]), limits, request)
    width, room = expected_icr_distance(vehicle), request.room(vehicle)
    ratios, paths = [], []
    for seed in range(2):
        other = unplanned.unplanned_drive(width, limits, room, design.duration, 1000 + seed)
        sigmas = []
        for rims in (design.rims, other):
            drive = plant("terramechanic")("drive", vehicle, parse_ground(ground), rims, usual_sensors(vehicle), seed)
            found = fit_supported(Icr.nominal(vehicle), [drive], [increment_windows(drive)], FitOptions())
            sigmas.append(np.sqrt(np.diag(found.covariance))[:5])
            if rims is design.rims and drive.pose is not None:
                paths.append(between(drive.pose.values[0], drive.pose.values)[:, :2])
        ratios.append(sigmas[0] / sigmas[1])
    x, y = np.abs(np.concatenate(paths)).max(axis=0)
    end = np.mean([np.hypot(*path[-1]) for path in paths])
    return " | ".join(["", f"{x:.1f} m", f"{y:.1f} m", f"{end:.1f} m", *(f"{r:.2f}" for r in np.mean(ratios, axis=0))])


def both_models() -> list[str]:
    """What a drive designed for one model tells of the other."""
    lines = [
        "",
        "## Which model to design for",
        "",
        "Predicted sigmas over those of unplanned drives, jackal, 10 x 10 m, 3 minutes.",
        "",
        "| designed for | told of | " + " | ".join(p.name for p in ScheduledIcr.PARAMETERS) + " |",
        "|---|---|" + "---|" * len(ScheduledIcr.PARAMETERS),
    ]
    vehicle, request = preset("jackal"), Request((10.0, 10.0), 180.0)
    limits, setups = Limits.of(vehicle), {name: setup_of(vehicle, MODELS[name]) for name in ("icr", "scheduled_icr")}
    for made_for in setups:
        rims = design_drive(setups[made_for], limits, request).rims
        for told, setup in setups.items():
            sigmas, other = setup.sigmas(setup.information(rims)), unplanned_sigmas(setup, limits, request)
            cells = " | ".join(f"{sigmas[p.name] / other[p.name]:.2f}" for p in setup.model.PARAMETERS)
            lines.append(
                f"| {made_for} | {told} | {cells} |"
                + " |" * (len(ScheduledIcr.PARAMETERS) - len(setup.model.PARAMETERS))
            )
    return lines


def main() -> None:
    lines = [
        "# Designed drives against unplanned ones",
        "",
        "Written by `make studies` (`benchmarks/design.py`); nothing here is edited by hand.",
        "",
        "`skidsteer design` chooses figures (straights, turns on the spot, arcs, to both sides, there and back, at",
        "several speeds) so that the log determinant of the information about the model's parameters, with lag and",
        "time offset unknown, is greatest. A parameter that would keep more than 45 % of the sigma that an unplanned",
        "drive leaves is weighed up: D-optimality alone gives up the scale factors.",
        "",
        f"Each case: {ROBOTS} robots drawn from what is thinkable of the vehicle (the design knows only the expected",
        "one), each simulated on the designed drive and on an unplanned one of equal length in the same area, with a",
        f"lag of {LAG} s, a reference {DELAY} s late at 10 Hz, and the noise that `design` assumes; both fitted by the",
        "steps of `calibrate`. Reported: median sigma of the fits. Actual: root mean square error. Supported: how many",
        "unplanned drives do not leave the parameter out; only those are in the median. Shares: designed over",
        "unplanned.",
        "",
        "The scale factors are the hard ones. The motion noise grows with the distance, so that what any drive tells",
        "of them is bounded by the distance it covers: against a driver who averages v, a drive at V on straights",
        "alone cannot get below the share sqrt(v / V), and it has turns to drive and to speed up and slow down.",
    ]
    for one in CASES:
        lines += case(*one)
    lines += both_models()
    lines += on_grounds()
    if DATA.is_dir():
        lines += recorded()
    (ROOT / "docs" / "design.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
