"""Calibration files with values that cannot be: refused in one line, whichever command reads them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from report_drives import lab
from skidsteer import export
from skidsteer.errors import DataError, RequestError, printable
from skidsteer.io.calibration_file import calibration_text, load_calibration

Key = tuple[str, ...]


@pytest.fixture(scope="module")
def content() -> Any:
    """What the file of a calibration holds."""
    return yaml.safe_load(calibration_text(lab()[0]))


def edited(content: Any, key: Key, value: object, path: Path) -> Path:
    """A file in which the value of a key is another."""
    copy = yaml.safe_load(yaml.safe_dump(content))
    place = copy
    for name in key[:-1]:
        place = place[name]
    assert key[-1] in place
    place[key[-1]] = value
    path.write_text(yaml.safe_dump(copy), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("key", "value"),
    [
        (("model", "parameters", "icr_y_left", "value"), 1e308),
        (("nuisance", "lag", "value"), -1.0),
        (("noise", "walk"), float("inf")),
        (("noise", "turn"), 1e308),
        (("regions", "scale"), float("nan")),
        (("regions", "dof"), 0.0),
        (("regions", "turning"), -0.01),
        (("controller", "projection", "x"), 1e308),
        (("controller", "projection", "yaw_rate"), float("inf")),
        (("controller", "projection", "multipliers", "track_width"), 1e308),
    ],
)
def test_values_that_cannot_be_are_refused_by_name(content: Any, key: Key, value: object, tmp_path: Path) -> None:
    file = edited(content, key, value, tmp_path / "calibration.yaml")
    with pytest.raises(DataError, match=f"calibration.yaml: .*{key[-2] if key[-1] == 'value' else key[-1]}"):
        load_calibration(file)


def test_parameters_of_an_older_model_are_named(content: Any, tmp_path: Path) -> None:
    copy = yaml.safe_load(yaml.safe_dump(content))
    parameters = copy["model"]["parameters"]
    parameters["yaw_gain"] = parameters.pop("icr_x")
    file = tmp_path / "calibration.yaml"
    file.write_text(yaml.safe_dump(copy), encoding="utf-8")
    with pytest.raises(
        DataError, match=r"calibration.yaml: model: .* takes .*icr_x.*; got .*yaw_gain; calibrate again$"
    ):
        load_calibration(file)


def test_regions_of_an_older_file_know_of_no_turns(content: Any, tmp_path: Path) -> None:
    file = tmp_path / "calibration.yaml"
    copy = yaml.safe_load(yaml.safe_dump(content))
    del copy["regions"]["turning"]
    file.write_text(yaml.safe_dump(copy), encoding="utf-8")
    regions = load_calibration(file).regions
    assert regions is not None
    assert (regions.turning, regions.scale) == (0.0, content["regions"]["scale"])


@pytest.mark.parametrize("radius", [1e308, 1e-308, 100.0])
def test_a_robot_that_is_no_pioneer_has_no_integers(content: Any, radius: float, tmp_path: Path) -> None:
    known = load_calibration(edited(content, ("vehicle", "wheel_radius"), radius, tmp_path / "calibration.yaml"))
    with pytest.raises(RequestError, match="is no Pioneer P3-AT"):
        export.text(known, "p3at")


def test_no_name_in_the_file_turns_the_text_of_who_shows_it(tmp_path: Path) -> None:
    """Marks of direction, of other planes, too, are told by their numbers; what people read stays as it is."""
    names = ("\u202egnp.yaml", "a\u2066b\u2069: - é \u200f 日本", "\U000e0041 \x9b tab\t", "plain")
    known = lab()[0]
    records = tuple(replace(known.provenance.drives[0], name=name, source=name) for name in names)
    warnings = (*known.warnings, f"{names[0]}: odd")
    odd = replace(known, warnings=warnings, provenance=replace(known.provenance, drives=records))
    text = calibration_text(odd)
    assert all(c == "\n" or printable(c) == c for c in text)
    assert "é" in text
    assert "日本" in text
    file = tmp_path / "calibration.yaml"
    file.write_text(text, encoding="utf-8")
    again = load_calibration(file)
    assert tuple(d.name for d in again.provenance.drives) == names
    assert again.warnings == warnings
