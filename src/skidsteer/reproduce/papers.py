"""Which papers can be reproduced, and what that gives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from skidsteer.errors import RequestError
from skidsteer.io.atomic import write_text
from skidsteer.reproduce import giannoccaro2015, thalmann2016, wang_simulated
from skidsteer.reproduce import rows as lines
from skidsteer.reproduce.figure import draw, to_csv
from skidsteer.reproduce.rows import Reproduction

PAPERS: dict[str, Callable[[], Reproduction]] = {
    "giannoccaro2015": lambda: Reproduction(giannoccaro2015.rows()),
    "thalmann2016": thalmann2016.reproduction,
    "wang2015": wang_simulated.reproduction,
}


def reproduce(paper: str) -> Reproduction:
    """Calculate what a paper prints.

    Raises:
        RequestError: no such paper; the message lists those there are.
    """
    if paper not in PAPERS:
        raise RequestError(f"no paper '{paper}'; there are: {', '.join(PAPERS)}")
    return PAPERS[paper]()


def write(done: Reproduction, folder: Path) -> tuple[Path, ...]:
    """Write the table as table.csv, each figure as CSV and as a drawing (svg) into a folder; the files written.

    Raises:
        RequestError: there are figures, but matplotlib is not installed.
    """
    files = [folder / "table.csv"]
    write_text(files[0], lines.to_csv(done.rows))
    for figure in done.figures:
        files += [folder / f"{figure.name}.csv", folder / f"{figure.name}.svg"]
        write_text(files[-2], to_csv(figure))
        draw(figure, files[-1])
    return tuple(files)
