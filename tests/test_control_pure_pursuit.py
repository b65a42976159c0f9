import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import brentq

from control_loop import CENTRED, PLANT, follow
from skidsteer.control import PathState, PurePursuit, Wheels
from skidsteer.control.pure_pursuit import PRESETS, arc_curvature, lookahead_point
from skidsteer.paths import arc, lemniscate, line
from skidsteer.se2 import compose, exp, invert

STILL = np.zeros(3)
LINE, RING = line(10.0), arc(2.0, 8.0 * math.pi)
PLAIN = PRESETS["plain"]


def test_the_command_by_hand() -> None:
    """0.1 m to the left of a line, turned by 0.2 rad to the left: the point ahead, the arc to it, and its speed."""
    ahead = math.sqrt(0.6**2 - 0.1**2)
    x, y = ahead * math.cos(0.2) - 0.1 * math.sin(0.2), -ahead * math.sin(0.2) - 0.1 * math.cos(0.2)
    state, pose = PathState(LINE, 3.0), (3.0, 0.1, 0.2)
    assert lookahead_point(state, pose, 0.6) == pytest.approx((x, y), abs=1e-12)
    curvature = 2.0 * y / 0.36
    assert curvature == pytest.approx(-1.19745, abs=1e-5)
    speed = 0.5 / abs(curvature) / 0.9  # its radius is below 0.9 m
    assert PurePursuit().command(pose, STILL, state) == pytest.approx((speed, speed * curvature), abs=1e-12)
    assert PLAIN.command(pose, STILL, state) == pytest.approx((0.5, 0.5 * curvature), abs=1e-12)


def test_on_a_circle_it_drives_that_circle() -> None:
    v, omega = replace(PLAIN, desired_linear_vel=1.0).command(RING.at(5.0), STILL, PathState(RING, 5.0))
    assert (v, omega) == pytest.approx((1.0, 0.5), abs=2e-4)  # the point ahead lies on a chord of the circle


def test_which_point_lies_ahead() -> None:
    far = PathState(LINE, 3.0)
    assert lookahead_point(far, (3.0, 2.0, 0.0), 0.6) == pytest.approx((0.0, -2.0))  # the nearest one
    last = PathState(LINE, 9.8)
    assert lookahead_point(last, (9.8, 0.0, 0.0), 0.6) == pytest.approx((0.2, 0.0))  # the end
    lap = lemniscate(3.0)
    x, y = lookahead_point(PathState(lap, lap.length - 0.1), (0.0, 0.0, 0.0), 0.6)
    assert math.hypot(x, y) == pytest.approx(0.6)  # beyond the lap
    assert arc_curvature(0.0, 0.0) == 0.0


def test_the_lookahead_scales_with_the_speed() -> None:
    scaled = PurePursuit(use_velocity_scaled_lookahead_dist=True)
    assert [scaled.lookahead(v) for v in (0.1, 0.4, -0.4, 2.0)] == pytest.approx([0.3, 0.6, 0.6, 0.9])
    assert PurePursuit().lookahead(2.0) == 0.6


def test_turns_slow_it_down_to_a_least_speed() -> None:
    law = PurePursuit(desired_linear_vel=1.0, use_rotate_to_heading=False)
    state = PathState(LINE, 3.0)
    speeds = [law.command((3.0, y, 0.0), STILL, state)[0] for y in (0.0, 0.19, 0.4, 0.59)]
    assert speeds == pytest.approx([1.0, 1.0, 0.36 / (0.8 * 0.9), 0.36 / (1.18 * 0.9)])
    assert law.command((3.0, 0.0, 3.0), STILL, state)[0] == 1.0  # it faces back: almost straight on
    sharp = replace(law, lookahead_dist=0.1)
    assert sharp.command((3.0, 0.09, 0.0), STILL, state)[0] == 0.25
    slow = replace(sharp, desired_linear_vel=0.2)
    assert slow.command((3.0, 0.09, 0.0), STILL, state)[0] == 0.2  # the least speed is not above the desired one


def test_a_fixed_distance_for_the_regulation() -> None:
    turn = arc(0.6, 4.0)
    law = PurePursuit(use_fixed_curvature_lookahead=True, curvature_lookahead_dist=0.3)
    v, omega = law.command((0.0, 0.05, 0.0), STILL, PathState(turn, 0.0))
    x, y = lookahead_point(PathState(turn, 0.0), (0.0, 0.05, 0.0), 0.3)
    assert v == pytest.approx(0.5 / max(1.0, 0.9 * 2.0 * abs(y) / (x**2 + y**2)))
    assert omega / v == pytest.approx(arc_curvature(*lookahead_point(PathState(turn, 0.0), (0.0, 0.05, 0.0), 0.6)))


def test_it_turns_on_the_spot_towards_a_point_beside_or_behind_it() -> None:
    state, law = PathState(LINE, 3.0), PurePursuit()
    assert law.command((3.0, 0.0, 1.5), [0.0, 0.0, -1.75], state) == (0.0, -1.8)
    assert law.command((3.0, 0.0, -3.0), [0.0, 0.0, 1.0], state) == pytest.approx((0.0, 1.0 + 3.2 / 20.0))
    assert law.command((3.0, 0.0, 0.78), STILL, state)[0] > 0.0


def test_it_slows_down_before_the_end_and_stops_there() -> None:
    law = PurePursuit()
    speeds = [law.command((x, 0.0, 0.0), STILL, PathState(LINE, x))[0] for x in (8.9, 9.5, 9.7, 9.76)]
    assert speeds == pytest.approx([0.5, 0.25, 0.15, 0.0])
    close = replace(law, xy_goal_tolerance=0.01)
    assert close.command((9.98, 0.0, 0.0), STILL, PathState(LINE, 9.98))[0] == 0.05


@pytest.mark.parametrize("icr_x", [0.0, 0.28])
def test_the_offset_on_a_circle(icr_x: float) -> None:
    """None on a unicycle; with icr_x the arc to the point ahead is the one that v_y bends to the circle it drives."""
    law = replace(PLAIN, desired_linear_vel=1.0)

    def miss(radius: float) -> float:
        theta_e = math.asin(icr_x / radius)
        to_point = math.asin((0.36 + radius**2 - 4.0) / (1.2 * radius))
        return math.tan(theta_e) / icr_x - 2.0 / 0.6 * math.sin(to_point - theta_e)

    offset = float(brentq(miss, 2.0, 2.5)) - 2.0 if icr_x else 0.0
    wheels = Wheels(PLANT if icr_x else CENTRED, 3.0)
    run = follow(law, wheels, RING, (0.0, 0.0, 0.0), 15.0)
    assert run.aside[-1] == pytest.approx(-offset, abs=5e-3)
    assert offset > 0.07 or icr_x == 0.0


@pytest.mark.parametrize("preset", ["nav2", "plain", "adaptive"])
def test_it_follows_the_lemniscate(preset: str) -> None:
    path, wheels = lemniscate(110.77 / 5.0 / 2.622057), Wheels(CENTRED, 3.0)
    law = replace(PRESETS[preset], desired_linear_vel=1.0)
    run = follow(law, wheels, path, path.at(0.0) + [0.2, -0.6, 0.5], 30.0)
    assert abs(run.aside[0]) > 0.2
    assert run.s[-1] > path.length
    assert np.abs(run.aside[700:]).max() < (0.03 if preset == "adaptive" else 0.01)


def test_it_comes_to_a_line_from_behind() -> None:
    run = follow(PurePursuit(), Wheels(CENTRED, 3.0), LINE, (1.0, -0.5, math.pi), 26.0)
    assert abs(run.aside[-1]) < 0.005
    assert np.abs(run.twists[-1]).max() == 0.0
    assert run.poses[-1, 0] == pytest.approx(9.75, abs=0.02)


@given(st.floats(-math.pi, math.pi), st.floats(0.01, 0.99))
def test_the_way_to_a_fixed_point_is_one_circle(angle: float, share: float) -> None:
    """What it commands does not change on the way: facing away it makes one wide turn, and none if exactly so."""
    assume(abs(math.sin(angle)) > 1e-6)
    at = 0.9 * math.cos(angle), 0.9 * math.sin(angle)
    curvature = arc_curvature(*at)
    assert curvature == pytest.approx(2.0 * math.sin(angle) / 0.9)
    turn = share * 2.0 * abs(angle)  # of the 2 a to the point
    way = compose(invert(exp(np.array([1.0, 0.0, curvature]) * turn / abs(curvature))), np.array([*at, 0.0]))
    assert arc_curvature(*way[:2]) == pytest.approx(curvature, rel=1e-6)


@pytest.mark.parametrize("name", ["adaptive", "plain"])
def test_facing_away_before_a_path_it_makes_the_wide_turn_that_the_law_tells(name: str) -> None:
    start = np.array([-0.9, 0.0, math.radians(175.0)])
    run = follow(PRESETS[name], Wheels(CENTRED, 3.0), LINE, start, 60.0)
    assert np.abs(run.poses[:, 1]).max() == pytest.approx(0.9 / math.sin(math.radians(5.0)), rel=0.02)
    assert abs(run.poses[-1, 1]) < 0.1  # and it is on its way along the path
    assert run.poses[-1, 0] > 6.0
    away = follow(PRESETS[name], Wheels(CENTRED, 3.0), LINE, np.array([-0.9, 0.0, math.pi]), 20.0)
    assert away.poses[-1, 0] < -9.0
    assert follow(PRESETS["nav2"], Wheels(CENTRED, 3.0), LINE, start, 60.0).poses[:, 0].min() > -1.0


def test_the_point_ahead_is_seen_from_the_rear_in_reverse() -> None:
    back = PathState(LINE.in_reverse(), 3.0)
    pose = compose((3.0, 0.1, 0.2), (0.0, 0.0, math.pi))
    assert lookahead_point(back, tuple(pose.tolist()), 0.6) == pytest.approx(
        lookahead_point(PathState(LINE, 3.0), (3.0, 0.1, 0.2), 0.6)
    )


def test_options_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="need lookahead_dist > 0"):
        PurePursuit(lookahead_dist=0.0)
    with pytest.raises(ValueError, match="min_lookahead_dist <= max_lookahead_dist"):
        PurePursuit(min_lookahead_dist=1.0)
