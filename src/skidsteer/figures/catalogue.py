"""Which figures there are, and what each of them needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from skidsteer.errors import named
from skidsteer.figures.errors import draw_coverage, draw_models, draw_residuals
from skidsteer.figures.material import Material
from skidsteer.figures.robot import draw_robot_icrs
from skidsteer.figures.sheet import save, style
from skidsteer.figures.slip import draw_chi_lambda, draw_icr_speed
from skidsteer.figures.trajectory import draw_before_after, draw_trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Sheet


@dataclass(frozen=True, slots=True)
class Entry:
    """A figure: what it shows, and how it is drawn."""

    text: str
    draw: Callable[[Material], Sheet]


FIGURES: dict[str, Entry] = {
    "robot-icrs": Entry("the robot from above, to scale, with its tread ICRs and their 95 % ellipses", draw_robot_icrs),
    "trajectory": Entry("a drive: reference, nominal and calibrated dead reckoning", draw_trajectory),
    "before-after": Entry("both of these side by side, at the width of a page", draw_before_after),
    "models": Entry("held-out errors of every model", draw_models),
    "residuals": Entry("errors over speed and yaw rate: where the model fails", draw_residuals),
    "chi-lambda": Entry("ICR coefficient over lambda, measured, by the model and by Wang 2015", draw_chi_lambda),
    "icr-speed": Entry("ICRs over the speed, measured and by the model", draw_icr_speed),
    "coverage": Entry("share of end poses inside the predicted regions against the share claimed", draw_coverage),
}


def entry(name: str) -> Entry:
    """The figure of that name.

    Raises:
        RequestError: no such figure; the message lists those there are.
    """
    return named(name, "figure", FIGURES)


def write_figure(name: str, material: Material, path: Path) -> None:
    """Draw a figure into a file; the suffix tells whether svg or png.

    Raises:
        RequestError: no such figure, neither svg nor png, no drive where one is needed, or matplotlib is not installed.
        DataError: the file cannot be written.
    """
    chosen = entry(name)
    with style():
        save(chosen.draw(material), path)
