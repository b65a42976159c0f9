import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError, RequestError
from skidsteer.identify.calibrate import calibrate
from skidsteer.identify.circle_test import (
    FoundRun,
    RunOptions,
    chi_of_run,
    circle_test,
    fit_coefficient,
    fit_runs,
    icr_error,
    runs_from_drive,
    runs_on,
    side_result,
    wang_protocol,
)
from skidsteer.models import Curvature, Icr, SymmetricIcr
from skidsteer.models.curvature import icr_coefficient
from skidsteer.models.slip_ratio import CircleRun
from skidsteer.reproduce import giannoccaro2015, wang2015
from skidsteer.reproduce.rows import Row, compared
from skidsteer.samples import SAMPLES, rover_runs, sample
from skidsteer.se2 import exp
from skidsteer.simulate import Sensors, kinematic_drive
from skidsteer.vehicle import preset
from skidsteer.windows import Timing, increment_windows, predict

P3AT = preset("pioneer-p3at")
ROVER = preset("rover-4wd1")
EXACT = Sensors(reference_rate=10.0, position_sigma=0.0, yaw_sigma=0.0)


def rims_of(rows: np.ndarray, hold: float = 4.0, rest: float = 1.0, rate: float = 50.0) -> Series:
    """Each pair of rim speeds held, with rests between."""
    slot = round((hold + rest) * rate)
    values = np.zeros((slot * len(rows), 2))
    for i, row in enumerate(rows):
        values[i * slot : i * slot + round(hold * rate)] = row
    return Series(np.arange(len(values)) / rate, values, "wheels")


# Wang


def test_protocol_by_hand() -> None:
    rows = wang_protocol()
    assert rows.shape == (40, 4)
    assert_allclose(rows[2], [0.0, 0.3, -0.3, 0.3])  # on the spot
    assert_allclose(rows[5], [1.0, 0.1, 0.0, 0.2])  # left side at rest
    assert_allclose(rows[20 + 3], [4.0, 0.4, 0.3, 0.5])
    moving = rows[5:]
    assert_allclose((moving[:, 2] + moving[:, 3]) / (moving[:, 3] - moving[:, 2]), moving[:, 0])  # Eq. (13)
    assert_allclose(moving[:, 2:].mean(axis=1), moving[:, 1])


def test_protocol_within_the_limits_of_wangs_robot() -> None:
    rows = wang_protocol(0.7)
    assert len(rows) == 37
    assert np.abs(rows[:, 2:]).max() <= 0.7 + 1e-9
    assert wang_protocol(0.05).shape == (0, 4)


def test_chi_by_hand() -> None:
    # y0 = (1.6 - 0.4) / (2 * 2.0) = 0.3, chi = 0.6 / 0.4; a right turn is the same
    assert_allclose(chi_of_run([0.4, 1.6], [1.6, 0.4], [2.0, -2.0], 0.4), [1.5, 1.5])
    with pytest.raises(ValueError, match="need an angle other than 0"):
        chi_of_run(1.0, 1.0, 0.0, 0.4)


def test_error_of_y0_as_printed() -> None:
    """Eq. (43): 0.007 m."""
    assert icr_error((0.0, 0.46), 0.25 * np.pi, (0.00026, 0.00020), 0.018) == pytest.approx(0.007, abs=5e-4)


def test_refit_of_table_three() -> None:
    fit = fit_coefficient(np.arange(8), wang2015.TABLE_3)
    assert (round(fit.a, 3), round(fit.b, 3), round(fit.rms, 4)) == (0.468, 0.050, 0.0025)
    assert fit.converged
    assert not fit.at_bound
    assert fit.pairs == 8
    assert np.sqrt(np.diag(fit.covariance)) == pytest.approx([0.0024, 0.0031], abs=1e-4)
    model = fit.model(P3AT, alpha=0.9)
    assert (model.a, model.b, model.alpha, model.track_width) == (fit.a, fit.b, 0.9, 0.40)


@given(st.floats(-0.5, 5.0).filter(lambda a: abs(a) > 0.05), st.floats(0.0, 2.0))
def test_fit_recovers_any_curve(a: float, b: float) -> None:
    x = np.arange(10.0)
    fit = fit_coefficient(x, icr_coefficient(x, a, b))
    assert fit.rms < 1e-6
    assert_allclose([fit.a, fit.b], [a, b], rtol=1e-3, atol=1e-4)


def test_covariance_is_the_scatter_of_fits() -> None:
    rng = np.random.default_rng(4)
    x, truth = np.tile(np.arange(8.0), 5), (0.6, 0.3)
    fits = [fit_coefficient(x, icr_coefficient(x, *truth) + 0.006 * rng.standard_normal(40)) for _ in range(300)]
    values = np.array([[f.a, f.b] for f in fits])
    claimed = np.mean([f.covariance for f in fits], axis=0)
    assert_allclose(np.cov(values.T), claimed, rtol=0.25)
    assert_allclose(values.mean(axis=0), truth, atol=0.01)


def test_weights_let_the_better_runs_decide() -> None:
    x = np.arange(6.0)
    chi = icr_coefficient(x, 0.5, 0.1)
    chi[5] += 0.2
    fit = fit_coefficient(x, chi, [1, 1, 1, 1, 1, 1e-4])
    assert_allclose([fit.a, fit.b], [0.5, 0.1], atol=1e-4)


def test_a_chi_that_grows_with_lambda_is_told() -> None:
    fit = fit_coefficient([0.0, 1.0, 4.0], [1.3, 1.4, 1.6])
    assert fit.at_bound
    assert np.isfinite(fit.covariance).all()


def test_wide_arcs_alone_are_told() -> None:
    """Far out only a / b shows: chi - 1 falls as 1 / sqrt(lambda)."""
    fit = fit_coefficient([4.0, 9.0, 16.0, 25.0], [2.0, 1.6, 1.45, 1.35])
    assert fit.at_bound
    assert fit.b == 10.0


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        ([1.0, 2.0], [1.4, 1.3], "2 runs cannot tell a, b and their error"),
        ([], [], "0 runs cannot tell"),
        ([2.0, 2.0, 2.0], [1.4, 1.4, 1.3], "all 3 runs have a lambda near 2.00"),
        ([1.0, 2.0, np.inf], [1.4, 1.4, 1.3], "need as many finite lambda as chi"),
        ([1.0, 2.0, 3.0], [1.4, np.nan, 1.3], "need as many finite lambda as chi"),
        ([1.0, 2.0, 3.0], [1.4, 1.3], "need as many finite lambda as chi"),
    ],
)
def test_fits_that_cannot_be_are_refused(x: list[float], y: list[float], message: str) -> None:
    with pytest.raises(RequestError, match=re.escape(message)):
        fit_coefficient(x, y)


# Runs in a drive


def test_wangs_experiment_from_end_to_end() -> None:
    """The protocol driven by a known curve: every run is found, and a and b come back."""
    truth, rows = Curvature(0.468, 0.050, 1.0, P3AT.track_width), wang_protocol(0.7)
    drive = kinematic_drive("protocol", P3AT, truth, rims_of(rows[:, 2:]), EXACT)
    runs = runs_from_drive(drive, options=RunOptions(least_turn=0.1))
    assert len(runs) == len(rows)
    assert_allclose([run.path_curvature for run in runs], rows[:, 0], atol=1e-9)
    brisk = [run for run, row in zip(runs, rows, strict=True) if row[1] > 0.15]
    chi = [run.chi(P3AT.track_width) for run in brisk]
    assert_allclose(chi, icr_coefficient([run.path_curvature for run in brisk], 0.468, 0.050), atol=2e-4)
    fit = fit_runs(runs, P3AT.track_width)
    assert_allclose([fit.a, fit.b], [0.468, 0.050], atol=5e-4)


def test_protocol_with_noise_is_told_within_its_sigmas() -> None:
    truth = Curvature(0.6, 0.2, 1.0, P3AT.track_width)
    sensors = replace(EXACT, position_sigma=0.005, yaw_sigma=0.01)
    pulls = []
    for seed in range(12):
        drive = kinematic_drive("noisy", P3AT, truth, rims_of(wang_protocol(0.7)[:, 2:]), sensors, seed=seed)
        fit = fit_runs(runs_from_drive(drive), P3AT.track_width)
        pulls.append((np.array([fit.a, fit.b]) - [0.6, 0.2]) / np.sqrt(np.diag(fit.covariance)))
    assert np.abs(pulls).max() < 4.0
    assert 0.5 < float(np.sqrt(np.mean(np.square(pulls)))) < 1.6


def test_radius_of_found_runs_by_hand() -> None:
    """Sides at 0.3 and 0.6 m/s with ICRs at +-0.3 m: omega 0.5, v_x 0.45; icr_x = 0.1 makes v_y -0.05."""
    drive = kinematic_drive("arc", P3AT, Icr(0.3, -0.3, 0.1, 1.0, 1.0), rims_of(np.array([[0.3, 0.6]]), 30.0), EXACT)
    (run,) = runs_from_drive(drive)
    assert run.path_curvature == pytest.approx(3.0)
    assert run.angle == pytest.approx(0.5 * (run.end - run.start))  # more than a whole turn
    assert run.chi(0.4) == pytest.approx(1.5)
    circle = run.circle("lawn")
    assert circle is not None
    assert circle.radius == pytest.approx(np.hypot(0.45, 0.05) / 0.5, rel=1e-6)
    assert circle.speed == pytest.approx(np.hypot(0.45, 0.05), rel=1e-6)
    assert (circle.surface, circle.direction) == ("lawn", "left")


def test_backward_and_opposed_runs() -> None:
    rows = np.array([[-0.3, -0.6], [-0.3, 0.3], [0.6, 0.3]])
    drive = kinematic_drive("three", P3AT, SymmetricIcr(0.3, 1.0), rims_of(rows), EXACT)
    back, spot, right = runs_from_drive(drive)
    assert back.distance < 0.0
    circle = back.circle()
    assert circle is not None
    assert circle.direction == "left"
    assert spot.circle() is None
    assert right.angle < 0.0


def test_what_follows_a_change_of_speed_is_left_out() -> None:
    """With a lag of 0.15 s the body is behind for half a second; after it chi is that of the model."""
    rows = np.array([[0.3, 0.6], [0.6, 0.2], [0.2, 0.4]])
    drive = kinematic_drive("lag", P3AT, SymmetricIcr(0.3, 1.0), rims_of(rows, rest=0.0), EXACT, lag=0.1)
    chi = [run.chi(0.4) for run in runs_from_drive(drive, options=RunOptions(settle=1.0))]
    assert len(chi) == 3
    assert_allclose(chi[1:], 1.5, rtol=1e-3)
    hasty = [run.chi(0.4) for run in runs_from_drive(drive, options=RunOptions(settle=0.0))]
    assert np.abs(np.array(hasty) - 1.5).max() > 0.01


def test_a_delay_of_the_reference_is_taken_out() -> None:
    rims = rims_of(np.array([[0.3, 0.6], [0.6, 0.3]]))
    late = kinematic_drive("late", P3AT, SymmetricIcr(0.3, 1.0), rims, replace(EXACT, reference_delay=0.3))
    assert_allclose([run.chi(0.4) for run in runs_from_drive(late, Timing(0.3))], 1.5, rtol=1e-6)


def test_uneven_stamps_do_not_shorten_the_path() -> None:
    """0.45 m/s with 0.5 rad/s and side slip: arcs of unequal length still point the same way from their middles."""
    t = np.cumsum(np.random.default_rng(1).uniform(0.25, 2.5, 12))
    pose = Series(t, exp(np.outer(t, [0.45, -0.2, 0.5])), "pose")
    wheels = Series([0.0, *np.arange(0.5, 20.0, 0.5)], np.tile([0.3, 0.6], (40, 1)), "wheels")
    drive = Drive("uneven", P3AT, wheels, pose=pose)
    (run,) = runs_from_drive(drive)
    assert run.distance == pytest.approx(np.hypot(0.45, 0.2) * (run.end - run.start), rel=1e-9)


def test_a_turn_too_small_is_no_run() -> None:
    drive = kinematic_drive("s", P3AT, SymmetricIcr(0.3, 1.0), rims_of(np.array([[0.50, 0.53]])), EXACT)
    with pytest.raises(RequestError, match=r"^s: no turn of at least 15 deg"):
        runs_from_drive(drive)
    assert len(runs_from_drive(drive, options=RunOptions(least_turn=0.1))) == 1


def test_drives_without_runs_are_refused() -> None:
    straight = kinematic_drive("s", P3AT, SymmetricIcr(0.3, 1.0), rims_of(np.array([[0.5, 0.5]])), EXACT)
    with pytest.raises(RequestError, match=r"^s: no turn of at least 15 deg and 1 s at constant speeds of both sides"):
        runs_from_drive(straight)
    with pytest.raises(RequestError, match=r"^s: the circle test needs reference poses with heading$"):
        runs_from_drive(Drive("s", P3AT, straight.wheels))
    turning = kinematic_drive("t", P3AT, SymmetricIcr(0.3, 1.0), rims_of(np.array([[0.2, 0.5]])), EXACT)
    swapped = replace(turning, wheels=Series(turning.wheels.t, turning.wheels.values[:, ::-1], "wheels"))
    with pytest.raises(RequestError, match=r"^t: the reference turns against the wheels: are sides or signs swapped"):
        runs_from_drive(swapped)


def test_options_refuse() -> None:
    with pytest.raises(ValueError, match=r"^spacing must be positive"):
        RunOptions(spacing=0.0)
    with pytest.raises(ValueError, match=r"^settle must not be negative"):
        RunOptions(settle=-1.0)


def test_standing_runs_are_no_circle() -> None:
    assert FoundRun(0.0, 1.0, -0.1, 0.2, 0.05, 0.5).circle() is None
    assert FoundRun(0.0, 1.0, 0.1, 0.2, 0.0, 0.5).circle() is None


# Giannoccaro


def test_one_carriageway_for_runs_that_share_it() -> None:
    runs = [CircleRun(0.2, v, 0.3 * (v + 0.2) / (v - 0.2), "tiles") for v in (0.4, 0.6, 0.8)]
    found = side_result(runs, 0.28)
    assert found.icr_y == pytest.approx(0.3)
    assert found.icr_y_sigma == pytest.approx(0.0, abs=1e-12)
    assert found.steering_efficiency == pytest.approx(0.28 / 0.6)
    assert found.misfit < 1e-12
    assert side_result(runs[:1], 0.28).icr_y_sigma is None


def test_carriageway_by_hand() -> None:
    # lambda 3 and 2, radii 1.0 and 0.5: (3 + 1) / 13
    runs = [CircleRun(0.2, 0.4, 1.0), CircleRun(0.2, 0.6, 0.5)]
    found = side_result(runs, 0.28)
    assert found.icr_y == pytest.approx(4.0 / 13.0)
    residual = np.array([1.0 - 12.0 / 13.0, 0.5 - 8.0 / 13.0])
    assert found.icr_y_sigma == pytest.approx(np.sqrt((residual @ residual) / 13.0))
    assert found.misfit == pytest.approx(3.0 / 13.0)


def test_surfaces_and_sides_stand_beside_each_other() -> None:
    indoor, outdoor, football = circle_test(rover_runs(), ROVER.track_width)
    assert [r.surface for r in (indoor, outdoor, football)] == ["indoor", "outdoor", "football"]
    assert indoor.left is not None
    assert indoor.right is not None
    assert football.right is None
    assert [run.name for run in indoor.right.runs] == ["1R", "2R", "3R", "4R", "5R"]
    assert indoor.left.slip_ratios == pytest.approx([1.42, 1.84, 2.71, 2.52, 2.46], abs=0.005)
    assert indoor.left.icr_y == pytest.approx(0.604, abs=5e-4)
    assert indoor.left.icr_y < indoor.right.icr_y  # the paper: less slip in left turns


def test_unknown_surface_and_nothing_are_refused() -> None:
    with pytest.raises(RequestError, match=r"^no circle runs on surface 'ice'; there are: indoor, outdoor, football$"):
        runs_on(rover_runs(), "ice")
    with pytest.raises(RequestError, match=r"there are: \(unnamed\)$"):
        runs_on([CircleRun(0.2, 0.4, 1.0)], "ice")
    with pytest.raises(RequestError, match=r"^no circle runs given$"):
        circle_test([], 0.28)
    with pytest.raises(RequestError, match=r"^no circle runs given$"):
        side_result([], 0.28)


def test_runs_of_a_drive_give_the_ratio_of_the_model() -> None:
    """From any drive: an ICR model's circles through Eq. (15)."""
    rows = np.array([[0.2, 0.6], [0.3, 0.6], [0.6, 0.2]])
    drive = kinematic_drive("circles", ROVER, SymmetricIcr(0.25, 1.0), rims_of(rows), EXACT)
    circles = [run.circle("lab") for run in runs_from_drive(drive)]
    (lab,) = circle_test([c for c in circles if c is not None], ROVER.track_width)
    assert lab.left is not None
    assert lab.right is not None
    assert (lab.left.icr_y, lab.right.icr_y) == pytest.approx((0.25, 0.25))
    assert lab.left.slip_ratios[0] == pytest.approx(0.6 * (0.5 - 0.14) / (0.2 * (0.5 + 0.14)))


# The sample


def test_sample_holds_what_was_measured() -> None:
    drive, runs = sample("rover-4wd1"), rover_runs()
    assert drive.segments is not None
    assert len(drive.segments) == len(runs) == 25
    assert drive.source == "measured circle runs of Giannoccaro 2015, Tables 1, 2 and 4, laid out as arcs"
    assert drive.vehicle is ROVER
    found = runs_from_drive(drive, options=RunOptions(least_turn=0.01))
    circles = [run.circle() for run in found]
    assert_allclose([c.radius for c in circles if c], [run.radius for run in runs], rtol=1e-9)
    assert_allclose([c.speed for c in circles if c], [run.speed for run in runs], rtol=1e-9)
    assert_allclose([[c.v_left, c.v_right] for c in circles if c], [[r.v_left, r.v_right] for r in runs])
    assert [c.direction for c in circles if c] == [run.direction for run in runs]


def test_labels_of_the_sample() -> None:
    labels = sample("rover-4wd1").labels
    assert labels["surface"].tolist() == [0.0] * 10 + [1.0] * 10 + [2.0] * 5
    assert labels["run"][:10].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0] * 2
    assert labels["turn"].tolist() == ([1.0] * 5 + [-1.0] * 5) * 2 + [1.0] * 5


def test_speeds_of_the_sample_are_credible() -> None:
    """Read as drag, Table 4 lets the robot lose 5 to 40 % of the rolled distance; read as printed it would lose 90."""
    share = [2.0 * (run.speed or 0.0) / (run.v_left + run.v_right) for run in rover_runs()]
    assert min(share) > 0.6
    assert max(share) < 0.95


def test_clocks_have_no_effect_on_the_sample() -> None:
    drive, model = sample("rover-4wd1"), SymmetricIcr(0.3, 0.9)
    windows = increment_windows(drive)
    assert len(windows) == 25
    for timing in (Timing(-2.0), Timing(1.5), Timing(0.0, 0.2)):
        expected = predict(model, drive.wheels, windows, Timing())
        assert_allclose(predict(model, drive.wheels, windows, timing)[1:], expected[1:], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("name", "runs"), [("indoor", 10), ("outdoor", 10), ("football", 5)])
def test_surfaces_as_samples(name: str, runs: int) -> None:
    drive = sample(f"rover-4wd1-{name}")
    assert drive.name == f"rover-4wd1-{name}"
    assert drive.segments is not None
    assert len(drive.segments) == runs
    assert drive.labels["surface"].tolist() == [float(["indoor", "outdoor", "football"].index(name))] * runs
    assert SAMPLES[f"rover-4wd1-{name}"].text


def test_sample_calibrates() -> None:
    calibration = calibrate(sample("rover-4wd1-indoor"), model="icr_symmetric")
    found = calibration.parameters
    assert found["icr_y"].value == pytest.approx(0.273, abs=0.015)
    assert found["alpha"].value == pytest.approx(0.879, abs=0.02)
    assert not calibration.nuisance["lag"].determined
    assert calibration.held_out["icr_symmetric"].yaw_deg.rms < 0.3 * calibration.held_out["differential"].yaw_deg.rms


# Reproduction


def test_table_five_follows_from_table_two() -> None:
    rows = giannoccaro2015.table_5_rows()
    assert len(rows) == 25
    misprints = [row for row in rows if row.verdict == "corrected"]
    assert [row.what for row in misprints] == [f"K_s outdoor {n}L, Table 5" for n in (3, 4, 5)]
    assert [row.ours for row in misprints] == pytest.approx([3.31, 3.10, 3.06], abs=0.006)
    others = [row for row in rows if row.verdict != "corrected"]
    assert {row.verdict for row in others} == {"reproduced"}
    assert max(abs(row.paper - row.ours) for row in others) < 0.05


def test_table_three_does_not_follow_from_table_two() -> None:
    rows = [row for row in giannoccaro2015.table_3_rows() if row.what.startswith("x_ICR")]
    assert len(rows) == 5
    assert {row.verdict for row in rows} == {"cannot be reproduced"}
    assert (rows[0].paper, round(rows[0].ours, 3)) == (0.247, 0.604)
    assert "runs 3 to 5 alone give 0.270; R / lambda falls from 0.735 to 0.227 m" in rows[0].reason
    chi = [row for row in giannoccaro2015.table_3_rows() if row.what.startswith("chi")]
    assert {row.verdict for row in chi} == {"reproduced"}


def test_other_rows_of_giannoccaro() -> None:
    by_what = {row.what: row for row in giannoccaro2015.rows()}
    speed = by_what["rim speed at k = 80 [mm/s], Table 1"]
    assert (speed.paper, speed.ours) == (957.0, pytest.approx(836.0, abs=1.0))
    assert by_what["slip of the inner side, 4L outdoors [%], Table 4"].ours == pytest.approx(-100.0)
    assert by_what["linear velocity at k = 60 [m/s], section V"].ours == pytest.approx(0.63)


def test_rows_of_wang() -> None:
    by_what = {row.what: row for row in wang2015.rows()}
    a, b = by_what["a of Eq. (44) from Table 3"], by_what["b of Eq. (44) from Table 3"]
    assert (a.paper, round(a.ours, 3)) == (0.4728, 0.468)
    assert (b.paper, round(b.ours, 3)) == (0.0538, 0.05)
    assert a.reason.endswith("the printed pair leaves 0.0032 RMS, ours 0.0025")
    assert all(by_what[f"chi at lambda = {x}, Table 3"].verdict == "reproduced" for x in range(8))
    omega = by_what["omega of 0.1 and 0.3 m/s [rad/s], Eq. (47)"]
    assert omega.ours == pytest.approx(2.0 * omega.paper, rel=1e-4)
    assert by_what["error of y0 [m], Eq. (43)"].verdict == "reproduced"


@pytest.mark.parametrize("rows", [wang2015.rows(), giannoccaro2015.rows()])
def test_every_deviation_has_its_reason(rows: tuple[Row, ...]) -> None:
    assert all(row.reason for row in rows if row.verdict != "reproduced")
    assert len({row.what for row in rows}) == len(rows)
    assert all(np.isfinite([row.paper, row.ours]).all() for row in rows)


def test_compared() -> None:
    assert compared("x", 1.0, 1.05, 0.05).verdict == "reproduced"
    assert compared("x", 1.0, 1.06, 0.05).verdict == "cannot be reproduced"


def test_rover_runs_pass_their_own_check() -> None:
    with pytest.raises(DataError):
        replace(rover_runs()[0], v_left=0.632)
