import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.calibration import Calibration, Estimate, Provenance
from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.identify.design import Design, Request, design_drive, make_request, setup_of
from skidsteer.identify.excite import Choice, Setup, log_det
from skidsteer.identify.excursion import (
    excursion,
    expected_icr_distance,
    expected_model,
    footprint_radius,
    possible_models,
    trajectory,
)
from skidsteer.identify.least_squares import fit
from skidsteer.identify.manoeuvres import PERIOD, Figure, Limits, Manoeuvre, library, rims_of
from skidsteer.identify.unplanned import unplanned_drive
from skidsteer.models import MODELS, Differential, Icr, Model, Multiplier, ScheduledIcr
from skidsteer.noise import Noise
from skidsteer.se2 import FloatArray, between, chain, compose, exp
from skidsteer.simulate import Sensors, kinematic_drive
from skidsteer.vehicle import Vehicle, preset
from skidsteer.windows import Timing, Windows, increment_windows, predict

JACKAL = preset("jackal")
LIMITS = Limits.of(JACKAL, 2.0)
SQUARE = Request((20.0, 20.0), 180.0)


@pytest.fixture(scope="module")
def designed() -> Design:
    return design_drive(setup_of(JACKAL, Icr), LIMITS, SQUARE)


speeds = st.floats(-2.0, 2.0).filter(lambda v: abs(v) > 0.01)


@given(speeds, speeds, st.floats(0.05, 10.0), st.floats(0.2, 5.0))
def test_a_manoeuvre_covers_its_distance_within_the_acceleration(
    left: float, right: float, duration: float, acceleration: float
) -> None:
    rims = Manoeuvre(0.0, 0.0, (left, right), duration).profile(acceleration)
    assert_allclose(rims.sum(axis=0) * PERIOD, np.array([left, right]) * duration, rtol=1e-9)
    padded = np.concatenate([np.zeros((1, 2)), rims, np.zeros((1, 2))])
    assert np.abs(np.diff(padded, axis=0)).max() <= acceleration * PERIOD * (1.0 + 1e-9)
    assert np.abs(rims).max() <= max(abs(left), abs(right)) * (1.0 + 1e-9)
    assert_allclose(rims[:, 0] * right, rims[:, 1] * left, atol=1e-12)  # the ratio of the sides is kept


@pytest.mark.parametrize("family", ["icr", "scheduled_icr"])
def test_figures_keep_the_limits_and_come_back_whatever_the_robot(family: str) -> None:
    model = expected_model(MODELS[family], JACKAL)
    robot = Icr(0.35, -0.22, 0.07, 0.93, 1.02)
    figures = library(model, LIMITS, 3.0)
    assert len({figure.words() for figure in figures}) > 50
    for figure in figures:
        rims = rims_of([figure], LIMITS.acceleration, 3.0)
        twist = model.twist(*rims.values.T)
        assert np.abs(rims.values).max() <= LIMITS.wheel_speed + 1e-9
        assert np.abs(twist[:, 0]).max() <= LIMITS.speed + 1e-6
        assert np.abs(twist[:, 2]).max() <= LIMITS.omega + 1e-6
        assert np.abs(twist[:, 0] * twist[:, 2]).max() <= LIMITS.lateral_acceleration + 1e-6
        assert_allclose(trajectory(robot, rims, 0.15).values[-1], 0.0, atol=1e-3)  # the lag rounds corners


def test_the_library_goes_both_ways_and_knows_every_kind() -> None:
    words = " / ".join(figure.words() for figure in library(expected_model(Icr, JACKAL), LIMITS, 3.0))
    for kind in (
        "straight ahead, 3.0 m at 2.00 m/s, back through the middle to the other end, and to the middle",
        "straight ahead, 3.0 m at 2.00 m/s, back through the middle to the other end, 4 times to and fro, and to the",
        "turn on the spot to the left, 1 turn at 1.50 rad/s, and back",
        "turn on the spot to the right, 2 turns at 0.45 rad/s, and back",
        "arc ahead about the left, radius 0.28 m, 90 deg at 0.38 m/s, and back; the same backwards about the right",
    ):
        assert kind in words


def dense_information(setup: Setup, rims: Series) -> FloatArray:
    """J^T C^-1 J with everything by central differences and the whole covariance of all increments at once."""
    t = np.arange(0.0, rims.t[-1], 1.0 / setup.reference_rate)
    k = len(t) - 1

    def increments(values: FloatArray, poses: FloatArray, moved: FloatArray) -> FloatArray:
        model, timing = setup.model.with_theta(values[:-2]), Timing(values[-1], values[-2])
        motion = predict(model, rims, Windows(t[:-1], t[1:], np.zeros((k, 3)), np.ones(k, bool)), timing)
        measured = compose(chain(compose(motion, exp(moved))), exp(poses))
        return between(measured[:-1], measured[1:]).ravel()

    x = np.array([*setup.model.theta, setup.timing.lag, 0.0])
    zero = (x, np.zeros((k + 1, 3)), np.zeros((k, 3)))

    def slope(i: int) -> FloatArray:
        columns, step = [], 1e-6
        for j in range(zero[i].size):
            ends = []
            for sign in (1.0, -1.0):
                moved = [a.copy() for a in zero]
                moved[i].flat[j] += sign * step
                ends.append(increments(*moved))
            columns.append((ends[0] - ends[1]) / (2.0 * step))
        return np.array(columns).T

    noise = setup.noise
    fine = np.arange(0.0, rims.t[-1], 1e-3)
    lagged = np.zeros((len(fine), 2))
    for i in range(1, len(fine)):
        lagged[i] = lagged[i - 1] + 1e-3 / setup.timing.lag * (rims.hold(fine[i - 1]) - lagged[i - 1])
    rolled, apart = np.abs(lagged).mean(axis=1), 0.5 * np.abs(lagged[:, 1] - lagged[:, 0])
    paths = np.cumsum(np.stack([rolled, rolled, 0.9 * apart + 0.1 * rolled], axis=1), axis=0) * 1e-3
    grown = np.diff([np.interp(t, fine, path) for path in paths.T]).T
    Q = np.diag((grown * [noise.walk**2, noise.walk**2, noise.turn**2]).ravel())
    R = np.diag(np.tile([noise.position**2, noise.position**2, noise.yaw**2], k + 1))
    J, P, M = slope(0), slope(1), slope(2)
    return np.asarray(J.T @ np.linalg.solve(P @ R @ P.T + M @ Q @ M.T, J))


@pytest.mark.parametrize(
    "model", [Icr(0.3, -0.25, 0.05, 0.95, 1.03), ScheduledIcr(0.3, -0.25, 0.05, 0.95, 1.03, 0.1, 0.2, 0.1, 0.15, 0.3)]
)
def test_information_is_that_of_all_increments_at_once(model: Model) -> None:
    noise = Noise(position=0.02, yaw=0.01, stamp=1e-4, walk=0.05, turn=0.04)
    setup = Setup(JACKAL, model, noise, Timing(0.0, 0.1), 5.0)
    rims = rims_of([Figure.retraced(Manoeuvre(0.5, 0.8, (0.3, 0.8), 2.0))], 1.5, 0.5)
    ours, dense = setup.information(rims), dense_information(setup, rims)
    scale = np.sqrt(np.diag(dense))
    assert_allclose(ours / np.outer(scale, scale), dense / np.outer(scale, scale), atol=4e-3)


def test_what_a_fit_takes_for_known_before_a_drive() -> None:
    bounds = Icr.bounds(JACKAL)
    expected = [*12.0 / (bounds[:, 1] - bounds[:, 0]) ** 2, 1.0 / 0.5**2, 1.0]
    assert_allclose(setup_of(JACKAL, Icr).prior, expected)


def test_motion_noise_grows_with_the_distance() -> None:
    rims = Series(np.arange(0.0, 4.01, 0.05), np.ones((81, 2)), "wheels")
    model, noise = Icr(0.3, -0.3, 0.0, 1.0, 1.0), Noise(walk=0.05, turn=1e-4)
    ends = np.array([trajectory(model, rims, 0.0, noise, seed).values[-1, :2] for seed in range(400)])
    assert_allclose(ends.std(axis=0), 0.05 * np.sqrt(4.0), rtol=0.12)


def random_information(count: int, size: int, seed: int) -> FloatArray:
    rows = np.random.default_rng(seed).standard_normal((count, 2, size))
    return np.einsum("nki,nkj->nij", rows, rows)


def test_timing_is_marginalised() -> None:
    H = random_information(9, 5, 1).sum(axis=0)
    assert log_det(H) == pytest.approx(-np.linalg.slogdet(np.linalg.inv(H)[:3, :3])[1])


def every_choice(durations: FloatArray, time: float) -> list[tuple[int, ...]]:
    choices = itertools.chain(*(itertools.combinations_with_replacement(range(6), n) for n in range(1, 8)))
    return [c for c in choices if durations[list(c)].sum() <= time]


@pytest.mark.parametrize("seed", range(4))
def test_the_choice_is_nearly_the_best_of_all(seed: int) -> None:
    matrices, durations = random_information(6, 4, seed), np.array([1.0, 1.5, 2.0, 1.2, 0.8, 2.5])
    choice = Choice(matrices, durations, np.full(4, 0.01), np.full(4, np.inf))
    found = choice.choose(6.0)
    assert durations[found].sum() <= 6.0 + 1e-9
    assert choice.of(found) > max(map(choice.of, every_choice(durations, 6.0))) - 0.05


def test_what_misses_most_is_nearly_the_least_of_all() -> None:
    durations, enough = np.array([1.0, 1.5, 2.0, 1.2, 0.8, 2.5]), np.array([0.05, 0.04, 0.1, 0.06])  # cannot be had
    every, over = every_choice(durations, 6.0), []
    often = np.array([[choice.count(i) for i in range(6)] for choice in every])
    for seed in range(12):
        matrices = random_information(6, 4, seed)
        H = np.einsum("cn,nij->cij", often, matrices) + 0.01 * np.eye(4)
        worst = (np.sqrt(np.diagonal(np.linalg.inv(H), axis1=1, axis2=2)) / enough).max(axis=1)
        found = Choice(matrices, durations, np.full(4, 0.01), enough).choose(6.0)
        over.append(worst[every.index(tuple(sorted(found)))] / worst.min())
    assert np.median(over) < 1.005
    assert np.mean(over) < 1.03


def test_no_other_mix_of_figures_would_do_much_better(designed: Design) -> None:
    """The equivalence theorem (Kiefer, Wolfowitz 1960) bounds what any mix of figures could reach in that time."""
    setup = designed.setup
    figures = library(setup.model, LIMITS, 3.0)
    profiles = [rims_of([f], LIMITS.acceleration, 2 * PERIOD) for f in figures]
    durations = np.array([len(p) * PERIOD - 4 * PERIOD for p in profiles])
    choice = Choice(np.array([setup.information(p) for p in profiles]), durations, setup.prior, np.full(7, np.inf))
    time = 178.0
    share = np.full(len(figures), time / len(figures))
    for _ in range(300):  # multiplicative steps towards the best mix
        H = np.einsum("n,nij->ij", share / durations, choice.information) + np.diag(setup.prior)
        C, inner = np.linalg.inv(H), np.linalg.inv(H[-2:, -2:])
        of_timing = np.einsum("ij,nji->n", inner, choice.information[:, -2:, -2:])
        gain = (np.einsum("ij,nji->n", C, choice.information) - of_timing) / durations
        bound = float(log_det(H) + gain.max() * time - share @ gain)
        share *= np.sqrt(np.maximum(gain, 1e-9))
        share *= time / share.sum()
    lost = bound - choice.of(choice.choose(time))  # of the log det, at most
    assert np.exp(-lost / 5.0) > 0.95  # D-efficiency, at least


def test_a_parameter_that_is_dear_is_not_given_up(designed: Design, monkeypatch: pytest.MonkeyPatch) -> None:
    shares = {name: designed.sigmas[name] / designed.unplanned[name] for name in ("alpha_left", "alpha_right")}
    again = design_drive(setup_of(JACKAL, Icr), LIMITS, SQUARE)
    assert again.sigmas == designed.sigmas  # the same request, the same drive
    assert max(shares.values()) < 0.5
    monkeypatch.setattr("skidsteer.identify.excite.STRICTNESS", 0.0)
    careless = design_drive(setup_of(JACKAL, Icr), LIMITS, SQUARE)
    assert min(careless.sigmas[name] / careless.unplanned[name] for name in shares) > 1.2 * max(shares.values())


def test_a_designed_drive_tells_twice_as_much_as_an_unplanned_one_and_as_much_as_it_says(designed: Design) -> None:
    """The robots are not the expected one; the fits know neither noise nor timing."""
    noise, width = designed.setup.noise, expected_icr_distance(JACKAL)
    sensors = Sensors(10.0, noise.position, noise.yaw, noise.stamp, reference_delay=0.15)
    room = SQUARE.room(JACKAL)
    sigmas: dict[str, list[FloatArray]] = {"designed": [], "unplanned": []}
    misses = []
    for seed, robot in enumerate(possible_models(JACKAL, 77)[:5]):
        assert isinstance(robot, ScheduledIcr)
        for name, rims in (
            ("designed", designed.rims),
            ("unplanned", unplanned_drive(width, LIMITS, room, designed.duration, 100 + seed)),
        ):
            drive = kinematic_drive(
                name, JACKAL, robot.constant, rims, sensors, 0.1, (noise.walk, noise.turn), seed=seed
            )
            found = fit(Icr.nominal(JACKAL), [drive], [increment_windows(drive)])
            sigmas[name].append(np.sqrt(np.diag(found.covariance))[:5])
            if name == "designed":
                misses.append((found.values[:5] - robot.constant.theta) / sigmas[name][-1])
    ours, others = (np.median(sigmas[name], axis=0) for name in ("designed", "unplanned"))
    assert (ours <= 0.5 * others).all()
    assert_allclose(ours, [designed.sigmas[p.name] for p in Icr.PARAMETERS], rtol=0.25)
    assert 0.4 < float(np.sqrt(np.mean(np.square(misses)))) < 1.6


def test_robots_that_were_not_imagined_stay_inside(designed: Design) -> None:
    robots, room = possible_models(JACKAL, 4711), SQUARE.room(JACKAL)
    inside = []
    for i, robot in enumerate(robots):
        path = trajectory(robot, designed.rims, 0.1, designed.setup.noise, 1000 + i).values
        inside.append((np.abs(path[:, :2]).max(axis=0) <= 0.5 * np.array(SQUARE.area) - footprint_radius(JACKAL)).all())
    assert np.mean(inside) > 0.85
    assert (np.array([designed.excursion.x, designed.excursion.y]) <= room).all()
    assert_allclose(designed.path.values[-1, :2], 0.0, atol=1e-3)


def test_a_design_keeps_time_and_limits(designed: Design) -> None:
    assert 0.9 * 180.0 < designed.duration <= 180.0
    assert np.abs(designed.rims.values).max() <= LIMITS.wheel_speed + 1e-9
    assert np.abs(np.diff(designed.rims.values, axis=0)).max() <= LIMITS.acceleration * PERIOD + 1e-9
    assert (designed.rims.values[[0, -1]] == 0.0).all()
    played = Differential(0.37559 * 1.5).wheel_speeds(*designed.commands.values.T)
    assert_allclose(played, designed.rims.values, atol=1e-12)
    last_start, last_duration, _ = designed.schedule[-1]
    assert last_start + last_duration == pytest.approx(designed.duration - 1.0)


def test_an_unplanned_drive_is_like_those_recorded() -> None:
    speed, turn, rest = [], [], []
    for seed in range(8):
        rims = unplanned_drive(0.56, LIMITS, (4.0, 3.0), 180.0, seed).values
        path = trajectory(
            Icr(0.28, -0.28, 0.0, 1.0, 1.0), Series(PERIOD * np.arange(3600.0), rims, "wheels"), 0.0
        ).values
        assert (np.abs(path[:, :2]).max(axis=0) < [4.5, 3.5]).all()
        assert np.abs(np.diff(rims, axis=0)).max() <= LIMITS.acceleration * PERIOD + 1e-9
        speed.append(np.abs(rims.mean(axis=1)).mean())
        turn.append(np.abs(np.diff(rims, axis=1)).mean() / 0.56)
        rest.append((np.abs(rims).max(axis=1) < 0.03).mean())
    assert 0.19 < np.mean(speed) < 0.26
    assert 0.08 < np.mean(turn) < 0.16
    assert 0.15 < np.mean(rest) < 0.3


def test_what_is_expected_of_a_robot() -> None:
    assert expected_icr_distance(preset("husky-a200")) == pytest.approx(0.555 * 1.875)  # factory
    assert expected_icr_distance(preset("summit-xl")) == pytest.approx(0.462 + 0.458**2 / 0.462)  # B (1 + (L / B)^2)
    assert expected_icr_distance(Vehicle("cart", 0.4, 0.1)) == pytest.approx(0.6)
    for family in (Icr, Multiplier, MODELS["icr_symmetric"], MODELS["linear"], MODELS["curvature"], ScheduledIcr):
        left, right = expected_model(family, JACKAL).wheel_speeds(0.0, 0.01)
        assert right - left == pytest.approx(0.01 * 1.5 * 0.37559, rel=1e-3), family.NAME
    assert footprint_radius(JACKAL) == pytest.approx(np.hypot(0.131 + 0.098, 0.5 * (0.37559 + 0.098)))


def test_an_excursion_is_what_nearly_all_stay_within() -> None:
    rims = Series(np.arange(0.0, 4.0, 0.05), np.ones((80, 2)), "wheels")
    robots: list[Model] = [Icr(0.3, -0.3, 0.0, a, a) for a in np.linspace(0.5, 1.5, 101)]
    reach = excursion(robots, rims, 0.0, None)
    assert reach.x == pytest.approx(1.45 * 3.95)
    assert reach.y == pytest.approx(0.0, abs=1e-9)
    assert reach.end == pytest.approx(reach.x)


@settings(max_examples=2, deadline=None)
@given(st.sampled_from([(6.0, 6.0, 120.0), (12.0, 5.0, 60.0), (30.0, 30.0, 240.0)]), st.integers(0, 5))
def test_any_request_keeps_its_area(request_: tuple[float, float, float], seed: int) -> None:
    length, width, time = request_
    request = Request((length, width), time, seed=seed)
    made = design_drive(setup_of(JACKAL, Icr), LIMITS, request)
    room = request.room(JACKAL)
    assert made.excursion.x <= room[0]
    assert made.excursion.y <= room[1]
    assert made.duration <= time


def test_what_is_not_said_follows_from_the_calibration() -> None:
    vehicle = preset("pioneer-p3at")
    names = (*(p.name for p in Icr.PARAMETERS), "lag", "time_offset")
    values = (0.2553, -0.3071, -0.0120, 0.9271, 0.9049, 0.08, 0.15)
    calibration = Calibration(
        vehicle,
        Icr(*values[:5]),
        names,
        {name: Estimate(value, 1e-3, "") for name, value in zip(names, values, strict=True)},
        1e-6 * np.eye(7),
        Noise(position=0.01, walk=0.004, turn=0.008),
        Provenance((), {}, "", ""),
    )
    setup, request = make_request("10x6", 2.0, calibration=calibration)
    assert setup.vehicle == vehicle
    assert setup.model == calibration.model
    assert setup.noise == calibration.noise
    assert setup.timing == Timing(0.0, 0.08)
    assert request == Request((10.0, 6.0), 120.0)
    limits = Limits.of(setup.vehicle)
    known, unknown = (design_drive(setup, limits, request, c) for c in (calibration, None))
    assert known.excursion.end < unknown.excursion.end
    assert make_request("10x6", 2.0, JACKAL)[0].model == expected_model(ScheduledIcr, JACKAL)
    with pytest.raises(RequestError, match="calibration is of icr; give --model icr"):
        make_request("10x6", 2.0, model="curvature", calibration=calibration)
    with pytest.raises(RequestError, match="which robot"):
        make_request("10x6", 2.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"area": "10by10"}, "write it as 10x10"),
        ({"area": "10x0"}, "two positive lengths"),
        ({"area": "nanx10"}, "two positive lengths"),
        ({"minutes": 0.0}, "--minutes must be a positive time"),
        ({"model": "icrs"}, "no model 'icrs'; there are: differential, "),
        ({"model": "differential"}, "no parameters"),
        ({"position_noise": 0.0}, "position must be positive"),
        ({"yaw_noise_deg": -1.0}, "yaw must be positive"),
        ({"reference_rate": 0.0}, "rate must be positive"),
        ({"margin": -1.0}, "--margin"),
    ],
)
def test_requests_that_cannot_be(change: dict[str, object], message: str) -> None:
    words: dict[str, object] = {"vehicle": JACKAL, "area": "10x10", "minutes": 3.0, "model": "icr"}
    with pytest.raises(RequestError, match=message):
        make_request(**(words | change))  # type: ignore[arg-type]


def test_limits_that_cannot_be() -> None:
    with pytest.raises(RequestError, match=r"beyond the 2 m/s of the wheels of jackal"):
        Limits.of(JACKAL, 2.5)
    with pytest.raises(RequestError, match="give --max-speed"):
        Limits.of(preset("rover-4wd1"))
    assert Limits.of(preset("rover-4wd1"), 0.6).wheel_speed == 0.6
    with pytest.raises(RequestError, match="limit of the speed must be positive"):
        Limits.of(JACKAL, -1.0)


@pytest.mark.parametrize(
    ("area", "time", "message"),
    [
        ((0.7, 5.0), 60.0, r"cannot turn in 0.7 x 5 m.*needs more than 1.2 x 1.2 m"),
        ((1.6, 1.6), 600.0, "too small"),
        ((10.0, 10.0), 3.0, "give more --minutes"),
    ],
)
def test_areas_and_times_that_do_not_do(area: tuple[float, float], time: float, message: str) -> None:
    with pytest.raises(RequestError, match=message):
        design_drive(setup_of(JACKAL, Icr), LIMITS, Request(area, time))
