"""Commands that hand a calibration to other software."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skidsteer.cli.outputs import Force, spare_file
from skidsteer.cli.words import DRIVE_HELP, Profile, Window, app, positive
from skidsteer.sources import Source, on_drives


@app.command()
@on_drives
def export(
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="calibration.yaml, or its folder")],
    source: Source,
    to: Annotated[
        str, typer.Option(metavar="FORMAT", help="ros2-control, ros1-control, robot-localization, p3at or json")
    ],
    drives: Annotated[
        list[str] | None,
        typer.Argument(metavar="DRIVE", help=f"to measure on what multipliers lose: {DRIVE_HELP}"),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="to write; default: standard output")] = None,
    controller: Annotated[
        str, typer.Option(metavar="NAME", help="of the controller's node in ROS")
    ] = "diff_drive_controller",
    rate: Annotated[float, typer.Option(metavar="HZ", help="of odometry messages, for their covariance")] = 50.0,
    icr_frame: Annotated[
        str | None, typer.Option(metavar="NAME", help="frame at the ICR that the odometry is to be of")
    ] = None,
    window: Window = 2.0,
    profile: Profile = None,
    force: Force = False,
) -> None:
    """A calibration for other software: ROS, a Pioneer, JSON. Parameters to paste, with what is lost in them."""
    from skidsteer.export import Settings, text
    from skidsteer.export import force as as_multipliers
    from skidsteer.io.atomic import write_text
    from skidsteer.io.calibration_file import load_calibration

    positive(window, "--window")
    if out is not None:
        spare_file(out, force, "export")
    known = load_calibration(calibration).profile(profile)
    loaded = source.load(drives, known) if drives else []
    settings = Settings(controller, rate, icr_frame, source.words["imu_topic"] or "imu/data")
    made = text(known, to, settings, as_multipliers(known, loaded, window))
    if out is None:
        typer.echo(made, nl=False)
        return
    write_text(out, made)
    typer.echo(f"written: {out}")
