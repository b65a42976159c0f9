"""The slips of circle runs as a motion model for planning: Giannoccaro 2015, Eqs. (13)-(15).

The paper plans with the slipping ratio K_s of the circle test nearest to the arc. Here K_s and the slip of the outer
side are interpolated over the curvature between the runs, down to a straight, on which nothing slips. Each pair of rim
speeds then has one motion, as in a model; forwards only, and on arcs no tighter than the runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import RequestError
from skidsteer.models import Model
from skidsteer.models.slip_ratio import CircleRun, Side, rims_on_circle
from skidsteer.se2 import FloatArray

GRID = 500  # arcs to a side, between which the inverse is interpolated
STEP = 1e-6  # [m/s] of a derivative
SIDES: tuple[Side, Side] = ("left", "right")


@dataclass(frozen=True)
class SlipTable(Model):
    """Circle runs on one surface, with speeds over ground, and the track width."""

    NAME: ClassVar[str] = "slip_ratio"

    runs: tuple[CircleRun, ...]
    track_width: float  # [m]

    def __post_init__(self) -> None:
        for run in self.runs:
            if run.speed is None or run.inner == 0.0 or run.radius <= 0.5 * self.track_width:
                raise RequestError(
                    f"circle run {run.name or run.radius} has no slip of both sides: it needs a speed over ground, an"
                    f" inner side that rolls and a radius above half the track; leave it out or calibrate a model"
                )
        if not self.runs:
            raise RequestError("a plan by slip ratios needs circle runs, got none")
        for side in SIDES:
            split, _, _ = self._arcs(side)
            if (np.diff(split) <= 0.0).any():
                raise RequestError(f"the circle runs that turn {side} contradict each other: wider arcs split more")

    def _of(self, side: Side) -> FloatArray:
        """Rows (n, 3) of curvature [1/m], K_s and outer slip, beginning with the straight."""
        rows = [[0.0, 1.0, 0.0]]
        for run in self.runs:
            slips = run.slip_coefficients(self.track_width)
            if run.direction == side and slips is not None:
                rows.append([1.0 / run.radius, run.slip_ratio(self.track_width) or np.nan, slips[1]])
        return np.array(sorted(rows))

    def _arcs(self, side: Side) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Along ever tighter arcs (n,): (v_o - v_i) / (v_o + v_i), curvature [1/m], speed over mean rim speed."""
        rows = self._of(side)
        curvature = np.unique(np.concatenate([np.linspace(0.0, rows[-1, 0], GRID), rows[:, 0]]))
        K, i_o = (np.interp(curvature, rows[:, 0], column) for column in rows[:, 1:].T)
        half = 0.5 * self.track_width * curvature
        outer, inner = (1.0 + half) / (1.0 - i_o), (1.0 - half) / (K * (1.0 - i_o))  # Eqs. (13), (14), at 1 m/s
        return (outer - inner) / (outer + inner), curvature, 2.0 / (outer + inner)

    def twist(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        """Twists (..., 3) of rim speeds (...); NaN where the sides differ more than in any run, or go backwards."""
        left, right = np.broadcast_arrays(np.asarray(v_left, dtype=float), np.asarray(v_right, dtype=float))
        total = left + right
        split = np.divide(right - left, total, out=np.zeros_like(total), where=total != 0.0)
        curvature, speed = np.zeros_like(total), np.where(total == 0.0, 0.0, np.nan)
        for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
            known, bend, share = self._arcs(side)
            here = (sign * split >= 0.0) & (sign * split <= known[-1] + 1e-12) & (total > 0.0)
            curvature = np.where(here, sign * np.interp(sign * split, known, bend), curvature)
            speed = np.where(here, 0.5 * total * np.interp(sign * split, known, share), speed)
        return np.stack([speed, np.zeros_like(speed), speed * curvature], axis=-1)

    def parameter_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:  # noqa: D102
        return np.zeros((*np.broadcast(v_left, v_right).shape, 3, 0))

    def speed_jacobian(self, v_left: ArrayLike, v_right: ArrayLike) -> FloatArray:
        """Derivative (..., 3, 2), towards the straight: a difference over ``STEP``; nothing at rest."""
        left, right = np.broadcast_arrays(np.asarray(v_left, dtype=float), np.asarray(v_right, dtype=float))
        towards = np.where(right >= left, STEP, -STEP)
        here = self.twist(left, right)
        by_left = (self.twist(left + towards, right) - here) / towards[..., None]
        by_right = (self.twist(left, right - towards) - here) / -towards[..., None]
        return np.nan_to_num(np.stack([by_left, by_right], axis=-1))

    def wheel_speeds(self, v: ArrayLike, omega: ArrayLike) -> FloatArray:
        """Rim speeds (..., 2) for v > 0 and omega, Eqs. (6), (14), (15): the planning of section V.

        Raises:
            RequestError: backwards, or an arc tighter than all runs.
        """
        pairs = np.stack(np.broadcast_arrays(np.asarray(v, dtype=float), np.asarray(omega, dtype=float)), axis=-1)
        rims = [self._rims(*pair) for pair in pairs.reshape(-1, 2).tolist()]
        return np.array(rims).reshape(pairs.shape)

    def _rims(self, v: float, omega: float) -> FloatArray:
        if v <= 0.0:
            raise RequestError(f"slip ratios of circles tell forward motion only, got v = {v:g} m/s")
        if omega == 0.0:
            return np.array([v, v])
        side = SIDES[0] if omega > 0.0 else SIDES[1]
        rows, curvature = self._of(side), abs(omega) / v
        if curvature > rows[-1, 0] + 1e-12:
            have = f"down to {1.0 / rows[-1, 0]:.3f} m only" if len(rows) > 1 else "none"
            raise RequestError(
                f"an arc of {1.0 / curvature:.3f} m to the {side} needs circle runs that way that are as tight; there"
                f" are {have}: record them, or give a wider --radius or --clearance or the other --direction"
            )
        K, i_o = (float(np.interp(curvature, rows[:, 0], column)) for column in rows[:, 1:].T)
        return rims_on_circle(1.0 / curvature, omega, K, self.track_width, i_o)
