"""No command replaces what skidsteer did not write, unless told to; every command replaces what it wrote itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from conftest import Call
from skidsteer import export, load_drive, save_calibration
from skidsteer.cli import app
from skidsteer.cli.outputs import KINDS, spare
from skidsteer.errors import DataError
from skidsteer.identify.calibrate import calibrate
from skidsteer.io.folder import write_folder
from skidsteer.samples import sample

PRECIOUS = "t,v_left,v_right\n0.0,0.1,0.1\n0.1,0.1,0.1\n"  # somebody's measurements
ROBOT = "name: mine\ntrack_width: 0.4\nwheel_radius: 0.11\n"


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drives") / "short"
    write_folder(sample("p3at-mandow").between(0.0, 30.0), path)
    return path


@pytest.fixture(scope="module")
def known(short: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("result") / "calibration.yaml"
    save_calibration(calibrate(load_drive(short), "multiplier"), path)
    return path


MANOEUVRE = ["simulate", "--vehicle", "jackal", "--plant", "kinematic", "--manoeuvre", "2,0.5,0"]
FOLDERS: list[tuple[list[str], tuple[str, ...]]] = [  # commands, and the files that they write into --out
    (
        ["calibrate", "{short}", "--model", "multiplier"],
        ("calibration.yaml", "report.html", *(file for file, _ in export.FORMATS.values())),
    ),
    (
        ["design", "--vehicle", "jackal", "--area", "6x6", "--minutes", "0.3", "--model", "multiplier"],
        ("commands.csv", "path.csv", "path.svg"),
    ),
    (
        ["plan", "--calibration", "{known}", "--obstacle", "0.7x1.2", "--clearance", "0.5"],
        ("commands.csv", "path.csv", "plan.json", "plan.svg"),
    ),
    (
        ["follow", "--path", "line", "--size", "2", "--calibration", "{known}", "--speed", "0.5"],
        ("follow.json", "follow.html", "way.svg", "errors.svg", "drive"),
    ),
    (["reproduce", "giannoccaro2015"], ("reproduction.md",)),
]
FILES: list[tuple[list[str], str]] = [  # commands, and the name of a file that they write
    (["odometry", "{known}", "{short}"], "way.tum"),
    (["report", "{known}"], "report.html"),
    (["figure", "robot-icrs", "--calibration", "{known}"], "robot.svg"),
    (["figure", "robot-icrs", "--calibration", "{known}"], "robot.png"),
    *((["export", "{known}", "--to", kind], "made") for kind in export.FORMATS),
]


def filled(words: list[str], short: Path, known: Path) -> list[str]:
    return [word.format(short=short, known=known) for word in words]


def held(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(("words", "names"), FOLDERS, ids=lambda value: value[0])
def test_files_of_others_in_a_folder_are_kept(
    words: list[str], names: tuple[str, ...], short: Path, known: Path, tmp_path: Path, call: Call
) -> None:
    for name in names:
        if name == "drive":
            (tmp_path / name).mkdir()
            (tmp_path / name / "wheels.csv").write_text(PRECIOUS)
        else:
            (tmp_path / name).write_text(PRECIOUS)
        before = held(tmp_path)
        code, out, error = call(*filled(words, short, known), "--out", tmp_path)
        assert (code, out, error.count("\n")) == (1, "", 1), error
        assert f"{tmp_path / name}: " in error
        assert "--force to lose it" in error
        assert held(tmp_path) == before
        for path in before:
            Path(path).unlink()


@pytest.mark.parametrize(("words", "names"), FOLDERS, ids=lambda value: value[0])
def test_what_a_command_wrote_into_a_folder_it_replaces(
    words: list[str], names: tuple[str, ...], short: Path, known: Path, tmp_path: Path, call: Call
) -> None:
    """What it does not write at all, such as the integers of another robot, need not be there."""
    for _ in range(2):
        code, _, error = call(*filled(words, short, known), "--out", tmp_path)
        assert code == 0, error
    assert {path.name for path in tmp_path.iterdir() if path.name in names}
    assert {path.name for path in tmp_path.iterdir()} <= {*names, "figures"}


@pytest.mark.parametrize(("words", "name"), FILES)
def test_a_file_of_others_is_kept_and_one_of_its_own_replaced(
    words: list[str], name: str, short: Path, known: Path, tmp_path: Path, call: Call
) -> None:
    out = tmp_path / name
    words = [*filled(words, short, known), "--out", str(out)]
    out.write_text(PRECIOUS)
    code, told, error = call(*words)
    assert (code, told, error.count("\n")) == (1, "", 1)
    assert "was not written by skidsteer as it stands; choose another --out, or --force to lose it" in error
    assert out.read_text() == PRECIOUS
    assert call(*words, "--force")[0] == 0
    made = out.read_bytes()
    assert made[:16] != PRECIOUS[:16].encode()
    assert call(*words)[0] == 0
    out.write_bytes(b"")
    assert call(*words)[0] == 0
    assert out.read_bytes()[:16] == made[:16]


def test_covariances_are_kept_and_replaced(short: Path, known: Path, tmp_path: Path, call: Call) -> None:
    words = ("odometry", known, short, "--out", tmp_path / "a.tum", "--covariance", tmp_path / "c.csv")
    (tmp_path / "c.csv").write_text(PRECIOUS)
    assert call(*words)[0] == 1
    assert held(tmp_path) == {str(tmp_path / "c.csv"): PRECIOUS.encode()}
    assert call(*words, "--force")[0] == 0
    assert call(*words)[0] == 0


def test_a_trajectory_of_others_is_kept(short: Path, known: Path, tmp_path: Path, call: Call) -> None:
    """The reference, for one, has the same format."""
    truth = "0.0 1.0 2.0 0.1 0.0 0.0 0.0 1.0\n"
    (tmp_path / "truth.tum").write_text(truth)
    assert call("odometry", known, short, "--out", tmp_path / "truth.tum")[0] == 1
    assert (tmp_path / "truth.tum").read_text() == truth


@pytest.mark.parametrize("words", [MANOEUVRE, ["sample", "p3at-mandow"], ["check", "sample:p3at-mandow", "--fix"]])
def test_a_recorded_drive_is_kept(words: list[str], tmp_path: Path, call: Call) -> None:
    drive = tmp_path / "recorded"
    drive.mkdir()
    (drive / "wheels.csv").write_text(PRECIOUS)
    (drive / "vehicle.yaml").write_text(ROBOT)
    before = held(drive)
    code, out, error = call(*words, "--out", drive)
    assert (code, out, error.count("\n")) == (1, "", 1)
    told = "holds a drive that skidsteer did not write; choose another folder, or --force to lose it"
    assert error == f"skidsteer: {drive}: {told}\n"
    assert held(drive) == before
    assert call(*words, "--out", drive, "--force")[0] == 0
    assert held(drive) != before
    assert call(*words, "--out", drive)[0] == 0  # now it is its own


def test_a_calibration_is_not_replaced_by_something_else(known: Path, call: Call) -> None:
    before = known.read_bytes()
    for words in (["report", known], ["export", known, "--to", "json"]):
        assert call(*words, "--out", known)[0] == 1
    assert known.read_bytes() == before


def test_a_file_that_cannot_be_read_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "report.html").write_text("x")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(DataError, match="is there and cannot be read: Permission denied"):
        spare(tmp_path / "report.html", False)


def test_every_command_that_writes_can_be_forced() -> None:
    written = {(words[0]) for words, _ in FOLDERS} | {words[0] for words, _ in FILES} | {"simulate", "sample", "check"}
    commands = {
        str(command.callback.__name__): command.callback for command in app.registered_commands if command.callback
    }
    takes_out = {name for name, callback in commands.items() if "out" in callback.__annotations__}
    assert takes_out == written
    assert {name for name, callback in commands.items() if "force" in callback.__annotations__} == written
    assert "trajectory" in KINDS


def test_what_cannot_be_written_is_told_before_the_work(short: Path, known: Path, tmp_path: Path, call: Call) -> None:
    """Nothing is read, driven or calculated that has nowhere to go."""
    (tmp_path / "file").write_text("")
    nowhere = tmp_path / "file" / "made"
    for words in (MANOEUVRE, ["check", short, "--fix"], ["follow", "--path", "line"], ["calibrate", short]):
        code, out, error = call(*words, "--out", nowhere)
        assert (code, out, error) == (1, "", error)
        assert f"{tmp_path / 'file'} is a file; choose another path" in error
    absent = tmp_path / "absent" / "made.svg"
    code, _, error = call("figure", "trajectory", "--drive", tmp_path / "no drive", "--out", absent)
    assert (code, "there is no folder" in error) == (1, True)
    code, _, error = call("odometry", known, short, "--out", tmp_path / "a", "--covariance", tmp_path / "." / "a")
    assert (code, "--out and --covariance must be two files" in error) == (1, True)
    assert held(tmp_path) == {str(tmp_path / "file"): b""}
