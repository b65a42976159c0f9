"""Giannoccaro 2015, section V: the course of Fig. 10 in integers, and laps on plants calibrated by circles."""

from __future__ import annotations

import numpy as np
import pytest

from skidsteer.plan.outline import gap
from skidsteer.reproduce import giannoccaro2015
from skidsteer.reproduce.rover_course import CLEARANCE, FLOORS, WAYS, circles, laps


def test_the_course_and_its_integers() -> None:
    by_what = {row.what: row for row in giannoccaro2015.plan_rows()}
    length = by_what["length of the course [cm], Fig. 10"]
    assert (length.paper, length.verdict) == (815.48, "reproduced")
    assert length.ours == pytest.approx(200.0 * (1.25 + np.pi * 0.9))
    assert by_what["k on the straights, section V"].ours == 61
    outer, inner = (by_what[f"k of the {side} side on the arcs, section V"] for side in ("outer", "inner"))
    assert (outer.paper, outer.ours, inner.paper, inner.ours) == (65, 74, 26, 28)
    # By hand: (0.676 m/s * 0.76 m) / (0.262 m/s * 1.04 m), and 1 - 0.52 / 0.676
    assert "mean K_s = 1.89 by Eq. (15), and at 0.5 rad/s an outer slip of 0.23" in outer.reason


@pytest.mark.parametrize("name", FLOORS)
def test_circle_tests_on_a_plant(name: str) -> None:
    found = circles(name, 0)
    assert len(found) == 10
    assert [run.direction for run in found] == ["left"] * 5 + ["right"] * 5
    radii = np.array([run.radius for run in found]).reshape(2, 5)
    assert (np.diff(radii, axis=1) < 0.0).all()
    assert radii[0] == pytest.approx(radii[1], rel=0.03)


@pytest.mark.parametrize("name", FLOORS)
def test_laps_by_slip_ratio_end_within_decimetres(name: str) -> None:
    done = laps(name, "slip ratio")
    assert len(done.errors) == 5
    assert done.errors.max() < {"kinematic": 0.04, "terramechanic": 0.12}[name]
    for plan, path in zip(done.plans, done.paths, strict=True):
        assert path[-1, 2] == pytest.approx(2.0 * np.pi, abs=0.1)
        assert gap(plan.robot, path, plan.obstacle, plan.place).min() > CLEARANCE


def test_one_icr_distance_does_not_do_on_the_ground() -> None:
    assert laps("kinematic", "ICR model").errors.max() < 0.03
    assert laps("terramechanic", "ICR model").errors.min() > 3.0 * laps("terramechanic", "slip ratio").errors.max()


def test_every_lap_is_a_row_and_a_curve() -> None:
    done = giannoccaro2015.reproduction()
    rows = [row for row in done.rows if "Fig. 11" in row.what]
    assert len(rows) == len(FLOORS) * len(WAYS)
    assert {row.verdict for row in rows} == {"not possible without the original data"}
    assert all(np.isnan(row.paper) and "a few centimetres" in row.reason for row in rows)
    by_way = [float(laps(name, way).errors.mean()) for name in FLOORS for way in WAYS]
    assert [row.ours for row in rows] == pytest.approx(by_way)
    (figure,) = (f for f in done.figures if f.name == "figure-11")
    assert [c.label for c in figure.curves[:2]] == ["planned", "obstacle"]
    named = {place.name for place in done.places if done.rows_of(place) or done.figures_of(place)}
    assert named >= {*(f"Table {i}" for i in range(1, 6)), "Fig. 10", "Fig. 11"}
    assert all(place.not_computed for place in done.places if place.name not in named)
