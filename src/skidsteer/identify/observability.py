"""What drives determine, which combinations of parameters they leave open, and what to drive next.

A combination matters if its uncertainty moves predictions. So the covariance of a fit is carried over to a few motions
that every user knows (``motions``), each with a tolerance; a drive is judged by a model at least as free as a constant
ICR (``judged``), whatever simpler model was chosen because it could not tell more. The directions in which the
parameters can move unnoticed come from a pivoted Cholesky factor of that covariance: the worst motion, what moves it,
then the worst of what is left. What to drive next (``advice``) is found by adding the information of candidates.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skidsteer.calibration import MotionSigma, Observability, WeakDirection
from skidsteer.drive import Drive
from skidsteer.identify.advice import advise
from skidsteer.identify.judged import Judged, judge
from skidsteer.identify.least_squares import Fit, fit
from skidsteer.identify.motions import ALIKE, known_motions, sigmas
from skidsteer.identify.start import FitOptions
from skidsteer.models import Icr, Model, Multiplier
from skidsteer.se2 import FloatArray
from skidsteer.windows import Windows, increment_windows

TAKES_PART = 0.1  # a parameter belongs to a weak direction from this share of the one that moves most
MATTERS = 0.5  # of a tolerance that what is open of a parameter alone must move to be worth a word


def observe(found: Fit, drives: list[Drive], windows: list[Windows], options: FitOptions) -> Observability:
    """Verdict on drives by a fit to them.

    Args:
        found: the fit.
        drives: that it was made from.
        windows: of each drive, that it was made from.
        options: that it was made with.
    """
    judged = judge(found, drives, windows, options)
    speed, vehicle = typical_speed(drives), drives[0].vehicle
    motions, slopes = known_motions(judged.model, speed, vehicle.track_width)
    sigma = sigmas(slopes, judged.covariance[: judged.p, : judged.p])
    weak = _described(judged, motions, slopes)
    step = float(np.clip(np.median(np.concatenate([w.end - w.start for w in windows])), 0.1, 1.0))
    return Observability(
        model=judged.model.NAME,
        determined=judged.named(judged.determined & judged.problem.free),
        undetermined=judged.named(~judged.determined & _moves(judged, slopes)),
        motions=tuple(replace(m, sigma=s * m.tolerance) for m, s in zip(motions, sigma.tolist(), strict=True)),
        weak=weak,
        advice=advise(judged, motions, slopes, vehicle, speed, step) if weak else (),
    )


def observe_drive(drive: Drive, align: bool = False) -> Observability:
    """Verdict on one drive by a fit of the constant ICR, or of what its reference can tell of it.

    Args:
        drive: to judge.
        align: the sensor of its reference is turned, by an angle that is to be estimated, too.

    Raises:
        DataError: no reference, or wheels and reference share no time.
    """
    model: type[Model] = Multiplier if drive.reference is None else Icr
    options = FitOptions(align=align)
    windows = increment_windows(drive)
    return observe(fit(model.nominal(drive.vehicle), [drive], [windows], options), [drive], [windows], options)


def typical_speed(drives: list[Drive]) -> float:
    """Rim speed [m/s] that the faster side seldom exceeds."""
    fastest = np.concatenate([np.abs(d.wheels.values).max(axis=1) for d in drives])
    return float(np.quantile(fastest[fastest > 0.0], 0.9))


def _moves(judged: Judged, slopes: FloatArray) -> np.ndarray:
    """Which entries (m,) move a motion by half its tolerance by what is open of them; all that is no parameter, too."""
    out = np.ones(len(judged.names), bool)
    out[: judged.p] = (np.abs(slopes) * judged.sigma[: judged.p]).max(axis=0, initial=0.0) > MATTERS
    return out


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
        sigma = sigmas(slopes, rest)
        if not sigma.size or sigma.max() <= 1.0:
            break
        worst = int(np.argmax(sigma > ALIKE * sigma.max()))
        change = rest @ slopes[worst] / sigma[worst]
        found.append((worst, float(sigma[worst]), change))
        rest = rest - np.outer(change, change)
    return found


def _described(judged: Judged, motions: list[MotionSigma], slopes: FloatArray) -> tuple[WeakDirection, ...]:
    p = judged.p
    described = []
    for worst, sigma, change in weak_directions(slopes, judged.covariance[:p, :p]):
        moved = np.abs(change) / judged.problem.prior[:p]
        part = {judged.names[i]: float(change[i]) for i in np.flatnonzero(moved > TAKES_PART * moved.max())}
        described.append(WeakDirection(replace(motions[worst], sigma=sigma * motions[worst].tolerance), part))
    return tuple(described)
