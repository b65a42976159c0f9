"""The verdict on drives: against hand calculations of what each kind of drive can tell, and against refits."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from conftest import Run
from skidsteer.calibration import MotionSigma, Observability, WeakDirection
from skidsteer.doctor import examine
from skidsteer.drive import Drive, Series
from skidsteer.identify import advice as advising
from skidsteer.identify.advice import candidates
from skidsteer.identify.calibrate import calibrate, judge_drive
from skidsteer.identify.least_squares import Fit, FitOptions, _covariance, fit
from skidsteer.identify.motions import known_motions
from skidsteer.identify.observability import observe, observe_drive, typical_speed, weak_directions
from skidsteer.io.calibration_file import load_calibration, save_calibration
from skidsteer.io.folder import write_folder
from skidsteer.models import Differential, Icr, Model, Multiplier, ScheduledIcr, SymmetricIcr
from skidsteer.samples import sample
from skidsteer.se2 import FloatArray, exp, rotate
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import preset
from skidsteer.windows import increment_windows

P3AT = preset("pioneer-p3at")
TRUTH = Icr(0.26, -0.31, -0.03, 0.93, 0.93)  # equal rims go straight
NOISE = (0.004, 0.008)
REST = [2.0, 0.0, 0.0]


def driven(rows: list[list[float]], truth: Model = TRUTH, seed: int = 0, tail: Series | None = None) -> Drive:
    """A simulated drive of rows of duration, v, omega with rests; ``tail``: rim speeds that follow."""
    rims = rims_from_manoeuvres(np.array([REST, *rows, REST]), Differential(P3AT.track_width), rate=50.0)
    if tail is not None:
        after = rims.t[-1] + 0.02 + tail.t
        rims = Series(np.r_[rims.t, after], np.r_[rims.values, tail.values], "wheels")
    return kinematic_drive("sim", P3AT, truth, rims, Sensors(reference_delay=0.15), 0.08, NOISE, seed)


STRAIGHTS = [[15.0, 0.4, 0.0], REST] * 3
CIRCLE = [[60.0, 0.3, 0.5]]
SPOT = [[25.0, 0.0, 0.8], REST, [25.0, 0.0, -0.8]]
LITTLE_OF_ALL = [[20.0, 0.4, 0.0], REST, [10.0, 0.0, 0.8], REST, [10.0, 0.0, -0.8], REST, [20.0, -0.4, 0.0]]


def judged(drive: Drive, model: type[Model] = Icr) -> tuple[Fit, Observability]:
    windows = increment_windows(drive)
    found = fit(model.nominal(drive.vehicle), [drive], [windows])
    return found, observe(found, [drive], [windows], FitOptions())


# What each kind of drive can tell


def test_straights_tell_the_scale_factors_alone() -> None:
    """v_x = alpha v and omega = (alpha_r - alpha_l) v / (y_l - y_r) = 0: nothing of the three ICR coordinates."""
    _, verdict = judged(driven(STRAIGHTS))
    assert set(verdict.undetermined) == {"icr_y_left", "icr_y_right", "icr_x"}
    assert {"alpha_left", "alpha_right"} <= set(verdict.determined)
    assert max(verdict.determined[name] for name in ("alpha_left", "alpha_right")) < 0.02
    assert len(verdict.weak) == 3
    assert set().union(*(w.change for w in verdict.weak)) == set(verdict.undetermined)
    assert verdict.weak[0].known.motion.startswith("the angle of a full turn")
    assert len(verdict.advice) == 1
    assert verdict.advice[0].startswith("add two turns on the spot each way")


def test_one_circle_tells_one_equation_a_side() -> None:
    """On a circle, alpha_l v_l + y_l omega = v_x = alpha_r v_r + y_r omega and v_y = -icr_x omega are all there is."""
    found, verdict = judged(driven(CIRCLE))
    assert "icr_x" in verdict.determined
    assert {"icr_y_right", "alpha_right"} <= set(verdict.undetermined)
    assert len(verdict.weak) == 2
    rims = Differential(P3AT.track_width).wheel_speeds(0.3, 0.5)
    omega = found.model.twist(*rims)[2]
    for w in verdict.weak:
        change = {p: w.change.get(p, 0.0) for p in ("icr_y_left", "icr_y_right", "alpha_left", "alpha_right")}
        for side, v in zip(("left", "right"), rims, strict=True):
            by_scale, by_centre = change[f"alpha_{side}"] * v, change[f"icr_y_{side}"] * omega
            assert abs(by_scale + by_centre) < 0.02 * max(abs(by_scale), 1e-3)
    assert verdict.advice[0].startswith("add one straight of 10 m there and back")


def test_turns_on_the_spot_tell_no_distance() -> None:
    """With v_l = -v_r both sides' equations scale with the speed: each alpha can change with its own ICR."""
    _, verdict = judged(driven(SPOT))
    assert "icr_x" in verdict.determined
    assert set(verdict.undetermined) == {"icr_y_left", "icr_y_right", "alpha_left", "alpha_right"}
    spot = [m for m in verdict.motions if "full turn on the spot" in m.motion]
    assert len(spot) == 2
    assert max(m.sigma for m in spot) < 2.0  # deg
    assert len(verdict.weak) == 2
    assert [a.split(":")[0] for a in verdict.advice] == ["add one straight of 10 m there and back"]


@pytest.mark.parametrize("model", [Differential, Multiplier, SymmetricIcr])
def test_a_simple_model_does_not_hide_what_is_open(model: type[Model]) -> None:
    """A drive that cannot tell more than a simple model is judged by the five parameters all the same."""
    _, verdict = judged(driven(STRAIGHTS), model)
    assert verdict.model == "icr"
    assert set(verdict.undetermined) == {"icr_y_left", "icr_y_right", "icr_x"}
    assert verdict.advice


@pytest.mark.parametrize(
    "drive", [driven(LITTLE_OF_ALL), sample("p3at-mandow").between(0.0, 120.0)], ids=["short", "lab"]
)
def test_a_drive_of_everything_is_told_nothing(drive: Drive) -> None:
    _, verdict = judged(drive)
    assert verdict.sentences == ()
    assert verdict.undetermined == {}
    assert {"icr_y_left", "icr_y_right", "icr_x", "alpha_left", "alpha_right"} <= set(verdict.determined)
    assert all(m.sigma < m.tolerance for m in verdict.motions)


@pytest.mark.parametrize("name", ["warthog-asphalt", "husky-gyro-flooring"])
def test_real_drives_of_everything_are_told_nothing(name: str, real: object) -> None:
    from skidsteer.io.drives import load_drive

    verdict = observe_drive(load_drive(real(name)))  # type: ignore[operator]
    assert verdict.weak == verdict.sentences == ()


def test_positions_are_judged_as_if_the_place_of_the_antenna_were_known() -> None:
    drive = sample("p3at-mandow").between(0.0, 100.0)
    assert drive.pose is not None
    positions = Series(drive.pose.t, drive.pose.values[:, :2], "position")
    verdict = observe_drive(replace(drive, pose=None, position=positions))
    assert verdict.model == "icr"
    assert verdict.sentences == ()
    drives = [replace(drive, pose=None, position=positions)]
    windows = [increment_windows(drives[0])]
    found = fit(Icr.nominal(P3AT), drives, windows, FitOptions(mount=None))
    assert found.named("icr_x")[1] > 0.1
    assert observe(found, drives, windows, FitOptions(mount=None)).weak == ()


def test_terms_that_a_drive_does_not_support_are_not_asked_for() -> None:
    """Slip_fade moves nothing where there is no side slip: open, but not worth a word."""
    drive = driven(LITTLE_OF_ALL)
    windows = increment_windows(drive)
    options = FitOptions(without=ScheduledIcr.OPTIONAL)
    found = fit(ScheduledIcr.nominal(P3AT), [drive], [windows], options)
    assert found.named("slip_fade")[1] > 0.5
    verdict = observe(found, [drive], [windows], options)
    assert verdict.sentences == ()
    assert not {*ScheduledIcr.OPTIONAL, "slip_fade"} & {*verdict.determined, *verdict.undetermined}


# What to drive next


@pytest.mark.parametrize(("rows", "words"), [(STRAIGHTS, "two turns"), (CIRCLE, "one straight")])
def test_advice_keeps_its_promise(rows: list[list[float]], words: str) -> None:
    """A drive with the manoeuvre that was advised is told nothing, and its sigma is the one that was promised."""
    _, before = judged(driven(rows))
    (advice,) = before.advice
    promised = float(advice.split("would be known to ")[1].split()[0])
    speed = typical_speed([driven(rows)])
    (steps,) = [r for text, r in candidates(P3AT, speed, TRUTH).items() if text.startswith(words)]  # two whole turns
    _, after = judged(driven(rows, tail=advising.played(steps, speed)))
    assert after.sentences == ()
    motion = advice.split(": ")[1].split(" would")[0]
    (reached,) = [m.sigma for m in after.motions if m.motion == motion]
    assert reached == pytest.approx(promised, rel=0.4)


def test_advice_is_computed_not_looked_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what is on offer the manoeuvre that helps is chosen, and none where none helps."""
    offers = candidates

    def only(*words: str) -> tuple[str, ...]:
        monkeypatch.setattr(
            advising, "candidates", lambda *a: {k: v for k, v in offers(*a).items() if k.startswith(words)}
        )
        return judged(driven(STRAIGHTS))[1].advice

    assert only("one straight") == ()
    (advice,) = only("one straight", "one full circle")
    assert advice.startswith("add one full circle each way")


@pytest.mark.parametrize("width", [1e6, 1e300])
def test_what_would_take_an_hour_is_not_advised(width: float) -> None:
    """A model that hardly turns comes of a drive in other units, say; no table of its rim speeds fits any memory."""
    assert list(candidates(P3AT, 0.3, SymmetricIcr(width, 1.0))) == ["one straight of 10 m there and back"]


def test_the_faster_manoeuvre_keeps_to_the_wheels() -> None:
    slow, quick = candidates(P3AT, 0.3, TRUTH), candidates(P3AT, 0.6, TRUTH)
    assert [text for text in slow if text.endswith("m/s")] == ["one full circle each way at 0.45 m/s"]
    assert [text for text in quick if text.endswith("m/s")] == ["one full circle each way at 0.69 m/s"]
    for parts in (*slow.values(), *quick.values()):
        assert np.abs([part.rims for part in parts]).max() <= 0.69
    for text, parts in slow.items():
        moved = np.array([TRUTH.twist(*part.rims) * part.duration for part in parts])
        if "straight" in text:
            assert_allclose(moved[:, 0], [10.0 * 0.93, -10.0 * 0.93])  # the rims roll 10 m
        else:
            assert_allclose(np.abs(moved[:, 2]), (2.0 if "spot" in text else 1.0) * 2.0 * np.pi)
            assert moved[0, 2] * moved[1, 2] < 0.0


def test_lasting_errors_widen_what_a_freer_model_would_know() -> None:
    """Judged by another model than the fitted one, the information is divided as the fit's variances were raised."""
    drive = driven(LITTLE_OF_ALL)
    windows = increment_windows(drive)
    found = fit(SymmetricIcr.nominal(P3AT), [drive], [windows])
    sigmas = [
        observe(replace(found, inflated=factor), [drive], [windows], FitOptions()).determined["icr_x"]
        for factor in (1.0, 4.0)
    ]
    assert sigmas[1] == pytest.approx(2.0 * sigmas[0], rel=0.01)


# The parts


def _centre(pose: FloatArray) -> FloatArray:
    """Point that a motion leaves where it is: c = p + R c."""
    R = np.stack([rotate(pose[2], np.array([1.0, 0.0])), rotate(pose[2], np.array([0.0, 1.0]))], axis=-1)
    return np.asarray(np.linalg.solve(np.eye(2) - R, pose[:2]))


def _moved(model: Model, at: Model, speed: float) -> FloatArray:
    """The motions of the verdict by rolling them out, for rim speeds and durations that belong to ``at``."""
    out = []
    straight = 10.0 / at.twist(speed, speed)[0]
    pose = exp(model.twist(speed, speed) * straight)
    out += [pose[0], pose[1]]
    for rims in ((-speed, speed), (speed, -speed)):
        turn, then = model.twist(*rims), at.twist(*rims)
        out += [360.0 * turn[2] / then[2], *_centre(exp(turn * 1.0))]
    for rims in ((speed / 3, speed), (speed, speed / 3)):
        turn, then = model.twist(*rims), at.twist(*rims)
        out += [360.0 * turn[2] / then[2], 10.0 * turn[0] / then[0], 10.0 * turn[1] / then[0]]
    return np.array(out)


def test_motions_have_the_slopes_of_a_rollout() -> None:
    terms = [0.1 + 0.05 * i for i in range(len(ScheduledIcr.PARAMETERS) - 5)]
    model, speed = ScheduledIcr(0.26, -0.31, -0.03, 0.93, 0.93, *terms), 0.6
    motions, slopes = known_motions(model, speed, 0.4)
    tolerance = np.array([m.tolerance for m in motions])
    h = 1e-6
    for i in range(len(model.theta)):
        step = h * np.eye(len(model.theta))[i]
        moved = [_moved(model.with_theta(model.theta + s * step), model, speed) for s in (1, -1)]
        numeric = (moved[0] - moved[1]) / (2 * h)
        assert_allclose(slopes[:, i] * tolerance, numeric, rtol=1e-5, atol=1e-5)
    assert {m.unit for m in motions} == {"m", "deg"}


def test_weak_directions_by_hand() -> None:
    slopes = np.array([[1.0, 0.0], [0.0, 1.0]])
    covariance = np.array([[9.0, 6.0], [6.0, 8.0]])  # the second by the first: 4; of its own: 4
    (first, sigma, change), (second, rest, left) = weak_directions(slopes, covariance)
    assert (first, second) == (0, 1)
    assert (sigma, rest) == pytest.approx((3.0, 2.0))
    assert_allclose(change, [3.0, 2.0])
    assert_allclose(left, [0.0, 2.0])


@given(st.integers(0, 10_000), st.integers(1, 6), st.integers(1, 4))
def test_beyond_the_weak_directions_every_motion_is_known(seed: int, rows: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    slopes, root = rng.normal(size=(rows, size)), 3.0 * rng.normal(size=(size, size))
    covariance = root @ root.T
    found = weak_directions(slopes, covariance)
    left = covariance - sum((np.outer(c, c) for _, _, c in found), np.zeros((size, size)))
    assert (np.einsum("ri,ij,rj->r", slopes, left, slopes) <= 1.0 + 1e-6).all()
    assert np.linalg.eigvalsh(left).min() > -1e-6 * np.trace(covariance)
    assert len(found) <= min(rows, size)


def test_what_nothing_tells_stays_open_where_errors_last_long() -> None:
    """The block sandwich must not take a direction without scores for one that is known."""
    rng = np.random.default_rng(1)
    scores = np.stack([20.0 * rng.standard_normal(40), np.zeros(40)], axis=1)
    covariance, ratio = _covariance(np.diag([100.0, 0.0]), scores, np.array([5.0, 0.3]))
    assert ratio > 1.0
    assert covariance[1, 1] == pytest.approx(0.09)


def test_sentences() -> None:
    far = WeakDirection(MotionSigma("the drift", 12.0, 1.0, "m"), {"icr_x": 0.1})
    near = WeakDirection(MotionSigma("the angle", 43.21, 36.0, "deg"), {"a": 0.1, "b": 0.2, "c": 0.3})
    verdict = Observability("icr", {}, {}, (), (far, near), ("add a turn",))
    assert verdict.sentences == (
        "the drift is not known: icr_x of the icr model is open",
        "the angle is known to 43 deg only: a, b and c of the icr model can change together and the drive would look"
        " the same",
        "add a turn",
    )


# Where a user meets it


def test_calibrate_says_it_once_and_keeps_it(tmp_path: Path) -> None:
    drive = driven(STRAIGHTS)
    assert {f.kind for f in examine(drive)} >= {"straight_only"}
    calibration = calibrate(drive, model="icr")
    verdict = calibration.observability
    assert verdict is not None
    assert [w for w in calibration.warnings if "drives straight" in w] == []
    assert calibration.warnings[0].startswith("not determined by this drive: icr_y_left, icr_y_right, icr_x;")
    assert set(verdict.sentences) <= set(calibration.warnings)
    assert not calibration.estimates["icr_x"].determined
    assert calibration.estimates["alpha_left"].determined
    save_calibration(calibration, tmp_path / "calibration.yaml")
    assert load_calibration(tmp_path / "calibration.yaml").observability == verdict


def test_check_tells_the_verdict(tmp_path: Path, run: Run) -> None:
    write_folder(driven(STRAIGHTS), tmp_path / "straights")
    shown = run("check", tmp_path / "straights")
    text = " ".join(shown.stdout.split())
    assert "Not determined: icr_y_left, icr_y_right, icr_x." in text
    assert "add two turns on the spot each way" in text
    assert "straight_only" not in text  # the verdict says the same, with figures
    document = json.loads(run("check", tmp_path / "straights", "--json").stdout)
    assert document["observability"]["advice"][0].startswith("add two turns on the spot")
    assert [f["kind"] for f in document["findings"]] == ["straight_only"]
    assert document["not_judged_because"] is None


def test_a_standing_robot(tmp_path: Path, run: Run) -> None:
    drive = driven(STRAIGHTS)
    assert drive.pose is not None
    rng = np.random.default_rng(3)
    pose = Series(drive.pose.t, 0.002 * rng.standard_normal(drive.pose.values.shape), "pose")
    still = replace(drive, wheels=Series(drive.wheels.t, 0.0 * drive.wheels.values, "wheels"), pose=pose)
    write_folder(still, tmp_path / "still")
    document = json.loads(run("check", tmp_path / "still", "--json").stdout)
    assert document["observability"] is None
    assert document["not_judged_because"].startswith("the robot stands still (the wheels moved by 0.00 m in all)")
    refused = run("calibrate", tmp_path / "still")
    assert refused.returncode == 1
    assert "stands still" in refused.stderr


def test_errors_are_cured_before_a_verdict() -> None:
    drive = sample("p3at-mandow").between(0.0, 100.0)
    swapped = replace(drive, wheels=Series(drive.wheels.t, drive.wheels.values[:, ::-1], "wheels"))
    assert judge_drive(swapped, examine(swapped)) == "cure the errors first"


def test_what_one_drive_leaves_open_another_tells() -> None:
    straights, all_sorts = driven(STRAIGHTS), replace(driven(LITTLE_OF_ALL, seed=2), name="other")
    calibration = calibrate([straights, all_sorts], model="multiplier")
    assert calibration.observability is not None
    assert calibration.observability.sentences == ()
    assert not any("straight" in w for w in calibration.warnings)
