"""Path following: controllers with one interface, and wheel speeds for their commands."""

from skidsteer.control.huskic import Huskic, HuskicGains
from skidsteer.control.observer import Observer
from skidsteer.control.path_state import Command, Controller, PathError, PathState, path_error
from skidsteer.control.pentzer import Pentzer, PentzerGains
from skidsteer.control.predictive import Predictive, PredictiveGains
from skidsteer.control.profile import Limits, SpeedProfile, speed_profile
from skidsteer.control.pure_pursuit import PurePursuit
from skidsteer.control.soetanto import Soetanto, SoetantoGains
from skidsteer.control.speed import SaturationSpeed, Wheels, icr_x_at

__all__ = [
    "Command",
    "Controller",
    "Huskic",
    "HuskicGains",
    "Limits",
    "Observer",
    "PathError",
    "PathState",
    "Pentzer",
    "PentzerGains",
    "Predictive",
    "PredictiveGains",
    "PurePursuit",
    "SaturationSpeed",
    "Soetanto",
    "SoetantoGains",
    "SpeedProfile",
    "Wheels",
    "icr_x_at",
    "path_error",
    "speed_profile",
]
