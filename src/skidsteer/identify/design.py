"""The drive that determines a model best within an area and a time, and what it will tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.identify.excite import Choice, Setup
from skidsteer.identify.excursion import (
    Excursion,
    calibrated_models,
    excursion,
    expected_icr_distance,
    expected_model,
    footprint_radius,
    possible_models,
    trajectory,
)
from skidsteer.identify.manoeuvres import PERIOD, Figure, Limits, library, rims_of
from skidsteer.identify.unplanned import unplanned_drive
from skidsteer.models import MODELS, Differential, Model
from skidsteer.noise import Noise
from skidsteer.se2 import FloatArray
from skidsteer.simulate import controller
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Timing

REST = 1.0  # [s] before and after
ROBOTS = 12  # possible robots that every single figure must fit
STRETCH = 1.1  # that straights, planned to the very end of the room, may exceed it by
DRIFT = 0.3  # share of the room that a figure may end away from its start
ENOUGH = 0.45  # no parameter should keep more than this share of the sigma that an unplanned drive leaves
ENOUGH_TIMING = 1.5  # the same of lag and time offset
DRIVERS = 5  # unplanned drives to compare with
TRIES = 8
LEAST = 0.15  # share of the area that must be left to plan in once the drift is allowed for
MOST_LENGTH, MOST_TIME = 1e4, 8.0 * 3600.0  # [m], [s] of a drive
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Request:
    """What is wanted of a drive.

    Raises:
        RequestError: an area or a time that is not positive, or beyond what anybody drives.
    """

    area: tuple[float, float]  # [m] along the first heading and across it; the robot starts in the middle
    time: float  # [s]
    margin: float = 0.25  # [m] to keep from the edge
    seed: int = 0

    def __post_init__(self) -> None:
        most = f"of at most {MOST_LENGTH:g} m", f"of at most {MOST_TIME / 60.0:g}"
        if not all(0.0 < side <= MOST_LENGTH for side in self.area):
            raise RequestError(f"--area needs two positive lengths in m {most[0]}, as 10x10, got {self.area}")
        if not 0.0 < self.time <= MOST_TIME:
            raise RequestError(f"--minutes must be a positive time {most[1]}, got {self.time / 60.0:g}")
        if not (np.isfinite(self.margin) and self.margin >= 0.0):
            raise RequestError(f"--margin must be a length in m, at least 0, got {self.margin:g}")

    def room(self, vehicle: Vehicle) -> tuple[float, float]:
        """How far [m] base_link may get from the start along x and y.

        Raises:
            RequestError: nowhere.
        """
        need = footprint_radius(vehicle) + self.margin
        x, y = 0.5 * self.area[0] - need, 0.5 * self.area[1] - need
        if min(x, y) <= 0.0:
            raise RequestError(
                f"{vehicle.name} cannot turn in {self.area[0]:g} x {self.area[1]:g} m; with --margin {self.margin:g} m"
                f" it needs more than {2.0 * need:.1f} x {2.0 * need:.1f} m"
            )
        return x, y


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """A drive and what it is expected to tell."""

    setup: Setup
    limits: Limits
    request: Request
    figures: tuple[Figure, ...]  # one after the other
    rims: Series  # (n, 2) [m/s] every ``PERIOD``
    path: Series  # (m, 3) expected poses from the first one
    sigmas: Mapping[str, float]  # of parameters, lag and time offset
    unplanned: Mapping[str, float]  # the same after an unplanned drive of equal length: median of ``DRIVERS``
    excursion: Excursion

    @property
    def duration(self) -> float:
        """[s]."""
        return len(self.rims) * PERIOD

    @property
    def controller(self) -> Differential:
        """What the robot's own controller turns v and omega into rim speeds with."""
        return controller(self.setup.vehicle)

    @property
    def commands(self) -> Series:
        """Speeds v [m/s] and omega [rad/s] (n, 2) that make the robot's controller turn its rims as planned."""
        twist = self.controller.twist(*self.rims.values.T)
        return Series(self.rims.t, twist[:, [0, 2]], "commands")

    @property
    def schedule(self) -> list[tuple[float, float, Figure]]:
        """Start and duration [s] of each figure."""
        lengths = [len(figure.profile(self.limits.acceleration)) * PERIOD for figure in self.figures]
        starts = REST + np.concatenate([[0.0], np.cumsum(lengths)])
        return list(zip(starts.tolist(), lengths, self.figures, strict=False))

    @property
    def strokes(self) -> list[FloatArray]:
        """Positions (n, 2) [m] of each figure."""
        t = self.path.t
        return [self.path.values[(t >= a) & (t <= a + d + PERIOD), :2] for a, d, _ in self.schedule]


def setup_of(
    vehicle: Vehicle,
    family: type[Model],
    calibration: Calibration | None = None,
    reference_rate: float = 10.0,
    position_noise: float | None = None,
    yaw_noise: float | None = None,
) -> Setup:
    """What is expected: from a calibration where there is one, else from the vehicle.

    Raises:
        RequestError: a model without parameters, another model than the calibration's, or noise that cannot be.
    """
    if not family.PARAMETERS:
        raise RequestError(f"{family.NAME} has no parameters to determine; choose another model")
    if calibration is not None and family is not type(calibration.model):
        raise RequestError(f"the calibration is of {calibration.model.NAME}; give --model {calibration.model.NAME}")
    known = {"position": position_noise, "yaw": yaw_noise, "rate": reference_rate}
    for name, value in known.items():
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise RequestError(f"the reference's {name} must be positive, got {value:g}")
    noise = Noise() if calibration is None else calibration.noise
    noise = replace(noise, **{k: v for k, v in (("position", position_noise), ("yaw", yaw_noise)) if v is not None})
    model = expected_model(family, vehicle) if calibration is None else calibration.model
    timing = Timing(0.0, 0.1) if calibration is None else Timing(0.0, calibration.timing.lag)
    return Setup(vehicle, model, noise, timing, reference_rate)


def design_drive(
    setup: Setup,
    limits: Limits,
    request: Request,
    calibration: Calibration | None = None,
    progress: Progress | None = None,
) -> Design:
    """The drive that determines the model of a set-up best.

    The planned area is made smaller until robots that differ from the expected one as much as they may, with motion
    noise, stay inside the area.

    Raises:
        RequestError: the area is too small, or the time too short for a single figure.
    """
    room, lag = request.room(setup.vehicle), setup.timing.lag
    robots = (
        calibrated_models(calibration, request.seed) if calibration else possible_models(setup.vehicle, request.seed)
    )
    _tell(progress, "driving without a plan", 0)
    unplanned = unplanned_sigmas(setup, limits, request)
    shares = [*[ENOUGH] * len(setup.model.PARAMETERS), ENOUGH_TIMING, ENOUGH_TIMING]
    enough = np.array([share * unplanned[name] for share, name in zip(shares, setup.names, strict=True)])
    look_at = cache(partial(_candidate, setup, limits, robots[:ROBOTS]))
    share = 1.0
    for i in range(TRIES):
        _tell(progress, f"designing within {100 * share:.0f} % of the area", i + 1)
        part = (share * room[0], share * room[1])
        candidates = [c for c in map(look_at, library(setup.model, limits, part[0])) if _fits(c, part)]
        figures = _chosen(candidates, request.time - 2.0 * REST, setup.prior, enough)
        rims = rims_of(figures, limits.acceleration, REST)
        reached = excursion(robots, rims, lag, setup.noise, request.seed)
        over = max(reached.x / room[0], reached.y / room[1])
        if over <= 1.0:
            break
        share = min(share / over, 0.95 * share)
        if share < LEAST or i == TRIES - 1:
            raise _too_small(request, over)
    _tell(progress, "done", TRIES + 1)
    path = trajectory(setup.model, rims, lag, step=PERIOD)
    sigmas = setup.sigmas(setup.information(rims))
    return Design(setup, limits, request, tuple(figures), rims, path, sigmas, unplanned, reached)


def _too_small(request: Request, over: float) -> RequestError:
    return RequestError(
        f"{request.area[0]:g} x {request.area[1]:g} m are too small for {request.time / 60.0:g} minutes by a table of"
        f" commands: a robot like this may get {over:.1f} times as far as there is room; give a larger --area, fewer"
        " --minutes, or what is known of it with --calibration"
    )


def _tell(progress: Progress | None, what: str, done: int) -> None:
    if progress is not None:
        progress(what, done, TRIES + 1)


def unplanned_sigmas(setup: Setup, limits: Limits, request: Request) -> dict[str, float]:
    """What an unplanned drive of the same length would tell: the median of ``DRIVERS``."""
    room = request.room(setup.vehicle)
    width = expected_icr_distance(setup.vehicle)
    drives = [unplanned_drive(width, limits, room, request.time, request.seed + i) for i in range(DRIVERS)]
    found = [setup.sigmas(setup.information(rims)) for rims in drives]
    return {name: float(np.median([sigmas[name] for sigmas in found])) for name in setup.names}


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A figure, how long it takes, how far any robot goes with it, and what it tells."""

    figure: Figure
    duration: float  # [s]
    reached: Excursion
    information: FloatArray


def _candidate(setup: Setup, limits: Limits, robots: list[Model], figure: Figure) -> Candidate:
    rims = rims_of([figure], limits.acceleration, 2.0 * PERIOD)
    reached = excursion(robots, rims, setup.timing.lag, None)
    return Candidate(figure, (len(rims) - 4) * PERIOD, reached, setup.information(rims))


def _fits(candidate: Candidate, room: tuple[float, float]) -> bool:
    """Whether any robot drives a figure inside the room, and comes back from it."""
    reached = candidate.reached
    return reached.x <= STRETCH * room[0] and reached.y <= room[1] and reached.end <= DRIFT * min(room)


def _chosen(candidates: list[Candidate], time: float, prior: FloatArray, enough: FloatArray) -> list[Figure]:
    """The best figures in a time [s], the widest first: then the robot is still where it should be."""
    if not candidates or min(c.duration for c in candidates) > time:
        raise RequestError(f"{time:.1f} s are too short for any manoeuvre in this area; give more --minutes")
    information = np.array([c.information for c in candidates])
    choice = Choice(information, np.array([c.duration for c in candidates]), prior, enough)
    chosen = [candidates[i] for i in choice.choose(time)]
    widest = sorted(chosen, key=lambda c: (-max(c.reached.x, c.reached.y), -c.duration))
    return [c.figure for c in widest]


def make_request(
    area: str,
    minutes: float,
    vehicle: Vehicle | None = None,
    model: str | None = None,
    calibration: Calibration | None = None,
    reference_rate: float = 10.0,
    position_noise: float | None = None,
    yaw_noise_deg: float | None = None,
    margin: float = 0.25,
    seed: int = 0,
) -> tuple[Setup, Request]:
    """Set-up and request from the words of a command line; vehicle and model are the calibration's unless given.

    Without a calibration the model is scheduled_icr: what determines it determines the constant ICR, too.

    Raises:
        RequestError: a word or number that cannot be.
    """
    if vehicle is None and calibration is None:
        raise RequestError("which robot? give --vehicle NAME|FILE or --calibration FILE")
    vehicle = vehicle or calibration.vehicle  # type: ignore[union-attr]
    model = model or (calibration.model.NAME if calibration is not None else "scheduled_icr")
    if model not in MODELS:
        raise RequestError(f"no model '{model}'; there are: {', '.join(MODELS)}")
    yaw_noise = None if yaw_noise_deg is None else float(np.radians(yaw_noise_deg))
    setup = setup_of(vehicle, MODELS[model], calibration, reference_rate, position_noise, yaw_noise)
    return setup, Request(_area(area), 60.0 * minutes, margin, seed)


def _area(word: str) -> tuple[float, float]:
    try:
        length, width = (float(side) for side in word.lower().split("x"))
    except ValueError:
        raise RequestError(f"--area {word!r} is not two lengths in m; write it as 10x10") from None
    return length, width
