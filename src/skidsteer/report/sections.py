"""The sections below the first screen; what a drive does not tell is left out, and says so."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from skidsteer.calibration import Calibration, MotionSigma
from skidsteer.doctor import Finding
from skidsteer.errors import RequestError
from skidsteer.export import ros2_control
from skidsteer.models import MODELS
from skidsteer.report import charts
from skidsteer.report.charts import Chart
from skidsteer.report.evidence import Evidence
from skidsteer.report.markup import Content, Html, figure, markup, spread, table, tag
from skidsteer.report.summary import on_what

RESTARTS = (2, 5, 10, 30)  # [s]


@dataclass(frozen=True, slots=True)
class Section:
    """One section, and the charts that the page draws into it."""

    name: str
    title: str
    body: Html
    charts: tuple[Chart, ...] = ()


def sections(evidence: Evidence) -> tuple[Section, ...]:
    """All sections in the order of the page."""
    makers: tuple[Callable[[Evidence], Section | None], ...] = (
        _notes,
        _trajectory,
        _configuration,
        _held_out,
        _residuals,
        _chi,
        _parameters,
        _observability,
        _doctor,
        _consistency,
        _provenance,
    )
    return tuple(section for make in makers if (section := make(evidence)) is not None)


def _section(name: str, title: str, *body: Content, charts: Iterable[Chart] = ()) -> Section:
    """A section; plain text becomes a paragraph."""
    return Section(name, title, markup([p if isinstance(p, Html) else tag("p", p) for p in body]), tuple(charts))


def _left_out(name: str, title: str, why: str) -> Section:
    return _section(name, title, tag("p", f"Left out: {why}", class_="left-out"))


def _chart(chart: Chart) -> Html:
    style = f"height:{chart.height}px"
    return tag("div", class_="chart", id=f"chart-{chart.name}", role="img", aria_label=chart.label, style=style)


def _side_by_side(found: Iterable[Chart]) -> Html:
    return tag("div", *(_chart(chart) for chart in found), class_="pair")


# What to know


def _notes(evidence: Evidence) -> Section | None:
    notes = evidence.calibration.warnings
    return _section("notes", "What to know", tag("ul", *(tag("li", f"{note}.") for note in notes))) if notes else None


# Trajectory


def _trajectory(evidence: Evidence) -> Section:
    name, title = "trajectory", "Where dead reckoning goes"
    if not evidence.tracks:
        return _left_out(name, title, "no drive whose reference tells positions.")
    several = len(evidence.tracks) > 1
    options = [tag("option", t.name, value=str(i)) for i, t in enumerate(evidence.tracks)]
    choice = tag("label", "drive ", tag("select", *options, id="drive")) if several else None
    radios = [
        tag(
            "label",
            tag("input", type="radio", name="restart", value=str(n), checked=n == 0),
            tag("span", f"{n} s" if n else "whole drive"),
        )
        for n in (*RESTARTS, 0)
    ]
    restart = tag(
        "fieldset", tag("legend", "begin anew at the reference every"), *radios, class_="choice", id="restart"
    )
    slider = tag(
        "input", type="range", id="time", min="0", max="1000", value="1000", step="1", aria_label="time of the drive"
    )
    position = any(t.sees == "position" for t in evidence.tracks)
    aligned = (
        " Where the reference tells no heading, each stretch is turned and moved to fit it best." if position else ""
    )
    return _section(
        name,
        title,
        tag("div", choice, restart, class_="controls"),
        tag("div", class_="chart track", id="chart-track", role="img", aria_label=_track_label(evidence)),
        tag("div", tag("label", "time ", for_="time"), slider, tag("output", id="clock", for_="time"), class_="slide"),
        tag("p", id="readout", class_="readout", aria_live="polite"),
        tag(
            "p",
            f"{on_what(evidence)}{aligned} Every pose shown is one of the drive; of long drives those that lie"
            " farthest out and those with the largest errors are kept.",
            class_="caption",
        ),
    )


def _track_label(evidence: Evidence) -> str:
    names = ", ".join(["reference", *evidence.models, "calibrated"])
    return f"Paths from above of {', '.join(t.name for t in evidence.tracks)}: {names}"


# Held-out errors


def _held_out(evidence: Evidence) -> Section:
    name, title = "held-out", "How far off, on what the fit has not seen"
    calibration = evidence.calibration
    if not calibration.held_out:
        return _left_out(name, title, "the calibration holds no held-out errors.")
    found = charts.held_out_charts(calibration)
    caption = (
        "Filled: median error with its 95 % interval, by drawing blocks of the drive again and again. Open: RMS."
        " Logarithmic. Every model is fitted to one half of the blocks of time and judged on the other."
    )
    because = f"Chosen: {calibration.selected_because}."
    foreign = "" if evidence.is_seen or not evidence.drives else _foreign(evidence)
    return _section(
        name,
        title,
        because,
        _side_by_side(found),
        tag("p", caption, class_="caption"),
        _errors(calibration),
        *([foreign] if foreign else []),
        charts=found,
    )


def _foreign(evidence: Evidence) -> Html | str:
    """Errors of the calibration on drives that it was not made from."""
    rows = [
        (
            j.drive,
            str(len(j.calibrated)),
            *(
                _median(getattr(e, n), f)
                for n, f in (("translation", 1.0), ("yaw", 180.0 / np.pi))
                for e in (j.nominal, j.calibrated)
            ),
        )
        for j in evidence.judged
    ]
    head = ("on these drives", "windows", "nominal [m]", "calibrated [m]", "nominal [°]", "calibrated [°]")
    return table(head, rows, range(1, 6), label="median errors on these drives") if rows else ""


def _median(errors: np.ndarray, factor: float) -> str:
    told = np.abs(errors[np.isfinite(errors)]) * factor
    return figure(float(np.median(told)), 3) if len(told) else "–"


def _errors(calibration: Calibration) -> Html:
    names = [
        n
        for n in ("translation_m", "yaw_deg", "yaw_gyro_deg")
        if any(charts.spread_of(h, n) for h in calibration.held_out.values())
    ]
    words = {"translation_m": "position [m]", "yaw_deg": "yaw [°]", "yaw_gyro_deg": "yaw by gyro [°]"}
    head = ["model", "windows", *(f"{words[n]} {what}" for n in names for what in ("median", "RMS", "95 %"))]
    rows = []
    for model, held in calibration.held_out.items():
        label: Content = tag("strong", model) if model == calibration.model.NAME else model
        row: list[Content] = [label, str(held.windows)]
        for name in names:
            known = charts.spread_of(held, name)
            row += (
                ["–"] * 3
                if known is None
                else [
                    _with_interval(known.median, (held.median_95 or {}).get(name)),
                    figure(known.rms, 3),
                    figure(known.p95, 3),
                ]
            )
        rows.append(row)
    return table(head, rows, range(1, len(head)), label="held-out errors of all models")


def _with_interval(median: float, interval: tuple[float, float] | None) -> Content:
    if interval is None:
        return figure(median, 3)
    return (figure(median, 3), tag("span", f" {figure(interval[0], 2)}…{figure(interval[1], 2)}", class_="interval"))


# Where the model fails


def _residuals(evidence: Evidence) -> Section:
    name, title = "residuals", "Where the model fails"
    found = charts.residual_charts(evidence)
    if not found:
        return _left_out(name, title, "no drive with a reference or a gyro.")
    count = sum(len(j.calibrated) for j in evidence.judged)
    shown = (
        ""
        if count <= charts.MOST_WINDOWS
        else f" Of {count} windows {charts.MOST_WINDOWS} are shown, the {charts.WORST} worst among them."
    )
    caption = (
        f"Each point is a window of up to {evidence.window:g} s at its mean speed and yaw rate; the larger and darker,"
        f" the larger the error of the {evidence.calibration.model.NAME} model. Point at one for its time in the"
        f" log.{shown}"
    )
    return _section(
        name, title, _worst(evidence), _side_by_side(found), tag("p", caption, class_="caption"), charts=found
    )


def _worst(evidence: Evidence) -> str:
    """Which kind of motion has the largest typical errors."""
    kinds = {"straights": [], "curves": [], "turns on the spot": []}  # type: dict[str, list[float]]
    for judged in evidence.judged:
        size = np.abs(judged.calibrated.translation)
        half = 0.5 * evidence.calibration.vehicle.track_width
        spin = np.abs(judged.omega) * half
        kind = np.where(spin < 0.1 * np.abs(judged.v), 0, np.where(spin < np.abs(judged.v), 1, 2))
        for i, name in enumerate(kinds):
            kinds[name] += size[(kind == i) & np.isfinite(size)].tolist()
    told = [
        f"{figure(float(np.median(sizes)), 2, 'm')} in {name} ({len(sizes)})" for name, sizes in kinds.items() if sizes
    ]
    if not told:
        return "Against the gyro alone, only turns can be judged."
    return f"Median error of the end position: {', '.join(told)}."


# Chi against lambda


def _chi(evidence: Evidence) -> Section:
    name, title = "chi", "How the ICRs move with the curve"
    chart = charts.chi_chart(evidence)
    if chart is None or evidence.turns is None:
        return _left_out(name, title, "no turns with a reference that tells the heading.")
    beyond = int((np.abs(evidence.turns.path_curvature) > charts.MOST_CURVATURE).sum())
    far = f" {beyond} nearly straight ones lie beyond the right edge." if beyond else ""
    caption = (
        f"χ = 1 would be a turn without slip. Points: {evidence.turns.found}, from what the rims rolled and the"
        f" reference turned (Wang 2015, Eqs. (13), (15), (25)). Lines: the models.{far}"
    )
    return _section(name, title, _chart(chart), tag("p", caption, class_="caption"), charts=(chart,))


# Parameters


def _parameters(evidence: Evidence) -> Section:
    calibration = evidence.calibration
    chart = charts.correlation_chart(calibration)
    meaning = {p.name: p.meaning for p in calibration.model.PARAMETERS}
    nominal = MODELS[calibration.model.NAME].nominal(calibration.vehicle)
    before = dict(zip(meaning, nominal.theta.tolist(), strict=True))
    rows = []
    for name, e in calibration.estimates.items():
        state: Content = tag("em", "not determined", class_="bad") if not e.determined else ""
        nominal_value = figure(before[name], 3) if name in before else ""
        rows.append(
            (tag("code", name), *spread(e.value, e.sigma), e.unit, nominal_value, (meaning.get(name, ""), " ", state))
        )
    head = ("parameter", "value", "± sigma", "unit", "nominal", "")
    parts: list[Content] = [table(head, rows, (1, 2, 4), label="parameters")]
    if calibration.profiles:
        parts += [tag("h3", "Profiles"), _profiles(calibration)]
    if chart is not None:
        parts += [tag("h3", "Correlations of their errors"), _chart(chart)]
    return _section("parameters", "Parameters", *parts, charts=() if chart is None else (chart,))


def _profiles(calibration: Calibration) -> Html:
    rows = [
        (ground, *(" ± ".join(spread(e.value, e.sigma)) for e in profile.parameters.values()))
        for ground, profile in {"all together": calibration, **calibration.profiles}.items()
    ]
    head = ("ground", *calibration.parameters)
    return table(head, rows, range(1, len(head)), label="profiles")


# Observability


def _observability(evidence: Evidence) -> Section:
    name, title = "observability", "What the drives tell, and what to drive next"
    verdict = evidence.calibration.observability
    if verdict is None:
        return _left_out(name, title, "what the runs tell was not judged.")
    parts: list[Content] = []
    if verdict.weak:
        parts.append(tag("ul", *(tag("li", f"{line}.") for line in verdict.sentences)))
    else:
        parts.append(
            "The drives determine what matters: every motion below is known to better than its tolerance. Nothing is"
            " to be added."
        )
    rows = [(m.motion, m.rounded, f"{m.tolerance:.3g} {m.unit}", _bar(m)) for m in verdict.motions]
    parts.append(
        table(("motion", "known to (1 σ)", "tolerance", "share of the tolerance"), rows, (1, 2), label="known motions")
    )
    parts.append(
        tag(
            "p",
            f"Judged by the {verdict.model} model: how well the drives predict motions that every user knows.",
            class_="caption",
        )
    )
    return _section(name, title, *parts)


def _bar(motion: MotionSigma) -> Html:
    share = motion.sigma / motion.tolerance
    kind = "bar wide" if share > 1.0 else "bar"
    inner = tag("span", style=f"width:{100.0 * min(share, 1.0):.0f}%")
    return tag(
        "div",
        tag("span", inner, class_=kind, aria_hidden="true"),
        tag("span", f"{100.0 * share:.0f} %"),
        class_="share",
    )


# The log


def _doctor(evidence: Evidence) -> Section | None:
    if not evidence.findings:
        return None
    several = len(evidence.findings) > 1
    rows = [_finding(f, drive if several else "") for drive, found in evidence.findings for f in found]
    if not rows:
        return _section("log", "What is wrong with the log", "Nothing was found.")
    return _section("log", "What is wrong with the log", tag("ul", *rows, class_="findings"))


def _finding(finding: Finding, drive: str) -> Html:
    words = {"error": "error", "warning": "warning", "info": "good to know"}[finding.severity]
    where = ", ".join(f"{a:.1f}–{b:.1f} s" for a, b in finding.where[:4])
    more = f" and {len(finding.where) - 4} more" if len(finding.where) > 4 else ""
    place = f" At {where}{more}." if where else ""
    return tag(
        "li",
        tag("span", words, class_=f"severity {finding.severity}"),
        tag(
            "span",
            tag("strong", f"{drive}: " if drive else "", finding.what),
            f" {finding.effect} {finding.cure}{place}",
        ),
        tag("span", f"{100.0 * finding.confidence:.0f} % sure", class_="sure"),
    )


# Consistency


def _consistency(evidence: Evidence) -> Section:
    name, title = "consistency", "Whether the uncertainty is honest"
    chart = charts.coverage_chart(evidence)
    if chart is None:
        return _left_out(name, title, "no drive whose reference tells poses.")
    squared = np.concatenate([j.calibrated.squared for j in evidence.judged])
    squared = squared[np.isfinite(squared)]
    regions = evidence.calibration.regions
    held = ""
    if regions is not None:
        shares = [f"{100 * regions.coverage(squared, share):.0f} %" for share in (0.68, 0.95)]
        held = f" Regions that claim 68 % and 95 % hold {shares[0]} and {shares[1]} of them."
    own = (
        " The regions were fitted to these same windows at 68 % and 95 %: there they fit by themselves."
        if evidence.is_seen and regions is not None
        else ""
    )
    first = (
        f"NEES of {len(squared)} end poses: median {figure(float(np.median(squared)), 2)} (2.4 expected), mean"
        f" {figure(float(np.mean(squared)), 2)} (3 expected).{held}"
    )
    caption = (
        f"On the dotted line a region holds what it claims; above it is wider than need be, below it too small.{own}"
    )
    return _section(name, title, first, _chart(chart), tag("p", caption, class_="caption"), charts=(chart,))


# Configuration


def _configuration(evidence: Evidence) -> Section:
    name, title = "configuration", "To paste: diff_drive_controller of ROS 2"
    try:
        text = ros2_control(evidence.calibration, forced=evidence.forced)
    except RequestError as refusal:
        return _left_out(name, title, f"{refusal}.")
    button = tag("button", "Copy", type="button", id="copy", data_copy="yaml")
    said = tag("span", id="copied", role="status")
    block = tag("pre", tag("code", text, id="yaml"), tabindex="0", role="region", aria_label="YAML of the controller")
    return _section(name, title, tag("div", button, said, class_="copying"), block)


# Provenance


def _provenance(evidence: Evidence) -> Section:
    made = evidence.calibration.provenance
    rows = [
        (
            d.name,
            d.source,
            f"{d.duration:.1f}",
            str(d.windows),
            str(d.outliers),
            tag("code", d.sha256 or "–", class_="hash"),
        )
        for d in made.drives
    ]
    drives = table(
        ("drive", "source", "duration [s]", "increments", "weighed down", "SHA-256"), rows, (2, 3, 4), label="drives"
    )
    facts = {
        "software": made.software,
        "calibrated": made.created,
        "method": evidence.calibration.method,
        "vehicle": f"{evidence.calibration.vehicle.name}, track width {evidence.calibration.vehicle.track_width:g} m,"
        f" wheel radius {evidence.calibration.vehicle.wheel_radius:g} m",
        "options": ", ".join(f"{k}: {'–' if v is None else v}" for k, v in made.options.items()),
        "shown here": ", ".join(evidence.drives) or "no drive",
    }
    listed = tag("dl", *(tag("div", tag("dt", key), tag("dd", value)) for key, value in facts.items()), class_="facts")
    return _section("provenance", "Where this comes from", drives, listed)
