"""Scans of a plate as the reference of a drive: CSV files, folders, bags, and a calibration from them."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bag_files import START, VEHICLE, Message, wheel_messages, write_messages
from conftest import Run
from skidsteer import se2
from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError, RequestError
from skidsteer.identify.calibrate import calibrate
from skidsteer.io.bag import BagOptions, list_bag, read_bag, read_bag_noted
from skidsteer.io.csv_table import read_table
from skidsteer.io.drives import load_drive
from skidsteer.io.folder import read_csv_files, read_folder, write_folder
from skidsteer.io.options import parse_options, parse_plate
from skidsteer.io.scans import scans_of
from skidsteer.laser.plate import Plate
from skidsteer.laser.scans import Scanner, Scans
from skidsteer.laser.scene import simulate_scans
from skidsteer.models import Differential, Icr
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres

SCANNER = Scanner(np.radians(120.0), np.radians(0.25), 0.1, 8.0, 0.008, 25.0)
PLATE = Plate(0.5, 0.1, 0.05, 0.2)
TRUTH = Icr(0.40, -0.46, 0.03, 0.95, 0.97)
WHERE = (3.0, -0.5, 1.0)  # the robot at first, in the scanner's frame
MANOEUVRES = [
    [1.0, 0.0, 0.0],
    [4.0, 0.3, 0.0],
    [6.0, 0.0, 0.9],
    [6.0, 0.3, -0.6],
    [5.0, -0.2, 0.0],
    [7.0, 0.0, -0.7],
    [6.0, 0.4, 0.8],
    [4.0, 0.3, 0.0],
    [6.0, -0.3, 0.6],
]


def write_scans(scans: Scans, path: Path) -> None:
    """Ranges to a tenth of a millimetre."""
    header = ",".join(["t", *(f"{bearing:.7f}" for bearing in scans.bearings.tolist())])
    cells = np.where(scans.ranges > 0.0, np.char.mod("%.4f", scans.ranges), "")
    lines = [",".join([repr(t), *row]) for t, row in zip(scans.t.tolist(), cells.tolist(), strict=True)]
    path.write_text("\n".join([header, *lines, ""]))


@pytest.fixture(scope="module")
def experiment() -> tuple[Drive, Scans]:
    """A drive with its exact poses in the scanner's frame, and what a scanner saw of it before a wall."""
    rims = rims_from_manoeuvres(np.array(MANOEUVRES), Differential(VEHICLE.track_width))
    plain = Sensors(reference_rate=SCANNER.rate, position_sigma=0.0, yaw_sigma=0.0)
    drive = kinematic_drive("lab", VEHICLE, TRUTH, rims, plain, 0.05, (0.002, 0.004), 1)
    assert drive.pose is not None
    truth = Series(drive.pose.t, se2.compose(WHERE, drive.pose.values), "pose")
    plate = se2.compose(truth.values, (PLATE.x, PLATE.y, PLATE.yaw))
    scans = simulate_scans(SCANNER, [(plate, PLATE.width)], [((6.0, -9.0), (6.0, 9.0))], 0.01, 0.001, 2)
    return replace(drive, pose=truth), replace(scans, t=truth.t)


@pytest.fixture(scope="module")
def folder(experiment: tuple[Drive, Scans], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lab") / "run"
    drive, scans = experiment
    write_folder(replace(drive, pose=None), path)
    write_scans(scans, path / "scans.csv")
    return path


def errors(drive: Drive, truth: Series) -> np.ndarray:
    assert drive.pose is not None
    there = np.column_stack([np.interp(drive.pose.t, truth.t, column) for column in truth.values.T])
    error = drive.pose.values - there
    error[:, 2] = se2.wrap(error[:, 2])
    return error


def close_to_the_truth(drive: Drive, truth: Series | None) -> None:
    assert truth is not None
    error = errors(drive, truth)
    assert len(error) > 0.85 * len(truth)
    assert np.abs(error[:, 2]).max() < 0.1
    assert_allclose(np.sqrt(np.median(error**2, axis=0)), 0.0, atol=0.015)
    assert (np.abs(error.mean(axis=0)) < 0.003).all()


# CSV


def test_scans_round_trip(experiment: tuple[Drive, Scans], tmp_path: Path) -> None:
    scans = experiment[1].rows(slice(0, 40))
    write_scans(scans, tmp_path / "scans.csv")
    again = scans_of(read_table(tmp_path / "scans.csv"))
    assert_array_equal(again.t, scans.t)
    assert_allclose(again.bearings, scans.bearings, atol=1e-7)
    assert_allclose(again.ranges, scans.ranges, atol=5.1e-5)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_what_stands_for_no_range(tmp_path: Path, separator: str) -> None:
    text = "t,-0.1,0,0.1\n0,1,,nan\n1,,,\n2,inf,0,2.5\n\n".replace(",", separator)
    (tmp_path / "scans.csv").write_text(text)
    scans = scans_of(read_table(tmp_path / "scans.csv"))
    assert_array_equal(scans.ranges, [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 2.5]])
    assert_array_equal(scans.t, [0.0, 1.0, 2.0])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,left,right,middle\n0,1,2,3\n", "the columns of scans are t and"),
        ("x,-0.1,0,0.1\n0,1,2,3\n", "the columns of scans are t and"),
        ("t,-0.1,0,0.1\n", "has a header and no rows"),
        ("t,-0.1,0,0.1\n0,1,2,3\n\n1,1,2\n", "line 4 has 3 cells, the header 4"),
        ("t,-0.1,0,0.1\n0,1,2,3\n1,1,wide,3\n", "line 3, column '0': 'wide' is not a number"),
        ("t,-0.1,0,0.1\n0,1,2,3\n0,1,2,3\n", "line 3: t is no number or not later"),
        ("t,-0.1,0,0.1\nnan,1,2,3\n", "line 2: t is no number"),
        ("t,-0.1,0,0.3\n0,1,2,3\n", "evenly spaced"),
        ("t,-35,0,35\n0,1,2,3\n", "are they in degrees"),
    ],
)
def test_scan_files_with_faults(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "scans.csv").write_text(text)
    with pytest.raises(DataError, match=words) as caught:
        scans_of(read_table(tmp_path / "scans.csv"))
    assert str(caught.value).startswith(str(tmp_path / "scans.csv"))


# Folders


def test_a_folder_with_scans_has_poses(experiment: tuple[Drive, Scans], folder: Path) -> None:
    drive = read_folder(folder, plate=PLATE)
    close_to_the_truth(drive, experiment[0].pose)
    assert drive.sha256 != read_folder(folder_without_scans(folder)).sha256


def folder_without_scans(folder: Path) -> Path:
    other = folder.parent / "without"
    if not other.exists():
        write_folder(replace(read_folder(folder, plate=PLATE), pose=None), other)
    return other


def test_calibration_from_scans_finds_the_model(folder: Path) -> None:
    found = calibrate(read_folder(folder, plate=PLATE), model="icr").parameters
    for name in ("icr_y_left", "icr_y_right", "icr_x", "alpha_left", "alpha_right"):
        assert abs(found[name].value - getattr(TRUTH, name)) < 4.0 * found[name].sigma, name
        assert found[name].sigma < 0.03, name


def test_the_plate_decides_which_reference_is_used(
    experiment: tuple[Drive, Scans], folder: Path, tmp_path: Path
) -> None:
    drive = experiment[0]
    assert drive.pose is not None
    wrong = Series(drive.pose.t, drive.pose.values + [9.0, 9.0, 0.0], "pose")
    write_folder(replace(drive, pose=wrong), tmp_path / "both")
    (tmp_path / "both" / "scans.csv").write_bytes((folder / "scans.csv").read_bytes())
    by_pose, by_scans = read_folder(tmp_path / "both"), read_folder(tmp_path / "both", plate=PLATE)
    assert by_pose.pose is not None
    assert_array_equal(by_pose.pose.values, wrong.values)
    close_to_the_truth(by_scans, drive.pose)


def test_folders_and_plates_that_do_not_fit(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="need its measures: --plate WIDTH"):
        read_folder(folder)
    with pytest.raises(DataError, match=r"no scans\.csv to see a plate in"):
        read_folder(folder_without_scans(folder), plate=PLATE)
    with pytest.raises(DataError, match=r"scans\.csv: scans: the plate is seen in 0 of \d+ scans.*0\.9 m wide"):
        read_folder(folder, plate=replace(PLATE, width=0.9))
    (tmp_path / "still").mkdir()
    for name in ("scans.csv", "vehicle.yaml"):
        (tmp_path / "still" / name).write_bytes((folder / name).read_bytes())
    (tmp_path / "still" / "wheels.csv").write_text("t,v_left,v_right\n0,0,0\n60,0,0\n")
    with pytest.raises(RequestError, match=r"scans\.csv: .*looks the same both ways"):
        read_folder(tmp_path / "still", plate=PLATE)


def test_a_folder_with_scans_is_not_replaced(experiment: tuple[Drive, Scans], folder: Path) -> None:
    with pytest.raises(DataError, match=r"is not just a drive, it holds scans\.csv"):
        write_folder(experiment[0], folder)


def test_csv_files_are_recognised_by_their_columns(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "lidar.csv").write_bytes((folder / "scans.csv").read_bytes())
    drive = read_csv_files([folder / "wheels.csv", tmp_path / "lidar.csv"], plate=PLATE)
    assert drive.pose is not None
    same = read_folder(folder, plate=PLATE).pose
    assert same is not None
    assert_array_equal(drive.pose.values, same.values)


# Bags


def scan_messages(scans: Scans, frame: str = "laser", topic: str = "/scan") -> list[Message]:
    messages = []
    for t, ranges in zip(scans.t, scans.ranges, strict=True):
        ns = START * 10**9 + round(t * 1e9)
        value = {
            "header": (ns, frame),
            "angle_min": scans.bearings[0],
            "angle_increment": scans.step,
            "range_min": 0.1,
            "range_max": 30.0,
            "ranges": np.where(ranges > 0.0, ranges, np.inf),
        }
        messages.append(Message(topic, "sensor_msgs/msg/LaserScan", ns, value))
    return messages


@pytest.mark.parametrize("kind", ["rosbag1", "mcap"])
def test_a_bag_with_scans_has_poses(experiment: tuple[Drive, Scans], tmp_path: Path, kind: str) -> None:
    drive, scans = experiment
    path = write_messages(tmp_path / "bag", kind, wheel_messages(drive, "velocity") + scan_messages(scans))
    read, contents = read_bag_noted(path, VEHICLE, BagOptions(plate=PLATE))
    close_to_the_truth(read, drive.pose)
    assert contents.chosen["reference"] == "/scan"
    assert any(note.startswith("/scan: the plate is seen in") for note in contents.notes)
    assert "reference" not in list_bag(path).chosen
    with pytest.raises(RequestError, match="/scan: scans of a plate on the robot need its measures: --plate WIDTH"):
        read_bag(path, VEHICLE, BagOptions(reference_topic="/scan"))
    with pytest.raises(DataError, match=r"/scan: scans: the plate is seen in 0 of"):
        read_bag(path, VEHICLE, BagOptions(plate=Plate(1.7)))


def test_scans_of_changing_bearings_and_late_rays(experiment: tuple[Drive, Scans], tmp_path: Path) -> None:
    """Every third scan lacks its last rays, rays come one after the other in 20 ms, and there is another scanner."""
    drive, scans = experiment
    messages = scan_messages(scans)
    for message in messages:
        message.value["time_increment"] = 0.02 / len(scans.bearings)
        stamp = message.value["header"][0] - 10_000_000  # the middle of the field is seen at the stamp it had
        message.value["header"] = (stamp, "laser")
    for message in messages[::3]:
        message.value["ranges"] = message.value["ranges"][:-7]
    other = scan_messages(scans.rows(slice(0, 9)), "base_laser")
    path = write_messages(tmp_path / "bag", "mcap", wheel_messages(drive, "velocity") + messages + other)
    read, contents = read_bag_noted(path, VEHICLE, BagOptions(plate=PLATE))
    close_to_the_truth(read, drive.pose)
    assert any(f"of {len(scans)} scans" in note for note in contents.notes)
    assert read.pose is not None
    bearing = np.arctan2(read.pose.values[:, 1], read.pose.values[:, 0])
    expected = 0.02 * (bearing / np.ptp(scans.bearings))  # after the middle of the scan
    late = read.pose.t - scans.t[np.abs(scans.t[:, None] - (read.pose.t - expected)).argmin(axis=0)]
    assert np.abs(late - expected).max() < 0.001


def test_ranges_out_of_the_scanners_reach_are_none(experiment: tuple[Drive, Scans], tmp_path: Path) -> None:
    drive, scans = experiment
    messages = scan_messages(scans.rows(slice(0, 60)))
    for message, name, limit in zip(messages, ["range_min", "range_max"] * 30, [9.5, 1.5] * 30, strict=True):
        message.value[name] = limit
    path = write_messages(tmp_path / "bag", "mcap", wheel_messages(drive, "velocity") + messages)
    with pytest.raises(DataError, match=r"in 0 of 60 scans"):
        read_bag(path, VEHICLE, BagOptions(plate=PLATE))


def test_bags_and_plates_that_do_not_fit(experiment: tuple[Drive, Scans], tmp_path: Path) -> None:
    drive, scans = experiment
    wheels = wheel_messages(drive, "velocity")
    path = write_messages(tmp_path / "none", "mcap", wheels)
    with pytest.raises(RequestError, match="no laser scans to see a plate in"):
        read_bag(path, VEHICLE, BagOptions(plate=PLATE))
    messages = scan_messages(scans.rows(slice(0, 100)))
    for number, message in enumerate(messages):
        message.value["angle_min"] += 1e-3 * number
    path = write_messages(tmp_path / "jitter", "mcap", wheels + messages)
    with pytest.raises(DataError, match="100 sets of bearings"):
        read_bag(path, VEHICLE, BagOptions(plate=PLATE))
    for message in messages:
        message.value["ranges"] = np.full(len(scans.bearings), np.nan)
        message.value["angle_min"] = scans.bearings[0]
    path = write_messages(tmp_path / "nan", "mcap", wheels + messages)
    with pytest.raises(DataError, match="100 show nothing"):
        read_bag(path, VEHICLE, BagOptions(plate=PLATE))


# The command line


@pytest.mark.parametrize(
    ("text", "plate"),
    [
        ("0.29", Plate(0.29)),
        ("0.29,left", Plate(0.29, side="left")),
        ("0.5, 0.1, 0.05, 0.2", Plate(0.5, 0.1, 0.05, 0.2)),
        ("0.5,0,0,1.5708,back", Plate(0.5, 0.0, 0.0, 1.5708, "back")),
    ],
)
def test_plates_on_the_command_line(text: str, plate: Plate) -> None:
    assert parse_plate(text) == plate
    assert parse_options({"plate": text, "imu_topic": None}) == BagOptions(plate=plate)


@pytest.mark.parametrize(
    "text", ["", "left", "wide", "0.3,1", "0.3,1,2,3,4", "0.3,up", "0.3,left,right", "-0.3", "nan"]
)
def test_plates_that_cannot_be(text: str) -> None:
    with pytest.raises(RequestError, match="plate"):
        parse_plate(text)


def test_calibrate_takes_scans(folder: Path, run: Run) -> None:
    plate = f"{PLATE.width},{PLATE.x},{PLATE.y},{PLATE.yaw}"
    args = ("calibrate", folder / "wheels.csv", folder / "scans.csv", "--model", "icr_symmetric", "--json")
    document = json.loads(run(*args, "--plate", plate).stdout)
    assert document["model"] == "icr_symmetric"
    refusal: subprocess.CompletedProcess[str] = run("calibrate", folder)
    assert refusal.returncode == 1
    assert "--plate WIDTH" in refusal.stderr
    assert load_drive(folder, bag=BagOptions(plate=PLATE)).pose is not None
