"""Sections that judge: held-out errors, where the model fails, where the ICRs lie, whether regions hold."""

from __future__ import annotations

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.metrics import WindowErrors
from skidsteer.report import error_charts, model_charts
from skidsteer.report.evidence import Evidence
from skidsteer.report.markup import Content, Html, rounded, table, tag
from skidsteer.report.section import Section, drawn, left_out, section, side_by_side


def held_out(evidence: Evidence) -> Section:
    """Held-out errors of every model, and those on foreign drives."""
    name, title = "held-out", "How far off, on what the fit has not seen"
    calibration = evidence.calibration
    if not calibration.held_out:
        return left_out(name, title, "the calibration holds no held-out errors.")
    found = error_charts.held_out_charts(calibration)
    caption = (
        "Filled: median error with its 95 % interval, by drawing blocks of the drive again and again. Open: RMS."
        " Logarithmic. Every model is fitted to one half of the blocks of time and judged on the other."
    )
    because = f"Chosen: {calibration.selected_because}."
    foreign = "" if evidence.is_seen or not evidence.drives else _foreign(evidence)
    return section(
        name,
        title,
        because,
        side_by_side(found),
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
    return table("median errors on these drives", head, rows, range(1, 6)) if rows else ""


def _median(errors: np.ndarray, factor: float) -> str:
    sizes = np.abs(errors[np.isfinite(errors)]) * factor
    return rounded(float(np.median(sizes)), 3) if len(sizes) else "–"


def _errors(calibration: Calibration) -> Html:
    names = [
        n
        for n in ("translation_m", "yaw_deg", "yaw_gyro_deg")
        if any(error_charts.spread_of(h, n) for h in calibration.held_out.values())
    ]
    words = {"translation_m": "position [m]", "yaw_deg": "yaw [°]", "yaw_gyro_deg": "yaw by gyro [°]"}
    head = ["model", "windows", *(f"{words[n]} {what}" for n in names for what in ("median", "RMS", "95 %"))]
    rows = []
    for model, held in calibration.held_out.items():
        label: Content = tag("strong", model) if model == calibration.model.NAME else model
        row: list[Content] = [label, str(held.windows)]
        for name in names:
            known = error_charts.spread_of(held, name)
            row += (
                ["–"] * 3
                if known is None
                else [
                    _with_interval(known.median, (held.median_95 or {}).get(name)),
                    rounded(known.rms, 3),
                    rounded(known.p95, 3),
                ]
            )
        rows.append(row)
    return table("held-out errors of all models", head, rows, range(1, len(head)))


def _with_interval(median: float, interval: tuple[float, float] | None) -> Content:
    if interval is None:
        return rounded(median, 3)
    return (rounded(median, 3), tag("span", f" {rounded(interval[0], 2)}…{rounded(interval[1], 2)}", class_="interval"))


def residuals(evidence: Evidence) -> Section:
    """Errors over speed and yaw rate, and in which motions they are largest."""
    name, title = "residuals", "Where the model fails"
    found = error_charts.residual_charts(evidence)
    if not found:
        return left_out(name, title, "no drive with a reference or a gyro.")
    count = sum(len(j.calibrated) for j in evidence.judged)
    shown = (
        ""
        if count <= error_charts.MOST_WINDOWS
        else f" Of {count} windows {error_charts.MOST_WINDOWS} are shown, the {error_charts.WORST} worst among them."
    )
    caption = (
        f"Each point is a window of up to {evidence.window:g} s at its mean speed and yaw rate; the larger it is and"
        f" the stronger its colour, the larger the error of the {evidence.calibration.model.NAME} model. Point at one"
        f" for its time in the log.{shown}"
    )
    return section(
        name, title, _worst(evidence), side_by_side(found), tag("p", caption, class_="caption"), charts=found
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
    medians = [
        f"{rounded(float(np.median(sizes)), 2, 'm')} in {name} ({len(sizes)})" for name, sizes in kinds.items() if sizes
    ]
    if not medians:
        return "Against the gyro alone, only turns can be judged."
    return f"Median error of the end position: {', '.join(medians)}."


def chi(evidence: Evidence) -> Section:
    """Measured turns and the curves of the models through them."""
    name, title = "chi", "How the ICRs move with the curve"
    chart = model_charts.chi_chart(evidence)
    if chart is None or evidence.turns is None:
        return left_out(name, title, "no turns with a reference that tells the heading.")
    beyond = int((np.abs(evidence.turns.path_curvature) > model_charts.MOST_CURVATURE).sum())
    far = f" {beyond} nearly straight ones lie beyond the right edge." if beyond else ""
    caption = (
        f"χ = 1 would be a turn without slip. Points: {evidence.turns.found}, from what the rims rolled and the"
        f" reference turned (Wang 2015, Eqs. (13), (15), (25)). Lines: the models.{far}"
    )
    return section(name, title, drawn(chart), tag("p", caption, class_="caption"), charts=(chart,))


def consistency(evidence: Evidence) -> Section:
    """Whether predicted regions hold the share that they claim."""
    name, title = "consistency", "Whether the uncertainty is honest"
    chart = error_charts.coverage_chart(evidence)
    if chart is None:
        return left_out(name, title, "no drive whose reference tells poses.")
    found = WindowErrors.join([j.calibrated for j in evidence.judged]).distances.told()
    squared = found.squared
    regions = evidence.calibration.regions
    held = ""
    if regions is not None:
        shares = [f"{100 * regions.coverage(found, share):.0f} %" for share in (0.68, 0.95)]
        held = f" Regions that claim 68 % and 95 % hold {shares[0]} and {shares[1]} of them."
    own = (
        " The regions were fitted to these same windows at 68 % and 95 %: there they fit by themselves."
        if evidence.is_seen and regions is not None
        else ""
    )
    first = (
        f"NEES of {len(squared)} end poses: median {rounded(float(np.median(squared)), 2)} (2.4 expected), mean"
        f" {rounded(float(np.mean(squared)), 2)} (3 expected).{held}"
    )
    caption = (
        f"On the dotted line a region holds what it claims; above it is wider than need be, below it too small.{own}"
    )
    return section(name, title, first, drawn(chart), tag("p", caption, class_="caption"), charts=(chart,))
