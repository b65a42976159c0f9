"""Tread ICRs that depend on the operating point: what a constant ICR leaves out at speed. Ours.

With v, omega of the constant ICR (Mandow 2007, Eqs. (2)-(7)) the body moves with

    v_x    = v / (1 + turn_loss omega^2)
    omega' = omega (1 + yaw_gain v^2 / (KNEE^2 + v^2) + load_gain |v omega| / (LEAN + |v omega|))
    v_y    = -icr_x omega' - side_slip v omega / (1 + slip_fade |v|)

``side_slip``: pushed outwards by the lateral acceleration v omega, the robot slips to the outside of the turn;
``slip_fade``: less so, for its acceleration, the faster it drives.
``turn_loss``: the faster it turns, the more of the rolled distance is lost. ``yaw_gain``: tyres that already slip
lengthwise resist turning less, so that it turns more easily when it drives; ``load_gain``: more so, the more of its
weight leans on the outer side. All of them vanish as the speed goes to zero. Read as ICRs: icr_x moves ahead with
the speed, the treads' ICRs move inwards or outwards with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.models.icr import Icr
from skidsteer.models.model import Model, Parameter
from skidsteer.se2 import FloatArray

KNEE = 1.0  # [m/s] speed at which half of the yaw gain is reached
LEAN = 3.0  # [m/s^2] lateral acceleration at which half of the load gain is reached


@dataclass(frozen=True)
class ScheduledIcr(Model):
    """Ten parameters; ``OPTIONAL`` ones are kept only where the drive supports them."""

    NAME: ClassVar[str] = "scheduled_icr"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *Icr.PARAMETERS,
        Parameter("turn_loss", "s^2", 0.0, 0.0, 5.0, "share of v_x lost for each (rad/s)^2 of yaw rate"),
        Parameter("side_slip", "s", 0.0, -1.0, 1.5, "outward slip for each m/s^2 of lateral acceleration"),
        Parameter("yaw_gain", "", 0.0, 0.0, 0.5, "share of yaw rate gained at high speed"),
        Parameter("load_gain", "", 0.0, 0.0, 0.5, "share of yaw rate gained at high lateral acceleration"),
        Parameter("slip_fade", "s/m", 0.0, 0.0, 2.0, "how side slip saturates with speed"),
    )
    OPTIONAL: ClassVar[tuple[str, ...]] = ("turn_loss", "side_slip", "yaw_gain", "load_gain")

    icr_y_left: float  # [m]
    icr_y_right: float  # [m]
    icr_x: float  # [m]
    alpha_left: float
    alpha_right: float
    turn_loss: float  # [s^2]
    side_slip: float  # [s]
    yaw_gain: float
    load_gain: float
    slip_fade: float  # [s/m]

    def __post_init__(self) -> None:
        self.constant  # noqa: B018  # refuses what an Icr refuses
        for name in ("turn_loss", "yaw_gain", "load_gain", "slip_fade"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"need {name} >= 0, got {getattr(self, name)}")

    @property
    def constant(self) -> Icr:
        """The constant ICR that this goes over into at low speed."""
        return Icr(self.icr_y_left, self.icr_y_right, self.icr_x, self.alpha_left, self.alpha_right)

    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        v, omega = _planar(self.constant.twist(v_left, v_right))
        turn = omega * self._gain(v, omega)
        v_y = -self.icr_x * turn - self.side_slip * v * omega / self._fade(v)
        return np.stack([v / (1.0 + self.turn_loss * omega**2), v_y, turn], axis=-1)

    def _gain(self, v: FloatArray, omega: FloatArray) -> FloatArray:
        a = np.abs(v * omega)
        return np.asarray(1.0 + self.yaw_gain * v**2 / (KNEE**2 + v**2) + self.load_gain * a / (LEAN + a))

    def _fade(self, v: FloatArray) -> FloatArray:
        return np.asarray(1.0 + self.slip_fade * np.abs(v))

    def _by_constant(self, v: FloatArray, omega: FloatArray) -> FloatArray:
        """Derivative (..., 3, 2) of the twist by v and omega of the constant ICR."""
        loss = 1.0 + self.turn_loss * omega**2
        a = np.abs(v * omega)
        by_a = self.load_gain * LEAN / (LEAN + a) ** 2
        turn_by_v = omega * (
            self.yaw_gain * 2.0 * v * (KNEE / (KNEE**2 + v**2)) ** 2 + by_a * np.abs(omega) * np.sign(v)
        )
        turn_by_omega = self._gain(v, omega) + by_a * a
        rows = (
            (1.0 / loss, -2.0 * v * self.turn_loss * omega / loss**2),
            (
                -self.icr_x * turn_by_v - self.side_slip * omega / self._fade(v) ** 2,
                -self.icr_x * turn_by_omega - self.side_slip * v / self._fade(v),
            ),
            (turn_by_v, turn_by_omega),
        )
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def parameter_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        v, omega = _planar(self.constant.twist(v_left, v_right))
        by_icr = self._by_constant(v, omega) @ self.constant.parameter_jacobian(v_left, v_right)[..., [0, 2], :]
        by_icr[..., 1, 2] -= omega * self._gain(v, omega)  # icr_x itself
        a = np.abs(v * omega)
        by_gain, by_load = omega * v**2 / (KNEE**2 + v**2), omega * a / (LEAN + a)
        none = np.zeros_like(v)
        by_turn_loss = np.stack([-v * (omega / (1.0 + self.turn_loss * omega**2)) ** 2, none, none], axis=-1)
        by_side_slip = np.stack([none, -v * omega / self._fade(v), none], axis=-1)
        by_slip_fade = np.stack([none, self.side_slip * v * omega * np.abs(v) / self._fade(v) ** 2, none], axis=-1)
        by_yaw_gain = np.stack([none, -self.icr_x * by_gain, by_gain], axis=-1)
        by_load_gain = np.stack([none, -self.icr_x * by_load, by_load], axis=-1)
        by_terms = np.stack([by_turn_loss, by_side_slip, by_yaw_gain, by_load_gain, by_slip_fade], axis=-1)
        return np.concatenate([by_icr, by_terms], axis=-1)

    def speed_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        v, omega = _planar(self.constant.twist(v_left, v_right))
        by_speeds: FloatArray = (
            self._by_constant(v, omega) @ self.constant.speed_jacobian(v_left, v_right)[..., [0, 2], :]
        )
        return by_speeds

    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:
        """Rim speeds (..., 2) [m/s] that give v_x = v and omega, by fixed-point steps; NaN where they find none."""
        v, omega = np.broadcast_arrays(np.asarray(v, dtype=float), np.asarray(omega, dtype=float))
        inner_v, inner_omega = v.copy(), omega.copy()
        for _ in range(ITERATIONS):
            inner_omega = omega / self._gain(inner_v, inner_omega)
            inner_v = v * (1.0 + self.turn_loss * inner_omega**2)
        reached = _planar(self.twist(*np.moveaxis(self.constant.wheel_speeds(inner_v, inner_omega), -1, 0)))
        miss = np.hypot(reached[0] - v, reached[1] - omega)
        speeds = self.constant.wheel_speeds(inner_v, inner_omega)
        return np.where((miss < 1e-6 * (1.0 + np.hypot(v, omega)))[..., None], speeds, np.nan)


ITERATIONS = 60


def _planar(twist: FloatArray) -> tuple[FloatArray, FloatArray]:
    return twist[..., 0], twist[..., 2]
