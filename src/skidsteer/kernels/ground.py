"""Shear stress under each wheel's contact patch, and a planar robot on such wheels stepped through time.

An element of a patch that has been in contact for the time T has slid by j = T |s|, s its mean sliding velocity since
it came in. Its stress is p mu (1 - exp(-j / K)) against the direction in which it slides now, Wang 2015, Eqs.
(17)-(21). That is so where the ground (and the tyre) are as stiff sideways as lengthwise. Where they are not, j / K is
the length of (j_x / K, j_y / K_y), and the share exp(-j / K) of the stress, which is still elastic, points against
(s_x / K, s_y / K_y).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.se2 import FloatArray

GRAVITY = 9.81  # [m/s^2]
HELD = 30.0  # [s] of sliding that a patch remembers where its wheel hardly turns
CREEP = 1e-7  # [m/s] sliding below which stress is proportional to it
STANDSTILL = 1e-3  # [m/s] of a hub below which its rolling resistance fades
ITERATIONS = 40  # Newton steps
HALVINGS = 12  # of a Newton step, and of a time step, before giving up
TOLERANCE = 1e-8  # of forces, relative to the weight
DONE, LIFTED, FAILED = 0, 1, 2  # how ``drive`` ended


@njit(cache=True, fastmath={"contract", "nsz"})
def _wheel(
    u: FloatArray,
    rim: float,
    place: FloatArray,
    patch: FloatArray,
    K: float,
    ratio: float,
    along: FloatArray,
    across: FloatArray,
) -> FloatArray:
    """Shear force of one wheel for each newton of load times friction, and its derivatives.

    Args:
        u: (3,) twist of the body.
        rim: [m/s] of the wheel.
        place: (2,) [m] of the patch's centre.
        patch: (2,) [m] length and width.
        K: [m] shear modulus along the wheel.
        ratio: of K to that across.
        along: (n, 2) nodes from the edge where the ground comes in, in patch lengths, and weights.
        across: (m, 2) nodes from the middle, in patch widths, and weights.

    Returns:
        (3, 5) F_x, F_y, moment about the origin; then their derivatives by v_x, v_y, omega and rim.
    """
    out = np.zeros((3, 5))
    forward = 1.0 if rim >= 0.0 else -1.0
    for i in range(len(along)):
        way = patch[0] * along[i, 0]
        T = way / math.hypot(rim, way / HELD)
        x = place[0] + forward * (0.5 * patch[0] - way)
        middle = x + 0.5 * forward * way  # where it was on average since it came in
        T_by_rim = -rim * T**3 / (way * way)
        b, c = u[1] + u[2] * x, u[1] + u[2] * middle
        for k in range(len(across)):
            y = place[1] + patch[1] * across[k, 0]
            w = along[i, 1] * across[k, 1]
            a = u[0] - u[2] * y - rim
            e, d = ratio * b, ratio * c
            S, W = math.sqrt(a * a + b * b + CREEP**2), math.sqrt(a * a + e * e + CREEP**2)
            M = math.sqrt(a * a + d * d + CREEP**2)
            E = math.exp(-T * M / K)
            D = 1.0 - E
            elastic, sliding = D * E / W, D * D / S
            gx, gy = elastic + sliding, ratio * elastic + sliding
            gx_E, gy_E = (1.0 - 2.0 * E) / W - 2.0 * D / S, ratio * (1.0 - 2.0 * E) / W - 2.0 * D / S
            E_a, E_c, E_T = -E * T * a / (K * M), -E * T * ratio * d / (K * M), -E * M / K
            p, q = elastic / (W * W), sliding / (S * S)
            gx_a, gx_b, gx_c = gx_E * E_a - a * (p + q), -ratio * e * p - b * q, gx_E * E_c
            gy_a, gy_b, gy_c = gy_E * E_a - a * (ratio * p + q), -(ratio**2) * e * p - b * q, gy_E * E_c
            rim_T = E_T * T_by_rim
            fx, fx_a, fx_v = -w * a * gx, a * gx_a + gx, a * (gx_b + gx_c)
            fx_o, fx_r = a * (x * gx_b + middle * gx_c) - y * fx_a, a * gx_E * rim_T - fx_a
            fy, fy_a, fy_v = -w * b * gy, b * gy_a, b * (gy_b + gy_c) + gy
            fy_o, fy_r = b * (x * gy_b + middle * gy_c) + x * gy - y * fy_a, b * gy_E * rim_T - fy_a
            out[0, 0] += fx
            out[1, 0] += fy
            out[2, 0] += x * fy - y * fx
            out[0, 1] -= w * fx_a
            out[1, 1] -= w * fy_a
            out[2, 1] -= w * (x * fy_a - y * fx_a)
            out[0, 2] -= w * fx_v
            out[1, 2] -= w * fy_v
            out[2, 2] -= w * (x * fy_v - y * fx_v)
            out[0, 3] -= w * fx_o
            out[1, 3] -= w * fy_o
            out[2, 3] -= w * (x * fy_o - y * fx_o)
            out[0, 4] -= w * fx_r
            out[1, 4] -= w * fy_r
            out[2, 4] -= w * (x * fy_r - y * fx_r)
    return out


@njit(cache=True)
def shear(
    twists: FloatArray,
    rims: FloatArray,
    places: FloatArray,
    patch: FloatArray,
    K: float,
    ratio: float,
    along: FloatArray,
    across: FloatArray,
) -> FloatArray:
    """``_wheel`` for each operating point and wheel: twists (k, 3), rims (k, w), places (w, 2) to (k, w, 3, 5)."""
    out = np.empty((len(twists), len(places), 3, 5))
    for n in range(len(twists)):
        for i in range(len(places)):
            out[n, i] = _wheel(twists[n], rims[n, i], places[i], patch, K, ratio, along, across)
    return out


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
        along: nodes, as for ``_wheel``.
        across: nodes, as for ``_wheel``.
        total: out, (5, 6) F_x, F_y, moment about the origin, then what the left and the right side pull with; and the
            derivatives by z. Rolling resistance is in the forces and the moment only.
        drag: out, (1,) [W] that rolling resistance takes from the body.
    """
    total[:] = 0.0
    drag[0] = 0.0
    for i in range(len(places)):
        side = 3 if places[i, 1] > 0.0 else 4
        f = _wheel(z, z[side], places[i], body[8:10], ground[i, 1], ground[i, 3], along, across)
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
    """What is missing in the equations of motion at the end of an implicit Euler step, its Jacobian and its size.

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
        places: (w, 2) [m] patches from the origin; those of the left side have y > 0.
        body: (10,) mass [kg], yaw inertia [kg m^2], centre of mass x, y and height [m], mass that the rims of a side
            feel [kg], lag of the speed loop [s], force of a side [N], patch length and width [m].
        bounds: (k, 6) of areas: t, x, y from, to. The first must hold everywhere.
        terrains: (k, 5) of the areas: friction of wheels turning the same and the opposite way, K [m], rolling
            resistance, ratio of K to that across.
        along: nodes, as for ``_wheel``.
        across: nodes, as for ``_wheel``.
        poses: out, (n, 3).
        states: out, (n, 5) twist and rim speeds.
        power: out, (n, 3) [W] that the rims put in, shear and rolling resistance take; mean over the step before.

    Returns:
        How it ended, at which index of t, and which wheel lifted off.
    """
    pose, z = start[:3].copy(), start[3:].copy()
    loads, ground = np.empty(len(places)), np.zeros((len(places), 4))
    total, drag, was = np.zeros((5, 6)), np.zeros(1), np.empty(5)
    poses[0], states[0], power[0] = pose, z, 0.0
    _share_load(places, body, 0.0, 0.0, loads)
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
