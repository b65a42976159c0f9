"""Parameters of an ``ekf_node`` of robot_localization that integrates the controller's velocities."""

from __future__ import annotations

from skidsteer.calibration import Calibration
from skidsteer.export.covariances import gyro_alone
from skidsteer.export.settings import Settings
from skidsteer.export.yaml_text import comment, mapping

STATE = ("x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "vroll", "vpitch", "vyaw", "ax", "ay", "az")
NODE = "ekf_filter_node"


def robot_localization(calibration: Calibration, settings: Settings | None = None) -> str:
    """YAML of a planar filter that takes velocities from the odometry and, where a gyro was there, its yaw rate."""
    settings = settings or Settings()
    has_gyro = any(name.startswith("gyro") for name in calibration.estimates)
    parameters: dict[str, object] = {
        "frequency": float(settings.rate),
        "two_d_mode": True,
        "publish_tf": True,
        "odom_frame": "odom",
        "base_link_frame": "base_link",
        "world_frame": "odom",
        "odom0": f"{settings.controller}/odom",
        "odom0_config": _fused("vx", "vy", "vyaw"),
        "odom0_differential": False,
        "odom0_relative": False,
    }
    if has_gyro:
        parameters |= {
            "imu0": settings.imu_topic,
            "imu0_config": _fused("vyaw"),
            "imu0_differential": False,
            "imu0_relative": False,
        }
    return _comments(calibration, settings, has_gyro) + mapping({NODE: {"ros__parameters": parameters}})


def _fused(*names: str) -> list[bool]:
    return [name in names for name in STATE]


def _comments(calibration: Calibration, settings: Settings, has_gyro: bool) -> str:
    told = [
        f"ekf_node of robot_localization for {calibration.vehicle.name}.",
        "Velocities only: the pose in an odometry message is the sum of these, with a covariance that does not grow."
        " vy is fused as the 0 that the controller reports, with the covariance of what that leaves out; without it"
        " nothing would hold the filter's sideways velocity.",
    ]
    if settings.icr_frame is not None:
        told.append(
            f"The odometry is of the frame {settings.icr_frame}: the filter brings its velocity to base_link by the"
            " transform between the two, and so regains the sideways velocity of turns."
        )
    told.append("Set enable_odom_tf: false in the controller: the filter publishes the transform odom to base_link.")
    if has_gyro and gyro_alone(calibration):
        told.append(
            f"The drives had a gyro and no other reference: what it turned otherwise than the wheels,"
            f" {calibration.noise.gyro:.2g} rad after a second, is in the covariance of the odometry. Take that of"
            " angular_velocity z from the gyro's driver or data sheet."
        )
    elif has_gyro:
        told.append(
            f"The drives had a gyro: its turn erred by {calibration.noise.gyro:.2g} rad after a second. Where its"
            " driver gives no covariance, let that of angular_velocity z be the square of this times the IMU's rate."
        )
    told.append(
        f"{NODE} and odom0 are named as by the software itself; on Clearpath's robots they are ekf_node and"
        " platform/odom. Parameters under a name that no node has are ignored without a word. In ROS 1, load what"
        " stands below ros__parameters into the node's own namespace."
    )
    told.append("Checked against the documented parameters, not on a robot with ROS.")
    return comment(*told)
