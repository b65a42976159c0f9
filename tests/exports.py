"""Calibrations to export, and how what is written is read back."""

from __future__ import annotations

import re

import numpy as np
import yaml

from skidsteer.calibration import Calibration, DriveRecord, Estimate, Provenance
from skidsteer.models import Icr, Model
from skidsteer.noise import Noise
from skidsteer.vehicle import Vehicle, preset

HUSKY = preset("husky-a200")
ICR = Icr(0.60, -0.50, -0.08, 0.95, 0.92)
NOISE = Noise(walk=0.05, turn=0.04, gyro=0.003)


def made(model: Model = ICR, vehicle: Vehicle = HUSKY, names: tuple[str, ...] = ("morning",)) -> Calibration:
    """A calibration as if it had been found."""
    own = {p.name: Estimate(float(v), 0.01, p.unit) for p, v in zip(model.PARAMETERS, model.theta, strict=True)}
    estimates = {**own, "lag": Estimate(0.1, 0.01, "s"), "gyro_bias": Estimate(0.001, 0.001, "rad/s")}
    drives = tuple(DriveRecord(name, name, "", 60.0, 100, 0) for name in names)
    return Calibration(
        vehicle,
        model,
        tuple(estimates),
        estimates,
        1e-4 * np.eye(len(estimates)),
        NOISE,
        Provenance(drives, {"window": 2.0}, "skidsteer", "today"),
    )


def parameters(text: str, node: str = "diff_drive_controller") -> dict[str, object]:
    content = yaml.safe_load(text)
    assert list(content) == [node]
    assert list(content[node]) == ["ros__parameters"]
    return dict(content[node]["ros__parameters"])


def rms_of(text: str, row: str) -> tuple[float, float]:
    """RMS errors [m], [deg] that a row of the comment states."""
    found = re.search(rf"^#   {row} +([\d.]+) m +([\d.]+) deg", text, re.MULTILINE)
    assert found, text
    return float(found[1]), float(found[2])
