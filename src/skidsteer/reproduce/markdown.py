"""Reproductions as one Markdown document: every number in it comes from the calculation."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

from skidsteer.reproduce.rows import VERDICTS, Place, Reproduction, Row, Table, tally

HEAD = """# Five papers, calculated again

Written by `skidsteer reproduce all --out docs`; nothing here is edited by hand. `skidsteer reproduce PAPER` prints one
of them, `--json` gives every number and every curve.

*reproduced*: ours agrees. *corrected*: the paper contradicts itself and the right figure is known. *cannot be
reproduced*: the figure does not follow from what the paper prints. *not possible without the original data*: the paper
measured something that it does not publish; "ours" is then what stands in for it, a simulation or a real drive of
another robot, and the difference is no error.
"""


def document(done: Mapping[str, Reproduction], titles: Mapping[str, str]) -> str:
    """The whole document: a tally of verdicts, then a chapter for each paper."""
    lines = [HEAD, *_tally(done)]
    for name, reproduction in done.items():
        lines += ["", *chapter(name, titles[name], reproduction)]
    return "\n".join(lines) + "\n"


def _tally(done: Mapping[str, Reproduction]) -> list[str]:
    rows = {name: tally(reproduction.rows) for name, reproduction in done.items()}
    lines = [[f"[{name}](#{name})", *(str(rows[name].get(v, 0)) for v in VERDICTS)] for name in done]
    return _table(("paper", *VERDICTS), lines, numbers=len(VERDICTS))


def chapter(name: str, title: str, done: Reproduction) -> list[str]:
    """Lines about one paper: its tables and figures, row by row, then drawings and notes."""
    lines = [f"## {name}", "", f"{title}.", ""]
    if done.places:
        lines += [*_table(("in the paper", "shows", "here"), [_place(done, p) for p in done.places]), ""]
    lines += _rows(done.rows)
    for table in done.tables:
        lines += ["", f"### {table.title}", "", *_side_by_side(table)]
    if done.notes:
        lines += ["", "### Found on the way", "", *(f"- {note.rstrip('.')}." for note in done.notes)]
    for figure in done.figures:
        lines += ["", f"![{figure.title}](figures/{name}-{figure.name}.svg)", "", f"`{figure.name}`: {figure.title}."]
    return lines


def _place(done: Reproduction, place: Place) -> list[str]:
    rows, drawn = done.rows_of(place), [f"`{figure.name}`" for figure in done.figures_of(place)]
    parts = [f"{n} {verdict}" for verdict, n in tally(rows).items()] + drawn
    return [place.name, place.shows, "; ".join([*parts, *([place.not_computed] if place.not_computed else [])])]


def _rows(rows: Sequence[Row]) -> list[str]:
    reasons = [row.reason for row in rows]
    said = ["as above" if a and a == b else b for a, b in itertools.pairwise(["", *reasons])]
    cells = [
        [row.what, *map(number, (row.paper, row.ours, row.difference)), row.verdict, reason]
        for row, reason in zip(rows, said, strict=True)
    ]
    return _table(("", "paper", "ours", "difference", "verdict", "why"), cells, numbers=3)


def _side_by_side(table: Table) -> list[str]:
    cells = [[label, *map(number, values)] for label, values in table.lines]
    return [*_table(table.head, cells, numbers=len(table.head) - 1), *([] if not table.note else ["", table.note])]


def _table(head: Sequence[str], lines: Sequence[Sequence[str]], numbers: int = 0) -> list[str]:
    """Lines of a table; ``numbers`` columns after the first are aligned to the right."""
    rules = ["---:" if 1 <= i <= numbers else "---" for i in range(len(head))]
    return [_line(head), f"|{'|'.join(rules)}|", *(_line(line) for line in lines)]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def number(value: float) -> str:
    """Four digits, or a whole number; a dash where there is none."""
    whole = abs(value) < 1e7 and value == round(value) if math.isfinite(value) else False
    return "-" if math.isnan(value) else f"{value:.0f}" if whole else f"{value:.4g}"
