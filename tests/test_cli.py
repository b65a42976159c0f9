"""The command line as a user meets it: results, refusals of one line, exit codes, nothing half-written."""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from conftest import POSE_DRIVES, Call, Run
from skidsteer.io.folder import write_folder
from skidsteer.samples import sample


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first minute of the sample as a drive folder."""
    path = tmp_path_factory.mktemp("drives") / "short"
    write_folder(sample("p3at-mandow").between(0.0, 60.0), path)
    return path


@pytest.fixture(scope="module")
def calibrated(short: Path, run: Run, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    out = tmp_path_factory.mktemp("out")
    result = run("calibrate", short, "--model", "icr", "--out", out, "--json")
    assert result.returncode == 0, result.stderr
    return out / "calibration.yaml", json.loads(result.stdout)


def refused(result: subprocess.CompletedProcess[str]) -> str:
    """The one line of a refusal."""
    assert result.returncode == 1, result
    assert result.stdout == ""
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("skidsteer: ")
    return lines[0]


def test_calibrate_json_has_the_promised_shape(calibrated: tuple[Path, dict[str, object]]) -> None:
    document = calibrated[1]
    assert document["model"] == "icr"
    parameters = document["parameters"]
    assert isinstance(parameters, dict)
    assert list(parameters) == ["icr_y_left", "icr_y_right", "icr_x", "alpha_left", "alpha_right"]
    assert set(parameters["icr_x"]) >= {"value", "sigma", "unit"}
    assert set(document["nuisance"]) == {"lag", "time_offset"}  # type: ignore[call-overload]
    held_out = document["held_out"]
    assert isinstance(held_out, dict)
    assert {"differential", "multiplier", "icr"} <= set(held_out)
    for figures in held_out.values():
        assert figures["windows"] > 10
        for spread in (figures["translation_m"], figures["yaw_deg"]):
            assert set(spread) == {"median", "rms", "p95"}


def test_parameters_are_those_the_sample_was_made_with(calibrated: tuple[Path, dict[str, object]]) -> None:
    truth = {"icr_y_left": 0.2553, "icr_y_right": -0.3071, "icr_x": -0.0120, "alpha_left": 0.9271, "lag": 0.08}
    found = {**calibrated[1]["parameters"], **calibrated[1]["nuisance"]}  # type: ignore[dict-item]
    for name, value in truth.items():
        assert abs(found[name]["value"] - value) < 4.0 * found[name]["sigma"], name


def test_evaluate_reads_what_calibrate_wrote(calibrated: tuple[Path, dict[str, object]], short: Path, run: Run) -> None:
    result = run("evaluate", calibrated[0], short, "--json")
    document = json.loads(result.stdout)
    assert document["window_s"] == 2.0
    assert document["windows"] == document["drives"]["short"]["windows"] > 20
    assert document["yaw_deg"]["rms"] < 1.5
    assert document["translation_m"]["median"] < 0.03


def test_evaluate_finds_the_delay_of_another_set_up(
    calibrated: tuple[Path, dict[str, object]], tmp_path: Path, run: Run
) -> None:
    from dataclasses import replace

    from skidsteer.drive import Series

    drive = sample("p3at-mandow").between(0.0, 60.0)
    assert drive.pose is not None
    late = replace(drive, pose=Series(drive.pose.t + 0.4, drive.pose.values, "pose"))
    write_folder(late, tmp_path / "late")
    before = json.loads(run("evaluate", calibrated[0], tmp_path / "late", "--json").stdout)
    after = json.loads(run("evaluate", calibrated[0], tmp_path / "late", "--json", "--fit-delay").stdout)
    found = calibrated[1]["nuisance"]["time_offset"]["value"]  # type: ignore[index]
    assert after["drives"]["late"]["time_offset_s"] == pytest.approx(found + 0.4, abs=0.005)
    assert after["yaw_deg"]["rms"] < 0.3 * before["yaw_deg"]["rms"]


def test_compare_shows_every_model(short: Path, run: Run) -> None:
    document = json.loads(run("compare", short, "--json").stdout)
    assert set(document["models"]) >= {"differential", "multiplier", "icr_symmetric", "icr", "linear"}
    assert document["selected"] in document["models"]
    assert document["models"]["differential"]["against_best"]["yaw"]["p_worse"] < 0.05


def test_tables_are_for_people(calibrated: tuple[Path, dict[str, object]], short: Path, run: Run) -> None:
    text = run("calibrate", short, "--model", "icr", env={**os.environ, "COLUMNS": "120"}).stdout
    for word in ("icr_y_left", "+- sigma", "Before: dead reckoning", "held-out error: translation [m]"):
        assert word in text
    assert "Time offset used: short" in run("evaluate", calibrated[0], short).stdout


def test_sample_lists_and_writes(tmp_path: Path, run: Run) -> None:
    assert "simulated" in run("sample").stdout
    assert run("sample", "p3at-mandow", "--out", tmp_path / "x").returncode == 0
    assert (tmp_path / "x" / "wheels.csv").exists()
    assert "there are: p3at-lab" in refused(run("sample", "nonsense"))


def test_two_csv_files_are_one_drive(short: Path, tmp_path: Path, run: Run) -> None:
    for name in ("wheels.csv", "pose.csv"):
        shutil.copy(short / name, tmp_path / name)
    args = (tmp_path / "wheels.csv", tmp_path / "pose.csv", "--model", "multiplier", "--json")
    assert json.loads(run("calibrate", *args, "--vehicle", "pioneer-p3at").stdout)["model"] == "multiplier"
    assert "--vehicle" in refused(run("calibrate", *args))


def test_help_is_quick_and_light(run: Run) -> None:
    assert run("--help").returncode == 0
    check = "import sys, skidsteer.cli; sys.exit(any(m in sys.modules for m in ('numpy', 'numba', 'scipy', 'rich')))"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


@pytest.mark.parametrize("args", [("calibrate",), ("calibrate", "x", "--no-such"), ("nonsense",)])
def test_wrong_usage_exits_with_2(args: tuple[str, ...], run: Run) -> None:
    assert run(*args).returncode == 2


def damage(short: Path, tmp_path: Path, file: str, edit: object) -> Path:
    folder = tmp_path / "damaged"
    shutil.copytree(short, folder)
    path = folder / file
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(edit(lines)))  # type: ignore[operator]
    return folder


def reversed_time(lines: list[str]) -> list[str]:
    return [lines[0], *reversed(lines[1:])]


def shifted(lines: list[str]) -> list[str]:
    rows = [line.split(",", 1) for line in lines[1:]]
    return [lines[0], *(f"{float(t) + 1e4},{rest}" for t, rest in rows)]


def still(lines: list[str]) -> list[str]:
    return [lines[0], *(line.split(",")[0] + ",0,0\n" for line in lines[1:])]


def in_milliseconds(lines: list[str]) -> list[str]:
    rows = [line.split(",", 1) for line in lines[1:]]
    return [lines[0], *(f"{float(t) * 1e3},{rest}" for t, rest in rows)]


CASES = {
    "milliseconds": ("wheels.csv", in_milliseconds, "is t in seconds?"),
    "NaN": ("wheels.csv", lambda x: [*x[:50], x[50].split(",")[0] + ",nan,0.1\n", *x[51:]], "is nan"),
    "unsorted": ("wheels.csv", reversed_time, "is earlier than"),
    "repeated": ("wheels.csv", lambda x: [*x[:50], x[49], *x[50:]], "repeats the time"),
    "column": ("pose.csv", lambda x: ["t,x,y,heading\n", *x[1:]], "yaw"),
    "empty": ("wheels.csv", lambda x: [], "empty"),
    "one row": ("wheels.csv", lambda x: x[:2], "two"),
    "no overlap": ("pose.csv", shifted, "share no time"),
    "still": ("wheels.csv", still, "stands still"),
    "short": ("pose.csv", lambda x: x[:12], "at least 4 s"),
    "vehicle": ("vehicle.yaml", lambda x: ["track_width: wide\n"], "vehicle.yaml"),
    "code": ("vehicle.yaml", lambda x: ["!!python/object/apply:os.system ['true']\n"], "vehicle.yaml"),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_drives_get_one_line_and_nothing_is_written(case: str, short: Path, tmp_path: Path, run: Run) -> None:
    file, edit, words = CASES[case]
    folder = damage(short, tmp_path, file, edit)
    line = refused(run("calibrate", folder, "--out", tmp_path / "out", "--json"))
    assert words in line
    assert not (tmp_path / "out" / "calibration.yaml").exists()


def test_missing_things_are_named(short: Path, tmp_path: Path, run: Run) -> None:
    folder = tmp_path / "drive"
    shutil.copytree(short, folder)
    (folder / "wheels.csv").unlink()
    assert "wheels.csv" in refused(run("calibrate", folder))
    assert "no such" in refused(run("calibrate", tmp_path / "nowhere"))
    assert "pioneer-p3at" in refused(run("calibrate", short, "--vehicle", "tractor"))
    assert "no model" in refused(run("calibrate", short, "--model", "magic"))
    assert "no method" in refused(run("calibrate", short, "--method", "magic"))
    assert "positive" in refused(run("calibrate", short, "--window", "-1"))


def test_unwritable_output_is_refused(short: Path, tmp_path: Path, run: Run) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("here already")
    assert "cannot be made a folder" in refused(run("calibrate", short, "--model", "multiplier", "--out", blocked))
    if os.geteuid() != 0:
        locked = tmp_path / "locked"
        locked.mkdir(mode=stat.S_IRUSR | stat.S_IXUSR)
        refused(run("calibrate", short, "--model", "multiplier", "--out", locked))


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda s: s.replace("skidsteer_calibration: 1", "skidsteer_calibration: 99"), "version"),
        (lambda s: "skidsteer_calibration: !!python/object/apply:os.system ['true']\n", "not YAML"),
        (lambda s: "", "not a calibration"),
        (lambda s: s.replace("name: icr\n", "name: magic\n"), "no model"),
        (lambda s: s.replace("icr_x", "icr_z", 1), "icr"),
        (lambda s: s.replace("noise:", "nose:"), "nois"),
        (lambda s: s[: len(s) // 2], "calibration.yaml"),
    ],
)
def test_bad_calibration_files_get_one_line(
    edit: object, words: str, calibrated: tuple[Path, dict[str, object]], short: Path, tmp_path: Path, run: Run
) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(edit(calibrated[0].read_text()))  # type: ignore[operator]
    assert words in refused(run("evaluate", path, short))


def test_warthog_on_asphalt_meets_its_figures(real: object, run: Run) -> None:
    result = run("calibrate", real("warthog-asphalt"), "--json")  # type: ignore[operator]
    figures = json.loads(result.stdout)["held_out"]
    assert figures["icr"]["translation_m"]["median"] <= 0.045
    assert figures["icr"]["yaw_deg"]["rms"] <= 1.2
    assert figures["differential"]["yaw_deg"]["rms"] > 15.0


def test_the_genetic_search_says_how_far_it_is_from_the_optimum(short: Path, run: Run) -> None:
    document = json.loads(run("calibrate", short, "--model", "icr", "--method", "genetic", "--json").stdout)
    assert document["method"] == "genetic"
    (note,) = [w for w in document["warnings"] if w.startswith("genetic search")]
    assert "above the best point of its 8-bit grid" in note
    assert "above the least squares" in note


@pytest.mark.parametrize("name", POSE_DRIVES)
def test_every_real_drive_is_calibrated_and_explained(name: str, real: object, run: Run) -> None:
    result = run("calibrate", real(name), "--model", "icr", "--json")  # type: ignore[operator]
    assert result.returncode == 0, result.stderr
    document = json.loads(result.stdout)
    assert document["selected_because"]
    icr, nominal = document["held_out"]["icr"], document["held_out"]["differential"]
    for what in ("translation_m", "yaw_deg"):
        for statistic in ("median", "rms"):
            assert icr[what][statistic] < nominal[what][statistic], (what, statistic)
    sigmas = [p["sigma"] for p in document["parameters"].values() if p["determined"]]
    assert sigmas
    assert np.all(np.array(sigmas) > 0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--wheel-signal", "torque"], "skidsteer: --wheel-signal must be position or velocity, got torque"),
        (["--separation", "wide"], "skidsteer: --separation must be a positive number, got wide"),
        (["--separation-multiplier", "-1"], "skidsteer: --separation-multiplier must be a positive number, got -1.0"),
        (["--wheels-unit", "furlong"], "skidsteer: --wheels-unit must be one of rad, rad/s, m/s, ticks, got furlong"),
        (["--separation", "0"], "skidsteer: --separation must be a positive number, got 0.0"),
    ],
)
def test_options_of_bags_that_cannot_be(run: Run, words: list[str], said: str) -> None:
    done = run("check", "sample:p3at-mandow", *words)
    assert (done.returncode, done.stdout) == (1, "")
    assert said in done.stderr


def test_positions_alone_tell_no_error_in_yaw(short: Path, tmp_path: Path, call: Call) -> None:
    poses = [line.split(",") for line in (short / "pose.csv").read_text(encoding="utf-8").splitlines()]
    (tmp_path / "position.csv").write_text("".join(f"{t},{x},{y}\n" for t, x, y, _ in poses), encoding="utf-8")
    words = ("--vehicle", "pioneer-p3at", "--model", "icr_symmetric")
    code, out, _ = call("calibrate", short / "wheels.csv", tmp_path / "position.csv", *words)
    assert code == 0
    assert "Before: dead reckoning" in out
    assert "nan" not in out
