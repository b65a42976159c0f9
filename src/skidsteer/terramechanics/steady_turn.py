"""Steady motion at constant rim speeds, where the forces are in balance: Wang 2015, Eqs. (16), (22)-(24)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import RequestError
from skidsteer.kernels.ground import GRAVITY
from skidsteer.se2 import FloatArray
from skidsteer.terramechanics.robot import Robot
from skidsteer.terramechanics.shear import NODES, Quadrature, friction, rolling_forces, unit_forces
from skidsteer.terramechanics.terrain import Terrain

ITERATIONS = 200
FIRST_STEP = 0.1  # [s]
SHORTEST_STEP = 1e-4  # [s] taken even where the residual grows: the motion in time leads past that
TOLERANCE = 1e-10  # of forces, relative to the weight


@dataclass(frozen=True, slots=True, eq=False)
class SteadyTurn:
    """Motion in balance at each pair of rim speeds; leading axes are operating points."""

    twist: FloatArray  # (..., 3) of the origin [m/s, m/s, rad/s]
    rims: FloatArray  # (..., 2) [m/s]
    loads: FloatArray  # (..., w) [N]
    track_width: float  # [m]

    @property
    def path_curvature(self) -> FloatArray:
        """Wang's lambda (...), Eq. (13); not finite on a straight."""
        return _ratio(self.rims.sum(axis=-1), self.rims[..., 1] - self.rims[..., 0])

    @property
    def icr_y(self) -> FloatArray:
        """Tread ICRs (..., 2) [m], left and right, Eqs. (5), (6); not finite on a straight, where there are none."""
        return _ratio(self.twist[..., :1] - self.rims, self.twist[..., 2:])

    @property
    def icr_x(self) -> FloatArray:
        """ICR (...) [m] ahead of the origin, Eq. (7); not finite on a straight."""
        return _ratio(-self.twist[..., 1], self.twist[..., 2])

    @property
    def icr_coefficient(self) -> FloatArray:
        """Wang's chi (...), Eq. (15); not finite on a straight."""
        icr_y = self.icr_y
        return np.asarray((icr_y[..., 0] - icr_y[..., 1]) / self.track_width)


def _ratio(a: FloatArray, b: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(a / b)


def rims_on_path(path_curvature: ArrayLike, speed: ArrayLike) -> FloatArray:
    """Rim speeds (..., 2) [m/s] of a lambda (...), Eq. (13), in a left turn where it is positive.

    Args:
        path_curvature: lambda; infinite: straight on.
        speed: [m/s] mean of both rims, or half their difference where that is more (|lambda| < 1).
    """
    ratio, speed = np.asarray(path_curvature, dtype=float), np.asarray(speed, dtype=float)
    total, apart = speed * np.clip(ratio, -1.0, 1.0), speed / np.maximum(np.abs(ratio), 1.0)
    return np.stack([total - apart, total + apart], axis=-1)


def steady_turn(
    robot: Robot, terrain: Terrain, v_left: ArrayLike, v_right: ArrayLike, quadrature: Quadrature = NODES
) -> SteadyTurn:
    """Find the twist at which the ground's forces balance the centrifugal force, Eq. (16).

    Where the paper searches for the chi and lambda of least residual force, Eq. (23), pseudo-transient Newton steps
    find the twist without any residual. The loads follow the acceleration.

    Args:
        robot: that turns.
        terrain: under all wheels.
        v_left: (...) [m/s] left rim speed.
        v_right: (...) [m/s] right rim speed.
        quadrature: over each patch.

    Raises:
        RequestError: speeds that are not finite, no balance found, or a wheel that lifts off.
    """
    rims = np.stack(np.broadcast_arrays(np.asarray(v_left, dtype=float), np.asarray(v_right, dtype=float)), axis=-1)
    flat = rims.reshape(-1, 2)
    if not np.isfinite(flat).all():
        raise RequestError("rim speeds must be finite")
    twist = _start(robot, flat)
    balance = _balance(robot, terrain, twist, flat, quadrature)
    step = np.full(len(flat), FIRST_STEP)
    for _ in range(ITERATIONS):
        if (balance.size <= TOLERANCE).all():
            break
        tried = twist - np.linalg.solve(balance.slope + _inertia(robot) / step[:, None, None], balance.residual)[..., 0]
        after = _balance(robot, terrain, tried, flat, quadrature)
        better = (after.size < balance.size) | (step <= SHORTEST_STEP)
        change = np.where(better, balance.size / np.maximum(after.size, TOLERANCE), 0.1)
        step = np.maximum(step * np.clip(change, 0.1, 100.0), SHORTEST_STEP)
        twist = np.where(better[:, None], tried, twist)
        balance = balance.where(better, after)
    _refuse_unbalanced(robot, flat, balance)
    shape = rims.shape[:-1]
    loads = balance.loads.reshape(*shape, -1)
    return SteadyTurn(twist.reshape(*shape, 3), rims, loads, robot.vehicle.track_width)


@dataclass(frozen=True, slots=True, eq=False)
class _Balance:
    """Residual forces at some twists, for each operating point."""

    residual: FloatArray  # (n, 3, 1) [N, N, N m]
    slope: FloatArray  # (n, 3, 3) its derivative with respect to the twist
    loads: FloatArray  # (n, w) [N]
    size: FloatArray  # (n,) norm of the residual, relative to the weight

    def where(self, better: np.ndarray, other: _Balance) -> _Balance:
        """This balance, with the other one's points where those are better."""
        return _Balance(
            np.where(better[:, None, None], other.residual, self.residual),
            np.where(better[:, None, None], other.slope, self.slope),
            np.where(better[:, None], other.loads, self.loads),
            np.where(better, other.size, self.size),
        )


def _start(robot: Robot, rims: FloatArray) -> FloatArray:
    """Twist (n, 3) of point contacts with Coulomb friction: chi = 1 + (L / B)^2."""
    width = robot.vehicle.track_width * (1.0 + ((robot.axles[0] - robot.axles[-1]) / robot.vehicle.track_width) ** 2)
    omega = (rims[:, 1] - rims[:, 0]) / width
    return np.column_stack([rims.mean(axis=1), -omega * robot.com_x, omega])


def _balance(robot: Robot, terrain: Terrain, twist: FloatArray, rims: FloatArray, quadrature: Quadrature) -> _Balance:
    acceleration, by_twist = _centripetal(robot, twist)
    loads, per_load = robot.loads(acceleration), robot.load_slopes() @ by_twist  # (n, w), (n, w, 3)
    unit = unit_forces(robot, terrain, twist, rims, quadrature)[..., :4]
    unit = unit * friction(terrain, rims)[:, None, None, None]
    rolling, rolling_slope = rolling_forces(robot, terrain, twist, np.ones_like(loads))
    force, slope = unit[..., 0] + rolling, unit[..., 1:] + rolling_slope  # for each newton of load
    m, origin = robot.mass, np.array([-robot.com_y, robot.com_x])
    inert = m * np.column_stack([acceleration, acceleration @ origin])  # moment about the origin
    inert_slope = m * np.concatenate([by_twist, (origin @ by_twist)[:, None]], axis=1)
    residual = inert - np.einsum("nw,nwi->ni", loads, force)
    changed = np.einsum("nw,nwij->nij", loads, slope) + np.einsum("nwi,nwj->nij", force, per_load)
    size = np.abs(residual / [1.0, 1.0, np.sqrt(robot.yaw_inertia / m)]).max(axis=1) / (m * GRAVITY)
    return _Balance(residual[..., None], inert_slope - changed, loads, size)


def _centripetal(robot: Robot, twist: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Acceleration (n, 2) of the centre of mass in a steady turn, and its twist derivative (n, 2, 3)."""
    x, y, (v_x, v_y, omega) = robot.com_x, robot.com_y, twist.T
    zero = np.zeros_like(omega)
    acceleration = np.column_stack([-omega * (v_y + omega * x), omega * (v_x - omega * y)])
    rows = ((zero, -omega, -v_y - 2.0 * omega * x), (omega, zero, v_x - 2.0 * omega * y))
    return acceleration, np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def _inertia(robot: Robot) -> FloatArray:
    """Mass matrix (3, 3): forces and moment about the origin per rate of change of the twist."""
    m, x, y = robot.mass, robot.com_x, robot.com_y
    return np.array([[m, 0.0, -m * y], [0.0, m, m * x], [-m * y, m * x, robot.yaw_inertia + m * (x**2 + y**2)]])


def _refuse_unbalanced(robot: Robot, rims: FloatArray, balance: _Balance) -> None:
    bad = np.flatnonzero(~(balance.size <= TOLERANCE))
    if bad.size:
        raise RequestError(
            f"the forces find no balance with rim speeds of {rims[bad[0], 0]:.3f} and {rims[bad[0], 1]:.3f} m/s"
            f" ({bad.size} of {len(rims)} pairs); drive slower"
        )
    lifted = np.argwhere(balance.loads < 0.0)
    if lifted.size:
        point, wheel = lifted[0]
        raise RequestError(
            f"{robot.name_of(wheel)} lifts off the ground with rim speeds of {rims[point, 0]:.3f} and"
            f" {rims[point, 1]:.3f} m/s; drive slower or lower the centre of mass"
        )
