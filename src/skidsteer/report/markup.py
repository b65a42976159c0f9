"""HTML from plain values; all text is escaped, so that nothing from a log can run or draw."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from skidsteer.errors import printable


class Html(str):
    """Text that is markup already; any other string is escaped when it is inserted."""

    __slots__ = ()


Content = str | Html | Iterable["Content"] | None


def tag(name: str, /, *content: Content, **attributes: str | bool | None) -> Html:
    """An element. Attributes: ``_`` becomes ``-``, a trailing one is dropped (``class_``), None and False leave out."""
    head = name
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        word = key.rstrip("_").replace("_", "-")
        head += f" {word}" if value is True else f' {word}="{html.escape(printable(str(value)), quote=True)}"'
    inside = markup(content)
    return Html(f"<{head}>" if name in ("meta", "br", "input", "hr") else f"<{head}>{inside}</{name}>")


def markup(content: Content) -> Html:
    """Markup of texts, elements, and lists of them."""
    if content is None:
        return Html("")
    if isinstance(content, Html):
        return content
    if isinstance(content, str):
        return Html("\n".join(chart_text(line) for line in content.split("\n")))
    return Html("".join(markup(part) for part in content))


def table(
    label: str,
    head: Sequence[Content],
    rows: Iterable[Sequence[Content]],
    numeric: Sequence[int] = (),
    wide: Sequence[int] = (),
) -> Html:
    """A table that scrolls sideways where it is wider than the page.

    ``numeric`` columns are set to the right, ``wide`` ones keep room for a sentence.
    """

    def cell(name: str, i: int, content: Content) -> Html:
        kind = "number" if i in numeric else "wide" if i in wide else None
        if name == "td" and i == 0:
            return tag("th", content, scope="row", class_=kind)
        return tag(name, content, class_=kind, scope="col" if name == "th" else None)

    body = [tag("tr", *(cell("td", i, c) for i, c in enumerate(row))) for row in rows]
    heading = tag("thead", tag("tr", *(cell("th", i, c) for i, c in enumerate(head))))
    return tag(
        "div", tag("table", heading, tag("tbody", body)), class_="scroll", tabindex="0", role="region", aria_label=label
    )


def embedded(value: Any, name: str) -> Html:
    """JSON as data in a page, in which no text can end the element; NaN and infinity become null."""
    text = json.dumps(plain(value), allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Html(f'<script type="application/json" id="{html.escape(name)}">{text}</script>')


def plain(value: Any) -> Any:
    """A value as JSON has it: arrays and tuples as lists, NaN and infinity as null."""
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def chart_text(text: str) -> str:
    """A line of text for a chart, whose labels take markup: escaped, and without marks that reverse or hide text."""
    return html.escape(printable(text), quote=False)


def rounded(value: float, digits: int = 2, unit: str = "") -> str:
    """A number to so many significant digits with its unit, without an exponent; a dash where there is none."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return f"0 {unit}".rstrip()
    places = max(digits - 1 - math.floor(math.log10(abs(float(f"{value:.{digits}g}")))), 0)
    joint = "" if unit == "°" else " "
    return f"{value:.{places}f}{joint}{unit}".rstrip().replace("-", "−")


def spread(value: float, sigma: float) -> tuple[str, str]:
    """Value and sigma, to two digits of the sigma."""
    if not (math.isfinite(sigma) and sigma > 0.0):
        return rounded(value, 5), "fixed"
    places = min(max(1 - math.floor(math.log10(float(f"{sigma:.2g}"))), 0), 8)
    return f"{value:.{places}f}".replace("-", "−"), f"{sigma:.{places}f}"
