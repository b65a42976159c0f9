"""One drive, every container: the calibration does not depend on how the log was kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bag_files import write_bag
from conftest import Run
from skidsteer.drive import Drive, Series
from skidsteer.identify.calibrate import CalibrateOptions, calibrate
from skidsteer.io.drives import load_drive
from skidsteer.io.folder import write_folder
from skidsteer.samples import sample


def on_nanoseconds(series: Series | None) -> Series | None:
    """Stamps that a header can hold exactly."""
    return None if series is None else Series(np.round(series.t * 1e9) / 1e9, series.values, series.name)


@pytest.fixture(scope="module")
def drive() -> Drive:
    minute = sample("p3at-mandow").between(0.0, 60.0)
    return replace(minute, wheels=on_nanoseconds(minute.wheels), pose=on_nanoseconds(minute.pose))


@pytest.fixture(scope="module")
def from_folder(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    path = tmp_path_factory.mktemp("folder") / "drive"
    write_folder(drive, path)
    return estimates(load_drive(path))


def estimates(drive: Drive) -> np.ndarray:
    found = calibrate(drive, options=CalibrateOptions(model="icr", spacing=0.0))
    return np.array([[e.value, e.sigma] for e in found.estimates.values()])


@pytest.mark.parametrize("kind", ["rosbag1", "sqlite3", "mcap"])
def test_the_same_drive_gives_the_same_calibration(
    kind: str, drive: Drive, from_folder: np.ndarray, tmp_path: Path
) -> None:
    path = write_bag(drive, tmp_path / "drive", kind)
    assert_allclose(estimates(load_drive(path, drive.vehicle)), from_folder, rtol=1e-9, atol=1e-9)


def test_the_command_line_reads_a_bag_and_says_what_it_took(drive: Drive, tmp_path: Path, run: Run) -> None:
    path = write_bag(drive, tmp_path / "drive", "mcap")
    result = run("calibrate", path, "--vehicle", "pioneer-p3at", "--model", "multiplier", "--json")
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["model"] == "multiplier"
    assert "joint_states" in result.stderr
    bare = run("calibrate", path)
    assert bare.returncode == 1
    assert "--vehicle" in bare.stderr
