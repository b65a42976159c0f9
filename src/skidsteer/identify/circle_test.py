"""Runs of constant rim speeds along circles, and what they tell: Wang 2015, 3.1 and 3.4; Giannoccaro 2015, IV.

Wang: the ICR coefficient of each run, Eqs. (15), (25), and a, b of Eq. (44) through all of them. Giannoccaro: radius,
slip ratio and equivalent carriageway, surface by surface, left and right turns side by side. The runs come from a table
(``skidsteer.io.circle_runs``) or are found in any drive with reference poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from skidsteer.drive import Drive
from skidsteer.errors import RequestError
from skidsteer.kernels import moments as kernels
from skidsteer.models import Curvature
from skidsteer.models.curvature import icr_coefficient
from skidsteer.models.slip_ratio import CircleRun, Side
from skidsteer.se2 import FloatArray, rotate
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Timing, Windows, increment_windows, steps

LIMITS = ((-0.999, 20.0), (0.0, 10.0))  # of a and b in a fit to runs

# Wang: the ICR coefficient


def wang_protocol(max_wheel_speed: float | None = None) -> FloatArray:
    """The 8 x 5 runs of Wang 2015, Eqs. (26), (27), as rows (40, 4) of lambda, v, v_left, v_right [m/s], turning left.

    v is the speed of the robot's centre; in the turns on the spot, lambda = 0, where that is none, that of the rims.
    Rows in which a side would exceed ``max_wheel_speed`` [m/s] are left out: for Wang's robot, 0.7 m/s, those are
    lambda = 1 at 0.4 and 0.5 m/s and lambda = 2 at 0.5 m/s.
    """
    path_curvature, v = np.repeat(np.arange(8.0), 5), np.tile(0.1 * np.arange(1, 6), 8)
    spot = path_curvature == 0.0
    half_apart = np.where(spot, v, v / np.where(spot, 1.0, path_curvature))  # Eq. (13) solved for (v_r - v_l) / 2
    centre = np.where(spot, 0.0, v)
    rows = np.stack([path_curvature, v, centre - half_apart, centre + half_apart], axis=-1)
    limit = np.inf if max_wheel_speed is None else max_wheel_speed
    return np.asarray(rows[np.abs(rows[:, 2:]).max(axis=1) <= limit + 1e-12])


def chi_of_run(rolled_left: ArrayLike, rolled_right: ArrayLike, angle: ArrayLike, track_width: float) -> FloatArray:
    """ICR coefficient of runs, Wang 2015, Eqs. (15), (25), (42).

    Args:
        rolled_left: (...) [m] what the left side rolled, corrected by its scale factor.
        rolled_right: (...) [m] the right side.
        angle: (...) [rad] true angle of the turn, counter-clockwise positive, whole turns included.
        track_width: [m].

    Returns:
        (...) chi, the inverse of Mandow's steering efficiency.

    Raises:
        ValueError: an angle of zero.
    """
    phi = np.asarray(angle, dtype=float)
    if (phi == 0.0).any():
        raise ValueError(f"need an angle other than 0 [rad], got {phi.tolist()}")
    y0 = (np.asarray(rolled_right, dtype=float) - np.asarray(rolled_left, dtype=float)) / (2.0 * phi)  # Eq. (25)
    return np.asarray(2.0 * y0 / track_width)  # Eq. (15)


def icr_error(rolled: ArrayLike, angle: float, rolled_error: ArrayLike, angle_error: float) -> float:
    """Largest error [m] of y0 by Wang 2015, Eq. (43), from those of the sides, (2,) [m], and of the angle [rad]."""
    left, right = np.asarray(rolled, dtype=float)
    y0 = abs(right - left) / (2.0 * abs(angle))
    return float((np.abs(rolled_error).sum() / 2.0 + y0 * abs(angle_error)) / abs(angle))


@dataclass(frozen=True, slots=True, eq=False)
class CoefficientFit:
    """Eq. (44) through pairs of lambda and chi; ``covariance`` (2, 2) of a, b from their scatter.

    Where ``at_bound`` is True a or b stands at a limit of ``LIMITS``: with b = 0 chi does not fall with lambda, with b
    at its upper limit the runs tell the ratio of a and b only (wide arcs alone). Use a constant ICR then.
    """

    a: float
    b: float
    covariance: FloatArray
    rms: float
    pairs: int
    converged: bool
    at_bound: bool

    def model(self, vehicle: Vehicle, alpha: float = 1.0) -> Curvature:
        """The motion model of this curve; ``alpha`` is the scale factor that the rolled distances were corrected by."""
        return Curvature(self.a, self.b, alpha, vehicle.track_width)


def fit_coefficient(path_curvature: ArrayLike, chi: ArrayLike, weight: ArrayLike | None = None) -> CoefficientFit:
    """Nonlinear least squares of Wang 2015, Eq. (44), inside ``LIMITS``: chi is positive and does not grow.

    Args:
        path_curvature: (n,) lambda of each run; the sign does not matter.
        chi: (n,) its ICR coefficient.
        weight: (n,) inverse of its standard deviation, up to a factor; None: all the same.

    Raises:
        RequestError: fewer than three runs, not finite, or all of one lambda.
    """
    x, y = np.abs(np.asarray(path_curvature, dtype=float)), np.asarray(chi, dtype=float)
    w = np.ones_like(y) if weight is None else np.asarray(weight, dtype=float)
    w = w / np.sqrt(np.mean(w**2)) if len(w) else w
    _refuse_too_few(x, y)

    def residual(theta: FloatArray) -> FloatArray:
        return np.asarray(w * (icr_coefficient(x, *theta) - y))

    def jacobian(theta: FloatArray) -> FloatArray:
        fall = 1.0 + theta[1] * np.sqrt(x)
        return np.stack([w / fall, -w * theta[0] * np.sqrt(x) / fall**2], axis=-1)

    start = np.array([np.clip(np.median(y) - 1.0, -0.9, 19.0), 0.05])
    lower, upper = np.array(LIMITS).T
    found = least_squares(residual, start, jacobian, (lower, upper), method="dogbox", xtol=1e-12, ftol=1e-14)
    a, b = map(float, found.x)
    J = jacobian(found.x)
    freedom = max(len(y) - 2, 1)
    covariance = np.linalg.pinv(J.T @ J) * 2.0 * found.cost / freedom
    rms = float(np.sqrt(np.mean((icr_coefficient(x, a, b) - y) ** 2)))
    return CoefficientFit(a, b, covariance, rms, len(y), bool(found.success), bool(found.active_mask.any()))


def _refuse_too_few(x: FloatArray, y: FloatArray) -> None:
    if x.shape != y.shape or x.ndim != 1 or not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise RequestError(f"need as many finite lambda as chi, got {x.shape} and {y.shape}; leave straight runs out")
    if len(x) < 3:
        raise RequestError(f"{len(x)} runs cannot tell a, b and their error; record at least 3, of different lambda")
    if np.ptp(x) < 0.1:
        raise RequestError(
            f"all {len(x)} runs have a lambda near {x.mean():.2f}: b needs different ones, such as turns on the spot"
            " and wide arcs"
        )


# Runs in a drive


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What counts as a run of constant rim speeds."""

    spacing: float = 0.2  # [s] of the windows that are compared
    tolerance: float = 0.05  # largest change of a side's speed, as a share of the faster side
    resolution: float = 0.02  # [m/s] change of a side's speed that is none
    least_speed: float = 0.02  # [m/s] of the faster side; slower is standing still
    settle: float = 0.5  # [s] left out after a change of speed: the body follows the rims with a lag
    least_duration: float = 1.0  # [s] of what is left
    least_turn: float = np.pi / 12.0  # [rad] in one run

    def __post_init__(self) -> None:
        for name in ("spacing", "tolerance", "resolution", "least_speed", "least_duration", "least_turn"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not self.settle >= 0.0:
            raise ValueError(f"settle must not be negative, got {self.settle}")


@dataclass(frozen=True, slots=True)
class FoundRun:
    """A run of constant rim speeds found in a drive: what the sides rolled, and what the reference tells."""

    start: float  # [s] reference clock
    end: float  # [s]
    rolled_left: float  # [m]
    rolled_right: float  # [m]
    distance: float  # [m] of the centre along its circle, backwards negative
    angle: float  # [rad] counter-clockwise positive

    @property
    def path_curvature(self) -> float:
        """Lambda of Wang 2015, Eq. (13)."""
        return (self.rolled_left + self.rolled_right) / (self.rolled_right - self.rolled_left)

    def chi(self, track_width: float) -> float:
        """ICR coefficient of Wang 2015, Eqs. (15), (25)."""
        return float(chi_of_run(self.rolled_left, self.rolled_right, self.angle, track_width))

    def circle(self, surface: str = "") -> CircleRun | None:
        """The same as a circle run; None where the sides ran against each other, or the robot did not go anywhere."""
        if self.rolled_left * self.rolled_right < 0.0 or self.distance == 0.0:
            return None
        span = self.end - self.start
        return CircleRun(
            self.rolled_left / span,
            self.rolled_right / span,
            abs(self.distance / self.angle),
            surface,
            speed=abs(self.distance) / span,
            name=f"{self.start:.1f} s",
        )


def runs_from_drive(
    drive: Drive, timing: Timing | None = None, options: RunOptions | None = None
) -> tuple[FoundRun, ...]:
    """Find the turning runs of constant rim speeds in a drive with reference poses.

    Args:
        drive: with reference poses.
        timing: how the reference lies against the wheels.
        options: what counts as a run.

    Raises:
        RequestError: no reference poses, no such run, or wheels that contradict the reference.
    """
    options = options or RunOptions()
    if drive.pose is None:
        raise RequestError(f"{drive.name}: the circle test needs reference poses with heading")
    windows = increment_windows(drive, options.spacing)
    cut = steps(drive.wheels, windows, timing or Timing(), slopes=False)
    rolled, _ = kernels.extents(cut.distance, cut.offsets)
    found = [_run(windows, rolled, a, b) for a, b in _constant(windows, rolled, options)]
    runs = tuple(r for r in found if abs(r.angle) >= options.least_turn and r.rolled_left != r.rolled_right)
    if not runs:
        raise RequestError(
            f"{drive.name}: no turn of at least {np.degrees(options.least_turn):.0f} deg and"
            f" {options.least_duration:g} s at constant speeds of both sides; record such runs, both ways"
        )
    if np.median([r.chi(drive.vehicle.track_width) for r in runs]) <= 0.0:
        raise RequestError(f"{drive.name}: the reference turns against the wheels: are sides or signs swapped?")
    return runs


def _constant(windows: Windows, rolled: FloatArray, options: RunOptions) -> list[tuple[int, int]]:
    """First and end index of stretches of windows in which both sides keep their speed."""
    speed = (rolled / (windows.end - windows.start)[:, None]).tolist()
    joined, start, end = windows.joined.tolist(), windows.start.tolist(), windows.end.tolist()
    stretches, first, settled = [], 0, -np.inf
    for i in range(1, len(speed) + 1):
        if i < len(speed) and joined[i] and _same(speed[first], speed[i], options):
            if start[first] < settled:  # still following the change: the run begins later
                first = i
            continue
        if end[i - 1] - start[first] >= options.least_duration - 1e-9 and start[first] >= settled:
            stretches.append((first, i))
        if i < len(speed):
            first, settled = i, start[i] + options.settle if joined[i] else start[i]
    return [(a, b) for a, b in stretches if max(map(abs, speed[a])) >= options.least_speed]


def _same(a: Sequence[float], b: Sequence[float], options: RunOptions) -> bool:
    allowed = max(options.resolution, options.tolerance * max(abs(a[0]), abs(a[1])))
    return abs(a[0] - b[0]) <= allowed and abs(a[1] - b[1]) <= allowed


def _run(windows: Windows, rolled: FloatArray, a: int, b: int) -> FoundRun:
    motion = windows.motion[a:b]
    yaw = motion[:, 2]
    # Chords in the frame half-way round their arcs all point the same way: their noise averages out in the sum.
    along = rotate(-0.5 * yaw, motion[:, :2] / np.sinc(yaw / (2.0 * np.pi))[:, None]).sum(axis=0)
    left, right = rolled[a:b].sum(axis=0).tolist()
    distance = float(np.copysign(np.hypot(*along), along[0]))
    return FoundRun(float(windows.start[a]), float(windows.end[b - 1]), left, right, distance, float(yaw.sum()))


def fit_runs(runs: Sequence[FoundRun], track_width: float) -> CoefficientFit:
    """Wang's a and b of runs found in a drive; a longer turn weighs more, as its angle is better known."""
    chi = [run.chi(track_width) for run in runs]
    weight = [abs(run.angle) / abs(c) if c else 0.0 for run, c in zip(runs, chi, strict=True)]
    return fit_coefficient([run.path_curvature for run in runs], chi, weight)


# Giannoccaro: surfaces and sides


@dataclass(frozen=True, slots=True)
class SideResult:
    """Runs of one surface that curve to one side, and the equivalent carriageway through all of them."""

    runs: tuple[CircleRun, ...]
    icr_y: float  # [m] x_ICR, least squares on Eq. (12)
    icr_y_sigma: float | None  # [m] from the scatter of the radii; None of a single run
    steering_efficiency: float  # slippage index chi, Eq. (11)
    slip_ratios: tuple[float | None, ...]  # K_s of each run, Eq. (15)
    misfit: float  # largest error of a radius by Eq. (12), as a share: near 0 where one x_ICR describes all runs


@dataclass(frozen=True, slots=True)
class SurfaceResult:
    """One surface, left and right turns side by side; None where there are no runs that way."""

    surface: str
    left: SideResult | None
    right: SideResult | None


def circle_test(runs: Sequence[CircleRun], track_width: float) -> tuple[SurfaceResult, ...]:
    """Giannoccaro's comparison: each surface of the runs, in the order that they come in.

    Raises:
        RequestError: no runs.
    """
    if not runs:
        raise RequestError("no circle runs given")
    surfaces = dict.fromkeys(run.surface for run in runs)
    return tuple(_surface_result(surface, runs_on(runs, surface), track_width) for surface in surfaces)


def runs_on(runs: Sequence[CircleRun], surface: str, side: Side | None = None) -> tuple[CircleRun, ...]:
    """The runs of one surface, and of one side if asked.

    Raises:
        RequestError: no run on that surface; the message lists those there are.
    """
    there = tuple(run for run in runs if run.surface == surface)
    if not there:
        names = ", ".join(dict.fromkeys(run.surface or "(unnamed)" for run in runs))
        raise RequestError(f"no circle runs on surface '{surface}'; there are: {names}")
    return there if side is None else tuple(run for run in there if run.direction == side)


def _surface_result(surface: str, runs: tuple[CircleRun, ...], track_width: float) -> SurfaceResult:
    sides = {side: tuple(run for run in runs if run.direction == side) for side in ("left", "right")}
    results = {side: side_result(there, track_width) if there else None for side, there in sides.items()}
    return SurfaceResult(surface, results["left"], results["right"])


def side_result(runs: Sequence[CircleRun], track_width: float) -> SideResult:
    """Equivalent carriageway of runs by least squares on R = x_ICR lambda, Giannoccaro 2015, Eq. (12).

    Raises:
        RequestError: no runs.
    """
    if not runs:
        raise RequestError("no circle runs given")
    R = np.array([run.radius for run in runs])
    s = np.array([run.path_curvature for run in runs])
    icr_y = float(s @ R / (s @ s))
    residual = R - icr_y * s
    sigma = float(np.sqrt(residual @ residual / (len(R) - 1) / (s @ s))) if len(R) > 1 else None
    ratios = tuple(run.slip_ratio(track_width) for run in runs)
    efficiency = track_width / (2.0 * icr_y)  # Eq. (11)
    return SideResult(tuple(runs), icr_y, sigma, efficiency, ratios, float(np.abs(residual / R).max()))
