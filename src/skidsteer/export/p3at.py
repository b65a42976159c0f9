"""The two integers of a Pioneer P3-AT, Mandow 2007, Eqs. (14), (15)."""

from __future__ import annotations

from math import degrees

from skidsteer.calibration import Calibration
from skidsteer.errors import RequestError
from skidsteer.export.forced import Forced, force
from skidsteer.export.yaml_text import comment
from skidsteer.models import SymmetricIcr
from skidsteer.p3at import from_model


def p3at(calibration: Calibration, forced: Forced | None = None) -> str:
    """``Ticksmm`` and ``Revcount`` for the model's multipliers with the mean scale of both sides.

    Exact are the distance with equal rims and the yaw with opposite ones; a difference between the sides is lost.

    Raises:
        RequestError: the model does not move as a differential drive at all, or the robot is too large or small.
    """
    forced = forced or force(calibration)
    found, radius = forced.projection.multipliers, calibration.vehicle.wheel_radius
    left, right = found.left_wheel_radius_multiplier, found.right_wheel_radius_multiplier
    try:
        integers = from_model(SymmetricIcr(0.5 * found.separation, 0.5 * (left + right)), radius)
    except (ValueError, OverflowError) as error:
        raise RequestError(f"{calibration.vehicle.name} is no Pioneer P3-AT: {error}; take another format") from error
    drift = degrees((right - left) / found.separation)
    return (
        comment(
            f"Pioneer P3-AT: {calibration.vehicle.name}, the {calibration.model.NAME} model. Mandow 2007,"
            " Eqs. (14), (15), the former turned the right way up.",
            "What is lost: both sides get one scale and the ICR the middle, so that with equal rims the robot"
            f" turns by {drift:.2f} deg in each metre unnoticed.",
        )
        + f"Ticksmm {integers.ticksmm}\nRevcount {integers.revcount}\n"
    )
