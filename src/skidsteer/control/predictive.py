"""Model predictive control of our own: in each step a plan over about the next second.

An ``Observer`` estimates the present pose, although poses come late, and the slip. A ``SpeedProfile`` gives the speed.
The plan is the sequence of yaw rates that, by the equations of motion of the observer, with the lag of the rims and
within the limits of the wheels, minimises

    integral of  y_e^2 + reach^2 sin^2(course) + effort (derivative of the commanded yaw rate - that of the path)^2

(``kernels.horizon``). The course is the direction in which the origin moves relative to the tangent, not that in which
the robot faces: curves have no offset. Beyond a knee the offset counts linearly, so that far from the path the robot
approaches it at theta_a. Facing away from the path it turns on the spot, as Huskić's law does.

The profile does not know the grip. While the first part of a plan slips by more at speed than the equations describe
(``stage.STEEPEST``), the robot slows down: at the limit of its grip noise is enough to throw it off the path.

A plan is a simulated drive and no worse than the rest of the previous one, so that a search that has not converged does
no harm. Where its cost is not finite the robot drives the rest of the previous plan and brakes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.control.observer import Estimate, Observer, Triple
from skidsteer.control.path_state import Command, PathState, elapsed, finite, path_error, require_positive, wrapped
from skidsteer.control.profile import Limits, SpeedProfile, rims_by_speed, speed_profile
from skidsteer.control.speed import Wheels, icr_x_at
from skidsteer.errors import RequestError
from skidsteer.kernels import horizon, slip, stage
from skidsteer.models import Model
from skidsteer.paths import Path
from skidsteer.se2 import FloatArray

APPROACH = 1.0  # [m] from the path at which the heading that leads back to it is 76 % of theta_a
FACING, FACED = math.radians(75.0), math.radians(20.0)  # off that heading: turns on the spot, until this close
BEHIND = math.radians(150.0)  # off it, beyond which it keeps turning to the same side
SPIN = 1.5  # [rad/s] at most on the spot
SLOW = 0.1  # [m/s] at which the calibration's icr_x is that of low speed
BEND = 0.2  # [1/m] curvature at which the rim speeds are linearised
END = 0.5  # [s] of cost that the last row stands for
STAGES = 60  # of a plan, at most
WAY = 3.0  # least length of a plan over reach and icr_x: turning moves the origin to the wrong side first
NEAR = 0.5  # share of a plan, from its start, whose slip counts: its last stages are never driven
LEAST_PACE, RECOVERY = 0.3, 0.5  # least share of the profile; share of the acceleration with which it returns to it
ITERATIONS, TOLERANCE = 4, 1e-4  # of the search; share of the cost that a further one must promise to save


@dataclass(frozen=True, slots=True)
class PredictiveGains:
    """Weights of the cost."""

    reach: float = 0.28  # [m] distance over which an offset is corrected
    effort: float = 4.5e-5  # [m^2 s^4] weight of changing the yaw rate otherwise than the path does
    agility: float = 1.0  # how fast the slip may change, see ``Observer``
    theta_a: float = math.pi / 4.0  # [rad] largest approach angle

    def __post_init__(self) -> None:
        require_positive(self, "reach", "effort", "agility", "theta_a")
        if not self.theta_a < 0.5 * math.pi:
            raise ValueError(f"need theta_a below pi / 2, got {self.theta_a}")


@dataclass(frozen=True, slots=True, eq=False)
class PredictiveState(PathState):
    """Place on the path, estimate of the robot, and the plan."""

    estimate: Estimate
    profile: SpeedProfile
    rims: FloatArray  # (2, 2) rim speeds for 1 m/s and for 1 rad/s, in the direction of driving
    stage: float  # [s] of the plan
    asked: Command  # last command: speed [m/s] in the direction of driving, yaw rate [rad/s]
    plan: FloatArray  # (n,) [rad/s^2] derivative of the commanded yaw rate
    next: Command  # the present one
    turning: bool  # on the spot
    iterations: int  # of the search; -1: the plan is the rest of the previous one
    pace: float = 1.0  # share of the profile that is driven


@dataclass(frozen=True, slots=True)
class Predictive:
    """Path following by prediction. A twist's v_x is that of the rims by the model of ``wheels``, its omega a gyro's.

    ``wheels`` should hold a constant ICR (``ScheduledIcr.constant`` of a scheduled one): plan and observer take rims
    as linear in v and omega, and would mistake the changes of a scheduled model with speed for changes of the ground.
    What a calibration knows of the slip at speed goes into ``scheduled``.

    ``begin`` and ``advance`` take in pose and twist and plan; ``command`` returns what they planned.
    """

    gains: PredictiveGains
    wheels: Wheels
    limits: Limits
    observer: Observer
    period: float = 0.02  # [s] from command to command
    scheduled: Model | None = None  # initial slip; None: by the model of the wheels
    horizon: float = 1.2  # [s] at least; longer at low speed, see ``WAY``

    def __post_init__(self) -> None:
        require_positive(self, "period", "horizon")
        if not self.period < self.horizon < math.inf:
            raise ValueError(f"need period < horizon < inf [s], got {self.period}, {self.horizon}")

    def begin(self, path: Path, pose: ArrayLike) -> PredictiveState:
        """See ``Controller``.

        Raises:
            DataError: a pose that is not finite.
            RequestError: a model without rim speeds or ICR at the speed of the profile.
        """
        start, profile = PathState.begin(path, pose), speed_profile(path, self.wheels, self.limits)
        speed, ahead = float(profile.speeds.max()), start.direction
        model = self.scheduled or self.wheels.model
        slow, fast = (ahead * icr_x_at(model, ahead * v, BEND) for v in (min(SLOW, speed), speed))
        if not math.isfinite(slow + fast):
            raise RequestError(f"the model {model.NAME} tells no ICR at {speed:.2f} m/s; ask for a lower speed")
        estimate = self._observer.begin(_along(finite("pose", pose), ahead), slow, (fast - slow) / speed**2)
        lasting = max(self.horizon, WAY * (self.gains.reach + abs(fast)) / speed)
        step = max(self.period, lasting / STAGES)
        straight, bent = rims_by_speed(self.wheels, ahead * speed, [0.0, BEND])
        state = PredictiveState(
            path,
            start.s,
            estimate,
            profile,
            np.array([straight, (bent - straight) / BEND]),
            step,
            (0.0, 0.0),
            np.zeros(math.ceil(lasting / step - 1e-9)),
            (0.0, 0.0),
            False,
            0,
        )
        return self._planned(state)

    def command(self, pose: ArrayLike, twist: ArrayLike, state: PredictiveState) -> Command:
        """See ``Controller``."""
        finite("pose", pose), finite("twist", twist)
        if state.arrived:
            return 0.0, 0.0
        v, omega = state.next
        return state.direction * v, omega

    def advance(
        self,
        state: PredictiveState,
        pose: ArrayLike,
        twist: ArrayLike,
        dt: float,
        commanded: Command,
        reckoned: bool = False,
    ) -> PredictiveState:
        """See ``Controller``. A reckoned pose is ignored: the observer predicts with the slip."""
        at, (v, _, omega) = finite("pose", pose), finite("twist", twist)
        if elapsed(dt) == 0.0:
            return state
        ahead = state.direction
        asked = ahead * commanded[0], commanded[1]
        measured = None if reckoned else _along(at, ahead)
        estimate = self._observer.advance(state.estimate, measured, ahead * v, omega, dt, asked[1])
        s = state.path.project(estimate.pose[:2], near=state.s)
        stages = np.arange(len(state.plan))
        plan = np.interp(stages + dt / state.stage, stages, state.plan)
        return self._planned(replace(state, s=s, estimate=estimate, asked=asked, plan=plan))

    @property
    def _observer(self) -> Observer:
        return replace(self.observer, agility=self.gains.agility * self.observer.agility)

    def _planned(self, state: PredictiveState) -> PredictiveState:
        row, body, weights = self._row(state), self._body(state), self._weights(state)
        e = wrapped(row[stage.THETA] + self.gains.theta_a * math.tanh(row[stage.Y] / APPROACH))
        if abs(e) > (FACED if state.turning else FACING):
            return self._turned(state, row, body, e)
        plan, path = state.plan.copy(), state.path
        rows = np.empty((len(plan) + 1, stage.ROW))
        speeds = state.pace * state.profile.speeds
        search = path.knots, path.closed, speeds, ITERATIONS, TOLERANCE, rows
        iterations = int(horizon.plan(row, plan, body, weights, *search))
        if iterations == horizon.UNKNOWN:
            return self._braked(state)
        first = rows[0] + self.period / state.stage * (rows[1] - rows[0])
        ask = float(first[stage.SPEED_ASKED]), float(first[stage.ASKED])
        pace = self._pace(state, rows)
        return replace(state, plan=plan, next=ask, turning=False, iterations=iterations, pace=pace)

    def _pace(self, state: PredictiveState, rows: FloatArray) -> float:
        """Share of the profile to drive after a plan of these rows; slip that a turn has at any speed is left out."""
        near = rows[: 1 + math.ceil(NEAR * len(state.plan))]
        beyond = near[:, stage.SIDE] + state.estimate.now[slip.ICR_X] * near[:, stage.OMEGA]
        slips = np.abs(beyond) / np.maximum(near[:, stage.SPEED], stage.SLOWEST)
        change = self.limits.acceleration * self.period / float(state.profile.speeds.max())
        if slips.max() > stage.STEEPEST:
            return max(state.pace - change, LEAST_PACE)
        return min(state.pace + RECOVERY * change, 1.0)

    def _turned(self, state: PredictiveState, row: FloatArray, body: FloatArray, e: float) -> PredictiveState:
        """On the spot, towards the path."""
        v, omega = state.asked
        slower = max(v - self.limits.acceleration * self.period, 0.0)
        side = math.copysign(1.0, omega if abs(e) > BEHIND and omega else -e)
        bounds = np.empty(2)
        body[stage.STEP] = self.period
        stage.bounds(row, slower, body, bounds)
        rate = min(max((side * min(SPIN, 2.0 * abs(e)) - omega) / self.period, bounds[0]), bounds[1])
        ask = slower, omega + float(rate) * self.period
        return replace(state, plan=np.zeros_like(state.plan), next=ask, turning=True, iterations=0)

    def _braked(self, state: PredictiveState) -> PredictiveState:
        """The rest of the previous plan, ever slower."""
        v, omega = state.asked
        slower = max(v - self.limits.acceleration * self.period, 0.0)
        share = slower / v if v > 0.0 else 0.0
        first = float(state.plan[0]) if math.isfinite(state.plan[0]) else 0.0
        return replace(state, next=(slower, share * (omega + first * self.period)), iterations=horizon.UNKNOWN)

    def _row(self, state: PredictiveState) -> FloatArray:
        estimate = state.estimate
        x, y, yaw = _along(estimate.pose, state.direction)
        error = path_error(state, (x, y, yaw))
        now, turn = estimate.now, estimate.turn
        v, omega = state.asked
        lateral = error.y_e, error.theta_e, now[slip.SIDE], turn[slip.OMEGA]
        return np.array([*lateral, estimate.rims, omega, state.s, estimate.speed, v])

    def _body(self, state: PredictiveState) -> FloatArray:
        now, turn, limits = state.estimate.now, state.estimate.turn, self.limits
        slips = now[[slip.SCALE, slip.LOSS, slip.ICR_X, slip.COMPLIANCE, slip.GIVE]]
        bounds = self.wheels.max_speed, limits.rim_acceleration, limits.acceleration, limits.omega_max
        return np.array([state.stage, self.period, self.observer.lag, *slips, *turn[1:], *state.rims.ravel(), *bounds])

    def _weights(self, state: PredictiveState) -> FloatArray:
        gains = self.gains
        # far off the offset counts as 2 knee |y_e|; the knee is such that a course of theta_a pays over the horizon
        lasting = len(state.plan) * state.stage + END
        speed = float(state.profile.speeds.max())
        knee = gains.reach**2 * math.sin(gains.theta_a) / (speed * lasting)
        return np.array([gains.reach, gains.effort, knee, END])


def _along(pose: Triple, ahead: float) -> Triple:
    """A pose turned round in reverse, and a turned one back."""
    x, y, yaw = pose
    return x, y, yaw if ahead > 0.0 else wrapped(yaw + math.pi)
