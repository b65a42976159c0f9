from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from skidsteer.drive import Drive, Series
from skidsteer.gyro import Turn
from skidsteer.metrics import Spread, WindowErrors, align_gyro, aligned_rms, median_interval, window_errors
from skidsteer.models import Differential, Icr, Model
from skidsteer.se2 import FloatArray, chain, compose, rotate
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import preset
from skidsteer.windows import Mount, Timing, Windows, predict

P3AT = preset("pioneer-p3at")
TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)
WRONG = Icr(0.35, -0.35, 0.05, 1.0, 0.9)
STILL, LEFT, RIGHT = [3.0, 0.0, 0.0], [5.0, 0.4, 0.6], [5.0, 0.4, -0.5]
MANOEUVRES = [STILL, [4.0, 0.4, 0.0], LEFT, RIGHT, STILL, [4.0, 0.0, 0.9], [4.0, 0.0, -0.7], RIGHT, LEFT, STILL]
TIMING = Timing(0.2, 0.08)


def perfect_drive(rate: float = 5.0) -> Drive:
    """No noise at all; the reference is 0.2 s late, the lag 0.08 s."""
    rims = rims_from_manoeuvres(np.array(MANOEUVRES), Differential(P3AT.track_width))
    return kinematic_drive("d", P3AT, TRUTH, rims, Sensors(rate, 0.0, 0.0, reference_delay=0.2), lag=0.08)


PERFECT = perfect_drive()


def with_gyro(drive: Drive, late: float, bias: float = 0.0, scale: float = 1.0, noise: float = 0.0) -> Drive:
    """A gyro at 50 Hz whose stamps are late; ``scale`` is true over measured rate."""
    t = np.arange(drive.span[0] + 0.5, drive.span[1] - 0.5, 0.02)
    short = Windows(t - 0.005, t + 0.005, np.zeros((len(t), 3)), np.zeros(len(t), bool))
    rate = predict(TRUTH, drive.wheels, short, Timing(0.0, 0.08))[:, 2] / 0.01
    rate = rate / scale + bias + noise * np.random.default_rng(0).standard_normal(len(t))
    return replace(drive, gyro=Series(t + late, rate, "gyro"))


# Spread


def test_spread_by_hand() -> None:
    spread = Spread.of(np.array([3.0, -4.0, 0.0, 1.0, -2.0]))
    assert spread.median == 2.0
    assert spread.rms == pytest.approx(np.sqrt(30.0 / 5.0))
    assert spread.p95 == pytest.approx(3.8)  # between the fourth and fifth of five sizes, 0.8 of the way
    assert Spread.of(np.array([-0.5])) == Spread(0.5, 0.5, 0.5)


def test_spread_leaves_out_nan() -> None:
    assert Spread.of(np.array([np.nan, 3.0, np.nan, -4.0])) == Spread.of(np.array([3.0, -4.0]))


def test_the_interval_of_a_median_holds_the_truth_as_often_as_it_says() -> None:
    """Errors that blocks share; the median of their size is that of |N(0, 2)|."""
    rng, block, held = np.random.default_rng(3), np.repeat(np.arange(16), 12), 0
    for _ in range(200):
        errors = rng.normal(size=16)[block] + np.sqrt(3.0) * rng.normal(size=192)
        low, high = median_interval(errors, block) or (np.nan, np.nan)
        held += low <= 2.0 * 0.67449 <= high
    assert 0.88 <= held / 200 <= 0.98


def test_the_interval_of_a_median_needs_blocks() -> None:
    block = np.repeat(np.arange(6), 2)
    assert median_interval(np.full(12, -0.5), block) == (0.5, 0.5)
    assert median_interval(np.where(block == 0, np.nan, 1.0), block) is None
    assert median_interval(np.zeros(0), np.zeros(0, int)) is None


@pytest.mark.parametrize("errors", [[], [np.nan, np.nan]])
def test_spread_of_nothing_is_nan(errors: list[float]) -> None:
    spread = Spread.of(np.array(errors))
    assert np.isnan([spread.median, spread.rms, spread.p95]).all()


# Window errors


def test_the_truth_makes_no_errors() -> None:
    errors = window_errors(TRUTH, PERFECT, TIMING)
    assert len(errors) > 15
    assert_allclose(errors.translation, 0.0, atol=1e-6)
    assert_allclose(errors.yaw, 0.0, atol=1e-9)
    assert np.isnan(errors.yaw_gyro).all()  # there is none


def test_window_errors_by_hand() -> None:
    """A reference that turns left by 3.0 rad a window, a model that turns right: the error wraps."""
    pose = Series(np.array([0.0, 2.0, 4.0]), chain([[1.0, 0.0, 3.0], [0.3, -0.4, 0.1]]), "pose")
    wheels = Series(np.array([0.0, 1.0]), np.array([[0.5, 0.5], [0.5, 0.5]]))
    errors = window_errors(Differential(0.5), Drive("d", P3AT, wheels, pose=pose, segments=None), Timing())
    assert len(errors) == 0  # wheels end at 1 s
    wheels = Series(np.arange(5.0), np.array([[0.5, 0.5], [0.5, 0.5], [0.1, -0.1], [0.1, -0.1], [0.0, 0.0]]))
    errors = window_errors(Differential(0.5), Drive("d", P3AT, wheels, pose=pose), Timing())
    # predicted: 1 m straight; -0.8 rad on the spot
    assert_allclose(errors.translation, [0.0, 0.5], atol=1e-12)
    assert_allclose(errors.yaw, [3.0, 0.9], atol=1e-12)
    assert_array_equal(errors.start, [0.0, 2.0])


def test_yaw_errors_are_wrapped() -> None:
    pose = Series(np.array([0.0, 2.0]), chain([[0.0, 0.0, 3.0]]), "pose")
    wheels = Series(np.arange(4.0), np.tile([0.75, -0.75], (4, 1)))
    errors = window_errors(Differential(1.0), Drive("d", P3AT, wheels, pose=pose), Timing())
    assert_allclose(errors.yaw, [6.0 - 2 * np.pi], atol=1e-12)


def test_windows_end_with_the_last_pose_no_later_than_their_length() -> None:
    errors = window_errors(TRUTH, PERFECT, TIMING, length=1.5)
    assert_allclose(errors.end - errors.start, 1.4, atol=1e-9)  # poses come every 0.2 s


def test_a_sensor_beside_the_origin_sees_its_own_motion() -> None:
    """Poses of an antenna at (0.3, -0.2), turned by 0.5 rad: told so, the truth makes no errors."""
    place = [0.3, -0.2, 0.5]
    assert PERFECT.pose is not None
    moved = Series(PERFECT.pose.t, compose(PERFECT.pose.values, place), "pose")
    drive = replace(PERFECT, pose=moved)
    errors = window_errors(TRUTH, drive, TIMING, mount=Mount(*place))
    assert_allclose(errors.translation, 0.0, atol=1e-6)
    assert_allclose(errors.yaw, 0.0, atol=1e-9)
    assert window_errors(TRUTH, drive, TIMING).translation.max() > 0.2
    drive = replace(drive, pose=None, position=Series(moved.t, moved.values[:, :2], "position"))
    assert_allclose(window_errors(TRUTH, drive, TIMING, mount=Mount(*place)).translation, 0.0, atol=1e-6)
    assert window_errors(TRUTH, drive, TIMING).translation.max() > 0.02


def test_join_and_where() -> None:
    """Every field goes the same way, NaN and all."""
    names = [f.name for f in fields(WindowErrors)]
    a, b = (WindowErrors(*(100.0 * i + np.array(v) for i in range(len(names)))) for v in ([0.0, np.nan], [5.0]))
    both = WindowErrors.join([a, b])
    assert len(both) == 3
    kept = both.where(np.array([True, False, True]))
    for i, name in enumerate(names):
        assert_array_equal(getattr(both, name), 100.0 * i + np.array([0.0, np.nan, 5.0]))
        assert_array_equal(getattr(kept, name), 100.0 * i + np.array([0.0, 5.0]))
    assert len(WindowErrors.join([])) == 0


# Positions without heading

paths = arrays(np.float64, (6, 2), elements=st.floats(-3.0, 3.0).map(lambda x: round(x, 3)))


def rms_at(path: FloatArray, reference: FloatArray, turn: float) -> float:
    a, b = path - path.mean(axis=0), reference - reference.mean(axis=0)
    return float(np.sqrt(((rotate(np.full(len(a), turn), a) - b) ** 2).sum(axis=1).mean()))


@given(paths, paths)
def test_aligned_rms_is_the_least_over_all_turns(path: FloatArray, reference: FloatArray) -> None:
    turns = np.linspace(-np.pi, np.pi, 721)
    coarse = turns[np.argmin([rms_at(path, reference, t) for t in turns])]
    searched = min(rms_at(path, reference, t) for t in coarse + np.linspace(-0.01, 0.01, 201))
    assert aligned_rms(path, reference) == pytest.approx(searched, abs=1e-4)


@given(paths, st.floats(-4.0, 4.0))
def test_aligned_rms_does_not_see_rigid_motions(path: FloatArray, turn: float) -> None:
    moved = compose([3.0, -2.0, turn], np.c_[path, np.zeros(len(path))])[:, :2]
    assert aligned_rms(path, moved) == pytest.approx(0.0, abs=1e-7)
    assert aligned_rms(moved, path) == pytest.approx(0.0, abs=1e-7)


def test_aligned_rms_by_hand() -> None:
    line = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    # twice as long: no scale is fitted, the ends are 1 m off
    assert aligned_rms(line, 2.0 * line[:, ::-1]) == pytest.approx(np.sqrt(2.0 / 3.0))
    # a mirror image cannot be turned away
    corner = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0]])
    assert aligned_rms(corner, corner * [1.0, -1.0]) > 0.3


def positions_of(drive: Drive) -> Drive:
    assert drive.pose is not None
    xy = compose([5.0, 1.0, 2.0], drive.pose.values)[:, :2]
    return replace(drive, pose=None, position=Series(drive.pose.t, xy, "position"))


def test_positions_are_compared_after_alignment() -> None:
    drive = positions_of(PERFECT)
    errors = window_errors(TRUTH, drive, TIMING)
    assert len(errors) > 10
    assert_allclose(errors.translation, 0.0, atol=1e-6)
    assert np.isnan(errors.yaw).all()
    assert np.median(window_errors(WRONG, drive, TIMING).translation) > 1e-3
    with_late_stamps = window_errors(TRUTH, drive, Timing(0.0, 0.08))
    assert with_late_stamps.translation.max() > 1e-3  # the time offset is heeded


def test_position_errors_are_the_rms_along_the_window() -> None:
    """Independent: the path by chaining predicted increments, aligned by a search."""
    drive = positions_of(PERFECT)
    assert drive.position is not None
    errors = window_errors(WRONG, drive, TIMING, length=3.0)
    k = 4
    i = int(np.searchsorted(drive.position.t, errors.start[k]))
    j = int(np.searchsorted(drive.position.t, errors.start[k] + 3.0 + 1e-9, side="right")) - 1
    t, xy = drive.position.t[i : j + 1], drive.position.values[i : j + 1]
    windows = Windows(np.full(j - i, t[0]), t[1:], np.zeros((j - i, 3)), np.zeros(j - i, bool))
    path = np.r_[np.zeros((1, 2)), predict(WRONG, drive.wheels, windows, TIMING)[:, :2]]
    searched = min(rms_at(path, xy, turn) for turn in np.linspace(-np.pi, np.pi, 20_001))
    assert errors.translation[k] == pytest.approx(searched, rel=1e-4)


def test_standing_windows_of_positions_do_not_count() -> None:
    drive = positions_of(PERFECT)
    errors = window_errors(TRUTH, drive, TIMING)
    assert drive.position is not None
    at = drive.position.values[np.searchsorted(drive.position.t, errors.start)]
    end = np.searchsorted(drive.position.t, errors.start + 2.0 + 1e-9, side="right") - 1
    assert (np.hypot(*(drive.position.values[end] - at).T) >= 0.1).all()


def test_two_positions_tell_the_way_between_them() -> None:
    drive = positions_of(PERFECT)
    assert drive.position is not None
    few = replace(drive, position=Series(drive.position.t[:200:10], drive.position.values[:200:10], "position"))
    ends = np.stack([few.position.t[:-1:2], few.position.t[1::2]], axis=1)  # type: ignore[union-attr]
    errors = window_errors(TRUTH, replace(few, segments=ends), TIMING)
    assert len(errors)
    assert_allclose(errors.translation, 0.0, atol=1e-3)


# Gyro


def test_a_gyro_judges_no_window_in_which_it_is_silent() -> None:
    drive = with_gyro(PERFECT, 0.0)
    assert drive.gyro is not None
    errors = window_errors(TRUTH, replace(drive, gyro=drive.gyro.between(0.0, 11.0)), TIMING)
    early, late = errors.end < 10.0, errors.start > 11.0
    assert np.isfinite(errors.yaw_gyro[early]).all()
    assert early.any()
    assert np.isnan(errors.yaw_gyro[late]).all()
    assert late.any()


@pytest.mark.parametrize("late", [0.0, 0.137, -0.43])
def test_align_gyro_recovers_offset_bias_and_scale(late: float) -> None:
    drive = with_gyro(PERFECT, late, bias=0.02, scale=0.95, noise=0.005)
    assert drive.gyro is not None
    errors = align_gyro(drive, TRUTH, TIMING)
    assert errors.time_offset == pytest.approx(late, abs=0.005)
    assert errors.bias == pytest.approx(0.02, abs=0.002)
    assert errors.scale == pytest.approx(0.95, abs=0.004)
    start, end = np.array([10.0, 18.0]), np.array([12.0, 21.0])
    windows = Windows(start, end, np.zeros((2, 3)), np.zeros(2, bool))
    turned = predict(TRUTH, drive.wheels, windows, Timing(0.0, 0.08))[:, 2]
    assert_allclose(Turn.of(drive.gyro).between(start, end, errors), turned, atol=0.01)


def test_the_offset_of_the_gyro_does_not_need_the_right_model() -> None:
    """Correlation is blind to scale: a model that turns a third too slowly finds the same offset."""
    drive = with_gyro(PERFECT, 0.137)
    assert align_gyro(drive, Differential(0.8), TIMING).time_offset == pytest.approx(0.137, abs=0.01)


def test_gyro_errors_of_the_truth_are_small() -> None:
    errors = window_errors(TRUTH, with_gyro(PERFECT, 0.1, bias=0.01, scale=1.1), TIMING)
    assert np.isfinite(errors.yaw_gyro).sum() > 15
    assert np.nanmax(np.abs(errors.yaw_gyro)) < 0.01


def test_gyro_errors_are_those_of_the_yaw() -> None:
    """A perfect gyro judges a wrong model as the reference's yaw does."""
    errors = window_errors(WRONG, with_gyro(PERFECT, 0.0), TIMING)
    assert_allclose(errors.yaw_gyro, -errors.yaw, atol=0.01)
    assert np.abs(errors.yaw).max() > 0.1


def test_a_drive_with_a_gyro_only_is_judged_by_it() -> None:
    drive = replace(with_gyro(PERFECT, 0.1, bias=0.01), pose=None)
    errors = window_errors(TRUTH, drive, Timing(0.0, 0.08))
    assert np.isnan(errors.translation).all()
    assert np.isnan(errors.yaw).all()
    assert len(errors) == pytest.approx((drive.span[1] - drive.span[0]) / 2.0, abs=1.5)
    assert np.nanmax(np.abs(errors.yaw_gyro)) < 0.01
    assert np.nanmax(np.abs(window_errors(WRONG, drive, Timing(0.0, 0.08)).yaw_gyro)) > 0.1
    assert align_gyro(drive, TRUTH, Timing(0.0, 0.08)).scale == 1.0


def test_positions_and_a_gyro_are_both_judged() -> None:
    errors = window_errors(TRUTH, positions_of(with_gyro(PERFECT, 0.1)), TIMING)
    assert_allclose(errors.translation, 0.0, atol=1e-6)
    assert np.nanmax(np.abs(errors.yaw_gyro)) < 0.01
    assert np.isnan(errors.yaw).all()


def test_a_drive_that_hardly_turns_tells_no_scale() -> None:
    t = np.arange(0.0, 20.0, 0.02)
    model: Model = Differential(0.4)
    wheels = Series(t, np.c_[0.4 - 0.01 * np.sin(t), 0.4 + 0.01 * np.sin(t)])
    pose = Series(t[::10], np.c_[0.4 * t[::10], 0.0 * t[::10], 0.0 * t[::10]])
    drive = Drive("d", P3AT, wheels, pose=pose, gyro=Series(t, 0.05 * np.sin(t) + 0.3))
    assert align_gyro(drive, model, Timing()).scale == 1.0


def test_a_gyro_of_half_the_drive_makes_no_errors_in_the_other() -> None:
    drive = with_gyro(PERFECT, 0.1)
    assert drive.gyro is not None
    half = replace(drive, gyro=drive.gyro.between(0.0, 20.0))
    assert np.nanmax(np.abs(window_errors(TRUTH, half, TIMING).yaw_gyro)) < 0.01
