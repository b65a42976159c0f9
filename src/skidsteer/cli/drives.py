"""Commands that make drives, or tell where one went."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skidsteer.cli.outputs import Force, spare_drive, spare_file, spare_in
from skidsteer.cli.words import DRIVE_HELP, FILTERS, GROUNDS, TERRAINS, Json, Profile, Seed, app, folder
from skidsteer.sources import VEHICLES, Source, on_drives


@app.command()
def design(
    area: Annotated[
        str, typer.Option(metavar="LxW", help="[m] along the first heading, and across; start in its middle")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="write commands.csv, path.csv and path.svg there")],
    vehicle: Annotated[
        str | None, typer.Option(metavar="NAME|FILE", help=f"{VEHICLES}, or YAML file; default: the calibration's")
    ] = None,
    minutes: Annotated[float, typer.Option(metavar="MIN", help="how long to drive [min]")] = 3.0,
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
    max_omega: Annotated[float, typer.Option(metavar="RAD/S", help="highest yaw rate that the controller takes")] = 1.5,
    max_acceleration: Annotated[
        float, typer.Option(metavar="M/S2", help="of the wheels, as the controller limits it: 1 on a stock Husky")
    ] = 1.5,
    max_lateral: Annotated[float, typer.Option(metavar="M/S2", help="speed times yaw rate")] = 0.5,
    margin: Annotated[float, typer.Option(metavar="M", help="to keep from the edge of the area")] = 0.25,
    seed: Annotated[int, Seed] = 0,
    force: Force = False,
    json: Json = False,
) -> None:
    """Choose the drive that tells most of a robot. A table of commands, and the sigmas that it will give."""
    from skidsteer import console, courses, documents
    from skidsteer.identify.design import design_drive, make_request
    from skidsteer.identify.excursion import footprint_radius
    from skidsteer.identify.manoeuvres import Limits
    from skidsteer.io.calibration_file import load_calibration
    from skidsteer.io.command_table import write_commands, write_path, write_picture
    from skidsteer.io.folder import vehicle as find_vehicle

    spare_in(out, ("commands.csv", "path.csv", "path.svg"), force)
    known = None if calibration is None else load_calibration(calibration)
    robot = None if vehicle is None else find_vehicle(vehicle)
    setup, request = make_request(
        area, minutes, robot, model, known, reference_rate, position_noise, yaw_noise, margin, seed
    )
    robot = setup.vehicle
    limits = Limits.of(robot, max_speed, max_omega, max_acceleration, max_lateral)
    with console.progress_bar() as report:
        made = design_drive(setup, limits, request, known, report)
    write_commands(folder(out) / "commands.csv", made.commands, made.rims.values)
    write_path(out / "path.csv", made.path)
    write_picture(out / "path.svg", made.strokes, request.area, footprint_radius(robot))
    if json:
        typer.echo(documents.to_json(documents.design_document(made)))
    else:
        courses.show_design(made)


@app.command()
@on_drives
def odometry(
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="calibration.yaml, or its folder")],
    drive: Annotated[list[str], typer.Argument(metavar="DRIVE", help=DRIVE_HELP)],
    source: Source,
    out: Annotated[Path, typer.Option(metavar="FILE", help="trajectory of base_link to write, TUM format")],
    filter: Annotated[
        str, typer.Option("--filter", metavar="NAME", help=f"how poses are estimated: {FILTERS}")
    ] = "icr",
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
    force: Force = False,
    json: Json = False,
) -> None:
    """Where a robot drove: a trajectory with covariance. From wheels, gyro and reference, as they are there."""
    from skidsteer import console, documents
    from skidsteer.errors import RequestError
    from skidsteer.evaluation import remarks
    from skidsteer.io.calibration_file import load_calibration
    from skidsteer.io.covariance_csv import write_covariances
    from skidsteer.io.tum import write_tum
    from skidsteer.odometry.phases import run_phases
    from skidsteer.odometry.run import OdometryOptions, run

    spare_file(out, force, "trajectory")
    if covariance is not None:
        if covariance.resolve() == out.resolve():
            raise RequestError(f"{out}: --out and --covariance must be two files")
        spare_file(covariance, force, "covariances")
    options = OdometryOptions(filter, not no_reference, not no_gyro, smooth, lose_after, fit_delay)
    known = load_calibration(calibration).profile(profile)
    with console.progress_bar() as report:
        loaded = source.load_one(drive, known)
        if phases is None:
            result = run(known, loaded, options, report)
        else:
            result = run_phases(known, loaded, phases, options, report)
    write_tum(out, result.trajectory.t, result.trajectory.poses)
    if covariance is not None:
        write_covariances(covariance, result.trajectory.t, result.trajectory.covariances)
    if json:
        typer.echo(documents.to_json(documents.odometry_document(result, remarks(known, [loaded]))))
    else:
        console.show_odometry(result)


@app.command()
def sample(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="which; none: list them")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="drive folder to write")] = None,
    force: Force = False,
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
    write_folder(drive, target, force)
    typer.echo(f"written: {target}")


@app.command()
def simulate(
    vehicle: Annotated[
        str, typer.Option(metavar="NAME|FILE", help=f"{VEHICLES}, or YAML file with the robot's measures")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="drive folder to write")],
    commands: Annotated[
        Path | None, typer.Option(metavar="FILE", help="CSV: t [s] with v, omega or v_left, v_right [m/s, rad/s]")
    ] = None,
    manoeuvre: Annotated[
        str | None,
        typer.Option(
            metavar="S,V,OMEGA:...", help="instead: one after the other [s, m/s, rad/s], such as 8,0.5,0:6,0,0.8"
        ),
    ] = None,
    plant: Annotated[str, typer.Option(metavar="NAME", help="kinematic, terramechanic or mujoco")] = "terramechanic",
    terrain: Annotated[
        str, typer.Option(metavar=GROUNDS, help=f"{TERRAINS}; and others from a time [s] on, or at a place [m]")
    ] = "lab",
    seed: Annotated[int, Seed] = 0,
    force: Force = False,
) -> None:
    """Drive a simulated robot and write what its sensors record. As a drive folder."""
    from skidsteer import plants
    from skidsteer.errors import RequestError
    from skidsteer.io.commands import parse_manoeuvres, read_commands
    from skidsteer.io.folder import vehicle as find_vehicle
    from skidsteer.io.folder import write_folder
    from skidsteer.terramechanics.terrain import parse_ground

    if (commands is None) == (manoeuvre is None):
        raise RequestError("give either --commands FILE or --manoeuvre S,V,OMEGA:...")
    spare_drive(out, force)
    robot = find_vehicle(vehicle)
    rims = parse_manoeuvres(manoeuvre or "", robot) if commands is None else read_commands(commands, robot)
    drive = plants.plant(plant)(out.name, robot, parse_ground(terrain), rims, plants.usual_sensors(robot), seed)
    folder(out.parent)
    write_folder(drive, out, force)
    typer.echo(f"written: {out}")
