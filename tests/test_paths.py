import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import cumulative_simpson, quad
from scipy.interpolate import CubicSpline
from scipy.special import fresnel, gamma

from skidsteer.errors import DataError, RequestError
from skidsteer.paths import (
    STEP,
    Path,
    arc,
    clothoid,
    join,
    lemniscate,
    line,
    spline,
    stadium,
)
from skidsteer.se2 import FloatArray, compose, wrap

WAYPOINTS = [[0.0, 0.0], [3.0, 1.0], [4.0, 4.0], [7.0, 3.0], [9.0, 5.0]]
START = (1.0, -2.0, 0.7)
PATHS = {
    "line": line(7.0, START),
    "arc": arc(2.0, -2.5, START),
    "clothoid": clothoid(6.0, -0.3, 0.9, START),
    "stadium": stadium(5.0, 1.5, START),
    "lemniscate": lemniscate(6.0, START),
    "spline": spline(WAYPOINTS),
    "loop": spline([[0.0, 0.0], [4.0, -1.0], [6.0, 3.0], [2.0, 5.0]], closed=True),
    "joined": join(line(2.0), clothoid(3.0, 0.0, 0.6), arc(1.0 / 0.6, 1.0), clothoid(2.0, 0.6, 0.0)),
}
ANY = pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)


@ANY
def test_heading_and_position_are_the_integrals_of_curvature(path: Path) -> None:
    s = np.linspace(0.0, path.length, 20_001)
    pose, curvature = path.at(s), path.curvature(s)
    yaw = pose[0, 2] + cumulative_simpson(curvature, x=s, initial=0.0)
    assert_allclose(pose[:, 2], yaw, atol=2e-3)  # curvature jumps where pieces meet
    for axis, rate in ((0, np.cos(pose[:, 2])), (1, np.sin(pose[:, 2]))):
        assert_allclose(pose[:, axis], pose[0, axis] + cumulative_simpson(rate, x=s, initial=0.0), atol=1e-7)


@ANY
def test_the_slope_of_the_curvature_is_its_derivative(path: Path) -> None:
    middle = path.knots[:-1, 0] + 0.5 * np.diff(path.knots[:, 0])
    difference = (path.curvature(middle + 1e-4) - path.curvature(middle - 1e-4)) / 2e-4
    assert_allclose(path.curvature_slope(middle), difference, atol=1e-6)


@ANY
def test_one_frame_is_that_of_many(path: Path) -> None:
    for s in np.linspace(-1.3 * path.length, 2.3 * path.length, 23):
        frame = path.frame(float(s))
        assert_array_equal(frame[:3], path.at(s))
        assert_array_equal(frame[3:], [path.curvature(s), path.curvature_slope(s)])


def test_a_line_and_an_arc_by_hand() -> None:
    assert_allclose(line(2.0, (1.0, 2.0, np.pi / 2)).at([0.0, 1.5, 2.0]), [[1, y, np.pi / 2] for y in (2, 3.5, 4)])
    left = arc(2.0, np.pi / 2)
    assert left.length == pytest.approx(np.pi)
    assert_allclose(left.end, [2.0, 2.0, np.pi / 2], atol=1e-12)
    assert_allclose(arc(2.0, -np.pi / 2, (1.0, 0.0, np.pi)).end, [-1.0, 2.0, np.pi / 2], atol=1e-12)
    assert_allclose(left.curvature([0.0, 1.0]), 0.5)
    assert_allclose(left.curvature_slope([0.0, 1.0]), 0.0)


def test_a_clothoid_is_that_of_fresnel() -> None:
    """From a straight on, with kappa = c s: x = sqrt(pi / c) C(s sqrt(c / pi)), y likewise with S."""
    c, s = 0.4, np.linspace(0.0, 5.0, 23)
    sine, cosine = fresnel(s * np.sqrt(c / np.pi))
    expected = np.column_stack([np.sqrt(np.pi / c) * cosine, np.sqrt(np.pi / c) * sine, 0.5 * c * s**2])
    assert_allclose(clothoid(5.0, 0.0, 2.0).at(s), expected, atol=1e-12)


def test_a_lemniscate_is_bernoullis() -> None:
    path = lemniscate(8.0)
    a = 4.0
    assert path.length == pytest.approx(2.0 * a * gamma(0.25) ** 2 / (2.0 * np.sqrt(2.0 * np.pi)))  # 2 a varpi
    inside = path.placed((0.0, 0.0, -np.pi / 4)).at(np.linspace(0.0, path.length, 501))  # along the axes
    x, y = inside[:, 0], inside[:, 1]
    assert_allclose((x**2 + y**2) ** 2, a**2 * (x**2 - y**2), atol=1e-6)
    assert x.max() == pytest.approx(a, abs=1e-6)
    s = np.linspace(0.01, 0.49, 50) * path.length
    assert_allclose(path.curvature(s), 3.0 * np.hypot(*path.at(s)[:, :2].T) / a**2, atol=1e-4)
    assert_allclose(path.curvature(s + 0.5 * path.length), -path.curvature(s), atol=1e-4)
    assert path.curvature_slope(0.0) == pytest.approx(3.0 / a**2, rel=1e-3)
    assert_allclose(path.end[:2], 0.0, atol=1e-9)


def test_the_lemniscate_of_the_benchmark() -> None:
    assert 5.0 * lemniscate(110.77 / 5.0 / (2.0 * 1.3110287771461)).length == pytest.approx(110.77, rel=1e-3)


def test_a_spline_goes_through_its_waypoints_as_long_as_an_integral_says() -> None:
    path = spline(WAYPOINTS)
    points = np.array(WAYPOINTS)
    u = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    curve = CubicSpline(u, points, bc_type="natural")
    lengths = [quad(lambda t: np.hypot(*curve(t, 1)), a, b, epsabs=1e-12)[0] for a, b in itertools.pairwise(u)]
    s = np.r_[0.0, np.cumsum(lengths)]
    assert path.length == pytest.approx(s[-1], abs=1e-9)
    assert_allclose(path.at(s)[:, :2], points, atol=1e-7)
    (dx, dy), (ddx, ddy) = curve(u, 1).T, curve(u, 2).T
    assert_allclose(path.curvature(s), (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3, rtol=1e-3, atol=1e-6)


def test_a_straight_spline_is_a_line() -> None:
    path = spline([[0.0, 0.0], [1.0, 2.0], [3.0, 6.0]])
    assert path.length == pytest.approx(np.hypot(3.0, 6.0))
    assert_allclose(path.curvature(np.linspace(0.0, path.length, 9)), 0.0, atol=1e-9)
    assert_allclose(spline([[0.0, 0.0], [0.0, 3.0]]).end, [0.0, 3.0, np.pi / 2], atol=1e-12)


def test_a_stadium_by_hand() -> None:
    path = stadium(4.0, 1.0)
    assert path.length == pytest.approx(8.0 + 2.0 * np.pi)
    assert_allclose(path.at([4.0, 4.0 + np.pi / 2, 4.0 + np.pi])[:, :2], [[4, 0], [5, 1], [4, 2]], atol=1e-9)
    assert_allclose(path.curvature([1.0, 4.0 + 1e-6, 5.0, 7.2]), [0.0, 1.0, 1.0, 0.0])
    assert path.end[2] == pytest.approx(2.0 * np.pi)


def brute(path: Path, point: FloatArray) -> float:
    s, step = np.linspace(0.0, path.length, 40_001, retstep=True)
    near = s[np.hypot(*(path.at(s)[:, :2] - point).T).argmin()]
    s = np.clip(np.linspace(near - step, near + step, 2_001), 0.0, path.length)
    return float(np.hypot(*(path.at(s)[:, :2] - point).T).min())


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(PATHS)), st.floats(-6.0, 12.0), st.floats(-6.0, 9.0))
@example("joined", 1.0, 0.0)  # on the path, between two samples
def test_no_point_is_nearer_than_the_projection(name: str, x: float, y: float) -> None:
    path, point = PATHS[name], np.array([x, y])
    s = path.project(point)
    assert 0.0 <= s <= path.length
    found = path.at(s)
    least = brute(path, point)
    assert least - 1e-3 * STEP <= np.hypot(*(found[:2] - point)) <= least + 0.5 * STEP**2 + 1e-6 * (1.0 + least)
    if 0.0 < s < path.length and 1.0 - path.curvature(s) * path.error([x, y, 0.0], s)[1] > 0.1:
        assert abs(path.error([x, y, 0.0], s)[0]) < 1e-9  # at a right angle


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(PATHS)), st.floats(0.01, 0.99), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0))
def test_offset_and_heading_come_back_from_the_frame(name: str, share: float, aside: float, turned: float) -> None:
    path = PATHS[name]
    s = share * path.length
    pose = compose(path.at(s), [0.0, aside, turned])
    found = path.project(pose[:2], near=s + 0.3)
    assert found == pytest.approx(s, abs=1e-7)
    assert_allclose(path.error(pose, found), [0.0, aside, wrap(turned)], atol=1e-6)


def test_the_window_keeps_the_branch_where_the_path_crosses_itself() -> None:
    path = lemniscate(6.0)
    half = 0.5 * path.length
    point = path.at(half)[:2] + [0.01, 0.02]
    assert abs(path.project(point, near=half - 0.1) - half) < 0.1
    assert abs(path.project(point, near=0.1)) < 0.1
    assert abs(path.project(point, near=path.length + 0.1) - path.length) < 0.1


def test_a_lost_robot_is_found_on_the_whole_path() -> None:
    path = line(30.0)
    assert path.project([20.0, 0.4], near=3.0) == pytest.approx(20.0)
    assert path.project([4.5, 0.4], near=3.0) == pytest.approx(4.5)
    assert path.project([-1.0, 0.4], near=0.5) == 0.0
    assert path.project([31.0, 0.4], near=29.5) == 30.0
    loop = stadium(10.0, 2.0)
    lap = loop.length
    assert loop.project(loop.at(-0.004)[:2], near=0.0) == pytest.approx(-0.004, abs=1e-9)  # across the seam
    assert loop.project(loop.at(3.0)[:2], near=2.0 * lap + 15.0) == pytest.approx(2.0 * lap + 3.0)
    assert loop.project(loop.at(0.5)[:2], near=lap - 0.5) == pytest.approx(lap + 0.5)


def test_laps_go_on_and_open_ends_go_straight_on() -> None:
    loop = stadium(4.0, 1.0, START)
    s = np.linspace(0.0, loop.length, 17)[:-1]
    assert_allclose(loop.at(s + 2.0 * loop.length), loop.at(s) + [0.0, 0.0, 4.0 * np.pi], atol=1e-9)
    assert_allclose(loop.curvature(s - loop.length + 1e-9), loop.curvature(s + 1e-9))
    open_ = arc(2.0, 1.0)
    assert_allclose(open_.at(open_.length + 0.5), compose(open_.end, [0.5, 0.0, 0.0]))
    assert_allclose(open_.at(-0.5), [-0.5, 0.0, 0.0])
    assert open_.curvature(-0.5) == open_.curvature(open_.length + 0.5) == 0.0


def test_in_reverse_the_rear_leads() -> None:
    path = arc(3.0, 1.0).in_reverse()
    assert_allclose(path.robot(0.0), [0.0, 0.0, np.pi])
    assert_allclose(path.error([0.0, 0.2, np.pi + 0.1], 0.0), [0.0, 0.2, 0.1], atol=1e-12)
    assert_allclose(path.at(0.0), 0.0)
    assert path.in_reverse().robot(0.0)[2] == 0.0
    assert join(path, path).reverse


@given(st.floats(-20, 20), st.floats(-20, 20), st.floats(-7, 7))
def test_a_moved_path_is_moved_everywhere(x: float, y: float, yaw: float) -> None:
    path = clothoid(5.0, 0.2, -0.5)
    s = np.linspace(0.0, 5.0, 9)
    assert_allclose(path.placed((x, y, yaw)).at(s), compose([x, y, yaw], path.at(s)), atol=1e-9)


def test_a_path_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        line(1.0).knots[0, 0] = 1.0


def knots(*rows: tuple[float, ...]) -> FloatArray:
    return np.array(rows)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: line(0.0), "length of a path must be a positive"),
        (lambda: arc(-1.0, 1.0), "radius of a path must be a positive"),
        (lambda: arc(1.0, 0.0), "length of a path must be a positive"),
        (lambda: clothoid(1.0, 0.0, np.nan), "curvature of a path must be finite"),
        (lambda: lemniscate(np.inf), "width"),
        (lambda: stadium(-1.0, 1.0), "length"),
        (lambda: Path(knots((0, 0, 0, 0, 0, 0))), "at least two rows"),
        (lambda: Path(knots((0, 0, 0, 0, 0, 0), (0, 1, 0, 0, 0, 0))), "increase from knot to knot"),
        (lambda: Path(knots((0, 0, 0, 0, 0, 0), (1, 1, 0, 0.5, 0, 0))), r"kink of 28.65 deg at s = 1.00 m; round it"),
        (lambda: Path(knots((0, 0, 0, 0, 0, 0), (1, 1.2, 0, 0, 0, 0))), r"gap of 0.2000 m"),
        (lambda: Path(line(1.0).knots, closed=True), "must end where it begins: 1.0000 m"),
        (lambda: join(stadium(1.0, 1.0), line(1.0)), "only open paths"),
        (lambda: join(line(1.0), line(1.0).in_reverse()), "all of them driven ahead or all in reverse"),
        (lambda: join(), "only open paths"),
    ],
)
def test_paths_that_cannot_be(make: object, message: str) -> None:
    with pytest.raises(RequestError, match=message):
        make()  # type: ignore[operator]


@pytest.mark.parametrize(
    ("points", "closed", "message"),
    [
        ([[0, 0]], False, "at least 2 different waypoints, got 1"),
        ([[0, 0], [1, 0]], True, "at least 3 different waypoints, got 2"),
        ([[0, 0], [1, 1], [1, 1], [2, 0]], False, r"waypoints 2 and 3 are the same point \(1, 1\); delete one"),
        ([[0, 0], [1, 0], [0, 0.01]], False, "goes back by 179 deg at waypoint 2"),
        ([[0, 0], [1, np.nan]], False, "finite x, y"),
        ([0.0, 1.0], False, "finite x, y"),
    ],
)
def test_waypoints_that_cannot_be(points: list[list[float]], closed: bool, message: str) -> None:
    with pytest.raises(DataError, match=message):
        spline(points, closed)


def test_a_projection_needs_numbers() -> None:
    with pytest.raises(ValueError, match="finite point"):
        line(1.0).project([np.nan, 0.0])
    with pytest.raises(ValueError, match="window > 0"):
        line(1.0).project([0.0, 0.0], near=0.0, window=0.0)
