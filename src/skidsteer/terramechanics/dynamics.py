"""Planar motion of a robot on its wheels: commanded rim speeds in, motion out, by implicit Euler steps.

The shear stress follows the sliding without delay, as in the steady turn; at low speed that is stiff, hence the
implicit steps. Wheel loads follow the ground's forces of the previous step. The rims follow a first-order lag while the
torque suffices; otherwise they are driven at the torque limit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.kernels import ground as kernels
from skidsteer.rolling import OverturnedError, at_rest
from skidsteer.se2 import FloatArray
from skidsteer.simulate import PLAIN, Motion, Sensors, recorded, refuse_fast
from skidsteer.terramechanics.robot import Robot
from skidsteer.terramechanics.shear import NODES, Quadrature
from skidsteer.terramechanics.terrain import Ground, Terrain

STEP = 0.005  # [s] at most


def move(
    robot: Robot,
    ground: Ground | Terrain,
    commands: Series,
    start: ArrayLike = (0.0,) * 8,
    step: float = STEP,
    quadrature: Quadrature = NODES,
) -> Motion:
    """Drive a robot from its first command to its last.

    Args:
        robot: that moves.
        ground: terrain everywhere, or areas of several.
        commands: (n, 2) [m/s] rim speeds, held from sample to sample; steps end at the samples.
        start: (8,) x, y [m], yaw [rad], v_x, v_y [m/s], omega [rad/s], left and right rim speed [m/s].
        step: [s] at most.
        quadrature: over each patch.

    Raises:
        RequestError: fewer than two commands, one beyond what the vehicle's wheels can do, a wheel that lifts off, a
            start that is not finite, or a step that cannot be solved.
    """
    refuse_fast(robot.vehicle, commands)
    state = np.array(start, dtype=float)
    if state.shape != (8,) or not np.isfinite(state).all():
        raise RequestError(f"a start needs 8 finite numbers: pose, twist, rim speeds; got {state}")
    if not 0.0 < step < np.inf:
        raise RequestError(f"the step must be a positive time in s, got {step}")
    ground = Ground(ground) if isinstance(ground, Terrain) else ground
    t = _clock(commands.t, step)
    poses, states, power = np.empty((len(t), 3)), np.empty((len(t), 5)), np.empty((len(t), 3))
    fixed = _numbers(robot, ground, quadrature)
    ended, at, wheel = kernels.drive(t, commands.hold(t), state, robot.loads(), *fixed, poses, states, power)
    _refuse_end(robot, ended, float(t[at]), wheel)
    return Motion(t, poses, states[:, :3], states[:, 3:], power)


class RollingRobot:
    """The motion of `move`, stepped from outside. See ``Rolling``.

    Args:
        robot: that moves; its lag is that of the wheels.
        ground: terrain everywhere, or areas of several; its times count from the beginning.
        start: (3,) pose, at rest.

    Raises:
        RequestError: a start that is not finite.
    """

    def __init__(self, robot: Robot, ground: Ground | Terrain, start: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        self.robot, self.t = robot, 0.0
        self.state, self.power = at_rest(start), np.zeros(3)
        ground = Ground(ground) if isinstance(ground, Terrain) else ground
        self._fixed, self._loads = _numbers(robot, ground, NODES), robot.loads()
        self._parts, self._length = np.zeros(1), 0.0  # [s] parts that a step of this length is cut into

    def step(self, rims: ArrayLike, dt: float) -> FloatArray:
        """State (8,) dt [s] later, with commanded rim speeds (2,) [m/s]; see ``Rolling``.

        Raises:
            OverturnedError: a wheel lifts off.
            RequestError: a step that cannot be solved.
        """
        if dt <= 0.0:
            return self.state
        if dt != self._length:
            count = max(1, int(np.ceil(dt / STEP * (1.0 - 1e-9))))
            self._parts, self._length = np.linspace(0.0, dt, count + 1), dt
        n = len(self._parts)
        asked, t = np.empty((n, 2)), self.t + self._parts
        asked[:] = rims
        poses, states, power = np.empty((n, 3)), np.empty((n, 5)), np.empty((n, 3))
        ended, at, wheel = kernels.drive(t, asked, self.state, self._loads, *self._fixed, poses, states, power)
        _refuse_end(self.robot, ended, float(t[at]), wheel)
        self.t += dt
        self.state = np.concatenate((poses[-1], states[-1]))
        self.power = power[1:].mean(axis=0)
        return self.state


def terramechanic_drive(
    name: str, robot: Robot, ground: Ground | Terrain, commands: Series, sensors: Sensors = PLAIN, seed: int = 0
) -> Drive:
    """Drive a robot over a ground and record it.

    Args:
        name: of the drive.
        robot: that moves, from rest at the origin.
        ground: terrain everywhere, or areas of several.
        commands: (n, 2) [m/s] rim speeds, held from sample to sample.
        sensors: that record it.
        seed: of the sensors' noise.

    Returns:
        A drive with the encoders' rim speeds, the reference, the gyro if there is one, and the ``wheel_command``.

    Raises:
        RequestError: as `move` does.
    """
    return recorded(name, robot.vehicle, move(robot, ground, commands), sensors, seed, commands)


def _clock(t: FloatArray, step: float) -> FloatArray:
    """Times that hold every t (n,) [s] and are no more than ``step`` [s] apart."""
    if len(t) < 2:
        raise RequestError("a drive needs at least two commands: the last one tells when it ends")
    parts = np.ceil(np.diff(t) / step * (1.0 - 1e-9)).astype(int)
    first = np.cumsum(parts) - parts
    share = (np.arange(parts.sum()) - np.repeat(first, parts)) / np.repeat(parts, parts)
    return np.append(np.repeat(t[:-1], parts) + share * np.repeat(np.diff(t), parts), t[-1])


Numbers = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


def _numbers(robot: Robot, ground: Ground, quadrature: Quadrature) -> Numbers:
    """The constants, in the order of `kernels.ground.drive`."""
    return robot.places, _body(robot), ground.bounds(), ground.numbers(), *quadrature.nodes()


def _body(robot: Robot) -> FloatArray:
    """The numbers of a robot in the order of `kernels.ground.drive`."""
    r = robot.vehicle.wheel_radius
    return np.array(
        [
            robot.mass,
            robot.yaw_inertia,
            robot.com_x,
            robot.com_y,
            robot.com_height,
            robot.wheel_inertia / r**2,
            robot.lag,
            robot.torque_limit / r,
            robot.patch_length,
            robot.patch_width,
        ]
    )


def _refuse_end(robot: Robot, ended: int, t: float, wheel: int) -> None:
    if ended == kernels.LIFTED:
        raise OverturnedError(
            f"{robot.name_of(wheel)} lifts off the ground at {t:.3f} s; drive more gently or lower the centre of mass"
        )
    if ended == kernels.FAILED:
        raise RequestError(f"the forces at {t:.3f} s find no balance; shorten the step or drive more gently")
