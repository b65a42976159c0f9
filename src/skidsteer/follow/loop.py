"""The closed loop: a pose is told, the controller commands, the wheels are asked, the robot moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skidsteer.control import Command, Controller, PathError, PathState, Wheels, path_error
from skidsteer.control.path_state import State
from skidsteer.errors import RequestError
from skidsteer.follow.path_follower import STANDING, Memory, PathFollower
from skidsteer.follow.refusals import refuse_path, refuse_start
from skidsteer.follow.run import Run
from skidsteer.follow.sensing import IDEAL, Localization, Sensing, Triple, twist_meter
from skidsteer.paths import Path
from skidsteer.progress import Progress, silent
from skidsteer.rolling import OverturnedError, Rolling
from skidsteer.se2 import FloatArray

NEAR_END = 0.5  # [m] from the end of an open path, within which a robot that its controller stops has arrived
STILL = 0.01  # [m/s] of the rims, below which the robot stands
PATIENCE = 5.0  # [s] that it may stand on the way although poses come
UNKNOWN = (math.nan, math.nan, math.nan)

End = tuple[str, str]  # outcome and reason


@dataclass(frozen=True, slots=True)
class Ends:
    """When driving ends.

    Raises:
        RequestError: one of them is not above 0.
    """

    laps: float = 1.0  # of a closed path
    time: float = 600.0  # [s]
    off: float = 3.0  # [m] from the path, beyond which it is lost

    def __post_init__(self) -> None:
        named = {"laps": self.laps, "the time [s]": self.time, "the distance off the path [m]": self.off}
        for name, value in named.items():
            if not value > 0.0:
                raise RequestError(f"{name} must be above 0, got {value:g}")


ONCE = Ends()


class Row(NamedTuple):
    """A sample of the loop, see ``Run``."""

    state: FloatArray
    placed: Triple
    seen: Triple
    commanded: Command
    sent: Command
    at: Triple  # s, cross-track and heading error
    power: FloatArray


def follow(
    rolling: Rolling,
    controller: Controller[State],
    wheels: Wheels,
    path: Path,
    sensing: Sensing = IDEAL,
    ends: Ends = ONCE,
    acceleration: float = math.inf,
    seed: int = 0,
    progress: Progress = silent,
) -> Run:
    """Let a controller drive a robot along a path.

    Args:
        rolling: the robot, where it begins; it is driven on.
        controller: that drives it, see ``PathFollower``.
        wheels: the model that turns commands into rim speeds, which is what is believed of the robot; their limit.
        path: to follow.
        sensing: rate of the loop, and what the controller is told.
        ends: when to end.
        acceleration: [m/s^2] by which no rim speed sent changes faster.
        seed: of the noise.
        progress: called once a second of the drive, with the percentage of the way.

    Returns:
        Every sample, and how it ended: arrived, laps done, lost the path, tipped over, stands still, time is up, or
        not simulated on: a step that the plant cannot simulate.

    Raises:
        RequestError: a path or a start that cannot be driven.
    """
    refuse_path(path, wheels)
    refuse_start(path, rolling.state[:3], ends.off)
    follower = PathFollower(controller, wheels, path, acceleration, sensing.poses)
    localization, meter = Localization(sensing, seed), twist_meter(wheels.model, sensing, seed)
    memory: Memory[State] = Memory()
    judge, rows, dt, end = Judge(path, ends), list[Row](), 1.0 / sensing.rate, None
    while end is None:
        t, state = len(rows) * dt, rolling.state
        if len(rows) % max(round(sensing.rate), 1) == 0:
            progress(f"driving, {t:.0f} s", int(100.0 * judge.share), 100)
        x, y, yaw, *moving = state.tolist()
        placed = localization.place((x, y, yaw), t, judge.share)
        seen, twist = localization.see(placed, t), meter(moving)
        memory = follower.drive(memory, seen, twist, dt)
        at = judge.locate(placed)
        row = (judge.s, at.y_e, at.theta_e)
        rows.append(Row(state, placed, seen or UNKNOWN, memory.asked, memory.sent, row, rolling.power))
        end = judge.end(t, at, memory, max(abs(moving[3]), abs(moving[4])))
        try:
            rolling.step(memory.sent, 0.0 if end else dt)
        except OverturnedError as fall:
            end = "tipped over", str(fall)
        except RequestError as fault:
            end = "not simulated on", str(fault)
    return _run(path, dt, rows, *end)


class Judge:
    """How far the robot has come, by its true pose in the map, and whether driving ends."""

    def __init__(self, path: Path, ends: Ends) -> None:
        self._path, self._ends = path, ends
        self._goal = ends.laps * path.length if path.closed else path.length
        self.s, self._begun = math.nan, math.nan  # [m] along the path
        self._since: float | None = None  # [s] when it came to stand

    @property
    def share(self) -> float:
        """Of the way."""
        return 0.0 if math.isnan(self.s) else (self.s - self._begun) / self._goal

    def locate(self, placed: Triple) -> PathError:
        """Errors of a pose, by projection."""
        if math.isnan(self.s):
            state = PathState.begin(self._path, placed)
            self._begun = state.s
        else:
            state = PathState(self._path, self._path.project(placed[:2], near=self.s))
        self.s = state.s
        return path_error(state, placed)

    def end(self, t: float, at: PathError, memory: Memory[State], fastest: float) -> End | None:
        """Outcome and reason, or None: drive on; ``fastest`` [m/s] is the faster rim."""
        stands = fastest < STILL and memory.known is not None and memory.known.caution == 1.0
        self._since = (self._since if self._since is not None else t) if stands else None
        left = math.hypot(self._path.length - self.s, at.x_e, at.y_e)
        if self._path.closed and self.share >= 1.0:
            return "laps done", f"{self._ends.laps:g} laps are driven"
        if not self._path.closed and stands and memory.asked == STANDING and left <= NEAR_END:
            return "arrived", f"it stands {left:.2f} m from the end of the path"
        if (off := math.hypot(at.x_e, at.y_e)) > self._ends.off:
            return "lost the path", f"it is {self._off(at)} at {t:.2f} s, more than {self._ends.off:g} m"
        if self._since is not None and t - self._since > PATIENCE:
            aside = f", {self._off(at)}" if off > NEAR_END else ""
            return "stands still", f"it does not move on from {self.s:.2f} m along the path{aside}"
        return ("time is up", f"{self._ends.time:g} s are over") if t >= self._ends.time else None

    def _off(self, at: PathError) -> str:
        """How far it is from its point of the path: off to a side, or past an end."""
        distance = f"{math.hypot(at.x_e, at.y_e):.2f} m"
        if not self._path.closed and at.x_e > abs(at.y_e) and self.s >= self._path.length:
            return f"{distance} past the end of the path"
        if not self._path.closed and -at.x_e > abs(at.y_e) and self.s <= 0.0:
            return f"{distance} before the beginning of the path"
        return f"{distance} off"


def _run(path: Path, dt: float, rows: list[Row], outcome: str, reason: str) -> Run:
    columns: list[FloatArray] = [np.array(column, dtype=float) for column in zip(*rows, strict=True)]
    states, placed, seen, commanded, sent, at, power = columns
    s, aside, turned = at.T
    t: FloatArray = dt * np.arange(len(rows), dtype=float)
    return Run(path, t, states, placed, seen, commanded, sent, s, aside, turned, power, outcome, reason)
