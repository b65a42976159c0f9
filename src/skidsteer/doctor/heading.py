"""At which angle the sensor of a pose sits on the robot: which way it sees the robot drive, apart from turning."""

from __future__ import annotations

import numpy as np

from skidsteer.doctor.signals import sampled, total_of_poses, typical
from skidsteer.drive import Drive, Series

LEAST = np.radians(10.0)  # smaller angles slip explains, too, or a fit alone can tell
ONE_WAY = 0.6  # share of the motion, apart from turning, that has to go along one line
SIZE = 0.2  # share of the motion that must be apart from turning
FEW = 20  # samples


def travel_angle(pose: Series, drive: Drive, full_turn: float, step: float) -> float:
    """Yaw [rad] of the pose's sensor against the line along which the robot drives, in (-pi / 2, pi / 2]; or 0.

    A sensor at (x, y) on the robot and at yaw a sees a twist as R(-a) (v_x - y omega, v_y + x omega). What goes with
    omega is taken off, wherever the sensor sits and however the robot slips sideways in turns; what is left are
    changes of v_x, along a line at -a. Driving back is on that line, too, so that the wheels have to tell which end
    of it is ahead. Angles below ``LEAST``, or of motion that has no one line, are 0.

    Args:
        pose: (n, 3) of the reference, x and y in m.
        drive: that it belongs to.
        full_turn: by which its yaw was recorded.
        step: [s] of the grid on which rates are taken.
    """
    ahead, left = (sampled(total_of_poses(pose, drive, full_turn, turned), step).values for turned in (0.0, -np.pi / 2))
    velocity, omega = ahead[:, 0] + 1j * left[:, 0], ahead[:, 1]
    known = np.isfinite(velocity) & np.isfinite(omega)
    velocity, omega = velocity[known], omega[known]
    if len(omega) < FEW or not omega.any():
        return 0.0
    apart = velocity - omega * (omega @ velocity) / (omega @ omega)
    size = np.minimum(np.abs(apart), 4.0 * typical(np.abs(apart)))
    if not size.sum() > SIZE * np.abs(velocity).sum():
        return 0.0
    line = size @ np.exp(2j * np.angle(apart)) / size.sum()
    angle = -0.5 * float(np.angle(line))
    return angle if abs(line) > ONE_WAY and abs(angle) > LEAST else 0.0
