import builtins
import hashlib
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_array_equal

from skidsteer.drive import LARGEST, Drive, Series
from skidsteer.errors import DataError, SkidSteerError
from skidsteer.io.drives import load_drive, load_drives
from skidsteer.io.folder import read_csv_files, read_folder, vehicle, write_folder
from skidsteer.vehicle import Vehicle

REAL_DRIVES = Path(__file__).parents[2] / "shared" / "data"
PARTS = {"wheels": 2, "pose": 3, "position": 2, "gyro": 1, "command": 2, "wheel_command": 2}
ROBOT = Vehicle("mine", 0.55, 0.165, mass=50.0)

FILES = {
    "wheels.csv": "t,v_left,v_right\n0.0,0.1,0.2\n0.5,0.3,0.4\n1.0,0.5,0.6\n",
    "pose.csv": "t,x,y,yaw\n0.1,1,2,3\n0.2,4,5,6\n",
    "imu.csv": "t,gyro_z\n0.1,0.7\n",
    "cmd.csv": "t,v,omega\n0.1,0.8,0.9\n",
    "cmdwheels.csv": "t,v_left_cmd,v_right_cmd\n0.1,1.1,1.2\n",
    "segments.csv": "seg,t_start,t_end,step,ground\n0,0,0.5,7,grass\n1,0.5,1,8,gravel\n",
    "vehicle.yaml": "name: mine\ntrack_width: 0.55\nwheel_radius: 0.165\nmass: 50\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "run-1"
    path.mkdir()
    for name, text in FILES.items():
        (path / name).write_text(text)
    return path


def assert_same(a: Drive, b: Drive) -> None:
    assert a.vehicle == b.vehicle
    assert a.antenna == b.antenna
    for part in PARTS:
        one, other = getattr(a, part), getattr(b, part)
        assert (one is None) == (other is None), part
        if one is not None:
            assert one.t.tobytes() == other.t.tobytes(), part
            assert one.values.tobytes() == other.values.tobytes(), part
    assert (a.segments is None) == (b.segments is None)
    if a.segments is not None and b.segments is not None:
        assert a.segments.tobytes() == b.segments.tobytes()
    assert list(a.labels) == list(b.labels)
    for name, column in a.labels.items():
        assert_array_equal(b.labels[name], column)


# --- reading ---


def test_reads_every_part(folder: Path) -> None:
    drive = read_folder(folder)
    assert (drive.name, drive.source, drive.vehicle) == ("run-1", str(folder), ROBOT)
    assert_array_equal(drive.wheels.t, [0, 0.5, 1])
    assert_array_equal(drive.wheels.values, [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    for part, values in {
        "pose": [[1, 2, 3], [4, 5, 6]],
        "gyro": [[0.7]],
        "command": [[0.8, 0.9]],
        "wheel_command": [[1.1, 1.2]],
    }.items():
        assert_array_equal(getattr(drive, part).values, values)
    assert drive.position is None
    assert_array_equal(drive.segments, [[0, 0.5], [0.5, 1]])
    assert list(drive.labels) == ["step"]  # the names of the grounds are no numbers
    assert_array_equal(drive.labels["step"], [7, 8])


def test_wheels_alone_are_a_drive(folder: Path) -> None:
    for name in set(FILES) - {"wheels.csv", "vehicle.yaml"}:
        (folder / name).unlink()
    drive = read_folder(folder)
    assert drive.reference is None
    assert drive.segments is None
    assert drive.labels == {}


def test_sha256_is_that_of_the_files_used(folder: Path) -> None:
    (folder / "position.csv").write_text("not used\n")
    (folder / "notes.txt").write_text("not used\n")
    used = ["wheels.csv", "pose.csv", "imu.csv", "cmd.csv", "cmdwheels.csv", "segments.csv"]
    content = "".join(FILES[name] for name in used)
    recorded = hashlib.sha256(content.encode()).hexdigest()
    assert read_folder(folder).sha256 == read_folder(folder, vehicle("jackal")).sha256 == recorded


def test_given_vehicle_replaces_the_file(folder: Path) -> None:
    (folder / "vehicle.yaml").write_text("damaged: [\n")
    assert read_folder(folder, vehicle("jackal")).vehicle.name == "jackal"
    (folder / "vehicle.yaml").unlink()
    assert read_folder(folder, vehicle("jackal")).vehicle.name == "jackal"
    with pytest.raises(DataError, match=r"no vehicle.yaml; name the robot with --vehicle NAME\|FILE \(presets: husky"):
        read_folder(folder)


def test_a_vehicle_to_fall_back_on_leaves_the_file_alone(folder: Path) -> None:
    other = vehicle("jackal")
    assert read_folder(folder, otherwise=other).vehicle == ROBOT
    assert read_folder(folder, vehicle("warthog"), otherwise=other).vehicle.name == "warthog"
    assert load_drives([str(folder)], otherwise=other)[0].vehicle == ROBOT
    (folder / "vehicle.yaml").unlink()
    assert read_folder(folder, otherwise=other).vehicle == other
    assert read_csv_files([folder / "wheels.csv", folder / "pose.csv"], otherwise=other).vehicle == other


def test_pose_is_preferred_to_position(folder: Path) -> None:
    (folder / "position.csv").write_text("t,x,y\n0.1,8,9\n")
    assert read_folder(folder).position is None
    (folder / "pose.csv").unlink()
    drive = read_folder(folder)
    assert drive.pose is None
    assert drive.position is not None
    assert_array_equal(drive.position.values, [[8, 9]])


@pytest.mark.parametrize(
    "text",
    [
        "v_right,t,v_left\n0.2,0,0.1\n0.4,0.5,0.3\n",
        "t,frame,v_left,v_right\n0,base,0.1,0.2\n0.5,base,0.3,0.4\n",
        "t,v_left,v_right,slip\n0,0.1,0.2,nan\n0.5,0.3,0.4,\n",
        "t;v_left;v_right\n0;0.1;0.2\n0.5;0.3;0.4\n",
        "t\tv_left\tv_right\n0\t0.1\t0.2\n0.5\t0.3\t0.4\n",
        "t,v_left,v_right\r\n0,0.1,0.2\r\n0.5,0.3,0.4\r\n",
        "t,v_left,v_right\r0,0.1,0.2\r0.5,0.3,0.4",
        "\ufefft,v_left,v_right\n0,0.1,0.2\n0.5,0.3,0.4\n",
        "\n# t, v_left, v_right\n\n0, 0.1, 0.2\n \n0.5, 0.3, 0.4\n\n,,\n",
        '"t","v_left","v_right"\n"0","0.1","0.2"\n"0.5","0.3","0.4"\n',
        't,"note, long",v_left,v_right\n0,"a, b",0.1,0.2\n0.5,"c\nd",0.3,0.4\n',
        "t,v_left,v_right,\n0,0.1,0.2,\n0.5,0.3,0.4,\n",
        "t,v_left,v_right\n0,1e-1,+.2\n5E-1,0.3,0.4\n",
    ],
)
def test_reads_what_programs_write(folder: Path, text: str) -> None:
    (folder / "wheels.csv").write_bytes(text.encode())
    wheels = read_folder(folder).wheels
    assert_array_equal(wheels.t, [0, 0.5])
    assert_array_equal(wheels.values, [[0.1, 0.2], [0.3, 0.4]])


WHEELS = "t,v_left,v_right\n"


@pytest.mark.parametrize(
    ("file", "text", "fault"),
    [
        ("wheels.csv", "", "is empty; the first line must name the columns"),
        ("wheels.csv", " \n\n", "is empty; the first line must name the columns"),
        ("wheels.csv", ",,\n,,\n", "is empty; the first line must name the columns"),
        ("wheels.csv", WHEELS, "has a header and no rows"),
        ("wheels.csv", WHEELS + "\n,,\n", "has a header and no rows"),
        ("wheels.csv", WHEELS + "0,1,1\n", "has a single row; a drive needs at least two wheel samples"),
        ("wheels.csv", "0.0,1,1\n0.1,1,1\n", "no column 't'; the first line names: 0.0, 1, 1"),
        ("wheels.csv", "t,left,right\n0,1,1\n", "no column 'v_left'; the first line names: t, left, right"),
        ("wheels.csv", "t v_left v_right\n0 1 1\n", "no column 't'; the first line names: t v_left v_right"),
        ("wheels.csv", "t,v_left,v_left,v_right\n0,1,1,1\n", "2 columns are named 'v_left'; rename or delete"),
        ("wheels.csv", WHEELS + "0,1,1\n\n1,a,1\n", "line 4, column 'v_left': 'a' is not a number; correct or delete"),
        ("wheels.csv", WHEELS + "0,1,1\n1,,1\n", "line 3, column 'v_left' is empty; fill it in or delete that line"),
        ("wheels.csv", WHEELS + "0,1,1\n1,1_0,1\n", "line 3, column 'v_left': '1_0' is not a number"),
        ("wheels.csv", WHEELS + "0,1,1\n1,\u0661,1\n", "line 3, column 'v_left': '\u0661' is not a number"),
        (
            "wheels.csv",
            "t;v_left;v_right\n0;0,5;1\n",
            "line 2, column 'v_left': '0,5' is not a number; write a decimal",
        ),
        ("wheels.csv", WHEELS + "0,1,1\n1,1\n", "line 3 has 2 cells, the header 3; complete or delete that line"),
        ("wheels.csv", WHEELS + "0,1,1\n1,1,1,1\n", "line 3 has 4 cells, the header 3"),
        ("wheels.csv", WHEELS + "0,1,1,1\n1,1,1,1\n", "line 2 has 4 cells, the header 3"),
        ("wheels.csv", WHEELS + '0,1,1\n1,"1,1\n2,1,1\n', "line 3 has 2 cells, the header 3"),
        ("wheels.csv", WHEELS + '0,1,"' + "x" * 200_000, "line 2: field larger than field limit"),
        ("wheels.csv", WHEELS + "0,1,1\n\n1,nan,1\n2,1,-inf\n", "line 4, column 'v_left' is nan; delete .*2 in all"),
        ("wheels.csv", WHEELS + "0,1,1\n1,1,1e999\n", r"line 3, column 'v_right' is inf; delete .*1 in all"),
        ("wheels.csv", WHEELS + "0,1,1\n\n0,1,1\n", r"line 4 \(t = 0.000 s\) repeats the time of the one before; sort"),
        ("wheels.csv", WHEELS + "0,1,1\n2,1,1\n1,1,1\n", r"line 4 \(t = 1.000 s\) is earlier than the one before"),
        ("wheels.csv", WHEELS + "0,1,1\n1.7e18,1,1\n", r"line 3: 1.7e\+18 is no time in seconds; is it in milli- or"),
        ("wheels.csv", WHEELS + "-1e308,1,1\n1e308,1,1\n", r"line 2: -1e\+308 is no time in seconds"),
        ("pose.csv", 't,note,x,y,yaw\n0,"a\nb",1,1,1\n1,c,?,1,1\n', "line 4, column 'x': '\\?' is not a number"),
        ("pose.csv", "t,x,y\n0,1,1\n", "no column 'yaw'; the first line names: t, x, y"),
        ("imu.csv", "t,gyro_z\n0,x\n", "line 2, column 'gyro_z': 'x' is not a number"),
        (
            "segments.csv",
            "seg,t_start,t_end\n0,0,1\n1,0.5,2\n",
            "line 3: a segment must end after it starts and follow",
        ),
        ("segments.csv", "seg,t_start,t_end\n0,1,1\n", "line 2: a segment must end after it starts"),
        ("segments.csv", "seg,t_start,t_end\n0,-1e308,1e308\n", "line 2: .*is no time in seconds"),
        ("segments.csv", "seg,start\n0,1\n", "no column 't_start'; the first line names: seg, start"),
        ("vehicle.yaml", "name: mine\n", "the key 'track_width' is missing"),
    ],
)
def test_names_file_line_and_cure(folder: Path, file: str, text: str, fault: str) -> None:
    (folder / file).write_text(text)
    with pytest.raises(DataError, match=rf"run-1/{file}: {fault}") as caught:
        read_folder(folder)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"PK\x03\x04\0\0binary", r"is binary \(or UTF-16\), not text in UTF-8; export it as such"),
        ("t,v_left,v_right\n0,1,1\n".encode("utf-16"), "is binary"),
        (b"t,v_left,v_right\n0,1,1\n1,\xe9,1\n", "line 3 is not UTF-8 text; save the file as UTF-8"),
    ],
)
def test_names_what_is_no_text(folder: Path, data: bytes, fault: str) -> None:
    (folder / "wheels.csv").write_bytes(data)
    with pytest.raises(DataError, match=f"wheels.csv: {fault}"):
        read_folder(folder)


def test_names_what_is_no_file(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="absent: no such folder"):
        read_folder(tmp_path / "absent")
    with pytest.raises(DataError, match=r"wheels\.csv: is a file, not a folder"):
        read_folder(folder / "wheels.csv")
    with pytest.raises(DataError, match=r": no wheels\.csv \(t, v_left, v_right\); there are: run-1"):
        read_folder(tmp_path)
    (folder / "imu.csv").unlink()
    (folder / "imu.csv").mkdir()
    with pytest.raises(DataError, match=r"imu\.csv: is a folder, not a file"):
        read_folder(folder)
    (folder / "imu.csv").rmdir()
    (folder / "imu.csv").symlink_to("/dev/zero")
    with pytest.raises(DataError, match=r"imu\.csv: is a device or pipe, not a file"):
        read_folder(folder)
    (folder / "imu.csv").unlink()
    (folder / "imu.csv").symlink_to("nowhere")
    with pytest.raises(DataError, match=r"imu\.csv: no such file"):
        read_folder(folder)
    with pytest.raises(DataError, match="embedded null"):
        read_folder("a\0b")


def test_refused_permission_is_one_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(builtins, "open", refuse)
    with pytest.raises(DataError, match=r"wheels\.csv: cannot be read: Permission denied"):
        read_folder(folder)


# --- a set of files ---


def copy(folder: Path, **names: str) -> list[Path]:
    """Copies of the files of a folder under other names."""
    paths = []
    for part, name in names.items():
        (folder / name).write_text(FILES[f"{part}.csv"])
        paths.append(folder / name)
    return paths


def test_recognises_files_by_their_columns(folder: Path) -> None:
    paths = copy(folder, pose="slam.csv", wheels="run_7.csv", imu="a", cmd="b", cmdwheels="c", segments="d")
    drive = read_csv_files(paths)
    assert (drive.name, drive.source) == ("run_7", ", ".join(map(str, paths)))
    assert_same(drive, read_folder(folder))
    assert drive.sha256 == read_folder(folder).sha256


def test_files_of_a_folder_are_the_folder(folder: Path) -> None:
    drive = read_csv_files([folder / name for name in FILES if name.endswith(".csv")])
    assert drive.name == "run-1"
    assert_same(drive, read_folder(folder))


def test_one_file_may_hold_several_parts(folder: Path) -> None:
    path = folder / "log.csv"
    path.write_text("t,v_left,v_right,x,y,yaw,v,omega,gyro_z\n0,1,2,3,4,5,6,7,8\n1,1,2,3,4,5,6,7,8\n")
    drive = read_csv_files([path], ROBOT)
    assert drive.pose is not None
    assert drive.gyro is not None
    assert_array_equal(drive.pose.values[0], [3, 4, 5])
    assert_array_equal(drive.gyro.values[0], [8])
    assert drive.command is None  # beside a pose, v and omega are measured
    assert drive.position is None
    assert drive.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_pose_file_is_preferred_to_position_file(folder: Path) -> None:
    (folder / "gnss.csv").write_text("t,x,y\n0,1,1\n")
    drive = read_csv_files([folder / "gnss.csv", folder / "wheels.csv", folder / "pose.csv"])
    assert drive.position is None
    drive = read_csv_files([folder / "gnss.csv", folder / "wheels.csv"])
    assert drive.position is not None


def test_file_with_a_known_name_is_that_part_alone(folder: Path) -> None:
    (folder / "pose.csv").write_text("t,x,y,yaw,gyro_z\n0,1,2,3,4\n1,1,2,3,4\n")
    drive = read_csv_files([folder / "wheels.csv", folder / "pose.csv", folder / "imu.csv"])
    assert drive.gyro is not None
    assert_array_equal(drive.gyro.values, [[0.7]])


def test_names_what_is_wrong_with_a_set_of_files(folder: Path) -> None:
    wheels, again, other = folder / "wheels.csv", folder / "again.csv", folder / "other.csv"
    again.write_text(FILES["wheels.csv"])
    other.write_text("time,speed\n0,1\n")
    with pytest.raises(DataError, match=r"wheels.csv and .*again.csv both have wheels columns; leave one of them out"):
        read_csv_files([wheels, again])
    with pytest.raises(
        DataError, match=r"other.csv: no part of a drive in its columns time, speed; rename them to: t,"
    ):
        read_csv_files([wheels, other])
    with pytest.raises(DataError, match=r"no columns t, v_left, v_right in: .*pose.csv; add the file of the wheel"):
        read_csv_files([folder / "pose.csv"])
    with pytest.raises(DataError, match="no columns t, v_left, v_right in: nothing"):
        read_csv_files([])
    (folder / "vehicle.yaml").unlink()
    with pytest.raises(DataError, match=r"run-1: no vehicle.yaml; name the robot with --vehicle"):
        read_csv_files([wheels])


# --- writing ---

values = st.floats(-LARGEST, LARGEST)


@st.composite
def series(draw: st.DrawFn, part: str, least: int = 1) -> Series:
    t = draw(st.lists(st.floats(-1e11, 1e11), min_size=least, max_size=4, unique=True))
    return Series(sorted(t), draw(arrays(float, (len(t), PARTS[part]), elements=values)), part)


@st.composite
def drives(draw: st.DrawFn) -> Drive:
    times = sorted(draw(st.sets(st.floats(0, 1e6), min_size=2, max_size=8)))
    segments = np.array(times[: len(times) // 2 * 2]).reshape(-1, 2)
    names = draw(st.lists(st.sampled_from(["step", "grip µ", "a-b"]), unique=True))
    labels = {name: draw(arrays(float, len(segments), elements=st.floats())) for name in names}
    optional = {part: draw(st.none() | series(part)) for part in PARTS if part not in ("wheels", "position")}
    if optional["pose"] is None:
        optional["position"] = draw(st.none() | series("position"))
    windows = {"segments": segments, "labels": labels} if draw(st.booleans()) else {}
    antenna = draw(st.none() | st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)))
    return Drive("any", ROBOT, draw(series("wheels", 2)), **optional, **windows, antenna=antenna)


@given(drives())
@settings(deadline=None, max_examples=60)
def test_writing_then_reading_is_exact(drive: Drive) -> None:
    with tempfile.TemporaryDirectory() as folder:
        write_folder(drive, f"{folder}/drive")
        assert_same(read_folder(f"{folder}/drive"), drive)


def test_writes_what_people_can_read(folder: Path, tmp_path: Path) -> None:
    write_folder(read_folder(folder), tmp_path / "copy")
    assert (tmp_path / "copy" / "wheels.csv").read_text() == FILES["wheels.csv"]
    assert (tmp_path / "copy" / "segments.csv").read_text() == "seg,t_start,t_end,step\n0,0.0,0.5,7.0\n1,0.5,1.0,8.0\n"
    yaml = "# m, kg, m/s\nname: mine\ntrack_width: 0.55\nwheel_radius: 0.165\nwheels: 4\nmass: 50.0\nsource: ''\n"
    told, mark, digest = (tmp_path / "copy" / "vehicle.yaml").read_text().partition("# written by skidsteer, SHA-256: ")
    assert (told, bool(mark), len(digest)) == (yaml, True, 65)


def test_replaces_an_older_drive_of_its_own_as_a_whole(folder: Path, tmp_path: Path) -> None:
    drive, copy = read_folder(folder), tmp_path / "copy"
    write_folder(drive, copy)
    short = Drive("short", ROBOT, drive.wheels)
    write_folder(short, copy)
    assert sorted(path.name for path in copy.iterdir()) == ["vehicle.yaml", "wheels.csv"]
    assert_same(read_folder(copy), short)


@pytest.mark.parametrize("change", ["recorded", "wheels.csv", "vehicle.yaml", "unmarked", "other files", "added"])
def test_replaces_no_drive_that_it_did_not_write(folder: Path, tmp_path: Path, change: str) -> None:
    """Nor one that was written and then changed, nor one that a copied vehicle.yaml stands beside."""
    drive, there = read_folder(folder), tmp_path / "there"
    write_folder(drive, there)
    if change == "recorded":
        there = folder
    elif change == "unmarked":
        (there / "vehicle.yaml").write_text(FILES["vehicle.yaml"])
    elif change == "other files":
        (there / "wheels.csv").write_text(FILES["wheels.csv"] + "9.0,0.1,0.1\n")
    elif change == "added":
        (there / "cmdwheels.csv").write_text("t,v_left_cmd,v_right_cmd\n0.0,0.1,0.2\n")
    else:
        (there / change).write_text((there / change).read_text().replace("0.", "00.", 1))
    before = {path.name: path.read_bytes() for path in there.iterdir()}
    with pytest.raises(DataError, match="did not write; choose another folder, or --force to lose it"):
        write_folder(drive, there)
    assert {path.name: path.read_bytes() for path in there.iterdir()} == before
    write_folder(drive, there, force=True)
    assert_same(read_folder(there), drive)


def test_fills_an_empty_folder(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    write_folder(read_folder(folder), tmp_path / "empty")
    assert_same(read_folder(tmp_path / "empty"), read_folder(folder))


def test_does_not_replace_what_is_not_just_a_drive(folder: Path, tmp_path: Path) -> None:
    drive = read_folder(folder)
    (folder / "thesis.tex").write_text("precious")
    with pytest.raises(DataError, match=r"is not just a drive, it holds thesis\.tex; choose another folder"):
        write_folder(drive, folder)
    with pytest.raises(DataError, match="is not just a drive, it holds run-1; choose another folder"):
        write_folder(drive, tmp_path)
    with pytest.raises(DataError, match=r"thesis\.tex: is a file, not a folder"):
        write_folder(drive, folder / "thesis.tex")
    with pytest.raises(DataError, match=r"there is no folder .*absent; create it first"):
        write_folder(drive, tmp_path / "absent" / "drive")
    assert (folder / "thesis.tex").read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == ["run-1"]


@pytest.mark.parametrize("name", ["a,b", "seg", "t_end", "", " a", 'a"', "a\nb"])
def test_refuses_labels_that_are_no_column_names(folder: Path, tmp_path: Path, name: str) -> None:
    drive = Drive("any", ROBOT, read_folder(folder).wheels, segments=[[0, 1]], labels={name: np.array([1.0])})
    with pytest.raises(DataError, match="cannot be the name of a CSV column; rename it"):
        write_folder(drive, tmp_path / "copy")


# --- any content ---

edits = st.tuples(
    st.sampled_from(sorted(FILES)),
    st.integers(0, 80),
    st.integers(0, 3),
    st.binary(max_size=3)
    | st.sampled_from([b",", b"\n", b'"', b"nan", b"1e999", b"-", b": ", b"*", b"&a ", b"!!", b"["]),
)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scratch")


@given(changes=st.lists(edits, min_size=1, max_size=4))
@settings(deadline=None, max_examples=400)
def test_damaged_files_give_a_drive_or_one_line(scratch: Path, changes: list[tuple[str, int, int, bytes]]) -> None:
    contents = {name: text.encode() for name, text in FILES.items()}
    for name, start, removed, added in changes:
        contents[name] = contents[name][:start] + added + contents[name][start + removed :]
    for name, content in contents.items():
        (scratch / name).write_bytes(content)
    try:
        message = read_folder(scratch).name
    except SkidSteerError as error:
        message = str(error)
    assert message.isprintable()


# --- recordings of real robots ---


@pytest.mark.skipif(not REAL_DRIVES.is_dir(), reason="the recorded drives are not here")
def test_real_drives_read_and_survive_a_copy(tmp_path: Path) -> None:
    drives = [read_folder(path) for path in sorted(REAL_DRIVES.iterdir()) if path.is_dir()]
    assert len(drives) >= 12
    for drive in drives:
        assert vehicle(drive.vehicle.name).track_width == pytest.approx(drive.vehicle.track_width, rel=0.06)
        write_folder(drive, tmp_path / "copy")
        assert_same(read_folder(tmp_path / "copy"), drive)
    windows = next(drive for drive in drives if drive.name == "husky-windows")
    assert windows.segments is not None
    assert windows.segments.shape == (586, 2)
    assert list(windows.labels) == ["calib_step", "transitory"]


def test_a_yaw_that_never_changes_while_the_wheels_turn_is_none(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """As a GNSS receiver's odometry has it, or a table whose yaw was filled up."""
    turning = FILES | {"wheels.csv": "t,v_left,v_right\n0.0,-1.0,1.0\n0.5,-1.0,1.0\n1.0,-1.0,1.0\n"}
    for name, text in turning.items():
        (tmp_path / name).write_text(text)
    assert load_drive(tmp_path).pose is not None
    (tmp_path / "pose.csv").write_text("t,x,y,yaw\n0.1,1,2,0\n0.2,4,5,0\n")
    with caplog.at_level("INFO"):
        drive = load_drive(tmp_path)
    assert drive.pose is None
    assert drive.position is not None
    assert_array_equal(drive.position.values, [[1, 2], [4, 5]])
    assert "taken for positions only" in caplog.text
    (tmp_path / "wheels.csv").write_text(FILES["wheels.csv"])  # straight on: the heading is one
    assert load_drive(tmp_path).pose is not None
