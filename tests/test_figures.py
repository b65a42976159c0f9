from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from conftest import Call
from skidsteer.calibration import Calibration
from skidsteer.drive import Drive
from skidsteer.errors import RequestError
from skidsteer.figures.catalogue import FIGURES, write_figure
from skidsteer.figures.material import Material, held_out, parse_part, parted
from skidsteer.figures.observed import binned, coefficient, icrs, observe, scale
from skidsteer.figures.trajectory import reckoned
from skidsteer.identify.calibrate import CalibrateOptions, calibrate
from skidsteer.io.calibration_file import save_calibration
from skidsteer.io.folder import write_folder
from skidsteer.models import Differential, Icr, SymmetricIcr
from skidsteer.report.reckoner import Reckoner
from skidsteer.samples import P3AT_TRUTH, sample

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def drive() -> Drive:
    return sample("p3at-mandow").between(0.0, 60.0)


@pytest.fixture(scope="module")
def material(drive: Drive) -> Material:
    return Material(calibrate(drive, options=CalibrateOptions(model="icr")), (drive,))


@pytest.fixture(scope="module")
def known(material: Material) -> tuple[Reckoner, ...]:
    return material.reckoners("x")


def test_the_drive_that_was_fitted_is_held_out(material: Material, known: tuple[Reckoner, ...]) -> None:
    assert known[0].is_held_out
    assert held_out(known) == ", held out"
    seen = observe(known, material)
    assert_allclose(seen.translation, known[0].errors(2.0).translation)
    assert held_out([replace(known[0], parts=known[0].parts[:1])]) == ""


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_drawn_and_is_the_same_every_time(
    name: str, material: Material, known: tuple[Reckoner, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Material, "reckoners", lambda *_: known)  # without fitting them again
    write_figure(name, material, tmp_path / "a.svg")
    write_figure(name, material, tmp_path / "b.svg")
    text = (tmp_path / "a.svg").read_text()
    assert text == (tmp_path / "b.svg").read_text()
    assert "<dc:date>" not in text
    width = float(text.split('width="')[1].split("pt")[0]) / 72.0 * 25.4
    assert width == pytest.approx(88.0, abs=0.1) or width == pytest.approx(180.0, abs=0.1)


def test_png_too(material: Material, tmp_path: Path) -> None:
    write_figure("robot-icrs", material, tmp_path / "a.PNG")
    assert (tmp_path / "a.PNG").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(RequestError, match=r"written as \.svg or \.png"):
        write_figure("robot-icrs", material, tmp_path / "a.pdf")


def test_what_is_missing_is_told(material: Material, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RequestError, match="no figure 'nothing'; there are: robot-icrs, trajectory"):
        write_figure("nothing", material, tmp_path / "a.svg")
    with pytest.raises(RequestError, match="'trajectory' shows a drive with reference poses: give one with --drive"):
        write_figure("trajectory", replace(material, drives=()), tmp_path / "a.svg")
    bare: Calibration = replace(material.calibration, held_out={}, regions=None)
    for name in ("models", "coverage"):
        with pytest.raises(RequestError, match=f"'{name}' .* calibrate a longer drive"):
            write_figure(name, replace(material, calibration=bare), tmp_path / "a.svg")
    straight = replace(material, drives=(material.drives[0].between(2.0, 9.0),))
    with pytest.raises(RequestError, match="no window of 2 s in which the robot turns by 10 deg"):
        write_figure("chi-lambda", straight, tmp_path / "a.svg")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(RequestError, match=r"pip install 'skidsteer\[figures\]'"):
        write_figure("robot-icrs", material, tmp_path / "a.svg")
    assert not list(tmp_path.iterdir())


def test_windows_tell_the_icrs_they_were_made_with(material: Material, drive: Drive) -> None:
    """The plant is the model, so that what is read off the windows is its truth but for noise."""
    truth = replace(material.calibration, model=P3AT_TRUTH)
    exact = replace(material, calibration=truth, drives=(replace(drive, name="another"),))
    (known,) = exact.reckoners("x")
    seen = observe([known], exact, turning=True)
    for twist, noise in ((seen.predicted, 0.002), (seen.measured, 0.02)):
        assert_allclose(np.median(icrs(seen.rims, twist, P3AT_TRUTH), axis=0), [-0.0120, 0.2553, -0.3071], atol=noise)
    chi = coefficient(seen.rims, seen.measured[:, 2], P3AT_TRUTH, 0.4)
    assert np.median(chi) == pytest.approx((0.2553 + 0.3071) / 0.4, rel=0.02)


def test_icrs_by_hand() -> None:
    """Rims 0.2 and 0.4, alpha 0.5 each, turn at 0.1 / 0.5 rad/s: y = (v_x - alpha V) / omega."""
    model = Icr(0.3, -0.2, 0.05, 0.5, 0.5)
    rims, twist = np.array([[0.2, 0.4]]), model.twist([0.2], [0.4])
    assert_allclose(scale(model), 0.5)
    assert_allclose(icrs(rims, twist, model), [[0.05, 0.3, -0.2]])
    assert_allclose(coefficient(rims, twist[:, 2], model, 0.25), 2.0)
    assert_allclose(scale(SymmetricIcr(0.3, 0.9)), 0.9)
    assert_allclose(scale(Differential(0.4)), 1.0)


def test_lambda_is_infinite_straight_on(material: Material, known: tuple[Reckoner, ...]) -> None:
    seen = observe(known, material)
    straight = replace(seen, rims=np.tile([0.3, 0.3], (len(seen.rims), 1)))
    assert np.isinf(straight.path_curvature).all()
    assert replace(seen, rims=np.array([[0.1, 0.3]])).path_curvature == pytest.approx(2.0)


def test_bins_hold_equal_numbers() -> None:
    x = np.arange(40.0)[::-1]
    found = binned(x, 2.0 * x, least=10)
    assert_allclose(found.x, [4.5, 14.5, 24.5, 34.5])
    assert_allclose(found.median, 2.0 * found.x)
    assert (found.low < found.median).all()
    assert len(binned(x[:3], x[:3]).x) == 1


def test_dead_reckoning_begins_anew(drive: Drive, known: tuple[Reckoner, ...]) -> None:
    once, often = reckoned(known[0], 0.0), reckoned(known[0], 10.0)
    assert (len(once.lines), len(often.lines)) == (1, 6)
    assert often.off < once.off
    nominal = reckoned(known[0], 0.0, Differential.nominal(drive.vehicle))
    assert nominal.off > 10.0 * once.off
    assert drive.pose is not None
    assert_allclose(often.lines[1][0], often.reference[1][0])
    assert_allclose(often.reference[-1][-1], drive.pose.values[-1])


def test_a_part_is_shown_and_the_rest_calibrates(drive: Drive) -> None:
    shown, rest = parted([drive], *parse_part("20,40"))
    assert [d.span for d in shown] == [pytest.approx((20.0, 40.0), abs=0.02)]
    assert shown[0].name == "p3at-mandow, 20 to 40 s"  # so that it does not pass for what the calibration was made from
    assert {d.name for d in rest} == {"p3at-mandow"}
    assert [round(end) for d in rest for end in d.span] == [0, 20, 40, 60]
    for text, message in (("20", "two times A,B"), ("a,b", "two times A,B")):
        with pytest.raises(RequestError, match=message):
            parse_part(text)
    with pytest.raises(RequestError, match="from an earlier to a later time"):
        parted([drive], 40.0, 20.0)
    with pytest.raises(RequestError, match=r"does not move inside of 0 to 0\.5 s"):
        parted([drive], 0.0, 0.5)
    with pytest.raises(RequestError, match="does not move outside of 0 to 60 s"):
        parted([drive], 0.0, 60.0)


def test_the_command(material: Material, drive: Drive, call: Call, tmp_path: Path) -> None:
    code, out, _ = call("figure", "list")
    assert code == 0
    assert [line.split(":")[0] for line in out.splitlines()] == list(FIGURES)
    save_calibration(material.calibration, tmp_path / "c.yaml")
    write_folder(drive, tmp_path / "drive")
    given = ("--calibration", tmp_path / "c.yaml")
    code, out, err = call("figure", "trajectory", *given, "--drive", tmp_path / "drive", "--out", tmp_path / "t.svg")
    assert (code, err) == (0, "")
    assert (tmp_path / "t.svg").exists()
    for words, message in (
        (("figure", "nothing"), "skidsteer: no figure 'nothing'; there are:"),
        (("figure", "models"), "skidsteer: give --calibration FILE, --drive DRIVE or both"),
        (("figure", "models", "--out", "a.gif", *given), "skidsteer: a.gif: a figure is written as .svg or .png"),
        (("figure", "robot-icrs", *given, "--out", tmp_path / "no" / "a.svg"), "there is no folder"),
    ):
        code, out, err = call(*words)
        assert (code, out) == (1, "")
        assert message in err
