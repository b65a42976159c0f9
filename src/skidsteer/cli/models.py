"""Commands from drives to a model: calibrate, and what tells how good it is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skidsteer.cli.outputs import Force, spare_drive, spare_in
from skidsteer.cli.words import (
    DRIVE_HELP,
    MODELS,
    Drives,
    Json,
    Lag,
    Offset,
    Profile,
    Seed,
    Window,
    app,
    folder,
    positive,
)
from skidsteer.sources import Source, on_drives

if TYPE_CHECKING:
    from collections.abc import Sequence

    from skidsteer.calibration import Calibration
    from skidsteer.drive import Drive
    from skidsteer.identify.circle_test import SurfaceResult
    from skidsteer.identify.holdout import Folds


@app.command()
@on_drives
def calibrate(
    source: Source,
    drives: Annotated[list[str] | None, typer.Argument(metavar="DRIVE", help=DRIVE_HELP)] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="write calibration.yaml, report and exports there")
    ] = None,
    model: Annotated[str, typer.Option(metavar="NAME|auto", help=f"{MODELS}, or auto: chosen by the drives")] = "auto",
    method: Annotated[
        str, typer.Option(metavar="NAME", help="least-squares, genetic (Mandow 2007) or circle-test")
    ] = "least-squares",
    window: Window = 2.0,
    time_offset: Offset = None,
    lag: Lag = None,
    mount: Annotated[
        str | None,
        typer.Option(metavar="X,Y[,YAW]|free", help="of the reference on the robot [m, rad]; default: at its origin"),
    ] = None,
    seed: Annotated[int, Seed] = 0,
    fix: Annotated[bool, typer.Option("--fix", help="apply the doctor's safe cures first")] = False,
    profile: Annotated[
        list[str] | None, typer.Option(metavar="GROUND=DRIVE", help="a profile for each ground, in place of DRIVE...")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Calibrate a motion model from drives of one robot."""
    from skidsteer import console, documents
    from skidsteer.export import FORMATS
    from skidsteer.identify.calibrate import calibrate_with_folds, make_options
    from skidsteer.identify.terrain import calibrate_profiles

    if out is not None:
        spare_in(out, ("calibration.yaml", "report.html", *(file for file, _ in FORMATS.values())), force)
    if bool(drives) == bool(profile):
        raise typer.BadParameter("give drives, or --profile GROUND=DRIVE for each of them")
    if drives and (circles := source.circles(drives, model, method)) is not None:
        _write(circles.calibration, out, surfaces=circles.surfaces)
        if json:
            typer.echo(documents.to_json(documents.circles_document(circles)))
        else:
            console.show_circles(circles)
        return
    options = make_options(model, method, window, seed, time_offset, lag, mount, fix)
    with console.progress_bar() as report:
        if profile:
            grounds = source.grounds(profile)
            loaded = [drive for group in grounds.values() for drive in group]
            calibration, folds = calibrate_profiles(grounds, options, report), None
        else:
            loaded = source.load(drives or [])
            calibration, folds = calibrate_with_folds(loaded, options, report)
        if out is not None:
            report("writing the report", 0, 1)
            _write(calibration, out, loaded, folds=folds)
    if json:
        typer.echo(documents.to_json(documents.calibration_document(calibration)))
    else:
        console.show_calibration(calibration)


@app.command()
@on_drives
def evaluate(
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="calibration.yaml, or its folder")],
    drives: Drives,
    source: Source,
    window: Window = 2.0,
    fit_delay: Annotated[bool, typer.Option("--fit-delay", help="find the time offset of each drive first")] = False,
    profile: Profile = None,
    json: Json = False,
) -> None:
    """Errors of a calibration on drives. Fits nothing, but the delay if asked."""
    from skidsteer import console, documents
    from skidsteer.evaluation import evaluate as evaluate_drives
    from skidsteer.io.calibration_file import load_calibration

    positive(window, "--window")
    known = load_calibration(calibration).profile(profile)
    loaded = source.load(drives, known)
    result = evaluate_drives(known, loaded, window, fit_delay)
    if json:
        typer.echo(documents.to_json(documents.evaluation_document(result, window)))
    else:
        console.show_evaluation(result)


@app.command()
@on_drives
def terrains(
    drives: Annotated[list[str], typer.Argument(metavar="GROUND=DRIVE", help="drives and the ground of each")],
    source: Source,
    model: Annotated[str, typer.Option(metavar="NAME", help=f"whose parameters are compared: {MODELS}")] = "icr",
    window: Window = 2.0,
    json: Json = False,
) -> None:
    """Whether grounds differ so much that each needs its own model."""
    from skidsteer import console, documents
    from skidsteer.identify.calibrate import make_options
    from skidsteer.identify.terrain import compare_terrains

    with console.progress_bar() as report:
        found = compare_terrains(source.grounds(drives), model, make_options(model, window=window), report)
    if json:
        typer.echo(documents.to_json(documents.terrains_document(found)))
    else:
        console.show_terrains(found)


@app.command()
@on_drives
def compare(drives: Drives, source: Source, window: Window = 2.0, json: Json = False) -> None:
    """Every model, held out, side by side."""
    from skidsteer import console, documents
    from skidsteer.identify.calibrate import compare_models

    with console.progress_bar() as report:
        held_out, selection = compare_models(source.load(drives), positive(window, "--window"), report)
    if json:
        typer.echo(documents.to_json(documents.comparison_document(held_out, selection)))
    else:
        console.show_comparison(held_out, selection)


@app.command()
@on_drives
def check(
    drive: Annotated[list[str], typer.Argument(metavar="DRIVE", help=DRIVE_HELP)],
    source: Source,
    fix: Annotated[bool, typer.Option("--fix", help="apply the safe cures, and write the drive to --out")] = False,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="drive folder to write the cured drive to")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """What is wrong with a log, where, and the cure. And what it can tell of the robot."""
    from skidsteer import console, documents
    from skidsteer.doctor import examine
    from skidsteer.doctor import fix as cure
    from skidsteer.errors import RequestError
    from skidsteer.identify.calibrate import judge_drive
    from skidsteer.io.folder import write_folder

    if fix != (out is not None):
        raise RequestError("--fix and --out DIR belong together")
    if out is not None and any(out.resolve() == Path(word).resolve() for word in drive):
        raise RequestError(f"{out}: --out must be another folder than the drive, which stays as it was recorded")
    if out is not None:
        spare_drive(out, force)
    topics = source.topics(drive)
    loaded = source.load_one(drive)
    findings = examine(loaded)
    verdict = judge_drive(loaded, findings)
    cures: tuple[str, ...] = ()
    if out is not None:
        cured, cures = cure(loaded, findings)
        write_folder(cured, out, force)
    if json:
        typer.echo(documents.to_json(documents.check_document(loaded, findings, topics, cures, verdict)))
    else:
        console.show_check(loaded, findings, topics, cures, verdict)


def _write(
    calibration: Calibration,
    out: Path | None,
    drives: Sequence[Drive] = (),
    surfaces: Sequence[SurfaceResult] = (),
    folds: Folds | None = None,
) -> None:
    from skidsteer.export import texts
    from skidsteer.io.atomic import write_files
    from skidsteer.io.calibration_file import FILE, calibration_text
    from skidsteer.report import gather, page

    if out is not None:
        shown = page(gather(calibration, drives, surfaces, folds=folds))
        files = {FILE: calibration_text(calibration), "report.html": shown, **texts(calibration)}
        write_files(folder(out), files)
