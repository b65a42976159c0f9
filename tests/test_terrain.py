"""Whether grounds differ: the test against hand calculation and its own promise, profiles, the commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import binom
from scipy.stats import t as student

from conftest import Call
from skidsteer.calibration import Calibration
from skidsteer.drive import Drive
from skidsteer.errors import RequestError
from skidsteer.identify.calibrate import CalibrateOptions
from skidsteer.identify.holdout import held_out
from skidsteer.identify.least_squares import Fit, FitOptions, fit
from skidsteer.identify.select import Comparison, Excess
from skidsteer.identify.terrain import (
    Difference,
    Pair,
    Terrains,
    _same_windows,
    calibrate_profiles,
    compare_terrains,
    wald_test,
)
from skidsteer.io.calibration_file import calibration_text, load_calibration, save_calibration
from skidsteer.io.folder import write_folder
from skidsteer.metrics import window_errors
from skidsteer.models import Differential, Icr, Multiplier
from skidsteer.noise import Noise
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import preset
from skidsteer.windows import Timing, increment_windows

P3AT = preset("pioneer-p3at")
ASPHALT = Icr(0.26, -0.31, -0.03, 0.93, 0.91)
GRASS = Icr(0.34, -0.38, -0.02, 0.90, 0.88)
SENSORS = Sensors(position_sigma=0.01, yaw_sigma=float(np.radians(0.5)), reference_delay=0.15)
NOISE = (0.004, 0.008)
KNOWN = FitOptions(noise=Noise(SENSORS.position_sigma, SENSORS.yaw_sigma, 1e-5, *NOISE), robust=False)  # quick


def driven(truth: Icr, seed: int, legs: int = 16, name: str = "drive") -> Drive:
    rng = np.random.default_rng(seed)
    rows = [[2.0, rng.uniform(-0.4, 0.6), rng.uniform(-0.8, 0.8)] for _ in range(legs)]
    plan = np.array([[1.0, 0.0, 0.0], *rows, [1.0, 0.0, 0.0]])
    rims = rims_from_manoeuvres(plan, Differential(P3AT.track_width), rate=20.0)
    return kinematic_drive(name, P3AT, truth, rims, SENSORS, 0.08, NOISE, seed)


def fitted(truth: Icr, seed: int) -> Fit:
    drive = driven(truth, seed)
    return fit(Icr.nominal(P3AT), [drive], [increment_windows(drive)], KNOWN)


@pytest.fixture(scope="module")
def some() -> Fit:
    return fitted(ASPHALT, 0)


# The test


def test_by_hand(some: Fit) -> None:
    """Two multipliers, 1.5 +- 0.3 and 1.9 +- 0.4: (0.4 / 0.5)^2 = 0.64 with one degree of freedom.

    34 s are four stretches of 10 s; F with 1 and 8 degrees of freedom is the square of Student's t with 8.
    """
    drive = driven(ASPHALT, 0)
    options = replace(KNOWN, time_offset=0.15, lag=0.08)
    found = fit(Multiplier.nominal(P3AT), [drive], [increment_windows(drive)], options)

    def with_value(value: float, sigma: float) -> Fit:
        values, covariance = found.values.copy(), found.covariance.copy()
        values[0], covariance[0, 0] = value, sigma**2
        return replace(found, values=values, covariance=covariance)

    result = wald_test([with_value(1.5, 0.3), with_value(1.9, 0.4)])
    assert result.statistic == pytest.approx(0.64)
    assert (result.freedom, result.stretches) == (1, 8)
    assert result.p == pytest.approx(2.0 * float(student.sf(0.8, 8)))
    three = wald_test([with_value(1.5, 0.3), with_value(1.9, 0.4), with_value(1.7, 0.2)])
    mean = (1.5 / 0.09 + 1.9 / 0.16 + 1.7 / 0.04) / (1 / 0.09 + 1 / 0.16 + 1 / 0.04)
    parts = [((v - mean) / s) ** 2 for v, s in ((1.5, 0.3), (1.9, 0.4), (1.7, 0.2))]
    assert three.statistic == pytest.approx(sum(parts))
    assert three.freedom == 2


def test_two_fits_give_the_quadratic_form_of_their_difference(some: Fit) -> None:
    other = fitted(GRASS, 1)
    difference = some.values[:5] - other.values[:5]
    total = some.covariance[:5, :5] + other.covariance[:5, :5]
    result = wald_test([some, other])
    assert result.statistic == pytest.approx(float(difference @ np.linalg.solve(total, difference)))
    assert result.freedom == 5
    assert result.p < 1e-6
    assert wald_test([some, some]).p == 1.0


def test_false_alarms_come_as_often_as_promised() -> None:
    """Pairs of drives on one ground; benchmarks/terrain.py does the same with estimated noise and 200 pairs."""
    pairs = 50
    fits = [fitted(ASPHALT, 100 + seed) for seed in range(2 * pairs)]
    results = [wald_test(fits[i : i + 2]) for i in range(0, 2 * pairs, 2)]
    alarms = sum(r.p < 0.05 for r in results)
    assert binom.ppf(0.005, pairs, 0.05) <= alarms <= binom.ppf(0.995, pairs, 0.05)
    statistic = np.mean([r.statistic for r in results])
    assert abs(statistic - 5.0) < 3.0 * np.sqrt(2.0 * 5.0 / pairs)


def test_a_ground_that_is_four_percent_wider_is_found() -> None:
    wider = replace(ASPHALT, icr_y_left=1.04 * ASPHALT.icr_y_left, icr_y_right=1.04 * ASPHALT.icr_y_right)
    found = [wald_test([fitted(ASPHALT, 300 + 2 * i), fitted(wider, 301 + 2 * i)]).p < 0.05 for i in range(8)]
    assert sum(found) >= 7


def test_directions_that_a_drive_leaves_open_are_not_compared(some: Fit) -> None:
    """A drive of straights knows nothing of the ICRs: three directions less, and no false agreement."""
    rows = np.array([[2.0, 0.0, 0.0], *[[12.0, 0.4, 0.0], [1.0, 0.0, 0.0]] * 2])
    rims = rims_from_manoeuvres(rows, Differential(P3AT.track_width), rate=20.0)
    truth = Icr(0.26, -0.31, -0.03, 0.92, 0.92)
    straights = kinematic_drive("straights", P3AT, truth, rims, SENSORS, 0.08, NOISE, 5)
    other = fit(Icr.nominal(P3AT), [straights], [increment_windows(straights)], KNOWN)
    assert wald_test([some, other]).freedom == 2


def test_what_cannot_be_compared(some: Fit) -> None:
    with pytest.raises(RequestError, match="need two fits or more of one model"):
        wald_test([some])
    blank = replace(some, covariance=np.diag(some.prior_sigma**2) * some.free)
    with pytest.raises(RequestError, match="nothing that all of the grounds' drives determine"):
        wald_test([blank, blank])
    with pytest.raises(RequestError, match="need drives of two grounds or more, got one"):
        compare_terrains({"one": [driven(ASPHALT, 0)]})


# The verdict

WORSE = Comparison(Excess(0.1, 0.05, 0.15, 1e-4, 0.1), Excess(0.4, 0.2, 0.6, 1e-6, 0.4))
UNSURE = Comparison(Excess(0.3, -0.5, 3.0, 0.3, 0.3), Excess(0.4, -0.6, 4.0, 0.3, 0.4))
EQUAL = Comparison(Excess(0.01, -0.05, 0.07, 0.4, 0.0), Excess(-0.02, -0.1, 0.06, 0.7, 0.0))


@pytest.mark.parametrize(
    ("p", "a_on_b", "b_on_a", "needed", "words"),
    [
        (0.4, WORSE, WORSE, False, "these 2 grounds need one profile only (p = 0.4)"),
        (0.001, EQUAL, EQUAL, False, "the models of the grounds differ (p = 0.001), but none surely predicts another"),
        (0.001, EQUAL, UNSURE, False, "the models of the grounds differ (p = 0.001), but none surely predicts another"),
        (0.001, EQUAL, WORSE, True, "profiles of their own (p = 0.001): on ice the calibration of mud against its own"),
        (0.001, None, None, True, "differ (p = 0.001); the drives are too short to tell how much that matters"),
    ],
)
def test_sentences(p: float, a_on_b: Comparison | None, b_on_a: Comparison | None, needed: bool, words: str) -> None:
    found = Terrains(
        "icr",
        ("ice", "mud"),
        Difference(9.0, 5, 20, p),
        (Pair("ice", "mud", Difference(9.0, 5, 20, p), a_on_b, b_on_a),),
    )
    assert found.needed is needed
    assert words in found.because


@pytest.fixture(scope="module")
def grounds() -> dict[str, list[Drive]]:
    return {
        "asphalt": [driven(ASPHALT, 1, 40, "monday")],
        "grass": [driven(GRASS, 2, 40, "tuesday")],
    }


OPTIONS = CalibrateOptions(spacing=0.0, fit=KNOWN)


def test_other_grounds_are_told_apart_and_it_matters(grounds: dict[str, list[Drive]]) -> None:
    found = compare_terrains(grounds, "icr", OPTIONS)
    (pair,) = found.pairs
    assert found.needed
    assert pair.difference == found.difference
    assert pair.a_on_b is not None
    assert pair.b_on_a is not None
    for comparison in (pair.a_on_b, pair.b_on_a):
        assert comparison.yaw is not None
        assert comparison.yaw.share > 0.5
        assert comparison.surely_worse


def test_the_same_ground_is_not(grounds: dict[str, list[Drive]]) -> None:
    same = {"one": grounds["asphalt"], "other": [driven(ASPHALT, 7, 40), driven(ASPHALT, 8, 20)]}
    found = compare_terrains(same, "icr", OPTIONS)
    assert found.difference.p > 0.01
    assert not found.needed
    (pair,) = found.pairs
    assert pair.a_on_b is not None
    assert pair.a_on_b.yaw is not None
    assert pair.a_on_b.yaw.low < 0.0 < pair.a_on_b.yaw.high


def test_errors_are_compared_on_the_same_windows() -> None:
    """Held-out errors come fold by fold, those of another model drive by drive."""
    drives = [driven(ASPHALT, 7, 24), driven(ASPHALT, 8, 16)]
    own = held_out(Icr.nominal(P3AT), drives, KNOWN)
    assert own is not None
    parts = [window_errors(GRASS, drive, Timing(0.15, 0.08)) for drive in drives]
    matched = _same_windows(parts, own)
    assert_allclose(matched.start, own.errors.start)
    assert_allclose(matched.end, own.errors.end)
    for i in (0, 1):
        here = own.block // 1000 == i
        assert set(matched.yaw[here]) <= set(parts[i].yaw)


# Profiles


@pytest.fixture(scope="module")
def profiled(grounds: dict[str, list[Drive]]) -> Calibration:
    return calibrate_profiles(grounds, replace(OPTIONS, model="icr"))


def test_profiles_are_of_their_grounds(profiled: Calibration) -> None:
    assert set(profiled.profiles) == {"asphalt", "grass"}
    for name, truth in (("asphalt", ASPHALT), ("grass", GRASS)):
        profile = profiled.profile(name)
        assert [d.name for d in profile.provenance.drives] == [{"asphalt": "monday", "grass": "tuesday"}[name]]
        for parameter, estimate in profile.parameters.items():
            assert abs(estimate.value - getattr(truth, parameter)) < 4.0 * estimate.sigma
    between = [profiled.profile(name).estimates["icr_y_left"].value for name in ("asphalt", "grass")]
    assert between[0] < profiled.estimates["icr_y_left"].value < between[1]
    assert profiled.profile(None) is profiled
    assert profiled.warnings[-1].startswith("the grounds need profiles of their own")
    with pytest.raises(RequestError, match=r"^no profile 'ice'; there are: asphalt, grass$"):
        profiled.profile("ice")
    with pytest.raises(RequestError, match=r"^no profile 'ice'; the calibration has none$"):
        profiled.profile("grass").profile("ice")


def test_profiles_are_kept_in_the_file(profiled: Calibration, tmp_path: Path) -> None:
    save_calibration(profiled, tmp_path / "calibration.yaml")
    again = load_calibration(tmp_path / "calibration.yaml")
    assert calibration_text(again) == calibration_text(profiled)
    assert again.profile("grass").estimates == profiled.profile("grass").estimates
    assert again.profile("grass").observability == profiled.profile("grass").observability
    text = (tmp_path / "calibration.yaml").read_text(encoding="utf-8")
    old = text[: text.index("\nprofiles:") + 1]  # as before there were profiles
    (tmp_path / "old.yaml").write_text(old, encoding="utf-8")
    assert load_calibration(tmp_path / "old.yaml").profiles == {}


# The commands


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("drives")
    for name, truth, seed in (("asphalt", ASPHALT, 1), ("grass", GRASS, 2)):
        write_folder(driven(truth, seed, 12), root / name)
    return {name: root / name for name in ("asphalt", "grass")}


def test_terrains_command(folders: dict[str, Path], call: Call) -> None:
    code, out, _ = call("terrains", f"a={folders['asphalt']}", folders["grass"], "--model", "icr_symmetric", "--json")
    document = json.loads(out)
    assert code == 0
    assert document["grounds"] == ["a", "grass"]
    assert document["p"] < 1e-3
    assert document["freedom"] == 2
    assert document["profiles_needed"] is True
    assert document["pairs"][0]["b_on_a"]["yaw"]["share"] > 0.2


def test_calibrate_with_profiles_and_evaluate_one(
    folders: dict[str, Path], tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def quick(grounds: dict[str, list[Drive]], options: CalibrateOptions, _: object) -> Calibration:
        return calibrate_profiles(grounds, replace(options, spacing=0.0, fit=KNOWN))

    monkeypatch.setattr("skidsteer.identify.terrain.calibrate_profiles", quick)
    words = [f"--profile={name}={path}" for name, path in folders.items()]
    code, out, _ = call("calibrate", *words, "--model", "multiplier", "--out", tmp_path, "--json")
    document = json.loads(out)
    assert code == 0
    assert set(document["profiles"]) == {"asphalt", "grass"}
    assert any("profiles of their own" in w for w in document["warnings"])
    errors = {}
    for name in ("asphalt", "grass"):
        _, out, _ = call("evaluate", tmp_path / "calibration.yaml", folders["grass"], "--profile", name, "--json")
        errors[name] = json.loads(out)["yaw_deg"]["rms"]
    assert errors["grass"] < 0.5 * errors["asphalt"]


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("terrains", "=x"), 1, "'=x': give GROUND=DRIVE, such as grass=drives/monday"),
        (("terrains", "sample:p3at-mandow"), 1, "need drives of two grounds or more, got p3at-mandow"),
        (("terrains", "a=sample:p3at-mandow", "b=sample:rover-4wd1"), 1, "the drives are of different robots"),
        (("terrains", "a=sample:p3at-mandow", "b=sample:p3at-mandow", "--model", "magic"), 1, "no model 'magic'"),
        (("calibrate", "--profile", "a=sample:p3at-mandow"), 1, "need drives of two grounds or more, got a"),
        (("calibrate", "sample:p3at-mandow", "--profile", "a=sample:p3at-mandow"), 2, "give drives, or --profile"),
        (("calibrate",), 2, "give drives, or --profile"),
    ],
)
def test_refusals(words: tuple[str, ...], code: int, message: str, call: Call) -> None:
    got, out, err = call(*words)
    assert (got, out) == (code, "")
    assert message in " ".join(err.split())
