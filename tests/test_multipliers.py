"""The three factors of a differential drive controller that lose least of a model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.drive import Drive, Series
from skidsteer.models import MODELS, Curvature, Icr, Linear, Model, ScheduledIcr
from skidsteer.multipliers import Multipliers, moving_rims, project, usual_rims
from skidsteer.vehicle import Vehicle

WIDTH = 0.6
VEHICLE = Vehicle("test", track_width=WIDTH, wheel_radius=0.15)
ICR = Icr(0.55, -0.45, 0.06, 0.9, 0.95)
RIMS = usual_rims(1.0)

icrs = st.builds(
    Icr,
    icr_y_left=st.floats(0.3, 1.0),
    icr_y_right=st.floats(-1.0, -0.3),
    icr_x=st.floats(-0.3, 0.3),
    alpha_left=st.floats(0.7, 1.2),
    alpha_right=st.floats(0.7, 1.2),
)


def test_an_icr_by_hand() -> None:
    """y_l - y_r = 1.0 m over 0.6 m; the lever arm is (icr_x, (y_l + y_r) / 2)."""
    found = project(ICR, RIMS, WIDTH)
    assert_allclose(found.multipliers.theta, [0.9, 0.95, 1.0 / 0.6], rtol=1e-9)
    assert_allclose([found.x, found.y], [0.06, 0.05], atol=1e-9)


@given(icrs, st.integers(0, 2**32 - 1))
def test_the_controller_tells_exactly_how_one_point_of_the_robot_moves(model: Icr, seed: int) -> None:
    """Whatever the motions it was found over: the velocity at a point p of a rigid body is v + omega x p."""
    rng = np.random.default_rng(seed)
    found = project(model, rng.uniform(-1.0, 1.0, (20, 2)), WIDTH)
    rims = rng.uniform(-2.0, 2.0, (30, 2))
    v_x, v_y, omega = model.twist(rims[:, 0], rims[:, 1]).T
    at_point = np.stack([v_x - omega * found.y, v_y + omega * found.x, omega], axis=1)
    assert_allclose(found.multipliers.twist(rims[:, 0], rims[:, 1]), at_point, atol=1e-8)


def test_a_linear_model_keeps_its_yaw_rate() -> None:
    model = Linear(0.5, 0.42, 0.05, -0.02, -0.9, 1.1)
    twist, forced = (m.twist(RIMS[:, 0], RIMS[:, 1]) for m in (model, project(model, RIMS, WIDTH).multipliers))
    assert_allclose(forced[:, 2], twist[:, 2], atol=1e-12)
    straight = np.abs(twist[:, 2]) < 1e-9
    assert_allclose(forced[straight, 0], twist[straight, 0], atol=1e-12)


@pytest.mark.parametrize(
    "model",
    [
        Curvature(0.6, 0.1, 0.92, WIDTH),
        ScheduledIcr(0.55, -0.45, 0.06, 0.9, 0.95, 0.3, 0.1, 0.2, 0.1, 0.4),
    ],
)
def test_no_other_factors_are_nearer_in_yaw_rate(model: Model) -> None:
    """Least squares, checked by moving the two numbers that the yaw rate hangs on."""
    found = project(model, RIMS, WIDTH).multipliers
    omega = model.twist(RIMS[:, 0], RIMS[:, 1])[:, 2]

    def miss(multipliers: Multipliers) -> float:
        return float(np.sum((multipliers.twist(RIMS[:, 0], RIMS[:, 1])[:, 2] - omega) ** 2))

    least = miss(found)
    assert least > 0.0
    for change in ([1.01, 1.0, 1.0], [0.99, 1.0, 1.0], [1.0, 1.01, 1.0], [1.0, 0.99, 1.0], [1.0, 1.0, 1.01]):
        assert miss(found.with_theta(found.theta * change)) > least


@pytest.mark.parametrize("name", MODELS)
def test_a_nominal_model_has_no_multipliers(name: str) -> None:
    found = project(MODELS[name].nominal(VEHICLE), RIMS, WIDTH)
    assert_allclose(found.multipliers.theta, 1.0, rtol=1e-3)  # the curvature model rounds its cusp off
    assert_allclose([found.x, found.y], 0.0, atol=1e-9)


def test_jacobian_by_finite_differences() -> None:
    model, step = Multipliers(0.9, 0.95, 1.7, WIDTH), 1e-6
    for i, column in enumerate(np.moveaxis(model.matrix_jacobian(), -1, 0)):
        ahead, back = (model.with_theta(model.theta + s * np.eye(3)[i]).matrix() for s in (step, -step))
        assert_allclose(column, (ahead - back) / (2.0 * step), atol=1e-8)


def test_a_model_that_is_no_differential_drive_is_refused() -> None:
    with pytest.raises(ValueError, match="_wheel_radius_multiplier > 0"):
        project(Linear(0.5, 0.5, 0.0, 0.0, 1.0, 2.0), RIMS, WIDTH)


def drive(values: list[tuple[float, float]]) -> Drive:
    return Drive("test", VEHICLE, Series(np.arange(len(values)) * 0.1, np.array(values), "wheels"))


def test_only_motions_count() -> None:
    made = drive([(0.0, 0.0), (0.2, 0.4), (0.5, 0.5), (-0.3, 0.3), (0.0, 0.0)])
    assert_allclose(moving_rims([made]), [(0.2, 0.4), (0.5, 0.5), (-0.3, 0.3)])


@pytest.mark.parametrize("values", [[(0.0, 0.0)] * 5, [(0.5, 0.5)] * 5, [(-0.2, 0.2)] * 5])
def test_drives_that_do_not_tell_give_way_to_usual_motions(values: list[tuple[float, float]]) -> None:
    """At rest, straight on only, or on the spot only: the factors are those of the model all the same."""
    found = project(ICR, moving_rims([drive(values)]), WIDTH)
    assert_allclose(found.multipliers.theta, [0.9, 0.95, 1.0 / 0.6], rtol=1e-9)
