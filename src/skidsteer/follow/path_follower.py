"""What runs on the robot: from the pose that is told, or none, to the rim speeds that are sent.

It keeps three promises whatever the controller does: no rim speed sent is beyond the wheels' limit, none changes faster
than their acceleration, and where no pose comes the robot slows down and stands until one does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic

from skidsteer.control import Command, Controller, Wheels
from skidsteer.control.path_state import State
from skidsteer.errors import RequestError
from skidsteer.follow.known_pose import KnownPose, finite, grace
from skidsteer.follow.sensing import Triple, twist_function
from skidsteer.paths import Path

STANDING = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Memory(Generic[State]):
    """What is known between two samples, and what was sent last."""

    known: KnownPose | None = None  # None: no pose has come yet
    state: State | None = None  # of the controller
    asked: Command = STANDING  # v [m/s], omega [rad/s] by the controller
    sent: Command = STANDING  # [m/s] rim speeds
    realised: Command = STANDING  # v, omega that they are believed to give
    pace: float = 0.0  # [m/s] of the faster rim when a pose came last


class PathFollower(Generic[State]):
    """A controller on its way along a path; its functions are pure.

    Args:
        controller: that drives.
        wheels: the model that turns commands into rim speeds, which is what is believed of the robot; their limit.
        path: to follow.
        acceleration: [m/s^2] by which no rim speed sent changes faster.
        pose_rate: [Hz] at which poses come: one that is due only later is not lost.

    Raises:
        RequestError: an acceleration or a rate that is not above 0.
    """

    def __init__(
        self,
        controller: Controller[State],
        wheels: Wheels,
        path: Path,
        acceleration: float = math.inf,
        pose_rate: float = math.inf,
    ) -> None:
        if not acceleration > 0.0:
            raise RequestError(f"the acceleration of the wheels must be above 0 m/s^2, got {acceleration}")
        if not pose_rate > 0.0:
            raise RequestError(f"the rate of the poses must be above 0 Hz, got {pose_rate}")
        self._grace = grace(pose_rate)
        self._controller, self._wheels, self._path, self._acceleration = controller, wheels, path, acceleration
        self._twist = twist_function(wheels.model)

    def drive(self, before: Memory[State], seen: Triple | None, twist: Triple, dt: float) -> Memory[State]:
        """Memory and rim speeds of a sample.

        Args:
            before: of the last sample; ``Memory()`` at the beginning.
            seen: pose that was told; None or not finite: none.
            twist: measured; where it is not finite the one that was sent last is taken for it.
            dt: [s] since the last sample.
        """
        twist = twist if finite(twist) else (before.realised[0], 0.0, before.realised[1])
        known = KnownPose.first(seen, self._grace) if before.known is None else before.known.after(dt, twist, seen)
        if known is None:
            return self._sent(before, None, None, STANDING, dt)
        if before.state is None:
            state = self._controller.begin(self._path, known.pose)
        else:
            told = known.pose, twist, dt, before.realised
            state = self._controller.advance(before.state, *told, known.age > 0.0)
        return self._sent(before, known, state, self._controller.command(known.pose, twist, state), dt)

    def _sent(
        self, before: Memory[State], known: KnownPose | None, state: State | None, asked: Command, dt: float
    ) -> Memory[State]:
        left, right = self._wheels.speeds(*asked).tolist()
        caution = known.caution if known is not None else 0.0
        if caution < 1.0:
            left, right = _slowed((left, right), caution * before.pace)
        sent = _within((left, right), before.sent, self._acceleration * dt)
        v, _, omega = self._twist(*sent)
        pace = max(abs(sent[0]), abs(sent[1])) if caution == 1.0 else before.pace
        return Memory(known, state, asked, sent, (v, omega), pace)


def _slowed(asked: Command, fastest: float) -> Command:
    """Rim speeds in the same proportion, none of them beyond that [m/s]."""
    most = max(abs(asked[0]), abs(asked[1]))
    share = min(1.0, fastest / most) if most else 1.0
    return share * asked[0], share * asked[1]


def _within(asked: Command, before: Command, change: float) -> Command:
    """Rim speeds on the straight way from those before to those asked for, none changed by more than that [m/s]."""
    left, right = asked[0] - before[0], asked[1] - before[1]
    most = max(abs(left), abs(right))
    if most <= change:
        return asked
    share = change / most
    return before[0] + share * left, before[1] + share * right
