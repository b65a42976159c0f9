"""The odometry and the commands of ROS 2's diff_drive_controller in our own words, from its published sources.

ros-controls/ros2_controllers, diff_drive_controller/src/odometry.cpp and diff_drive_controller.cpp, from version 2.15
(Humble) to 4.18 (Jazzy), and the later updateFromPosition: they differ in none of this. Parameters are read once, when
the controller is configured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

# Parameters that all of these versions declare, and their types: diff_drive_controller_parameter.yaml.
CONTROLLER_PARAMETERS = {
    "left_wheel_names": list,
    "right_wheel_names": list,
    "wheel_separation": float,
    "wheel_radius": float,
    "wheel_separation_multiplier": float,
    "left_wheel_radius_multiplier": float,
    "right_wheel_radius_multiplier": float,
    "odom_frame_id": str,
    "base_frame_id": str,
    "pose_covariance_diagonal": list,
    "twist_covariance_diagonal": list,
    "open_loop": bool,
    "position_feedback": bool,
    "enable_odom_tf": bool,
    "cmd_vel_timeout": float,
    "publish_limited_velocity": bool,
    "velocity_rolling_window_size": int,
    "publish_rate": float,
}
# Of ekf_node, cra-ros-pkg/robot_localization, params/ekf.yaml in the branches ros2, humble-devel and jazzy-devel.
EKF_PARAMETERS = {
    "frequency": float,
    "sensor_timeout": float,
    "two_d_mode": bool,
    "publish_tf": bool,
    "map_frame": str,
    "odom_frame": str,
    "base_link_frame": str,
    "world_frame": str,
    "odom0": str,
    "odom0_config": list,
    "odom0_queue_size": int,
    "odom0_differential": bool,
    "odom0_relative": bool,
    "imu0": str,
    "imu0_config": list,
    "imu0_differential": bool,
    "imu0_relative": bool,
    "imu0_queue_size": int,
    "process_noise_covariance": list,
}


class Controller:
    """Wheel angles or turning rates in, pose and velocity out; commands in, turning rates out."""

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.separation = parameters["wheel_separation_multiplier"] * parameters["wheel_separation"]
        self.left_radius = parameters["left_wheel_radius_multiplier"] * parameters["wheel_radius"]
        self.right_radius = parameters["right_wheel_radius_multiplier"] * parameters["wheel_radius"]
        self.x = self.y = self.heading = 0.0
        self.left_old = self.right_old = 0.0
        self.linear = self.angular = 0.0

    def position_feedback(self, left: float, right: float, dt: float) -> None:
        """Wheel angles [rad] after dt [s]."""
        left_now, right_now = left * self.left_radius, right * self.right_radius
        self._move(left_now - self.left_old, right_now - self.right_old, dt)
        self.left_old, self.right_old = left_now, right_now

    def velocity_feedback(self, left: float, right: float, dt: float) -> None:
        """Turning rates [rad/s] held for dt [s]."""
        self._move(left * self.left_radius * dt, right * self.right_radius * dt, dt)

    def _move(self, left: float, right: float, dt: float) -> None:
        linear, angular = 0.5 * (left + right), (right - left) / self.separation
        if abs(angular) < 1e-6:
            self.x += linear * math.cos(self.heading + 0.5 * angular)
            self.y += linear * math.sin(self.heading + 0.5 * angular)
            self.heading += angular
        else:
            before, radius = self.heading, linear / angular
            self.heading += angular
            self.x += radius * (math.sin(self.heading) - math.sin(before))
            self.y -= radius * (math.cos(self.heading) - math.cos(before))
        self.linear, self.angular = linear / dt, angular / dt

    def command(self, linear: float, angular: float) -> tuple[float, float]:
        """Turning rates [rad/s] that the wheels are told."""
        half = 0.5 * angular * self.separation
        return (linear - half) / self.left_radius, (linear + half) / self.right_radius
