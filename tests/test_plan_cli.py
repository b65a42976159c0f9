"""`skidsteer plan` as a user meets it."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from conftest import Call
from skidsteer.identify.circle_calibration import calibrate_circles
from skidsteer.io.calibration_file import save_calibration
from skidsteer.io.csv_table import numbers, read_table
from skidsteer.io.folder import read_folder
from skidsteer.models import SymmetricIcr
from skidsteer.models.slip_ratio import CircleRun
from skidsteer.vehicle import preset

ROUND = ("--obstacle", "0.70x1.25", "--clearance", "0.4")


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of circles of a P3-AT that is as the kinematic plant has it."""
    robot = preset("pioneer-p3at")
    chi = 1.0 + (0.27 / 0.40) ** 2
    model = SymmetricIcr(0.5 * chi * 0.40, 1.0)
    runs = []
    for i, (v, omega) in enumerate(((0.3, 0.3), (0.3, -0.3), (0.3, 0.5), (0.2, -0.3), (0.35, 0.35))):
        left, right = model.wheel_speeds(v, omega).tolist()
        runs.append(
            CircleRun(left, right, abs(v / omega) * (1.0 + 0.002 * (-1) ** i), speed=v * (1 + 0.001 * (-1) ** i))
        )
    path = tmp_path_factory.mktemp("calibration") / "calibration.yaml"
    save_calibration(calibrate_circles(runs, robot, ()).calibration, path)
    return path


def test_a_plan_is_written_and_driven(call: Call, calibration: Path, tmp_path: Path) -> None:
    out = tmp_path / "plan"
    code, text, _ = call("plan", *ROUND, "--calibration", calibration, "--laps", 2, "--out", out, "--json")
    assert code == 0
    document = json.loads(text)
    assert json.loads((out / "plan.json").read_text()) == document
    assert [s["name"] for s in document["stretches"]] == ["AB", "BC", "CD", "DA"] * 2
    assert document["clearance_m"]["least"] == pytest.approx(0.4, abs=2e-3)
    assert document["clearance_m"]["least_95"] < document["clearance_m"]["least"]

    code, _, _ = call(
        *("simulate", "--vehicle", "pioneer-p3at", "--plant", "kinematic", "--commands", out / "commands.csv"),
        *("--out", tmp_path / "drive"),
    )
    assert code == 0
    drive = read_folder(tmp_path / "drive")
    assert drive.pose is not None
    path = numbers(read_table(out / "path.csv"), ("t", "x", "y", "yaw"))
    expected = np.column_stack([np.interp(drive.pose.t, path[:, 0], column) for column in path[:, 1:3].T])
    off = np.hypot(*(drive.pose.values[:, :2] - expected).T)
    assert off.max() < 0.1  # the sensor errs by 1 cm, the calibration by a lag that circles do not tell
    assert off[-1] < 0.05


def test_commands_are_those_of_the_stretches(call: Call, calibration: Path, tmp_path: Path) -> None:
    _, text, _ = call("plan", *ROUND, "--calibration", calibration, "--out", tmp_path, "--direction", "right", "--json")
    document, rows = json.loads(text), numbers(read_table(tmp_path / "commands.csv"), ("t", "v_left", "v_right"))
    rolled = (rows[:-1, 1:] * np.diff(rows[:, 0])[:, None]).sum(axis=0)
    told = sum(np.array(s["rims_m_s"]) * s["duration_s"] for s in document["stretches"])
    assert_allclose(rolled, told, atol=1e-4)
    assert told[0] > told[1]
    assert_allclose(rows[-1, 1:], 0.0)


def test_the_picture_shows_obstacle_course_robot_and_end(call: Call, calibration: Path, tmp_path: Path) -> None:
    call("plan", *ROUND, "--calibration", calibration, "--out", tmp_path)
    root = ET.parse(tmp_path / "plan.svg").getroot()
    kinds = [element.tag.rpartition("}")[2] for element in root]
    assert kinds.count("polyline") == 4
    assert kinds.count("polygon") == 1 + 17 + 1  # obstacle; four outlines a stretch and the last; end
    words = [element.text for element in root if element.tag.endswith("text")]
    assert words == ["A", "B", "C", "D", "1.25 x 0.7 m"]


def test_the_table_for_people(call: Call, tmp_path: Path) -> None:
    words = ("--circles", "sample:rover-4wd1", "--profile", "indoor", "--speed", "0.623", "--curve-speed", "0.45")
    code, text, _ = call("plan", *ROUND, *words, "--out", tmp_path, "--laps", 3)
    assert code == 0
    assert "round 1.25 x 0.7 m on its left" in " ".join(text.split())
    assert [line.split()[0] for line in text.splitlines() if line[:2] in ("AB", "BC", "CD", "DA")] == [
        "AB",
        "BC",
        "CD",
        "DA",
    ]
    assert "k left" in text
    assert "on its left, from rest at A, on arcs of 0.920 m, 3 laps:" in " ".join(text.split())
    assert "Whole k alone" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "give either --calibration FILE or --circles TABLE"),
        (("--circles", "sample:rover-4wd1"), "add --profile with one of indoor, outdoor, football"),
        (("--circles", "sample:rover-4wd1", "--profile", "moon"), "no circle runs on surface 'moon'"),
        (("--circles", "sample:p3at-mandow"), "no table of circle runs"),
        (("--calibration", "nowhere.yaml"), "nowhere.yaml"),
        (
            ("--calibration", "x.yaml", "--vehicle", "jackal"),
            "--vehicle is of circle runs; a calibration knows its own",
        ),
        (("--circles", "sample:rover-4wd1-indoor", "--obstacle", "999x999"), "change --radius or the speeds"),
        (("--circles", "sample:rover-4wd1-indoor", "--obstacle", "1.25"), "--obstacle '1.25' is not two lengths"),
        (("--circles", "sample:rover-4wd1-indoor", "--obstacle", "0x1"), "obstacle needs two positive lengths"),
        (("--circles", "sample:rover-4wd1-indoor", "--footprint", "axb"), "--footprint 'axb' is not two lengths"),
        (("--circles", "sample:rover-4wd1-indoor", "--clearance", "-1"), "--clearance must be above 0"),
        (("--circles", "sample:rover-4wd1-indoor", "--speed", "3"), "change --speed"),
    ],
)
def test_bad_requests_are_one_line(call: Call, tmp_path: Path, words: tuple[str, ...], message: str) -> None:
    code, out, error = call("plan", *ROUND, *words, "--out", tmp_path / "new")
    assert code == 1
    assert message in error
    assert error.startswith("skidsteer: ")
    assert error.count("\n") == 1
    assert not out
    assert not (tmp_path / "new").exists()
