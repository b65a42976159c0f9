from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.errors import RequestError
from skidsteer.se2 import FloatArray, compose, exp
from skidsteer.terramechanics.robot import Robot, robot, wang_robot
from skidsteer.terramechanics.shear import (
    Quadrature,
    friction,
    rolling_forces,
    unit_forces,
    wheel_forces,
)
from skidsteer.terramechanics.terrain import ALWAYS, TERRAINS, Area, Ground, terrain
from skidsteer.vehicle import Vehicle, preset

LAB = TERRAINS["lab"]
P3AT = wang_robot()
SIX = robot(replace(preset("husky-a200"), wheels=6), com_x=0.04, com_y=-0.03)
K = LAB.shear_modulus
SOFT = replace(LAB, shear_modulus=0.02, lateral_shear_modulus=0.05)

speeds = st.floats(-1.0, 1.0)
twists = st.tuples(speeds, speeds, st.floats(-2.0, 2.0))


def chord_force(twist: FloatArray, rim: float, place: FloatArray, shear_modulus: float) -> FloatArray:
    """F_x, F_y, moment of one wheel by Eqs. (17)-(21) with Yu's displacement, summed over a fine grid."""
    length, width = P3AT.patch_length, P3AT.patch_width
    entry = place[0] + np.copysign(0.5 * length, rim)
    share = (np.arange(400) + 0.5) / 400
    T, y = np.meshgrid(share * length / abs(rim), place[1] + (share - 0.5) * width)
    x = entry - rim * T
    there = compose(exp(twist * T[..., None]), np.stack([x, y, 0.0 * x], axis=-1))
    j = np.hypot(there[..., 0] - entry, there[..., 1] - y)  # over the ground, since it came in
    s_x, s_y = twist[0] - twist[2] * y - rim, twist[1] + twist[2] * x
    strength = -(1.0 - np.exp(-j / shear_modulus)) / np.hypot(s_x, s_y)
    forces = np.stack([strength * s_x, strength * s_y, strength * (x * s_y - y * s_x)])
    return np.asarray(forces.mean(axis=(1, 2)))


# The stress


@pytest.mark.parametrize("shear_modulus", [0.0054, 0.05])
def test_forces_are_the_integrals_of_the_paper(shear_modulus: float) -> None:
    """Every parameter differs from zero; wheels turn opposite ways. What differs is of order (omega T)^2."""
    twist, rims, ground = np.array([0.11, -0.03, 0.9]), (-0.2, 0.45), replace(LAB, shear_modulus=shear_modulus)
    ours = unit_forces(P3AT, ground, twist, rims, Quadrature(16, 6))[..., 0]
    for wheel in (0, 3):  # front left, rear right
        rim = rims[P3AT.side[wheel]]
        expected = chord_force(twist, rim, P3AT.places[wheel], shear_modulus)
        assert np.abs(expected).min() > 0.005
        assert_allclose(ours[wheel], expected, rtol=(0.9 * 0.035 / rim) ** 2 / 12)


def test_sliding_without_turning_by_hand() -> None:
    """Stress p mu (1 - exp(-s T / K)) over T = 0 .. length / rim has the mean 1 - (1 - exp(-a)) / a."""
    twist, rims = np.array([0.42, 0.03, 0.0]), np.array([0.4, 0.45])
    forces = wheel_forces(P3AT, LAB, twist, rims)
    for wheel, rim in ((0, 0.4), (1, 0.4), (2, 0.45), (3, 0.45)):
        slip = np.array([0.42 - rim, 0.03])
        a = np.hypot(*slip) * 0.035 / rim / K
        expected = -31.0 * 9.81 / 4.0 * 0.4437 * (1.0 - (1.0 - np.exp(-a)) / a) * slip / np.hypot(*slip)
        assert_allclose(forces[wheel, :2], expected, rtol=2e-4)


def test_sliding_on_tyres_soft_sideways_by_hand() -> None:
    """The part exp(-z) of the stress, z = T (s_x / K, s_y / K_y), points against the latter, the rest against s."""
    ground = replace(LAB, lateral_shear_modulus=0.0013)
    forces = unit_forces(P3AT, ground, [0.41, 0.03, 0.0], [0.4, 0.45])[..., 0]
    for wheel, rim in ((1, 0.4), (3, 0.45)):
        slip = np.array([0.41 - rim, 0.03])
        elastic = slip / [K, 0.0013]
        a = np.hypot(*elastic) * 0.035 / rim
        once, twice = -np.expm1(-a) / a, -np.expm1(-2.0 * a) / (2.0 * a)  # means of exp(-z) and of its square
        expected = -(once - twice) * elastic / np.hypot(*elastic) - (1.0 - 2.0 * once + twice) * slip / np.hypot(*slip)
        assert_allclose(forces[wheel, :2], expected, rtol=3e-4)


def test_equal_stiffness_is_the_paper() -> None:
    twist, rims = [0.11, -0.03, 0.9], [-0.2, 0.45]
    same = unit_forces(P3AT, replace(LAB, lateral_shear_modulus=K), twist, rims)
    assert_allclose(same, unit_forces(P3AT, LAB, twist, rims), rtol=1e-12)


def test_a_stiff_ground_gives_coulomb_friction() -> None:
    forces = unit_forces(P3AT, replace(LAB, shear_modulus=1e-9), [0.3, 0.1, 0.0], [0.2, 0.5])[..., 0]
    for wheel, slip in ((0, [0.1, 0.1]), (3, [-0.2, 0.1])):
        assert_allclose(forces[wheel, :2], -np.array(slip) / np.hypot(*slip), rtol=1e-4)


def test_forces_scale_with_load_and_friction() -> None:
    twist, rims, loads = [0.1, 0.05, 0.6], [-0.1, 0.3], np.array([40.0, 50.0, 60.0, 154.11])
    unit = unit_forces(P3AT, LAB, twist, rims)[..., 0]
    assert_allclose(wheel_forces(P3AT, LAB, twist, rims, loads), unit * (loads * 0.3093)[:, None])
    assert_allclose(
        friction(LAB, [[0.1, 0.2], [-0.1, -0.2], [0.1, -0.2], [0.0, 0.3]]), [0.4437, 0.4437, 0.3093, 0.4437]
    )


@given(twists, speeds, speeds)
def test_sliding_only_takes_power(twist: tuple[float, float, float], left: float, right: float) -> None:
    """What the rims put in is no less than what the body gets."""
    rims = np.array([left, right])
    forces = wheel_forces(SIX, SOFT, twist, rims)
    put_in = forces[:, 0] @ rims[SIX.side]
    assert forces.sum(axis=0) @ twist <= put_in + 1e-9
    rolling, _ = rolling_forces(SIX, LAB, twist)
    assert rolling.sum(axis=0) @ twist <= 1e-12


@given(twists, speeds, speeds)
def test_the_mirror_image_has_the_forces_mirrored(twist: tuple[float, float, float], left: float, right: float) -> None:
    ground = replace(LAB, lateral_shear_modulus=0.003)
    forces = unit_forces(P3AT, ground, twist, [left, right])[..., 0]
    mirrored = unit_forces(P3AT, ground, np.array(twist) * [1, -1, -1], [right, left])[..., 0]
    assert_allclose(mirrored[[2, 3, 0, 1]] * [1, -1, -1], forces, atol=1e-9)


@settings(deadline=None)
@given(twists, st.floats(0.02, 1.0), st.floats(-1.0, -0.02))
def test_derivatives_are_finite_differences(twist: tuple[float, float, float], left: float, right: float) -> None:
    z, h = np.array([*twist, left, right]), 1e-7
    forces = unit_forces(P3AT, SOFT, z[:3], z[3:])
    for k in range(5):
        step = h * np.eye(5)[k]
        after, before = (unit_forces(P3AT, SOFT, (z + d)[:3], (z + d)[3:])[..., 0] for d in (step, -step))
        own = forces[..., 1 + min(k, 3)] * (1.0 if k < 3 else (P3AT.side == k - 3)[:, None])
        slide = np.hypot(z[0] - z[2] * P3AT.places[:, 1] - z[3:][P3AT.side], z[1] + z[2] * P3AT.places[:, 0])
        smooth = slide > 0.1 + 0.1 * abs(z[2])  # no node slides as slowly as the differences' steps
        assert_allclose(((after - before) / (2.0 * h))[smooth], own[smooth], atol=1e-5)


def test_a_batch_is_a_loop() -> None:
    rng = np.random.default_rng(3)
    twist, rims = rng.normal(size=(2, 5, 3)), rng.normal(size=(5, 2))
    forces = wheel_forces(SIX, LAB, twist, rims)
    assert forces.shape == (2, 5, 6, 3)
    for i in range(2):
        for j in range(5):
            assert_allclose(forces[i, j], wheel_forces(SIX, LAB, twist[i, j], rims[j]))


def test_the_nodes_are_as_accurate_as_the_documentation_says() -> None:
    rng = np.random.default_rng(1)
    twist = rng.normal(size=(200, 3)) * [0.3, 0.1, 0.6]
    rims = twist[:, :1] + twist[:, 2:] * [-0.29, 0.29] + rng.normal(scale=0.02, size=(200, 2))
    fine = unit_forces(P3AT, LAB, twist, rims, Quadrature(60, 30))[..., 0]
    error = [
        np.abs(unit_forces(P3AT, LAB, twist, rims, Quadrature(n, m))[..., :2, 0] - fine[..., :2]) for n, m in NODES
    ]
    assert [float(np.sqrt((e**2).mean())) < limit for e, limit in zip(error, (2e-3, 5e-4), strict=True)] == [True] * 2


NODES = ((8, 3), (16, 6))


def test_a_wheel_that_does_not_turn_slides_with_full_friction() -> None:
    forces = unit_forces(P3AT, LAB, [0.2, 0.1, 0.0], [0.0, 0.0])[..., 0]
    assert_allclose(forces[:, :2], np.tile(-np.array([0.2, 0.1]) / np.hypot(0.2, 0.1), (4, 1)), rtol=1e-3)
    assert_allclose(unit_forces(P3AT, LAB, [0.0, 0.0, 0.0], [0.0, 0.0])[..., 0], 0.0)


# Rolling resistance


def test_rolling_resistance_adds_up_to_the_printed_one() -> None:
    force, _ = rolling_forces(P3AT, LAB, [0.5, 0.02, 0.3])
    assert_allclose(force.sum(axis=0), [-31.0 * 9.81 * 0.0371, 0.0, 0.0], rtol=1e-5, atol=1e-4)  # Eq. (22)
    on_the_spot, _ = rolling_forces(P3AT, LAB, [0.0, 0.0, 1.0])
    assert_allclose(on_the_spot.sum(axis=0), [0.0, 0.0, -31.0 * 9.81 * 0.0371 * 0.2], rtol=1e-4, atol=1e-9)


def test_the_slope_of_rolling_resistance() -> None:
    twist = np.array([2e-4, 1e-4, 3e-3])
    _, slope = rolling_forces(SIX, LAB, twist)
    for k in range(3):
        step = 1e-8 * np.eye(3)[k]
        difference = rolling_forces(SIX, LAB, twist + step)[0] - rolling_forces(SIX, LAB, twist - step)[0]
        assert_allclose(slope[..., k], difference / 2e-8, rtol=1e-4, atol=1e-3)


# Robot


def test_loads_by_hand() -> None:
    """m = 31 kg, axles 0.275 m apart, track 0.4 m, centre of mass 2 cm ahead, 3 cm to the left, 10 cm high."""
    loads = wang_robot(com_x=0.02, com_y=0.03, com_height=0.1).loads([1.0, -2.0])
    weight, pitch, roll = 31.0 * 9.81, 31.0 * (9.81 * 0.02 - 0.1), 31.0 * (9.81 * 0.03 + 0.2)
    expected = [
        weight / 4 + sx * pitch / 2 / 0.275 + sy * roll / 2 / 0.4 for sx, sy in ((1, 1), (-1, 1), (1, -1), (-1, -1))
    ]
    assert_allclose(loads, expected)


def test_six_wheels_balance_weight_and_moments() -> None:
    loads, (x, y) = SIX.loads([0.7, 1.1]), SIX.places.T
    assert_allclose(SIX.axles, [0.256, 0.0, -0.256])
    assert loads.sum() == pytest.approx(50.0 * 9.81)
    assert loads @ x == pytest.approx(50.0 * (9.81 * 0.04 - SIX.com_height * 0.7))
    assert loads @ y == pytest.approx(50.0 * (-9.81 * 0.03 - SIX.com_height * 1.1))


def test_the_table_of_the_paper() -> None:
    assert_allclose(P3AT.axles, [0.1375, -0.1375])
    assert (P3AT.patch_length, P3AT.patch_width) == (pytest.approx(0.035), 0.05)
    assert (P3AT.mass, P3AT.vehicle.track_width, P3AT.vehicle.wheel_radius) == (31.0, 0.40, 0.11)
    assert_allclose(P3AT.loads([3.0, 3.0]), 31.0 * 9.81 / 4.0)  # p = m g / 2 (L - C) b, whatever happens
    assert_allclose(LAB.numbers(), [0.4437, 0.3093, 0.00054, 0.0371, 1.0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: wang_robot(outer=0.24, inner=0.24), r"^need L > C > 0 \[m\], got L = 0.24, C = 0.24"),
        (lambda: wang_robot(patch_width=0.0), "patch_width must be above 0, got 0.0"),
        (lambda: wang_robot(mass=0.0), "robot pioneer-p3at: mass must be above 0, got 0.0"),
        (lambda: replace(P3AT, mass=0.0), "robot pioneer-p3at: mass must be above 0, got 0.0"),
        (lambda: replace(P3AT, mass=np.inf), "must be finite"),
        (lambda: replace(P3AT, mass=np.nan), "mass must be above 0, got nan"),
        (lambda: replace(P3AT, lag=-0.1), "lag must be at least 0, got -0.1"),
        (lambda: replace(P3AT, patch_length=0.3), "patches of 0.3 m overlap along the robot"),
        (lambda: replace(P3AT, com_x=0.2), "a wheel is off the ground at rest; bring the centre of mass"),
        (lambda: robot(preset("scout-2.0")), "^vehicle scout-2.0 has no mass; give it in a vehicle file$"),
        (lambda: robot(Vehicle("x", 0.5, 0.1, mass=9.0)), "^vehicle x has no wheel_base; give it in a vehicle file$"),
        (lambda: robot(replace(preset("jackal"), wheels=3)), "needs an even number of wheels from 4 on"),
        (lambda: replace(LAB, friction=0.0), "^terrain lab: friction must be above 0, got 0.0$"),
        (lambda: replace(LAB, shear_modulus=-1.0), "^terrain lab: shear_modulus must be above 0, got -1.0$"),
        (lambda: replace(LAB, lateral_shear_modulus=0.0), "lateral_shear_modulus must be above 0, got 0.0"),
        (lambda: replace(LAB, rolling_resistance=-0.1), "^terrain lab: rolling_resistance must be at least 0"),
        (lambda: replace(LAB, friction_opposite=np.nan), "friction_opposite must be above 0, got nan"),
        (lambda: terrain("mud"), "^no terrain 'mud'; there are: lab, tiles, .*ice$"),
        (lambda: Area(LAB, x=(1.0, 1.0)), "^area of lab: x must begin before it ends, got 1.0, 1.0$"),
    ],
)
def test_what_cannot_be_is_refused(make: object, message: str) -> None:
    with pytest.raises(RequestError, match=message):
        make()  # type: ignore[operator]


def test_a_quadrature_needs_nodes() -> None:
    with pytest.raises(ValueError, match="at least one node"):
        Quadrature(0, 3)
    along, across = Quadrature(5, 4).nodes()
    assert_allclose([along[:, 1].sum(), across[:, 1].sum(), across[:, 0] @ across[:, 1]], [1.0, 1.0, 0.0], atol=1e-12)
    assert_allclose(along[:, 0] @ along[:, 1], 0.5)  # the mean of the way


def test_every_terrain_says_where_its_numbers_come_from() -> None:
    assert set(TERRAINS) == {"lab", "tiles", "asphalt", "concrete", "grass", "gravel", "wet-sand", "ice"}
    for name, ground in TERRAINS.items():
        assert ground.name == name
        assert "assumed" in ground.source or "Wang 2015" in ground.source


def test_a_ground_tells_its_areas_in_order() -> None:
    ice = TERRAINS["ice"]
    ground = Ground(LAB, (Area(ice, x=(1.0, 2.0), t=(0.0, 5.0)),))
    assert_allclose(ground.bounds()[1], [0.0, 5.0, 1.0, 2.0, *ALWAYS])
    assert_allclose(ground.numbers(), [LAB.numbers(), ice.numbers()])


def test_assumed_measures_are_those_documented() -> None:
    vehicle = preset("husky-a200")
    made: Robot = robot(vehicle)
    assert_allclose([made.patch_length, made.patch_width, made.com_height], np.array([1 / 3, 1 / 2, 1]) * 0.1651)
    box = (0.512 + 2 * 0.1651) ** 2 + (0.5708 + 0.5 * 0.1651) ** 2
    assert made.yaw_inertia == pytest.approx(50.0 * box / 12.0)
    assert robot(vehicle, com_x=0.05, mass=60.0).loads([0.0, 0.0]).sum() == pytest.approx(60.0 * 9.81)
