"""Commands that drive a simulated robot in a closed loop."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from skidsteer.cli.outputs import Force, spare_drive, spare_in
from skidsteer.cli.words import GROUNDS, TERRAINS, Json, Profile, Seed, app, folder
from skidsteer.sources import VEHICLES


@app.command()
def follow(
    path: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="lemniscate, stadium, line, CSV of waypoints x, y [m], or bag")
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="write drive/, follow.json, follow.html, way.svg, errors.svg there")
    ],
    speed: Annotated[float, typer.Option(metavar="M/S", help="asked for [m/s]")] = 1.0,
    controller: Annotated[
        str, typer.Option(metavar="NAME", help="huskic, soetanto, pentzer, pure_pursuit or predictive")
    ] = "huskic",
    gains: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="of the controller; default: as it is launched, a wrong one lists them"),
    ] = None,
    plant: Annotated[str, typer.Option(metavar="NAME", help="kinematic, terramechanic or mujoco")] = "kinematic",
    terrain: Annotated[
        str, typer.Option(metavar=GROUNDS, help=f"{TERRAINS}; and others from a time [s] on, or at a place [m]")
    ] = "grass",
    vehicle: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help=f"{VEHICLES}, or YAML file; default: the calibration's, or summit-xl"),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="what the controller believes; none: as found on the plant at low speed"),
    ] = None,
    profile: Profile = None,
    size: Annotated[
        float | None, typer.Option(metavar="M", help="of a named path [m]: from end to end, or of its straights")
    ] = None,
    closed: Annotated[bool, typer.Option("--closed", help="waypoints go on from the last to the first")] = False,
    topic: Annotated[str | None, typer.Option(metavar="NAME", help="of the nav_msgs/Path in a bag")] = None,
    reverse: Annotated[bool, typer.Option("--reverse", help="drive with the rear ahead")] = False,
    start: Annotated[str | None, typer.Option(metavar="X,Y[,YAW]", help="[m, rad]; none: on the path")] = None,
    laps: Annotated[float, typer.Option(metavar="N", help="of a closed path")] = 1.0,
    rate: Annotated[float, typer.Option(metavar="HZ", help="of the controller")] = 50.0,
    lag: Annotated[float, typer.Option(metavar="S", help="of the wheels")] = 0.1,
    delay: Annotated[float, typer.Option(metavar="S", help="of the poses")] = 0.0,
    pose_rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="of the poses; default: one each time the controller is asked")
    ] = None,
    position_noise: Annotated[float, typer.Option(metavar="M", help="of the poses, each axis")] = 0.0,
    yaw_noise: Annotated[float, typer.Option(metavar="DEG", help="of the poses")] = 0.0,
    jump: Annotated[str, typer.Option(metavar="M@S,...", help="leaps of the localization, also M@PERCENT%")] = "",
    lost: Annotated[str, typer.Option(metavar="FROM-TO,...", help="[s] without poses")] = "",
    acceleration: Annotated[float, typer.Option(metavar="M/S2", help="limit of the rims [m/s^2]")] = math.inf,
    off: Annotated[float, typer.Option(metavar="M", help="from the path, where driving ends")] = 3.0,
    seed: Annotated[int, Seed] = 0,
    force: Force = False,
    json: Json = False,
) -> None:
    """Let a controller drive a simulated robot along a path. And show how well."""
    from skidsteer import console, documents
    from skidsteer.errors import RequestError
    from skidsteer.follow import words
    from skidsteer.follow.animation import page
    from skidsteer.follow.picture import against_time, way
    from skidsteer.follow.run import summarize
    from skidsteer.follow.sensing import Sensing
    from skidsteer.follow.task import Belief, Task, believed, recorded_drive, run_task
    from skidsteer.io.atomic import write_files
    from skidsteer.io.calibration_file import load_calibration
    from skidsteer.io.folder import write_folder
    from skidsteer.terramechanics.terrain import parse_ground

    spare_in(out, ("follow.json", "follow.html", "way.svg", "errors.svg"), force)
    spare_drive(out / "drive", force)
    if profile is not None and calibration is None:
        raise RequestError("--profile is of a calibration; give --calibration FILE, too")
    known = None if calibration is None else load_calibration(calibration).profile(profile)
    robot, ground = words.driven(vehicle, known), parse_ground(terrain)
    course = words.course(path, size, closed, topic)
    belief = believed(plant, robot, ground) if known is None else Belief(known.model, str(calibration))
    task = Task(
        course.in_reverse() if reverse else course,
        robot,
        ground,
        belief,
        speed,
        controller,
        gains,
        plant,
        lag,
        None if start is None else words.parse_start(start),
        Sensing(
            rate,
            delay,
            position_noise,
            math.radians(yaw_noise),
            jumps=words.parse_jumps(jump),
            lost=words.parse_spans(lost),
            pose_rate=pose_rate,
        ),
        laps,
        off,
        acceleration,
        seed,
    )
    with console.progress_bar() as report:
        run = run_task(task, report)
    told, document = words.sentences(task, run, summarize(run)), documents.to_json(documents.follow_document(task, run))
    files = {
        "follow.json": document + "\n",
        "follow.html": page(f"{task.vehicle.name} follows {path}", told, run, robot),
        "way.svg": way(run),
        "errors.svg": against_time(run, task.wheels.max_speed),
    }
    write_folder(recorded_drive(out.name, task, run), folder(out) / "drive", force)
    write_files(out, files)
    typer.echo(document if json else "\n".join([*told, f"written: {out}"]))
