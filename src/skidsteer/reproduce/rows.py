"""One line of a reproduction: what a paper prints, what we find, and whether the two agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["reproduced", "misprint", "not reproducible", "deviates"]


@dataclass(frozen=True, slots=True)
class Row:
    """One printed figure and ours.

    ``misprint``: the paper contradicts itself and the right figure is known. ``not reproducible``: its figure does not
    follow from what it prints. ``deviates``: ours should agree and does not. All but ``reproduced`` give a reason.
    """

    what: str  # with the place in the paper
    paper: float
    ours: float
    verdict: Verdict
    reason: str = ""


def compared(what: str, paper: float, ours: float, tolerance: float, reason: str = "") -> Row:
    """A row that should agree to within a tolerance; ``reason`` says what that is, or why it is not met."""
    # The margin is for printed decimals, which are not exact in binary.
    agrees = abs(paper - ours) <= tolerance + 1e-9
    return Row(what, paper, ours, "reproduced" if agrees else "deviates", reason)
