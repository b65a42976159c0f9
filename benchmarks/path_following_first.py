"""The first comparison of the laws, made before this code by an implementation of its own, driven again in MuJoCo.

It does not tell all that one must know to drive it again: here it is driven with several answers to what it leaves
open, and the question is whether its figures lie within what they come to.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from path_following_cases import STORE
from path_following_first_text import (
    DELAYED,
    EDGE,
    FIRST,
    FIRST_LATE,
    HARD,
    HEAD,
    JUDGED,
    NEAREST,
    SPEEDS,
    TITLES,
    WIDTHS,
)
from path_following_laws import LAWS, TYPICAL, Known
from skidsteer.control import Wheels
from skidsteer.follow import Ends, Sensing, follow, summarize
from skidsteer.models import SymmetricIcr
from skidsteer.plants import begin, point_contacts
from skidsteer.reproduce.huskic_runs import LEMNISCATE
from skidsteer.se2 import FloatArray
from skidsteer.terramechanics.terrain import Ground, Terrain
from skidsteer.vehicle import preset

ROBOT = replace(preset("pioneer-p3at"), mass=31.0, max_wheel_speed=4.0)
ENDS = Ends(laps=3.0, time=200.0, off=2.0)
ROUNDED = 0.05  # [cm] to which the first comparison tells its figures
CLOSE = math.log(1.25)
NEAR = 1.1  # times the ends of a span, up to which a figure is near to it
LATER = 0.06  # [s] of pose delay in its second table
Pair = tuple[float, float]  # mean and largest error [cm]


@dataclass(frozen=True, slots=True)
class Setup:
    """Answers to what the first comparison does not tell."""

    friction: float = 0.5
    width: float = 1.0  # between the ICRs believed, over that of point contacts
    late: float = 0.0  # [s] from pose to command
    bound: float = 4.0  # [rad/s] of the yaw rate asked for


NOMINAL = Setup()
SETUPS = [Setup(*answers) for answers in product((0.5, 0.4), (1.0, 0.95, 1.05), (0.0, 0.03))]


@dataclass(frozen=True, slots=True)
class CutWheels(Wheels):
    """Wheels that are asked for no more than a yaw rate; v is not slowed for it, as by the authors of Huskić 2017."""

    omega_max: float = math.inf  # [rad/s]

    def speeds(self, v: float, omega: float) -> FloatArray:
        return Wheels.speeds(self, v, min(max(omega, -self.omega_max), self.omega_max))


@dataclass(frozen=True, slots=True)
class Trial:
    """Three laps of a law."""

    law: str
    gains: str
    speed: float  # [m/s]
    setup: Setup = NOMINAL
    delay: float = 0.0  # [s] of the pose, told
    lag: float = 0.1  # [s]

    def errors(self) -> tuple[Pair, Pair]:
        """Of all laps and of those after the first, driven where they are not in the store; infinite: it fails."""
        file = STORE / "first" / f"{hashlib.sha256(repr(self).encode()).hexdigest()[:24]}.json"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(self._driven()))
        every, later = json.loads(file.read_text())
        return (every[0], every[1]), (later[0], later[1])

    def _driven(self) -> tuple[Pair, Pair]:
        known = Known(believed(self.setup.width), 4.0, math.inf, self.lag, 0.0)
        law = LAWS[self.law].build(LAWS[self.law].published[self.gains], self.speed, known)
        rolling = begin("mujoco", ROBOT, floor(self.setup.friction), LEMNISCATE.at(0.0), self.lag)
        wheels = CutWheels(known.model, 4.0, self.setup.bound)
        run = follow(rolling, law, wheels, LEMNISCATE, Sensing(delay=self.setup.late + self.delay), ENDS)
        if not run.done:
            return (math.inf, math.inf), (math.inf, math.inf)
        first_lap = float(run.t[np.argmax(run.s - run.s[0] >= LEMNISCATE.length)])
        every, later = summarize(run), summarize(run, first_lap)
        return (100.0 * every.mean, 100.0 * every.largest), (100.0 * later.mean, 100.0 * later.largest)


def believed(width: float) -> SymmetricIcr:
    """ICRs that are as many times as far apart as those of point contacts."""
    return SymmetricIcr(width * point_contacts(ROBOT).icr_y, 1.0)


def floor(friction: float) -> Ground:
    return Ground(Terrain("floor", friction, friction, shear_modulus=0.001))


def turned(speed: float) -> float:
    """Yaw rate of a steady turn in the nominal plant, over that of point contacts."""
    rolling, rims = begin("mujoco", ROBOT, floor(NOMINAL.friction)), believed(1.0).wheel_speeds(speed, TYPICAL * speed)
    rates = [rolling.step(rims, 0.02)[5] for _ in range(300)]
    return float(np.mean(rates[150:])) / (TYPICAL * speed)


@dataclass(frozen=True, slots=True)
class Cell:
    """A figure of the first comparison, and what it came to in each set-up."""

    name: str
    was: Pair
    nominal: Pair
    found: tuple[Pair, ...]  # all laps in each set-up, then those after the first in each

    @classmethod
    def driven(cls, law: str, gains: str, speed: float, was: Pair, delay: float = 0.0) -> Cell:
        trials = [Trial(law, gains, speed, setup, delay) for setup in SETUPS]
        every, later = zip(*(trial.errors() for trial in trials), strict=True)
        after = f", {1e3 * delay:.0f} ms" if delay else ""
        cell = cls(f"{TITLES[law]}, {gains}, {speed:g} m/s{after}", was, every[0], every + later)
        print(cell.name, cell, flush=True)
        return cell

    def span(self, which: int) -> Pair:
        """Of the mean (0) or largest (1) error [cm]."""
        told = [pair[which] for pair in self.found]
        return min(told), max(told)

    def inside(self, which: int, times: float = 1.0) -> bool:
        low, high = self.span(which)
        return (low - ROUNDED) / times <= self.was[which] <= (high + ROUNDED) * times

    def __str__(self) -> str:
        spans = " / ".join("-".join(map(_figure, self.span(which))) for which in (0, 1))
        return f"{_pair(self.nominal)}; {spans} ({self.was[0]:g} / {self.was[1]:g})"


def lines() -> Iterator[str]:
    """The section."""
    speeds, rules = " | ".join(f"{v:g} m/s" for v in SPEEDS), "---|" * len(SPEEDS)
    yield HEAD.format(speeds=speeds, rules=rules, slow=turned(SPEEDS[0]), fast=turned(SPEEDS[-1]), curvature=TYPICAL)
    laws: dict[str, list[Cell]] = {}
    for (law, gains), told in FIRST.items():
        row = [was and Cell.driven(law, gains, v, was) for v, was in zip(SPEEDS, told, strict=True)]
        yield f"| {TITLES[law]} | {gains} | {' | '.join(str(cell or '-') for cell in row)} |"
        laws[f"{TITLES[law]}, {gains}"] = [cell for cell in row if cell]
    published = [cell for name, row in laws.items() for cell in row if not name.startswith(TITLES["pure pursuit"])]
    yield from ("", *judged(published), *nearest(published), *by_width(laws), DELAYED)
    delayed = [Cell.driven(law, "launch", 1.5, was, LATER) for law, was in FIRST_LATE.items()]
    yield from (f"| {TITLES[law]} | {cell} |" for law, cell in zip(FIRST_LATE, delayed, strict=True))
    yield from ("", *judged(delayed[:-1]), "", edge(), *hard())


def judged(cells: Sequence[Cell]) -> Iterator[str]:
    """How many cells lie within what the set-ups come to, and which do not."""
    for which, what in enumerate(("mean", "largest")):
        inside = [cell for cell in cells if cell.inside(which)]
        near = [cell for cell in cells if cell not in inside and cell.inside(which, NEAR)]
        far = [cell for cell in cells if cell not in inside and cell not in near]
        widths = [high / low for low, high in (cell.span(which) for cell in cells)]
        names = [f"{c.name} ({c.was[which]:g}, here {'-'.join(map(_figure, c.span(which)))})" for c in near + far]
        yield JUDGED.format(
            what=what,
            inside=len(inside),
            cells=len(cells),
            near=len(near),
            width=np.median(widths),
            names="; ".join(names) or "none",
        )


def nearest(cells: Sequence[Cell]) -> Iterator[str]:
    """How near each set-up alone comes: the nominal one, and the nearest."""
    was = np.array([cell.was[0] for cell in cells])
    logs = np.log(np.array([[pair[0] for pair in cell.found[: len(SETUPS)]] for cell in cells]).T / was)
    rms = np.sqrt(np.mean(logs**2, axis=1))
    for name, i in (("nominal", 0), ("nearest", int(rms.argmin()))):
        off, setup = np.abs(logs[i]), SETUPS[i]
        far = [f"{cell.name} ({math.exp(logs[i, j]):.2f})" for j, cell in enumerate(cells) if off[j] > CLOSE]
        yield NEAREST.format(
            name=name,
            friction=setup.friction,
            width=setup.width,
            late=1e3 * setup.late,
            median=math.exp(float(np.median(logs[i]))),
            near=100.0 * float(np.mean(off <= CLOSE)),
            rms=math.exp(float(rms[i])),
            far=", ".join(far) or "none",
        )


def by_width(cells: dict[str, list[Cell]]) -> Iterator[str]:
    """Which ICRs believed each law asks for."""
    yield WIDTHS
    for name, row in cells.items():
        ratios = [[cell.found[i][0] / cell.was[0] for cell in row] for i in range(len(SETUPS))]
        told = (
            np.median([ratio for ratio, setup in zip(ratios, SETUPS, strict=True) if setup.width == width])
            for width in (0.95, 1.0, 1.05)
        )
        yield f"| {name} | {' | '.join(f'{median:.2f}' for median in told)} |"


def edge() -> str:
    """What the bound of the yaw rate does, and how late the loop is with which SLPINL swings and PBR does not."""
    late = [Setup(late=0.03, bound=bound) for bound in (NOMINAL.bound, math.inf)]
    bound, free = (_pair(Trial("slpinl", "launch", 2.0, setup).errors()[0]) for setup in late)
    both = (Trial(law, "launch", 1.5, Setup(late=0.02), LATER) for law in ("slpinl", "pbr ff"))
    slpinl, pbr = (_pair(trial.errors()[0]) for trial in both)
    return EDGE.format(bound=bound, free=free, slpinl=slpinl, pbr=pbr)


def hard() -> Iterator[str]:
    """What is left with 0.2 s of lag and 0.1 s of delay, at 2 m/s."""
    yield HARD
    for law, gains in FIRST:
        told = [Trial(law, gains, 2.0, replace(NOMINAL, late=late), 0.1, 0.2).errors()[0] for late in (0.0, 0.03)]
        yield f"| {TITLES[law]} | {gains} | {' | '.join(map(_pair, told))} |"


def _pair(pair: Pair) -> str:
    return " / ".join(map(_figure, pair))


def _figure(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else "fails"
