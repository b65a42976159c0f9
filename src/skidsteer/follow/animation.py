"""A run as a page that plays it: one file, which asks nothing of any other place."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from skidsteer.errors import printable
from skidsteer.follow.picture import thin
from skidsteer.follow.run import Run
from skidsteer.vehicle import Vehicle

FRAMES = 6000  # at most
RATE = 25.0  # [Hz] at most
POINTS = 2000  # of the path
FAR = 30.0  # robots long: a path larger than that is shown from nearby


def page(title: str, sentences: Sequence[str], run: Run, vehicle: Vehicle) -> str:
    """The page as HTML: robot, path, way, ICRs as they move and the cross-track error, to play.

    Args:
        title: of the page.
        sentences: below it.
        run: that is played.
        vehicle: its measures.
    """
    text = files("skidsteer.follow").joinpath("animation.html").read_text(encoding="utf-8")
    parts = {
        "TITLE": html.escape(printable(title)),
        "SENTENCES": "\n".join(f"<p>{html.escape(printable(sentence))}</p>" for sentence in sentences),
        "DATA": embedded(_data(run, vehicle)),
    }
    return re.sub("@(TITLE|SENTENCES|DATA)@", lambda mark: parts[mark[1]], text)


def embedded(data: Any) -> str:
    """JSON that may stand in a script of a page, whatever its texts say."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _data(run: Run, vehicle: Vehicle) -> dict[str, Any]:
    count = int(min(FRAMES, RATE * run.t[-1] + 2))
    kept = thin(np.arange(len(run.t)), max(count, 2))
    path = run.path.at(np.linspace(0.0, run.path.length, int(min(POINTS, 20.0 * run.path.length + 2))))
    states, placed = run.states[kept], run.placed[kept]
    half = 0.5 * (vehicle.wheel_base or 0.0)
    length = 2.0 * (half + vehicle.wheel_radius)
    return {
        "t": _rounded(run.t[kept], 3),
        **{name: _rounded(column, 3) for name, column in zip(("x", "y", "yaw"), placed.T, strict=True)},
        **{
            name: _rounded(c, 4)
            for name, c in zip(("vx", "vy", "omega", "left", "right"), states[:, 3:].T, strict=True)
        },
        "off": _rounded(run.cross_track[kept], 4),
        "blind": np.isnan(run.seen[kept, 0]).astype(int).tolist(),
        "path": {"x": _rounded(path[:, 0], 3), "y": _rounded(path[:, 1], 3)},
        "robot": {
            "length": length,
            "track": vehicle.track_width,
            "radius": vehicle.wheel_radius,
            "axles": np.linspace(half, -half, max(vehicle.wheels // 2, 1)).tolist(),
        },
        "near": bool(np.ptp(path[:, :2], axis=0).max() > FAR * length),
    }


def _rounded(values: np.ndarray, digits: int) -> list[float]:
    return [float(value) for value in np.round(values, digits)]
