"""Parameters of the ``diff_drive_controller`` of ROS 1 (ros_control)."""

from __future__ import annotations

from skidsteer.calibration import Calibration
from skidsteer.export.diff_drive import Generation, controller_yaml
from skidsteer.export.forced import Forced
from skidsteer.export.settings import Settings

ROS1 = Generation(
    "ros1-control",
    None,
    "rosrun tf2_ros static_transform_publisher {x} {y} 0 0 0 0 base_link {frame}",
    (
        "Add these to the parameters the controller has: left_wheel, right_wheel, limits. The first key is the"
        " controller's name, husky_velocity_controller or jackal_velocity_controller on Clearpath's robots. Take"
        " wheel_radius_multiplier out, which their files set: while it is there, the controller ignores the multipliers"
        " of the two sides.",
        "Checked against the published sources of the controller and a parameter server, not on a robot.",
    ),
)


def ros1_control(calibration: Calibration, settings: Settings | None = None, forced: Forced | None = None) -> str:
    """YAML to paste into the parameters of a ``diff_drive_controller`` of ROS 1, see ``controller_yaml``."""
    return controller_yaml(calibration, settings, forced, ROS1)
