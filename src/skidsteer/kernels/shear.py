"""Shear stress under the contact patches of wheels.

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

HELD = 30.0  # [s] of sliding that a patch remembers where its wheel hardly turns
CREEP = 1e-7  # [m/s] sliding below which stress is proportional to it


@njit(cache=True, fastmath={"contract", "nsz"})
def wheel_force(
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
        (3, 5) F_x, F_y, moment about the origin; then their derivatives with respect to v_x, v_y, omega and rim.
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
    """``wheel_force`` for each operating point and wheel: twists (k, 3), rims (k, w), places (w, 2) to (k, w, 3, 5)."""
    out = np.empty((len(twists), len(places), 3, 5))
    for n in range(len(twists)):
        for i in range(len(places)):
            out[n, i] = wheel_force(twists[n], rims[n, i], places[i], patch, K, ratio, along, across)
    return out
