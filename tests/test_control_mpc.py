"""The predictive controller: its parts against independent calculations, then the closed loop on exact kinematics."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from control_loop import PLANT, TURNED
from skidsteer.control import Limits, Observer, Predictive, PredictiveGains, Wheels, speed_profile
from skidsteer.control.predictive import PredictiveState
from skidsteer.errors import DataError, RequestError
from skidsteer.follow import Ends, Jump, Run, Sensing, follow
from skidsteer.follow.belief import low_speed
from skidsteer.kernels import horizon, lags, slip, stage
from skidsteer.models import Icr, Model, ScheduledIcr
from skidsteer.paths import Path, arc, clothoid, join, lemniscate, line, stadium
from skidsteer.plants import begin
from skidsteer.rolling import RollingModel
from skidsteer.se2 import FloatArray, compose
from skidsteer.terramechanics.terrain import parse_ground
from skidsteer.vehicle import preset

EIGHT = lemniscate(110.77 / 5.0 / 2.622057)
WHEELS = Wheels(PLANT, 3.0)
SUMMIT = preset("summit-xl")
STILL = np.zeros(3)

# every number of a body non-zero: stage, period, lag; scale, loss, icr_x, compliance, give, gain, drift, ease; wheels
BODY = np.array(
    [0.03, 0.02, 0.1, 0.97, -0.1, 0.03, 0.04, 0.05, 1.1, 0.02, 0.8, 1.1, 1.05, -0.5, 0.45, 3.0, 3.0, 1.0, 4.0]
)
WEIGHTS = np.array([0.3, 1e-4, 0.1, 0.5])
ROW = np.array([0.05, 0.02, -0.1, 0.5, 0.6, 0.65, 3.0, 1.5, 1.45])


def controller(speed: float = 1.5, lag: float = 0.1, delay: float = 0.06, wheels: Wheels = WHEELS) -> Predictive:
    return Predictive(PredictiveGains(), wheels, Limits(speed), Observer(lag, delay))


def drive(
    law: Predictive,
    path: Path = EIGHT,
    start: FloatArray | None = None,
    truth: Model = PLANT,
    lag: float = 0.1,
    sensing: Sensing = Sensing(delay=0.06),  # noqa: B008
    ends: Ends = Ends(1.0, 60.0),  # noqa: B008
) -> Run:
    at = path.robot(0.0) if start is None else start
    return follow(RollingModel(truth, at, lag), law, law.wheels, path, sensing, ends)


# lags


@given(st.floats(1e-3, 0.5), st.floats(1e-3, 0.5), st.floats(0.005, 0.1))
@settings(deadline=None)
def test_lags_one_behind_the_other_by_the_matrix_exponential(first: float, second: float, dt: float) -> None:
    rates = np.array([[-1.0 / first, 0.0, 0.0], [1.0 / second, -1.0 / second, 0.0], [1.0, 0.0, 0.0]])
    left, behind, area = expm(dt * rates)[:, 0]
    assert lags.decay(dt, first) == pytest.approx(left, abs=1e-6)
    assert lags.cascade(dt, first, second) == pytest.approx(behind, abs=1e-3)  # nearly equal ones count as equal
    share = lags.mean_share(dt, first)
    assert (1.0 - share) + share * left == pytest.approx(area / dt, abs=1e-6)


def test_no_lag_follows_at_once() -> None:
    assert lags.decay(0.02, 0.0) == 0.0
    assert lags.cascade(0.02, 0.0, 0.1) == 0.0
    assert lags.cascade(0.02, 0.1, 0.0) == pytest.approx(math.exp(-0.2))
    assert lags.mean_share(0.02, 0.0) == 1.0


# the stage of a plan


def moved(row: FloatArray, u: float, body: FloatArray = BODY, path: Path = EIGHT) -> tuple[FloatArray, FloatArray]:
    after, D = np.zeros(stage.ROW), np.zeros((stage.STEERED, stage.STEERED + 1))
    stage.ask_speed(ROW, body, np.full(9, 1.5), path.length, path.closed, after)
    stage.move(row, u, body, path.knots, path.closed, np.empty(5), after, D)
    return after, D


@pytest.mark.parametrize("changed", [{}, {stage.Y: 1.5, stage.THETA: -0.9}, {stage.SIDE: 0.2, stage.OMEGA: -0.8}])
def test_the_jacobian_of_a_stage_by_differences(changed: dict[int, float]) -> None:
    row = ROW.copy()
    row[list(changed)] = list(changed.values())
    _, D = moved(row, 0.7)
    for k in range(stage.STEERED + 1):
        step = np.zeros(stage.ROW)
        if k < stage.STEERED:
            step[k] = 1e-6
        du = 1e-6 if k == stage.U else 0.0
        numeric = (moved(row + step, 0.7 + du)[0] - moved(row - step, 0.7 - du)[0]) / 2e-6
        assert_allclose(D[:, k], numeric[: stage.STEERED], atol=1e-8)


def test_stages_solve_the_equations_of_motion() -> None:
    """Many short ones against an integration of the equations in the plane; a robot 0.3 m beside the path, slipping."""
    body = BODY.copy()
    body[stage.STEP] = body[stage.PERIOD] = 0.001
    row = ROW.copy()
    row[stage.Y], row[stage.SPEED_ASKED] = 0.3, 1.5
    start, u = row.copy(), 0.7
    for _ in range(500):
        after = np.zeros(stage.ROW)
        stage.ask_speed(row, body, np.full(9, 1.5), EIGHT.length, True, after)
        stage.move(row, u, body, EIGHT.knots, True, np.empty(5), after, np.zeros((6, 7)))
        row = after
    at = EIGHT.at(start[stage.S])
    pose = compose(at, (0.0, start[stage.Y], start[stage.THETA]))
    z = [*pose, start[stage.SIDE], start[stage.OMEGA], start[stage.RIMS], start[stage.ASKED], start[stage.S]]
    x, y, yaw, side, omega, rims, asked, _ = solve_ivp(_rates, (0.0, 0.5), z, args=(u, body), rtol=1e-8).y[:, -1]
    s = EIGHT.project((x, y), near=start[stage.S])
    _, y_e, theta_e = EIGHT.error(np.array([x, y, yaw]), s)
    exact = [y_e, theta_e, side, omega, rims, asked, s]
    assert_allclose(row[: stage.SPEED], exact, atol=2e-3)
    assert abs(y_e - 0.3) > 0.01
    assert abs(side) > 0.05


def _rates(_: float, z: FloatArray, u: float, body: FloatArray) -> list[float]:
    """The equations of ``control.observer``, the curvature being the path's."""
    _, _, yaw, side, omega, rims, asked, s = z
    c = float(EIGHT.curvature(s))
    v = (body[stage.SCALE] + body[stage.LOSS] * abs(c)) * 1.5
    k = body[stage.COMPLIANCE] + body[stage.GIVE] * abs(c)
    bent = body[stage.COMPLIANCE] * v * v + body[stage.GIVE] * v * abs(omega)
    driven = body[stage.GAIN] * rims + body[stage.DRIFT] - (1.0 - body[stage.EASE] * abs(side / v)) * omega
    theta = yaw - float(EIGHT.at(s)[2])
    beside = float(EIGHT.error(np.array([z[0], z[1], yaw]), s)[1])
    return [
        v * math.cos(yaw) - side * math.sin(yaw),
        v * math.sin(yaw) + side * math.cos(yaw),
        omega,
        -(side + (body[stage.ICR_X] + bent) * omega) / (k * v),
        driven / (body[stage.COMPLIANCE] * v),
        (asked - rims) / body[stage.LAG],
        u,
        (v * math.cos(theta) - side * math.sin(theta)) / (1.0 - c * beside),
    ]


def test_the_gradient_of_the_cost_by_differences() -> None:
    row = ROW.copy()
    row[stage.THETA], row[stage.SIDE] = 0.4, -0.3
    G, H = np.zeros(6), np.zeros((6, 6))
    stage.add_cost(row, BODY, WEIGHTS, 1.3, G, H)
    for k in range(stage.STEERED):
        step = np.zeros(stage.ROW)
        step[k] = 1e-6
        costs = [stage.cost(row + sign * step, BODY, WEIGHTS) for sign in (1.0, -1.0)]
        assert G[k] == pytest.approx(1.3 * (costs[0] - costs[1]) / 2e-6, abs=1e-8)
    assert np.linalg.eigvalsh(H).min() >= -1e-12


@settings(deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(0.0, 2.0), st.floats(-1.0, 1.0), st.floats(0.5, 20.0), st.floats(1.5, 9.0))
def test_the_bounds_keep_the_rims_within_their_limits(
    asked: float, speed: float, growth: float, rim_acceleration: float, omega_max: float
) -> None:
    body, row, out = BODY.copy(), ROW.copy(), np.empty(2)
    body[[stage.RIM_ACCELERATION, stage.OMEGA_MAX]] = rim_acceleration, omega_max
    h, after = body[stage.STEP], max(speed + growth * body[stage.STEP], 0.0)
    row[[stage.ASKED, stage.SPEED_ASKED]] = asked, speed
    stage.bounds(row, after, body, out)
    by_speed, by_turn = body[stage.BY_SPEED : stage.BY_TURN], body[stage.BY_TURN : stage.BY_TURN + 2]
    before = by_speed * speed + by_turn * asked

    def kept(u: float, slack: float) -> bool:
        rims = by_speed * after + by_turn * (asked + u * h)
        fast = np.abs(rims).max() <= body[stage.RIM_SPEED] + slack
        sudden = np.abs(rims - before).max() <= (rim_acceleration + slack) * h
        return bool(fast and sudden and abs(asked + u * h) <= omega_max + slack)

    if out[0] < out[1]:
        assert kept(out[0], 1e-9)
        assert kept(out[1], 1e-9)
        assert not kept(out[1] + 0.1, 1e-9)
        assert not kept(out[0] - 0.1, 1e-9)
    else:
        assert not any(kept(u, -1e-6) for u in np.linspace(-200.0, 200.0, 401))


# the plan


def planned(u: FloatArray, iterations: int = 50, row: FloatArray = ROW) -> tuple[int, FloatArray, FloatArray]:
    u, rows = u.copy(), np.empty((len(u) + 1, stage.ROW))
    road = EIGHT.knots, True, np.full(9, 1.5)
    return horizon.plan(row, u, BODY, WEIGHTS, *road, iterations, 1e-10, rows), u, rows


def test_no_small_change_of_a_plan_costs_less() -> None:
    _, u, _ = planned(np.zeros(60))
    least = _cost(u)
    for seed in range(30):
        tried = u + 1e-2 * np.random.default_rng(seed).standard_normal(60)
        assert _cost(tried) > least


def _cost(u: FloatArray) -> float:
    """As the kernel's documentation has it, of the rows of a plan that is not improved."""
    _, u, rows = planned(u, 0)
    at, h = np.empty(5), BODY[stage.STEP]
    total = 0.0
    for before, after, rate in zip(rows[:-1], rows[1:], u, strict=True):
        growth = (after[stage.SPEED_ASKED] - before[stage.SPEED_ASKED]) / h
        wanted = stage.wanted(after, growth, BODY, EIGHT.knots, True, at)
        total += h * (stage.cost(after, BODY, WEIGHTS) + WEIGHTS[stage.EFFORT] * (rate - wanted) ** 2)
    return float(total + WEIGHTS[stage.END] * stage.cost(rows[-1], BODY, WEIGHTS))


def test_a_plan_keeps_its_bounds_and_leads_to_the_path() -> None:
    row = ROW.copy()
    row[stage.Y] = 0.8
    _, u, rows = planned(np.zeros(60), row=row)
    rims = rows[:, [stage.SPEED_ASKED, stage.ASKED]] @ BODY[stage.BY_SPEED : stage.BY_SPEED + 4].reshape(2, 2)
    change = np.abs(np.diff(rims, axis=0)) / BODY[stage.STEP]
    assert change.max() == pytest.approx(BODY[stage.RIM_ACCELERATION])  # it is used, and no more
    assert np.abs(rims).max() <= BODY[stage.RIM_SPEED]
    assert abs(rows[-1, stage.Y]) < 0.4
    assert_allclose(np.diff(rows[:, stage.ASKED]), BODY[stage.STEP] * u)


def test_a_plan_without_a_finite_cost_is_left_as_it_was() -> None:
    row = ROW.copy()
    row[stage.OMEGA] = math.nan
    done, u, _ = planned(np.full(60, 0.3), row=row)
    assert done == horizon.UNKNOWN
    assert (u == 0.3).all()


# the speed profile

PATHS = {
    "eight": EIGHT,
    "stadium": stadium(6.0, 1.5),
    "spiral": clothoid(9.0, -0.8, 0.9),
    "bends": join(line(3.0), arc(1.0, 2.0), line(2.0), arc(2.0, -1.5)),
}


@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
@given(
    st.floats(0.2, 3.0),
    st.floats(0.2, 3.0),
    st.floats(1.0, 8.0),
    st.floats(0.3, 5.0),
    st.floats(0.3, 3.0),
    st.booleans(),
)
@settings(max_examples=15, deadline=None)
def test_a_profile_keeps_every_limit(
    path: Path, speed: float, acceleration: float, rim: float, lateral: float, omega_max: float, reverse: bool
) -> None:
    path = path.in_reverse() if reverse else path
    limits = Limits(speed, acceleration, rim, lateral, omega_max)
    v = speed_profile(path, WHEELS, limits).speeds
    s = np.linspace(0.0, path.length, len(v))
    curvature = path.curvature(s - 1e-6 * np.sign(s))
    ahead = -1.0 if reverse else 1.0
    rims = PLANT.wheel_speeds(ahead * v, v * curvature)
    assert v.max() <= speed
    assert np.abs(rims).max() <= WHEELS.max_speed
    assert (v**2 * np.abs(curvature)).max() <= lateral * (1.0 + 1e-5)
    assert (v * np.abs(curvature)).max() <= omega_max * (1.0 + 1e-5)
    with np.errstate(divide="ignore"):
        dt = 2.0 * np.diff(s) / (v[:-1] + v[1:])
    assert (np.abs(np.diff(v)) / dt).max() <= acceleration * (1.0 + 1e-9)
    assert (np.abs(np.diff(rims, axis=0)) / dt[:, None]).max() <= rim
    if path.closed:
        assert v[0] == v[-1]
    else:
        assert v[-1] == 0.0
        assert v.max() > 0.0


def test_a_profile_by_hand() -> None:
    """3 m on a line: half of it to brake from sqrt(2 a s), and no faster than the wheels."""
    profile = speed_profile(line(3.0), Wheels(Icr(0.5, -0.5, 0.1, 1.0, 1.0), 2.0), Limits(9.0, 1.2, 5.0))
    assert profile.at(2.5) == pytest.approx(math.sqrt(2.0 * 1.2 * 0.5), rel=1e-3)
    assert profile.at(0.0) == pytest.approx(0.95 * 2.0)
    assert profile.at(5.0) == 0.0
    tight = speed_profile(arc(0.5, 3.0), Wheels(Icr(0.5, -0.5, 0.1, 1.0, 1.0), 2.0), Limits(9.0, 9.0, 50.0, 9.0))
    assert tight.at(0.2) == pytest.approx(0.95 * 2.0 / (1.0 + 0.5 / 0.5))  # Eq. (16) of Huskic 2017


# the observer


def test_the_filter_of_the_pose_has_the_right_derivatives() -> None:
    x = np.array([0.3, -0.2, 0.7, 0.1, 0.95, -0.1, 1.02, 0.05, 0.04, 0.03])
    F, room = np.empty((10, 10)), np.empty((10, 10))
    slip.roll(x.copy(), 0.05, 1.4, -0.6, F)
    for k in range(slip.STATES):
        ends = [x.copy(), x.copy()]
        ends[0][k] += 1e-6
        ends[1][k] -= 1e-6
        for end in ends:
            slip.roll(end, 0.05, 1.4, -0.6, room)
        assert_allclose(F[:, k], (ends[0] - ends[1]) / 2e-6, rtol=5e-2, atol=1e-7)  # the lag shifts the mean


def test_the_filter_of_the_turn_carries_its_covariance_by_its_derivative() -> None:
    drives, usual, none = (0.05, 0.9, 1.1, 0.1, 0.15, 0.3, 0.0), np.array([0.0, 1.0, 0.0, 0.7]), np.zeros(4)

    def after(t: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
        t, P = t.copy(), P.copy()
        slip.turn(t, P, *drives, none, 1e12, usual, 20.0)  # what is measured tells nothing
        return t, P

    t, P = np.array([0.8, 1.1, 0.05, 0.9]), np.diag([0.1, 0.2, 0.3, 0.4])
    P[0, 3] = P[3, 0] = 0.05
    F = np.array([(after(t + e, P)[0] - after(t - e, P)[0]) / 2e-6 for e in 1e-6 * np.eye(4)]).T
    assert_allclose(after(t, P)[1], F @ P @ F.T, atol=1e-7)


@pytest.mark.parametrize("delay", [0.0, 0.05, 0.06, 0.13])
def test_the_pose_is_told_as_if_it_came_at_once(delay: float) -> None:
    """Exact kinematics with lag, told late: within 1 mm of where the robot is, delay of whole steps or not."""
    run = drive(controller(1.5, 0.1, delay), sensing=Sensing(delay=delay))
    law = controller(1.5, 0.1, delay)
    state = law.begin(EIGHT, run.seen[0])
    worst = 0.0
    for i in range(1, 300):
        sent = PLANT.twist(*run.sent[i - 1])
        told = PLANT.twist(*run.states[i, 6:])
        state = law.advance(state, run.seen[i], told, 0.02, (float(sent[0]), float(sent[2])))
        worst = max(worst, float(np.hypot(*(np.array(state.estimate.pose[:2]) - run.states[i, :2]))))
    assert worst < 1e-3
    assert np.hypot(*(run.seen[299, :2] - run.states[299, :2])) == pytest.approx(1.5 * delay, abs=0.01)


def test_without_a_pose_the_observer_reckons_with_the_slip_and_learns_nothing() -> None:
    """2 s blind: as with a pose that tells nothing, its slip as known, the robot not where its rims alone lead."""
    blind, told = Observer(0.1, 0.06), Observer(0.1, 0.06, 1e6, 1e6)
    start = blind.begin((1.0, 2.0, 0.5), 0.28, 0.05)
    a = b = start
    for k in range(100):
        a = blind.advance(a, None, 1.5, 0.6, 0.02, 0.6)
        b = told.advance(b, (k, -k, 0.0), 1.5, 0.6, 0.02, 0.6)
    assert_allclose(a.now, b.now, atol=1e-8)
    assert_allclose(a.late_covariance, b.late_covariance, atol=1e-8)
    assert_allclose(a.now[slip.SCALE :], start.now[slip.SCALE :], rtol=1e-12)
    assert np.diag(a.late_covariance)[0] > 10.0 * np.diag(start.late_covariance)[0]
    assert len(a.steps) <= 4


def test_a_leap_of_the_map_is_as_sure_as_a_pose_and_tells_nothing_of_the_slip() -> None:
    x, pose, R = np.linspace(0.1, 0.5, 10), np.array([1.9, 0.25, 0.35]), np.array([1e-4, 2e-4, 3e-4])
    A = 0.03 * np.random.default_rng(0).normal(size=(10, 10))
    P = A @ A.T
    after, covariance = x.copy(), P.copy()
    assert slip.update(after, covariance, pose, R, 8.0)
    assert_allclose(after, [*pose, *x[3:]], atol=1e-12)
    assert_allclose(covariance[:3], np.hstack([np.diag(R), np.zeros((3, 7))]), atol=0.0)
    assert_allclose(covariance[3:, 3:], P[3:, 3:], atol=0.0)
    H, S = np.eye(10)[:3], P[:3, :3] + np.diag(R)
    near = x[:3] + 0.01
    after, covariance = x.copy(), P.copy()
    assert not slip.update(after, covariance, near, R, 8.0)
    K = np.linalg.solve(S, H @ P).T
    assert_allclose(after, x + K @ (near - x[:3]), atol=1e-12)
    assert_allclose(covariance, P - K @ S @ K.T, atol=1e-12)


@pytest.mark.parametrize("truth", ["scheduled", "wide"])
def test_poses_at_10_hz_are_no_more_than_they_tell(truth: str) -> None:
    """Between two poses none comes: what is reckoned there must not count as seen. (It did: 1.3 and 0.8 cm.)"""
    lost = tuple((0.1 * k + 0.01, 0.1 * k + 0.09) for k in range(600))
    sensing = Sensing(delay=0.06, position_sigma=0.005, yaw_sigma=0.003, gyro_sigma=0.003, lost=lost)
    run = drive(controller(1.5), truth=WRONG[truth], sensing=sensing)
    assert run.done
    assert np.isfinite(run.seen[:, 0]).mean() == pytest.approx(0.2, abs=0.01)
    assert np.abs(run.cross_track[run.t > 6.0]).mean() < {"scheduled": 0.009, "wide": 0.006}[truth]


def test_a_slip_that_the_calibration_does_not_know_is_found() -> None:
    """A robot whose ICR moves ahead by 0.25 s v and that turns less: side = -(0.28 + 0.25 v) omega, 0.9 omega."""
    truth = ScheduledIcr(0.55, -0.48, 0.28, 0.9, 0.93, 0.0, 0.25, 0.0, 0.0, 0.0)
    run = drive(controller(1.5), truth=truth, ends=Ends(2.0))
    assert run.done
    law, found = controller(1.5), []
    state = law.begin(EIGHT, run.seen[0])
    for i in range(1, len(run.t)):
        sent, told = PLANT.twist(*run.sent[i - 1]), PLANT.twist(*run.states[i, 6:])
        told[2] = run.states[i, 5]
        state = law.advance(state, run.seen[i], told, 0.02, (float(sent[0]), float(sent[2])))
        now, (v_x, v_y, omega) = state.estimate.now, run.states[i, 3:6]
        if run.t[i] > 8.0 and abs(omega) > 0.7:
            icr_x = now[slip.ICR_X] + (now[slip.COMPLIANCE] + now[slip.GIVE] * abs(omega) / v_x) * v_x**2
            found.append((icr_x + v_y / omega, now[slip.SIDE] - v_y, state.estimate.turn[slip.OMEGA] - omega))
    off = np.abs(found)
    assert len(off) > 300
    assert (off.mean(axis=0) < [0.03, 0.01, 0.001]).all()


# the closed loop


@pytest.mark.parametrize(("speed", "lag", "delay"), [(0.5, 0.0, 0.0), (1.5, 0.1, 0.06), (2.0, 0.2, 0.1)])
def test_it_follows_exact_kinematics_to_millimetres(speed: float, lag: float, delay: float) -> None:
    run = drive(controller(speed, lag, delay), lag=lag, sensing=Sensing(delay=delay))
    assert run.done
    off = np.abs(run.cross_track)
    assert off.max() < 0.01
    assert off[run.t > 4.0].mean() < 2e-3
    assert run.states[run.t > 4.0, 3].mean() == pytest.approx(speed, rel=0.03)


WRONG = {
    "wide": Icr(0.60, -0.35, 0.1, 0.8, 0.85),
    "narrow": Icr(0.35, -0.36, 0.4, 1.0, 0.97),
    "scheduled": ScheduledIcr(0.48, -0.42, 0.28, 0.9, 0.93, 0.05, 0.2, 0.2, 0.3, 0.1),
}


@pytest.mark.parametrize("truth", WRONG.values(), ids=WRONG)
def test_a_wrong_model_leaves_no_offset(truth: Model) -> None:
    """ICRs wrong by a third, rims by a tenth: without the states of the slip it stays centimetres off."""
    run = drive(controller(1.5), truth=truth)
    assert run.done
    late = np.abs(run.cross_track[run.t > 6.0])
    assert late.mean() < 0.01
    assert late.max() < 0.04


@pytest.mark.parametrize("seed", range(3))
def test_it_slows_down_where_the_ground_has_no_grip(seed: int) -> None:
    """2 m/s on curves that take 0.8 of the friction of gravel, with noise. (It drifted on: 0.2-0.6 m off.)"""
    wheels = Wheels(low_speed("terramechanic", SUMMIT, parse_ground("gravel")), 3.0)
    sensing = Sensing(delay=0.06, position_sigma=0.005, yaw_sigma=0.003, gyro_sigma=0.003)
    robot = begin("terramechanic", SUMMIT, parse_ground("gravel"), EIGHT.robot(0.0), 0.1)
    run = follow(robot, controller(2.0, wheels=wheels), wheels, EIGHT, sensing, Ends(2.0, 60.0), 3.0, seed)
    assert run.done
    assert np.abs(run.cross_track).max() < 0.15
    assert np.abs(run.cross_track).mean() < 0.04
    assert run.states[run.t > 4.0, 3].mean() > 1.5


def test_the_pace_falls_by_the_slip_that_speed_adds_and_comes_back() -> None:
    """A curve so tight that the ICR of low speed alone slips by 0.56 rad is driven at full pace."""
    law = controller(1.0)
    state = law.begin(circle := arc(0.5, 3.0), circle.at(0.0))
    rows = np.zeros((len(state.plan) + 1, stage.ROW))
    rows[:, stage.SPEED], rows[:, stage.OMEGA] = 1.0, 2.0
    at_low_speed = -float(state.estimate.now[slip.ICR_X]) * 2.0
    paces = []
    for beyond in (0.39, 0.41):
        rows[:, stage.SIDE] = at_low_speed - beyond
        paces.append(law._pace(replace(state, pace=0.8), rows))
    change = 1.0 * 0.02 / float(state.profile.speeds.max())  # by 1 m/s^2 in a period
    assert_allclose(paces, [0.8 + 0.5 * change, 0.8 - change])
    rows[: len(rows) // 2 + 1, stage.SIDE] = at_low_speed
    assert law._pace(replace(state, pace=0.8), rows) > 0.8  # its end is never driven
    assert law._pace(replace(state, pace=1.0), rows) == 1.0


@pytest.mark.parametrize("start", [(0.0, 4.0, 0.3), (2.0, -1.0, math.pi), (1.0, -6.0, 2.5), (0.0, 0.5, -1.6)])
def test_it_comes_to_a_line_from_anywhere(start: tuple[float, float, float]) -> None:
    run = drive(controller(1.0), line(30.0), np.array(start), ends=Ends(1.0, 60.0, 9.0))
    assert run.done
    assert np.abs(run.cross_track[run.s > 15.0]).max() < 0.01


def test_driving_in_reverse_is_the_mirror() -> None:
    wheels = Wheels(TURNED, 3.0)
    ahead = drive(controller(1.2, wheels=wheels), truth=TURNED, start=EIGHT.at(0.0) + [0.1, 0.2, 0.1])
    back = EIGHT.in_reverse()
    reverse = drive(controller(1.2), back, back.robot(0.0) + [0.1, 0.2, 0.1])
    n = min(len(ahead.t), len(reverse.t))
    assert n > 700
    assert_allclose(reverse.cross_track[:n], ahead.cross_track[:n], atol=1e-6)
    assert_allclose(reverse.sent[:n], -ahead.sent[:n, ::-1], atol=1e-6)


def test_it_stops_at_the_end() -> None:
    path = clothoid(6.0, 0.0, 0.4)
    run = drive(controller(1.5), path)
    assert run.outcome == "arrived"
    assert np.abs(run.cross_track).max() < 0.01
    assert np.hypot(*(run.states[-1, :2] - path.end[:2])) < 0.03
    assert run.states[:, 3].max() > 1.2


def test_a_leap_of_the_localization_is_driven_back_gently() -> None:
    run = drive(controller(1.5), sensing=Sensing(delay=0.06, jumps=(Jump(left=0.886, time=6.0),)))
    assert run.done
    after = run.t > 6.0
    assert run.cross_track[after].max() == pytest.approx(0.886, abs=0.05)
    assert run.cross_track[after].min() > -0.1  # hardly an overshoot
    assert np.abs(run.cross_track[run.t > 10.0]).max() < 0.02
    assert np.abs(run.heading_error).max() < 1.0
    rims = run.sent[:, 1] - run.sent[:, 0]
    assert np.abs(np.diff(rims)).max() <= 2.0 * 3.0 * 0.02 + 1e-9


@pytest.mark.parametrize("speed", [1.0, 2.5])
def test_no_limit_is_exceeded_in_any_sample(speed: float) -> None:
    """Noise, a leap, a start off the path: rims, their acceleration and the yaw rate stay within their limits."""
    wheels, limits = Wheels(PLANT, 1.8), Limits(speed, 0.8, 2.0, 3.0, 1.2)
    law = Predictive(PredictiveGains(), wheels, limits, Observer(0.1, 0.06))
    noisy = Sensing(50.0, 0.06, 0.02, 0.01, 0.02, 0.01, (Jump(left=-0.6, turn=0.3, time=4.0),))
    run = drive(law, start=EIGHT.at(0.0) + [0.3, -0.5, 1.9], sensing=noisy)
    assert run.done
    asked = PLANT.wheel_speeds(*run.commanded.T)
    assert np.abs(asked).max() <= 1.8 + 1e-9
    assert np.abs(np.diff(asked, axis=0)).max() <= 2.0 * 0.02 + 1e-9
    assert np.abs(run.commanded[:, 1]).max() <= 1.2 + 1e-9
    assert np.abs(run.cross_track[run.t > 10.0]).mean() < 0.02


# the interface


def test_what_is_not_known_is_refused() -> None:
    law = controller()
    state = law.begin(EIGHT, EIGHT.at(3.0))
    for bad in ((math.nan, 0.0, 0.0), (0.0, 0.0, math.inf), (0.0, 0.0)):
        for pose, twist, word in ((bad, STILL, "pose"), (EIGHT.at(3.0), bad, "twist")):
            with pytest.raises(DataError, match=f"the {word} is"):
                law.command(pose, twist, state)
            with pytest.raises(DataError, match=f"the {word} is"):
                law.advance(state, pose, twist, 0.02, (0.0, 0.0))
        with pytest.raises(DataError, match="the pose is"):
            law.begin(EIGHT, bad)
    for dt in (-0.02, math.nan):
        with pytest.raises(DataError, match="the time step is"):
            law.advance(state, EIGHT.at(3.0), STILL, dt, (0.0, 0.0))


def test_no_time_changes_nothing() -> None:
    law = controller()
    state = law.begin(EIGHT, EIGHT.at(3.0))
    assert law.advance(state, EIGHT.at(3.1), STILL, 0.0, (0.3, 0.1)) is state


def test_its_functions_are_pure() -> None:
    law = controller()
    state = law.begin(EIGHT, EIGHT.at(3.0))
    once, again = (law.advance(state, EIGHT.at(3.1), (0.4, 0.0, 0.1), 0.02, (0.5, 0.2)) for _ in range(2))
    assert once.next == again.next
    assert_allclose(once.plan, again.plan, atol=0.0)
    assert_allclose(once.estimate.late_covariance, again.estimate.late_covariance, atol=0.0)


def test_where_no_plan_has_a_finite_cost_it_brakes() -> None:
    law = controller(1.5)
    run = drive(law, ends=Ends(0.5))
    state = law.begin(EIGHT, run.seen[100])
    broken = replace(state, plan=np.full_like(state.plan, math.nan), asked=(1.2, 0.4))
    after = law._planned(broken)
    assert after.iterations == horizon.UNKNOWN
    assert after.next == pytest.approx((1.18, 0.4 * 1.18 / 1.2))


def test_steps_of_another_length_than_the_period() -> None:
    for rate in (20.0, 90.0):
        run = drive(controller(1.5), sensing=Sensing(rate, 0.06))
        assert run.done
        assert np.abs(run.cross_track[run.t > 4.0]).max() < 0.02


def test_a_scheduled_model_tells_the_slip_to_begin_with() -> None:
    """side = -(0.28 omega' + 0.2 v omega / (1 + 0.1 v)); omega' is the gain times omega, at a curvature of 0.2."""
    law = replace(controller(1.5), scheduled=WRONG["scheduled"])
    now = law.begin(EIGHT, EIGHT.at(3.0)).estimate.now
    gain = 1.0 + 0.2 * 1.5**2 / (1.5**2 + (0.9 * 0.244) ** 2 + 0.02**2) + 0.3 * 0.366 / 3.366  # omega 0.3 / 1.228
    by_hand = 0.28 + 0.2 * 1.5 / (1.0 + 0.1 * 1.5) / gain
    crawling = 1.0 + 0.2 * 0.1**2 / (0.1**2 + (0.9 * 0.0168) ** 2 + 0.02**2)
    assert now[slip.ICR_X] == pytest.approx(0.28 + 0.2 * 0.1 / 1.01 / crawling, abs=1e-4)
    assert now[slip.ICR_X] + now[slip.COMPLIANCE] * 1.5**2 == pytest.approx(by_hand, abs=1e-3)


def test_more_than_the_wheels_can_do_is_as_fast_as_they_can() -> None:
    run = drive(controller(50.0, wheels=Wheels(PLANT, 1.2)))
    assert run.done
    assert 0.95 * 1.2 <= np.abs(run.sent).max() <= 1.2
    assert np.abs(run.cross_track[run.t > 4.0]).max() < 0.01


class Mute(Icr):
    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:
        return super().wheel_speeds(v, omega) * math.nan


def test_a_speed_of_which_a_model_tells_nothing_is_refused() -> None:
    law, mute = controller(2.5), Mute(*PLANT.theta)
    with pytest.raises(RequestError, match=r"the model icr tells no ICR at 2\.50 m/s; ask for a lower speed"):
        replace(law, scheduled=mute).begin(EIGHT, EIGHT.at(3.0))
    with pytest.raises(RequestError, match=r"the model icr tells no rim speeds at 2\.5 m/s"):
        replace(law, wheels=Wheels(mute, 3.0)).begin(EIGHT, EIGHT.at(3.0))


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="need reach > 0"):
        PredictiveGains(reach=0.0)
    with pytest.raises(ValueError, match="theta_a below pi / 2"):
        PredictiveGains(theta_a=1.6)
    with pytest.raises(ValueError, match="need a finite speed"):
        Limits(math.inf)
    with pytest.raises(ValueError, match="need acceleration > 0"):
        Limits(1.0, acceleration=math.nan)
    with pytest.raises(ValueError, match="need a finite delay of at least 0 s"):
        Observer(0.1, -0.1)
    with pytest.raises(ValueError, match="need period < horizon"):
        replace(controller(), period=2.0)


def test_the_state_tells_where_it_is() -> None:
    state = controller().begin(EIGHT, EIGHT.at(3.0))
    assert isinstance(state, PredictiveState)
    assert state.s == pytest.approx(3.0)
    assert not state.arrived
