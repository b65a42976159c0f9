"""What Mandow 2007 prints, and what follows from it by calculation: indexes, claims, integers of the P3-AT, sums."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from skidsteer.identify.turn_test import straight_test, turn_test
from skidsteer.models import Icr, SymmetricIcr
from skidsteer.p3at import printed_ticksmm, revcount, ticksmm
from skidsteer.reproduce.rows import Place, Row, compared
from skidsteer.vehicle import preset

P3AT = preset("pioneer-p3at")
DEFAULT, SYMMETRIC, ASYMMETRIC = "default", "symmetric", "asymmetric"
TYRES = ("50 psi", "20 psi", "solid")
Column = tuple[float, float, float, float, float, float, float]
NAMES = ("y_ICRv [m]", "x_ICRr [m]", "x_ICRl [m]", "alpha_r", "alpha_l", "chi", "e")
TABLES: dict[str, tuple[Column, Column, Column]] = {  # of NAMES, in Mandow's frame: y forward, x to the right
    "Table I": (
        (-0.0080, 0.2998, -0.2758, 0.9253, 0.9464, 0.6949, 0.0417),
        (-0.0120, 0.3071, -0.2553, 0.9049, 0.9271, 0.7112, 0.0921),
        (-0.0120, 0.2588, -0.2667, 0.9128, 0.9047, 0.7612, -0.0150),
    ),
    "Table II": (
        (-0.0159, 0.2758, -0.2878, 0.9418, 0.9457, 0.7098, -0.0213),
        (-0.0128, 0.2899, -0.2772, 0.9183, 0.9222, 0.7053, 0.0224),
        (-0.0139, 0.2703, -0.2659, 0.9139, 0.9047, 0.7460, 0.0082),
    ),
}
GROUND = {"Table I": "asphalt", "Table II": "concrete"}
TABLE_3 = {  # mean squared errors: x [m^2], y [m^2], heading [rad^2], J
    ASYMMETRIC: (0.00010, 0.00011, 0.0359, 0.0361),
    DEFAULT: (0.00183, 0.00468, 0.0359, 0.0424),
    SYMMETRIC: (0.00162, 0.00455, 0.0359, 0.0421),
}
ERRORS = ("x [m^2]", "y [m^2]", "heading [rad^2]", "J")
FACTORY = SymmetricIcr(0.3, 1.0)  # section IV.B
PRINTED_SYMMETRIC = SymmetricIcr(0.275, 0.91)  # by Eqs. (11), (12), section IV.D
PLACES = (
    Place("Table I", "parameters and indexes on asphalt, three kinds of tyres"),
    Place("Table II", "the same on smooth concrete"),
    Place("Table III", "mean squared errors of three models on the validation path"),
    Place("Fig. 1", "treads of wheels and tracks", "a drawing without figures"),
    Place("Fig. 2", "ICRs of vehicle and treads", "a drawing without figures"),
    Place("Fig. 3", "the equivalent differential drive", "a drawing without figures"),
    Place("Fig. 4", "the two kinds of tyres", "a photograph"),
    Place("Fig. 5", "robot and GPS base", "a photograph"),
    Place("Fig. 6", "the validation path by three models and GPS"),
)
NOTES = (
    "Eq. (11) lacks the alpha that Eq. (8) has: where alpha is not 1, the two together do not give back the turn that"
    " was measured. Mandow's own 0.275 m is of the form with alpha",
    "Eq. (13) adds square metres to square radians; neighbouring segments share a noisy position, so that their errors"
    " are not independent",
    "an antenna at (l_x, l_y) on the robot sees icr_x - l_x and the middle of the tread ICRs - l_y: 'y_ICRv is always"
    " about 1 cm behind' holds for the antenna's own place",
)


def model_of(column: Column) -> Icr:
    """A column of Table I or II in our frame, x forward, y left."""
    y, right, left, alpha_right, alpha_left = column[:5]
    return Icr(-left, -right, y, alpha_left, alpha_right)


ASPHALT_20 = model_of(TABLES["Table I"][1])  # of Table III and Fig. 6


def rows() -> tuple[Row, ...]:
    """Everything that needs no drive."""
    return (*index_rows(), *claim_rows(), *test_rows(), *integer_rows(), *sum_rows())


def index_rows() -> tuple[Row, ...]:
    """Eqs. (9), (10) of the printed ICRs."""
    return tuple(
        compared(f"{name} {GROUND[table]}, {tyre}, {table}", printed, ours, 1e-4, "Eqs. (9), (10) of its ICRs")
        for table, tyre, column in columns()
        for name, printed, ours in zip(NAMES[5:], column[5:], _indexes(column), strict=True)
    )


def columns() -> Iterator[tuple[str, str, Column]]:
    """Table, kind of tyres and printed column, all six."""
    return (
        (table, tyre, column) for table, columns in TABLES.items() for tyre, column in zip(TYRES, columns, strict=True)
    )


def _indexes(column: Column) -> tuple[float, float]:
    model = model_of(column)
    return model.steering_efficiency(P3AT.track_width), model.eccentricity()


def claim_rows() -> tuple[Row, ...]:
    """What the text reads from the tables, counted."""
    asphalt, concrete = (np.array(TABLES[table]) for table in TABLES)
    both = np.concatenate([asphalt, concrete])
    less = [tyre for tyre, on, other in zip(TYRES, asphalt[:, 5], concrete[:, 5], strict=True) if on < other]
    solid = sum(table[2, 5] > table[:2, 5].max() for table in (asphalt, concrete))
    closer = int(sum((np.abs(t[0, 3:5] - 1.0) < np.abs(t[1, 3:5] - 1.0)).sum() for t in (asphalt, concrete)))
    return (
        Row(
            "kinds of tyres with a lower chi on asphalt than on concrete, Tables I and II",
            3.0,
            float(len(less)),
            "cannot be reproduced",
            f"'lower steering efficiency' on asphalt holds for {', '.join(less)} only: with the other tyres the tables"
            " have the higher chi on asphalt",
        ),
        compared("grounds on which solid tyres have the highest chi, Tables I and II", 2.0, float(solid), 0.0),
        compared("alphas closer to 1 at 50 than at 20 psi, Tables I and II", 4.0, float(closer), 0.0),
        compared("mean y_ICRv [m], Tables I and II", -0.01, float(both[:, 0].mean()), 0.005, "'about 1 cm behind'"),
        compared("largest |e|, Tables I and II", 0.0, float(np.abs(both[:, 6]).max()), 0.1, "'very close to zero'"),
    )


def test_rows() -> tuple[Row, ...]:
    """Eqs. (11), (12) of one turn on the spot and one straight run by the printed Table I."""
    turn, run = (ASPHALT_20.twist(left, 0.3) for left in (-0.3, 0.3))
    alpha = float(straight_test([0.3, 0.3], run[0]))
    why = (
        "'paper' is Eq. (11) as printed, 'ours' the same times alpha, which Eq. (8) needs: half the distance of the"
        f" printed ICRs is {0.5 * (ASPHALT_20.icr_y_left - ASPHALT_20.icr_y_right):.4f} m, and the paper's own 0.275 m"
        " is near it"
    )
    printed, corrected = (float(turn_test([-0.3, 0.3], turn[2], factor)) for factor in (1.0, alpha))
    place = "truth: Table I, 20 psi"
    return (
        Row(f"x_ICR [m] of a turn on the spot by Eq. (11), {place}", printed, corrected, "corrected", why),
        compared(f"alpha of a straight run by Eq. (12), {place}", 0.91, alpha, 0.01, "printed for it: 0.91"),
        compared("x_ICR [m] of a robot that does not slip", 0.2, 0.5 * P3AT.track_width, 1e-9, "half of L"),
    )


def integer_rows() -> tuple[Row, ...]:
    """Ticksmm and Revcount, Eqs. (14), (15), of the symmetric model of section IV.D."""
    alpha, icr_y = PRINTED_SYMMETRIC.alpha, PRINTED_SYMMETRIC.icr_y
    printed, right = printed_ticksmm(alpha), ticksmm(alpha)
    upside_down = (
        "'paper' is the value of the equation as printed: Ticksmm is ticks for a millimetre, so that a wheel that makes"
        f" more way for a tick needs fewer; as printed the robot reports {138 / printed:.2f} of the nominal way where"
        f" it makes {alpha:g}"
    )
    rolled = 2.0 * math.pi * 1e3 * icr_y / alpha * 138.0 / 8.0  # ticks / 8 that a turn takes, by Eq. (8)
    follows = f"'paper' takes Ticksmm as printed; by Eq. (8) a whole turn takes {rolled:.1f} times 8 ticks"
    return (
        compared("Ticksmm of alpha = 1, r = 110 mm, Eq. (14)", 138.0, float(ticksmm(1.0)), 0.0, "the factory's"),
        Row("Ticksmm of alpha = 0.91, r = 110 mm, Eq. (14)", float(printed), float(right), "corrected", upside_down),
        Row(
            "Ticksmm of alpha = 1, r = 95 mm, Eq. (14)",
            float(printed_ticksmm(1.0, 0.095)),
            float(ticksmm(1.0, 0.095)),
            "corrected",
            "'paper' is the value of the equation as printed; the solid tyres are smaller and make more ticks",
        ),
        Row(
            "Revcount of alpha = 0.91, x_ICR = 0.275 m, Eqs. (14), (15)",
            float(revcount(icr_y, printed)),
            float(revcount(icr_y, right)),
            "corrected",
            f"{follows}; x_ICR has to be put in in mm",
        ),
    )


def sum_rows() -> tuple[Row, ...]:
    """J is the sum of the three squares, Eq. (13)."""
    return tuple(
        compared(f"J of the {name} model, Table III", values[3], sum(values[:3]), 1e-4, "the sum of its three errors")
        for name, values in TABLE_3.items()
    )
