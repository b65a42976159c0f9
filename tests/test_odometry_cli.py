"""``skidsteer odometry`` as a user meets it, and evo reading what it writes."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from conftest import Run
from skidsteer.calibration import Calibration, Estimate, Provenance
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.identify.least_squares import fit
from skidsteer.io.calibration_file import save_calibration
from skidsteer.io.drives import load_drive
from skidsteer.io.folder import write_folder
from skidsteer.io.tum import read_tum, write_tum
from skidsteer.models import Icr, Model
from skidsteer.noise import Noise
from skidsteer.odometry.filters import FILTERS
from skidsteer.odometry.run import OdometryOptions, run
from skidsteer.samples import P3AT_LAG, P3AT_MOTION_NOISE, P3AT_TRUTH, sample
from skidsteer.se2 import compose
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Timing, increment_windows


def calibration(model: Model, covariance: np.ndarray, noise: Noise, timing: Timing, vehicle: Vehicle) -> Calibration:
    names = tuple(p.name for p in model.PARAMETERS)
    values = zip(names, model.theta, np.sqrt(np.diag(covariance)), strict=True)
    estimates = {name: Estimate(float(v), float(s), "") for name, v, s in values}
    estimates |= {"lag": Estimate(timing.lag, 0.0, "s"), "time_offset": Estimate(timing.time_offset, 0.0, "s")}
    P = np.zeros((len(names) + 2,) * 2)
    P[: len(names), : len(names)] = covariance
    return Calibration(
        vehicle, model, (*names, "lag", "time_offset"), estimates, P, noise, Provenance((), {}, "test", "")
    )


@pytest.fixture(scope="module")
def known() -> Calibration:
    """What a good calibration of the sample knows."""
    noise = Noise(0.01, float(np.radians(0.5)), 1e-3, *P3AT_MOTION_NOISE)
    truth = (P3AT_TRUTH, 0.003**2 * np.eye(5), noise, Timing(0.15, P3AT_LAG))
    return calibration(*truth, sample("p3at-mandow").vehicle)


@pytest.fixture(scope="module")
def short() -> Drive:
    return sample("p3at-mandow").between(0.0, 60.0)


@pytest.fixture(scope="module")
def files(known: Calibration, short: Drive, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Calibration, drive, and a folder to write to."""
    folder = tmp_path_factory.mktemp("odometry")
    save_calibration(known, folder / "calibration.yaml")
    write_folder(short, folder / "drive")
    return folder / "calibration.yaml", folder / "drive", folder


def evo(tool: str, *args: object) -> str:
    command = [str(Path(sys.executable).with_name(tool)), "tum", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout


def test_evo_reads_the_trajectory(run: Run, files: tuple[Path, Path, Path], short: Drive) -> None:
    """Absolute and relative pose errors against the reference, whose noise is 1 cm and 0.5 deg, as evo counts them."""
    calibration_file, drive, folder = files
    out, covariance = folder / "x.tum", folder / "x.csv"
    result = run("odometry", calibration_file, drive, "--out", out, "--covariance", covariance)
    assert result.returncode == 0, result.stderr
    assert "Reference: 300 taken, 0 refused (0 jumps followed)" in result.stdout
    assert short.pose is not None
    reference = folder / "reference.tum"
    write_tum(reference, short.pose.t - 0.15, short.pose.values)
    for tool, least, most in (("evo_ape", 0.005, 0.02), ("evo_rpe", 0.01, 0.03)):
        text = evo(
            tool, reference, out, "--t_max_diff", "0.006", "--save_results", folder / f"{tool}.zip", "--no_warnings"
        )
        assert "rmse" in text
        with zipfile.ZipFile(folder / f"{tool}.zip") as archive:
            rmse = json.loads(archive.read("stats.json"))["rmse"]
        assert least < rmse < most, (tool, rmse)
    track = read_tum(out)
    assert_allclose(track.t, short.wheels.t, atol=1e-9)
    table = np.loadtxt(covariance, delimiter=",", skiprows=1)
    assert covariance.read_text().startswith("t,xx,xy,xyaw,yy,yyaw,yawyaw\n")
    assert table.shape == (len(track), 7)
    assert (table[100:, [1, 4]] < 0.02**2).all()


def test_json_tells_what_was_taken_and_how_sure_the_end_is(run: Run, files: tuple[Path, Path, Path]) -> None:
    calibration_file, drive, folder = files
    result = run("odometry", calibration_file, drive, "--out", folder / "y.tum", "--lose-after", "30", "--json")
    document = json.loads(result.stdout)
    assert document["filter"].startswith("icr-")
    assert document["reference"]["accepted"] > 140
    assert 0.7 < document["reference"]["nis_per_dof"]["mean"] < 1.3
    assert document["since"] == 30.0
    assert 0.0 < document["distance_m"]["most"] < 0.15
    assert document["nominal_distance_m"]["most"] > 5.0 * document["distance_m"]["most"]
    assert set(document["last"]["mean"]) == {
        "x",
        "y",
        "yaw",
        "icr_y_left",
        "icr_y_right",
        "icr_x",
        "alpha_left",
        "alpha_right",
    }
    assert document["last"]["sigma"]["x"] > 0.005


@pytest.mark.parametrize("name", list(FILTERS))
def test_every_filter_makes_a_track(name: str, known: Calibration, short: Drive) -> None:
    drive = short.between(0.0, 30.0)
    result = run_of(known, drive, filter=name)
    assert len(result.trajectory.t) == len(drive.wheels)
    assert np.isfinite(result.trajectory.means).all()
    assert np.linalg.eigvalsh(result.trajectory.covariances).min() > 0.0
    assert result.distance is not None
    assert result.distance.rms < 0.1


@pytest.mark.parametrize("name", ["icr", "frozen", "extended"])
def test_the_bias_of_a_gyro_is_not_taken_for_turning(name: str, known: Calibration, short: Drive) -> None:
    """A gyro that tells 0.05 rad/s too much leaves a filter no farther off the track, once the reference is lost."""
    turn = known.model.twist(*short.wheels.values.T)[:, 2]
    drive = replace(short.between(0.0, 30.0), gyro=Series(short.wheels.t, turn[:, None] + 0.05, "gyro"))
    with_gyro, without = (run_of(known, drive, filter=name, lose_after=20.0, gyro=gyro) for gyro in (True, False))
    assert with_gyro.distance is not None
    assert without.distance is not None
    assert with_gyro.distance.most < 1.5 * without.distance.most


def run_of(known: Calibration, drive: Drive, **options: object):  # type: ignore[no-untyped-def]
    return run(known, drive, OdometryOptions(**options))  # type: ignore[arg-type]


def test_without_a_reference_it_reckons_from_the_origin(known: Calibration, short: Drive) -> None:
    alone = run_of(known, replace(short, pose=None))
    assert_allclose(alone.trajectory.poses[0], np.zeros(3), atol=0.0)
    assert alone.distance is None
    assert alone.trajectory.covariances[-1, 0, 0] > 1e-4
    ignored = run_of(known, short, reference=False)
    assert_allclose(ignored.trajectory.poses, alone.trajectory.poses, atol=0.0)
    assert ignored.distance is not None
    assert ignored.nominal is not None
    assert ignored.distance.most < 0.3 < ignored.nominal.most
    assert short.pose is not None
    elsewhere = compose([3.0, -2.0, 2.0], short.pose.values)
    turned = run_of(known, replace(short, pose=Series(short.pose.t, elsewhere)), reference=False)
    assert turned.distance.most == pytest.approx(ignored.distance.most, rel=1e-6)
    positions = replace(short, pose=None, position=Series(short.pose.t, elsewhere[:, :2]))
    assert run_of(known, positions, reference=False).distance.rms < 0.1


def test_smoothing_comes_closer(known: Calibration, short: Drive) -> None:
    forward, both = run_of(known, short), run_of(known, short, smooth=True)
    assert both.distance is not None
    assert forward.distance is not None
    middle = slice(500, 5000)
    assert (both.trajectory.covariances[middle, 0, 0] < forward.trajectory.covariances[middle, 0, 0]).mean() > 0.95


def test_the_delay_of_the_reference_is_found(known: Calibration, short: Drive) -> None:
    assert short.pose is not None
    later = replace(short, pose=Series(short.pose.t + 0.25, short.pose.values, "pose"))
    assert run_of(known, later, fit_delay=True).trajectory.squared.mean() < 3.6
    assert run_of(known, later).trajectory.squared.mean() > 6.0


def test_a_gyro_is_taken_where_there_is_one(known: Calibration, short: Drive) -> None:
    """A perfect gyro with a bias, 0.1 s late, against a calibration whose left ICR is off by 5 cm."""
    truth = run_of(known, short, reference=False).trajectory
    rate = np.gradient(truth.poses[:, 2], truth.t)[::5] + 0.004
    drive = replace(short, pose=None, gyro=Series(truth.t[::5] + 0.1, rate, "gyro"))
    wrong = replace(known, model=replace(P3AT_TRUTH, icr_y_left=0.2), covariance=_wider(known))
    with_gyro, without = run_of(wrong, drive), run_of(wrong, drive, gyro=False)
    miss = [np.abs(found.trajectory.poses[:, 2] - truth.poses[:, 2]).max() for found in (with_gyro, without)]
    assert miss[0] < 0.1 < 0.3 < miss[1]
    assert with_gyro.trajectory.last.mean[-1] == pytest.approx(0.004, abs=0.001)
    assert with_gyro.trajectory.rates[0] > 1000
    width = with_gyro.trajectory.last.mean[3] - with_gyro.trajectory.last.mean[4]
    assert width == pytest.approx(P3AT_TRUTH.icr_y_left - P3AT_TRUTH.icr_y_right, rel=0.05)


def _wider(known: Calibration) -> np.ndarray:
    P = known.covariance.copy()
    P[:5, :5] = 0.05**2 * np.eye(5)
    return P


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"filter": "kalman"}, "no filter 'kalman'; there are: icr, frozen"),
        ({"lose_after": -1.0}, "the reference is lost after a time of 0 s or more, got -1"),
        ({"lose_after": 1e9}, r"the reference is lost after 1e\+09 s, the drive lasts 60.0 s"),
        ({"filter": "frozen", "smooth": True}, "only the filter 'icr' can be smoothed"),
    ],
)
def test_requests_that_cannot_be_served(
    known: Calibration, short: Drive, options: dict[str, object], message: str
) -> None:
    with pytest.raises(RequestError, match=message):
        run_of(known, short, **options)


def test_drives_that_cannot_be_served(known: Calibration, short: Drive) -> None:
    windows = replace(short, segments=np.array([[1.0, 3.0], [5.0, 7.0]]))
    with pytest.raises(RequestError, match="is a set of separate windows"):
        run_of(known, windows)
    with pytest.raises(RequestError, match="a delay is fitted to reference poses, and it has none"):
        run_of(known, replace(short, pose=None), fit_delay=True)


def test_refusals_are_one_line(run: Run, files: tuple[Path, Path, Path]) -> None:
    calibration_file, drive, folder = files
    result = run("odometry", calibration_file, drive, "--out", folder / "z.tum", "--filter", "nothing")
    assert result.returncode == 1
    assert result.stdout == ""
    assert result.stderr.startswith("skidsteer: no filter 'nothing'; there are: icr")
    assert len(result.stderr.strip().splitlines()) == 1
    assert not (folder / "z.tum").exists()


def test_real_grass(real: Callable[[str], Path]) -> None:
    """Calibrated on one drive, lost for the last 100 s of another: a third of the nominal error at most."""
    a, b = load_drive(real("warthog-grass-a")), load_drive(real("warthog-grass-b"))
    found = fit(Icr.nominal(a.vehicle), [a], [increment_windows(a, 1.0)])
    on_grass = calibration(found.model, found.covariance[:5, :5], found.noise, found.timings[0], a.vehicle)
    result = run_of(on_grass, b, lose_after=218.0, fit_delay=True)
    assert result.distance is not None
    assert result.nominal is not None
    assert result.distance.most < 1.0
    assert result.distance.most < result.nominal.most / 3.0
