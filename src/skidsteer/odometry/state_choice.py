"""The two motion parameters in a filter's state, Thalmann 2016, Table 1, and their disturbances.

The displayed equations are lost in the scan at hand; this follows from the text and Figs. 1 to 3. With B the track
width, the motion parameters m give the rim speeds (v_l, v_r) = C m:

    sides               v_l, v_r              C = [1, 0; 0, 1]           Eq. (1)
    speed_yaw_rate      v, yaw rate           C = [1, -B/2; 1, B/2]      Eqs. (2), (3)
    speed_difference    v_T, dv = v_r - v_l   C = [1, -1/2; 1, 1/2]      Eqs. (4), (5)

Encoders brought to C^-1 (v_l, v_r) outside the filter, variant (b) of section 2.2, observe m itself. With the variance
sigma^2 of each rim speed they have sigma^2 (sides), sigma^2 / 2 (speed), 2 sigma^2 (difference) and 2 sigma^2 / B^2
(yaw rate), and are uncorrelated in each choice.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from skidsteer.errors import RequestError
from skidsteer.se2 import FloatArray

Choice = Literal["sides", "speed_yaw_rate", "speed_difference"]
MOTION: dict[str, tuple[str, str]] = {
    "sides": ("v_left", "v_right"),
    "speed_yaw_rate": ("v", "omega"),
    "speed_difference": ("v", "v_difference"),
}


def rims(choice: Choice, track_width: float) -> FloatArray:
    """C (2, 2): rim speeds of both sides by the motion parameters."""
    if choice == "sides":
        return np.eye(2)
    lever = 0.5 * track_width if choice == "speed_yaw_rate" else 0.5
    return np.array([[1.0, -lever], [1.0, lever]])


def unit_variance(choice: Choice, track_width: float) -> FloatArray:
    """Variance (2,) of the observed motion parameters where that of each rim speed is 1 [(m/s)^2]."""
    return np.asarray((np.linalg.inv(rims(choice, track_width)) ** 2).sum(axis=1))


@dataclass(frozen=True, slots=True)
class SystemNoise:
    """Standard deviations, all finite and not negative; ``encoder`` positive.

    The accelerations are constant in a step and independent from step to step, as in the paper, so that their effect
    depends on the sampling rate.
    """

    acceleration: float = 0.5  # [m/s^2] disturbance of the speed, or of each side
    difference: float = 0.1  # [m/s^2] disturbance of the difference of the sides; divided by the track: of the yaw rate
    encoder: float = 0.005  # [m/s] of an observed rim speed
    drift: float = 0.0  # [1/sqrt(s)] random walk of estimated slip parameters; not in the paper
    walk: float = 0.0  # [m/sqrt(m)] random walk of the position with the distance rolled, each axis; not in the paper
    turn: float = 0.0  # [rad/sqrt(m)] the same of the yaw

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not 0.0 <= value < np.inf or (f.name == "encoder" and value == 0.0):
                raise RequestError(f"system noise {f.name} must be finite, not negative, encoder positive; got {value}")

    def disturbance(self, choice: Choice, track_width: float) -> FloatArray:
        """Standard deviation (2,) of the accelerations of the motion parameters."""
        if choice == "sides":
            return np.array([self.acceleration, self.acceleration])
        width = track_width if choice == "speed_yaw_rate" else 1.0
        return np.array([self.acceleration, self.difference / width])
