import importlib.util
import json
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.doctor import KINDS, Finding, examine, fix
from skidsteer.doctor.alignment import Hypothesis, Link, align, most_probable_path
from skidsteer.doctor.course import events_of
from skidsteer.doctor.cures import CURES
from skidsteer.doctor.drift import NO_DRIFT, drift_against
from skidsteer.doctor.evidence import gather
from skidsteer.doctor.excitation import motion_of
from skidsteer.doctor.folding import LONGEST, fold
from skidsteer.doctor.limits import clipped
from skidsteer.doctor.sampling import hold_length, lattice
from skidsteer.doctor.signals import Signal, Total, turned_by, typical
from skidsteer.doctor.signs import confidence
from skidsteer.doctor.units import widths
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.io.folder import read_folder
from skidsteer.models import Differential
from skidsteer.samples import sample
from skidsteer.se2 import FloatArray, between, compose, wrap
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Mount

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
VEHICLE = Vehicle("mine", track_width=0.5, wheel_radius=0.1)


def study() -> ModuleType:
    spec = importlib.util.spec_from_file_location("doctor_study", ROOT / "benchmarks" / "doctor.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["doctor_study"] = module
    spec.loader.exec_module(module)
    return module


def restarted(pose: Series) -> Series:
    """The pose of a localization that starts anew half-way, elsewhere."""
    half, values = len(pose) // 2, pose.values.copy()
    values[half:] = compose([7.0, -4.0, 2.0], between(values[half], values[half:]))
    return Series(pose.t, values, "pose")


@pytest.fixture(scope="module")
def drive() -> Drive:
    """A faultless drive of five minutes with a pose and a gyro of its own, 0.15 s early against it."""
    lab = sample("p3at-mandow")
    assert lab.pose is not None
    rng = np.random.default_rng(0)
    yaw = np.cumsum(np.r_[0.0, wrap(np.diff(lab.pose.values[:, 2]))])
    t = np.arange(lab.pose.t[0] + 0.2, lab.pose.t[-1] - 0.2, 0.02)
    rate = (np.interp(t + 0.1, lab.pose.t, yaw) - np.interp(t - 0.1, lab.pose.t, yaw)) / 0.2
    gyro = Series(t - 0.15, rate + rng.normal(0.0, 0.02, len(t)), "gyro")
    steps = 0.004 * rng.standard_normal(lab.wheels.values.shape)  # wheel speeds of a real encoder are never smooth
    return replace(lab, gyro=gyro, wheels=Series(lab.wheels.t, lab.wheels.values + steps, "wheels"))


def wheels(drive: Drive, values: FloatArray) -> Drive:
    return replace(drive, wheels=Series(drive.wheels.t, values, "wheels"))


def pose(drive: Drive, values: FloatArray) -> Drive:
    assert drive.pose is not None
    return replace(drive, pose=Series(drive.pose.t, values, "pose"))


def gyro(drive: Drive, values: FloatArray) -> Drive:
    assert drive.gyro is not None
    return replace(drive, gyro=Series(drive.gyro.t, values, "gyro"))


def at(drive: Drive, part: str, t: FloatArray) -> Drive:
    return replace(drive, **{part: Series(t, getattr(drive, part).values, part)})


def without(drive: Drive, part: str, start: float, end: float) -> Drive:
    series = getattr(drive, part)
    keep = (series.t < start) | (series.t > end)
    return replace(drive, **{part: Series(series.t[keep], series.values[keep], part)})


def the(kind: str, drive: Drive) -> Finding:
    found = [finding for finding in examine(drive) if finding.kind == kind]
    assert len(found) == 1, [finding.kind for finding in examine(drive)]
    return found[0]


def test_a_faultless_drive_has_no_findings(drive: Drive) -> None:
    assert examine(drive) == ()
    assert examine(sample("p3at-mandow")) == ()


@pytest.mark.parametrize(
    ("kind", "fault"),
    [
        ("swapped_sides", lambda d: wheels(d, d.wheels.values[:, ::-1])),
        ("left_negated", lambda d: wheels(d, d.wheels.values * [-1.0, 1.0])),
        ("right_negated", lambda d: wheels(d, d.wheels.values * [1.0, -1.0])),
        ("both_negated", lambda d: wheels(d, -d.wheels.values)),
        ("gyro_sign", lambda d: gyro(d, -d.gyro.values)),
        ("gyro_degrees", lambda d: gyro(d, np.degrees(d.gyro.values))),
        ("reference_yaw_degrees", lambda d: pose(d, d.pose.values * [1.0, 1.0, 180.0 / np.pi])),
        ("reference_yaw_sign", lambda d: pose(d, d.pose.values * [1.0, 1.0, -1.0])),
        ("wheels_in_rad_s", lambda d: wheels(d, d.wheels.values / 0.11)),
        ("wheels_in_mm_s", lambda d: wheels(d, d.wheels.values * 1e3)),
    ],
)
def test_a_fault_of_signs_or_units_is_found_and_undone(drive: Drive, kind: str, fault: object) -> None:
    wrong = fault(drive)
    findings = examine(wrong)
    assert [finding.kind for finding in findings] == [kind]
    assert findings[0].fixable
    assert findings[0].severity == "error"
    assert findings[0].confidence > 0.9
    cured, done = fix(wrong, findings)
    assert len(done) == 1
    assert_allclose(cured.wheels.values, drive.wheels.values, atol=1e-12)
    assert cured.pose is not None
    assert drive.pose is not None
    assert_allclose(cured.pose.values, drive.pose.values, atol=1e-9)
    assert cured.gyro is not None
    assert drive.gyro is not None
    assert_allclose(cured.gyro.values, drive.gyro.values, atol=1e-12)


def test_swapped_and_negated_at_once_are_both_named(drive: Drive) -> None:
    wrong = wheels(drive, drive.wheels.values[:, ::-1] * [-1.0, 1.0])
    findings = examine(wrong)
    assert {finding.kind for finding in findings} == {"swapped_sides", "left_negated"}
    assert examine(fix(wrong, findings)[0]) == ()


def test_a_reference_that_looks_backwards_is_not_cured(drive: Drive) -> None:
    wrong = wheels(drive, -drive.wheels.values[:, ::-1])
    finding = the("backwards", wrong)
    assert not finding.fixable
    assert fix(wrong, [finding]) == (wrong, ())


@pytest.mark.parametrize("yaw_deg", [89.2, -60.0, 135.0, 15.0])
def test_a_sensor_that_is_turned_is_told_from_wrong_wheels(drive: Drive, yaw_deg: float) -> None:
    assert drive.pose is not None
    finding = the("turned_reference", pose(drive, compose(drive.pose.values, [0.4, -0.1, np.radians(yaw_deg)])))
    assert_allclose(np.degrees(finding.amount), yaw_deg, atol=1.0)
    assert finding.severity == "info"  # a calibration finds the angle by itself
    assert not finding.fixable


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0])
def test_faults_of_the_wheels_are_found_behind_a_turned_sensor(drive: Drive, yaw_deg: float) -> None:
    assert drive.pose is not None
    seen = pose(drive, compose(drive.pose.values, [0.0, 0.0, np.radians(yaw_deg)]))
    turned = {"turned_reference"} if yaw_deg else set()
    for kind, values in (
        ("swapped_sides", drive.wheels.values[:, ::-1]),
        ("left_negated", drive.wheels.values * [-1.0, 1.0]),
        ("wheels_in_mm_s", drive.wheels.values * 1e3),
    ):
        assert {f.kind for f in examine(wheels(seen, values))} == {kind, *turned}


def test_a_compass_in_degrees_is_read(drive: Drive) -> None:
    assert drive.pose is not None
    x, y, yaw = drive.pose.values.T
    wrong = pose(drive, np.column_stack([x, y, 90.0 - np.degrees(yaw)]))
    findings = examine(wrong)
    assert {f.kind for f in findings} == {"reference_yaw_sign", "reference_yaw_degrees", "turned_reference"}
    cured, _ = fix(wrong, findings)
    assert cured.pose is not None
    assert_allclose(cured.pose.values[:, 2], yaw - 0.5 * np.pi, atol=1e-9)
    assert [f.kind for f in examine(cured)] == ["turned_reference"]


def test_a_sensor_far_off_the_middle_of_a_robot_that_turns_on_the_spot_is_not_turned() -> None:
    rims = rims_from_manoeuvres(np.array([[20.0, 0.0, 0.8], [20.0, 0.0, -0.8]] * 2), Differential(0.9))
    seen = kinematic_drive("spin", VEHICLE, Differential(0.9), rims, Sensors(mount=Mount(1.5, 0.2)), seed=1)
    assert "turned_reference" not in {f.kind for f in examine(seen)}


@pytest.mark.parametrize("slope", [5e-4, -5e-4])
def test_a_gyro_that_drifts_is_found_and_steadied(drive: Drive, slope: float) -> None:
    assert drive.gyro is not None
    t = drive.gyro.t
    wrong = gyro(drive, drive.gyro.values + slope * (t - t[0])[:, None])
    finding = the("gyro_drift", wrong)
    assert_allclose(finding.amount, slope, rtol=0.1)
    cured, done = fix(wrong, [finding])
    assert len(done) == 1
    assert cured.gyro is not None
    assert_allclose(cured.gyro.values, drive.gyro.values, atol=0.012)
    assert examine(cured) == ()


@pytest.mark.parametrize("slope", [5e-4, -5e-4])
def test_a_gyro_that_drifts_is_no_clock_that_jumps(real: Callable[[str], Path], slope: float) -> None:
    alone = read_folder(real("husky-gyro-flooring"))
    assert alone.gyro is not None
    t = alone.gyro.t
    found = {f.kind for f in examine(gyro(alone, alone.gyro.values + slope * (t - t[0])[:, None]))}
    assert found - {f.kind for f in examine(alone)} == {"gyro_drift"}


def test_a_drift_is_told_beside_turns_by_hand() -> None:
    t = 0.1 * np.arange(1000)
    turns = np.sin(0.7 * t)
    wheels_say = Signal(5.0, 0.1, np.column_stack([np.full(1000, 0.5), 2.0 * turns]))
    found = drift_against(Signal(5.0, 0.1, (1.5 * turns + 0.3 + 2e-3 * t)[:, None]), wheels_say)
    assert_allclose([found.start, found.slope, found.span], [5.0, 2e-3, 99.9], rtol=1e-9)
    assert drift_against(Signal(0.0, 0.1, np.ones((10, 1))), wheels_say) == NO_DRIFT


def test_milliseconds_for_seconds_are_one_finding(drive: Drive) -> None:
    parts = {name: getattr(drive, name) for name in ("wheels", "pose", "gyro")}
    wrong = replace(drive, **{name: Series(1e3 * s.t, s.values, name) for name, s in parts.items()})
    (finding,) = examine(wrong)
    assert finding.kind == "time_unit"
    assert "10 s apart: is the time in milliseconds?" in finding.what
    assert not finding.fixable


def test_a_gyro_alone_cannot_tell_whose_sign_is_wrong(drive: Drive) -> None:
    alone = replace(drive, pose=None)
    assert examine(alone) == ()
    for wrong in (gyro(alone, -drive.gyro.values), wheels(alone, drive.wheels.values[:, ::-1])):
        finding = the("turn_sign", wrong)
        assert finding.confidence == 0.5
        assert not finding.fixable
    assert the("left_negated", wheels(alone, drive.wheels.values * [-1.0, 1.0])).part == "wheels"
    assert the("gyro_degrees", gyro(alone, np.degrees(drive.gyro.values))).part == "gyro"
    assert the("wheels_in_mm_s", wheels(alone, drive.wheels.values * 1e3)).amount == 1e-3


def test_positions_without_heading_tell_units_and_a_negated_side(drive: Drive) -> None:
    assert drive.pose is not None
    positions = Series(drive.pose.t, drive.pose.values[:, :2], "position")
    plain = replace(drive, pose=None, gyro=None, position=positions)
    assert examine(plain) == ()
    assert the("wheels_in_mm_s", wheels(plain, drive.wheels.values * 1e3)).fixable
    assert the("turn_sign", wheels(plain, drive.wheels.values[:, ::-1])).confidence == 0.5
    assert the("right_negated", wheels(plain, drive.wheels.values * [1.0, -1.0])).fixable
    assert_allclose(the("clock_offset", at(plain, "position", positions.t + 3.0)).amount, 3.15, atol=0.25)


def test_findings_are_plain_numbers_and_words(drive: Drive) -> None:
    faults = [wheels(drive, f * drive.wheels.values) for f in (0.3, 9.0, 1e3, 1e5)]
    for wrong in [*faults, without(drive, "pose", 20.0, 23.0), gyro(drive, 0.3 * np.sign(drive.gyro.values))]:
        for finding in examine(wrong):
            assert json.loads(json.dumps(asdict(finding)))["kind"] == finding.kind
            assert type(finding.amount) is float
            assert finding.what.endswith(".")
            assert finding.effect.endswith(".")
            assert finding.cure.endswith((".", ")."))


def test_ticks_are_named_and_cured_where_their_number_is_known(drive: Drive) -> None:
    per_turn = 2.0 * np.pi * 0.11 * 138_000.0
    wrong = wheels(drive, drive.wheels.values * 138_000.0)
    assert not the("wheels_in_ticks", wrong).fixable
    known = replace(wrong, vehicle=replace(wrong.vehicle, ticks_per_revolution=per_turn))
    assert_allclose(the("wheels_in_ticks", known).amount, 1.0 / 138_000.0)


@pytest.mark.parametrize("factor", [1e-3, 1e-2])
@pytest.mark.parametrize("part", ["pose", "position"])
def test_a_reference_in_millimetres_is_found_and_scaled(drive: Drive, part: str, factor: float) -> None:
    assert drive.pose is not None
    places = Series(drive.pose.t, drive.pose.values[:, :2], "position")
    right = drive if part == "pose" else replace(drive, pose=None, gyro=None, position=places)
    values = getattr(right, part).values / ([factor, factor, 1.0] if part == "pose" else factor)
    wrong = replace(right, **{part: Series(drive.pose.t, values, part)})
    finding = the("reference_unit", wrong)
    assert (finding.part, finding.amount) == (part, factor)
    cured, done = fix(wrong, [finding])
    assert done == (f"multiplied the positions of the {part} by {factor:g}",)
    assert_allclose(getattr(cured, part).values, getattr(right, part).values, atol=1e-12)


@pytest.mark.parametrize("part", ["pose", "gyro"])
def test_milliseconds_of_one_part_are_one_finding(drive: Drive, part: str) -> None:
    findings = examine(at(drive, part, 1e3 * getattr(drive, part).t))
    assert [(f.kind, f.part) for f in findings] == [("time_unit", part)]


@pytest.mark.parametrize("factor", [0.3, 2.5, 5.0])
def test_a_wheel_radius_wrong_by_a_large_factor_is_found(drive: Drive, factor: float) -> None:
    finding = the("wheel_radius", wheels(drive, factor * drive.wheels.values))
    assert_allclose(finding.amount, 0.91 / factor, rtol=0.1)  # the truth has scale factors of 0.92
    assert not finding.fixable


@pytest.mark.parametrize(("part", "shift"), [("pose", 2.0), ("pose", -4.0), ("gyro", 60.0), ("wheels", 1.7e9)])
def test_a_clock_that_is_ahead_is_found_and_shifted(drive: Drive, part: str, shift: float) -> None:
    wrong = at(drive, part, getattr(drive, part).t + shift)
    finding = the("clock_offset", wrong)
    assert finding.part == part
    assert_allclose(finding.amount, shift, atol=0.4)
    assert examine(fix(wrong, [finding])[0]) == ()


@pytest.mark.parametrize("part", ["wheels", "pose", "gyro"])
def test_a_clock_that_runs_fast_is_found_and_stretched(drive: Drive, part: str) -> None:
    t = getattr(drive, part).t
    wrong = at(drive, part, t + 0.01 * (t - t[0]))
    finding = the("clock_drift", wrong)
    assert finding.part == part
    assert_allclose(finding.amount, 0.01, rtol=0.15)
    assert "clock_drift" not in {f.kind for f in examine(fix(wrong, [finding])[0])}


@pytest.mark.parametrize(("part", "size"), [("wheels", 5.0), ("pose", 5.0), ("gyro", 2.0)])
def test_a_clock_set_forward_is_found_and_undone(drive: Drive, part: str, size: float) -> None:
    t = getattr(drive, part).t
    wrong = at(drive, part, t + size * (t > 120.0))
    finding = the("clock_jump", wrong)
    assert finding.part == part
    assert_allclose(finding.amount, size, atol=0.3)
    assert_allclose(finding.where, [(120.0, 120.0 + size)], atol=0.4)  # by the pause in its own stamps
    assert not {"clock_jump", "clock_offset"} & {f.kind for f in examine(fix(wrong, [finding])[0])}


def test_a_clock_set_back_is_found(drive: Drive) -> None:
    assert drive.gyro is not None
    late = drive.gyro.t > 120.0
    keep = ~late | (drive.gyro.t > 124.0)
    t = (drive.gyro.t - 4.0 * late)[keep]
    finding = the("clock_jump", replace(drive, gyro=Series(t, drive.gyro.values[keep])))
    assert finding.part == "gyro"
    assert_allclose(finding.amount, -4.0, atol=0.3)


def test_a_jump_is_told_on_the_clock_that_jumped(drive: Drive) -> None:
    late = drive.wheels.t > 120.0
    keep = ~late | (drive.wheels.t > 124.0)
    t = (drive.wheels.t - 4.0 * late)[keep] - 50.0
    findings = {f.kind: f for f in examine(replace(drive, wheels=Series(t, drive.wheels.values[keep])))}
    assert set(findings) == {"clock_jump", "clock_offset"}
    assert findings["clock_jump"].part == "wheels"
    assert_allclose(findings["clock_jump"].amount, -4.0, atol=0.3)
    assert_allclose(np.mean(findings["clock_jump"].where), 70.0, atol=5.0)
    assert_allclose(findings["clock_offset"].amount, -50.0, atol=0.5)


@pytest.mark.parametrize("size", [4.0, 1e9])
def test_a_jump_of_the_whole_log_is_told_from_lost_data(drive: Drive, size: float) -> None:
    when = 5.0  # it drives straight at 0.2 m/s from 2 to 10 s
    wrong = drive
    for part in ("wheels", "pose", "gyro"):
        t = getattr(drive, part).t
        wrong = at(wrong, part, t + size * (t > when))
    finding = the("clock_jump", wrong)
    assert finding.part == "all"
    assert_allclose(finding.amount, size, atol=0.05)
    cured = fix(wrong, [finding])[0]
    assert_allclose(cured.wheels.t, drive.wheels.t, atol=0.05)
    lost = drive
    for part in ("wheels", "pose", "gyro"):
        lost = without(lost, part, when, when + 3.0)
    kinds = [f.kind for f in examine(lost)]
    assert set(kinds) <= {"gap"}
    assert "gap" in kinds


def test_a_frozen_reference_is_found_where_it_is_and_dropped(drive: Drive) -> None:
    assert drive.pose is not None
    t, values = drive.pose.t, drive.pose.values.copy()
    lost = (t >= 20.0) & (t < 23.0)
    values[lost] = values[np.argmax(lost)]
    finding = the("frozen_reference", pose(drive, values))
    assert_allclose(finding.where, [(20.0, 23.0)], atol=0.3)
    cured, done = fix(pose(drive, values), [finding])
    assert cured.pose is not None
    assert len(cured.pose) == len(t) - lost.sum() + 1
    assert "repeated" in done[0]


def test_held_samples_are_found_with_their_rate(drive: Drive) -> None:
    index = np.arange(len(drive.wheels)) // 10 * 10
    assert "at 10 Hz" in the("held_samples", wheels(drive, drive.wheels.values[index])).what
    assert drive.pose is not None
    index = np.arange(len(drive.pose)) // 2 * 2
    wrong = pose(drive, drive.pose.values[index])
    cured, _ = fix(wrong, examine(wrong))
    assert cured.pose is not None
    assert len(cured.pose) == (len(drive.pose) + 1) // 2


def test_coarse_encoders_are_found_by_speed_and_by_count(drive: Drive) -> None:
    v = drive.wheels.values
    assert_allclose(the("quantised_wheels", wheels(drive, np.round(v / 0.03) * 0.03)).amount, 0.03, rtol=1e-3)
    rng = np.random.default_rng(1)
    dt = rng.uniform(0.005, 0.015, (len(v), 1))
    counts = np.diff(np.round(np.cumsum(np.r_[np.zeros((1, 2)), v * dt], axis=0) / 5e-4), axis=0)
    uneven = replace(drive, wheels=Series(np.cumsum(dt) - dt[0], counts * 5e-4 / dt, "wheels"))
    assert the("quantised_wheels", uneven).part == "wheels"


@pytest.mark.parametrize("part", ["wheels", "pose", "gyro"])
def test_a_gap_while_the_robot_moves_is_found(drive: Drive, part: str) -> None:
    finding = the("gap", without(drive, part, 20.0, 23.0))
    assert finding.part == part
    assert_allclose(finding.where, [(20.0, 23.0)], atol=0.3)


@pytest.mark.parametrize(("side", "name", "speed"), [(0, "left", 0.31), (1, "right", 0.31), (0, "left", 0.0)])
def test_a_side_that_is_dead_is_found(drive: Drive, side: int, name: str, speed: float) -> None:
    dead = drive.wheels.t > (60.0 if speed else 0.0)
    values = drive.wheels.values.copy()
    values[dead, side] = speed
    wrong = wheels(drive, values)
    finding = the("frozen_wheels", wrong)
    assert name in finding.what
    assert finding.severity == "error"
    assert_allclose(finding.where, [(drive.wheels.t[dead][0], drive.span[1])], atol=0.3)
    assert not [f for f in examine(wrong) if f.kind.startswith("clock_")]


def test_a_side_that_stands_while_the_other_drives_it_round_is_not_dead(drive: Drive) -> None:
    values = drive.wheels.values.copy()
    values[(drive.wheels.t > 60.0) & (drive.wheels.t < 75.0), 0] = 0.0
    assert not [f for f in examine(wheels(drive, values)) if f.kind == "frozen_wheels"]


def test_segments_with_a_pose_at_either_end_are_seen_to_move(drive: Drive) -> None:
    assert drive.pose is not None
    start = np.arange(20.0, 200.0, 5.0)
    segments = np.stack([start, start + 2.0], axis=1)
    ends = np.unique(np.searchsorted(drive.pose.t, segments.ravel()))
    few = replace(drive, pose=Series(drive.pose.t[ends], drive.pose.values[ends], "pose"), segments=segments)
    assert not [f for f in examine(few) if f.kind == "standing_still"]


def test_a_localization_that_starts_anew_is_found(drive: Drive) -> None:
    assert drive.pose is not None
    finding = the("leap", replace(drive, pose=restarted(drive.pose)))
    half = drive.pose.t[len(drive.pose) // 2]
    assert finding.part == "pose"
    assert finding.where[0][1] == half
    segments = np.array([[drive.span[0], half - 0.01], [half, drive.span[1]]])
    assert examine(replace(drive, pose=restarted(drive.pose), segments=segments)) == ()


def test_a_pause_of_the_reference_is_one_where_it_comes_evenly(drive: Drive) -> None:
    pause = without(drive, "pose", 20.0, 21.3)
    (where,) = the("gap", pause).where
    assert_allclose(where, (20.0, 21.3), atol=0.21)
    assert drive.pose is not None
    keep = np.arange(len(drive.pose)) % 10 < 4  # poses now and then, as a tracker of landmarks has them: 1.4 s between
    uneven = replace(drive, pose=Series(drive.pose.t[keep], drive.pose.values[keep], "pose"))
    assert not [finding for finding in examine(uneven) if finding.kind == "gap"]


def test_clipped_readings_are_found(drive: Drive) -> None:
    assert drive.gyro is not None
    finding = the("saturated", gyro(drive, np.clip(drive.gyro.values, -0.5, 0.5)))
    assert finding.part == "gyro"
    assert_allclose(finding.amount, 0.5)
    finding = the("saturated", wheels(drive, np.clip(drive.wheels.values, -0.35, 0.35)))
    assert finding.part == "wheels"
    assert_allclose(finding.amount, 0.35)


@pytest.mark.parametrize("mount", [(0.0, -0.5, 0.0), (0.0, 0.5, 0.0), (0.3, -0.4, -1.2), (0.5, 0.0, 1.5)])
def test_where_the_reference_sits_is_no_limit_and_hides_none(mount: tuple[float, float, float]) -> None:
    """A sensor off the middle is faster than the wheels in turns, which this robot makes at its highest wheel speed."""
    lab = sample("p3at-lab")
    assert lab.pose is not None
    seen = pose(lab, compose(lab.pose.values, mount))
    assert {finding.kind for finding in examine(seen)} <= {"turned_reference"}
    finding = the("saturated", wheels(seen, np.clip(seen.wheels.values, -0.35, 0.35)))
    assert_allclose(finding.amount, 0.35)
    assert finding.where


def test_driving_backwards_is_no_fault_and_hides_none(drive: Drive) -> None:
    assert drive.pose is not None
    back = pose(wheels(drive, -drive.wheels.values[:, ::-1]), drive.pose.values + np.array([0.0, 0.0, np.pi]))
    assert examine(back) == ()
    for d in (drive, back):  # coarse steps are flat anywhere: only the reference tells the limit
        coarse = np.round(d.wheels.values, 2)
        kinds = {f.kind for f in examine(wheels(d, np.clip(coarse, -0.3, 0.3)))}
        assert kinds == {"saturated", "quantised_wheels"}
        assert {f.kind for f in examine(wheels(d, coarse))} == {"quantised_wheels"}


def test_the_bias_of_a_gyro_on_a_straight_is_no_turn() -> None:
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(6000)
    speed = 0.4 + 0.1 * np.sin(0.3 * t)
    rims = Series(t, speed[:, None] + 0.004 * rng.normal(size=(6000, 2)), "wheels")
    rate = 0.03 * (speed - 0.3) + 0.004 * rng.normal(size=6000)
    findings = examine(Drive("straight", VEHICLE, rims, gyro=Series(t, rate, "gyro")))
    assert [f.kind for f in findings] == ["straight_only"]


def test_a_robot_that_is_stuck_for_a_while_hides_no_fault(drive: Drive) -> None:
    stuck = (drive.wheels.t > 60.0) & (drive.wheels.t < 140.0)
    alone = replace(drive, pose=None)
    assert drive.gyro is not None
    still = gyro(alone, np.where((drive.gyro.t > 59.0) & (drive.gyro.t < 141.0), 0.0, drive.gyro.values[:, 0]))
    spun = np.where(stuck[:, None], [0.6, -0.6] + 0.01 * drive.wheels.values, drive.wheels.values)
    assert {f.kind for f in examine(wheels(still, spun[:, ::-1]))} == {"turn_sign"}


def test_the_effective_width_is_the_same_with_a_side_negated(drive: Drive) -> None:
    alone = replace(drive, pose=None)
    for values in (drive.wheels.values, drive.wheels.values * [-1.0, 1.0]):
        pair = gather(wheels(alone, values)).by_gyro
        assert pair is not None
        assert_allclose(widths(alone.vehicle, pair), (0.5624 / 0.4 / 0.916,) * 2, rtol=0.1)  # the truth of the sample


def test_wheels_that_are_commands_are_found(drive: Drive) -> None:
    t, v = drive.wheels.t, np.round(drive.wheels.values, 2)
    command = np.stack([v.mean(axis=1), (v[:, 1] - v[:, 0]) / 0.7], axis=-1)
    assert the("commanded_wheels", replace(wheels(drive, v), command=Series(t, command))).severity == "warning"
    assert the("commanded_wheels", replace(wheels(drive, v), wheel_command=Series(t, v))).part == "wheels"


def test_a_robot_at_rest_is_found(drive: Drive) -> None:
    still = wheels(drive, np.where(drive.wheels.t[:, None] < 8.0, drive.wheels.values, 0.0))
    assert the("standing_still", replace(still, pose=None, gyro=None)).severity == "error"


def test_a_straight_drive_a_circle_and_a_short_drive_are_told_apart() -> None:
    lab = study()
    base = sample("p3at-mandow")
    assert the("straight_only", lab.less_turning(base, 0.0, 0.0)).severity == "error"
    assert "radius" in the("circle_only", lab.less_turning(base, 0.0, 0.8)).what
    assert "little_turning" in {f.kind for f in examine(base.between(0.0, 18.0))}
    assert motion_of(gather(base)).turned > 20.0


def test_fix_refuses_a_finding_of_another_drive(drive: Drive) -> None:
    finding = the("gyro_sign", gyro(drive, -drive.gyro.values))
    with pytest.raises(RequestError, match="cannot cure gyro_sign: the drive has no gyro"):
        fix(replace(drive, gyro=None), [finding])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "bad luck"}, "kind must be one of"),
        ({"severity": "fatal"}, "severity must be one of info, warning, error, got fatal"),
        ({"confidence": 1.5}, "confidence must lie in"),
    ],
)
def test_findings_are_checked(change: dict[str, object], message: str) -> None:
    good = Finding("gap", "", (), 0.5, "info", "", "", False)
    with pytest.raises(ValueError, match=message):
        replace(good, **change)


def test_every_cure_belongs_to_a_kind() -> None:
    assert set(CURES) <= set(KINDS)


# The parts


def test_the_path_stays_slides_and_jumps_by_hand() -> None:
    scores = np.zeros((6, 30))
    scores[[0, 1, 2], [5, 5, 6]] = 10.0  # slides by one
    scores[[3, 4, 5], [20, 20, 20]] = 10.0  # jumps
    path, score = most_probable_path(scores)
    assert path.tolist() == [5, 5, 6, 20, 20, 20]
    assert_allclose(score, 60.0 - 0.7 - 8.0)
    assert most_probable_path(scores, slide=0)[0].tolist()[3:] == [20, 20, 20]


def _signals(lag: float, sign: int, scale: float, seed: int) -> tuple[Signal, Signal]:
    rng = np.random.default_rng(seed)
    smooth = np.convolve(rng.normal(size=1400), np.ones(15) / 15.0, "same")
    b = Signal(3.0, 0.1, np.stack([smooth, np.roll(smooth, 500)], axis=-1))
    t = 3.0 + lag + 0.1 * np.arange(1400)
    noisy = sign * scale * smooth + 0.02 * rng.normal(size=1400)
    return Signal(float(t[0]), 0.1, noisy[:, None]), b


@settings(max_examples=15, deadline=None)
@given(st.integers(-200, 200), st.sampled_from([-1, 1]), st.floats(0.01, 50.0), st.integers(0, 5))
def test_alignment_recovers_lag_sign_and_scale(lag: int, sign: int, scale: float, seed: int) -> None:
    a, b = _signals(0.1 * lag, sign, scale, seed)
    hypotheses = tuple(Hypothesis(f"{c}{s}", (Link(0, c, s),)) for c in (0, 1) for s in (1, -1))
    best = align(a, b, hypotheses)[0]
    if scale < 0.2:  # drowned in noise
        return
    assert best.hypothesis.name == f"0{sign}"
    assert_allclose(best.lag(a.t), 0.1 * lag, atol=0.11)
    assert_allclose(best.scales, [sign * scale], rtol=0.1)


def test_signals_that_share_no_time_at_any_lag_do_not_align() -> None:
    nothing = Signal(0.0, 0.1, np.full((50, 1), np.nan))
    assert align(nothing, nothing, (Hypothesis("", (Link(0, 0, 1),)),)) == []


def test_rates_stop_at_breaks_by_hand() -> None:
    total = Total(np.array([0.0, 1.0, 2.0, 3.0]), np.array([[0.0], [1.0], [3.0], [3.0]]), np.array([0, 0, 0, 1]))
    assert_allclose(total.rates(np.array([0.5, 1.0, 1.5, 2.5, -1.0]), 1.0).ravel(), [1.0, 1.5, 2.0, np.nan, np.nan])


def test_typical_is_where_half_of_the_way_was_made() -> None:
    assert typical(np.array([0.0, 0.0, 0.0, 1.0, -2.0, np.nan, 3.0])) == 2.0
    assert typical(np.zeros(3)) == 0.0


def test_turned_counts_whole_seconds_of_real_turns() -> None:
    rates = np.r_[np.full(20, 0.5), np.full(10, -0.2), np.full(10, 0.01), np.full(10, np.nan)]
    assert_allclose(turned_by(rates, 0.1), 1.2)


@given(st.lists(st.floats(0.01, 1e9), min_size=1, max_size=30))
def test_folding_shortens_pauses_and_unfolds_again(steps: list[float]) -> None:
    t = np.r_[0.0, np.cumsum(steps)]
    folded, folding = fold(Drive("", VEHICLE, Series(t, np.zeros((len(t), 2)))))
    assert np.diff(folded.wheels.t).max() <= LONGEST * (1.0 + 1e-6)
    assert_allclose([folding.unfold(float(x)) for x in folded.wheels.t], t, atol=1e-5 + 1e-12 * t[-1])


@given(st.floats(1e-3, 1e3), st.integers(0, 100))
def test_a_lattice_is_found_and_noise_has_none(step: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert_allclose(lattice(step * rng.integers(-20, 20, 300)), step)
    assert lattice(step * rng.normal(size=300)) == 0.0


@pytest.mark.parametrize("hold", [2, 3, 5, 8])
def test_hold_lengths_are_found_and_coarse_steps_are_none(hold: int) -> None:
    rng = np.random.default_rng(hold)
    t, values = 0.05 * np.arange(900), rng.normal(size=900)
    assert hold_length(t, values[np.arange(900) // hold * hold][:, None]) == hold
    assert hold_length(t, values[:, None]) == 1
    coarse = np.round(np.sin(t) + 0.2 * values)
    assert hold_length(t, coarse[:, None]) == 1


def test_noise_is_clipped_only_where_it_is_flat_at_its_extreme() -> None:
    t = 0.02 * np.arange(3000)
    values = np.sin(t) + 0.01 * np.random.default_rng(0).normal(size=3000)
    assert clipped(t, values) == ([], 0.0)
    where, limit = clipped(t, np.clip(values, -0.7, 0.8))
    assert limit == 0.8
    assert len(where) >= 18
    assert all(np.sin(start) ** 2 > 0.4 for start, _ in where)


def test_events_tell_constant_drift_and_jump_apart() -> None:
    a, b = _signals(0.2, 1, 1.0, 3)
    hypotheses = (Hypothesis("", (Link(0, 0, 1),)),)
    lab = {
        "": a,
        "clock_drift": Signal(a.start, a.step, np.interp(a.t, a.t + 0.02 * (a.t - a.start), a.values[:, 0])[:, None]),
        "clock_jump": Signal(
            a.start, a.step, np.where(a.t < 70.0, a.values[:, 0], np.roll(a.values[:, 0], 30))[:, None]
        ),
    }
    for kind, signal in lab.items():
        pair = type(gather(sample("p3at-mandow")).by_reference)(signal, b, align(signal, b, hypotheses)[0], 0.0)
        events = events_of(pair, a.t, b.t, float)
        assert [event.kind for event in events] == ([kind] if kind else [])


def test_confidence_grows_with_the_lead() -> None:
    assert confidence(0.0) == 0.5
    assert confidence(8.0) < confidence(12.0) < confidence(100.0) == 0.99


# Anything that passes for a drive


@st.composite
def series(draw: st.DrawFn, width: int) -> Series:
    steps = draw(st.lists(st.sampled_from([0.05, 0.1, 0.2, 1.0, 5.0, 70.0, 1e9]), min_size=1, max_size=40))
    t = draw(st.sampled_from([0.0, 100.0, 1.7e9])) + np.cumsum(steps)
    rng = np.random.default_rng(draw(st.integers(0, 1000)))
    values = {
        "noise": rng.normal(size=(len(t), width)),
        "rest": np.zeros((len(t), width)),
        "steps": rng.integers(-2, 3, (len(t), width)).astype(float),
        "far": 1e3 * np.cumsum(rng.normal(size=(len(t), width)), axis=0),
    }
    return Series(t, values[draw(st.sampled_from(sorted(values)))])


@st.composite
def drives(draw: st.DrawFn) -> Drive:
    recorded = {"pose": 3, "position": 2, "gyro": 1, "command": 2}
    parts = {name: draw(series(width)) for name, width in recorded.items() if draw(st.booleans())}
    rolled = draw(series(2))
    segments = None
    if len(rolled) > 3 and draw(st.booleans()):
        segments = np.array([[rolled.t[0], rolled.t[1]], [rolled.t[2], rolled.t[-1]]])
    return Drive("any", VEHICLE, rolled, segments=segments, **parts)


@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
@given(drives())
def test_whatever_was_recorded_can_be_examined_and_fixed(anything: Drive) -> None:
    findings = examine(anything)
    json.dumps([asdict(finding) for finding in findings])
    cured, done = fix(anything, findings)
    assert (cured is anything) == (not done)


# The injection study, reduced; benchmarks/doctor.py runs all of it.


@pytest.mark.skipif(not DATA.exists(), reason="the real drives are not here")
def test_untouched_real_drives_raise_no_false_alarm() -> None:
    lab = study()
    for untouched in lab.read_drives(DATA):
        false = lab.false_alarms(untouched, examine(untouched))
        assert not false, (untouched.name, false)


@pytest.mark.skipif(not DATA.exists(), reason="the real drives are not here")
def test_faults_put_into_real_drives_are_found() -> None:
    lab = study()
    names = ("husky-gyro-flooring", "husky-mocap", "warthog-asphalt")
    real = [lab.read_folder(DATA / name) for name in names]
    some = [v for fault in lab.FAULTS for d in real for v in lab.variants(fault, d)[::5]]
    missed = [v.label for v in some if not lab.found_in(v, examine(v.drive))]
    assert len(some) > 70
    assert len(missed) <= 0.05 * len(some), missed
