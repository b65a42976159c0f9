"""Giannoccaro 2015, "Kinematic trajectories reconstruction", IJSSIS 8: Tables 1, 3, 4, 5 from Table 2; section V."""

from __future__ import annotations

import numpy as np

from skidsteer.identify.circle_test import runs_on, side_result
from skidsteer.models.slip_ratio import CircleRun, Side, slip_ratio
from skidsteer.plan.circumnavigation import Plan, circumnavigate
from skidsteer.plan.driver import Driver
from skidsteer.plan.slip_table import SlipTable
from skidsteer.reproduce import giannoccaro2015_claims as claims
from skidsteer.reproduce.figure import Curve, Figure
from skidsteer.reproduce.giannoccaro2015_claims import TABLE_5
from skidsteer.reproduce.rover_course import CODE, FLOORS, RADIUS, TURN, WAYS, laps, paper_request
from skidsteer.reproduce.rows import Reproduction, Row, compared, stands_in
from skidsteer.samples import ROVER_DRAGS, rover_runs
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import preset

TRACK_WIDTH = preset("rover-4wd1").track_width  # [m] as it follows from both rows of Table 3
TABLE_3: dict[tuple[str, Side], tuple[float, float]] = {  # x_ICR [m], chi
    ("indoor", "left"): (0.247, 0.567),
    ("indoor", "right"): (0.299, 0.468),
    ("outdoor", "left"): (0.407, 0.344),
    ("outdoor", "right"): (0.467, 0.300),
    ("football", "left"): (0.309, 0.453),
}
COPIED = ("3L", "4L", "5L")  # outdoors
TABLE_1 = {20: 191.0, 40: 410.0, 60: 632.0, 80: 957.0, 100: 1059.0, 120: 1249.0}  # command k -> rim speed [mm/s]
TOLERANCE = 0.05  # of K_s
PLAN_K = (26, 65)  # of the inner and the outer side on the arcs of section V


HOW = {"slip ratio": "the slips of circles about as wide", "ICR model": "one ICR distance for all of them"}


def reproduction() -> Reproduction:
    """Everything, calculated and simulated."""
    figures = (claims.radius_figure(), laps_figure())
    return Reproduction((*rows(), *claims.rows(), *driven_rows()), figures, (), claims.PLACES, claims.NOTES)


def rows() -> tuple[Row, ...]:
    """Every figure of the paper that can be checked by calculation."""
    return (*table_1_rows(), *table_3_rows(), *table_4_rows(), *table_5_rows(), _speed_row(), *plan_rows())


def table_1_rows() -> tuple[Row, ...]:
    """Rim speeds against the straight line that the text promises, through all other points."""
    k = [k for k in TABLE_1 if k != 80]
    ours = float(np.polyval(np.polyfit(k, [TABLE_1[i] for i in k], 1), 80))
    between = float(np.interp(80, list(claims.CALIBRATION), [1e3 * speed for _, speed in claims.CALIBRATION.values()]))
    reason = (
        f"Fig. 5 is called perfectly linear, and its ends give {between:.0f}; the other five points are so to 12 mm/s."
        " Table 5 is calculated with it"
    )
    return (Row("rim speed at k = 80 [mm/s], Table 1", TABLE_1[80], ours, "cannot be reproduced", reason),)


def table_3_rows() -> tuple[Row, ...]:
    """x_ICR by least squares on Eq. (12) over Table 2, and chi, which follows from the printed x_ICR."""
    found = []
    for (surface, side), (x_icr, chi) in TABLE_3.items():
        runs = runs_on(rover_runs(), surface, side)
        every, tight = side_result(runs, TRACK_WIDTH).icr_y, side_result(runs[2:], TRACK_WIDTH).icr_y
        single = [run.icr_y for run in runs]
        reason = (
            f"runs 3 to 5 alone give {tight:.3f}; R / lambda falls from {max(single):.3f} to {min(single):.3f} m:"
            " no constant x_ICR describes these runs"
        )
        place = f"{surface}, {side} turns, Table 3"
        found.append(Row(f"x_ICR [m] of Table 2 {place}", x_icr, every, "cannot be reproduced", reason))
        found.append(compared(f"chi {place}", chi, TRACK_WIDTH / (2.0 * x_icr), 0.001, "Eq. (11) of the printed x_ICR"))
    return tuple(found)


def table_4_rows() -> tuple[Row, ...]:
    """Slip of the inner side where the printed sign cannot be."""
    at = runs_on(rover_runs(), "outdoor")[3]
    slips = at.slip_coefficients(TRACK_WIDTH)
    ours = 100.0 * slips[0] if slips and slips[0] is not None else float("nan")
    reason = (
        f"a wheel that slips by 100 % makes no way, but the circle has {at.radius} m: the table prints the magnitude of"
        " a dragged wheel's slip, here and in all rows (K_s above 1 needs i_i below i_o)"
    )
    printed = ROVER_DRAGS["outdoor"][3]
    return (Row("slip of the inner side, 4L outdoors [%], Table 4", printed, ours, "corrected", reason),)


def table_5_rows() -> tuple[Row, ...]:
    """K_s of every run by Eq. (15) from Table 2."""
    return tuple(
        _ratio_row(run, printed)
        for surface, ratios in TABLE_5.items()
        for run, printed in zip(runs_on(rover_runs(), surface), ratios, strict=True)
    )


def _ratio_row(run: CircleRun, printed: float) -> Row:
    what = f"K_s {run.surface} {run.name}, Table 5"
    ours = run.slip_ratio(TRACK_WIDTH) or 0.0
    if run.surface == "outdoor" and run.name in COPIED:
        return Row(what, printed, ours, "corrected", f"repeats the value of {run.name[0]}R")
    return compared(what, printed, ours, TOLERANCE, "Eq. (15) from Tables 1 and 2, B = 0.28 m")


def _speed_row() -> Row:
    radius = preset("rover-4wd1").wheel_radius
    reason = f"10.5 rad/s times the diameter; the radius is {radius} m, and Table 1 has {TABLE_1[60]:.0f} mm/s"
    return Row("linear velocity at k = 60 [m/s], section V", 1.26, 10.5 * radius, "corrected", reason)


# Section V


def indoor_plan() -> Plan:
    """The course of Fig. 10 by the indoor runs as printed."""
    table = SlipTable(runs_on(rover_runs(), "indoor"), TRACK_WIDTH)
    return circumnavigate(Driver.of_circles(table, preset("rover-4wd1")), paper_request())


def plan_rows() -> tuple[Row, ...]:
    """Length and integers of the course of section V."""
    straight, arc = indoor_plan().stretches[:2]
    length = 200.0 * (straight.amount + arc.amount * RADIUS)
    straight_k, (inner, outer) = straight.k or (0, 0), arc.k or (0, 0)
    why = _integers()
    return (
        compared("length of the course [cm], Fig. 10", 815.48, length, 0.01),
        compared("k on the straights, section V", 60, straight_k[0], 1.0, "to one step: 0.63 m/s is k = 60.6"),
        Row("k of the outer side on the arcs, section V", PLAN_K[1], outer, "cannot be reproduced", why),
        Row("k of the inner side on the arcs, section V", PLAN_K[0], inner, "cannot be reproduced", why),
    )


def _integers() -> str:
    """What the printed integers of the arcs would mean."""
    inner, outer = CODE.speeds(PLAN_K).tolist()
    ratio = float(slip_ratio(outer, inner, RADIUS, TRACK_WIDTH))
    slip = 1.0 - TURN * (RADIUS + 0.5 * TRACK_WIDTH) / outer
    second, third = (run.slip_ratio(TRACK_WIDTH) or 0.0 for run in runs_on(rover_runs(), "indoor")[1:3])
    slips = [s[1] for run in runs_on(rover_runs(), "indoor")[1:3] if (s := run.slip_coefficients(TRACK_WIDTH))]
    return (
        f"{PLAN_K[1]} and {PLAN_K[0]} on an arc of {RADIUS:g} m mean K_s = {ratio:.2f} by Eq. (15), and at {TURN:g}"
        f" rad/s an outer slip of {slip:.2f}; ours are interpolated between 2L and 3L, K_s {second:.2f} and"
        f" {third:.2f}, outer slips {slips[0]:.2f} and {slips[1]:.2f} by Tables 2, 4 and 5; which ones were taken is"
        " not said"
    )


def driven_rows() -> tuple[Row, ...]:
    """Ends of laps of simulated rovers, each calibrated by circles on its own floor."""
    return tuple(_lap_row(name, way) for name in FLOORS for way in WAYS)


def _lap_row(name: str, way: str) -> Row:
    done = laps(name, way)
    errors, integers = done.errors, sorted({plan.stretches[1].k or (0, 0) for plan in done.plans})
    clear = min(float(np.min(plan.gaps)) for plan in done.plans)
    words = ", ".join(f"{outer} and {inner}" for inner, outer in integers)
    reason = (
        f'"a few centimetres" in five laps; ours end {errors.min():.3f} to {errors.max():.3f} m off, with k = {words}'
        f" on the arcs, each planned from ten circles on the same floor by {HOW[way]}; {clear:.2f} m off the"
        " obstacle"
    )
    what = f"mean end error [m] of laps planned by {way}, {name} plant, Fig. 11"
    return stands_in(what, float("nan"), float(errors.mean()), reason)


def laps_figure() -> Figure:
    """Counterpart of Fig. 11 a)."""
    planned = laps("terramechanic", "slip ratio").plans[0]
    lines = {"planned": planned.expected.path.values, "obstacle": _outline(planned)}
    lines |= {f"{name} plant, by {way}": laps(name, way).paths[0] for name in FLOORS for way in WAYS}
    curves = tuple(Curve(label, line[:, 0], line[:, 1]) for label, line in lines.items())
    return Figure("figure-11", "Laps of simulated rovers", "x [m]", "y [m]", curves, to_scale=True)


def _outline(plan: Plan) -> FloatArray:
    corners = plan.obstacle.at(plan.place)
    return np.concatenate([corners, corners[:1]])
