"""Sections on parameters, on what the drives determine, and on what is wrong with the log."""

from __future__ import annotations

from skidsteer.calibration import Calibration, MotionSigma
from skidsteer.doctor import Finding
from skidsteer.models import MODELS
from skidsteer.report import model_charts
from skidsteer.report.evidence import Evidence
from skidsteer.report.markup import Content, Html, rounded, spread, table, tag
from skidsteer.report.section import Section, drawn, left_out, section


def parameters(evidence: Evidence) -> Section:
    """Values, sigmas, profiles and correlations."""
    calibration = evidence.calibration
    chart = model_charts.correlation_chart(calibration)
    meaning = {p.name: p.meaning for p in calibration.model.PARAMETERS}
    nominal = MODELS[calibration.model.NAME].nominal(calibration.vehicle)
    before = dict(zip(meaning, nominal.theta.tolist(), strict=True))
    rows = []
    for name, e in calibration.estimates.items():
        state: Content = tag("em", "not determined", class_="bad") if not e.determined else ""
        nominal_value = rounded(before[name], 3) if name in before else ""
        rows.append(
            (tag("code", name), *spread(e.value, e.sigma), e.unit, nominal_value, (meaning.get(name, ""), " ", state))
        )
    head = ("parameter", "value", "± sigma", "unit", "nominal", "")
    parts: list[Content] = [table("parameters", head, rows, (1, 2, 4), (5,))]
    if calibration.profiles:
        parts += [tag("h3", "Profiles"), _profiles(calibration)]
    if chart is not None:
        parts += [tag("h3", "Correlations of their errors"), drawn(chart)]
    return section("parameters", "Parameters", *parts, charts=() if chart is None else (chart,))


def _profiles(calibration: Calibration) -> Html:
    rows = [
        (ground, *(" ± ".join(spread(e.value, e.sigma)) for e in profile.parameters.values()))
        for ground, profile in {"all together": calibration, **calibration.profiles}.items()
    ]
    head = ("ground", *calibration.parameters)
    return table("profiles", head, rows, range(1, len(head)))


def observability(evidence: Evidence) -> Section:
    """What the drives determine, motion by motion, and what to drive next."""
    name, title = "observability", "What the drives tell, and what to drive next"
    verdict = evidence.calibration.observability
    if verdict is None:
        return left_out(name, title, "what the runs tell was not judged.")
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
        table("known motions", ("motion", "known to (1 σ)", "tolerance", "share of the tolerance"), rows, (1, 2), (0,))
    )
    parts.append(
        tag(
            "p",
            f"Judged by the {verdict.model} model: how well the drives predict motions that every user knows.",
            class_="caption",
        )
    )
    return section(name, title, *parts)


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


def log(evidence: Evidence) -> Section | None:
    """The doctor's findings; None without a drive."""
    if not evidence.findings:
        return None
    several = len(evidence.findings) > 1
    rows = [_finding(f, drive if several else "") for drive, found in evidence.findings for f in found]
    if not rows:
        return section("log", "What is wrong with the log", "Nothing was found.")
    return section("log", "What is wrong with the log", tag("ul", *rows, class_="findings"))


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
