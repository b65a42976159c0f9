from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.errors import DataError
from skidsteer.io.drives import load_drive, load_drives
from skidsteer.io.folder import write_folder
from skidsteer.io.tum import read_tum, write_tum
from skidsteer.samples import sample

poses = st.lists(st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-3.0, 3.0)), min_size=1, max_size=9)


@given(rows=poses)
def test_trajectory_round_trips(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[float, float, float]]
) -> None:
    path = tmp_path_factory.mktemp("tum") / "trajectory.tum"
    t = 1_700_000_000.0 + 0.25 * np.arange(len(rows))
    write_tum(path, t, rows)
    back = read_tum(path)
    assert_allclose(back.t, t, rtol=0)
    assert_allclose(back.values[:, :2], np.array(rows)[:, :2], rtol=0)
    difference = back.values[:, 2] - np.array(rows)[:, 2]
    assert_allclose(np.angle(np.exp(1j * difference)), 0.0, atol=1e-12)


def test_one_line_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    write_tum(path, [12.5], [[1.0, -2.0, np.pi / 2]])
    cells = path.read_text().split()
    assert cells[:4] == ["12.500000000", "1.0", "-2.0", "0.0"]
    assert_allclose([float(cell) for cell in cells[4:]], [0, 0, np.sqrt(0.5), np.sqrt(0.5)])


def test_yaw_goes_on_beyond_half_a_turn(tmp_path: Path) -> None:
    yaw = np.linspace(0.0, 9.0, 30)
    write_tum(tmp_path / "a.tum", np.arange(30.0), np.stack([0 * yaw, 0 * yaw, yaw], axis=1))
    assert_allclose(read_tum(tmp_path / "a.tum").values[:, 2], yaw, atol=1e-12)


def test_comments_blank_lines_and_commas_are_accepted(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text("# t x y z qx qy qz qw\n\n1 2 3 0 0 0 0 1\n2, 3, 4, 0, 0, 0, 0, 2  # twice as long\n")
    assert_allclose(read_tum(path).values, [[2, 3, 0], [3, 4, 0]])


def test_empty_trajectory_is_an_empty_file(tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", [], [])
    assert (tmp_path / "a.tum").read_bytes() == b""


def test_times_must_fit_poses(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="one time for each pose"):
        write_tum(tmp_path / "a.tum", [1.0, 2.0], [[0.0, 0.0, 0.0]])


def test_folder_must_exist(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="there is no folder"):
        write_tum(tmp_path / "no" / "a.tum", [1.0], [[0.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "has no line"),
        ("# only a comment\n", "has no line"),
        ("1 2 3\n", "line 1 has 3 columns; need 8"),
        ("1 2 3 0 0 0 0 1\n2 2 3 0 0 0 0 x\n", "line 2 is not eight numbers"),
        ("1 2 3 0 0 0 0 nan\n", "line 1 holds NaN or infinity"),
        ("1 2 3 0 0 0 0 0\n", "line 1 has a quaternion of length 0"),
        ("2 2 3 0 0 0 0 1\n1 2 3 0 0 0 0 1\n", "is earlier than the one before"),
        ("\0\0", "is binary"),
    ],
)
def test_what_is_no_trajectory_says_why(tmp_path: Path, text: str, what: str) -> None:
    (tmp_path / "a.tum").write_text(text)
    with pytest.raises(DataError, match=what):
        read_tum(tmp_path / "a.tum")


def test_no_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        read_tum(tmp_path / "a.tum")


# As the reference of a drive


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample as a folder, and its poses as a trajectory with a comment above."""
    path = tmp_path_factory.mktemp("files") / "run"
    drive = sample("p3at-mandow").between(0.0, 30.0)
    assert drive.pose is not None
    write_folder(drive, path)
    write_tum(path / "pose.tum", drive.pose.t, drive.pose.values)
    (path / "pose.tum").write_text("# t x y z qx qy qz qw\n" + (path / "pose.tum").read_text())
    return path


def test_a_trajectory_is_the_reference_that_its_poses_are_in_a_table(files: Path) -> None:
    (drive,) = load_drives([str(files / "wheels.csv"), str(files / "pose.tum")])
    table = load_drive(f"{files / 'wheels.csv'},{files / 'pose.csv'}")
    assert drive.pose is not None
    assert table.pose is not None
    assert_allclose(drive.pose.t, table.pose.t, rtol=0, atol=1e-9)
    turns = np.round((table.pose.values[0, 2] - drive.pose.values[0, 2]) / (2.0 * np.pi))
    assert_allclose(drive.pose.values + [0.0, 0.0, 2.0 * np.pi * turns], table.pose.values, atol=1e-12)
    assert drive.name == table.name
    assert drive.sha256 != table.sha256


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda lines: [*lines[:4], "", lines[3]], "line 6 .* repeats the time of the one before"),
        (lambda lines: [lines[0], "", "1e18 0 0 0 0 0 0 1"], r"line 3: 1e\+18 is no time in seconds"),
        (lambda lines: [*lines, "1 2 3"], "has 3 columns; need 8"),
    ],
)
def test_faults_of_a_trajectory_are_named_with_its_own_lines(
    files: Path, tmp_path: Path, change: Callable[[list[str]], list[str]], what: str
) -> None:
    (tmp_path / "pose.tum").write_text("\n".join(change((files / "pose.tum").read_text().splitlines())) + "\n")
    with pytest.raises(DataError, match=what) as caught:
        load_drive(f"{files / 'wheels.csv'},{tmp_path / 'pose.tum'}")
    assert str(caught.value).startswith(str(tmp_path / "pose.tum"))


def test_a_trajectory_alone_is_no_drive(files: Path) -> None:
    with pytest.raises(DataError, match=r"no columns t, v_left, v_right in: pose\.tum"):
        load_drive(str(files / "pose.tum"))


def test_two_references_are_one_too_many(files: Path) -> None:
    with pytest.raises(DataError, match=r"pose\.csv and .*pose\.tum both have pose columns"):
        load_drive(",".join(str(files / name) for name in ("wheels.csv", "pose.csv", "pose.tum")))
