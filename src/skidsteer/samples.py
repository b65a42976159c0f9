"""Drives that come with the package, so that everything can be tried without a robot: ``sample:NAME``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Drive
from skidsteer.errors import RequestError
from skidsteer.models import Differential, Icr
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import preset

P3AT_TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)  # Mandow 2007, Table I, pneumatic tyres at 20 psi, asphalt
P3AT_LAG = 0.08  # [s]
P3AT_SENSORS = Sensors(
    reference_rate=5.0,
    position_sigma=0.01,
    yaw_sigma=float(np.radians(0.5)),
    reference_delay=0.15,
    encoder_step=1.0 / 138_000.0,  # [m] Mandow 2007, Eq. (14): 138 counts a millimetre
)
P3AT_MOTION_NOISE = (0.004, 0.008)  # [m/sqrt(m)], [rad/sqrt(m)]


def p3at_lab(seed: int = 2007) -> Drive:
    """A simulated Pioneer P3-AT after Mandow 2007, IV-C: encoders at 100 Hz, a reference at 5 Hz and 1 cm.

    The truth is ``P3AT_TRUTH`` with a lag of ``P3AT_LAG``; the reference is 0.15 s late and, unlike Mandow's single
    antenna, tells the heading to 0.5 deg.
    """
    vehicle = preset("pioneer-p3at")
    rims = rims_from_manoeuvres(_representative_paths(), Differential(vehicle.track_width))
    return kinematic_drive("p3at-lab", vehicle, P3AT_TRUTH, rims, P3AT_SENSORS, P3AT_LAG, P3AT_MOTION_NOISE, seed)


def _representative_paths() -> np.ndarray:
    """Rows of duration, v, omega: straights, circles, turns on the spot and S-curves at several speeds; 5 minutes."""
    stop = [1.0, 0.0, 0.0]
    rows = [[2.0, 0.0, 0.0]]
    for v in (0.2, 0.4, 0.6):
        rows += [[8.0, v, 0.0], stop, [6.0, 0.0, 0.8], stop, [8.0, v, 0.5 * v], [8.0, v, -0.5 * v], stop]
        rows += [[6.0, 0.0, -0.8], stop, [4.0, -v, 0.0], [5.0, v, 1.2 * v], [5.0, v, -1.2 * v]]
        rows += [[2.0, v, s * 0.9] for s in (1, -1, 1, -1, 1, -1)] + [[6.0, 0.5 * v, 0.4], [6.0, 0.5 * v, -0.4], stop]
    return np.array(rows)


@dataclass(frozen=True, slots=True)
class Sample:
    """A drive that can be made at any time."""

    make: Callable[[], Drive]
    text: str


SAMPLES: dict[str, Sample] = {
    "p3at-lab": Sample(p3at_lab, "simulated Pioneer P3-AT on asphalt, known truth (Mandow 2007, Table I), 5 minutes"),
}


def sample(name: str) -> Drive:
    """The sample drive of that name.

    Raises:
        RequestError: no such sample; the message lists those there are.
    """
    if name not in SAMPLES:
        raise RequestError(f"no sample '{name}'; there are: {', '.join(SAMPLES)}")
    return SAMPLES[name].make()
