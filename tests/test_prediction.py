"""Predicted end poses: what turns are off by, and regions that hold the share they claim."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import binom

from skidsteer.drive import Series
from skidsteer.models import Icr
from skidsteer.noise import Noise, paths_between
from skidsteer.prediction import (
    LEAST_TOLD,
    Distances,
    Regions,
    Uncertainty,
    distances,
    fit_regions,
    fit_turning,
    forecast,
    motion_covariance,
    turn_effect,
)
from skidsteer.se2 import FloatArray, between, chain, compose, exp, log
from skidsteer.windows import Timing, Windows, predict

MODEL = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)
NOISE = Noise(position=0.004, yaw=0.003, stamp=1e-4, walk=0.01, turn=0.01)
KNOWN = Uncertainty(NOISE, np.zeros((7, 7)))
LENGTH = 2.0


def test_turn_effect_against_differences() -> None:
    twist = np.array([[0.5, 0.1, 0.8], [-0.3, 0.05, -1.9], [0.4, 0.0, 0.0], [0.2, -0.1, 1e-5], [0.0, 0.0, 1.2]])
    motion, step = exp(twist), 1e-6
    more, less = (exp(twist * [1.0, 1.0, 1.0 + sign * step]) for sign in (1.0, -1.0))
    expected = (log(between(motion, more)) - log(between(motion, less))) / (2.0 * step)
    assert_allclose(turn_effect(motion), expected, atol=1e-8)


def test_turn_effect_by_hand() -> None:
    """A quarter turn to the left with radius 1: the chord turns, and the yaw of the end by its own size."""
    quarter = 0.5 * np.pi
    effect = turn_effect(np.array([[1.0, 1.0, quarter]]))
    # the start lies at (-1, 1) seen from the end; the twist rolls pi / 2 ahead
    assert_allclose(effect, [[quarter - 1.0, 1.0, quarter]], atol=1e-12)


def rims(seed: int, count: int) -> Series:
    """Straights, curves and turns on the spot of two seconds each."""
    rng = np.random.default_rng(seed)
    v, omega = rng.uniform(-0.2, 0.6, count), rng.uniform(-1.2, 1.2, count) * (rng.random(count) > 0.3)
    speeds = np.column_stack([v - 0.3 * omega, v + 0.3 * omega])
    return Series(LENGTH * np.arange(count + 1), np.vstack([speeds, speeds[-1:]]), "wheels")


def driven(seed: int, count: int, turning: float, dof: float | None = None) -> tuple[Series, Windows]:
    """Windows that end where a robot with known errors ended: lasting ones of its turns, noise, and heavy tails."""
    wheels, rng = rims(seed, count), np.random.default_rng(1000 + seed)
    windows = Windows(wheels.t[:-1], wheels.t[1:], np.zeros((count, 3)), np.zeros(count, bool))
    expected = predict(MODEL, wheels, windows, Timing())
    paths = paths_between(wheels, wheels.t)
    tail = np.ones(count) if dof is None else np.sqrt(dof / rng.chisquare(dof, count))
    off = 1.0 + turning * tail * rng.standard_normal(count)
    moved = exp(log(expected) * np.column_stack([np.ones(count), np.ones(count), off]))
    noise = np.linalg.cholesky(motion_covariance(expected, paths, NOISE)) @ rng.standard_normal((count, 3, 1))
    spread = np.array([NOISE.position, NOISE.position, NOISE.yaw])
    seen = [tail[:, None] * spread * rng.standard_normal((count, 3)) for _ in range(2)]
    moved = compose(moved, exp(tail[:, None] * noise[..., 0]))
    measured = between(exp(seen[0]), compose(moved, exp(seen[1])))
    return wheels, replace(windows, motion=measured)


@functools.cache
def found(seed: int, count: int = 300, turning: float = 0.0, dof: float | None = None) -> Distances:
    wheels, windows = driven(seed, count, turning, dof)
    return distances(MODEL, wheels, windows, Timing(), KNOWN)


def test_distances_are_chi_square_where_noise_is_all() -> None:
    squared = found(0, 3000).squared
    assert squared.mean() == pytest.approx(3.0, abs=0.15)
    assert np.mean(squared > 7.81) == pytest.approx(0.05, abs=0.012)


def test_allowing_is_the_larger_covariance() -> None:
    """Against the covariance with the turn's part written out, and NaN stays NaN."""
    C = np.array([[0.04, 0.01, 0.02], [0.01, 0.09, -0.01], [0.02, -0.01, 0.16]])
    e, g = np.array([0.3, -0.2, 0.5]), np.array([-0.1, 0.4, 1.1])
    solved = np.linalg.solve(C, np.column_stack([e, g]))
    one = Distances(np.array([e @ solved[:, 0], np.nan]), np.full(2, g @ solved[:, 0]), np.full(2, g @ solved[:, 1]))
    expected = e @ np.linalg.solve(C + 0.3**2 * np.outer(g, g), e)
    assert_allclose(one.allowing(0.3), [expected, np.nan])
    assert_allclose(one.allowing(0.0), one.squared)
    assert len(one.told().squared) == 1


@pytest.mark.parametrize("sees", ["position", "turn"])
def test_a_reference_without_heading_tells_no_distance(sees: str) -> None:
    wheels, windows = driven(0, 20, 0.0)
    blind = Windows(windows.start, windows.end, windows.motion, windows.joined, sees)  # type: ignore[arg-type]
    off = distances(MODEL, wheels, blind, Timing(), KNOWN)
    assert np.isnan([off.squared, off.score, off.information]).all()
    assert fit_regions(off) is None


# Regions

CASES = {"noise alone": (0.0, None), "turns off by 8 %": (0.08, None), "and heavy tails": (0.05, 4.0)}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("share", [0.68, 0.95])
def test_regions_hold_the_share_they_claim(name: str, share: float) -> None:
    """Fitted to 300 end poses and judged on 300 others, 20 times: the share lies in its binomial band.

    The quantiles of what was fitted scatter as much as what is judged, so that the variance doubles.
    """
    hits, count = 0.0, 0
    for seed in range(20):
        regions = fit_regions(found(seed, 300, *CASES[name]))
        assert regions is not None
        hits += 300 * regions.coverage(found(100 + seed, 300, *CASES[name]), share)
        count += 300
    low, high = binom.ppf([0.0005, 0.9995], count // 2, share) / (count // 2)
    assert low <= hits / count <= high


def test_regions_of_turns_that_are_off_hold_in_turns_and_straight_on() -> None:
    """One factor for all would claim too much straight on and too little in turns."""
    regions = fit_regions(found(0, 3000, 0.08))
    assert regions is not None
    judged = found(1, 3000, 0.08)
    wheels = rims(1, 3000)
    turns = np.abs(np.diff(wheels.values[:-1])[:, 0]) > 0.3
    for some in (turns, ~turns):
        part = Distances(judged.squared[some], judged.score[some], judged.information[some])
        assert regions.coverage(part, 0.68) == pytest.approx(0.68, abs=0.05)
    plain = Distances(judged.squared, 0.0 * judged.score, judged.information)
    single = fit_regions(replace(found(0, 3000, 0.08), score=np.zeros(3000)))
    assert single is not None
    shares = [
        single.coverage(Distances(plain.squared[some], plain.score[some], plain.information[some]), 0.68)
        for some in (turns, ~turns)
    ]
    assert shares[0] < 0.6
    assert shares[1] > 0.68 + 0.05  # more than the 68 % above may differ by


@pytest.mark.parametrize(("turning", "dof"), [(0.03, None), (0.08, None), (0.08, 4.0)])
def test_what_turns_are_off_by_is_found(turning: float, dof: float | None) -> None:
    told = [fit_turning(found(seed, 300, turning, dof)) for seed in range(10)]
    assert np.mean(told) == pytest.approx(turning, rel=0.15)
    assert_allclose(told, turning, rtol=0.4)


def test_turns_that_are_right_are_hardly_ever_found_off() -> None:
    """A test at 5 % finds one in twenty; what it finds is small."""
    told = np.array([fit_turning(found(seed)) for seed in range(40)])
    assert (told > 0.0).sum() <= binom.ppf(0.999, 40, 0.05)
    assert told.max() < 0.02


def test_scale_and_tail_are_those_of_the_errors() -> None:
    heavy = fit_regions(found(5, 3000, 0.0, 4.0))
    gauss = fit_regions(found(5, 3000))
    assert heavy is not None
    assert gauss is not None
    assert heavy.dof == pytest.approx(4.0, rel=0.35)
    assert heavy.scale == pytest.approx(1.0, abs=0.15)
    assert gauss.dof > 20.0
    assert gauss.scale == pytest.approx(1.0, abs=0.1)


def test_too_few_end_poses_tell_no_regions() -> None:
    few = found(0)
    cut = slice(0, LEAST_TOLD - 1)
    assert fit_regions(Distances(few.squared[cut], few.score[cut], few.information[cut])) is None
    assert np.isnan(Regions(1.0, 5.0).coverage(Distances(*np.full((3, 4), np.nan)), 0.68))


# Forecasts


def test_turns_that_are_off_add_up_with_the_angle() -> None:
    """Against the same model with its yaw rate off by a share all along; the random walk grows with the root only."""
    wheels = Series(np.arange(41.0), np.tile([0.2, 0.5], (41, 1)), "wheels")
    t = np.linspace(0.0, 40.0, 401)
    plain, lasting = (forecast(MODEL, wheels, t, 0.0, KNOWN, turning) for turning in (0.0, 0.03))
    assert_allclose(plain.of_turns, 0.0)
    assert_allclose(lasting.of_parameters + lasting.of_motion, plain.covariances)
    yaw = np.sqrt(lasting.of_turns[:, 2, 2])
    assert_allclose(yaw, 0.03 * np.abs(lasting.path.values[:, 2]), atol=1e-12)
    assert plain.covariances[-1, 2, 2] == pytest.approx(4.0 * plain.covariances[100, 2, 2], rel=1e-6)
    windows = Windows(t[:-1], t[1:], np.zeros((400, 3)), np.ones(400, bool))
    step = log(predict(MODEL, wheels, windows, Timing()))
    ends = [chain(exp(step * [1.0, 1.0, 1.0 + sign * 1e-6]))[-1] for sign in (1.0, -1.0)]
    effect = _in_frame(lasting.path.values[-1], (ends[0] - ends[1]) / 2e-6)
    assert_allclose(lasting.of_turns[-1], 0.03**2 * np.outer(effect, effect), rtol=1e-4, atol=1e-9)


def _in_frame(pose: FloatArray, change: FloatArray) -> FloatArray:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ change
