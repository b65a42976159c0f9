"""Motions that every user knows, and what a model's parameters do to them: a straight, turns on the spot, curves."""

from __future__ import annotations

import numpy as np

from skidsteer.calibration import MotionSigma
from skidsteer.models import Model
from skidsteer.se2 import FloatArray

SHARE = 0.1  # of a distance or a turn that a prediction may err by
PLACE = 0.25  # of the track width that the point it turns about may be off by
STRAIGHT = 10.0  # [m]
ALIKE = 0.8  # of motions known about as badly the first is named

Row = tuple[str, float, str, FloatArray]  # motion, tolerance, unit, derivative by the parameters


def known_motions(model: Model, speed: float, track_width: float) -> tuple[list[MotionSigma], FloatArray]:
    """Motions, with a sigma of zero yet, and the derivative (r, p) of each by the parameters, in tolerances.

    What the model assumes, whatever was driven, is left out.
    """
    rows = _straight(model, speed)
    rows += _on_the_spot(model, (-speed, speed), "left", track_width)
    rows += _on_the_spot(model, (speed, -speed), "right", track_width)
    rows += _curve(model, (speed / 3.0, speed), "left")
    rows += _curve(model, (speed, speed / 3.0), "right")
    told = [row for row in rows if np.abs(row[3]).max(initial=0.0) > 1e-9 * row[1]]
    slopes = [slope / tolerance for _, tolerance, _, slope in told]
    motions = [MotionSigma(motion, 0.0, tolerance, unit) for motion, tolerance, unit, _ in told]
    return motions, np.array(slopes).reshape(len(told), len(model.theta))


def _straight(model: Model, speed: float) -> list[Row]:
    """Rows of equal rim speeds, to first order about a straight."""
    by_x, by_y, by_turn = model.parameter_jacobian(speed, speed)
    time = STRAIGHT / float(model.twist(speed, speed)[0])
    aside = time * (by_y + 0.5 * STRAIGHT * by_turn)
    return [
        ("the distance of 10 m straight on", SHARE * STRAIGHT, "m", time * by_x),
        ("the drift to the side on 10 m straight on", SHARE * STRAIGHT, "m", aside),
    ]


def _on_the_spot(model: Model, rims: tuple[float, float], side: str, track_width: float) -> list[Row]:
    (v_x, v_y, omega), (by_x, by_y, by_turn) = model.twist(*rims), model.parameter_jacobian(*rims)
    place, turn = PLACE * track_width, f"turn on the spot to the {side}"
    return [
        (f"the angle of a full {turn}", SHARE * 360.0, "deg", 360.0 * by_turn / omega),
        (f"how far ahead the centre of a {turn} lies", place, "m", (v_y * by_turn / omega - by_y) / omega),
        (f"how far aside the centre of a {turn} lies", place, "m", (by_x - v_x * by_turn / omega) / omega),
    ]


def _curve(model: Model, rims: tuple[float, float], side: str) -> list[Row]:
    (v_x, _, omega), (by_x, by_y, by_turn) = model.twist(*rims), model.parameter_jacobian(*rims)
    time, curve = STRAIGHT / v_x, f"curve to the {side}"
    return [
        (f"the angle of a full {curve}", SHARE * 360.0, "deg", 360.0 * by_turn / omega),
        (f"the distance of 10 m in a {curve}", SHARE * STRAIGHT, "m", time * by_x),
        (f"the side slip on 10 m in a {curve}", SHARE * STRAIGHT, "m", time * by_y),
    ]


def sigmas(slopes: FloatArray, covariance: FloatArray) -> FloatArray:
    """Standard deviation (r,) of motions, in tolerances."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ri,ij,rj->r", slopes, covariance, slopes), 0.0)))
