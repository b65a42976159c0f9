"""Tables of circle runs on the command line: results, refusals of one line, and what is made of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from conftest import Call
from skidsteer.calibration import DriveRecord
from skidsteer.errors import RequestError
from skidsteer.identify.circle_calibration import calibrate_circles, calibrate_circles_in, circle_runs_in
from skidsteer.identify.circle_test import wang_protocol
from skidsteer.io.calibration_file import load_calibration
from skidsteer.io.folder import write_folder
from skidsteer.models import Curvature, SymmetricIcr
from skidsteer.models.slip_ratio import CircleRun
from skidsteer.samples import sample
from skidsteer.vehicle import preset

P3AT, ROVER = preset("pioneer-p3at"), preset("rover-4wd1")
RECORD = (DriveRecord("runs", "here", "", 0.0, 3, 0),)


@pytest.fixture
def table(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "runs.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return write


HEAD = "v_left,v_right,radius,chord,sagitta,surface\n"
GOOD = "0.2,0.6,0.8,,,tiles\n0.3,0.6,1.2,,,tiles\n"


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0.4,0.4,1,,,tiles", "line 4: both sides run at 0.4 m/s: a straight run has no radius, leave it out"),
        ("0,0,1,,,tiles", "line 4: both sides are at rest: no circle was driven"),
        ("-0.3,0.3,1,,,tiles", "line 4: the sides run against each other (v_left -0.3, v_right 0.3 m/s)"),
        ("0.2,0.6,,1,-0.1,tiles", "line 4: chord and sagitta must be positive lengths in m, got 1 and -0.1"),
        ("0.2,0.6,,1,0,tiles", "line 4: chord and sagitta must be positive lengths in m, got 1 and 0; a sagitta of 0"),
        ("0.2,0.6,0.4,1,,tiles", "line 4: a chord of 1 m is longer than the diameter, 0.8 m; correct one of them"),
        ("0.2,0.6,,0.5,1,tiles", "line 4: chord 0.5 m and sagitta 1 m belong to no circle: the chord would be longer"),
        ("0.2,0.6,-1,,,tiles", "line 4: the radius must be a positive length in m, got -1"),
        ("0.2,0.6,nan,,,tiles", "line 4: the radius must be a positive length in m, got nan"),
        ("0.2,0.6,,,,tiles", "line 4: has no radius, and not both chord and sagitta"),
    ],
)
def test_bad_runs_get_one_line(row: str, message: str, table: Callable[[str], Path], call: Call) -> None:
    path = table(HEAD + GOOD + row + "\n")
    code, out, err = call("calibrate", path, "--vehicle", "pioneer-p3at")
    assert (code, out) == (1, "")
    assert err.startswith(f"skidsteer: {path}: {message}")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "words", "message"),
    [
        (HEAD + GOOD, (), "circle runs do not tell the robot's measures; give --vehicle"),
        (HEAD + "0.2,0.6,0.8,,,tiles\n", ("--vehicle", "jackal"), "runs: 1 circle run cannot tell its own error"),
        (HEAD + GOOD, ("--vehicle", "jackal", "--model", "icr"), "circle runs cannot tell the model 'icr'; choose one"),
        (HEAD + GOOD, ("--vehicle", "jackal", "--method", "genetic"), "--method genetic needs a drive"),
        (HEAD + GOOD, ("--vehicle", "jackal", "--model", "curvature"), "2 runs cannot tell a, b and their error"),
        ("v_left,v_right\n0.2,0.6\n", ("--vehicle", "jackal"), "no part of a drive"),
    ],
)
def test_impossible_requests_get_one_line(
    text: str, words: tuple[str, ...], message: str, table: Callable[[str], Path], call: Call
) -> None:
    code, out, err = call("calibrate", table(text), *words)
    assert (code, out) == (1, "")
    assert message in err
    assert len(err.strip().splitlines()) == 1


def test_an_unknown_surface_names_those_there_are(table: Callable[[str], Path], tmp_path: Path, call: Call) -> None:
    rows = GOOD + GOOD.replace("tiles", "wet grass")
    assert call("calibrate", table(HEAD + rows), "--vehicle", "rover-4wd1", "--out", tmp_path)[0] == 0
    drive = "sample:rover-4wd1-indoor"
    code, _, err = call("evaluate", tmp_path / "calibration.yaml", drive, "--profile", "ice")
    assert code == 1
    assert err == "skidsteer: no profile 'ice'; there are: tiles, wet grass\n"
    assert call("evaluate", tmp_path / "calibration.yaml", drive, "--profile", "wet grass")[0] == 0
    assert (
        call("calibrate", "sample:rover-4wd1-ice")[2]
        .strip()
        .startswith("skidsteer: no sample 'rover-4wd1-ice'; there are:")
    )


def test_a_drive_too_short_for_folds_is_calibrated_and_says_so(tmp_path: Path, call: Call) -> None:
    write_folder(sample("p3at-mandow").between(10.0, 22.0), tmp_path / "short")
    code, out, _ = call("calibrate", tmp_path / "short", "--json")
    document = json.loads(out)
    assert code == 0
    assert document["held_out"] == {}
    assert "too short to hold anything out: no comparison was possible" in document["selected_because"]
    assert any(w.startswith("too short to hold anything out") for w in document["warnings"])
    assert "NaN" not in out
    code, _, err = call("compare", tmp_path / "short")
    assert code == 1
    assert "too short to hold anything out; at least 16 s in motion are needed" in err


def test_the_rover_sample_has_its_surfaces_side_by_side(tmp_path: Path, call: Call) -> None:
    """K_s of Giannoccaro 2015, Table 5, calculated from Table 2: 1.42 1.84 2.71 2.52 2.46 for left turns indoors."""
    code, out, _ = call("calibrate", "sample:rover-4wd1", "--json", "--out", tmp_path)
    document = json.loads(out)
    assert code == 0
    indoor, outdoor, football = document["circle_test"]
    assert [s["surface"] for s in (indoor, outdoor, football)] == ["indoor", "outdoor", "football"]
    assert football["right"] is None
    ratios = [run["slip_ratio"] for run in indoor["left"]["runs"]]
    assert ratios == pytest.approx([1.42, 1.84, 2.71, 2.52, 2.46], abs=0.006)
    assert indoor["left"]["icr_y_m"] == pytest.approx(0.604, abs=5e-4)
    assert indoor["left"]["chi"] == pytest.approx(0.28 / (2 * 0.604), abs=5e-4)
    assert indoor["left"]["equivalent_track_width_m"] == pytest.approx(2 * indoor["left"]["icr_y_m"])
    assert set(document["profiles"]) == {"indoor", "outdoor", "football"}
    assert document["model"] == "icr_symmetric"
    assert any("no constant ICR describes these runs" in w for w in document["warnings"])
    assert set(load_calibration(tmp_path / "calibration.yaml").profiles) == {"indoor", "outdoor", "football"}
    _, text, _ = call("calibrate", "sample:rover-4wd1")
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert any(line.startswith("runs 5 5 5 5 5") for line in lines)
    assert any(line.startswith("K_s 0.41:0.632 1.42 1.45 1.47 1.48 1.42") for line in lines)


def test_other_models_take_the_sample_as_a_drive(call: Call) -> None:
    document = json.loads(call("calibrate", "sample:rover-4wd1-indoor", "--model", "icr", "--json")[1])
    assert document["model"] == "icr"
    assert "circle_test" not in document


def test_wang_s_protocol_gives_back_his_curve(table: Callable[[str], Path], call: Call) -> None:
    """The 35 turning runs of the 8 x 5 protocol that are no turns on the spot; radii off by 0.3 %."""
    truth, rng = Curvature(0.468, 0.05, 1.0, P3AT.track_width), np.random.default_rng(5)
    rows = ["v_left,v_right,radius"]
    for path_curvature, _, left, right in wang_protocol():
        if path_curvature > 0.0:
            twist = truth.twist(left, right)
            rows.append(f"{left},{right},{twist[0] / twist[2] * (1 + 0.003 * rng.standard_normal())}")
    assert len(rows) == 36
    document = json.loads(call("calibrate", table("\n".join(rows)), "--vehicle", "pioneer-p3at", "--json")[1])
    assert document["model"] == "curvature"
    assert document["selected_because"].startswith("the ICR distance falls with lambda")
    for name, value in {"a": 0.468, "b": 0.05}.items():
        found = document["parameters"][name]
        assert found["determined"]
        assert abs(found["value"] - value) < 3.0 * found["sigma"] < 0.03
    assert not document["parameters"]["alpha"]["determined"]
    assert any("measure speeds over ground" in w for w in document["warnings"])


# The calibration


def runs_of(model: SymmetricIcr, speed: bool, errors: tuple[float, ...] = (1.0, 1.0, 1.0)) -> list[CircleRun]:
    pairs = ((0.2, 0.6), (0.3, 0.6), (0.6, 0.1))
    out = []
    for (left, right), error in zip(pairs, errors, strict=True):
        v, _, omega = model.twist(left, right)
        out.append(CircleRun(left, right, abs(v / omega) * error, speed=float(v) if speed else None))
    return out


def test_constant_by_hand() -> None:
    """Radii off by factors e, 1/e, 1: the geometric mean is right, its sigma that of the logs over the root of 3."""
    factor = 1.05
    runs = runs_of(SymmetricIcr(0.3, 0.9), True, (factor, 1.0 / factor, 1.0))
    found = calibrate_circles(runs, ROVER, RECORD).calibration
    icr_y, alpha = found.estimates["icr_y"], found.estimates["alpha"]
    assert icr_y.value == pytest.approx(0.3)
    assert icr_y.sigma == pytest.approx(0.3 * np.log(factor) / np.sqrt(3.0))
    assert alpha.value == pytest.approx(0.9)
    assert alpha.determined
    assert alpha.sigma < 1e-9
    assert found.selected_because.startswith("no curve through these runs") or "lambda" in found.selected_because


def test_without_speeds_the_scale_is_an_assumption() -> None:
    found = calibrate_circles(runs_of(SymmetricIcr(0.3, 0.9), False), ROVER, RECORD, "icr_symmetric").calibration
    assert found.estimates["alpha"].value == 1.0
    assert found.estimates["alpha"].sigma == pytest.approx(1.0 / np.sqrt(12.0))
    assert not found.estimates["alpha"].determined
    assert found.estimates["icr_y"].value == pytest.approx(0.3)
    assert found.selected_because == "asked for"


def test_circles_of_a_drive() -> None:
    """The sample's circles and S-curves tell the ICR distance of its truth."""
    drive = sample("p3at-mandow")
    runs = circle_runs_in(drive)
    assert {run.direction for run in runs} == {"left", "right"}
    assert {run.surface for run in runs} == {"p3at-mandow"}
    found = calibrate_circles_in([drive]).calibration
    assert found.profiles == {}
    assert found.effective_track_width is not None
    assert found.estimates["icr_y"].value == pytest.approx(0.281, abs=0.02)
    assert found.provenance.drives[0].windows == len(runs)


def test_a_drive_of_turns_on_the_spot_has_no_circles() -> None:
    with pytest.raises(RequestError, match="turns on the spot only; record circles"):
        circle_runs_in(sample("p3at-mandow").between(9.5, 18.0))
