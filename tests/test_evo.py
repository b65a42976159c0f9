"""Trajectories as evo reads them, and errors as evo counts them: an independent tool that the field knows."""

from __future__ import annotations

import copy
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skidsteer.drive import Drive, Series
from skidsteer.io.tum import read_tum, write_tum
from skidsteer.metrics import aligned_rms, window_errors
from skidsteer.models import Icr
from skidsteer.odometry.reckoning import reckon
from skidsteer.odometry.run import distance
from skidsteer.se2 import FloatArray, compose, invert
from skidsteer.vehicle import preset
from skidsteer.windows import Timing

TRUTH = Icr(0.55, -0.60, -0.08, 0.95, 0.92)
BELIEVED = Icr(0.62, -0.57, 0.05, 0.97, 0.97)


@pytest.fixture(scope="module")
def evo() -> SimpleNamespace:
    """What is used of it; importing it warns of what is not ours."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        metrics = pytest.importorskip("evo.core.metrics")
        from evo.tools.file_interface import read_tum_trajectory_file, write_tum_trajectory_file
    return SimpleNamespace(metrics=metrics, read=read_tum_trajectory_file, write=write_tum_trajectory_file)


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Wheels at 50 Hz, noisy poses of the truth at 10 Hz, since 1970; the yaw turns many times round."""
    rng = np.random.default_rng(5)
    t = 1_700_000_000.0 + np.arange(3001) / 50.0
    phase = 0.13 * (t - t[0])
    rims = 0.5 + np.stack([0.5 * np.sin(phase), 0.4 * np.cos(1.7 * phase) + 0.3], axis=1)
    wheels = Series(t, rims, "wheels")
    poses = reckon(TRUTH, wheels, start=(3.0, -2.0, 2.5))[::5] + rng.normal(0.0, [0.02, 0.02, 0.01], (601, 3))
    return Drive("d", preset("husky-a200"), wheels, pose=Series(t[::5], poses, "pose"))


def written(evo: SimpleNamespace, path: Path, t: FloatArray, poses: FloatArray) -> Any:
    write_tum(path, t, poses)
    return evo.read(str(path))


def test_evo_reads_what_is_written_and_we_read_what_evo_writes(
    evo: SimpleNamespace, drive: Drive, tmp_path: Path
) -> None:
    assert drive.pose is not None
    track = written(evo, tmp_path / "ours.tum", drive.pose.t, drive.pose.values)
    assert track.check()[0]
    assert_allclose(track.timestamps, drive.pose.t, rtol=0.0, atol=1e-6)
    assert_allclose(track.positions_xyz[:, :2], drive.pose.values[:, :2], rtol=0.0, atol=1e-12)
    yaw = [np.arctan2(pose[1, 0], pose[0, 0]) for pose in track.poses_se3]
    assert_allclose(np.exp(1j * np.array(yaw)), np.exp(1j * drive.pose.values[:, 2]), atol=1e-12)
    evo.write(str(tmp_path / "evo.tum"), track)
    back = read_tum(tmp_path / "evo.tum")
    assert_allclose(back.t, drive.pose.t, rtol=0.0, atol=1e-6)
    assert_allclose(compose(invert(back.values), drive.pose.values)[:, :2], 0.0, atol=1e-9)
    assert_allclose(np.diff(back.values[:, 2]), np.diff(drive.pose.values[:, 2]), atol=1e-9)


def test_window_errors_are_relative_pose_errors(evo: SimpleNamespace, drive: Drive, tmp_path: Path) -> None:
    """Windows of 2 s are every 20 poses: each error in translation and yaw is evo's, in all that we count."""
    assert drive.pose is not None
    errors = window_errors(BELIEVED, drive, Timing(0.0, 0.0), 2.0)
    assert len(errors) == 30
    pair = (
        written(evo, tmp_path / "reference.tum", drive.pose.t, drive.pose.values),
        written(evo, tmp_path / "track.tum", drive.pose.t, reckon(BELIEVED, drive.wheels)[::5]),
    )
    for relation, ours in (
        (evo.metrics.PoseRelation.translation_part, errors.translation),
        (evo.metrics.PoseRelation.rotation_angle_rad, np.abs(errors.yaw)),
    ):
        theirs = evo.metrics.RPE(relation, 20, evo.metrics.Unit.frames, all_pairs=False)
        theirs.process_data(pair)
        assert_allclose(theirs.error, ours, rtol=0.0, atol=1e-7)
        assert ours.mean() > 0.01


def test_distance_from_the_reference_is_the_absolute_pose_error(
    evo: SimpleNamespace, drive: Drive, tmp_path: Path
) -> None:
    """As it lies, laid on the reference by the first pose, and by the best rigid motion."""
    assert drive.pose is not None
    seen, path = drive.pose.values, reckon(BELIEVED, drive.wheels)[::5]
    laid = compose(compose(seen[0], invert(path[0])), path)
    reference = written(evo, tmp_path / "reference.tum", drive.pose.t, seen)
    track = written(evo, tmp_path / "track.tum", drive.pose.t, path)

    def error(align: str | None, *arguments: Any) -> Any:
        moved, theirs = copy.deepcopy(track), evo.metrics.APE(evo.metrics.PoseRelation.translation_part)
        if align:
            getattr(moved, align)(*arguments)
        theirs.process_data((reference, moved))
        return theirs.get_all_statistics()

    for ours, theirs in (
        (distance(path[:, :2], seen[:, :2]), error(None)),
        (distance(laid[:, :2], seen[:, :2]), error("align_origin", reference)),
    ):
        assert (ours.rms, ours.most) == pytest.approx((theirs["rmse"], theirs["max"]), abs=1e-6)
    best = aligned_rms(path[:, :2], seen[:, :2])
    assert best == pytest.approx(error("align", reference)["rmse"], abs=1e-6)
    assert best < distance(laid[:, :2], seen[:, :2]).rms
