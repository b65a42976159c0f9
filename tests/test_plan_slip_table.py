"""Circle runs as a motion model for plans, and the integers of the rover."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skidsteer.errors import RequestError
from skidsteer.models.slip_ratio import CircleRun, turn_radius
from skidsteer.plan.encoding import ENCODINGS
from skidsteer.plan.slip_table import SlipTable
from skidsteer.samples import rover_runs

B = 0.28
INDOOR = tuple(run for run in rover_runs() if run.surface == "indoor")
TABLE = SlipTable(INDOOR, B)


@pytest.mark.parametrize("run", INDOOR, ids=lambda run: run.name)
def test_a_run_is_met_exactly(run: CircleRun) -> None:
    turn = 1.0 if run.direction == "left" else -1.0
    assert run.speed is not None
    expected = [run.speed, 0.0, turn * run.speed / run.radius]
    assert_allclose(TABLE.twist(run.v_left, run.v_right), expected, atol=1e-9)
    assert_allclose(TABLE.wheel_speeds(expected[0], expected[2]), [run.v_left, run.v_right], atol=1e-9)


@pytest.mark.parametrize("radius", [0.32, 0.5, 0.9, 2.0, 5.0, 40.0])
@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_wheel_speeds_undo_twist(radius: float, turn: float) -> None:
    v = np.array([0.2, 0.45, 0.8])
    rims = TABLE.wheel_speeds(v, turn * v / radius)
    assert_allclose(TABLE.twist(rims[:, 0], rims[:, 1])[:, [0, 2]], np.column_stack([v, turn * v / radius]), rtol=2e-4)


def test_an_arc_between_two_runs_by_hand() -> None:
    # half way between 2L (1.176 m) and 3L (0.471 m) in curvature
    curvature = 0.5 * (1.0 / 1.176 + 1.0 / 0.471)
    K = 0.5 * (INDOOR[1].slip_ratio(B) + INDOOR[2].slip_ratio(B))  # type: ignore[operator]
    left, right = TABLE.wheel_speeds(0.4, 0.4 * curvature)
    assert turn_radius(right, left, K, B) == pytest.approx(1.0 / curvature)
    slips = [run.slip_coefficients(B)[1] for run in INDOOR[1:3]]  # type: ignore[index]
    outer = 0.4 * (1.0 + 0.5 * B * curvature) / (1.0 - 0.5 * sum(slips))
    assert right == pytest.approx(outer)


def test_straight_and_rest_do_not_slip() -> None:
    assert_allclose(TABLE.twist([0.5, 0.0], [0.5, 0.0]), [[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert_allclose(TABLE.wheel_speeds(0.5, 0.0), [0.5, 0.5])


def test_slopes_by_speed() -> None:
    left, right, d = np.array([0.3, 0.9, 0.41]), np.array([0.8, 0.35, 0.6]), 1e-4
    by_left = (TABLE.twist(left + d, right) - TABLE.twist(left - d, right)) / (2.0 * d)
    by_right = (TABLE.twist(left, right + d) - TABLE.twist(left, right - d)) / (2.0 * d)
    assert_allclose(TABLE.speed_jacobian(left, right), np.stack([by_left, by_right], axis=-1), rtol=0.02, atol=2e-3)


def test_motion_that_no_run_knows() -> None:
    assert np.isnan(TABLE.twist([0.0, -0.3], [0.5, -0.3])[:, 0]).all()
    with pytest.raises(RequestError, match="forward motion only"):
        TABLE.wheel_speeds(-0.3, 0.1)
    with pytest.raises(RequestError, match=r"0\.250 m to the left .* 0\.309 m only"):
        TABLE.wheel_speeds(0.25, 1.0)
    turf = SlipTable(tuple(run for run in rover_runs() if run.surface == "football"), B)
    with pytest.raises(RequestError, match=r"to the right .* there are none"):
        turf.wheel_speeds(0.25, -0.2)


def test_runs_that_tell_no_slips() -> None:
    with pytest.raises(RequestError, match="2L has no slip of both sides"):
        SlipTable((INDOOR[0], replace(INDOOR[1], speed=None)), B)
    with pytest.raises(RequestError, match="got none"):
        SlipTable((), B)
    wide, tight = replace(INDOOR[0], radius=0.4), replace(INDOOR[3], radius=3.0)
    with pytest.raises(RequestError, match="contradict"):
        SlipTable((wide, tight), B)


def test_the_rover_s_integers() -> None:
    rover = ENCODINGS["rover-4wd1"]
    assert_allclose(rover.speeds((20, 120)), [0.191, 1.249], atol=0.013)
    assert_allclose(rover.speeds((0, 5)), [0.0, 0.02], atol=0.02)
    assert rover.nearest(rover.speeds((26, 65)) + [0.004, -0.004]) == (26, 65)
    with pytest.raises(RequestError, match=r"the right side .* k = 2,"):
        rover.nearest(np.array([0.5, 0.005]))
    with pytest.raises(RequestError, match="the left side"):
        rover.nearest(np.array([1.5, 0.5]))
