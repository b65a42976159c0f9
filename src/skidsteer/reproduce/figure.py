"""A figure as data, and as a drawing where matplotlib is there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skidsteer.figures.sheet import COLOURS, COLUMN, DASHES, MARKERS, blank, save, style
from skidsteer.se2 import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One line of a figure; ``low`` and ``high`` are the ends of its bars."""

    label: str
    x: FloatArray  # (n,)
    y: FloatArray  # (n,)
    low: FloatArray | None = None  # (n,)
    high: FloatArray | None = None  # (n,)
    measured: bool = False  # the reference of the others


@dataclass(frozen=True, slots=True)
class Figure:
    """What is drawn; ``name`` is that of its files."""

    name: str
    title: str
    x_label: str  # with the unit
    y_label: str
    curves: tuple[Curve, ...]
    to_scale: bool = False  # with equal axes


FEW = 12  # points up to which they are marked
BESIDE = 5  # curves up to which the legend is inside the axes
MEASURED: dict[str, Any] = {"color": "#999999", "linewidth": 2.4, "zorder": 1.5}


def _look(i: int) -> dict[str, Any]:
    return {"color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i % len(DASHES)]}


def draw(figure: Figure, path: Path) -> None:
    """Write a drawing; the suffix of the path gives the format, svg or png.

    Raises:
        RequestError: matplotlib is not installed.
        DataError: the file cannot be written.
    """
    with style():
        below = len(figure.curves) > BESIDE
        sheet = blank(1.4 * COLUMN, 80.0 + (2.2 * len(figure.curves) if below else 0.0))
        axes = sheet.add_subplot()
        for i, curve in enumerate(figure.curves):
            look = {"label": curve.label, **(MEASURED if curve.measured else _look(i))}
            mark = "" if curve.measured or figure.to_scale or len(curve.x) > FEW else MARKERS[i % len(MARKERS)]
            if curve.low is None or curve.high is None:
                axes.plot(curve.x, curve.y, marker=mark, **look)
            else:
                bars = [curve.y - curve.low, curve.high - curve.y]
                axes.errorbar(curve.x, curve.y, yerr=bars, marker=mark, capsize=2, elinewidth=0.8, **look)
        axes.set(xlabel=figure.x_label, ylabel=figure.y_label)
        if figure.to_scale:
            axes.set_aspect("equal", adjustable="datalim")
        if below:
            sheet.legend(loc="outside lower center", ncols=2)
        else:
            axes.legend()
        save(sheet, path)
