"""``vehicle.yaml``: the fields of a `Vehicle`, and where an antenna sits on it, as lines of ``key: value``."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, FiniteFloat, ValidationError

from skidsteer.errors import DataError, RequestError
from skidsteer.io.text_file import decode, read_bytes, short
from skidsteer.vehicle import Vehicle, preset

LARGEST = 1 << 20  # [bytes] that a vehicle file may have
WIDEST = 10.0  # [m] no robot that skids is larger
Antenna = tuple[float, float]  # [m] ahead and left of the middle of the robot


class VehicleFile(BaseModel):
    """The types of the fields of `Vehicle`; what is credible is checked there."""

    model_config = ConfigDict(extra="forbid", strict=True)

    name: str
    track_width: float
    wheel_radius: float
    wheels: int = 4
    wheel_base: float | None = None
    mass: float | None = None
    ticks_per_revolution: float | None = None
    max_wheel_speed: float | None = None
    factory_separation: float | None = None
    factory_multiplier: float | None = None
    source: str = ""


class EquippedFile(VehicleFile):
    """A vehicle and the place of an antenna on it [m]."""

    antenna_x: FiniteFloat | None = None
    antenna_y: FiniteFloat | None = None


def read_vehicle(path: str | os.PathLike[str]) -> Vehicle:
    """Read a vehicle from a YAML file whose keys are the fields of `Vehicle`; an unknown key is an error.

    Raises:
        DataError: no such file, or its content is not a vehicle.
    """
    return parse_vehicle(path, read_bytes(path, LARGEST))


def parse_vehicle(path: str | os.PathLike[str], data: bytes) -> Vehicle:
    """The vehicle in the content of a YAML file; ``path`` is for the messages.

    Raises:
        DataError: the content is not a vehicle.
    """
    measures = _validated(path, data).model_dump(exclude={"antenna_x", "antenna_y"})
    for key in ("track_width", "wheel_radius"):
        if measures[key] > WIDEST:
            raise DataError(f"{path}: {key} is {measures[key]:g} m; is it in mm?")
    try:
        return Vehicle(**measures)
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error


def parse_antenna(path: str | os.PathLike[str], data: bytes) -> Antenna | None:
    """Where the antenna sits by the keys ``antenna_x`` and ``antenna_y`` of a vehicle's YAML file; None: not told.

    Raises:
        DataError: the content is not a vehicle, or only one of the keys is there.
    """
    file = _validated(path, data)
    if file.antenna_x is None and file.antenna_y is None:
        return None
    if file.antenna_x is None or file.antenna_y is None:
        raise DataError(f"{path}: antenna_x and antenna_y belong together; give both in m, ahead and left")
    return file.antenna_x, file.antenna_y


def _validated(path: str | os.PathLike[str], data: bytes) -> EquippedFile:
    content = _parse_flat_yaml(path, decode(path, data))
    try:
        return EquippedFile.model_validate(content)
    except ValidationError as error:
        raise DataError(f"{path}: {_first_fault(error)}") from error


def vehicle(name_or_path: str | os.PathLike[str]) -> Vehicle:
    """The preset of that name, or else the vehicle in that YAML file.

    Raises:
        RequestError: neither a preset nor a file; the message lists the presets.
        DataError: the file is not a vehicle.
    """
    text = os.fspath(name_or_path)
    if Path(text).suffix.lower() in (".yaml", ".yml"):
        return read_vehicle(text)
    try:
        return preset(text)
    except RequestError:
        if os.path.exists(text):
            return read_vehicle(text)
        raise


def vehicle_text(vehicle: Vehicle, antenna: Antenna | None = None) -> str:
    """The YAML of all that is known of a vehicle, and of an antenna on it; it reads back to the last bit."""
    place = {} if antenna is None else dict(zip(("antenna_x", "antenna_y"), antenna, strict=True))
    content = {key: _plain(value) for key, value in (asdict(vehicle) | place).items() if value is not None}
    text: str = yaml.safe_dump(content, sort_keys=False, width=1000)
    return "# m, kg, m/s\n" + text


def _plain(value: object) -> object:
    """The Python number of a NumPy one, which YAML cannot write."""
    return value.item() if isinstance(value, np.generic) else value


def _parse_flat_yaml(path: str | os.PathLike[str], text: str) -> dict[str, Any]:
    try:
        _refuse_unless_flat(path, yaml.compose(text, Loader=yaml.SafeLoader))
        content: dict[str, Any] = yaml.safe_load(text)
        return content
    except DataError:
        raise
    except yaml.MarkedYAMLError as error:
        where = f" line {error.problem_mark.line + 1}:" if error.problem_mark else ""
        raise DataError(f"{path}:{where} not readable as YAML: {' '.join(str(error.problem).split())}") from error
    except Exception as error:  # the parser raises errors of many types on odd tags, digits and control characters
        raise DataError(f"{path}: not readable as YAML: {short(str(error))}") from error


def _refuse_unless_flat(path: str | os.PathLike[str], node: yaml.Node | None) -> None:
    """Without nesting, aliases cannot make a small file large."""
    if not isinstance(node, yaml.MappingNode):
        raise DataError(f"{path}: needs lines of 'key: value', such as 'track_width: 0.55'")
    seen: set[str] = set()
    for key, value in node.value:
        where = f"{path}: line {key.start_mark.line + 1}"
        if not (isinstance(key, yaml.ScalarNode) and isinstance(value, yaml.ScalarNode)):
            raise DataError(f"{where}: each key needs one plain value, such as 'track_width: 0.55'")
        if key.value in seen:
            raise DataError(f"{where}: the key {short(key.value)} is there twice; keep one")
        seen.add(key.value)


def _first_fault(error: ValidationError) -> str:
    fault = error.errors(include_url=False)[0]
    key = short(str(fault["loc"][0]))
    if fault["type"] == "missing":
        return f"the key {key} is missing"
    if fault["type"] == "extra_forbidden":
        return f"unknown key {key}; the keys are: {', '.join(EquippedFile.model_fields)}"
    return f"the key {key} has the value {short(str(fault['input']))}, {fault['msg'].lower()}"
