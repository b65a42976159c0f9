"""Mandow's simple experiment, Eqs. (11) and (12): turn on the spot, drive straight, and have the symmetric model.

Eq. (11) as printed has no alpha, but Eq. (8) turns by alpha (R - L) / (2 x_ICR): where alpha of Eq. (12) is used, (11)
has to be multiplied by it, or the two together do not give back the turn they were measured on. Mandow's own result
(alpha = 0.91, x_ICR = 0.275 m) is of that kind: half the distance of the ICRs of Table I is 0.281 m; over alpha, as
printed, it would be 0.307 m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.drive import Drive
from skidsteer.errors import RequestError
from skidsteer.kernels import moments as kernels
from skidsteer.models import SymmetricIcr
from skidsteer.se2 import FloatArray, chain
from skidsteer.windows import Timing, Windows, increment_windows, steps

TURN, STRAIGHT = 1, 2  # kinds of a window; negative: clockwise, backwards


def turn_test(rolled: ArrayLike, angle: ArrayLike, alpha: ArrayLike = 1.0) -> FloatArray:
    """ICR of turns on the spot, Mandow 2007, Eq. (11) times alpha.

    Args:
        rolled: (..., 2) [m] what the left and the right side rolled.
        angle: (...) [rad] true angle of the turn, counter-clockwise positive, whole turns included.
        alpha: (...) true over nominal rim speed, from ``straight_test``.

    Returns:
        (...) icr_y [m]: the left tread ICR, the right one lies at -icr_y.

    Raises:
        ValueError: an angle of zero.
    """
    left, right = np.moveaxis(np.asarray(rolled, dtype=float), -1, 0)
    twice = 2.0 * _nonzero(angle, "angle [rad]")
    return np.asarray(np.asarray(alpha, dtype=float) * (right - left) / twice)  # Eq. (11)


def straight_test(rolled: ArrayLike, distance: ArrayLike) -> FloatArray:
    """True over nominal rim speed of straight runs, Mandow 2007, Eq. (12).

    Args:
        rolled: (..., 2) [m] what the left and the right side rolled.
        distance: (...) [m] true distance, backwards negative.

    Returns:
        (...) alpha.

    Raises:
        ValueError: the two sides rolled nothing together.
    """
    total = np.asarray(rolled, dtype=float).sum(axis=-1)
    return 2.0 * np.asarray(distance, dtype=float) / _nonzero(total, "distance rolled by both sides [m]")  # Eq. (12)


def _nonzero(value: ArrayLike, name: str) -> FloatArray:
    array = np.asarray(value, dtype=float)
    if (array == 0.0).any():
        raise ValueError(f"need a {name} other than 0, got {array.tolist()}")
    return array


@dataclass(frozen=True, slots=True)
class StretchOptions:
    """What counts as a turn on the spot and as a straight run."""

    pivot: float = 0.1  # largest |v_left + v_right| over |v_right - v_left| in a turn on the spot
    straight: float = 0.1  # largest |v_right - v_left| over |v_left + v_right| in a straight run
    least_speed: float = 0.02  # [m/s] of the faster side; slower is standing still
    least_turn: float = np.pi / 6.0  # [rad] in one stretch
    least_distance: float = 0.5  # [m] in one stretch

    def __post_init__(self) -> None:
        for name in ("pivot", "straight"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name} must lie between 0 and 1, got {getattr(self, name)}")
        for name in ("least_speed", "least_turn", "least_distance"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class StretchEstimate:
    """One number from several stretches of a drive."""

    value: float
    standard_error: float | None  # from the scatter of the stretches; None where there is only one
    stretches: int
    length: float  # [rad] or [m], of all stretches together


@dataclass(frozen=True, slots=True)
class SymmetricFit:
    """The symmetric model, Mandow 2007, Eq. (8), from turns on the spot and straight runs."""

    model: SymmetricIcr
    icr_y: StretchEstimate  # [m]
    alpha: StretchEstimate


def symmetric_from_drive(
    drive: Drive, timing: Timing | None = None, options: StretchOptions | None = None
) -> SymmetricFit:
    """Find the turns on the spot and the straight runs of a drive with reference poses, and apply Eqs. (11), (12).

    Several stretches are joined by regression through the origin of what the reference tells on what the wheels tell:
    the reference's error is the same for a short and a long stretch.

    Args:
        drive: with reference poses.
        timing: how the reference lies against the wheels.
        options: what counts as a stretch.

    Raises:
        RequestError: no reference poses, no such stretch, or wheels that contradict the reference.
    """
    options = options or StretchOptions()
    if drive.pose is None:
        raise RequestError(f"{drive.name}: the turn test needs reference poses with heading")
    windows = increment_windows(drive)
    cut = steps(drive.wheels, windows, timing or Timing())
    rolled, _ = kernels.extents(cut.distance, cut.offsets)
    kind = _kinds(rolled, windows.end - windows.start, options)
    turns, runs = _stretches(windows, rolled, kind, TURN), _stretches(windows, rolled, kind, STRAIGHT)
    turns, runs = turns[np.abs(turns[:, 3]) >= options.least_turn], runs[np.abs(runs[:, 2]) >= options.least_distance]
    if len(turns) == 0 or len(runs) == 0:
        raise RequestError(_what_is_missing(drive.name, len(turns) > 0, len(runs) > 0, options))
    alpha = _slope(0.5 * (runs[:, 1] + runs[:, 0]), runs[:, 2])
    rate = _slope(0.5 * (turns[:, 1] - turns[:, 0]), turns[:, 3])
    if alpha.value <= 0.0 or rate.value <= 0.0:
        motion = "moves" if alpha.value <= 0.0 else "turns"
        raise RequestError(f"{drive.name}: the reference {motion} against the wheels: are sides or signs swapped?")
    icr_y = _ratio(alpha, rate)
    return SymmetricFit(SymmetricIcr(icr_y.value, alpha.value), icr_y, alpha)


def _kinds(rolled: FloatArray, duration: FloatArray, options: StretchOptions) -> np.ndarray:
    """Kind (k,) of each window: +-TURN, +-STRAIGHT or 0."""
    together, apart = rolled.sum(axis=1), rolled[:, 1] - rolled[:, 0]
    moves = np.abs(rolled).max(axis=1) >= options.least_speed * duration
    turn = moves & (np.abs(together) <= options.pivot * np.abs(apart))
    straight = moves & (np.abs(apart) <= options.straight * np.abs(together))
    return np.asarray(TURN * np.sign(apart) * turn + STRAIGHT * np.sign(together) * straight)


def _stretches(windows: Windows, rolled: FloatArray, kind: np.ndarray, wanted: int) -> FloatArray:
    """Rows (n, 4) of unbroken windows of one kind: rolled left, right [m], true distance [m], true angle [rad]."""
    begins = np.ones(len(kind), dtype=bool)
    begins[1:] = (np.diff(kind) != 0) | ~windows.joined[1:]
    first = np.flatnonzero(begins)
    rows = [
        [*rolled[a:b].sum(axis=0), *_travelled(windows.motion[a:b])]
        for a, b in zip(first, [*first[1:], len(kind)], strict=True)
        if abs(kind[a]) == wanted
    ]
    return np.array(rows, dtype=float).reshape(-1, 4)


def _travelled(motion: FloatArray) -> tuple[float, float]:
    """Distance [m] along the arc through both ends, and angle [rad], of motions (n, 3) one after another."""
    x, y, yaw = chain(motion)[-1]
    # The chord of an arc points along half its angle: that tells forwards from backwards.
    chord = np.copysign(np.hypot(x, y), x * np.cos(0.5 * yaw) + y * np.sin(0.5 * yaw))
    return float(chord / np.sinc(yaw / (2.0 * np.pi))), float(yaw)


def _slope(x: FloatArray, y: FloatArray) -> StretchEstimate:
    """Regression of y (n,) on x (n,) through the origin; length is that of y."""
    value = float(x @ y / (x @ x))
    error = None
    if len(x) > 1:
        error = float(np.sqrt(((y - value * x) ** 2).sum() / (len(x) - 1) / (x @ x)))
    return StretchEstimate(value, error, len(x), float(np.abs(y).sum()))


def _ratio(alpha: StretchEstimate, rate: StretchEstimate) -> StretchEstimate:
    """Icr_y = alpha / rate, with the turns' count and length; errors of the two are independent."""
    value, error = alpha.value / rate.value, None
    if alpha.standard_error is not None and rate.standard_error is not None:
        error = value * float(np.hypot(alpha.standard_error / alpha.value, rate.standard_error / rate.value))
    return StretchEstimate(value, error, rate.stretches, rate.length)


def _what_is_missing(name: str, turns: bool, runs: bool, options: StretchOptions) -> str:
    turn = f"turn on the spot of at least {np.degrees(options.least_turn):.0f} deg"
    run = f"straight run of at least {options.least_distance:g} m"
    missing = f"no {turn} and no {run}" if not (turns or runs) else f"no {run}" if turns else f"no {turn}"
    return f"{name}: has {missing}; record such stretches, both ways, or fit the model to the whole drive"
