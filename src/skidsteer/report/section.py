"""What a section of the page is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from skidsteer.report.chart import Chart
from skidsteer.report.markup import Content, Html, markup, tag


@dataclass(frozen=True, slots=True)
class Section:
    """One section, and the charts that the page draws into it."""

    name: str
    title: str
    body: Html
    charts: tuple[Chart, ...] = ()


def section(name: str, title: str, *body: Content, charts: Iterable[Chart] = ()) -> Section:
    """A section; plain text becomes a paragraph."""
    return Section(name, title, markup([p if isinstance(p, Html) else tag("p", p) for p in body]), tuple(charts))


def left_out(name: str, title: str, why: str) -> Section:
    """A section that only says why it is left out."""
    return section(name, title, tag("p", f"Left out: {why}", class_="left-out"))


def drawn(chart: Chart) -> Html:
    """The place that the page draws a chart into."""
    style = f"height:{chart.height}px"
    return tag("div", class_="chart", id=f"chart-{chart.name}", role="img", aria_label=chart.label, style=style)


def side_by_side(found: Iterable[Chart]) -> Html:
    """Charts beside each other; one below the other where there is no room."""
    return tag("div", *(drawn(chart) for chart in found), class_="pair")
