"""``calibration.yaml``: a `Calibration` as YAML that reads back exactly, to the last bit and word."""

from __future__ import annotations

import os
from dataclasses import asdict, fields, replace
from typing import Annotated, Any

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skidsteer.calibration import (
    Calibration,
    Controller,
    DriveRecord,
    Estimate,
    HeldOut,
    MotionSigma,
    Observability,
    Provenance,
    WeakDirection,
)
from skidsteer.errors import DataError, printable
from skidsteer.io.atomic import write_text
from skidsteer.io.text_file import decode, read_bytes
from skidsteer.io.vehicle_file import VehicleFile
from skidsteer.metrics import Spread
from skidsteer.models import MODELS
from skidsteer.multipliers import Multipliers, Projection
from skidsteer.noise import Noise
from skidsteer.prediction import Regions
from skidsteer.vehicle import Vehicle

SCHEMA = 1
FILE = "calibration.yaml"
LARGEST = 16 << 20  # [bytes]

_Finite = Annotated[float, Field(gt=-1e12, lt=1e12)]  # neither NaN nor a number whose square is none; years in s fit
_Positive = Annotated[float, Field(gt=0.0, lt=1e12)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _Estimate(_Strict):
    value: _Finite
    sigma: _Finite
    unit: str
    determined: bool


class _Model(_Strict):
    name: str
    fixed: dict[str, _Finite]
    parameters: dict[str, _Estimate]


class _Covariance(_Strict):
    names: list[str]
    rows: list[list[_Finite]]


class _Noise(_Strict):
    position: _Finite
    yaw: _Finite
    stamp: _Finite
    walk: _Finite
    turn: _Finite
    gyro: _Finite


class _Spread(_Strict):
    median: float
    rms: float
    p95: float


class _HeldOut(_Strict):
    windows: int
    translation_m: _Spread
    yaw_deg: _Spread
    yaw_gyro_deg: _Spread | None = None
    coverage_68: float | None = None
    coverage_95: float | None = None
    median_95: dict[str, tuple[float, float]] | None = None


class _Regions(_Strict):
    scale: _Positive
    dof: _Positive
    turning: Annotated[float, Field(ge=0.0, lt=1e3)] = 0.0


class _MotionSigma(_Strict):
    motion: str
    sigma: float
    tolerance: float
    unit: str


class _WeakDirection(_Strict):
    known: _MotionSigma
    change: dict[str, float]


class _Observability(_Strict):
    model: str
    determined: dict[str, float]
    undetermined: dict[str, float]
    motions: list[_MotionSigma]
    weak: list[_WeakDirection]
    advice: list[str]


class _Multipliers(_Strict):
    left_wheel_radius_multiplier: _Finite
    right_wheel_radius_multiplier: _Finite
    wheel_separation_multiplier: _Finite
    track_width: _Finite


class _Projection(_Strict):
    multipliers: _Multipliers
    x: _Finite
    y: _Finite
    rim_speed: _Positive
    yaw_rate: _Finite


class _Controller(_Strict):
    projection: _Projection
    held_out: _HeldOut | None = None


class _DriveRecord(_Strict):
    name: str
    source: str
    sha256: str
    duration: float
    windows: int
    outliers: int


class _Provenance(_Strict):
    software: str
    created: str
    drives: list[_DriveRecord]
    options: dict[str, str | bool | int | float | None]


class _Body(_Strict):
    """The layout of a calibration; what a number means stands with the field of the same name in the values."""

    vehicle: VehicleFile
    model: _Model
    nuisance: dict[str, _Estimate]
    covariance: _Covariance
    noise: _Noise
    method: str
    selected_because: str
    warnings: list[str]
    held_out: dict[str, _HeldOut]
    regions: _Regions | None = None
    observability: _Observability | None = None
    controller: _Controller | None = None
    provenance: _Provenance


class _File(_Body):
    skidsteer_calibration: int
    profiles: dict[str, _Body] = {}


def save_calibration(calibration: Calibration, path: str | os.PathLike[str]) -> None:
    """Write a calibration as YAML, all of it or nothing.

    Raises:
        DataError: the file cannot be written.
    """
    write_text(path, calibration_text(calibration))


def calibration_text(calibration: Calibration) -> str:
    """The content of ``calibration.yaml``."""
    content = {"skidsteer_calibration": SCHEMA, **_content(calibration)}
    if calibration.profiles:
        content["profiles"] = {name: _content(profile) for name, profile in calibration.profiles.items()}
    text: str = yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
    return "".join(c if c == "\n" or printable(c) == c else f"\\U{ord(c):08X}" for c in text)


class _Dumper(yaml.SafeDumper):
    """Puts text in double quotes where a character of it is to be told by its number, or it would turn the rest."""


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if printable(text) == text else '"')


_Dumper.add_representer(str, _text)


def _content(calibration: Calibration) -> dict[str, Any]:
    model, provenance = calibration.model, calibration.provenance
    own = {p.name for p in model.PARAMETERS}
    return {
        "vehicle": asdict(calibration.vehicle),
        "model": {
            "name": model.NAME,
            "fixed": {name: value for name, value in asdict(model).items() if name not in own},
            "parameters": {name: asdict(e) for name, e in calibration.parameters.items()},
        },
        "nuisance": {name: asdict(e) for name, e in calibration.nuisance.items()},
        "covariance": {"names": list(calibration.names), "rows": calibration.covariance.tolist()},
        "noise": asdict(calibration.noise),
        "method": calibration.method,
        "selected_because": calibration.selected_because,
        "warnings": list(calibration.warnings),
        "held_out": {name: _plain(_without_none(asdict(h))) for name, h in calibration.held_out.items()},
        "regions": None if calibration.regions is None else asdict(calibration.regions),
        "observability": None if calibration.observability is None else _plain(asdict(calibration.observability)),
        "controller": None if calibration.controller is None else _controller_content(calibration.controller),
        "provenance": {
            "software": provenance.software,
            "created": provenance.created,
            "drives": [asdict(d) for d in provenance.drives],
            "options": dict(provenance.options),
        },
    }


def _controller_content(controller: Controller) -> dict[str, Any]:
    held_out = None if controller.held_out is None else _plain(_without_none(asdict(controller.held_out)))
    return {"projection": asdict(controller.projection), "held_out": held_out}


def _plain(content: Any) -> Any:
    """The same with lists for tuples, which YAML cannot tell."""
    if isinstance(content, dict):
        return {key: _plain(value) for key, value in content.items()}
    return [_plain(value) for value in content] if isinstance(content, tuple) else content


def _without_none(content: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in content.items() if value is not None}


def load_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration from its file, or from the folder that ``calibrate --out`` wrote it to.

    Raises:
        DataError: no such file, not YAML, not a calibration, of another version, or with values that cannot be.
    """
    if os.path.isdir(path):
        path = _in_folder(path)
    content = _parse(path, decode(path, read_bytes(path, LARGEST)))
    version = content.get("skidsteer_calibration")
    if version != SCHEMA:
        found = "no version" if version is None else f"version {str(version)[:20]!r}"
        raise DataError(f"{path}: a calibration file of {found}, this software reads version {SCHEMA}; calibrate again")
    try:
        file = _File.model_validate(content)
        return replace(_calibration(file), profiles={name: _calibration(body) for name, body in file.profiles.items()})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise DataError(f"{path}: {where}: {first['msg']}") from error
    except (ValueError, TypeError) as error:
        raise DataError(f"{path}: {error}") from error


def _in_folder(folder: str | os.PathLike[str]) -> str:
    path = os.path.join(folder, FILE)
    if not os.path.lexists(path):
        is_drive = os.path.lexists(os.path.join(folder, "wheels.csv"))
        what = "is a drive, and a calibration is wanted here" if is_drive else f"holds no {FILE}"
        raise DataError(f"{folder}: {what}; make one with `skidsteer calibrate DRIVE --out DIR`")
    return path


def _parse(path: str | os.PathLike[str], text: str) -> dict[str, Any]:
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark is not None else ""
        problem = str(getattr(error, "problem", None) or "not plain data").splitlines()[0]
        raise DataError(f"{path}: is not YAML of plain values{where}: {problem}") from error
    if not isinstance(content, dict):
        raise DataError(f"{path}: is not a calibration file; make one with `skidsteer calibrate DRIVE --out DIR`")
    return content


def _calibration(file: _Body) -> Calibration:
    if file.model.name not in MODELS:
        raise ValueError(f"model.name: no model '{file.model.name}'; there are: {', '.join(MODELS)}")
    values = {name: e.value for name, e in file.model.parameters.items()}
    wanted = [f.name for f in fields(MODELS[file.model.name])]
    if sorted(values | file.model.fixed) != sorted(wanted):
        given = ", ".join([*values, *file.model.fixed])
        raise ValueError(f"model: {file.model.name} takes {', '.join(wanted)}; got {given}; calibrate again")
    estimates = {
        name: Estimate(e.value, e.sigma, e.unit, e.determined)
        for name, e in (file.model.parameters | file.nuisance).items()
    }
    _refuse_unphysical(estimates, file.covariance)
    return Calibration(
        vehicle=Vehicle(**file.vehicle.model_dump()),
        model=MODELS[file.model.name](**values, **file.model.fixed),
        names=tuple(file.covariance.names),
        estimates=estimates,
        covariance=np.array(file.covariance.rows, dtype=float).reshape(len(estimates), -1),
        noise=Noise(**file.noise.model_dump()),
        provenance=Provenance(
            tuple(DriveRecord(**d.model_dump()) for d in file.provenance.drives),
            file.provenance.options,
            file.provenance.software,
            file.provenance.created,
        ),
        method=file.method,
        selected_because=file.selected_because,
        warnings=tuple(file.warnings),
        held_out={name: _held_out(h) for name, h in file.held_out.items()},
        regions=None if file.regions is None else Regions(**file.regions.model_dump()),
        observability=None if file.observability is None else _observability(file.observability),
        controller=None if file.controller is None else _controller(file.controller),
    )


def _controller(file: _Controller) -> Controller:
    known = file.projection
    multipliers = Multipliers(**known.multipliers.model_dump())
    projection = Projection(multipliers, known.x, known.y, known.rim_speed, known.yaw_rate)
    return Controller(projection, None if file.held_out is None else _held_out(file.held_out))


def _observability(file: _Observability) -> Observability:
    return Observability(
        model=file.model,
        determined=file.determined,
        undetermined=file.undetermined,
        motions=tuple(MotionSigma(**m.model_dump()) for m in file.motions),
        weak=tuple(WeakDirection(MotionSigma(**w.known.model_dump()), w.change) for w in file.weak),
        advice=tuple(file.advice),
    )


def _refuse_unphysical(estimates: dict[str, Estimate], covariance: _Covariance) -> None:
    for name, e in estimates.items():
        if not (np.isfinite(e.value) and np.isfinite(e.sigma) and e.sigma >= 0):
            raise ValueError(f"{name}: value and sigma must be finite and sigma not negative")
        if name == "lag" and e.value < 0.0:
            raise ValueError(f"lag: must not be negative, got {e.value} s")
    rows = covariance.rows
    if any(len(row) != len(rows) for row in rows):
        raise ValueError("covariance.rows: must be square")
    matrix = np.array(rows, dtype=float).reshape(len(rows), len(rows))
    if not (np.isfinite(matrix).all() and np.allclose(matrix, matrix.T) and (np.diag(matrix) >= 0).all()):
        raise ValueError("covariance.rows: must be finite, symmetric and not negative on the diagonal")


def _held_out(file: _HeldOut) -> HeldOut:
    gyro = None if file.yaw_gyro_deg is None else Spread(**file.yaw_gyro_deg.model_dump())
    spreads = Spread(**file.translation_m.model_dump()), Spread(**file.yaw_deg.model_dump()), gyro
    return HeldOut(file.windows, *spreads, file.coverage_68, file.coverage_95, file.median_95)
