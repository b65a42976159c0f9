import numpy as np
import pytest
from numpy.testing import assert_allclose

from skidsteer.drive import Series
from skidsteer.reproduce import repeated_samples, thalmann2016
from skidsteer.reproduce.thalmann_drives import COUNT, LABORATORY, counted, drive, with_repeats


def test_counts_of_the_encoders_add_up_to_what_was_rolled() -> None:
    t = np.arange(0.0, 20.0, 0.01)
    rims = Series(t, np.stack([0.5 + 0.2 * np.sin(t), 0.3 + 0.0 * t], axis=1))
    wheels = counted(rims)
    rolled = wheels.values.sum(axis=0) * 0.1
    assert_allclose(rolled, rims.values[: 10 * len(wheels)].sum(axis=0) * 0.01, atol=COUNT)
    assert_allclose(np.diff(wheels.t), 0.1)


def test_repeats_come_under_acceleration_on_one_side() -> None:
    t = 0.1 * np.arange(400)
    v = np.clip(0.025 * np.arange(400.0), 0.0, 5.0)
    clean = Series(t, np.stack([v, v], axis=1))
    wheels, repeated = with_repeats(clean, 0.5, np.random.default_rng(0))
    assert not repeated.all(axis=1).any()
    assert not repeated[201:].any()  # at constant speed
    assert 60 < repeated.sum() < 140
    k, side = np.argwhere(repeated)[0]
    assert wheels.values[k, side] == clean.values[k - 1, side]
    assert_allclose(wheels.values[~repeated], clean.values[~repeated])


def test_simulated_drives_last_6_to_7_minutes_at_half_a_metre_a_second() -> None:
    wheels, tracking = drive(LABORATORY, 0)
    assert 360.0 < wheels.t[-1] < 420.0
    assert 0.4 < np.abs(wheels.values).mean() < 0.6
    assert np.ptp(tracking.positions.values, axis=0).max() < 20.0
    assert not np.array_equal(drive(LABORATORY, 1)[0].values[:100], wheels.values[:100])


def test_repeated_samples_are_found_by_the_alternative_model_and_not_by_the_basic_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(repeated_samples, "RUNS", 60)
    for disturbance in (0.05, 0.25):
        basic = repeated_samples.detection("basic", disturbance)
        alternative = repeated_samples.detection("alternative", disturbance)
        assert alternative.found > 0.8
        assert alternative.false < 0.01
        assert basic.found <= basic.false  # what it excludes is rather the good samples


def test_two_phases_at_one_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thalmann2016, "DRIVES", 2)
    monkeypatch.setattr(thalmann2016, "DURATIONS", (20.0, 180.0))
    monkeypatch.setattr(thalmann2016, "WINDOWS", 6)
    done = thalmann2016.site_study(LABORATORY)
    assert len(done.slips) == 2
    for e in done.slips:
        assert abs(e.value - LABORATORY.slip) < 3.0 * e.sigma
    assert done.loss.errors["basic"].shape == (2, 6)
    assert done.reduction[1] > 50.0
    study = thalmann2016.Study(
        (done, done),
        tuple(repeated_samples.Detection(n, d, 0.5, 0.1, 0.0) for n in ("basic", "alternative") for d in (0.1, 0.2)),
    )
    rows = thalmann2016.rows(study)
    assert [r.verdict for r in rows[:5]] == ["reproduced"] * 5
    figures = {f.name: f for f in thalmann2016.figures(study)}
    assert list(figures) == [f"figure-{n}" for n in (4, 5, 7, 8, 9, 10, "10-shares", 11, 12, 13)]
    basic, extended = figures["figure-13"].curves
    assert_allclose(basic.y, np.median(done.loss.errors["basic"], axis=1))
    assert extended.label == "extended"
    assert_allclose(figures["figure-11"].curves[0].y, [e.value for e in done.slips])


def test_geometry_figures_follow_the_closed_form() -> None:
    over_speed, over_radius = thalmann2016.geometry_figures()
    ten = next(c for c in over_speed.curves if c.label == "10 Hz")
    assert_allclose(ten.y, 1e3 * (0.1 * ten.x) ** 2 / (2.0 * 5.0), rtol=1e-3, atol=1e-9)
    ten = next(c for c in over_radius.curves if c.label == "10 Hz")
    assert_allclose(ten.y, 1e3 * 0.05**2 / (2.0 * ten.x), rtol=1e-2)
