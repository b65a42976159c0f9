"""Slip of the inner and the outer side on a circle: Giannoccaro 2015, Eqs. (11)-(16), (22).

The slipping ratio K_s = (1 - i_i) / (1 - i_o) of the two sides tells the radius of a circle from the rim speeds,

    R = B/2 (v_o + K_s v_i) / (v_o - K_s v_i)     Eq. (15)

This is a description of runs, not a motion model, and is in no list of models: with a constant K_s other than 1 (an
ideal drive) the yaw rate jumps where the sides swap roles, so that equal speeds would turn the robot, left or right
alike, and above v_i = v_o / K_s it would turn to the wrong side. The paper's own runs show it: with the 2.5
that K_s settles at indoors, run 1L (0.632 and 0.410 m/s) would curve to the right. K_s is constant in tight curves
only; a plan takes it from the runs about as wide as the arc (``skidsteer.plan.slip_table``).

Slip coefficients are positive where a wheel spins and negative where it is dragged. The inner side of a skid-steer
robot is dragged: Table 4 prints the magnitudes of negative coefficients (with the sign as printed, a robot with 100 %
at 4L outdoors could not move along its circle of 0.496 m).

Giannoccaro puts y forward and x right; his x_ICR is a distance from the middle, icr_y here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import DataError
from skidsteer.se2 import FloatArray

Side = Literal["left", "right"]


def turn_radius(v_outer: ArrayLike, v_inner: ArrayLike, slip_ratio: ArrayLike, track_width: float) -> FloatArray:
    """Radius (...) [m] of the centre's circle, Eq. (15); infinite where v_outer = slip_ratio v_inner.

    Negative where the robot would curve towards the supposed outer side.
    """
    outer, dragged = np.asarray(v_outer, dtype=float), np.asarray(slip_ratio, dtype=float) * np.asarray(v_inner)
    outer, dragged = np.broadcast_arrays(outer, dragged)
    straight = np.full(outer.shape, np.inf)
    np.divide(0.5 * track_width * (outer + dragged), outer - dragged, out=straight, where=outer != dragged)
    return straight


def slip_ratio(v_outer: ArrayLike, v_inner: ArrayLike, radius: ArrayLike, track_width: float) -> FloatArray:
    """K_s (...) from a measured radius [m], Eq. (15) solved for it; negative for a radius below half the track width.

    Raises:
        ValueError: an inner side at rest: every ratio gives the same circle.
    """
    inner, R, half = np.asarray(v_inner, dtype=float), np.asarray(radius, dtype=float), 0.5 * track_width
    if (inner == 0.0).any():
        raise ValueError(f"need a v_inner other than 0 [m/s], got {inner.tolist()}")
    return np.asarray(np.asarray(v_outer) * (R - half) / (inner * (R + half)))


def slip_ratio_from_slips(slip_inner: ArrayLike, slip_outer: ArrayLike) -> FloatArray:
    """K_s (...) from slip coefficients (fractions, not per cent), Eq. (14).

    Raises:
        ValueError: an outer side that spins on the spot, slip 1.
    """
    grip = 1.0 - np.asarray(slip_outer, dtype=float)
    if (grip == 0.0).any():
        raise ValueError("need a slip_outer other than 1: the outer side does not move at all")
    return np.asarray((1.0 - np.asarray(slip_inner, dtype=float)) / grip)


def slip_coefficient(rim: ArrayLike, ground: ArrayLike) -> FloatArray:
    """Slip i (...), a fraction: 1 - ground speed / rim speed, Eq. (22). Negative: dragged.

    Raises:
        ValueError: a rim at rest.
    """
    rim = np.asarray(rim, dtype=float)
    if (rim == 0.0).any():
        raise ValueError(f"need a rim speed other than 0 [m/s], got {rim.tolist()}")
    return np.asarray(1.0 - np.asarray(ground, dtype=float) / rim)


def radius_of_arc(
    chord: ArrayLike, sagitta: ArrayLike, chord_sigma: ArrayLike = 0.0, sagitta_sigma: ArrayLike = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Radius of an arc too long to be driven as a whole circle, R = l^2 / (2 x), Eq. (16), and its standard deviation.

    Args:
        chord: (...) l [m], straight from the first to the last point of the arc.
        sagitta: (...) x [m], how far the last point lies beside the line that the robot set off along. Of a chord c
            with the height h of the arc above its middle, give l = hypot(c / 2, h) and x = h.
        chord_sigma: (...) [m] standard deviation of the chord.
        sagitta_sigma: (...) [m] of the sagitta, independent of it.

    Returns:
        radius (...) [m] and sigma (...) [m], to first order.

    Raises:
        DataError: lengths that are not positive, or a chord longer than the diameter: a sagitta longer than the chord.
    """
    l, x = np.broadcast_arrays(np.asarray(chord, dtype=float), np.asarray(sagitta, dtype=float))  # noqa: E741
    _refuse_no_arc(l, x)
    R = l**2 / (2.0 * x)  # Eq. (16)
    return R, np.asarray(R * np.hypot(2.0 * np.asarray(chord_sigma) / l, np.asarray(sagitta_sigma) / x))


def _refuse_no_arc(chord: FloatArray, sagitta: FloatArray) -> None:
    for l, x in zip(chord.ravel(), sagitta.ravel(), strict=True):  # noqa: E741
        if not (0.0 < l < np.inf and 0.0 < x < np.inf):
            why = "; a sagitta of 0 is a straight, with no radius" if x == 0.0 else ""
            raise DataError(f"chord and sagitta must be positive lengths in m, got {l:g} and {x:g}{why}")
        if x > l:
            raise DataError(
                f"chord {l:g} m and sagitta {x:g} m belong to no circle: the chord would be longer than the diameter,"
                f" {l * l / x:g} m; are the two columns swapped?"
            )


def rims_on_circle(
    radius: ArrayLike, omega: ArrayLike, slip_ratio: float, track_width: float, slip_outer: float = 0.0
) -> FloatArray:
    """Rim speeds (..., 2) left, right [m/s] for a circle, Eqs. (6), (14), (15): the planning of section V.

    Args:
        radius: (...) [m] of the centre's circle, above half the track width.
        omega: (...) [rad/s], counter-clockwise positive.
        slip_ratio: K_s of a circle of about that radius.
        track_width: [m].
        slip_outer: slip coefficient of the outer side, a fraction.

    Raises:
        ValueError: radius, ratio or slip that no robot can drive with.
    """
    R, half = np.asarray(radius, dtype=float), 0.5 * track_width
    if not ((half < R) & np.isfinite(R)).all():
        raise ValueError(f"need finite radii above half the track width, {half:g} m, got {R.tolist()}")
    if not (slip_ratio > 0.0 and slip_outer < 1.0):
        raise ValueError(f"need slip_ratio > 0 and slip_outer < 1, got {slip_ratio}, {slip_outer}")
    omega = np.asarray(omega, dtype=float)
    rate = np.abs(omega) / (1.0 - slip_outer)
    outer, inner, left = rate * (R + half), rate * (R - half) / slip_ratio, omega >= 0.0
    return np.stack([np.where(left, inner, outer), np.where(left, outer, inner)], axis=-1)


@dataclass(frozen=True, slots=True)
class CircleRun:
    """One run of constant rim speeds along a circle whose radius was measured.

    Raises:
        DataError: a run that describes no circle.
    """

    v_left: float  # [m/s] rim speed; both forwards or both backwards, one may be at rest
    v_right: float  # [m/s]
    radius: float  # [m] of the path of the robot's centre
    surface: str = ""
    speed: float | None = None  # [m/s] of the robot's centre over ground, where it was measured
    radius_sigma: float | None = None  # [m]
    name: str = ""

    def __post_init__(self) -> None:
        left, right = self.v_left, self.v_right
        pair = f"v_left {left:g}, v_right {right:g} m/s"
        if not np.isfinite([left, right]).all():
            raise DataError(f"a circle run needs finite rim speeds, got {pair}")
        if left == right == 0.0:
            raise DataError("both sides are at rest: no circle was driven")
        if left == right:
            raise DataError(f"both sides run at {left:g} m/s: a straight run has no radius, leave it out")
        if left * right < 0.0:
            raise DataError(f"the sides run against each other ({pair}): there is no inner one, use the turn test")
        if not 0.0 < self.radius < np.inf:
            raise DataError(f"the radius must be a positive length in m, got {self.radius:g}")
        if self.speed is not None and not 0.0 < self.speed < np.inf:
            raise DataError(f"the speed over ground must be positive, in m/s, got {self.speed:g}")

    @classmethod
    def from_chord(
        cls,
        v_left: float,
        v_right: float,
        chord: float,
        sagitta: float,
        surface: str = "",
        speed: float | None = None,
        name: str = "",
        sigma: float = 0.0,
    ) -> CircleRun:
        """A run of which chord and sagitta [m] were measured, Eq. (16), each to ``sigma`` [m]."""
        radius, spread = radius_of_arc(chord, sagitta, sigma, sigma)
        return cls(v_left, v_right, float(radius), surface, speed, float(spread) if sigma > 0.0 else None, name)

    @property
    def direction(self) -> Side:
        """Side that the centre of the circle lies on."""
        return "left" if abs(self.v_right) > abs(self.v_left) else "right"

    @property
    def outer(self) -> float:
        """Magnitude of the rim speed of the outer side [m/s]."""
        return max(abs(self.v_left), abs(self.v_right))

    @property
    def inner(self) -> float:
        """Magnitude of the rim speed of the inner side [m/s]."""
        return min(abs(self.v_left), abs(self.v_right))

    @property
    def path_curvature(self) -> float:
        """Magnitude of lambda of Wang 2015, Eq. (13): the factor of Eq. (12)."""
        return (self.outer + self.inner) / (self.outer - self.inner)

    @property
    def icr_y(self) -> float:
        """x_ICR [m] of this run alone, the paper's equivalent carriageway, Eq. (12)."""
        return self.radius / self.path_curvature

    def steering_efficiency(self, track_width: float) -> float:
        """Slippage index chi, Eq. (11): 1 is a turn without slip. Wang's ICR coefficient is its inverse."""
        return track_width / (2.0 * self.icr_y)

    def slip_ratio(self, track_width: float) -> float | None:
        """K_s, Eq. (15); None where the inner side is at rest, which leaves it undetermined."""
        return None if self.inner == 0.0 else float(slip_ratio(self.outer, self.inner, self.radius, track_width))

    def slip_coefficients(self, track_width: float) -> tuple[float | None, float] | None:
        """Slip of the inner and the outer side, fractions, Eqs. (13), (22); None where no speed was measured.

        That of an inner side at rest is None: Eq. (22) divides by its rim speed.
        """
        if self.speed is None:
            return None
        lean = 0.5 * track_width / self.radius
        inner, outer = self.speed * (1.0 - lean), self.speed * (1.0 + lean)
        of_inner = None if self.inner == 0.0 else float(slip_coefficient(self.inner, inner))
        return of_inner, float(slip_coefficient(self.outer, outer))
