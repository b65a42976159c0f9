"""What users meet at the edges of the command line: other robots, odd names, places that cannot be written to."""

from __future__ import annotations

import contextlib
import errno
import io
import itertools
import json
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import pytest
from rich.console import Console

from conftest import Call, Run
from skidsteer import calibrate, console
from skidsteer.cli import ORDER, OneLine
from skidsteer.cli import words as told_words
from skidsteer.console import escape
from skidsteer.documents import to_json
from skidsteer.drive import Series
from skidsteer.errors import printable
from skidsteer.io.calibration_file import load_calibration, save_calibration
from skidsteer.io.drives import load_drive
from skidsteer.io.folder import write_folder
from skidsteer.io.vehicle_file import vehicle_text
from skidsteer.models import MODELS
from skidsteer.odometry.filters import FILTERS
from skidsteer.samples import sample
from skidsteer.sources import VEHICLES
from skidsteer.terramechanics.terrain import TERRAINS
from skidsteer.vehicle import PRESETS, preset


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 s of the sample as a drive folder."""
    path = tmp_path_factory.mktemp("drives") / "short"
    write_folder(sample("p3at-mandow").between(0.0, 40.0), path)
    return path


@pytest.fixture(scope="module")
def calibrated(short: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration of the sample."""
    path = tmp_path_factory.mktemp("result") / "calibration.yaml"
    save_calibration(calibrate(load_drive(short), "multiplier"), path)
    return path


def of_other_robot(short: Path, tmp_path: Path, track_width: float, wheel_radius: float) -> Path:
    folder = tmp_path / "foreign"
    shutil.copytree(short, folder)
    words = f"name: other\ntrack_width: {track_width}\nwheel_radius: {wheel_radius}\n"
    (folder / "vehicle.yaml").write_text(words, encoding="utf-8")
    return folder


def test_a_drive_of_another_robot_is_told(
    calibrated: Path, short: Path, tmp_path: Path, call: Call, caplog: pytest.LogCaptureFixture
) -> None:
    foreign = of_other_robot(short, tmp_path, 0.5, 0.22)
    code, out, _ = call("evaluate", calibrated, short, foreign, "--json")
    told = json.loads(out)["warnings"]
    assert code == 0
    assert told == [
        "foreign: recorded by other (track width 0.5 m, wheel radius 0.22 m), but the calibration is of pioneer-p3at"
        " (track width 0.4 m, wheel radius 0.11 m); its rim speeds are taken as they are; if it is one robot, multiply"
        " them by 0.5"
    ]
    assert caplog.messages == [f"Note: {told[0]}."]
    code, out, _ = call("odometry", calibrated, foreign, "--out", tmp_path / "x.tum", "--json")
    assert json.loads(out)["warnings"] == told
    assert call("report", calibrated, foreign, "--out", tmp_path / "x.html")[0] == 0
    assert told[0] in (tmp_path / "x.html").read_text(encoding="utf-8")


def test_the_robot_of_a_calibration_is_no_other(calibrated: Path, short: Path, tmp_path: Path, call: Call) -> None:
    same = of_other_robot(short, tmp_path, 0.4001, 0.11)
    asked = of_other_robot(short, tmp_path / "b", 0.5, 0.22)
    for words in ([short, same], [asked, "--vehicle", "pioneer-p3at"], ["sample:p3at-mandow"]):
        code, out, _ = call("evaluate", calibrated, *words, "--json")
        assert (code, json.loads(out)["warnings"]) == (0, [])


@pytest.mark.parametrize("robot", [None, "husky-a200"])
def test_a_report_knows_the_drive_it_was_made_from(robot: str | None, short: Path, tmp_path: Path, call: Call) -> None:
    """Whatever vehicle was named, and whatever the folder is called by now."""
    drive = load_drive(short, None if robot is None else preset(robot))
    save_calibration(calibrate(drive, "multiplier"), tmp_path / "calibration.yaml")
    shutil.copytree(short, tmp_path / "moved")
    assert call("report", tmp_path / "calibration.yaml", tmp_path / "moved", "--out", tmp_path / "again.html")[0] == 0
    text = (tmp_path / "again.html").read_text(encoding="utf-8")
    assert "After: held out" in text
    assert "that it was not made from" not in text


def test_what_calibrate_writes_is_all_old_or_all_new(
    short: Path, tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the robot of the new one has no use for a file of the old one."""
    names = ("calibration.yaml", "ekf.yaml", "model.json", "p3at.txt", "report.html", "ros2_control.yaml")
    for name in names:
        (tmp_path / name).write_text("old", encoding="utf-8")
    words = ("calibrate", short, "--model", "multiplier", "--vehicle", "husky-a200", "--out", tmp_path, "--force")
    sync, full = os.fsync, itertools.chain([False] * 4, itertools.repeat(True))

    def failing(file: int) -> None:
        if next(full):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(file)

    monkeypatch.setattr(os, "fsync", failing)
    code, out, err = call(*words)
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert "No space left on device" in err
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == dict.fromkeys(names, "old")
    monkeypatch.setattr(os, "fsync", sync)
    assert call(*words)[0] == 0
    assert {p.name for p in tmp_path.iterdir()} == set(names) - {"p3at.txt"}
    assert not any(p.read_text(encoding="utf-8") == "old" for p in tmp_path.iterdir())


def test_a_file_in_the_place_of_a_folder_is_named(tmp_path: Path, call: Call) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    code, _, err = call("reproduce", "giannoccaro2015", "--out", tmp_path / "file")
    assert code == 1
    assert err.endswith(f"{tmp_path / 'file'} is a file; choose another path\n")


ODD = "a\x1b[31m\x9b2J\u202e\u2028[red]\nZ\\"  # colours, clears, turns round, breaks the line


def harmless(text: str) -> bool:
    return printable(text.replace("\n", "")) == text.replace("\n", "")


@pytest.fixture(scope="module")
def odd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive, its robot, and a calibration of it, in all of whose names are orders to a terminal."""
    made = sample("p3at-mandow").between(0.0, 40.0)
    robot = replace(preset("pioneer-p3at"), name=ODD, source=ODD)
    folder = tmp_path_factory.mktemp("odd")
    write_folder(replace(made, vehicle=robot), folder / ODD)
    (folder / "robot.yaml").write_text(vehicle_text(robot), encoding="utf-8")
    known = calibrate(load_drive(folder / ODD), "multiplier")
    estimates = {name: replace(e, unit=ODD) for name, e in known.estimates.items()}
    told = replace(known, estimates=estimates, selected_because=ODD, warnings=(ODD,), profiles={})
    save_calibration(replace(told, profiles={ODD: told}), folder / "calibration.yaml")
    return folder


@pytest.mark.parametrize(
    "words",
    [
        "calibrate {drive} --model multiplier",
        "calibrate {drive} --model multiplier --json",
        "evaluate calibration.yaml {drive}",
        "evaluate calibration.yaml {drive} --json",
        "check {drive}",
        "check {drive} --json",
        "odometry calibration.yaml {drive} --out x.tum",
        "export calibration.yaml --to ros2-control",
        "export calibration.yaml --to robot-localization",
        "export calibration.yaml --to json",
        "plan --calibration calibration.yaml --obstacle 0.7x1.2 --clearance 0.3 --out x",
        "follow --path line --size 3 --speed 0.4 --calibration calibration.yaml --out x",
        "follow --path line --size 3 --speed 0.4 --vehicle robot.yaml --out x --json",
        "evaluate calibration.yaml {drive} --profile no",
        "calibrate {drive} sample:rover-circles",
        "compare no{drive}",
    ],
)
def test_no_name_is_an_order_to_the_terminal(
    words: str, odd: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(odd)
    _, out, err = call(*(word.format(drive=ODD) for word in words.split(" ")))
    assert out + err
    assert harmless(out)
    assert harmless(err)
    assert "\nZ" not in out + err
    if "--json" in words:
        assert repr(ODD)[1:-1] in str(json.loads(out))


def test_no_name_breaks_a_table_or_is_markup() -> None:
    shown = Console(highlight=False, width=200, file=io.StringIO(), force_terminal=True, color_system="truecolor")
    shown.print(f"[bold]{escape(ODD)}[/bold] end")
    assert isinstance(shown.file, io.StringIO)
    assert shown.file.getvalue() == "\x1b[1ma?[31m?2J??[red]?Z\\\x1b[0m end\n"


def test_names_are_harmless_in_pages_and_files(odd: Path, tmp_path: Path, call: Call) -> None:
    assert call("report", odd / "calibration.yaml", odd / ODD, "--out", tmp_path / "r.html")[0] == 0
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    body = page[: page.index('<script type="application/json"')]
    assert "a?[31m?2J??[red]" in body
    assert harmless(body)
    known = load_calibration(odd / "calibration.yaml")
    assert (known.vehicle.name, known.warnings, list(known.profiles)) == (ODD, (ODD,), [ODD])
    assert harmless((odd / ODD / "vehicle.yaml").read_text(encoding="utf-8"))


def test_a_log_is_one_line(caplog: pytest.LogCaptureFixture) -> None:
    record = logging.LogRecord("skidsteer", logging.INFO, "", 0, "%s: wheels", (ODD,), None)
    assert OneLine().format(record) == "a?[31m?2J??[red]?Z\\: wheels"


def test_names_that_no_encoding_holds_are_told_escaped(tmp_path: Path, run: Run) -> None:
    folder = tmp_path / os.fsdecode(b"r\xc3\xb6hre\xff")
    done = run("sample", "p3at-mandow", "--out", folder, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith("röhre?\n")
    assert to_json({"drive": folder.name}) == '{\n  "drive": "röhre\\udcff"\n}'


def test_help_tells_every_name_there_is() -> None:
    """As text, since help must not wait for the packages that know them."""
    told = {
        told_words.MODELS: MODELS,
        told_words.FILTERS: FILTERS,
        told_words.TERRAINS: TERRAINS,
        VEHICLES: sorted(PRESETS),
    }
    for text, names in told.items():
        assert text.split(", ") == list(names)


def test_the_commands_are_told_in_order_and_in_full(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = call("--help")
    lines = out[out.index("Commands:") :].splitlines()[1:]
    assert code == 0
    assert tuple(line.split()[0] for line in lines) == ORDER
    assert not any(line.endswith("...") for line in lines)
    assert call("--version") == (0, f"skidsteer {metadata.version('skidsteer')}\n", "")


@pytest.mark.parametrize("command", ORDER)
def test_no_option_tells_a_type_of_the_language(command: str, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    _, out, _ = call(command, "--help")
    options = out[out.index("Options:") :]
    assert not re.search(r"<(str|int|float|path|list|int range)", options)


def compiled() -> None:
    """Ctrl-C in a compiled loop, as Numba passes it on."""
    raise SystemError("returned a result with an exception set") from KeyboardInterrupt()


def plain() -> None:
    raise KeyboardInterrupt


def hidden() -> None:
    """Ctrl-C while a compiled module is imported, which makes an error of its own of it."""
    with contextlib.suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    raise ImportError("failed to import")


@pytest.mark.parametrize("interrupted", [compiled, plain, hidden])
def test_an_interruption_is_one_line(interrupted: object, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skidsteer.samples.sample", lambda _: interrupted())  # type: ignore[operator]
    assert call("sample", "p3at-mandow") == (130, "", "skidsteer: interrupted\n")


def test_an_interruption_while_the_commands_are_read_is_one_line() -> None:
    code = """
import sys
class Struck:
    def find_spec(self, name, *rest):
        if name == "typer":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Struck())
from skidsteer.cli import main
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "skidsteer: interrupted\n")


def test_ctrl_c_is_heard_as_before_once_a_command_is_done(call: Call) -> None:
    before = signal.getsignal(signal.SIGINT)
    assert call("sample")[0] == 0
    assert signal.getsignal(signal.SIGINT) is before


def test_a_fault_of_our_own_is_no_interruption(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def fault(_: str) -> None:
        raise SystemError("bug")

    monkeypatch.setattr("skidsteer.samples.sample", fault)
    with pytest.raises(SystemError, match="bug"):
        call("sample", "p3at-mandow")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
def test_an_output_that_is_full_is_one_line() -> None:
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-c", "from skidsteer.cli import main; main()", "--help"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr == "skidsteer: cannot write to standard output: No space left on device\n"


def test_a_table_of_numbers_is_whole_however_narrow(
    calibrated: Path, tmp_path: Path, short: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "a_drive_with_a_name_that_is_longer_than_the_terminal"
    shutil.copytree(short, folder)
    monkeypatch.setattr(console, "OUT", Console(highlight=False, width=40))
    code, out, _ = call("evaluate", calibrated, folder)
    assert code == 0
    assert re.search(rf"^{folder.name} +\d+ +\d\.\d{{3}} +\d\.\d{{3}} ", out, re.MULTILINE)
    assert "…" not in out


def test_the_folder_of_a_calibration_will_do(calibrated: Path, short: Path, call: Call) -> None:
    code, out, _ = call("evaluate", calibrated.parent, short, "--json")
    assert (code, out) == (0, call("evaluate", calibrated, short, "--json")[1])


def test_a_drive_without_a_reference_is_no_judge(short: Path, calibrated: Path, tmp_path: Path, call: Call) -> None:
    blind = tmp_path / "blind"
    write_folder(replace(load_drive(short), pose=None), blind)
    told = "skidsteer: blind: has nothing to judge by; add pose.csv (t, x, y, yaw), position.csv or imu.csv (gyro_z)\n"
    assert call("evaluate", calibrated, blind) == (1, "", told)


def test_a_drive_in_place_of_a_calibration_is_told(short: Path, calibrated: Path, tmp_path: Path, call: Call) -> None:
    made = "make one with `skidsteer calibrate DRIVE --out DIR`\n"
    told = f"skidsteer: {short}: is a drive, and a calibration is wanted here; {made}"
    assert call("evaluate", short, short) == (1, "", told)
    assert call("report", tmp_path) == (1, "", f"skidsteer: {tmp_path}: holds no calibration.yaml; {made}")


def test_a_cured_drive_does_not_take_the_place_of_the_recorded_one(short: Path, tmp_path: Path, call: Call) -> None:
    log = tmp_path / "log"
    shutil.copytree(short, log)
    before = {path.name: path.read_bytes() for path in log.iterdir()}
    code, out, error = call("check", log, "--fix", "--out", tmp_path / "log" / ".." / "log")
    assert (code, out, error.count("\n")) == (1, "", 1)
    assert "--out must be another folder than the drive, which stays as it was recorded" in error
    assert {path.name: path.read_bytes() for path in log.iterdir()} == before


def test_a_recording_does_not_count_twice(short: Path, tmp_path: Path, call: Call) -> None:
    """Nor a copy of it: the sigmas would be too small by a third, and the copy would judge it held out."""
    copy = tmp_path / "copy"
    shutil.copytree(short, copy)
    for command in (["calibrate", short, copy], ["compare", short, short], ["calibrate", *["sample:p3at-mandow"] * 2]):
        code, out, error = call(*command)
        assert (code, out, error.count("\n")) == (1, "", 1)
        assert "are the same recording, which would count twice; leave one of them out" in error


def test_a_reference_in_millimetres_is_told(real: Callable[[str], Path], tmp_path: Path, call: Call) -> None:
    """The model that comes of it would take ages to turn round: nothing to advise."""
    drive = load_drive(real("warthog-asphalt"))
    assert drive.pose is not None
    far = Series(drive.pose.t, drive.pose.values * [1e3, 1e3, 1.0], "pose")
    write_folder(replace(drive, pose=far, gyro=None, command=None), tmp_path / "far")
    code, out, _ = call("calibrate", tmp_path / "far", "--model", "icr")
    assert code == 0
    assert "The positions of the reference are in mm" in " ".join(out.split())
