"""The closed loop: a pose is told, the controller commands, the wheels are asked, the robot moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skidsteer.control import Command, Controller, Wheels
from skidsteer.control.path_state import State
from skidsteer.errors import RequestError
from skidsteer.follow.known_pose import KnownPose
from skidsteer.follow.run import Run
from skidsteer.follow.sensing import IDEAL, Localization, Sensing, Triple, twist_function, twist_meter
from skidsteer.paths import Path
from skidsteer.rolling import OverturnedError, Rolling
from skidsteer.se2 import FloatArray

NEAR_END = 0.5  # [m] before the end of an open path, within which a robot that its controller stops has arrived
STILL = 0.01  # [m/s] of the rims, below which the robot stands
PATIENCE = 5.0  # [s] that it may stand on the way although poses come


@dataclass(frozen=True, slots=True)
class Ends:
    """When driving ends."""

    laps: float = 1.0  # of a closed path
    time: float = 600.0  # [s]
    off: float = 3.0  # [m] from the path, beyond which it is lost

    def __post_init__(self) -> None:
        for name in ("laps", "time", "off"):
            if not getattr(self, name) > 0.0:
                raise RequestError(f"{name} must be above 0, got {getattr(self, name)}")


class Row(NamedTuple):
    """A sample of the loop, see ``Run``."""

    state: FloatArray
    placed: Triple
    seen: Triple
    commanded: Command
    sent: Command
    at: Triple  # s, cross-track and heading error
    power: FloatArray


NONE = (math.nan, math.nan, math.nan)


def follow(
    rolling: Rolling,
    controller: Controller[State],
    wheels: Wheels,
    path: Path,
    sensing: Sensing = IDEAL,
    ends: Ends = Ends(),
    acceleration: float = math.inf,
    seed: int = 0,
) -> Run:
    """Let a controller drive a robot along a path.

    While no pose comes the robot is reckoned by what the wheels and the gyro tell, for half a second, ever slower; then
    it stands until a pose comes.

    Args:
        rolling: the robot, where it begins; it is driven on.
        controller: that drives it.
        wheels: the model that turns commands into rim speeds, which is what is believed of the robot; their limit.
        path: to follow.
        sensing: rate of the loop, and what the controller is told.
        ends: when to end.
        acceleration: [m/s^2] by which no rim speed sent changes faster.
        seed: of the noise.

    Returns:
        Every sample, and how it ended: arrived, laps done, lost the path, tipped over, stands still, time is up.

    Raises:
        RequestError: a step that the plant cannot simulate.
    """
    dt, limit = 1.0 / sensing.rate, acceleration / sensing.rate
    localization, meter = Localization(sensing, seed), twist_meter(wheels.model, sensing, seed)
    realised = twist_function(wheels.model)
    goal = ends.laps * path.length if path.closed else path.length
    rows: list[Row] = []
    known, state, sent, commanded = None, None, (0.0, 0.0), (0.0, 0.0)
    near, begun, stood, end = None, 0.0, 0, ("time is up", f"{ends.time:g} s are over")
    for k in range(round(ends.time * sensing.rate) + 1):
        numbers = rolling.state.tolist()
        twist, t = meter(numbers), k * dt
        placed = localization.place((numbers[0], numbers[1], numbers[2]), t, ((near or begun) - begun) / goal)
        seen = localization.see(placed, t)
        near = path.project(placed[:2], near=near)
        begun = near if k == 0 else begun
        _, aside, turned = path.error(placed, near).tolist()
        if known is not None:
            known = known.after(dt, twist, seen)
        elif seen is not None:
            known = KnownPose(seen)
        if known is None:
            asked = (0.0, 0.0)
        else:
            if state is None:
                state = controller.begin(path, known.pose)
            else:
                state = controller.advance(state, known.pose, twist, dt, commanded)
            v, omega = controller.command(known.pose, twist, state)
            asked = (known.caution * v, known.caution * omega)
        left, right = wheels.speeds(*asked).tolist()
        sent = _slowed(sent, (left, right), limit)
        v, _, omega = realised(*sent)
        commanded = v, omega
        rows.append(Row(rolling.state, placed, seen or NONE, asked, sent, (near, aside, turned), rolling.power))
        stood = stood + 1 if max(abs(numbers[6]), abs(numbers[7])) < STILL and known and known.age == 0.0 else 0
        stopped = asked == (0.0, 0.0) and stood > 0
        if path.closed and near - begun >= goal:
            end = "laps done", f"{ends.laps:g} laps are driven"
            break
        if not path.closed and stopped and path.length - near <= NEAR_END:
            end = "arrived", f"it stands {path.length - near:.2f} m before the end of the path"
            break
        if math.hypot(*(a - b for a, b in zip(placed[:2], path.at(near)[:2], strict=True))) > ends.off:
            end = "lost the path", f"it is {abs(aside):.2f} m off the path at {t:.2f} s, more than {ends.off:g} m"
            break
        if stood * dt > PATIENCE:
            end = "stands still", f"it does not move on from s = {near:.2f} m"
            break
        try:
            rolling.step(sent, dt)
        except OverturnedError as fall:
            end = "tipped over", str(fall)
            break
    return _run(path, dt, rows, *end)


def _slowed(before: Command, asked: Command, limit: float) -> Command:
    """Rim speeds on the way from those before to those asked for, none of them changed by more than a limit [m/s]."""
    left, right = asked[0] - before[0], asked[1] - before[1]
    most = max(abs(left), abs(right))
    if most <= limit:
        return asked
    share = limit / most
    return before[0] + share * left, before[1] + share * right


def _run(path: Path, dt: float, rows: list[Row], outcome: str, reason: str) -> Run:
    columns: list[FloatArray] = [np.array(column, dtype=float) for column in zip(*rows, strict=True)]
    states, placed, seen, commanded, sent, at, power = columns
    s, aside, turned = at.T
    t: FloatArray = dt * np.arange(len(rows), dtype=float)
    return Run(path, t, states, placed, seen, commanded, sent, s, aside, turned, power, outcome, reason)
