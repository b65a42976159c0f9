"""The command line: parse, load, call, write. Heavy packages are imported by the command that needs them."""

from __future__ import annotations

import sys

INTERRUPTED = 130  # exit code of a shell
TOLD = "skidsteer: interrupted\n"

try:
    import io
    import logging
    import os
    import signal
    from collections.abc import Iterator
    from contextlib import contextmanager
    from types import FrameType

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
except KeyboardInterrupt:  # Ctrl-C while all this is read
    sys.stderr.write(TOLD)
    sys.exit(INTERRUPTED)

ORDER = (  # as a user comes to need them
    *("calibrate", "check", "evaluate", "compare", "report", "export", "odometry", "terrains"),
    *("design", "simulate", "plan", "follow", "sample", "figure", "reproduce"),
)
app.registered_commands.sort(key=lambda command: ORDER.index(command.callback.__name__ if command.callback else ""))


class OneLine(logging.Formatter):
    """Messages alone, in which no name from a file is an order to the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """The message of a record."""
        from skidsteer.errors import printable

        return printable(record.getMessage())


@contextmanager
def _listening() -> Iterator[list[int]]:
    """A list that is empty until Ctrl-C, which compiled modules that are being imported make another error of."""
    struck: list[int] = []

    def strike(number: int, frame: FrameType | None) -> None:
        struck.append(number)
        signal.default_int_handler(number, frame)

    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if usual:
        signal.signal(signal.SIGINT, strike)
    try:
        yield struck
    finally:
        if usual:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def main() -> None:
    """Run the command line; what is the user's to mend ends as one line and exit code 1."""
    with _listening() as struck:
        try:
            _run()
        except BaseException as error:
            if not (struck or _interrupts(error)):
                raise
            sys.stderr.write(TOLD)
            sys.exit(INTERRUPTED)


def _run() -> None:
    from skidsteer.errors import SkidSteerError, printable

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # no name in a file is one that cannot be told
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(OneLine())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    try:
        app()
    except SkidSteerError as error:
        typer.echo(f"skidsteer: {printable(' '.join(str(error).split()))}", err=True)
        sys.exit(1)
    except OSError as error:
        if error.filename is not None:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left of the output goes nowhere
        if not isinstance(error, BrokenPipeError):
            typer.echo(f"skidsteer: cannot write to standard output: {error.strerror or error}", err=True)
        sys.exit(1)


def _interrupts(error: BaseException) -> bool:
    """Whether it is Ctrl-C, as Python, compiled loops and the parser of the command line pass it on."""
    if isinstance(error, SystemExit):
        return error.code == INTERRUPTED
    return isinstance(error, KeyboardInterrupt) or isinstance(error.__cause__, KeyboardInterrupt)
