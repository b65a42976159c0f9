"""The binary genetic search on a simulated drive like Mandow's, and its parts."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import ArrayLike

from skidsteer import se2
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.identify import genetic
from skidsteer.identify.genetic import GeneticOptions, Grid, Shortfall, grid_optimum, measure_shortfall, search
from skidsteer.identify.least_squares import fit
from skidsteer.identify.moments import Moments, drive_moments, fit_squares
from skidsteer.models import Differential, Icr, Linear, MatrixModel, Model, SymmetricIcr
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Timing, increment_windows

VEHICLE = Vehicle("Pioneer P3-AT", track_width=0.4, wheel_radius=0.11)
TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)  # Mandow 2007, Table I, asphalt, 20 psi
BOUNDS = Icr.bounds(VEHICLE)
TICK = 0.001 / 138.0  # [m] one count of the encoder


def make_drive(seed: int, duration: float = 300.0) -> Drive:
    """Five minutes of varied driving: encoders every 10 ms, a reference at 5 Hz with 1 cm and 0.5 deg of noise."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(round(100 * duration) + 1)
    knots = np.arange(0.0, duration + 2.0, 2.0)
    forward, turning = (np.interp(t[:-1], knots, rng.uniform(-1.0, 1.0, len(knots))) for _ in range(2))
    speeds = np.clip(
        np.stack([0.25 + 0.35 * forward - 0.3 * turning, 0.25 + 0.35 * forward + 0.3 * turning], 1), -0.69, 0.69
    )
    counts = np.floor(np.cumsum(0.01 * speeds, axis=0) / TICK)
    recorded = 100.0 * TICK * np.diff(counts, axis=0, prepend=0.0)
    poses = se2.chain(se2.exp(0.01 * speeds @ TRUTH.matrix().T))[::20]
    poses = poses + [0.01, 0.01, np.radians(0.5)] * rng.standard_normal(poses.shape)
    wheels = Series(t, np.concatenate([recorded, recorded[-1:]]), "wheels")
    return Drive("simulated", VEHICLE, wheels, pose=Series(t[::20], poses, "pose"))


@pytest.fixture(scope="module")
def drive() -> Drive:
    return make_drive(0)


@pytest.fixture(scope="module")
def total(drive: Drive) -> Moments:
    return drive_moments(drive, Icr.nominal(VEHICLE), BOUNDS)


def test_search_reaches_the_grid_optimum_within_a_percent(total: Moments) -> None:
    """Twelve seeds; the steps of the grid cost less than the noise."""
    for seed in range(12):
        result = search(total, Icr.nominal(VEHICLE), BOUNDS, GeneticOptions(seed=seed))
        loss = measure_shortfall(result, total, BOUNDS)
        assert 0.0 <= loss.search < 0.01, seed
        assert 0.0 <= loss.grid < 0.01
        assert_allclose(result.model.theta, TRUTH.theta, atol=6.0 * float(result.resolution.max()))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_search_holds_on_other_drives(seed: int) -> None:
    total = drive_moments(make_drive(seed), Icr.nominal(VEHICLE), BOUNDS)
    for options in (GeneticOptions(seed=seed), GeneticOptions(seed=seed + 10)):
        loss = measure_shortfall(search(total, Icr.nominal(VEHICLE), BOUNDS, options), total, BOUNDS)
        assert 0.0 <= loss.search < 0.01


def test_search_is_decided_by_the_seed(total: Moments) -> None:
    options = GeneticOptions(population=20, generations=10, seed=3)
    one, other = (search(total, Icr.nominal(VEHICLE), BOUNDS, options) for _ in range(2))
    assert one.model == other.model
    assert_array_equal(one.history, other.history)
    assert search(total, Icr.nominal(VEHICLE), BOUNDS, replace(options, seed=4)).model != one.model


def test_result_tells_what_was_done(total: Moments) -> None:
    options = GeneticOptions(population=30, generations=20, elite=0)
    result = search(total, Icr.nominal(VEHICLE), BOUNDS, options)
    assert result.history.shape == (21,)
    assert (np.diff(result.history) <= 0.0).all()
    assert result.history[0] > result.history[-1] == result.cost
    assert_allclose(result.cost, total.cost(result.model.matrix()), rtol=1e-12)
    assert 30 < result.evaluations <= 21 * 30
    assert_allclose(result.resolution, (BOUNDS[:, 1] - BOUNDS[:, 0]) / 255.0)
    on_grid = (result.model.theta - BOUNDS[:, 0]) / result.resolution
    assert_allclose(on_grid, np.rint(on_grid), atol=1e-9)


def test_no_generations_leave_the_best_of_the_first(total: Moments) -> None:
    result = search(total, Icr.nominal(VEHICLE), BOUNDS, GeneticOptions(population=10, generations=0))
    assert result.history.shape == (1,)
    assert result.evaluations == 10


def exhaustive(total: Moments, start: MatrixModel, bounds: FloatArray, bits: int) -> float:
    """The least cost of all points of the grid."""
    axes = [np.linspace(lower, upper, 2**bits) for lower, upper in bounds]
    return min(float(total.cost(start.with_theta(theta).matrix())) for theta in itertools.product(*axes))


@pytest.mark.parametrize("bits", [1, 4, 6])
@pytest.mark.parametrize("gray", [True, False])
def test_search_and_grid_optimum_agree_with_trying_all(drive: Drive, bits: int, gray: bool) -> None:
    start, bounds = SymmetricIcr.nominal(VEHICLE), SymmetricIcr.bounds(VEHICLE)
    total = drive_moments(drive, start, bounds)
    best = exhaustive(total, start, bounds, bits)
    around = grid_optimum(total, fit_squares(total, start, bounds).model, bounds, bits)
    assert_allclose(around.cost, best, rtol=1e-9)
    assert_allclose(total.cost(around.model.matrix()), around.cost, rtol=1e-9)
    result = search(total, start, bounds, GeneticOptions(bits=bits, gray=gray))
    assert_allclose(result.cost, best, rtol=1e-9 if gray else 0.1)


def test_grid_optimum_walks_to_it(total: Moments) -> None:
    from_optimum = grid_optimum(total, fit_squares(total, TRUTH, BOUNDS).model, BOUNDS)
    from_afar = grid_optimum(total, TRUTH.with_theta(TRUTH.theta + 6.0 * Grid(BOUNDS, 8).resolution), BOUNDS)
    assert from_afar.moves >= 3
    assert from_optimum.moves <= 2
    assert_allclose(from_afar.cost, from_optimum.cost, rtol=2e-3)


def test_linear_model_is_searched_too(drive: Drive) -> None:
    start, bounds = Linear.nominal(VEHICLE), Linear.bounds(VEHICLE)
    total = drive_moments(drive, start, bounds)
    result = search(total, start, bounds)
    assert isinstance(result.model, Linear)
    assert measure_shortfall(result, total, bounds).search < 0.01


def test_a_model_without_parameters_is_refused(drive: Drive) -> None:
    start, bounds = Differential.nominal(VEHICLE), Differential.bounds(VEHICLE)
    with pytest.raises(RequestError, match="'differential' has no parameters to search for"):
        search(drive_moments(drive, start, bounds), start, bounds)


def test_several_drives_are_one_search(drive: Drive, total: Moments) -> None:
    other = make_drive(5, duration=60.0)
    drives = [drive, other]
    options = GeneticOptions(population=30, generations=30)
    cuts, timings = [increment_windows(d) for d in drives], [Timing(), Timing(0.02)]
    result, loss = genetic.search_drives(Icr.nominal(VEHICLE), drives, cuts, timings, options)
    both = total + drive_moments(other, Icr.nominal(VEHICLE), BOUNDS, Timing(0.02))
    expected = search(both, Icr.nominal(VEHICLE), BOUNDS, options)
    assert result.model == expected.model
    assert loss == measure_shortfall(expected, both, BOUNDS)
    narrow = np.stack([TRUTH.theta - 0.02, TRUTH.theta + 0.02], axis=1)
    inside, _ = genetic.search_drives(TRUTH, drives, cuts, timings, options, narrow)
    assert (np.abs(inside.model.theta - TRUTH.theta) <= 0.02 + 1e-12).all()
    with pytest.raises(RequestError, match="no drive"):
        genetic.search_drives(TRUTH, [], [], [])


def test_shortfall_by_hand() -> None:
    loss = Shortfall(genetic_cost=1.2, grid_cost=1.0, squares_cost=0.8)
    assert_allclose([loss.search, loss.grid], [0.2, 0.25])
    perfect = Shortfall(0.0, 0.0, -1e-16)
    assert perfect.search == 0.0
    assert perfect.grid == np.inf


def test_chromosomes_by_hand() -> None:
    """Genes of 3 bits: 110 is 6 in plain binary; in Gray code 110 follows 010 (3) and stands for 4."""
    chromosome = np.array([[1, 1, 0, 0, 0, 1]], dtype=bool)
    assert_array_equal(genetic._decode(chromosome, GeneticOptions(bits=3, gray=False)), [[6, 1]])
    assert_array_equal(genetic._decode(chromosome, GeneticOptions(bits=3, gray=True)), [[4, 1]])


@pytest.mark.parametrize("gray", [True, False])
def test_chromosomes_stand_for_every_level_once(gray: bool) -> None:
    words = np.array(list(itertools.product([False, True], repeat=6)))
    level = genetic._decode(words, GeneticOptions(bits=6, gray=gray))[:, 0]
    assert sorted(level) == list(range(64))
    changes = (words[np.argsort(level)][1:] != words[np.argsort(level)][:-1]).sum(axis=1)
    assert changes.max() == (1 if gray else 6)


@given(st.integers(1, 32), st.data())
def test_levels_of_the_grid_come_back(bits: int, data: st.DataObject) -> None:
    grid = Grid(BOUNDS, bits)
    level = np.array(data.draw(st.lists(st.integers(0, 2**bits - 1), min_size=5, max_size=5)))
    assert_array_equal(grid.nearest(grid.theta(level)), level)
    assert_allclose(grid.theta(np.zeros(5, int)), BOUNDS[:, 0])
    assert_allclose(grid.theta(np.full(5, 2**bits - 1)), BOUNDS[:, 1])
    outside = grid.nearest(BOUNDS[:, 1] + 1.0)
    assert_array_equal(outside, np.full(5, 2**bits - 1))


def breed(options: GeneticOptions, seed: int = 0) -> tuple[genetic.Bits, genetic.Bits, FloatArray]:
    rng = np.random.default_rng(seed)
    population, cost = rng.random((options.population, 16)) < 0.5, rng.random(options.population)
    return population, genetic._breed(population, cost, options, rng), cost


@given(st.integers(0, 1000), st.integers(2, 12), st.integers(0, 1))
def test_children_without_mutation_or_crossover_are_their_parents(seed: int, size: int, elite: int) -> None:
    options = GeneticOptions(population=size, elite=elite, crossover=0.0, mutation=0.0)
    population, children, cost = breed(options, seed)
    assert children.shape == population.shape
    assert {row.tobytes() for row in children} <= {row.tobytes() for row in population}
    if elite:
        assert_array_equal(children[0], population[np.argmin(cost)])


def test_tournaments_prefer_the_better() -> None:
    options = GeneticOptions(population=400, elite=0, crossover=0.0, mutation=0.0, tournament=2)
    population, children, cost = breed(options)
    value = {row.tobytes(): c for row, c in zip(population, cost, strict=True)}
    mean = float(np.mean([value[row.tobytes()] for row in children]))
    assert_allclose(mean, 1.0 / 3.0, atol=0.05)  # the better of two uniform numbers


def test_crossover_swaps_what_lies_between_two_points() -> None:
    options = GeneticOptions(population=2, elite=0, crossover=1.0, mutation=0.0)
    seen = set()
    for seed in range(200):
        rng = np.random.default_rng(seed)
        one, other = genetic._breed(np.array([[False] * 8, [True] * 8]), np.zeros(2), options, rng)
        if (one != other).all():  # parents of both kinds
            seen.add(int(np.count_nonzero(np.diff(one.astype(int)))))
    assert seen == {0, 1, 2}


def test_mutation_flips_its_share_of_bits() -> None:
    options = GeneticOptions(population=500, elite=0, crossover=0.0, mutation=0.1)
    rng = np.random.default_rng(0)
    children = genetic._breed(np.zeros((500, 40), dtype=bool), np.zeros(500), options, rng)
    assert_allclose(children.mean(), 0.1, atol=0.01)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"bits": 0}, "bits must lie in 1..32, got 0"),
        ({"population": 1}, "population must be at least 2, got 1"),
        ({"generations": -1}, "generations must be at least 0"),
        ({"elite": 100}, "elite must be below population = 100, got 100"),
        ({"tournament": 0}, "tournament must be at least 1"),
        ({"crossover": 1.5}, r"crossover must lie in 0..1, got 1.5"),
        ({"mutation": float("nan")}, "mutation must lie in 0..1, got nan"),
        ({"seed": -1}, "seed must be at least 0"),
    ],
)
def test_options_are_checked(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GeneticOptions(**wrong)  # type: ignore[arg-type]


def test_the_result_takes_the_place_of_a_fit(drive: Drive) -> None:
    windows = increment_windows(drive)
    found = fit(Icr.nominal(VEHICLE), [drive], [windows])
    put, note = genetic.genetic_fit(found, [drive], [windows])
    result, loss = genetic.search_drives(Icr.nominal(VEHICLE), [drive], [windows], found.timings)
    assert put.model == result.model
    assert_array_equal(put.values[:5], result.model.theta)
    assert_array_equal(put.values[5:], found.values[5:])
    assert_array_equal(put.covariance, found.covariance)
    assert note.startswith(f"genetic search: cost {100.0 * loss.search:.2g} % above the best point of its 8-bit grid")
    assert f"that {100.0 * loss.grid:.2g} % above the least squares" in note
    assert found.model != put.model  # the fit itself is left as it was


class Bent(Model):
    """A model that is not linear in the rim speeds."""

    NAME = "bent"

    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        raise NotImplementedError

    parameter_jacobian = speed_jacobian = wheel_speeds = twist


def test_models_not_linear_in_the_rim_speeds_are_refused(drive: Drive) -> None:
    windows = increment_windows(drive)
    found = replace(fit(Icr.nominal(VEHICLE), [drive], [windows]), model=Bent())
    with pytest.raises(RequestError, match="needs a model linear in the rim speeds, not 'bent'"):
        genetic.genetic_fit(found, [drive], [windows])
