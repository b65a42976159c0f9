"""Long work tells how far it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from report_drives import lab
from skidsteer.errors import RequestError
from skidsteer.follow.task import Task, believed, run_task
from skidsteer.identify.terrain import compare_terrains
from skidsteer.odometry.phases import run_phases
from skidsteer.odometry.run import OdometryOptions, run
from skidsteer.paths import line
from skidsteer.progress import Progress, silent
from skidsteer.report import gather
from skidsteer.terramechanics.terrain import parse_ground
from skidsteer.vehicle import preset


def follow(tell: Progress) -> None:
    robot, ground = preset("summit-xl"), parse_ground("grass")
    run_task(Task(line(5.0), robot, ground, believed("kinematic", robot, ground), 1.0), tell)


def odometry(tell: Progress) -> None:
    calibration, drive, _ = lab()
    run(calibration, drive, OdometryOptions("basic"), tell)


def smoothing(tell: Progress) -> None:
    calibration, drive, _ = lab()
    run(calibration, drive, OdometryOptions(smooth=True), tell)


def phases(tell: Progress) -> None:
    calibration, drive, _ = lab()
    run_phases(calibration, drive.between(0.0, 60.0), 40.0, progress=tell)


def report(tell: Progress) -> None:
    calibration, drive, folds = lab()
    gather(calibration, [drive], folds=folds, progress=tell)


def terrains(tell: Progress) -> None:
    _, drive, _ = lab()
    halves = {"a": [drive.between(0.0, 60.0)], "b": [replace(drive.between(60.0, 120.0), name="b")]}
    compare_terrains(halves, "multiplier", progress=tell)


@pytest.mark.parametrize("work", [follow, odometry, smoothing, phases, report, terrains])
def test_it_tells_what_is_done_and_how_far_it_is(work: Callable[[Progress], None]) -> None:
    said: list[tuple[str, int, int]] = []
    work(lambda *words: said.append(words))
    assert len(said) > 1
    for what, done, total in said:
        assert what
        assert 0 <= done <= total
    assert said[-1][1] >= said[0][1]


def test_a_bar_that_is_struck_ends_the_work() -> None:
    def strike(*_: object) -> None:
        raise RequestError("enough")

    with pytest.raises(RequestError, match="enough"):
        follow(strike)


def test_nobody_is_told_unless_asked(capsys: pytest.CaptureFixture[str]) -> None:
    silent("driving", 1, 2)
    odometry(silent)
    assert capsys.readouterr() == ("", "")
