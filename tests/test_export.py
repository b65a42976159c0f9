"""What other software is told: the keys are its own, and its odometry is the one promised."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import skidsteer
from conftest import Call
from exports import HUSKY, ICR, made, parameters
from ros_controller import CONTROLLER_PARAMETERS, EKF_PARAMETERS
from skidsteer import export
from skidsteer.calibration import Calibration, HeldOut
from skidsteer.drive import Drive
from skidsteer.errors import RequestError
from skidsteer.export.covariances import UNMEASURED, covariances
from skidsteer.export.settings import TAKEN
from skidsteer.io.calibration_file import load_calibration, save_calibration
from skidsteer.metrics import Spread
from skidsteer.models import MODELS, Icr, Linear, ScheduledIcr, SymmetricIcr
from skidsteer.prediction import Regions
from skidsteer.samples import sample
from skidsteer.vehicle import preset


@pytest.fixture(scope="module")
def drive() -> Drive:
    return sample("p3at-mandow").between(0.0, 90.0)


@pytest.fixture(scope="module")
def calibrated(drive: Drive) -> Calibration:
    return skidsteer.calibrate(drive, model="icr")


# The keys


@pytest.mark.parametrize("frame", [None, "icr_link"])
def test_every_parameter_is_one_of_the_controller_and_of_its_type(frame: str | None) -> None:
    told = parameters(export.ros2_control(made(), export.Settings(icr_frame=frame)))
    for name, value in told.items():
        assert type(value) is CONTROLLER_PARAMETERS[name], name
    for name in ("pose_covariance_diagonal", "twist_covariance_diagonal"):
        diagonal = told[name]
        assert isinstance(diagonal, list)
        assert len(diagonal) == 6
        assert all(type(v) is float and 0.0 < v < math.inf for v in diagonal)


def test_every_parameter_is_one_of_the_filter_and_of_its_type() -> None:
    told = parameters(export.robot_localization(made()), "ekf_filter_node")
    for name, value in told.items():
        assert type(value) is EKF_PARAMETERS[name], name


def test_the_filter_takes_velocities_only() -> None:
    told = parameters(export.robot_localization(made(), export.Settings(controller="base")), "ekf_filter_node")
    order = ["x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "vroll", "vpitch", "vyaw", "ax", "ay", "az"]
    fused = {
        key: [n for n, yes in zip(order, told[key], strict=True) if yes] for key in ("odom0_config", "imu0_config")
    }  # type: ignore[call-overload]
    assert fused == {"odom0_config": ["vx", "vy", "vyaw"], "imu0_config": ["vyaw"]}
    assert told["two_d_mode"] is True
    assert told["odom0_differential"] is False
    assert told["odom0"] == "base/odom"


def test_without_a_gyro_there_is_none_to_fuse(calibrated: Calibration) -> None:
    assert "imu0" not in parameters(export.robot_localization(calibrated), "ekf_filter_node")


# Covariances


def test_twist_covariance_by_hand() -> None:
    """0.05^2 m * 0.5 m/s * 50 Hz = 0.0625, and (0.05 m * 0.4 rad/s)^2 = 0.0004 of the lever arm's y beside it.

    The yaw's grows along what the sides roll apart, half the width times the yaw rate, and a tenth of the rest.
    """
    where = replace(export.force(made()).projection, rim_speed=0.5, yaw_rate=0.4)
    told = covariances(made(), where, 50.0, of_icr=False)
    assert_allclose(told.twist[:2], [0.0625 + 0.0004, 0.0625 + (0.08 * 0.4) ** 2], rtol=1e-6)
    apart = 0.5 * 0.4 * where.multipliers.separation
    assert 0.1 < apart < 0.4
    assert told.twist[5] == pytest.approx(0.04**2 * (apart + 0.1 * (0.5 - apart)) * 50.0)
    assert told.twist[2:5] == (UNMEASURED,) * 3
    assert covariances(made(), where, 50.0, of_icr=True).twist[0] == pytest.approx(0.0625)


def test_twist_covariance_is_that_of_the_random_walk_at_any_rate() -> None:
    """Integrated as a filter does, independent errors of that variance spread as far as the noise model says."""
    where = export.force(made()).projection
    rng = np.random.default_rng(8)
    for rate in (10.0, 100.0):
        variance = covariances(made(), where, rate, of_icr=True).twist[0]
        steps_ = int(10.0 * rate)
        ends = (rng.normal(0.0, math.sqrt(variance), (4000, steps_)) / rate).sum(axis=1)
        assert np.var(ends) == pytest.approx(0.05**2 * where.rim_speed * 10.0, rel=0.08)


def test_a_gyro_alone_does_not_tell_that_the_wheels_turn_without_error() -> None:
    """0.003^2 rad^2 a second that wheels and gyro differ by: at 50 Hz, and after 10 m at 0.5 m/s, beside the walk."""
    nothing, some = Spread(math.nan, math.nan, math.nan), Spread(1.0, 1.4, 3.0)
    alone = replace(made(), held_out={"icr": HeldOut(100, nothing, nothing, some)})
    where = replace(export.force(made()).projection, rim_speed=0.5)
    plain, told = (covariances(c, where, 50.0, of_icr=True) for c in (made(), alone))
    assert told.twist[5] - plain.twist[5] == pytest.approx(0.003**2 * 50.0)
    assert told.pose[5] - plain.pose[5] == pytest.approx(0.003**2 * 20.0)
    assert (told.twist[:5], told.pose[:5]) == (plain.twist[:5], plain.pose[:5])
    assert "no other reference" in " ".join(export.robot_localization(alone).split())
    assert "whether wheels or gyro erred" in " ".join(export.ros2_control(alone).replace("#", "").split())


def test_covariances_are_raised_to_what_held_out_windows_show() -> None:
    """A Gaussian of twice the covariance: regions with scale 2 and many degrees of freedom."""
    wide = replace(made(), regions=Regions(2.0, 1e4))
    where = export.force(made()).projection
    plain, raised = (covariances(c, where, 50.0, of_icr=True) for c in (made(), wide))
    assert raised.raised == pytest.approx(2.0, rel=1e-3)
    assert_allclose(np.array(raised.pose)[[0, 1, 5]], 2.0 * np.array(plain.pose)[[0, 1, 5]], rtol=1e-3)


def test_what_turns_are_off_by_adds_up_to_the_same_after_a_window() -> None:
    """In the yaw only: 3 % of what is turned in the 2 s of a judging window, of twice the variance; not straight on."""
    where = replace(export.force(made()).projection, yaw_rate=0.7)
    regions = Regions(2.0, 1e4)
    plain, lasting = (
        covariances(replace(made(), regions=r), where, 50.0, of_icr=True)
        for r in (regions, replace(regions, turning=0.03))
    )
    added = np.array(lasting.twist) - plain.twist
    assert_allclose(added[:5], 0.0)
    assert added[5] / 50.0 * 2.0 == pytest.approx(2.0 * (0.03 * 0.7 * 2.0) ** 2)
    assert (lasting.pose, lasting.raised) == (plain.pose, plain.raised)


# Names


NASTY = [
    "a: b",
    "x\ny: 1",
    "# no",
    "'",
    '"',
    "a\u2028b: {c: d}",
    "\ud800",
    "日本",
    "<script>",
    "\x07",
    "- a",
    "true",
    "1.0",
    "~",
]


@settings(deadline=None)
@given(st.one_of(st.sampled_from(NASTY), st.text(min_size=1)))
def test_no_name_breaks_the_yaml(name: str) -> None:
    vehicle, frame = replace(HUSKY, name=name), "".join(name.split()).lstrip("/")
    if not (frame.isprintable() and frame) or frame in TAKEN:
        with pytest.raises(RequestError, match="--icr-frame"):
            export.Settings(icr_frame=frame)
        frame = "1e5:{"
    names = export.Settings(controller="base", icr_frame=frame)
    calibration = made(vehicle=vehicle, names=(name, name))
    for text in (export.ros2_control(calibration, names), export.robot_localization(calibration, names)):
        content = yaml.safe_load(text)
        ((key, inside),) = content.items()
        assert key in ("base", "ekf_filter_node")
        assert list(inside) == ["ros__parameters"]
        assert set(inside["ros__parameters"]) <= {*CONTROLLER_PARAMETERS, *EKF_PARAMETERS}
    assert json.loads(export.as_json(calibration))["vehicle"]["name"] == name


@pytest.mark.parametrize(
    "name",
    [
        "a b: c",
        "2wheels",
        "husky/",
        "//husky",
        "husky//base",
        "ns/2base",
        "r\u00f6ver",
        "a-b",
        "~base",
        "/",
        "/**",
        "a.b",
    ],
)
def test_names_that_ros_refuses_are_refused(name: str) -> None:
    for option in ("controller", "imu_topic"):
        with pytest.raises(RequestError, match=r"that a ROS (node|topic) can have; use letters"):
            export.Settings(**{option: name})


@pytest.mark.parametrize("name", ["base", "/husky/base", "_base", "ns_1/base2", "a" * 255])
def test_names_that_ros_takes_are_taken(name: str) -> None:
    text = export.ros2_control(made(), export.Settings(controller=name, imu_topic="~/" + name[:200]))
    assert list(yaml.safe_load(text)) == [name]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("/icr_link", "begin with /"),
        ("icr link", "no space"),
        ("base_link", "a name of its own"),
        ("odom", "a name of its own"),
        ("i" * 256, "up to 255"),
    ],
)
def test_frames_that_tf2_refuses_are_refused(name: str, message: str) -> None:
    with pytest.raises(RequestError, match=message):
        export.Settings(icr_frame=name)


# The Pioneer, JSON, files


def test_a_circle_test_is_told_with_its_assumptions() -> None:
    """It holds no errors to show, and its noise is assumed."""
    text = export.ros2_control(replace(made(SymmetricIcr(0.5, 1.0)), warnings=("circle runs tell no noise",)))
    assert "# Note: circle runs tell no noise.\n" in text
    assert "The errors that are left were not measured" in text
    assert "--child-frame-id icr_link" in export.ros2_control(
        made(SymmetricIcr(0.5, 1.0)), export.Settings(icr_frame="icr_link")
    )


def test_integers_of_a_p3at() -> None:
    """Mandow 2007, Table I, 20 psi: mean alpha 0.916, x_ICR (0.2553 + 0.3071) / 2 = 0.2812 m."""
    model = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)
    text = export.p3at(made(model, preset("pioneer-p3at")))
    told = dict(line.split() for line in text.splitlines() if not line.startswith("#"))
    ticks = round(138 / 0.916)
    assert told == {"Ticksmm": str(ticks), "Revcount": str(round(2.0 * math.pi * 281.2 * ticks / 8))}
    assert f"by {math.degrees((0.9049 - 0.9271) / 0.5624):.2f} deg in each metre" in text


def test_json_holds_the_model() -> None:
    content = json.loads(export.as_json(made()))
    rims = np.array([0.3, 0.5])
    assert_allclose(np.array(content["matrix"]) @ rims, ICR.twist(*rims))
    assert content["parameters"]["icr_x"] == {"value": -0.08, "sigma": 0.01, "unit": "m", "determined": True}
    assert content["multipliers"]["of_point_m"] == pytest.approx([-0.08, 0.05])
    assert content["lag_s"] == 0.1


@pytest.mark.parametrize("name", MODELS)
def test_every_model_has_every_format(name: str) -> None:
    calibration = made(MODELS[name].nominal(HUSKY))
    for kind in export.FORMATS:
        assert export.text(calibration, kind)


def test_what_no_controller_can_is_refused_and_left_out() -> None:
    calibration = made(Linear(0.5, 0.5, 0.0, 0.0, 1.0, 2.0))
    with pytest.raises(RequestError, match="the linear model cannot be told by multipliers"):
        export.ros2_control(calibration)
    assert set(export.texts(calibration).values()) == {None}


def test_the_calibration_file_keeps_what_the_controller_loses(calibrated: Calibration, tmp_path: Path) -> None:
    save_calibration(calibrated, tmp_path / "calibration.yaml")
    assert load_calibration(tmp_path / "calibration.yaml").controller == calibrated.controller
    assert calibrated.controller is not None


def test_a_scheduled_model_is_forced_over_the_motions_of_its_drives(drive: Drive) -> None:
    model = ScheduledIcr(0.26, -0.30, -0.01, 0.93, 0.90, 0.5, 0.1, 0.3, 0.0, 0.0)
    calibration = made(model, preset("pioneer-p3at"))
    usual, driven = export.force(calibration), export.force(calibration, [drive])
    assert usual.motions == "all motions up to 0.345 m/s"
    assert driven.motions == "the motions of p3at-mandow"
    assert driven.projection != usual.projection


def test_files_that_fit_stand_beside_a_calibration(calibrated: Calibration) -> None:
    files = export.texts(calibrated)
    assert [name for name, content in files.items() if content] == [
        "ros2_control.yaml",
        "ekf.yaml",
        "p3at.txt",
        "model.json",
    ]
    husky = export.texts(replace(calibrated, vehicle=HUSKY, controller=None))
    assert [name for name, content in husky.items() if content is None] == ["ros1_control.yaml", "p3at.txt"]


@pytest.fixture
def file(calibrated: Calibration, tmp_path: Path) -> Path:
    save_calibration(calibrated, tmp_path / "calibration.yaml")
    return tmp_path / "calibration.yaml"


@pytest.mark.parametrize("kind", export.FORMATS)
def test_command_prints_or_writes_the_same(file: Path, kind: str, call: Call) -> None:
    code, printed, err = call("export", file, "--to", kind)
    assert (code, err) == (0, "")
    out = file.parent / "made"
    assert call("export", file, "--to", kind, "--out", out)[0] == 0
    assert out.read_text(encoding="utf-8") == printed == export.text(load_calibration(file), kind)


def test_command_measures_on_drives(file: Path, drive: Drive, call: Call) -> None:
    code, printed, _ = call(
        "export", file, "sample:p3at-mandow", "--to", "ros2-control", "--controller", "base", "--rate", 20
    )
    assert code == 0
    assert "windows of 2 s of p3at-mandow" in printed
    assert parameters(printed, "base")["publish_rate"] == 20.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "ros1"], "no format 'ros1'; there are: ros2-control, ros1-control, robot-localization, p3at, json"),
        (["--to", "json", "--profile", "mud"], "no profile 'mud'; the calibration has none"),
        (["--to", "json", "--rate", "nan"], "--rate must be a positive number of messages a second, got nan"),
        (
            ["--to", "ros2-control", "--controller", "a b: c"],
            "--controller 'a b: c' is no name that a ROS node can have",
        ),
        (["--to", "json", "--controller", " "], "--controller must be a name on one line that is not empty, got ' '"),
        (["nowhere", "--to", "json"], "nowhere: no such"),
        (["--to", "json", "--out", "missing/made.json"], "there is no folder"),
    ],
)
def test_refusals_are_one_line_and_leave_nothing(
    file: Path, words: list[str], message: str, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(file.parent)
    before = sorted(file.parent.rglob("*"))
    code, out, err = call("export", file, *words)
    assert (code, out, len(err.splitlines())) == (1, "", 1)
    assert message in err
    assert sorted(file.parent.rglob("*")) == before


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("skidsteer_calibration: 1", "skidsteer_calibration: 7", "a calibration file of version '7'"),
        ("  name: icr\n", "  name: hovercraft\n", "no model 'hovercraft'"),
        ("wheel_separation_multiplier: 1", "wheel_separation_multiplier: -1", "wheel_separation_multiplier > 0"),
    ],
)
def test_calibrations_of_another_kind_are_refused(file: Path, old: str, new: str, message: str, call: Call) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")
    code, out, err = call("export", file, "--to", "ros2-control", "--out", file.parent / "made.yaml")
    assert (code, out, len(err.splitlines())) == (1, "", 1)
    assert message in err
    assert not (file.parent / "made.yaml").exists()
