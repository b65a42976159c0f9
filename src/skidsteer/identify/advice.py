"""What to drive next: candidate manoeuvres, by what they would tell with the same reference and noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skidsteer.calibration import MotionSigma
from skidsteer.drive import Series
from skidsteer.identify.judged import Judged
from skidsteer.identify.manoeuvres import Figure, Manoeuvre, rims_of
from skidsteer.identify.motions import ALIKE, STRAIGHT, sigmas
from skidsteer.identify.problem import Problem
from skidsteer.identify.unknowns import SHARED, Unknowns
from skidsteer.models import Model
from skidsteer.noise import Weights
from skidsteer.se2 import FloatArray
from skidsteer.simulate import Sensors, kinematic_drive
from skidsteer.vehicle import Vehicle
from skidsteer.windows import increment_windows

MOST_ADVICE = 3
RAMP = 1.0  # [s] from rest to the speed of the drive
LONGEST = 3600.0  # [s] of a manoeuvre: a model that takes longer is none, as of a drive in other units than ours
FASTER = 1.5  # times the speed of the drive

Parts = tuple[Manoeuvre, ...]


def candidates(vehicle: Vehicle, speed: float, model: Model) -> dict[str, Parts]:
    """Manoeuvres worth a try, in words.

    All but the last keep to the speed [m/s] of the drive; that one is faster, as far as the wheels can be. None takes
    more than ``LONGEST``.
    """
    straight = _held(model, speed, speed, STRAIGHT / speed)
    fast = max(min(FASTER * speed, vehicle.max_wheel_speed or np.inf), speed)
    tried = {
        "one straight of 10 m there and back": (straight, straight.back()),
        "two turns on the spot each way": (_turned(model, -speed, speed, 2.0), _turned(model, speed, -speed, 2.0)),
        "one full circle each way": _circles(model, speed),
        f"one full circle each way at {fast:.2g} m/s": _circles(model, fast),
    }
    return {text: parts for text, parts in tried.items() if sum(part.duration for part in parts) < LONGEST}


def _held(model: Model, left: float, right: float, duration: float) -> Manoeuvre:
    v, _, omega = model.twist(left, right).tolist()
    return Manoeuvre(v, omega, (left, right), duration)


def _turned(model: Model, left: float, right: float, turns: float) -> Manoeuvre:
    omega = abs(float(model.twist(left, right)[2]))
    return _held(model, left, right, 2.0 * np.pi * turns / omega if omega > 0.0 else np.inf)


def _circles(model: Model, speed: float) -> Parts:
    return _turned(model, speed / 3.0, speed, 1.0), _turned(model, speed, speed / 3.0, 1.0)


def played(parts: Parts, speed: float) -> Series:
    """Rim speeds of manoeuvres one after the other, between rests."""
    return rims_of([Figure(parts)], speed / RAMP)


def advise(
    judged: Judged, motions: list[MotionSigma], slopes: FloatArray, vehicle: Vehicle, speed: float, step: float
) -> tuple[str, ...]:
    """Manoeuvres, the most helpful first, until every motion is known to its tolerance or none helps any more."""
    shared = np.flatnonzero(judged.problem.free[: judged.p + len(SHARED)])
    precision = np.asarray(np.linalg.inv(judged.covariance[np.ix_(shared, shared)]))
    slopes = slopes[:, shared[shared < judged.p]]
    tried = {
        text: _information(judged, played(parts, speed), vehicle, step)
        for text, parts in candidates(vehicle, speed, judged.model).items()
    }
    advice: list[str] = []
    before = _after(slopes, precision)
    while before.max() > 1.0 and len(advice) < MOST_ADVICE and tried:
        after = {text: _after(slopes, precision + H) for text, H in tried.items()}
        best = min(after, key=lambda text: max(float(after[text].max()), 1.0))
        worst = int(np.argmax(before > ALIKE * before.max()))
        if after[best].max() > 0.9 * before.max():
            break
        new = replace(motions[worst], sigma=float(after[best][worst]) * motions[worst].tolerance)
        advice.append(f"add {best}: {new.motion} would be known to {new.rounded}")
        precision, before = precision + tried.pop(best), after[best]
    return tuple(advice)


def _after(slopes: FloatArray, precision: FloatArray) -> FloatArray:
    size = slopes.shape[1]
    return sigmas(slopes, np.asarray(np.linalg.inv(precision)[:size, :size]))


def _information(judged: Judged, rims: Series, vehicle: Vehicle, step: float) -> FloatArray:
    """What rim speeds would tell (s, s) of the free entries that all drives share; its time offset is its own."""
    found, model = judged.found, judged.model
    sensors = Sensors(reference_rate=1.0 / step, position_sigma=0.0, yaw_sigma=0.0)
    drive = kinematic_drive("candidate", vehicle, model, rims, sensors, found.timings[0].lag)
    sees = judged.problem.windows[0].sees
    windows = replace(increment_windows(drive), sees="pose" if sees == "turn" else sees)
    one = judged.p + len(SHARED) + 4
    free = judged.problem.free[:one].copy()
    free[-4:] = [sees != "turn", False, False, False]
    x = np.concatenate([judged.state.x[: one - 4], [0.0, 0.0, 0.0, 1.0]])
    state, prior = Unknowns(model, x, 1), judged.problem.prior[:one]
    problem = Problem(
        [drive], [windows], [None], state, prior, free, judged.problem.limits[:one], judged.problem.options
    )
    H = problem.information(state, found.noise, [Weights.ones(len(windows))])[0] / found.inflated
    if not free[-4]:
        return H
    own = H[-1, -1] + 1.0 / prior[-4] ** 2
    return np.asarray(H[:-1, :-1] - np.outer(H[:-1, -1], H[-1, :-1]) / own)
