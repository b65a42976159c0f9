"""What drives a plan: the robot, its motion model with its uncertainty, and its integer commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.models import Model
from skidsteer.noise import Noise
from skidsteer.plan.encoding import ENCODINGS, Encoding
from skidsteer.plan.slip_table import SlipTable
from skidsteer.prediction import Regions, Uncertainty
from skidsteer.vehicle import Vehicle

NORMAL = Regions(1.0, 1e6)


@dataclass(frozen=True, slots=True, eq=False)
class Driver:
    """A robot, its motion model with its uncertainty, and its integer commands."""

    vehicle: Vehicle
    model: Model
    uncertainty: Uncertainty
    lag: float = 0.0  # [s]
    regions: Regions = NORMAL
    encoding: Encoding | None = None
    open: tuple[str, ...] = ()  # parameters that are not determined

    @classmethod
    def of(cls, calibration: Calibration) -> Driver:
        """By a calibration."""
        names = [*calibration.parameters, "", "lag"]  # a time offset does not matter
        at = [calibration.names.index(n) if n in calibration.names else -1 for n in names]
        padded = np.pad(calibration.covariance, (0, 1))  # what is not estimated is known exactly
        return cls(
            calibration.vehicle,
            calibration.model,
            Uncertainty(calibration.noise, padded[np.ix_(at, at)]),
            calibration.timing.lag,
            calibration.regions or NORMAL,
            ENCODINGS.get(calibration.vehicle.name),
            tuple(name for name, e in calibration.parameters.items() if not e.determined),
        )

    @classmethod
    def of_circles(cls, table: SlipTable, vehicle: Vehicle) -> Driver:
        """By the slip ratios of circle runs, which hold neither lag nor noise: these are assumed."""
        return cls(vehicle, table, Uncertainty(Noise(), np.zeros((2, 2))), encoding=ENCODINGS.get(vehicle.name))
