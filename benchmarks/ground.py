"""The terramechanic plant against the paper, itself, other plants and our own calibration. Writes docs/ground.md."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.evaluation import evaluate
from skidsteer.identify.calibrate import CalibrateOptions, calibrate
from skidsteer.models import Icr
from skidsteer.reproduce.wang2015 import TABLE_3
from skidsteer.se2 import FloatArray
from skidsteer.simulate import Motion, Sensors, controller, recorded, rims_from_manoeuvres
from skidsteer.terramechanics.dynamics import move
from skidsteer.terramechanics.robot import Robot, robot, wang_robot
from skidsteer.terramechanics.shear import Quadrature
from skidsteer.terramechanics.steady_turn import rims_on_path, steady_turn
from skidsteer.terramechanics.terrain import TERRAINS, Terrain
from skidsteer.vehicle import preset

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "ground.md"
LAB, TILES = TERRAINS["lab"], TERRAINS["tiles"]
WANG = wang_robot()
RATIOS = np.arange(8.0)
SPEEDS = np.linspace(0.1, 0.5, 5)  # [m/s] of the 40 runs, Eq. (27)
SENSORS = Sensors(10.0, 0.005, float(np.radians(0.2)), encoder_rate=50.0, gyro_rate=50.0)
SEEDS = range(4)
PARALLEL = range(40)


def chi(terrain: Terrain, speeds: FloatArray | float, quadrature: Quadrature = Quadrature()) -> FloatArray:  # noqa: B008
    """Of Table 1's robot, mean over speeds."""
    rims = rims_on_path(RATIOS[:, None], speeds)
    found = steady_turn(WANG, terrain, rims[..., 0], rims[..., 1], quadrature).icr_coefficient
    return np.asarray(found.mean(axis=1))


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield from ("", f"| {' | '.join(head)} |", f"|{'---|' * len(head)}")
    yield from (f"| {' | '.join(row)} |" for row in rows)


def curve() -> Iterator[str]:
    coulomb = 1.0 + (0.275 / 0.4) ** 2
    alike = replace(LAB, friction_opposite=LAB.friction)
    free = replace(LAB, rolling_resistance=0.0)
    variants: list[tuple[str, Sequence[float]]] = [
        ("measured, Table 3", TABLE_3),
        ("Table 1 as printed (`lab`), 0.3 m/s", chi(LAB, 0.3)),
        ("the same, five speeds as measured", chi(LAB, SPEEDS)),
        ("very slow: no centrifugal force", chi(LAB, 0.01)),
        ("slow, mu_op = mu_sa", chi(alike, 0.01)),
        ("slow, no rolling resistance", chi(free, 0.01)),
        ("slow, no rolling resistance, K / 100", chi(replace(free, shear_modulus=5.4e-6), 0.01)),
        ("point contacts, 1 + (L / B)^2", [coulomb] * 8),
        ("slow, K_y = 1.25 mm, no rolling resistance", chi(TILES, 0.01)),
        ("the same (`tiles`), five speeds as measured", chi(TILES, SPEEDS)),
    ]
    yield "## chi over lambda: Fig. 5 and Table 3"
    rows = [[name, *(f"{value:.4f}" for value in values)] for name, values in variants]
    yield from table(["Pioneer P3-AT", *(f"{ratio:.0f}" for ratio in RATIOS)], rows)
    worst = [float(np.abs(chi(t, SPEEDS) / TABLE_3 - 1.0).max()) for t in (LAB, TILES)]
    took = np.median([_seconds(lambda: chi(LAB, 0.3)) for _ in range(9)])
    yield ""
    yield (
        f"Off the measured values by at most {100 * worst[0]:.1f} % (`lab`) and {100 * worst[1]:.1f} % (`tiles`). The"
        f" curve takes {1e3 * took:.1f} ms."
    )
    yield ""
    yield from WHY


WHY = (
    "As printed, Eqs. (16)-(22) give a fall from the spot to a circle and none after it. All of that fall is rolling",
    "resistance: on the spot the hubs of both sides move apart, so that it becomes a moment which the shear forces",
    "have to overcome beside the sideways friction; from R = B / 2 on it only holds the robot back. mu_op < mu_sa adds",
    "to it, for the resistance is then a larger share of the friction. The shear modulus K changes nothing: with equal",
    "loads all four patches slide alike, so that it scales all forces by one factor. The centrifugal force makes chi",
    "rise with lambda, as turns get gentler at the same speed. The paper does not say which of its terms made the",
    "smooth curve of Fig. 5.",
    "",
    "What gives the measured fall is tyres that give way more easily sideways than lengthwise: the wider the turn the",
    "less the wheels slip, the more of the stress is still elastic, and the less it resists sideways. One number",
    f"(K_y / K = {1.0 / TILES.stiffness_ratio:.1f}) fits Table 3, with rolling resistance left to the motors: on firm",
    "ground it is a moment at the wheel, which a speed loop overcomes, rather than a force on the body.",
)


def accuracy() -> Iterator[str]:
    yield "## Accuracy"
    fine = chi(LAB, 0.3, Quadrature(60, 20))
    robot_, commands = robot(preset("pioneer-p3at"), com_x=0.03), wild()
    best = {name: move(robot_, TERRAINS[name], commands, step=0.0005, quadrature=Quadrature(24, 8)) for name in GROUNDS}
    rows = []
    for nodes in (Quadrature(4, 2), Quadrature(6, 2), Quadrature(6, 3), Quadrature(8, 3), Quadrature(12, 4)):
        off = np.abs(chi(LAB, 0.3, nodes) - fine).max()
        ends = [end_error(move(robot_, TERRAINS[n], commands, quadrature=nodes), best[n]) for n in GROUNDS]
        rows.append([f"{nodes.along} x {nodes.across}", f"{off:.1e}", *(f"{1e3 * e[0]:.2f}, {e[1]:.3f}" for e in ends)])
    yield from table(["nodes along x across", "chi", *(f"end of 60 s on {n} [mm, deg]" for n in GROUNDS)], rows)
    rows = []
    for step in (0.02, 0.01, 0.005, 0.0025):
        motions = [move(robot_, TERRAINS[n], commands, step=step) for n in GROUNDS]
        ends = [end_error(m, best[n]) for m, n in zip(motions, GROUNDS, strict=True)]
        took = np.median([_seconds(lambda step=step: move(robot_, LAB, commands, step=step)) for _ in range(3)])
        cells = [f"{1e3 * e[0]:.2f}, {e[1]:.3f}" for e in ends]
        rows.append([f"{1e3 * step:g} ms", *cells, f"{np.ptp(commands.t) / took:.0f}"])
    yield from table(["longest step (8 x 3)", *(f"on {n} [mm, deg]" for n in GROUNDS), "times real time"], rows)
    yield ""
    yield "Against 24 x 8 nodes and steps of 0.5 ms; the command changes at random every 0.2 to 2 s. The defaults are"
    yield "8 x 3 and 5 ms. Times are processor time of one core."
    yield f"{len(PARALLEL)} drives of 60 s in two processes, on the clock: {parallel():.0f} times real time."


GROUNDS = ("lab", "gravel", "ice")


def wild(seconds: float = 60.0) -> Series:
    rng = np.random.default_rng(6)
    t = np.append(0.0, np.cumsum(rng.uniform(0.2, 2.0, int(seconds))))
    t = np.append(t[t < seconds], seconds)
    return Series(t, rng.uniform(-0.6, 0.6, (len(t), 2)))


def end_error(motion: Motion, best: Motion) -> tuple[float, float]:
    off = motion.pose[-1] - best.pose[-1]
    return float(np.hypot(*off[:2])), float(np.degrees(abs(off[2])))


def _seconds(call: object) -> float:
    start = time.process_time()
    call()  # type: ignore[operator]
    return time.process_time() - start


def one_seed(seed: int) -> float:
    commands = wild()
    recorded("seed", WANG.vehicle, move(WANG, LAB, commands), SENSORS, seed)
    return float(np.ptp(commands.t))


def parallel() -> float:
    with get_context("spawn").Pool(2) as pool:
        pool.map(one_seed, range(2))  # loads what is compiled
        start = time.perf_counter()
        driven = sum(pool.map(one_seed, PARALLEL, chunksize=1))
        return driven / (time.perf_counter() - start)


def centre_of_mass() -> Iterator[str]:
    yield "## Centre of mass"
    rows = []
    for name, terrain in (("lab", LAB), ("tiles", TILES), ("asphalt", TERRAINS["asphalt"])):
        cells = []
        for ahead in (-0.05, 0.02, 0.05):
            made = wang_robot(com_x=ahead)
            rims = rims_on_path(2.0, 0.02)
            found = steady_turn(made, terrain, *rims)
            moved = move(made, terrain, Series(np.array([0.0, 20.0]), np.tile(rims, (2, 1))))
            in_time = -moved.twist[-1, 1] / moved.twist[-1, 2]
            cells.append(f"{float(found.icr_x):+.3f}, {in_time:+.3f}")
        rows.append([name, *cells])
    yield from table(
        ["icr_x [m] of the steady turn, of the motion in time", "5 cm behind", "2 cm ahead", "5 cm ahead"], rows
    )
    yield ""
    yield "Wang's robot in slow turns, lambda = 2."


def plant_icrs(made: Robot, motion: Motion) -> FloatArray:
    """Parameters (5,) of constant ICRs nearest to the true twists and rim speeds, weighed as the sensors do."""
    model, sigma = Icr.nominal(made.vehicle), np.array([SENSORS.position_sigma] * 2 + [0.1 * SENSORS.yaw_sigma])

    def off(theta: FloatArray) -> FloatArray:
        return np.asarray(((model.with_theta(theta).twist(*motion.rims.T) - motion.twist) / sigma).ravel())

    return np.asarray(least_squares(off, model.theta).x)


def paths(speeds: Sequence[float], turns: Sequence[float]) -> FloatArray:
    rows = [[1.0, 0.0, 0.0]]
    for v in speeds:
        rows += [[5.0, v, s * w] for w in turns for s in (1.0, -1.0)] + [[3.0, v, 0.0], [2.0, -v, 0.0]]
        rows += [[3.0, 0.0, s * turns[-1]] for s in (1.0, -1.0)]
    return np.array([*rows, [1.0, 0.0, 0.0]])


Rolls = Callable[[Robot, Terrain, Series], Motion]


def drives_of(made: Robot, terrain: Terrain, rows: FloatArray, rolls: Rolls = move) -> tuple[Motion, list[Drive]]:
    commands = rims_from_manoeuvres(rows, controller(made.vehicle), acceleration=1.0)
    motion = rolls(made, terrain, commands)
    return motion, [recorded(f"{seed}", made.vehicle, motion, SENSORS, seed, commands) for seed in SEEDS]


def kept(motion: Motion) -> tuple[float, float]:
    """Shares of the rolled way that the robot makes: straight on, and turning while it drives."""
    rolled, turned = motion.rims.mean(axis=1), np.abs(motion.twist[:, 2])
    drives = np.abs(rolled) > 0.05
    parts = (drives & (turned < 0.02), drives & (turned > 0.1))
    return tuple(float(np.abs(motion.twist[p, 0]).sum() / np.abs(rolled[p]).sum()) for p in parts)  # type: ignore[return-value]


def recovery() -> Iterator[str]:
    yield "## Calibration on drives of this plant"
    yield from recovered(CASES, move)
    yield ""
    yield from CONSTANT


def recovery_elsewhere() -> Iterator[str]:
    from skidsteer import mujoco_plant

    yield "## Calibration on drives of MuJoCo"
    yield from recovered(ELSEWHERE, mujoco_plant.roll)
    yield ""
    yield "Coulomb friction at points in the physics engine, whose ground is not our model."


def recovered(cases: Sequence[Case], rolls: Rolls) -> Iterator[str]:
    rows = []
    for vehicle, terrain, measures in cases:
        made = robot(preset(vehicle), **measures)
        motion, drives = drives_of(made, TERRAINS[terrain], paths((0.1, 0.2, 0.3), (0.3, 0.6)), rolls)
        true, found, sigma = plant_icrs(made, motion), [], []
        for drive in drives:
            parameters = calibrate(drive, options=CalibrateOptions(model="icr")).parameters
            found.append([parameters[p.name].value for p in Icr.PARAMETERS])
            sigma.append([parameters[p.name].sigma for p in Icr.PARAMETERS])
        z = (np.array(found) - true) / sigma
        both = zip(true, np.mean(found, 0), np.mean(sigma, 0), strict=True)
        cells = [f"{t:.4f}, {m:.4f} ({s:.4f})" for t, m, s in both]
        ways = ", ".join(f"{100 * share:.1f}" for share in kept(motion))
        rows.append(
            [f"{vehicle}, {terrain}", ways, *cells, f"{(np.abs(z) < 2.0).mean():.2f}", f"{np.abs(z).max():.1f}"]
        )
        print(rows[-1], flush=True)
    head = ["slow drives: plant's own, found (sigma)", "way kept straight, turning [%]"]
    yield from table([*head, *(p.name for p in Icr.PARAMETERS), "share within 2 sigma", "largest, in sigma"], rows)
    yield ""
    yield f"{len(SEEDS)} drives each, of one motion with other noise of the sensors; sigma is the mean reported one."


Case = tuple[str, str, dict[str, float]]
CASES: list[Case] = [
    ("pioneer-p3at", "lab", {"com_x": 0.02}),
    ("pioneer-p3at", "tiles", {"com_x": 0.02}),
    ("jackal", "asphalt", {"com_x": -0.02}),
    ("warthog", "gravel", {}),
]
ELSEWHERE: list[Case] = [
    ("pioneer-p3at", "lab", {"com_x": 0.02}),
    ("jackal", "grass", {"com_x": -0.02}),
    ("husky-a200", "gravel", {}),
    ("warthog", "gravel", {"com_x": 0.05}),
]
CONSTANT = (
    "Where straights keep more of their way than curves no constant ICR describes the plant, however slowly it drives.",
    "The plant's own is then the one nearest to all of its motion; a robust fit, which weighs down what the rest of",
    "the drive contradicts, is nearest to another part of it. Stretches of the drive scatter more than the noise",
    "allows, and sigma comes from that scatter.",
)


SPEEDY = (("warthog", "asphalt"), ("warthog", "gravel"), ("warthog", "ice"), ("jackal", "gravel"), ("jackal", "ice"))


def steady_slip(made: Robot, terrain: Terrain) -> str:
    """icr_x over v of steady turns at 2 m/s, lambda 4 and 8."""
    turns = rims_on_path(np.array([4.0, 8.0]), 2.0)
    try:
        steady = steady_turn(made, terrain, turns[:, 0], turns[:, 1])
    except RequestError:
        return "no balance"
    return ", ".join(f"{c:.3f}" for c in steady.icr_x / steady.twist[:, 0])


def at_speed() -> Iterator[str]:
    yield "## At speed"
    rows = []
    for vehicle, terrain in SPEEDY:
        made = robot(replace(preset(vehicle), max_wheel_speed=None))
        _, (drive, other, *_) = drives_of(made, TERRAINS[terrain], paths((0.5, 1.0, 2.0), (0.3, 0.6, 1.0)))
        cells: list[str] = []
        terms: list[str] = []
        for name in ("icr", "scheduled_icr"):
            known = calibrate(drive, options=CalibrateOptions(model=name))
            figures = evaluate(known, [other]).total
            far, turned = figures.translation_m, figures.yaw_deg
            assert turned is not None
            cells.append(f"{100 * far.median:.1f} ({100 * far.rms:.1f}), {turned.median:.2f} ({turned.rms:.1f})")
            if name == "scheduled_icr":
                found = (known.parameters[term] for term in ("side_slip", "load_gain"))
                terms = [f"{term.value:.3f} +- {term.sigma:.3f}" for term in found]
        rows.append([f"{vehicle}, {terrain}", *cells, *terms, steady_slip(made, TERRAINS[terrain])])
        print(rows[-1], flush=True)
    head = ["drives up to 2 m/s", "constant: 2 s, median (RMS) [cm], yaw [deg]", "scheduled"]
    yield from table(
        [*head, "side_slip found [s]", "load_gain", "icr_x / v of steady turns at 2 m/s, lambda 4, 8 [s]"], rows
    )
    yield ""
    yield from SLIP


SLIP = (
    "Fitted on one drive, judged on another of the same path with other noise. Side slip here comes from friction that",
    "already slides. By hand, for stiff ground and small drifts, v_y = -v omega |omega| (a^2 + b^2)^(3/2) / (mu g a^2)",
    "with a = B (chi - 1) / 2, b = L / 2, so that the slip for each v omega grows with the yaw rate and falls with",
    "friction; soft ground adds a part that grows with speed. What real drives show stands in docs/models.md.",
)


def main() -> None:
    lines = [
        "# Wheels on the ground",
        "",
        "Written by `make studies` (`benchmarks/ground.py`); nothing here is edited by hand.",
    ]
    for section in (curve, accuracy, centre_of_mass, recovery, recovery_elsewhere, at_speed):
        lines += ["", *section()]
        print("\n".join(lines[-40:]), flush=True)
    DOCUMENT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
