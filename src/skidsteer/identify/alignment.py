"""Whether the reference's sensor is turned against the robot's forward direction."""

from __future__ import annotations

from dataclasses import replace

from skidsteer.drive import Drive
from skidsteer.identify.least_squares import FitOptions, fit
from skidsteer.models import ScheduledIcr
from skidsteer.windows import increment_windows

SURE = 3.0  # [sigma] that the yaw of the sensor must differ from the assumed one by


def is_turned(drives: list[Drive], options: FitOptions, spacing: float = 0.0) -> bool:
    """Whether drives show that the sensor of their reference poses sits at another yaw than ``options.mount`` says.

    A robot that drives straight moves along its own x axis; a sensor turned by a few degrees sees it crab. That no
    tread ICR explains it tells the two apart. The freest model is fitted: what a simpler one leaves hides the angle.
    Needs poses and a place of the sensor that is given.
    """
    if options.mount is None or not any(d.pose is not None for d in drives):
        return False
    windows = [increment_windows(drive, spacing) for drive in drives]
    found = fit(ScheduledIcr.nominal(drives[0].vehicle), drives, windows, replace(options, align=True))
    yaw, sigma = found.named("mount_yaw")
    return abs(yaw - options.mount.yaw) > SURE * sigma
