"""`skidsteer design` as a user meets it."""

from __future__ import annotations

import itertools
import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from conftest import Run
from skidsteer.cli import main
from skidsteer.drive import Series
from skidsteer.identify.calibrate import calibrate
from skidsteer.io.calibration_file import save_calibration
from skidsteer.io.command_table import write_path
from skidsteer.io.csv_table import numbers, read_table
from skidsteer.samples import sample


def here(*words: object) -> int | None:
    """Exit code of a command run in this process; None where it ends well."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["skidsteer", *map(str, words)])
        try:
            main()
        except SystemExit as end:
            return None if end.code in (0, None) else int(str(end.code))
    return None


@pytest.fixture(scope="module")
def designed(run: Run, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    out = tmp_path_factory.mktemp("design")
    words = ("--vehicle", "jackal", "--area", "8x6", "--minutes", "2", "--model", "icr", "--out", out, "--json")
    result = run("design", *words)
    assert result.returncode == 0, result.stderr
    return out, json.loads(result.stdout)


def test_the_json_says_what_to_drive_and_what_it_tells(designed: tuple[Path, dict[str, object]]) -> None:
    document = designed[1]
    assert document["vehicle"] == "jackal"
    assert document["model"] == "icr"
    assert 100.0 < document["duration_s"] <= 120.0  # type: ignore[operator]
    predicted = document["predicted"]
    assert isinstance(predicted, dict)
    assert list(predicted) == [
        "icr_y_left",
        "icr_y_right",
        "icr_x",
        "alpha_left",
        "alpha_right",
        "lag",
        "time_offset",
    ]
    assert all(0.0 < e["sigma"] < e["unplanned_sigma"] for name, e in predicted.items() if name.startswith("icr"))
    manoeuvres = document["manoeuvres"]
    assert isinstance(manoeuvres, list)
    assert all(a["start_s"] + a["duration_s"] <= b["start_s"] + 1e-6 for a, b in itertools.pairwise(manoeuvres))


def test_the_commands_can_be_played(designed: tuple[Path, dict[str, object]]) -> None:
    out, document = designed
    rows = numbers(read_table(out / "commands.csv"), ("t", "v", "omega", "v_left", "v_right"))
    t, v, omega, left, right = rows.T
    assert np.allclose(np.diff(t), 0.05)
    assert t[-1] + 0.05 == pytest.approx(document["duration_s"])
    width = document["controller_width_m"]
    assert isinstance(width, float)
    assert np.allclose(v - 0.5 * width * omega, left, atol=2e-6)
    assert np.allclose(v + 0.5 * width * omega, right, atol=2e-6)


def test_the_path_is_that_of_the_commands(designed: tuple[Path, dict[str, object]]) -> None:
    t, s, x, y, yaw = numbers(read_table(designed[0] / "path.csv"), ("t", "s", "x", "y", "yaw")).T
    assert (np.diff(t) > 0).all()
    assert (np.abs(x) < 4.0).all()
    assert (np.abs(y) < 3.0).all()
    assert np.allclose([x[-1], y[-1], yaw[-1]], 0.0, atol=1e-3)
    assert s[-1] == pytest.approx(np.hypot(np.diff(x), np.diff(y)).sum(), rel=1e-3)


def test_the_picture_is_a_picture(designed: tuple[Path, dict[str, object]]) -> None:
    root = ET.parse(designed[0] / "path.svg").getroot()
    strokes = [e for e in root.iter() if e.tag.endswith("polyline")]
    assert len(strokes) == len(designed[1]["manoeuvres"])  # type: ignore[arg-type]
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    points = np.array([p.split(",") for e in strokes for p in e.attrib["points"].split()], dtype=float)
    assert (points >= 0).all()
    assert (points <= [width, height]).all()


def test_curvature_is_left_out_where_there_is_none(tmp_path: Path) -> None:
    yaw = np.array([0.0, 0.1, 0.2, 0.3, 0.3])
    poses = np.column_stack([[0.0, 0.2, 0.4, 0.4, 0.4], np.zeros(5), yaw])
    write_path(tmp_path / "path.csv", Series(np.arange(5.0), poses))
    rows = [line.split(",") for line in (tmp_path / "path.csv").read_text().splitlines()[1:]]
    assert [row[5] for row in rows] == ["0.5", "0.5", "", "", ""]
    assert [row[1] for row in rows] == ["0", "0.2", "0.4", "0.4", "0.4"]


def test_a_calibration_is_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = sample("p3at-mandow").between(0.0, 40.0)
    save_calibration(calibrate(drive, model="icr"), tmp_path / "calibration.yaml")
    words = ("--calibration", tmp_path / "calibration.yaml", "--area", "8x6", "--minutes", "1", "--out", tmp_path)
    assert here("design", *words, "--json") is None
    document = json.loads(capsys.readouterr().out)
    assert (document["vehicle"], document["model"]) == ("pioneer-p3at", "icr")
    assert document["noise"]["position"] < 0.015  # the calibration's, not the usual one


def test_people_get_a_table_in_plain_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skidsteer.console.OUT.width", 200, raising=False)
    words = ("--vehicle", "jackal", "--area", "8x6", "--minutes", "1", "--model", "icr", "--out", tmp_path / "new")
    assert here("design", *words) is None
    text = capsys.readouterr().out
    for part in ("manoeuvre", "straight ahead", "predicted sigmas", "unplanned", "icr_y_left", "19 of 20", "0.563 m"):
        assert part in text
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == ["commands.csv", "path.csv", "path.svg"]


@pytest.mark.parametrize(
    ("change", "cure"),
    [
        (("--area", "10by10"), "write it as 10x10"),
        (("--area", "1x1"), "needs more than 1.2 x 1.2 m"),
        (("--minutes", "0"), "--minutes must be a positive time"),
        (("--minutes", "1e9"), "of at most 480, got 1e+09"),
        (("--vehicle", "tank"), "no vehicle preset 'tank'; there are"),
        (("--vehicle", "rover-4wd1"), "give --max-speed"),
        (("--max-speed", "9"), "beyond the 2 m/s"),
        (("--max-omega", "0"), "limit of the omega must be positive"),
        (("--max-lateral", "-1"), "limit of the lateral acceleration must be positive"),
        (("--model", "ice"), "no model 'ice'; there are"),
        (("--calibration", "nowhere.yaml"), "nowhere.yaml"),
    ],
)
def test_refusals_name_the_cure(
    change: tuple[str, str], cure: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = {"--vehicle": "jackal", "--area": "10x10", "--minutes": "3", "--out": str(tmp_path / "out")}
    words |= {change[0]: change[1]}
    assert here("design", *(word for pair in words.items() for word in pair)) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert cure in said.err
    assert len(said.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
