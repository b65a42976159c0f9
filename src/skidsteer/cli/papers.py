"""Commands for papers: calculate what others print, draw what one prints oneself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skidsteer.cli.outputs import Force, spare_file, spare_in
from skidsteer.cli.words import DRIVE_HELP, Json, Profile, Window, app, positive
from skidsteer.sources import Source, on_drives

if TYPE_CHECKING:
    from skidsteer.figures.material import Material


@app.command()
def reproduce(
    paper: Annotated[
        str,
        typer.Argument(
            metavar="PAPER|all", help="mandow2007, wang2015, giannoccaro2015, thalmann2016, huskic2017 or all"
        ),
    ],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="write reproduction.md and figures/*.svg")] = None,
    drive: Annotated[
        str | None,
        typer.Option(
            metavar="DRIVE",
            help=f"a real one beside Mandow's: {DRIVE_HELP}; default: that in $SKIDSTEER_DATA",
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """A paper's printed figures beside ours, with a verdict on each."""
    from skidsteer import console, documents
    from skidsteer.reproduce import papers

    names = papers.asked(paper)
    if out is not None:
        spare_in(out, ("reproduction.md",), force)
        papers.prepare(out)
    with console.progress_bar() as report:
        real = papers.real_drive(names, drive)
        done = {}
        for i, name in enumerate(names):
            report(name, i, len(names))
            done[name] = papers.reproduce(name, real)
    files = () if out is None else papers.write(done, out)
    if json:
        one = paper in done
        document = (
            documents.reproduction_document(paper, done[paper]) if one else documents.reproductions_document(done)
        )
        typer.echo(documents.to_json(document))
    else:
        for name, reproduction in done.items():
            console.show_reproduction(name, reproduction)
        for file in files:
            typer.echo(f"written: {file}")


@app.command()
@on_drives
def figure(
    source: Source,
    name: Annotated[str, typer.Argument(metavar="NAME|list", help="which; list: what there is")],
    calibration: Annotated[Path | None, typer.Option(metavar="FILE", help="default: calibrate on the drives")] = None,
    drive: Annotated[
        list[str] | None, typer.Option(metavar="DRIVE", help=f"to show; again for more: {DRIVE_HELP}")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help=".svg or .png; default: NAME.svg")] = None,
    model: Annotated[
        str, typer.Option(metavar="NAME|auto", help="to calibrate where there is no --calibration")
    ] = "auto",
    show: Annotated[
        str | None, typer.Option(metavar="A,B", help="only this part of the drives [s]; the rest calibrates")
    ] = None,
    restart: Annotated[float, typer.Option(metavar="S", help="begin dead reckoning anew this often; 0: never")] = 0.0,
    window: Window = 2.0,
    profile: Profile = None,
    force: Force = False,
) -> None:
    """Draw a figure for a paper. Vector, to a column's width, the same file every time."""
    from skidsteer.figures.catalogue import FIGURES, entry, write_figure
    from skidsteer.figures.sheet import checked_suffix

    if name == "list":
        for key, value in FIGURES.items():
            typer.echo(f"{key}: {value.text}")
        return
    entry(name)
    path = out or Path(f"{name}.svg")
    spare_file(path, force, checked_suffix(path))
    write_figure(name, _material(source, calibration, drive or [], model, show, restart, window, profile), path)
    typer.echo(f"written: {path}")


def _material(
    source: Source,
    calibration: Path | None,
    names: list[str],
    model: str,
    show: str | None,
    restart: float,
    window: float,
    profile: str | None,
) -> Material:
    from skidsteer import console
    from skidsteer.errors import RequestError
    from skidsteer.figures.material import Material, parse_part, parted
    from skidsteer.identify.calibrate import CalibrateOptions
    from skidsteer.identify.calibrate import calibrate as fit
    from skidsteer.io.calibration_file import load_calibration

    if calibration is None and not names:
        raise RequestError("give --calibration FILE, --drive DRIVE or both")
    known = None if calibration is None else load_calibration(calibration).profile(profile)
    drives = tuple(source.load(names, known)) if names else ()
    shown, rest = (drives, drives) if show is None else parted(drives, *parse_part(show))
    if known is None:
        with console.progress_bar() as report:
            known = fit(list(rest), options=CalibrateOptions(model=model), progress=report)
    return Material(known, shown, positive(restart, "--restart") if restart else 0.0, positive(window, "--window"))
