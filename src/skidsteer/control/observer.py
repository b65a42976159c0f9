"""Where a robot is now and how it slips, from late poses, a gyro and the commands.

The ICR model, extended by what it leaves out at speed, with a state for each unknown. By the ICR model the rims stand
for a speed v and a yaw rate r, which follow the command with a lag. The body moves with

    speed      = (scale + loss |c|) v                        c = omega / speed
    k          = compliance + give |c|
    side'      = -(side + (icr_x + k speed^2) omega) / (k speed)
    omega'     = (gain r + drift - (1 - ease |side / speed|) omega) / (compliance speed)

where ``side`` is the velocity of the origin to the left. Tyres and soft ground yield sideways in proportion to the
lateral acceleration. That moves the ICR ahead by k speed^2 and lets the body follow with the time constant k speed: the
side slip of ``models.ScheduledIcr``, in time. The sharper the turn, the more they yield (``give``) and the more speed
is lost (``loss``). The larger the slip angle, the less the ground resists turning (``ease``): the robot oversteers. At
low speed the ICR model remains.

The slip states wander, and return in time to what the calibration says. Everything is expressed in the direction of
driving.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from skidsteer.control.path_state import require_positive
from skidsteer.kernels import slip as kernels
from skidsteer.kernels.lags import decay
from skidsteer.kernels.stage import SHARPEST, SLOWEST, STEEPEST
from skidsteer.se2 import FloatArray

Triple = tuple[float, float, float]

MEMORY = 20.0  # [s] time constant with which the slip returns to its usual values
JUMP = 8.0  # sigmas of a pose beyond which the map has leapt
STIFFEST = 0.01  # [s^2/m] initial compliance where the model has none
USUAL_EASE = 0.7  # initial, of any robot
# initial standard deviations, and their growth in a second at an agility of 1
FIRST_SLIP = np.array([0.05, 0.05, 0.1, 0.01, 0.1, 0.05, 0.1])  # side, scale, loss, turn, icr_x, compliance, give
WANDER_SLIP = np.array([0.035, 0.05, 0.055, 0.002, 0.03, 0.0135, 0.033])
FIRST_TURN = np.array([0.01, 0.1, 0.1, 0.3])  # omega, gain, drift, ease
WANDER_TURN = np.array([0.28, 0.06, 0.066, 0.17])
WANDER_POSE = 1e-3  # [m], [rad] that a second adds


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The estimate. Arrays are not written to."""

    now: FloatArray  # (10,) state predicted to now, see ``kernels.slip``
    turn: FloatArray  # (4,) yaw rate, gain, drift, ease
    rims: float  # [rad/s] yaw rate of the lagged rims by the ICR model
    speed: float  # [m/s] of the rims by the ICR model
    omega: float  # [rad/s] as measured
    late: FloatArray  # (10,) state when the last pose was taken
    late_covariance: FloatArray  # (10, 10)
    turn_covariance: FloatArray  # (4, 4)
    steps: FloatArray  # (n, 3) since then: dt, speed and yaw rate as measured
    usual: FloatArray  # (10,) state to which the slip returns: that of the calibration

    @property
    def pose(self) -> Triple:
        """X, y [m], yaw [rad] now, in the direction of driving."""
        x, y, yaw = self.now[:3].tolist()
        return x, y, yaw

    @property
    def slip_angle(self) -> float:
        """[rad] magnitude."""
        return min(abs(float(self.now[kernels.SIDE])) / max(self.body_speed, SLOWEST), STEEPEST)

    @property
    def body_speed(self) -> float:
        """[m/s]."""
        sharp = min(abs(self.omega) / max(self.speed, SLOWEST), SHARPEST)
        return max((float(self.now[kernels.SCALE]) + float(self.now[kernels.LOSS]) * sharp) * self.speed, 0.0)


@dataclass(frozen=True, slots=True)
class Observer:
    """The filters, with the properties of sensors and wheels that they are given.

    Raises:
        ValueError: a lag or delay below 0, or a sigma or agility that is not above 0.
    """

    lag: float  # [s] of the rims
    delay: float  # [s] of the pose
    position_sigma: float = 0.01  # [m] of the pose
    yaw_sigma: float = 0.01  # [rad] of the pose
    gyro_sigma: float = 0.01  # [rad/s]
    agility: float = 1.0  # how fast the slip may change

    def __post_init__(self) -> None:
        require_positive(self, "position_sigma", "yaw_sigma", "gyro_sigma", "agility")
        for name in ("lag", "delay"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"need a finite {name} of at least 0 s, got {getattr(self, name)}")

    def begin(self, pose: Triple, icr_x: float, compliance: float) -> Estimate:
        """The estimate of a robot at rest that slips as its calibration says: icr_x [m] at low speed, k [s^2/m]."""
        late = np.array([*pose, 0.0, 1.0, 0.0, 1.0, icr_x, max(compliance, STIFFEST), 0.0])
        sigma = np.concatenate([self._pose_sigma, FIRST_SLIP])
        turn = np.array([0.0, 1.0, 0.0, USUAL_EASE])
        nothing = np.empty((0, 3))
        return Estimate(late, turn, 0.0, 0.0, 0.0, late, np.diag(sigma**2), np.diag(FIRST_TURN**2), nothing, late)

    def advance(
        self, before: Estimate, pose: Triple | None, speed: float, omega: float, dt: float, asked: float
    ) -> Estimate:
        """The estimate after a step.

        Args:
            before: the estimate before the step.
            pose: received at its end, ``delay`` old; None: none came.
            speed: [m/s] of the rims at its end.
            omega: [rad/s] measured at its end.
            dt: [s] duration.
            asked: [rad/s] yaw rate commanded in it.
        """
        step = (dt, 0.5 * (before.speed + speed), 0.5 * (before.omega + omega))
        steps = np.append(before.steps, [step], axis=0)
        late, late_covariance, now = before.late.copy(), before.late_covariance.copy(), np.empty(kernels.STATES)
        usual = before.usual
        Q = np.concatenate([np.full(3, WANDER_POSE), self.agility * WANDER_SLIP]) ** 2
        R = self._pose_sigma**2
        seen = np.full(3, np.nan) if pose is None else np.array(pose)
        used = kernels.late(late, late_covariance, steps, self.delay, seen, Q, R, usual, MEMORY, JUMP, now)
        moved = replace(before, now=now, speed=max(speed, 0.0), omega=omega)
        turn, turn_covariance = before.turn.copy(), before.turn_covariance.copy()
        body_lag = max(float(now[kernels.COMPLIANCE]), 0.0) * moved.body_speed
        measured = float(now[kernels.TURN_SCALE]) * omega
        Q, slip = (self.agility * WANDER_TURN) ** 2, moved.slip_angle
        drives = before.rims, asked, self.lag, body_lag, slip, measured
        usual_turn = np.array([0.0, 1.0, 0.0, USUAL_EASE])
        kernels.turn(turn, turn_covariance, dt, *drives, Q, self.gyro_sigma**2, usual_turn, MEMORY)
        kept = decay(dt, self.lag)
        rims = kept * before.rims + (1.0 - kept) * asked
        return replace(
            moved,
            turn=turn,
            rims=rims,
            late=late,
            late_covariance=late_covariance,
            turn_covariance=turn_covariance,
            steps=steps[used:],
        )

    @property
    def _pose_sigma(self) -> FloatArray:
        return np.array([self.position_sigma, self.position_sigma, self.yaw_sigma])
