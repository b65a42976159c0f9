"""Dead reckoning from wheel speeds: geometries of a step at constant speeds, and their errors.

Thalmann 2016, sections 2.1 and 2.2. The displayed Eqs. (1) and (2) are lost in the scan at hand. In a step of dt, with
path s = v dt and turn delta = omega dt, seen from the pose where it begins:

    polygon   (s, 0, delta)                                       Eq. (1): the path goes on along the tangent
    arc       (s k cos(delta / 2), s k sin(delta / 2), delta)     Eq. (2): the chord of an arc of length s

with k = sin(delta / 2) / (delta / 2), which is 1 on a straight line. (Written with the radius v / omega, as in the
paper, the arc needs a second filter for straight lines.) ``exact`` is the exponential map of SE(2): the arc, and
sideways motion as an ICR ahead of or behind the origin causes it.

A polygon errs by v^2 dt^2 / (2 R) a step, quadratic in the speed and inverse in the radius R. Over a full circle the
errors cancel: the vertices lie on a circle of nearly the same radius, displaced by half a step, v dt / 2, whatever R.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.drive import Series
from skidsteer.models import Model
from skidsteer.se2 import FloatArray, chain, exp

Geometry = Literal["polygon", "arc", "exact"]


def polygon(twist: ArrayLike, dt: ArrayLike) -> FloatArray:
    """Motion (..., 3) along the tangent at the start, Eq. (1), of twists (..., 3) held for dt (...) [s]."""
    return np.asarray(np.asarray(twist, dtype=float) * np.asarray(dt, dtype=float)[..., None])


def arc(twist: ArrayLike, dt: ArrayLike) -> FloatArray:
    """Motion (..., 3) along an arc, Eq. (2), of twists (..., 3) held for dt (...) [s]; v_y is not used."""
    path, _, turn = np.moveaxis(polygon(twist, dt), -1, 0)
    half = 0.5 * turn
    chord = path * np.sinc(half / np.pi)
    return np.stack([chord * np.cos(half), chord * np.sin(half), turn], axis=-1)


def exact(twist: ArrayLike, dt: ArrayLike) -> FloatArray:
    """Motion (..., 3) of twists (..., 3) held for dt (...) [s]: the exponential map, with the side slip v_y."""
    return exp(polygon(twist, dt))


STEPS = {"polygon": polygon, "arc": arc, "exact": exact}


def reckon(
    model: Model, wheels: Series, geometry: Geometry = "exact", start: ArrayLike = (0.0, 0.0, 0.0)
) -> FloatArray:
    """Poses (n, 3) at the wheel samples, yaw unwrapped.

    Args:
        model: rim speeds to twists.
        wheels: (n, 2) rim speeds [m/s], each held until the next sample, however long that takes.
        geometry: of a step.
        start: pose at the first sample.

    Raises:
        ValueError: no such geometry.
    """
    if geometry not in STEPS:
        raise ValueError(f"need a geometry of {', '.join(STEPS)}, got {geometry!r}")
    twist = model.twist(wheels.values[:-1, 0], wheels.values[:-1, 1])
    return chain(STEPS[geometry](twist, np.diff(wheels.t)), start)


def polygon_error(speed: float, radius: float, rate: float) -> float:
    """Distance [m] of the polygon from the arc after one step, Thalmann 2016, Figs. 4 and 5.

    Args:
        speed: [m/s] along the circle.
        radius: [m]; infinite is the straight line.
        rate: [Hz] of the wheel samples.
    """
    twist = np.array([speed, 0.0, speed / radius])
    return float(np.hypot(*(polygon(twist, 1.0 / rate) - arc(twist, 1.0 / rate))[:2]))


def off_circle(speed: float, radius: float, rate: float) -> float:
    """Largest distance [m] of the polygon's vertices from the circle, once around it: about speed / (2 rate)."""
    n = int(np.ceil(2.0 * np.pi * radius * rate / speed))
    twist = np.broadcast_to([speed, 0.0, speed / radius], (n, 3))
    x, y, _ = chain(polygon(twist, np.full(n, 1.0 / rate))).T
    return float(np.abs(np.hypot(x, y - radius) - radius).max())
