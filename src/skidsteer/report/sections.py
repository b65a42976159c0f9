"""The sections below the first screen; one without data says why it is left out."""

from __future__ import annotations

from collections.abc import Callable

from skidsteer.errors import RequestError
from skidsteer.export import ros2_control
from skidsteer.report.evidence import Evidence
from skidsteer.report.judgement import chi, consistency, held_out, residuals
from skidsteer.report.knowledge import log, observability, parameters
from skidsteer.report.markup import table, tag
from skidsteer.report.section import Section, left_out, section
from skidsteer.report.summary import on_what

RESTARTS = (2, 5, 10, 30)  # [s]


def sections(evidence: Evidence) -> tuple[Section, ...]:
    """All sections in the order of the page."""
    makers: tuple[Callable[[Evidence], Section | None], ...] = (
        _notes,
        _trajectory,
        _configuration,
        held_out,
        residuals,
        chi,
        parameters,
        observability,
        log,
        consistency,
        _provenance,
    )
    return tuple(section for make in makers if (section := make(evidence)) is not None)


def _notes(evidence: Evidence) -> Section | None:
    notes = evidence.notes
    return section("notes", "What to know", tag("ul", *(tag("li", f"{note}.") for note in notes))) if notes else None


def _trajectory(evidence: Evidence) -> Section:
    name, title = "trajectory", "Where dead reckoning goes"
    if not evidence.tracks:
        return left_out(name, title, "no drive whose reference tells positions.")
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
    return section(
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


def _configuration(evidence: Evidence) -> Section:
    name, title = "configuration", "To paste: diff_drive_controller of ROS 2"
    try:
        text = ros2_control(evidence.calibration, forced=evidence.forced)
    except RequestError as refusal:
        return left_out(name, title, f"{refusal}.")
    button = tag("button", "Copy", type="button", id="copy", data_copy="yaml")
    said = tag("span", id="copied", role="status")
    block = tag("pre", tag("code", text, id="yaml"), tabindex="0", role="region", aria_label="YAML of the controller")
    return section(name, title, tag("div", button, said, class_="copying"), block)


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
        "drives", ("drive", "source", "duration [s]", "increments", "weighed down", "SHA-256"), rows, (2, 3, 4), (1, 5)
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
    return section("provenance", "Where this comes from", drives, listed)
