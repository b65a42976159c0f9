"""A reproduction row by row: what a paper prints, our result, and whether they agree."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from skidsteer.reproduce.figure import Figure

Verdict = Literal["reproduced", "corrected", "cannot be reproduced", "not possible without the original data"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)


@dataclass(frozen=True, slots=True)
class Row:
    """A printed number and ours.

    ``reproduced``: they agree. ``corrected``: the paper contradicts itself and the right number is known. ``cannot be
    reproduced``: the number does not follow from what the paper prints. ``not possible without the original data``: the
    paper measured it, and ours comes from what stands in for the measurement (a simulation, a real drive of ours). All
    but ``reproduced`` need a reason.
    """

    what: str  # with the place in the paper
    paper: float  # NaN where it claims without a number
    ours: float
    verdict: Verdict
    reason: str = ""

    @property
    def difference(self) -> float:
        """Ours less the paper's; 0 where only the last bits differ."""
        apart = self.ours - self.paper
        return 0.0 if abs(apart) < 1e-12 * (1.0 + abs(self.paper)) else apart

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"verdict must be one of {', '.join(VERDICTS)}, got {self.verdict!r}")
        if self.verdict != "reproduced" and not self.reason:
            raise ValueError(f"'{self.what}' is {self.verdict}: give the reason")


@dataclass(frozen=True, slots=True)
class Place:
    """A table or figure of a paper. ``not_computed`` says why there are neither rows nor a drawing of it."""

    name: str  # as the paper numbers it: "Table 3", "Fig. 12"
    shows: str
    not_computed: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Numbers side by side: a line for each label, a cell for each head (NaN: none)."""

    title: str
    head: tuple[str, ...]
    lines: tuple[tuple[str, tuple[float, ...]], ...]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Reproduction:
    """The reproduction of a paper; ``places`` lists every table and figure that the paper prints."""

    rows: tuple[Row, ...]
    figures: tuple[Figure, ...] = ()
    tables: tuple[Table, ...] = ()
    places: tuple[Place, ...] = ()
    notes: tuple[str, ...] = ()  # further errors and remarks

    def rows_of(self, place: Place) -> tuple[Row, ...]:
        """Rows that name a table or figure."""
        return tuple(row for row in self.rows if place.name in places_named(row.what))

    def figures_of(self, place: Place) -> tuple[Figure, ...]:
        """Drawings of a figure: ``figure-12a`` is one of Fig. 12."""
        number = re.fullmatch(r"Fig\. (\d+)", place.name)
        if number is None:
            return ()
        return tuple(f for f in self.figures if re.fullmatch(rf"figure-{number[1]}(\D.*)?", f.name))


def places_named(text: str) -> set[str]:
    """Tables and figures that a text names: "Figs. 12, 13 and Table III" is "Fig. 12", "Fig. 13", "Table III"."""
    found = re.findall(r"\b(Table|Fig)s?\.? ((?:\d+|[IVX]+)(?:(?:, | and )(?:\d+|[IVX]+)\b)*)", text)
    numbers = ((kind, number) for kind, list_ in found for number in re.split(r", | and ", list_))
    return {f"{kind}. {number}" if kind == "Fig" else f"{kind} {number}" for kind, number in numbers}


def compared(what: str, paper: float, ours: float, tolerance: float, reason: str = "") -> Row:
    """A row that should agree within a tolerance; ``reason`` explains that, or why it is not met."""
    # The margin is for printed decimals, which are not exact in binary.
    agrees = abs(paper - ours) <= tolerance + 1e-9
    why = reason or f"off by more than {tolerance:g}"
    return (
        Row(what, paper, ours, "reproduced", reason) if agrees else Row(what, paper, ours, "cannot be reproduced", why)
    )


def stands_in(what: str, paper: float, ours: float, reason: str) -> Row:
    """A row whose number was measured; ``reason`` says what stands in for the measurement."""
    return Row(what, paper, ours, "not possible without the original data", reason)


def tally(rows: Sequence[Row]) -> dict[Verdict, int]:
    """How many rows have each verdict; verdicts that none has are left out."""
    return {v: n for v in VERDICTS if (n := sum(row.verdict == v for row in rows))}
