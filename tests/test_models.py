import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.models import (
    MODELS,
    Differential,
    Icr,
    Linear,
    MatrixModel,
    Model,
    Multiplier,
    ScheduledIcr,
    SymmetricIcr,
)
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import PRESETS, preset

P3AT = preset("pioneer-p3at")
SPEEDS = np.array([[0.7, -0.3], [0.0, 0.4], [-0.5, -0.5], [0.2, 0.6], [0.0, 0.0]])
SHARE = [0.6, 0.3, 0.7, 0.2, 0.4, 0.8, 0.35, 0.55, 0.45, 0.65]  # somewhere inside, for as many parameters as there are
names = pytest.mark.parametrize("name", sorted(MODELS))
speeds = st.floats(-2.0, 2.0)


def model_at(name: str, share: list[float]) -> Model:
    """A model whose parameters lie at a share of the way from lower to upper bound."""
    if name == "linear":  # v_x of both sides positive: elsewhere the rows may be parallel, and nothing steers
        share = [0.4 + 0.6 * share[0], 0.4 + 0.6 * share[1], *share[2:]]
    kind = MODELS[name]
    bounds = kind.bounds(P3AT)
    return kind.nominal(P3AT).with_theta(bounds[:, 0] + np.array(share[: len(bounds)]) * (bounds[:, 1] - bounds[:, 0]))


shares = st.lists(st.floats(0.05, 0.95), min_size=10, max_size=10)


def difference(f: Any, x: FloatArray, h: float = 1e-6) -> FloatArray:
    """Central differences of f (...) by x (p,): (..., p)."""
    columns = []
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = h
        columns.append((f(x + step) - f(x - step)) / (2 * h))
    return np.stack(columns, axis=-1) if columns else np.zeros((*f(x).shape, 0))


@names
@given(share=shares, v_left=speeds, v_right=speeds)
def test_parameter_jacobian_is_the_finite_difference(
    name: str, share: list[float], v_left: float, v_right: float
) -> None:
    model = model_at(name, share)
    expected = difference(lambda theta: model.with_theta(theta).twist(v_left, v_right), model.theta)
    scale = 1.0 + np.abs(expected).max(initial=0.0)
    assert_allclose(model.parameter_jacobian(v_left, v_right) / scale, expected / scale, atol=2e-7)


@names
@given(share=shares, v_left=speeds, v_right=speeds)
def test_speed_jacobian_is_the_finite_difference(name: str, share: list[float], v_left: float, v_right: float) -> None:
    model = model_at(name, share)
    expected = difference(lambda v: model.twist(v[0], v[1]), np.array([v_left, v_right]))
    assert_allclose(model.speed_jacobian(v_left, v_right), expected, atol=1e-7)


@names
@given(share=shares, v=speeds, omega=speeds)
def test_wheel_speeds_give_the_twist_asked_for(name: str, share: list[float], v: float, omega: float) -> None:
    model = model_at(name, share)
    twist = model.twist(*model.wheel_speeds(v, omega))
    assert_allclose(twist[[0, 2]], [v, omega], atol=1e-9)


@names
def test_batch_equals_loop(name: str) -> None:
    model = model_at(name, SHARE)
    left, right = SPEEDS.T
    for function in (model.twist, model.parameter_jacobian, model.speed_jacobian, model.wheel_speeds):
        whole = function(left, right)
        assert_allclose(whole, [function(a, b) for a, b in SPEEDS], atol=1e-15)
        assert_allclose(function(left[:4].reshape(2, 2), right[:4].reshape(2, 2))[1, 0], whole[2], atol=1e-15)
        assert_allclose(function(left, 0.3), function(left, np.full(5, 0.3)), atol=0)
        assert function(left[:0], right[:0]).shape == (0, *whole.shape[1:])


@names
@pytest.mark.parametrize("vehicle", sorted(PRESETS))
def test_nominal_is_the_ideal_differential_drive(name: str, vehicle: str) -> None:
    robot = PRESETS[vehicle]
    left, right = SPEEDS.T
    ideal = np.stack([(left + right) / 2, 0 * left, (right - left) / robot.track_width], axis=-1)
    assert_allclose(MODELS[name].nominal(robot).twist(left, right), ideal, atol=1e-14)


@names
@pytest.mark.parametrize("vehicle", sorted(PRESETS))
def test_bounds_contain_the_nominal(name: str, vehicle: str) -> None:
    kind, robot = MODELS[name], PRESETS[vehicle]
    bounds, theta = kind.bounds(robot), kind.nominal(robot).theta
    assert bounds.shape == (len(kind.PARAMETERS), 2)
    optional = np.array([p.name in (*kind.OPTIONAL, "slip_fade") for p in kind.PARAMETERS], dtype=bool)
    assert ((bounds[:, 0] < theta) | optional & (bounds[:, 0] == theta)).all()
    assert (theta < bounds[:, 1]).all()


def test_bounds_and_nominal_grow_with_the_track_by_hand() -> None:
    robot = preset("warthog")
    w = robot.track_width
    assert_allclose(Icr.bounds(robot)[:2], [[0.1 * w, 3.0 * w], [-3.0 * w, -0.1 * w]])
    assert_allclose(Icr.nominal(robot).theta, [w / 2, -w / 2, 0.0, 1.0, 1.0])
    assert_allclose(Linear.bounds(robot)[5], [0.1 / w, 2.5 / w])
    assert_allclose(Multiplier.nominal(robot).theta, [1.0])
    assert Multiplier.nominal(robot).track_width == w


@names
def test_theta_round_trip(name: str) -> None:
    model = model_at(name, SHARE)
    again = MODELS[name].nominal(P3AT).with_theta(model.theta)
    assert again == model
    assert type(again) is type(model)


@names
def test_name_matches_the_table(name: str) -> None:
    assert name == MODELS[name].NAME


def test_models_come_from_the_simplest_to_the_richest() -> None:
    counts = [len(m.PARAMETERS) for m in MODELS.values()]
    assert counts == sorted(counts)


def test_with_theta_refuses_another_length() -> None:
    with pytest.raises(ValueError, match="zip"):
        Icr.nominal(P3AT).with_theta([1.0, 2.0])


@pytest.mark.parametrize("name", [name for name, kind in MODELS.items() if issubclass(kind, MatrixModel)])
def test_matrix_models_are_linear_in_the_rims(name: str) -> None:
    model = model_at(name, SHARE)
    assert isinstance(model, MatrixModel)
    assert_allclose(model.twist(0.3, -0.7), model.matrix() @ [0.3, -0.7], atol=1e-15)


# Worked by hand, every parameter non-zero


def test_icr_by_hand() -> None:
    """Where a tread stands still on the ground, the body above it moves just as fast as that tread runs backwards.

    Treads run at 0.8 * 1.0 = 0.8 and 0.9 * 2.0 = 1.8 m/s. At y = 0.4 the body moves at v_x - 0.4 omega = 0.8, at
    y = -0.6 at v_x + 0.6 omega = 1.8. Hence omega = 1.0 and v_x = 1.2; and at x = 0.2 v_y + 0.2 omega = 0.
    """
    twist = Icr(icr_y_left=0.4, icr_y_right=-0.6, icr_x=0.2, alpha_left=0.8, alpha_right=0.9).twist(1.0, 2.0)
    assert_allclose(twist, [1.2, -0.2, 1.0], atol=1e-15)


def test_scheduled_icr_by_hand() -> None:
    """On the constant ICR above, v = 1.2 m/s and omega = 1 rad/s.

    v_x = 1.2 / (1 + 0.25); the ICRs are 1 m apart, so that the yaw rate gains 0.2 * 1.44 / (1.44 + 1 + 0.0004) by how
    straight the path is; the ICRs close in by 0.3 * 1.2 / 4.2 by lateral acceleration;
    v_y = -0.2 omega' - 0.4 * 1.2 / (1 + 0.5 * 1.2).
    """
    terms = {"turn_loss": 0.25, "side_slip": 0.4, "straight_gain": 0.2, "load_gain": 0.3, "slip_fade": 0.5}
    model = ScheduledIcr(icr_y_left=0.4, icr_y_right=-0.6, icr_x=0.2, alpha_left=0.8, alpha_right=0.9, **terms)
    omega = (1.0 + 0.2 * 1.44 / 2.4404) / (1.0 - 0.3 * 1.2 / 4.2)
    assert_allclose(model.twist(1.0, 2.0), [0.96, -0.2 * omega - 0.3, omega], rtol=1e-14)


def test_half_of_the_straight_gain_is_reached_on_a_circle_of_the_icrs_distance() -> None:
    """There Wang's lambda is 2; none of it is reached on the spot, all of it far from there, whatever the speed."""
    plain = ScheduledIcr(0.4, -0.6, 0.2, 0.8, 0.9, 0.0, 0.0, 0.0, 0.0, 0.0)
    model = replace(plain, straight_gain=0.3)
    for omega in (0.5, -3.0):
        for radius, share in ((0.0, 0.0), (1.0, 0.5), (-1.0, 0.5), (100.0, 1.0)):
            rims = plain.wheel_speeds(radius * omega, omega)
            assert_allclose(model.twist(*rims)[2], omega * (1.0 + 0.3 * share), rtol=4e-4)


@pytest.mark.parametrize("load_gain", [0.5, -3.0])
def test_wheel_speeds_of_a_scheduled_icr_are_found_at_any_operating_point(load_gain: float) -> None:
    """At the bounds of every term, at rest, on the spot and far beyond what drives; NaN where nothing was asked for."""
    model = ScheduledIcr(0.4, -0.6, 0.2, 0.8, 0.9, 5.0, 0.4, 1.0, load_gain, 0.5)
    asked = np.stack(np.meshgrid([-9.0, -0.1, 0.0, 1e-3, 1.0, 9.0], [-5.0, -0.2, 0.0, 1e-3, 3.0]), axis=-1)
    twist = model.twist(*np.moveaxis(model.wheel_speeds(asked[..., 0], asked[..., 1]), -1, 0))
    assert_allclose(twist[..., [0, 2]], asked, rtol=1e-9, atol=1e-10)
    speeds = model.wheel_speeds([1.0, np.nan, 1.0], [0.5, 0.5, np.nan])
    assert np.isnan(speeds).all(axis=-1).tolist() == [False, True, True]


@given(shares, speeds, speeds)
def test_icr_obeys_mandows_definition(share: list[float], v_left: float, v_right: float) -> None:
    """Mandow 2007, Eqs. (2)-(5) in REP-103: the defining equations, not the solved matrix."""
    m = model_at("icr", share)
    assert isinstance(m, Icr)
    v_x, v_y, omega = m.twist(v_left, v_right)
    assert_allclose(v_x - omega * m.icr_y_left, m.alpha_left * v_left, atol=1e-12)
    assert_allclose(v_x - omega * m.icr_y_right, m.alpha_right * v_right, atol=1e-12)
    assert_allclose(v_y + omega * m.icr_x, 0.0, atol=1e-12)  # the ICR's longitudinal coordinate is the same for all


def test_icr_signs_by_eye() -> None:
    m = Icr(0.3, -0.3, 0.1, 1.0, 1.0)
    assert m.twist(0.0, 1.0)[2] > 0  # the right side faster turns left
    assert m.twist(-1.0, 1.0)[1] < 0  # turning left about a point ahead, the origin behind it moves right
    assert Icr(0.2, -0.4, 0.0, 1.0, 1.0).twist(-1.0, 1.0)[0] < 0  # centre of turn to the right: origin moves back


def test_symmetric_icr_by_hand() -> None:
    # treads at 0.9 and 1.8 m/s, ICRs 0.75 m apart: omega = 0.9 / 0.75
    assert_allclose(SymmetricIcr(icr_y=0.375, alpha=0.9).twist(1.0, 2.0), [1.35, 0.0, 1.2], atol=1e-15)


def test_multiplier_by_hand() -> None:
    assert_allclose(Multiplier(multiplier=1.6, track_width=0.5).twist(1.0, 1.4), [1.2, 0.0, 0.5], atol=1e-15)


def test_differential_by_hand() -> None:
    assert_allclose(Differential(track_width=0.5).twist(1.0, 1.4), [1.2, 0.0, 0.8], atol=1e-15)


def test_linear_by_hand() -> None:
    model = Linear(vx_left=0.4, vx_right=0.6, vy_left=-0.1, vy_right=0.2, omega_left=-1.5, omega_right=1.1)
    assert_allclose(model.twist(2.0, 3.0), [2.6, 0.4, 0.3], atol=1e-15)


@given(st.floats(0.05, 2.0), st.floats(0.5, 1.5), speeds, speeds)
def test_icr_with_symmetric_values_is_symmetric_icr(y: float, alpha: float, v_left: float, v_right: float) -> None:
    five, two = Icr(y, -y, 0.0, alpha, alpha), SymmetricIcr(y, alpha)
    assert_allclose(five.twist(v_left, v_right), two.twist(v_left, v_right), atol=1e-12)


@given(st.floats(0.4, 6.0), st.floats(0.1, 2.0), speeds, speeds)
def test_multiplier_is_symmetric_icr_without_scale(m: float, width: float, v_left: float, v_right: float) -> None:
    two = SymmetricIcr(m * width / 2, 1.0)
    assert_allclose(Multiplier(m, width).twist(v_left, v_right), two.twist(v_left, v_right), atol=1e-12)


@given(shares, speeds, speeds)
def test_linear_holds_every_icr_model(share: list[float], v_left: float, v_right: float) -> None:
    icr = model_at("icr", share)
    assert isinstance(icr, Icr)
    free = Linear(*icr.matrix().ravel())
    assert_allclose(free.twist(v_left, v_right), icr.twist(v_left, v_right), atol=1e-12)


def test_figures_of_mandows_table_one() -> None:
    """Mandow 2007, Table I, pneumatic tyres: x_ICRr = 0.3071, x_ICRl = -0.2553 on a track of 0.40 m."""
    m = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)
    assert m.steering_efficiency(0.40) == pytest.approx(0.40 / 0.5624, abs=1e-12)
    assert m.eccentricity() == pytest.approx(0.0518 / 0.5624, abs=1e-12)


# Refusals


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        (Differential, (0.0,), "need track_width > 0 [m], got 0.0"),
        (Differential, (np.nan,), "need track_width > 0 [m], got nan"),
        (Multiplier, (0.0, 0.5), "need multiplier > 0 and track_width > 0, got 0.0, 0.5"),
        (Multiplier, (1.5, -0.5), "need multiplier > 0 and track_width > 0, got 1.5, -0.5"),
        (Icr, (-0.3, 0.3, 0.0, 1.0, 1.0), "need icr_y_left > icr_y_right [m], got -0.3, 0.3"),
        (Icr, (0.3, 0.3, 0.0, 1.0, 1.0), "need icr_y_left > icr_y_right [m], got 0.3, 0.3"),
        (Icr, (0.3, -0.3, 0.0, 0.0, 1.0), "need alpha_left, alpha_right > 0, got 0.0, 1.0"),
        (Icr, (0.3, -0.3, 0.0, 1.0, -1.0), "need alpha_left, alpha_right > 0, got 1.0, -1.0"),
        (SymmetricIcr, (0.0, 1.0), "need icr_y > 0 [m] and alpha > 0, got 0.0, 1.0"),
        (SymmetricIcr, (0.3, -1.0), "need icr_y > 0 [m] and alpha > 0, got 0.3, -1.0"),
        (
            Linear,
            (0.5, 0.5, 0.0, 0.0, 1.0, 1.0),
            "the rows of v_x and omega are parallel: the robot could not be steered",
        ),
    ],
)
def test_constructors_refuse(kind: type[Model], arguments: tuple[float, ...], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        kind(*arguments)


@names
def test_models_are_frozen(name: str) -> None:
    model = MODELS[name].nominal(P3AT)
    field = next(iter(model.__dataclass_fields__))
    with pytest.raises(AttributeError):
        setattr(model, field, 1.0)
