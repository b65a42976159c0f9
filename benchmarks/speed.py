"""A simulated drive of a million wheel samples, and what is timed on it in this process."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares as scipy_least_squares

from skidsteer.drive import Drive, Series
from skidsteer.identify.genetic import GeneticOptions, search
from skidsteer.identify.least_squares import Fit, fit
from skidsteer.identify.moments import moments
from skidsteer.identify.squares import PlainFit, Squares, fit_squares
from skidsteer.kernels import squares as kernels
from skidsteer.models import Icr
from skidsteer.se2 import FloatArray
from skidsteer.simulate import Sensors, kinematic_drive
from skidsteer.vehicle import preset
from skidsteer.windows import Timing, Windows, increment_windows, linearize, predict, steps

SAMPLES = 1_000_000
RATE = 100.0  # [Hz] of the wheels; the reference at 5 Hz cuts them into segments of 20
TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)  # Mandow 2007, Table I
TIMING = Timing(0.0137, 0.06)
COPIES = 6  # of the samples, read in turn: too many for the cache


def drive(samples: int = SAMPLES) -> Drive:
    """Rim speeds that wander, a reference that is noisy and late, a body that lags."""
    rng = np.random.default_rng(0)
    t = np.arange(samples) / RATE
    waves = zip(rng.uniform(0.01, 0.3, 8), rng.uniform(0.0, 2.0 * np.pi, (8, 2)), strict=True)
    rims = 0.4 + 0.1 * sum(np.sin(2.0 * np.pi * f * t[:, None] + phase) for f, phase in waves)
    sensors = Sensors(reference_delay=TIMING.time_offset)
    vehicle = preset("pioneer-p3at")
    return kinematic_drive("benchmark", vehicle, TRUTH, Series(t, rims), sensors, TIMING.lag, (0.01, 0.01))


def timed(run: Callable[[], object], repeats: int) -> float:
    """Median of the seconds that repetitions take on a processor, after one to warm up.

    The time of this process, that of the system in it included, not that on the clock: what other jobs take of the
    machine does not count. All that is timed runs on one thread.
    """
    run()
    out = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        out.append(time.process_time() - start)
    return float(np.median(out))


# --- the fit of the squared cost


class NumpyResidual:
    """Mandow's Eq. (13) as one would write it with NumPy: segments as rows, headings by a cumulative sum.

    Made for speed: the samples are cut and laid out beforehand, for free; nothing is allocated in a call.
    """

    def __init__(self, drive: Drive, windows: Windows) -> None:
        cut = steps(drive.wheels, windows, TIMING, slopes=False)
        count = np.diff(cut.offsets)
        place = np.arange(count.max()) < count[:, None]
        self.left, self.right = np.zeros(place.shape), np.zeros(place.shape)
        self.left[place], self.right[place] = cut.distance.T
        self.measured = windows.motion
        self.buffers = np.empty((5, *place.shape))
        yaw = np.c_[self.left.sum(axis=1), self.right.sum(axis=1)] @ TRUTH.matrix()[2]
        self.calls = 0
        self.turns = 2.0 * np.pi * np.round((yaw - self.measured[:, 2]) / (2.0 * np.pi))

    def __call__(self, theta: FloatArray) -> FloatArray:
        """Residuals (3 k,)."""
        self.calls += 1
        A = TRUTH.with_theta(theta).matrix()
        turn, heading, cos, forward, work = self.buffers
        np.multiply(self.left, A[2, 0], out=turn)
        turn += np.multiply(self.right, A[2, 1], out=work)
        np.cumsum(turn, axis=1, out=heading)
        yaw = heading[:, -1].copy()
        heading -= np.multiply(turn, 0.5, out=work)
        np.cos(heading, out=cos)
        sin = np.sin(heading, out=heading)
        chord = np.square(turn, out=turn)  # 1 - (turn / 2)^2 / 6: the chord of a step over its arc
        chord *= -1.0 / 24.0
        chord += 1.0
        cos *= chord
        sin *= chord
        np.multiply(self.left, A[0, 0], out=forward)
        forward += np.multiply(self.right, A[0, 1], out=work)
        sideways = np.multiply(self.left, A[1, 0], out=turn)
        sideways += np.multiply(self.right, A[1, 1], out=work)
        x = np.einsum("ki,ki->k", cos, forward) - np.einsum("ki,ki->k", sin, sideways)
        y = np.einsum("ki,ki->k", sin, forward) + np.einsum("ki,ki->k", cos, sideways)
        return np.concatenate(
            [x - self.measured[:, 0], y - self.measured[:, 1], yaw - self.measured[:, 2] - self.turns]
        )


@dataclass(frozen=True)
class FitComparison:
    """Ours and SciPy's fit of the same cost from the same start."""

    ours: float
    prepared: float  # ours without cutting the log
    scipy: float
    method: str  # of SciPy, the faster one
    residual: float
    evaluations: int  # of SciPy's residual
    iterations: int  # ours, on all samples
    cost_difference: float  # relative


def compare_fits(drive: Drive, windows: Windows, repeats: int) -> FitComparison:
    """Ours includes cutting the log; SciPy is given the steps."""
    start, bounds = Icr.nominal(drive.vehicle), Icr.bounds(drive.vehicle)
    residual = NumpyResidual(drive, windows)

    def scipy(method: str) -> float:
        residual.calls = 0
        return float(2.0 * scipy_least_squares(residual, start.theta, jac="2-point", method=method).cost)

    def ours() -> PlainFit:
        return fit_squares(steps(drive.wheels, windows, TIMING, slopes=False), windows, start, bounds)

    cut = steps(drive.wheels, windows, TIMING, slopes=False)
    times = {method: timed(lambda m=method: scipy(m), 3) for method in ("trf", "lm")}
    method = min(times, key=lambda m: times[m])
    found = ours()
    assert found.converged
    scipy_cost = scipy(method)
    evaluations = residual.calls
    return FitComparison(
        timed(ours, repeats),
        timed(lambda: fit_squares(cut, windows, start, bounds), repeats),
        times[method],
        method,
        timed(lambda: residual(start.theta), repeats),
        evaluations,
        found.iterations,
        abs(scipy_cost / found.cost - 1.0),
    )


# --- one evaluation against reading


@dataclass(frozen=True)
class Evaluation:
    """Cost, gradient and Gauss-Newton matrix against the sum of the same numbers."""

    memory: float
    memory_sum: float
    cache: float
    cache_sum: float


def compare_evaluation(drive: Drive, windows: Windows, repeats: int) -> Evaluation:
    """From memory (copies read in turn) and from the cache (always the same copy)."""
    cut = steps(drive.wheels, windows, TIMING, slopes=False)
    tiles = Squares.of(cut, windows, TRUTH).tiles
    assert tiles is not None
    A = TRUTH.matrix()
    copies = itertools.cycle([tiles.rows.copy() for _ in range(COPIES)])

    def evaluate(rows: FloatArray) -> object:
        return kernels.squares(A, rows, tiles.starts, tiles.total, tiles.measured)

    return Evaluation(
        timed(lambda: evaluate(next(copies)), repeats),
        timed(lambda: np.sum(next(copies)), repeats),
        timed(lambda: evaluate(tiles.rows), repeats),
        timed(lambda: np.sum(tiles.rows), repeats),
    )


# --- the rest


def robust_fit(drive: Drive, windows: Windows) -> tuple[float, Fit]:
    """Seconds of the full fit, and what it found."""
    start = time.process_time()
    found = fit(Icr.nominal(drive.vehicle), [drive], [windows])
    return time.process_time() - start, found


def genetic(drive: Drive, windows: Windows, repeats: int) -> tuple[float, float]:
    """Seconds of the whole search, 100 chromosomes and 200 generations, and of the moments alone, log to sums."""
    start, bounds = Icr.nominal(drive.vehicle), Icr.bounds(drive.vehicle)

    def gather() -> object:
        return moments(steps(drive.wheels, windows, TIMING, slopes=False), windows, start, bounds)

    def whole() -> object:
        return search(gather(), start, bounds, GeneticOptions(population=100, generations=200))

    return timed(whole, repeats), timed(gather, repeats)


def stages(drive: Drive, windows: Windows, repeats: int) -> dict[str, float]:
    """What one iteration of the robust fit needs of the samples."""
    cut = steps(drive.wheels, windows, TIMING)
    return {
        "cut the log, no lag (`windows.steps`)": timed(lambda: steps(drive.wheels, windows, Timing(0.0137)), repeats),
        "cut the log behind a lag": timed(lambda: steps(drive.wheels, windows, TIMING), repeats),
        "motions and derivatives (`windows.linearize`)": timed(lambda: linearize(TRUTH, cut), repeats),
        "log to motions (`windows.predict`)": timed(lambda: predict(TRUTH, drive.wheels, windows, TIMING), repeats),
    }


def increments(drive: Drive) -> Windows:
    """The segments: between neighbouring reference poses."""
    return increment_windows(drive)
