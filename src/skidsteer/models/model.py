"""What every motion model offers: rim speeds of both sides to the body twist and back, with named parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of a model. ``nominal``, ``lower`` and ``upper`` are multiplied by track_width ** track_power.

    The bounds are what is physically credible; the estimators search inside them and take them as all that is known
    before the drive.
    """

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    meaning: str
    track_power: int = 0


@dataclass(frozen=True)
class Model(ABC):
    """A frozen dataclass whose fields are its parameters, and measures of the vehicle that it holds fixed.

    A new model is one file: a subclass with ``NAME``, ``PARAMETERS`` and the four methods, and its line in
    ``skidsteer.models.MODELS``.
    """

    NAME: ClassVar[str]
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = ()
    OPTIONAL: ClassVar[tuple[str, ...]] = ()  # parameters that stay nominal unless the drive supports them
    CRABS: ClassVar[bool] = False  # may crab on a straight, which looks like a sensor mounted at an angle

    @abstractmethod
    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        """Rim speeds (...) [m/s] to the body twist (..., 3): v_x, v_y [m/s], omega [rad/s]."""

    @abstractmethod
    def parameter_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        """Derivative (..., 3, p) of the twist with respect to the parameters, in the order of ``PARAMETERS``."""

    @abstractmethod
    def speed_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        """Derivative (..., 3, 2) of the twist with respect to v_left and v_right."""

    @abstractmethod
    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:
        """Rim speeds (..., 2) [m/s] that give v_x = v (...) [m/s] and omega (...) [rad/s]; v_y cannot be chosen."""

    @classmethod
    def nominal(cls, vehicle: Vehicle) -> Self:
        """The model before any drive: an ideal differential drive of the vehicle's track width."""
        values = {p.name: p.nominal * vehicle.track_width**p.track_power for p in cls.PARAMETERS}
        fixed = {f.name: getattr(vehicle, f.name) for f in fields(cls) if f.name not in values}
        return cls(**values, **fixed)

    @classmethod
    def bounds(cls, vehicle: Vehicle) -> FloatArray:
        """Lower and upper bound of each parameter, (p, 2)."""
        limits = [np.array([p.lower, p.upper]) * vehicle.track_width**p.track_power for p in cls.PARAMETERS]
        return np.array(limits).reshape(-1, 2)

    @property
    def theta(self) -> FloatArray:
        """The parameters as a vector (p,), in the order of ``PARAMETERS``."""
        return np.array([getattr(self, p.name) for p in self.PARAMETERS], dtype=float)

    def with_theta(self, theta: ArrayLike) -> Self:
        """The same model with other parameters (p,)."""
        values = np.asarray(theta, dtype=float)
        return replace(self, **{p.name: float(v) for p, v in zip(self.PARAMETERS, values, strict=True)})


@dataclass(frozen=True)
class MatrixModel(Model):
    """A model that is linear in the rim speeds: twist = A (v_left, v_right), Mandow 2007, Eq. (6)."""

    @abstractmethod
    def matrix(self) -> FloatArray:
        """A, (3, 2): rows v_x, v_y, omega; columns left, right."""

    @abstractmethod
    def matrix_jacobian(self) -> FloatArray:
        """Derivative of A with respect to the parameters, (3, 2, p)."""

    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        return _pair(v_left, v_right) @ self.matrix().T

    def parameter_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        return np.asarray(np.einsum("ijp,...j->...ip", self.matrix_jacobian(), _pair(v_left, v_right)))

    def speed_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        shape = np.broadcast(v_left, v_right).shape
        return np.broadcast_to(self.matrix(), (*shape, 3, 2)).copy()

    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:  # noqa: D102
        return _pair(v, omega) @ np.linalg.inv(self.matrix()[[0, 2]]).T


def _pair(a: ArrayLike, b: ArrayLike) -> FloatArray:
    a, b = np.broadcast_arrays(np.asarray(a, dtype=float), np.asarray(b, dtype=float))
    return np.stack([a, b], axis=-1)
