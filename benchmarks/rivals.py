"""What others do about slip at speed, as models that our windows can judge. In benchmarks only.

``SlipRegression``: the linear regression of body slip of DRIVE (Baril et al., arXiv:2309.10718, and their published
code): the ideal differential drive of nominal width less w_x v, w_y v omega and w_1 v omega + w_2 v + w_3 omega. Their
prior is as good as flat. They fit velocities of the steady state; here the five weights are searched for like any
other model's parameters, with lag, time offset and outlier weights, which can only help them.

``Residual``: a Gaussian process on what a constant ICR leaves of the mean twists between reference poses.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RegularGridInterpolator

from skidsteer.drive import Drive
from skidsteer.identify.least_squares import Fit
from skidsteer.models import Icr
from skidsteer.models.model import Model, Parameter
from skidsteer.se2 import FloatArray, log
from skidsteer.windows import increment_windows, predict


@dataclass(frozen=True)
class SlipRegression(Model):
    """Five weights on the twist of the ideal differential drive."""

    NAME: ClassVar[str] = "slip_regression"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("x_by_speed", "", 0.0, -1.0, 1.0, "share of v_x lost"),
        Parameter("y_by_lateral", "s", 0.0, -2.0, 2.0, "side slip for each m/s^2 of lateral acceleration"),
        Parameter("yaw_by_lateral", "1/m", 0.0, -2.0, 2.0, "yaw rate lost for each m/s^2 of lateral acceleration"),
        Parameter("yaw_by_speed", "1/m", 0.0, -2.0, 2.0, "yaw rate lost for each m/s"),
        Parameter("yaw_by_turn", "", 0.0, -1.0, 1.0, "share of the yaw rate lost"),
    )

    x_by_speed: float
    y_by_lateral: float
    yaw_by_lateral: float
    yaw_by_speed: float
    yaw_by_turn: float
    track_width: float

    def _ideal(self, v_left: ArrayLike, v_right: ArrayLike) -> tuple[FloatArray, FloatArray]:
        left, right = np.asarray(v_left, dtype=float), np.asarray(v_right, dtype=float)
        return 0.5 * (left + right), (right - left) / self.track_width

    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        v, omega = self._ideal(v_left, v_right)
        lost = self.yaw_by_lateral * v * omega + self.yaw_by_speed * v + self.yaw_by_turn * omega
        return np.stack([v * (1.0 - self.x_by_speed), -self.y_by_lateral * v * omega, omega - lost], axis=-1)

    def parameter_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        v, omega = self._ideal(v_left, v_right)
        out = np.zeros((*v.shape, 3, 5))
        out[..., 0, 0], out[..., 1, 1] = -v, -v * omega
        out[..., 2, 2:] = -np.stack([v * omega, v, omega], axis=-1)
        return out

    def speed_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        v, omega = self._ideal(v_left, v_right)
        none = np.zeros_like(v)
        by_v = np.stack(
            [
                none + 1.0 - self.x_by_speed,
                -self.y_by_lateral * omega,
                -self.yaw_by_lateral * omega - self.yaw_by_speed,
            ],
            axis=-1,
        )
        by_omega = np.stack([none, -self.y_by_lateral * v, 1.0 - self.yaw_by_lateral * v - self.yaw_by_turn], axis=-1)
        turn = by_omega / self.track_width
        return np.stack([0.5 * by_v - turn, 0.5 * by_v + turn], axis=-1)

    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:
        raise NotImplementedError("a rival for the table, not for control")


@dataclass(frozen=True)
class Residual(Model):
    """A constant ICR and the mean of a Gaussian process over its (v, omega), tabulated."""

    NAME: ClassVar[str] = "gaussian_process"

    icr: Icr
    table: RegularGridInterpolator  # (v, omega) to the three components of the residual twist

    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        twist = self.icr.twist(v_left, v_right)
        return np.asarray(twist + self.table(twist[..., [0, 2]]))

    def parameter_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        raise NotImplementedError("a rival for the table: it is not searched for by derivatives")

    speed_jacobian = parameter_jacobian

    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:
        raise NotImplementedError("a rival for the table, not for control")


def gaussian_process(found: Fit, drive: Drive, spacing: float = 0.5, most: int = 800, seed: int = 0) -> Residual:
    """Fit a Gaussian process to what a constant ICR leaves.

    Args:
        found: fit of a constant ICR to the drive, with its timing.
        drive: to learn from.
        spacing: of the reference poses whose mean twists are learned [s].
        most: samples that are learned, drawn at random: the cost grows with their cube.
        seed: of the draw.
    """
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    assert isinstance(found.model, Icr)
    windows = increment_windows(drive, spacing)
    if len(windows) > most:
        chosen = np.random.default_rng(seed).permutation(len(windows))[:most]
        windows = windows.where(np.isin(np.arange(len(windows)), chosen))
    span = (windows.end - windows.start)[:, None]
    expected = log(predict(found.model, drive.wheels, windows, found.timings[0])) / span
    left = log(windows.motion) / span - expected
    inputs = expected[:, [0, 2]]
    scale = inputs.std(axis=0)
    limits = np.abs(inputs).max(axis=0) * 1.05
    axes = [np.linspace(-x, x, 61) for x in limits]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    mean = np.zeros((*grid.shape[:2], 3))
    for i, values in enumerate(left.T):
        spread = float(np.median(np.abs(values - np.median(values))) * 1.4826)
        clipped = np.clip(values, np.median(values) - 5 * spread, np.median(values) + 5 * spread)
        kernel = ConstantKernel(1.0, (1e-4, 1e2)) * RBF([1.0, 1.0], (0.1, 20.0)) + WhiteKernel(1.0, (1e-3, 1e2))
        with warnings.catch_warnings():  # a length scale at its bound
            warnings.simplefilter("ignore")
            process = GaussianProcessRegressor(kernel, normalize_y=True, random_state=seed)
            process.fit(inputs / scale, clipped)
        mean[..., i] = process.predict((grid / scale).reshape(-1, 2)).reshape(grid.shape[:2])
    table = RegularGridInterpolator(axes, mean, bounds_error=False, fill_value=None)
    return Residual(found.model, table)
