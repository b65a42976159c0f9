"""A log through a filter: the trajectory with its covariance, and the innovations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skidsteer.errors import DataError, RequestError
from skidsteer.kernels import icr_filter, icr_replay
from skidsteer.kernels.icr_replay import Nodes, Told
from skidsteer.odometry.icr_filter import IcrFilter
from skidsteer.odometry.log import Log, Step
from skidsteer.odometry.state import Filter, FilterState, Pose, Position, refuse_foreign
from skidsteer.progress import Progress, silent
from skidsteer.se2 import FloatArray

TELLING = 500  # steps between two reports of progress


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """States at the stamps of the wheels, and the innovations of the references between the first and the last."""

    names: tuple[str, ...]  # of what the means hold
    t: FloatArray  # (k,) [s]
    means: FloatArray  # (k, n); x, y [m] and yaw [rad] of base_link first, the yaw unwrapped
    covariances: FloatArray  # (k, 3, 3) of the pose
    seen_t: FloatArray  # (m,) [s]
    squared: FloatArray  # (m,) normalised innovation squared
    dof: int  # of each of them
    accepted: np.ndarray  # (m,) bool
    anchored: np.ndarray  # (m,) bool: refused for long, then taken as the pose
    rates: tuple[int, int]  # yaw rates of a gyro that were accepted, and refused
    last: FilterState
    rate_squared: float = float("nan")  # mean normalised innovation squared of the gyro's rates; NaN without

    @property
    def poses(self) -> FloatArray:
        """X, y [m], yaw [rad] of base_link, (k, 3)."""
        return self.means[:, :3]


def replay(filter: Filter, state: FilterState, log: Log, progress: Progress = silent) -> Trajectory:
    """Run a filter over a log, from a state at its first wheel stamp to its last.

    The filter with ICR states runs in one compiled loop, in the same steps as ``predict`` and ``update``.

    Raises:
        RequestError: the state belongs to another filter.
        DataError: the state is not one at the first wheel stamp.
    """
    _refuse_elsewhere(filter, state, log)
    return _compiled(filter, state, log)[0] if isinstance(filter, IcrFilter) else stepwise(filter, state, log, progress)


def _refuse_elsewhere(filter: Filter, state: FilterState, log: Log) -> None:
    """Refuse a state of another filter, or of another time than that of the first wheel stamp."""
    refuse_foreign(state, filter.fingerprint)
    if state.time != log.wheels.t[0]:
        raise DataError(f"the state is one at {state.time:.6f} s, the wheels begin at {log.wheels.t[0]:.6f} s")


def stepwise(filter: Filter, state: FilterState, log: Log, progress: Progress = silent) -> Trajectory:
    """``replay`` step by step, for any filter."""
    means, covariances, taken, rates, squares = [], [], [], [0, 0], 0.0
    for i, happens in enumerate(log.events()):
        if i % TELLING == 0:
            progress("filtering", i, len(log.wheels))
        for event in happens:
            if isinstance(event, Step):
                state = event.taken(filter, state)
                continue
            state, innovation = filter.update(state, event)
            if isinstance(event, Pose | Position):
                taken.append((event.time, innovation.squared, innovation.accepted, innovation.anchored))
            else:
                rates[0 if innovation.accepted else 1] += 1
                squares += innovation.squared
        means.append(state.mean)
        covariances.append(state.pose_covariance)
    seen_t, squared, accepted, anchored = np.array(taken, dtype=float).reshape(-1, 4).T
    return Trajectory(
        filter.names,
        log.wheels.t,
        np.array(means),
        np.array(covariances),
        seen_t,
        squared,
        log.dof,
        accepted > 0.0,
        anchored > 0.0,
        (rates[0], rates[1]),
        state,
        squares / sum(rates) if sum(rates) else np.nan,
    )


def _compiled(filter: IcrFilter, state: FilterState, log: Log, nodes: int = 0) -> tuple[Trajectory, Nodes, int]:
    """The trajectory, and the first ``nodes`` states after a step, with their number."""
    k, n = len(log.wheels), len(state.mean)
    mean, P, memory = state.mean.copy(), state.covariance.copy(), state.memory.copy()
    measured, gyro = _measurements(log), log.gyro if filter.gyro else None
    gyro_t, rate = (np.zeros(0), np.zeros(0)) if gyro is None else (gyro.t.copy(), gyro.values[:, 0].copy())
    means, covariances, m = np.empty((k, n)), np.empty((k, 3, 3)), len(measured.when)
    squared, flags, rates = np.empty(m), np.empty(m, dtype=np.int64), np.zeros(3)
    room = Nodes(np.empty((nodes, 6)), np.empty((nodes, n)), np.empty((nodes, n, n)), np.empty((nodes, len(memory))))
    wheels = np.ascontiguousarray(log.wheels.values)
    out = (means, covariances, squared, flags, rates, room)
    given = (log.wheels.t, wheels, gyro_t, rate, log.gyro_walk, measured)
    count = icr_replay.replay(mean, P, memory, filter.setup, *given, *out)
    used = flags != icr_filter.UNUSED_FLAG
    flags, end = flags[used], FilterState(filter.fingerprint, float(log.wheels.t[-1]), mean, P, memory)
    accepted, anchored = flags == icr_filter.ACCEPTED_FLAG, flags == icr_filter.ANCHORED_FLAG
    taken, refused, squares = rates.tolist()
    rate_squared = squares / (taken + refused) if taken + refused else np.nan
    seen = (measured.when[used], squared[used], log.dof, accepted, anchored, (int(taken), int(refused)))
    return Trajectory(filter.names, log.wheels.t, means, covariances, *seen, end, rate_squared), room, count


def _measurements(log: Log) -> Told:
    """The references as arrays; positions as poses without a yaw."""
    if log.reference is None or log.covariance is None:
        return Told(
            np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0), np.zeros((0, 3))
        )
    m, dof = len(log.reference), log.dof
    seen, covariance = np.zeros((m, 3)), np.zeros((m, 3, 3))
    seen[:, :dof], covariance[:, :dof, :dof] = log.reference.values, log.covariance
    mount = np.tile([log.mount.x, log.mount.y, log.mount.yaw], (m, 1))
    kind = np.full(m, icr_replay.POSE if dof == 3 else icr_replay.POSITION, dtype=np.int64)
    return Told(log.reference.t.copy(), kind, seen, covariance, np.full(m, log.stamp), mount)


def smooth(filter: Filter, state: FilterState, log: Log) -> Trajectory:
    """As ``replay``, but each state given the whole log: Rauch, Tung and Striebel 1965. For ICR filters that adapt.

    States and covariances of all steps are held in memory.

    Raises:
        RequestError: another filter, or a state of another one.
        DataError: the state is not one at the first wheel stamp.
    """
    if not isinstance(filter, IcrFilter) or not filter.options.adapt:
        raise RequestError("only the filter 'icr' can be smoothed; leave --smooth away")
    _refuse_elsewhere(filter, state, log)
    most = sum(len(s) for s in (log.wheels, log.reference, log.gyro) if s is not None) + 1
    trajectory, nodes, count = _compiled(filter, state, log, most)
    icr_replay.smooth(filter.setup, log.gyro_walk, nodes, count)
    at = np.searchsorted(nodes.step[:count, 0], log.wheels.t, side="right") - 1
    return replace(trajectory, means=nodes.x[at], covariances=nodes.P[at][:, :3, :3])
