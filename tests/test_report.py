"""The report: what it computes, what it shows, what it leaves out, and that nothing from a log can run in it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from conftest import Call
from report_drives import HURT, NAMES, hostile, lab, long_drive
from skidsteer.calibration import Calibration, Estimate, Provenance
from skidsteer.drive import Drive, Series
from skidsteer.errors import printable
from skidsteer.io.calibration_file import load_calibration, save_calibration
from skidsteer.io.folder import write_folder
from skidsteer.models import Curvature, Differential, Icr, Linear, Model, ScheduledIcr, SymmetricIcr
from skidsteer.models.curvature import icr_coefficient
from skidsteer.noise import Noise
from skidsteer.report import gather, page
from skidsteer.report.drift import drift_per_10_m, yaw_per_turn
from skidsteer.report.error_charts import worst_and_some
from skidsteer.report.markup import Html, embedded, markup, rounded, spread, tag
from skidsteer.report.model_charts import chi_of_model
from skidsteer.report.reckoner import Part, Reckoner, fit_options, known_vehicle, uncalibrated
from skidsteer.report.tracks import DriveTracks, step_errors, thin, tracks_of
from skidsteer.report.treads import ellipse, places, tread_icrs
from skidsteer.se2 import FloatArray, between, chain, compose, exp, invert, wrap
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import Vehicle, preset
from skidsteer.windows import Mount, Timing

P3AT = preset("pioneer-p3at")
TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)
TIMING, MOUNT = Timing(0.2, 0.08), Mount(0.12, -0.07, 0.3)
WHOLE = np.array([-np.inf, np.inf])


def made_calibration(model: Model, covariance: FloatArray, vehicle: Vehicle = P3AT) -> Calibration:
    """A calibration of a model alone."""
    names = tuple(p.name for p in model.PARAMETERS)
    sigma = np.sqrt(np.diag(covariance))
    estimates = {n: Estimate(float(v), float(s), "") for n, v, s in zip(names, model.theta, sigma, strict=True)}
    return Calibration(vehicle, model, names, estimates, covariance, Noise(), Provenance((), {}, "made", "now"))


# Tread ICRs


def test_the_tread_icrs_of_the_icr_model_are_its_parameters() -> None:
    found = tread_icrs(made_calibration(TRUTH, np.diag([1e-4, 4e-4, 9e-4, 1e-6, 1e-6])))
    assert_allclose(found.place, [[-0.0120, 0.2553], [-0.0120, -0.3071]], atol=1e-12)
    assert_allclose(found.covariance, [np.diag([9e-4, 1e-4]), np.diag([9e-4, 4e-4])], atol=1e-9)
    assert_allclose(found.distance, 0.5624)


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (Differential(0.4), [[0.0, 0.2], [0.0, -0.2]]),
        (SymmetricIcr(0.31, 0.9), [[0.0, 0.31], [0.0, -0.31]]),
        (Curvature(0.5, 0.1, 0.9, 0.4), [[0.0, 0.3], [0.0, -0.3]]),
        (Linear(0.5, 0.4, 0.06, 0.02, -1.6, 1.25), [[-0.016, 0.32], [0.0375, -0.3125]]),
        (ScheduledIcr(0.2553, -0.3071, -0.012, 0.9271, 0.9049, 0.4, 0.2, 0.1, 0.1, 0.3), TRUTH),
    ],
)
def test_every_model_has_tread_icrs(model: Model, expected: list[list[float]] | Icr) -> None:
    wanted = places(expected) if isinstance(expected, Icr) else expected
    assert_allclose(places(model), wanted, atol=1e-4)


def test_a_parameter_at_its_limit_has_an_ellipse_too() -> None:
    model = ScheduledIcr(0.5, -0.5, 0.1, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert np.isfinite(tread_icrs(made_calibration(model, 1e-4 * np.eye(10))).covariance).all()


def test_the_ellipse_holds_95_of_100() -> None:
    covariance = np.array([[4e-4, 3e-4], [3e-4, 9e-4]])
    a, b, angle = ellipse(covariance)
    points = np.random.default_rng(0).multivariate_normal([0.0, 0.0], covariance, 20_000)
    c, s = np.cos(angle), np.sin(angle)
    inside = ((c * points[:, 0] + s * points[:, 1]) / a) ** 2 + ((c * points[:, 1] - s * points[:, 0]) / b) ** 2 < 1.0
    assert 0.945 < inside.mean() < 0.955


# Dead reckoning


STILL = [3.0, 0.0, 0.0]
MANOEUVRES = np.array([STILL, [6.0, 0.4, 0.0], [8.0, 0.3, 0.6], [6.0, 0.0, -0.8], [8.0, 0.4, -0.5], STILL])


@pytest.fixture(scope="module")
def perfect() -> Drive:
    """No noise at all; a sensor ahead of the middle, turned, late by 0.2 s, behind a lag of 0.08 s."""
    rims = rims_from_manoeuvres(MANOEUVRES, Differential(P3AT.track_width))
    sensors = Sensors(10.0, 0.0, 0.0, reference_delay=TIMING.time_offset, mount=MOUNT)
    return kinematic_drive("perfect", P3AT, TRUTH, rims, sensors, TIMING.lag)


def test_dead_reckoning_by_the_truth_stays_on_the_reference(perfect: Drive) -> None:
    found = tracks_of(Reckoner(perfect, (Part(TRUTH, TIMING, MOUNT),), WHOLE, False), uncalibrated(P3AT))
    assert found is not None
    assert found.sees == "pose"
    assert len(found) > 300
    apart = found.poses["calibrated"] - found.poses["reference"]
    assert_allclose(np.hypot(apart[:, 0], apart[:, 1]), 0.0, atol=2e-4)
    assert_allclose(wrap(apart[:, 2]), 0.0, atol=2e-4)
    assert np.abs(found.poses["nominal"] - found.poses["reference"])[-1, :2].max() > 0.1
    assert np.abs(step_errors(found, "calibrated")).max() < 1e-4


def test_each_block_is_predicted_by_the_fit_that_has_not_seen_it(perfect: Drive) -> None:
    parts = Part(TRUTH, TIMING, MOUNT), Part(Differential(0.4), TIMING, MOUNT)
    edges = np.array([-np.inf, 10.0, 20.0, np.inf])
    found = tracks_of(Reckoner(perfect, parts, edges, True), {})
    assert found is not None
    assert found.is_held_out
    error = np.abs(step_errors(found, "calibrated")).max(axis=1)
    odd = (found.t[:-1] >= 10.0) & (found.t[:-1] < 20.0)
    assert error[1:][~odd].max() < 1e-4
    assert error[1:][odd].max() > 1e-2


def test_a_drive_in_segments_begins_anew_in_each() -> None:
    _, drive, _ = lab()
    cut = replace(drive, segments=np.array([[10.0, 12.0], [20.0, 22.0], [40.0, 43.0]]))
    found = tracks_of(Reckoner(cut, (Part(TRUTH, Timing(0.15, 0.08), Mount()),), WHOLE, False), uncalibrated(P3AT))
    assert found is not None
    first = np.flatnonzero(np.diff(found.piece, prepend=-1))
    assert len(first) == 3
    for poses in found.poses.values():
        assert_allclose(poses[first], found.poses["reference"][first])


def test_positions_and_gyro_alone_tell_what_they_can() -> None:
    _, drive, _ = lab()
    assert drive.pose is not None
    part = (Part(TRUTH, Timing(0.15, 0.08), Mount()),)
    positions = replace(drive, pose=None, position=Series(drive.pose.t, drive.pose.values[:, :2], "position"))
    seen = tracks_of(Reckoner(positions, part, WHOLE, False), {})
    assert seen is not None
    assert seen.sees == "position"
    bowed = drift_per_10_m([seen])
    assert bowed is not None
    assert bowed.is_fitted
    rate = np.gradient(np.unwrap(drive.pose.values[:, 2]), drive.pose.t)
    gyro = replace(drive, pose=None, gyro=Series(drive.pose.t, rate, "gyro"))
    turned = tracks_of(Reckoner(gyro, part, WHOLE, False), {"nominal": Differential(0.4)})
    assert turned is not None
    assert turned.sees == "turn"
    found = yaw_per_turn([turned])
    assert found is not None
    assert found.errors["calibrated"] < 0.2 * found.errors["nominal"]
    assert tracks_of(Reckoner(replace(drive, pose=None), part, WHOLE, False), {}) is None


# Drift


def driven(steps: FloatArray, **models: FloatArray) -> DriveTracks:
    """A track of one piece from motions of reference and models."""
    poses = {"reference": chain(steps), **{name: chain(motion) for name, motion in models.items()}}
    poses["reference"][:, 2] = wrap(poses["reference"][:, 2])
    n = len(steps) + 1
    return DriveTracks("made", "pose", True, np.arange(n, dtype=float), np.zeros(n, int), poses)


def test_drift_by_hand() -> None:
    """Along a straight at 1 m a step: one model goes 10 % too far, another turns by 0.01 rad a step."""
    straight = np.tile([1.0, 0.0, 0.0], (60, 1))
    found = drift_per_10_m([driven(straight, nominal=straight * [1.1, 1.0, 1.0], calibrated=straight)])
    assert found is not None
    assert (found.whole, found.length, found.stretches) == (10.0, 10.0, 6.0)
    assert_allclose(found.errors["nominal"], 1.0)
    assert_allclose(found.errors["calibrated"], 0.0, atol=1e-12)
    bent = straight + [0.0, 0.0, 0.01]
    bow = drift_per_10_m([driven(straight, nominal=bent, calibrated=straight)])
    assert bow is not None
    assert_allclose(bow.errors["nominal"], np.hypot(*(chain(bent[:10])[-1, :2] - [10.0, 0.0])))


def test_without_headings_stretches_are_fitted() -> None:
    """A straight of 10 m against one that is 10 % longer, both centred: RMS of 5 % of the distance from the middle."""
    straight = np.tile([0.1, 0.0, 0.0], (400, 1))
    seen = replace(driven(straight, nominal=straight * [1.1, 1.0, 1.0], calibrated=straight), sees="position")
    turned = {**seen.poses, "reference": compose([5.0, -3.0, 2.0], seen.poses["reference"])}
    found = drift_per_10_m([replace(seen, poses=turned)])
    assert found is not None
    assert (found.is_fitted, found.whole, found.length) == (True, 10.0, 10.0)
    assert 3.0 <= found.stretches <= 4.0
    places = 0.1 * np.arange(101)
    assert_allclose(found.errors["nominal"], 0.1 * places.std(), rtol=1e-6)
    assert_allclose(found.errors["calibrated"], 0.0, atol=1e-9)


def test_short_drives_are_scaled_up() -> None:
    short = np.tile([0.5, 0.0, 0.0], (14, 1))
    found = drift_per_10_m([driven(short, nominal=short * [1.1, 1.0, 1.0], calibrated=short)])
    assert found is not None
    assert (found.length, found.stretches) == (2.0, 3.0)
    assert_allclose(found.errors["nominal"], 1.0)
    assert drift_per_10_m([driven(0.01 * short, nominal=short, calibrated=0.01 * short)]) is None


def test_yaw_per_turn_by_hand() -> None:
    """Ten degrees a step, left then right; the nominal model turns a quarter too far, both ways."""
    left = np.tile([0.0, 0.0, np.radians(10.0)], (100, 1))
    steps = np.concatenate([left, -left])
    found = yaw_per_turn([driven(steps, nominal=1.25 * steps, calibrated=steps)])
    assert found is not None
    assert (found.length, found.stretches) == (360.0, 4.0)
    assert_allclose(found.errors["nominal"], 90.0)
    assert_allclose(found.errors["calibrated"], 0.0, atol=1e-9)


def test_errors_to_the_left_and_to_the_right_do_not_cancel() -> None:
    left = np.tile([0.0, 0.0, np.radians(10.0)], (100, 1))
    steps = np.concatenate([left, -left])
    lopsided = steps + [0.0, 0.0, np.radians(1.0)]
    found = yaw_per_turn([driven(steps, nominal=lopsided, calibrated=steps)])
    assert found is not None
    assert_allclose(found.errors["nominal"], 36.0)


def test_the_calibration_of_the_sample_drifts_far_less() -> None:
    calibration, drive, folds = lab()
    evidence = gather(calibration, [drive], folds=folds)
    assert evidence.is_held_out
    assert evidence.drift is not None
    assert evidence.turn is not None
    assert evidence.drift.errors["calibrated"] < 0.2 * evidence.drift.errors["nominal"]
    assert evidence.turn.errors["calibrated"] < 0.1 * evidence.turn.errors["nominal"]
    again = gather(calibration, [drive])  # the fits made anew from what the calibration says of itself
    assert again.drift is not None
    assert_allclose(again.drift.errors["calibrated"], evidence.drift.errors["calibrated"], rtol=0.05)


# Fewer points


def test_thinning_keeps_the_ends_and_the_outlier() -> None:
    steps = exp(np.random.default_rng(2).normal([0.1, 0.0, 0.0], [0.01, 0.0, 0.1], (50_000, 3)))
    long = driven(steps, calibrated=steps)
    poses = {name: values.copy() for name, values in long.poses.items()}
    poses["reference"][31_416, :2] += [0.3, 0.4]
    outlier = replace(long, poses=poses)
    few = thin(outlier, 2000)
    assert len(few) <= 2000
    assert 31_416.0 in few.t
    for i in (0, 1):
        assert few.poses["reference"][:, i].max() == poses["reference"][:, i].max()
        assert few.poses["reference"][:, i].min() == poses["reference"][:, i].min()
    assert (few.t[0], few.t[-1]) == (0.0, 50_000.0)
    kept = few.t.astype(int)
    assert_allclose(few.poses["calibrated"], poses["calibrated"][kept])
    assert thin(outlier, 50_001) is outlier


@given(st.lists(st.floats(0.0, 1e3), min_size=1, max_size=300), st.integers(20, 100))
def test_the_worst_are_always_shown(sizes: list[float], most: int) -> None:
    size = np.array(sizes)
    shown = worst_and_some(size, most, 10)
    assert len(shown) == min(len(size), most)
    assert len(set(shown.tolist())) == len(shown)
    assert set(np.sort(size)[-10:].tolist()) <= set(size[shown].tolist())


def test_ten_hours_stay_small_and_show_the_wrong_pose() -> None:
    calibration, _, _ = lab()
    drive = long_drive(1.0, at=2000.05, jump=7.0)
    evidence = gather(calibration, [drive])
    assert len(evidence.tracks[0]) <= 12_000
    assert len(page(evidence).encode()) < 8e6
    assert drive.pose is not None
    wrong = drive.pose.t[np.searchsorted(drive.pose.t, 2000.05)]
    assert wrong in evidence.tracks[0].t
    assert max(float(np.nanmax(j.calibrated.translation)) for j in evidence.judged) < 8.0


# Chi and lambda


def test_chi_of_the_models() -> None:
    x = np.array([0.0, 0.5, 1.0, 4.0])
    assert_allclose(chi_of_model(Differential(0.4), x, 1.0, 0.5, 0.4), 1.0)
    wang = Curvature(0.5, 0.1, 1.0, 0.4)
    assert_allclose(chi_of_model(wang, x, -1.0, 0.5, 0.4), icr_coefficient(x, 0.5, 0.1), rtol=2e-4)
    # By hand, outer rim 0.5 m/s, lambda 1: the left rim stands, omega = alpha_right 0.5 / (y_l - y_r)
    chi = chi_of_model(TRUTH, np.array([1.0]), 1.0, 0.5, 0.4)
    assert_allclose(chi, 0.5624 / (0.9049 * 0.4))
    assert_allclose(chi_of_model(TRUTH, np.array([1.0]), -1.0, 0.5, 0.4), 0.5624 / (0.9271 * 0.4))


def test_the_turns_of_a_drive_lie_on_the_curve_of_its_truth(perfect: Drive) -> None:
    calibration = made_calibration(TRUTH, 1e-6 * np.eye(5))
    calibration = replace(
        calibration,
        names=(*calibration.names, "lag", "time_offset"),
        estimates={**calibration.estimates, "lag": Estimate(0.08, 0.0, "s"), "time_offset": Estimate(0.2, 0.0, "s")},
        covariance=1e-6 * np.eye(7),
    )
    centred = kinematic_drive(
        "centred", P3AT, TRUTH, perfect.wheels, Sensors(10.0, 0.0, 0.0, reference_delay=0.2), TIMING.lag
    )
    turns = gather(calibration, [centred]).turns
    assert turns is not None
    assert turns.found == "runs of constant rim speeds"
    side = np.sign(turns.path_curvature)
    assert len(set(side.tolist())) == 2
    for i in range(len(turns.chi)):
        size = np.abs(turns.path_curvature[i : i + 1])
        assert_allclose(turns.chi[i], chi_of_model(TRUTH, size, side[i], 0.5, P3AT.track_width), rtol=0.02)


# What is known of the robot


def test_a_robot_is_known_by_its_name() -> None:
    named = Vehicle("Clearpath-Husky-A200", track_width=0.55, wheel_radius=0.165)
    known = known_vehicle(named)
    assert (known.track_width, known.factory_multiplier, known.factory_separation) == (0.55, 1.875, 0.555)
    assert known.wheel_base == 0.512
    own = known_vehicle(replace(named, factory_multiplier=1.5, factory_separation=0.6))
    assert (own.factory_multiplier, own.factory_separation) == (1.5, 0.6)
    assert "shipped" not in uncalibrated(Vehicle("mine", track_width=0.55, wheel_radius=0.165))
    assert_allclose(uncalibrated(named)["shipped"].twist(-0.5, 0.5)[2], 1.0 / (1.875 * 0.555))


def test_the_options_of_a_fit_come_back() -> None:
    calibration, _, _ = lab()
    options = fit_options(calibration.provenance.options)
    assert options.mount == Mount()
    assert (options.lag, options.time_offset, options.robust) == (None, None, True)
    assert fit_options({"mount": "free", "lag": 0.1, "robust": False}).mount is None
    placed = fit_options({"mount": "0.1,-0.2,0.3", "lag": 0.0, "time_offset": -0.5, "align": True})
    assert placed.mount == Mount(0.1, -0.2, 0.3)
    assert (placed.lag, placed.time_offset, placed.align) == (0.0, -0.5, True)


# Markup


ATOMS = st.text() | st.floats() | st.integers() | st.none()


@given(st.recursive(ATOMS, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)))
@settings(max_examples=60)
def test_no_data_ends_its_element(value: object) -> None:
    element = embedded({"data": value}, "data")
    inside = element.removeprefix('<script type="application/json" id="data">').removesuffix("</script>")
    assert not set("<>&") & set(inside)
    assert inside.isascii()
    json.loads(inside)


@given(st.text())
def test_no_text_is_markup(text: str) -> None:
    class Reader(HTMLParser):
        tags: list[str]
        words = ""

        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            self.tags.append(tag)
            assert dict(attrs).get("title", printable(text)) == printable(text)

        def handle_data(self, data: str) -> None:
            self.words += data

    reader = Reader()
    reader.tags = []
    reader.feed(tag("p", text, [text], None, Html("<br>"), title=text))
    reader.close()
    assert reader.tags == ["p", "br"]
    assert markup(Html("<b>")) == "<b>"


@pytest.mark.parametrize(
    ("value", "digits", "unit", "words"),
    [
        (0.0347, 2, "m", "0.035 m"),
        (103.4, 2, "°", "103°"),
        (-1.25, 2, "", "−1.2"),
        (0.0, 2, "m", "0 m"),
        (9.96, 2, "m", "10 m"),
        (float("nan"), 2, "m", "–"),
        (0.00012345, 2, "", "0.00012"),
    ],
)
def test_numbers_for_people(value: float, digits: int, unit: str, words: str) -> None:
    assert rounded(value, digits, unit) == words


def test_value_and_sigma_have_the_same_places() -> None:
    assert spread(1.00234, 0.02871) == ("1.002", "0.029")
    assert spread(-0.5, 0.0996) == ("−0.50", "0.10")
    assert spread(512.3, 12.0) == ("512", "12")
    assert spread(0.25, 0.0) == ("0.25000", "fixed")


# The page


class Links(HTMLParser):
    """Every element that loads something, and every handler."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        if tag in ("img", "iframe", "link", "object", "embed", "a", "base", "form") or {"src", "href"} & named.keys():
            self.found.append((tag, named))
        if any(name.startswith("on") for name in named):
            self.found.append((tag, named))


def without_scripts(text: str) -> str:
    return re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)


def test_the_page_loads_nothing_and_runs_only_its_own_scripts() -> None:
    calibration, drive, folds = lab()
    text = page(gather(calibration, [drive], folds=folds))
    assert not Links(text).found
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    assert policy[1].startswith("default-src &#x27;none&#x27;; script-src &#x27;sha256-")
    assert len(text.encode()) < 8e6


def test_names_from_a_log_are_text() -> None:
    calibration, drives = hostile()
    text = page(gather(calibration, drives))
    assert not Links(text).found
    assert HURT not in text
    assert text.count("<script") == 3
    data = json.loads(text.split('id="data">')[1].split("</script>")[0])
    assert data["tracks"][0]["name"] == NAMES[0]
    names = json.dumps(list(data["charts"].values()))
    assert "<img" not in names
    assert "<a " not in names


def shown(evidence_text: str) -> str:
    return " ".join(re.sub(r"<[^>]*>", " ", without_scripts(evidence_text)).split())


SECTIONS = (
    *("summary", "trajectory", "configuration", "held-out", "residuals", "chi"),
    *("parameters", "observability", "log", "consistency", "provenance"),
)


def test_every_section_is_there() -> None:
    calibration, drive, folds = lab()
    text = page(gather(calibration, [drive], folds=folds))
    words = shown(text)
    for name in SECTIONS:
        assert f'id="{name}"' in text
    assert "Left out" not in words
    assert "held out, each block of time" in words
    multiplier = re.search(r"wheel_separation_multiplier: ([0-9.]+)", words)
    assert multiplier is not None
    assert f"1.5 → to {float(multiplier[1]):.3f}" in words
    for estimate in calibration.estimates.values():
        assert spread(estimate.value, estimate.sigma)[0] in words


def test_what_to_change_is_what_is_to_be_pasted() -> None:
    """A robot known by its name, with a track width of its own."""
    calibration, _, _ = lab()
    husky = Vehicle("clearpath-husky-a200", track_width=0.55, wheel_radius=0.165)
    words = shown(page(gather(replace(calibration, vehicle=husky))))
    told = {name: float(value) for name, value in re.findall(r"(wheel_separation\w*): ([0-9.]+)", words)}
    assert told["wheel_separation"] == 0.55
    assert f"{1.875 * 0.555 / 0.55:.4g} → to {told['wheel_separation_multiplier']:.3f}" in words
    assert f"1.875 → {told['wheel_separation_multiplier'] * 0.55 / 0.555:.3f}" in words


def test_what_has_no_reference_is_left_out_and_says_so() -> None:
    calibration, drive, _ = lab()
    words = shown(page(gather(calibration, [replace(drive, pose=None)])))
    for why in ("reference tells positions", "reference tells poses"):
        assert f"Left out: no drive whose {why}." in words
    assert "Left out: no drive with a reference or a gyro." in words
    assert "drift per 10 m" not in words
    alone = shown(page(gather(calibration)))
    assert "No drive is at hand" in alone
    assert "turns on the spot as if it were" in alone


def test_foreign_drives_are_told_from_its_own() -> None:
    calibration, drive, folds = lab()
    other = gather(calibration, [replace(drive, name="another day")])
    assert other.is_held_out
    assert not other.is_seen
    assert "drives that it was not made from" in shown(page(other))
    half = replace(calibration.provenance.drives[0], name="the other half")
    more = replace(
        calibration, provenance=replace(calibration.provenance, drives=(*calibration.provenance.drives, half))
    )
    part = gather(more, [drive])
    assert part.is_seen
    assert not part.is_held_out
    assert "somewhat too good" in shown(page(part))
    assert folds is not None


# The command line


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Calibration file and drive folder."""
    folder = tmp_path_factory.mktemp("saved")
    calibration, drive, _ = lab()
    save_calibration(calibration, folder / "calibration.yaml")
    write_folder(drive, folder / "a drive")
    return folder / "calibration.yaml", folder / "a drive"


def test_calibrate_writes_the_report(call: Call, tmp_path: Path, saved: tuple[Path, Path]) -> None:
    code, _, _ = call("calibrate", saved[1], "--model", "multiplier", "--out", tmp_path / "out")
    assert code == 0
    assert "held out, each block of time" in shown((tmp_path / "out" / "report.html").read_text())


def test_report_on_another_drive(call: Call, tmp_path: Path, saved: tuple[Path, Path]) -> None:
    file = tmp_path / 'it\'s "new".html'
    code, out, _ = call("report", saved[0], saved[1], "--out", file, "--window", "4")
    assert code == 0
    assert out == f"written: {file}\n"
    assert "Each point is a window of up to 4 s" in shown(file.read_text())


def test_report_of_circle_runs(call: Call, tmp_path: Path) -> None:
    assert call("calibrate", "sample:rover-4wd1", "--out", tmp_path)[0] == 0
    made = (tmp_path / "report.html").read_text()
    data = json.loads(made.split('id="data">')[1].split("</script>")[0])
    points = [trace for trace in data["charts"]["chi"]["data"] if trace["mode"] == "markers"]
    assert [trace["name"] for trace in points] == ["indoor", "outdoor", "football"]
    assert [len(trace["x"]) for trace in points] == [10, 10, 5]
    words = shown(made)
    assert "football" in words
    assert "Left out: no drive whose reference tells positions." in words
    code, _, _ = call("report", tmp_path / "calibration.yaml", "sample:rover-4wd1", "--out", tmp_path / "again.html")
    assert code == 0
    again = json.loads((tmp_path / "again.html").read_text().split('id="data">')[1].split("</script>")[0])
    assert again["charts"]["chi"] == data["charts"]["chi"]


def test_report_without_a_drive(call: Call, tmp_path: Path, saved: tuple[Path, Path]) -> None:
    assert call("report", saved[0], "--out", tmp_path / "r.html")[0] == 0
    assert "No drive is at hand" in shown((tmp_path / "r.html").read_text())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--out", "{tmp}"), "is a folder"),
        (("--out", "{tmp}/none/r.html"), "create it first"),
        (("--profile", "ice"), "no profile 'ice'"),
        (("--window", "0"), "--window must be a positive time"),
        (("{tmp}/nothing",), "no such drive"),
    ],
)
def test_a_report_that_cannot_be_is_one_clear_line(
    words: tuple[str, ...], told: str, call: Call, tmp_path: Path, saved: tuple[Path, Path]
) -> None:
    code, out, err = call("report", saved[0], *(word.format(tmp=tmp_path) for word in words))
    assert (code, out) == (1, "")
    assert told in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_no_room_leaves_no_part_of_a_page(
    call: Call, tmp_path: Path, saved: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "r.html").write_text("the old one")

    def full(_: int) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", full)
    code, _, err = call("report", saved[0], "--out", tmp_path / "r.html", "--force")
    assert code == 1
    assert "No space left on device" in err
    assert (tmp_path / "r.html").read_text() == "the old one"
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


def test_reports_of_real_drives(real: Callable[[str], Path]) -> None:
    """A gyro alone; windows; a calibration that is not theirs."""
    from skidsteer.io.drives import load_drive

    calibration, _, _ = lab()
    gyro = gather(calibration, [load_drive(real("husky-gyro-flooring"))])
    assert gyro.turn is not None
    assert gyro.drift is None
    assert not gyro.tracks
    assert "Against the gyro alone" in shown(page(gyro))
    windows = load_drive(real("warthog-gravel-windows"))
    some = gather(calibration, [windows.with_segments(np.arange(30))])
    assert some.drift is not None
    assert len(set(some.tracks[0].piece.tolist())) == 30


def test_the_calibration_file_keeps_the_intervals(saved: tuple[Path, Path]) -> None:
    known, read = lab()[0], load_calibration(saved[0])
    held = known.held_out["icr"].median_95
    assert held is not None
    assert {"translation_m", "yaw_deg"} <= held.keys()
    assert read.held_out["icr"].median_95 == held
    low, high = held["translation_m"]
    assert low <= known.held_out["icr"].translation_m.median <= high


def test_restarts_are_rigid(perfect: Drive) -> None:
    """What the page does to begin anew, done here: the same motion from another pose."""
    found = tracks_of(Reckoner(perfect, (Part(TRUTH, TIMING, MOUNT),), WHOLE, False), uncalibrated(P3AT))
    assert found is not None
    poses, reference, i, j = found.poses["nominal"], found.poses["reference"], 50, 90
    moved = compose(compose(reference[i], invert(poses[i])), poses[j])
    assert_allclose(between(reference[i], moved), between(poses[i], poses[j]), atol=1e-9)
