"""Commands on the papers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skidsteer.cli.words import DRIVE_HELP, Json, app, folder


@app.command()
def reproduce(
    paper: Annotated[str, typer.Argument(metavar="PAPER|all", help="giannoccaro2015, thalmann2016, wang2015 ...")],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="write reproduction.md and figures/*.svg")] = None,
    drive: Annotated[
        str | None,
        typer.Option(
            metavar="DRIVE", help=f"a real one to stand in for Mandow's: {DRIVE_HELP}; default: $SKIDSTEER_DATA"
        ),
    ] = None,
    json: Json = False,
) -> None:
    """A paper's printed figures beside ours, with a verdict on each."""
    from skidsteer import console, documents
    from skidsteer.io.drives import load_drive
    from skidsteer.reproduce import papers

    names = papers.asked(paper)
    with console.progress_bar() as report:
        real = papers.real_drive() if drive is None else load_drive(drive)
        done = {}
        for i, name in enumerate(names):
            report(name, i, len(names))
            done[name] = papers.reproduce(name, real)
    files = () if out is None else papers.write(done, folder(out))
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
