"""Regulated pure pursuit, as users of Nav2 know it: Macenski, Singh, Martin, Gines 2023, arXiv:2305.20026.

The robot drives the arc that leads to a point of the path ahead, curvature 2 y / L^2. Names, units and defaults of the
options are Nav2's; its regulation by obstacles, which needs a costmap, is left out. It knows nothing of icr_x.

A fixed point is reached on one circle, of radius L / (2 sin a) where it is seen at an angle a. A robot that faces away
from its path therefore makes a wide turn, of radius 26 m for a point at 0.9 m and 179 deg, and none at exactly 180 deg,
unless it may rotate on the spot: ``use_rotate_to_heading``, on by default, off in ``adaptive`` and ``plain``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from numpy.typing import ArrayLike

from skidsteer.control.path_state import Command, PathState, finite, require_positive
from skidsteer.kernels import paths as kernels

STEPS = 20  # per lookahead distance, in the search along the path


@dataclass(frozen=True, slots=True)
class PurePursuit:
    """Options of Nav2's ``RegulatedPurePursuitController``; ``xy_goal_tolerance`` is its goal checker's.

    Raises:
        ValueError: an option that is not above 0, or ``min_lookahead_dist`` above ``max_lookahead_dist``.
    """

    desired_linear_vel: float = 0.5  # [m/s]
    lookahead_dist: float = 0.6  # [m] where it does not scale with the speed
    min_lookahead_dist: float = 0.3  # [m]
    max_lookahead_dist: float = 0.9  # [m]
    lookahead_time: float = 1.5  # [s] of driving to look ahead
    use_velocity_scaled_lookahead_dist: bool = False
    use_regulated_linear_velocity_scaling: bool = True
    regulated_linear_scaling_min_radius: float = 0.9  # [m] in sharper turns it slows down
    regulated_linear_scaling_min_speed: float = 0.25  # [m/s] below which the regulation does not slow it down
    use_fixed_curvature_lookahead: bool = False
    curvature_lookahead_dist: float = 1.0  # [m] at which the regulation looks for turns, if fixed
    approach_velocity_scaling_dist: float = 1.0  # [m] from the end, within which it slows down
    min_approach_linear_velocity: float = 0.05  # [m/s]
    use_rotate_to_heading: bool = True
    rotate_to_heading_min_angle: float = 0.785  # [rad] to the point ahead, beyond which it turns on the spot
    rotate_to_heading_angular_vel: float = 1.8  # [rad/s]
    max_angular_accel: float = 3.2  # [rad/s^2] of turning on the spot
    controller_frequency: float = 20.0  # [Hz]
    xy_goal_tolerance: float = 0.25  # [m] from the end, within which it stops

    def __post_init__(self) -> None:
        require_positive(self, *(name for name in self.__slots__ if not name.startswith("use_")))
        if not self.min_lookahead_dist <= self.max_lookahead_dist:
            raise ValueError(
                f"need min_lookahead_dist <= max_lookahead_dist, got {self.min_lookahead_dist},"
                f" {self.max_lookahead_dist}"
            )

    begin = staticmethod(PathState.begin)  # see ``Controller``

    def command(self, pose: ArrayLike, twist: ArrayLike, state: PathState) -> Command:
        """See ``Controller``; here ``state`` is at the nearest point of the path."""
        at, (v_x, _, turning) = finite("pose", pose), finite("twist", twist)
        if state.remaining <= self.xy_goal_tolerance:
            return 0.0, 0.0
        x, y = lookahead_point(state, at, self.lookahead(v_x))
        angle = math.atan2(y, x)
        if self.use_rotate_to_heading and abs(angle) > self.rotate_to_heading_min_angle:
            return 0.0, self._rotation(angle, turning)
        curvature = arc_curvature(x, y)
        regulating = curvature
        if self.use_fixed_curvature_lookahead:
            regulating = arc_curvature(*lookahead_point(state, at, self.curvature_lookahead_dist))
        speed = self._speed(regulating, state, at)
        return state.direction * speed, speed * curvature

    def advance(
        self, state: PathState, pose: ArrayLike, twist: ArrayLike, dt: float, commanded: Command, reckoned: bool = False
    ) -> PathState:
        """See ``Controller``; this law does not use the command."""
        return state.projected(pose, twist, dt)

    def lookahead(self, v_x: float) -> float:
        """Lookahead distance [m] at a measured v_x [m/s]."""
        if not self.use_velocity_scaled_lookahead_dist:
            return self.lookahead_dist
        return min(max(self.lookahead_time * abs(v_x), self.min_lookahead_dist), self.max_lookahead_dist)

    def _rotation(self, angle: float, turning: float) -> float:
        """Yaw rate [rad/s] of turning on the spot towards an angle, from a measured one."""
        change = self.max_angular_accel / self.controller_frequency
        wanted = math.copysign(self.rotate_to_heading_angular_vel, angle)
        return min(max(wanted, turning - change), turning + change)

    def _speed(self, curvature: float, state: PathState, at: tuple[float, float, float]) -> float:
        """Speed [m/s], regulated by curvature and by the approach of the end."""
        speed = self.desired_linear_vel
        if self.use_regulated_linear_velocity_scaling:
            sharpness = abs(curvature) * self.regulated_linear_scaling_min_radius
            speed = max(speed / max(sharpness, 1.0), self.regulated_linear_scaling_min_speed)
        if state.remaining < self.approach_velocity_scaling_dist:
            end_x, end_y, _ = state.path.end.tolist()
            share = math.hypot(end_x - at[0], end_y - at[1]) / self.approach_velocity_scaling_dist
            speed = min(speed, max(share * speed, self.min_approach_linear_velocity))
        return min(speed, self.desired_linear_vel)


PRESETS = {
    "nav2": PurePursuit(),
    "adaptive": PurePursuit(
        use_velocity_scaled_lookahead_dist=True,
        use_regulated_linear_velocity_scaling=False,
        use_rotate_to_heading=False,
    ),  # Nav2's README: all switches off but the scaled lookahead
    "plain": PurePursuit(use_regulated_linear_velocity_scaling=False, use_rotate_to_heading=False),
}


def lookahead_point(state: PathState, pose: tuple[float, float, float], distance: float) -> tuple[float, float]:
    """First point of the path, from the state on, that is a distance [m] away from the robot.

    Where the path begins farther away it is the nearest point; where no point is so far away, the end of the path.

    Returns:
        x ahead and y to the left [m], seen in the direction of driving.
    """
    path, last = state.path, state.s + state.remaining
    dx, dy = kernels.ahead(path.knots, path.closed, state.s, last, pose[0], pose[1], distance, STEPS)
    cos, sin = state.direction * math.cos(pose[2]), state.direction * math.sin(pose[2])
    return cos * dx + sin * dy, cos * dy - sin * dx


def arc_curvature(x: float, y: float) -> float:
    """Curvature [1/m] of the arc from the robot to a point x ahead and y to the left [m]; 0 if it is at the robot."""
    squared = x**2 + y**2
    return 2.0 * y / squared if squared > 0.0 else 0.0
