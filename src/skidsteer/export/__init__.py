"""A calibration in the words of other software. A new format is one module and one line in ``FORMATS``."""

from skidsteer.export.as_json import as_json
from skidsteer.export.files import FORMATS, text, texts
from skidsteer.export.forced import Forced, Measured, force
from skidsteer.export.p3at import p3at
from skidsteer.export.robot_localization import robot_localization
from skidsteer.export.ros1_control import ros1_control
from skidsteer.export.ros2_control import ros2_control
from skidsteer.export.settings import Settings

__all__ = [
    "FORMATS",
    "Forced",
    "Measured",
    "Settings",
    "as_json",
    "force",
    "p3at",
    "robot_localization",
    "ros1_control",
    "ros2_control",
    "text",
    "texts",
]
