"""Tables and figures of Thalmann 2016; Figs. 7 to 10: a drive and the drift of its odometry, one straight run."""

from __future__ import annotations

import numpy as np

from skidsteer.drive import Series
from skidsteer.models import Differential
from skidsteer.odometry.kinematic_ekf import thalmann_filter
from skidsteer.odometry.reckoning import reckon
from skidsteer.odometry.reference_update import threshold
from skidsteer.odometry.state_choice import SystemNoise
from skidsteer.odometry.thalmann_replay import Replay, replay
from skidsteer.reproduce.figure import Curve, Figure
from skidsteer.reproduce.repeated_samples import DIFFERENCE, ENCODER, SPEED
from skidsteer.reproduce.rows import Place
from skidsteer.reproduce.thalmann_drives import ACCELERATION, LABORATORY, ROBOT, counted, drive

DISTURBANCE = 0.1  # [m/s^2] of the speed, or of each side
SIGNIFICANCE = 0.001
REPEATED = 2.45  # [s] after which the left side repeats its last speed once
CALIBRATED_SEED = 1
V_LEFT = 3  # of the basic filter's state
PLACES = (
    Place("Table 1", "states and geometries of four models", "no numbers; odometry.state_choice holds all four"),
    Place("Fig. 1", "geometry of the basic model", "a drawing without figures"),
    Place("Fig. 2", "geometry of the arc model", "a drawing without figures"),
    Place("Fig. 3", "geometry of the alternative model", "a drawing without figures"),
    Place("Fig. 4", "error of the polygon by the speed"),
    Place("Fig. 5", "error of the polygon by the radius"),
    Place("Fig. 6", "the rooftop", "a photograph"),
    Place("Fig. 7", "a drive, and the drift of its odometry"),
    Place("Fig. 8", "speed of the left side in a straight run"),
    Place("Fig. 9", "difference of the sides in it"),
    Place("Fig. 10", "compatibility test in it"),
    Place("Fig. 11", "transfer-factor difference of each drive"),
    Place("Fig. 12", "largest error while tracking is lost, rooftop"),
    Place("Fig. 13", "the same, laboratory"),
)
NOTES = (
    "'limited to a maximum of 5 cm' is half a step, v dt / 2: by as much the polygon's circle is displaced, whatever"
    " the radius. A single step errs by v^2 dt^2 / (2 R), which Figs. 4 and 5 show: 1 mm at 1 m/s, 10 Hz and 5 m",
    "the scan at hand has lost the displayed equations; those used follow from the text and Figs. 1 to 3",
    "the arc model needs no second filter for straight lines: sin(x) / x is 1 at 0",
)


def figures() -> tuple[Figure, ...]:
    """Figs. 7 to 10."""
    wheels = straight_run()
    runs = {name: _run(name, wheels) for name in ("basic", "alternative")}
    return (trajectory_figure(), _speed_figure(wheels, runs), _difference_figure(wheels, runs), _test_figure(runs))


def trajectory_figure() -> Figure:
    """Fig. 7: the track of the total station, and odometry alone."""
    wheels, tracking = drive(LABORATORY, CALIBRATED_SEED)
    x, y = tracking.positions.values.T
    line = reckon(Differential(ROBOT.track_width), wheels, "polygon")
    curves = (Curve("basic odometry", line[:, 0], line[:, 1]), Curve("total station", x, y, measured=True))
    return Figure("figure-7", "A simulated drive in the laboratory", "x [m]", "y [m]", curves, to_scale=True)


def straight_run() -> Series:
    """Encoders (n, 2) at 10 Hz of a straight run to 0.5 m/s, in which one sample of the left side repeats."""
    t = np.arange(0.0, 12.0, 0.01)
    v = np.clip(ACCELERATION * (t - 1.5), 0.0, SPEED)
    wheels = counted(Series(t, np.column_stack([v, v]), "wheels"))
    values, at = wheels.values.copy(), int(np.searchsorted(wheels.t, REPEATED))
    values[at, 0] = values[at - 1, 0]
    return Series(wheels.t, values, "wheels")


def _run(name: str, wheels: Series) -> Replay:
    filter = thalmann_filter(name, ROBOT.track_width, SystemNoise(DISTURBANCE, DIFFERENCE, ENCODER))
    return replay(filter, filter.start(0.0, np.zeros(3), 1e-6 * np.eye(3)), wheels, covariances=False)


def _speed_figure(wheels: Series, runs: dict[str, Replay]) -> Figure:
    estimated = runs["basic"]
    curves = (
        Curve("basic model", estimated.t, estimated.means[:, V_LEFT]),
        Curve("measured", wheels.t, wheels.values[:, 0], measured=True),
    )
    return Figure("figure-8", "Speed of the left side, one repeated sample", "time [s]", "v_l [m/s]", curves)


def _difference_figure(wheels: Series, runs: dict[str, Replay]) -> Figure:
    basic, alternative = runs["basic"].means, runs["alternative"].means
    curves = (
        Curve("basic model", runs["basic"].t, 1e3 * (basic[:, V_LEFT + 1] - basic[:, V_LEFT])),
        Curve("alternative model", runs["alternative"].t, 1e3 * alternative[:, V_LEFT + 1]),
        Curve("measured", wheels.t, 1e3 * (wheels.values[:, 1] - wheels.values[:, 0]), measured=True),
    )
    return Figure("figure-9", "Difference of the sides, one repeated sample", "time [s]", "dv [mm/s]", curves)


def _test_figure(runs: dict[str, Replay]) -> Figure:
    curves = [Curve(f"{name} model", run.t[1:], np.sqrt(run.statistic[1:])) for name, run in runs.items()]
    limit, ends = np.sqrt(threshold(SIGNIFICANCE, 2)), runs["basic"].t[[1, -1]]
    curves.append(Curve("limit at 0.1 %", ends, np.full(2, limit), measured=True))
    title = "Compatibility test, Eq. (10), one repeated sample"
    return Figure("figure-10", title, "time [s]", "square root of T [-]", tuple(curves))
