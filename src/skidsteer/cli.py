"""The command line: parse, load, call, write. Heavy packages are imported by the command that needs them."""

from __future__ import annotations

import os
import sys
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

Drives = Annotated[list[str], typer.Argument(metavar="DRIVE...", help="drive folder, CSV files or sample:NAME")]
Json = Annotated[bool, typer.Option("--json", help="print one JSON document and nothing else")]
Window = Annotated[float, typer.Option("--window", metavar="S", help="length of the judging windows [s]")]
VehicleName = Annotated[str | None, typer.Option("--vehicle", metavar="NAME|FILE", help="preset or YAML file")]
Offset = Annotated[float | None, typer.Option(help="fix the time offset of the reference [s]")]
Lag = Annotated[float | None, typer.Option(help="fix the actuation lag [s]")]


@app.command()
def calibrate(
    drives: Drives,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="write calibration.yaml there")] = None,
    model: Annotated[str, typer.Option(metavar="NAME|auto", help="model, or auto: chosen by the drives")] = "auto",
    method: Annotated[str, typer.Option(help="least-squares or genetic (Mandow 2007)")] = "least-squares",
    vehicle: VehicleName = None,
    window: Window = 2.0,
    time_offset: Offset = None,
    lag: Lag = None,
    mount: Annotated[str | None, typer.Option(metavar="X,Y[,YAW]|free", help="of the reference [m, rad]")] = None,
    seed: Annotated[int, typer.Option(help="of the genetic search")] = 0,
    json: Json = False,
) -> None:
    """Calibrate a motion model from drives of one robot."""
    from skidsteer import console, documents
    from skidsteer.identify.calibrate import calibrate as calibrate_drives
    from skidsteer.identify.calibrate import make_options
    from skidsteer.io.calibration_file import save_calibration
    from skidsteer.io.drives import load_drives

    options = make_options(model, method, window, seed, time_offset, lag, mount)
    with console.progress_bar() as report:
        calibration = calibrate_drives(load_drives(drives, _vehicle(vehicle)), options=options, progress=report)
    if out is not None:
        save_calibration(calibration, _folder(out) / "calibration.yaml")
    if json:
        typer.echo(documents.to_json(documents.calibration_document(calibration)))
    else:
        console.show_calibration(calibration)


@app.command()
def evaluate(
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="calibration.yaml")],
    drives: Drives,
    window: Window = 2.0,
    fit_delay: Annotated[bool, typer.Option("--fit-delay", help="find the time offset of each drive first")] = False,
    vehicle: VehicleName = None,
    json: Json = False,
) -> None:
    """Errors of a calibration on drives; fits nothing, but the delay if asked."""
    from skidsteer import console, documents
    from skidsteer.evaluate import evaluate as evaluate_drives
    from skidsteer.io.calibration_file import load_calibration
    from skidsteer.io.drives import load_drives

    known = load_calibration(calibration)
    loaded = load_drives(drives, _vehicle(vehicle) or known.vehicle)
    result = evaluate_drives(known, loaded, _positive(window, "--window"), fit_delay)
    if json:
        typer.echo(documents.to_json(documents.evaluation_document(result, window)))
    else:
        console.show_evaluation(result)


@app.command()
def compare(drives: Drives, vehicle: VehicleName = None, window: Window = 2.0, json: Json = False) -> None:
    """Every model, held out, side by side."""
    from skidsteer import console, documents
    from skidsteer.identify.calibrate import compare_models
    from skidsteer.io.drives import load_drives

    with console.progress_bar() as report:
        loaded = load_drives(drives, _vehicle(vehicle))
        held_out, selection = compare_models(loaded, _positive(window, "--window"), report)
    if json:
        typer.echo(documents.to_json(documents.comparison_document(held_out, selection)))
    else:
        console.show_comparison(held_out, selection)


@app.command()
def sample(
    name: Annotated[str | None, typer.Argument(help="which; none: list them")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="drive folder to write")] = None,
) -> None:
    """List the embedded drives, or write one as a drive folder."""
    from skidsteer.io.folder import write_folder
    from skidsteer.samples import SAMPLES
    from skidsteer.samples import sample as make

    if name is None:
        for key, value in SAMPLES.items():
            typer.echo(f"sample:{key}  {value.text}")
        return
    drive = make(name.removeprefix("sample:"))
    target = out or Path(drive.name)
    write_folder(drive, target)
    typer.echo(f"written: {target}")


def _vehicle(name: str | None):  # type: ignore[no-untyped-def]  # Vehicle must not be imported for --help
    from skidsteer.io.folder import vehicle

    return None if name is None else vehicle(name)


def _positive(value: float, option: str) -> float:
    from skidsteer.errors import RequestError

    if not 0.0 < value < 1e6:
        raise RequestError(f"{option} must be a positive time in s, got {value}")
    return value


def _folder(path: Path) -> Path:
    from skidsteer.errors import DataError

    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{path}: cannot be made a folder: {error.strerror or error}") from error
    return path


def main() -> None:
    """Run the command line; what is the user's to mend ends as one line and exit code 1."""
    from skidsteer.errors import SkidSteerError

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
