"""One step and one update of the filter with ICR states, against independent algebra."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from odometry_drives import ASPHALT, LAG, NOISE, VEHICLE, make_filter, turning
from skidsteer.errors import DataError, RequestError
from skidsteer.kernels.twists import KINDS, twist_of
from skidsteer.models import MODELS, Icr, Model, ScheduledIcr
from skidsteer.models.transfer_factor import TransferFactor
from skidsteer.odometry.icr_filter import FilterOptions, IcrFilter
from skidsteer.odometry.log import Log
from skidsteer.odometry.state import FilterState, Pose, Position, Standstill, YawRate
from skidsteer.odometry.trajectory import replay
from skidsteer.se2 import FloatArray, chain, compose, wrap
from skidsteer.windows import Mount, Timing, Windows, predict

POSE = np.array([1.0, -2.0, 0.7])
P_POSE = np.array([[0.02, 0.004, 0.001], [0.004, 0.03, -0.002], [0.001, -0.002, 0.01]])
WHEELS = (0.43, 0.71)


def anywhere(model: type[Model], rng: np.random.Generator) -> Model:
    """A model inside its bounds, every parameter off its nominal."""
    low, high = model.bounds(VEHICLE).T
    nominal = model.nominal(VEHICLE)
    return nominal.with_theta(low + (high - low) * rng.uniform(0.3, 0.45, len(low))) if len(low) else nominal


def filter_of(model: Model, gyro: bool = False, fixed: tuple[str, ...] = ()) -> IcrFilter:
    bounds = type(model).bounds(VEHICLE)
    free = [i for i, p in enumerate(model.PARAMETERS) if p.name not in fixed]
    names = tuple(model.PARAMETERS[i].name for i in free)
    P = np.diag(np.linspace(0.01, 0.03, len(free)) ** 2)
    return IcrFilter(model, names, P, bounds[free], NOISE, 0.11, gyro, 1.02)


def moved(f: IcrFilter, state: FilterState, mean: FloatArray, dt: float = 0.3) -> FloatArray:
    shifted = FilterState(f.fingerprint, state.time, mean.copy(), state.covariance, state.memory)
    return f.predict(shifted, WHEELS, dt).mean


def transition(f: IcrFilter, state: FilterState, dt: float = 0.3) -> FloatArray:
    """Derivative of the step by the state, by central differences."""
    h = 1e-6 * np.eye(len(state.mean))
    return np.array([(moved(f, state, state.mean + e, dt) - moved(f, state, state.mean - e, dt)) / 2e-6 for e in h]).T


def warm(f: IcrFilter) -> FilterState:
    """A state with speeds behind the lag that are not those of the rims, in which each number goes with each other."""
    state = f.predict(f.start(5.0, POSE, P_POSE), (0.2, 0.1), 0.2)
    A = 0.01 * np.random.default_rng(2).normal(size=(len(f.names), len(f.names)))
    return FilterState(state.filter, state.time, state.mean, state.covariance + A @ A.T, state.memory)


@pytest.mark.parametrize("model", [*MODELS.values(), TransferFactor])
def test_compiled_twists_are_those_of_the_models(model: type[Model]) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        m = anywhere(model, rng)
        left, right = rng.uniform(-2.0, 2.0, 2)
        twist, J = np.empty(3), np.zeros((3, len(m.theta)))
        twist_of(KINDS[m.NAME], VEHICLE.track_width, m.theta, left, right, twist, J)
        assert_allclose(twist, m.twist(left, right), atol=1e-13)
        assert_allclose(J, m.parameter_jacobian(left, right), atol=1e-12)


@pytest.mark.parametrize("model", [*MODELS.values(), TransferFactor])
@pytest.mark.parametrize("gyro", [False, True])
@pytest.mark.parametrize("reach", [1000.0, 1.0])
def test_a_step_carries_the_covariance_by_its_derivative(model: type[Model], gyro: bool, reach: float) -> None:
    f = replace(filter_of(anywhere(model, np.random.default_rng(1)), gyro), options=FilterOptions(reach=reach))
    state, dt = warm(f), 0.3
    after = f.predict(state, WHEELS, dt)
    F, q = transition(f, state), len(f.free)
    _, rolled, apart = rolled_behind(state, dt)
    kept = math.exp(-rolled / f.options.reach)
    F[3 : 3 + q, 3 : 3 + q] *= kept
    Q = np.zeros_like(F)
    Q[:3, :3] = np.diag([rolled * NOISE.walk**2, rolled * NOISE.walk**2, apart * NOISE.turn**2])
    variation = f.options.variation * (f.bounds[:, 1] - f.bounds[:, 0])
    Q[3 : 3 + q, 3 : 3 + q] = (1.0 - kept**2) * (f.theta_covariance + np.diag(variation**2))
    if gyro:
        Q[-1, -1] = f.options.bias_walk**2 * dt
    assert_allclose(after.covariance, F @ state.covariance @ F.T + Q, atol=2e-11)
    assert_allclose(after.covariance, after.covariance.T, atol=0.0)
    assert after.time == state.time + dt


def rolled_behind(state: FilterState, dt: float, lag: float = 0.11) -> tuple[FloatArray, float, float]:
    """Distances rolled behind the lag from the speeds that the state remembers; their mean; the path of the yaw."""
    behind = state.memory[:2]
    v = np.array(WHEELS)
    distance = v * dt + (behind - v) * lag * (1.0 - math.exp(-dt / lag))
    rolled, apart = float(0.5 * np.abs(distance).sum()), float(0.5 * np.abs(np.diff(distance))[0])
    return distance, rolled, 0.9 * apart + 0.1 * rolled


def test_a_drive_moves_as_the_model_predicts() -> None:
    """Independent: the windows' own cutting of the log and rollout."""
    rims = turning(20.0, np.random.default_rng(0))
    f = make_filter()
    t = rims.t[[0, 300, 700, 950]]
    windows = Windows(t[:-1], t[1:], np.zeros((3, 3)), np.ones(3, bool))
    expected = compose(POSE, chain(predict(ASPHALT, rims, windows, Timing(0.0, LAG))))
    track = replay(f, f.start(0.0, POSE), Log(rims))
    assert_allclose(track.poses[[0, 300, 700, 950]], expected, atol=1e-10)


def test_a_fixed_parameter_is_no_state() -> None:
    model = anywhere(ScheduledIcr, np.random.default_rng(0))
    f = filter_of(model, fixed=("turn_loss", "slip_fade"))
    kept = [p.name for p in model.PARAMETERS if p.name not in ("turn_loss", "slip_fade")]
    assert f.names == ("x", "y", "yaw", *kept)
    v = model.twist(*WHEELS)
    state = f.predict(f.start(0.0, np.zeros(3), P_POSE), WHEELS, 1e-3)
    assert_allclose(state.mean[:3], v * 1e-3, rtol=0.01)


MOUNT = Mount(0.3, -0.2, 0.4)


def sensed(mean: FloatArray, mount: Mount) -> FloatArray:
    return compose(mean[:3], np.array([mount.x, mount.y, mount.yaw]))


@pytest.mark.parametrize("dof", [3, 2])
def test_an_update_is_the_textbook_one(dof: int) -> None:
    f = make_filter(sigma=0.02, gyro=True)
    state = f.predict(f.start(5.0, POSE, P_POSE), WHEELS, 0.4)
    x, P = state.mean, state.covariance
    h = 1e-6 * np.eye(len(x))
    H = np.array([(sensed(x + e, MOUNT) - sensed(x - e, MOUNT)) / 2e-6 for e in h]).T[:dof]
    v, c, s = ASPHALT.twist(*state.memory[:2]), math.cos(x[2]), math.sin(x[2])
    lever = sensed(x, MOUNT)[:2] - x[:2]
    along = [c * v[0] - s * v[1] - v[2] * lever[1], s * v[0] + c * v[1] + v[2] * lever[0], v[2]][:dof]
    R = np.array([[0.01, 0.002, 0.001], [0.002, 0.02, -0.001], [0.001, -0.001, 0.005]])[:dof, :dof]
    z = sensed(x, MOUNT)[:dof] + np.array([0.1, -0.15, 0.05])[:dof]
    S = H @ P @ H.T + R + 0.05**2 * np.outer(along, along)
    K = P @ H.T @ np.linalg.inv(S)
    nu = z - sensed(x, MOUNT)[:dof]
    seen = Pose(5.4, z + [0, 0, 2 * np.pi], R, 0.05, MOUNT) if dof == 3 else Position(5.4, z, R, 0.05, MOUNT)
    after, innovation = f.update(state, seen)
    assert innovation.accepted
    assert innovation.dof == dof
    assert_allclose(innovation.squared, nu @ np.linalg.solve(S, nu), rtol=1e-9)
    assert_allclose(after.mean, x + K @ nu, atol=1e-10)
    assert_allclose(after.covariance, P - K @ S @ K.T, atol=1e-12)


@pytest.mark.parametrize("reach", [1000.0, 1.0])
def test_a_yaw_rate_is_taken_with_the_noise_of_the_step_it_measures(reach: float) -> None:
    """Independent: condition the joint Gaussian of the state before, and of the step's own noise."""
    f = replace(make_filter(sigma=0.02, gyro=True, reach=reach), gyro_scale=1.03)
    state, dt, R = warm(f), 0.25, 4e-4
    after = f.predict(state, WHEELS, dt)
    F, q, n = transition(f, state, dt), 5, 9
    B = F - np.eye(n)
    kept = math.exp(-rolled_behind(state, dt, LAG)[1] / f.options.reach)
    F[3 : 3 + q, 3 : 3 + q] *= kept
    turn = NOISE.turn**2 * rolled_behind(state, dt, LAG)[2]
    turned = B[2] @ state.covariance @ B[2] + turn  # variance of the turn
    with_turn = F @ state.covariance @ B[2]
    with_turn[2] += turn
    g, bias = 1.0 / (1.03 * dt), np.eye(n)[-1]
    C = g * with_turn + after.covariance @ bias
    S = g * g * turned + 2.0 * g * with_turn[-1] + after.covariance[-1, -1] + R
    rate = g * (after.mean[2] - state.mean[2]) + 0.02
    told, innovation = f.update(after, YawRate(after.time, rate, R))
    assert_allclose(innovation.squared, 0.02**2 / S, rtol=1e-5)
    assert_allclose(told.mean, after.mean + C / S * 0.02, atol=1e-8)
    assert_allclose(told.covariance, after.covariance - np.outer(C, C) / S, atol=1e-9)


def test_frozen_parameters_stay_and_still_make_the_pose_uncertain() -> None:
    f = make_filter(sigma=0.02, adapt=False)
    state = f.start(0.0, POSE, 1e-6 * np.eye(3))
    for _ in range(100):
        state = f.predict(state, WHEELS, 0.1)
    after, _ = f.update(state, Pose(state.time, state.pose + [0.05, 0.05, 0.05], 1e-4 * np.eye(3)))
    assert_allclose(after.mean[3:], ASPHALT.theta, atol=0.0)
    assert_allclose(after.covariance[3:, 3:], 0.02**2 * np.eye(5), rtol=1e-12)
    assert state.covariance[2, 2] > 0.1
    np.linalg.cholesky(after.covariance)


def test_nothing_is_forgotten_and_nothing_blows_up_while_nothing_is_told() -> None:
    f = make_filter(sigma=0.005)
    state = f.start(0.0, np.zeros(3))
    ground = f.theta_covariance + np.diag((0.03 * (f.bounds[:, 1] - f.bounds[:, 0])) ** 2)
    before = np.diag(state.covariance)[3:]
    for _ in range(30):
        rims = turning(60.0, np.random.default_rng(0))
        shifted = FilterState(f.fingerprint, 0.0, state.mean.copy(), state.covariance.copy(), state.memory.copy())
        state = replay(f, shifted, Log(rims)).last
        now = np.diag(state.covariance)[3:]
        assert (now > before).all()
        assert (now <= np.diag(ground)).all()
        before = now
    assert_allclose(state.mean[3:], ASPHALT.theta, atol=0.0)


def test_at_rest_nothing_grows_and_a_gyro_tells_its_bias() -> None:
    f = make_filter(gyro=True)
    state = f.start(0.0, POSE, 1e-4 * np.eye(3))
    for _ in range(500):
        state = f.predict(state, (0.0, 0.0), 0.02)
        state, _ = f.update(state, YawRate(state.time, 0.013, NOISE.gyro**2 / 0.02))
    assert_allclose(state.pose, POSE, atol=1e-12)
    assert_allclose(state.pose_covariance, 1e-4 * np.eye(3), rtol=1e-9)
    sigma = math.sqrt(state.covariance[-1, -1])
    assert abs(state.mean[-1] - 0.013) < 3e-4
    assert sigma == pytest.approx(NOISE.gyro / math.sqrt(10.0), rel=0.2)


def test_standstill_stops_what_follows_the_rims() -> None:
    f = make_filter()
    state = f.predict(f.start(0.0), (0.5, 0.5), 0.5)
    halted, innovation = f.update(state, Standstill(0.5))
    assert innovation.accepted
    assert f.predict(state, (0.0, 0.0), 0.5).mean[0] > state.mean[0] + 0.03
    assert_allclose(f.predict(halted, (0.0, 0.0), 0.5).pose, state.pose, atol=1e-15)


def test_a_gap_keeps_the_pose_and_admits_what_may_have_happened() -> None:
    f = make_filter()
    state = f.predict(f.start(0.0, POSE, 1e-6 * np.eye(3)), (0.5, 0.5), 0.5)
    after = f.predict(state, (0.5, 0.5), 4.0)
    assert_allclose(after.pose, state.pose, atol=0.0)
    assert_allclose(np.diag(after.pose_covariance - state.pose_covariance), [4.0, 4.0, 4.0], rtol=1e-6)
    in_two = f.predict(f.predict(state, None, 1.5), None, 2.5)
    assert_allclose(in_two.covariance, after.covariance, rtol=1e-9, atol=1e-12)
    assert f.predict(after, (0.0, 0.0), 0.5).pose == pytest.approx(after.pose)  # nothing is left of the speeds before


def at(state: FilterState, away: tuple[float, float, float], sigma: float = 0.01) -> Pose:
    return Pose(state.time, compose(state.pose, np.array(away)), sigma**2 * np.eye(3))


def test_one_wrong_reference_is_refused() -> None:
    f = make_filter()
    state = f.predict(f.start(0.0, POSE, 1e-4 * np.eye(3)), WHEELS, 0.1)
    after, innovation = f.update(state, at(state, (3.0, 1.0, 0.2)))
    assert not innovation.accepted
    assert not innovation.anchored
    assert_allclose(after.mean, state.mean, atol=0.0)
    assert_allclose(after.covariance, state.covariance, atol=0.0)
    assert f.update(after, at(after, (0.0, 0.0, 0.0)))[1].accepted


@pytest.mark.parametrize("dof", [3, 2])
def test_a_reference_that_jumped_is_followed_and_the_parameters_stay(dof: int) -> None:
    """A new map frame: moved by metres and, for poses, turned by two radians."""
    f = make_filter(sigma=0.01)
    jump = np.array([4.0, -3.0, 2.0 if dof == 3 else 0.0])
    state, truth, told = f.start(0.0, POSE, 1e-4 * np.eye(3)), POSE, []
    for i in range(40):
        state, truth = f.predict(state, WHEELS, 0.2), moved_on(truth)
        z = sensed(compose(jump, truth) if i >= 10 else truth, MOUNT)
        R = 1e-4 * np.eye(3)
        seen = Pose(state.time, z, R, 0.0, MOUNT) if dof == 3 else Position(state.time, z[:2], R[:2, :2], 0.0, MOUNT)
        state, innovation = f.update(state, seen)
        told.append(innovation)
    accepted = np.array([i.accepted for i in told])
    assert accepted[:10].all()
    assert not accepted[10:15].any()
    assert told[14].anchored
    assert sum(i.anchored for i in told) == 1
    assert accepted[15:].all()
    expected = compose(jump, truth)
    assert_allclose(state.pose[:2], expected[:2], atol=0.05)
    assert abs(wrap(state.pose[2] - expected[2])) < 0.05
    assert (np.abs(state.mean[3:] - ASPHALT.theta) < 0.03).all()
    np.linalg.cholesky(state.covariance)


@pytest.mark.parametrize("dof", [3, 2])
def test_a_pose_set_anew_is_as_uncertain_as_the_reference(dof: int) -> None:
    """Independent: the textbook update of a pose (or position) of which nothing was known."""
    f = make_filter(sigma=0.02, patience=1)
    state = f.predict(f.start(5.0, POSE, P_POSE), WHEELS, 0.4)
    R = np.array([[0.01, 0.002, 0.001], [0.002, 0.02, -0.001], [0.001, -0.001, 0.005]])[:dof, :dof]
    z = (sensed(state.mean, MOUNT) + [5.0, -7.0, 1.0])[:dof]
    seen = Pose(5.4, z, R, 0.0, MOUNT) if dof == 3 else Position(5.4, z, R, 0.0, MOUNT)
    after, innovation = f.update(state, seen)
    assert innovation.anchored
    assert not innovation.accepted
    assert_allclose(sensed(after.mean, MOUNT)[:dof], z, atol=1e-12)
    assert_allclose(after.mean[dof:], state.mean[dof:], atol=0.0)
    P, h = state.covariance.copy(), 1e-6 * np.eye(8)
    P[:dof], P[:, :dof] = 0.0, 0.0
    P[:dof, :dof] = 1e5 * np.eye(dof)
    H = np.array([(sensed(after.mean + e, MOUNT) - sensed(after.mean - e, MOUNT)) / 2e-6 for e in h]).T[:dof]
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    assert_allclose(after.covariance, P - K @ S @ K.T, atol=2e-6)


def moved_on(pose: FloatArray) -> FloatArray:
    """0.2 s further by the model, at steady speeds."""
    f = make_filter()
    state = f.predict(f.start(0.0, pose), WHEELS, 0.2)
    return state.pose.copy()


def test_a_side_that_sticks_is_survived() -> None:
    """Ten seconds of a left encoder that tells nothing, with a reference; then it works again."""
    f, truth = make_filter(), POSE
    state = f.start(0.0, POSE, 1e-4 * np.eye(3))
    for i in range(300):
        stuck = 50 <= i < 100
        state = f.predict(state, (0.0, WHEELS[1]) if stuck else WHEELS, 0.2)
        truth = moved_on(truth)
        state, _ = f.update(state, Pose(state.time, truth, 1e-4 * np.eye(3)))
        assert np.isfinite(state.mean).all()
        np.linalg.cholesky(state.covariance)
    assert_allclose(state.pose[:2], truth[:2], atol=0.05)
    assert (np.abs(state.mean[3:] - ASPHALT.theta) < 4.0 * np.sqrt(np.diag(state.covariance)[3:])).all()


@pytest.mark.parametrize(
    ("wheels", "dt", "message"),
    [
        (WHEELS, -0.1, "time goes backwards or is not finite: dt = -0.1 s"),
        (WHEELS, math.nan, "dt = nan s"),
        (WHEELS, math.inf, "dt = inf s"),
        ((math.nan, 0.1), 0.1, "rim speeds nan, 0.1 are NaN or infinite"),
        ((0.1, -math.inf), 0.1, "rim speeds 0.1, -inf are NaN or infinite"),
    ],
)
def test_bad_steps_are_refused(wheels: tuple[float, float], dt: float, message: str) -> None:
    f = make_filter()
    with pytest.raises(DataError, match=message.replace("(", "\\(")):
        f.predict(f.start(0.0), wheels, dt)


def test_no_time_changes_nothing() -> None:
    f = make_filter()
    state = f.start(0.0)
    assert f.predict(state, WHEELS, 0.0) is state


def test_bad_measurements_are_refused() -> None:
    f = make_filter()
    state = f.start(2.0)
    eye = np.eye(3)
    cases = [
        (Pose(2.5, POSE, eye), "a measurement at 2.500000 s for a state at 2.000000 s"),
        (Pose(math.nan, POSE, eye), "a measurement at nan s"),
        (Pose(2.0, np.array([math.nan, 0.0, 0.0]), eye), "the measurement at 2.000 s is NaN or infinite"),
        (Pose(2.0, POSE[:2], eye), "a measurement of 3 numbers"),
        (Pose(2.0, POSE, -eye), "measurement: the covariance is not positive definite, its least eigenvalue is -1"),
        (Position(2.0, POSE[:2], np.full((2, 2), math.nan)), "the covariance must be finite and symmetric"),
        (Position(2.0, POSE[:2], np.array([[1.0, 0.5], [0.0, 1.0]])), "the covariance must be finite and symmetric"),
        (Position(2.0, POSE[:2], eye[:2]), "a covariance is square"),
    ]
    for measurement, message in cases:
        with pytest.raises(DataError, match=message.replace("(", "\\(")):
            f.update(state, measurement)
    with pytest.raises(RequestError, match="this filter has no gyro"):
        f.update(state, YawRate(2.0, 0.1, 1e-4))
    with_gyro = make_filter(gyro=True)
    with pytest.raises(DataError, match="predict first"):
        with_gyro.update(with_gyro.start(2.0), YawRate(2.0, 0.1, 1e-4))
    stepped = with_gyro.predict(with_gyro.start(2.0), WHEELS, 0.1)
    with pytest.raises(DataError, match=r"a yaw rate over 0.05 s for a step of 0.1 s; let a Timeline divide it"):
        with_gyro.update(stepped, YawRate(2.1, 0.1, 1e-4, 0.05))
    with pytest.raises(DataError, match="needs finite numbers and a positive variance"):
        with_gyro.update(stepped, YawRate(2.1, 0.1, 0.0))


def test_states_of_other_filters_are_refused() -> None:
    f, other = make_filter(), make_filter(lag=0.09)
    state = other.start(0.0)
    with pytest.raises(RequestError, match=f"the state belongs to the filter {other.fingerprint}, not to"):
        f.predict(state, WHEELS, 0.1)
    with pytest.raises(RequestError, match="go on with the filter and calibration that it was made with"):
        f.update(state, at(state, (0.0, 0.0, 0.0)))
    assert make_filter().fingerprint == f.fingerprint


def test_starts_and_options_that_cannot_be_are_refused() -> None:
    f = make_filter()
    with pytest.raises(DataError, match="start: the covariance is not positive definite"):
        f.start(0.0, POSE, np.zeros((3, 3)))
    with pytest.raises(DataError, match="a start needs a finite time and x, y, yaw"):
        f.start(0.0, [1.0, math.nan, 0.0])
    with pytest.raises(ValueError, match="reach must be positive and finite, got 0"):
        FilterOptions(reach=0.0)
    with pytest.raises(ValueError, match="need 0 < confidence < 1, got 1"):
        FilterOptions(confidence=1.0)


def test_parameters_stay_inside_their_bounds() -> None:
    f = make_filter(sigma=0.3)
    state = f.start(0.0, POSE, 1e-6 * np.eye(3))
    for _ in range(20):
        state = f.predict(state, (0.0, 0.5), 0.2)
        state, _ = f.update(state, at(state, (0.0, 0.0, 0.3), 0.3))
    low, high = Icr.bounds(VEHICLE).T
    assert (state.mean[3:] >= low).all()
    assert (state.mean[3:] <= high).all()


def test_states_cannot_be_changed() -> None:
    state = make_filter().start(0.0)
    for array in (state.mean, state.covariance, state.memory):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_a_covariance_that_was_turned_is_one() -> None:
    """Turned by any angle, equal variances leave off its diagonal what rounding leaves, not twice the same."""
    f = make_filter()
    for angle in np.linspace(-3.0, 3.0, 50):
        c, s = math.cos(angle), math.sin(angle)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        state = f.start(0.0, POSE, R @ np.diag([1e-4, 1e-4, 1e-5]) @ R.T)
        assert_allclose(state.pose_covariance, np.diag([1e-4, 1e-4, 1e-5]), atol=1e-18)
        assert_allclose(state.pose_covariance, state.pose_covariance.T, atol=0.0)
    with pytest.raises(DataError, match="finite and symmetric"):
        f.start(0.0, POSE, [[1e-4, 1e-8, 0.0], [0.0, 1e-4, 0.0], [0.0, 0.0, 1e-5]])
