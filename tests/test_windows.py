import itertools
import re
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from skidsteer import windows as module
from skidsteer.drive import Drive, Series
from skidsteer.kernels.rollout import SMALL
from skidsteer.models import MODELS, Icr, Model, Parameter
from skidsteer.se2 import FloatArray, between, chain, compose, exp, wrap
from skidsteer.vehicle import preset
from skidsteer.windows import (
    Mount,
    Timing,
    Windows,
    covered,
    increment_windows,
    judging_windows,
    leaps,
    linearize,
    pieces,
    predict,
    seen_by,
    steps,
    stretches,
)

P3AT = preset("pioneer-p3at")
TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)
TWIST = np.array([0.5, 0.0, 0.3])


def drive_at(t: ArrayLike, segments: ArrayLike | None = None, twist: FloatArray = TWIST) -> Drive:
    """Reference poses at stamps t (n,) on an arc; wheels at 20 Hz over the same time, which turn as fast."""
    t = np.asarray(t, dtype=float)
    wheels = np.arange(np.floor(t[0]) - 1, np.ceil(t[-1]) + 1.01, 0.05)
    pose = Series(t, exp((t - t[0])[:, None] * twist), "pose")
    segments = None if segments is None else np.asarray(segments, dtype=float)
    rims = np.tile(1.0 + 0.5 * P3AT.track_width * twist[2] * np.array([-1.0, 1.0]), (len(wheels), 1))
    return Drive("d", P3AT, Series(wheels, rims, "wheels"), pose=pose, segments=segments)


def spans(windows: Windows) -> FloatArray:
    return np.stack([windows.start, windows.end], axis=1)


# A reference that was set anew


@pytest.mark.parametrize(
    ("step", "leapt"),
    [([-3.0, 0.0, 0.0], True), ([0.0, 0.0, 2.0], True), ([-0.3, 0.0, 0.0], False), ([0.0, 0.0, 0.5], False)],
)
def test_windows_end_where_the_reference_leaps(step: list[float], leapt: bool) -> None:
    drive = drive_at(np.arange(0.0, 20.0, 0.1))
    assert drive.pose is not None
    values = drive.pose.values.copy()
    values[100:] += step  # between 9.9 and 10.0 s
    moved = replace(drive, pose=Series(drive.pose.t, values, "pose"))
    assert_allclose(leaps(moved), [[9.9, 10.0]] if leapt else np.zeros((0, 2)))
    for cut in (increment_windows(moved), increment_windows(moved, 0.5), judging_windows(moved)):
        across = (cut.start < 9.95) & (cut.end > 9.95)
        assert across.any() != leapt
    assert len(increment_windows(moved)) == len(increment_windows(drive)) - leapt
    assert not increment_windows(moved).joined[increment_windows(moved).start == 10.0].any() or not leapt


def test_leaps_are_cut_out_of_segments_and_beside_gaps() -> None:
    drive = drive_at(np.arange(0.0, 20.0, 0.1), [[2.0, 4.0], [5.0, 15.0]])
    assert drive.pose is not None
    values = drive.pose.values.copy()
    values[100:, 0] += 5.0
    values[102:, 0] -= 9.0  # and again
    values[120, 0] += 3.0  # a sample that is wrong by itself is for the estimator
    moved = replace(drive, pose=Series(drive.pose.t, values, "pose"))
    assert_allclose(pieces(moved), [[2.0, 4.0], [5.0, 9.9], [10.0, 10.1], [10.2, 15.0]])
    assert_allclose(pieces(drive), drive.segments)
    values[::3, 0] += 100.0  # everywhere: a unit is wrong
    assert not len(leaps(replace(drive, pose=Series(drive.pose.t, values, "pose"))))


@pytest.mark.parametrize("far", [2e3, 5e6, 1e9])
def test_a_fix_at_zero_among_map_coordinates_is_cut_out(far: float) -> None:
    """Alone, or two of them in a row: nothing else is lost, and what is left is that of a clean log."""
    drive = drive_at(np.arange(0.0, 20.0, 0.1))
    assert drive.pose is not None
    for wrong in (slice(100, 101), slice(100, 102)):
        values = drive.pose.values.copy()
        values[wrong, :2] -= far
        spoiled = replace(drive, pose=Series(drive.pose.t, values, "pose"))
        windows, clean = increment_windows(spoiled), increment_windows(drive)
        assert np.abs(windows.motion).max() < 1.0
        assert len(clean) - 3 <= len(windows) <= len(clean) - 2


def test_a_reference_that_froze_catches_up() -> None:
    drive = drive_at(np.arange(0.0, 20.0, 0.1))
    assert drive.pose is not None
    values = drive.pose.values.copy()
    values[100:115] = values[100]
    values[115:, 0] += 1.0  # 1.75 m after 1.5 s at 1 m/s by the wheels
    assert not len(leaps(replace(drive, pose=Series(drive.pose.t, values, "pose"))))
    values[115:, 0] += 6.0
    assert_allclose(leaps(replace(drive, pose=Series(drive.pose.t, values, "pose"))), [[11.4, 11.5]])


def test_a_smaller_leap_shows_where_the_robot_stands() -> None:
    drive = drive_at(np.arange(0.0, 20.0, 0.1))
    assert drive.pose is not None
    stands = drive.wheels.values * (np.abs(drive.wheels.t - 10.0) > 3.0)[:, None]
    values = drive.pose.values.copy()
    values[100:, 0] -= 1.0
    moved = replace(drive, pose=Series(drive.pose.t, values, "pose"))
    assert not len(leaps(moved))
    assert len(leaps(replace(moved, wheels=Series(drive.wheels.t, stands, "wheels")))) == 1


def test_a_reference_that_comes_rarely_is_used_all_the_same() -> None:
    """Windows of 6 s with a pose at either end, and one long gap that tells little."""
    drive = drive_at([0.0, 6.0, 10.0, 16.0, 20.0, 26.0], [[0.0, 6.0], [10.0, 16.0], [20.0, 26.0]])
    assert_allclose(spans(increment_windows(drive)), drive.segments)
    once = drive_at(np.r_[np.arange(0.0, 60.0, 6.0), np.arange(90.0, 120.0, 6.0)])
    assert_allclose(np.diff(spans(increment_windows(once))), 6.0)
    often = drive_at(np.r_[np.arange(0.0, 5.0, 0.1), np.arange(11.0, 20.0, 0.1)])
    assert np.diff(spans(increment_windows(often))).max() < 1.0


# Which windows are judged


def rule(t: FloatArray, length: float) -> list[tuple[float, float]]:
    """The sentence of the documentation: start at a pose, end at the last no more than length later, no overlap."""
    found, i = [], 0
    while i < len(t) - 1:
        later = np.flatnonzero(t <= t[i] + length + 1e-9)[-1]
        if later > i:
            found.append((t[i], t[later]))
        i = max(int(later), i + 1)
    return found


@settings(deadline=None)
@given(st.lists(st.floats(0.03, 3.0), min_size=1, max_size=40), st.floats(0.5, 4.0))
def test_judging_windows_follow_the_rule(gaps: list[float], length: float) -> None:
    t = np.cumsum([0.0, *gaps])
    drive = drive_at(t)
    expected = [(a, b) for a, b in rule(t, length) if b - a >= min(1.0, length / 2)]
    # on the arc at 0.5 m/s, 0.2 m or more are moved in 0.4 s: motion drops none
    assert_allclose(spans(judging_windows(drive, length)), np.reshape(expected, (-1, 2)), atol=0)


def test_judging_windows_by_hand() -> None:
    t = [0.0, 0.9, 1.9, 2.1, 3.9, 4.2, 7.0, 7.5, 8.2]
    # 0 to 1.9; 1.9 to 3.9; 3.9 to 4.2 is too short; from 4.2 no pose within 2 s; 7.0 to 8.2
    assert_allclose(spans(judging_windows(drive_at(t))), [[0.0, 1.9], [1.9, 3.9], [7.0, 8.2]])
    assert_array_equal(judging_windows(drive_at(t)).joined, [False, True, False])


def test_regular_stamps_give_windows_of_the_full_length() -> None:
    t = 1000.0 + 0.1 * np.arange(101)  # 0.1 is not exact in binary: the window must still hold 20 steps
    assert_allclose(np.diff(spans(judging_windows(drive_at(t)))), np.full((5, 1), 2.0))


@pytest.mark.parametrize(
    ("moved", "counts"),
    [
        ([0.101, 0.0, 0.0], True),
        ([-0.08, 0.08, 0.0], True),
        ([0.099, 0.0, np.radians(4.9)], False),
        ([0.0, 0.0, np.radians(5.1)], True),
        ([0.0, 0.0, np.radians(-5.1)], True),
        ([0.0, 0.0, 0.0], False),
    ],
)
def test_a_window_counts_when_the_reference_moved(moved: list[float], counts: bool) -> None:
    start = np.array([3.0, -2.0, 2.0])
    pose = Series(np.array([0.0, 2.0]), chain([moved], start), "pose")
    drive = Drive("d", P3AT, Series(np.arange(0, 3, 0.1), np.zeros((30, 2))), pose=pose)
    assert len(judging_windows(drive)) == int(counts)


def test_motion_is_seen_from_the_start_pose() -> None:
    windows = judging_windows(drive_at(np.arange(0.0, 4.1, 1.0)))
    assert_allclose(windows.motion, [exp(2.0 * TWIST)] * 2, atol=1e-12)


def test_each_segment_is_one_window() -> None:
    t = np.arange(0.0, 20.01, 0.5)
    windows = judging_windows(drive_at(t, [[0.7, 3.2], [4.0, 11.0], [11.0, 12.5]]))
    assert_allclose(spans(windows), [[1.0, 3.0], [4.0, 11.0], [11.0, 12.5]])


def test_a_segment_without_two_poses_gives_no_window() -> None:
    t = np.arange(0.0, 20.01, 2.0)
    assert_allclose(spans(judging_windows(drive_at(t, [[0.5, 1.9], [2.1, 5.0], [6.0, 10.0]]))), [[6.0, 10.0]])


# Increments and pieces


def test_increments_join_neighbours() -> None:
    windows = increment_windows(drive_at([0.0, 0.2, 0.4, 6.0, 6.2, 6.4]))
    # 0.4 to 6.0 is longer than 5 s; what follows begins anew
    assert_allclose(spans(windows), [[0.0, 0.2], [0.2, 0.4], [6.0, 6.2], [6.2, 6.4]])
    assert_array_equal(windows.joined, [False, True, False, True])


def test_increments_with_spacing_by_hand() -> None:
    windows = increment_windows(drive_at(0.1 * np.arange(11)), spacing=0.3)
    assert_allclose(spans(windows), [[0.0, 0.3], [0.3, 0.6], [0.6, 0.9]])
    windows = increment_windows(drive_at([0.0, 0.1, 0.25, 0.9, 0.95, 1.3]), spacing=0.3)
    assert_allclose(spans(windows), [[0.0, 0.9], [0.9, 1.3]])


def test_increments_do_not_leave_their_segment() -> None:
    windows = increment_windows(drive_at(np.arange(0.0, 6.01, 1.0), [[0.0, 2.0], [2.5, 5.2]]))
    assert_allclose(spans(windows), [[0.0, 1.0], [1.0, 2.0], [3.0, 4.0], [4.0, 5.0]])
    assert_array_equal(windows.joined, [False, True, False, True])


def gappy_wheels() -> Series:
    return Series(np.r_[np.arange(0.0, 3.01, 0.1), np.arange(5.0, 8.01, 0.1)], np.ones((62, 2)), "wheels")


def gappy_drive(segments: ArrayLike | None = None) -> Drive:
    drive = drive_at(np.arange(-1.0, 10.01, 0.5), segments)
    return Drive("d", P3AT, gappy_wheels(), pose=drive.pose, segments=drive.segments)


def test_pieces_end_where_wheel_samples_are_missing() -> None:
    assert_allclose(pieces(gappy_drive()), [[0.0, 3.0], [5.0, 8.0]])
    assert_allclose(pieces(gappy_drive([[1.0, 6.0], [6.5, 7.0], [8.5, 9.0]])), [[1.0, 3.0], [5.0, 6.0], [6.5, 7.0]])
    assert pieces(gappy_drive([[3.5, 4.5]])).shape == (0, 2)


def test_a_gap_of_just_one_second_is_none() -> None:
    wheels = Series(np.array([0.0, 1.0, 2.5]), np.ones((3, 2)))
    assert_allclose(pieces(Drive("d", P3AT, wheels)), [[0.0, 1.0], [2.5, 2.5]])


def test_windows_keep_out_of_gaps_in_the_wheels() -> None:
    for windows in (increment_windows(gappy_drive()), judging_windows(gappy_drive())):
        assert len(windows) >= 3
        for a, b in spans(windows):
            assert (0.0 <= a < b <= 3.0) or (5.0 <= a < b <= 8.0)
        assert_array_equal(windows.start[~windows.joined], [0.0, 5.0])


def test_dropping_a_window_cuts_the_chain() -> None:
    windows = increment_windows(drive_at(np.arange(6.0)))
    kept = windows.where(np.array([True, False, True, True, False]))
    assert_array_equal(kept.start, [0.0, 2.0, 3.0])
    assert_array_equal(kept.joined, [False, False, True])
    assert_array_equal(kept.motion, windows.motion[[0, 2, 3]])
    assert_array_equal(windows.where(np.array([False, True, True, True, True])).joined, [False, True, True, True])


def test_stretches_and_what_they_cover() -> None:
    t = np.array([0.0, 0.5, 1.5, 2.6, 3.0, 5.0])
    assert_allclose(stretches(t), [[0.0, 1.5], [2.6, 3.0], [5.0, 5.0]])
    start, end = np.array([[0.0, 1.5], [1.0, 2.7], [2.6, 3.0], [3.0, 5.0], [-0.1, 1.0], [2.0, 2.2], [5.0, 5.0]]).T
    assert_array_equal(covered(t, start, end), [True, False, True, False, False, False, True])


def test_positions_are_seen_along_the_axes_of_the_reference() -> None:
    xy = np.array([[1.0, 1.0], [1.5, 1.2], [1.5, 2.2]])
    drive = Drive("d", P3AT, Series(np.arange(4.0), np.ones((4, 2))), position=Series(np.arange(3.0), xy))
    windows = increment_windows(drive)
    assert windows.sees == "position"
    assert_allclose(windows.motion, [[0.5, 0.2, 0.0], [0.0, 1.0, 0.0]], atol=1e-15)
    assert_array_equal(windows.joined, [False, True])
    judged = judging_windows(drive)
    assert_allclose(spans(judged), [[0.0, 2.0]])
    assert judged.where(np.array([True])).sees == "position"


def test_poses_come_before_positions() -> None:
    drive = drive_at(np.arange(5.0))
    drive = Drive("d", P3AT, drive.wheels, pose=drive.pose, position=Series(np.arange(50.0), np.zeros((50, 2))))
    assert increment_windows(drive).sees == "pose"


def test_a_gyro_alone_gives_windows_of_time() -> None:
    wheels = Series(np.arange(0.0, 10.0, 0.1), np.zeros((100, 2)))
    drive = Drive("d", P3AT, wheels, gyro=Series(np.arange(2.0, 9.0, 0.01), np.zeros(700)))
    windows = increment_windows(drive)
    assert windows.sees == "turn"
    assert_allclose(spans(windows), np.c_[np.arange(2.0, 8.4, 0.5), np.arange(2.5, 9.0, 0.5)])
    assert_allclose(spans(judging_windows(drive)), [[2.0, 4.0], [4.0, 6.0], [6.0, 8.0]])  # though nothing moved


def test_a_drive_without_reference_has_no_windows() -> None:
    drive = Drive("mine", P3AT, gappy_wheels())
    for function in (increment_windows, judging_windows):
        with pytest.raises(ValueError, match=r"^mine has no reference$"):
            function(drive)


@pytest.mark.parametrize("place", [(np.nan, 0.0, 0.0), (0.0, np.inf, 0.0), (0.0, 0.0, np.nan)])
def test_mount_refuses(place: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match=r"^a mount needs finite x, y \[m\] and yaw \[rad\], got "):
        Mount(*place)


@pytest.mark.parametrize(("offset", "lag"), [(np.nan, 0.0), (0.0, -0.1), (np.inf, 0.0), (0.0, np.nan)])
def test_timing_refuses(offset: float, lag: float) -> None:
    message = f"need a finite time_offset and lag >= 0 [s], got {offset}, {lag}"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        Timing(offset, lag)


# Prediction against an independent integration


@dataclass(frozen=True)
class Cubic(Model):
    """Not linear in the speeds, nor in its parameters: v_x = s (l + r), v_y = k (r^2 - l^2), omega = c d + q^2 d^3."""

    NAME: ClassVar[str] = "cubic"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = tuple(Parameter(n, "", 1.0, 0.0, 2.0, "") for n in "skcq")

    s: float
    k: float
    c: float
    q: float

    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        left, right = np.asarray(v_left), np.asarray(v_right)
        d = right - left
        return np.stack([self.s * (left + right), self.k * (right**2 - left**2), self.c * d + self.q**2 * d**3], -1)

    def parameter_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        left, right = np.asarray(v_left), np.asarray(v_right)
        d, o = right - left, np.zeros_like(right)
        rows = [[left + right, o, o, o], [o, right**2 - left**2, o, o], [o, o, d, 2 * self.q * d**3]]
        return np.moveaxis(np.array(rows), [0, 1], [-2, -1])

    def speed_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        left, right = np.asarray(v_left), np.asarray(v_right)
        s, turn = np.full_like(right, self.s), self.c + 3 * self.q**2 * (right - left) ** 2
        rows = [[s, s], [-2 * self.k * left, 2 * self.k * right], [-turn, turn]]
        return np.moveaxis(np.array(rows), [0, 1], [-2, -1])

    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:
        raise NotImplementedError


@dataclass(frozen=True)
class Unrolled(Model):
    """An Icr that does not tell it is a matrix."""

    NAME: ClassVar[str] = "unrolled"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = Icr.PARAMETERS

    icr_y_left: float
    icr_y_right: float
    icr_x: float
    alpha_left: float
    alpha_right: float

    def inner(self) -> Icr:
        return Icr(*self.theta)

    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        return self.inner().twist(v_left, v_right)

    def parameter_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        return self.inner().parameter_jacobian(v_left, v_right)

    def speed_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        return self.inner().speed_jacobian(v_left, v_right)

    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:
        return self.inner().wheel_speeds(v, omega)


CUBIC = Cubic(0.45, 0.1, 1.4, 0.5)
UNROLLED = Unrolled(*TRUTH.theta)


def wheel_log(rate: float = 20.0, seconds: float = 12.0, scale: float = 1.0, seed: int = 3) -> Series:
    """Irregular samples of speeds that jump: the first at t = 2 s."""
    rng = np.random.default_rng(seed)
    t = 2.0 + np.cumsum(rng.uniform(0.5, 1.5, int(seconds * rate)) / rate)
    return Series(t, scale * rng.uniform(-0.6, 0.9, (len(t), 2)), "wheels")


def some_windows(wheels: Series, count: int = 12, seed: int = 4) -> Windows:
    """Windows of 0.02 to 2 s anywhere in the log, in no order, one or two reaching beyond its ends."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(wheels.t[0], wheels.t[-1] - 1.0, count)
    start[:2] = wheels.t[0] - 0.5, wheels.t[-1] - 0.4
    end = start + rng.uniform(0.02, 2.0, count)
    return Windows(start, end, np.zeros((count, 3)), np.zeros(count, bool))


def integrate(model: Model, wheels: Series, a: float, b: float, lag: float) -> FloatArray:
    """Pose at b seen from a: x' = cos(yaw) v_x - ..., lag f' = v - f, the speed held from sample to sample."""

    def slope(v: FloatArray, y: FloatArray) -> FloatArray:
        v_x, v_y, omega = model.twist(*(y[3:] if lag > 0 else v))
        c, s = np.cos(y[2]), np.sin(y[2])
        return np.array([c * v_x - s * v_y, s * v_x + c * v_y, omega, *((v - y[3:]) / lag if lag > 0 else (0.0, 0.0))])

    first = min(a, wheels.t[0])
    edges = np.unique(np.r_[first, wheels.t[wheels.t < b], a, b])
    y, at_a = np.r_[0.0, 0.0, 0.0, wheels.values[0]], np.zeros(3)
    for left, right in itertools.pairwise(edges):
        if left == a:
            at_a = y[:3]
        v = wheels.hold(left)
        y = solve_ivp(lambda _, y, v=v: slope(v, y), (left, right), y, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    return between(at_a, y[:3])


@pytest.mark.parametrize("model", [TRUTH, UNROLLED, CUBIC])
@pytest.mark.parametrize("offset", [0.0, 0.37, -0.2])
def test_predict_is_the_integral(model: Model, offset: float) -> None:
    wheels = wheel_log(seconds=4.0)
    windows = some_windows(wheels, 6)
    predicted = predict(model, wheels, windows, Timing(offset))
    # stamps late by the offset: a window [a, b] of the reference is [a - offset, b - offset] of the wheels
    expected = [integrate(model, wheels, a - offset, b - offset, 0.0) for a, b in spans(windows)]
    assert_allclose(predicted, expected, atol=1e-8)


def within(wheels: Series, windows: Windows, timing: Timing) -> np.ndarray:
    """Mask (k,) of windows that do not reach beyond the log."""
    late = timing.time_offset
    return (windows.start - late > wheels.t[0]) & (windows.end - late < wheels.t[-1])


def refined(wheels: Series, parts: int) -> Series:
    """The same held speeds, each sample told several times."""
    t = np.linspace(wheels.t[:-1], wheels.t[1:], parts, endpoint=False, axis=1).ravel()
    return Series(np.r_[t, wheels.t[-1]], np.r_[np.repeat(wheels.values[:-1], parts, axis=0), wheels.values[-1:]])


@pytest.mark.parametrize("lag", [0.02, 0.08, 0.7])
@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_predict_behind_a_lag_comes_near_the_integral(lag: float, offset: float) -> None:
    """Behind a lag the yaw is exact; the speed bends inside a step, where its mean is taken: an error of dt^2."""
    wheels = wheel_log(seconds=4.0)
    windows = some_windows(wheels, 7)
    windows = windows.where(within(wheels, windows, Timing(offset)))
    expected = [integrate(TRUTH, wheels, a - offset, b - offset, lag) for a, b in spans(windows)]
    coarse, fine = (predict(TRUTH, refined(wheels, n), windows, Timing(offset, lag)) - expected for n in (4, 8))
    assert_allclose(fine[:, 2], 0.0, atol=1e-9)
    # noise of the speeds as large as the speeds, at 20 Hz: still less than ten micrometres
    assert_allclose(fine[:, :2], 0.0, atol=1e-5)
    assert np.linalg.norm(coarse[:, :2]) == pytest.approx(4 * np.linalg.norm(fine[:, :2]), rel=0.2)


@pytest.mark.parametrize("model", [TRUTH, UNROLLED])
def test_predict_is_exact_for_large_turns_in_a_step(model: Model) -> None:
    wheels = wheel_log(rate=1.8, seconds=8.0, scale=1.6)
    windows = some_windows(wheels, 8)
    cut = steps(wheels, windows, Timing())
    half = 0.5 * model.twist(cut.distance[:, 0], cut.distance[:, 1])[:, 2]
    assert (np.abs(half) > SMALL).sum() > 3
    assert (np.abs(half) < SMALL).sum() > 3
    expected = [integrate(model, wheels, a, b, 0.0) for a, b in spans(windows)]
    assert_allclose(predict(model, wheels, windows, Timing()), expected, atol=1e-8)


def test_rolled_distance_behind_a_lag_by_hand() -> None:
    # At rest until t = 1, then 1 m/s on the left and -0.5 m/s on the right, lag 0.5 s.
    wheels = Series(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 0.0], [1.0, -0.5], [1.0, -0.5]]))
    window = Windows(np.array([0.5]), np.array([2.5]), np.zeros((1, 3)), np.zeros(1, bool))
    cut = steps(wheels, window, Timing(0.0, 0.5))
    rolled = 1.5 - 0.5 * (1 - np.exp(-3.0))
    assert_allclose(cut.distance.sum(axis=0), [rolled, -0.5 * rolled], atol=1e-14)
    assert_allclose(cut.duration, [0.5, 1.0, 0.5])
    assert_array_equal(cut.offsets, [0, 3])
    assert_allclose(cut.start_speeds, [[0.0, 0.0]])
    assert_allclose(cut.end_speeds, [[1 - np.exp(-3.0), -0.5 * (1 - np.exp(-3.0))]], atol=1e-14)


def one_window(start: float, end: float) -> Windows:
    return Windows(np.array([start]), np.array([end]), np.zeros((1, 3)), np.zeros(1, bool))


def test_order_of_windows_does_not_matter() -> None:
    wheels = wheel_log(rate=100.0)
    windows = some_windows(wheels, 30)
    timing = Timing(0.1, 0.05)
    mixed = predict(TRUTH, wheels, windows, timing)
    assert_allclose(mixed, [predict(TRUTH, wheels, one_window(a, b), timing)[0] for a, b in spans(windows)], atol=0)


def test_neighbouring_windows_chain_to_the_whole() -> None:
    wheels = wheel_log()
    t = np.sort(np.r_[3.0, 8.0, np.random.default_rng(0).uniform(3.0, 8.0, 40), wheels.t[30:40]])
    parts = Windows(t[:-1], t[1:], np.zeros((len(t) - 1, 3)), np.ones(len(t) - 1, bool))
    whole = Windows(t[:1], t[-1:], np.zeros((1, 3)), np.zeros(1, bool))
    timing = Timing(0.0, 0.1)
    assert_allclose(
        chain(predict(TRUTH, wheels, parts, timing))[-1], predict(TRUTH, wheels, whole, timing)[0], atol=1e-2
    )
    held = Timing(0.0, 0.0)  # here the steps are exact arcs however they are cut
    assert_allclose(chain(predict(TRUTH, wheels, parts, held))[-1], predict(TRUTH, wheels, whole, held)[0], atol=1e-12)


def test_beyond_the_log_the_first_and_last_speeds_hold() -> None:
    wheels = Series(np.array([1.0, 2.0]), np.array([[0.2, 0.2], [0.4, 0.4]]))
    straight = Icr(0.3, -0.3, 0.0, 1.0, 1.0)
    for timing in (Timing(), Timing(0.0, 0.2)):
        assert_allclose(predict(straight, wheels, one_window(0.0, 1.0), timing), [[0.2, 0.0, 0.0]], atol=1e-15)
        assert_allclose(predict(straight, wheels, one_window(9.0, 10.0), timing), [[0.4, 0.0, 0.0]], atol=1e-15)
    assert_allclose(predict(straight, wheels, one_window(0.5, 3.0), Timing()), [[0.7, 0.0, 0.0]], atol=1e-15)
    for far in (-1000.0, 1000.0):
        motion, jacobian = linearize(straight, steps(wheels, one_window(far, far + 1.0), Timing(0.0, 0.01)))
        assert motion[0, 0] == pytest.approx(0.2 if far < 0 else 0.4)
        assert_allclose(jacobian[0, :, -2:], 0.0, atol=1e-12)


@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_a_window_that_ends_with_a_sample_ends_before_it(lag: float) -> None:
    wheels = Series(np.arange(4.0), np.array([[0.2, 0.2], [0.4, 0.4], [0.9, 0.9], [0.0, 0.0]]))
    cut = steps(wheels, one_window(0.5, 2.0), Timing(0.0, lag))
    assert_allclose(cut.duration, [0.5, 1.0])


@pytest.mark.parametrize("lag", [0.0, 0.1, 2.0])
def test_after_a_gap_the_first_sample_holds_backwards_and_the_lag_forgets(lag: float) -> None:
    wheels = Series(np.array([0.0, 1.0, 5.0, 6.0]), np.array([[1.0, 1.0], [1.0, 1.0], [0.2, 0.2], [0.2, 0.2]]))
    straight = Icr(0.3, -0.3, 0.0, 1.0, 1.0)
    assert_allclose(predict(straight, wheels, one_window(4.0, 6.5), Timing(0.0, lag)), [[0.5, 0.0, 0.0]], atol=1e-12)
    assert_allclose(predict(straight, wheels, one_window(5.3, 6.3), Timing(0.4, lag)), [[0.2, 0.0, 0.0]], atol=1e-12)


def test_a_short_gap_is_not_warmed_up() -> None:
    wheels = Series(np.array([0.0, 1.0, 2.0]), np.array([[1.0, 1.0], [1.0, 1.0], [0.2, 0.2]]))
    straight = Icr(0.3, -0.3, 0.0, 1.0, 1.0)
    assert_allclose(predict(straight, wheels, one_window(1.0, 2.0), Timing()), [[1.0, 0.0, 0.0]], atol=1e-12)


def test_no_windows_no_motions() -> None:
    wheels = wheel_log(seconds=2.0)
    none = Windows(np.zeros(0), np.zeros(0), np.zeros((0, 3)), np.zeros(0, bool))
    for model in (TRUTH, CUBIC):
        assert predict(model, wheels, none, Timing()).shape == (0, 3)
        motion, jacobian = linearize(model, steps(wheels, none, Timing()))
        assert motion.shape == (0, 3)
        assert jacobian.shape == (0, 3, len(model.theta) + 2)


def speed_behind(wheels: Series, lag: float, query: float) -> FloatArray:
    """f of lag f' = v - f at one time, sample by sample from the first, where f = v."""
    f = wheels.values[0]
    for i, (t, v) in enumerate(zip(wheels.t, wheels.values, strict=True)):
        until = wheels.t[i + 1] if i + 1 < len(wheels) else np.inf
        if query < until:
            return v + (f - v) * np.exp(-max(query - t, 0.0) / lag)
        f = v + (f - v) * np.exp(-(until - t) / lag)
    raise AssertionError


def rolled_by(wheels: Series, start: float, end: float) -> FloatArray:
    """Integral of the held speeds themselves."""
    edges = np.unique(np.r_[start, wheels.t[(wheels.t > start) & (wheels.t < end)], end])
    return np.diff(edges) @ wheels.hold(edges[:-1])


@pytest.mark.parametrize("lag", [0.001, 0.05, 0.5, 5.0])
@pytest.mark.parametrize("regular", [True, False])
def test_what_is_rolled_behind_a_lag(lag: float, regular: bool) -> None:
    """From lag f' = v - f: the integral of f is that of v less lag times what f has gained. In windows of any order."""
    wheels = wheel_log(rate=50.0, seconds=20.0)
    if regular:
        wheels = Series(2.0 + 0.02 * np.arange(len(wheels)), wheels.values)
    windows = some_windows(wheels, 60)
    cut = steps(wheels, windows, Timing(0.0, lag))
    for k, (a, b) in enumerate(spans(windows)):
        first, last = speed_behind(wheels, lag, a), speed_behind(wheels, lag, b)
        part = slice(cut.offsets[k], cut.offsets[k + 1])
        assert_allclose(cut.start_speeds[k], first, atol=1e-13)
        assert_allclose(cut.end_speeds[k], last, atol=1e-13)
        assert_allclose(cut.distance[part].sum(axis=0), rolled_by(wheels, a, b) - lag * (last - first), atol=1e-12)
        assert cut.duration[part].sum() == pytest.approx(b - a, abs=1e-12)


@pytest.mark.parametrize("count", [1, 31, 32, 33, 80])
@pytest.mark.parametrize("lag", [0.0, 0.08])
@pytest.mark.parametrize("scale", [1.0, 3.5])  # steps that turn by up to 0.2 rad and more
def test_many_windows_at_once_are_each_alone(count: int, lag: float, scale: float) -> None:
    """However many windows are rolled side by side, and whichever way: the scalar path and that of any model."""
    wheels = wheel_log(scale=scale)
    start = np.random.default_rng(1).uniform(2.5, 11.0, count)
    windows = Windows(start, start + 1.0, np.zeros((count, 3)), np.zeros(count, bool))
    timing = Timing(0.1, lag)
    cut = steps(wheels, windows, timing)
    together, any_model = linearize(TRUTH, cut), linearize(UNROLLED, cut)
    for k, (a, b) in enumerate(spans(windows)):
        alone = linearize(TRUTH, steps(wheels, one_window(a, b), timing))
        for i in range(2):
            assert_allclose(together[i][k], alone[i][0], atol=1e-11)
    for i in range(2):
        assert_allclose(together[i], any_model[i], atol=1e-11)
    assert_allclose(predict(TRUTH, wheels, windows, timing), together[0], atol=1e-13)


@pytest.mark.parametrize("half", [0.05, 0.15, 0.199, 0.201, 0.29, 0.31, 0.8])
def test_turns_around_the_limits_of_the_series(half: float) -> None:
    """Circles in steps of twice this angle, 40 windows of 20 steps: the closed form."""
    model, t = Icr(0.3, -0.4, 0.1, 0.9, 1.1), np.arange(0.0, 60.0, 0.5)
    left, right = 0.2, 0.2 * 0.9 / 1.1 + 0.7 * 2 * half / 0.5 / 1.1  # omega = 2 half / 0.5 s
    wheels = Series(t, np.tile([left, right], (len(t), 1)))
    windows = Windows(0.5 * np.arange(40.0), 0.5 * np.arange(40.0) + 10.0, np.zeros((40, 3)), np.zeros(40, bool))
    motion = linearize(model, steps(wheels, windows, Timing()))[0]
    expected = exp(10.0 * model.twist(left, right))
    assert expected[2] == pytest.approx(40 * half)
    assert_allclose(motion, np.tile(expected, (40, 1)), rtol=0, atol=2e-13 * (1 + expected[2]))


def test_windows_of_very_different_lengths() -> None:
    wheels = wheel_log(seconds=40.0)
    start = np.full(40, 3.0)
    end = start + np.r_[np.full(39, 0.05), 30.0]
    windows = Windows(start, end, np.zeros((40, 3)), np.zeros(40, bool))
    cut = steps(wheels, windows, Timing())
    for a, b in zip(linearize(TRUTH, cut), linearize(UNROLLED, cut), strict=True):
        assert_allclose(a, b, atol=1e-10)


# Sensitivities


def differences(model: Model, wheels: Series, windows: Windows, timing: Timing, h: float = 1e-6) -> FloatArray:
    """Finite differences (k, 3, p + 2) of ``predict``; by a lag of zero one-sided, second order."""

    def at(theta: FloatArray, offset: float = timing.time_offset, lag: float = timing.lag) -> FloatArray:
        return predict(model.with_theta(theta), wheels, windows, Timing(offset, lag))

    theta = model.theta
    columns = [(at(theta + h * e) - at(theta - h * e)) / (2 * h) for e in np.eye(len(theta))]
    late, early = at(theta, timing.time_offset + h), at(theta, timing.time_offset - h)
    columns.append((late - early) / (2 * h))
    if timing.lag > 0:
        columns.append((at(theta, lag=timing.lag + h) - at(theta, lag=timing.lag - h)) / (2 * h))
    else:
        columns.append((-3 * at(theta) + 4 * at(theta, lag=h) - at(theta, lag=2 * h)) / (2 * h))
    return np.stack(columns, axis=-1)


def assert_same_slopes(jacobian: FloatArray, expected: FloatArray, timing: Timing) -> None:
    """All columns; but that of the offset only without a lag: behind one it is the exact slope, ``predict`` is not."""
    columns = np.ones(jacobian.shape[2], bool)
    columns[-2] = timing.lag == 0.0
    assert_allclose(jacobian[..., columns], expected[..., columns], atol=1e-8, rtol=1e-6)


@pytest.mark.parametrize("timing", [Timing(0.0, 0.0), Timing(0.13, 0.0), Timing(-0.3, 0.08), Timing(0.4, 0.9)])
@pytest.mark.parametrize("name", sorted(MODELS))
def test_linearize_is_the_finite_difference(name: str, timing: Timing) -> None:
    wheels = wheel_log()
    windows = some_windows(wheels)
    model = MODELS[name].nominal(P3AT)
    model = model.with_theta(model.theta + 0.05 * np.arange(1, len(model.theta) + 1))
    motion, jacobian = linearize(model, steps(wheels, windows, timing))
    assert_allclose(motion, predict(model, wheels, windows, timing), atol=1e-13)
    assert_same_slopes(jacobian, differences(model, wheels, windows, timing), timing)


@pytest.mark.parametrize("lag", [0.0, 0.15])
@pytest.mark.parametrize("model", [UNROLLED, CUBIC])
@pytest.mark.parametrize("rate", [20.0, 1.8])  # at 1.8 Hz steps turn by more than the series of the kernel allow
def test_linearize_of_any_model_is_the_finite_difference(model: Model, rate: float, lag: float) -> None:
    wheels = wheel_log(rate=rate, scale=1.3)
    windows = some_windows(wheels)
    timing = Timing(0.21, lag)
    motion, jacobian = linearize(model, steps(wheels, windows, timing))
    assert_allclose(motion, predict(model, wheels, windows, timing), atol=1e-13)
    assert_same_slopes(jacobian, differences(model, wheels, windows, timing), timing)


@pytest.mark.parametrize("model", [TRUTH, CUBIC])
@pytest.mark.parametrize("timing", [Timing(-0.3, 0.08), Timing(0.21, 0.15), Timing(0.4, 0.9)])
def test_derivative_by_the_offset_behind_a_lag(model: Model, timing: Timing) -> None:
    wheels = refined(wheel_log(), 8)
    windows = some_windows(wheels)
    windows = windows.where(within(wheels, windows, timing))
    jacobian = linearize(model, steps(wheels, windows, timing))[1]
    assert_allclose(jacobian[..., -2], differences(model, wheels, windows, timing)[..., -2], atol=2e-4)


@pytest.mark.parametrize("lag", [0.0, 0.3])
@pytest.mark.parametrize("rate", [20.0, 1.8])
def test_matrix_path_equals_generic_path(rate: float, lag: float) -> None:
    wheels = wheel_log(rate=rate, scale=1.6)
    cut = steps(wheels, some_windows(wheels), Timing(0.1, lag))
    for a, b in zip(linearize(TRUTH, cut), linearize(UNROLLED, cut), strict=True):
        assert_allclose(a, b, atol=1e-12)


@pytest.mark.parametrize("chunk", [1, 7, 100, 10**6])
def test_chunks_do_not_change_the_result(chunk: int, monkeypatch: pytest.MonkeyPatch) -> None:
    wheels = wheel_log()
    cut = steps(wheels, some_windows(wheels), Timing(0.1, 0.05))
    whole = linearize(CUBIC, cut)
    monkeypatch.setattr(module, "CHUNK", chunk)
    for a, b in zip(linearize(CUBIC, cut), whole, strict=True):
        assert_allclose(a, b, atol=0)


def test_derivative_by_a_lag_of_zero_where_a_window_begins_with_a_sample() -> None:
    # Speed jumps from 0 to 1 at t = 1: behind a short lag T the window from there rolls T less.
    wheels = Series(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 1.0]]))
    straight = Icr(0.3, -0.3, 0.0, 1.0, 1.0)
    for start in (0.4, 1.0):
        jacobian = linearize(straight, steps(wheels, one_window(start, 1.7), Timing()))[1]
        assert_allclose(jacobian[0, :, -1], [-1.0, 0.0, 0.0], atol=1e-14)
    jacobian = linearize(straight, steps(wheels, one_window(1.1, 1.7), Timing()))[1]
    assert_allclose(jacobian[0, :, -1], 0.0, atol=1e-14)  # by then the transient is over


def test_derivative_by_the_offset_by_hand() -> None:
    # Late stamps mean an earlier window: it gains the speed at its start and loses that at its end.
    wheels = Series(np.array([0.0, 1.0]), np.array([[0.3, 0.3], [0.5, 0.5]]))
    straight = Icr(0.3, -0.3, 0.0, 1.0, 1.0)
    jacobian = linearize(straight, steps(wheels, one_window(0.5, 1.5), Timing()))[1]
    assert_allclose(jacobian[0, :, -2], [0.3 - 0.5, 0.0, 0.0], atol=1e-15)


# A sensor beside the origin


def test_mount_by_hand() -> None:
    """A quarter turn on the spot takes an antenna from 1 m ahead to 1 m left; it looks to the left itself."""
    quarter = np.pi / 2
    assert_allclose(Mount(1.0, 0.0).seen(np.array([[0.0, 0.0, quarter]])), [[-1.0, 1.0, quarter]], atol=1e-15)
    assert_allclose(Mount(1.0, 0.0, quarter).seen(np.array([[0.0, 0.0, quarter]])), [[1.0, 1.0, quarter]], atol=1e-15)
    straight = Mount(0.4, -0.3, quarter).seen(np.array([[2.0, 0.0, 0.0]]))
    assert_allclose(straight, [[0.0, -2.0, 0.0]], atol=1e-15)


def test_seen_is_between_the_poses_of_the_sensor() -> None:
    rng = np.random.default_rng(0)
    body, place = rng.uniform(-1.0, 1.0, (20, 3)), np.array([0.3, -0.2, 0.7])
    poses = chain(body)
    sensor = compose(poses, place)
    assert_allclose(Mount(*place).seen(body), between(sensor[:-1], sensor[1:]), atol=1e-12)


def test_seen_by_is_the_finite_difference() -> None:
    wheels = wheel_log()
    windows, place, h = some_windows(wheels), np.array([0.3, -0.2, 0.7]), 1e-6
    motion, jacobian = linearize(TRUTH, steps(wheels, windows, Timing(0.1, 0.0)))
    seen, slopes = seen_by(Mount(*place), motion, jacobian)
    assert_allclose(wrap_yaw(seen - Mount(*place).seen(motion)), 0.0, atol=1e-13)

    def at(theta: FloatArray, offset: float, where: FloatArray) -> FloatArray:
        return Mount(*where).seen(predict(TRUTH.with_theta(theta), wheels, windows, Timing(offset)))

    x = np.r_[TRUTH.theta, 0.1, place]
    ends = [[at(y[:5], y[5], y[6:]) for y in (x + h * e, x - h * e)] for e in np.eye(9)]
    expected = np.stack([wrap_yaw(a - b) / (2 * h) for a, b in ends], axis=-1)
    assert_allclose(np.delete(slopes, 6, axis=2), expected, atol=1e-8)  # the lag's column comes as it was given


def wrap_yaw(difference: FloatArray) -> FloatArray:
    return np.concatenate([difference[:, :2], wrap(difference[:, 2:])], axis=1)
