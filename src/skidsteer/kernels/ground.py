"""A planar robot on the shear forces of its wheels, stepped through time by implicit Euler steps."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.kernels.shear import wheel_force
from skidsteer.se2 import FloatArray

GRAVITY = 9.81  # [m/s^2]
STANDSTILL = 1e-3  # [m/s] of a hub below which its rolling resistance fades
ITERATIONS = 40  # Newton steps
HALVINGS = 12  # of a Newton step, and of a time step, before giving up
TOLERANCE = 1e-8  # of forces, relative to the weight
DONE, LIFTED, FAILED = 0, 1, 2  # how ``drive`` ended


@njit(cache=True)
def _solve(A: FloatArray, b: FloatArray) -> bool:
    """Solve A x = b into b by elimination with pivots; A is used up. False where it is singular."""
    n = len(b)
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        if not abs(A[best, k]) > 0.0:  # NaN, too
            return False
        if best != k:
            for j in range(k, n):
                A[k, j], A[best, j] = A[best, j], A[k, j]
            b[k], b[best] = b[best], b[k]
        for i in range(k + 1, n):
            f = A[i, k] / A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= f * A[k, j]
            b[i] -= f * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= A[k, j] * b[j]
        b[k] /= A[k, k]
    return True


@njit(cache=True)
def _ground_forces(
    z: FloatArray,
    places: FloatArray,
    loads: FloatArray,
    ground: FloatArray,
    body: FloatArray,
    along: FloatArray,
    across: FloatArray,
    total: FloatArray,
    drag: FloatArray,
) -> None:
    """Forces on the body at z = v_x, v_y, omega, left and right rim speed.

    Args:
        z: (5,).
        places: (w, 2) [m].
        loads: (w,) [N].
        ground: (w, 4) friction, K, rolling resistance, ratio of K to that across under each wheel.
        body: (10,), as for ``drive``.
        along: nodes, as for ``wheel_force``.
        across: nodes, as for ``wheel_force``.
        total: out, (5, 6) F_x, F_y, moment about the origin, then what the left and the right side pull with; and the
            derivatives by z. Rolling resistance is in the forces and the moment only.
        drag: out, (1,) [W] that rolling resistance takes from the body.
    """
    total[:] = 0.0
    drag[0] = 0.0
    for i in range(len(places)):
        side = 3 if places[i, 1] > 0.0 else 4
        f = wheel_force(z, z[side], places[i], body[8:10], ground[i, 1], ground[i, 3], along, across)
        strength = loads[i] * ground[i, 0]
        for r in range(3):
            for k in range(4):
                total[r, k] += strength * f[r, k]
            total[r, 1 + side] += strength * f[r, 4]
        for k in range(4):
            total[side, k] += strength * f[0, k]
        total[side, 1 + side] += strength * f[0, 4]
        y = places[i, 1]
        hub = z[0] - z[2] * y
        length = math.sqrt(hub * hub + STANDSTILL**2)
        R, slope = loads[i] * ground[i, 2] * hub / length, loads[i] * ground[i, 2] * STANDSTILL**2 / length**3
        drag[0] += R * hub
        total[0, 0] -= R  # Eq. (22)
        total[2, 0] += y * R
        total[0, 1] -= slope
        total[0, 3] += slope * y
        total[2, 1] += y * slope
        total[2, 3] -= y * y * slope


@njit(cache=True)
def _residual(
    z: FloatArray,
    before: FloatArray,
    dt: float,
    wanted: FloatArray,
    body: FloatArray,
    total: FloatArray,
    r: FloatArray,
    J: FloatArray,
) -> float:
    """Residual of the equations of motion at the end of an implicit Euler step, its Jacobian and its norm.

    ``before`` (5,) is z at the start, ``wanted`` (2,) [m/s^2] the acceleration that the speed loop asks of both rims.
    """
    mass, inertia, cx, cy = body[0], body[1], body[2], body[3]
    ax, ay = z[0] - z[2] * cy, z[1] + z[2] * cx  # of the centre of mass
    bx, by = before[0] - before[2] * cy, before[1] + before[2] * cx
    r[0] = mass * ((ax - bx) / dt - z[2] * ay) - total[0, 0]
    r[1] = mass * ((ay - by) / dt + z[2] * ax) - total[1, 0]
    r[2] = inertia * (z[2] - before[2]) / dt - (total[2, 0] - cx * total[1, 0] + cy * total[0, 0])
    for k in range(5):
        J[0, k] = -total[0, 1 + k]
        J[1, k] = -total[1, 1 + k]
        J[2, k] = -(total[2, 1 + k] - cx * total[1, 1 + k] + cy * total[0, 1 + k])
    J[0, 0] += mass / dt
    J[0, 1] -= mass * z[2]
    J[0, 2] -= mass * (cy / dt + ay + z[2] * cx)
    J[1, 0] += mass * z[2]
    J[1, 1] += mass / dt
    J[1, 2] += mass * (cx / dt + ax - z[2] * cy)
    J[2, 2] += inertia / dt
    for side in range(3, 5):
        need = body[5] * wanted[side - 3] + total[side, 0]
        r[side] = body[5] * (z[side] - before[side]) / dt
        for k in range(5):
            J[side, k] = 0.0
        J[side, side] = body[5] / dt
        if abs(need) <= body[7]:
            r[side] -= body[5] * wanted[side - 3]
        else:
            r[side] += total[side, 0] - math.copysign(body[7], need)
            for k in range(5):
                J[side, k] += total[side, 1 + k]
    size = abs(r[2]) / math.sqrt(inertia / mass)
    for k in (0, 1, 3, 4):
        size = max(size, abs(r[k]))
    return float(size)


@njit(cache=True)
def _step(
    z: FloatArray,
    dt: float,
    command: FloatArray,
    places: FloatArray,
    loads: FloatArray,
    ground: FloatArray,
    body: FloatArray,
    along: FloatArray,
    across: FloatArray,
    total: FloatArray,
    drag: FloatArray,
) -> bool:
    """One implicit Euler step of z (5,), in place, by damped Newton steps; False, and z as it was, where they fail."""
    before = z.copy()
    decay = -math.expm1(-dt / body[6]) if body[6] > 0.0 else 1.0
    wanted = (command - before[3:]) * (decay / dt)
    r, J, tried = np.empty(5), np.empty((5, 5)), np.empty(5)
    r_tried, J_tried = np.empty(5), np.empty((5, 5))
    z[3:] += wanted * dt
    _ground_forces(z, places, loads, ground, body, along, across, total, drag)
    size = _residual(z, before, dt, wanted, body, total, r, J)
    enough = TOLERANCE * body[0] * GRAVITY
    for _ in range(ITERATIONS):
        if size <= enough:
            return True
        if not _solve(J, r):
            break
        share, better = 1.0, False
        for _ in range(HALVINGS):
            tried[:] = z - share * r
            _ground_forces(tried, places, loads, ground, body, along, across, total, drag)
            size_tried = _residual(tried, before, dt, wanted, body, total, r_tried, J_tried)
            if size_tried < size:
                better = True
                break
            share *= 0.5
        if not better:
            break
        z[:], r[:], J[:] = tried, r_tried, J_tried
        size = size_tried
    z[:] = before
    return False


@njit(cache=True)
def _under(
    t: float,
    pose: FloatArray,
    opposite: bool,
    places: FloatArray,
    bounds: FloatArray,
    terrains: FloatArray,
    ground: FloatArray,
) -> None:
    """Fill ``ground`` (w, 4) of ``_ground_forces``: the last of the areas that holds it now."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(len(places)):
        x = pose[0] + c * places[i, 0] - s * places[i, 1]
        y = pose[1] + s * places[i, 0] + c * places[i, 1]
        for k in range(len(bounds)):
            a = bounds[k]
            if a[0] <= t < a[1] and a[2] <= x < a[3] and a[4] <= y < a[5]:
                ground[i, 0] = terrains[k, 1] if opposite else terrains[k, 0]
                ground[i, 1], ground[i, 2], ground[i, 3] = terrains[k, 2], terrains[k, 3], terrains[k, 4]


@njit(cache=True)
def _share_load(places: FloatArray, body: FloatArray, fx: float, fy: float, loads: FloatArray) -> None:
    """Loads (w,) [N] that vary linearly over the wheels and balance weight and the ground's forces fx, fy [N]."""
    n, xx, yy = len(places), 0.0, 0.0
    for i in range(n):
        xx += places[i, 0] ** 2
        yy += places[i, 1] ** 2
    pitch = body[0] * GRAVITY * body[2] - body[4] * fx
    roll = body[0] * GRAVITY * body[3] - body[4] * fy
    for i in range(n):
        loads[i] = body[0] * GRAVITY / n + places[i, 1] * roll / yy
        if xx > 0.0:
            loads[i] += places[i, 0] * pitch / xx


@njit(cache=True)
def drive(
    t: FloatArray,
    commands: FloatArray,
    start: FloatArray,
    loads: FloatArray,
    places: FloatArray,
    body: FloatArray,
    bounds: FloatArray,
    terrains: FloatArray,
    along: FloatArray,
    across: FloatArray,
    poses: FloatArray,
    states: FloatArray,
    power: FloatArray,
) -> tuple[int, int, int]:
    """Step a robot through time.

    Args:
        t: (n,) [s].
        commands: (n, 2) [m/s] rim speeds asked for, held from each time to the next.
        start: (8,) pose, twist, rim speeds.
        loads: in and out, (w,) [N] on the wheels.
        places: (w, 2) [m] patches from the origin; those of the left side have y > 0.
        body: (10,) mass [kg], yaw inertia [kg m^2], centre of mass x, y and height [m], mass that the rims of a side
            feel [kg], lag of the speed loop [s], force of a side [N], patch length and width [m].
        bounds: (k, 6) of areas: t, x, y from, to. The first must hold everywhere.
        terrains: (k, 5) of the areas: friction of wheels turning the same and the opposite way, K [m], rolling
            resistance, ratio of K to that across.
        along: nodes, as for ``wheel_force``.
        across: nodes, as for ``wheel_force``.
        poses: out, (n, 3).
        states: out, (n, 5) twist and rim speeds.
        power: out, (n, 3) [W] that the rims put in, shear and rolling resistance take; mean over the step before.

    Returns:
        How it ended, at which index of t, and which wheel lifted off.
    """
    pose, z = start[:3].copy(), start[3:].copy()
    ground = np.zeros((len(places), 4))
    total, drag, was = np.zeros((5, 6)), np.zeros(1), np.empty(5)
    poses[0], states[0], power[0] = pose, z, 0.0
    for n in range(len(t)):
        for i in range(len(places)):
            if not loads[i] >= 0.0:
                return LIFTED, n, i
        if n == len(t) - 1:
            break
        power[n + 1] = 0.0
        done, parts = 0, 1  # equal parts of the step, more where Newton fails
        while done < parts:
            dt = (t[n + 1] - t[n]) / parts
            _under(t[n] + done * dt, pose, z[3] * z[4] < 0.0, places, bounds, terrains, ground)
            was[:] = z
            if not _step(z, dt, commands[n], places, loads, ground, body, along, across, total, drag):
                if parts >= 1 << HALVINGS:
                    return FAILED, n, 0
                done, parts = 2 * done, 2 * parts
                continue
            _advance(pose, was, z, dt)
            shear_power = total[3, 0] * z[3] + total[4, 0] * z[4]
            power[n + 1, 0] += shear_power / parts
            on_body = total[0, 0] * z[0] + total[1, 0] * z[1] + total[2, 0] * z[2]
            power[n + 1, 1] += (shear_power - on_body - drag[0]) / parts
            power[n + 1, 2] += drag[0] / parts
            _share_load(places, body, total[0, 0], total[1, 0], loads)
            done += 1
        poses[n + 1], states[n + 1] = pose, z
    return DONE, len(t) - 1, 0


@njit(cache=True)
def _advance(pose: FloatArray, before: FloatArray, after: FloatArray, dt: float) -> None:
    """Move a pose (3,) by the mean of two twists over dt, by the chord of the arc."""
    vx, vy, omega = 0.5 * (before[0] + after[0]), 0.5 * (before[1] + after[1]), 0.5 * (before[2] + after[2])
    half = 0.5 * omega * dt
    chord = dt * (1.0 - half * half / 6.0 * (1.0 - half * half / 20.0))
    c, s = math.cos(pose[2] + half), math.sin(pose[2] + half)
    pose[0] += chord * (c * vx - s * vy)
    pose[1] += chord * (s * vx + c * vy)
    pose[2] += 2.0 * half
