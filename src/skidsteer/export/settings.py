"""What the calibration does not know of the robot's software."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from skidsteer.errors import RequestError


@dataclass(frozen=True, slots=True)
class Settings:
    """Names and rates of the software that the calibration is for; the defaults are those of its documentation.

    Raises:
        RequestError: a name that is empty or cannot be printed, or a rate that is not a positive number.
    """

    controller: str = "diff_drive_controller"  # name of the controller, and of its node
    rate: float = 50.0  # [Hz] at which odometry is published
    icr_frame: str | None = None  # frame at the robot's ICR, that the odometry is to be of; None: base_link
    imu_topic: str = "imu/data"

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, str) and not (value.strip() and value.isprintable()):
                option = f"--{field.name.replace('_', '-')}"
                raise RequestError(f"{option} must be a name on one line that is not empty, got {value!r}")
        if not (math.isfinite(self.rate) and 0.0 < self.rate <= 1e4):
            raise RequestError(f"--rate must be a positive number of messages a second, got {self.rate}")
