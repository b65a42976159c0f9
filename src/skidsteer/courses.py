"""What is to be driven, as tables at a terminal: designed drives and plans."""

from __future__ import annotations

import itertools

import numpy as np
from rich.table import Table

from skidsteer import console
from skidsteer.console import escape
from skidsteer.identify.design import Design
from skidsteer.plan.circumnavigation import Plan


def show_design(design: Design) -> None:
    """What to drive, and what it will tell beside an unplanned drive."""
    table = Table("start", "times", "each", "manoeuvre", box=None, pad_edge=False)
    for figure, group in itertools.groupby(design.schedule, key=lambda row: row[2]):
        rows = list(group)
        table.add_row(f"{rows[0][0]:.1f} s", str(len(rows)), f"{rows[0][1]:.1f} s", figure.words())
    for column in table.columns[:3]:
        column.justify = "right"
    vehicle, area, reach = design.setup.vehicle, design.request.area, design.excursion
    console.OUT.print(
        f"[bold]{escape(vehicle.name)}[/bold]: {design.duration:.0f} s for {design.setup.model.NAME}, start in the"
    )
    console.OUT.print(f"middle of {area[0]:g} x {area[1]:g} m, facing along the first side, and drive:")
    console.OUT.print(table)
    console.OUT.print(_told(design))
    console.OUT.print(
        f"19 of 20 robots like this stay within {reach.x:.1f} m ahead and behind, as many within {reach.y:.1f} m to the"
        f" sides, and as many end within {reach.end:.1f} m of the start. Keep a hand at the stop button."
    )
    console.OUT.print(
        "commands.csv is for a controller that turns v and omega into wheel speeds with a track width of"
        f" {design.controller.track_width:.3f} m; for another, play its v_left and v_right."
    )


def _told(design: Design) -> Table:
    units = {p.name: p.unit for p in design.setup.model.PARAMETERS}
    table = Table("parameter", "sigma", "unplanned", "share", "unit", box=None, pad_edge=False)
    table.title, table.title_justify = "predicted sigmas, beside those of an unplanned drive of equal length", "left"
    for name, sigma in design.sigmas.items():
        other = design.unplanned[name]
        table.add_row(
            escape(name), f"{sigma:.2g}", f"{other:.2g}", f"{100 * sigma / other:.0f} %", units.get(name, "s")
        )
    for column in table.columns[1:4]:
        column.justify = "right"
    return table


def show_plan(plan: Plan) -> None:
    """Stretches of a lap with their rim speeds, how far the robot keeps off the obstacle, and where it ends."""
    coded, obstacle, laps = plan.driver.encoding is not None, plan.obstacle, plan.request.laps
    again = f", {laps} laps" if laps > 1 else ""
    console.OUT.print(
        f"[bold]{escape(plan.driver.vehicle.name)}[/bold] by {plan.driver.model.NAME}: round {obstacle.length:g} x"
        f" {obstacle.width:g} m on its {plan.request.side}, from rest at A, on arcs of {plan.radius:.3f} m{again}:"
    )
    titles = ["stretch", "start s", "lasts s", "way m", "radius m", "left m/s", "right m/s"]
    table = Table(*titles, *(["k left", "k right"] if coded else []), box=None, pad_edge=False)
    for t, s in list(zip(plan.starts.tolist(), plan.stretches, strict=True))[:4]:
        radius = f"{s.radius:.3f}" if s.curved else ""
        speeds = [f"{v:.3f}" for v in s.rims]
        table.add_row(s.name, f"{t:.2f}", f"{s.duration:.2f}", f"{s.length:.3f}", radius, *speeds, *map(str, s.k or ()))
    for column in table.columns[1:]:
        column.justify = "right"
    console.OUT.print(table)
    (x, y, yaw), missed = plan.end_sigmas, plan.misses
    if coded:
        bend = plan.stretches[1].radius - plan.radius
        console.OUT.print(
            f"Whole k alone make the arcs {bend:+.3f} m wider and end the course {np.hypot(*missed[:2]):.3f} m and"
        )
        console.OUT.print(f"{np.degrees(missed[2]):.1f} deg off.")
    console.OUT.print(
        f"Keeps {plan.gaps.min():.3f} m off the obstacle, at each place 19 robots of 20 {plan.sure_gap:.3f} m."
    )
    console.OUT.print(
        f"Ends {np.hypot(*plan.end[:2]):.3f} m from the start; sigma {x:.3f} m ahead, {y:.3f} m to the side,"
    )
    console.OUT.print(f"{np.degrees(yaw):.1f} deg.")
    for note in plan.notes:
        console.OUT.print(f"[yellow]Note:[/yellow] {escape(note)}.")
