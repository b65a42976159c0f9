"""Courses round an obstacle: geometry, timing, what to expect, and what plants make of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skidsteer.calibration import Calibration, Estimate
from skidsteer.errors import RequestError
from skidsteer.identify.excursion import expected_model, trajectory
from skidsteer.models import MODELS, Differential, Icr, Model
from skidsteer.noise import Noise
from skidsteer.plan.circumnavigation import Plan, Request, circumnavigate
from skidsteer.plan.driver import Driver
from skidsteer.plan.encoding import ENCODINGS, Encoding
from skidsteer.plan.outline import Rectangle, gap
from skidsteer.plan.slip_table import SlipTable
from skidsteer.prediction import Regions, Uncertainty, forecast
from skidsteer.samples import rover_runs
from skidsteer.se2 import between
from skidsteer.simulate import Sensors, kinematic_drive
from skidsteer.vehicle import preset

OBSTACLE = Rectangle(0.70, 1.25, "obstacle")  # Giannoccaro 2015, Fig. 10
ROVER, JACKAL = preset("rover-4wd1"), preset("jackal")
SKEW = Icr(0.24, -0.33, 0.05, 0.97, 1.02)
TIGHT = Noise(walk=0.01, turn=0.02)


def driver(model: Model, sigma: float = 0.0, noise: Noise = TIGHT, lag: float = 0.1) -> Driver:
    """A Jackal whose parameters and lag are known to a share ``sigma``."""
    theta = np.abs([*model.theta, 0.0, lag])
    return Driver(JACKAL, model, Uncertainty(noise, np.diag((sigma * theta) ** 2)), lag)


def test_the_paper_s_course() -> None:
    ideal = Driver(ROVER, Differential(0.28), Uncertainty(Noise(), np.zeros((2, 2))))
    plan = circumnavigate(ideal, Request(OBSTACLE, 0.38, 0.632, 0.45, radius=0.90))
    lengths = [s.length for s in plan.stretches]
    assert_allclose(lengths, [1.25, 2.8274, 1.25, 2.8274], atol=1e-4)
    assert sum(lengths) == pytest.approx(8.1548, abs=1e-4)
    assert_allclose([s.duration for s in plan.stretches[:2]], [1.25 / 0.632, np.pi / 0.5], rtol=1e-12)
    assert_allclose(plan.stretches[1].rims, [0.5 * 0.76, 0.5 * 1.04])  # omega times the radius of each side
    assert_allclose(plan.place, [0.625, 0.9, 0.0], atol=1e-12)
    assert plan.gaps.min() == pytest.approx(0.90 - 0.35 - 0.17, abs=1e-3)
    assert_allclose(plan.end[:2], 0.0, atol=2e-3)
    assert plan.end[2] == pytest.approx(2.0 * np.pi)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("name", MODELS)
def test_any_model_comes_back_and_keeps_clear(name: str, side: str) -> None:
    model = expected_model(MODELS[name], JACKAL)
    plan = circumnavigate(driver(model), Request(OBSTACLE, 0.4, 0.5, 0.4, side=side, laps=2))
    assert_allclose(plan.end[:2], 0.0, atol=0.01)
    assert plan.end[2] == pytest.approx(4.0 * np.pi * (1.0 if side == "left" else -1.0), abs=5e-3)
    assert plan.gaps.min() == pytest.approx(0.4, abs=0.006)
    turning = np.sign(plan.expected.path.values[-1, 2])
    assert turning * plan.place[1] > 0.0  # the obstacle is on the side that it turns to


@pytest.mark.parametrize("side", ["left", "right"])
def test_clearance_is_that_of_the_swept_outline(side: str) -> None:
    # An ICR ahead of the middle swings the rear out: the outline leaves the band of the straight's.
    plan = circumnavigate(driver(SKEW), Request(OBSTACLE, 0.3, 0.5, 0.5, side=side))
    course = trajectory(SKEW, plan.rims, 0.1, step=0.01)
    assert gap(plan.robot, course.values, plan.obstacle, plan.place).min() == pytest.approx(0.3, abs=1.5e-3)
    corners, obstacle = plan.robot.at(course.values).reshape(-1, 2), plan.obstacle.at(plan.place)
    edges = np.concatenate([a + np.linspace(0, 1, 200)[:, None] * (b - a) for a, b in _edges(obstacle)])
    nearest = min(np.hypot(*(edges[:, None] - part[None]).T).min() for part in np.array_split(corners, 40))
    assert nearest >= 0.3 - 2e-3


def _edges(corners: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    return list(zip(corners, np.roll(corners, -1, axis=0), strict=True))


def test_the_course_lies_symmetrically_about_the_obstacle() -> None:
    plan = circumnavigate(driver(SKEW, lag=0.0), Request(OBSTACLE, 0.4, 0.5, 0.4))
    t, end = plan.expected.path.t, plan.starts[-1] + plan.stretches[-1].duration
    inside = [np.interp(0.5 * (a + b), t, plan.gaps) for a, b in zip(plan.starts, [*plan.starts[1:], end], strict=True)]
    assert inside[0] == pytest.approx(inside[2], abs=1e-3)
    assert inside[1] == pytest.approx(inside[3], abs=1e-3)
    assert plan.place[1] == pytest.approx(plan.radius)
    assert plan.place[0] == pytest.approx(0.625 + SKEW.icr_x)  # the arc turns about a point that far ahead


@pytest.mark.parametrize("model", [SKEW, expected_model(MODELS["scheduled_icr"], JACKAL)], ids=["icr", "scheduled_icr"])
def test_expected_covariance_is_that_of_many_robots(model: Model) -> None:
    me = driver(model, 0.003)
    plan = circumnavigate(me, Request(OBSTACLE, 0.4, 0.5, 0.4))
    rng, size = np.random.default_rng(3), len(model.theta)
    sigma = np.sqrt(np.diag(me.uncertainty.covariance))[:size]
    ends = []
    for seed in range(400):
        other = model.with_theta(model.theta + sigma * rng.standard_normal(size))
        lag = 0.1 * (1.0 + 0.003 * rng.standard_normal())
        ends.append(between(plan.end, trajectory(other, plan.rims, lag, TIGHT, seed).values[-1]))
    ratio = np.cov(np.array(ends).T) / plan.expected.covariances[-1]
    assert_allclose(np.diag(ratio), 1.0, atol=0.3)
    whitened = np.linalg.solve(np.linalg.cholesky(plan.expected.covariances[-1]), np.array(ends).T)
    assert np.mean((whitened**2).sum(axis=0)) == pytest.approx(3.0, rel=0.12)


def test_nineteen_of_twenty_keep_what_is_said() -> None:
    plan = circumnavigate(driver(SKEW), Request(OBSTACLE, 0.4, 0.5, 0.4))
    t = plan.expected.path.t
    at = int(np.argmin(plan.gaps - plan._margin(plan.expected.covariances)))
    paths = [trajectory(SKEW, plan.rims, 0.1, TIGHT, seed, step=float(t[1] - t[0])) for seed in range(600)]
    here = np.array([[np.interp(t[at], p.t, column) for column in p.values.T] for p in paths])
    kept = gap(plan.robot, here, plan.obstacle, plan.place)
    assert np.mean(kept >= plan.sure_gap) == pytest.approx(0.95, abs=0.03)


def test_forecast_against_differences() -> None:
    plan = circumnavigate(driver(SKEW), Request(OBSTACLE, 0.4, 0.5, 0.4))
    rims, t, step = plan.rims, plan.expected.path.t, 1e-5
    columns = []
    for i in range(6):
        ends = []
        for sign in (1.0, -1.0):
            theta, lag = SKEW.theta, 0.1
            if i < 5:
                theta = theta + sign * step * np.eye(5)[i]
            else:
                lag += sign * step
            ends.append(trajectory(SKEW.with_theta(theta), rims, lag).values[-1])
        difference = (ends[0] - ends[1]) / (2.0 * step)
        c, s = np.cos(plan.end[2]), np.sin(plan.end[2])
        columns.append([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]] @ difference)
    J, spread = np.array(columns).T, np.array([0.02, 0.03, 0.01, 0.004, 0.005, 0.02])
    full = np.diag(np.insert(spread, 5, 7.0) ** 2)  # a time offset makes no difference
    found = forecast(SKEW, rims, t, 0.1, Uncertainty(TIGHT, full))
    assert_allclose(found.of_parameters[-1], J * spread**2 @ J.T, atol=2e-5 * np.abs(J * spread).max())


def test_regions_that_claim_more_widen_what_is_said() -> None:
    narrow = circumnavigate(driver(SKEW), Request(OBSTACLE, 0.4, 0.5, 0.4))
    wide = replace(narrow, driver=replace(narrow.driver, regions=Regions(4.0, 1e6)))
    assert_allclose(wide.end_sigmas, 2.0 * narrow.end_sigmas)
    lost = [narrow.gaps.min() - plan.sure_gap for plan in (narrow, wide)]
    assert lost[1] > 1.8 * lost[0]
    spread = [np.hypot(*(plan.end_ellipse - plan.end[:2]).T).max() for plan in (narrow, wide)]
    assert spread[1] == pytest.approx(2.0 * spread[0], rel=1e-3)


def test_turns_that_are_off_widen_the_end_by_the_angle_turned() -> None:
    request = Request(OBSTACLE, 0.4, 0.5, 0.4)
    sure = circumnavigate(driver(SKEW), request)
    unsure = circumnavigate(replace(driver(SKEW), regions=Regions(1.0, 1e6, 0.02)), request)
    widened = np.sqrt(unsure.end_sigmas[2] ** 2 - sure.end_sigmas[2] ** 2)
    assert widened == pytest.approx(0.02 * abs(sure.end[2]))
    assert unsure.sure_gap < sure.sure_gap


def coded(model: Model = SKEW) -> Driver:
    return replace(driver(model, lag=0.0), encoding=Encoding(0.05, -0.02, 1, 40))


def test_rounding_is_told_and_timed() -> None:
    plan = circumnavigate(coded(), Request(OBSTACLE, 0.4, 0.5, 0.4))
    straight, arc = plan.stretches[:2]
    assert straight.k is not None
    assert_allclose(straight.rims, 0.05 * np.array(straight.k) - 0.02)
    assert np.abs(straight.rims - straight.asked).max() <= 0.025 + 1e-12
    assert straight.length == pytest.approx(1.25)
    assert abs(arc.twist[2]) * arc.duration == pytest.approx(np.pi)
    drift = straight.twist[2] * straight.duration  # whole numbers do not drive this robot straight
    assert abs(drift) > 0.01
    assert plan.misses[2] == pytest.approx(2.0 * drift)
    assert plan.gaps.min() >= 0.4 - 1e-4
    walked = trajectory(SKEW, plan.rims, 0.0, step=0.01).values[-1]
    assert_allclose(plan.misses[:2], walked[:2], atol=1e-3)


CIRCLES = SlipTable(tuple(run for run in rover_runs() if run.surface == "indoor"), 0.28)


def test_the_paper_s_integers() -> None:
    plan = circumnavigate(Driver.of_circles(CIRCLES, ROVER), Request(OBSTACLE, 0.38, 0.63, 0.45, radius=0.90))
    assert [s.k for s in plan.stretches[:2]] == [(61, 61), (28, 74)]  # the paper has 60; 26 and 65
    assert any("assumed" in note for note in plan.notes)


@pytest.mark.parametrize("model", [SKEW, Differential(0.5)], ids=["icr", "differential"])
def test_a_plan_is_driven_on_the_kinematic_plant(model: Model) -> None:
    plan = circumnavigate(driver(model), Request(OBSTACLE, 0.4, 0.5, 0.4, side="right"))
    sensors = Sensors(reference_rate=20.0, position_sigma=1e-9, yaw_sigma=1e-9)
    drive = kinematic_drive("lap", JACKAL, model, plan.rims, sensors, 0.1)
    assert drive.pose is not None
    assert_allclose(drive.pose.values[-1], plan.end, atol=2e-4)
    assert gap(plan.robot, drive.pose.values, plan.obstacle, plan.place).min() >= 0.399


def refused(match: str, request: Request | None = None, who: Driver | None = None, **changes: object) -> None:
    def plan() -> None:
        asked = request or Request(**{"obstacle": OBSTACLE, "clearance": 0.4, "speed": 0.5, **changes})  # type: ignore[arg-type]
        circumnavigate(who or driver(SKEW), asked)

    with pytest.raises(RequestError, match=match):
        plan()


def test_bad_requests() -> None:
    refused("--clearance must be above 0", clearance=0.0)
    refused("--speed must be above 0", speed=float("nan"))
    refused("--radius must be above 0", radius=-1.0)
    refused("left or right", side="up")
    refused("--laps must be from 1 to 100", laps=0)
    refused(r"the course would take \d\.\d+e\+06 s; drive faster", speed=1e-6)
    refused("the course would take", Request(Rectangle(1e5, 1.0, "obstacle"), 0.4, 0.5))
    refused(r"reaches 2 m/s; give a lower --speed$", speed=2.5)
    refused(r"reaches 2 m/s; give a lower --speed or --curve-speed", speed=1.5, curve_speed=1.9)


def test_a_radius_that_does_not_keep_the_clearance() -> None:
    refused(r"arcs of 0.6 m leave 0.\d+ m .* --clearance asks for 0.4 m; give a --radius of at least 0.99", radius=0.6)
    refused(r"arcs of 0.3 m leave 0.000 m", radius=0.3)


def test_arcs_that_no_circle_run_knows() -> None:
    tight = Rectangle(0.1, 0.5, "obstacle")
    refused("needs circle runs that way", Request(tight, 0.05, 0.4), Driver.of_circles(CIRCLES, ROVER))


def test_sides_that_would_have_to_turn_back() -> None:
    rover = Driver(ROVER, Differential(0.9), Uncertainty(Noise(), np.zeros((2, 2))), encoding=ENCODINGS["rover-4wd1"])
    refused("left side is asked for -", Request(Rectangle(0.1, 0.5), 0.1, 0.4), rover)


def test_a_calibration_that_tells_too_little(rough: Calibration) -> None:
    refused("does not determine icr_y: by that alone", Request(OBSTACLE, 0.38, 0.45), Driver.of(rough))


@pytest.fixture(scope="module")
def rough() -> Calibration:
    """Of circles that one ICR distance does not describe."""
    from skidsteer.identify.circle_calibration import calibrate_circles
    from skidsteer.io.circle_runs import circle_table

    table = circle_table(["sample:rover-4wd1-indoor"])
    assert table is not None
    return calibrate_circles(table.runs, table.vehicle, (table.record,)).calibration


def test_a_driver_by_a_calibration(rough: Calibration) -> None:
    made = Driver.of(rough)
    assert made.encoding is ENCODINGS["rover-4wd1"]
    assert made.open == ("icr_y",)
    order = [rough.names.index(name) for name in ("icr_y", "alpha")]
    assert_allclose(made.uncertainty.covariance[:2, :2], rough.covariance[np.ix_(order, order)])
    assert made.uncertainty.covariance[3, 3] == rough.estimates["lag"].sigma ** 2
    late = replace(rough, estimates={**rough.estimates, "lag": Estimate(0.13, 0.01, "s")})
    assert Driver.of(late).lag == 0.13
    fixed = replace(
        rough,
        names=rough.names[:2],
        covariance=rough.covariance[:2, :2],
        estimates={n: rough.estimates[n] for n in rough.names[:2]},
    )
    assert_allclose(Driver.of(fixed).uncertainty.covariance[2:], 0.0)  # a lag that was given is known


def test_uncertainty_that_takes_all_of_the_clearance_is_told() -> None:
    plan: Plan = circumnavigate(driver(SKEW, noise=Noise()), Request(OBSTACLE, 0.05, 0.5, 0.4))
    assert plan.sure_gap < 0.0
    assert any("may touch the obstacle" in note for note in plan.notes)
