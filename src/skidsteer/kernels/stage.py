"""A stage of a plan: how the robot moves in it, within which bounds it can be steered, and what it costs.

Seen in the direction of driving, so that speeds are 0 or more, a stage begins with a row

    Y [m], THETA [rad]   beside the path, and by which the robot is turned to the left of the tangent
    SIDE [m/s]           velocity of the origin to the left
    OMEGA [rad/s]        of the body
    RIMS [rad/s]         the yaw rate asked for, behind the lag of the rims
    ASKED [rad/s]        the yaw rate asked for

which the input u [rad/s^2], the rate of ``ASKED``, steers; and with S [m] along the path, SPEED [m/s] of the rims
behind their lag and SPEED_ASKED [m/s], which follow the profile. The equations are those of ``control.observer``.
"""

from __future__ import annotations

import math

from numba import njit

from skidsteer.kernels.lags import cascade, decay, mean_share
from skidsteer.kernels.paths import point
from skidsteer.se2 import FloatArray

Y, THETA, SIDE, OMEGA, RIMS, ASKED, S, SPEED, SPEED_ASKED = range(9)
STEERED, ROW = 6, 9
U = STEERED  # column of the input in a Jacobian (6, 7)
CROWDED = 0.2  # least 1 - c y: nearer to the centre of curvature the path is taken for this
SLOWEST = 0.2  # [m/s] below which directions of motion are taken as at this speed
SHARPEST, STEEPEST = 1.5, 0.4  # [1/m] of curvature, [rad] of slip angle, beyond which the ground yields no further

# Places in ``body``: stage and period of commands, the slip as ``control.observer`` tells it, wheels
STEP, PERIOD, LAG, SCALE, LOSS, ICR_X, COMPLIANCE, GIVE, GAIN, DRIFT, EASE = range(11)
BY_SPEED, BY_TURN, RIM_SPEED, RIM_ACCELERATION, ACCELERATION, OMEGA_MAX = 11, 13, 15, 16, 17, 18  # by: left and right
BODY = 19

# Places in ``weights``
REACH, EFFORT, KNEE, END = range(4)
WEIGHTS = 4


@njit(cache=True)
def profile_at(profile: FloatArray, length: float, closed: bool, s: float) -> float:
    """Speed [m/s] at s [m] of a profile (n,) from one end of the path to the other."""
    last = len(profile) - 1
    at = s / length
    at = (at - math.floor(at) if closed else min(max(at, 0.0), 1.0)) * last
    i = min(int(at), last - 1)
    return float(profile[i] + (at - i) * (profile[i + 1] - profile[i]))


@njit(cache=True)
def held_share(body: FloatArray) -> float:
    """Share of a stage's change of command that is in force on average: commands are held for a period each."""
    return float(0.5 * (1.0 + body[PERIOD] / body[STEP]))


@njit(cache=True)
def ask_speed(
    row: FloatArray,
    body: FloatArray,
    profile: FloatArray,
    length: float,
    closed: bool,
    after: FloatArray,
) -> None:
    """Both speeds at the end of a stage: that of the profile a lag ahead, as fast as it may change."""
    h = body[STEP]
    target = profile_at(profile, length, closed, row[S] + row[SPEED] * body[LAG])
    change = body[ACCELERATION] * h
    after[SPEED_ASKED] = min(max(target, row[SPEED_ASKED] - change), row[SPEED_ASKED] + change)
    left = decay(h, body[LAG])
    held = row[SPEED_ASKED] + held_share(body) * (after[SPEED_ASKED] - row[SPEED_ASKED])
    after[SPEED] = left * row[SPEED] + (1.0 - left) * held


@njit(cache=True)
def bounds(row: FloatArray, speed_asked: float, body: FloatArray, out: FloatArray) -> None:
    """Least and greatest u (2,) by speed and acceleration of the rims of both sides, and by the greatest yaw rate.

    ``speed_asked`` [m/s] is that at the end of the stage. Where no u keeps all of them it is the least excess.
    """
    h, asked = body[STEP], row[ASKED]
    a = (speed_asked - row[SPEED_ASKED]) / h
    low, high = (-body[OMEGA_MAX] - asked) / h, (body[OMEGA_MAX] - asked) / h
    for side in range(2):
        by_speed, by_turn = body[BY_SPEED + side], body[BY_TURN + side]
        middle, half = -by_speed * a / by_turn, abs(body[RIM_ACCELERATION] / by_turn)
        low, high = max(low, middle - half), min(high, middle + half)
        middle, half = -by_speed * speed_asked / by_turn, abs(body[RIM_SPEED] / by_turn)
        low, high = max(low, (middle - half - asked) / h), min(high, (middle + half - asked) / h)
    if low > high:
        low = high = 0.5 * (low + high)
    out[0], out[1] = low, high


@njit(cache=True)
def move(
    row: FloatArray,
    u: float,
    body: FloatArray,
    knots: FloatArray,
    closed: bool,
    at: FloatArray,
    after: FloatArray,
    D: FloatArray,
) -> None:
    """The row (9,) at the end of a stage, whose speeds are set already, and the Jacobian D (6, 7); ``at`` is room."""
    h = body[STEP]
    point(knots, closed, row[S], at)
    sharp = min(abs(at[3]), SHARPEST)
    v = (body[SCALE] + body[LOSS] * sharp) * 0.5 * (row[SPEED] + after[SPEED])
    _turn(row, u, v, body, after, D)
    mean = _slide(row, v, sharp, body, after, D)
    side = after[SIDE]
    lag = max(body[COMPLIANCE] + body[GIVE] * sharp, 0.0) * v
    f = mean_share(h, lag)
    drift = (1.0 - f) * row[SIDE] + f * side
    kappa = at[3] + 0.5 * h * v * at[4]
    cos, sin = math.cos(row[THETA]), math.sin(row[THETA])
    clear = 1.0 - kappa * row[Y]
    way = max(clear, CROWDED)
    rate = (v * cos - row[SIDE] * sin) / way
    after[THETA] = row[THETA] + h * (mean - kappa * rate)
    after[S] = row[S] + h * rate
    D[THETA, THETA] = 1.0 + h * kappa * (v * sin + row[SIDE] * cos) / way
    D[THETA, SIDE] += h * kappa * sin / way
    D[THETA, Y] = -h * kappa * rate * kappa / way if clear > CROWDED else 0.0
    middle = 0.5 * (row[THETA] + after[THETA])
    cos, sin = math.cos(middle), math.sin(middle)
    after[Y] = row[Y] + h * (v * sin + drift * cos)
    for k in range(STEERED + 1):
        by_theta = 0.5 * (D[THETA, k] + (1.0 if k == THETA else 0.0))
        by_side = f * D[SIDE, k] + (1.0 - f if k == SIDE else 0.0)
        D[Y, k] = h * ((v * cos - drift * sin) * by_theta + cos * by_side)
    D[Y, Y] += 1.0


@njit(cache=True)
def _turn(row: FloatArray, u: float, v: float, body: FloatArray, after: FloatArray, D: FloatArray) -> None:
    """Yaw rates asked for, of the rims and of the body at the end, and their rows of D."""
    h, gain = body[STEP], body[GAIN]
    lag = max(body[COMPLIANCE], 0.0) * v
    a, b, passed = decay(h, body[LAG]), decay(h, lag), gain * cascade(h, body[LAG], lag)
    slow = max(v, SLOWEST)
    slip = min(abs(row[SIDE]) / slow, STEEPEST)
    ease = body[EASE] * slip
    after[ASKED] = row[ASKED] + u * h
    held = held_share(body) * h
    asked = row[ASKED] + u * held
    after[RIMS] = a * row[RIMS] + (1.0 - a) * asked
    driven = gain * asked + body[DRIFT] + ease * row[OMEGA]
    after[OMEGA] = b * row[OMEGA] + (1.0 - b) * driven + passed * (row[RIMS] - asked)
    D[:] = 0.0
    D[ASKED, ASKED], D[ASKED, U] = 1.0, h
    D[RIMS, RIMS], D[RIMS, ASKED], D[RIMS, U] = a, 1.0 - a, (1.0 - a) * held
    by_asked = (1.0 - b) * gain - passed
    D[OMEGA, OMEGA], D[OMEGA, RIMS] = b + (1.0 - b) * ease, passed
    D[OMEGA, ASKED], D[OMEGA, U] = by_asked, by_asked * held
    if slip < STEEPEST:
        D[OMEGA, SIDE] = (1.0 - b) * body[EASE] * row[OMEGA] * math.copysign(1.0 / slow, row[SIDE])


@njit(cache=True)
def _slide(row: FloatArray, v: float, sharp: float, body: FloatArray, after: FloatArray, D: FloatArray) -> float:
    """Sideways velocity at the end and its row of D; the mean yaw rate, whose derivatives go to the row of THETA."""
    h = body[STEP]
    f = mean_share(h, body[LAG] + max(body[COMPLIANCE], 0.0) * v)
    mean = (1.0 - f) * row[OMEGA] + f * after[OMEGA]
    c = decay(h, max(body[COMPLIANCE] + body[GIVE] * sharp, 0.0) * v)
    bent = body[GIVE] * v * abs(mean)
    icr_x = body[ICR_X] + body[COMPLIANCE] * v * v + bent
    after[SIDE] = c * row[SIDE] - (1.0 - c) * icr_x * mean
    for k in (SIDE, OMEGA, RIMS, ASKED, U):
        by_mean = f * D[OMEGA, k] + (1.0 - f if k == OMEGA else 0.0)
        D[SIDE, k] = -(1.0 - c) * (icr_x + bent) * by_mean
        D[THETA, k] = h * by_mean
    D[SIDE, SIDE] += c
    return float(mean)


@njit(cache=True)
def _course(row: FloatArray, body: FloatArray) -> tuple[float, float, float]:
    """Sine of the angle between the motion of the origin and the path, and its derivatives by THETA and SIDE."""
    v = max(body[SCALE] * row[SPEED], SLOWEST)
    cos, sin, share = math.cos(row[THETA]), math.sin(row[THETA]), row[SIDE] / v
    return sin + share * cos, cos - share * sin, cos / v


@njit(cache=True)
def cost(row: FloatArray, body: FloatArray, weights: FloatArray) -> float:
    """Of a row [m^2]: the offset squared, beyond the knee in proportion; and reach times the course, squared."""
    course, _, _ = _course(row, body)
    knee = weights[KNEE]
    return float(2.0 * knee**2 * (math.sqrt(1.0 + (row[Y] / knee) ** 2) - 1.0) + (weights[REACH] * course) ** 2)


@njit(cache=True)
def add_cost(
    row: FloatArray, body: FloatArray, weights: FloatArray, share: float, G: FloatArray, H: FloatArray
) -> None:
    """Add gradient (6,) and Gauss-Newton matrix (6, 6) of the cost, ``share`` times."""
    course, by_theta, by_side = _course(row, body)
    near = 2.0 * share / math.sqrt(1.0 + (row[Y] / weights[KNEE]) ** 2)
    weight = 2.0 * share * weights[REACH] ** 2
    G[Y] += near * row[Y]
    G[THETA] += weight * course * by_theta
    G[SIDE] += weight * course * by_side
    H[Y, Y] += near
    H[THETA, THETA] += weight * by_theta * by_theta
    H[THETA, SIDE] += weight * by_theta * by_side
    H[SIDE, THETA] += weight * by_theta * by_side
    H[SIDE, SIDE] += weight * by_side * by_side


@njit(cache=True)
def wanted(row: FloatArray, growth: float, body: FloatArray, knots: FloatArray, closed: bool, at: FloatArray) -> float:
    """The u [rad/s^2] that the path asks for where the robot will be once lags have passed; growth [m/s^2] of v."""
    v = body[SCALE] * row[SPEED]
    point(knots, closed, row[S] + v * (body[LAG] + max(body[COMPLIANCE], 0.0) * v), at)
    resists = 1.0 - body[EASE] * min(abs(row[SIDE]) / max(v, SLOWEST), STEEPEST)
    return float((v * v * at[4] + growth * at[3]) * max(resists, CROWDED) / body[GAIN])
