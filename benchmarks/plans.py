"""Laps round an obstacle, planned by calibrations and by circle tests, on simulated ground. Writes docs/plans.md."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.identify.calibrate import calibrate
from skidsteer.identify.circle_calibration import circle_runs_in
from skidsteer.plan.circumnavigation import Plan, Request, circumnavigate
from skidsteer.plan.driver import Driver
from skidsteer.plan.outline import Rectangle, gap
from skidsteer.plan.slip_table import SlipTable
from skidsteer.samples import COM_AHEAD, GROUND_SENSORS, on_ground
from skidsteer.terramechanics.dynamics import move, terramechanic_drive
from skidsteer.terramechanics.robot import Robot, robot
from skidsteer.terramechanics.terrain import terrain
from skidsteer.vehicle import preset

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "plans.md"
OBSTACLE = Rectangle(0.70, 1.25, "obstacle")
CLEARANCE = 0.4  # [m]
CASES = (  # vehicle, ground, speeds [m/s] and yaw rates [rad/s] of the drive, speed of the lap
    ("pioneer-p3at", "tiles", (0.2, 0.3, 0.4), (0.3, 0.6), 0.3),
    ("jackal", "asphalt", (0.3, 0.6, 0.9), (0.4, 0.8), 0.5),
    ("jackal", "grass", (0.3, 0.6, 0.9), (0.4, 0.8), 0.5),
    ("husky-a200", "gravel", (0.2, 0.4, 0.6), (0.3, 0.6), 0.4),
)
SHARES = (0.8, 0.65, 0.5, 0.35, 0.2)  # of the outer rim speed, on circles
HELD, REST, PERIOD = 6.0, 1.0, 0.05  # [s]


def circle_commands(outer: float) -> Series:
    """Ten circles at an outer rim speed [m/s], a rest between two."""
    rest, held = np.zeros((round(REST / PERIOD), 2)), round(HELD / PERIOD)
    pairs = [(share * outer, outer) for share in SHARES]
    rims = [np.concatenate([rest, np.tile(pair, (held, 1))]) for pair in [*pairs, *(p[::-1] for p in pairs)]]
    values = np.concatenate([*rims, rest])
    return Series(PERIOD * np.arange(len(values), dtype=float), values, "circles")


def drivers(made: Robot, case: tuple[str, str, tuple[float, ...], tuple[float, ...], float]) -> dict[str, Driver]:
    """By what one drive tells, and by circles about as fast as the lap."""
    name, ground, speeds, rates, speed = case
    drive = on_ground(name, ground, speeds, rates)
    known = {model: Driver.of(calibrate(drive, model)) for model in ("icr", "scheduled_icr")}
    sensors = replace(GROUND_SENSORS, reference_delay=0.0)
    circles = terramechanic_drive("circles", made, terrain(ground), circle_commands(1.3 * speed), sensors)
    table = SlipTable(circle_runs_in(circles), made.vehicle.track_width)
    return known | {"slip ratios of circles": Driver.of_circles(table, made.vehicle)}


def lap(plan: Plan, made: Robot, ground: str) -> list[str]:
    path = move(made, terrain(ground), plan.rims).pose
    off, sigma = path[-1] - plan.end, plan.end_sigmas
    kept = float(gap(plan.robot, path, plan.obstacle, plan.place).min())
    place = f"{np.hypot(*off[:2]):.3f} ({np.hypot(*sigma[:2]):.3f})"
    yaw = f"{np.degrees(off[2]):+.1f} ({np.degrees(sigma[2]):.1f})"
    return [place, yaw, f"{abs(off[2]) / sigma[2]:.1f}", f"{kept:.3f}", f"{plan.sure_gap:.3f}"]


def rows() -> Iterator[list[str]]:
    for case in CASES:
        made = robot(preset(case[0]), com_x=COM_AHEAD)
        for way, driver in drivers(made, case).items():
            for side in ("left", "right"):
                label = [f"{case[0]}, {case[1]}", way, side]
                try:
                    plan = circumnavigate(driver, Request(OBSTACLE, CLEARANCE, case[4], side=side))
                    yield [*label, *lap(plan, made, case[1])]
                except RequestError as refusal:
                    yield [*label, f"refused: {refusal}", "", "", "", ""]


HEAD = (
    "robot, ground",
    "planned by",
    "turning",
    "end off by [m] (sigma)",
    "yaw off by [deg] (sigma)",
    "in sigmas",
    "kept off the obstacle [m]",
    "that 19 of 20 should keep [m]",
)
TEXT = (
    "# Laps round an obstacle",
    "",
    "Written by `make studies` (`benchmarks/plans.py`); nothing here is edited by hand.",
    "",
    f"One lap round {OBSTACLE.width:g} x {OBSTACLE.length:g} m with a clearance of {CLEARANCE:g} m, driven without",
    "feedback on the terramechanic plant. Each calibration is from two minutes of straights, arcs and turns on the",
    "spot on the same ground; the circles are ten, driven at about the speed of the lap. Sigma is what the plan tells.",
    "",
)
MEANING = (
    "",
    "A lap holds two operating points all the time. What a model is wrong by there does not change on the way, so that",
    "it adds up with the angle turned. Sigma holds that: the share of a turn that predictions are off by all through",
    "it is found on held-out windows (`regions.turning` of the calibration). What lasts of the way ahead is not told",
    "apart from noise: on loose gravel, where a constant ICR errs in the way rather than in the turn, an end may be",
    "further off than its sigma says. Circles about as wide and as fast as the arcs measure that very operating point;",
    "their sigma rests on an assumed noise.",
)


def main() -> None:
    lines = [*TEXT, f"| {' | '.join(HEAD)} |", f"|{'---|' * len(HEAD)}"]
    for row in rows():
        lines.append(f"| {' | '.join(row)} |")
        print(lines[-1], flush=True)
    DOCUMENT.write_text("\n".join([*lines, *MEANING]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
