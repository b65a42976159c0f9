"""The first comparison of the laws, made before this code by an implementation of its own, driven again in MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from path_following_laws import LAWS, Known
from skidsteer.control import Wheels
from skidsteer.follow import Ends, Sensing, Summary, follow, summarize
from skidsteer.plants import begin, point_contacts
from skidsteer.reproduce.huskic_runs import LEMNISCATE
from skidsteer.terramechanics.terrain import Ground, Terrain
from skidsteer.vehicle import preset

ROBOT = replace(preset("pioneer-p3at"), mass=31.0, max_wheel_speed=4.0)
FLOOR = Terrain("floor", friction=0.5, friction_opposite=0.5, shear_modulus=0.001)
SPEEDS = (0.5, 1.0, 1.5, 2.0)
LAPS = 3.0
OFF = 2.0  # [m]
NEAR = math.log(1.25)
LATE = 0.04  # [s]
Cells = tuple[tuple[float, float] | None, ...]
FIRST: dict[tuple[str, str], Cells] = {  # mean and largest error [cm]
    ("huskic measured", "launch"): ((2.0, 3.1), (3.1, 5.6), (3.4, 6.6), (3.3, 7.4)),
    ("huskic measured", "header"): (None, (7.0, 13.5), (17.2, 27.9), (23.5, 38.0)),
    ("slpinl", "launch"): ((0.9, 1.6), (1.7, 3.1), (1.7, 3.2), (39.9, 110.0)),
    ("slpinl", "header"): (None, (1.5, 3.0), (2.7, 4.2), (4.9, 7.5)),
    ("pbr", "launch"): ((9.2, 14.1), (10.8, 16.7), (11.9, 18.4), (12.3, 18.7)),
    ("pbr ff", "launch"): ((1.1, 1.9), (2.7, 4.8), (3.9, 6.6), (4.3, 6.9)),
    ("pure pursuit", "launch"): ((1.3, 2.1), (2.5, 4.1), (2.1, 3.1), (1.6, 2.5)),
}
TITLES = {
    "huskic measured": "Huskić, measured omega",
    "slpinl": "SLPINL",
    "pbr": "PBR",
    "pbr ff": "PBR + feed-forward",
    "pure pursuit": "pure pursuit",
}
TEXT = """
## The first comparison, driven again

A first comparison, by an implementation of its own, let the laws drive three laps of the lemniscate in MuJoCo, at 50 Hz
with 0.1 s of lag, the true pose and no delay. It tells mean and largest error; not the robot, nor its friction. Here a
robot as big as a Pioneer P3-AT (31 kg) drives on friction 0.5; the ICRs believed are those of point contacts. Cells are
mean / largest error [cm], in brackets those of the first comparison.

| law | gains | {speeds} |
|---|---|{rules}
""".rstrip()


def drive(law: str, gains: str, speed: float, delay: float = 0.0, friction: float = FLOOR.friction) -> Summary:
    """Three laps."""
    known = Known(point_contacts(ROBOT), 4.0, math.inf, 0.1, 0.0)
    floor = replace(FLOOR, friction=friction, friction_opposite=friction)
    rolling = begin("mujoco", ROBOT, Ground(floor), LEMNISCATE.at(0.0))
    controller = LAWS[law].build(LAWS[law].published[gains], speed, known)
    wheels, ends = Wheels(known.model, known.max_speed), Ends(LAPS, 400.0, OFF)
    return summarize(follow(rolling, controller, wheels, LEMNISCATE, Sensing(delay=delay), ends))


def lines() -> Iterator[str]:
    """The section."""
    yield TEXT.format(speeds=" | ".join(f"{v:g} m/s" for v in SPEEDS), rules="---|" * len(SPEEDS))
    apart = []
    for law, gains in FIRST:
        found = against(law, gains)
        row = [f"{now[0]:.1f} / {now[1]:.1f} ({_before(was)})" for now, was in found]
        apart += [
            (now[0] / was[0], f"{TITLES[law]}, {gains} at {speed:g} m/s")
            for speed, (now, was) in zip(SPEEDS, found, strict=True)
            if was is not None
        ]
        yield f"| {TITLES[law]} | {gains} | {' | '.join(row)} |"
        print(law, gains, *row, flush=True)
    yield from ("", *_judged(apart))


def against(law: str, gains: str, delay: float = 0.0) -> list[tuple[tuple[float, float], tuple[float, float] | None]]:
    """Mean and largest error [cm] at each speed, with a delay [s] of the pose, and those of the first comparison."""
    told = [drive(law, gains, speed, delay) for speed in SPEEDS]
    return [((100.0 * t.mean, 100.0 * t.largest), was) for t, was in zip(told, FIRST[law, gains], strict=True)]


def _before(was: tuple[float, float] | None) -> str:
    return "-" if was is None else f"{was[0]:g} / {was[1]:g}"


def _judged(apart: list[tuple[float, str]]) -> Iterator[str]:
    far = ", ".join(f"{what} ({ratio:.2f})" for ratio, what in apart if abs(math.log(ratio)) > NEAR)
    yield f"Ratio of the means, ours over first: {_agreement([r for r, _ in apart])}. Farther off: {far}."
    late = {delay: drive("slpinl", "launch", 2.0, delay) for delay in (0.02, 0.04, 0.06)}
    loose = {friction: drive("slpinl", "launch", 2.0, friction=friction) for friction in (0.4, 0.3)}
    told = [f"{100 * t.mean:.1f} / {100 * t.largest:.1f} with {1e3 * d:.0f} ms of delay" for d, t in late.items()]
    told += [f"{100 * t.mean:.1f} / {100 * t.largest:.1f} on friction {f:g}" for f, t in loose.items()]
    with_delay = [now[0] / was[0] for law, gains in FIRST for now, was in against(law, gains, LATE) if was is not None]
    yield ""
    yield (
        f"SLPINL with launch gains at 2 m/s stands at the edge of what it can do: {', '.join(told)}. A loop that is"
        " later than it was meant to be would explain the first comparison's figure: with"
        f" {1e3 * LATE:.0f} ms of delay the whole table has {_agreement(with_delay)}."
    )


def _agreement(ratios: list[float]) -> str:
    logs = np.log(ratios)
    near = np.mean(np.abs(logs) < NEAR)
    return (
        f"median {np.exp(np.median(logs)):.2f}, {100 * near:.0f} % within a factor of 1.25, RMS factor"
        f" {np.exp(np.sqrt(np.mean(logs**2))):.2f}"
    )
