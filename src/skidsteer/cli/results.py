"""Commands that show a calibration to people."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skidsteer.cli.outputs import Force, spare_file
from skidsteer.cli.words import DRIVE_HELP, Profile, Window, app, positive
from skidsteer.sources import Source, on_drives


@app.command()
@on_drives
def report(
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="calibration.yaml, or its folder")],
    source: Source,
    drives: Annotated[list[str] | None, typer.Argument(metavar="DRIVE", help=DRIVE_HELP)] = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="page to write")] = Path("report.html"),
    window: Window = 2.0,
    fit_delay: Annotated[
        bool, typer.Option("--fit-delay", help="find the time offset of foreign drives first")
    ] = False,
    profile: Profile = None,
    force: Force = False,
) -> None:
    """One page on a calibration, and how it does on drives. Its own, held out, or others."""
    from skidsteer import console
    from skidsteer.identify.circle_calibration import METHOD
    from skidsteer.io.calibration_file import load_calibration
    from skidsteer.report import gather, write_report

    spare_file(out, force, ".html")
    known = load_calibration(calibration).profile(profile)
    words, length = drives or [], positive(window, "--window")
    with console.progress_bar() as tell:
        circles = source.circles(words, known.model.NAME, METHOD) if words and known.method == METHOD else None
        if circles is not None:
            evidence = gather(known, (), circles.surfaces, length)
        else:
            loaded = source.load(words, known) if words else []
            evidence = gather(known, loaded, window=length, fit_delay=fit_delay, progress=tell)
    write_report(evidence, out)
    typer.echo(f"written: {out}")
