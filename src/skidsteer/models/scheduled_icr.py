"""Tread ICRs that depend on the operating point: what a constant ICR leaves out at speed and on curves. Ours.

With v, omega of the constant ICR (Mandow 2007, Eqs. (2)-(7)), a = |v omega| and D = icr_y_left - icr_y_right the body
moves with

    v_x    = v / (1 + turn_loss omega^2)
    omega' = omega (1 + straight_gain v^2 / (v^2 + (D omega)^2 + CREEP^2)) / (1 - load_gain a / (LEAN + a))
    v_y    = -icr_x omega' - side_slip v omega / (1 + slip_fade |v|)

``side_slip``: pushed outwards by the lateral acceleration v omega, the robot slips to the outside of the turn;
``slip_fade``: less so, at the same acceleration, the faster it drives.
``turn_loss``: the faster it turns, the more of the rolled distance is lost. ``straight_gain``: tyres that slip more
lengthwise than sideways resist turning less, so that the treads' ICRs move inwards as the path gets straighter (Wang
2015, 5.3): not at all on the spot, half of it on a circle of radius D, where Wang's lambda, Eq. (13), is 2.
``load_gain``: the share by which lateral acceleration moves the treads' ICRs together: inwards (above 0) where the
weight leans on the outer side; outwards (below 0) where holding the robot in its turn uses up the friction, as on ice.
At low speed all but ``straight_gain`` vanish.
Read as ICRs: icr_x moves ahead with the speed, the treads' ICRs move with speed and radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.models.icr import Icr
from skidsteer.models.model import Model, Parameter
from skidsteer.se2 import FloatArray

CREEP = 0.02  # [m/s] slower counts as standing still
LEAN = 3.0  # [m/s^2] lateral acceleration at which half of the load gain is reached
STEPS = 12  # of Newton's method, which rarely takes more than five


@dataclass(frozen=True)
class ScheduledIcr(Model):
    """Ten parameters; ``OPTIONAL`` ones are kept only where the drive supports them."""

    NAME: ClassVar[str] = "scheduled_icr"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *Icr.PARAMETERS,
        Parameter("turn_loss", "s^2", 0.0, 0.0, 5.0, "share of v_x lost for each (rad/s)^2 of yaw rate"),
        Parameter("side_slip", "s", 0.0, -1.0, 1.5, "outward slip for each m/s^2 of lateral acceleration"),
        Parameter("straight_gain", "", 0.0, 0.0, 1.0, "share of yaw rate gained as the path gets straight"),
        Parameter("load_gain", "", 0.0, -3.0, 0.5, "share that the ICRs close in at high lateral acceleration"),
        Parameter("slip_fade", "s/m", 0.0, 0.0, 2.0, "how side slip saturates with speed"),
    )
    OPTIONAL: ClassVar[tuple[str, ...]] = ("turn_loss", "side_slip", "straight_gain", "load_gain")

    icr_y_left: float  # [m]
    icr_y_right: float  # [m]
    icr_x: float  # [m]
    alpha_left: float
    alpha_right: float
    turn_loss: float  # [s^2]
    side_slip: float  # [s]
    straight_gain: float
    load_gain: float
    slip_fade: float  # [s/m]

    def __post_init__(self) -> None:
        self.constant  # noqa: B018  # refuses what an Icr refuses
        for name in ("turn_loss", "straight_gain", "slip_fade"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"need {name} >= 0, got {getattr(self, name)}")
        if not self.load_gain < 1.0:
            raise ValueError(f"need load_gain < 1, got {self.load_gain}")

    @property
    def constant(self) -> Icr:
        """The constant ICR that this tends to at low speed."""
        return Icr(self.icr_y_left, self.icr_y_right, self.icr_x, self.alpha_left, self.alpha_right)

    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        v, omega = _planar(self.constant.twist(v_left, v_right))
        turn = omega * self._gain(v, omega)
        v_y = -self.icr_x * turn - self.side_slip * v * omega / self._fade(v)
        return np.stack([v / (1.0 + self.turn_loss * omega**2), v_y, turn], axis=-1)

    def _gain(self, v: FloatArray, omega: FloatArray) -> FloatArray:
        return np.asarray((1.0 + self.straight_gain * self._straight(v, omega)) / self._closer(v, omega))

    def _closer(self, v: FloatArray, omega: FloatArray) -> FloatArray:
        """Share of their distance that lateral acceleration leaves between the treads' ICRs."""
        return np.asarray(1.0 - self.load_gain * _lean(v, omega))

    def _straight(self, v: FloatArray, omega: FloatArray) -> FloatArray:
        """How straight the path is: 0 on the spot, 1 where both sides run alike."""
        return np.asarray(v**2 / self._square(v, omega))

    def _square(self, v: FloatArray, omega: FloatArray) -> FloatArray:
        return np.asarray(v**2 + (self._apart * omega) ** 2 + CREEP**2)

    @property
    def _apart(self) -> float:
        return self.icr_y_left - self.icr_y_right

    def _fade(self, v: FloatArray) -> FloatArray:
        return np.asarray(1.0 + self.slip_fade * np.abs(v))

    def _slopes(self, v: FloatArray, omega: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Derivatives of v_x and of omega' with respect to v and omega of the constant ICR."""
        loss, square, a = 1.0 + self.turn_loss * omega**2, self._square(v, omega), np.abs(v * omega)
        gain, closer = self._gain(v, omega), self._closer(v, omega)
        by_a = gain / closer * self.load_gain * LEAN / (LEAN + a) ** 2
        by_v = 2.0 * self.straight_gain * v * (square - v**2) / square**2 / closer
        by_omega = -2.0 * self.straight_gain * omega * (self._apart * v / square) ** 2 / closer
        return (
            1.0 / loss,
            -2.0 * v * self.turn_loss * omega / loss**2,
            omega * (by_v + by_a * np.abs(omega) * np.sign(v)),
            gain + omega * by_omega + by_a * a,
        )

    def _by_constant(self, v: FloatArray, omega: FloatArray) -> FloatArray:
        """Derivative (..., 3, 2) of the twist with respect to v and omega of the constant ICR."""
        x_by_v, x_by_omega, turn_by_v, turn_by_omega = self._slopes(v, omega)
        fade = self._fade(v)
        rows = (
            (x_by_v, x_by_omega),
            (
                -self.icr_x * turn_by_v - self.side_slip * omega / fade**2,
                -self.icr_x * turn_by_omega - self.side_slip * v / fade,
            ),
            (turn_by_v, turn_by_omega),
        )
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def parameter_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        v, omega = _planar(self.constant.twist(v_left, v_right))
        by_icr = self._by_constant(v, omega) @ self.constant.parameter_jacobian(v_left, v_right)[..., [0, 2], :]
        by_icr[..., 1, 2] -= omega * self._gain(v, omega)  # icr_x itself
        closer = self._closer(v, omega)
        by_apart = -2.0 * self.straight_gain * self._apart * (v / self._square(v, omega)) ** 2 * omega**3 / closer
        for column, sign in ((0, 1.0), (1, -1.0)):  # D itself
            by_icr[..., 1, column] -= sign * self.icr_x * by_apart
            by_icr[..., 2, column] += sign * by_apart
        by_gain = omega * self._straight(v, omega) / closer
        by_load = omega * self._gain(v, omega) / closer * _lean(v, omega)
        none = np.zeros_like(v)
        by_turn_loss = np.stack([-v * (omega / (1.0 + self.turn_loss * omega**2)) ** 2, none, none], axis=-1)
        by_side_slip = np.stack([none, -v * omega / self._fade(v), none], axis=-1)
        by_slip_fade = np.stack([none, self.side_slip * v * omega * np.abs(v) / self._fade(v) ** 2, none], axis=-1)
        by_straight_gain = np.stack([none, -self.icr_x * by_gain, by_gain], axis=-1)
        by_load_gain = np.stack([none, -self.icr_x * by_load, by_load], axis=-1)
        by_terms = np.stack([by_turn_loss, by_side_slip, by_straight_gain, by_load_gain, by_slip_fade], axis=-1)
        return np.concatenate([by_icr, by_terms], axis=-1)

    def speed_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        v, omega = _planar(self.constant.twist(v_left, v_right))
        by_speeds: FloatArray = (
            self._by_constant(v, omega) @ self.constant.speed_jacobian(v_left, v_right)[..., [0, 2], :]
        )
        return by_speeds

    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:
        """Rim speeds (..., 2) [m/s] that give v_x = v and omega, by Newton's method; NaN where it finds none."""
        v, omega = np.broadcast_arrays(np.asarray(v, dtype=float), np.asarray(omega, dtype=float))
        least_omega = omega * (1.0 - max(self.load_gain, 0.0)) / (1.0 + self.straight_gain)  # no gain is above that
        most_omega = omega * (1.0 - min(self.load_gain, 0.0))  # nor any loss
        most_v = v * (1.0 + self.turn_loss * most_omega**2)
        limits_v, limits_omega = _ordered(v, most_v), _ordered(least_omega, most_omega)
        inner_v, inner_omega, size = v, omega, 1.0 + np.hypot(v, omega)
        for _ in range(STEPS):
            miss_v, miss_omega = self._miss(inner_v, inner_omega, v, omega)
            if (np.maximum(np.abs(miss_v), np.abs(miss_omega)) <= 1e-12 * size).all():
                break
            x_by_v, x_by_omega, turn_by_v, turn_by_omega = self._slopes(inner_v, inner_omega)
            det = x_by_v * turn_by_omega - x_by_omega * turn_by_v
            inner_v = _within(inner_v - (turn_by_omega * miss_v - x_by_omega * miss_omega) / det, *limits_v)
            inner_omega = _within(inner_omega - (x_by_v * miss_omega - turn_by_v * miss_v) / det, *limits_omega)
        reached = np.hypot(*self._miss(inner_v, inner_omega, v, omega)) < 1e-6 * size
        return np.where(reached[..., None], self.constant.wheel_speeds(inner_v, inner_omega), np.nan)

    def _miss(
        self, inner_v: FloatArray, inner_omega: FloatArray, v: FloatArray, omega: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """By how much v_x and omega' miss those asked for, at v and omega of the constant ICR."""
        return (
            inner_v / (1.0 + self.turn_loss * inner_omega**2) - v,
            inner_omega * self._gain(inner_v, inner_omega) - omega,
        )


def _lean(v: FloatArray, omega: FloatArray) -> FloatArray:
    """Lateral acceleration from 0 at none to 1 at most."""
    a = np.abs(v * omega)
    return np.asarray(a / (LEAN + a))


def _ordered(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.minimum(a, b), np.maximum(a, b)


def _within(x: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    return np.asarray(np.minimum(np.maximum(x, low), high))


def _planar(twist: FloatArray) -> tuple[FloatArray, FloatArray]:
    return twist[..., 0], twist[..., 2]
