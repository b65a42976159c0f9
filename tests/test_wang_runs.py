from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skidsteer.errors import DataError, RequestError
from skidsteer.identify.circle_test import wang_protocol
from skidsteer.reproduce import wang_simulated
from skidsteer.reproduce.papers import reproduce
from skidsteer.reproduce.rows import VERDICTS
from skidsteer.reproduce.wang2015 import TABLE_3
from skidsteer.reproduce.wang_runs import (
    COUNT,
    EXAMPLE,
    ROBOT,
    STAND,
    TILES,
    Reckonings,
    Runs,
    reckonings,
    runs,
    watch,
)
from skidsteer.terramechanics.steady_turn import steady_turn
from skidsteer.terramechanics.terrain import TERRAINS


@pytest.fixture(scope="module")
def found() -> Runs:
    return runs()


@pytest.fixture(scope="module")
def path(found: Runs) -> Reckonings:
    return reckonings(found)


def test_counts_and_scans_tell_the_chi_of_the_plant(found: Runs) -> None:
    """Far within the paper's bound of 7 mm of y0, which is 0.035 of chi: the noise of many scans averages out."""
    assert len(found.chi) == 37
    assert np.abs(found.chi - found.steady_chi).max() < 0.004
    assert np.sqrt(np.mean((found.chi - found.steady_chi) ** 2)) < 0.0012
    assert found.scale == pytest.approx(1.0, abs=0.002)


def test_distances_are_corrected_where_the_ground_holds_the_robot_back() -> None:
    """On `lab` rolling resistance makes wheels slip on a straight; the run there tells by how much."""
    held = runs(wang_protocol()[17:19], TERRAINS["lab"])  # lambda = 3
    straight = steady_turn(ROBOT, TERRAINS["lab"], 0.3, 0.3).twist[0] / 0.3
    assert straight < 0.998
    assert held.scale == pytest.approx(straight, abs=0.0008)
    assert_allclose(held.chi, held.scale * held.steady_chi, atol=0.004)


def test_the_curve_falls_as_in_table_3(found: Runs) -> None:
    means = np.array([found.of(x).mean() for x in range(8)])
    assert_allclose(means, TABLE_3, atol=0.017)
    assert (np.diff(means) < -0.005).all()
    fit = found.fit()
    assert fit.a == pytest.approx(0.475, abs=0.02)
    assert 0.03 < fit.b < 0.08


def test_what_is_rolled_is_counted() -> None:
    seen = watch([[0.1, 0.2]], [2.0], TILES, 0)
    rolled = seen.rolled(seen.wheels.t[[0, -1]])
    assert_allclose(rolled[0], 0.0)
    assert_allclose(rolled[1], [0.2, 0.4], atol=1e-3)  # what the lag takes at first it gives back at last
    assert_allclose(rolled[1] / COUNT, np.round(rolled[1] / COUNT), atol=1e-6)
    assert seen.between(0.0, STAND).t[-1] <= STAND
    with pytest.raises(DataError, match=r"out of sight from 90\.00 to 91\.00 s"):
        seen.between(90.0, 91.0)
    with pytest.raises(RequestError, match=r"reaches 0\.69"):
        watch([[0.1, 0.8]], [2.0], TILES, 0)


def test_the_path_reckoned_by_the_curve_turns_as_the_robot_does(path: Reckonings) -> None:
    """The robot turns right by 1.55 rad; chi = 1.5 leaves 3 % of that out."""
    assert path.seen[-1, 2] - path.seen[0, 2] == pytest.approx(-1.55, abs=0.02)
    assert path.t[-1] == pytest.approx(len(EXAMPLE) + 0.5, abs=0.02)
    assert 0.04 < path.off("P3-AT")[-1, 2] < 0.06
    assert np.abs(path.off("proposed")[:, 2]).max() < 0.03
    by_factory, by_curve = path.errors("P3-AT"), path.errors("proposed")
    assert by_curve[2] < 0.5 * by_factory[2]
    assert 0.01 < path.slid < 0.03  # to the left, out of the turn
    known = {name: np.hypot(*path.errors(f"{name}, slide known")[:2]) for name in ("P3-AT", "proposed")}
    assert known["proposed"] < 0.6 * known["P3-AT"]
    assert known["proposed"] < np.hypot(*by_curve[:2])
    still = replace(path, by_model={"seen": path.seen + [0.3, 0.4, 0.5]})
    assert_allclose(still.errors("seen"), [0.4, 0.3, 0.5])  # across, along, yaw


def test_rows_stand_beside_what_was_measured(found: Runs, path: Reckonings) -> None:
    rows = {row.what: row for row in wang_simulated.rows(found, path)}
    assert "corrected" not in {row.verdict for row in rows.values()}
    assert all(row.reason for row in rows.values())
    assert all(np.isfinite([row.paper, row.ours]).all() for row in rows.values())
    assert rows["chi of the runs at lambda = 4, Table 3"].ours == pytest.approx(found.of(4.0).mean())
    assert (rows["runs that the robot can drive, Eqs. (26), (27)"].ours) == 37
    a = rows["a of Eq. (44) from the runs"]
    assert (a.paper, a.ours) == (0.4728, found.fit().a)
    assert a.reason.startswith("0.468 from Table 3")
    spot, rest = (rows[f"fall of chi from lambda {x}, Fig. 5"] for x in ("0 to 1", "1 to 7"))
    assert spot.ours > 0.09
    falls = rows["steps of lambda from 0 to 7 in which chi falls, Fig. 5"]
    assert (falls.ours, falls.verdict) == (1.0, "cannot be reproduced")
    assert rest.ours < 0.0 < rest.paper
    far = rows["largest position error of the proposed model [m], section 3.5, in the runs"]
    assert far.ours == pytest.approx(np.hypot(*path.off("proposed")[:, :2].T).max())


def test_figures_are_those_of_the_paper(found: Runs, path: Reckonings) -> None:
    figures = {figure.name: figure for figure in wang_simulated.figures(found, path)}
    assert list(figures) == [f"figure-{n}" for n in ("5", "11a", "11b", "12a", "12b", "13", "14", "15a", "15b", "16")]
    by_speed, by_ratio = ({c.label: c for c in figures[f"figure-12{x}"].curves} for x in "ab")
    assert_allclose(by_speed["0.3 m/s"].x, np.arange(8.0))
    assert_allclose(by_speed["0.5 m/s"].x, [0.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    assert_allclose(by_ratio["lambda 3"].y, found.of(3.0))
    runs_there, plant, fitted, *_ = figures["figure-13"].curves
    assert_allclose(runs_there.y, plant.y, atol=0.004)
    assert fitted.y[0] == pytest.approx(1.0 + found.fit().a)
    assert len(figures["figure-14"].curves) == 5


def test_the_paper_is_calculated_and_simulated() -> None:
    done = reproduce("wang2015")
    assert {row.verdict for row in done.rows} == set(VERDICTS)
    assert len({row.what for row in done.rows}) == len(done.rows)
    assert len(done.figures) == 10
