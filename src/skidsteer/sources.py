"""Drives named on the command line, and the options that every command on drives has."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

if TYPE_CHECKING:
    from skidsteer.calibration import Calibration
    from skidsteer.drive import Drive
    from skidsteer.identify.circle_calibration import CircleCalibration
    from skidsteer.io.bag import BagContents
    from skidsteer.io.options import BagOptions
    from skidsteer.vehicle import Vehicle

log = logging.getLogger(__name__)

VEHICLES = "husky-a200, jackal, panther, pioneer-p3at, rover-4wd1, scout-2.0, summit-xl, warthog"

SOURCE_OPTIONS = {
    "vehicle": ("NAME|FILE", f"{VEHICLES}, or YAML file with the robot's measures; default: written beside the drive"),
    "wheels_topic": ("TOPIC", "of a bag: joint states, odometry or a twist of the wheels"),
    "reference_topic": ("TOPIC", "of a bag: reference pose, position or /tf"),
    "imu_topic": ("TOPIC", "of a bag: gyro"),
    "command_topic": ("TOPIC", "of a bag: commanded twist"),
    "left_joints": ("A,B", "of a bag: joints of the left wheels"),
    "right_joints": ("A,B", "of a bag: joints of the right wheels"),
    "wheel_signal": ("WORD", "of a bag: position or velocity of the joint states"),
    "wheels_unit": ("UNIT", "of a bag: of a pair of wheel topics: rad, rad/s, m/s or ticks"),
    "base_frame": ("FRAME", "of a bag: the robot's frame"),
    "map_frame": ("FRAME", "of a bag: the reference's frame"),
    "separation": ("M", "of a bag: wheel separation that the wheel odometry was made with [m]"),
    "separation_multiplier": ("X", "of a bag: its multiplier that the wheel odometry was made with"),
    "plate": ("WIDTH[,X,Y,YAW][,SIDE]", "on the robot, seen by a scanner that stands left|right|front|back of it"),
}


class Source:
    """How drives are to be read: the options that every command on drives has."""

    def __init__(self, words: dict[str, str | None]) -> None:
        self.words = words

    def vehicle(self) -> Vehicle | None:
        """The vehicle asked for; None: what is written beside the drive."""
        from skidsteer.io.folder import vehicle

        name = self.words["vehicle"]
        return None if name is None else vehicle(name)

    def load_one(self, paths: list[str], known: Calibration | None = None) -> Drive:
        """Read what must be one drive, see ``load``.

        Raises:
            RequestError: several drives were named.
        """
        from skidsteer.errors import RequestError

        drives = self.load(paths, known)
        if len(drives) > 1:
            raise RequestError(f"one drive at a time, got {len(drives)}")
        return drives[0]

    def topics(self, paths: list[str]) -> BagContents | None:
        """What a bag offers; None where the drive is none."""
        from skidsteer.io.drives import bag_contents

        return bag_contents(paths[0], self._options())

    def load(self, paths: list[str], known: Calibration | None = None) -> list[Drive]:
        """Read drives; beside a calibration the vehicle is its own where none is told, and another robot is logged."""
        from skidsteer.io.drives import load_drives

        if known is None:
            return load_drives(paths, self.vehicle(), self._options())
        from skidsteer.evaluation import remarks

        drives = load_drives(paths, self.vehicle(), self._options(), otherwise=known.vehicle)
        for sentence in remarks(known, drives):
            log.warning("Note: %s.", sentence)
        return drives

    def grounds(self, words: list[str]) -> dict[str, list[Drive]]:
        """Read drives by the ground they were driven on."""
        from skidsteer.io.drives import load_grounds

        return load_grounds(words, self.vehicle(), self._options())

    def circles(self, paths: list[str], model: str, method: str) -> CircleCalibration | None:
        """The calibration from a table of circle runs, or from the circles in drives if asked; None: from drives."""
        from skidsteer.identify.circle_calibration import METHOD, calibrate_circles, calibrate_circles_in, serves
        from skidsteer.io.circle_runs import circle_table

        table = circle_table(paths, self.vehicle())
        if table is not None and serves(model, method, table.is_drive):
            return calibrate_circles(table.runs, table.vehicle, (table.record,), model)
        return calibrate_circles_in(self.load(paths), model) if method == METHOD else None

    def _options(self) -> BagOptions:
        from skidsteer.io.options import parse_options

        return parse_options({name: word for name, word in self.words.items() if name != "vehicle"})


def on_drives(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command that takes a ``source`` the options of ``SOURCE_OPTIONS`` in its place."""
    hints = get_type_hints(command, include_extras=True)
    own = [p for p in inspect.signature(command).parameters.values() if p.name != "source"]
    kept = [p.replace(annotation=hints[p.name], kind=inspect.Parameter.KEYWORD_ONLY) for p in own]
    added = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[str | None, typer.Option(metavar=metavar, help=text)],
        )
        for name, (metavar, text) in SOURCE_OPTIONS.items()
    ]

    def run(**words: Any) -> None:
        command(source=Source({name: words.pop(name) for name in SOURCE_OPTIONS}), **words)

    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__signature__ = inspect.Signature([*kept, *added])  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in [*kept, *added]}
    return run
