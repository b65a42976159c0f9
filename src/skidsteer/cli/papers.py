"""Commands on the papers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skidsteer.cli.words import Json, app, folder

if TYPE_CHECKING:
    pass


@app.command()
def reproduce(
    paper: Annotated[str, typer.Argument(metavar="PAPER", help="giannoccaro2015, thalmann2016 or wang2015")],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="write table and figures there")] = None,
    json: Json = False,
) -> None:
    """A paper's printed figures beside ours, with a verdict on each."""
    from skidsteer import console, documents
    from skidsteer.reproduce import papers

    done = papers.reproduce(paper)
    files = () if out is None else papers.write(done, folder(out))
    if json:
        typer.echo(documents.to_json(documents.reproduction_document(paper, done)))
    else:
        console.show_reproduction(done)
        for file in files:
            typer.echo(f"written: {file}")
