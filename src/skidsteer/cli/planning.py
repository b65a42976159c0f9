"""Commands that plan what a calibrated robot is to do."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skidsteer.cli.outputs import Force, spare_in
from skidsteer.cli.words import Json, Profile, app, folder


@app.command()
def plan(
    obstacle: Annotated[str, typer.Option(metavar="LxW", help="[m] to drive round, such as 0.70x1.25")],
    clearance: Annotated[float, typer.Option(metavar="M", help="that the robot's outline keeps off it")],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="write commands.csv, plan.json, path.csv and plan.svg there")
    ],
    calibration: Annotated[Path | None, typer.Option(metavar="FILE", help="calibration.yaml of the robot")] = None,
    circles: Annotated[
        str | None, typer.Option(metavar="TABLE", help="instead: slip ratios of circle runs, CSV or sample:rover-4wd1")
    ] = None,
    vehicle: Annotated[str | None, typer.Option(metavar="NAME|FILE", help="of the circle runs")] = None,
    profile: Profile = None,
    speed: Annotated[float, typer.Option(metavar="M/S", help="on the straights")] = 0.3,
    curve_speed: Annotated[float | None, typer.Option(metavar="M/S", help="on the arcs; default: the same")] = None,
    radius: Annotated[
        float | None, typer.Option(metavar="M", help="of the arcs; default: the least that keeps the clearance")
    ] = None,
    footprint: Annotated[
        str | None, typer.Option(metavar="LxW", help="[m] outline of the robot; default: outer edges of its wheels")
    ] = None,
    direction: Annotated[
        str, typer.Option(metavar="left|right", help="the robot turns to, round the obstacle")
    ] = "left",
    laps: Annotated[int, typer.Option(metavar="N", help="how often round")] = 1,
    force: Force = False,
    json: Json = False,
) -> None:
    """Wheel commands that drive a robot round an obstacle. And where it will end."""
    from skidsteer import courses, documents
    from skidsteer.io.atomic import write_text
    from skidsteer.io.command_table import write_commands, write_path
    from skidsteer.plan.circumnavigation import Request, circumnavigate
    from skidsteer.plan.picture import draw
    from skidsteer.plan.words import driver_of, rectangle

    spare_in(out, ("commands.csv", "path.csv", "plan.json", "plan.svg"), force)
    driver = driver_of(calibration, circles, vehicle, profile)
    request = Request(rectangle(obstacle, "obstacle"), clearance, speed, curve_speed, radius, direction, laps)
    made = circumnavigate(driver, request, None if footprint is None else rectangle(footprint, "footprint"))
    document = documents.to_json(documents.plan_document(made))
    write_commands(folder(out) / "commands.csv", made.commands, made.rims.values)
    write_path(out / "path.csv", made.expected.path)
    write_text(out / "plan.json", document + "\n")
    write_text(out / "plan.svg", draw(made))
    if json:
        typer.echo(document)
    else:
        courses.show_plan(made)
