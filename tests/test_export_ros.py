"""Exports as ROS itself reads them: the types that ROS 2's parser gives, and the parameter server of ROS 1."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from exports import HUSKY, made
from ros_controller import CONTROLLER_PARAMETERS, EKF_PARAMETERS
from ros_parameters import parameter_types, type_of
from skidsteer import export
from skidsteer.export.settings import TOPIC
from skidsteer.models import MODELS, Icr, SymmetricIcr
from skidsteer.vehicle import PRESETS, preset

SYSTEM_PYTHON = "/usr/bin/python3"
LISTS = {
    "pose_covariance_diagonal": [float],
    "twist_covariance_diagonal": [float],
    "odom0_config": [bool],
    "imu0_config": [bool],
}
ROUND = Icr(1.0, -1.0, 0.0, 1.0, 1.0)  # whole numbers, which a careless writer writes as integers


def assert_declared(told: dict[str, Any], declared: dict[str, type]) -> None:
    assert told
    for name, kind in told.items():
        assert kind == LISTS.get(name, declared[name]), (name, kind)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("1.0", float),
        ("1.0e-05", float),
        ("1e5", float),
        ("1000000.0", float),
        ("inf", float),
        (".5", float),
        ("1", int),
        ("-010", int),
        ("0x1F", int),
        ("09", float),
        ("y", bool),
        ("Off", bool),
        ("'y'", str),
        ('"1"', str),
        ("oN", str),
        ("base_link", str),
        ("1_0", str),
        ("1.0.0", str),
    ],
)
def test_the_types_that_ros_gives(text: str, kind: type) -> None:
    scalar = next(event for event in yaml.parse(text, Loader=yaml.CSafeLoader) if isinstance(event, yaml.ScalarEvent))
    assert type_of(scalar) is kind


@pytest.mark.parametrize("frame", [None, "icr_link"])
@pytest.mark.parametrize("name", [*MODELS, "round"])
def test_no_parameter_of_the_controller_has_another_type_than_it_declares(name: str, frame: str | None) -> None:
    model = ROUND if name == "round" else MODELS[name].nominal(HUSKY)
    told = parameter_types(export.ros2_control(made(model), export.Settings(rate=20, icr_frame=frame)))
    assert list(told) == ["diff_drive_controller"]
    assert_declared(told["diff_drive_controller"], CONTROLLER_PARAMETERS)


@pytest.mark.parametrize("name", PRESETS)
def test_no_robot_makes_another_type(name: str) -> None:
    told = parameter_types(export.ros2_control(made(SymmetricIcr(1.0, 1.0), preset(name))))
    assert_declared(told["diff_drive_controller"], CONTROLLER_PARAMETERS)


def test_no_parameter_of_the_filter_has_another_type_than_it_declares() -> None:
    told = parameter_types(export.robot_localization(made(), export.Settings(rate=30)))
    assert list(told) == ["ekf_filter_node"]
    assert_declared(told["ekf_filter_node"], EKF_PARAMETERS)


@settings(deadline=None)
@given(
    st.one_of(
        st.sampled_from(["y", "N", "on", "1e5", "017", "0x1p3", "inf", "-INF", "nan", ".5", "1.", "null", "~", "#a"]),
        st.text(st.characters(codec="ascii", categories=("L", "N", "P")), min_size=1, max_size=6),
    )
)
def test_a_name_stays_a_text(name: str) -> None:
    """ROS takes ``y`` for a bool and ``1e5`` for a number, where YAML has texts."""
    names = export.Settings(controller="base", icr_frame=name if name[0] != "/" else None)
    assert parameter_types(export.ros2_control(made(), names))["base"].get("base_frame_id", str) is str
    topic = name if TOPIC.fullmatch(name) else "nan"
    filtered = export.robot_localization(made(), export.Settings(controller="base", imu_topic=topic))
    told = parameter_types(filtered)["ekf_filter_node"]
    assert (told["imu0"], told["odom0"]) == (str, str)
    assert yaml.safe_load(filtered)["ekf_filter_node"]["ros__parameters"]["imu0"] == topic


# ROS 1


def test_ros1_is_told_the_same_numbers_without_the_key_of_ros2() -> None:
    """The controller's sources name and multiply them alike; only the key between differs, and the joints' names."""
    chosen = export.Settings(controller="husky_velocity_controller", icr_frame="icr_link")
    one, two = (yaml.safe_load(f(made(), chosen)) for f in (export.ros1_control, export.ros2_control))
    assert one["husky_velocity_controller"] == two["husky_velocity_controller"]["ros__parameters"]
    text = export.ros1_control(made(), chosen)
    where = export.force(made()).projection
    assert (
        f"#   rosrun tf2_ros static_transform_publisher {where.x:.4f} {where.y:.4f} 0 0 0 0 base_link icr_link" in text
    )
    assert "Take wheel_radius_multiplier out" in " ".join(text.replace("#", "").split())
    assert "left_wheel_names" not in text
    assert "--to ros1-control` measures" in " ".join(text.replace("#", "").split())


ASK = """
import sys, rosparam
(values, namespace), = rosparam.load_file(sys.argv[1], default_namespace="/")
inside = values["husky_velocity_controller"]
for name, value in inside.items():
    print(name, type(value).__name__, *(type(v).__name__ for v in (value if isinstance(value, list) else ())))
"""


def has_rosparam() -> bool:
    try:
        return subprocess.run([SYSTEM_PYTHON, "-c", "import rosparam"], capture_output=True, timeout=60).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


@pytest.mark.skipif(not has_rosparam(), reason="Debian's python3-rosparam is not installed")
def test_rosparam_reads_doubles_where_the_controller_insists_on_them(tmp_path: Path) -> None:
    """The controller of ROS 1 stops at a covariance that is no double."""
    text = export.ros1_control(made(ROUND), export.Settings(controller="husky_velocity_controller", rate=20))
    (tmp_path / "c.yaml").write_text(text)
    command = [SYSTEM_PYTHON, "-c", ASK, str(tmp_path / "c.yaml")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    told = {name: kinds for name, *kinds in map(str.split, printed.splitlines())}
    for name, (kind, *items) in told.items():
        assert kind == CONTROLLER_PARAMETERS[name].__name__, name
        assert items == ["float"] * 6 * (kind == "list"), name
    assert {"pose_covariance_diagonal", "wheel_separation_multiplier"} <= set(told)
