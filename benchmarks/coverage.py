"""Whether regions hold the share they claim on steps not fitted to, and how sure that is. Writes docs/coverage.md."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from models import DATA, DRIVES, halves
from skidsteer.drive import Drive
from skidsteer.identify.calibrate import CalibrateOptions, calibrate_with_folds
from skidsteer.identify.holdout import held_out_errors
from skidsteer.io.drives import load_drive
from skidsteer.metrics import WindowErrors, window_errors
from skidsteer.prediction import Distances, fit_regions
from skidsteer.se2 import FloatArray

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "coverage.md"
SHARES = (0.68, 0.95)
RESAMPLES = 200
TEXT = """# Regions on real drives

Written by `make studies` (`benchmarks/coverage.py`); nothing here is edited by hand.

`skidsteer calibrate` is given one half of the command steps of a drive of 2 s windows. Of the end poses of the other
half, the table shows the share inside the regions that claim 68 % and 95 %. The windows of one command step err alike:
the standard errors are those of drawing whole command steps again, of the judged half and of the fitted one, whose
held-out windows the regions come from. *Turns off by* is the share of a turn that predictions are off by all through
it; scale and degrees of freedom are those of the Student t.

| drive | fitted on | held out | judged | inside 68 % | inside 95 % | turns off by | scale | degrees of freedom |
|---|---|---|---|---|---|---|---|---|"""
MEANING = """
All together: {inside}. Root mean square of the differences from what is claimed: {rms}; of the standard errors:
{sigma}. Where the two are alike, the differences are what chance makes of so few command steps."""


def steps_of(drive: Drive, errors: WindowErrors) -> np.ndarray:
    """Command step (k,) of each window."""
    assert drive.segments is not None
    row = np.searchsorted(drive.segments[:, 0], errors.start, side="right") - 1
    return np.asarray(drive.labels["calib_step"])[row]


def drawn(found: Distances, step: np.ndarray, rng: np.random.Generator) -> Distances:
    """The end poses of as many command steps, drawn with replacement."""
    names, number = np.unique(step, return_inverse=True)
    times = np.bincount(rng.integers(0, len(names), len(names)), minlength=len(names))
    again = np.repeat(np.arange(len(step)), times[number])
    return Distances(found.squared[again], found.score[again], found.information[again])


def standard_errors(seen: tuple[Distances, np.ndarray], judged: tuple[Distances, np.ndarray]) -> FloatArray:
    rng, shares = np.random.default_rng(0), []
    for _ in range(RESAMPLES):
        regions = fit_regions(drawn(*seen, rng))
        if regions is not None:
            other = drawn(*judged, rng)
            shares.append([regions.coverage(other, share) for share in SHARES])
    return np.asarray(np.std(shares, axis=0))


def cases() -> Iterator[tuple[str, str, Drive, Drive]]:
    for name in DRIVES:
        even, odd = halves(load_drive(DATA / name))
        yield from ((name, "even", even, odd), (name, "odd", odd, even))


def main() -> None:
    lines, shares, errors = [TEXT], [], []
    for name, half, fitted, other in cases():
        known, folds = calibrate_with_folds([fitted], CalibrateOptions())
        assert folds is not None
        assert known.regions is not None
        seen = held_out_errors(folds, [fitted]).errors
        judged = window_errors(known.model, other, known.timing, 2.0, known.mount, known.uncertainty)
        share = np.array([known.regions.coverage(judged.distances, s) for s in SHARES])
        of_seen, of_judged = (seen.distances, steps_of(fitted, seen)), (judged.distances, steps_of(other, judged))
        sigma = standard_errors(of_seen, of_judged)
        shares.append(share)
        errors.append(sigma)
        told = [f"{100 * a:.0f} +- {100 * b:.1f}" for a, b in zip(share, sigma, strict=True)]
        r = known.regions
        row = [name, half, str(len(seen)), str(len(judged)), *told, f"{100 * r.turning:.1f} %", f"{r.scale:.2f}"]
        lines.append(f"| {' | '.join(row)} | {r.dof:.1f} |")
        print(lines[-1], flush=True)
    off, sigma = np.array(shares) - SHARES, np.array(errors)
    inside, rms, mean = (
        " and ".join(f"{100 * v:.1f} %" for v in values)
        for values in (np.mean(shares, axis=0), np.sqrt(np.mean(off**2, axis=0)), np.sqrt(np.mean(sigma**2, axis=0)))
    )
    lines.append(MEANING.format(inside=inside, rms=rms, sigma=mean))
    DOCUMENT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
