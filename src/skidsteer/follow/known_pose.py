"""Where the robot is while no pose comes: reckoned for a moment, ever slower, then it stands until one comes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from skidsteer.follow.sensing import Triple

GRACE = 0.1  # [s] without a pose that change nothing, at least
MISSED = 2.0  # periods of the poses that change nothing: one may fail to come
SLOWING = 0.4  # [s] after them, within which the robot comes to stand


def grace(pose_rate: float) -> float:
    """Time [s] without a pose that changes nothing, where they come at a rate [Hz]."""
    return max(GRACE, MISSED / pose_rate)


@dataclass(frozen=True, slots=True)
class KnownPose:
    """A pose, and how long ago the last one came."""

    pose: Triple
    age: float = 0.0  # [s]
    grace: float = GRACE  # [s] without a pose that change nothing

    @classmethod
    def first(cls, seen: Triple | None, grace: float = GRACE) -> KnownPose | None:
        """The first pose that is told, as soon as one is."""
        return cls(seen, grace=grace) if seen is not None and finite(seen) else None

    @property
    def caution(self) -> float:
        """Share of the pace that it had when a pose came last: 1 while poses come, 0 ``SLOWING`` after the grace."""
        return min(max((self.grace + SLOWING - self.age) / SLOWING, 0.0), 1.0)

    def after(self, dt: float, twist: Triple, seen: Triple | None) -> KnownPose:
        """Dt [s] later: the pose seen, or where a measured twist brought it. One that is not finite counts as none."""
        if seen is not None and finite(seen):
            return replace(self, pose=seen, age=0.0)
        x, y, yaw = self.pose
        v_x, v_y, omega = twist
        half = 0.5 * omega * dt
        chord = dt * math.sin(half) / half if half else dt
        cos, sin = math.cos(yaw + half), math.sin(yaw + half)
        moved = x + chord * (cos * v_x - sin * v_y), y + chord * (sin * v_x + cos * v_y), yaw + 2.0 * half
        return replace(self, pose=moved, age=self.age + dt)


def finite(numbers: Triple) -> bool:
    """Whether all three are."""
    return math.isfinite(numbers[0] + numbers[1] + numbers[2])
