"""Left is the mirror of right and no place or heading is special, for filters and for the plan in a closed loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from control_loop import PLANT
from odometry_drives import make_filter
from skidsteer.control import Limits, Observer, Predictive, PredictiveGains, Wheels
from skidsteer.drive import Series
from skidsteer.follow import Ends, Run, Sensing, follow
from skidsteer.models import Icr
from skidsteer.models.transfer_factor import TransferFactor
from skidsteer.odometry.icr_filter import IcrFilter
from skidsteer.odometry.kinematic_ekf import TABLE_1, thalmann_filter
from skidsteer.odometry.log import Log
from skidsteer.odometry.state import Filter
from skidsteer.odometry.state_choice import SystemNoise
from skidsteer.odometry.trajectory import Trajectory, replay, smooth
from skidsteer.paths import Path, clothoid, join
from skidsteer.rolling import RollingModel
from skidsteer.se2 import FloatArray, compose
from skidsteer.windows import Mount
from test_odometry_trajectory import busy_log

FLIP = np.array([1.0, -1.0, -1.0])
ELSEWHERE = np.array([30.0, -20.0, 2.1])
HERE = np.zeros(3)
START = np.array([1.0, -2.0, 0.7])
P_START = np.array([[0.02, 0.004, 0.001], [0.004, 0.03, -0.002], [0.001, -0.002, 0.01]])
OTHER = {"icr_y_left": "icr_y_right", "alpha_left": "alpha_right", "slip_left": "slip_right"}
OTHER |= {right: left for left, right in OTHER.items()}


def turned(at: FloatArray) -> FloatArray:
    """What turns the axes of poses to those of a frame at a pose (3,)."""
    c, s = np.cos(at[2]), np.sin(at[2])
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def moved(log: Log, at: FloatArray) -> Log:
    """The same drive in a frame in which it lies elsewhere."""
    assert log.reference is not None
    assert log.covariance is not None
    seen, R, k = log.reference.values, turned(at), log.dof
    values = compose(at, seen) if k == 3 else seen @ R[:2, :2].T + at[:2]
    return replace(
        log, reference=Series(log.reference.t, values), covariance=(R[:k, :k] @ log.covariance @ R[:k, :k].T)
    )


def mirrored(log: Log) -> Log:
    assert log.reference is not None
    assert log.covariance is not None
    assert log.gyro is not None
    M, k = np.diag(FLIP), log.dof
    return replace(
        log,
        wheels=Series(log.wheels.t, log.wheels.values[:, ::-1].copy()),
        reference=Series(log.reference.t, log.reference.values * FLIP[:k]),
        covariance=M[:k, :k] @ log.covariance @ M[:k, :k],
        mount=Mount(log.mount.x, -log.mount.y, -log.mount.yaw),
        gyro=Series(log.gyro.t, -log.gyro.values),
    )


def other_side(model: Icr) -> Icr:
    return Icr(-model.icr_y_right, -model.icr_y_left, model.icr_x, model.alpha_right, model.alpha_left)


def other_robot(f: IcrFilter) -> IcrFilter:
    """The filter of the mirror image; its parameters are as unsure, each with each other."""
    assert isinstance(f.model, Icr)
    index = [f.free.index(OTHER.get(name, name)) for name in f.free]
    sign = np.array([-1.0 if name.startswith("icr_y") else 1.0 for name in f.free])
    bounds = np.sort(sign[:, None] * f.bounds[index], axis=1)
    covariance = np.outer(sign, sign) * f.theta_covariance[np.ix_(index, index)]
    return replace(f, model=other_side(f.model), theta_covariance=covariance, bounds=bounds)


def tracked(f: Filter, log: Log, start: FloatArray, P: FloatArray, back: bool = False) -> Trajectory:
    return (smooth if back else replay)(f, f.start(float(log.wheels.t[0]), start, P), log)


@pytest.mark.parametrize("sees", [3, 2])
@pytest.mark.parametrize("back", [False, True])
def test_the_icr_filter(sees: int, back: bool) -> None:
    log, f, R, M = busy_log(sees=sees), make_filter(gyro=True), turned(ELSEWHERE), np.diag(FLIP)
    here = tracked(f, log, START, P_START, back)
    there = tracked(f, moved(log, ELSEWHERE), compose(ELSEWHERE, START), R @ P_START @ R.T, back)
    assert_allclose(there.poses, compose(ELSEWHERE, here.poses), atol=1e-9)
    assert_allclose(there.covariances, R @ here.covariances @ R.T, atol=1e-10)
    assert_allclose(there.squared, here.squared, rtol=1e-6)
    image = tracked(other_robot(f), mirrored(log), START * FLIP, M @ P_START @ M, back)
    assert_allclose(image.poses, here.poses * FLIP, atol=1e-9)
    assert_allclose(image.covariances, M @ here.covariances @ M, atol=1e-10)
    assert 0 < here.accepted.sum() < len(here.accepted)


@pytest.mark.parametrize("name", [name for name in TABLE_1 if name != "transfer_difference"])  # which has one slip only
def test_thalmanns_filters(name: str) -> None:
    whole = busy_log()
    wheels = whole.wheels.between(0.0, 3.0)
    assert wheels is not None
    log, R, M = replace(whole, wheels=wheels), turned(ELSEWHERE), np.diag(FLIP)
    noise = SystemNoise(0.5, 0.1, 0.01, 1e-3, 0.01, 0.01)
    f = replace(thalmann_filter(name, 0.6, noise), model=TransferFactor(0.05, -0.08, 0.8, 0.6))
    here = tracked(f, log, START, P_START)
    there = tracked(f, moved(log, ELSEWHERE), compose(ELSEWHERE, START), R @ P_START @ R.T)
    assert_allclose(there.poses, compose(ELSEWHERE, here.poses), atol=1e-8)
    assert_allclose(there.covariances, R @ here.covariances @ R.T, atol=1e-9)
    image = replace(f, model=TransferFactor(-0.08, 0.05, 0.8, 0.6))
    assert_allclose(tracked(image, mirrored(log), START * FLIP, M @ P_START @ M).poses, here.poses * FLIP, atol=1e-8)


def along(model: Icr, side: float, at: FloatArray, reverse: bool) -> Run:
    first = clothoid(2.0, 0.0, 0.7 * side, at)
    path: Path = join(first, clothoid(2.0, 0.7 * side, -0.5 * side, first.end))
    path = path.in_reverse() if reverse else path
    law = Predictive(PredictiveGains(), Wheels(model, 3.0), Limits(1.5), Observer(0.1, 0.06))
    start = compose(path.robot(0.0), np.array([0.0, 0.15 * side, 0.1 * side]))
    return follow(RollingModel(model, start, 0.1), law, law.wheels, path, Sensing(delay=0.06), Ends(1.0, 20.0))


@pytest.mark.parametrize("reverse", [False, True])
def test_the_plan_in_a_closed_loop(reverse: bool) -> None:
    here, image = along(PLANT, 1.0, HERE, reverse), along(other_side(PLANT), -1.0, HERE, reverse)
    there = along(PLANT, 1.0, ELSEWHERE, reverse)
    assert here.done
    assert_allclose(image.states[:, :2], here.states[:, :2] * FLIP[:2], atol=1e-8)
    assert_allclose(image.sent, here.sent[:, ::-1], atol=1e-7)
    assert_allclose(there.states[:, :2], compose(ELSEWHERE, here.states[:, :3])[:, :2], atol=1e-8)
