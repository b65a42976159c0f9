"""The ideal differential drive, and the same with the one correction factor that robots ship with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from skidsteer.models.model import MatrixModel, Parameter
from skidsteer.se2 import FloatArray


def _matrix(width: float) -> FloatArray:
    return np.array([[0.5, 0.5], [0.0, 0.0], [-1.0 / width, 1.0 / width]])


@dataclass(frozen=True)
class Differential(MatrixModel):
    """No slip at all: the robot turns with its track width. Nothing to estimate."""

    NAME: ClassVar[str] = "differential"

    track_width: float  # [m]

    def __post_init__(self) -> None:
        if not self.track_width > 0:
            raise ValueError(f"need track_width > 0 [m], got {self.track_width}")

    def matrix(self) -> FloatArray:  # noqa: D102
        return _matrix(self.track_width)

    def matrix_jacobian(self) -> FloatArray:  # noqa: D102
        return np.zeros((3, 2, 0))


@dataclass(frozen=True)
class Multiplier(MatrixModel):
    """The track width times one factor: what ROS calls wheel_separation_multiplier, and users tune by eye."""

    NAME: ClassVar[str] = "multiplier"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("multiplier", "", 1.0, 0.4, 10.0, "effective track width over track width"),
    )

    multiplier: float
    track_width: float  # [m]

    def __post_init__(self) -> None:
        if not (self.multiplier > 0 and self.track_width > 0):
            raise ValueError(f"need multiplier > 0 and track_width > 0, got {self.multiplier}, {self.track_width}")

    def matrix(self) -> FloatArray:  # noqa: D102
        return _matrix(self.multiplier * self.track_width)

    def matrix_jacobian(self) -> FloatArray:  # noqa: D102
        slope = 1.0 / (self.multiplier**2 * self.track_width)
        return np.array([[0.0, 0.0], [0.0, 0.0], [slope, -slope]])[..., None]
