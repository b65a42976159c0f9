"""What windows of drives show of the robot's slip: rim speeds, twist, lambda, chi, ICRs; and a model's view of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from skidsteer.errors import RequestError
from skidsteer.evaluation import mount
from skidsteer.figures.material import Material
from skidsteer.models import Model
from skidsteer.report.reckoner import Reckoner
from skidsteer.se2 import FloatArray, log, wrap
from skidsteer.windows import Mount, judging_windows, steps

LEAST_TURN = float(np.radians(10.0))  # in a window, for its ICRs to be told
SLOW = 0.1  # [m/s] at which the scale of the rims is read off a model


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Windows (n,): mean rim speeds, the twists held all through them that the reference and the model tell, errors."""

    rims: FloatArray  # (n, 2)
    measured: FloatArray  # (n, 3) v_x, v_y [m/s], omega [rad/s]
    predicted: FloatArray  # (n, 3)
    duration: FloatArray  # (n,) [s]
    translation: FloatArray  # (n,) [m] by which the model ends wrong
    yaw: FloatArray  # (n,) [rad] the same of its yaw

    def where(self, keep: np.ndarray) -> Observed:
        """Only the windows of a mask (n,)."""
        return Observed(*(getattr(self, f.name)[keep] for f in fields(self)))

    @property
    def path_curvature(self) -> FloatArray:
        """Lambda (n,), Wang 2015, Eq. (13): infinite straight on."""
        total, apart = self.rims.sum(axis=1), self.rims[:, 1] - self.rims[:, 0]
        return np.asarray(np.divide(total, apart, out=np.full(len(total), np.inf), where=apart != 0.0))


def observe(known: Sequence[Reckoner], material: Material, turning: bool = False) -> Observed:
    """The judging windows of drives; ``turning``: only those that turn by ``LEAST_TURN`` or more.

    Raises:
        RequestError: there is no such window.
    """
    parts = [_observe(one, mount(material.calibration, one.drive), material.window) for one in known]
    found = Observed(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Observed)))
    if turning:
        found = found.where(np.abs(found.measured[:, 2]) * found.duration >= LEAST_TURN)
    if not len(found.rims):
        what = f"turns by {np.degrees(LEAST_TURN):.0f} deg" if turning else "moves"
        raise RequestError(f"the drives have no window of {material.window:g} s in which the robot {what}")
    return found


def _observe(reckoner: Reckoner, place: Mount, length: float) -> Observed:
    drive = reckoner.drive
    errors = reckoner.errors(length)
    windows = judging_windows(drive, length)
    windows = windows.where(np.isin(windows.start, errors.start))
    duration = windows.end - windows.start
    cut = steps(drive.wheels, windows, reckoner.timing, slopes=False)
    rolled = np.add.reduceat(np.vstack([cut.distance, np.zeros((1, 2))]), cut.offsets[:-1], axis=0)
    rolled[np.diff(cut.offsets) == 0] = 0.0
    body, predicted = (place.body(motion) for motion in (windows.motion, reckoner.motions(windows)))
    body[:, 2] = predicted[:, 2] + wrap(body[:, 2] - predicted[:, 2])  # windows may turn by more than half a turn
    measured, expected = _twist(body, duration), _twist(predicted, duration)
    return Observed(rolled / duration[:, None], measured, expected, duration, errors.translation, errors.yaw)


def _twist(motion: FloatArray, duration: FloatArray) -> FloatArray:
    return np.asarray(log(motion) / duration[:, None])


def scale(model: Model) -> FloatArray:
    """True over nominal speed (2,) of the left and the right rim, as near as a model tells.

    Where a model has a scale of each side by name it is that; of others the way made on a slow straight.
    """
    values = {p.name: float(v) for p, v in zip(model.PARAMETERS, model.theta, strict=True)}
    straight = float(model.twist(SLOW, SLOW)[0]) / SLOW
    return np.array([values.get("alpha_left", straight), values.get("alpha_right", straight)])


def coefficient(rims: FloatArray, omega: FloatArray, model: Model, track_width: float) -> FloatArray:
    """Chi (n,) of rim speeds (n, 2) and yaw rates (n,), Wang 2015, Eqs. (15), (25): ICR distance over track width."""
    true = rims * scale(model)
    return np.asarray((true[:, 1] - true[:, 0]) / (omega * track_width))


def icrs(rims: FloatArray, twist: FloatArray, model: Model) -> FloatArray:
    """Columns icr_x, icr_y_left, icr_y_right [m] (n, 3), Mandow 2007, Eqs. (2)-(5), in REP-103."""
    v_x, v_y, omega = twist.T
    left, right = (rims * scale(model)).T
    return np.asarray(np.column_stack([-v_y, v_x - left, v_x - right]) / omega[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class Binned:
    """Medians and quartiles of y over x, in bins that hold equal numbers."""

    x: FloatArray
    median: FloatArray
    low: FloatArray
    high: FloatArray


def binned(x: FloatArray, y: FloatArray, least: int = 5, most: int = 12) -> Binned:
    """Bins of at least ``least`` points, at most ``most`` bins; a point is told by the median of its x."""
    count = int(np.clip(len(x) // least, 1, most))
    groups = np.array_split(np.argsort(x, kind="stable"), count)
    low, median, high = (np.array([np.quantile(y[g], q) for g in groups]) for q in (0.25, 0.5, 0.75))
    return Binned(np.array([np.median(x[g]) for g in groups]), median, low, high)
