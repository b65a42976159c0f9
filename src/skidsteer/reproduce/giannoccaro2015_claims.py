"""Claims in the text of Giannoccaro 2015 on its tables, counted, and its equations, tested."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from skidsteer.reproduce.figure import Curve, Figure
from skidsteer.reproduce.rows import Place, Row, compared
from skidsteer.samples import ROVER_DRAGS, ROVER_PAIRS, ROVER_RADII
from skidsteer.vehicle import preset

RIM = preset("rover-4wd1").wheel_radius  # [m]
CALIBRATION = {5: (0.33, 0.02), 125: (21.67, 1.3)}  # k -> [rad/s], [m/s] in the text
DIFFERENCES = (222.0, 547.0, 766.0, 868.0, 1058.0)  # [mm/s] Table 1
TABLE_5 = {  # K_s of 1L to 5L, 1R to 5R
    "indoor": (1.42, 1.83, 2.71, 2.54, 2.45, 1.45, 1.91, 2.75, 2.60, 2.54),
    "outdoor": (1.47, 2.07, 3.21, 2.97, 2.89, 1.48, 2.07, 3.21, 2.97, 2.89),
    "football": (1.42, 1.98, 3.41, 3.29, 3.44),
}
SETTLED = {"indoor": 2.5, "outdoor": 3.0, "football": 3.5}  # what K_s settles to, in the text
PLACES = (
    Place("Table 1", "integers k and rim speeds of the runs"),
    Place("Table 2", "measured radii: what Tables 3 and 5 are calculated from"),
    Place("Table 3", "equivalent carriageway and slippage index"),
    Place("Table 4", "slip of the inner side"),
    Place("Table 5", "slipping ratio K_s"),
    Place("Fig. 1", "ICRs of vehicle and tracks", "a drawing without figures"),
    Place("Fig. 2", "the equivalent carriageway", "a drawing without figures"),
    Place("Fig. 3", "the robot", "a photograph"),
    Place("Fig. 4", "radius of curvature from a chord"),
    Place("Fig. 5", "angular speed by k; its points are not printed"),
    Place("Fig. 6", "runs indoors and outdoors", "photographs"),
    Place("Fig. 7", "runs on synthetic grass", "named in the text; it is Fig. 6 c, a photograph"),
    Place("Fig. 8", "repetitions of the runs indoors", "the single radii are not printed"),
    Place("Fig. 9", "radii on three surfaces"),
    Place("Fig. 10", "obstacle and course"),
    Place("Fig. 11", "ends of five laps"),
)
NOTES = (
    "Eqs. (3), (4) have a minus that Mandow's (3), (4), which they cite, do not have: a track that stands still has its"
    " ICR where the vehicle's own point does, at -v_y / omega, as in (2)",
    "Eq. (7), second row, prints x_ICRv and x_ICRl for x_ICRr and -x_ICRl; with those (8) follows",
    "K_s of Table 5 is said to come from Eq. (14), which needs the slip of the outer side; that is not printed. By"
    " Eq. (15) it follows from Tables 1 and 2",
)


def rows() -> tuple[Row, ...]:
    """Claims that can be counted or calculated."""
    return (*_command_rows(), *_radius_rows(), *_slip_rows(), *_settled_rows(), _chord_row())


def _command_rows() -> tuple[Row, ...]:
    speeds = [1e3 * (outer - inner) for inner, outer in ROVER_PAIRS]
    steps = np.diff(DIFFERENCES)
    reason = (
        "'a constant step of the increase of the difference of the velocities': constant are the steps of k, 20; those"
        f" of the speeds are {', '.join(f'{step:.0f}' for step in steps)} mm/s, uneven by the speed printed for k = 80"
    )
    ends = tuple(
        compared(f"rim speed at k = {k} [m/s], Fig. 5", speed, rate * RIM, 0.005, f"{rate} rad/s times {RIM} m")
        for k, (rate, speed) in CALIBRATION.items()
    )
    differences = tuple(
        compared(f"difference of speeds of {i + 1}L [mm/s], Table 1", printed, ours, 0.5)
        for i, (printed, ours) in enumerate(zip(DIFFERENCES, speeds, strict=True))
    )
    ratio = float(steps.max() / steps.min())
    uneven = Row("largest over smallest step of the differences, Table 1", 1.0, ratio, "cannot be reproduced", reason)
    return (*ends, *differences, uneven)


def _radius_rows() -> tuple[Row, ...]:
    indoor, outdoor, turf = (np.array(ROVER_RADII[surface]) for surface in ("indoor", "outdoor", "football"))
    least = int((indoor < outdoor).sum() + (indoor[:5] < turf).sum())
    left = [int((radii[:5] < radii[5:]).sum()) for radii in (indoor, outdoor)]
    tighter = [f"{i + 1}" for i in range(5) if outdoor[i] >= outdoor[i + 5]]
    reason = (
        "'the minor slipping of the sets 1L-5L in both the surfaces': outdoors the left turns of the sets"
        f" {', '.join(tighter)} are the wider ones"
    )
    what = "sets with the smaller radius to the left"
    return (
        compared("comparisons in which the radius is smaller indoors, Table 2", 15.0, float(least), 0.0),
        compared(f"{what}, indoors, Table 2", 5.0, float(left[0]), 0.0),
        Row(f"{what}, outdoors, Table 2", 5.0, float(left[1]), "cannot be reproduced", reason),
    )


def _slip_rows() -> tuple[Row, ...]:
    series = [part for drags in ROVER_DRAGS.values() for part in (drags[:5], drags[5:]) if part]
    rising = sum(int((np.diff(part) > 0.0).sum()) for part in series)
    steps = sum(len(part) - 1 for part in series)
    turf, indoor = np.array(ROVER_DRAGS["football"]), np.array(ROVER_DRAGS["indoor"][:5])
    lowest = [f"{i + 1}L" for i in range(5) if turf[i] >= indoor[i]]
    return (
        Row(
            "steps from set to set in which the slip rises, Table 4",
            float(steps),
            float(rising),
            "cannot be reproduced",
            "'in all the cases the percentage slipping increases with the velocity difference': it falls to"
            f" {_falls(series)}",
        ),
        Row(
            "sets with less slip on the football pitch than indoors, Table 4",
            5.0,
            float(5 - len(lowest)),
            "cannot be reproduced",
            f"'the slipping on the football pitch seem to be the lowest': not in {', '.join(lowest)}",
        ),
    )


def _falls(series: Sequence[Sequence[float]]) -> str:
    falls = [
        f"{part[i + 1]:g} % after {part[i]:g} %"
        for part in series
        for i in range(len(part) - 1)
        if part[i + 1] <= part[i]
    ]
    return ", ".join(falls)


def _settled_rows() -> tuple[Row, ...]:
    """K_s of the sets 3 to 5, to which the ratio is said to settle, against Table 5's means."""
    found = []
    for surface, settled in SETTLED.items():
        ratios = TABLE_5[surface]
        mean = float(np.mean([*ratios[2:5], *ratios[7:10]]))
        found.append(
            compared(f"K_s that it settles to, {surface}, Table 5", settled, mean, 0.15, "mean of the sets 3 to 5")
        )
    return tuple(found)


def _chord_row() -> Row:
    """Eq. (16) on an arc that is known."""
    radius, angle = 1.0, 0.5
    chord, across = 2.0 * radius * math.sin(0.5 * angle), radius * (1.0 - math.cos(angle))
    sagitta = radius * (1.0 - math.cos(0.5 * angle))
    reason = (
        "l is the chord from the point whose heading is the Y axis, x its part across that axis, by Eq. (17); taken as"
        f" chord and sagitta of the arc, Eq. (16) would give {chord**2 / (2.0 * sagitta):.2f} m"
    )
    what = f"R [m] of an arc of {radius:g} m and {angle:g} rad by Eq. (16), Fig. 4"
    return compared(what, radius, chord**2 / (2.0 * across), 1e-9, reason)


def radius_figure() -> Figure:
    """Fig. 9 from Tables 1 and 2."""
    apart = np.array([outer - inner for inner, outer in ROVER_PAIRS])
    curves = tuple(Curve(surface, apart, 1e-3 * np.array(radii[:5])) for surface, radii in ROVER_RADII.items())
    return Figure("figure-9", "Radii of the sets 1L to 5L, Table 2", "difference of rim speeds [m/s]", "R [m]", curves)
