"""Giannoccaro 2015, "Kinematic trajectories reconstruction", IJSSIS 8: Tables 1, 3, 4, 5 from Table 2."""

from __future__ import annotations

import numpy as np

from skidsteer.identify.circle_test import runs_on, side_result
from skidsteer.models.slip_ratio import CircleRun, Side
from skidsteer.reproduce.rows import Reproduction, Row, compared
from skidsteer.samples import ROVER_DRAGS, rover_runs
from skidsteer.vehicle import preset

TRACK_WIDTH = preset("rover-4wd1").track_width  # [m] as it follows from both rows of Table 3
TABLE_3: dict[tuple[str, Side], tuple[float, float]] = {  # x_ICR [m], chi
    ("indoor", "left"): (0.247, 0.567),
    ("indoor", "right"): (0.299, 0.468),
    ("outdoor", "left"): (0.407, 0.344),
    ("outdoor", "right"): (0.467, 0.300),
    ("football", "left"): (0.309, 0.453),
}
TABLE_5 = {  # K_s of 1L to 5L, 1R to 5R
    "indoor": (1.42, 1.83, 2.71, 2.54, 2.45, 1.45, 1.91, 2.75, 2.60, 2.54),
    "outdoor": (1.47, 2.07, 3.21, 2.97, 2.89, 1.48, 2.07, 3.21, 2.97, 2.89),
    "football": (1.42, 1.98, 3.41, 3.29, 3.44),
}
COPIED = ("3L", "4L", "5L")  # outdoors
TABLE_1 = {20: 191.0, 40: 410.0, 60: 632.0, 80: 957.0, 100: 1059.0, 120: 1249.0}  # command k -> rim speed [mm/s]
TOLERANCE = 0.05  # of K_s


def reproduction() -> Reproduction:
    """Everything that can be calculated."""
    return Reproduction(rows())


def rows() -> tuple[Row, ...]:
    """Every figure of the paper that can be checked by calculation."""
    return (*table_1_rows(), *table_3_rows(), *table_4_rows(), *table_5_rows(), _speed_row())


def table_1_rows() -> tuple[Row, ...]:
    """Rim speeds against the straight line that the text promises, through all other points."""
    k = [k for k in TABLE_1 if k != 80]
    ours = float(np.polyval(np.polyfit(k, [TABLE_1[i] for i in k], 1), 80))
    reason = "Fig. 5 is called perfectly linear; the other five points are so to 12 mm/s. Table 5 is calculated with it"
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
