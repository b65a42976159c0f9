"""The models' body twist and its derivative by the parameters, compiled; the equations of ``skidsteer.models``.

``KINDS`` numbers the models by name. Each function writes into twist (3,) and its derivative J (3, p), which must hold
zeros where it writes nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skidsteer.se2 import FloatArray

KINDS = {
    "differential": 0,
    "multiplier": 1,
    "icr_symmetric": 2,
    "curvature": 3,
    "icr": 4,
    "linear": 5,
    "scheduled_icr": 6,
    "transfer_factor": 7,
}
CREEP = 0.02  # [m/s] as in models.curvature and models.scheduled_icr
LEAN = 3.0  # [m/s^2] as in models.scheduled_icr


@njit(cache=True, forceinline=True, error_model="numpy")
def twist_of(
    kind: int, track: float, theta: FloatArray, left: float, right: float, twist: FloatArray, J: FloatArray
) -> None:
    """Twist (3,) of rim speeds [m/s], and its derivative (3, p), of the model of that kind.

    Args:
        kind: from ``KINDS``.
        track: [m] width that the model holds fixed; not used by the others.
        theta: (p,) all parameters of the model, in their order.
        left: [m/s].
        right: [m/s].
        twist: out.
        J: out, (3, p).
    """
    if kind == 4:
        _icr(theta, left, right, twist, J)
    elif kind == 6:
        _scheduled_icr(theta, left, right, twist, J)
    elif kind == 0:
        twist[0], twist[1], twist[2] = 0.5 * (left + right), 0.0, (right - left) / track
    elif kind == 1:
        twist[0], twist[1], twist[2] = 0.5 * (left + right), 0.0, (right - left) / (theta[0] * track)
        J[2, 0] = -twist[2] / theta[0]
    elif kind == 2:
        _icr_symmetric(theta, left, right, twist, J)
    elif kind == 3:
        _curvature(theta, track, left, right, twist, J)
    elif kind == 5:
        for i in range(3):
            twist[i] = theta[2 * i] * left + theta[2 * i + 1] * right
            J[i, 2 * i], J[i, 2 * i + 1] = left, right
    else:
        _transfer_factor(theta, track, left, right, twist, J)


@njit(cache=True, forceinline=True, error_model="numpy")
def _icr(theta: FloatArray, left: float, right: float, twist: FloatArray, J: FloatArray) -> None:
    """Mandow 2007, Eq. (7)."""
    y_left, y_right, x = theta[0], theta[1], theta[2]
    scaled_left, scaled_right, width = theta[3] * left, theta[4] * right, 1.0 / (y_left - y_right)
    omega = (scaled_right - scaled_left) * width
    v = (y_left * scaled_right - y_right * scaled_left) * width
    twist[0], twist[1], twist[2] = v, -x * omega, omega
    J[0, 0], J[0, 1] = (scaled_right - v) * width, (v - scaled_left) * width
    J[2, 0], J[2, 1] = -omega * width, omega * width
    J[0, 3], J[0, 4] = -y_right * left * width, y_left * right * width
    J[2, 3], J[2, 4] = -left * width, right * width
    for m in range(5):
        J[1, m] = -x * J[2, m]
    J[1, 2] = -omega


@njit(cache=True, error_model="numpy")
def _scheduled_icr(theta: FloatArray, left: float, right: float, twist: FloatArray, J: FloatArray) -> None:
    _icr(theta, left, right, twist, J)
    x, turn_loss, side_slip, slip_fade = theta[2], theta[5], theta[6], theta[9]
    straight_gain, load_gain = theta[7], theta[8]
    v, omega, apart = twist[0], twist[2], theta[0] - theta[1]
    loss, fade, a = 1.0 + turn_loss * omega**2, 1.0 + slip_fade * abs(v), abs(v * omega)
    square = v**2 + (apart * omega) ** 2 + CREEP**2
    straight = v**2 / square
    lean = a / (LEAN + a)
    closer = 1.0 - load_gain * lean
    gain, straight_gain = (1.0 + straight_gain * straight) / closer, straight_gain / closer
    by_a = gain / closer * load_gain * LEAN / (LEAN + a) ** 2
    turn_by_v = omega * (2.0 * straight_gain * v * (square - v**2) / square**2 + by_a * abs(omega) * np.sign(v))
    turn_by_omega = gain - 2.0 * straight_gain * (apart * v * omega / square) ** 2 + by_a * a
    for m in range(5):
        by_v, by_omega = J[0, m], J[2, m]
        turn = turn_by_v * by_v + turn_by_omega * by_omega
        slip = side_slip * (omega / fade**2 * by_v + v / fade * by_omega)
        J[0, m] = by_v / loss - 2.0 * v * turn_loss * omega / loss**2 * by_omega
        J[1, m] = -x * turn - slip
        J[2, m] = turn
    J[1, 2] -= omega * gain
    by_apart = -2.0 * straight_gain * apart * (v / square) ** 2 * omega**3
    J[1, 0] -= x * by_apart
    J[1, 1] += x * by_apart
    J[2, 0] += by_apart
    J[2, 1] -= by_apart
    J[0, 5] = -v * (omega / loss) ** 2
    J[1, 6] = -v * omega / fade
    J[2, 7] = omega * straight / closer
    J[2, 8] = omega * gain / closer * lean
    J[1, 7], J[1, 8] = -x * J[2, 7], -x * J[2, 8]
    J[1, 9] = side_slip * v * omega * abs(v) / fade**2
    twist[0], twist[1], twist[2] = v / loss, -x * omega * gain - side_slip * v * omega / fade, omega * gain


@njit(cache=True, error_model="numpy")
def _icr_symmetric(theta: FloatArray, left: float, right: float, twist: FloatArray, J: FloatArray) -> None:
    """Mandow 2007, Eq. (8)."""
    y, alpha = theta[0], theta[1]
    J[0, 1], J[2, 1] = 0.5 * (left + right), 0.5 * (right - left) / y
    twist[0], twist[1], twist[2] = alpha * J[0, 1], 0.0, alpha * J[2, 1]
    J[2, 0] = -twist[2] / y


@njit(cache=True, error_model="numpy")
def _transfer_factor(
    theta: FloatArray, track: float, left: float, right: float, twist: FloatArray, J: FloatArray
) -> None:
    """Thalmann 2016, Eq. (7)."""
    turn = theta[2] / track
    effective_left, effective_right = (1.0 - theta[0]) * left, (1.0 - theta[1]) * right
    apart = effective_right - effective_left
    twist[0], twist[1], twist[2] = 0.5 * (effective_left + effective_right), 0.0, turn * apart
    J[0, 0], J[0, 1] = -0.5 * left, -0.5 * right
    J[2, 0], J[2, 1], J[2, 2] = turn * left, -turn * right, apart / track


@njit(cache=True, error_model="numpy")
def _curvature(theta: FloatArray, track: float, left: float, right: float, twist: FloatArray, J: FloatArray) -> None:
    """Wang 2015, Eqs. (11), (15), (44)."""
    a, b, alpha, total, apart = theta[0], theta[1], theta[2], left + right, right - left
    p = math.sqrt(math.sqrt(math.sqrt(apart**4 + CREEP**4)))
    q = total**4 * (total**4 + CREEP**4) ** -0.875
    inner = p + b * q
    chi = 1.0 + a * p / inner
    omega = alpha * apart / (track * chi)
    twist[0], twist[1], twist[2] = 0.5 * alpha * total, 0.0, omega
    J[2, 0], J[2, 1], J[2, 2] = -omega / chi * p / inner, omega / chi * a * p * q / inner**2, omega / alpha
    J[0, 2] = 0.5 * total
