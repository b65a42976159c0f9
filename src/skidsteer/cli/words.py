"""The application, the options that its commands share, and what each of them checks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="From a drive log of a skid-steer robot to a calibrated motion model with honest uncertainty.",
)

DRIVE_HELP = "drive folder, CSV files, bag or sample:NAME"
Drives = Annotated[list[str], typer.Argument(metavar="DRIVE...", help=DRIVE_HELP)]
Json = Annotated[bool, typer.Option("--json", help="print one JSON document and nothing else")]
Window = Annotated[float, typer.Option("--window", metavar="S", help="length of the judging windows [s]")]
Offset = Annotated[float | None, typer.Option(help="fix the time offset of the reference [s]")]
Lag = Annotated[float | None, typer.Option(help="fix the actuation lag [s]")]
Profile = Annotated[str | None, typer.Option(metavar="NAME", help="ground of the calibration; none: all together")]


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
