"""A drive as input of a filter: wheels, reference and gyro on the clock of the wheels, event by event."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.evaluation import mount
from skidsteer.gyro import rough_errors
from skidsteer.odometry.state import ORIGIN, Filter, FilterState, Measurement, Pose, Position, YawRate
from skidsteer.se2 import FloatArray
from skidsteer.windows import MAX_GAP, Mount


@dataclass(frozen=True, slots=True)
class Step:
    """Rim speeds v_left, v_right [m/s] held for dt [s]; None: unknown."""

    wheels: tuple[float, float] | None
    dt: float
    sampled: bool = True  # a wheel sample was taken at its beginning

    def taken(self, filter: Filter, state: FilterState) -> FilterState:
        """The state after it."""
        return (filter.predict if self.sampled else filter.hold)(state, self.wheels, self.dt)


Event = Step | Measurement


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """Series on the clock of the wheels, and their noise."""

    wheels: Series  # (k, 2) v_left, v_right [m/s], held from sample to sample
    reference: Series | None = None  # (m, 3) poses, or (m, 2) positions
    covariance: FloatArray | None = None  # (3, 3) or (2, 2) of each reference
    stamp: float = 0.0  # [s] standard deviation of the reference's stamps
    mount: Mount = ORIGIN
    gyro: Series | None = None  # (g, 1) yaw rate as measured [rad/s]
    gyro_walk: float = 1e-4  # [rad^2/s] variance of the gyro's turn, after a second

    def without(self, lost: tuple[float, float]) -> Log:
        """The log without the reference from lost[0] to lost[1] [s]."""
        if self.reference is None:
            return self
        keep = (self.reference.t < lost[0]) | (self.reference.t > lost[1])
        kept = Series(self.reference.t[keep], self.reference.values[keep], self.reference.name) if keep.any() else None
        return replace(self, reference=kept)

    @property
    def dof(self) -> int:
        """Dimension of a reference; 0 without one."""
        return 0 if self.reference is None else self.reference.values.shape[1]

    def events(self) -> Iterator[list[Event]]:
        """For each wheel stamp the events since the previous one, in the order of time.

        Steps end at the stamps of wheels, gyro and reference; a gyro measures the mean rate between two of its stamps.
        """
        t, gyro_t, when = self.wheels.t, self._stamps(self.gyro), self._stamps(self.reference)
        now, g, k = t[0], int(np.searchsorted(gyro_t, t[0], side="right")), int(np.searchsorted(when, t[0]))
        for i in range(len(t)):
            happens: list[Event] = []
            known = i > 0 and t[i] - t[i - 1] <= MAX_GAP
            wheels = (float(self.wheels.values[i - 1, 0]), float(self.wheels.values[i - 1, 1])) if known else None
            while True:
                while k < len(when) and when[k] == now:
                    happens.append(self._seen(k))
                    k += 1
                if now == t[i]:
                    break
                until = min([t[i], *gyro_t[g : g + 1], *when[k : k + 1]])
                happens.append(Step(wheels, float(until - now), bool(now == t[i - 1])))
                if 0 < g < len(gyro_t) and gyro_t[g] - gyro_t[g - 1] <= MAX_GAP:
                    happens.append(self._rate(g, float(until), float(until - now)))
                g += int(g < len(gyro_t) and gyro_t[g] == until)
                now = until
            yield happens

    @staticmethod
    def _stamps(series: Series | None) -> FloatArray:
        return np.zeros(0) if series is None else series.t

    def _rate(self, g: int, until: float, dt: float) -> YawRate:
        assert self.gyro is not None
        rate = 0.5 * float(self.gyro.values[g - 1, 0] + self.gyro.values[g, 0])
        return YawRate(until, rate, self.gyro_walk / dt)

    def _seen(self, k: int) -> Pose | Position:
        assert self.reference is not None
        assert self.covariance is not None
        kind = Pose if self.reference.values.shape[1] == 3 else Position
        return kind(float(self.reference.t[k]), self.reference.values[k], self.covariance, self.stamp, self.mount)


def log_of(
    calibration: Calibration,
    drive: Drive,
    time_offset: float | None = None,
    reference: bool = True,
    gyro: bool = True,
) -> Log:
    """The log of a drive, with noise, mounting and clocks of a calibration.

    The clock of the gyro is set by the correlation of its rate with the wheels, which needs the whole drive.

    Args:
        calibration: of the robot.
        drive: to be replayed.
        time_offset: [s] of the reference; None: that of the calibration.
        reference: whether to use it.
        gyro: whether to use it.

    Raises:
        RequestError: a drive of separate windows, which has no single trajectory.
    """
    if drive.segments is not None:
        raise RequestError(
            f"{drive.name}: is a set of separate windows, between which neither time nor pose goes on;"
            " odometry needs one continuous drive"
        )
    noise, seen = calibration.noise, drive.reference if reference else None
    rates = drive.gyro if gyro else None
    if seen is not None:
        offset = calibration.timing.time_offset if time_offset is None else time_offset
        seen = Series(seen.t - offset, seen.values, seen.name)
    if rates is not None:
        late = rough_errors(drive.wheels, rates, calibration.model, calibration.timing.lag).time_offset
        rates = Series(rates.t - late, rates.values, rates.name)
    variance = np.array([noise.position**2, noise.position**2, noise.yaw**2])
    columns = 3 if seen is None else seen.values.shape[1]
    covariance = np.diag(variance[:columns])
    return Log(drive.wheels, seen, covariance, noise.stamp, mount(calibration, drive), rates, noise.gyro**2)
