"""One line of a reproduction: what a paper prints, what we find, and whether the two agree."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from skidsteer.reproduce.figure import Figure

Verdict = Literal["reproduced", "misprint", "not reproducible", "deviates", "simulated"]


@dataclass(frozen=True, slots=True)
class Row:
    """One printed figure and ours.

    ``misprint``: the paper contradicts itself and the right figure is known. ``not reproducible``: its figure does not
    follow from what it prints. ``deviates``: ours should agree and does not. ``simulated``: the paper measured a robot,
    and a simulated one stands in for it. All but ``reproduced`` give a reason.
    """

    what: str  # with the place in the paper
    paper: float  # NaN where it claims without a figure
    ours: float
    verdict: Verdict
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Reproduction:
    """All that a paper's calculation gives."""

    rows: tuple[Row, ...]
    figures: tuple[Figure, ...] = ()


def compared(what: str, paper: float, ours: float, tolerance: float, reason: str = "") -> Row:
    """A row that should agree to within a tolerance; ``reason`` says what that is, or why it is not met."""
    # The margin is for printed decimals, which are not exact in binary.
    agrees = abs(paper - ours) <= tolerance + 1e-9
    return Row(what, paper, ours, "reproduced" if agrees else "deviates", reason)


def to_csv(rows: Sequence[Row]) -> str:
    """Lines of what, paper, ours, difference, verdict, reason."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["what", "paper", "ours", "difference", "verdict", "reason"])
    for row in rows:
        numbers = ["" if math.isnan(v) else f"{v:.6g}" for v in (row.paper, row.ours, row.ours - row.paper)]
        writer.writerow([row.what, *numbers, row.verdict, row.reason])
    return text.getvalue()
