from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skidsteer.errors import DataError, RequestError
from skidsteer.io.vehicle_file import (
    WIDEST,
    VehicleFile,
    parse_antenna,
    parse_vehicle,
    read_vehicle,
    vehicle,
    vehicle_text,
)
from skidsteer.vehicle import PRESETS, Vehicle, preset

GOOD = "name: mine\ntrack_width: 0.55  # m\nwheel_radius: 0.165\n"

positive = st.floats(min_value=0.0, exclude_min=True, allow_infinity=False)
vehicles = st.builds(
    Vehicle,
    name=st.text(),
    track_width=positive.filter(lambda width: width <= WIDEST),
    wheel_radius=positive.filter(lambda radius: radius <= WIDEST),
    wheels=st.integers(2, 1000),
    wheel_base=st.none() | positive,
    mass=st.none() | positive,
    factory_multiplier=st.none() | positive,
    source=st.text(),
)


@given(vehicles)
def test_writing_then_reading_is_exact(robot: Vehicle) -> None:
    assert parse_vehicle("vehicle.yaml", vehicle_text(robot).encode()) == robot


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_presets_survive_a_file(tmp_path: Path, name: str) -> None:
    (tmp_path / "robot.yaml").write_text(vehicle_text(preset(name)))
    assert read_vehicle(tmp_path / "robot.yaml") == preset(name)


def test_writes_numpy_numbers() -> None:
    robot = Vehicle("mine", float(np.float64(0.1)), np.float64(0.2), np.int64(6))  # type: ignore[arg-type]
    assert parse_vehicle("", vehicle_text(robot).encode()) == Vehicle("mine", 0.1, 0.2, 6)


def test_file_has_the_fields_of_a_vehicle() -> None:
    assert list(VehicleFile.model_fields) == [field.name for field in fields(Vehicle)]


@given(vehicles, st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)))
def test_the_place_of_an_antenna_is_kept_beside_the_vehicle(robot: Vehicle, place: tuple[float, float]) -> None:
    text = vehicle_text(robot, place).encode()
    assert parse_antenna("vehicle.yaml", text) == place
    assert parse_vehicle("vehicle.yaml", text) == robot
    assert parse_antenna("vehicle.yaml", vehicle_text(robot).encode()) is None


def test_half_a_place_is_none() -> None:
    with pytest.raises(DataError, match="antenna_x and antenna_y belong together"):
        parse_antenna("vehicle.yaml", (GOOD + "antenna_x: 0.4\n").encode())


def test_reads_what_users_write() -> None:
    assert parse_vehicle("vehicle.yaml", GOOD.encode()) == Vehicle("mine", 0.55, 0.165)
    assert parse_vehicle("vehicle.yaml", b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode()).name == "mine"
    assert parse_vehicle("vehicle.yaml", (GOOD + "wheels: 6\nmass: 50\n").encode()).mass == 50.0


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "needs lines of 'key: value', such as 'track_width: 0.55'"),
        ("# nothing\n", "needs lines of 'key: value'"),
        ("- 1\n- 2\n", "needs lines of 'key: value'"),
        ("just words", "needs lines of 'key: value'"),
        ("name: mine\n", "the key 'track_width' is missing"),
        (GOOD + "colour: red\n", "unknown key 'colour'; the keys are: name, track_width, .*source"),
        (GOOD + "1: red\n", "the key '1' has the value '1', "),
        (GOOD + "mass: -5\n", "vehicle mass must be a positive number, got -5.0"),
        (GOOD + "mass: .nan\n", "vehicle mass must be a positive number, got nan"),
        (GOOD + "mass: heavy\n", "the key 'mass' has the value 'heavy', input should be a valid number"),
        (GOOD + "mass: yes\n", "the key 'mass' has the value 'True', input should be a valid number"),
        (GOOD + "mass: 2020-01-01\n", "the key 'mass' has the value '2020-01-01', input should be a valid number"),
        (GOOD + "antenna_x: .inf\n", "the key 'antenna_x' has the value 'inf', input should be a finite number"),
        ("name: mine\ntrack_width: 550\nwheel_radius: 165\n", "track_width is 550 m; is it in mm?"),
        ("name: mine\ntrack_width: 0.55\nwheel_radius: 165\n", "wheel_radius is 165 m; is it in mm?"),
        (GOOD + "wheels: 1\n", "vehicle wheels must be at least 2, got 1"),
        (GOOD + "wheels: 4.5\n", "the key 'wheels' has the value '4.5', input should be a valid integer"),
        (GOOD + "name: other\n", "line 4: the key 'name' is there twice; keep one"),
        (GOOD + "source: [a, b]\n", "line 4: each key needs one plain value"),
        (GOOD + "? [a, b]\n: 1\n", "line 4: each key needs one plain value"),
        (GOOD + "source: !!python/object/apply:os.system ['true']\n", "line 4: each key needs one plain value"),
        (GOOD + "source: !!python/name:os.system\n", "line 4: not readable as YAML: could not determine a constructor"),
        (GOOD + "source: *name\n", "line 4: not readable as YAML: found undefined alias"),
        (GOOD + "source: 'open\n", "not readable as YAML: found unexpected end of stream"),
        (GOOD + "---\n" + GOOD, "line 4: not readable as YAML: but found another document"),
        (GOOD + "mass: !!float ''\n", "not readable as YAML: "),
        (GOOD + "mass: 2020-99-99\n", "not readable as YAML: 'month must be in 1..12'"),
        (GOOD + "mass: 1" + "0" * 5000 + "\n", "not readable as YAML: "),
        (GOOD + "mass: 1" + "0" * 400 + "\n", "the key 'mass' has the value '1000|mass must be a positive"),
        (GOOD + "mass: \x07\n", "not readable as YAML: "),
        ("[" * 20_000, "not readable as YAML: "),
        ("a: &a [x]\nb: &b {<<: [*a, *a]}\n", "line 1: each key needs one plain value"),
    ],
)
def test_names_the_fault_in_one_line(text: str, fault: str) -> None:
    with pytest.raises(DataError, match=rf"^vehicle.yaml: .*({fault})") as caught:
        parse_vehicle("vehicle.yaml", text.encode())
    assert str(caught.value).isprintable()


def test_does_not_read_a_large_or_a_binary_file(tmp_path: Path) -> None:
    (tmp_path / "large.yaml").write_bytes(b"#" * 2_000_000)
    (tmp_path / "binary.yaml").write_bytes(b"\0\1\2")
    (tmp_path / "latin.yaml").write_bytes(b"name: mine\nsource: M\xfcller\n")
    with pytest.raises(DataError, match=r"large.yaml: is larger than 1048576 bytes"):
        read_vehicle(tmp_path / "large.yaml")
    with pytest.raises(DataError, match=r"binary.yaml: is binary"):
        read_vehicle(tmp_path / "binary.yaml")
    with pytest.raises(DataError, match=r"latin.yaml: line 2 is not UTF-8 text"):
        read_vehicle(tmp_path / "latin.yaml")


def test_vehicle_is_a_preset_or_a_file(tmp_path: Path) -> None:
    for name in ("robot.yaml", "plain"):
        (tmp_path / name).write_text(GOOD)
        assert vehicle(tmp_path / name) == vehicle(str(tmp_path / name)) == Vehicle("mine", 0.55, 0.165)
    assert vehicle("pioneer-p3at") is PRESETS["pioneer-p3at"]
    with pytest.raises(RequestError, match=r"no vehicle preset 'pionier'; there are: .*pioneer-p3at"):
        vehicle("pionier")
    with pytest.raises(DataError, match=r"missing\.yaml: no such file"):
        vehicle(tmp_path / "missing.yaml")
    with pytest.raises(DataError, match="is a folder, not a file"):
        vehicle(tmp_path)
