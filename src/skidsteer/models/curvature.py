"""ICRs that move inwards as the path gets straighter: Wang 2015, Eqs. (13)-(15), (44)-(47).

The treads' ICRs lie at +-B chi / 2, with

    chi = 1 + a / (1 + b sqrt|lambda|),   lambda = (v_l + v_r) / (v_r - v_l)     Eqs. (44), (13)

so that omega = (v_r - v_l) / (B chi), Eqs. (11), (15); the 2 B chi printed in Eqs. (46), (47) is wrong. Here chi is
written as a ratio that needs no lambda and stays finite on a straight,

    chi = 1 + a p / (p + b q),   p = sqrt|v_r - v_l|,   q = sqrt|v_l + v_r|

As printed, omega has a cusp at each turn on the spot (its slope by v_l + v_r is infinite there) and no slope at rest.
Speeds below ``CREEP`` are therefore rounded off. Above 0.1 m/s p and q are those above to 0.15 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.models.model import Model, Parameter
from skidsteer.se2 import FloatArray

CREEP = 0.02  # [m/s] slower counts as standing still
ITERATIONS = 60  # each at least halves the error


def icr_coefficient(path_curvature: ArrayLike, a: float, b: float) -> FloatArray:
    """Wang's ICR coefficient chi: distance of the treads' ICRs over track width, 1 without slip.

    It is the inverse of Mandow's steering efficiency. Fitted for lambda up to 10; beyond it falls on towards 1.

    Args:
        path_curvature: (...) lambda, Eq. (13): 0 on the spot, +-1 with one side at rest, infinite on a straight.
        a: chi - 1 on the spot.
        b: how fast chi falls.

    Returns:
        (...) chi of Eq. (44).
    """
    return np.asarray(1.0 + a / (1.0 + b * np.sqrt(np.abs(path_curvature))))


@dataclass(frozen=True)
class Curvature(Model):
    """Three parameters: Wang's a and b, Eq. (44), and the scale factor of the rims.

    Wang first corrects the rolled distances by straight runs, Eq. (42); here that factor is ``alpha``. The
    model is symmetric about the origin and, like a constant ICR, depends on the ratio of the speeds only: chi is almost
    independent of speed, Wang 2015, Fig. 12 (b).
    """

    NAME: ClassVar[str] = "curvature"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("a", "", 0.0, -0.5, 5.0, "ICR distance over track width in a turn on the spot, less 1"),
        Parameter("b", "", 0.05, 0.0, 2.0, "how fast that falls as the path gets straighter"),
        Parameter("alpha", "", 1.0, 0.5, 1.5, "true over nominal rim speed"),
    )

    a: float
    b: float
    alpha: float
    track_width: float  # [m]

    def __post_init__(self) -> None:
        if not (self.a > -1.0 and self.b >= 0.0):
            raise ValueError(f"need a > -1 and b >= 0, got {self.a}, {self.b}")
        if not (self.alpha > 0.0 and self.track_width > 0.0):
            raise ValueError(f"need alpha > 0 and track_width > 0 [m], got {self.alpha}, {self.track_width}")

    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        total, apart = _sums(v_left, v_right)
        omega = self.alpha * apart / (self.track_width * self._chi(total, apart))  # Eqs. (11), (15)
        return np.stack([0.5 * self.alpha * total, np.zeros_like(omega), omega], axis=-1)

    def _chi(self, total: FloatArray, apart: FloatArray) -> FloatArray:
        p, q = _root(apart), self.b * _root_from_zero(total)
        return np.asarray(1.0 + self.a * p / (p + q))  # Eq. (44)

    def parameter_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        total, apart = _sums(v_left, v_right)
        p, q = _root(apart), _root_from_zero(total)
        chi, inner = self._chi(total, apart), p + self.b * q
        omega = self.alpha * apart / (self.track_width * chi)
        by_a, by_b = -omega / chi * p / inner, omega / chi * self.a * p * q / inner**2
        none = np.zeros_like(omega)
        v_x = np.stack([none, none, 0.5 * total], axis=-1)
        turn = np.stack([by_a, by_b, omega / self.alpha], axis=-1)
        return np.stack([v_x, np.zeros_like(v_x), turn], axis=-2)

    def speed_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        total, apart = _sums(v_left, v_right)
        p, q, chi = _root(apart), _root_from_zero(total), self._chi(total, apart)
        rate = self.alpha / (self.track_width * chi)
        # log chi by p and q, times apart
        change = self.a * self.b * apart / ((p + self.b * q) ** 2 * chi)
        by_apart = rate * (1.0 - change * q * _slope_of_root(apart))
        by_total = rate * change * p * _slope_from_zero(total)
        half = np.full_like(rate, 0.5 * self.alpha)
        v_x = np.stack([half, half], axis=-1)
        turn = np.stack([by_total - by_apart, by_total + by_apart], axis=-1)
        return np.stack([v_x, np.zeros_like(v_x), turn], axis=-2)

    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:
        """Rim speeds (..., 2) [m/s] that give v_x = v and omega; exact on a straight.

        Solves apart = B omega chi(apart) / alpha by repeated substitution. The logarithm of chi changes by less than
        half of that of apart, for any a and b: every step at least halves the error.
        """
        v, omega = np.broadcast_arrays(np.asarray(v, dtype=float), np.asarray(omega, dtype=float))
        total, ideal = 2.0 * v / self.alpha, self.track_width * omega / self.alpha
        apart = ideal * (1.0 + self.a)
        for _ in range(ITERATIONS):
            before, apart = apart, ideal * self._chi(total, apart)
            if (np.abs(apart - before) <= np.finfo(float).eps * np.abs(apart)).all():
                break
        return np.stack([0.5 * (total - apart), 0.5 * (total + apart)], axis=-1)


def _sums(v_left: ArrayLike, v_right: ArrayLike) -> tuple[FloatArray, FloatArray]:
    left, right = np.broadcast_arrays(np.asarray(v_left, dtype=float), np.asarray(v_right, dtype=float))
    return left + right, right - left


def _root(x: FloatArray) -> FloatArray:
    """sqrt|x|, rounded to sqrt(CREEP) at zero."""
    return np.asarray((x**4 + CREEP**4) ** 0.125)


def _slope_of_root(x: FloatArray) -> FloatArray:
    return np.asarray(0.5 * x**3 * (x**4 + CREEP**4) ** -0.875)


def _root_from_zero(x: FloatArray) -> FloatArray:
    """sqrt|x|, rounded to a smooth zero at zero."""
    return np.asarray(x**4 * (x**4 + CREEP**4) ** -0.875)


def _slope_from_zero(x: FloatArray) -> FloatArray:
    return np.asarray(x**3 * (0.5 * x**4 + 4.0 * CREEP**4) * (x**4 + CREEP**4) ** -1.875)
