import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError
from skidsteer.vehicle import preset

P3AT = preset("pioneer-p3at")


def series(count: int, width: int, name: str = "series", start: float = 0.0) -> Series:
    """Samples at start, start + 1, ... s, each with its own numbers."""
    return Series(start + np.arange(count), np.arange(float(count * width)).reshape(count, width), name)


def full_drive() -> Drive:
    return Drive(
        "full",
        P3AT,
        wheels=series(11, 2, "wheels"),
        pose=series(11, 3, "pose"),
        position=series(11, 2, "position"),
        gyro=series(11, 1, "gyro"),
        command=series(11, 2, "command"),
        wheel_command=series(11, 2, "wheel_command"),
        segments=np.array([[0.0, 2.0], [3.0, 5.0], [5.0, 8.0]]),
        labels={"slope": np.array([0.1, 0.2, 0.3])},
    )


# Series: immutable, independent, refuses what it cannot hold


def test_series_arrays_cannot_be_written() -> None:
    s = series(3, 2)
    for array in (s.t, s.values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(AttributeError):
        s.t = np.zeros(3)  # type: ignore[misc]


def test_series_does_not_share_the_callers_arrays() -> None:
    t, values = np.arange(3.0), np.ones((3, 2))
    s = Series(t, values)
    t[0], values[0, 0] = -1.0, 7.0  # also: the caller's arrays stay writable
    assert s.t[0] == 0.0
    assert s.values[0, 0] == 1.0


def test_held_and_cut_values_are_not_views_of_the_series() -> None:
    s = series(4, 2)
    s.hold(np.array([0.0, 2.5]))[:] = np.nan
    assert np.isfinite(s.values).all()
    part = s.between(1.0, 2.0)
    assert part is not None
    assert not np.shares_memory(part.values, s.values)


def test_series_of_numbers_becomes_one_column() -> None:
    s = Series([0, 1], [2, 3])  # type: ignore[arg-type]
    assert s.values.shape == (2, 1)
    assert s.t.dtype == s.values.dtype == np.float64
    assert len(s) == 2


@pytest.mark.parametrize(
    ("t", "values", "message"),
    [
        ([0, 1], [[1, 2]], "w: times (2,) and values (1, 2) do not belong together"),
        ([[0, 1]], [[1, 2]], "w: times (1, 2) and values (1, 2) do not belong together"),
        ([0], [[[1.0]]], "w: times (1,) and values (1, 1, 1) do not belong together"),
        ([], np.zeros((0, 2)), "w: no samples"),
        (
            [0, 1, 2, 3],
            [1, np.nan, 2, np.inf],
            "w: sample 2 of 4 (t = 1.000 s) is NaN or infinite (2 in all); remove those rows",
        ),
        ([0, np.inf], [1, 2], "w: sample 2 of 2 (t = inf s) is NaN or infinite (1 in all); remove those rows"),
        (
            [0, 1, 2],
            [1, -1e200, 3],
            "w: sample 2 of 3 (t = 1.000 s) holds 1e+200, which no sensor tells (1 in all); remove those rows",
        ),
        (
            [0, 1, 1, 0.5],
            [1, 2, 3, 4],
            "w: sample 3 (t = 1.000 s) repeats the time of the one before; sort by time, keep one each",
        ),
        (
            [0, 1, 0.5, 0.5],
            [1, 2, 3, 4],
            "w: sample 3 (t = 0.500 s) is earlier than the one before; sort by time, keep one each",
        ),
    ],
)
def test_series_refuses(t: object, values: object, message: str) -> None:
    with pytest.raises(DataError, match=f"^{re.escape(message)}$"):
        Series(t, values, "w")  # type: ignore[arg-type]


# between and hold


def test_between_keeps_both_ends() -> None:
    part = series(5, 1).between(1.0, 3.0)
    assert part is not None
    assert_array_equal(part.t, [1.0, 2.0, 3.0])
    assert_array_equal(part.values[:, 0], [1.0, 2.0, 3.0])


@pytest.mark.parametrize(("start", "end"), [(1.1, 1.9), (-2.0, -1.0), (9.0, 10.0), (3.0, 1.0)])
def test_between_is_none_where_there_is_no_sample(start: float, end: float) -> None:
    assert series(5, 1).between(start, end) is None


def test_between_keeps_name_and_a_single_sample() -> None:
    part = series(5, 2, "gyro").between(2.0, 2.0)
    assert part is not None
    assert part.name == "gyro"
    assert_array_equal(part.values, [[4.0, 5.0]])


def test_hold_by_hand() -> None:
    s = Series(np.array([0.0, 1.0, 3.0]), np.array([[1.0], [2.0], [4.0]]))
    asked = [-5.0, 0.0, 0.999, 1.0, 2.9, 3.0, 99.0]
    assert_array_equal(s.hold(asked)[:, 0], [1.0, 1.0, 1.0, 2.0, 2.0, 4.0, 4.0])


@given(st.lists(st.floats(-2.0, 12.0), min_size=1, max_size=8))
def test_hold_of_many_is_hold_of_each(times: list[float]) -> None:
    s = series(10, 2)
    assert_array_equal(s.hold(times), [s.hold(t) for t in times])
    assert_array_equal(s.hold(np.array(times)[:, None])[:, 0], s.hold(times))


# Drive


@pytest.mark.parametrize(
    ("part", "width"),
    [("wheels", 2), ("pose", 3), ("position", 2), ("gyro", 1), ("command", 2), ("wheel_command", 2)],
)
def test_drive_refuses_a_part_of_another_width(part: str, width: int) -> None:
    parts = {"wheels": series(3, 2)} | {part: series(3, width + 1)}
    with pytest.raises(DataError, match=f"^mine: {part} needs {width} columns, got {width + 1}$"):
        Drive("mine", P3AT, **parts)


def test_reference_is_the_poses_before_the_positions() -> None:
    drive = full_drive()
    assert drive.reference is drive.pose
    assert Drive("d", P3AT, series(3, 2), position=drive.position).reference is drive.position
    assert Drive("d", P3AT, series(3, 2)).reference is None


def test_span_is_that_of_the_wheels() -> None:
    assert Drive("d", P3AT, series(3, 2, start=4.0), pose=series(20, 3)).span == (4.0, 6.0)


def test_between_cuts_every_part_and_keeps_only_whole_segments() -> None:
    drive = full_drive().between(3.0, 7.5)
    for part in ("wheels", "pose", "position", "gyro", "command", "wheel_command"):
        assert_array_equal(getattr(drive, part).t, [3.0, 4.0, 5.0, 6.0, 7.0])
    assert_array_equal(drive.segments, [[3.0, 5.0]])
    assert_array_equal(drive.labels["slope"], [0.2])


def test_between_keeps_a_segment_that_fills_it_exactly() -> None:
    assert_array_equal(full_drive().between(3.0, 8.0).segments, [[3.0, 5.0], [5.0, 8.0]])


def test_between_drops_a_part_that_has_no_sample_there() -> None:
    drive = Drive("d", P3AT, series(10, 2), pose=series(2, 3)).between(4.0, 6.0)
    assert drive.pose is None
    assert drive.segments is None


def test_between_without_wheels_is_refused() -> None:
    with pytest.raises(DataError, match=r"^full: no wheel sample between 20\.000 and 30\.000 s$"):
        full_drive().between(20.0, 30.0)


@pytest.mark.parametrize("keep", [[True, False, True], [0, 2]])
def test_with_segments_chooses_by_mask_and_by_index(keep: list[int]) -> None:
    drive = full_drive().with_segments(keep)
    assert_array_equal(drive.segments, [[0.0, 2.0], [5.0, 8.0]])
    assert_array_equal(drive.labels["slope"], [0.1, 0.3])


def test_with_segments_refuses_a_drive_without() -> None:
    with pytest.raises(DataError, match=r"^d: has no segments$"):
        Drive("d", P3AT, series(3, 2)).with_segments([0])


def test_with_segments_refuses_to_leave_none() -> None:
    with pytest.raises(DataError, match=r"full: .*segments"):
        full_drive().with_segments([False, False, False])


ORDER = "d: segments must be finite, end after they start, and follow each other without overlap"


@pytest.mark.parametrize(
    ("segments", "message"),
    [
        ([0.0, 1.0], "d: segments need rows of t_start, t_end, got shape (2,)"),
        ([[0.0, 1.0, 2.0]], "d: segments need rows of t_start, t_end, got shape (1, 3)"),
        (np.zeros((0, 2)), "d: segments need rows of t_start, t_end, got shape (0, 2)"),
        ([[0.0, np.nan]], ORDER),
        ([[0.0, np.inf]], ORDER),
        ([[1.0, 1.0]], ORDER),
        ([[2.0, 1.0]], ORDER),
        ([[0.0, 2.0], [1.0, 3.0]], ORDER),
        ([[4.0, 5.0], [0.0, 1.0]], ORDER),
    ],
)
def test_segments_are_checked(segments: object, message: str) -> None:
    with pytest.raises(DataError, match=f"^{re.escape(message)}$"):
        Drive("d", P3AT, series(3, 2), segments=segments)  # type: ignore[arg-type]


def test_segments_and_labels_are_independent_and_cannot_be_written() -> None:
    segments = np.array([[0.0, 2.0]])
    drive = Drive("d", P3AT, series(3, 2), segments=segments, labels={"slope": np.array([1.0])})
    segments[0, 0] = -9.0
    assert drive.segments is not None
    assert drive.segments[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        drive.segments[0, 0] = 1.0
    with pytest.raises(TypeError):
        drive.labels["slope"] = np.array([2.0])  # type: ignore[index]
    with pytest.raises(AttributeError):
        drive.name = "other"  # type: ignore[misc]
