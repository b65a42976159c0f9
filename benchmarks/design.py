"""Designed drives against unplanned ones: predicted, reported and actual errors. Writes docs/design.md."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.follow.belief import low_speed
from skidsteer.identify import unplanned
from skidsteer.identify.design import Design, Request, design_drive, setup_of, unplanned_sigmas
from skidsteer.identify.excursion import (
    expected_icr_distance,
    footprint_radius,
    possible_models,
    trajectory,
)
from skidsteer.identify.least_squares import Fit, FitOptions, fit_supported
from skidsteer.identify.manoeuvres import PERIOD, Limits
from skidsteer.identify.spacing import choose_spacing
from skidsteer.io.drives import load_drive
from skidsteer.kernels import roll
from skidsteer.models import MODELS, Icr, Model, ScheduledIcr
from skidsteer.plants import plant, usual_sensors
from skidsteer.se2 import FloatArray, between
from skidsteer.simulate import Sensors, kinematic_drive
from skidsteer.terramechanics.terrain import parse_ground
from skidsteer.vehicle import preset
from skidsteer.windows import MAX_GAP, increment_windows, predict

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("SKIDSTEER_DATA", ROOT.parent / "shared" / "data"))
ROBOTS = int(os.environ.get("SKIDSTEER_ROBOTS", "12"))
CASES = (  # vehicle, model, area [m], highest speed [m/s]; None: the command's own
    ("jackal", "icr", 10.0, None),
    ("jackal", "scheduled_icr", 10.0, None),
    ("jackal", "icr", 20.0, 2.0),
    ("jackal", "scheduled_icr", 20.0, 2.0),
    ("husky-a200", "icr", 10.0, None),
)
GRID = 61  # rim speeds of a side that the bound looks at
STEPS = 1500  # towards the bound
OTHERS = 3  # unplanned drives on the plant
RECORDED = ("warthog-asphalt", "warthog-grass-a", "warthog-grass-b", "husky-mocap", "husky-gyro-asphalt")
RECORDED += ("husky-gyro-flooring", "husky-gyro-ice", "husky-gyro-snow")
LAG, DELAY = 0.1, 0.15  # [s] of the simulated robots


def simulated(name: str, design: Design, robot: Model, rims: Series, seed: int) -> Drive:
    noise = design.setup.noise
    sensors = Sensors(design.setup.reference_rate, noise.position, noise.yaw, noise.stamp, DELAY)
    return kinematic_drive(name, design.setup.vehicle, robot, rims, sensors, LAG, (noise.walk, noise.turn), seed)


def calibrated(design: Design, robot: Model, rims: Series, seed: int) -> FloatArray:
    """Sigmas and errors (2, p) of a fit to a simulated drive, by the steps of ``calibrate`` without its judging."""
    drive = simulated("drive", design, robot, rims, seed)
    found, p = fitted(type(robot).nominal(drive.vehicle), drive), len(robot.theta)
    return np.stack([np.sqrt(np.diag(found.covariance))[:p], found.values[:p] - robot.theta])


def fitted(nominal: Model, drive: Drive) -> Fit:
    windows = [increment_windows(drive, choose_spacing([drive], FitOptions()))]
    return fit_supported(nominal, [drive], windows, FitOptions())


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
    left = np.full(len(design.setup.model.PARAMETERS), np.nan)
    for i, parameter in enumerate(design.setup.model.PARAMETERS):
        sigma, other = (median([e[0, i] for e in part if e[0, i] > 0.0]) for part in (ours, theirs))
        left[i], kept = other, sum(e[0, i] > 0.0 for e in theirs)
        rms, other_rms = (float(np.sqrt(np.mean([e[1, i] ** 2 for e in part]))) for part in (ours, theirs))
        lines.append(
            f"| {parameter.name} | {design.sigmas[parameter.name]:.4f} | {sigma:.4f} | {rms:.4f} | {other:.4f} |"
            f" {other_rms:.4f} | {kept} of {ROBOTS} | {sigma / other:.2f} | {rms / other_rms:.2f} |"
        )
    lines = [line.replace(" nan ", " - ") for line in lines]  # never supported
    return [*lines, "", *bounds(design, left), "", *staying_inside(design), *livelier(design)]


def bounds(design: Design, left: FloatArray) -> list[str]:
    """What no drive can do better, against the sigmas (p,) that unplanned drives left; NaN: never determined."""
    names, limits = [p.name for p in design.setup.model.PARAMETERS], design.limits
    leg = 2.0 * design.request.room(design.setup.vehicle)[0]
    way = design.duration * leg / (leg / limits.speed + limits.speed / limits.acceleration)
    alpha = design.setup.noise.walk / np.sqrt(way) / left[names.index("alpha_left")]
    best = least_worst_share(design, np.where(np.isnan(left), np.inf, left))
    return [
        f"Bounds: no drive within these limits leaves less than {best:.2f} of every sigma, though it never speeds up",
        f"nor turns round; straights alone, to and fro across the area, {way:.0f} m, leave {alpha:.2f} of alpha_left.",
    ]


def steady_information(design: Design) -> FloatArray:
    """Information (n, p, p) a second about the parameters at steady motions within the limits, by perfect poses.

    Poses that err, a lag and a time offset that are not known can only take away from it.
    """
    model, limits, noise = design.setup.model, design.limits, design.setup.noise
    side = np.linspace(-limits.wheel_speed, limits.wheel_speed, GRID)
    left, right = (a.ravel() for a in np.meshgrid(side, side))
    v, _, omega = model.twist(left, right).T
    rolled = 0.5 * (np.abs(left) + np.abs(right))
    kept = (np.abs(v) <= limits.speed + 1e-9) & (np.abs(omega) <= limits.omega) & (rolled > 0.0)
    kept &= np.abs(v * omega) <= limits.lateral_acceleration
    grown = np.sqrt(roll.paths(np.column_stack([left, right]), np.arange(len(left) + 1))[:, [0, 0, 1]])
    sigma = grown * [noise.walk, noise.walk, noise.turn]  # of the motion after a second
    slopes = model.parameter_jacobian(left[kept], right[kept]) / sigma[kept, :, None]
    return np.asarray(np.einsum("nki,nkj->nij", slopes, slopes))


def least_worst_share(design: Design, left: FloatArray) -> float:
    """Lower bound of the worst share that any mix of steady motions leaves of the sigmas (p,).

    The worst squared share is convex in the times w of the motions: for any weights of the parameters, their weighted
    squared shares less what any w gains along the gradient are a lower bound. Multiplicative steps raise it.
    """
    information, time, p = steady_information(design), design.duration, len(left)
    prior = np.diag(design.setup.prior[:p])
    times, weights, bound = np.full(len(information), time / len(information)), np.full(p, 1.0 / p), 0.0
    for _ in range(STEPS):
        C = np.linalg.inv(np.einsum("n,nij->ij", times, information) + prior)
        squared = np.diag(C) / left**2
        gain = np.einsum("ij,nji->n", C @ np.diag(weights / left**2) @ C, information)
        bound = max(bound, float(weights @ squared - (time * gain.max() - times @ gain)))
        times = times * np.sqrt(gain)
        times *= time / times.sum()
        weights = weights * squared**0.1
        weights /= weights.sum()
    return float(np.sqrt(bound))


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
        "The commands for a model, 10 x 10 m, 3 minutes, played on the terramechanic plant with its usual sensors",
        f"(1 cm, 0.5 deg, 10 Hz), beside {OTHERS} unplanned drives. This plant has no motion noise: what the fits take",
        "for it is where the model does not hold, so that sigmas cannot be compared: a drive that shows less of it",
        "reports less. So errors, root mean square: of the parameters against the ICRs of the plant's own steady turns",
        "at 0.3 m/s; in 2 s windows of three more unplanned drives on that ground. Off: the largest error of the five",
        "in reported sigmas, median.",
        "",
        "| robot, ground | model | drive | gets to | icr_y [mm] | icr_x [mm] | alpha [%] | off | 2 s: cm | deg |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in ("jackal", "husky-a200"):
        for family in ("icr", "scheduled_icr"):
            vehicle = preset(name)
            design = design_drive(setup_of(vehicle, MODELS[family]), Limits.of(vehicle), Request((10.0, 10.0), 180.0))
            for ground in ("lab", "grass"):
                lines += played(design, ground)
                print(*lines[-2:], sep="\n", flush=True)
    return lines


def played(design: Design, ground: str) -> list[str]:
    """Rows of the designed drive and of unplanned ones on a ground."""
    vehicle, limits, family = design.setup.vehicle, design.limits, type(design.setup.model)
    width, room = expected_icr_distance(vehicle), design.request.room(vehicle)

    def on_plant(rims: Series, seed: int) -> Drive:
        return plant("terramechanic")("drive", vehicle, parse_ground(ground), rims, usual_sensors(vehicle), seed)

    def unplanned_on_plant(seed: int) -> Drive:
        return on_plant(unplanned.unplanned_drive(width, limits, room, design.duration, seed), seed)

    own = low_speed("terramechanic", vehicle, parse_ground(ground)).theta
    judged = [unplanned_on_plant(2000 + seed) for seed in range(3)]
    parts = {"designed": [on_plant(design.rims, 0)], "unplanned": [unplanned_on_plant(1000 + i) for i in range(OTHERS)]}
    rows = []
    for name, drives in parts.items():
        found = [fitted(family.nominal(vehicle), drive) for drive in drives]
        off = np.array([f.values[:5] - own for f in found])
        sigmas = np.array([np.sqrt(np.diag(f.covariance))[:5] for f in found])
        y, x, alpha = (float(np.sqrt(np.mean(off[:, part] ** 2))) for part in (slice(2), 2, slice(3, 5)))
        cm, deg = np.sqrt(np.mean([missed(f, drive) for f in found for drive in judged], axis=0))
        reached = f"{np.abs(positions(drives[0])).max():.1f} m" if name == "designed" else ""
        worst = np.median(np.abs(off / sigmas).max(axis=1))
        rows.append(
            f"| {vehicle.name}, {ground} | {family.NAME} | {name} | {reached} | {1e3 * y:.0f} | {1e3 * x:.0f} |"
            f" {100 * alpha:.1f} | {worst:.1f} | {cm:.2f} | {deg:.2f} |"
        )
    return rows


def missed(found: Fit, drive: Drive) -> tuple[float, float]:
    """Mean squared errors [cm^2, deg^2] of predictions over 2 s."""
    windows = increment_windows(drive, 2.0)
    errors = between(predict(found.model, drive.wheels, windows, found.timings[0]), windows.motion)
    return 1e4 * float((errors[:, :2] ** 2).sum(axis=1).mean()), float(np.mean(np.degrees(errors[:, 2]) ** 2))


def positions(drive: Drive) -> FloatArray:
    """Where it got (n, 2) [m], seen from its first pose."""
    assert drive.pose is not None
    return np.asarray(between(drive.pose.values[0], drive.pose.values)[:, :2])


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
        "several speeds) so that no parameter keeps more than 45 % of the sigma that an unplanned drive leaves, or",
        "else the worst one as little as can be, with lag and time offset unknown; among such drives that with the",
        "greatest log determinant of the information. D-optimality alone gives up the scale factors.",
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
        "alone cannot get below the share sqrt(v / V). The bounds below each table are those of the information that",
        "steady motions within the limits give to perfect poses, in the best mix; the area, speeding up, turning",
        "round and poses that err take away from it.",
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
