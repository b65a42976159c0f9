"""A figure as data, and as a drawing where matplotlib is there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from skidsteer.errors import RequestError
from skidsteer.se2 import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One line of a figure; ``low`` and ``high`` are the ends of its bars."""

    label: str
    x: FloatArray  # (n,)
    y: FloatArray  # (n,)
    low: FloatArray | None = None  # (n,)
    high: FloatArray | None = None  # (n,)


@dataclass(frozen=True, slots=True)
class Figure:
    """What is drawn; ``name`` is that of its files."""

    name: str
    title: str
    x_label: str  # with the unit
    y_label: str
    curves: tuple[Curve, ...]


def draw(figure: Figure, path: Path) -> None:
    """Write a drawing; the suffix of the path tells the format (png, svg, pdf).

    Raises:
        RequestError: matplotlib is not installed.
    """
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure as Sheet
    except ImportError as error:
        raise RequestError("drawing needs matplotlib: pip install 'skidsteer[figures]'") from error
    sheet = Sheet(figsize=(7.0, 4.5), layout="constrained")
    FigureCanvasAgg(sheet)
    axes = sheet.add_subplot()
    for curve in figure.curves:
        if curve.low is None or curve.high is None:
            axes.plot(curve.x, curve.y, label=curve.label)
        else:
            bars = [curve.y - curve.low, curve.high - curve.y]
            axes.errorbar(curve.x, curve.y, yerr=bars, label=curve.label, marker="o", capsize=3)
    axes.set(title=figure.title, xlabel=figure.x_label, ylabel=figure.y_label)
    axes.grid(alpha=0.3)
    axes.legend()
    undated = {"Date": None} if path.suffix == ".svg" else None
    with rc_context({"svg.hashsalt": figure.name}):  # the same figure gives the same file
        sheet.savefig(path, metadata=undated)
