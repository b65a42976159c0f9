"""Everything a fit may estimate, in one vector: model, lag, mounting of the reference, clocks and gyros."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Drive
from skidsteer.gyro import GyroErrors
from skidsteer.models import Model
from skidsteer.se2 import FloatArray
from skidsteer.windows import Mount, Timing

SHARED = ("lag", "mount_x", "mount_y", "mount_yaw")
OF_DRIVE = ("time_offset", "gyro_time_offset", "gyro_bias", "gyro_scale")
UNITS = dict(zip((*SHARED, *OF_DRIVE), ("s", "m", "m", "rad", "s", "s", "rad/s", ""), strict=True))
PRIOR_SIGMA = dict(zip((*SHARED, *OF_DRIVE), (0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 0.02, 0.01), strict=True))
LIMITS = dict(
    zip(
        (*SHARED, *OF_DRIVE),
        ((0.0, 2.0), (-5.0, 5.0), (-5.0, 5.0), (-4.0, 4.0), (-10.0, 10.0), (-10.0, 10.0), (-0.2, 0.2), (0.8, 1.2)),
        strict=True,
    )
)


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """One point of the search: the vector x (m,), and what its entries mean.

    Order: parameters of the model, lag, mounting (x, y, yaw), then for each drive time offset of the reference and time
    offset, bias and scale of the gyro.
    """

    family: Model
    x: FloatArray
    drives: int

    def at(self, x: FloatArray) -> Unknowns:
        """The same unknowns with other values."""
        return Unknowns(self.family, x, self.drives)

    @property
    def p(self) -> int:
        """Number of the model's parameters."""
        return len(self.family.PARAMETERS)

    @property
    def model(self) -> Model:
        """The model at this point."""
        return self.family.with_theta(self.x[: self.p])

    @property
    def mount(self) -> Mount:
        """The mounting at this point."""
        return Mount(*self.x[self.p + 1 : self.p + 4].tolist())

    def timing(self, drive: int) -> Timing:
        """Time offset of a drive's reference, and the lag."""
        return Timing(float(self.x[self._of(drive)]), float(self.x[self.p]))

    def gyro(self, drive: int) -> GyroErrors:
        """What a drive's gyro is wrong by."""
        first = self._of(drive)
        return GyroErrors(*self.x[first + 1 : first + 4].tolist())

    def columns(self, drive: int) -> np.ndarray:
        """Indices (p + 8,) into x of what the motions of one drive depend on."""
        first = self._of(drive)
        return np.concatenate([np.arange(self.p + 4), np.arange(first, first + 4)])

    def _of(self, drive: int) -> int:
        return self.p + 4 + 4 * drive

    def names(self, drives: list[Drive]) -> tuple[str, ...]:
        """A name for each entry; those of several drives carry the drive's name."""
        tails = [f":{d.name}" for d in drives] if self.drives > 1 else [""]
        own = [p.name for p in self.family.PARAMETERS]
        return (*own, *SHARED, *(name + tail for tail in tails for name in OF_DRIVE))

    def bounds(self, drives: list[Drive]) -> FloatArray:
        """Lower and upper limit (m, 2) of each entry."""
        nuisance = [LIMITS[name] for name in (*SHARED, *OF_DRIVE * self.drives)]
        limits: FloatArray = np.concatenate([type(self.family).bounds(drives[0].vehicle), np.array(nuisance)])
        return limits

    def prior_sigma(self, drives: list[Drive]) -> FloatArray:
        """What is known of each entry before the drive, (m,): for parameters the spread of their bounds."""
        bounds = type(self.family).bounds(drives[0].vehicle)
        nuisance = [PRIOR_SIGMA[name] for name in (*SHARED, *OF_DRIVE * self.drives)]
        return np.asarray(np.concatenate([(bounds[:, 1] - bounds[:, 0]) / np.sqrt(12.0), np.array(nuisance)]))
