"""Constant instantaneous centres of rotation (ICRs) of the treads, Mandow 2007.

Mandow puts y forward and x right. Here REP-103 holds, x forward and y left, so that icr_x = y_ICRv,
icr_y_left = -x_ICRl and icr_y_right = -x_ICRr.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from skidsteer.models.model import MatrixModel, Parameter
from skidsteer.se2 import FloatArray


@dataclass(frozen=True)
class Icr(MatrixModel):
    """Five parameters, Mandow 2007, Eqs. (2)-(7): where each tread stands still on the ground, and two scale factors.

    A reference sensor mounted (l_x, l_y) from where it is taken to be shifts icr_x by l_x and both icr_y by l_y:
    motion alone cannot tell the two apart.
    """

    NAME: ClassVar[str] = "icr"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("icr_y_left", "m", 0.5, 0.1, 3.0, "left tread ICR, to the left of the origin", 1),
        Parameter("icr_y_right", "m", -0.5, -3.0, -0.1, "right tread ICR, to the left of the origin", 1),
        Parameter("icr_x", "m", 0.0, -1.0, 1.0, "ICR of body and treads, ahead of the origin", 1),
        Parameter("alpha_left", "", 1.0, 0.5, 1.5, "true over nominal rim speed, left"),
        Parameter("alpha_right", "", 1.0, 0.5, 1.5, "true over nominal rim speed, right"),
    )

    icr_y_left: float  # [m]
    icr_y_right: float  # [m]
    icr_x: float  # [m]
    alpha_left: float
    alpha_right: float

    def __post_init__(self) -> None:
        if not self.icr_y_left > self.icr_y_right:
            raise ValueError(f"need icr_y_left > icr_y_right [m], got {self.icr_y_left}, {self.icr_y_right}")
        if not (self.alpha_left > 0 and self.alpha_right > 0):
            raise ValueError(f"need alpha_left, alpha_right > 0, got {self.alpha_left}, {self.alpha_right}")

    def matrix(self) -> FloatArray:
        """A of Mandow 2007, Eq. (7), in REP-103."""
        left, right, x = self.icr_y_left, self.icr_y_right, self.icr_x
        rows = np.array([[-right, left], [x, -x], [-1.0, 1.0]])
        return np.asarray(rows * [self.alpha_left, self.alpha_right] / (left - right))

    def matrix_jacobian(self) -> FloatArray:  # noqa: D102
        left, right, x = self.icr_y_left, self.icr_y_right, self.icr_x
        alpha, width = np.array([self.alpha_left, self.alpha_right]), left - right
        A, unit = self.matrix(), np.array([[-right, left], [x, -x], [-1.0, 1.0]]) / width
        d_left = np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]) * alpha / width - A / width
        d_right = np.array([[-1.0, 0.0], [0.0, 0.0], [0.0, 0.0]]) * alpha / width + A / width
        d_x = np.array([[0.0, 0.0], [1.0, -1.0], [0.0, 0.0]]) * alpha / width
        d_alpha_left, d_alpha_right = unit * [1.0, 0.0], unit * [0.0, 1.0]
        return np.stack([d_left, d_right, d_x, d_alpha_left, d_alpha_right], axis=-1)

    def steering_efficiency(self, track_width: float) -> float:
        """Mandow 2007, Eq. (9): track width over ICR distance; 1 is a turn without slip. Wang's chi is its inverse."""
        return track_width / (self.icr_y_left - self.icr_y_right)

    def eccentricity(self) -> float:
        """Mandow 2007, Eq. (10): 0 where the tread ICRs lie symmetrically, positive where they lie to the right."""
        return -(self.icr_y_left + self.icr_y_right) / (self.icr_y_left - self.icr_y_right)


@dataclass(frozen=True)
class SymmetricIcr(MatrixModel):
    """Two parameters, Mandow 2007, Eq. (8): ICRs at +-icr_y on the lateral axis, one scale factor."""

    NAME: ClassVar[str] = "icr_symmetric"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("icr_y", "m", 0.5, 0.1, 3.0, "left tread ICR, the right one lies at -icr_y", 1),
        Parameter("alpha", "", 1.0, 0.5, 1.5, "true over nominal rim speed"),
    )

    icr_y: float  # [m]
    alpha: float

    def __post_init__(self) -> None:
        if not (self.icr_y > 0 and self.alpha > 0):
            raise ValueError(f"need icr_y > 0 [m] and alpha > 0, got {self.icr_y}, {self.alpha}")

    def matrix(self) -> FloatArray:
        """A of Mandow 2007, Eq. (8), in REP-103."""
        return self.alpha / (2.0 * self.icr_y) * np.array([[self.icr_y, self.icr_y], [0.0, 0.0], [-1.0, 1.0]])

    def matrix_jacobian(self) -> FloatArray:  # noqa: D102
        d_icr_y = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, -1.0]]) * self.alpha / (2.0 * self.icr_y**2)
        return np.stack([d_icr_y, self.matrix() / self.alpha], axis=-1)
