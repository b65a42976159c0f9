"""The page: head, first screen, sections, data and scripts in one file that loads nothing else."""

from __future__ import annotations

import base64
import hashlib
import os
from datetime import datetime, timezone
from importlib.resources import files
from typing import Any

from skidsteer.io.atomic import write_text
from skidsteer.report.evidence import Evidence
from skidsteer.report.markup import Html, embedded, tag
from skidsteer.report.section import Section
from skidsteer.report.sections import sections
from skidsteer.report.summary import summary
from skidsteer.report.tracks import DriveTracks


def write_report(evidence: Evidence, path: str | os.PathLike[str]) -> None:
    """Write the page, all of it or nothing.

    Raises:
        DataError: the file cannot be written.
    """
    write_text(path, page(evidence))


def page(evidence: Evidence) -> str:
    """The whole page as text; it opens from disk and makes no request."""
    scripts = (_plotly(), _own("page.js"))
    parts = sections(evidence)
    data = {
        "charts": {chart.name: chart.figure for part in parts for chart in part.charts},
        "tracks": [_track(track) for track in evidence.tracks],
    }
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=_policy(scripts)),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", f"Calibration of {evidence.calibration.vehicle.name}"),
        tag("style", Html(_own("page.css"))),
    )
    main = tag("main", summary(evidence), *(_section(part) for part in parts), id="main")
    end = [embedded(data, "data"), *(tag("script", Html(script)) for script in scripts)]
    body = tag("body", _header(evidence), main, _footer(evidence), *end)
    return f"<!DOCTYPE html>\n{tag('html', head, body, lang='en')}\n"


def _policy(scripts: tuple[str, ...]) -> str:
    """Only the scripts of this page run, and nothing is fetched."""
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(s.encode()).digest()).decode()}'" for s in scripts)
    return f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:"


def _own(name: str) -> str:
    return files("skidsteer.report").joinpath(name).read_text(encoding="utf-8")


def _plotly() -> str:
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def _header(evidence: Evidence) -> Html:
    calibration = evidence.calibration
    drives = ", ".join(d.name for d in calibration.provenance.drives)
    button = tag("button", "Dark", type="button", id="theme", aria_label="change between light and dark")
    return tag(
        "header",
        tag(
            "div",
            tag("h1", calibration.vehicle.name),
            tag("p", f"Motion model calibrated from {drives}: {calibration.model.NAME}"),
        ),
        button,
    )


def _section(part: Section) -> Html:
    return tag("section", tag("h2", part.title), part.body, id=part.name)


def _footer(evidence: Evidence) -> Html:
    now = datetime.now(timezone.utc).isoformat(timespec="seconds")
    return tag("footer", tag("p", f"Report of {now} by {evidence.calibration.provenance.software}."))


def _track(track: DriveTracks) -> dict[str, Any]:
    """What the page needs of a track: positions to the millimetre, yaw to 1e-5 rad."""
    poses = {
        name: [values[:, 0].round(3).tolist(), values[:, 1].round(3).tolist(), values[:, 2].round(5).tolist()]
        for name, values in track.poses.items()
    }
    t = (track.t - track.t[0]).round(3)
    return {
        "name": track.name,
        "sees": track.sees,
        "begin": float(track.t[0]),
        "t": t.tolist(),
        "piece": track.piece.tolist(),
        "poses": poses,
    }
