"""The papers that can be reproduced, and the document of their reproductions."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from skidsteer.drive import Drive
from skidsteer.errors import RequestError, named
from skidsteer.figures.sheet import style
from skidsteer.io.atomic import make_folder, write_text
from skidsteer.io.drives import load_drive
from skidsteer.reproduce.figure import draw
from skidsteer.reproduce.markdown import document
from skidsteer.reproduce.rows import Reproduction

REAL = "warthog-asphalt"  # stands in for the drives of a paper that does not publish its own
DATA = "SKIDSTEER_DATA"  # environment variable with the folder of real drives


@dataclass(frozen=True, slots=True)
class Paper:
    """A paper, the module of its reproduction, and whether that takes a real drive."""

    title: str
    module: str  # of this package, with ``reproduction()``; imported when it is asked for
    on_drive: bool = False


PAPERS: dict[str, Paper] = {
    "mandow2007": Paper(
        "Mandow et al. 2007, Experimental kinematics for wheeled skid-steer mobile robots, IROS", "mandow2007", True
    ),
    "wang2015": Paper(
        "Wang et al. 2015, Analysis and Experimental Kinematics of a Skid-Steering Wheeled Robot Based on a Laser"
        " Scanner Sensor, Sensors 15",
        "wang_simulated",
    ),
    "giannoccaro2015": Paper(
        "Giannoccaro 2015, Kinematic Trajectories Reconstruction Based on Motors Encoders Feedback for a Rover"
        " Skid-Steering Robot, IJSSIS 8",
        "giannoccaro2015",
    ),
    "thalmann2016": Paper(
        "Thalmann and Neuner 2016, In-Field Calibrated Odometry for Skid-Steered Mobile Robots, MCG", "thalmann2016"
    ),
    "huskic2017": Paper(
        "Huskić, Buck, Zell 2017, Path following control of skid-steered wheeled mobile robots at higher speeds on"
        " different terrain types, ICRA",
        "huskic2017",
    ),
}


def asked(paper: str) -> tuple[str, ...]:
    """The papers meant by a name, or by ``all``.

    Raises:
        RequestError: no such paper; the message lists those there are.
    """
    if paper == "all":
        return tuple(PAPERS)
    named(paper, "paper", PAPERS, ", or all")
    return (paper,)


def reproduce(paper: str, drive: Drive | None = None) -> Reproduction:
    """Calculate what a paper prints.

    Args:
        paper: a key of ``PAPERS``.
        drive: a real one to stand in where the paper's own is not published.

    Raises:
        RequestError: no such paper; the message lists those there are.
    """
    (name,) = asked(paper)
    module = import_module(f"skidsteer.reproduce.{PAPERS[name].module}")
    done: Reproduction = module.reproduction(drive) if PAPERS[name].on_drive else module.reproduction()
    return done


def real_drive(papers: Sequence[str], path: str | None = None) -> Drive | None:
    """The real drive for papers that take one; None where none does, or there is none.

    Args:
        papers: keys of ``PAPERS``.
        path: of the drive; None: ``REAL`` in the folder that ``SKIDSTEER_DATA`` names (or ../shared/data).

    Raises:
        RequestError: a drive is given, but none of the papers takes one.
        DataError: it cannot be read.
    """
    takers = [name for name, paper in PAPERS.items() if paper.on_drive]
    if not set(takers) & set(papers):
        if path is not None:
            raise RequestError(f"--drive is of no use here: a drive is taken by {', '.join(takers)}")
        return None
    folder = Path(os.environ.get(DATA, Path("..", "shared", "data"))) / REAL
    if path is None and not folder.is_dir():
        return None
    return load_drive(path or folder)


def prepare(folder: Path) -> None:
    """Make the folder, before a long calculation.

    Raises:
        DataError: it cannot be made.
        RequestError: matplotlib is not installed.
    """
    make_folder(folder / "figures")
    with style():
        pass


def write(done: dict[str, Reproduction], folder: Path) -> tuple[Path, ...]:
    """Write reproduction.md, and each figure as figures/PAPER-NAME.svg, into a folder; the files written.

    Raises:
        DataError: a file cannot be written.
        RequestError: matplotlib is not installed.
    """
    titles = {name: PAPERS[name].title for name in done}
    figures = {f"{name}-{figure.name}.svg": figure for name, one in done.items() for figure in one.figures}
    prepare(folder)
    for name, figure in figures.items():
        draw(figure, folder / "figures" / name)
    write_text(folder / "reproduction.md", document(done, titles))
    return (folder / "reproduction.md", *(folder / "figures" / name for name in figures))
