"""A plan as a picture: obstacle, expected course, outlines of the robot, and the region of its end."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skidsteer.plan.circumnavigation import Plan
from skidsteer.se2 import FloatArray

PIXELS = 720.0  # of the longer side
EDGE = 30.0  # pixels around
STATIONS = 4  # outlines of the robot for each stretch
COLOURS = ("#2b6cb0", "#c05621")  # of straights and of arcs

Place = Callable[[FloatArray], str]


def draw(plan: Plan) -> str:
    """The picture as SVG; x points to the right."""
    path, outlines = plan.expected.path.values, plan.robot.at(plan.expected.path.values)
    obstacle = plan.obstacle.at(plan.place)
    every = np.concatenate([outlines.reshape(-1, 2), obstacle, plan.end_ellipse])
    low, size = every.min(axis=0), np.ptp(every, axis=0)
    scale = PIXELS / float(size.max())
    width, height = scale * size + 2.0 * EDGE

    def place(points: FloatArray) -> str:
        rows = (points - low) * [scale, -scale] + [EDGE, height - EDGE]
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in rows.tolist())

    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" fill="none">',
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="white"/>',
        f'<polygon points="{place(obstacle)}" fill="#ddd" stroke="#555"/>',
        *_robots(plan, outlines, place),
        *_course(plan, path, place),
        f'<polygon points="{place(plan.end_ellipse)}" stroke="#c00" stroke-dasharray="5 3"/>',
        *_words(plan, place),
        "</svg>",
    ]
    return "\n".join([*lines, ""])


def _robots(plan: Plan, outlines: FloatArray, place: Place) -> list[str]:
    """Outlines in each stretch of the first lap, and at the end."""
    t, first = plan.expected.path.t, list(zip(plan.starts.tolist(), plan.stretches, strict=True))[:4]
    times = [begin + share * s.duration for begin, s in first for share in np.arange(STATIONS) / STATIONS]
    at = [*np.searchsorted(t, times).tolist(), len(t) - 1]
    return [f'<polygon points="{place(outlines[i])}" stroke="#999" stroke-width="0.8"/>' for i in at]


def _course(plan: Plan, path: FloatArray, place: Place) -> list[str]:
    t = plan.expected.path.t
    edges = np.searchsorted(t, [*plan.starts, t[-1]])
    return [
        f'<polyline points="{place(path[a : b + 1, :2])}" stroke="{COLOURS[s.curved]}" stroke-width="1.6"/>'
        for s, a, b in zip(plan.stretches, edges[:-1], edges[1:], strict=True)
    ]


def _words(plan: Plan, place: Place) -> list[str]:
    """Letters where the stretches of a lap begin, and the size of the obstacle."""
    style = 'font-family="sans-serif" font-size="15" fill="#222" text-anchor="middle"'
    t, path = plan.expected.path.t, plan.expected.path.values
    at = np.searchsorted(t, plan.starts[:4])
    spots = [(s.name[0], path[i, :2]) for i, s in zip(at, plan.stretches, strict=False)]
    spots.append((f"{plan.obstacle.length:g} x {plan.obstacle.width:g} m", plan.place[:2]))
    out = []
    for word, spot in spots:
        x, y = place(np.asarray(spot)[None]).split(",")
        out.append(f'<text x="{x}" y="{y}" {style}>{word}</text>')
    return out
