"""Robots stepped through time from outside: what a closed loop drives. ``plants.begin`` makes those of the plants."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import RequestError
from skidsteer.kernels import rolling as kernels
from skidsteer.kernels.twists import KINDS
from skidsteer.models import Model
from skidsteer.se2 import FloatArray


class OverturnedError(RequestError):
    """A robot that falls over, or lifts a wheel where that cannot be simulated."""


class Rolling(Protocol):
    """A robot stepped through time. It keeps its own state: the only thing in a closed loop that does."""

    state: FloatArray  # (8,) x, y [m], yaw [rad], v_x, v_y [m/s], omega [rad/s], left and right rim speed [m/s]
    power: FloatArray  # (3,) [W] mean over the last step: by the rims, lost by sliding, by rolling; NaN: not told

    def step(self, rims: ArrayLike, dt: float) -> FloatArray:
        """The state dt [s] later, with rim speeds (2,) [m/s] asked for and held: a new array. A dt of 0 does nothing.

        Raises:
            OverturnedError: the robot falls over.
            RequestError: a step that cannot be simulated.
        """


class RollingModel:
    """A motion model stepped through time; its rims follow what they are asked for. Exact where they do so at once.

    Args:
        model: the truth.
        start: (3,) pose, at rest.
        lag: [s] time constant of the rims.
        acceleration: [m/s^2] that no rim exceeds.

    Raises:
        RequestError: a model that is not compiled, a start that is not finite, a lag or acceleration that cannot be.
    """

    def __init__(
        self, model: Model, start: ArrayLike = (0.0, 0.0, 0.0), lag: float = 0.0, acceleration: float = math.inf
    ) -> None:
        if model.NAME not in KINDS:
            raise RequestError(f"the model {model.NAME} cannot be driven step by step; there are: {', '.join(KINDS)}")
        if not (0.0 <= lag < math.inf and acceleration > 0.0):
            raise RequestError(f"need a lag of at least 0 s and an acceleration above 0, got {lag}, {acceleration}")
        self.state = at_rest(start)
        self.power = np.full(3, np.nan)
        self._model = KINDS[model.NAME], float(getattr(model, "track_width", 1.0)), model.theta
        self._drives = float(lag), float(acceleration)

    def step(self, rims: ArrayLike, dt: float) -> FloatArray:
        """See ``Rolling``."""
        left, right = np.asarray(rims, dtype=float).tolist()
        self.state = kernels.step(*self._model, self.state, left, right, float(dt), *self._drives)
        return self.state


def at_rest(start: ArrayLike) -> FloatArray:
    """State (8,) of a robot that stands at a pose (3,).

    Raises:
        RequestError: not three finite numbers.
    """
    pose = np.asarray(start, dtype=float)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise RequestError(f"a start needs three finite numbers, x, y [m] and yaw [rad]; got {pose.tolist()}")
    return np.append(pose, np.zeros(5))
