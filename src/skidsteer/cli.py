"""The command line: parse, load, call, write. Heavy packages are imported by the command that needs them."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skidsteer.sources import Source, on_drives

if TYPE_CHECKING:
    from skidsteer.calibration import Calibration

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


@app.command()
@on_drives
def calibrate(
    source: Source,
    drives: Annotated[list[str] | None, typer.Argument(metavar="DRIVE...", help=DRIVE_HELP)] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="write calibration.yaml there")] = None,
    model: Annotated[str, typer.Option(metavar="NAME|auto", help="model, or auto: chosen by the drives")] = "auto",
    method: Annotated[str, typer.Option(help="least-squares, genetic (Mandow 2007) or circle-test")] = "least-squares",
    window: Window = 2.0,
    time_offset: Offset = None,
    lag: Lag = None,
    mount: Annotated[str | None, typer.Option(metavar="X,Y[,YAW]|free", help="of the reference [m, rad]")] = None,
    seed: Annotated[int, typer.Option(help="of the genetic search")] = 0,
    fix: Annotated[bool, typer.Option("--fix", help="apply the doctor's safe cures first")] = False,
    profile: Annotated[
        list[str] | None, typer.Option(metavar="GROUND=DRIVE", help="a profile for each ground, in place of DRIVE...")
    ] = None,
    json: Json = False,
) -> None:
    """Calibrate a motion model from drives of one robot."""
    from skidsteer import console, documents
    from skidsteer.identify.calibrate import calibrate as calibrate_drives
    from skidsteer.identify.calibrate import make_options
    from skidsteer.identify.terrain import calibrate_profiles

    if bool(drives) == bool(profile):
        raise typer.BadParameter("give drives, or --profile GROUND=DRIVE for each of them")
    if drives and (circles := source.circles(drives, model, method)) is not None:
        _write(circles.calibration, out)
        if json:
            typer.echo(documents.to_json(documents.circles_document(circles)))
        else:
            console.show_circles(circles)
        return
    options = make_options(model, method, window, seed, time_offset, lag, mount, fix)
    with console.progress_bar() as report:
        if profile:
            calibration = calibrate_profiles(source.grounds(profile), options, report)
        else:
            calibration = calibrate_drives(source.load(drives or []), options=options, progress=report)
    _write(calibration, out)
    if json:
        typer.echo(documents.to_json(documents.calibration_document(calibration)))
    else:
        console.show_calibration(calibration)


@app.command()
@on_drives
def evaluate(
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="calibration.yaml")],
    drives: Drives,
    source: Source,
    window: Window = 2.0,
    fit_delay: Annotated[bool, typer.Option("--fit-delay", help="find the time offset of each drive first")] = False,
    profile: Profile = None,
    json: Json = False,
) -> None:
    """Errors of a calibration on drives; fits nothing, but the delay if asked."""
    from skidsteer import console, documents
    from skidsteer.evaluation import evaluate as evaluate_drives
    from skidsteer.io.calibration_file import load_calibration

    known = load_calibration(calibration).profile(profile)
    loaded = source.load(drives, otherwise=known.vehicle)
    result = evaluate_drives(known, loaded, _positive(window, "--window"), fit_delay)
    if json:
        typer.echo(documents.to_json(documents.evaluation_document(result, window)))
    else:
        console.show_evaluation(result)


@app.command()
@on_drives
def terrains(
    drives: Annotated[list[str], typer.Argument(metavar="GROUND=DRIVE...", help="drives and the ground of each")],
    source: Source,
    model: Annotated[str, typer.Option(metavar="NAME", help="model whose parameters are compared")] = "icr",
    window: Window = 2.0,
    json: Json = False,
) -> None:
    """Whether the model of one ground differs from that of another, and whether it matters."""
    from skidsteer import console, documents
    from skidsteer.identify.calibrate import make_options
    from skidsteer.identify.terrain import compare_terrains

    found = compare_terrains(source.grounds(drives), model, make_options(model, window=window))
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
        held_out, selection = compare_models(source.load(drives), _positive(window, "--window"), report)
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
    json: Json = False,
) -> None:
    """What is wrong with a log, where, how sure that is, what it does, and the cure."""
    from skidsteer import console, documents
    from skidsteer.doctor import examine
    from skidsteer.doctor import fix as cure
    from skidsteer.errors import RequestError
    from skidsteer.identify.calibrate import judge_drive
    from skidsteer.io.folder import write_folder

    if fix != (out is not None):
        raise RequestError("--fix and --out DIR belong together")
    topics = source.topics(drive)
    loaded = source.load_one(drive)
    findings = examine(loaded)
    verdict = judge_drive(loaded, findings)
    cures: tuple[str, ...] = ()
    if out is not None:
        cured, cures = cure(loaded, findings)
        write_folder(cured, out)
    if json:
        typer.echo(documents.to_json(documents.check_document(loaded, findings, topics, cures, verdict)))
    else:
        console.show_check(loaded, findings, topics, cures, verdict)


@app.command()
def design(
    area: Annotated[
        str, typer.Option(metavar="LxW", help="[m] along the first heading, and across; start in its middle")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="write commands.csv, path.csv and path.svg there")],
    vehicle: Annotated[
        str | None, typer.Option(metavar="NAME|FILE", help="preset or YAML file; default: the calibration's")
    ] = None,
    minutes: Annotated[float, typer.Option(help="how long to drive")] = 3.0,
    model: Annotated[
        str | None, typer.Option(metavar="NAME", help="to determine; default: the calibration's, or scheduled_icr")
    ] = None,
    calibration: Annotated[Path | None, typer.Option(metavar="FILE", help="what is known of the robot")] = None,
    reference_rate: Annotated[float, typer.Option(metavar="HZ", help="of the reference")] = 10.0,
    position_noise: Annotated[float | None, typer.Option(metavar="M", help="of the reference, each axis")] = None,
    yaw_noise: Annotated[float | None, typer.Option(metavar="DEG", help="of the reference")] = None,
    max_speed: Annotated[
        float | None, typer.Option(metavar="M/S", help="default: walking pace, or the wheels'")
    ] = None,
    max_omega: Annotated[float, typer.Option(metavar="RAD/S", help="highest yaw rate")] = 1.5,
    max_acceleration: Annotated[float, typer.Option(metavar="M/S2", help="of the wheels")] = 1.5,
    max_lateral: Annotated[float, typer.Option(metavar="M/S2", help="speed times yaw rate")] = 0.5,
    margin: Annotated[float, typer.Option(metavar="M", help="to keep from the edge of the area")] = 0.25,
    seed: Annotated[int, typer.Option(help="of the robots and drivers imagined")] = 0,
    json: Json = False,
) -> None:
    """The drive that determines a model best, as a table of commands, and the sigmas that it will give."""
    from skidsteer import console, documents
    from skidsteer.identify.design import design_drive, make_request
    from skidsteer.identify.excursion import footprint_radius
    from skidsteer.identify.manoeuvres import Limits
    from skidsteer.io.calibration_file import load_calibration
    from skidsteer.io.command_table import write_commands, write_path, write_picture
    from skidsteer.io.folder import vehicle as find_vehicle

    known = None if calibration is None else load_calibration(calibration)
    robot = None if vehicle is None else find_vehicle(vehicle)
    setup, request = make_request(
        area, minutes, robot, model, known, reference_rate, position_noise, yaw_noise, margin, seed
    )
    robot = setup.vehicle
    limits = Limits.of(robot, max_speed, max_omega, max_acceleration, max_lateral)
    with console.progress_bar() as report:
        made = design_drive(setup, limits, request, known, report)
    write_commands(_folder(out) / "commands.csv", made.commands, made.rims.values)
    write_path(out / "path.csv", made.path)
    write_picture(out / "path.svg", made.strokes, request.area, footprint_radius(robot))
    if json:
        typer.echo(documents.to_json(documents.design_document(made)))
    else:
        console.show_design(made)


@app.command()
@on_drives
def odometry(
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="calibration.yaml")],
    drive: Annotated[list[str], typer.Argument(metavar="DRIVE", help=DRIVE_HELP)],
    source: Source,
    out: Annotated[Path, typer.Option(metavar="FILE", help="trajectory of base_link to write, TUM format")],
    filter: Annotated[str, typer.Option("--filter", metavar="NAME", help="how poses are estimated")] = "icr",
    covariance: Annotated[Path | None, typer.Option(metavar="FILE", help="CSV to write covariances to")] = None,
    smooth: Annotated[bool, typer.Option("--smooth", help="each pose given the whole drive")] = False,
    no_reference: Annotated[bool, typer.Option("--no-reference", help="take it to judge by only")] = False,
    no_gyro: Annotated[bool, typer.Option("--no-gyro", help="leave the gyro out")] = False,
    lose_after: Annotated[float | None, typer.Option(metavar="S", help="lose the reference after S seconds")] = None,
    fit_delay: Annotated[bool, typer.Option("--fit-delay", help="find the reference's time offset first")] = False,
    phases: Annotated[
        float | None, typer.Option(metavar="S", help="learn slips from positions for S seconds, then lose them")
    ] = None,
    profile: Profile = None,
    json: Json = False,
) -> None:
    """Where the robot drove: a trajectory with covariance, from wheels, and gyro and reference where they are there."""
    from skidsteer import console, documents
    from skidsteer.io.calibration_file import load_calibration
    from skidsteer.io.covariance_csv import write_covariances
    from skidsteer.io.tum import write_tum
    from skidsteer.odometry.phases import run_phases
    from skidsteer.odometry.run import OdometryOptions, run

    options = OdometryOptions(filter, not no_reference, not no_gyro, smooth, lose_after, fit_delay)
    known = load_calibration(calibration).profile(profile)
    loaded = source.load_one(drive, otherwise=known.vehicle)
    result = run(known, loaded, options) if phases is None else run_phases(known, loaded, phases, options)
    write_tum(out, result.track.t, result.track.poses)
    if covariance is not None:
        write_covariances(covariance, result.track.t, result.track.covariances)
    if json:
        typer.echo(documents.to_json(documents.odometry_document(result)))
    else:
        console.show_odometry(result)


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
    files = () if out is None else papers.write(done, _folder(out))
    if json:
        typer.echo(documents.to_json(documents.reproduction_document(paper, done)))
    else:
        console.show_reproduction(done)
        for file in files:
            typer.echo(f"written: {file}")


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


@app.command()
def simulate(
    vehicle: Annotated[str, typer.Option(metavar="NAME|FILE", help="preset or YAML file with the robot's measures")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="drive folder to write")],
    commands: Annotated[
        Path | None, typer.Option(metavar="FILE", help="CSV: t with v, omega or v_left, v_right")
    ] = None,
    manoeuvre: Annotated[str | None, typer.Option(metavar="S,V,OMEGA:...", help="instead: one after the other")] = None,
    plant: Annotated[str, typer.Option(metavar="NAME", help="kinematic, terramechanic or mujoco")] = "terramechanic",
    terrain: Annotated[str, typer.Option(metavar="NAME[,NAME@S...]", help="ground, and others from a time on")] = "lab",
    seed: Annotated[int, typer.Option(help="of the sensors' noise")] = 0,
) -> None:
    """Drive a simulated robot over a ground and write what its sensors record as a drive folder."""
    from skidsteer import plants
    from skidsteer.errors import RequestError
    from skidsteer.io.commands import parse_manoeuvres, read_commands
    from skidsteer.io.folder import vehicle as find_vehicle
    from skidsteer.io.folder import write_folder
    from skidsteer.terramechanics.terrain import parse_ground

    if (commands is None) == (manoeuvre is None):
        raise RequestError("give either --commands FILE or --manoeuvre S,V,OMEGA:...")
    robot = find_vehicle(vehicle)
    rims = parse_manoeuvres(manoeuvre or "", robot) if commands is None else read_commands(commands, robot)
    drive = plants.plant(plant)(out.name, robot, parse_ground(terrain), rims, plants.usual_sensors(robot), seed)
    _folder(out.parent)
    write_folder(drive, out)
    typer.echo(f"written: {out}")


def _positive(value: float, option: str) -> float:
    from skidsteer.errors import RequestError

    if not 0.0 < value < 1e6:
        raise RequestError(f"{option} must be a positive time in s, got {value}")
    return value


def _write(calibration: Calibration, out: Path | None) -> None:
    from skidsteer.io.calibration_file import save_calibration

    if out is not None:
        save_calibration(calibration, _folder(out) / "calibration.yaml")


def _folder(path: Path) -> Path:
    from skidsteer.errors import DataError

    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{path}: cannot be made a folder: {error.strerror or error}") from error
    return path


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
