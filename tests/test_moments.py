"""Moments against the cost they stand for, summed up window by window without them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import approx_fprime, least_squares

from skidsteer import se2
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.identify.moments import Moments, drive_moments, fit_squares, matrices, moments, yaw_box
from skidsteer.models import MODELS, Differential, Icr, Linear, MatrixModel, SymmetricIcr
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Steps, Timing, Windows, increment_windows, predict

VEHICLE = Vehicle("test", track_width=0.4, wheel_radius=0.11)
TRUTH = Icr(0.26, -0.31, -0.02, 0.93, 0.9)
WIDE = Icr.bounds(VEHICLE)
NARROW = np.array([[0.2, 0.35], [-0.4, -0.2], [-0.1, 0.1], [0.8, 1.0], [0.8, 1.0]])


def make_cut(distance: FloatArray, offsets: list[int]) -> Steps:
    s, k = len(distance), len(offsets) - 1
    return Steps(
        np.asarray(distance, dtype=float), np.zeros((s, 2)), np.ones(s), np.array(offsets), *np.zeros((2, k, 2))
    )


def make_windows(motion: FloatArray) -> Windows:
    k = len(motion)
    return Windows(np.arange(k) * 1.0, np.arange(k) + 1.0, np.asarray(motion, dtype=float), np.zeros(k, bool))


def random_cut(seed: int, step: float, windows: int = 12) -> Steps:
    """Windows of 1 to 9 steps of up to ``step`` [m] forwards and backwards."""
    rng = np.random.default_rng(seed)
    offsets = np.concatenate([[0], np.cumsum(rng.integers(1, 10, windows))])
    return make_cut(rng.uniform(-step, step, (offsets[-1], 2)), list(offsets))


def predicted(model: MatrixModel, cut: Steps) -> FloatArray:
    """Brute force: the SE(2) exponential of every step, chained."""
    increments = se2.exp(cut.distance @ model.matrix().T)
    return np.array(
        [se2.chain(increments[a:b])[-1] for a, b in zip(cut.offsets[:-1], cut.offsets[1:], strict=True)]
    ).reshape(-1, 3)


def squared_cost(model: MatrixModel, cut: Steps, motion: FloatArray) -> float:
    return float(((predicted(model, cut) - motion) ** 2).sum())


def measured(cut: Steps, seed: int) -> FloatArray:
    return predicted(TRUTH, cut) + 0.01 * np.random.default_rng(seed).standard_normal((len(cut.offsets) - 1, 3))


def make_drive(seed: int, noise: float = 0.01, duration: float = 40.0) -> Drive:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 0.01)
    knots = np.arange(0.0, duration + 1.0)
    speeds = np.stack([np.interp(t, knots, rng.uniform(-0.6, 0.7, len(knots))) for _ in range(2)], axis=1)
    poses = se2.chain(se2.exp(0.01 * speeds[:-1] @ TRUTH.matrix().T))[::20]
    poses = poses + noise * rng.standard_normal(poses.shape)
    return Drive("simulated", VEHICLE, Series(t, speeds, "wheels"), pose=Series(t[::20], poses, "pose"))


seeds = st.integers(0, 2**32 - 1)


@settings(deadline=None, max_examples=60)
@given(seeds, st.sampled_from([0.001, 0.02, 0.1, 0.25]), st.sampled_from(["wide", "narrow"]))
def test_cost_is_that_of_chained_motions(seed: int, step: float, width: str) -> None:
    """From steps of 1 mm to windows of two metres; between the wide bounds those turn by tens of radians."""
    bounds, cut = WIDE if width == "wide" else NARROW, random_cut(seed, step)
    motion = measured(cut, seed)
    total = moments(cut, make_windows(motion), TRUTH, bounds)
    rng = np.random.default_rng(seed)
    models = [TRUTH.with_theta(theta) for theta in rng.uniform(bounds[:, 0], bounds[:, 1], (5, 5))]
    expected = [squared_cost(model, cut, motion) for model in [*models, TRUTH]]
    assert_allclose(total.cost([model.matrix() for model in [*models, TRUTH]]), expected, rtol=1e-8)


@pytest.mark.parametrize("timing", [Timing(), Timing(0.07, 0.15)])
def test_cost_is_that_of_predicted_windows(timing: Timing) -> None:
    drive = make_drive(1)
    windows = increment_windows(drive)
    total = drive_moments(drive, Icr.nominal(VEHICLE), WIDE, timing)
    assert total.windows == len(windows) == 199
    for theta in np.random.default_rng(2).uniform(WIDE[:, 0], WIDE[:, 1], (20, 5)):
        model = TRUTH.with_theta(theta)
        error = predict(model, drive.wheels, windows, timing) - windows.motion
        error[:, 2] -= 2.0 * np.pi * np.rint(error[:, 2] / (2.0 * np.pi))
        assert_allclose(total.cost(model.matrix()), (error**2).sum(), rtol=1e-8)


def test_a_quarter_turn_worked_by_hand() -> None:
    """One step of a linear model. dl = 0.1, dr = 0.3; v = (0.22, -0.05); yaw = -pi/40 + 21 pi/40 = pi/2.

    A quarter turn ends at 2 / pi (v_x - v_y, v_x + v_y) = (0.54, 0.34) / pi.
    """
    A = np.array([[0.4, 0.6], [0.1, -0.2], [-0.25 * np.pi, 1.75 * np.pi]])
    motion = np.array([[0.1, 0.2, 1.5]])
    expected = (0.54 / np.pi - 0.1) ** 2 + (0.34 / np.pi - 0.2) ** 2 + (0.5 * np.pi - 1.5) ** 2
    linear = Linear(*A.ravel())
    bounds = A.ravel()[:, None] + [-0.3, 0.5]
    total = moments(make_cut(np.array([[0.1, 0.3]]), [0, 1]), make_windows(motion), linear, bounds)
    assert_allclose(total.cost(A), expected, rtol=1e-9)


@settings(deadline=None, max_examples=30)
@given(seeds)
def test_gradient_is_that_of_finite_differences(seed: int) -> None:
    cut = random_cut(seed, 0.05)
    bounds = np.where([[0, 0]] * 4 + [[0, 1]], 1.3, NARROW)  # other limits for A32 than for A31
    total = moments(cut, make_windows(measured(cut, seed)), TRUTH, bounds)
    rng = np.random.default_rng(seed)
    inside = bounds.mean(axis=1) + 0.4 * (bounds[:, 1] - bounds[:, 0]) * rng.uniform(-1.0, 1.0, 5)
    A = TRUTH.with_theta(inside).matrix()
    cost, gradient = total.cost_and_gradient(A)
    assert_allclose(cost, total.cost(A), rtol=1e-13)
    numeric = approx_fprime(A.ravel(), lambda a: float(total.cost(a.reshape(3, 2))), 1e-7)
    assert_allclose(gradient.ravel(), numeric, rtol=1e-5, atol=1e-5 * np.abs(numeric).max())


@settings(deadline=None, max_examples=20)
@given(seeds, seeds)
def test_moments_of_drives_add_up(one: int, other: int) -> None:
    cuts = [random_cut(one, 0.01), random_cut(other, 0.1)]  # series of different degree
    parts = [moments(cut, make_windows(measured(cut, 3)), TRUTH, WIDE) for cut in cuts]
    A = matrices(TRUTH, np.random.default_rng(one).uniform(WIDE[:, 0], WIDE[:, 1], (4, 5)))
    assert_allclose((parts[0] + parts[1]).cost(A), parts[0].cost(A) + parts[1].cost(A), rtol=1e-10)
    assert_allclose((parts[1] + parts[0]).cost(A), (parts[0] + parts[1]).cost(A), rtol=1e-12)
    assert (parts[0] + parts[1]).windows == 24


def test_moments_of_different_bounds_do_not_add_up() -> None:
    cut = random_cut(0, 0.01)
    parts = [moments(cut, make_windows(measured(cut, 0)), TRUTH, bounds) for bounds in (WIDE, NARROW)]
    with pytest.raises(ValueError, match="different boxes"):
        parts[0] + parts[1]


def test_a_batch_is_a_loop() -> None:
    cut = random_cut(4, 0.02)
    total = moments(cut, make_windows(measured(cut, 4)), TRUTH, WIDE)
    A = matrices(TRUTH, np.random.default_rng(0).uniform(WIDE[:, 0], WIDE[:, 1], (6, 5))).reshape(2, 3, 3, 2)
    batch = total.cost(A)
    assert batch.shape == (2, 3)
    assert_allclose(batch, [[total.cost(a) for a in row] for row in A], rtol=1e-14)
    assert total.cost(A[0, 0]).shape == ()


def test_steps_of_any_size_are_exact() -> None:
    """A step that turns by 3 rad is far outside the series of sine and cosine."""
    cut = make_cut(np.array([[-0.8, 0.9], [0.7, -0.6], [0.0, 0.0]]), [0, 3])
    motion = np.array([[0.1, 0.2, 0.3]])
    total = moments(cut, make_windows(motion), TRUTH, NARROW)
    yaw = predicted(TRUTH, cut)[0, 2]
    assert abs(yaw - 0.3) < np.pi
    assert_allclose(total.cost(TRUTH.matrix()), squared_cost(TRUTH, cut, motion), rtol=1e-9)


def test_steps_at_the_edge_of_the_series_are_exact_to_rounding() -> None:
    """One step whose half angle comes close to 0.3 rad, on a box without width."""
    limits = np.stack([TRUTH.theta, TRUTH.theta * (1.0 + 1e-9)], axis=1)
    bounds = np.sort(limits, axis=1)
    cut = make_cut(np.array([[-0.18, 0.19]]), [0, 1])
    yaw = predicted(TRUTH, cut)[0, 2]
    assert 0.59 < yaw < 0.6
    motion = np.array([[0.0, 0.0, yaw]])  # the cost is the chord squared
    total = moments(cut, make_windows(motion), TRUTH, bounds, tolerance=1e-14)
    assert_allclose(total.cost(TRUTH.matrix()), squared_cost(TRUTH, cut, motion), rtol=2e-12)


def test_whole_turns_are_those_of_the_start_model() -> None:
    """Turns of 350 deg are measured as -10 deg."""
    cut = make_cut(np.tile([-0.0171, 0.0171], (100, 1)), [0, 100])
    truth = predicted(TRUTH, cut)
    assert truth[0, 2] > np.pi
    wrapped = truth.copy()
    wrapped[:, 2] = se2.wrap(truth[:, 2])
    total = moments(cut, make_windows(wrapped), TRUTH, NARROW)
    assert abs(total.cost(TRUTH.matrix())) < 1e-9
    assert_allclose(total.heading[2, 2], truth[0, 2] ** 2)


def test_no_windows_cost_nothing() -> None:
    total = moments(make_cut(np.zeros((0, 2)), [0]), make_windows(np.zeros((0, 3))), TRUTH, WIDE)
    assert total.windows == 0
    assert total.cost(TRUTH.matrix()) == 0.0


@pytest.mark.parametrize("name", MODELS)
def test_box_holds_every_model_inside_the_bounds(name: str) -> None:
    start = MODELS[name].nominal(VEHICLE)
    if not isinstance(start, MatrixModel):
        pytest.skip("not linear in the rim speeds")
    bounds = type(start).bounds(VEHICLE)
    box = yaw_box(start, bounds)
    share = np.random.default_rng(0).beta(0.3, 0.3, (2000, len(bounds)))  # crowded towards the bounds
    rows = matrices(start, bounds[:, 0] + share * (bounds[:, 1] - bounds[:, 0]))[:, 2]
    assert (rows >= box[:, 0] - 1e-12).all()
    assert (rows <= box[:, 1] + 1e-12).all()
    reached = (rows.max(axis=0) - rows.min(axis=0)) / np.maximum(box[:, 1] - box[:, 0], 1e-12)
    assert len(bounds) == 0 or (reached > 0.8).all()


def test_a_model_without_parameters_has_a_cost() -> None:
    drive = make_drive(3)
    start = Differential.nominal(VEHICLE)
    total = drive_moments(drive, start, Differential.bounds(VEHICLE))
    windows = increment_windows(drive)
    error = predict(start, drive.wheels, windows, Timing()) - windows.motion
    assert_allclose(total.cost(start.matrix()), (error**2).sum(), rtol=1e-9)
    found = fit_squares(total, start, Differential.bounds(VEHICLE))
    assert found.converged
    assert found.model == start


def test_outside_the_box_is_refused() -> None:
    cut = random_cut(0, 0.01)
    total = moments(cut, make_windows(measured(cut, 0)), TRUTH, NARROW)
    with pytest.raises(
        RequestError, match=r"the moments hold for A31 in \[-2\.5, -1\.067\].*, not for \[-5\.0, 1\.5\]"
    ):
        total.cost([TRUTH.matrix(), [[0.5, 0.5], [0.0, 0.0], [-5.0, 1.5]]])
    with pytest.raises(RequestError, match="not for"):
        total.cost_and_gradient([[0.5, 0.5], [0.0, 0.0], [-2.0, np.nan]])
    with pytest.raises(ValueError, match=r"need matrices \(\.\.\., 3, 2\)"):
        total.cost(np.zeros((2, 3)))


def test_windows_too_long_for_the_bounds_are_refused() -> None:
    cut = make_cut(np.full((100, 2), 0.1), [0, 100])
    with pytest.raises(RequestError, match=r"the left side rolls 10 m.*-18\.75 and -0\.2083 1/m.*shorten the windows"):
        moments(cut, make_windows(np.zeros((1, 3))), TRUTH, WIDE)
    assert moments(cut, make_windows(np.zeros((1, 3))), TRUTH, NARROW).table.shape[0] > 10


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        (WIDE[:4], "need bounds"),
        (WIDE[:, ::-1], "bounds of icr_y_left need lower < upper"),
        (np.where(np.isfinite(WIDE), np.nan, WIDE), "bounds of icr_y_left"),
    ],
)
def test_bad_bounds_are_refused(bounds: FloatArray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        yaw_box(TRUTH, bounds)


def test_bounds_with_impossible_models_are_refused() -> None:
    bounds = WIDE.copy()
    bounds[0, 0] = -2.0
    with pytest.raises(RequestError, match="the bounds allow impossible models: need icr_y_left > icr_y_right"):
        yaw_box(TRUTH, bounds)


def test_a_drive_without_heading_or_windows_is_refused() -> None:
    drive = make_drive(0)
    assert drive.pose is not None
    with pytest.raises(RequestError, match="needs reference poses with heading"):
        drive_moments(replace(drive, pose=None), TRUTH, WIDE)
    with pytest.raises(RequestError, match="no two neighbouring reference poses"):
        drive_moments(replace(drive, pose=Series([1.0], drive.pose.values[:1], "pose")), TRUTH, WIDE)


def test_moments_cannot_be_changed() -> None:
    total = drive_moments(make_drive(0), TRUTH, NARROW)
    for array in (total.box, total.table, total.heading):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0.0


def total_and_windows(seed: int) -> tuple[Moments, Drive, Windows]:
    drive = make_drive(seed)
    return drive_moments(drive, Icr.nominal(VEHICLE), WIDE), drive, increment_windows(drive)


def test_least_squares_are_those_of_scipy_on_the_windows() -> None:
    total, drive, windows = total_and_windows(5)
    found = fit_squares(total, Icr.nominal(VEHICLE), WIDE)

    def residual(theta: FloatArray) -> FloatArray:
        return (predict(TRUTH.with_theta(theta), drive.wheels, windows, Timing()) - windows.motion).ravel()

    expected = least_squares(residual, TRUTH.theta, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert found.converged
    assert_allclose(found.cost, 2.0 * expected.cost, rtol=1e-8)
    assert_allclose(found.model.theta, expected.x, atol=2e-5)


def test_least_squares_recover_the_truth_of_a_clean_drive() -> None:
    drive = make_drive(6, noise=0.0)
    found = fit_squares(drive_moments(drive, Icr.nominal(VEHICLE), WIDE), Icr.nominal(VEHICLE), WIDE)
    assert_allclose(found.model.theta, TRUTH.theta, atol=1e-4)


def test_least_squares_stay_inside_the_bounds() -> None:
    total, *_ = total_and_windows(7)
    start = SymmetricIcr.nominal(VEHICLE)
    bounds = np.array([[0.05, 0.2], [0.95, 1.4]])  # the truth lies outside in both
    found = fit_squares(total, start, bounds)
    assert_allclose(found.model.theta, [0.2, 0.95], atol=0.06)
    assert (found.model.theta >= bounds[:, 0] - 1e-12).all()
    assert (found.model.theta <= bounds[:, 1] + 1e-12).all()
    free = fit_squares(total, start, SymmetricIcr.bounds(VEHICLE))
    assert_allclose(free.model.theta, [0.285, 0.915], atol=0.01)
    assert free.cost < found.cost
