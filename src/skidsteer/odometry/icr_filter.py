"""A filter of our own, over any calibrated model, whose parameters are states, so that it follows the ground.

States: pose of base_link, the parameters that the calibration found (five for the ICR model), and with a gyro its bias.

- *Motion*: the calibrated model, exact on SE(2), driven by rim speeds with the calibrated lag. The two lagged speeds
  are deterministic, hence memory and not states. The noise is that of the calibration: a random walk of
  position and yaw with the distance rolled. At rest nothing grows.
- *Parameters* follow a Gauss-Markov process over the distance rolled, whose centre is the estimate: their variance
  grows at first by 2 variation^2 / reach per metre, never beyond that of the calibration plus variation^2, while the
  estimate stays until a reference corrects it.
- *A gyro* measures the true turn of each step, noise of the wheels included, and its bias.
- *References* are gated by chi-square. One that is refused ``patience`` times in a row, but moves as the wheels do in
  between, has jumped: the pose is set to it, the parameters stay. One that jumps again ``soon``, or is refused ``lost``
  times in a row however it moves, indicates another ground: the pose is set to it, and the parameters get their full
  variance at once.
- *Gaps* of more than a second in the wheels: the pose stays, its variance grows by (1 m)^2 and (1 rad)^2 a second.
- *At rest*: rims that stand still add no noise, so that the bias of a gyro is observed there; ``Standstill`` says that
  the body is at rest whatever the rims do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from skidsteer.calibration import Calibration
from skidsteer.errors import DataError, RequestError
from skidsteer.kernels import icr_filter as kernel
from skidsteer.kernels.icr_filter import Setup
from skidsteer.kernels.icr_update import take_reference, take_yaw_rate
from skidsteer.kernels.twists import KINDS
from skidsteer.models import Model
from skidsteer.noise import Noise
from skidsteer.odometry.state import (
    SAME_TIME,
    FilterState,
    Innovation,
    Measurement,
    Pose,
    Standstill,
    YawRate,
    fingerprint,
    refuse_foreign,
    refuse_indefinite,
)
from skidsteer.se2 import FloatArray
from skidsteer.windows import MAX_GAP

GAP_WALK, GAP_TURN = 1.0, 1.0  # [m/sqrt(s)], [rad/sqrt(s)] random walk while nothing is known of the wheels


@dataclass(frozen=True, slots=True)
class FilterOptions:
    """Tuning; the defaults should not need to change."""

    adapt: bool = True  # False: references and gyro correct the pose only; the parameters stay
    variation: float = 0.03  # of a parameter from ground to ground, as a share of the width of its bounds (1 sigma)
    reach: float = 1000.0  # [m] rolled, correlation length of the parameters on one ground
    confidence: float = 0.999  # share of correct measurements that pass the gates
    patience: int = 5  # consistent refusals in a row after which the pose is set to the reference
    lost: int = 15  # refusals in a row after which it is set in any case
    soon: int = 20  # updates after a jump in which a second one counts as a change of the ground
    bias_sigma: float = 0.02  # [rad/s] of the gyro's bias at the start
    bias_walk: float = 1e-4  # [rad/s/sqrt(s)] of the gyro's bias

    def __post_init__(self) -> None:
        positive = ("variation", "reach", "bias_sigma", "bias_walk", "patience", "lost", "soon")
        for name in positive:
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name)}")
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"need 0 < confidence < 1, got {self.confidence}")


@dataclass(frozen=True, slots=True, eq=False)
class IcrFilter:
    """The filter. Make it with ``of``.

    ``theta_covariance`` (q, q) is that of the parameters ``free``; with ``gyro`` the last state is the gyro's bias.
    """

    model: Model
    free: tuple[str, ...]  # parameters that are states
    theta_covariance: FloatArray
    bounds: FloatArray  # (q, 2) of the free parameters
    noise: Noise
    lag: float = 0.0  # [s]
    gyro: bool = False
    gyro_scale: float = 1.0  # true over measured rate
    options: FilterOptions = FilterOptions()
    setup: FloatArray = field(init=False)  # packed, for the compiled loops
    fingerprint: str = field(init=False)

    def __post_init__(self) -> None:
        if self.model.NAME not in KINDS:
            raise RequestError(f"no filter for the model {self.model.NAME}; there is one for {', '.join(KINDS)}")
        setup = kernel.packed(_setup(self))
        setup.setflags(write=False)
        object.__setattr__(self, "setup", setup)
        object.__setattr__(self, "fingerprint", fingerprint("icr", self.free, self.gyro, setup))

    @classmethod
    def of(cls, calibration: Calibration, gyro: bool = False, options: FilterOptions = FilterOptions()) -> IcrFilter:
        """The filter of a calibration; states are the parameters that it did not fix.

        Raises:
            DataError: the covariance of the calibration is not positive definite.
        """
        free = tuple(name for name, e in calibration.parameters.items() if e.sigma > 0.0)
        index = [calibration.names.index(name) for name in free]
        covariance = calibration.covariance[np.ix_(index, index)]
        bounds = dict(zip(calibration.parameters, type(calibration.model).bounds(calibration.vehicle), strict=True))
        return cls(
            calibration.model,
            free,
            refuse_indefinite("calibration", covariance) if free else np.zeros((0, 0)),
            np.array([bounds[name] for name in free]).reshape(-1, 2),
            calibration.noise,
            calibration.timing.lag,
            gyro,
            _gyro_scale(calibration),
            options,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """What the mean holds, (n,)."""
        return ("x", "y", "yaw", *self.free, *(("gyro_bias",) if self.gyro else ()))

    def start(self, time: float, pose: ArrayLike = (0.0, 0.0, 0.0), covariance: ArrayLike | None = None) -> FilterState:
        """The state at the beginning.

        Args:
            time: [s] on the clock of the wheels.
            pose: (3,) of base_link.
            covariance: (3, 3) of the pose; None: known to a micrometre.

        Raises:
            DataError: a covariance that is not positive definite, or numbers that are not finite.
        """
        pose = np.asarray(pose, dtype=float)
        if pose.shape != (3,) or not (np.isfinite(pose).all() and np.isfinite(time)):
            raise DataError(f"a start needs a finite time and x, y, yaw; got {time} and {pose.tolist()}")
        P_pose = refuse_indefinite("start", 1e-12 * np.eye(3) if covariance is None else covariance)
        theta = [getattr(self.model, name) for name in self.free]
        n, q = len(self.names), len(theta)
        mean, P, memory = np.zeros(n), np.zeros((n, n)), np.zeros(kernel.CROSS + n)
        mean[:3], mean[3 : 3 + q] = pose, theta
        P[:3, :3], P[3 : 3 + q, 3 : 3 + q] = P_pose, self.theta_covariance
        if self.gyro:
            P[-1, -1] = self.options.bias_sigma**2
        memory[[kernel.LEFT, kernel.RIGHT]] = np.nan
        return FilterState(self.fingerprint, float(time), mean, P, memory)

    def predict(self, state: FilterState, wheels: tuple[float, float] | None, dt: float) -> FilterState:
        """The state after rim speeds v_left, v_right [m/s] have been held for dt [s]; see ``Filter.predict``.

        None for the speeds: nothing is known of them, as for a dt of more than a second.
        """
        if state.filter != self.fingerprint:
            refuse_foreign(state, self.fingerprint)
        left, right = (math.nan, math.nan) if wheels is None else wheels
        if not (0.0 < dt <= MAX_GAP and math.isfinite(left + right)):
            if _refuse_step(wheels, dt) == 0.0:
                return state
            if dt > MAX_GAP:
                left = right = math.nan
        mean, P, memory = state.mean.copy(), state.covariance.copy(), state.memory.copy()
        kernel.step(mean, P, memory, self.setup, left, right, dt)
        return FilterState(self.fingerprint, state.time + dt, mean, P, memory)

    def hold(self, state: FilterState, wheels: tuple[float, float] | None, dt: float) -> FilterState:
        """See ``Filter.hold``: a sample is an input, not an observation, so that this is ``predict``."""
        return self.predict(state, wheels, dt)

    def update(self, state: FilterState, measurement: Measurement) -> tuple[FilterState, Innovation]:
        """The state with a measurement that holds at the state's time; see ``Filter.update``.

        A yaw rate is the mean over the last step, and must be given right after it.
        """
        refuse_foreign(state, self.fingerprint)
        if not abs(measurement.time - state.time) <= SAME_TIME:
            raise DataError(
                f"a measurement at {measurement.time:.6f} s for a state at {state.time:.6f} s; predict up to it first,"
                " or let a Timeline take what is late"
            )
        mean, P, memory = state.mean.copy(), state.covariance.copy(), state.memory.copy()
        squared, dof, flag = self._measure(mean, P, memory, measurement)
        after = FilterState(self.fingerprint, state.time, mean, P, memory)
        anchored = flag == kernel.ANCHORED_FLAG
        return after, Innovation(squared, dof, flag == kernel.ACCEPTED_FLAG, anchored)

    def _measure(
        self, mean: FloatArray, P: FloatArray, memory: FloatArray, measurement: Measurement
    ) -> tuple[float, int, int]:
        """Take a measurement into mean, covariance and memory, in place: squared innovation, dof, flag."""
        if isinstance(measurement, Standstill):
            memory[[kernel.LEFT, kernel.RIGHT, kernel.SINCE]] = 0.0
            return 0.0, 0, kernel.ACCEPTED_FLAG
        if isinstance(measurement, YawRate):
            return self._measure_rate(mean, P, memory, measurement)
        seen = measurement.pose if isinstance(measurement, Pose) else measurement.position
        dof = 3 if isinstance(measurement, Pose) else 2
        seen, R = np.array(seen, dtype=float), refuse_indefinite("measurement", measurement.covariance)
        if seen.shape != (dof,) or R.shape != (dof, dof):
            raise DataError(f"a measurement of {dof} numbers and their covariance, got {seen.shape} and {R.shape}")
        if not (np.isfinite(seen).all() and 0.0 <= measurement.stamp < math.inf):
            raise DataError(f"the measurement at {measurement.time:.3f} s is NaN or infinite; leave it out")
        mount = np.array([measurement.mount.x, measurement.mount.y, measurement.mount.yaw])
        squared, flag = take_reference(mean, P, memory, self.setup, seen, R, measurement.stamp, mount)
        return squared, dof, flag

    def _measure_rate(
        self, mean: FloatArray, P: FloatArray, memory: FloatArray, measurement: YawRate
    ) -> tuple[float, int, int]:
        if not self.gyro:
            raise RequestError("this filter has no gyro; make it with IcrFilter.of(calibration, gyro=True)")
        if not (math.isfinite(measurement.rate) and 0.0 < measurement.variance < math.inf):
            raise DataError(
                f"the yaw rate at {measurement.time:.3f} s needs finite numbers and a positive variance, got"
                f" {measurement.rate} and {measurement.variance}"
            )
        if not memory[kernel.SINCE] > 0.0:
            raise DataError("a yaw rate is told right after the step that it is the mean over; predict first")
        if measurement.duration and abs(measurement.duration - memory[kernel.SINCE]) > SAME_TIME:
            raise DataError(
                f"a yaw rate over {measurement.duration:g} s for a step of {memory[kernel.SINCE]:g} s;"
                " let a Timeline divide it"
            )
        innovation, S, flag = take_yaw_rate(mean, P, memory, self.setup, measurement.rate, measurement.variance)
        return innovation**2 / S, 1, flag


def _refuse_step(wheels: tuple[float, float] | None, dt: float) -> float:
    """The dt of a step that may be taken.

    Raises:
        DataError: time goes backwards, or speeds or time are not finite.
    """
    if not math.isfinite(dt) or dt < 0.0:
        raise DataError(f"time goes backwards or is not finite: dt = {dt} s; leave the sample out and go on")
    if wheels is not None and not (math.isfinite(wheels[0]) and math.isfinite(wheels[1])):
        raise DataError(f"rim speeds {wheels[0]}, {wheels[1]} are NaN or infinite; leave the sample out and go on")
    return dt


def _gyro_scale(calibration: Calibration) -> float:
    """Median of the gyro's scales over the drives of a calibration; 1 where it knows none."""
    known = [e.value for name, e in calibration.nuisance.items() if name.startswith("gyro_scale")]
    return float(np.median(known)) if known else 1.0


def _setup(f: IcrFilter) -> Setup:
    o, s = f.options, np.zeros(kernel.SETTINGS)
    s[kernel.KIND], s[kernel.TRACK] = KINDS[f.model.NAME], getattr(f.model, "track_width", 1.0)
    s[kernel.LAG], s[kernel.WALK], s[kernel.TURN] = f.lag, f.noise.walk**2, f.noise.turn**2
    s[kernel.REACH], s[kernel.BIAS_WALK], s[kernel.GYRO_SCALE] = (
        o.reach if o.adapt else np.inf,
        o.bias_walk**2,
        f.gyro_scale,
    )
    s[kernel.LONGEST], s[kernel.GAP_WALK], s[kernel.GAP_TURN] = MAX_GAP, GAP_WALK**2, GAP_TURN**2
    s[kernel.GATES : kernel.GATES + 3] = chi2.ppf(o.confidence, [1, 2, 3])
    s[kernel.PATIENCE], s[kernel.LOST], s[kernel.SOON], s[kernel.ADAPT] = o.patience, o.lost, o.soon, float(o.adapt)
    variation = o.variation * (f.bounds[:, 1] - f.bounds[:, 0])
    ground = f.theta_covariance + np.diag(variation**2) if o.adapt else f.theta_covariance.copy()
    index = [p.name for p in f.model.PARAMETERS]
    free = np.array([index.index(name) for name in f.free], dtype=float)
    return Setup(s, f.model.theta, free, np.ascontiguousarray(f.bounds), ground)
