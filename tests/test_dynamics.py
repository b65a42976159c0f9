import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.identify.calibrate import CalibrateOptions, calibrate
from skidsteer.kernels import ground as kernels
from skidsteer.models import Differential, Icr
from skidsteer.se2 import FloatArray, between, compose, rotate
from skidsteer.simulate import Motion, Sensors, kinematic_drive, recorded, rims_from_manoeuvres
from skidsteer.terramechanics import dynamics
from skidsteer.terramechanics.dynamics import move, terramechanic_drive
from skidsteer.terramechanics.robot import Robot, robot, wang_robot
from skidsteer.terramechanics.shear import friction, rolling_forces, unit_forces
from skidsteer.terramechanics.steady_turn import steady_turn
from skidsteer.terramechanics.terrain import TERRAINS, Area, Ground, Terrain
from skidsteer.vehicle import preset
from skidsteer.windows import Mount

LAB, ICE = TERRAINS["lab"], TERRAINS["ice"]
P3AT = robot(preset("pioneer-p3at"), com_x=0.03, com_y=-0.01)
ROWS = np.array([[1.5, 0.4, 0.0], [1.5, 0.3, 0.7], [1.5, 0.0, -0.9], [1.0, -0.4, 0.0], [1.0, 0.0, 0.0]])
COMMANDS = rims_from_manoeuvres(ROWS, Differential(0.4), rate=50.0)
TWISTS = slice(3, 6)


def held(left: float, right: float, duration: float = 3.0) -> Series:
    return Series(np.array([0.0, duration]), np.array([[left, right]] * 2))


# Against the steady turn, and against another integrator


@pytest.mark.parametrize("terrain", ["lab", "grass", "wet-sand"])
@pytest.mark.parametrize("rims", [(0.2, 0.5), (-0.3, 0.4), (0.6, 0.55), (-0.2, -0.1)])
def test_held_rims_end_in_the_steady_turn(terrain: str, rims: tuple[float, float]) -> None:
    motion = move(P3AT, TERRAINS[terrain], held(*rims))
    assert_allclose(motion.twist[-1], steady_turn(P3AT, TERRAINS[terrain], *rims).twist, atol=2e-6)
    assert_allclose(motion.rims[-1], rims)


def test_six_wheels_end_in_the_steady_turn() -> None:
    made = robot(replace(preset("husky-a200"), wheels=6), com_x=-0.05)
    motion = move(made, LAB, held(0.3, 0.8))
    assert_allclose(motion.twist[-1], steady_turn(made, LAB, 0.3, 0.8).twist, atol=2e-6)


def reference_solution(made: Robot, terrain: Terrain, commands: Series, end: float) -> FloatArray:
    """Pose, twist of the centre of mass, rims (8,) at the end: SciPy's Radau between the commands."""
    x, y = made.com_x, made.com_y

    def slope(_: float, z: FloatArray, command: FloatArray) -> FloatArray:
        twist = np.array([z[3] + z[5] * y, z[4] - z[5] * x, z[5]])  # of the origin
        rims = np.clip(z[6:], -1.0, 1.0)
        loads = made.loads([0.0, 0.0])
        unit = unit_forces(made, terrain, twist, rims)[..., 0] * friction(terrain, rims)
        force = loads @ (unit + rolling_forces(made, terrain, twist, np.ones(4))[0])
        moment = force[2] - x * force[1] + y * force[0]
        v_x = force[0] / made.mass + z[5] * z[4]
        v_y = force[1] / made.mass - z[5] * z[3]
        return np.array(
            [*rotate(z[2], twist[:2]), z[5], v_x, v_y, moment / made.yaw_inertia, *((command - rims) / 0.1)]
        )

    z = np.zeros(8)
    for a, b in zip(commands.t, commands.t[1:], strict=False):
        if a < end:
            done = solve_ivp(slope, (a, b), z, "Radau", rtol=1e-7, atol=1e-9, args=(commands.hold(a),))
            z = done.y[:, -1]
    return np.asarray(z)


def test_the_motion_is_that_of_another_integrator() -> None:
    """Every parameter differs from zero but the height of the centre of mass: loads here follow a step later."""
    made = replace(P3AT, com_height=0.0)
    commands = Series(np.array([0.0, 0.6, 1.3, 1.8]), np.array([[0.3, 0.5], [-0.1, 0.4], [0.2, -0.3], [0.0, 0.0]]))
    expected = reference_solution(made, LAB, commands, 1.8)
    errors = []
    for step in (0.02, 0.005):
        motion = move(made, LAB, commands, step=step)
        errors.append(np.abs(motion.pose[-1] - expected[:3]).max())
        assert_allclose(motion.rims[-1], expected[6:], atol=1e-6)
    assert np.abs(expected[:3]).min() > 0.01
    assert errors[1] < 5e-4
    assert errors[1] < 0.5 * errors[0]  # and less the finer the steps


# By hand


def test_locked_wheels_stop_where_friction_says() -> None:
    start = [0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0]
    stiff = Terrain("stiff", 0.4, 0.4, 1e-6)
    motion = move(replace(wang_robot(), lag=0.0), stiff, held(0.0, 0.0, 0.5), start, step=0.0005)
    assert motion.pose[-1, 0] == pytest.approx(0.5**2 / (2.0 * 0.4 * 9.81), rel=2e-3)
    assert_allclose(motion.twist[-1], 0.0, atol=1e-6)
    assert_allclose(motion.pose[-1, 1:], 0.0, atol=1e-9)


def test_braking_moves_load_to_the_front() -> None:
    """By hand: with mu_f in front, mu_r behind, m a = mu_f (m g / 2 + m a h / L) + mu_r (m g / 2 - m a h / L)."""
    front, rear = Terrain("front", 0.1, 0.1, 1e-6), Terrain("rear", 0.5, 0.5, 1e-6)
    ground = Ground(rear, (Area(front, x=(0.0, np.inf)),))
    made = replace(wang_robot(com_height=0.15), lag=0.0)
    motion = move(made, ground, held(0.0, 0.0, 0.05), [0.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0], step=0.001)
    expected = 9.81 * 0.3 / (1.0 + 0.4 * 0.15 / 0.275)
    assert np.polyfit(motion.t, motion.twist[:, 0], 1)[0] == pytest.approx(-expected, rel=5e-3)


def test_rims_follow_their_lag_exactly() -> None:
    motion = move(replace(P3AT, lag=0.2), LAB, held(0.3, 0.4, 1.0), step=0.01)
    expected = np.outer(1.0 - np.exp(-motion.t / 0.2), [0.3, 0.4])
    assert_allclose(motion.rims, expected, atol=1e-9)
    assert_allclose(
        move(replace(P3AT, lag=0.0, torque_limit=np.inf), LAB, held(0.3, 0.4, 1.0)).rims[1:], [[0.3, 0.4]] * 200
    )


def test_torque_limits_the_acceleration() -> None:
    """By hand: both sides pull with torque / radius against rolling resistance, and speed up mass and rims."""
    made = replace(wang_robot(), torque_limit=2.2, wheel_inertia=0.05, lag=0.05)
    motion = move(made, LAB, held(0.6, 0.6, 1.0))
    acceleration = (2.0 * 2.2 / 0.11 - 31.0 * 9.81 * 0.0371) / (31.0 + 2.0 * 0.05 / 0.11**2)
    late = (motion.t > 0.2) & (motion.t < 0.5)
    slope = np.polyfit(motion.t[late], motion.rims[late], 1)[0]
    assert_allclose(slope, acceleration, rtol=0.01)
    assert np.abs(motion.power[:, 0]).max() <= 2.0 * 2.2 / 0.11 * 0.6
    strong = move(replace(made, torque_limit=np.inf), LAB, held(0.6, 0.6, 1.0))
    assert strong.rims[40, 0] > 2.0 * motion.rims[40, 0]


def test_too_little_torque_to_turn_on_the_spot() -> None:
    weak = move(replace(P3AT, torque_limit=1.0), LAB, held(-0.3, 0.3))
    assert_allclose(weak.twist[-1], 0.0, atol=0.01)
    assert np.abs(weak.rims[-1]).max() < 0.05


# Laws


def energy(made: Robot, motion: Motion) -> FloatArray:
    v_x, v_y, omega = motion.twist.T
    v_x, v_y = v_x - omega * made.com_y, v_y + omega * made.com_x
    return np.asarray(0.5 * made.mass * (v_x**2 + v_y**2) + 0.5 * made.yaw_inertia * omega**2)


def test_friction_only_takes_energy_and_all_of_it_is_accounted_for() -> None:
    motion = move(P3AT, LAB, COMMANDS, step=0.001)
    assert motion.power[:, 1:].min() >= -1e-9
    dt = np.diff(motion.t)
    put_in, lost = np.cumsum(motion.power[1:, 0] * dt), np.cumsum(motion.power[1:, 1:].sum(axis=1) * dt)
    kinetic = energy(P3AT, motion)[1:]
    assert kinetic.max() > 1.5
    assert np.abs(put_in - lost - kinetic).max() < 0.02 * kinetic.max()


def test_without_drive_the_energy_falls() -> None:
    start = [0.0, 0.0, 0.0, 0.5, -0.3, 2.0, 0.2, -0.1]
    for terrain in (LAB, ICE):
        motion = move(replace(P3AT, lag=0.0), terrain, held(0.0, 0.0, 5.0), start)
        assert (np.diff(energy(P3AT, motion)) <= 1e-12).all()
        assert np.abs(motion.twist[-1]).max() < 1e-4


def test_at_rest_nothing_moves() -> None:
    motion = move(P3AT, LAB, held(0.0, 0.0, 20.0))
    assert_allclose(motion.pose, 0.0, atol=1e-12)


def test_the_mirror_image_drives_mirrored() -> None:
    mirrored = Series(COMMANDS.t, COMMANDS.values[:, ::-1])
    one, other = move(P3AT, LAB, COMMANDS), move(replace(P3AT, com_y=0.01), LAB, mirrored)
    assert_allclose(other.pose, one.pose * [1.0, -1.0, -1.0], atol=1e-5)


def test_where_a_drive_begins_does_not_matter() -> None:
    origin = np.array([3.0, -2.0, 1.2])
    there = move(P3AT, LAB, COMMANDS, [*origin, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert_allclose(there.pose, compose(origin, move(P3AT, LAB, COMMANDS).pose), atol=1e-7)


def test_steps_end_at_the_commands() -> None:
    t = np.array([0.0, 0.0123, 0.02, 0.05])
    motion = move(P3AT, LAB, Series(t, np.full((4, 2), 0.1)), step=0.005)
    assert set(t) <= set(motion.t)
    assert np.diff(motion.t).max() <= 0.005 + 1e-12
    assert np.diff(motion.t).min() > 0.002
    assert len(move(P3AT, LAB, Series(np.arange(11) / 100.0, np.zeros((11, 2))), step=0.005).t) == 21


# Ground that changes


def test_ice_under_one_side_turns_a_braking_robot() -> None:
    start = [0.0, 0.0, 0.0, 0.6, 0.0, 0.0, 0.0, 0.0]
    ground = Ground(LAB, (Area(ICE, y=(0.0, np.inf)),))
    made = replace(wang_robot(), lag=0.0)
    assert move(made, ground, held(0.0, 0.0, 1.0), start).pose[-1, 2] < -0.02  # the right side holds
    assert_allclose(move(made, LAB, held(0.0, 0.0, 1.0), start).pose[-1, 2], 0.0, atol=1e-9)


def test_ground_changes_with_time_and_place() -> None:
    spin = held(-0.3, 0.3, 8.0)
    later = move(P3AT, Ground(LAB, (Area(ICE, t=(2.0, np.inf)),)), spin)
    assert_allclose(later.pose[later.t <= 2.0], move(P3AT, LAB, spin).pose[later.t <= 2.0])
    assert_allclose(later.twist[-1], steady_turn(P3AT, ICE, -0.3, 0.3).twist, atol=2e-5)
    assert abs(later.twist[-1, 2] - move(P3AT, LAB, spin).twist[-1, 2]) > 1e-3
    away = move(P3AT, Ground(LAB, (Area(ICE, x=(5.0, 6.0)),)), spin)
    assert_array_equal(away.pose, move(P3AT, LAB, spin).pose)
    start = [5.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    there = move(P3AT, Ground(LAB, (Area(ICE, x=(5.0, 6.0)),)), spin, start)
    assert_allclose(there.twist[-1], steady_turn(P3AT, ICE, -0.3, 0.3).twist, atol=2e-5)


def test_the_last_area_counts() -> None:
    both = Ground(LAB, (Area(ICE), Area(LAB)))
    assert_array_equal(move(P3AT, both, COMMANDS).pose, move(P3AT, LAB, COMMANDS).pose)


# Bad requests


@pytest.mark.parametrize(
    ("made", "commands", "start", "message"),
    [
        (P3AT, held(0.1, -0.7), None, r"^the right wheels are asked for -0.700 m/s at 0.00 s, but .* reaches 0.69 m/s"),
        (P3AT, Series(np.array([0.0]), np.zeros((1, 2))), None, "at least two commands"),
        (P3AT, Series(np.array([0.0, 1.0]), np.zeros((2, 3))), None, "two columns, left and right rim speed, got 3"),
        (P3AT, held(0.1, 0.1), [np.nan] + [0.0] * 7, "^a start needs 8 finite numbers"),
        (P3AT, held(0.1, 0.1), [0.0] * 5, "^a start needs 8 finite numbers"),
        (
            replace(P3AT, com_height=1.0, torque_limit=np.inf, lag=0.01),
            held(0.6, 0.6),
            None,
            r"^(left|right) wheel 1 lifts off the ground at 0\.\d+ s; drive more gently or lower the centre of mass$",
        ),
    ],
)
def test_what_cannot_be_driven_is_refused(
    made: Robot, commands: Series, start: list[float] | None, message: str
) -> None:
    with pytest.raises(RequestError, match=message):
        move(made, TERRAINS["concrete"], commands, start or [0.0] * 8)


def test_a_step_must_be_positive() -> None:
    with pytest.raises(RequestError, match="the step must be a positive time in s, got 0"):
        move(P3AT, LAB, COMMANDS, step=0.0)


def test_a_step_without_solution_is_an_error_and_not_nan() -> None:
    with pytest.raises(RequestError, match=r"^the forces at 0.000 s find no balance; shorten the step"):
        move(P3AT, LAB, held(0.1, 0.1), [0.0, 0.0, 0.0, 1e200, 0.0, 1e200, 0.0, 0.0])


@pytest.mark.parametrize("terrain", list(TERRAINS))
def test_wild_commands_end_finite(terrain: str) -> None:
    rng = np.random.default_rng(5)
    commands = Series(np.cumsum(rng.uniform(0.01, 0.4, 40)), rng.uniform(-0.69, 0.69, (40, 2)))
    motion = move(P3AT, TERRAINS[terrain], commands)
    assert all(np.isfinite(part).all() for part in (motion.pose, motion.twist, motion.rims, motion.power))
    assert np.abs(motion.twist[:, :2]).max() < 1.0


# Speed


def test_two_hundred_times_as_fast_as_life() -> None:
    commands = Series(np.tile(COMMANDS.t[:300], 1), COMMANDS.values[:300])
    move(P3AT, LAB, commands)
    ratios = []
    for _ in range(3):
        start = time.process_time()
        move(P3AT, LAB, commands)
        ratios.append(np.ptp(commands.t) / (time.process_time() - start))
    assert max(ratios) > 200.0


# What is recorded


QUIET = Sensors(position_sigma=0.0, yaw_sigma=0.0)


def pose_of(drive: Drive) -> Series:
    assert drive.pose is not None
    return drive.pose


def test_a_quiet_record_is_the_motion() -> None:
    motion = move(P3AT, LAB, COMMANDS)
    drive = terramechanic_drive("d", P3AT, LAB, COMMANDS, QUIET)
    pose = pose_of(drive)
    assert_allclose(pose.values, motion.pose_at(pose.t), atol=1e-12)
    assert_allclose(np.diff(pose.t), 0.2)
    rolled = (drive.wheels.values * np.diff(motion.t)[:, None]).sum(axis=0)
    assert_allclose(rolled, np.trapezoid(motion.rims, motion.t, axis=0), atol=1e-12)
    assert drive.wheel_command is COMMANDS
    assert drive.vehicle is P3AT.vehicle
    assert drive.gyro is None


def test_encoders_count_at_their_own_rate() -> None:
    drive = terramechanic_drive("d", P3AT, LAB, COMMANDS, replace(QUIET, encoder_step=0.002, encoder_rate=20.0))
    true = move(P3AT, LAB, COMMANDS)
    assert_allclose(np.diff(drive.wheels.t), 0.05)
    counts = drive.wheels.values * 0.05 / 0.002
    assert_allclose(counts, np.round(counts), atol=1e-6)
    rolled = np.cumsum(drive.wheels.values, axis=0)[-1] * 0.05
    end = np.searchsorted(true.t, drive.wheels.t[-1] + 0.05)
    assert_allclose(rolled, np.trapezoid(true.rims[: end + 1], true.t[: end + 1], axis=0), atol=0.0035)


def test_a_sensor_off_the_centre_tells_its_own_poses() -> None:
    mount = Mount(0.3, -0.1, 0.5)
    drive, centred = (terramechanic_drive("d", P3AT, LAB, COMMANDS, s) for s in (replace(QUIET, mount=mount), QUIET))
    assert_allclose(pose_of(drive).values, compose(pose_of(centred).values, [0.3, -0.1, 0.5]))


def test_references_get_lost_as_often_as_stated() -> None:
    sensors = Sensors(reference_rate=20.0, lost_share=0.3, lost_duration=0.4)
    full = pose_of(kinematic_drive("d", P3AT.vehicle, Differential(0.4), COMMANDS, replace(sensors, lost_share=0.0)))
    kept = [
        pose_of(kinematic_drive("d", P3AT.vehicle, Differential(0.4), COMMANDS, sensors, seed=s)) for s in range(60)
    ]
    assert np.mean([len(k) / len(full) for k in kept]) == pytest.approx(0.7, abs=0.04)
    assert all(set(k.t) <= set(full.t) and {full.t[0], full.t[-1]} <= set(k.t) for k in kept)
    assert np.median([np.diff(k.t).max() for k in kept]) > 0.5  # they are missing in stretches
    with pytest.raises(RequestError, match="lost_share below 1"):
        kinematic_drive("d", P3AT.vehicle, Differential(0.4), COMMANDS, replace(sensors, lost_share=1.0))


def test_the_gyro_tells_the_yaw_rate_with_its_bias_and_noise() -> None:
    motion = move(P3AT, LAB, COMMANDS)
    gyro = recorded("d", P3AT.vehicle, motion, replace(QUIET, gyro_rate=100.0, gyro_sigma=0.01, gyro_bias=0.03)).gyro
    assert gyro is not None
    error = gyro.values[:, 0] - np.interp(gyro.t, motion.t, motion.twist[:, 2])
    assert error.mean() == pytest.approx(0.03, abs=0.002)
    assert error.std() == pytest.approx(0.01, rel=0.15)
    assert_allclose(np.diff(gyro.t), 0.01)


def test_the_gyro_of_a_kinematic_plant_turns_as_its_reference() -> None:
    sensors = replace(QUIET, gyro_rate=100.0, gyro_sigma=0.0)
    drive = kinematic_drive("d", P3AT.vehicle, Differential(0.4), COMMANDS, sensors, 0.1, (0.0, 0.1), seed=3)
    assert drive.gyro is not None
    pose = pose_of(drive)
    turned = np.concatenate([[0.0], np.cumsum(drive.gyro.values[:, 0]) / 100.0])  # at the ends of the periods
    t = np.append(drive.gyro.t - 0.005, drive.gyro.t[-1] + 0.005)
    gyro, reference = np.diff(np.interp(pose.t, t, turned)), between(pose.values[:-1], pose.values[1:])[:, 2]
    assert_allclose(gyro, reference, atol=2e-4)
    assert np.abs(reference).max() > 0.1


def test_calibration_finds_the_icrs_of_the_plant() -> None:
    """At low speed, those nearest to true twists and rim speeds. How many within 2 sigma, docs/ground.md tells."""
    turns = [[4.0, v, w] for v in (0.2, 0.3) for w in (0.3, -0.3, 0.5, -0.5)]
    rows = np.array([[1.0, 0.0, 0.0], *turns, [4.0, 0.3, 0.0], [3.0, -0.2, 0.0], [3.0, 0.0, 0.6], [1.0, 0.0, 0.0]])
    motion = move(P3AT, LAB, rims_from_manoeuvres(rows, Differential(0.6)))
    drive = recorded("d", P3AT.vehicle, motion, Sensors(10.0, 0.005, 0.003, encoder_rate=50.0, gyro_rate=50.0), seed=4)
    found = calibrate(drive, options=CalibrateOptions(model="icr")).parameters
    weights = np.array([200.0, 200.0, 3000.0])
    nominal = Icr.nominal(P3AT.vehicle)
    true = least_squares(
        lambda theta: ((nominal.with_theta(theta).twist(*motion.rims.T) - motion.twist) * weights).ravel(),
        nominal.theta,
    ).x
    for parameter, value in zip(Icr.PARAMETERS, true, strict=True):
        estimate = found[parameter.name]
        assert abs(estimate.value - value) < 3.0 * estimate.sigma
        assert estimate.sigma < 0.02
    assert true[2] > 0.03  # ahead by more than the centre of mass


def test_a_drive_too_short_for_a_reference() -> None:
    with pytest.raises(RequestError, match=r"^0.\d+ s are too short for two references; drive longer$"):
        terramechanic_drive("d", P3AT, LAB, held(0.1, 0.1, 0.2))


def test_the_seed_decides_the_noise_and_not_the_motion() -> None:
    one, same, other = (terramechanic_drive("d", P3AT, LAB, COMMANDS, seed=s) for s in (1, 1, 2))
    assert_array_equal(pose_of(one).values, pose_of(same).values)
    assert np.abs(pose_of(one).values - pose_of(other).values).max() > 0.005
    assert_array_equal(one.wheels.values, other.wheels.values)


def test_the_numbers_of_a_robot_reach_the_kernel_in_order() -> None:
    body = dynamics._body(replace(P3AT, torque_limit=3.3, wheel_inertia=0.0242))
    assert_allclose(body[[0, 2, 3, 4, 5, 6, 7]], [23.6, 0.03, -0.01, 0.11, 2.0, 0.1, 30.0])
    assert_allclose(body[[1, 8, 9]], [P3AT.yaw_inertia, P3AT.patch_length, P3AT.patch_width])
    assert kernels.GRAVITY == 9.81
