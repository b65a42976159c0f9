"""Claims of the papers' texts, counted by hand, and the lists of what each paper prints."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skidsteer.reproduce import (
    giannoccaro2015,
    giannoccaro2015_claims,
    huskic2017,
    mandow2007_printed,
    thalmann_example,
    wang2015,
    wang_simulated,
)
from skidsteer.reproduce.rows import Row

DOCUMENT = Path(__file__).parents[1] / "docs" / "reproduction.md"
PRINTED = {
    "mandow2007": (mandow2007_printed.PLACES, ("I", "II", "III"), 6),
    "wang2015": (wang2015.PLACES, "1234", 16),
    "giannoccaro2015": (giannoccaro2015_claims.PLACES, "12345", 11),
    "thalmann2016": (thalmann_example.PLACES, "1", 13),
    "huskic2017": (huskic2017.PLACES, "", 7),
}


@pytest.mark.parametrize("paper", PRINTED)
def test_every_table_and_figure_of_a_paper_is_listed(paper: str) -> None:
    places, tables, figures = PRINTED[paper]
    expected = [*(f"Table {n}" for n in tables), *(f"Fig. {n}" for n in range(1, figures + 1))]
    assert [place.name for place in places] == expected
    assert all(place.shows for place in places)


@pytest.fixture(scope="module")
def rover() -> dict[str, Row]:
    return {row.what: row for row in giannoccaro2015_claims.rows()}


def test_giannoccaro_by_hand(rover: dict[str, Row]) -> None:
    """Steps 325, 219, 102, 190 of Table 1; outdoors 5800 < 7239, 2163 < 2345, 687 > 644, 496 > 464, 387 > 364."""
    assert rover["largest over smallest step of the differences, Table 1"].ours == pytest.approx(325.0 / 102.0)
    left = rover["sets with the smaller radius to the left, outdoors, Table 2"]
    assert (left.ours, left.verdict) == (2.0, "cannot be reproduced")
    assert "3, 4, 5" in left.reason
    rises = rover["steps from set to set in which the slip rises, Table 4"]
    assert (rises.paper, rises.ours) == (20.0, 14.0)
    assert rises.reason.count(" after ") == 6
    assert rover["sets with less slip on the football pitch than indoors, Table 4"].ours == 3.0
    assert rover["K_s that it settles to, football, Table 5"].ours == pytest.approx((3.41 + 3.29 + 3.44) / 3.0)


def test_the_chord_of_giannoccaro(rover: dict[str, Row]) -> None:
    """On the unit circle 2 sin^2(a / 2) = 1 - cos a, so that l^2 / 2 x = 1 at any angle."""
    row = rover["R [m] of an arc of 1 m and 0.5 rad by Eq. (16), Fig. 4"]
    assert row.verdict == "reproduced"
    sagitta = 1.0 - np.cos(0.25)
    assert f"{(2.0 * np.sin(0.25)) ** 2 / (2.0 * sagitta):.2f} m" in row.reason


def test_the_radii_are_drawn_as_printed() -> None:
    figure = giannoccaro2015_claims.radius_figure()
    assert_allclose(figure.curves[0].x, [0.222, 0.547, 0.766, 0.868, 1.058])
    assert_allclose(figure.curves[2].y, [3.548, 1.730, 0.745, 0.563, 0.442])


def test_chi_of_wangs_example_path() -> None:
    """Its rim speeds have lambda -7, -3, -2, -1, -5, -11."""
    proposed, constant = wang_simulated._chi_figure().curves
    ratios = np.array([7.0, 3.0, 2.0, 1.0, 5.0, 11.0])
    assert_allclose(proposed.y[::2], 1.0 + 0.4728 / (1.0 + 0.0538 * np.sqrt(ratios)))
    assert_allclose(proposed.x, [0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6])
    assert_allclose(constant.y, 1.5)


def test_one_run_of_wang() -> None:
    place, velocity = wang_simulated._one_run_figures()
    x, y, heading = place.curves
    speed, rate = velocity.curves
    steady = (speed.x > 1.2) & (speed.x < 2.8)
    assert speed.y[steady].mean() == pytest.approx(0.25, abs=0.01)
    assert rate.y[steady].mean() == pytest.approx(0.25 / 0.475, rel=0.05)
    assert heading.y[-1] - heading.y[0] == pytest.approx(wang_simulated.TURNED, abs=0.1)
    assert np.hypot(np.diff(x.y), np.diff(y.y)).max() < 0.02


def test_thalmanns_example_shows_what_the_text_says() -> None:
    """The basic model excludes good samples while it accelerates; on the difference the repeated one stands alone."""
    figures = {figure.name: figure for figure in thalmann_example.figures()}
    assert list(figures) == ["figure-7", "figure-8", "figure-9", "figure-10"]
    basic, alternative, limit = figures["figure-10"].curves
    good = (basic.x > 1.7) & (basic.x < 2.3)
    assert (basic.y[good] > limit.y[0]).all()
    assert (alternative.y[good] < limit.y[0]).all()
    peak = float(alternative.x[np.argmax(alternative.y)])
    assert peak == pytest.approx(thalmann_example.REPEATED, abs=0.1)
    assert alternative.y.max() > limit.y[0]
    assert np.abs(figures["figure-9"].curves[1].y).max() < np.abs(figures["figure-9"].curves[0].y).max()
    wheels = thalmann_example.straight_run()
    assert (np.diff(wheels.values[20:30], axis=0) == 0.0).sum() == 1


def committed(paper: str) -> dict[str, tuple[list[float], str]]:
    """Rows of a chapter of the document: what it is about, the numbers, the verdict."""
    if not DOCUMENT.is_file():
        pytest.skip("no documentation beside an installed package")
    (chapter,) = re.findall(
        rf"^## {paper}$(.*?)(?=^## |\Z)", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    cells = [re.split(r"(?<!\\) \| ", line[2:]) for line in chapter.splitlines() if line.startswith("| ")]
    return {
        row[0].replace("\\|", "|"): ([float(c) if c != "-" else np.nan for c in row[1:4]], row[4])
        for row in cells
        if len(row) == 6 and row[1] != "paper"
    }


@pytest.mark.parametrize(
    ("paper", "rows"),
    [
        ("mandow2007", mandow2007_printed.rows()),
        ("giannoccaro2015", (*giannoccaro2015.rows(), *giannoccaro2015_claims.rows())),
        ("wang2015", wang2015.rows()),
    ],
)
def test_the_committed_document_is_that_of_a_fresh_run(paper: str, rows: tuple[Row, ...]) -> None:
    there = committed(paper)
    assert len(rows) > 20
    for row in rows:
        numbers, verdict = there[row.what]
        assert verdict == row.verdict, row.what
        assert_allclose(numbers, [row.paper, row.ours, row.difference], rtol=6e-4, atol=1e-12, err_msg=row.what)
