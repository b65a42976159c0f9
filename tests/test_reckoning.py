import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from skidsteer.drive import Series
from skidsteer.models import Differential, Icr
from skidsteer.odometry.reckoning import arc, exact, off_circle, polygon, polygon_error, reckon

speeds = st.floats(-3.0, 3.0)
times = st.floats(0.0, 2.0)


def test_a_step_worked_by_hand() -> None:
    # v 2 m/s, omega pi/2 rad/s for 0.5 s: a path of 1 m that turns by pi/4, on a circle of 4/pi m
    twist, R = [2.0, 0.0, np.pi / 2], 4.0 / np.pi
    assert_allclose(polygon(twist, 0.5), [1.0, 0.0, np.pi / 4])
    circle = [R * np.sin(np.pi / 4), R * (1.0 - np.cos(np.pi / 4)), np.pi / 4]
    assert_allclose(arc(twist, 0.5), circle, atol=1e-15)
    assert_allclose(exact(twist, 0.5), circle, atol=1e-15)


def test_exact_steps_against_integration_of_the_differential_equation() -> None:
    v, w, omega = 0.7, -0.2, 1.3

    def rate(_: float, p: np.ndarray) -> list[float]:
        return [v * np.cos(p[2]) - w * np.sin(p[2]), v * np.sin(p[2]) + w * np.cos(p[2]), omega]

    end = solve_ivp(rate, (0.0, 1.7), [0.0, 0.0, 0.0], rtol=1e-11, atol=1e-12).y[:, -1]
    assert_allclose(exact([v, w, omega], 1.7), end, atol=1e-9)


@given(speeds, times)
def test_all_draw_the_straight_line_alike(v: float, dt: float) -> None:
    for step in (polygon, arc, exact):
        assert_allclose(step([v, 0.0, 0.0], dt), [v * dt, 0.0, 0.0], atol=1e-12)


@given(speeds, speeds, times)
def test_a_nearly_straight_arc_is_the_straight_line(v: float, omega: float, dt: float) -> None:
    assert_allclose(arc([v, 0.0, 1e-9 * omega], dt), polygon([v, 0.0, 1e-9 * omega], dt), atol=1e-7)


@given(speeds, speeds, times)
def test_arc_and_exponential_agree_without_side_slip(v: float, omega: float, dt: float) -> None:
    assert_allclose(arc([v, 0.0, omega], dt), exact([v, 0.0, omega], dt), atol=1e-12)


def test_steps_take_batches() -> None:
    twists, dt = np.random.default_rng(0).normal(size=(4, 5, 3)), np.linspace(0.1, 0.4, 5)
    for step in (polygon, arc, exact):
        one = [[step(twists[i, j], dt[j]) for j in range(5)] for i in range(4)]
        assert_allclose(step(twists, dt), one)


def test_reckoning_a_log_step_by_step() -> None:
    model, rng = Icr(0.6, -0.5, 0.1, 0.9, 1.1), np.random.default_rng(1)
    wheels = Series(np.cumsum(rng.uniform(0.05, 0.2, 40)), rng.uniform(-1.0, 1.0, (40, 2)))
    pose = np.array([1.0, -2.0, 0.4])
    for i in range(39):
        step = exact(model.twist(*wheels.values[i]), wheels.t[i + 1] - wheels.t[i])
        c, s = np.cos(pose[2]), np.sin(pose[2])
        pose = pose + [c * step[0] - s * step[1], s * step[0] + c * step[1], step[2]]
    assert_allclose(reckon(model, wheels, start=(1.0, -2.0, 0.4))[-1], pose, atol=1e-12)
    assert_allclose(reckon(model, wheels, "polygon")[0], 0.0)


def test_one_sample_is_where_it_starts() -> None:
    assert_allclose(reckon(Differential(0.5), Series([1.0], [[1.0, 2.0]]), start=(1.0, 2.0, 3.0)), [[1.0, 2.0, 3.0]])


def test_unknown_geometry() -> None:
    with pytest.raises(ValueError, match="polygon, arc, exact, got 'spline'"):
        reckon(Differential(0.5), Series([1.0], [[1.0, 2.0]]), "spline")  # type: ignore[arg-type]


def test_figures_4_and_5_the_polygon_errs_with_the_square_of_the_speed_and_inversely_to_the_radius() -> None:
    # a step: s^2 / (2 R), here 0.1^2 / 10 m
    assert_allclose(polygon_error(1.0, 5.0, 10.0), 0.001, rtol=1e-4)
    assert_allclose(polygon_error(0.5, 5.0, 10.0) / polygon_error(1.0, 5.0, 10.0), 0.25, rtol=1e-3)
    assert_allclose(polygon_error(0.5, 10.0, 10.0) / polygon_error(0.5, 5.0, 10.0), 0.5, rtol=1e-3)
    assert_allclose(polygon_error(0.5, 5.0, 20.0) / polygon_error(0.5, 5.0, 10.0), 0.25, rtol=1e-3)
    assert polygon_error(1.0, np.inf, 10.0) == 0.0
    assert polygon_error(0.0, 5.0, 10.0) == 0.0


def test_the_limit_of_5_cm_that_the_paper_prints_is_half_a_step() -> None:
    for radius in (0.5, 1.0, 5.0):
        assert_allclose(off_circle(1.0, radius, 10.0), 0.05, atol=0.001)
