"""What a calibration is: a model with covariance, nuisance terms, noise, held-out figures and provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from skidsteer.errors import RequestError
from skidsteer.metrics import Spread, WindowErrors, median_interval
from skidsteer.models import MatrixModel, Model
from skidsteer.multipliers import Projection
from skidsteer.noise import Noise
from skidsteer.prediction import Regions, Uncertainty
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Mount, Timing


@dataclass(frozen=True, slots=True)
class Estimate:
    """One number, its standard deviation, and whether the drive determines it at all.

    Where ``determined`` is False the value is little more than the assumption the search began with.
    """

    value: float
    sigma: float
    unit: str
    determined: bool = True


@dataclass(frozen=True, slots=True)
class MotionSigma:
    """How well what drives tell predicts one motion, and how well it should."""

    motion: str
    sigma: float
    tolerance: float
    unit: str

    @property
    def rounded(self) -> str:
        """Sigma with its unit, two digits."""
        return f"{float(f'{self.sigma:.2g}'):g} {self.unit}"


@dataclass(frozen=True, slots=True)
class WeakDirection:
    """Parameters that can change together, by ``change``: one sigma of what the drives leave open."""

    known: MotionSigma  # the motion that suffers most
    change: Mapping[str, float]  # of each parameter that takes part, in its unit


UNKNOWN = 5.0  # tolerances, above which a motion is not known at all


@dataclass(frozen=True, slots=True)
class Observability:
    """Verdict on drives: what they determine, which combinations they leave open, and what to drive next."""

    model: str  # that the drives are judged by: at least as free as the one that was chosen
    determined: Mapping[str, float]  # sigma of each entry that is known much better than before the drives
    undetermined: Mapping[str, float]  # of the others, but those that move nothing
    motions: tuple[MotionSigma, ...]  # that the model predicts
    weak: tuple[WeakDirection, ...]  # the worst first; empty: the drives determine what matters
    advice: tuple[str, ...]  # what to drive next

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is wanting and what to drive next, in words; none of drives that determine what matters."""
        return (*(self._missing(direction) for direction in self.weak), *self.advice)

    def _missing(self, direction: WeakDirection) -> str:
        known, names = direction.known, list(direction.change)
        motion = f"{known.motion} is known to {known.rounded} only"
        if known.sigma > UNKNOWN * known.tolerance:
            motion = f"{known.motion} is not known"
        if len(names) == 1:
            return f"{motion}: {names[0]} of the {self.model} model is open"
        together = f"{', '.join(names[:-1])} and {names[-1]}"
        return f"{motion}: {together} of the {self.model} model can change together and the drive would look the same"


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Errors of one model on windows that its fit did not see."""

    windows: int
    translation_m: Spread
    yaw_deg: Spread
    yaw_gyro_deg: Spread | None = None
    coverage_68: float | None = None  # share of end poses inside the region that claims 68 %
    coverage_95: float | None = None
    median_95: Mapping[str, tuple[float, float]] | None = None  # 95 % interval of each median; None: too few blocks

    @classmethod
    def of(cls, errors: WindowErrors, regions: Regions | None = None, block: np.ndarray | None = None) -> HeldOut:
        """Figures of window errors; the gyro's only where there is one, the coverage only with regions.

        Intervals of the medians need the block (k,) that each window lies in.
        """
        gyro = Spread.of(np.degrees(errors.yaw_gyro)) if np.isfinite(errors.yaw_gyro).any() else None
        shares: tuple[float | None, float | None] = (None, None)
        if regions is not None and np.isfinite(errors.squared).any():
            shares = (regions.coverage(errors.distances, 0.68), regions.coverage(errors.distances, 0.95))
        sizes = {"translation_m": errors.translation, "yaw_deg": np.degrees(errors.yaw)}
        sizes["yaw_gyro_deg"] = np.degrees(errors.yaw_gyro)
        intervals = {name: median_interval(size, block) for name, size in sizes.items()} if block is not None else {}
        told = {name: interval for name, interval in intervals.items() if interval is not None}
        spreads = Spread.of(errors.translation), Spread.of(np.degrees(errors.yaw)), gyro
        return cls(len(errors), *spreads, *shares, told or None)


@dataclass(frozen=True, slots=True)
class Controller:
    """What the differential drive controller of ROS 2 can know of the model, and its errors on held-out windows."""

    projection: Projection
    held_out: HeldOut | None  # None: too short to hold anything out


@dataclass(frozen=True, slots=True)
class DriveRecord:
    """Which drive a calibration was made from."""

    name: str
    source: str
    sha256: str
    duration: float  # [s]
    windows: int  # reference increments used
    outliers: int  # of them weighed down


@dataclass(frozen=True, slots=True)
class Provenance:
    """How a calibration came to be."""

    drives: tuple[DriveRecord, ...]
    options: Mapping[str, str | float | int | bool | None]
    software: str
    created: str  # ISO 8601, UTC


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A calibrated motion model.

    ``names`` orders ``covariance`` (m, m): the model's parameters, ``lag``, then ``time_offset`` or, for several
    drives, ``time_offset:NAME`` of each. Beside ``profiles``, the calibration itself is for all grounds together.
    """

    vehicle: Vehicle
    model: Model
    names: tuple[str, ...]
    estimates: Mapping[str, Estimate]
    covariance: FloatArray
    noise: Noise
    provenance: Provenance
    method: str = "least-squares"
    selected_because: str = ""
    warnings: tuple[str, ...] = ()
    held_out: Mapping[str, HeldOut] = field(default_factory=dict)
    regions: Regions | None = None  # of end poses after ``window`` seconds; None: too few held-out windows
    observability: Observability | None = None  # None: not judged
    controller: Controller | None = None  # None: not looked at
    profiles: Mapping[str, Calibration] = field(default_factory=dict)  # one for each ground; the same model on each

    def __post_init__(self) -> None:
        covariance = np.array(self.covariance, dtype=float)
        size = len(self.names)
        if covariance.shape != (size, size) or set(self.names) != set(self.estimates):
            raise ValueError(f"covariance {covariance.shape} and estimates must fit the {size} names {self.names}")
        covariance.setflags(write=False)
        object.__setattr__(self, "covariance", covariance)

    def profile(self, name: str | None) -> Calibration:
        """The calibration for one ground; None: for all of them.

        Raises:
            RequestError: no such profile; the message lists those there are.
        """
        if name is None:
            return self
        if name not in self.profiles:
            there = f"there are: {', '.join(self.profiles)}" if self.profiles else "the calibration has none"
            raise RequestError(f"no profile '{name}'; {there}")
        return self.profiles[name]

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Estimates of the model's parameters."""
        return {p.name: self.estimates[p.name] for p in self.model.PARAMETERS}

    @property
    def nuisance(self) -> dict[str, Estimate]:
        """Estimates of what is not the robot's motion: lag and time offsets."""
        return {name: e for name, e in self.estimates.items() if name not in self.parameters}

    @property
    def effective_track_width(self) -> Estimate | None:
        """Width [m] of the differential drive that turns on the spot like this; None where that is not constant."""
        if not isinstance(self.model, MatrixModel):
            return None
        A, jacobian = self.model.matrix(), self.model.matrix_jacobian()
        width = 2.0 / float(A[2, 1] - A[2, 0])
        slope = -0.5 * width**2 * (jacobian[2, 1] - jacobian[2, 0])
        index = [self.names.index(name) for name in self.parameters]
        variance = float(slope @ self.covariance[np.ix_(index, index)] @ slope)
        return Estimate(width, float(np.sqrt(max(variance, 0.0))), "m")

    @property
    def mount(self) -> Mount:
        """Where the reference's sensor sat; the origin where that was not estimated."""
        known = {name: e.value for name, e in self.estimates.items() if name.startswith("mount_")}
        return Mount(*(known.get(f"mount_{axis}", 0.0) for axis in ("x", "y", "yaw")))

    @property
    def reference_kinds(self) -> tuple[str, ...]:
        """What the references of its drives told: pose, position; none where that is not known, or a gyro alone."""
        told = str(self.provenance.options.get("reference") or "")
        return tuple(kind for kind in ("pose", "position") if kind in told.split(","))

    @property
    def uncertainty(self) -> Uncertainty:
        """What a prediction with ``timing`` may be wrong by; time offset and model are taken from the first drive."""
        offset = next((n for n in self.names if n.startswith("time_offset")), None)
        wanted = [*self.parameters, offset, "lag"]
        index = [self.names.index(n) for n in wanted if n in self.names]
        return Uncertainty(self.noise, self.covariance[np.ix_(index, index)])

    @property
    def timing(self) -> Timing:
        """Lag, and the median of the time offsets of the drives: what to expect of a drive from the same set-up."""
        offsets = [e.value for name, e in self.nuisance.items() if name.startswith("time_offset")]
        lag = self.estimates["lag"].value if "lag" in self.estimates else 0.0
        return Timing(float(np.median(offsets)) if offsets else 0.0, lag)
