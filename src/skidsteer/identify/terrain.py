"""Grounds: is the model of one really another than that of the other, and a profile for each.

Two questions. Are the parameters equal? A Wald test over all of them at once, with the honest covariance of each fit.
Does it matter? The calibration of one ground is judged on the drives of the other, against that ground's own held-out
errors on the same windows. A profile of its own is needed where the first is denied and the second is not.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as fisher

from skidsteer.calibration import Calibration
from skidsteer.drive import Drive
from skidsteer.errors import RequestError
from skidsteer.identify.calibrate import CalibrateOptions, calibrate, refuse_unusable, settled
from skidsteer.identify.holdout import HeldOutErrors, held_out
from skidsteer.identify.judged import DETERMINED
from skidsteer.identify.least_squares import Fit, FitOptions, fit, fit_supported
from skidsteer.identify.select import Comparison, compare_errors
from skidsteer.metrics import WindowErrors, window_errors
from skidsteer.models import MODELS, Multiplier
from skidsteer.progress import Progress, silent
from skidsteer.se2 import FloatArray
from skidsteer.windows import increment_windows

LEVEL = 0.05


@dataclass(frozen=True, slots=True)
class Difference:
    """Wald test that several fits have the same parameters."""

    statistic: float
    freedom: int  # directions compared, times the number of fits less one
    stretches: int  # of 10 s that the covariances rest on
    p: float  # chance of so much or more if they have


@dataclass(frozen=True, slots=True)
class Pair:
    """Two grounds; the calibration of each on the drives of the other, against the other's own, held out."""

    a: str
    b: str
    difference: Difference
    a_on_b: Comparison | None  # None: too short to hold anything out
    b_on_a: Comparison | None

    @property
    def sides(self) -> tuple[tuple[str, str, Comparison | None], ...]:
        """The calibration of one ground, on the other, against the other's own."""
        return ((self.a, self.b, self.a_on_b), (self.b, self.a, self.b_on_a))

    @property
    def matters(self) -> bool:
        """Whether one surely predicts the other ground worse than its own; True where nothing could be held out."""
        told = [c for _, _, c in self.sides if c is not None]
        return not told or any(c.surely_worse for c in told)


@dataclass(frozen=True, slots=True)
class Terrains:
    """Whether grounds need profiles of their own."""

    model: str
    names: tuple[str, ...]
    difference: Difference  # of all of them
    pairs: tuple[Pair, ...]

    @property
    def needed(self) -> bool:
        """Whether the models differ and one predicts another ground worse for it."""
        return self.difference.p < LEVEL and any(pair.matters for pair in self.pairs if pair.difference.p < LEVEL)

    @property
    def because(self) -> str:
        """The verdict in one sentence."""
        count, p = len(self.names), f"p = {self.difference.p:.2g}"
        if self.difference.p >= LEVEL:
            return f"these {count} grounds need one profile only ({p})"
        if not self.needed:
            return f"the models of the grounds differ ({p}), but none surely predicts another worse: one profile serves"
        pairs = [pair for pair in self.pairs if pair.difference.p < LEVEL]
        judged = [(a, b, c) for pair in pairs for a, b, c in pair.sides if c is not None and c.surely_worse]
        if not judged:
            return f"the models of the grounds differ ({p}); the drives are too short to tell how much that matters"
        one, other, comparison = max(judged, key=lambda side: side[2].largest)
        return (
            f"the grounds need profiles of their own ({p}): on {other} the calibration of {one} against its own errs by"
            f" {comparison}"
        )


def wald_test(fits: Sequence[Fit]) -> Difference:
    """Whether fits of one model to drives of different grounds have the same parameters.

    With the estimates t_i, covariances C_i and their weighted mean m the statistic sum (t_i - m)^T C_i^-1 (t_i - m) is
    a chi-square where the C_i are known (for two fits (t_1 - t_2)^T (C_1 + C_2)^-1 (t_1 - t_2)). Their noise is
    estimated: an F distribution with as many degrees of freedom as there are independent stretches of 10 s allows for
    that, cautiously on short drives. Compared are the directions that all drives determine: in the others the estimates
    agree because nothing moved them.

    Raises:
        RequestError: fewer than two fits, of different models, or nothing that all of them determine.
    """
    if len(fits) < 2 or len({f.model.NAME for f in fits}) > 1:
        raise RequestError(f"need two fits or more of one model, got {[f.model.NAME for f in fits]}")
    index = [i for i in range(len(fits[0].model.PARAMETERS)) if all(f.free[i] for f in fits)]
    scale = fits[0].prior_sigma[index]
    theta = np.array([f.values[index] / scale for f in fits])
    covariances = np.array([f.covariance[np.ix_(index, index)] / np.outer(scale, scale) for f in fits])
    U = _determined(covariances)
    theta, covariances = theta @ U, U.T @ covariances @ U
    precision = np.linalg.inv(covariances)
    mean = np.linalg.solve(precision.sum(axis=0), np.einsum("kij,kj->i", precision, theta))
    statistic = float(np.einsum("ki,kij,kj->", theta - mean, precision, theta - mean))
    freedom = U.shape[1] * (len(fits) - 1)
    stretches = sum(f.stretches for f in fits)
    return Difference(statistic, freedom, stretches, float(fisher.sf(statistic / freedom, freedom, stretches)))


def _determined(covariances: FloatArray) -> FloatArray:
    """Orthonormal directions (p, r) that every one of the covariances (k, p, p), in units of the prior, determines."""
    values, vectors = (
        np.linalg.eigh(covariances.sum(axis=0)) if covariances.shape[1] else (np.zeros(0), np.zeros((0, 0)))
    )
    kept: FloatArray = vectors[:, values < DETERMINED**2]
    if not kept.shape[1]:
        raise RequestError("nothing that all of the grounds' drives determine; see `skidsteer check DRIVE`")
    return kept


def compare_terrains(
    grounds: Mapping[str, Sequence[Drive]],
    model: str = "icr",
    options: CalibrateOptions | None = None,
    progress: Progress = silent,
) -> Terrains:
    """Test whether grounds have the same model.

    Args:
        grounds: drives of the same robot, by the name of their ground.
        model: that is compared; of a model with optional terms those that any ground supports.
        options: of the fits and of the judging windows.
        progress: called as work goes on.

    Raises:
        DataError: a drive that cannot be calibrated from.
        RequestError: fewer than two grounds, or a model that the references cannot tell.
    """
    if len(grounds) < 2:
        raise RequestError(f"need drives of two grounds or more, got {', '.join(grounds) or 'none'}")
    options = replace(options or CalibrateOptions(), model=model)
    sides = []
    for i, (name, drives) in enumerate(grounds.items()):
        progress(f"fitting {name}", i, len(grounds) + 1)
        sides.append(_Side.of(name, list(drives), options))
    progress("comparing the grounds", len(grounds), len(grounds) + 1)
    sides = _alike(sides, model)
    pairs = tuple(
        Pair(a.name, b.name, wald_test([a.fit, b.fit]), _foreign(a, b), _foreign(b, a))
        for a, b in itertools.combinations(sides, 2)
    )
    return Terrains(model, tuple(grounds), wald_test([side.fit for side in sides]), pairs)


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """One ground: its drives, a fit to them, and the errors of fits to parts of them on the rest."""

    name: str
    drives: list[Drive]
    options: CalibrateOptions
    fit: Fit
    own: HeldOutErrors | None

    @classmethod
    def of(cls, name: str, drives: list[Drive], options: CalibrateOptions) -> _Side:
        for drive in drives:
            refuse_unusable(drive)
        options = settled(drives, options)
        start, spacing = MODELS[options.model].nominal(drives[0].vehicle), options.spacing or 0.0
        windows = [increment_windows(d, spacing) for d in drives]
        own = held_out(start, drives, options.fit, options.window, spacing)
        return cls(name, drives, options, fit_supported(start, drives, windows, options.fit), own)


def _alike(sides: list[_Side], model: str) -> list[_Side]:
    """The same with every optional term free that any of them supports, so that all are of one model."""
    optional = MODELS[model].OPTIONAL
    used = {name for side in sides for name in optional if side.fit.free[side.fit.names.index(name)]}
    without = tuple(name for name in optional if name not in used)
    out = []
    for side in sides:
        kept = {name for name in optional if side.fit.free[side.fit.names.index(name)]}
        out.append(
            side if kept == used else replace(side, fit=_refit(side, replace(side.options.fit, without=without)))
        )
    return out


def _refit(side: _Side, options: FitOptions) -> Fit:
    start = MODELS[side.options.model].nominal(side.drives[0].vehicle)
    return fit(start, side.drives, [increment_windows(d, side.options.spacing or 0.0) for d in side.drives], options)


def _foreign(a: _Side, b: _Side) -> Comparison | None:
    """The model of a on the drives of b against b's own, with the time offsets of b: they are the logger's alone."""
    if b.own is None or not len(b.own.errors):
        return None
    lag = a.fit.timings[0].lag
    options = replace(b.options.fit, fix_model=True, lag=lag, mount=a.fit.mount)
    parts = []
    for drive in b.drives:
        windows = increment_windows(drive, b.options.spacing or 0.0)
        timing = fit(a.fit.model, [drive], [windows], options).timings[0]
        parts.append(window_errors(a.fit.model, drive, timing, b.options.window, a.fit.mount))
    return compare_errors(_same_windows(parts, b.own), b.own.errors, b.own.block)


def _same_windows(parts: list[WindowErrors], own: HeldOutErrors) -> WindowErrors:
    """The errors of drives on the windows of held-out errors, in their order."""
    drive = own.block // 1000
    joined = WindowErrors.join(parts)
    first = np.concatenate([[0], np.cumsum([len(p) for p in parts])])
    index = np.zeros(len(own.errors), int)
    for i, part in enumerate(parts):
        here = drive == i
        index[here] = first[i] + np.searchsorted(part.start, own.errors.start[here] - 1e-9)
    return joined.where(index)


def calibrate_profiles(
    grounds: Mapping[str, Sequence[Drive]], options: CalibrateOptions | None = None, progress: Progress | None = None
) -> Calibration:
    """Calibrate one model on all grounds together, and a profile of it on each; a note says whether they are needed.

    Raises:
        DataError: a drive that cannot be calibrated from.
        RequestError: fewer than two grounds, or what ``calibrate`` raises.
    """
    if len(grounds) < 2:
        raise RequestError(f"need drives of two grounds or more, got {', '.join(grounds) or 'none'}; name no profile")
    options = options or CalibrateOptions()
    whole = calibrate([d for drives in grounds.values() for d in drives], options=options, progress=progress)
    options = replace(options, model=whole.model.NAME)
    profiles = {name: calibrate(list(drives), options=options, progress=progress) for name, drives in grounds.items()}
    compared = whole.model.NAME if whole.model.PARAMETERS else Multiplier.NAME
    verdict = compare_terrains(grounds, compared, options, progress or silent)
    return replace(whole, profiles=profiles, warnings=(*whole.warnings, verdict.because))
