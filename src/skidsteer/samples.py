"""Drives that come with the package, so that everything can be tried without a robot: ``sample:NAME``.

Those of the Rover 4WD1 hold the printed measurements of a real robot, the others are simulated: ``p3at-mandow`` by a
model that is known exactly, the rest by the forces of the ground, which no model of ours knows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.errors import named
from skidsteer.models import Differential, Icr
from skidsteer.models.slip_ratio import CircleRun
from skidsteer.se2 import FloatArray, exp
from skidsteer.simulate import Sensors, controller, kinematic_drive, rims_from_manoeuvres
from skidsteer.terramechanics.dynamics import terramechanic_drive
from skidsteer.terramechanics.robot import robot
from skidsteer.terramechanics.terrain import terrain
from skidsteer.vehicle import preset

P3AT_TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)  # Mandow 2007, Table I, pneumatic tyres at 20 psi, asphalt
P3AT_LAG = 0.08  # [s]
P3AT_SENSORS = Sensors(
    reference_rate=5.0,
    position_sigma=0.01,
    yaw_sigma=float(np.radians(0.5)),
    reference_delay=0.15,
    encoder_step=1.0 / 138_000.0,  # [m] Mandow 2007, Eq. (14): 138 counts a millimetre
)
P3AT_MOTION_NOISE = (0.004, 0.008)  # [m/sqrt(m)], [rad/sqrt(m)]


def p3at_mandow(seed: int = 2007) -> Drive:
    """A simulated Pioneer P3-AT after Mandow 2007, IV-C: encoders at 100 Hz, a reference at 5 Hz and 1 cm.

    The truth is ``P3AT_TRUTH`` with a lag of ``P3AT_LAG``; the reference is 0.15 s late and, unlike Mandow's single
    antenna, tells the heading to 0.5 deg.
    """
    vehicle = preset("pioneer-p3at")
    rims = rims_from_manoeuvres(_representative_paths(), Differential(vehicle.track_width))
    return kinematic_drive("p3at-mandow", vehicle, P3AT_TRUTH, rims, P3AT_SENSORS, P3AT_LAG, P3AT_MOTION_NOISE, seed)


def _representative_paths() -> np.ndarray:
    """Rows of duration, v, omega: straights, circles, turns on the spot and S-curves at several speeds; 5 minutes."""
    stop = [1.0, 0.0, 0.0]
    rows = [[2.0, 0.0, 0.0]]
    for v in (0.2, 0.4, 0.6):
        rows += [[8.0, v, 0.0], stop, [6.0, 0.0, 0.8], stop, [8.0, v, 0.5 * v], [8.0, v, -0.5 * v], stop]
        rows += [[6.0, 0.0, -0.8], stop, [4.0, -v, 0.0], [5.0, v, 1.2 * v], [5.0, v, -1.2 * v]]
        rows += [[2.0, v, s * 0.9] for s in (1, -1, 1, -1, 1, -1)] + [[6.0, 0.5 * v, 0.4], [6.0, 0.5 * v, -0.4], stop]
    return np.array(rows)


GROUND_SENSORS = Sensors(
    reference_rate=10.0,
    position_sigma=0.01,
    yaw_sigma=float(np.radians(0.5)),
    reference_delay=0.08,
    encoder_rate=50.0,
    encoder_step=1e-4,
    gyro_rate=50.0,
    gyro_sigma=0.003,
    gyro_bias=0.002,
)
COM_AHEAD = 0.02  # [m] centre of mass of the simulated robots


def on_ground(name: str, ground: str, speeds: Sequence[float], rates: Sequence[float], seed: int = 2015) -> Drive:
    """A preset robot on simulated ground (`terramechanics`): straights, arcs, turns on the spot, backwards; 2 minutes.

    Args:
        name: of the vehicle's preset.
        ground: of the terrain.
        speeds: [m/s] driven.
        rates: [rad/s] of the arcs; on the spot the last of them.
        seed: of the sensors' noise.
    """
    made = robot(preset(name), com_x=COM_AHEAD)
    commands = rims_from_manoeuvres(_arcs(speeds, rates), controller(made.vehicle))
    short = name.removeprefix("pioneer-")
    return terramechanic_drive(f"{short}-{ground}", made, terrain(ground), commands, GROUND_SENSORS, seed)


def _arcs(speeds: Sequence[float], rates: Sequence[float]) -> FloatArray:
    """Rows of duration, v, omega."""
    stop = [1.0, 0.0, 0.0]
    rows = [[2.0, 0.0, 0.0]]
    for v in speeds:
        rows += [[5.0, v, 0.0], *([5.0, v, side * rate] for rate in rates for side in (1.0, -1.0)), stop]
        rows += [[5.0, 0.0, rates[-1]], [5.0, 0.0, -rates[-1]], stop, [4.0, -v, 0.0], [3.0, -v, rates[0]], stop]
    return np.array(rows)


# [m/s] Giannoccaro 2015, Table 1: inner and outer side of the runs 1 to 5
ROVER_PAIRS = ((0.410, 0.632), (0.410, 0.957), (0.191, 0.957), (0.191, 1.059), (0.191, 1.249))
ROVER_RADII = {  # [mm] Table 2, means of three runs each: 1L to 5L, 1R to 5R
    "indoor": (3452, 1176, 471, 373, 309, 4553, 1397, 488, 388, 315),
    "outdoor": (5800, 2163, 687, 496, 387, 7239, 2345, 644, 464, 364),
    "football": (3548, 1730, 745, 563, 442),
}
ROVER_DRAGS = {  # [%] Table 4: how much faster than its rims the inner side moved
    "indoor": (10.4, 24.4, 85.0, 78.7, 71.3, 16.6, 22.7, 67.5, 91.0, 79.5),
    "outdoor": (11.5, 23.9, 88.0, 100.0, 88.9, 13.6, 30.4, 75.8, 90.0, 84.1),
    "football": (2.0, 1.7, 48.5, 80.0, 93.3),
}


def rover_runs() -> tuple[CircleRun, ...]:
    """The circle runs of the Rover 4WD1, Giannoccaro 2015, Tables 1, 2 and 4: ten indoors and outdoors, five on turf.

    The speed over ground is that of the inner side, Table 4 through Eq. (22), brought to the robot's centre. The table
    prints magnitudes: an inner side that lagged behind its rims by 100 %, as 4L outdoors, would stand still.
    """
    half = 0.5 * preset("rover-4wd1").track_width
    runs = []
    for surface, radii in ROVER_RADII.items():
        for i, (radius_mm, drag) in enumerate(zip(radii, ROVER_DRAGS[surface], strict=True)):
            (inner, outer), radius = ROVER_PAIRS[i % 5], 0.001 * radius_mm
            left, right = (inner, outer) if i < 5 else (outer, inner)
            speed = inner * (1.0 + 0.01 * drag) * radius / (radius - half)
            runs.append(CircleRun(left, right, radius, surface, speed, name=f"{i % 5 + 1}{'L' if i < 5 else 'R'}"))
    return tuple(runs)


ROVER_SLOT = 10.0  # [s] in which a run keeps its speeds; its arc lies in the middle, far from any other run
ROVER_ARC = (4.0, 5.2)  # [s] of the slot: short enough that no model errs by half a turn


def rover_4wd1(surface: str | None = None) -> Drive:
    """Measured circle runs of a real Rover 4WD1, laid out as arcs: Giannoccaro 2015, Tables 1, 2 and 4.

    Measured are, of each run, the rim speeds (by the calibration of the commands, Fig. 5), the radius (mean of three
    repetitions) and the speed over ground. Everything else is laid out: each run is one segment of 1.2 s, whose two
    reference poses lie at the ends of an arc of that radius, speed / radius times 1.2 s of yaw apart, without noise and
    without side slip (no heading was measured). The rim speeds are constant through the segment and long before and
    after, so that clocks and lag have no effect: a time offset or lag estimated from this drive means nothing.

    Args:
        surface: one of ``ROVER_RADII``; None: all of them, one after the other.

    Returns:
        A drive with a segment for each run and the labels ``surface`` (0 indoor, 1 outdoor, 2 football), ``run`` (1 to
        5) and ``turn`` (1 left, -1 right).
    """
    runs = [run for run in rover_runs() if surface in (None, run.surface)]
    held = np.repeat([[run.v_left, run.v_right] for run in runs], 100, axis=0)
    wheels = Series(np.linspace(0.0, ROVER_SLOT * len(runs), len(held), endpoint=False), held, "wheels")
    ends = np.array([[ROVER_SLOT * i + end for end in ROVER_ARC] for i in range(len(runs))])
    poses = np.concatenate([_arc(run, ROVER_ARC[1] - ROVER_ARC[0]) for run in runs])
    return Drive(
        "rover-4wd1" if surface is None else f"rover-4wd1-{surface}",
        preset("rover-4wd1"),
        wheels,
        pose=Series(ends.ravel(), poses, "pose"),
        segments=ends,
        labels=_rover_labels(runs),
        source="measured circle runs of Giannoccaro 2015, Tables 1, 2 and 4, laid out as arcs",
    )


def _arc(run: CircleRun, duration: float) -> FloatArray:
    """First and last pose (2, 3) of a run that begins at the origin."""
    turn = run.speed / run.radius if run.speed is not None else 0.0
    return exp(np.outer([0.0, duration], [turn * run.radius, 0.0, turn if run.direction == "left" else -turn]))


def _rover_labels(runs: Sequence[CircleRun]) -> dict[str, FloatArray]:
    return {
        "surface": np.array([float(list(ROVER_RADII).index(run.surface)) for run in runs]),
        "run": np.array([float(run.name[0]) for run in runs]),
        "turn": np.array([1.0 if run.direction == "left" else -1.0 for run in runs]),
    }


@dataclass(frozen=True, slots=True)
class Sample:
    """A drive that can be made at any time."""

    make: Callable[[], Drive]
    text: str


SAMPLES: dict[str, Sample] = {
    "p3at-lab": Sample(
        partial(on_ground, "pioneer-p3at", "lab", (0.2, 0.3, 0.4), (0.3, 0.6)),
        "simulated Pioneer P3-AT by the forces of a laboratory's floor (Wang 2015), up to 0.4 m/s, 2 minutes",
    ),
    "p3at-tiles": Sample(
        partial(on_ground, "pioneer-p3at", "tiles", (0.2, 0.3, 0.4), (0.3, 0.6)),
        "the same commands on a tiled floor",
    ),
    "p3at-mandow": Sample(
        p3at_mandow, "simulated Pioneer P3-AT by a model with known truth (Mandow 2007, Table I, asphalt), 5 minutes"
    ),
    "warthog-grass": Sample(
        partial(on_ground, "warthog", "grass", (0.5, 1.0, 2.0), (0.3, 0.6)),
        "simulated Warthog by the forces of grass, up to 2 m/s, 2 minutes",
    ),
    "jackal-asphalt": Sample(
        partial(on_ground, "jackal", "asphalt", (0.3, 0.6, 0.9), (0.4, 0.8)),
        "simulated Jackal by the forces of asphalt, up to 0.9 m/s, 2 minutes",
    ),
    "jackal-grass": Sample(
        partial(on_ground, "jackal", "grass", (0.3, 0.6, 0.9), (0.4, 0.8)), "the same commands on grass"
    ),
    "rover-4wd1": Sample(rover_4wd1, "measured circle runs of a real Rover 4WD1 on three surfaces (Giannoccaro 2015)"),
    "rover-4wd1-indoor": Sample(partial(rover_4wd1, "indoor"), "those ten on the floor of the laboratory"),
    "rover-4wd1-outdoor": Sample(partial(rover_4wd1, "outdoor"), "those ten on the ground outside it, smoother"),
    "rover-4wd1-football": Sample(partial(rover_4wd1, "football"), "those five on synthetic grass, left turns only"),
}


def sample(name: str) -> Drive:
    """The sample drive of that name.

    Raises:
        RequestError: no such sample; the message lists those there are.
    """
    return named(name, "sample", SAMPLES).make()
