"""Forces of wheels on the ground by shear stress against shear displacement: Wang 2015, Eqs. (17)-(21), after Yu.

The equations are printed for x to the right and y forward; here REP-103 holds. Eq. (17), lost in print, is
tau = p mu (1 - exp(-j / K)), Wong 2001. The exponents of Eqs. (19), (21) print K_r for left wheels.

Yu's shear displacement j is the straight distance over the ground from where the element came into contact. Ours is the
mean sliding velocity seen from the robot, times the time T in contact: the same up to terms of order (omega T)^2 (chi
of Table 1's robot differs by 2e-5), and free of artefacts where a wheel hardly turns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.kernels import shear as kernels
from skidsteer.kernels.ground import STANDSTILL
from skidsteer.se2 import FloatArray
from skidsteer.terramechanics.robot import Robot
from skidsteer.terramechanics.terrain import Terrain


@dataclass(frozen=True, slots=True)
class Quadrature:
    """Gauss-Legendre nodes over a patch, along it in the root of the distance from the leading edge.

    There the stress rises within about K. docs/ground.md has the accuracy by number of nodes.
    """

    along: int = 8
    across: int = 3

    def __post_init__(self) -> None:
        if self.along < 1 or self.across < 1:
            raise ValueError(f"need at least one node each way, got {self.along} along, {self.across} across")

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Nodes and weights along (n, 2), from 0 to 1, and across (m, 2), from -1/2 to 1/2. Weights sum to 1."""
        u, w = _gauss(self.along)
        across, weight = _gauss(self.across)
        return np.column_stack([u**2, 2.0 * u * w]), np.column_stack([across - 0.5, weight])


NODES = Quadrature()


def _gauss(n: int) -> tuple[FloatArray, FloatArray]:
    x, w = np.polynomial.legendre.leggauss(n)
    return np.asarray(0.5 * (x + 1.0)), np.asarray(0.5 * w)


def friction(terrain: Terrain, rims: ArrayLike) -> FloatArray:
    """Friction mu (...) at rim speeds (..., 2): mu_op where the sides turn in opposite directions, else mu_sa."""
    rims = np.asarray(rims, dtype=float)
    return np.where(rims[..., 0] * rims[..., 1] < 0.0, terrain.friction_opposite, terrain.friction)


def unit_forces(
    robot: Robot, terrain: Terrain, twist: ArrayLike, rims: ArrayLike, quadrature: Quadrature = NODES
) -> FloatArray:
    """Shear force of each wheel for a load of 1 N and friction 1, with its derivatives.

    Args:
        robot: that moves.
        terrain: under all wheels.
        twist: (..., 3) of the body [m/s, m/s, rad/s].
        rims: (..., 2) left and right rim speed [m/s].
        quadrature: over each patch.

    Returns:
        (..., w, 3, 5): along the next to last axis F_x, F_y and the moment about the origin [m]; along the last one
        these, then their derivatives with respect to v_x, v_y, omega and the rim speed of the wheel.
    """
    twist, rims = np.asarray(twist, dtype=float), np.asarray(rims, dtype=float)
    shape = np.broadcast_shapes(twist.shape[:-1], rims.shape[:-1])
    flat = np.ascontiguousarray(np.broadcast_to(twist, (*shape, 3)).reshape(-1, 3))
    speeds = np.broadcast_to(rims, (*shape, 2)).reshape(-1, 2)[:, robot.side]
    patch = np.array([robot.patch_length, robot.patch_width])
    stiffness = (terrain.shear_modulus, terrain.stiffness_ratio)
    forces = kernels.shear(flat, speeds, robot.places, patch, *stiffness, *quadrature.nodes())
    return np.asarray(forces.reshape(*shape, len(robot.places), 3, 5))


def wheel_forces(
    robot: Robot,
    terrain: Terrain,
    twist: ArrayLike,
    rims: ArrayLike,
    loads: ArrayLike | None = None,
    quadrature: Quadrature = NODES,
) -> FloatArray:
    """Shear force (..., w, 3) of each wheel: F_x, F_y [N] and the moment about the origin [N m], Eqs. (18)-(21).

    Args:
        robot: that moves.
        terrain: under all wheels.
        twist: (..., 3) of the body [m/s, m/s, rad/s].
        rims: (..., 2) left and right rim speed [m/s].
        loads: (..., w) [N]; None: those at rest.
        quadrature: over each patch.
    """
    forces = unit_forces(robot, terrain, twist, rims, quadrature)[..., 0]
    loads = robot.loads() if loads is None else np.asarray(loads, dtype=float)
    return np.asarray(forces * (loads * friction(terrain, rims)[..., None])[..., None])


def rolling_forces(
    robot: Robot, terrain: Terrain, twist: ArrayLike, loads: ArrayLike | None = None
) -> tuple[FloatArray, FloatArray]:
    """Rolling resistance of each wheel against the motion of its hub, Eq. (22), and its twist derivative.

    The sum is the m g mu_roll of Eq. (22) where all hubs move forwards, and a moment where they move in opposite
    directions, which Eq. (22) leaves open. Below ``STANDSTILL`` it fades.

    Returns:
        (..., w, 3) F_x, F_y [N] and the moment about the origin [N m]; (..., w, 3, 3).
    """
    twist, y = np.asarray(twist, dtype=float), robot.places[:, 1]
    hub = twist[..., :1] - twist[..., 2:] * y
    length = np.hypot(hub, STANDSTILL)
    strength = terrain.rolling_resistance * (robot.loads() if loads is None else np.asarray(loads))
    lever = np.stack([-np.ones_like(y), np.zeros_like(y), y], axis=-1)
    arm = np.stack([np.ones_like(y), np.zeros_like(y), -y], axis=-1)
    slope = strength * STANDSTILL**2 / length**3
    force = (strength * hub / length)[..., None] * lever
    return force, slope[..., None, None] * lever[:, :, None] * arm[:, None, :]
