"""A robot in the physics engine MuJoCo: rim speeds asked for in, its motion out. A plant whose ground is not our model.

Wheels with Coulomb friction at points under a body in three dimensions; of a terrain it knows the friction alone. A
wheel gets far more rotary inertia than it has: with that of a real one, the engine's contacts turn a robot less than
Coulomb's law does. A speed loop stiff against the ground holds its speed all the same: the lag of the robot is left.

Steady turns on four wheels have the chi of Coulomb's law to 2 % up to a friction of 0.44, to 6 % up to 0.8; with six
wheels, whose loads are not determined, or a centre of mass off the middle, to 12 %.
"""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from skidsteer import se2
from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.rolling import OverturnedError, at_rest
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
    ground = Ground(ground) if isinstance(ground, Terrain) else ground
    t = commands.t[0] + STEP * np.arange(int(np.ceil((commands.t[-1] - commands.t[0]) / STEP)) + 1)
    rolling = RollingEngine(robot, ground, t0=float(commands.t[0]))
    states = np.empty((len(t), 8))
    states[0] = rolling.state
    for i, asked in enumerate(commands.hold(t[:-1]), start=1):
        states[i] = rolling.step(asked, STEP)
    return Motion(t, states[:, :3], states[:, 3:6], states[:, 6:], np.full((len(t), 3), np.nan))


class RollingEngine:
    """A robot in the engine on its way, from rest. See ``Rolling``; it goes on by whole steps of the engine.

    Args:
        robot: that moves; its patches are points here, and its torque has no limit.
        ground: terrain everywhere, or areas of several.
        start: (3,) pose.
        t0: [s] what the clock of the ground's areas tells at the beginning.

    Raises:
        RequestError: the package is missing, or a start that is not finite.
    """

    def __init__(
        self, robot: Robot, ground: Ground | Terrain, start: ArrayLike = (0.0, 0.0, 0.0), t0: float = 0.0
    ) -> None:
        self.state, self.power = at_rest(start), np.full(3, np.nan)
        self._t0, self._t, self._steps = t0, 0.0, 0
        self._ground = Ground(ground) if isinstance(ground, Terrain) else ground
        self._side, self._radius, self._wheels = robot.side, robot.vehicle.wheel_radius, _standing(robot)
        self._keep = math.exp(-STEP / robot.lag) if robot.lag > 0.0 else 0.0
        self._rims = np.zeros(2)  # behind the lag
        self._mujoco = engine()
        self._model = self._mujoco.MjModel.from_xml_string(_scene(robot))
        self._data = self._mujoco.MjData(self._model)
        self._settle()

    def step(self, rims: ArrayLike, dt: float) -> FloatArray:
        """See ``Rolling``."""
        self._t += dt
        asked = np.asarray(rims, dtype=float)
        while self._steps < round(self._t / STEP):
            self._advance(asked)
        self.state = self._told()
        return self.state

    def _settle(self) -> None:
        """Place the robot, let the contacts carry it, and take where it then stands for the start."""
        x, y, yaw = self.state[:3].tolist()
        self._data.qpos[:7] = x, y, 0.0, math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)
        self._model.geom_friction[1:, 0] = self._ground.everywhere.friction
        for _ in range(round(SETTLING / STEP)):
            self._mujoco.mj_step(self._model, self._data)
        self._turned = yaw
        self._moved = se2.compose(self.state[:3], se2.invert(self._pose()))

    def _advance(self, asked: FloatArray) -> None:
        """One step of the engine."""
        if self._ground.areas:
            wheels = se2.compose(self._pose(), self._wheels)
            self._model.geom_friction[1:, 0] = _frictions(self._ground, wheels, self._now)
        self._rims = self._keep * self._rims + (1.0 - self._keep) * asked
        self._data.ctrl[:] = self._rims[self._side] / self._radius
        self._mujoco.mj_step(self._model, self._data)
        self._steps += 1

    @property
    def _now(self) -> float:
        return self._t0 + STEP * self._steps

    def _pose(self) -> FloatArray:
        """Pose (3,) in the engine's world, its yaw unwrapped.

        Raises:
            OverturnedError: the robot has fallen over.
        """
        x, y, _, w, i, j, k = self._data.qpos[:7].tolist()
        if not 1.0 - 2.0 * (i * i + j * j) > TIPPED:  # NaN, too
            raise OverturnedError(
                f"the robot falls over at {self._now:.2f} s; drive more gently or lower the centre of mass"
            )
        yaw = math.atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))
        self._turned += math.remainder(yaw - self._turned, 2.0 * math.pi)
        return np.array([x, y, self._turned])

    def _told(self) -> FloatArray:
        """State (8,)."""
        pose, velocity = self._pose(), self._data.qvel
        along = se2.rotate(-pose[2], velocity[:2])
        wheels = velocity[6:] * self._radius
        speeds = [wheels[self._side == side].mean() for side in (0, 1)]
        return np.array([*se2.compose(self._moved, pose), *along, velocity[5], *speeds])


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
