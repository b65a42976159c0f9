"""Simulated counterparts of the experiments of Huskić 2017, section V.

Published gains, the corrected law, the terramechanic plant; the wheels lag by 0.1 s. On grass poses come at 50 Hz, as
from the robot's odometry, elsewhere at 10 Hz, as from a laser scanner, without delay or noise. The speed to ask for is
searched so that the mean speed is the printed one, where a law can drive that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from skidsteer.control import Controller, Huskic, Pentzer, SaturationSpeed, Soetanto, Wheels
from skidsteer.control.huskic import GAINS as HUSKIC
from skidsteer.control.pentzer import GAINS as PENTZER
from skidsteer.control.soetanto import GAINS as SOETANTO
from skidsteer.follow import Ends, Jump, Run, Sensing, Summary, follow, summarize
from skidsteer.models import Icr
from skidsteer.paths import Path
from skidsteer.plants import begin
from skidsteer.reproduce.huskic_runs import COURSE, GROUNDS, LAPS, LEMNISCATE, VEHICLE, icr
from skidsteer.terramechanics.terrain import TERRAINS, Ground

LIMIT = 3.0  # [m/s] of the rims
ODOMETRY, SCANNER = Sensing(), Sensing(rate=10.0)
TRIES = 4  # of the search
CLOSE = 0.01  # [m/s] tolerance of the mean speed
MOST = 1.2  # largest speed to ask for, over the printed one


@dataclass(frozen=True, slots=True)
class Experiment:
    """An experiment of the paper, and its counterpart."""

    law: str  # Huskić, PBR or SLPINL
    ground: str  # of the paper
    speed: float  # [m/s] printed mean
    believed: str = ""  # ground whose ICRs the controller has; the same one if empty
    leap: float = 0.0  # [m] of the localization to the left, at half of the way

    @property
    def path(self) -> Path:
        """The one of that ground."""
        return COURSE if self.ground == "grass" else LEMNISCATE

    def drive(self, asked: float) -> Trial:
        """Its counterpart, with a speed [m/s] asked for."""
        model = icr("terramechanic", GROUNDS[self.believed or self.ground])
        sensing = ODOMETRY if self.ground == "grass" else SCANNER
        if self.leap:
            sensing = replace(sensing, jumps=(Jump(left=self.leap, share=0.5),))
        rolling = begin("terramechanic", VEHICLE, Ground(TERRAINS[GROUNDS[self.ground]]), self.path.at(0.0))
        ends = Ends(laps=LAPS, time=60.0 + 2.0 * 160.0 / asked)
        run = follow(rolling, law(self.law, asked, model), Wheels(model, LIMIT), self.path, sensing, ends)
        return Trial(self, asked, run, summarize(run))


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A counterpart that was driven."""

    experiment: Experiment
    asked: float  # [m/s]
    run: Run
    summary: Summary

    @property
    def reached(self) -> float:
        """Mean speed [m/s] along the path."""
        return self.summary.way / self.summary.duration

    @property
    def share(self) -> float:
        """Of the way that was driven, at most 1."""
        path = self.run.path
        return min(self.summary.way / (LAPS * path.length if path.closed else path.length), 1.0)


def law(name: str, speed: float, model: Icr) -> Controller[Any]:
    """A law with the gains of the authors' launch file, at a speed [m/s], limited by the wheels only."""
    if name == "SLPINL":
        return Soetanto(SOETANTO["launch"], speed)
    if name == "PBR":
        return Pentzer(replace(PENTZER["published"], omega_max=math.inf), speed, model.icr_x)
    drive = SaturationSpeed(Wheels(model, LIMIT), speed)
    return Huskic(replace(HUSKIC["launch"], omega_max=math.inf), drive, model.icr_x)


def trial(experiment: Experiment) -> Trial:
    """Drive an experiment at the printed mean speed, or as near to it as possible."""
    found, asked = [], experiment.speed
    for _ in range(TRIES):
        found.append(experiment.drive(asked))
        if abs(found[-1].reached - experiment.speed) < CLOSE:
            break
        asked = min(asked * experiment.speed / found[-1].reached, MOST * experiment.speed, LIMIT)
    return min(found, key=lambda t: abs(t.reached - experiment.speed))
