"""The application, the options that its commands share, and what each of them checks."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

MODELS = "differential, multiplier, icr_symmetric, curvature, icr, linear, scheduled_icr"
FILTERS = "icr, frozen, basic, arc, arc_odometry, alternative, slip_ratios, transfer_difference, extended"
TERRAINS = "lab, tiles, asphalt, concrete, grass, gravel, wet-sand, ice"
GROUNDS = "NAME[,NAME@S][,NAME@X0/Y0/X1/Y1]..."

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

DRIVE_HELP = "drive folder, CSV files, bag or sample:NAME"
Drives = Annotated[list[str], typer.Argument(metavar="DRIVE", help=DRIVE_HELP)]
Json = Annotated[bool, typer.Option("--json", help="print one JSON document and nothing else")]
Window = Annotated[float, typer.Option("--window", metavar="S", help="length of the judging windows [s]")]
Offset = Annotated[
    float | None, typer.Option(metavar="S", help="time offset of the reference [s]; default: it is estimated")
]
Lag = Annotated[float | None, typer.Option(metavar="S", help="actuation lag [s]; default: it is estimated")]
Seed = typer.Option(min=0, metavar="N", help="of all that is drawn at random; the same one, the same result")
Profile = Annotated[str | None, typer.Option(metavar="NAME", help="ground of the calibration; none: all together")]


def _tell_version(asked: bool) -> None:
    if asked:
        typer.echo(f"skidsteer {metadata.version('skidsteer')}")
        raise typer.Exit


@app.callback()
def begin(
    version: Annotated[
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="print the version, and exit")
    ] = False,
) -> None:
    """From a drive log of a skid-steer robot to a calibrated motion model with honest uncertainty."""


def positive(value: float, option: str) -> float:
    """The value of an option that must be above 0.

    Raises:
        RequestError: it is not.
    """
    from skidsteer.errors import RequestError

    if not 0.0 < value < 1e6:
        raise RequestError(f"{option} must be a positive time in s, got {value}")
    return value


def folder(path: Path) -> Path:
    """The folder, made where it is not there.

    Raises:
        DataError: it cannot be made, or not written to.
    """
    from skidsteer.io.atomic import make_folder

    make_folder(path)
    return path
