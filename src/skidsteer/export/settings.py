"""What the calibration does not know of the robot's software."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, fields

from skidsteer.errors import RequestError

LONGEST = 255  # characters of a name
# Both generations: rmw_validate_node_name and rmw_validate_namespace of ROS 2, names.graph_resource_names of ROS 1.
NODE = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
TOPIC = re.compile(rf"(~/)?{NODE.pattern}")
TAKEN = ("base_link", "odom")  # frames that the tree has: the ICR's is another one


@dataclass(frozen=True, slots=True)
class Settings:
    """Names and rates of the software that the calibration is for; the defaults are those of its documentation.

    Raises:
        RequestError: a name that ROS refuses, or a rate that is not a positive number.
    """

    controller: str = "diff_drive_controller"  # name of the controller, and of its node
    rate: float = 50.0  # [Hz] at which odometry is published
    icr_frame: str | None = None  # frame at the robot's ICR, that the odometry is to be of; None: base_link
    imu_topic: str = "imu/data"

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            option = f"--{field.name.replace('_', '-')}"
            if isinstance(value, str) and not (value.strip() and value.isprintable()):
                raise RequestError(f"{option} must be a name on one line that is not empty, got {value!r}")
            if isinstance(value, str) and len(value) > LONGEST:
                raise RequestError(f"{option} must be a name of up to {LONGEST} characters, got {len(value)}")
        if not NODE.fullmatch(self.controller):
            raise RequestError(f"--controller '{self.controller}' is no name that a ROS node can have; {_SPELT}")
        if not TOPIC.fullmatch(self.imu_topic):
            raise RequestError(f"--imu-topic '{self.imu_topic}' is no name that a ROS topic can have; {_SPELT}")
        if self.icr_frame is not None:
            _refuse_frame(self.icr_frame)
        if not (math.isfinite(self.rate) and 0.0 < self.rate <= 1e4):
            raise RequestError(f"--rate must be a positive number of messages a second, got {self.rate}")


_SPELT = "use letters, digits and _, not a digit first, with / between namespaces"


def _refuse_frame(name: str) -> None:
    if name.startswith("/"):
        raise RequestError(f"--icr-frame '{name}': tf2 refuses frames that begin with /; leave it out")
    if any(map(str.isspace, name)):
        raise RequestError(f"--icr-frame '{name}': a frame's name has no space; use _")
    if name in TAKEN:
        raise RequestError(f"--icr-frame '{name}' is a frame that the robot has; give the new one a name of its own")
