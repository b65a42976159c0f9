"""What all filters share: state, measurements, and the two pure functions that lead to the next state.

Times are on the clock of the wheels; stamps of reference and gyro are corrected before. ``skidsteer.odometry.timeline``
takes measurements that arrive late at their own time.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import DataError, RequestError
from skidsteer.se2 import FloatArray
from skidsteer.windows import Mount

ORIGIN = Mount()
SAME_TIME = 1e-6  # [s] within which two times are the same
ROUNDING = 1e-9  # asymmetry of a covariance, relative to both sigmas, that is taken for rounding


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """The state of a filter at one time. Immutable; the arrays are made read-only, not copied.

    ``memory`` holds what the filter carries beside mean and covariance, such as lagged speeds.
    """

    filter: str  # fingerprint of its filter
    time: float  # [s] on the clock of the wheels
    mean: FloatArray  # (n,): x, y [m] and yaw [rad] of base_link first, the yaw unwrapped
    covariance: FloatArray  # (n, n)
    memory: FloatArray = field(default_factory=lambda: np.zeros(0))  # (m,)

    def __post_init__(self) -> None:
        self.mean.setflags(write=False)
        self.covariance.setflags(write=False)
        self.memory.setflags(write=False)

    @property
    def pose(self) -> FloatArray:
        """X, y [m], yaw [rad] of base_link, (3,)."""
        return self.mean[:3]

    @property
    def pose_covariance(self) -> FloatArray:
        """Covariance of ``pose``, (3, 3)."""
        return self.covariance[:3, :3]


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A reference pose, of a sensor at ``mount`` on the robot."""

    time: float  # [s] at which it holds
    pose: FloatArray  # (3,) x, y [m], yaw [rad]
    covariance: FloatArray  # (3, 3)
    stamp: float = 0.0  # [s] standard deviation of ``time``: at speed it moves the pose along its own path
    mount: Mount = ORIGIN


@dataclass(frozen=True, slots=True, eq=False)
class Position:
    """A reference position, of a sensor at ``mount`` on the robot (the lever arm; its yaw does not matter)."""

    time: float  # [s] at which it holds
    position: FloatArray  # (2,) x, y [m]
    covariance: FloatArray  # (2, 2)
    stamp: float = 0.0  # [s] standard deviation of ``time``
    mount: Mount = ORIGIN


@dataclass(frozen=True, slots=True)
class YawRate:
    """A gyro's yaw rate as measured, the mean over the ``duration`` before ``time``."""

    time: float  # [s] at which it ends
    rate: float  # [rad/s]
    variance: float  # [(rad/s)^2] of that mean
    duration: float = 0.0  # [s]; 0: since the state before the last prediction


@dataclass(frozen=True, slots=True)
class Standstill:
    """The robot stands still at ``time``, whatever its wheels do."""

    time: float  # [s]


Measurement = Pose | Position | YawRate | Standstill


@dataclass(frozen=True, slots=True)
class Innovation:
    """Result of an update."""

    squared: float  # normalised innovation squared (NIS): chi-square with ``dof`` where the covariances are right
    dof: int
    accepted: bool  # False: gated out, the state kept its mean and covariance
    anchored: bool = False  # the pose was set to a reference that disagreed with the state, but not with itself


class Filter(Protocol):
    """A filter: its options are its fields, its estimate is in the state. Every function is pure."""

    @property
    def fingerprint(self) -> str:
        """Name and hash of all that the filter depends on: a state of another one is refused."""

    @property
    def names(self) -> tuple[str, ...]:
        """What the mean holds, (n,); x, y, yaw first."""

    def start(self, time: float, pose: ArrayLike, covariance: ArrayLike) -> FilterState:
        """The initial state: pose (3,) and its covariance (3, 3), positive definite."""

    def predict(self, state: FilterState, wheels: tuple[float, float] | None, dt: float) -> FilterState:
        """The state after rim speeds v_left, v_right [m/s] were held for dt [s]; None: they are unknown.

        Raises:
            DataError: time goes backwards, or speeds or time are not finite; a dt of zero changes nothing.
            RequestError: a state of another filter.
        """

    def hold(self, state: FilterState, wheels: tuple[float, float] | None, dt: float) -> FilterState:
        """As ``predict``, for speeds that are still held: no new sample has come."""

    def update(self, state: FilterState, measurement: Measurement) -> tuple[FilterState, Innovation]:
        """The state with a measurement that holds at the state's time.

        Raises:
            DataError: the measurement holds at another time, is not finite, or its covariance not positive definite.
            RequestError: a state of another filter, or a measurement that the filter cannot use.
        """


def fingerprint(name: str, *parts: object) -> str:
    """Name and hash of a filter from all that it depends on; floats count to the last bit, arrays by their values."""
    plain = [part.tolist() if isinstance(part, np.ndarray) else part for part in parts]
    return f"{name}-{hashlib.sha256(repr(plain).encode()).hexdigest()[:16]}"


def refuse_foreign(state: FilterState, expected: str) -> None:
    """Refuse a state of another filter.

    Raises:
        RequestError: the fingerprint is not the expected one.
    """
    if state.filter != expected:
        raise RequestError(
            f"the state belongs to the filter {state.filter}, not to {expected};"
            " go on with the filter and calibration that it was made with, or start anew"
        )


def symmetric(what: str, covariance: ArrayLike) -> FloatArray:
    """A copy of a covariance (n, n), made exactly symmetric where rounding, as of a rotation, left it off.

    Raises:
        DataError: not square, not finite, or not symmetric.
    """
    P = np.array(covariance, dtype=float)
    if P.ndim != 2 or P.shape[0] != P.shape[1]:
        raise DataError(f"{what}: a covariance is square, got shape {P.shape}")
    sigma = np.sqrt(np.abs(np.diag(P)))
    if not (np.isfinite(P).all() and (np.abs(P - P.T) <= ROUNDING * np.outer(sigma, sigma)).all()):
        raise DataError(f"{what}: the covariance must be finite and symmetric")
    return np.asarray(0.5 * (P + P.T))


def refuse_indefinite(what: str, covariance: ArrayLike) -> FloatArray:
    """A copy of a covariance (n, n).

    Raises:
        DataError: not square, not finite, not symmetric, or not positive definite.
    """
    P = symmetric(what, covariance)
    try:
        np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        least = float(np.linalg.eigvalsh(P)[0])
        raise DataError(f"{what}: the covariance is not positive definite, its least eigenvalue is {least:g}") from None
    return P
