"""The closed loop: what it must do whatever the controller, the plant and the sensors."""

import math
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import control_loop
from control_loop import PLANT
from skidsteer.control import (
    Controller,
    Huskic,
    Limits,
    Observer,
    PathState,
    Pentzer,
    Predictive,
    PredictiveGains,
    PurePursuit,
    SaturationSpeed,
    Soetanto,
    Wheels,
    huskic,
    icr_x_at,
    pentzer,
    predictive,
    soetanto,
)
from skidsteer.errors import DataError, RequestError
from skidsteer.follow import Ends, Jump, Run, Sensing, follow, summarize
from skidsteer.follow.known_pose import GRACE, SLOWING, KnownPose, grace
from skidsteer.follow.path_follower import Memory, PathFollower
from skidsteer.follow.sensing import Localization, twist_meter
from skidsteer.models import Icr, ScheduledIcr
from skidsteer.paths import Path, arc, clothoid, lemniscate, line, stadium
from skidsteer.plants import begin, point_contacts
from skidsteer.rolling import OverturnedError, RollingModel
from skidsteer.se2 import FloatArray, compose, exp
from skidsteer.terramechanics.terrain import parse_ground
from skidsteer.vehicle import preset

engine = pytest.mark.skipif(find_spec("mujoco") is None, reason="mujoco is not installed")
SUMMIT = preset("summit-xl")
GRASS = parse_ground("grass")
PLANTS = ["kinematic", "terramechanic", pytest.param("mujoco", marks=engine)]
WHEELS = Wheels(PLANT, 1.2)
EIGHT = lemniscate(5.0)
STAND = GRACE + SLOWING  # [s] without a pose, from which on the robot stands


def controllers(wheels: Wheels, speed: float = 1.0) -> dict[str, Controller[Any]]:
    icr_x = icr_x_at(wheels.model, 0.5, 0.5)
    return {
        "huskic": Huskic(huskic.GAINS["launch"], SaturationSpeed(wheels, speed), icr_x, feed_forward=True),
        "soetanto": Soetanto(soetanto.GAINS["launch"], speed),
        "pentzer": Pentzer(pentzer.GAINS["published"], speed, icr_x, feed_forward=True),
        "pure_pursuit": PurePursuit(desired_linear_vel=speed),
        "predictive": Predictive(PredictiveGains(), wheels, Limits(speed), Observer(0.1, 0.05)),
    }


LAWS = pytest.mark.parametrize("law", list(controllers(WHEELS)))


def driven(law: str, path: Path, start: object = None, lag: float = 0.0, **options: object) -> Run:
    at = path.robot(0.0) if start is None else start
    return follow(RollingModel(PLANT, at, lag), controllers(WHEELS)[law], WHEELS, path, **options)  # type: ignore[arg-type]


# Against the loop of the controllers' tests


@LAWS
def test_without_lag_and_delay_it_is_the_exact_kinematics(law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predictive, "ITERATIONS", 30)  # a search that is cut short ends elsewhere by rounding errors
    monkeypatch.setattr(predictive, "TOLERANCE", 0.0)
    start = compose(EIGHT.robot(0.0), (0.1, 0.2, -0.3))
    expected = control_loop.follow(controllers(WHEELS)[law], WHEELS, EIGHT, start, 3.0)
    run = driven(law, EIGHT, start, ends=Ends(time=3.0))
    n, same = len(expected.poses), 1e-5 if law == "predictive" else 1e-9  # its search may end a step sooner or later
    assert run.outcome == "time is up"
    assert_allclose(run.states[:n, :3], expected.poses, atol=same)
    assert_allclose(run.sent[:n], expected.rims, atol=100.0 * same)
    assert_allclose(run.cross_track[:n], expected.aside, atol=same)
    assert_array_equal(run.placed, run.states[:, :3])
    assert_array_equal(run.seen, run.placed)


def test_errors_are_those_of_the_path() -> None:
    run = driven("pentzer", EIGHT, compose(EIGHT.robot(0.0), (0.0, 0.3, 0.4)), lag=0.2, ends=Ends(laps=2.0))
    expected = EIGHT.error(run.placed, run.s)
    assert_allclose(run.cross_track, expected[:, 1], atol=1e-12)
    assert_allclose(run.heading_error, expected[:, 2], atol=1e-12)
    assert_allclose(np.abs(expected[:, 0]), 0.0, atol=1e-9)
    assert run.s[-1] - run.s[0] == pytest.approx(2.0 * EIGHT.length, abs=0.03)


# How it ends


@LAWS
@pytest.mark.parametrize("reverse", [False, True])
def test_it_arrives_at_the_end_of_a_path(law: str, reverse: bool) -> None:
    path = clothoid(4.0, 0.0, 0.2)
    path = path.in_reverse() if reverse else path
    run = driven(law, path, lag=0.1)
    assert run.done
    assert run.outcome == "arrived"
    assert run.s[-1] > path.length - 0.26
    assert np.abs(run.states[-1, 6:]).max() < 0.01


@LAWS
@pytest.mark.parametrize("name", PLANTS)
def test_it_drives_its_laps_within_the_wheels_limits(law: str, name: str) -> None:
    """Faster than the wheels allow, from aside, with a leap of the localization and an acceleration."""
    believed, path = point_contacts(SUMMIT), lemniscate(5.0)
    wheels, start = Wheels(believed, 1.1), compose(path.robot(0.0), (0.0, 0.3, 0.5))
    sensing = Sensing(delay=0.05, position_sigma=0.01, yaw_sigma=0.01, gyro_sigma=0.01, jumps=(Jump(0.5, share=0.4),))
    controller = controllers(wheels, 2.0)[law]
    run = follow(begin(name, SUMMIT, GRASS, start, 0.1), controller, wheels, path, sensing, Ends(time=40.0), 4.0, 3)
    assert run.done, run.reason
    assert np.abs(run.sent).max() <= 1.1
    assert np.abs(run.sent).max() > 1.05
    assert np.abs(np.diff(run.sent, axis=0)).max() <= 4.0 * 0.02 * (1.0 + 1e-12)
    assert np.abs(run.sent[0]).max() <= 4.0 * 0.02 * (1.0 + 1e-12)
    assert summarize(run, 5.0).mean < 0.25


def test_wheels_at_their_acceleration_go_straight_to_what_is_asked_for() -> None:
    """By hand: at most 0.04 m/s a sample; both rims arrive together, and so keep the curvature on the way from rest."""

    class Held:
        begin = staticmethod(PathState.begin)

        def command(self, pose: object, twist: object, state: PathState) -> tuple[float, float]:
            return 0.5, 0.4

        def advance(self, state: PathState, *_: object) -> PathState:
            return state

    follower = PathFollower(Held(), WHEELS, EIGHT, acceleration=2.0)  # type: ignore[arg-type]
    asked, memory = WHEELS.speeds(0.5, 0.4), Memory()
    for k in range(1, 30):
        memory = follower.drive(memory, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.02)
        assert_allclose(memory.sent, asked * min(1.0, 0.04 * k / asked.max()), atol=1e-12)
        assert_allclose(memory.realised, PLANT.twist(*memory.sent)[[0, 2]], atol=1e-12)
    assert memory.asked == (0.5, 0.4)


def test_a_robot_that_loses_the_path_is_told_so() -> None:
    blind = replace(controllers(WHEELS)["pure_pursuit"], use_rotate_to_heading=False)
    path = line(20.0)
    run = follow(RollingModel(PLANT, (0.0, 0.0, math.pi)), blind, WHEELS, path, ends=Ends(off=1.0))
    assert (run.outcome, run.done) == ("lost the path", False)
    assert run.reason.startswith("it is 1.0")
    assert run.reason.endswith("more than 1 m")


def test_a_robot_that_falls_over_ends_the_run() -> None:
    class Falls(RollingModel):
        def step(self, rims: object, dt: float) -> FloatArray:
            if self.state[0] > 0.5:
                raise OverturnedError("the robot falls over at 1 s; drive more gently")
            return super().step(rims, dt)  # type: ignore[arg-type]

    run = follow(Falls(PLANT), controllers(WHEELS)["pentzer"], WHEELS, line(5.0))
    assert (run.outcome, run.reason) == ("tipped over", "the robot falls over at 1 s; drive more gently")
    assert run.states[-1, 0] > 0.5


def test_a_robot_that_does_not_move_on_is_told_so() -> None:
    class Lazy:
        def __init__(self) -> None:
            self.inner = controllers(WHEELS)["pentzer"]
            self.begin, self.advance = self.inner.begin, self.inner.advance

        def command(self, pose: object, twist: object, state: PathState) -> tuple[float, float]:
            return (1.0, 0.0) if state.s < 2.0 else (0.0, 0.0)

    run = follow(RollingModel(PLANT), Lazy(), WHEELS, line(5.0))  # type: ignore[arg-type]
    assert run.outcome == "stands still"
    assert run.t[-1] == pytest.approx(2.0 + 5.0, abs=0.1)


# The pose


def test_a_lost_pose_slows_the_robot_stops_it_and_lets_it_go_on() -> None:
    path = line(12.0)
    run = driven("pentzer", path, lag=0.05, sensing=Sensing(lost=((4.0, 6.0),)))
    assert run.outcome == "arrived"
    assert np.isnan(run.seen[(run.t >= 4.0) & (run.t < 6.0)]).all()
    assert np.isfinite(run.seen[(run.t < 3.99) | (run.t > 6.0)]).all()
    standing = (run.t > 4.0 + STAND + 0.01) & (run.t < 6.0)
    assert_array_equal(run.sent[standing], 0.0)
    slowing = (run.t > 4.0 + GRACE + 0.03) & (run.t < 4.0 + STAND)
    assert (np.diff(run.sent[slowing].mean(axis=1)) < 0.0).all()
    assert np.abs(run.states[run.t == 5.9][0, 6:]).max() < 1e-3
    assert np.abs(run.cross_track).max() < 0.01  # reckoned for half a second, it stays on the line


@LAWS
def test_a_pose_lost_for_a_second_on_a_curve(law: str) -> None:
    """Every law stops for it, and is back on the path afterwards."""
    run = driven(law, EIGHT, lag=0.1, sensing=Sensing(delay=0.05, lost=((3.0, 4.0),)))
    assert run.outcome == "laps done"
    assert_array_equal(run.sent[(run.t > 3.0 + STAND + 0.01) & (run.t < 4.0)], 0.0)
    slowing = np.abs(run.sent[(run.t > 3.0) & (run.t < 3.0 + STAND)]).max(axis=1)
    assert np.abs(np.diff(slowing)).max() < 1.3 * 0.02 * slowing[0] / (STAND - GRACE)  # evenly, whatever the law asks
    assert np.abs(run.cross_track).max() < 0.35
    assert np.abs(run.cross_track[-50:]).max() < 0.25


def test_short_gaps_are_reckoned_over() -> None:
    """A pose every 0.1 s only, and on a curve."""
    path = arc(2.0, 5.0)
    gaps = tuple((0.1 * k + 0.01, 0.1 * k + 0.099) for k in range(200))
    run, whole = (driven("pentzer", path, sensing=Sensing(lost=lost)) for lost in (gaps, ()))
    assert run.outcome == "arrived"
    assert run.t[-1] == pytest.approx(whole.t[-1], abs=0.1)
    assert_allclose(run.states[:300, :3], whole.states[:300, :3], atol=1e-6)  # the model is the truth


@pytest.mark.parametrize(("pose_rate", "each"), [(None, 1), (80.0, 1), (10.0, 5), (5.0, 10)])
def test_poses_come_at_their_rate(pose_rate: float | None, each: int) -> None:
    """Each as late as told; the robot does not take one that is due only later for a lost one."""
    run = driven("pentzer", line(6.0), sensing=Sensing(delay=0.06, pose_rate=pose_rate))
    assert run.outcome == "arrived"
    came = np.isfinite(run.seen[:, 0])
    assert_array_equal(came, np.arange(len(run.t)) % each == 0)
    late = np.maximum(np.arange(len(run.t)) - 3, 0)
    assert_allclose(run.seen[came], run.placed[late][came], atol=1e-12)
    whole = driven("pentzer", line(6.0), sensing=Sensing(delay=0.06))
    assert run.t[-1] == pytest.approx(whole.t[-1], abs=0.3)
    assert run.states[:, 3].max() == pytest.approx(whole.states[:, 3].max(), rel=1e-3)


def test_poses_whose_rate_divides_none_of_the_controllers_come_as_often() -> None:
    seen = Localization(Sensing(pose_rate=15.0), 0)
    came = np.array([seen.see((0.0, 0.0, 0.0), 0.02 * i) is not None for i in range(500)])
    assert came.sum() == 150
    assert set(np.diff(np.flatnonzero(came)).tolist()) == {3, 4}  # the first sample at or after each 1 / 15 s
    assert_array_equal(np.flatnonzero(came), np.ceil(np.arange(150) * 50.0 / 15.0 - 1e-9))


@LAWS
def test_a_pose_lost_for_a_second_where_they_come_at_5_hz(law: str) -> None:
    """One that fails to come changes nothing; without any for a second the robot stands, and goes on."""
    whole = Sensing(delay=0.05, pose_rate=5.0)
    runs = [driven(law, EIGHT, lag=0.1, sensing=replace(whole, lost=lost)) for lost in ((), ((2.1, 2.3), (3.1, 4.3)))]
    run = runs[1]
    assert run.outcome == "laps done"
    asked, fastest = (np.abs(each.sent).max(axis=1)[100:150] for each in runs)
    assert (fastest > 0.9 * asked).all()
    assert_array_equal(run.sent[(run.t > 3.0 + grace(5.0) + SLOWING + 0.01) & (run.t < 4.3)], 0.0)
    assert np.abs(run.cross_track).max() < 0.35


def test_a_robot_that_stands_between_two_poses_stands() -> None:
    class Still(Pentzer):
        def command(self, pose: object, twist: object, state: object) -> tuple[float, float]:
            return 0.0, 0.0

    still = Still(pentzer.GAINS["published"], 1.0, 0.0)
    sensing = Sensing(pose_rate=10.0)
    run = follow(RollingModel(PLANT, (0.0, 0.0, 0.0)), still, WHEELS, line(5.0), sensing)
    assert run.outcome == "stands still"


def test_no_pose_at_the_beginning_is_waited_for() -> None:
    run = driven("huskic", line(3.0), sensing=Sensing(lost=((-1.0, 1.0),)))
    assert run.outcome == "arrived"
    assert_array_equal(run.sent[run.t < 0.99], 0.0)
    assert run.sent[run.t > 1.05].max() > 0.5


def test_a_pose_that_is_no_number_counts_as_none() -> None:
    follower = PathFollower(controllers(WHEELS)["pentzer"], WHEELS, line(5.0))
    moving = follower.drive(Memory(), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.02)
    for bad in ((math.nan, 0.0, 0.0), (0.0, 0.0, math.inf), None):
        after = follower.drive(moving, bad, (1.0, 0.0, 0.0), 0.04)
        assert after.known == KnownPose((pytest.approx(1.04), 0.0, 0.0), 0.04)  # type: ignore[arg-type]
        assert follower.drive(Memory(), bad, (0.0, 0.0, 0.0), 0.02).sent == (0.0, 0.0)
    for _ in range(30):
        moving = follower.drive(moving, None, (0.5, 0.0, 0.1), 0.02)
    assert moving.sent == (0.0, 0.0)


def test_a_twist_that_is_no_number_is_taken_for_the_one_sent() -> None:
    follower = PathFollower(controllers(WHEELS)["pentzer"], WHEELS, line(5.0))
    moving = follower.drive(Memory(), (1.0, 0.1, 0.0), (0.0, 0.0, 0.0), 0.02)
    assert moving.realised[1] < -0.05
    reckoned = follower.drive(moving, None, (math.nan, 0.0, 0.0), 0.04).known
    v, omega = moving.realised
    assert reckoned is not None
    assert_allclose(reckoned.pose, compose((1.0, 0.1, 0.0), exp(np.array([v, 0.0, omega]) * 0.04)), atol=1e-12)
    assert follower.drive(moving, (1.02, 0.1, 0.0), (0.5, math.inf, 0.0), 0.02).sent != (0.0, 0.0)


def test_no_time_changes_nothing() -> None:
    for controller in controllers(WHEELS).values():
        follower = PathFollower(controller, WHEELS, EIGHT, acceleration=2.0)
        before = follower.drive(Memory(), tuple(EIGHT.robot(1.0).tolist()), (0.5, 0.0, 0.1), 0.02)
        after = follower.drive(before, tuple(EIGHT.robot(1.0).tolist()), (0.5, 0.0, 0.1), 0.0)
        assert after.state is before.state
        assert after.sent == before.sent


def test_reckoning_is_the_exponential() -> None:
    twist = (0.8, -0.3, 1.7)
    for dt, turn in ((0.3, 1.7), (0.3, 0.0)):
        after = KnownPose((1.0, 2.0, 0.4)).after(dt, (*twist[:2], turn), None)
        expected = compose((1.0, 2.0, 0.4), exp(np.array([*twist[:2], turn]) * dt))
        assert_allclose(after.pose, expected, atol=1e-12)


def test_a_delayed_pose_is_an_earlier_one() -> None:
    whole = Localization(Sensing(rate=10.0, delay=0.2), 0)
    part = Localization(Sensing(rate=10.0, delay=0.15), 0)
    for k in range(6):
        pose = (float(k), 0.0, 0.1 * k)
        assert whole.see(pose, 0.1 * k) == pytest.approx((max(k - 2.0, 0.0), 0.0, 0.1 * max(k - 2.0, 0.0)))
        assert part.see(pose, 0.1 * k) == pytest.approx((max(k - 1.5, 0.0), 0.0, 0.1 * max(k - 1.5, 0.0)))


def test_delay_and_lag_make_it_worse() -> None:
    worst = [
        summarize(driven("pentzer", EIGHT, lag=lag, sensing=Sensing(delay=delay)), 3.0).mean
        for lag, delay in ((0.0, 0.0), (0.1, 0.0), (0.15, 0.1))
    ]
    assert worst[0] < worst[1] < worst[2]


def test_a_leap_of_the_localization_moves_its_map() -> None:
    jump = Jump(0.886, ahead=0.2, turn=0.1, time=2.0)
    run = driven("pentzer", line(15.0), sensing=Sensing(jumps=(jump,)))
    before, after = run.t < 1.99, run.t > 1.99
    assert_allclose(run.placed[before], run.states[before, :3])
    k = int(np.flatnonzero(after)[0])
    assert_allclose(run.placed[k], compose(run.states[k, :3], (0.2, 0.886, 0.1)), atol=1e-12)
    assert np.abs(run.cross_track[before]).max() < 0.02
    assert run.cross_track[k] == pytest.approx(0.886, abs=0.03)
    assert run.outcome == "arrived"
    assert abs(run.cross_track[-1]) < 0.02  # in the new map it is back on the path
    assert run.states[-1, 1] < -0.5  # on the ground it is not where it would have been


def test_a_leap_at_a_share_of_the_way() -> None:
    run = driven("huskic", line(10.0), sensing=Sensing(jumps=(Jump(0.3, share=0.5),)))
    leapt = np.flatnonzero(np.abs(np.diff(run.placed[:, 1])) > 0.2)
    assert len(leapt) == 1
    assert run.s[leapt[0]] == pytest.approx(5.0, abs=0.05)


# Noise


def test_noise_is_that_of_the_seed() -> None:
    noisy = Sensing(position_sigma=0.02, yaw_sigma=0.01, wheel_sigma=0.01, gyro_sigma=0.01)
    one, same, other = (driven("huskic", line(4.0), sensing=noisy, seed=seed) for seed in (1, 1, 2))
    assert_array_equal(one.states, same.states)
    assert_array_equal(one.seen, same.seen)
    assert not np.array_equal(one.seen[:50], other.seen[:50])


def test_noise_has_its_sigma() -> None:
    run = driven("pentzer", lemniscate(12.0), sensing=Sensing(position_sigma=0.02, yaw_sigma=0.01), seed=4)
    sigma = (run.seen - run.placed).std(axis=0)
    assert_allclose(sigma, [0.02, 0.02, 0.01], rtol=0.08)
    meter = twist_meter(PLANT, Sensing(wheel_sigma=0.05, gyro_sigma=0.02), 0)
    told = np.array([meter([9.0, 9.0, 0.3, 0.5, 0.7]) for _ in range(4000)])
    by_rim = np.hypot(*PLANT.matrix()[:2].T) * 0.05
    assert_allclose(told.mean(axis=0), [*PLANT.twist(0.5, 0.7)[:2], 0.3], atol=3e-3)
    assert_allclose(told.std(axis=0), [*by_rim, 0.02], rtol=0.05)


def test_omega_is_the_gyros_and_v_the_wheels() -> None:
    told = twist_meter(PLANT, Sensing(), 0)([9.0, 9.0, 0.3, 0.5, 0.7])
    assert_allclose(told, [*PLANT.twist(0.5, 0.7)[:2], 0.3], atol=1e-12)


def test_a_controller_is_told_what_was_sent() -> None:
    """Not what it asked for, where the wheels cannot."""
    told = []

    class Greedy:
        begin = staticmethod(PathState.begin)

        def command(self, pose: object, twist: object, state: PathState) -> tuple[float, float]:
            return 3.0, 0.5

        def advance(self, state: PathState, *heard: object) -> PathState:
            told.append(heard[3])
            return state

    run = follow(RollingModel(PLANT), Greedy(), WHEELS, line(9.0), ends=Ends(time=0.5), acceleration=5.0)  # type: ignore[arg-type]
    assert_allclose(told, PLANT.twist(*run.sent[: len(told)].T)[:, [0, 2]], atol=1e-12)
    assert_array_equal(run.commanded, np.full((len(run.t), 2), [3.0, 0.5]))
    assert np.abs(run.sent).max() == 1.2


def test_a_path_shorter_than_the_tolerance_is_driven() -> None:
    run = driven("pentzer", line(0.4))
    assert run.outcome == "arrived"
    assert run.states[-1, 0] > 0.38


def test_a_nonlinear_belief_drives_too() -> None:
    belief = ScheduledIcr(0.48, -0.42, 0.1, 0.9, 0.93, 0.05, 0.1, 0.1, 0.1, 0.5)
    wheels, path = Wheels(belief, 1.2), line(1.5)
    run = follow(RollingModel(belief), Pentzer(pentzer.GAINS["published"], 1.0), wheels, path)
    assert run.outcome == "arrived"
    assert np.abs(run.sent).max() <= 1.2


# Figures


def test_figures_by_hand() -> None:
    path = line(4.0)
    n = 5
    t, s = 0.5 * np.arange(n), np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    aside, sent = np.array([0.1, -0.3, 0.2, 0.0, 0.4]), np.array([[0, 0], [1, 1], [1, 1], [1, 2], [1, 1]], dtype=float)
    states = np.column_stack([s, aside, np.zeros(n), np.full(n, 1.2), np.full(n, 0.5), np.zeros(n), sent])
    power = np.outer([np.nan, 10.0, 20.0, 30.0, 40.0], np.ones(3))
    run = Run(path, t, states, states[:, :3], states[:, :3], sent, sent, s, aside, 2.0 * aside, power, "arrived", "why")
    found = summarize(run)
    assert (found.outcome, found.reason, found.laps) == ("arrived", "why", 0.0)
    assert (found.duration, found.way, found.fastest) == (2.0, 2.0, 2.0)
    assert found.mean == pytest.approx(0.2)
    assert found.largest == 0.4
    assert found.rms == pytest.approx(math.sqrt(0.3 / 5.0))
    assert found.heading_rms == pytest.approx(2.0 * found.rms)
    assert found.speed == pytest.approx(1.3)
    assert found.effort == pytest.approx(math.sqrt((4.0 + 4.0 + 4.0 + 4.0) / 8.0))
    assert found.energy == pytest.approx(50.0)
    late = summarize(run, 1.0)
    assert (late.duration, late.way, late.mean) == (1.0, 1.0, pytest.approx(0.2))
    assert summarize(replace(run, power=np.full((n, 3), np.nan))).energy is None


def test_the_motion_of_a_run_is_that_of_the_robot() -> None:
    run = driven("pentzer", line(2.0), lag=0.1)
    assert_array_equal(run.motion.pose, run.states[:, :3])
    assert_array_equal(run.motion.rims, run.states[:, 6:])


@pytest.mark.parametrize("name", ["terramechanic"])
def test_a_ground_that_changes_is_felt(name: str) -> None:
    wheels = Wheels(point_contacts(SUMMIT), 3.0)
    path, controller = stadium(3.0, 1.5), controllers(wheels, 1.0)["pentzer"]
    runs = [follow(begin(name, SUMMIT, parse_ground(g)), controller, wheels, path) for g in ("grass", "grass,ice@5")]
    early = runs[0].t < 4.9
    assert_allclose(runs[1].states[: len(early)][early[: len(runs[1].t)]], runs[0].states[early])
    assert np.abs(runs[1].cross_track).max() > 2.0 * np.abs(runs[0].cross_track).max()


# What cannot be driven


@pytest.mark.parametrize(
    ("path", "start", "model", "message"),
    [
        (line(5.0), (0.0, 5.0, 0.0), PLANT, r"^the start \(0, 5\) is 5.00 m off the path, more than 3 m; begin nearer"),
        (
            line(5.0),
            (6.0, 0.1, 0.0),
            PLANT,
            r"^the start \(6, 0.1\) is 1.00 m beyond the end of the path; begin before",
        ),
        (arc(0.2, 3.0), None, PLANT, r"radius of 0.2 m at 0.00 m, but the robot turns about a point 0.28 m ahead or"),
        (
            arc(0.002, 3.0),
            None,
            Icr(0.4, -0.4, 0.0, 1.0, 1.0),
            r"^the path has a radius of 0.002 m .* widen that curve",
        ),
    ],
)
def test_what_cannot_be_driven_is_refused(path: Path, start: object, model: Icr, message: str) -> None:
    wheels = Wheels(model, 1.2)
    at = path.robot(0.0) if start is None else start
    with pytest.raises(RequestError, match=message):
        follow(RollingModel(model, at), controllers(wheels)["pentzer"], wheels, path)  # type: ignore[arg-type]


def test_a_start_farther_off_may_be_allowed() -> None:
    run = driven("huskic", line(9.0), (0.0, 5.0, 0.0), ends=Ends(off=6.0))
    assert run.outcome == "arrived"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sensing(rate=0.0), "rate of the controller must be from 0.1 to 1000 Hz, got 0"),
        (lambda: Sensing(delay=-0.1), r"the delay of the poses must be at least 0 and at most 10 s, got -0.1"),
        (lambda: Sensing(yaw_sigma=math.nan), "the noise of the yaw must be at least 0 and at most 180 deg, got nan"),
        (lambda: Sensing(lost=((2.0, 1.0),)), "poses are lost from one time to a later one, got 2.0 to 1.0 s"),
        (lambda: Jump(math.inf), "a jump needs numbers of at most 10000, got 0 m ahead, inf m left, 0 rad"),
        (lambda: Sensing(delay=1e6), "the delay of the poses must be at least 0 and at most 10 s, got 1e\\+06"),
        (
            lambda: Sensing(wheel_sigma=99.0),
            "noise of the rim speeds must be at least 0 and at most 10 m/s, got 99",
        ),
        (lambda: Jump(0.5, time=math.nan), "a jump needs a time in s, or a share"),
        (lambda: Ends(laps=0.0), "laps must be above 0"),
        (lambda: Ends(off=math.nan), r"the distance off the path \[m\] must be above 0, got nan"),
        (
            lambda: PathFollower(controllers(WHEELS)["huskic"], WHEELS, EIGHT, 0.0),
            "acceleration of the wheels must be above 0",
        ),
        (lambda: Sensing(pose_rate=0.0), "the rate of the poses must be at least 0.01 Hz, got 0"),
        (
            lambda: PathFollower(controllers(WHEELS)["huskic"], WHEELS, EIGHT, pose_rate=math.nan),
            "the rate of the poses must be above 0 Hz, got nan",
        ),
    ],
)
def test_options_that_cannot_be(make: object, message: str) -> None:
    with pytest.raises(RequestError, match=message):
        make()  # type: ignore[operator]


def test_a_command_that_is_no_number_is_an_error() -> None:
    class Broken:
        begin = staticmethod(PathState.begin)

        def command(self, pose: object, twist: object, state: PathState) -> tuple[float, float]:
            return math.nan, 0.0

    with pytest.raises((ValueError, DataError), match="need finite v and omega"):
        follow(RollingModel(PLANT), Broken(), WHEELS, line(5.0))  # type: ignore[arg-type]
