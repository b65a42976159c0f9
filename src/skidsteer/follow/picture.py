"""A run as pictures: the path and the way driven, and errors and speeds against time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from skidsteer.follow.run import Run
from skidsteer.se2 import FloatArray

PIXELS, EDGE = 720.0, 36.0  # of the longer side, and around
PANEL = (720.0, 150.0)  # of a plot against time
LEFT, GAP = 64.0, 26.0  # beside and between plots
MOST = 1500  # points of a line
COLOURS = ("#2b6cb0", "#c05621", "#6b46c1")
GREY = "#999"
TEXT = 'font-family="sans-serif" font-size="12" fill="#333"'


class Line(NamedTuple):
    """A line of a plot."""

    name: str
    values: FloatArray  # (n,)
    colour: str
    dashes: str = ""


def way(run: Run) -> str:
    """The path (dashed) and the way of the robot in its map, as SVG; x points to the right."""
    path = run.path.at(np.linspace(0.0, run.path.length, MOST))[:, :2]
    driven = thin(run.placed)[:, :2]
    every = np.concatenate([path, driven])
    low, size = every.min(axis=0), np.maximum(np.ptp(every, axis=0), 1.0)
    scale = PIXELS / float(size.max())
    width, height = scale * size + 2.0 * EDGE

    def place(points: FloatArray) -> str:
        return _points((points - low) * [scale, -scale] + [EDGE, height - EDGE])

    length = _round_step(0.2 * float(size.max()))
    (x, y), (end, _) = ((points.split(",")) for points in place(low + np.array([[0.0, 0.0], [length, 0.0]])).split())
    start = place(driven[:1]).split(",")
    return _svg(
        width,
        height,
        [
            f'<polyline points="{place(path)}" stroke="{GREY}" stroke-width="2" stroke-dasharray="6 4"/>',
            f'<polyline points="{place(driven)}" stroke="{COLOURS[0]}" stroke-width="1.5"/>',
            f'<circle cx="{start[0]}" cy="{start[1]}" r="4" fill="{COLOURS[1]}"/>',
            f'<path d="M{x} {float(y) + 14:.1f}H{end}" stroke="#333" stroke-width="2"/>',
            f'<text x="{end}" y="{float(y) + 18:.1f}" dx="6" {TEXT}>{length:g} m</text>',
        ],
    )


def against_time(run: Run, limit: float) -> str:
    """Cross-track error, speed and wheel speeds with their limit [m/s] against time, as SVG."""
    kept = thin(np.arange(len(run.t)))
    sent, rims, speed = run.sent[kept], run.states[kept, 6:], np.hypot(*run.states[kept, 3:5].T)
    edge, last = np.full(len(kept), limit), max(float(run.t[-1]), 1e-9)
    panels: Sequence[tuple[str, Sequence[Line]]] = (
        ("cross-track error [cm]", [Line("", 100.0 * run.cross_track[kept], COLOURS[0])]),
        ("speed [m/s]", [Line("", speed, COLOURS[0])]),
        (
            "wheel speeds [m/s]",
            [
                Line("left", rims[:, 0], COLOURS[0]),
                Line("right", rims[:, 1], COLOURS[1]),
                Line("sent", sent[:, 0], COLOURS[0], "2 3"),
                Line("", sent[:, 1], COLOURS[1], "2 3"),
                Line("limit", edge, GREY, "6 4"),
                Line("", -edge, GREY, "6 4"),
            ],
        ),
    )
    parts: list[str] = []
    for i, (title, lines) in enumerate(panels):
        parts += _panel(run.t[kept], title, lines, EDGE + i * (PANEL[1] + GAP))
    width, bottom = LEFT + PANEL[0] + EDGE, EDGE + len(panels) * (PANEL[1] + GAP) - GAP
    for time in ticks(0.0, last):
        x = LEFT + PANEL[0] * time / last
        parts.append(f'<text x="{x:.1f}" y="{bottom + 16:.1f}" text-anchor="middle" {TEXT}>{time:g}</text>')
    middle = LEFT + 0.5 * PANEL[0]
    parts.append(f'<text x="{middle:.1f}" y="{bottom + 34:.1f}" text-anchor="middle" {TEXT}>time [s]</text>')
    return _svg(width, bottom + 44.0, parts)


def _panel(t: FloatArray, title: str, lines: Sequence[Line], top: float) -> list[str]:
    """One plot, its upper edge at ``top`` [pixels]."""
    values = np.concatenate([line.values for line in lines])
    low, high = _room(float(np.nanmin(values)), float(np.nanmax(values)))
    last = max(float(t[-1]), 1e-9)

    def place(x: FloatArray, y: FloatArray) -> FloatArray:
        across, down = x / last * PANEL[0], (high - y) / (high - low) * PANEL[1]
        return np.column_stack([LEFT + across, top + down])

    out = [f'<rect x="{LEFT}" y="{top:.1f}" width="{PANEL[0]}" height="{PANEL[1]}" stroke="#bbb"/>']
    for value in ticks(low, high):
        y = place(np.zeros(1), np.array([value]))[0, 1]
        out.append(f'<path d="M{LEFT} {y:.1f}h{PANEL[0]}" stroke="#eee"/>')
        out.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end" {TEXT}>{value:g}</text>')
    for value in ticks(0.0, last):
        x = place(np.array([value]), np.zeros(1))[0, 0]
        out.append(f'<path d="M{x:.1f} {top:.1f}v{PANEL[1]}" stroke="#eee"/>')
    for line in lines:
        dashes = f' stroke-dasharray="{line.dashes}"' if line.dashes else ""
        out.append(f'<polyline points="{_points(place(t, line.values))}" stroke="{line.colour}"{dashes}/>')
    out.append(f'<text x="{LEFT}" y="{top - 6:.1f}" {TEXT}>{title}</text>')
    for i, line in enumerate([line for line in lines if line.name]):
        x = LEFT + PANEL[0] - 60.0 * (i + 1)
        out.append(f'<text x="{x:.1f}" y="{top - 6:.1f}" {TEXT.replace("#333", line.colour)}>{line.name}</text>')
    return out


def thin(values: np.ndarray, most: int = MOST) -> np.ndarray:
    """Not more than that many of n samples, evenly spaced, first and last among them."""
    n = len(values)
    return np.asarray(values[np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int))])


def ticks(low: float, high: float) -> list[float]:
    """Round numbers between two."""
    step = _round_step(0.25 * (high - low))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(i * step, 10) for i in range(first, last + 1)]


def _room(low: float, high: float) -> tuple[float, float]:
    """A little more than from low to high, with 0 in it."""
    low, high = min(low, 0.0), max(high, 0.0)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _round_step(about: float) -> float:
    """1, 2 or 5 times a power of ten, not more than about."""
    power = 10.0 ** math.floor(math.log10(about))
    return power * max(m for m in (1.0, 2.0, 5.0) if m * power <= about * (1.0 + 1e-9))


def _points(rows: FloatArray) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in rows.tolist())


def _svg(width: float, height: float, parts: Sequence[str]) -> str:
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" fill="none">'
    ground = f'<rect width="{width:.0f}" height="{height:.0f}" fill="white"/>'
    return "\n".join([head, ground, *parts, "</svg>", ""])
