"""Wang et al. 2015, "Analysis and Experimental Kinematics of a Skid-Steering Wheeled Robot", Sensors 15."""

from __future__ import annotations

import math

import numpy as np

from skidsteer.identify.circle_test import fit_coefficient, icr_error
from skidsteer.laser.plate import Sightings, find_plate
from skidsteer.laser.scans import SCANNERS
from skidsteer.laser.scene import simulate_scans
from skidsteer.models import Curvature
from skidsteer.models.curvature import icr_coefficient
from skidsteer.reproduce.rows import Place, Row, compared, stands_in

TRACK_WIDTH = 0.40  # [m] of the Pioneer P3-AT
PRINTED = (0.4728, 0.0538)  # a, b of Eq. (45)
TABLE_3 = (1.4662, 1.4480, 1.4394, 1.4341, 1.4215, 1.4232, 1.4165, 1.4115)  # chi at lambda 0, 1, ..., 7
SCATTER_3 = (0.0033, 0.0065, 0.0055, 0.0068, 0.0080, 0.0050, 0.0077, 0.0043)  # sigma of the five speeds
TABLE_4 = {"P3-AT": (0.0169, 0.0101, 0.0438), "proposed": (0.0273, 0.0119, 0.0778)}  # x [m], y [m], heading [rad]
PLATE_WIDTH = 0.290  # [m]
DISTANCES = (1.0, 3.0)  # [m] of the plate from the scanner, Eq. (40)
HALF_FIELD = 0.194 * np.pi  # [rad] largest heading of the plate, Eq. (35)
SCANS, SEED = 1000, 2015  # the paper does not say how many it took
COUNTS = 8192  # of an encoder for a revolution, section 3.2
PLACES = (
    Place("Table 1", "parameters of robot and ground", "numbers that go into Fig. 5, not results"),
    Place("Table 2", "measured width of the plate"),
    Place("Table 3", "chi of the runs at eight lambda"),
    Place("Table 4", "errors of dead reckoning on the example path"),
    Place("Fig. 1", "kinematics of the robot", "a drawing without figures"),
    Place("Fig. 2", "the equal differential drive", "a drawing without figures"),
    Place("Fig. 3", "forces and moments", "a drawing without figures"),
    Place("Fig. 4", "motion of a wheel's patch", "a drawing without figures"),
    Place("Fig. 5", "chi over lambda by the forces of the ground"),
    Place("Fig. 6", "the robot", "a photograph"),
    Place("Fig. 7", "scanner and plate", "a photograph"),
    Place("Fig. 8", "position and heading from the plate", "a drawing without figures"),
    Place("Fig. 9", "a run before the scanner", "a drawing without figures"),
    Place("Fig. 10", "measured width of the plate", "its mean, scatter and largest error are those of Table 2"),
    Place("Fig. 11", "position, heading and velocity in one run"),
    Place("Fig. 12", "chi over lambda and over speed"),
    Place("Fig. 13", "the fitted curve"),
    Place("Fig. 14", "the example path"),
    Place("Fig. 15", "errors on the example path"),
    Place("Fig. 16", "chi on the example path"),
)
NOTES = (
    "Eq. (21) has K_r with the left rear wheel, (20) has K_l with the left front one; K_l is meant, and Table 1 gives"
    " both the same value",
    "Eq. (23) adds the square of the same force twice; the forces of both directions are meant",
    "Eq. (41) prints the derivative by x twice; the second is the one by y, as the next term has it",
    "Eq. (44) has a cusp at lambda = 0: the square root rises there without bound, so that in a turn on the spot chi"
    " changes with the sum of the rim speeds at once. Our model rounds the root below 0.02 m/s",
    "Eq. (44) is given for lambda up to 10; the last second of the example path, Eq. (48), has 11",
    "the text calls a rising lambda a rising curvature; lambda is a radius",
    "Fig. 5 falls with lambda: the equations give a fall from the spot to a circle, by rolling resistance, and none"
    " after it. docs/ground.md tells what does: tyres that give way more easily sideways than lengthwise",
    "section 3.2 smooths the coordinates with a median, an edge and a mean filter and tells no width of any. Ours"
    " leaves out sightings far from the median of those around them and averages poses to 25 Hz; the scanner's own"
    " filters of ranges are in laser.scans, and no figure here uses them",
)


def rows() -> tuple[Row, ...]:
    """Every figure of the paper that can be checked by calculation."""
    laser = sightings()
    return (
        *_table_2_rows(laser),
        *_budget_rows(laser),
        *_fit_rows(),
        *_table_3_rows(),
        _error_row(),
        *_scanner_rows(),
        *_twist_rows(),
        *_table_4_rows(),
    )


def sightings() -> Sightings:
    """Simulated scans of the paper's plate by its scanner, evenly over the distances and headings it prints."""
    rng = np.random.default_rng(SEED)
    near, far = DISTANCES[0], DISTANCES[1] - 0.5 * PLATE_WIDTH  # beyond, a part of it is out of reach
    distance, heading = rng.uniform(near, far, SCANS), rng.uniform(-HALF_FIELD, HALF_FIELD, SCANS)
    bearing = np.radians(rng.uniform(-24.0, 24.0, SCANS))  # the whole plate in the field at the least distance
    place = distance * np.stack([np.cos(bearing), np.sin(bearing)])
    poses = np.column_stack([*place, 0.5 * np.pi + heading])  # the paper's scanner looks along its y axis
    return find_plate(simulate_scans(SCANNERS["lms400"], [(poses, PLATE_WIDTH)], seed=SEED), PLATE_WIDTH)


def _table_2_rows(laser: Sightings) -> tuple[Row, ...]:
    error = laser.chord - PLATE_WIDTH
    why = (
        "a chord between the outer rays that hit, Eq. (29), falls short by a spacing of rays:"
        f" {_spacing_mm(0.7):.1f} mm at 0.7 m, the least that the scanner sees, {_spacing_mm(3.0):.1f} mm at 3 m;"
        " between edges half a step beyond these rays, on the fitted line, the same scans give"
        f" {laser.width.mean():.4f} with a standard deviation of {laser.width.std(ddof=1):.4f}"
    )
    places = f"of {len(error)} simulated scans; it grows with slant and distance, and the paper does not print its own"
    largest = float(error[np.abs(error).argmax()])
    sigma = float(error.std(ddof=1))
    return (
        stands_in("mean of the measured width [m], Table 2", 0.289, float(laser.chord.mean()), why),
        stands_in("standard deviation of the width [m], Table 2", 0.003, sigma, "simulated at 1 to 3 m, +- 35 deg"),
        stands_in("largest error of the width [m], Table 2", -0.01, largest, places),
    )


def _spacing_mm(distance: float) -> float:
    return 1e3 * distance * SCANNERS["lms400"].step


def _budget_rows(laser: Sightings) -> tuple[Row, ...]:
    """The bounds of Eqs. (37)-(41), which add largest errors, each from the printed figures before it."""
    near, far = DISTANCES
    static = 0.003 + far * SCANNERS["lms400"].step  # Eq. (37): errors of range and bearing
    moved = 0.7 * (1.0 / 135.0)  # Eq. (38): way in the time of a scan
    bearing, through = (math.sqrt(2.0) * error / near for error in (0.013, static + moved))  # Eq. (41)
    line = np.sqrt(laser.covariance[:, 2, 2])
    return (
        compared("error of a point at rest [m], Eq. (37)", 0.008, static, 5e-4, "at 3 m"),
        compared(
            "error of a point by motion [m], Eq. (38)",
            0.005,
            moved,
            5e-4,
            f"at 135 Hz; at the 3.7 ms between scans of section 3.2 it is {0.7 * 0.0037:.4f}",
        ),
        compared("error of a point [m], Eq. (39)", 0.013, static + moved, 5e-4, "the sum, not rounded before"),
        compared(
            "error of the heading [rad], Eq. (41)",
            0.018,
            bearing,
            5e-4,
            f"bearing of one point at 1 m ({through:.4f} without rounding before); the line through the plate has a"
            f" standard deviation of {line.min():.4f} to {line.max():.4f} in the simulated scans",
        ),
    )


def _fit_rows() -> tuple[Row, ...]:
    fit = fit_coefficient(np.arange(8), TABLE_3)
    rms = float(np.sqrt(np.mean((icr_coefficient(np.arange(8), *PRINTED) - TABLE_3) ** 2)))
    reason = (
        "the paper fits 10 sets up to lambda = 10, its table stops at 7:"
        f" the printed pair leaves {rms:.4f} RMS, ours {fit.rms:.4f}"
    )
    return (
        Row("a of Eq. (44) from Table 3", PRINTED[0], fit.a, "cannot be reproduced", reason),
        Row("b of Eq. (44) from Table 3", PRINTED[1], fit.b, "cannot be reproduced", reason),
    )


def _table_3_rows() -> tuple[Row, ...]:
    ours = icr_coefficient(np.arange(8), *PRINTED).tolist()
    places = zip(range(8), TABLE_3, ours, SCATTER_3, strict=True)
    why = "the printed a and b, to within two of the printed standard deviations"
    return tuple(
        compared(f"chi at lambda = {x}, Table 3", mean, chi, 2.0 * sigma, why) for x, mean, chi, sigma in places
    )


def _error_row() -> Row:
    angle = 0.25 * np.pi  # Eq. (40)
    rolled = (0.0, 2.0 * angle * 0.5 * TRACK_WIDTH * TABLE_3[0])
    ours = icr_error(rolled, angle, (0.00026, 0.00020), 0.018)
    return compared("error of y0 [m], Eq. (43)", 0.007, ours, 5e-4, "on the spot, by pi / 4")


def _scanner_rows() -> tuple[Row, ...]:
    """Numbers of section 3.2 and claims on Table 3."""
    relative = (0.34, 0.59, 0.62, 0.71, 0.92, 0.52, 0.77, 0.30)  # [%] Table 3
    return (
        compared("angle of a count [deg], section 3.2", 0.0439, 360.0 / COUNTS, 1e-4, f"{COUNTS} counts"),
        compared("half field of view over pi, Eq. (35)", 0.194, 35.0 / 180.0, 1e-3, "70 deg"),
        compared("largest relative error below 1 %, Table 3", 1.0, max(relative), 0.1, "0.92 % at lambda = 4"),
        compared("largest sigma not above 0.01, Table 3", 0.01, max(SCATTER_3), 0.0021, "0.0080 at lambda = 4"),
    )


def _twist_rows() -> tuple[Row, ...]:
    """One input of Eq. (48) through Eq. (47) as printed and as it follows from Eqs. (11), (15)."""
    omega = float(Curvature(*PRINTED, 1.0, TRACK_WIDTH).twist(0.1, 0.3)[2])
    chi = float(icr_coefficient(2.0, *PRINTED))
    reason = "Eqs. (46), (47) print 2 B chi; by Eqs. (11), (15) 2 y0 is B chi"
    return (
        Row("omega of 0.1 and 0.3 m/s [rad/s], Eq. (47)", 0.2 / (2.0 * TRACK_WIDTH * chi), omega, "corrected", reason),
    )


def _table_4_rows() -> tuple[Row, ...]:
    reason = "text and Fig. 15 give the proposed model the smaller errors: the rows of Table 4 are swapped"
    axes = ("x [m]", "y [m]", "heading [rad]")
    return tuple(
        Row(f"error of the proposed model, {axis}, Table 4", printed, other, "corrected", reason)
        for axis, printed, other in zip(axes, TABLE_4["proposed"], TABLE_4["P3-AT"], strict=True)
    )
