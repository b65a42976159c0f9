"""One of Thalmann's filters over a whole drive, in a compiled loop: encoders, and positions while they are seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Series
from skidsteer.errors import DataError
from skidsteer.kernels import thalmann as kernels
from skidsteer.odometry.kinematic_ekf import KinematicEkf
from skidsteer.odometry.reference_update import threshold
from skidsteer.odometry.state import FilterState, refuse_foreign
from skidsteer.se2 import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Tracking:
    """Positions (p, 2) [m] of a target on the robot, as of a total station.

    Raises:
        DataError: noise that is not positive, a mounting that is not finite.
    """

    positions: Series  # stamps on the reference's clock
    sigma: float = 0.01  # [m] of a position, each axis
    stamp_sigma: float = 0.0  # [s] of a stamp: at speed it moves a position along its path
    time_offset: float = 0.0  # [s] by which the stamps are late
    lever: tuple[float, float] = (0.0, 0.0)  # [m] place of the target on the robot

    def __post_init__(self) -> None:
        if self.positions.values.shape[1] != 2:
            raise DataError(f"tracking tells x and y, got {self.positions.values.shape[1]} columns")
        numbers = [self.sigma, self.stamp_sigma, self.time_offset, *self.lever]
        if not (np.isfinite(numbers).all() and self.sigma > 0.0 and self.stamp_sigma >= 0.0):
            raise DataError(f"tracking needs finite numbers and a sigma above 0, got {numbers}")

    @property
    def t(self) -> FloatArray:
        """Times (p,) [s] of the positions on the clock of the wheels."""
        return self.positions.t - self.time_offset


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """A filter over a drive. A state at a wheel sample is that before the sample is taken, to continue from."""

    t: FloatArray  # (n,) [s] of the wheel samples
    means: FloatArray  # (n, m)
    covariances: FloatArray  # (n, m, m), or (0, m, m) if not kept
    statistic: FloatArray  # (n,) T of the compatibility test, Thalmann 2016, Eq. (10)
    taken: np.ndarray  # (n, 2) bool: the motion parameters whose observation was taken
    seen_t: FloatArray  # (p,) [s] of the positions between the first and the last wheel sample
    seen: FloatArray  # (p, 2) [m] as measured
    expected: FloatArray  # (p, 2) [m] of the target by the filter, after the update where there was one
    seen_statistic: FloatArray  # (p,) normalised innovation squared; NaN where the position was not used
    seen_deviance: FloatArray  # (p,) -2 log likelihood of the position, less a constant; zero where it was not used
    seen_taken: np.ndarray  # (p,) bool
    last: FilterState  # after everything

    @property
    def deviance(self) -> float:
        """-2 log likelihood of all positions used, less a constant."""
        return float(self.seen_deviance.sum())

    def state(self, filter: KinematicEkf, index: int) -> FilterState:
        """The state at a wheel sample.

        Raises:
            DataError: the covariances were not kept.
        """
        if not len(self.covariances):
            raise DataError("the covariances of this replay were not kept")
        return FilterState(
            filter.fingerprint, float(self.t[index]), self.means[index].copy(), self.covariances[index].copy()
        )


def replay(
    filter: KinematicEkf,
    start: FilterState,
    wheels: Series,
    tracking: Tracking | None = None,
    lost: tuple[float, float] | None = None,
    covariances: bool = True,
) -> Replay:
    """Run a filter over the wheel samples from its state's time on: the same steps as ``predict`` and ``update``.

    Args:
        filter: of the state.
        start: at or before the first wheel sample used; samples before it are not used.
        wheels: (n, 2) rim speeds [m/s].
        tracking: positions; None: encoders alone.
        lost: [s] first and last time, wheel clock, of the positions that are not taken.
        covariances: keep the covariance at every sample.

    Raises:
        DataError: no wheel sample at or after the state's time.
        RequestError: a state of another filter.
    """
    refuse_foreign(start, filter.fingerprint)
    first = int(np.searchsorted(wheels.t, start.time))
    t, z = wheels.t[first:], filter.observed(wheels.values[first:])
    if not len(t):
        raise DataError(f"no wheel sample at or after {start.time:.3f} s")
    mean, P = start.mean.copy(), start.covariance.copy()
    if t[0] > start.time:
        kernels.advance(mean, P, float(t[0] - start.time), *filter.dynamics)
    seen_t, seen = (np.zeros(0), np.zeros((0, 2))) if tracking is None else (tracking.t, tracking.positions.values)
    keep = (seen_t >= t[0]) & (seen_t <= t[-1])
    seen_t, seen = seen_t[keep], np.ascontiguousarray(seen[keep])
    used = np.ones(len(seen_t), dtype=np.bool_)
    if lost is not None:
        used &= (seen_t < lost[0]) | (seen_t > lost[1])
    n, p, m = len(t), len(seen_t), len(mean)
    noise = np.array([tracking.sigma, tracking.stamp_sigma] if tracking else [1.0, 0.0])
    lever = np.array(tracking.lever if tracking else (0.0, 0.0))
    means, kept = np.empty((n, m)), np.empty((n if covariances else 0, m, m))
    T, taken = np.empty(n), np.empty((n, 2), dtype=np.bool_)
    seen_means, seen_T, seen_deviance = np.empty((p, m)), np.empty(p), np.empty(p)
    seen_taken = np.zeros(p, dtype=np.bool_)
    out = (means, kept, T, taken, seen_means, seen_T, seen_deviance, seen_taken)
    gate = threshold(filter.gate, 2)
    loop: Callable[..., None] = kernels.replay
    inputs = (t, z, seen_t, seen, used, noise, lever, gate, mean, P)
    loop(*inputs, *filter.dynamics, *filter.encoders, *out)
    c, s = np.cos(seen_means[:, 2]), np.sin(seen_means[:, 2])
    expected = seen_means[:, :2] + np.stack([c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]], axis=1)
    end = FilterState(filter.fingerprint, float(t[-1]), mean, P)
    return Replay(t, means, kept, T, taken, seen_t, seen, expected, seen_T, seen_deviance, seen_taken, end)
