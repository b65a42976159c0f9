"""The command line: parse, load, call, write. Heavy packages are imported by the command that needs them."""

from __future__ import annotations

import os
import sys

import typer

from skidsteer.cli import (  # noqa: F401  (each adds its commands)
    drives,
    driving,
    exporting,
    models,
    papers,
    planning,
    results,
)
from skidsteer.cli.words import app


def main() -> None:
    """Run the command line; what is the user's to mend ends as one line and exit code 1."""
    import logging

    from skidsteer.errors import SkidSteerError

    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(message)s")
    try:
        app()
    except SkidSteerError as error:
        typer.echo(f"skidsteer: {' '.join(str(error).split())}", err=True)
        sys.exit(1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except KeyboardInterrupt:
        typer.echo("skidsteer: interrupted", err=True)
        sys.exit(130)
