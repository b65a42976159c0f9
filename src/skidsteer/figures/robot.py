"""The robot from above, to scale, with the ICRs of its treads and their 95 % ellipses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.figures.material import Material
from skidsteer.figures.sheet import BLACK, BLUE, COLUMN, GREY, VERMILION, blank, to_scale
from skidsteer.report.reckoner import known_vehicle
from skidsteer.report.treads import ellipse, tread_icrs
from skidsteer.se2 import FloatArray, rotate
from skidsteer.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Sheet

LENGTH = 0.8  # wheel base over track width where the vehicle does not tell its own


def draw_robot_icrs(material: Material) -> Sheet:
    """A sheet with the robot alone."""
    sheet = blank(COLUMN, 78.0)
    draw_robot(sheet.add_subplot(), material.calibration)
    return sheet


def draw_robot(axes: Axes, calibration: Calibration) -> None:
    """Draw the robot with its tread ICRs, x forward to the top, y to the left."""
    vehicle, icrs = calibration.vehicle, tread_icrs(calibration)
    base = _body(axes, vehicle)
    half, low = 0.5 * vehicle.track_width, -0.5 * base - 1.3 * vehicle.wheel_radius
    gap = 0.16 * vehicle.track_width
    _measure(axes, (half, -half), low - gap, f"track width {vehicle.track_width:.2f} m", VERMILION)
    for (x, y), covariance in zip(icrs.place, icrs.covariance, strict=True):
        axes.plot([y, y], [x, low - 2.3 * gap], color=BLUE, linewidth=0.5, linestyle=(0, (2, 2)))
        axes.fill(*_outline(x, y, covariance), facecolor=BLUE, alpha=0.3, edgecolor=BLUE, linewidth=0.8)
    axes.plot(icrs.place[:, 1], icrs.place[:, 0], "o", color=BLUE, markersize=2.5)
    _measure(
        axes, (icrs.place[0, 1], icrs.place[1, 1]), low - 2.3 * gap, f"turns as if {icrs.distance:.2f} m wide", BLUE
    )
    axes.plot(0.0, 0.0, "+", color=BLACK, markersize=5)
    for (x, y), side in zip(icrs.place.tolist(), ("left", "right"), strict=True):
        axes.text(y, x + 0.12 * half, f"{side}\nICR", color=BLUE, ha="center", va="bottom")
    to_scale(axes, "y, to the left [m]", "x, forward [m]", "box")
    wide = 1.25 * max(np.abs(icrs.place[:, 1]).max(), half + vehicle.wheel_radius)
    axes.set_xlim(wide, -wide)
    axes.set_ylim(low - 3.6 * gap, 0.5 * base + 2.2 * vehicle.wheel_radius)


def _body(axes: Axes, vehicle: Vehicle) -> float:
    """Draw body and wheels; the wheel base [m] that they were drawn with."""
    from matplotlib.patches import FancyBboxPatch, Rectangle

    base = known_vehicle(vehicle).wheel_base or LENGTH * vehicle.track_width
    r, half = vehicle.wheel_radius, 0.5 * vehicle.track_width
    thick, inner = 0.55 * r, half - 0.4 * r
    frame = FancyBboxPatch(
        (-inner, -0.5 * base - 0.6 * r),
        2 * inner,
        base + 1.2 * r,
        boxstyle=f"round,pad=0,rounding_size={0.3 * r}",
        facecolor="#eeeeee",
        edgecolor=GREY,
        linewidth=0.8,
    )
    axes.add_patch(frame)
    per_side = max(vehicle.wheels // 2, 1)
    for x in np.linspace(0.5 * base, -0.5 * base, per_side) if per_side > 1 else (0.0,):
        for y in (half, -half):
            axes.add_patch(Rectangle((y - 0.5 * thick, x - r), thick, 2 * r, facecolor="#555555", edgecolor="none"))
    tip = 0.5 * base + 0.35 * r
    axes.annotate("", (0.0, tip), (0.0, 0.12 * base), arrowprops={"arrowstyle": "-|>", "color": GREY, "linewidth": 0.8})
    return base


def _measure(axes: Axes, ends: tuple[float, float], x: float, text: str, colour: str) -> None:
    axes.annotate(
        "",
        (ends[0], x),
        (ends[1], x),
        arrowprops={"arrowstyle": "<|-|>", "color": colour, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0},
    )
    axes.annotate(text, (0.5 * sum(ends), x), (0, -2), textcoords="offset points", color=colour, ha="center", va="top")


def _outline(x: float, y: float, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The 95 % ellipse as y, x, the way it is drawn."""
    a, b, direction = ellipse(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    forward, left = rotate(direction, np.column_stack([a * np.cos(angle), b * np.sin(angle)])).T
    return y + left, x + forward
