"""The initial state of a filter for a log: at the origin, or where the reference sees the robot."""

from __future__ import annotations

import numpy as np

from skidsteer.models import Model
from skidsteer.odometry.log import Log
from skidsteer.odometry.state import Filter, FilterState
from skidsteer.se2 import FloatArray, chain, compose, invert
from skidsteer.windows import Timing, Windows, predict

HERE = np.diag([1e-6, 1e-6, 1e-6]) ** 2  # [m^2, m^2, rad^2] of a robot that begins at the origin by definition
ANYWHERE = (100.0, 3.0)  # [m], [rad]: sigma before the first reference is taken
ALIGNED = 0.3  # [rad] sigma of a heading found by alignment: close enough to linearise
STRETCH = 5.0  # [m] of path over which positions are aligned; less than a metre gives no heading


def begin(filter: Filter, log: Log, model: Model, lag: float) -> FilterState:
    """A state at the first wheel stamp.

    Without a reference the robot begins at the origin. With one it begins where the model, run back from the first
    reference, puts it, but with a covariance of ``ANYWHERE``: each reference counts once, when the filter takes it.
    Positions give a heading by aligning the first ``STRETCH`` of them with the path of the model.
    """
    first = float(log.wheels.t[0])
    if log.reference is None:
        return filter.start(first, np.zeros(3), HERE)
    inside = log.reference.between(first, float(log.wheels.t[-1]))
    if inside is None:
        return filter.start(first, np.zeros(3), HERE)
    t = np.concatenate([[first], inside.t])
    if log.dof == 3:
        pose = _run_back(log, model, lag, t[:2], inside.values[0])
        return filter.start(first, pose, np.diag([ANYWHERE[0], ANYWHERE[0], ANYWHERE[1]]) ** 2)
    pose, extent = _align(log, model, lag, t, inside.values)
    return filter.start(first, pose, np.diag([ANYWHERE[0], ANYWHERE[0], ALIGNED if extent > 1.0 else ANYWHERE[1]]) ** 2)


def _path(log: Log, model: Model, lag: float, t: FloatArray) -> FloatArray:
    """Poses (m, 3) of the body at times t (m,) [s], from the origin, by the model alone."""
    windows = Windows(t[:-1], t[1:], np.zeros((len(t) - 1, 3)), np.ones(len(t) - 1, bool))
    return chain(predict(model, log.wheels, windows, Timing(0.0, lag)))


def _run_back(log: Log, model: Model, lag: float, t: FloatArray, seen: FloatArray) -> FloatArray:
    """Pose (3,) at t[0] from that of the reference at t[1]."""
    mount = np.array([log.mount.x, log.mount.y, log.mount.yaw])
    return compose(compose(seen, invert(mount)), invert(_path(log, model, lag, t)[-1]))


def _align(log: Log, model: Model, lag: float, t: FloatArray, seen: FloatArray) -> tuple[FloatArray, float]:
    """Pose (3,) at t[0] that brings the path closest to the first positions (m, 2), and the extent [m] of those."""
    away = np.hypot(*(seen - seen[0]).T)
    last = int(np.argmax(away > STRETCH)) if (away > STRETCH).any() else len(seen) - 1
    body = _path(log, model, lag, t[: last + 2])[1:]
    path = compose(body, np.array([log.mount.x, log.mount.y, 0.0]))[:, :2]
    return closest(path, seen[: last + 1]), float(away[: last + 1].max())


def closest(path: FloatArray, seen: FloatArray) -> FloatArray:
    """Rigid motion (3,) that brings positions (m, 2) closest to others (m, 2), Umeyama 1991, no scale."""
    a, b = path @ [1.0, 1j], seen @ [1.0, 1j]
    turn = np.angle(np.vdot(a - a.mean(), b - b.mean()))
    at = b.mean() - np.exp(1j * turn) * a.mean()
    return np.array([at.real, at.imag, turn])
