"""Thalmann's claims on simulated drives, tracking lost on real ones. Writes docs/odometry.md and its figure."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError
from skidsteer.identify.calibrate import CalibrateOptions, calibrate
from skidsteer.io.drives import load_drive
from skidsteer.models import Model
from skidsteer.odometry.in_field import InField, calibrate_in_field, frozen, tune
from skidsteer.odometry.kinematic_ekf import KinematicEkf, thalmann_filter
from skidsteer.odometry.reckoning import reckon
from skidsteer.odometry.state_choice import SystemNoise
from skidsteer.odometry.thalmann_replay import Replay, Tracking
from skidsteer.odometry.tracking_loss import LossStudy, loss_study, tracked
from skidsteer.reproduce import thalmann2016
from skidsteer.reproduce import thalmann_drives as simulated
from skidsteer.reproduce.figure import Curve, Figure, draw
from skidsteer.reproduce.repeated_samples import Detection
from skidsteer.vehicle import preset

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("SKIDSTEER_DATA", ROOT.parent / "shared" / "data"))
DRIVES = ("warthog-grass-a", "warthog-grass-b", "warthog-asphalt")
PAIRS = (  # calibrated on, lost on
    ("warthog-grass-a", "warthog-grass-b"),
    ("warthog-grass-b", "warthog-grass-a"),
    ("warthog-grass-a", "warthog-asphalt"),
)
DURATIONS = (20.0, 40.0, 60.0, 80.0, 100.0, 120.0)  # [s]
COUNT = 40
SIGMA = 0.02  # [m] of the lidar's position
FOLLOW = SystemNoise(acceleration=2.0, difference=2.0, encoder=0.02)  # the encoders are followed closely
HEAD = """# Odometry with and without a reference

Written by `make studies` (`benchmarks/odometry_study.py`); nothing here is edited by hand.

## Thalmann 2016 on simulated drives

[reproduction.md](reproduction.md) has the claims of the paper's text beside ours. The robot of the simulation is
assumed, since the paper prints no measures of its own: track width {track} m, slip difference {lab} in the laboratory
and {roof} on the rooftop, encoders at 10 Hz that count {count} mm, a pose that wanders by {walk} m and {turn} rad per
square root of a metre, a total station of {sigma} mm at {rate} Hz.
"""
MEDIANS = """
Largest error while tracking is lost, median of 40 windows [m]:
"""
DETECTION = """
Repeated encoder samples under acceleration (400 straight runs to 0.5 m/s at 0.25 m/s^2, encoders at 10 Hz; in one of
ten samples one side tells its last speed again; test at 0.1 %): the share of them that the test finds, and the share of
the same observations that it excludes where nothing repeats, for several disturbance accelerations of the filter. The
last column is the other observation of the alternative model, the mean speed.

| filter | disturbance [m/s^2] | found [%] | good ones excluded [%] | good speeds excluded [%] |
|---|---|---|---|---|
"""
REAL = """
## Tracking lost on real drives

Positions of the lidar's pose stand for the total station; its headings and the gyro are not used. Thalmann's model is
extended by the steering efficiency (track width over effective track width): it is a state beside the slip ratios of
both sides. In the first phase they are estimated from wheels and positions of one drive; so are, by maximum likelihood,
the delay of the positions, the scatter of their stamps and the wandering of the pose. In the second phase they are
constants on another drive, whose delay is found on itself. Tracking is lost in {count} random windows of each length,
after the robot was seen to move 5 m; it moves at least 2 m away in each. The largest distance from the reference is the
error of a window.

The compatibility test is off: these wheels are measured at 4 Hz and held, every step would look like an outlier.

### What the drives tell, the counterpart of Fig. 11

| drive | slip left | slip right | efficiency | delay [s] | stamps [s] | walk [m/sqrt(m)] | turn [rad/sqrt(m)] |
|---|---|---|---|---|---|---|---|
"""
LOST = """
### Largest error, the counterpart of Figs. 12 and 13

Median over the windows [m]; in brackets the median of the ratio to the basic model in the same window. `basic` has the
nominal track width of 1.08 m, `factory` the width that the robot ships with ({factory} m); `icr` is the model that
`skidsteer calibrate` fits to poses and gyro of the calibration drive, reckoned exactly from where the extended filter
stood. `around` is calibrated on what is seen before and after each window of the drive itself, with the noise of
`warthog-grass-a`. A length is left out where no window of it fits into the drive: the robot stands first, and positions
tell no heading before it moves.

![Largest error while tracking is lost](figures/tracking-loss.svg)
"""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What the first phase makes of a drive."""

    drive: Drive
    filter: KinematicEkf
    tracking: Tracking
    found: InField
    icr: Model


def first_phase(name: str) -> Known:
    drive = load_drive(DATA / name)
    assert drive.pose is not None
    seen = Tracking(Series(drive.pose.t, drive.pose.values[:, :2], "positions"), SIGMA)
    plain = replace(thalmann_filter("extended", drive.vehicle.track_width, FOLLOW), significance=0.0)
    filter, tracking = tune(plain, drive.wheels, seen)
    icr = calibrate(drive, options=CalibrateOptions(model="icr")).model
    return Known(drive, filter, tracking, calibrate_in_field(filter, drive.wheels, tracking), icr)


def second_phase(known: Known, other: Known, around: bool) -> list[LossStudy]:
    """Lose tracking on ``other`` with what is known from ``known``; one study for each duration that fits."""
    width = other.drive.vehicle.track_width
    warthog = preset("warthog")
    factory = (warthog.factory_separation or width) * (warthog.factory_multiplier or 1.0)
    basic = replace(thalmann_filter("basic", width, known.filter.noise), significance=0.0)
    filters = {"basic": basic, "factory": frozen(basic, {"efficiency": width / factory})}
    filters |= {"around": known.filter} if around else {"extended": known.found.reckoner}
    studies = []
    for duration in DURATIONS:
        try:
            study = loss_study(filters, other.drive.wheels, other.tracking, (duration,), COUNT)
        except DataError:
            continue
        if not around:
            track = tracked(known.found.reckoner, other.drive.wheels, other.tracking)
            errors = [exact_error(known.icr, track, other, start, start + duration) for start in study.starts[0]]
            study = replace(study, errors={**study.errors, "icr": np.array([errors])})
        studies.append(study)
    return studies


def exact_error(model: Model, track: Replay, other: Known, start: float, end: float) -> float:
    """Largest error [m] of a model reckoned exactly, from the pose at the last sample before start [s]."""
    last = int(np.searchsorted(track.t, start, side="right")) - 1
    part = other.drive.wheels.between(float(track.t[last]), end)
    assert part is not None
    poses = reckon(model, part, start=track.means[last, :3])
    inside = (track.seen_t >= start) & (track.seen_t <= end)
    at = np.stack([np.interp(track.seen_t[inside], part.t, poses[:, i]) for i in range(2)], axis=1)
    return float(np.hypot(*(at - track.seen[inside]).T).max())


def slip_row(name: str, known: Known) -> str:
    slips = " | ".join(f"{e.value:.3f} +- {e.sigma:.3f}" for e in known.found.slips.values())
    t, noise = known.tracking, known.filter.noise
    return f"| {name} | {slips} | {t.time_offset:.2f} | {t.stamp_sigma:.2f} | {noise.walk:.3f} | {noise.turn:.3f} |"


def loss_table(title: str, studies: list[LossStudy]) -> list[str]:
    names = list(studies[0].errors)
    lines = ["", f"**{title}**", "", f"| lost for [s] | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for study in studies:
        cells = [f"{study.medians(n)[0]:.2f} ({study.ratio(n, 'basic')[0]:.2f})" for n in names]
        lines.append(f"| {study.durations[0]:g} | {' | '.join(cells)} |")
    pooled = {n: np.concatenate([s.errors[n][0] / s.errors["basic"][0] for s in studies]) for n in names}
    lines.append(f"| all | {' | '.join(f'({np.median(pooled[n]):.2f})' for n in names)} |")
    return lines


def loss_figure(all_studies: Mapping[str, list[LossStudy]]) -> Figure:
    curves = []
    for title, studies in all_studies.items():
        x = np.array([s.durations[0] for s in studies])
        for name in ("basic", "extended", "around"):
            if name in studies[0].errors:
                low, middle, high = np.array([np.quantile(s.errors[name][0], [0.25, 0.5, 0.75]) for s in studies]).T
                curves.append(Curve(f"{name}: {title}", x, middle, low, high))
    title = "Largest error while tracking is lost"
    return Figure("tracking-loss", title, "time without tracking [s]", "median and quartiles [m]", tuple(curves))


def simulated_lines() -> list[str]:
    done = thalmann2016.study()
    names = [f"{p.site.name}: {model}" for p in done.sites for model in p.loss.errors]
    lines = [MEDIANS, f"| lost for [s] | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for i, duration in enumerate(done.sites[0].loss.durations):
        cells = [f"{p.loss.medians(model)[i]:.3f}" for p in done.sites for model in p.loss.errors]
        lines.append(f"| {duration:g} | {' | '.join(cells)} |")
    return [*lines, DETECTION.rstrip("\n"), *(detection_row(d) for d in done.detections)]


def detection_row(d: Detection) -> str:
    rest = "-" if np.isnan(d.speed_excluded) else f"{100 * d.speed_excluded:.1f}"
    return f"| {d.filter} | {d.disturbance:g} | {100 * d.found:.0f} | {100 * d.false:.2f} | {rest} |"


def settings() -> dict[str, object]:
    return {
        "track": simulated.ROBOT.track_width,
        "lab": simulated.LABORATORY.slip,
        "roof": simulated.ROOFTOP.slip,
        "count": 1e3 * simulated.COUNT,
        "walk": simulated.WANDER[0],
        "turn": simulated.WANDER[1],
        "sigma": 1e3 * simulated.SENSORS.position_sigma,
        "rate": simulated.SENSORS.reference_rate,
    }


def main() -> None:
    known = {name: first_phase(name) for name in DRIVES}
    slips = [slip_row(name, k) for name, k in known.items()]
    print("\n".join(slips), flush=True)
    studies = {f"{a} to {b}": second_phase(known[a], known[b], False) for a, b in PAIRS}
    studies["within warthog-asphalt"] = second_phase(known["warthog-grass-a"], known["warthog-asphalt"], True)
    tables: list[str] = []
    for title, parts in studies.items():
        tables += loss_table(title, parts)
    print("\n".join(tables), flush=True)
    warthog = preset("warthog")
    factory = f"{(warthog.factory_separation or 0.0) * (warthog.factory_multiplier or 0.0):.2f}"
    text = [HEAD.format(**settings()).rstrip("\n"), *simulated_lines(), REAL.format(count=COUNT).rstrip("\n"), *slips]
    text += [LOST.format(factory=factory).rstrip("\n"), *tables]
    (ROOT / "docs" / "odometry.md").write_text("\n".join(text) + "\n", encoding="utf-8")
    (ROOT / "docs" / "figures").mkdir(exist_ok=True)
    draw(loss_figure(studies), ROOT / "docs" / "figures" / "tracking-loss.svg")


if __name__ == "__main__":
    main()
