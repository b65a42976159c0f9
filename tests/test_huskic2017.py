from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skidsteer.control import Huskic, Pentzer, SaturationSpeed, Wheels, huskic, pentzer
from skidsteer.follow import Ends, follow, summarize
from skidsteer.models import Icr
from skidsteer.plants import begin, point_contacts
from skidsteer.reproduce import huskic2017, huskic_laws, huskic_runs, huskic_simulated
from skidsteer.reproduce.huskic_laws import lyapunov_rate, states
from skidsteer.reproduce.huskic_runs import COURSE, LAPS, LEMNISCATE
from skidsteer.reproduce.huskic_simulated import Experiment, trial
from skidsteer.terramechanics.terrain import Ground, Terrain
from skidsteer.vehicle import preset

FLOOR = Terrain("floor", friction=0.5, friction_opposite=0.5, shear_modulus=0.001)
P3AT = replace(preset("pioneer-p3at"), mass=31.0, max_wheel_speed=4.0)
FREE = float("inf")


def test_the_corrected_law_lets_v1_fall_as_proved_and_the_printed_one_does_not() -> None:
    at = states(20_000)
    proved = -at.k1 * at.x_e**2 - at.k2 * at.e**2 / at.lam
    assert_allclose(lyapunov_rate(at, 1.0, 1.0), proved, atol=1e-9)
    assert 0.3 < np.mean(lyapunov_rate(at, -1.0, 1.0) > 0.0) < 0.5
    assert 0.01 < np.mean(lyapunov_rate(at, 1.0, 0.5) > 0.0) < 0.05  # the 1/2 of Eq. (8)


def test_the_rate_of_v1_is_that_of_the_controller() -> None:
    """One state by the controller's own omega and V1, by central differences in time."""
    gains = huskic.HuskicGains(k1=2.0, k2=3.0, lam=0.7)
    pose, (v, icr_x, curvature, h) = np.array([0.1, -0.2, 0.3]), (1.2, 0.25, 0.4, 1e-6)
    e, by_y = 0.3 - 0.25 * np.pi * np.tanh(0.2), -0.25 * np.pi * (1.0 - np.tanh(0.2) ** 2)
    one = [np.array([value]) for value in (*pose, e, by_y, v, curvature, icr_x, 2.0, 3.0, 0.7)]
    circle = replace(huskic_laws.arc(1.0 / curvature, 2.0 * np.pi), closed=True)
    law = Huskic(gains, SaturationSpeed(Wheels(Icr(0.5, -0.5, icr_x, 1.0, 1.0), 9.0), v), icr_x)
    state = law.begin(circle, [0.0, 0.0, 0.0])
    _, omega = law.command(pose, [0.0, 0.0, 0.0], state)
    s_rate = v * np.cos(0.3) + icr_x * omega * np.sin(0.3) + 2.0 * 0.1
    moved = []
    for t in (-h, h):
        x, y, yaw = pose + t * np.array(
            [v * np.cos(0.3) + icr_x * omega * np.sin(0.3), v * np.sin(0.3) - icr_x * omega * np.cos(0.3), omega]
        )
        moved.append(law.lyapunov([x, y, yaw], replace(state, s=state.s + t * s_rate)))
    slope = (moved[1] - moved[0]) / (2.0 * h)
    assert lyapunov_rate(huskic_laws.States(*one), 1.0, 1.0)[0] == pytest.approx(slope, abs=1e-6)


def test_an_icr_ahead_leaves_the_offset_of_steady_motion_on_a_circle() -> None:
    offset = huskic_laws.offset_on_circle(0.28, 0.5, "launch")
    theta = np.arcsin(0.28 * 0.5 / (1.0 - 0.5 * -offset))  # it drives outside of the circle, with e near 0
    assert np.arctanh(theta / (0.25 * np.pi)) == pytest.approx(offset, rel=0.25)
    assert huskic_laws.offset_on_circle(0.28, 0.5, "launch", feed_forward=True) < 0.005
    assert huskic_laws.printed_departure() > 0.5


def test_the_paths_have_the_printed_lengths() -> None:
    assert LAPS * LEMNISCATE.length == pytest.approx(110.77)
    assert LEMNISCATE.closed
    assert COURSE.length == pytest.approx(159.83)
    assert np.abs(COURSE.knots[:, 4]).max() == pytest.approx(1.0 / 1.5)
    jumps = np.diff(COURSE.curvature(np.linspace(0.0, COURSE.length, 20_000)))
    assert np.abs(jumps).max() < 0.01  # no curvature leaps


@pytest.mark.parametrize(
    ("law", "speed", "mean", "largest"),
    [("huskic", 1.5, 3.4, 6.6), ("pbr", 1.0, 10.8, 16.7), ("pbr ff", 1.5, 3.9, 6.6)],
)
def test_one_lap_in_mujoco_is_as_in_the_first_comparison(law: str, speed: float, mean: float, largest: float) -> None:
    """Errors [cm] of an implementation of its own; the robot differs by what is not known of it."""
    pytest.importorskip("mujoco")
    wheels = Wheels(point_contacts(P3AT), 4.0)
    gains = replace(pentzer.GAINS["published"], omega_max=FREE)
    controller = {
        "huskic": Huskic(
            replace(huskic.GAINS["launch"], omega_max=FREE), SaturationSpeed(wheels, speed), measured_omega=True
        ),
        "pbr": Pentzer(gains, speed),
        "pbr ff": Pentzer(gains, speed, feed_forward=True),
    }[law]
    told = summarize(
        follow(begin("mujoco", P3AT, Ground(FLOOR), LEMNISCATE.at(0.0)), controller, wheels, LEMNISCATE, ends=Ends(1.0))
    )
    assert told.outcome == "laps done"
    assert 100.0 * told.mean == pytest.approx(mean, rel=0.2)
    assert 100.0 * told.largest == pytest.approx(largest, rel=0.25)


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    """ICRs about those that the calibration finds, so that no test waits for it."""
    model = Icr(0.48, -0.48, 0.0, 0.9, 0.9)
    monkeypatch.setattr(huskic_simulated, "icr", lambda plant, terrain: model)


def test_a_trial_reaches_the_printed_speed(known: None) -> None:
    done = trial(Experiment("Huskić", "grass", 1.73))
    assert done.reached == pytest.approx(1.73, abs=0.02)
    assert 0.02 < done.summary.mean < 0.08
    assert done.share == pytest.approx(1.0, abs=0.01)
    assert done.asked != 1.73


def test_the_way_back_from_a_leap_is_measured(known: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(huskic_simulated, "LAPS", 2)
    monkeypatch.setattr(huskic2017, "LAPS", 2)
    done = Experiment("Huskić", "vinyl", 1.0, leap=huskic2017.LEAP).drive(1.0)
    assert done.summary.largest == pytest.approx(huskic2017.LEAP, abs=0.2)
    assert 0.5 < huskic2017.way_to_return(done) < 5.0


def test_every_experiment_becomes_rows_that_tell_what_stands_in(known: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(huskic_simulated, "LAPS", 1)
    monkeypatch.setattr(huskic_simulated, "TRIES", 1)
    trials = {e: trial(e) for e in list(huskic2017.EXPERIMENTS)[3:6]}
    monkeypatch.setattr(huskic2017, "EXPERIMENTS", {e: huskic2017.EXPERIMENTS[e] for e in trials})
    rows = huskic2017.experiment_rows(trials)
    assert {row.verdict for row in rows} == {"not possible without the original data"}
    assert [row.paper for row in rows] == [14.5, 4.2, 100.0]
    first, second, last = (done.summary for done in trials.values())
    assert [row.ours for row in rows] == pytest.approx([100.0 * first.mean, 100.0 * second.mean, 100.0 * last.largest])
    assert all("simulated" in row.reason for row in rows)
    assert {row.verdict for row in huskic2017.law_rows()} == {"corrected"}


def test_calibration_drives_stay_within_the_wheels() -> None:
    rows = huskic_runs.manoeuvres(huskic_runs.FAST, (0.3, 0.6, 1.0))
    rims = huskic_runs.rims_from_manoeuvres(rows, huskic_runs.controller(huskic_runs.VEHICLE))
    assert np.abs(rims.values).max() < 3.0
