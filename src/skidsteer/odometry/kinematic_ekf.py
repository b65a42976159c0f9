"""Thalmann's extended Kalman filters: encoders observe a state that accelerations disturb.

The displayed equations of Thalmann 2016 are lost in the scan at hand; this follows from the text. The state is the
pose (x, y, yaw), two motion parameters m (``state_choice``) and the slip parameters that are to be estimated. Speed v
and yaw rate omega of the robot are those of ``TransferFactor``, Eqs. (6) to (8), of the rim speeds C m. The ideal drive
has both slip ratios at zero and efficiency 1; Thalmann's transfer-factor difference is slip_right, with slip_left = 0.

Time update. With s = v dt, h = omega dt / 2 and the geometry of ``reckoning`` (k = sinc(h) for the arc),

    polygon:   x += s cos(yaw),           y += s sin(yaw),           yaw += 2 h
    arc:       x += s k cos(yaw + h),     y += s k sin(yaw + h),     yaw += 2 h

while m and slips stay. With (c, z) the cosine and sine of the heading of the chord, k = 1 and k' = 0 for the polygon,
k' = dk/dh for the arc, the rows of F - I are

    by yaw           -s k z,   s k c,   0
    by m and slips   k c ds + s (k' c - k z) dh,   k z ds + s (k' z + k c) dh,   2 dh

where the terms + k c dh and - k z dh, the turn of the chord, are those of the arc alone. The disturbance accelerations
a are constant through a step: m += a dt, and the pose moves as with m + a dt / 2, so that the system noise is
G diag(sigma_a^2) G' with G = dt [(F - I)_m / 2; 1]. The slip parameters may follow a random walk in time, and the pose
one with the distance rolled (neither is Thalmann's).

Observations. The encoders first undergo the compatibility test, Eq. (10) (``reference_update``). Where T is above its
threshold the observation is excluded that lowers T the most, by (D^-1 d)_i^2 / (D^-1)_ii, and the rest is tested
again. What is excluded once may be an outlier; what is excluded again and again is motion: each exclusion adds
d^2 / (threshold patience) to the variance of its motion parameter, so that a constant disagreement is believed after
``patience`` samples. An infinite patience is the paper's filter.

Since rim speeds are held from sample to sample, a sample is taken into the state first, then time advances with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import DataError, RequestError, named
from skidsteer.kernels import thalmann as kernels
from skidsteer.models.transfer_factor import TransferFactor
from skidsteer.odometry.reference_update import Moving, threshold, updated
from skidsteer.odometry.state import FilterState, Innovation, Measurement, fingerprint, refuse_foreign, symmetric
from skidsteer.odometry.state_choice import MOTION, Choice, SystemNoise, rims, unit_variance
from skidsteer.se2 import FloatArray

Path = Literal["polygon", "arc"]
Dynamics = tuple[FloatArray, bool, FloatArray, FloatArray, float, FloatArray, FloatArray, FloatArray]
SLIPS = tuple(p.name for p in TransferFactor.PARAMETERS)
PRIOR = {"slip_left": 0.1, "slip_right": 0.1, "efficiency": 0.4}  # sigmas of any skid-steer robot before a drive
START_SPEED = 1.0  # [m/s] standard deviation of each rim's speed before the first sample


@dataclass(frozen=True, slots=True)
class KinematicEkf:
    """One of Thalmann's filters; see the module. It is a ``skidsteer.odometry.state.Filter``.

    Raises:
        RequestError: an unknown state choice, geometry or slip parameter, an impossible significance or patience.
    """

    model: TransferFactor  # slips that are not estimated, and initial values of those that are
    choice: Choice = "speed_difference"
    geometry: Path = "polygon"
    estimated: tuple[str, ...] = ()  # slip parameters in the state
    noise: SystemNoise = field(default_factory=SystemNoise)
    significance: float = 0.001  # of the compatibility test of the encoders; 0: take all
    patience: float = 5.0  # samples after which a constant disagreement is believed
    gate: float = 0.0  # significance at which reference and gyro are gated; 0: take all
    fingerprint: str = field(init=False, repr=False, compare=False)  # name and hash of all of the above
    dynamics: Dynamics = field(init=False, repr=False, compare=False)  # constants of ``kernels.thalmann.advance``
    encoders: tuple[FloatArray, FloatArray, float] = field(init=False, repr=False, compare=False)  # of ``observe``
    inverse: FloatArray = field(init=False, repr=False, compare=False)  # C^-1 (2, 2)

    def __post_init__(self) -> None:
        if self.choice not in MOTION or self.geometry not in ("polygon", "arc"):
            raise RequestError(f"no state choice {self.choice!r} with geometry {self.geometry!r}; there are: {MOTION}")
        if not set(self.estimated) <= set(SLIPS) or len(set(self.estimated)) != len(self.estimated):
            raise RequestError(f"slip parameters are {', '.join(SLIPS)}, each once; got {self.estimated}")
        if not self.patience > 0.0:
            raise RequestError(f"patience must be a positive number of samples, got {self.patience}")
        threshold(self.gate, 1)
        limits = np.array([threshold(self.significance, count) for count in (1, 2)])
        C = rims(self.choice, self.model.track_width)
        where = np.array([5 + self.estimated.index(n) if n in self.estimated else -1 for n in SLIPS], dtype=np.int64)
        noise = self.noise
        derived = {
            "fingerprint": fingerprint("kinematic-ekf", self),
            "dynamics": (
                C,
                self.geometry == "arc",
                self.model.theta,
                where,
                float(self.model.track_width),
                noise.disturbance(self.choice, self.model.track_width),
                np.full(3, noise.drift**2),
                np.array([noise.walk**2, noise.turn**2]),
            ),
            "encoders": (noise.encoder**2 * self._unit_variance(), limits, float(self.patience)),
            "inverse": np.linalg.inv(C),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    def _unit_variance(self) -> FloatArray:
        return unit_variance(self.choice, self.model.track_width)

    @property
    def names(self) -> tuple[str, ...]:
        """What the mean holds."""
        return ("x", "y", "yaw", *MOTION[self.choice], *self.estimated)

    def observed(self, wheels: ArrayLike) -> FloatArray:
        """Motion parameters (..., 2) of rim speeds (..., 2) [m/s]."""
        return np.asarray(np.asarray(wheels, dtype=float) @ self.inverse.T)

    def start(
        self, time: float, pose: ArrayLike, covariance: ArrayLike, known: FilterState | None = None
    ) -> FilterState:
        """The initial state, with unknown speed.

        Args:
            time: [s] on the clock of the wheels.
            pose: (3,) x, y [m], yaw [rad].
            covariance: (3, 3) of the pose; zeros: exactly known.
            known: a state of this filter from an earlier drive, whose slips are taken over with their covariance; None:
                their sigmas are ``PRIOR``.

        Raises:
            DataError: pose or time not finite, a covariance that is not symmetric or negative somewhere.
            RequestError: ``known`` is a state of another filter.
        """
        pose, P = np.asarray(pose, dtype=float), np.asarray(covariance, dtype=float)
        if pose.shape != (3,) or P.shape != (3, 3) or not np.isfinite([time, *pose, *P.ravel()]).all():
            raise DataError(f"a start needs a finite time, x, y and yaw and their covariance, got {time}, {pose}, {P}")
        P = symmetric("start", P)
        if np.linalg.eigvalsh(P)[0] < -1e-12 * np.trace(P):
            raise DataError(f"the covariance of the start must be nowhere negative, got {P.tolist()}")
        first = [getattr(self.model, name) for name in self.estimated]
        spread = [*START_SPEED**2 * self._unit_variance(), *(PRIOR[name] ** 2 for name in self.estimated)]
        full = np.diag(np.r_[np.zeros(3), spread])
        full[:3, :3] = P
        if known is not None:
            refuse_foreign(known, self.fingerprint)
            first, full[5:, 5:] = list(known.mean[5:]), known.covariance[5:, 5:]
        return FilterState(self.fingerprint, float(time), np.r_[pose, 0.0, 0.0, first], full)

    def predict(self, state: FilterState, wheels: tuple[float, float] | None, dt: float) -> FilterState:
        """Take the encoders into the state, then advance it by dt [s].

        In a gap of seconds the motion is taken to continue, and the covariance grows with dt^4.

        Raises:
            DataError: time goes backwards, or speeds or time are not finite; a dt of zero changes nothing.
            RequestError: a state of another filter.
        """
        if not 0.0 <= dt < np.inf:
            raise DataError(f"time must go forwards by a finite step, got dt = {dt} s at {state.time:.3f} s")
        refuse_foreign(state, self.fingerprint)
        if dt == 0.0:
            return state
        mean, P = state.mean.copy(), state.covariance.copy()
        if wheels is None:
            kernels.advance(mean, P, float(dt), *self.dynamics)
        else:
            _refuse_infinite(wheels, state.time)
            left, right, step = float(wheels[0]), float(wheels[1]), float(dt)
            variance, limits, patience = self.encoders
            kernels.step(mean, P, left, right, step, self.inverse, variance, limits, patience, *self.dynamics)
        return FilterState(state.filter, state.time + dt, mean, P)

    def hold(self, state: FilterState, wheels: tuple[float, float] | None, dt: float) -> FilterState:
        """See ``Filter.hold``: a sample is one observation, however many parts its step is cut into."""
        return self.predict(state, None, dt)

    def observe(self, state: FilterState, wheels: tuple[float, float]) -> tuple[FilterState, float, np.ndarray]:
        """Take rim speeds (2,) [m/s] into the state.

        Returns:
            The state at the same time, T of Eq. (10), and a mask (2,) of the motion parameters that were taken.

        Raises:
            DataError: speeds that are not finite.
            RequestError: a state of another filter.
        """
        refuse_foreign(state, self.fingerprint)
        _refuse_infinite(wheels, state.time)
        mean, P, taken = state.mean.copy(), state.covariance.copy(), np.empty(2, dtype=np.bool_)
        T = kernels.observe(mean, P, self.observed(wheels), *self.encoders, taken)
        return FilterState(state.filter, state.time, mean, P), float(T), taken

    def update(self, state: FilterState, measurement: Measurement) -> tuple[FilterState, Innovation]:
        """The state with a measurement that holds at the state's time; gated at ``gate``.

        Raises:
            DataError: the measurement holds at another time, is not finite, or its covariance not positive definite.
            RequestError: a state of another filter.
        """
        refuse_foreign(state, self.fingerprint)
        return updated(state, self.moving(state), measurement, self.gate)

    def moving(self, state: FilterState) -> Moving:
        """The motion in a state."""
        C, _, slips, where, track, *_ = self.dynamics
        D, rolling = np.empty((2, len(state.mean))), np.zeros((2, len(state.mean)))
        v, omega, _ = kernels.twist(state.mean, C, slips, where, track, D)
        rolling[:, 3:5] = C
        return Moving(float(v), float(omega), D[1], C @ state.mean[3:5], rolling)


def _refuse_infinite(wheels: tuple[float, float], time: float) -> None:
    if not (math.isfinite(wheels[0]) and math.isfinite(wheels[1])):
        raise DataError(f"rim speeds must be finite, got {wheels} at {time:.3f} s; leave the sample out")


TABLE_1: dict[str, tuple[Choice, Path, tuple[str, ...]]] = {
    "basic": ("sides", "polygon", ()),
    "arc": ("speed_yaw_rate", "arc", ()),
    "arc_odometry": ("sides", "arc", ()),
    "alternative": ("speed_difference", "polygon", ()),
    "slip_ratios": ("sides", "polygon", ("slip_left", "slip_right")),  # Eq. (7)
    "transfer_difference": ("speed_difference", "polygon", ("slip_right",)),  # Eq. (8)
    "extended": ("speed_difference", "arc", SLIPS),  # ours: with the effective track width
}


def thalmann_filter(name: str, track_width: float, noise: SystemNoise | None = None) -> KinematicEkf:
    """A filter of Thalmann 2016, Table 1 and section 2.4, or ``extended``, for a track width [m].

    Raises:
        RequestError: no such filter.
    """
    choice, geometry, estimated = named(name, "filter", TABLE_1)
    ideal = TransferFactor(0.0, 0.0, 1.0, track_width)
    return KinematicEkf(ideal, choice, geometry, estimated, noise or SystemNoise())
