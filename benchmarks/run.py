"""Measure speed and memory, and write them to docs/benchmarks.md. Run as ``make bench``.

Every figure that decides a target is measured in one run: a ratio of medians, or a median.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: all that is timed runs on one thread

import filters
import following
import processes
import speed

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"


@dataclass(frozen=True)
class Row:
    """One line of the table of targets."""

    what: str
    figure: str
    target: str
    met: bool


def main() -> None:
    options = _options()
    drive = speed.drive()
    windows = speed.increments(drive)
    fits = speed.compare_fits(drive, windows, options.repeats)
    evaluation = speed.compare_evaluation(drive, windows, 5 * options.repeats)
    genetic, gather = speed.genetic(drive, windows, options.repeats)
    seconds, robust = speed.robust_fit(drive, windows)
    stages = speed.stages(drive, windows, options.repeats)
    filtering = filters.compare(options.repeats)
    paths = following.measure(options.repeats)
    memory = {what: processes.peak_memory(what) for what in ("squares", "robust")}
    starts = processes.start_times(options.repeats)
    rows = [
        *_fit_rows(fits),
        *_evaluation_rows(evaluation),
        Row("binary genetic search 100 x 200, from the log on", _s(genetic), "1 s", genetic < 1.0),
        Row(
            "memory of the fit of the squared cost, over the samples",
            _x(memory["squares"]),
            "4",
            memory["squares"] < 4.0,
        ),
        Row("memory of the full robust fit, over the samples", _x(memory["robust"]), "4", memory["robust"] < 4.0),
        *_filter_rows(filtering),
        *_follow_rows(paths),
        Row("`skidsteer --help`", _s(starts["help"]), "0.5 s", starts["help"] < 0.5),
    ]
    more = [
        ("fit of the squared cost, ours, from the log on", _s(fits.ours)),
        ("the same, from steps already cut", _s(fits.prepared)),
        (
            f"the same by SciPy `{fits.method}`, {fits.evaluations} residuals, from steps already cut",
            _s(fits.scipy),
        ),
        ("one residual in NumPy", _s(fits.residual)),
        ("cost, gradient, Gauss-Newton matrix; samples in memory", _s(evaluation.memory)),
        ("sum of the same samples in memory", _s(evaluation.memory_sum)),
        ("moments alone, from the log on", _s(gather)),
        *((what, _s(times)) for what, times in stages.items()),
        ("a step of the same filter with filterpy", _us(filtering.filterpy)),
        *((f"a step of {name} from Python", _us(seconds)) for name, seconds in paths.steps.items()),
        *((f"a second of the loop on {name}, by huskic", _s(1.0 / ratio)) for name, ratio in paths.plants.items()),
        (
            f"full robust fit, {robust.iterations} iterations, {'' if robust.converged else 'not '}converged",
            _s(seconds),
        ),
        ("`import skidsteer`, of which Python itself " + _s(starts["python"]), _s(starts["import"])),
        ("first `skidsteer calibrate sample:p3at-lab` on a machine (compiles), processor time", _s(starts["cold"])),
        ("the same again, processor time", _s(starts["warm"])),
    ]
    text = "\n".join(_document(rows, more, fits))
    DOCUMENT.write_text(text + "\n", encoding="utf-8")
    print(text)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--repeats", type=int, default=15, help="of short measurements; of those below 10 ms, 5 times as many"
    )
    return parser.parse_args()


def _fit_rows(fits: speed.FitComparison) -> Iterator[Row]:
    ratio = fits.scipy / fits.ours
    yield Row("converged fit of the squared cost, times as fast as SciPy", _x(ratio), "30, better 100", ratio > 30.0)
    same = fits.cost_difference < 1e-9
    yield Row("difference of both converged costs, relative", f"{fits.cost_difference:.1g}", "1e-9", same)


def _evaluation_rows(evaluation: speed.Evaluation) -> Iterator[Row]:
    memory = evaluation.memory / evaluation.memory_sum
    what = "cost, gradient and Gauss-Newton matrix, over the time to read the samples"
    yield Row(f"{what} from memory", _x(memory), "3", memory < 3.0)
    cache = evaluation.cache / evaluation.cache_sum
    yield Row(f"{what} where all of them stay in the cache", _x(cache), "-", True)


def _filter_rows(times: filters.FilterTimes) -> Iterator[Row]:
    batch, ratio = times.batch, times.filterpy / times.batch
    yield Row(f"batch replay of the ICR filter, {times.states} states, a step", _us(batch), "0.5 us", batch < 0.5e-6)
    yield Row("the same, times as fast as filterpy", _x(ratio), "30", ratio > 30.0)
    apart = f"{times.difference:.1g}"
    yield Row("difference of both last states, in their sigmas", apart, "1e-3", times.difference < 1e-3)
    yield Row("one live step of it from Python (`predict`)", _us(times.live), "5 us", times.live < 5e-6)


def _follow_rows(times: following.FollowTimes) -> Iterator[Row]:
    law, step = max(times.steps.items(), key=lambda item: item[1])
    what = f"path following, the slowest law without a plan ({law}): advance, command and rim speeds from Python"
    yield Row(what, _us(step), "50 us", step < 50e-6)
    mean, late = times.plan
    what = "a step of the predictive law on grass, from Python: mean, 99 of 100 are faster than"
    yield Row(what, f"{_us(mean)}, {_us(late)}", "2 ms", late < 2e-3)
    law, ratio = min(times.loops.items(), key=lambda item: item[1])
    what = f"closed loop at 50 Hz on the kinematic plant, the slowest law without a plan ({law}), times real time"
    yield Row(what, _x(ratio), "500", ratio > 500.0)


def _document(rows: list[Row], more: list[tuple[str, str]], fits: speed.FitComparison) -> Iterator[str]:
    yield "# Benchmarks\n"
    yield "Written by `make bench` (`benchmarks/run.py`); nothing here is edited by hand.\n"
    yield from _machine()
    yield ""
    yield (
        f"Data: a simulated drive of {speed.SAMPLES:,} wheel samples at {speed.RATE:.0f} Hz, cut by a reference at 5 Hz"
        " into 50,000 segments; the five ICR parameters of Mandow 2007. Medians of repeated runs, loops compiled and"
        " caches warm.\n"
    )
    yield "| what | measured | target | met |"
    yield "|---|---|---|---|"
    for row in rows:
        met = "yes" if row.met else "**no**"
        yield f"| {row.what} | {row.figure} | {row.target} | {met if row.target != '-' else ''} |"
    yield ""
    yield "| seconds | |"
    yield "|---|---|"
    for what, figure in more:
        yield f"| {what} | {figure} |"
    yield ""
    yield from NOTES
    yield f"- Ours evaluated all samples {fits.iterations} times, after a start on one segment in 16."


NOTES = (
    "What the comparison holds:\n",
    "- Seconds are processor time of the process (system included) on one thread, so that other jobs do not count; to"
    " start is on the clock, the fastest of several.",
    "- Both fits start at the nominal model and end at the same cost, Mandow 2007, Eq. (13). Ours"
    " (`identify.squares.fit_squares`) includes cutting the wheel log at the ends of the segments, laying the samples"
    " side by side, every pass over them, and the covariance. SciPy's `least_squares` (`trf` or `lm`, whichever is"
    " faster; 2-point derivatives, default tolerances) is given the cut samples as a matrix, segments as rows, for"
    " free; its residual allocates nothing but its result and takes the chord of a step from a series.",
    "- *Reading* is `numpy.sum` over the array that the kernel reads. *From memory* means copies of it read in turn,"
    " more than the cache holds; where all stays in the cache, reading is so fast that arithmetic decides.",
    "- The filter (`odometry.icr_filter`) replays all samples with a reference at 5 Hz: the steps are cut at wheel and"
    " reference stamps, means of all states and covariances of the poses are kept. filterpy's `ExtendedKalmanFilter`"
    " makes the same steps over the first hundredth of the samples, cut beforehand for free.",
    "- Closed loops follow the lemniscate of Huskić 2017, a lap, with poses that are noisy and 60 ms late and wheels"
    " that lag by 0.1 s; every sample is recorded and judged. Best of the repetitions.",
    "- Memory is the rise of the resident set at its peak, in a process that has the drive loaded and the loops"
    " compiled, over the bytes of t, v_left and v_right (24 MB).",
    "- The robust fit keeps distance, derivative by the lag and duration of each step (40 bytes a sample), takes"
    " temporaries of the size of the distances for the length of path of each window, and holds several copies of the"
    " derivatives by eight unknowns of each window: with 20 samples a window each copy is half as large as the samples."
    " Longer windows take less.",
)


def _machine() -> Iterator[str]:
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "numba"))
    system = f"{platform.system()}, Python {platform.python_version()}"
    yield f"{_processor()}, {os.cpu_count()} cores; {system}, {packages}."


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return platform.processor() or platform.machine()
    lines = [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
    return lines[0] if lines else platform.machine()


def _s(seconds: float) -> str:
    return f"{seconds:.2f} s" if seconds >= 0.1 else f"{1e3 * seconds:.1f} ms"


def _us(seconds: float) -> str:
    return f"{1e6 * seconds:.2f} us"


def _x(ratio: float) -> str:
    return f"{ratio:.0f}" if ratio >= 10.0 else f"{ratio:.1f}"


if __name__ == "__main__":
    main()
