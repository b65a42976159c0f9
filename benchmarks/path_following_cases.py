"""Closed loops of the path-following study: a case is what is driven, a score what came of it.

Cases are plain values and are driven in two processes; what came of them is kept in ``build/path-following``, so that a
study that was broken off goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from multiprocessing import get_context
from multiprocessing.pool import Pool
from pathlib import Path

from path_following_laws import LAWS, Known
from skidsteer.control import Wheels
from skidsteer.errors import SkidSteerError
from skidsteer.follow import Ends, Jump, Run, Sensing, follow, summarize
from skidsteer.models import MODELS, Model
from skidsteer.plants import begin
from skidsteer.reproduce import huskic_runs as site
from skidsteer.terramechanics.terrain import TERRAINS, Ground

STORE = Path(__file__).resolve().parents[1] / "build" / "path-following"
PATHS = {"lemniscate": site.LEMNISCATE, "course": site.COURSE}
RIM_LIMIT = 3.0  # [m/s] of the Summit XL's wheels
ACCELERATION = 3.0  # [m/s^2] that no rim speed sent exceeds
OFF = 1.0  # [m] from the path, beyond which a run has failed
NOISE = Sensing(position_sigma=0.01, yaw_sigma=0.01, wheel_sigma=0.01, gyro_sigma=0.01)  # [m, rad, m/s, rad/s]
PROCESSES = 2

Gains = tuple[tuple[str, float], ...]
Place = tuple[str, str]  # plant and terrain


@dataclass(frozen=True, slots=True)
class Case:
    """One closed loop."""

    law: str  # of LAWS
    gains: Gains
    speed: float  # [m/s] asked for
    place: Place
    path: str = "lemniscate"
    laps: int = 2
    lag: float = 0.1  # [s] of the wheels
    delay: float = 0.06  # [s] of the pose
    believed: tuple[str, str, str] = ("", "", "icr")  # plant and terrain of the calibration, or published; its model
    lag_share: float = 1.0  # lag and delay that a law is told, over the true ones
    jump: float = 0.0  # [m] to the left, at half of the way
    noisy: bool = False  # pose, wheels and gyro, see ``NOISE``
    off: float = OFF  # [m]

    @property
    def key(self) -> str:
        """Names it in the store: what differs from the defaults."""
        told = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}
        return hashlib.sha256(json.dumps(told).encode()).hexdigest()[:24]


@dataclass(frozen=True, slots=True)
class Score:
    """What came of a case; errors are of the true pose, across the path, over the whole run."""

    done: bool
    outcome: str
    share: float  # of the way that was driven
    mean: float  # [m]
    largest: float  # [m]
    rms: float  # [m]
    speed: float  # [m/s] along the path
    effort: float  # [m/s^2] RMS change of the rim speeds asked for
    energy: float | None  # [J/m] that the rims put in
    settled: float | None = None  # [m] of way after a jump, until it stays within 0.1 m of the path


def believed(case: Case) -> Model:
    """The model that a case's controller has of the robot."""
    plant, terrain, model = case.believed
    if plant == "published":
        return site.PUBLISHED[terrain]
    place = (plant, terrain) if plant else case.place
    return calibration(*place, model)


def calibration(plant: str, terrain: str, model: str) -> Model:
    """``huskic_runs.calibrated``, kept in a file."""
    file = STORE / f"calibration-{plant}-{terrain}-{model}.json"
    if not file.exists():
        found = site.calibrated(plant, terrain, model)
        _write(file, {"model": found.NAME, "theta": found.theta.tolist()})
    kept = json.loads(file.read_text())
    return MODELS[kept["model"]].nominal(site.VEHICLE).with_theta(kept["theta"])


def run(case: Case) -> Run:
    """Drive a case."""
    path, (plant, terrain) = PATHS[case.path], case.place
    known = Known(believed(case), RIM_LIMIT, ACCELERATION, case.lag_share * case.lag, case.lag_share * case.delay)
    law = LAWS[case.law].build(dict(case.gains), case.speed, known)
    if plant == "kinematic":
        rolling = begin(plant, site.VEHICLE, Ground(TERRAINS["grass"]), path.at(0.0), case.lag, site.PUBLISHED[terrain])
    else:
        rolling = begin(plant, site.VEHICLE, Ground(TERRAINS[terrain]), path.at(0.0), case.lag)
    jumps = (Jump(left=case.jump, share=0.5),) if case.jump else ()
    way = case.laps * path.length if path.closed else path.length
    ends = Ends(case.laps, 20.0 + 3.0 * way / case.speed, case.off)
    sensing = replace(NOISE if case.noisy else Sensing(), delay=case.delay, jumps=jumps)
    driven = known.constant if LAWS[case.law].constant else known.model
    return follow(rolling, law, Wheels(driven, RIM_LIMIT), path, sensing, ends, ACCELERATION)


def score(case: Case) -> Score:
    """Drive a case and judge it; a controller that breaks down has failed, too."""
    try:
        done = run(case)
    except (ArithmeticError, SkidSteerError) as fault:
        nothing = math.nan
        return Score(False, f"{type(fault).__name__}", 0.0, nothing, nothing, nothing, 0.0, nothing, None)
    told, path = summarize(done), PATHS[case.path]
    way = case.laps * path.length if path.closed else path.length
    energy = None if told.energy is None or told.way <= 0.0 else told.energy / told.way
    return Score(
        done.done,
        done.outcome,
        min(max(told.way / way, 0.0), 1.0),
        told.mean,
        told.largest,
        told.rms,
        told.way / max(told.duration, 1e-9),
        told.effort,
        energy,
        _settled(done) if case.jump else None,
    )


def _settled(done: Run) -> float | None:
    """Way [m] from a jump until the robot stays within 0.1 m of the path; None: it does not."""
    middle = 0.5 * (done.s[0] + done.s[-1])
    after = done.s >= middle
    wide = abs(done.cross_track[after]) > 0.1
    if not wide.any() or wide[-1] or not done.done:
        return None if wide.any() else 0.0
    last = len(wide) - 1 - int(wide[::-1].argmax())
    return float(done.s[after][last + 1] - middle)


def scores(cases: Sequence[Case]) -> list[Score]:
    """Of each case, driven where they are not in the store."""
    wanted = list(dict.fromkeys(case for case in cases if not _file(case).exists()))
    if wanted:
        for case in wanted:
            believed(case)  # calibrates once, not in each process
        for i, case in enumerate(_pool().imap_unordered(_drive, wanted, chunksize=1), start=1):
            if i % 100 == 0 or i == len(wanted) > 100:
                print(f"  {i} of {len(wanted)} runs, last {case.law} at {case.speed:g} m/s", flush=True)
    return [Score(**json.loads(_file(case).read_text())) for case in cases]


@cache
def _pool() -> Pool:
    return get_context("spawn").Pool(PROCESSES)


def _drive(case: Case) -> Case:
    _write(_file(case), asdict(score(case)))
    return case


def _file(case: Case) -> Path:
    return STORE / case.law.replace(" ", "-") / f"{case.key}.json"


def _write(file: Path, values: dict[str, object]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part")
    part.write_text(json.dumps(values))
    part.replace(file)


def cost(found: Score) -> float:
    """What the tuning makes small: mean error [cm]; a failed run counts 1 m, and up to 1 m more for what is left."""
    return 100.0 * found.mean if found.done and math.isfinite(found.mean) else 200.0 - 100.0 * found.share


def with_speed(case: Case, speeds: Sequence[float]) -> list[Case]:
    return [replace(case, speed=speed) for speed in speeds]
