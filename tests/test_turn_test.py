"""Mandow's turn and straight test by hand, and on simulated drives with known truth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer import se2
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.identify.turn_test import StretchOptions, straight_test, symmetric_from_drive, turn_test
from skidsteer.models import Icr, MatrixModel, SymmetricIcr
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Timing

VEHICLE = Vehicle("test", track_width=0.4, wheel_radius=0.11)
TRUTH = SymmetricIcr(0.28, 0.91)

# Left and right rim speed [m/s], and how long [s]: rest, ahead, rest, turn left, back, turn right, a curve.
FULL = [
    (0.0, 0.0, 2.0),
    (0.4, 0.4, 6.0),
    (0.0, 0.0, 1.0),
    (-0.3, 0.3, 7.0),
    (-0.3, -0.3, 5.0),
    (0.25, -0.25, 6.0),
    (0.2, 0.5, 5.0),
]


def make_drive(
    manoeuvres: list[tuple[float, float, float]],
    model: MatrixModel | list[MatrixModel] = TRUTH,
    noise: tuple[float, float] = (0.0, 0.0),
    late: float = 0.0,
    seed: int = 0,
) -> Drive:
    """Wheels at 100 Hz, reference at 5 Hz, with noise [m, rad] and stamps late by so much [s].

    The motion is that of one model, or of one for each manoeuvre.
    """
    models = model if isinstance(model, list) else [model] * len(manoeuvres)
    counts = [round(100 * duration) for *_, duration in manoeuvres]
    speeds = np.repeat([speeds for *speeds, _ in manoeuvres], counts, axis=0).astype(float)
    t = 0.01 * np.arange(len(speeds) + 1)
    matrices = np.repeat([each.matrix() for each in models], counts, axis=0)
    poses = se2.chain(se2.exp(0.01 * np.einsum("nij,nj->ni", matrices, speeds)), start=(3.0, -2.0, 1.0))[::20]
    poses = poses + np.random.default_rng(seed).standard_normal(poses.shape) * [noise[0], noise[0], noise[1]]
    poses[:, 2] = se2.wrap(poses[:, 2])
    wheels = Series(t, np.concatenate([speeds, speeds[-1:]]), "wheels")
    return Drive("simulated", VEHICLE, wheels, pose=Series(t[::20] + late, poses, "pose"))


def test_turn_and_straight_by_hand() -> None:
    """Sides roll -1.1 and 1.3 m in a turn of 3 rad: 2.4 / 6 = 0.4 m, times alpha 0.9. Ahead 2.1, 1.9 m: 1.8 m."""
    assert_allclose(turn_test([-1.1, 1.3], 3.0), 0.4)
    assert_allclose(turn_test([-1.1, 1.3], 3.0, alpha=0.9), 0.36)
    assert_allclose(straight_test([2.1, 1.9], 1.8), 0.9)


@given(st.floats(0.05, 3.0), st.floats(0.5, 1.5), st.floats(-4.0, 4.0).filter(lambda s: abs(s) > 0.01), st.floats(0, 1))
def test_both_undo_the_symmetric_model(icr_y: float, alpha: float, rolled: float, share: float) -> None:
    model = SymmetricIcr(icr_y, alpha)
    turn, run = np.array([-rolled, rolled * (1.0 + share)]), np.array([rolled, rolled])
    angle, distance = model.twist(*turn)[2], model.twist(*run)[0]
    assert_allclose(straight_test(run, distance), alpha, rtol=1e-12)
    assert_allclose(turn_test(turn, angle, alpha), icr_y, rtol=1e-12)
    assert_allclose(turn_test([turn, -turn], [angle, -angle], alpha), [icr_y, icr_y], rtol=1e-12)


def test_nothing_turned_or_rolled_is_refused() -> None:
    with pytest.raises(ValueError, match=r"angle \[rad\] other than 0, got \[1\.0, 0\.0\]"):
        turn_test([[-1.0, 1.0], [-1.0, 1.0]], [1.0, 0.0])
    with pytest.raises(ValueError, match="rolled by both sides"):
        straight_test([0.5, -0.5], 1.0)


def test_a_clean_drive_gives_back_the_truth() -> None:
    found = symmetric_from_drive(make_drive(FULL))
    assert_allclose(found.model.theta, TRUTH.theta, rtol=1e-9)
    assert (found.icr_y.stretches, found.alpha.stretches) == (2, 2)
    assert (found.icr_y.value, found.alpha.value) == (found.model.icr_y, found.model.alpha)
    assert_allclose(found.icr_y.length, 0.91 * (0.3 * 7.0 + 0.25 * 6.0) / 0.28)
    assert_allclose(found.alpha.length, 0.91 * (0.4 * 6.0 + 0.3 * 5.0))
    assert found.icr_y.standard_error is not None
    assert found.icr_y.standard_error < 1e-9


def test_turns_of_more_than_a_whole_one_count_in_full() -> None:
    found = symmetric_from_drive(make_drive([(-0.4, 0.4, 20.0), (0.3, 0.3, 4.0)]))
    assert found.icr_y.length > 8.0 * np.pi
    assert_allclose(found.model.theta, TRUTH.theta, rtol=1e-9)


def test_a_straight_run_that_bends_is_measured_along_its_arc() -> None:
    """The right tread slips more, so that equal rims drive a curve; icr_x = 0 keeps the arc tangent to x."""
    model = Icr(0.28, -0.28, 0.0, 0.95, 0.87)
    for direction in (1.0, -1.0):
        drive = make_drive([(0.4 * direction, 0.4 * direction, 10.0), (-0.3, 0.3, 5.0)], model)
        found = symmetric_from_drive(drive)
        assert_allclose(found.alpha.value, 0.91, rtol=1e-9)  # the mean of both, for ICRs that lie symmetrically
        assert_allclose(found.icr_y.value, 0.28, rtol=1e-9)


def test_mandows_robot_is_close_to_his_symmetric_model() -> None:
    """Table I, 20 psi; Section IV.D gives alpha = 0.91 and x_ICR = 0.275 m from Eqs. (11) and (12)."""
    found = symmetric_from_drive(make_drive(FULL, Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)))
    assert_allclose(found.alpha.value, 0.91, rtol=0.015)
    assert_allclose(found.icr_y.value, 0.275, rtol=0.03)


def test_a_late_reference_is_put_right_by_the_timing() -> None:
    drive = make_drive(FULL, late=0.6)
    assert_allclose(symmetric_from_drive(drive, Timing(0.6)).model.theta, TRUTH.theta, rtol=1e-9)
    assert abs(symmetric_from_drive(drive).model.alpha - TRUTH.alpha) > 0.02


def test_standard_errors_are_those_of_the_scatter() -> None:
    """60 drives with 8 stretches of each kind: errors over their standard errors follow Student's t, 7 degrees."""
    manoeuvres = 4 * [(0.3, 0.3, 5.0), (-0.3, 0.3, 4.0), (-0.3, -0.3, 4.0), (0.3, -0.3, 5.0)]
    scores = []
    for seed in range(60):
        found = symmetric_from_drive(make_drive(manoeuvres, noise=(0.01, np.radians(0.5)), seed=seed))
        assert found.icr_y.standard_error is not None
        assert found.alpha.standard_error is not None
        scores.append(
            [
                (found.icr_y.value - TRUTH.icr_y) / found.icr_y.standard_error,
                (found.alpha.value - TRUTH.alpha) / found.alpha.standard_error,
            ]
        )
    mean, rms = np.mean(scores, axis=0), np.sqrt(np.mean(np.square(scores), axis=0))
    assert (np.abs(mean) < 0.4).all()
    assert ((rms > 0.9) & (rms < 1.5)).all()  # sqrt(7 / 5) = 1.18


def test_standard_errors_by_hand() -> None:
    """Two runs of 2 m rolled go 1.8 and 1.88 m; two turns of 1.5 m rolled by each side, one after the other, 4.5 and
    5.1 rad. alpha = 0.92 with sqrt(2 * 0.04^2 / (2 * 2^2)) = 0.02, turn rate 3.2 with sqrt(2 * 0.3^2 / (2 * 1.5^2)) =
    0.2, icr_y = 0.92 / 3.2 = 0.2875 with 0.2875 * hypot(0.02 / 0.92, 0.2 / 3.2) = 0.019025.
    """
    manoeuvres = [(0.4, 0.4, 5.0), (-0.4, -0.4, 5.0), (-0.3, 0.3, 5.0), (0.3, -0.3, 5.0)]
    models = [SymmetricIcr(0.3, 0.9), SymmetricIcr(0.3, 0.94), SymmetricIcr(0.3, 0.9), SymmetricIcr(0.3, 1.02)]
    found = symmetric_from_drive(make_drive(manoeuvres, [*models]))
    assert (found.alpha.stretches, found.icr_y.stretches) == (2, 2)
    assert_allclose([found.alpha.value, found.alpha.standard_error], [0.92, 0.02], rtol=1e-9)
    assert_allclose([found.icr_y.value, found.icr_y.standard_error], [0.2875, 0.019025], rtol=1e-4)
    assert_allclose([found.alpha.length, found.icr_y.length], [3.68, 9.6], rtol=1e-9)


def test_one_stretch_has_no_standard_error() -> None:
    found = symmetric_from_drive(make_drive([(0.3, 0.3, 4.0), (-0.3, 0.3, 4.0)]))
    assert found.icr_y.standard_error is None
    assert found.alpha.standard_error is None
    twice = symmetric_from_drive(make_drive([(0.3, 0.3, 4.0), (-0.3, 0.3, 4.0), (-0.3, -0.3, 4.0)]))
    assert twice.alpha.standard_error is not None
    assert twice.icr_y.standard_error is None  # one turn only


def test_segments_break_a_stretch() -> None:
    drive = make_drive([(0.3, 0.3, 8.0), (-0.3, 0.3, 8.0)])
    cut = replace(drive, segments=np.array([[0.0, 3.8], [4.0, 8.0], [8.2, 12.0], [12.2, 16.0]]))
    assert symmetric_from_drive(drive).alpha.stretches == 1
    found = symmetric_from_drive(cut)
    assert (found.alpha.stretches, found.icr_y.stretches) == (2, 2)
    assert_allclose(found.model.theta, TRUTH.theta, rtol=1e-9)


@pytest.mark.parametrize(
    ("manoeuvres", "message"),
    [
        ([(0.3, 0.3, 8.0)], "has no turn on the spot of at least 30 deg; record"),
        ([(-0.3, 0.3, 8.0)], "has no straight run of at least 0.5 m; record"),
        ([(0.1, 0.5, 8.0)], "has no turn on the spot of at least 30 deg and no straight run of at least 0.5 m"),
        ([(0.0, 0.0, 8.0)], "no turn on the spot .* and no straight run"),
        ([(0.3, 0.3, 1.4), (-0.3, 0.3, 0.4)], "no turn on the spot .* and no straight run"),
    ],
)
def test_missing_stretches_are_named(manoeuvres: list[tuple[float, float, float]], message: str) -> None:
    with pytest.raises(RequestError, match=message):
        symmetric_from_drive(make_drive(manoeuvres))


def test_swapped_sides_and_signs_are_noticed() -> None:
    drive = make_drive(FULL)
    for speeds, message in (
        (drive.wheels.values[:, ::-1], "turns against the wheels: are sides or signs swapped"),
        (-drive.wheels.values, "moves against the wheels: are sides or signs swapped"),
    ):
        with pytest.raises(RequestError, match=message):
            symmetric_from_drive(replace(drive, wheels=Series(drive.wheels.t, speeds, "wheels")))


def test_a_drive_without_heading_is_refused() -> None:
    with pytest.raises(RequestError, match="simulated: the turn test needs reference poses with heading"):
        symmetric_from_drive(replace(make_drive(FULL), pose=None))


@pytest.mark.parametrize("name", ["pivot", "straight", "least_speed", "least_turn", "least_distance"])
def test_options_are_checked(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} must"):
        StretchOptions(**{name: 0.0})


def test_options_choose_the_stretches() -> None:
    """The curve (0.2, 0.5) has 0.3 over 0.7 of straightness, the last manoeuvre 0.4 over 0.6 of pivoting."""
    drive = make_drive([*FULL, (0.0, 0.0, 1.0), (0.3, 0.3, 3.0), (-0.1, 0.5, 3.0)])

    def count(options: StretchOptions) -> tuple[int, int]:
        found = symmetric_from_drive(drive, options=options)
        return found.icr_y.stretches, found.alpha.stretches

    assert count(StretchOptions()) == (2, 3)
    assert count(StretchOptions(least_distance=1.0)) == (2, 2)
    assert count(StretchOptions(least_turn=5.0)) == (1, 3)
    assert count(StretchOptions(least_speed=0.28)) == (1, 3)
    assert count(StretchOptions(pivot=0.68)) == (3, 3)
    assert count(StretchOptions(straight=0.44)) == (2, 4)
