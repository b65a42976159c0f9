"""The sheet that figures are drawn on: one style, colours that colour-blind readers tell apart, files that repeat.

matplotlib is an extra; it is imported where a sheet is made.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from skidsteer.errors import RequestError
from skidsteer.io.atomic import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Sheet

COLUMN, PAGE = 88.0, 180.0  # [mm] width of a column and of a page of two
MM = 1.0 / 25.4  # [inch]
SUFFIXES = (".svg", ".png")

# Okabe and Ito 2008
BLACK, ORANGE, SKY, GREEN = "#000000", "#e69f00", "#56b4e9", "#009e73"
BLUE, VERMILION, PURPLE, GREY = "#0072b2", "#d55e00", "#cc79a7", "#777777"
COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK)
DASHES = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))  # told apart in black and white
MARKERS = "os^Dv<>"

STYLE: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same everywhere
    "font.size": 7.5,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.5,
    "legend.fontsize": 7.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.hashsalt": "skidsteer",  # names inside the file are the same every time
    "svg.fonttype": "path",
    "path.simplify": True,
}


@contextmanager
def style() -> Iterator[None]:
    """What is made and saved inside has the common style.

    Raises:
        RequestError: matplotlib is not installed.
    """
    try:
        from matplotlib import rc_context
    except ImportError as error:
        raise RequestError("drawing needs matplotlib: pip install 'skidsteer[figures]'") from error
    with rc_context(STYLE):
        yield


def blank(width: float = COLUMN, height: float = 62.0) -> Sheet:
    """An empty sheet of that size [mm]; inside `style`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Sheet

    sheet = Sheet(figsize=(width * MM, height * MM), layout="constrained")
    FigureCanvasAgg(sheet)
    return sheet


def to_scale(axes: Axes, x_label: str, y_label: str, adjustable: Literal["box", "datalim"] = "datalim") -> None:
    """Axes in metres, as long upwards as sideways; ``box``: their limits are kept."""
    axes.set_aspect("equal", adjustable=adjustable)
    axes.set(xlabel=x_label, ylabel=y_label)


def save(sheet: Sheet, path: Path) -> None:
    """Write a sheet whole or not at all; the suffix of the path tells the format; inside `style`.

    Raises:
        RequestError: neither svg nor png.
        DataError: the file cannot be written.
    """
    suffix = checked_suffix(path)
    data = io.BytesIO()
    undated = {"Date": None} if suffix == ".svg" else {"Software": None}
    sheet.savefig(data, format=suffix[1:], dpi=300, metadata=undated)
    write_bytes(path, data.getvalue())


def checked_suffix(path: Path) -> str:
    """The suffix of a path, in small letters.

    Raises:
        RequestError: neither svg nor png.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise RequestError(f"{path}: a figure is written as {' or '.join(SUFFIXES)}; name it so")
    return suffix
