"""A robot in the physics engine MuJoCo: rim speeds asked for in, its motion out. A plant whose ground is not our model.

Wheels with Coulomb friction at points under a body in three dimensions; of a terrain it knows the friction alone. A
wheel gets far more rotary inertia than it has: with that of a real one, the engine's contacts turn a robot less than
Coulomb's law does. A speed loop stiff against the ground holds its speed all the same: the lag of the robot is left.

Steady turns on four wheels have the chi of Coulomb's law to 2 % up to a friction of 0.44, to 6 % up to 0.8; with six
wheels, whose loads are not determined, or a centre of mass off the middle, to 12 %.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from skidsteer import se2
from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.se2 import FloatArray
from skidsteer.simulate import Motion, refuse_fast
from skidsteer.terramechanics.robot import Robot
from skidsteer.terramechanics.terrain import Ground, Terrain

STEP = 0.002  # [s]
SETTLING = 0.5  # [s] until the contacts carry the robot, before the drive begins
HEAVINESS = 3.0  # rotary inertia of a wheel, over the robot's mass times the square of its radius
STIFFNESS = (
    300.0  # [1/s] of its speed loop, over that inertia; the stiffer, the more the contacts run ahead of the rims
)
TIPPED = 0.5  # cosine of the tilt from which the robot has fallen over


def engine() -> ModuleType:
    """The package.

    Raises:
        RequestError: it is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise RequestError("the plant mujoco needs the package: pip install 'skidsteer[mujoco]'") from error
    return mujoco  # type: ignore[no-any-return]


def roll(robot: Robot, ground: Ground | Terrain, commands: Series) -> Motion:
    """Drive a robot from its first command to its last, from rest.

    Args:
        robot: that moves; its patches are points here, and its torque has no limit.
        ground: terrain everywhere, or areas of several.
        commands: (n, 2) [m/s] rim speeds asked for, held from sample to sample.

    Returns:
        The motion every ``STEP``; its power is not told.

    Raises:
        RequestError: fewer than two commands, one beyond what the vehicle's wheels can do, the package is missing, or
            the robot falls over.
    """
    refuse_fast(robot.vehicle, commands)
    if len(commands.t) < 2:
        raise RequestError("a drive needs at least two commands: the last one tells when it ends")
    mujoco = engine()
    ground = Ground(ground) if isinstance(ground, Terrain) else ground
    model = mujoco.MjModel.from_xml_string(_scene(robot))
    data = mujoco.MjData(model)
    t = commands.t[0] + STEP * np.arange(int(np.ceil((commands.t[-1] - commands.t[0]) / STEP)) + 1)
    return _driven(mujoco, model, data, robot, ground, t, _lagged(commands.hold(t), robot.lag))


def _lagged(asked: FloatArray, lag: float) -> FloatArray:
    """Rim speeds (n, 2) that follow those asked for, from rest, through a first-order lag [s]."""
    from scipy.signal import lfilter

    keep = np.exp(-STEP / lag) if lag > 0.0 else 0.0
    return np.asarray(lfilter([0.0, 1.0 - keep], [1.0, -keep], asked, axis=0))


def _driven(
    mujoco: ModuleType, model: Any, data: Any, robot: Robot, ground: Ground, t: FloatArray, rims: FloatArray
) -> Motion:
    radius, side = robot.vehicle.wheel_radius, robot.side
    states, turning = np.empty((len(t), 6)), np.empty((len(t), len(side)))  # pose and velocity in the world; wheels
    model.geom_friction[1:, 0] = ground.everywhere.friction
    for _ in range(round(SETTLING / STEP)):
        mujoco.mj_step(model, data)
    targets = np.append(rims[1:], rims[-1:], axis=0)[:, side] / radius
    for i, now in enumerate(t.tolist()):
        states[i], turning[i] = _state(data, now), data.qvel[6:]
        if ground.areas:
            model.geom_friction[1:, 0] = _frictions(ground, se2.compose(states[i, :3], _standing(robot)), now)
        data.ctrl[:] = targets[i]
        mujoco.mj_step(model, data)
    states[:, 2] = np.unwrap(states[:, 2])
    pose = se2.compose(se2.invert(states[0, :3]), states[:, :3])
    twist = np.column_stack([se2.rotate(-states[:, 2], states[:, 3:5]), states[:, 5]])
    speed = radius * np.stack([turning[:, side == s].mean(axis=1) for s in (0, 1)], axis=-1)
    return Motion(t, pose, twist, speed, np.full((len(t), 3), np.nan))


def _state(data: Any, now: float) -> tuple[float, ...]:
    """Pose x, y, yaw and its rates in the world."""
    x, y, _, w, i, j, k = data.qpos[:7].tolist()
    if not 1.0 - 2.0 * (i * i + j * j) > TIPPED:  # NaN, too
        raise RequestError(f"the robot falls over at {now:.2f} s; drive more gently or lower the centre of mass")
    yaw = np.arctan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))
    return (x, y, yaw, *data.qvel[:2].tolist(), float(data.qvel[5]))


def _standing(robot: Robot) -> FloatArray:
    """Poses (w, 3) of the wheels in the robot."""
    return np.column_stack([robot.places, np.zeros(len(robot.places))])


def _frictions(ground: Ground, wheels: FloatArray, now: float) -> FloatArray:
    """Friction (w,) under wheels at poses (w, 3)."""
    bounds = ground.bounds()
    where = np.column_stack([np.full(len(wheels), now), wheels[:, :2]])[:, None]
    inside = np.all((where >= bounds[:, ::2]) & (where < bounds[:, 1::2]), axis=2)
    last = len(bounds) - 1 - np.argmax(inside[:, ::-1], axis=1)
    return np.asarray(ground.numbers()[last, 0])


def _scene(robot: Robot) -> str:
    """The robot on a plane in the engine's language: geom 0 is the plane, those after it the wheels."""
    r = robot.vehicle.wheel_radius
    inertia = HEAVINESS * robot.mass * r**2
    turn = robot.yaw_inertia  # rolling and pitching have the same
    names = [f"wheel{i}" for i in range(len(robot.places))]
    wheels = "".join(
        f'<body pos="{x} {y} {r}"><joint name="{name}" type="hinge" axis="0 1 0" armature="{inertia}"/>'
        f'<geom type="ellipsoid" size="{r} {0.5 * robot.patch_width} {r}" mass="1e-4" friction="0 0 0"/></body>'
        for name, (x, y) in zip(names, robot.places.tolist(), strict=True)
    )
    motors = "".join(f'<velocity joint="{name}" kv="{STIFFNESS * inertia}"/>' for name in names)
    return f"""<mujoco>
<option timestep="{STEP}" integrator="implicitfast" cone="elliptic" impratio="10" gravity="0 0 -9.81"/>
<default><geom condim="3" solref="0.02 1"/></default>
<worldbody>
<geom type="plane" size="0 0 1" friction="0 0 0"/>
<body><freejoint/>
<inertial pos="{robot.com_x} {robot.com_y} {robot.com_height}" mass="{robot.mass}" diaginertia="{turn} {turn} {turn}"/>
{wheels}</body>
</worldbody>
<actuator>{motors}</actuator>
</mujoco>"""
