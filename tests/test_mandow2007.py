from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skidsteer import se2
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.models import Differential, Icr, SymmetricIcr
from skidsteer.odometry.reckoning import reckon
from skidsteer.reproduce import mandow2007, mandow2007_printed, mandow2007_trial
from skidsteer.reproduce.mandow2007_printed import ASPHALT_20, DEFAULT, SYMMETRIC, TABLE_3, TABLES
from skidsteer.reproduce.mandow2007_trial import Identified, halves, score, training_drive, validation_drive
from skidsteer.reproduce.rows import Reproduction, Row
from skidsteer.samples import sample
from skidsteer.windows import Timing


@pytest.fixture(scope="module")
def done() -> Reproduction:
    return mandow2007.reproduction()


@pytest.fixture(scope="module")
def rows(done: Reproduction) -> dict[str, Row]:
    return {row.what: row for row in done.rows}


def test_tables_agree_with_the_equations(rows: dict[str, Row]) -> None:
    indexes = [row for row in rows.values() if row.what.startswith(("chi ", "e "))]
    assert len(indexes) == 12
    assert {row.verdict for row in indexes} == {"reproduced"}
    assert rows["chi asphalt, 20 psi, Table I"].ours == pytest.approx(0.4 / (0.3071 + 0.2553))
    assert rows["e asphalt, 20 psi, Table I"].ours == pytest.approx((0.3071 - 0.2553) / (0.3071 + 0.2553))


def test_claims_of_the_text_are_counted(rows: dict[str, Row]) -> None:
    """By hand: chi 0.6949 < 0.7098, but 0.7112 > 0.7053 and 0.7612 > 0.7460."""
    asphalt = rows["kinds of tyres with a lower chi on asphalt than on concrete, Tables I and II"]
    assert (asphalt.paper, asphalt.ours, asphalt.verdict) == (3.0, 1.0, "cannot be reproduced")
    assert "holds for 50 psi only" in asphalt.reason
    assert rows["alphas closer to 1 at 50 than at 20 psi, Tables I and II"].ours == 4.0
    assert rows["grounds on which solid tyres have the highest chi, Tables I and II"].ours == 2.0
    ahead = [column[0] for table in TABLES.values() for column in table]
    assert rows["mean y_ICRv [m], Tables I and II"].ours == pytest.approx(sum(ahead) / 6.0)


def test_the_genetic_search_finds_the_printed_columns_again(rows: dict[str, Row]) -> None:
    found = [row for row in rows.values() if "genetic search" in row.reason]
    assert len(found) == 30
    assert {row.verdict for row in found} == {"not possible without the original data"}
    assert max(abs(row.ours - row.paper) for row in found) < 0.006  # a step and a half of 8 bits


def test_turn_and_straight_tests_by_hand(rows: dict[str, Row]) -> None:
    """On the spot omega = 0.3 (0.9049 + 0.9271) / 0.5624, so that (11) has 0.3 / omega; straight on v / 0.3 = alpha."""
    turn = rows["x_ICR [m] of a turn on the spot by Eq. (11), truth: Table I, 20 psi"]
    assert turn.paper == pytest.approx(0.5624 / 1.832)
    alpha = (0.3071 * 0.9271 + 0.2553 * 0.9049) / 0.5624
    assert turn.ours == pytest.approx(alpha * 0.5624 / 1.832)
    assert rows["alpha of a straight run by Eq. (12), truth: Table I, 20 psi"].ours == pytest.approx(alpha)
    assert rows["x_ICR [m] by Eqs. (11), (12), section IV.D"].ours == pytest.approx(turn.ours, abs=0.004)


def test_integers_by_hand(rows: dict[str, Row]) -> None:
    """138 / 0.91 = 151.6, as printed 125.6; 2 pi 275 times 126 or 152 over 8."""
    ticks = rows["Ticksmm of alpha = 0.91, r = 110 mm, Eq. (14)"]
    assert (ticks.paper, ticks.ours, ticks.verdict) == (126.0, 152.0, "corrected")
    whole = rows["Revcount of alpha = 0.91, x_ICR = 0.275 m, Eqs. (14), (15)"]
    assert (whole.paper, whole.ours) == (27214.0, 32830.0)
    assert "32753.7 times 8 ticks" in whole.reason  # off by the rounding of Ticksmm: 0.2 %


def test_sums_of_table_three(rows: dict[str, Row]) -> None:
    for name in TABLE_3:
        assert rows[f"J of the {name} model, Table III"].verdict == "reproduced"


def test_table_three_is_not_of_segments(rows: dict[str, Row]) -> None:
    """By Eq. (13) the default model errs hardly more than the others; along the path, as the table has it."""
    reading = rows["squared position errors, default over asymmetric model, by Eq. (13), Table III"]
    assert reading.paper == pytest.approx(31.0)
    assert reading.ours < 2.0
    assert reading.verdict == "cannot be reproduced"
    along = {name: rows[f"mean squared error of y [m^2], {name} model, Table III"].ours for name in TABLE_3}
    assert along[DEFAULT] > 5.0 * along["asymmetric"]
    assert along[SYMMETRIC] > 5.0 * along["asymmetric"]
    headings = [rows[f"mean squared error of heading [rad^2], {name} model, Table III"].ours for name in TABLE_3]
    assert np.ptp(headings) < 1e-3 * headings[0]  # that of GPS, as in the paper
    assert 0.02 < headings[0] < 0.08


def test_without_a_real_drive_it_says_so(done: Reproduction) -> None:
    (table,) = done.tables
    assert "No real drive" in table.note
    assert all(np.isnan(cells[3:]).all() for _, cells in table.lines)
    assert [figure.name for figure in done.figures] == ["figure-6"]


def test_every_place_of_the_paper_has_rows_or_a_reason(done: Reproduction) -> None:
    assert [place.name for place in done.places] == [
        *(f"Table {n}" for n in ("I", "II", "III")),
        *(f"Fig. {n}" for n in range(1, 7)),
    ]
    for place in done.places:
        assert done.rows_of(place) or done.figures_of(place) or place.not_computed
    assert len({row.what for row in done.rows}) == len(done.rows)


def test_the_columns_in_our_frame() -> None:
    assert mandow2007_printed.model_of((1.0, 2.0, -3.0, 4.0, 5.0, 0.0, 0.0)) == Icr(3.0, -2.0, 1.0, 5.0, 4.0)


def test_a_perfect_model_scores_zero_and_a_known_error_is_found() -> None:
    """The robot drives a circle; a model that is right but for a frame turned and a radius, by hand."""
    t = np.arange(0.0, 10.0, 0.01)
    wheels = Series(t, np.column_stack([np.full(1000, 0.3), np.full(1000, 0.5)]), "wheels")
    truth = SymmetricIcr(0.25, 0.9)
    at = np.arange(0, 1000, 20)
    poses = se2.compose([3.0, -1.0, 2.0], reckon(truth, wheels)[at])
    drive = Drive("circle", mandow2007_printed.P3AT, wheels, pose=Series(t[at], poses, "pose"))
    perfect = score(truth, drive, Timing())
    assert_allclose(perfect.along, 0.0, atol=1e-20)
    assert_allclose(perfect.segments, 0.0, atol=1e-20)
    assert perfect.off == pytest.approx(0.0, abs=1e-10)
    fast = score(SymmetricIcr(0.25, 1.8), drive, Timing())  # turns and goes twice as far
    turn = 0.9 * 0.2 * 0.2 / 0.5  # [rad] a segment
    radius = 0.4 * 0.5 / 0.2
    expected = [
        (radius * (np.cos(2 * turn) - np.cos(turn))) ** 2,  # to the right
        (radius * (np.sin(2 * turn) - np.sin(turn))) ** 2,  # forward
        turn**2,
    ]
    assert_allclose(fast.segments, expected, rtol=1e-6)
    assert fast.along[0] > fast.segments[0]  # the heading that has drifted turns what follows


def test_halves_meet_in_the_middle() -> None:
    drive = sample("p3at-mandow")
    first, second = halves(drive)
    assert first.span[0] == drive.span[0]
    assert second.span[1] == drive.span[1]
    assert first.span[1] == pytest.approx(0.5 * sum(drive.span), abs=0.02)
    for bad in (replace(drive, pose=None), sample("rover-4wd1")):
        with pytest.raises(RequestError, match="needs one continuous drive with reference poses"):
            halves(bad)


def test_a_drive_without_turns_on_the_spot_has_no_symmetric_model() -> None:
    drive = training_drive(ASPHALT_20, 0)
    assert mandow2007_trial._turns(drive.between(0.0, 7.0), Timing()) == (None, 0.5)
    found, pivot = mandow2007_trial._turns(drive, Timing())
    assert found is not None
    assert pivot == 0.1


def test_with_a_real_drive_the_table_has_two_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    models = {"default": Differential(0.4), "symmetric": SymmetricIcr(0.3, 0.9), "asymmetric": ASPHALT_20}
    trained = Identified({**models, "ours": ASPHALT_20}, Timing(0.1, 0.0), None, 0.5)
    monkeypatch.setattr(mandow2007, "identify", lambda *_: trained)
    path = validation_drive(ASPHALT_20, 0)
    scores = {name: score(model, path, trained.timing) for name, model in trained.models.items()}
    before = Reproduction((), (mandow2007._path_figure("figure-6", "t", path, scores),))
    both = mandow2007._beside(before, scores, sample("p3at-mandow"))
    assert [figure.name for figure in both.figures] == ["figure-6", "figure-6-real"]
    assert [curve.label for curve in both.figures[1].curves] == [*trained.models, "reference"]
    (table,) = both.tables
    lines = dict(table.lines)
    assert np.isfinite(lines["ours: end off by [m]"][3])
    assert "has no turn on the spot" in table.note
    assert "time offset 0.100 s" in table.note
    assert "icr (icr_y_left 0.255" in table.note
