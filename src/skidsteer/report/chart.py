"""Charts as plain dictionaries for Plotly; colours are names ("$calibrated") that the page's theme resolves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from skidsteer.se2 import FloatArray

Json = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Chart:
    """One chart: traces and layout for Plotly, its height [px], and what it shows for those who cannot see it."""

    name: str
    data: list[Json]
    layout: Json
    label: str
    height: int = 340

    @property
    def figure(self) -> Json:
        """What the page draws."""
        return {"data": self.data, "layout": self.layout}


def axis(title: str, **words: Any) -> Json:
    """An axis with a title."""
    return {"title": {"text": title}, **words}


def colour_bar(title: str) -> Json:
    """A colour bar with its title beside it."""
    font = {"size": 13, "color": "$muted"}
    return {"title": {"text": title, "side": "right", "font": font}, "thickness": 12, "outlinewidth": 0}


def curve(x: FloatArray, y: FloatArray, name: str, colour: str, dash: str, width: float = 2.4) -> Json:
    """A line through points (k,), without a tooltip."""
    line = {"color": colour, "dash": dash, "width": width}
    values = {"x": np.round(x, 3).tolist(), "y": np.round(y, 4).tolist()}
    return {"type": "scatter", "mode": "lines", "name": name, **values, "line": line, "hoverinfo": "skip"}
