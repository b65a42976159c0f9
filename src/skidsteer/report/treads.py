"""Tread ICRs of any model, with their covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from skidsteer.calibration import Calibration
from skidsteer.models import Model
from skidsteer.se2 import FloatArray

SLOW = 1e-4  # [m/s] of the rims in the turn on the spot at which a model that depends on speed is evaluated
STEP = 1e-6  # of a parameter, in forward differences, as some must not be negative


@dataclass(frozen=True, slots=True, eq=False)
class TreadIcrs:
    """Tread ICRs in a slow turn on the spot: ``place`` (2, 2), rows left, right of x, y [m], ``covariance`` of each."""

    place: FloatArray
    covariance: FloatArray

    @property
    def distance(self) -> float:
        """Between the two [m], sideways."""
        return float(self.place[0, 1] - self.place[1, 1])


def tread_icrs(calibration: Calibration) -> TreadIcrs:
    """Tread ICRs of a calibration."""
    model = calibration.model
    index = [calibration.names.index(name) for name in calibration.parameters]
    steps = STEP * np.eye(len(index))
    slopes = [(places(model.with_theta(model.theta + step)) - places(model)) / STEP for step in steps]
    jacobian = np.moveaxis(np.array(slopes).reshape(-1, 2, 2), 0, -1)
    known = calibration.covariance[np.ix_(index, index)]
    return TreadIcrs(places(model), jacobian @ known @ np.swapaxes(jacobian, -1, -2))


def places(model: Model) -> FloatArray:
    """Tread ICRs (2, 2) [m] of a model: rows left, right of x, y.

    While the left rim stands still the body turns about the ICR of the left tread. There v_x - omega y = 0 and v_y +
    omega x = 0, so that y = v_x / omega and x = -v_y / omega in the motion by the right rim alone. A model that is not
    linear in the rim speeds is linearised in a slow turn on the spot. For the ICR model these are (icr_x, icr_y_left)
    and (icr_x, icr_y_right), Mandow 2007, Eqs. (2)-(5).
    """
    by_left, by_right = model.speed_jacobian(-SLOW, SLOW).T
    return np.array([[-v_y / omega, v_x / omega] for v_x, v_y, omega in (by_right, by_left)])


def ellipse(covariance: FloatArray, share: float = 0.95) -> tuple[float, float, float]:
    """Semi-axes [m], the longer one first, and its direction [rad] from x, of the region that holds a share."""
    values, vectors = np.linalg.eigh(covariance)
    a, b = np.sqrt(chi2.ppf(share, 2) * np.clip(values[::-1], 0.0, None)).tolist()
    return a, b, float(np.arctan2(vectors[1, 1], vectors[0, 1]))
