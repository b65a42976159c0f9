"""A free 3 x 2 matrix from rim speeds to twist: Anousaki and Kyriakopoulos, ICRA 2004, cited as [8] by Mandow 2007."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from skidsteer.models.model import MatrixModel, Parameter
from skidsteer.se2 import FloatArray


@dataclass(frozen=True)
class Linear(MatrixModel):
    """Six parameters without physical meaning, one more than the ICR model: v_y need not be proportional to omega."""

    NAME: ClassVar[str] = "linear"
    CRABS: ClassVar[bool] = True
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("vx_left", "", 0.5, -0.5, 1.5, "v_x for each m/s of the left rim"),
        Parameter("vx_right", "", 0.5, -0.5, 1.5, "v_x for each m/s of the right rim"),
        Parameter("vy_left", "", 0.0, -1.0, 1.0, "v_y for each m/s of the left rim"),
        Parameter("vy_right", "", 0.0, -1.0, 1.0, "v_y for each m/s of the right rim"),
        Parameter("omega_left", "1/m", -1.0, -2.5, -0.1, "yaw rate for each m/s of the left rim", -1),
        Parameter("omega_right", "1/m", 1.0, 0.1, 2.5, "yaw rate for each m/s of the right rim", -1),
    )

    vx_left: float
    vx_right: float
    vy_left: float
    vy_right: float
    omega_left: float  # [1/m]
    omega_right: float  # [1/m]

    def __post_init__(self) -> None:
        if self.vx_left * self.omega_right == self.vx_right * self.omega_left:
            raise ValueError("the rows of v_x and omega are parallel: the robot could not be steered")

    def matrix(self) -> FloatArray:  # noqa: D102
        return self.theta.reshape(3, 2)

    def matrix_jacobian(self) -> FloatArray:  # noqa: D102
        return np.eye(6).reshape(3, 2, 6)
