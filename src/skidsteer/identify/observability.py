"""What drives determine, which combinations of parameters they leave open, and what to drive next.

A combination matters if its uncertainty moves predictions. So the covariance of a fit is carried over to a few motions
that every user knows, a straight, turns on the spot, curves, each with a tolerance; a drive is judged by the models
at least as free as a constant ICR, whatever simpler model was chosen because it could not tell more. The directions in
which the parameters can move unnoticed come from a pivoted Cholesky factor of that covariance: the worst motion, what
moves it, then the worst of what is left. What to drive next is found by adding the information of candidate manoeuvres,
simulated with the same reference and noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skidsteer.calibration import MotionSigma, Observability, WeakDirection
from skidsteer.drive import Drive, Series
from skidsteer.gyro import Turn
from skidsteer.identify.least_squares import Fit, fit
from skidsteer.identify.problem import Problem
from skidsteer.identify.start import FitOptions, with_headings
from skidsteer.identify.unknowns import SHARED, Unknowns
from skidsteer.models import Differential, Icr, Model, Multiplier, SymmetricIcr
from skidsteer.noise import Weights
from skidsteer.se2 import FloatArray
from skidsteer.simulate import Sensors, kinematic_drive
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Windows, increment_windows

DETERMINED = 0.25  # a sigma above this share of what was known before the drive: not determined
SHARE = 0.1  # of a distance or a turn that a prediction may err by
PLACE = 0.25  # of the track width that the point it turns about may be off by
STRAIGHT = 10.0  # [m]
ALIKE = 0.8  # of motions known about as badly the first is named
TAKES_PART = 0.1  # a parameter belongs to a weak direction from this share of the one that moves most
MOST_ADVICE = 3
RAMP = 1.0  # [s] in which a candidate manoeuvre changes speed
RATE = 20.0  # [Hz] of its wheel samples
FASTER = 1.5  # times the drive's speed, where the vehicle does not tell what it can


def observe(found: Fit, drives: list[Drive], windows: list[Windows], options: FitOptions) -> Observability:
    """Verdict on drives by a fit to them.

    Args:
        found: the fit.
        drives: that it was made from.
        windows: of each drive, that it was made from.
        options: that it was made with.
    """
    judged = _judged(found, drives, windows, options)
    speed, vehicle = _typical_speed(drives), drives[0].vehicle
    motions, slopes = _motions(judged.model, speed, vehicle.track_width)
    sigma = _sigmas(slopes, judged.covariance[: judged.p, : judged.p])
    weak = _described(judged, motions, slopes)
    step = float(np.clip(np.median(np.concatenate([w.end - w.start for w in windows])), 0.1, 1.0))
    return Observability(
        model=judged.model.NAME,
        determined=judged.named(judged.determined & judged.problem.free),
        undetermined=judged.named(~judged.determined & _moves(judged, slopes)),
        motions=tuple(replace(m, sigma=s * m.tolerance) for m, s in zip(motions, sigma.tolist(), strict=True)),
        weak=weak,
        advice=_advice(judged, motions, slopes, vehicle, speed, step) if weak else (),
    )


def _moves(judged: _Judged, slopes: FloatArray) -> np.ndarray:
    """Which entries (m,) move a motion by half its tolerance by what is open of them; all that is no parameter, too."""
    out = np.ones(len(judged.names), bool)
    out[: judged.p] = (np.abs(slopes) * judged.sigma[: judged.p]).max(axis=0, initial=0.0) > 0.5
    return out


def observe_drive(drive: Drive) -> Observability:
    """Verdict on one drive by a fit of the constant ICR, or of what its reference can tell of it.

    Raises:
        DataError: no reference, or wheels and reference share no time.
    """
    gyro_only, positions = drive.reference is None, drive.pose is None and drive.position is not None
    model: type[Model] = Multiplier if gyro_only else SymmetricIcr if positions else Icr
    options = FitOptions(mount=None) if positions else FitOptions()
    windows = increment_windows(drive)
    return observe(fit(model.nominal(drive.vehicle), [drive], [windows], options), [drive], [windows], options)


def is_determined(found: Fit) -> np.ndarray:
    """Which entries (m,) of a fit are given, or known much better than before the drive.

    What is assumed of a gyro is knowledge, not ignorance.
    """
    assumed = np.array([name.startswith(("gyro_bias", "gyro_scale")) for name in found.names])
    known = np.diag(found.covariance) < (DETERMINED * found.prior_sigma) ** 2
    return np.asarray(assumed | ~found.free | known)


# The model that the drives are judged by


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    """A fit, or what it would be with a freer model: the state, and the covariance (m, m) of all its entries."""

    problem: Problem
    state: Unknowns
    found: Fit
    names: tuple[str, ...]
    covariance: FloatArray
    determined: np.ndarray  # (m,) bool
    told: np.ndarray  # (m,) bool: worth telling

    @property
    def sigma(self) -> FloatArray:
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def named(self, which: np.ndarray) -> dict[str, float]:
        """Sigma of the entries of a mask (m,) that are worth telling."""
        return {self.names[i]: float(self.sigma[i]) for i in np.flatnonzero(which & self.told)}

    @property
    def model(self) -> Model:
        return self.state.model

    @property
    def p(self) -> int:
        return self.state.p


def _judged(found: Fit, drives: list[Drive], windows: list[Windows], options: FitOptions) -> _Judged:
    """The fit's own covariance where its model is free enough, else the information about the freer one."""
    model = _freer(found, windows)
    own = len(found.model.PARAMETERS)
    state = Unknowns(model, np.concatenate([model.theta, found.values[own:]]), len(drives))
    free = np.concatenate([np.ones(state.p, bool), found.free[own:]])
    if model is found.model:
        free = found.free
    turns = [Turn.of(d.gyro) if d.gyro is not None and options.use_gyro else None for d in drives]
    headed = [with_headings(model, d, w, state, i) for i, (d, w) in enumerate(zip(drives, windows, strict=True))]
    prior, names = state.prior_sigma(drives), state.names(drives)
    problem = Problem(drives, headed, turns, state, prior, free, state.bounds(drives), options)
    covariance = found.covariance if model is found.model else _covariance(problem, state, found)
    as_fit = replace(found, model=model, names=names, covariance=covariance, prior_sigma=prior, free=free)
    return _Judged(problem, state, found, names, covariance, is_determined(as_fit), as_fit.told)


def _freer(found: Fit, windows: list[Windows]) -> Model:
    """The same motion by a model as free as the reference allows to judge."""
    model = found.model
    if not isinstance(model, Differential | Multiplier | SymmetricIcr):
        return model
    if all(w.sees == "turn" for w in windows):
        return Multiplier(1.0, model.track_width) if isinstance(model, Differential) else model
    A = model.matrix()
    alpha = float(A[0].sum())
    half = alpha / float(A[2, 1] - A[2, 0])
    if found.free[found.names.index("mount_x")]:
        return model if isinstance(model, SymmetricIcr) else SymmetricIcr(half, alpha)
    return Icr(half, -half, 0.0, alpha, alpha)


def _covariance(problem: Problem, state: Unknowns, found: Fit) -> FloatArray:
    H = problem.information(state, found.noise, list(found.weights))[0] / found.inflated
    free, prior = problem.free, problem.prior[problem.free]
    covariance = np.zeros((len(state.x), len(state.x)))
    covariance[np.ix_(free, free)] = np.linalg.inv(H + np.diag(1.0 / prior**2))
    return covariance


# Motions that a user knows


def _typical_speed(drives: list[Drive]) -> float:
    """Rim speed [m/s] that the faster side seldom exceeds."""
    fastest = np.concatenate([np.abs(d.wheels.values).max(axis=1) for d in drives])
    return float(np.quantile(fastest[fastest > 0.0], 0.9))


def _motions(model: Model, speed: float, track_width: float) -> tuple[list[MotionSigma], FloatArray]:
    """Motions, with a sigma of zero yet, and the derivative (r, p) of each by the parameters, in tolerances.

    What the model assumes, whatever was driven, is left out.
    """
    rows = _straight(model, speed)
    rows += _on_the_spot(model, (-speed, speed), "left", track_width)
    rows += _on_the_spot(model, (speed, -speed), "right", track_width)
    rows += _curve(model, (speed / 3.0, speed), "left")
    rows += _curve(model, (speed, speed / 3.0), "right")
    told = [row for row in rows if np.abs(row[3]).max(initial=0.0) > 1e-9 * row[1]]
    slopes = [slope / tolerance for _, tolerance, _, slope in told]
    motions = [MotionSigma(motion, 0.0, tolerance, unit) for motion, tolerance, unit, _ in told]
    return motions, np.array(slopes).reshape(len(told), len(model.theta))


Row = tuple[str, float, str, FloatArray]  # motion, tolerance, unit, derivative by the parameters


def _straight(model: Model, speed: float) -> list[Row]:
    by_x, by_y, by_turn = model.parameter_jacobian(speed, speed)
    time = STRAIGHT / float(model.twist(speed, speed)[0])
    aside = time * (by_y + 0.5 * STRAIGHT * by_turn)
    return [
        ("the distance of 10 m straight on", SHARE * STRAIGHT, "m", time * by_x),
        ("the drift to the side on 10 m straight on", SHARE * STRAIGHT, "m", aside),
    ]


def _on_the_spot(model: Model, rims: tuple[float, float], side: str, track_width: float) -> list[Row]:
    (v_x, v_y, omega), (by_x, by_y, by_turn) = model.twist(*rims), model.parameter_jacobian(*rims)
    place, turn = PLACE * track_width, f"turn on the spot to the {side}"
    return [
        (f"the angle of a full {turn}", SHARE * 360.0, "deg", 360.0 * by_turn / omega),
        (f"how far ahead the centre of a {turn} lies", place, "m", (v_y * by_turn / omega - by_y) / omega),
        (f"how far aside the centre of a {turn} lies", place, "m", (by_x - v_x * by_turn / omega) / omega),
    ]


def _curve(model: Model, rims: tuple[float, float], side: str) -> list[Row]:
    (v_x, _, omega), (by_x, by_y, by_turn) = model.twist(*rims), model.parameter_jacobian(*rims)
    time, curve = STRAIGHT / v_x, f"curve to the {side}"
    return [
        (f"the angle of a full {curve}", SHARE * 360.0, "deg", 360.0 * by_turn / omega),
        (f"the distance of 10 m in a {curve}", SHARE * STRAIGHT, "m", time * by_x),
        (f"the side slip on 10 m in a {curve}", SHARE * STRAIGHT, "m", time * by_y),
    ]


def _sigmas(slopes: FloatArray, covariance: FloatArray) -> FloatArray:
    """Standard deviation (r,) of motions, in tolerances."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ri,ij,rj->r", slopes, covariance, slopes), 0.0)))


# Directions that are left open


def weak_directions(slopes: FloatArray, covariance: FloatArray) -> list[tuple[int, float, FloatArray]]:
    """Changes of the parameters by one sigma that move some motion by more than its tolerance.

    Args:
        slopes: (r, p) derivative of the motions, in tolerances.
        covariance: (p, p) of the parameters.

    Returns:
        Of each direction, the worst first: the motion that it moves most, by how many tolerances, and the change (p,).
        Each is what is left when the motions before it are known: a pivoted Cholesky factor of the motions' covariance.
    """
    found, rest = [], covariance
    for _ in range(len(covariance)):
        sigma = _sigmas(slopes, rest)
        if not sigma.size or sigma.max() <= 1.0:
            break
        worst = int(np.argmax(sigma > ALIKE * sigma.max()))
        change = rest @ slopes[worst] / sigma[worst]
        found.append((worst, float(sigma[worst]), change))
        rest = rest - np.outer(change, change)
    return found


def _described(judged: _Judged, motions: list[MotionSigma], slopes: FloatArray) -> tuple[WeakDirection, ...]:
    p = judged.p
    described = []
    for worst, sigma, change in weak_directions(slopes, judged.covariance[:p, :p]):
        moved = np.abs(change) / judged.problem.prior[:p]
        part = {judged.names[i]: float(change[i]) for i in np.flatnonzero(moved > TAKES_PART * moved.max())}
        described.append(WeakDirection(replace(motions[worst], sigma=sigma * motions[worst].tolerance), part))
    return tuple(described)


# What to drive next


def candidates(vehicle: Vehicle, speed: float, model: Model) -> dict[str, FloatArray]:
    """Manoeuvres worth a try, in words, as rows of duration [s] and rim speeds left, right [m/s]."""
    straight, turn = STRAIGHT / speed, 4.0 * np.pi / abs(float(model.twist(-speed, speed)[2]))
    fast = max(vehicle.max_wheel_speed or FASTER * speed, speed)
    circles = {v: 2.0 * np.pi / abs(float(model.twist(v / 3.0, v)[2])) for v in (speed, fast)}
    both = np.array([[1.0, 1.0 / 3.0, 1.0], [1.0, 1.0, 1.0 / 3.0]])
    return {
        "one straight of 10 m there and back": np.array([[straight, speed, speed], [straight, -speed, -speed]]),
        "two turns on the spot each way": np.array([[turn, -speed, speed], [turn, speed, -speed]]),
        "one full circle each way": both * [circles[speed], speed, speed],
        f"one full circle each way at {fast:.2g} m/s": both * [circles[fast], fast, fast],
    }


def _advice(
    judged: _Judged, motions: list[MotionSigma], slopes: FloatArray, vehicle: Vehicle, speed: float, step: float
) -> tuple[str, ...]:
    """Manoeuvres, the most helpful first, until every motion is known to its tolerance or none helps any more."""
    shared = np.flatnonzero(judged.problem.free[: judged.p + len(SHARED)])
    precision = np.asarray(np.linalg.inv(judged.covariance[np.ix_(shared, shared)]))
    slopes = slopes[:, shared[shared < judged.p]]
    tried = {
        text: _information(judged, rows, vehicle, step)
        for text, rows in candidates(vehicle, speed, judged.model).items()
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
    return _sigmas(slopes, np.asarray(np.linalg.inv(precision)[:size, :size]))


def _information(judged: _Judged, rows: FloatArray, vehicle: Vehicle, step: float) -> FloatArray:
    """What a manoeuvre would tell (s, s) of the free entries that all drives share; its time offset is its own."""
    found, model = judged.found, judged.model
    sensors = Sensors(reference_rate=1.0 / step, position_sigma=0.0, yaw_sigma=0.0)
    drive = kinematic_drive("candidate", vehicle, model, _rims(rows), sensors, found.timings[0].lag)
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


def _rims(rows: FloatArray) -> Series:
    """Rim speeds of a manoeuvre that begins and ends at rest, with ramps between."""
    held = np.insert(rows[:, 1:], [0, len(rows)], 0.0, axis=0).repeat(2, axis=0)
    durations = np.concatenate([[RAMP], rows[:, 0], [RAMP]])
    starts = np.cumsum(durations + RAMP) - durations - RAMP
    corners = np.stack([starts, starts + durations], axis=1).ravel()
    t = np.arange(0.0, corners[-1], 1.0 / RATE)
    return Series(t, np.stack([np.interp(t, corners, side) for side in held.T], axis=1), "wheels")
