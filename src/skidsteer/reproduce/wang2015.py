"""Wang et al. 2015, "Analysis and Experimental Kinematics of a Skid-Steering Wheeled Robot", Sensors 15."""

from __future__ import annotations

import numpy as np

from skidsteer.identify.circle_test import fit_coefficient, icr_error
from skidsteer.models import Curvature
from skidsteer.models.curvature import icr_coefficient
from skidsteer.reproduce.rows import Row, compared

TRACK_WIDTH = 0.40  # [m] of the Pioneer P3-AT
PRINTED = (0.4728, 0.0538)  # a, b of Eq. (45)
TABLE_3 = (1.4662, 1.4480, 1.4394, 1.4341, 1.4215, 1.4232, 1.4165, 1.4115)  # chi at lambda 0, 1, ..., 7
SCATTER_3 = (0.0033, 0.0065, 0.0055, 0.0068, 0.0080, 0.0050, 0.0077, 0.0043)  # sigma of the five speeds
TABLE_4 = {"P3-AT": (0.0169, 0.0101, 0.0438), "proposed": (0.0273, 0.0119, 0.0778)}  # x [m], y [m], heading [rad]


def rows() -> tuple[Row, ...]:
    """Every figure of the paper that can be checked by calculation."""
    return (*_fit_rows(), *_table_3_rows(), _error_row(), *_twist_rows(), *_table_4_rows())


def _fit_rows() -> tuple[Row, ...]:
    fit = fit_coefficient(np.arange(8), TABLE_3)
    rms = float(np.sqrt(np.mean((icr_coefficient(np.arange(8), *PRINTED) - TABLE_3) ** 2)))
    reason = (
        "the paper fits 10 sets up to lambda = 10, its table stops at 7:"
        f" the printed pair leaves {rms:.4f} RMS, ours {fit.rms:.4f}"
    )
    return (
        Row("a of Eq. (44) from Table 3", PRINTED[0], fit.a, "not reproducible", reason),
        Row("b of Eq. (44) from Table 3", PRINTED[1], fit.b, "not reproducible", reason),
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


def _twist_rows() -> tuple[Row, ...]:
    """One input of Eq. (48) through Eq. (47) as printed and as it follows from Eqs. (11), (15)."""
    omega = float(Curvature(*PRINTED, 1.0, TRACK_WIDTH).twist(0.1, 0.3)[2])
    chi = float(icr_coefficient(2.0, *PRINTED))
    reason = "Eqs. (46), (47) print 2 B chi; by Eqs. (11), (15) 2 y0 is B chi"
    return (
        Row("omega of 0.1 and 0.3 m/s [rad/s], Eq. (47)", 0.2 / (2.0 * TRACK_WIDTH * chi), omega, "misprint", reason),
    )


def _table_4_rows() -> tuple[Row, ...]:
    reason = "text and Fig. 15 give the proposed model the smaller errors: the rows of Table 4 are swapped"
    axes = ("x [m]", "y [m]", "heading [rad]")
    return tuple(
        Row(f"error of the proposed model, {axis}, Table 4", printed, other, "misprint", reason)
        for axis, printed, other in zip(axes, TABLE_4["proposed"], TABLE_4["P3-AT"], strict=True)
    )
