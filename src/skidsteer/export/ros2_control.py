"""Parameters of the ``diff_drive_controller`` of ROS 2 (ros2_control)."""

from __future__ import annotations

from skidsteer.calibration import Calibration
from skidsteer.export.diff_drive import Generation, controller_yaml
from skidsteer.export.forced import Forced
from skidsteer.export.settings import Settings

ROS2 = Generation(
    "ros2-control",
    "ros__parameters",
    "ros2 run tf2_ros static_transform_publisher --x {x} --y {y} --frame-id base_link --child-frame-id {frame}",
    (
        "Add these to the parameters the controller has: left_wheel_names, right_wheel_names, limits. The first key is"
        " the controller's name (platform_velocity_controller on Clearpath's robots), with its namespace in front where"
        " it has one: parameters under a name that no node has are ignored without a word. Odometry comes no more often"
        " than the controller manager's update_rate (10 Hz on some Huskies): give the lesser of the two as --rate.",
        "With position_feedback: false, ros2_controllers before 2.15.0 took wheel velocities for m/s and left the"
        " radius multipliers out. Checked against a re-implementation of the controller, not on a robot with ROS.",
    ),
)


def ros2_control(calibration: Calibration, settings: Settings | None = None, forced: Forced | None = None) -> str:
    """YAML to paste into the parameters of a ``diff_drive_controller`` of ROS 2, see ``controller_yaml``."""
    return controller_yaml(calibration, settings, forced, ROS2)
