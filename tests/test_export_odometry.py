"""The controller that is configured by an export moves as was promised, and loses what the comment says."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import skidsteer
from exports import HUSKY, ICR, made, parameters, rms_of
from ros_controller import Controller
from skidsteer import export
from skidsteer.calibration import Calibration, HeldOut
from skidsteer.drive import Drive, Series
from skidsteer.evaluation import fit_offset
from skidsteer.identify.as_controller import as_controller
from skidsteer.identify.holdout import held_out
from skidsteer.identify.start import FitOptions
from skidsteer.models import Icr, Model, SymmetricIcr
from skidsteer.multipliers import usual_rims
from skidsteer.samples import P3AT_TRUTH, sample
from skidsteer.se2 import compose
from skidsteer.windows import Timing, Windows, judging_windows, steps


@pytest.fixture(scope="module")
def drive() -> Drive:
    return sample("p3at-mandow").between(0.0, 90.0)


@pytest.fixture(scope="module")
def calibrated(drive: Drive) -> Calibration:
    return skidsteer.calibrate(drive, model="icr")


@pytest.mark.parametrize("feedback", ["position", "velocity"])
@pytest.mark.parametrize("model", [SymmetricIcr(0.53, 0.94), ICR])
def test_the_controller_moves_as_the_point_of_the_model_that_was_promised(model: Model, feedback: str) -> None:
    """Held speeds, one after the other; the point's own path by the model, through the poses of the robot."""
    calibration = made(model)
    told = parameters(export.ros2_control(calibration))
    where = export.force(calibration).projection
    controller, angles = Controller(told), np.zeros(2)
    robot, lever = np.zeros(3), np.array([where.x, where.y, 0.0])
    start = compose(robot, lever)
    rng = np.random.default_rng(4)
    for rims in rng.uniform(-1.0, 1.0, (200, 2)):
        twist, dt = model.twist(*rims), float(rng.uniform(0.01, 0.1))
        robot = compose(robot, skidsteer.se2.exp(twist * dt))
        rates = rims / HUSKY.wheel_radius
        angles += rates * dt
        if feedback == "position":
            controller.position_feedback(*angles, dt)
        else:
            controller.velocity_feedback(*rates, dt)
        assert controller.angular == pytest.approx(float(twist[2]), rel=1e-4, abs=1e-5)
    point = compose(robot, lever)
    assert_allclose([controller.x, controller.y], (point - start)[:2], atol=2e-3)  # six digits were written
    assert controller.heading == pytest.approx(point[2], abs=1e-3)


def test_a_symmetric_model_loses_nothing() -> None:
    calibration = made(SymmetricIcr(0.53, 0.94))
    where, text = export.force(calibration).projection, export.ros2_control(calibration)
    assert_allclose([where.x, where.y], 0.0, atol=1e-12)
    assert "Nothing of the model is lost" in text
    controller = Controller(parameters(text))
    assert controller.separation == pytest.approx(1.06)
    assert controller.left_radius / HUSKY.wheel_radius == pytest.approx(0.94)


def test_what_the_drives_did_not_tell_is_said(drive: Drive) -> None:
    """A gyro alone: no figure of positions, and no claim of what it cost to leave them out."""
    blind = replace(drive, pose=None, gyro=skidsteer.drive.Series(drive.pose.t, gyro_of(drive), "gyro"))  # type: ignore[union-attr]
    text = export.ros2_control(skidsteer.calibrate(blind, model="multiplier"))
    plain = " ".join(line.lstrip("# ") for line in text.splitlines())
    assert "alpha_left, alpha_right and every translation are not observable" in plain
    assert "No reference told positions: that part is an assumption" in plain
    assert re.search(r"#   these multipliers +[\d.]+ deg against the gyro\n", text)
    assert all(np.isfinite(parameters(text)["twist_covariance_diagonal"]))  # type: ignore[arg-type]


def gyro_of(drive: Drive) -> np.ndarray:
    """Yaw rates (n, 1) [rad/s] that the reference's poses tell."""
    assert drive.pose is not None
    return np.gradient(np.unwrap(drive.pose.values[:, 2]), drive.pose.t)[:, None]


def test_the_separation_is_the_one_of_the_robot_s_own_files() -> None:
    """A Husky is described with 0.555 m and 1.875, though its wheels are 0.5708 m apart."""
    told = parameters(export.ros2_control(made()))
    assert told["wheel_separation"] == 0.555
    assert told["wheel_separation_multiplier"] == pytest.approx(1.1 / 0.555, rel=1e-5)
    assert told["wheel_radius"] == 0.1651


def test_commands_turn_the_robot_as_asked() -> None:
    controller = Controller(parameters(export.ros2_control(made())))
    for linear, angular in ((0.5, 0.0), (0.0, 1.0), (0.4, -0.7)):
        rims = np.array(controller.command(linear, angular)) * HUSKY.wheel_radius
        twist = ICR.twist(*rims)
        assert twist[2] == pytest.approx(angular, abs=1e-5)
        assert twist[0] - 0.05 * twist[2] == pytest.approx(linear, abs=1e-5)  # of the point 0.05 m to the left


def end_errors(told: Mapping[str, Any], drive: Drive, windows: Windows, timing: Timing) -> np.ndarray:
    """End errors (k, 2) [m], [deg] of a controller with these parameters, started anew in each window."""
    cut = steps(drive.wheels, windows, timing)
    errors = []
    for i, measured in enumerate(windows.motion):
        controller = Controller(told)
        part = slice(cut.offsets[i], cut.offsets[i + 1])
        rolled = np.cumsum(cut.distance[part], axis=0)
        for angle, dt in zip(rolled / drive.vehicle.wheel_radius, cut.duration[part], strict=True):
            controller.position_feedback(*angle, max(dt, 1e-9))
        turned = (controller.heading - measured[2] + math.pi) % (2.0 * math.pi) - math.pi
        errors.append((math.hypot(controller.x - measured[0], controller.y - measured[1]), math.degrees(turned)))
    return np.array(errors)


def rms_by_the_controller(text: str, calibration: Calibration, drive: Drive) -> tuple[float, float]:
    timing = replace(calibration.timing, time_offset=fit_offset(calibration, drive))
    errors = end_errors(parameters(text), drive, judging_windows(drive, 2.0), timing)
    distance, yaw = np.sqrt(np.mean(errors**2, axis=0)).tolist()
    return distance, yaw


def test_held_out_figures_are_those_of_controllers_that_did_not_see_the_windows(drive: Drive) -> None:
    """Each half of the blocks by a controller that is configured from a fit to the other half."""
    judged = held_out(Icr.nominal(drive.vehicle), [drive], FitOptions())
    assert judged is not None
    found = as_controller(P3AT_TRUTH, [drive], judged, 2.0)
    windows, errors = judging_windows(drive, 2.0), []
    for fold, fitted in enumerate(judged.folds.fits):
        first, last = judged.folds.block(0, windows.start), judged.folds.block(0, windows.end - 1e-9)
        told = parameters(export.ros2_control(made(fitted.model, drive.vehicle)))
        unseen = windows.where((first == last) & (first % 2 == fold))
        errors.append(end_errors(told, drive, unseen, fitted.timings[0]))
    distance, yaw = np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))
    assert found is not None
    assert found.held_out is not None
    assert found.held_out.windows == sum(map(len, errors))
    assert found.held_out.translation_m.rms == pytest.approx(distance, rel=1e-3)
    assert found.held_out.yaw_deg.rms == pytest.approx(yaw, rel=1e-3)
    assert found.held_out.translation_m.rms > 1.1 * HeldOut.of(judged.errors).translation_m.rms


def test_what_is_lost_is_what_the_controller_loses(calibrated: Calibration, drive: Drive) -> None:
    """The comment's figures for the multipliers, by the controller itself."""
    text = export.ros2_control(calibrated, forced=export.force(calibrated, [drive]))
    distance, yaw = rms_by_the_controller(text, calibrated, drive)
    assert rms_of(text, "these multipliers") == (pytest.approx(distance, abs=6e-4), pytest.approx(yaw, abs=6e-3))
    assert rms_of(text, "these multipliers")[0] > rms_of(text, "the icr model")[0]


def test_what_is_lost_on_a_real_drive(real: skidsteer.Drive) -> None:
    drive = skidsteer.load_drive(real("warthog-asphalt"))  # type: ignore[operator]
    calibration = skidsteer.calibrate(drive, model="icr")
    text = export.ros2_control(calibration, forced=export.force(calibration, [drive]))
    distance, yaw = rms_by_the_controller(text, calibration, drive)
    assert rms_of(text, "these multipliers") == (pytest.approx(distance, abs=6e-4), pytest.approx(yaw, abs=6e-3))
    text = export.ros2_control(calibration)
    nominal, forced, model = (rms_of(text, r) for r in ("nominal, no multiplier", "these multipliers", "the icr model"))
    assert calibration.controller is not None
    assert calibration.controller.held_out is not None
    assert forced[0] == pytest.approx(calibration.controller.held_out.translation_m.rms, abs=6e-4)
    assert nominal[0] > 2.0 * forced[0] > 2.0 * model[0]
    assert nominal[1] > 5.0 * forced[1]
    figures = [*(calibration.held_out[name] for name in ("differential", "multiplier", "icr"))]
    assert readme_table() == [told(h) for h in (*figures, calibration.controller.held_out)]


def told(figures: HeldOut) -> tuple[str, str, str]:
    assert figures.yaw_gyro_deg is not None
    rms = (f"{figures.translation_m.rms:.3f} m", f"{figures.yaw_deg.rms:.1f} deg")
    return (*rms, f"{figures.yaw_gyro_deg.median:.1f} deg")


def readme_table() -> list[tuple[str, ...]]:
    """Figures of the first table of the README: of this very drive."""
    text = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [^|]+ \| ([\d.]+ m) \| ([\d.]+ deg) \| ([\d.]+ deg) \|$", text, re.MULTILINE)
    return rows[:4]


def test_a_frame_at_the_icr_gives_the_lost_velocity_back() -> None:
    """robot_localization adds r x omega for the place r of the odometry's frame (ros_filter.cpp, prepareTwist)."""
    text = export.ros2_control(made(), export.Settings(icr_frame="icr_link"))
    told = parameters(text)
    assert told["base_frame_id"] == "icr_link"
    assert told["enable_odom_tf"] is False
    found = re.search(r"--x (\S+) --y (\S+) --frame-id base_link --child-frame-id icr_link$", text, re.MULTILINE)
    assert found
    x, y = float(found[1]), float(found[2])
    controller = Controller(told)
    for rims in usual_rims(1.0):
        controller.velocity_feedback(*(rims / HUSKY.wheel_radius), 0.02)
        regained = [controller.linear + y * controller.angular, -x * controller.angular, controller.angular]
        assert_allclose(regained, ICR.twist(*rims), atol=2e-4)


def test_another_recording_s_delay_is_no_error_of_the_robot(calibrated: Calibration, drive: Drive) -> None:
    """Its reference is stamped 0.4 s later: the figures stay, but for windows at the ends."""
    assert drive.pose is not None
    late = replace(drive, pose=Series(drive.pose.t + 0.4, drive.pose.values, "pose"))
    measured = [export.force(calibrated, [d]).measured for d in (drive, late)]
    now, then = (m.forced for m in measured if m is not None)
    assert then.translation_m.rms == pytest.approx(now.translation_m.rms, rel=0.1)
    assert then.yaw_deg.rms == pytest.approx(now.yaw_deg.rms, rel=0.1)
