"""Transfer factors of both sides, Thalmann 2016, section 2.4, after the slip ratios of Endo 2007 and Nagatani 2008.

The displayed Eqs. (6)-(8) are lost in the scan at hand; these follow from the text without ambiguity. With the slip
ratio a_i of side i, the effective speed over ground of that side is

    v_i,eff = (1 - a_i) v_i = tau_i v_i                                  Eq. (6)

and the ideal differential drive with effective in place of rim speeds,

    v = (tau_r v_r + tau_l v_l) / 2,   omega = (tau_r v_r - tau_l v_l) / B    Eq. (7)

Thalmann sets one factor to 1 and calls the other 1 - d: d is the slip ratio of the right side where that of the left
one is zero. In place of the track width B, the effective one, B / chi, is used, with Mandow's steering efficiency index
chi (1: no lateral slip); the yaw rate is linear in it, and for chi = 1 these are Thalmann's equations.

The model is Mandow's five-parameter one with icr_x = 0 and ICRs that lie symmetrically, +-B / (2 chi): it belongs to
the filters and is in no list of models to choose from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from skidsteer.models.model import MatrixModel, Parameter
from skidsteer.se2 import FloatArray


@dataclass(frozen=True)
class TransferFactor(MatrixModel):
    """Slip ratios of both sides and the steering efficiency; nominal is the ideal differential drive."""

    NAME: ClassVar[str] = "transfer_factor"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("slip_left", "", 0.0, -0.5, 0.5, "share of the left rim speed that is lost"),
        Parameter("slip_right", "", 0.0, -0.5, 0.5, "the same, right"),
        Parameter("efficiency", "", 1.0, 0.1, 2.5, "track width over effective track width"),
    )

    slip_left: float
    slip_right: float
    efficiency: float
    track_width: float  # [m]

    def __post_init__(self) -> None:
        if not (self.slip_left < 1.0 and self.slip_right < 1.0 and self.efficiency > 0.0 and self.track_width > 0.0):
            raise ValueError(
                "need slip_left, slip_right < 1, efficiency > 0 and track_width > 0,"
                f" got {self.slip_left}, {self.slip_right}, {self.efficiency}, {self.track_width}"
            )

    def matrix(self) -> FloatArray:  # noqa: D102
        turn = self.efficiency / self.track_width
        return np.array([[0.5, 0.5], [0.0, 0.0], [-turn, turn]]) * [1.0 - self.slip_left, 1.0 - self.slip_right]

    def matrix_jacobian(self) -> FloatArray:  # noqa: D102
        turn = self.efficiency / self.track_width
        d_left = np.array([[-0.5, 0.0], [0.0, 0.0], [turn, 0.0]])
        d_right = np.array([[0.0, -0.5], [0.0, 0.0], [0.0, -turn]])
        d_efficiency = self.matrix() * [[0.0], [0.0], [1.0 / self.efficiency]]
        return np.stack([d_left, d_right, d_efficiency], axis=-1)
