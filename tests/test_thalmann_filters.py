"""Thalmann's filters against a textbook filter with numerical derivatives, step by step and in the compiled loop."""

import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from skidsteer.drive import Series
from skidsteer.errors import DataError, RequestError
from skidsteer.models import Icr
from skidsteer.models.transfer_factor import TransferFactor
from skidsteer.odometry.kinematic_ekf import PRIOR, TABLE_1, KinematicEkf, thalmann_filter
from skidsteer.odometry.log import Log
from skidsteer.odometry.state import FilterState, Pose, Position, Standstill, YawRate
from skidsteer.odometry.state_choice import SystemNoise, rims, unit_variance
from skidsteer.odometry.thalmann_replay import Tracking, replay
from skidsteer.odometry.timeline import Timeline
from skidsteer.odometry.trajectory import stepwise
from skidsteer.windows import Mount

NOISE = SystemNoise(0.7, 0.3, 0.02, 0.004, 0.03, 0.02)


def truth(name: str) -> KinematicEkf:
    """A filter whose every constant is neither zero nor one."""
    return replace(thalmann_filter(name, 0.7, NOISE), model=TransferFactor(0.05, -0.08, 0.8, 0.7))


def moved(f: KinematicEkf, x: np.ndarray, a: np.ndarray, dt: float) -> np.ndarray:
    """The time update as the paper's text has it, written anew: x (n,), accelerations a (2,)."""
    slips = dict(zip(("slip_left", "slip_right", "efficiency"), f.model.theta, strict=True))
    slips |= dict(zip(f.estimated, x[5:], strict=True))
    m = x[3:5] + 0.5 * a * dt  # mean over the step
    B = f.model.track_width
    left, right = {
        "sides": (m[0], m[1]),
        "speed_yaw_rate": (m[0] - 0.5 * B * m[1], m[0] + 0.5 * B * m[1]),
        "speed_difference": (m[0] - 0.5 * m[1], m[0] + 0.5 * m[1]),
    }[f.choice]
    left, right = (1.0 - slips["slip_left"]) * left, (1.0 - slips["slip_right"]) * right
    s, turn = 0.5 * (left + right) * dt, slips["efficiency"] * (right - left) / B * dt
    if f.geometry == "polygon":
        dx, dy = s, 0.0
    else:
        dx, dy = s / turn * np.sin(turn), s / turn * (1.0 - np.cos(turn))
    c, z = np.cos(x[2]), np.sin(x[2])
    return np.r_[x[0] + c * dx - z * dy, x[1] + z * dx + c * dy, x[2] + turn, x[3:5] + a * dt, x[5:]]


def derivative(f, x: np.ndarray, step: float = 1e-6) -> np.ndarray:
    return np.stack([(f(x + step * e) - f(x - step * e)) / (2.0 * step) for e in np.eye(len(x))], axis=-1)


def some_state(f: KinematicEkf, seed: int = 0) -> FilterState:
    rng = np.random.default_rng(seed)
    n = len(f.names)
    mean = np.r_[1.0, -2.0, 0.7, f.observed([0.9, 1.3]), [{"efficiency": 0.8}.get(name, 0.06) for name in f.estimated]]
    A = 0.1 * rng.normal(size=(n, n))
    return FilterState(f.fingerprint, 3.0, mean, A @ A.T + 0.01 * np.eye(n))


@pytest.mark.parametrize("name", TABLE_1)
@pytest.mark.parametrize("dt", [0.01, 0.37])
def test_time_update_against_numerical_derivatives(name: str, dt: float) -> None:
    f = truth(name)
    state = some_state(f)
    after = f.predict(state, None, dt)
    zero = np.zeros(2)
    F = derivative(lambda x: moved(f, x, zero, dt), state.mean)
    G = derivative(lambda a: moved(f, state.mean, a, dt), zero)
    Q = G @ np.diag(f.noise.disturbance(f.choice, 0.7) ** 2) @ G.T
    C = rims(f.choice, 0.7)
    rolled = np.abs(C @ state.mean[3:5]).mean() * dt
    Q[:3, :3] += rolled * np.diag([NOISE.walk**2, NOISE.walk**2, NOISE.turn**2])
    Q[5:, 5:] += NOISE.drift**2 * dt * np.eye(len(f.estimated))
    assert_allclose(after.mean, moved(f, state.mean, zero, dt), atol=1e-14)
    assert_allclose(after.covariance, F @ state.covariance @ F.T + Q, atol=1e-9)
    assert after.time == 3.0 + dt


@pytest.mark.parametrize("name", TABLE_1)
def test_encoders_against_the_textbook_update(name: str) -> None:
    f = replace(truth(name), significance=0.0)
    state = some_state(f)
    after, _, taken = f.observe(state, (1.0, 1.4))
    assert taken.all()
    C, n = rims(f.choice, 0.7), len(state.mean)
    H = np.zeros((2, n))
    H[:, 3:5] = C  # observe the rim speeds themselves, with equal variances
    P, R = state.covariance, NOISE.encoder**2 * np.eye(2)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    assert_allclose(after.mean, state.mean + K @ ([1.0, 1.4] - C @ state.mean[3:5]), atol=1e-12)
    assert_allclose(after.covariance, (np.eye(n) - K @ H) @ P, atol=1e-12)


def test_variances_of_the_observed_motion_parameters_by_hand() -> None:
    assert_allclose(unit_variance("sides", 0.5), [1.0, 1.0])
    assert_allclose(unit_variance("speed_difference", 0.5), [0.5, 2.0])
    assert_allclose(unit_variance("speed_yaw_rate", 0.5), [0.5, 8.0])
    assert_allclose(truth("arc").observed([[1.0, 1.7]]), [[1.35, 1.0]])
    assert_allclose(truth("alternative").observed([[1.0, 1.7]]), [[1.35, 0.7]])


def expected(f: KinematicEkf, x: np.ndarray, seen: Position | Pose | YawRate | Standstill) -> np.ndarray:
    if isinstance(seen, Standstill):
        return rims(f.choice, 0.7) @ x[3:5]
    if isinstance(seen, YawRate):
        return np.array([(moved(f, x, np.zeros(2), 1.0) - x)[2]])
    c, s = np.cos(x[2]), np.sin(x[2])
    place = np.array([x[0] + c * seen.mount.x - s * seen.mount.y, x[1] + s * seen.mount.x + c * seen.mount.y])
    return place if isinstance(seen, Position) else np.r_[place, x[2] + seen.mount.yaw]


@pytest.mark.parametrize("name", ["basic", "extended", "arc", "transfer_difference"])
@pytest.mark.parametrize("kind", ["position", "pose", "rate", "standstill"])
def test_measurements_against_the_textbook_update(name: str, kind: str) -> None:
    f = truth(name)
    state, mount = some_state(f), Mount(0.3, -0.2, 0.1)
    R2, R3 = np.array([[0.04, 0.01], [0.01, 0.02]]), np.diag([0.04, 0.02, 0.01]) + 0.002
    seen = {
        "position": Position(3.0, np.array([1.4, -1.9]), R2, 0.0, mount),
        "pose": Pose(3.0, np.array([1.4, -1.9, 0.9]), R3, 0.0, mount),
        "rate": YawRate(3.0, 0.5, 0.01),
        "standstill": Standstill(3.0),
    }[kind]
    z, R = {
        "position": ([1.4, -1.9], R2),
        "pose": ([1.4, -1.9, 0.9], R3),
        "rate": ([0.5], [[0.01]]),
        "standstill": ([0.0, 0.0], 1e-6 * np.eye(2)),
    }[kind]
    after, innovation = f.update(state, seen)
    H = derivative(lambda x: expected(f, x, seen), state.mean)
    P, d = state.covariance, np.asarray(z) - expected(f, state.mean, seen)
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    assert_allclose(after.mean, state.mean + K @ d, atol=1e-7)
    assert_allclose(after.covariance, (np.eye(len(P)) - K @ H) @ P, atol=1e-7)
    assert_allclose(innovation.squared, d @ np.linalg.solve(S, d), rtol=1e-6)
    assert innovation.accepted
    assert innovation.dof == len(z)


def test_a_scatter_of_the_stamp_counts_along_the_path() -> None:
    f = thalmann_filter("basic", 0.7)
    state = FilterState(f.fingerprint, 0.0, np.array([0.0, 0.0, np.pi / 2, 2.0, 2.0]), 1e-12 * np.eye(5))
    R = 0.01**2 * np.eye(2)
    along = f.update(state, Position(0.0, np.array([0.0, 0.3]), R, stamp=0.15))[1].squared
    across = f.update(state, Position(0.0, np.array([0.3, 0.0]), R, stamp=0.15))[1].squared
    assert_allclose([along, across], [0.09 / (0.3**2 + 1e-4), 900.0], rtol=1e-6)


def test_reference_is_gated_when_asked_for() -> None:
    f = replace(thalmann_filter("basic", 0.7), gate=0.001)
    state = f.start(0.0, [0.0, 0.0, 0.0], 0.01 * np.eye(3))
    kept, told = f.update(state, Position(0.0, np.array([50.0, 0.0]), np.eye(2)))
    assert not told.accepted
    assert kept is state


@pytest.mark.parametrize("name", TABLE_1)
def test_compiled_loop_and_pure_steps_agree_to_rounding(name: str) -> None:
    f = replace(truth(name), significance=0.3, gate=1e-4)
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.02, 0.2, 80))
    wheels = Series(t, 0.5 + np.cumsum(rng.normal(0.0, 0.05, (80, 2)), axis=0))
    stamps = np.sort(rng.uniform(t[0], t[-1], 30))
    tracking = Tracking(Series(stamps + 0.3, rng.normal(0.0, 1.0, (30, 2))), 0.5, 0.1, 0.3, (0.2, -0.1))
    state = f.start(t[0], [0.1, 0.2, 0.3], 0.5 * np.eye(3))
    got = replay(f, state, wheels, tracking)
    at, used = 0, 0
    for k in range(80):
        assert_allclose(got.means[k], state.mean, rtol=1e-9, atol=1e-9)
        assert_allclose(got.covariances[k], state.covariance, rtol=1e-8, atol=1e-11)
        state, T, taken = f.observe(state, wheels.values[k])
        assert_allclose(got.statistic[k], T, rtol=1e-9)
        assert_array_equal(got.taken[k], taken)
        used += int(taken.all())
        while at < 30 and k < 79 and got.seen_t[at] < t[k + 1]:
            state = f.predict(state, None, got.seen_t[at] - state.time)
            seen = Position(state.time, tracking.positions.values[at], 0.25 * np.eye(2), 0.1, Mount(0.2, -0.1))
            state, told = f.update(state, seen)
            assert_allclose(got.seen_statistic[at], told.squared, rtol=1e-7)
            assert got.seen_taken[at] == told.accepted
            at += 1
        if k < 79:
            state = f.predict(state, None, t[k + 1] - state.time)
    assert at == 30
    assert 0 < used < 80
    assert_allclose(got.last.mean, state.mean, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("late", [False, True])
def test_a_sample_counts_once_however_its_step_is_cut(late: bool) -> None:
    """Positions between two samples, in time or late, cut the step; the sample is one observation all the same."""
    f, R, rng = truth("extended"), 0.25 * np.eye(2), np.random.default_rng(6)
    t = np.arange(0.0, 4.0, 0.1)
    wheels, seen = Series(t, 0.5 + rng.normal(0.0, 0.05, (40, 2))), Series(t[:-1] + 0.03, rng.normal(0.0, 0.5, (39, 2)))
    start = f.start(0.0, [0.1, 0.2, 0.3], 0.5 * np.eye(3))
    expected = replay(f, start, wheels, Tracking(seen, 0.5)).state(f, 39)
    if late:
        timeline = Timeline(f, start)
        for k, (left, right) in enumerate(wheels.values[:-1].tolist()):
            timeline = timeline.predict((left, right), t[k + 1] - t[k])
            timeline, _ = timeline.update(Position(seen.t[k], seen.values[k], R))
        got = timeline.now
    else:
        got = stepwise(f, start, Log(wheels, seen, R)).last
    assert_allclose(got.mean, expected.mean, rtol=1e-6, atol=1e-8)
    assert_allclose(got.covariance, expected.covariance, rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize("name", ["basic", "extended"])
def test_covariance_stays_symmetric_and_positive_definite_over_a_million_steps(name: str) -> None:
    f = replace(thalmann_filter(name, 0.7, SystemNoise(0.5, 0.1, 0.005)), significance=0.001)
    n = 1_000_000
    t = 0.01 * np.arange(n)
    v = 0.5 + 0.4 * np.stack([np.sin(0.3 * t), np.sin(0.3 * t + 0.5)], axis=1)
    path = 30.0 * np.stack([np.sin(t / 60.0), np.cos(t / 60.0)], axis=1)
    sparse = Series(t[:400_000:1000], path[:400_000:1000])  # a reference for 4000 s, none for 6000 s
    end = replay(
        f, f.start(0.0, [0.0, 30.0, 0.0], 1e-6 * np.eye(3)), Series(t, v), Tracking(sparse), covariances=False
    ).last
    P = end.covariance
    assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P)[0] > 0.0
    assert np.isfinite(end.mean).all()


def test_positions_known_to_a_millionth_of_a_metre_leave_the_covariance_positive_definite() -> None:
    f = thalmann_filter("extended", 0.7)
    t = 0.1 * np.arange(3000.0)
    wheels = Series(t, np.tile([0.5, 0.6], (3000, 1)))
    fine = Tracking(Series(t, np.zeros((3000, 2))), 1e-6)
    P = replay(f, f.start(0.0, np.zeros(3), np.eye(3)), wheels, fine).last.covariance
    assert np.linalg.eigvalsh(P)[0] > 0.0


def test_the_filter_with_right_noise_is_consistent() -> None:
    """NEES of the pose over simulated drives that the filter's own model made."""
    noise = SystemNoise(0.4, 0.3, 0.02)
    f = replace(thalmann_filter("alternative", 0.6, noise), significance=0.0)
    rng, squared = np.random.default_rng(0), []
    for _ in range(60):
        x = np.r_[0.0, 0.0, 0.0, rng.normal(0.5, 0.2), rng.normal(0.0, 0.1)]
        state = f.start(0.0, x[:3] + rng.multivariate_normal(np.zeros(3), 1e-4 * np.eye(3)), 1e-4 * np.eye(3))
        for _ in range(50):
            rim = np.array([x[3] - 0.5 * x[4], x[3] + 0.5 * x[4]]) + 0.02 * rng.normal(size=2)
            state = f.predict(state, (rim[0], rim[1]), 0.1)
            x = moved(f, x, np.array([0.4, 0.3]) * rng.normal(size=2), 0.1)
        squared.append((x - state.mean) @ np.linalg.solve(state.covariance, x - state.mean))
    assert abs(np.mean(squared) - 5.0) < 3.0 * np.sqrt(2.0 * 5.0 / 60.0)


def test_an_excluded_sample_is_believed_after_patience() -> None:
    f = replace(thalmann_filter("basic", 0.6, SystemNoise(0.1, 0.1, 0.005)), patience=5.0)
    state = f.start(0.0, np.zeros(3), 1e-4 * np.eye(3))
    for _ in range(20):
        state = f.predict(state, (0.5, 0.5), 0.1)
    excluded = 0
    for _ in range(20):
        state, _, taken = f.observe(state, (1.5, 0.5))  # the left side leaps
        assert taken[1]
        excluded += int(not taken[0])
        state = f.predict(state, None, 0.1)
    assert 1 <= excluded <= 6
    assert_allclose(state.mean[3], 1.5, atol=0.02)


def test_bad_input() -> None:
    f = thalmann_filter("transfer_difference", 0.6)
    state = f.start(1.0, np.zeros(3), np.zeros((3, 3)))
    assert f.predict(state, (1.0, 1.0), 0.0) is state
    for dt in (-0.1, np.nan, np.inf):
        with pytest.raises(DataError, match="time must go forwards"):
            f.predict(state, (1.0, 1.0), dt)
    for wheels in ((np.nan, 1.0), (1.0, np.inf)):
        with pytest.raises(DataError, match=r"rim speeds must be finite.*leave the sample out"):
            f.predict(state, wheels, 0.1)
    other = thalmann_filter("alternative", 0.6).start(1.0, np.zeros(3), np.eye(3))
    for call in (
        lambda: f.predict(other, None, 0.1),
        lambda: f.observe(other, (0.0, 0.0)),
        lambda: f.update(other, Standstill(1.0)),
        lambda: replay(f, other, Series([1.0], [[0.0, 0.0]])),
        lambda: f.start(0.0, np.zeros(3), np.eye(3), known=other),
    ):
        with pytest.raises(RequestError, match="the state belongs to the filter"):
            call()
    with pytest.raises(DataError, match="predict first"):
        f.update(state, Standstill(2.0))
    with pytest.raises(DataError, match="NaN or infinite; leave it out"):
        f.update(state, Position(1.0, np.array([np.nan, 0.0]), np.eye(2)))
    with pytest.raises(DataError, match="not positive definite"):
        f.update(state, Position(1.0, np.zeros(2), np.zeros((2, 2))))
    for pose, P in ((np.zeros(2), np.eye(3)), ([0.0, 0.0, np.nan], np.eye(3)), (np.zeros(3), np.nan * np.eye(3))):
        with pytest.raises(DataError, match="a start needs"):
            f.start(0.0, pose, P)
    with pytest.raises(DataError, match="nowhere negative"):
        f.start(0.0, np.zeros(3), -np.eye(3))
    with pytest.raises(DataError, match="no wheel sample at or after"):
        replay(f, state, Series([0.5], [[0.0, 0.0]]))


def test_a_measurement_of_another_time_is_refused_at_stamps_since_1970_too() -> None:
    f = truth("basic")
    state = f.start(1.7e9, [0.1, 0.2, 0.3], 0.5 * np.eye(3))
    f.update(state, Position(1.7e9, np.zeros(2), np.eye(2)))
    with pytest.raises(DataError, match="predict first"):
        f.update(state, Position(1.7e9 + 0.5, np.zeros(2), np.eye(2)))


def test_bad_options() -> None:
    with pytest.raises(RequestError, match="no filter 'ukf'; there are: basic, arc"):
        thalmann_filter("ukf", 0.6)
    f = thalmann_filter("basic", 0.6)
    for change in ({"choice": "none"}, {"geometry": "spline"}):
        with pytest.raises(RequestError, match="no state choice"):
            replace(f, **change)
    for names in (("slip",), ("slip_left", "slip_left")):
        with pytest.raises(RequestError, match="slip parameters are"):
            replace(f, estimated=names)
    with pytest.raises(RequestError, match="patience"):
        replace(f, patience=0.0)
    with pytest.raises(RequestError, match="significance"):
        replace(f, gate=1.0)
    for bad in ({"encoder": 0.0}, {"acceleration": -1.0}, {"walk": np.nan}):
        with pytest.raises(RequestError, match="system noise"):
            SystemNoise(**bad)
    with pytest.raises(DataError, match="tracking needs"):
        Tracking(Series([0.0], [[0.0, 0.0]]), sigma=0.0)
    with pytest.raises(DataError, match="tracking tells x and y"):
        Tracking(Series([0.0], [[0.0, 0.0, 0.0]]))


def test_a_gap_of_seconds_is_survived_and_the_covariance_says_so() -> None:
    f = thalmann_filter("basic", 0.6)
    state = f.predict(f.start(0.0, np.zeros(3), 1e-4 * np.eye(3)), (0.5, 0.5), 0.1)
    after = f.predict(state, (0.5, 0.5), 5.0)
    assert_allclose(after.mean[0], 0.5 * 5.1, atol=0.05)
    # each side may accelerate by 0.5 m/s^2 for 5 s: the mean of both moves by a t^2 / 2 / sqrt(2)
    assert_allclose(np.sqrt(after.covariance[0, 0]), 0.5 * 5.0**2 / 2.0 / np.sqrt(2.0), rtol=0.05)


def test_table_1() -> None:
    states = {name: thalmann_filter(name, 0.6).names for name in TABLE_1}
    assert states["basic"] == states["arc_odometry"] == ("x", "y", "yaw", "v_left", "v_right")
    assert states["arc"] == ("x", "y", "yaw", "v", "omega")
    assert states["alternative"] == ("x", "y", "yaw", "v", "v_difference")
    assert states["transfer_difference"] == (*states["alternative"], "slip_right")
    geometry = {name: thalmann_filter(name, 0.6).geometry for name in TABLE_1}
    assert [geometry[n] for n in ("basic", "arc", "arc_odometry", "alternative")] == [
        "polygon",
        "arc",
        "arc",
        "polygon",
    ]


def test_options_make_the_fingerprint() -> None:
    f = thalmann_filter("basic", 0.6)
    assert f.fingerprint == thalmann_filter("basic", 0.6).fingerprint
    changes = [{"patience": 4.0}, {"gate": 0.01}, {"noise": NOISE}, {"model": TransferFactor(0.0, 0.0, 1.0, 0.61)}]
    assert len({f.fingerprint, *(replace(f, **change).fingerprint for change in changes)}) == 5


def test_slips_are_taken_over_from_an_earlier_drive() -> None:
    f = thalmann_filter("extended", 0.6)
    first = f.start(0.0, np.zeros(3), np.eye(3))
    assert_allclose(np.sqrt(np.diag(first.covariance))[5:], [PRIOR[name] for name in f.estimated])
    known = some_state(f)
    state = f.start(0.0, np.zeros(3), np.eye(3), known)
    assert_array_equal(state.mean[5:], known.mean[5:])
    assert_array_equal(state.covariance[5:, 5:], known.covariance[5:, 5:])


def test_transfer_factors_are_symmetric_icrs() -> None:
    model = TransferFactor(0.1, -0.05, 0.8, 0.6)
    icr = Icr(0.6 / 1.6, -0.6 / 1.6, 0.0, 0.9, 1.05)
    assert_allclose(model.twist([0.3, 1.0], [0.7, -0.4]), icr.twist([0.3, 1.0], [0.7, -0.4]))
    # by hand: 0.9 * 0.3 and 1.05 * 0.7; their mean, and 0.8 / 0.6 of the difference
    assert_allclose(model.twist(0.3, 0.7), [0.5025, 0.0, 0.465 * 0.8 / 0.6])
    numeric = derivative(lambda x: model.with_theta(x).matrix(), model.theta)
    assert_allclose(model.matrix_jacobian(), numeric, atol=1e-9)
    for bad in ((1.0, 0.0, 1.0, 0.6), (0.0, 1.0, 1.0, 0.6), (0.0, 0.0, 0.0, 0.6), (0.0, 0.0, 1.0, 0.0)):
        with pytest.raises(ValueError, match="need slip_left"):
            TransferFactor(*bad)


def test_a_step_costs_little() -> None:
    f = thalmann_filter("extended", 0.7)
    t = 0.01 * np.arange(100_000.0)
    wheels, start = Series(t, np.tile([0.5, 0.6], (len(t), 1))), f.start(0.0, np.zeros(3), np.eye(3))
    replay(f, start, wheels, covariances=False)
    before = time.process_time()
    replay(f, start, wheels, covariances=False)
    assert time.process_time() - before < 1.0  # 10 us a step; measured below 1
