"""Where the robot went by its reference, and where its wheels say it went: nominal and calibrated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skidsteer.figures.material import Material, held_out
from skidsteer.figures.robot import draw_robot
from skidsteer.figures.sheet import BLACK, BLUE, COLUMN, DASHES, PAGE, VERMILION, blank, to_scale
from skidsteer.models import Differential, Model
from skidsteer.report.reckoner import Reckoner
from skidsteer.se2 import FloatArray, chain, compose, invert
from skidsteer.windows import Windows, judging_pairs

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Sheet

ENDLESS = 1e9  # [s]
MOST = 24  # segments of a drive that are shown


@dataclass(frozen=True, slots=True, eq=False)
class Reckoned:
    """Dead reckoning over the stretches of a drive, each from where the reference has it at its beginning."""

    lines: tuple[FloatArray, ...]  # (n, 3) poses at the reference's stamps, of each stretch
    reference: tuple[FloatArray, ...]  # (n, 3)

    @property
    def off(self) -> float:
        """By how much the stretches end wrong [m], root mean square."""
        ends = np.array([line[-1] - seen[-1] for line, seen in zip(self.lines, self.reference, strict=True)])
        return float(np.sqrt(np.mean(ends[:, 0] ** 2 + ends[:, 1] ** 2)))


def reckoned(reckoner: Reckoner, restart: float, model: Model | None = None) -> Reckoned:
    """Dead reckoning of a drive with reference poses, begun anew every ``restart`` [s] (0: never).

    Args:
        reckoner: of the drive.
        restart: [s] between beginnings.
        model: in place of the calibrated one.
    """
    drive = reckoner.drive
    assert drive.pose is not None
    t, poses = drive.pose.t, drive.pose.values
    lines, reference = [], []
    for i, j in judging_pairs(drive, t, restart or ENDLESS):
        steps = Windows(t[i:j], t[i + 1 : j + 1], np.zeros((j - i, 3)), np.ones(j - i, bool))
        lines.append(chain(reckoner.motions(steps, model), poses[i]))
        reference.append(poses[i : j + 1])
    return Reckoned(tuple(lines), tuple(reference))


def draw_trajectory(material: Material) -> Sheet:
    """A sheet with the first drive."""
    sheet = blank(COLUMN, 78.0)
    draw_drive(sheet.add_subplot(), material, material.reckoners("trajectory")[0])
    return sheet


def draw_before_after(material: Material) -> Sheet:
    """A sheet of the width of a page: the first drive, and beside it the robot with its tread ICRs."""
    sheet = blank(PAGE, 76.0)
    left, right = sheet.subplots(1, 2, width_ratios=(1.25, 1.0))
    draw_drive(left, material, material.reckoners("before-after")[0])
    draw_robot(right, material.calibration)
    return sheet


def draw_drive(axes: Axes, material: Material, reckoner: Reckoner) -> None:
    """Reference, nominal and calibrated dead reckoning, turned so that the drive begins along x.

    Of a drive of separate segments ``MOST`` are shown, each from its own start.
    """
    drive = reckoner.drive
    assert drive.pose is not None
    nominal = reckoned(reckoner, material.restart, Differential.nominal(material.calibration.vehicle))
    after = reckoned(reckoner, material.restart)
    every = max(len(after.lines) // MOST, 1) if drive.segments is not None else 1
    home = invert(drive.pose.values[0])
    for n, line in enumerate(after.reference[::every]):
        axes.plot(*compose(home, line)[:, :2].T, color="#bbbbbb", linewidth=2.6, label=None if n else "reference")
    end = f"ends of {material.restart:g} s" if material.restart else "end" if drive.segments is None else "ends"
    shown = (
        (nominal, VERMILION, DASHES[1], f"wheels, nominal: {end} off by {nominal.off:.2f} m"),
        (after, BLUE, DASHES[0], f"wheels, calibrated{held_out([reckoner])}: {after.off:.2f} m"),
    )
    for found, colour, dash, label in shown:
        for n, line in enumerate(found.lines[::every]):
            x, y = compose(home, line)[:, :2].T
            axes.plot(x, y, color=colour, linestyle=dash, label=None if n else label)
            axes.plot(x[-1], y[-1], "o", color=colour, markersize=2.5)
    axes.plot(0.0, 0.0, "o", color=BLACK, markersize=4, zorder=5)
    axes.annotate("start", (0.0, 0.0), (4, 4), textcoords="offset points")
    axes.legend(loc="upper left", borderaxespad=0.2)
    _room_above(axes)
    to_scale(axes, "x [m]", "y [m]")


def _room_above(axes: Axes) -> None:
    """Leave room for the legend above what is drawn."""
    box = axes.dataLim
    axes.update_datalim([(box.x0, box.y1 + 0.3 * box.height)])
    axes.autoscale_view()
