"""The covariances that odometry messages ask for, from the noise of the motion that a calibration estimated."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from scipy.stats import chi2

from skidsteer.calibration import Calibration
from skidsteer.multipliers import Projection
from skidsteer.noise import yaw_path
from skidsteer.prediction import motion_covariance
from skidsteer.se2 import FloatArray

UNMEASURED = 1e6  # variance of what a robot on a plane does not measure: height, roll and pitch
DISTANCE = 10.0  # [m] after which the pose's covariance is told


@dataclass(frozen=True, slots=True)
class Covariances:
    """Diagonals (6,) in the order of ROS: x, y, z [m^2] or [m^2/s^2], then about x, y, z [rad^2] or [rad^2/s^2]."""

    pose: tuple[float, ...]
    twist: tuple[float, ...]
    raised: float  # factor by which the noise was raised to what held-out windows show


def gyro_alone(calibration: Calibration) -> bool:
    """Whether a gyro was all that the drives were judged by: it does not tell whether it or the wheels erred."""
    judged = calibration.held_out.get(calibration.model.NAME)
    return judged is not None and not isfinite(judged.translation_m.rms)


def covariances(calibration: Calibration, projection: Projection, rate: float, of_icr: bool) -> Covariances:
    """Constant covariances for messages that know no others.

    The error of the motion is a random walk: its variance grows by walk^2 for each metre that the rims roll, that of
    the yaw by turn^2 for each that they roll apart and a tenth of each straight one. A filter that integrates
    velocities whose errors are independent from message to message, with variance R at ``rate`` a second, adds up
    R / rate a second: so R is walk^2 times the rim speed times ``rate``. What the multipliers leave out at the usual
    yaw rate is added, though it is no noise. So is what turns are off by all through them: as a random walk that adds
    up to the same at the end of a window that it was found in. Where there was a gyro alone, all that the two turned
    differently is taken for an error of the wheels: a filter that fuses both must not trust them more than the gyro.

    Args:
        calibration: its noise, raised so that regions of 68 % hold that share of its held-out windows.
        projection: tells usual rim speed and yaw rate, and the lever arm that is left out.
        rate: [Hz] of the messages.
        of_icr: the odometry is of a frame at the ICR: nothing is left out.
    """
    noise, regions = calibration.noise, calibration.regions
    raised = 1.0 if regions is None else regions.limit(0.68) / float(chi2.ppf(0.68, 3))
    growth = raised * np.array([noise.walk**2, noise.walk**2, noise.turn**2])
    lost = np.zeros(3) if of_icr else np.array([projection.y, projection.x, 0.0]) * projection.yaw_rate
    unknown = np.array([0.0, 0.0, noise.gyro**2 if gyro_alone(calibration) else 0.0])  # [rad^2] a second
    lasting = np.array([0.0, 0.0, _lasting(calibration, projection.yaw_rate)])
    twist = (growth * _paths(projection) + unknown + lasting) * rate + lost**2
    paths = DISTANCE * np.array([[1.0, 1.0, yaw_path(1.0, 1.0)]])
    ahead = motion_covariance(np.array([[DISTANCE, 0.0, 0.0]]), paths, noise)[0]
    x, y, yaw = raised * np.diag(ahead) + unknown * DISTANCE / projection.rim_speed
    return Covariances(_six(np.array([max(x, y), max(x, y), yaw])), _six(twist), raised)


def _paths(projection: Projection) -> FloatArray:
    """Paths (3,) [m] a second, at usual speeds, that the errors of x, y and yaw grow along, see ``skidsteer.noise``."""
    speed, apart = projection.rim_speed, 0.5 * projection.multipliers.separation * projection.yaw_rate
    return np.array([speed, speed, yaw_path(speed - min(apart, speed), speed + min(apart, speed))])


def _lasting(calibration: Calibration, yaw_rate: float) -> float:
    """What turns are off by, as variance of the yaw [rad^2] a second that adds up to it after a judging window."""
    regions, window = calibration.regions, calibration.provenance.options.get("window")
    if regions is None or window is None:
        return 0.0
    return regions.scale * (regions.turning * yaw_rate) ** 2 * float(window)


def _six(planar: FloatArray) -> tuple[float, ...]:
    x, y, yaw = planar.tolist()
    return (x, y, UNMEASURED, UNMEASURED, UNMEASURED, yaw)
