"""The robot from above, to scale: wheels, body, tread ICRs and their 95 % ellipses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skidsteer.report.markup import Html, rounded, tag
from skidsteer.report.treads import TreadIcrs, ellipse
from skidsteer.vehicle import Vehicle

WIDTH, MARGIN, HEAD, FOOT = 460.0, 42.0, 20.0, 30.0  # of the drawing, in its own units
STEP = 34.0  # from one measure below the robot to the next
MOST_HEIGHT = 330.0  # of the robot in it
BASE = 0.8  # wheel base over track width where unknown
TREAD = 0.55  # width of a wheel over its radius; drawn only


@dataclass(frozen=True, slots=True)
class Canvas:
    """Body coordinates (x forward, y left) [m] to the drawing, whose y grows downwards."""

    scale: float  # units a metre
    middle: float
    top: float  # x [m] at the upper edge of the robot

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Place in the drawing of a point of the robot."""
        return self.middle - self.scale * y, HEAD + self.scale * (self.top - x)


def robot_drawing(vehicle: Vehicle, icrs: TreadIcrs) -> Html:
    """SVG of the robot; colours by class, so that the page's themes apply.

    Args:
        vehicle: an unknown wheel base is guessed, and the wheels are dashed.
        icrs: of its treads.
    """
    base = vehicle.wheel_base or BASE * vehicle.track_width
    reach = ellipse(icrs.covariance[0])[0], ellipse(icrs.covariance[1])[0]
    half = 0.5 * vehicle.track_width + TREAD * vehicle.wheel_radius
    shipped = 0.5 * (vehicle.factory_separation or 0.0) * (vehicle.factory_multiplier or 0.0)
    wide = max(half, shipped, *(abs(y) + min(r, half) for y, r in zip(icrs.place[:, 1], reach, strict=True)))
    top = max(0.5 * base + 1.2 * vehicle.wheel_radius, float(icrs.place[:, 0].max()) + 0.1 * wide)
    low = min(-0.5 * base - 1.2 * vehicle.wheel_radius, float(icrs.place[:, 0].min()) - 0.1 * wide)
    scale = min((0.5 * WIDTH - MARGIN) / wide, MOST_HEIGHT / (top - low))
    canvas = Canvas(scale, 0.5 * WIDTH, top)
    foot = HEAD + scale * (top - low) + 14.0
    measures = _measures(vehicle, icrs)
    deepest = foot + STEP * (len(measures) - 1)
    parts = [
        *_body(canvas, vehicle, base),
        tag(
            "path",
            d="M{:.1f} {:.1f}L{:.1f} {:.1f}".format(*canvas.at(*icrs.place[0]), *canvas.at(*icrs.place[1])),
            class_="icr-x",
        ),
        *_origin(canvas),
        *(_icr(canvas, icrs, i, deepest) for i in (0, 1)),
        *(_measure(canvas, foot + STEP * i, *measure) for i, measure in enumerate(measures)),
    ]
    height = deepest + FOOT
    label = (
        f"The robot from above. Left tread ICR {rounded(icrs.place[0, 1], 3)} m to the left, right one"
        f" {rounded(-icrs.place[1, 1], 3)} m to the right, {rounded(icrs.place[:, 0].mean(), 2)} m ahead of base_link."
    )
    return tag("svg", *parts, viewBox=f"0 0 {WIDTH:g} {height:.0f}", role="img", aria_label=label, class_="robot")


def _body(canvas: Canvas, vehicle: Vehicle, base: float) -> list[Html]:
    r, half = vehicle.wheel_radius, 0.5 * vehicle.track_width
    inner = half - 0.42 * r
    parts = [_box(canvas, 0.5 * base + 0.7 * r, inner, base + 1.4 * r, 2.0 * inner, 0.3 * r, "body")]
    per_side = max(vehicle.wheels // 2, 1)
    kind = "wheel" if vehicle.wheel_base or per_side == 1 else "wheel guessed"
    for x in np.linspace(0.5 * base, -0.5 * base, per_side).tolist() if per_side > 1 else [0.0]:
        for y in (half, -half):
            parts.append(_box(canvas, x + r, y + 0.5 * TREAD * r, 2.0 * r, TREAD * r, 0.12 * r, kind))
    (x0, y0), (_, y1) = canvas.at(0.5 * base + 0.35 * r, 0.0), canvas.at(0.5 * base - 0.35 * r, 0.0)
    arrow = f"M{x0:.1f} {y0:.1f}l-7 12h14zM{x0:.1f} {y0 + 10:.1f}V{max(y1, y0 + 24):.1f}"
    return [*parts, tag("path", d=arrow, class_="ahead")]


def _box(canvas: Canvas, x: float, y: float, length: float, width: float, rounding: float, kind: str) -> Html:
    left, top = canvas.at(x, y)
    size = {"width": f"{canvas.scale * width:.1f}", "height": f"{canvas.scale * length:.1f}"}
    return tag("rect", x=f"{left:.1f}", y=f"{top:.1f}", rx=f"{canvas.scale * rounding:.1f}", **size, class_=kind)


def _origin(canvas: Canvas) -> list[Html]:
    x, y = canvas.at(0.0, 0.0)
    return [tag("path", d=f"M{x - 7:.1f} {y:.1f}h14M{x:.1f} {y - 7:.1f}v14", class_="origin")]


def _icr(canvas: Canvas, icrs: TreadIcrs, i: int, deepest: float) -> Html:
    """One tread ICR with its 95 % ellipse, and a line down to the measure below."""
    (x, y), side = icrs.place[i].tolist(), ("left", "right")[i]
    a, b, angle = ellipse(icrs.covariance[i])
    u, v = canvas.at(x, y)
    turn = -90.0 - math.degrees(angle)  # x is up, y to the left: the drawing's axes turned by a quarter
    shape = tag(
        "ellipse",
        cx=f"{u:.1f}",
        cy=f"{v:.1f}",
        rx=f"{max(canvas.scale * a, 1.0):.1f}",
        ry=f"{max(canvas.scale * b, 1.0):.1f}",
        transform=f"rotate({turn:.1f} {u:.1f} {v:.1f})",
        class_="region",
    )
    point = tag("circle", cx=f"{u:.1f}", cy=f"{v:.1f}", r="3.4", class_="icr")
    down = tag("path", d=f"M{u:.1f} {v + 6:.1f}V{deepest:.1f}", class_="down")
    name = tag("title", f"{side} tread ICR at x = {x:.3f} m, y = {y:.3f} m")
    return tag("g", name, down, shape, point)


Measure = tuple[float, float, str, str]  # from y, to y [m], kind, words


def _measures(vehicle: Vehicle, icrs: TreadIcrs) -> list[Measure]:
    """Widths to show below the robot, the innermost first."""
    half = 0.5 * vehicle.track_width
    found: list[Measure] = [(half, -half, "nominal", f"track width {vehicle.track_width:.3g} m")]
    if vehicle.factory_multiplier is not None and vehicle.factory_separation is not None:
        shipped = vehicle.factory_multiplier * vehicle.factory_separation
        found.append((0.5 * shipped, -0.5 * shipped, "shipped", f"as shipped {shipped:.3g} m"))
    left, right = icrs.place[:, 1].tolist()
    return [*found, (left, right, "calibrated", f"from ICR to ICR {icrs.distance:.3g} m")]


def _measure(canvas: Canvas, v: float, left: float, right: float, kind: str, words: str) -> Html:
    """A line with a bar at both ends, and what it measures below it."""
    a, b = canvas.at(0.0, left)[0], canvas.at(0.0, right)[0]
    line = f"M{a:.1f} {v:.1f}H{b:.1f}M{a:.1f} {v - 5:.1f}v10M{b:.1f} {v - 5:.1f}v10"
    text = tag("text", words, x=f"{0.5 * (a + b):.1f}", y=f"{v + 18:.1f}", class_=kind)
    return tag("g", tag("path", d=line, class_=f"measure {kind}"), text)
