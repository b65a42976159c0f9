"""Results for people at a terminal: tables, one sentence, a progress bar on standard error."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.markup import escape as without_markup
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.segment import Segments
from rich.table import Table

from skidsteer.calibration import Calibration, Estimate, HeldOut, Observability
from skidsteer.doctor import EXCITATION, Finding
from skidsteer.drive import Drive
from skidsteer.errors import printable
from skidsteer.evaluation import Evaluation
from skidsteer.identify.calibrate import Progress as Report
from skidsteer.identify.circle_calibration import CircleCalibration
from skidsteer.identify.circle_test import SideResult
from skidsteer.identify.select import Excess, Selection
from skidsteer.identify.terrain import Terrains
from skidsteer.reproduce.rows import Reproduction, tally
from skidsteer.reproduce.rows import Table as SideBySide

if TYPE_CHECKING:
    from skidsteer.io.bag import BagContents
    from skidsteer.odometry.run import Odometry

OUT = Console(highlight=False)
ERR = Console(stderr=True, highlight=False)
WIDE = 1000  # more than any table of names and numbers


def escape(text: str) -> str:
    """Text from a file, printed as it is: on one line, without markup and control characters."""
    return without_markup(printable(text))


@contextmanager
def progress_bar() -> Iterator[Report]:
    """A bar on standard error, if that is a terminal; the value reports to it: what, steps done, steps in all."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=ERR, transient=True, disable=not ERR.is_terminal) as bar:
        task = bar.add_task("reading", total=None)

        def report(what: str, done: int, total: int) -> None:
            bar.update(task, description=escape(what), completed=done, total=total)

        yield report


def show_calibration(calibration: Calibration) -> None:
    """Parameters with their sigmas, held-out errors and warnings."""
    drives = ", ".join(d.name for d in calibration.provenance.drives)
    OUT.print(f"[bold]{escape(calibration.vehicle.name)}[/bold] from {escape(drives)}: model {calibration.model.NAME}")
    _print_whole(_parameters(calibration))
    if width := calibration.effective_track_width:
        OUT.print(
            f"Effective track width {' +- '.join(_numbers(width))} m, nominal {calibration.vehicle.track_width:g} m."
        )
    if calibration.held_out:
        _print_whole(_errors(calibration.held_out, "held-out error", chosen=calibration.model.NAME))
        OUT.print(before_after(calibration))
    if calibration.controller is not None and calibration.controller.held_out is not None:
        OUT.print(_as_multipliers(calibration.controller.held_out))
    OUT.print(f"Chosen: {escape(calibration.selected_because)}.")
    for warning in calibration.warnings:
        OUT.print(f"[yellow]Note:[/yellow] {escape(warning)}.")
    if calibration.profiles:
        _print_whole(_profiles(calibration))


def _profiles(calibration: Calibration) -> Table:
    """Parameters of each profile side by side."""
    table = _table("profile", *calibration.parameters)
    for name, profile in {"all": calibration, **calibration.profiles}.items():
        table.add_row(escape(name), *(" +- ".join(_numbers(e)) for e in profile.parameters.values()))
    return table


def show_circles(found: CircleCalibration) -> None:
    """The circle test, surfaces side by side and left beside right, then the calibration."""
    sides = {
        f"{result.surface or 'unnamed'} {name}": side
        for result in found.surfaces
        for name, side in (("left", result.left), ("right", result.right))
        if side is not None
    }
    table = _table("", *map(escape, sides), right=slice(1, None))
    for title, cells in _circle_rows(list(sides.values())):
        table.add_row(escape(title), *cells)
    table.columns[0].no_wrap = True
    OUT.print("Circle test, Giannoccaro 2015: B_e = 2 x_ICR of Eq. (12), chi of Eq. (11), K_s of Eq. (15).")
    OUT.print(table)
    show_calibration(found.calibration)


PAIRS = 10  # of rim speeds up to which the slip ratio of each is shown


def _circle_rows(sides: list[SideResult]) -> Iterator[tuple[str, list[str]]]:
    yield "runs", [str(len(side.runs)) for side in sides]
    yield "B_e [m]", [f"{2.0 * side.icr_y:.3f}" for side in sides]
    yield "+-", ["" if side.icr_y_sigma is None else f"{2.0 * side.icr_y_sigma:.3f}" for side in sides]
    yield "chi", [f"{side.steering_efficiency:.3f}" for side in sides]
    pairs = sorted({(run.inner, run.outer) for side in sides for run in side.runs})
    if len(pairs) > PAIRS:
        known = [[ratio for ratio in side.slip_ratios if ratio is not None] for side in sides]
        yield "K_s, median", [f"{np.median(ratios):.2f}" if ratios else "open" for ratios in known]
        return
    for inner, outer in pairs:
        yield f"K_s {inner:.3g}:{outer:.3g}", [_slip_ratios(side, inner, outer) for side in sides]


def _slip_ratios(side: SideResult, inner: float, outer: float) -> str:
    """Slip ratios of the runs at a pair of speeds; an inner side at rest leaves it open."""
    ratios = [r for run, r in zip(side.runs, side.slip_ratios, strict=True) if (run.inner, run.outer) == (inner, outer)]
    return " ".join("open" if r is None else f"{r:.2f}" for r in ratios) or "-"


def before_after(calibration: Calibration) -> str:
    """One sentence: the errors of dead reckoning with the nominal and with the calibrated model."""
    before = calibration.held_out["differential"]
    after = calibration.held_out[calibration.model.NAME]
    length = calibration.provenance.options.get("window")
    if before.yaw_gyro_deg and after.yaw_gyro_deg and not np.isfinite(after.translation_m.rms):
        return (
            f"Before: the turn over windows of {length} s is off by {before.yaw_gyro_deg.rms:.1f} deg against the gyro"
            f" (RMS, nominal track width). After: {after.yaw_gyro_deg.rms:.1f} deg."
        )
    return (
        f"Before: dead reckoning over windows of {length} s is off by {_rms(before)} (RMS, nominal track width)."
        f" After: {_rms(after)}."
    )


def _rms(held_out: HeldOut) -> str:
    """RMS errors of position and, where the reference has it, yaw."""
    position, yaw = held_out.translation_m.rms, held_out.yaw_deg.rms
    return f"{position:.3f} m" + (f" and {yaw:.1f} deg" if np.isfinite(yaw) else "")


def _as_multipliers(held_out: HeldOut) -> str:
    gyro = held_out.yaw_gyro_deg
    known = {
        f"{held_out.translation_m.rms:.3f} m": held_out.translation_m,
        f"{held_out.yaw_deg.rms:.1f} deg": held_out.yaw_deg,
    }
    errors = [text for text, spread in known.items() if np.isfinite(spread.rms)]
    if not errors and gyro is not None:
        errors = [f"{gyro.rms:.1f} deg against the gyro"]
    return f"As multipliers of ROS 2's diff_drive_controller: {' and '.join(errors)}."


def _parameters(calibration: Calibration) -> Table:
    table = _table("parameter", "value", "+- sigma", "unit", "", right=slice(1, 3))
    for name, e in (calibration.parameters | calibration.nuisance).items():
        table.add_row(escape(name), *_numbers(e), escape(e.unit), "" if e.determined else "[red]not determined[/red]")
    return table


def _numbers(e: Estimate) -> tuple[str, str]:
    """Value and sigma, to two digits of the sigma."""
    if e.sigma == 0.0:
        return f"{e.value:.6g}", "fixed"
    digits = min(max(0, -int(f"{e.sigma:e}".split("e")[1]) + 1), 8)
    return f"{e.value:.{digits}f}", f"{e.sigma:.{digits}f}"


def _errors(figures: Mapping[str, HeldOut], title: str, chosen: str = "", count: str = "model") -> Table:
    gyro = any(h.yaw_gyro_deg for h in figures.values())
    head = [count, "windows", *2 * ("median", "RMS", "95 %"), *["vs gyro"] * gyro]
    table = _table(*head, right=slice(1, None), title=escape(f"{title}: translation [m], yaw [deg]"))
    for name, h in figures.items():
        t, y = h.translation_m, h.yaw_deg
        row = [escape(name), str(h.windows), *(_figure(v, 3) for v in (t.median, t.rms, t.p95))]
        row += [_figure(v, 2) for v in (y.median, y.rms, y.p95)]
        row += [f"{h.yaw_gyro_deg.median:.2f}" if h.yaw_gyro_deg else "-"] if gyro else []
        table.add_row(*row, style="bold" if name == chosen else None)
    return table


def _table(*head: str, right: slice = slice(0), title: str | None = None) -> Table:
    """A table without lines; the columns ``right`` are set to the right."""
    table = Table(*head, title=title, title_justify="left", box=None, pad_edge=False)
    for column in table.columns[right]:
        column.justify = "right"
    return table


def _print_whole(table: Table) -> None:
    """Print a table uncut: in a narrower terminal its lines wrap."""
    natural = OUT.measure(table, options=OUT.options.update(width=WIDE)).maximum
    lines = OUT.render(table, OUT.options.update(width=max(OUT.width, natural)))
    OUT.print(Segments(lines), crop=False, end="")


def _figure(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def show_evaluation(evaluation: Evaluation) -> None:
    """Errors of each drive and of all."""
    rows = dict(evaluation.drives)
    if len(rows) > 1:
        rows["all"] = evaluation.total
    _print_whole(_errors(rows, "error", count="drive"))
    if evaluation.total.coverage_68 is not None and evaluation.total.coverage_95 is not None:
        OUT.print(
            f"Predicted regions that claim 68 % and 95 % hold {100 * evaluation.total.coverage_68:.0f} % and"
            f" {100 * evaluation.total.coverage_95:.0f} % of the end poses."
        )
    offsets = ", ".join(f"{escape(name)} {offset:+.3f} s" for name, offset in evaluation.time_offsets.items())
    OUT.print(f"Time offset used: {offsets}.")


def _excess(e: Excess | None) -> str:
    if e is None:
        return "-"
    return f"{100 * e.share:+.0f} % ({100 * e.low:+.0f} to {100 * e.high:+.0f} %)"


def show_comparison(held_out: Mapping[str, HeldOut], selection: Selection) -> None:
    """Held-out errors of all models, and the verdict."""
    _print_whole(_errors(held_out, "held-out error", chosen=selection.name))
    table = _table("against the best", "translation", "yaw", "")
    for name, c in selection.against_best.items():
        table.add_row(name, _excess(c.translation), _excess(c.yaw), "worse" if c.worse else "")
    OUT.print(table)
    OUT.print(f"Chosen: {escape(selection.because)}.")


def show_terrains(found: Terrains) -> None:
    """Each pair of grounds: whether the parameters differ, and whether that matters."""
    title = f"{found.model}: errors against the ground's own calibration, held out"
    table = _table("calibration of", "on", "p", "translation", "yaw", "", title=title)
    for pair in found.pairs:
        for one, other, c in pair.sides:
            known = ("-", "-") if c is None else (_excess(c.translation), _excess(c.yaw))
            verdict = "too short to tell" if c is None else "worse" if c.surely_worse else ""
            table.add_row(escape(one), escape(other), f"{pair.difference.p:.2g}", *known, verdict)
    OUT.print(table)
    OUT.print(f"Verdict: {escape(found.because)}.")


def show_odometry(result: Odometry) -> None:
    """Measurements taken, sigma of the last pose, and distance from the reference."""
    track = result.trajectory
    last = np.sqrt(np.diag(track.covariances[-1]))
    OUT.print(f"{len(track.t)} poses in {track.t[-1] - track.t[0]:.1f} s by {escape(result.filter.fingerprint)}.")
    if len(track.squared):
        OUT.print(
            f"Reference: {track.accepted.sum()} taken, {(~track.accepted).sum()} refused"
            f" ({track.anchored.sum()} jumps followed); squared innovation over its dof (1 if all is right):"
            f" mean {np.mean(track.squared) / track.dof:.2f}, median {np.median(track.squared) / track.dof:.2f}."
        )
    if sum(track.rates):
        mean = f"mean squared innovation {track.rate_squared:.2f}"
        OUT.print(f"Gyro: {track.rates[0]} steps taken, {track.rates[1]} refused; {mean}.")
    OUT.print(f"Sigma of the last pose: x {last[0]:.2g} m, y {last[1]:.2g} m, yaw {np.degrees(last[2]):.2g} deg.")
    if result.distance is not None and result.nominal is not None:
        OUT.print(
            f"Distance from the reference since {result.since - track.t[0]:.1f} s: {result.distance.rms:.3f} m RMS,"
            f" {result.distance.most:.3f} m at most; by the nominal track width alone {result.nominal.rms:.3f} m and"
            f" {result.nominal.most:.3f} m."
        )


COLOURS = {"error": "red", "warning": "yellow", "info": "blue"}


def show_reproduction(name: str, done: Reproduction) -> None:
    """A line for each printed figure, with its verdict; the reasons; tables side by side; what is not calculated."""
    OUT.print(f"[bold]{name}[/bold]")
    table = _table("", "paper", "ours", "difference", "verdict", right=slice(1, 4))
    for row in done.rows:
        numbers = ("-" if np.isnan(v) else f"{v:.4g}" for v in (row.paper, row.ours, row.difference))
        colour = "green" if row.verdict == "reproduced" else "yellow"
        table.add_row(escape(row.what), *numbers, f"[{colour}]{row.verdict}[/]")
    OUT.print(table)
    for reason, rows in itertools.groupby(done.rows, key=lambda row: row.reason):
        if reason:
            OUT.print(f"{escape('; '.join(row.what for row in rows))}: {escape(reason)}.")
    for side in done.tables:
        _show_side_by_side(side)
    for note in done.notes:
        OUT.print(f"Found on the way: {escape(note.rstrip('.'))}.")
    for place in done.places:
        if place.not_computed:
            OUT.print(f"{place.name}, {escape(place.shows)}: {escape(place.not_computed)}.")
    OUT.print("; ".join(f"{n} {verdict}" for verdict, n in tally(done.rows).items()))


def _show_side_by_side(side: SideBySide) -> None:
    table = _table(*map(escape, side.head), title=escape(side.title))
    for label, values in side.lines:
        table.add_row(escape(label), *("-" if np.isnan(v) else f"{v:.4g}" for v in values))
    OUT.print(table)
    if side.note:
        OUT.print(escape(side.note))


def show_check(
    drive: Drive,
    findings: Sequence[Finding],
    topics: BagContents | None,
    cures: Sequence[str],
    verdict: Observability | str,
) -> None:
    """What a bag offers, what is wrong with the drive, and what it determines."""
    if topics is not None:
        table = _table("topic", "type", "messages", "could serve as", "used as")
        for t in topics.topics:
            table.add_row(escape(t.name), escape(t.type), str(t.count), ", ".join(t.serves), t.used_as)
        table.columns[0].overflow = table.columns[1].overflow = "fold"
        OUT.print(table)
    parts = {"pose": drive.pose, "position": drive.position, "gyro": drive.gyro, "command": drive.command}
    has = "".join(f", {name} {len(series)}" for name, series in parts.items() if series is not None)
    start, end = drive.span
    OUT.print(f"[bold]{escape(drive.name)}[/bold]: {end - start:.1f} s, wheels {len(drive.wheels)} samples{has}")
    judged = not isinstance(verdict, str)  # says more than the findings about how it was driven
    findings = [f for f in findings if not (judged and f.kind in EXCITATION)]
    for f in findings:
        where = "" if not f.where else f" ({_times(f.where)})"
        OUT.print(f"[{COLOURS[f.severity]}]{f.severity}[/] {f.kind}, {100 * f.confidence:.0f} % sure{where}")
        OUT.print(f"  {escape(f.what)} {escape(f.effect)}")
        OUT.print(f"  Cure: {escape(f.cure)}")
    for line in cures:
        OUT.print(f"[green]done[/] {escape(line)}")
    if not findings:
        OUT.print("Nothing found wrong.")
    _show_verdict(verdict)


def _show_verdict(verdict: Observability | str) -> None:
    if isinstance(verdict, str):
        OUT.print(f"Not judged what it tells of the robot: {escape(verdict)}.")
        return
    known = ", ".join(f"{name} +- {sigma:.2g}" for name, sigma in verdict.determined.items())
    OUT.print(f"Determined by this drive (model {verdict.model}): {escape(known or 'nothing')}.")
    if verdict.undetermined:
        OUT.print(f"[red]Not determined:[/] {escape(', '.join(verdict.undetermined))}.")
    for sentence in verdict.sentences:
        OUT.print(f"[yellow]Note:[/yellow] {escape(sentence)}.")


def _times(where: Sequence[tuple[float, float]]) -> str:
    shown = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in where[:3])
    return shown if len(where) <= 3 else f"{shown} and {len(where) - 3} more"
