"""Charts as plain dictionaries for Plotly; colours are words ("$calibrated") that the page's theme gives a meaning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from skidsteer.calibration import Calibration, HeldOut
from skidsteer.errors import RequestError
from skidsteer.identify.circle_test import CoefficientFit, fit_coefficient
from skidsteer.metrics import Spread
from skidsteer.models import MatrixModel, Model
from skidsteer.models.curvature import icr_coefficient
from skidsteer.report.evidence import Evidence, Judged, Turns
from skidsteer.report.markup import chart_text
from skidsteer.se2 import FloatArray

Json = dict[str, Any]

MOST_WINDOWS = 2000  # shown
WORST = 400  # of them, whatever the rest
MOST_CURVATURE = 12.0  # lambda, above which a turn is nearly straight
DASHES = ("solid", "dash", "dot", "longdashdot")
SYMBOLS = ("circle", "square", "diamond", "cross", "triangle-up", "x")


@dataclass(frozen=True, slots=True)
class Chart:
    """One chart: traces and layout for Plotly, its height [px], and what it shows for those who cannot see it."""

    name: str
    data: list[Json]
    layout: Json
    label: str
    height: int = 340

    @property
    def figure(self) -> Json:
        """What the page draws."""
        return {"data": self.data, "layout": self.layout}


def _axis(title: str, **words: Any) -> Json:
    return {"title": {"text": title}, **words}


def _colour_bar(title: str) -> Json:
    font = {"size": 13, "color": "$muted"}
    return {"title": {"text": title, "side": "right", "font": font}, "thickness": 12, "outlinewidth": 0}


# Held-out errors


def held_out_charts(calibration: Calibration) -> list[Chart]:
    """Median error of every model with its 95 % interval, and the RMS error: of the end position, and of the yaw."""
    window = calibration.provenance.options.get("window")
    titles = {
        "translation_m": f"end position after {window} s [m]",
        "yaw_deg": f"yaw after {window} s [°]",
        "yaw_gyro_deg": f"turn in {window} s against the gyro [°]",
    }
    wanted = [name for name in titles if any(_is_told(h, name) for h in calibration.held_out.values())]
    wanted = wanted[:2]  # the gyro where the reference tells no yaw
    return [_held_out_chart(calibration, name, titles[name]) for name in wanted]


def spread_of(figures: HeldOut, name: str) -> Spread | None:
    """The errors of that name; None where they are not known."""
    known: Spread | None = getattr(figures, name)
    return known if known is not None and np.isfinite(known.median) else None


def _is_told(figures: HeldOut, name: str) -> bool:
    return spread_of(figures, name) is not None


def _held_out_chart(calibration: Calibration, name: str, title: str) -> Chart:
    names = list(calibration.held_out)[::-1]
    told = [
        (n, s, (calibration.held_out[n].median_95 or {}).get(name))
        for n in names
        if (s := spread_of(calibration.held_out[n], name))
    ]
    colours = [_colour(n, calibration.model.NAME) for n, _, _ in told]
    middle = [s.median for _, s, _ in told]
    ends = [(ci or (s.median, s.median)) for _, s, ci in told]
    bars = {
        "type": "data",
        "symmetric": False,
        "array": [high - m for m, (_, high) in zip(middle, ends, strict=True)],
        "arrayminus": [m - low for m, (low, _) in zip(middle, ends, strict=True)],
        "thickness": 2.5,
        "width": 0,
        "color": "$muted",
    }
    rows = [n for n, _, _ in told]
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": "RMS",
            "x": [s.rms for _, s, _ in told],
            "y": rows,
            "marker": {"symbol": "diamond-open", "size": 9, "color": colours, "line": {"width": 1.6}},
            "hovertemplate": "%{y}: RMS %{x:.3g}<extra></extra>",
        },
        {
            "type": "scatter",
            "mode": "markers",
            "name": "median and its 95 % interval",
            "x": middle,
            "y": rows,
            "error_x": bars,
            "marker": {"size": 11, "color": colours},
            "hovertemplate": "%{y}: median %{x:.3g}<extra></extra>",
        },
    ]
    layout = {
        "xaxis": _axis(title, type="log", **_ticks([v for _, s, _ in told for v in (s.median, s.rms)])),
        "yaxis": {"automargin": True, "type": "category", "showgrid": False},
        "showlegend": False,
    }
    label = "; ".join(f"{n}: median {s.median:.3g}, RMS {s.rms:.3g}" for n, s, _ in told[::-1])
    return Chart(f"held-{name.replace('_', '-')}", data, layout, f"Error of the {title}. {label}", 90 + 34 * len(told))


def _ticks(values: Sequence[float]) -> Json:
    """Ticks at 1, 2, 5 of each decade that positive values reach; at 1 of many decades."""
    positive = [v for v in values if v > 0.0]
    if not positive:
        return {}
    low, high = np.floor(np.log10(min(positive))), np.ceil(np.log10(max(positive)))
    steps = (1.0, 2.0, 5.0) if high - low <= 3 else (1.0,)
    ticks = [step * 10.0**power for power in np.arange(low, high + 1) for step in steps]
    return {"tickmode": "array", "tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}


def _colour(name: str, chosen: str) -> str:
    return "$calibrated" if name == chosen else "$nominal" if name == "differential" else "$muted"


# Where the model fails


def residual_charts(evidence: Evidence) -> list[Chart]:
    """Errors of the calibrated model in the plane of speed and yaw rate: of the end position, and of the yaw."""
    kinds = {"translation": ("position error [m]", 1.0), "yaw": ("yaw error [°]", 180.0 / np.pi)}
    if not any(np.isfinite(j.calibrated.yaw).any() for j in evidence.judged):
        kinds = {"translation": kinds["translation"], "yaw_gyro": ("turn error against the gyro [°]", 180.0 / np.pi)}
    charts = []
    for name, (title, factor) in kinds.items():
        rows = np.concatenate([_rows(j, name, factor) for j in evidence.judged] or [np.zeros((0, 4))])
        if len(rows):
            names = [j.drive for j in evidence.judged for _ in _rows(j, name, factor)]
            charts.append(_residual_chart(f"residual-{name}", title, rows, names))
    return charts


def _rows(judged: Judged, name: str, factor: float) -> FloatArray:
    """Rows (k, 4) of v, omega, size of the error, start of the window."""
    size = factor * np.abs(getattr(judged.calibrated, name))
    told = np.isfinite(size)
    table = np.stack([judged.v, judged.omega, size, judged.calibrated.start], axis=1)
    return np.asarray(table[told])


def _residual_chart(name: str, title: str, rows: FloatArray, drives: list[str]) -> Chart:
    keep = worst_and_some(rows[:, 2], MOST_WINDOWS, WORST)
    keep = keep[np.argsort(rows[keep, 2], kind="stable")]  # the worst on top
    v, omega, size, start = rows[keep].T
    several = len(set(drives)) > 1
    where = [
        f"{chart_text(drives[i]) + ', ' if several else ''}t = {t:.1f} s" for i, t in zip(keep, start, strict=True)
    ]
    top = float(np.quantile(rows[:, 2], 0.98)) or 1.0
    marker = {
        "color": np.round(size, 4).tolist(),
        "colorscale": "$sequential",
        "cmin": 0.0,
        "cmax": top,
        "size": np.round(5.0 + 11.0 * np.sqrt(np.minimum(size / top, 2.0)), 1).tolist(),
        "opacity": 0.85,
        "line": {"width": 0.5, "color": "$paper"},
        "colorbar": _colour_bar(title),
    }
    data = {
        "type": "scatter",
        "mode": "markers",
        "x": np.round(v, 3).tolist(),
        "y": np.round(omega, 3).tolist(),
        "text": where,
        "marker": marker,
        "hovertemplate": "v %{x} m/s, ω %{y} rad/s<br>error %{marker.color:.3g}<br>%{text}<extra></extra>",
    }
    layout = {"xaxis": _axis("v [m/s]"), "yaxis": _axis("ω [rad/s]"), "showlegend": False}
    worst = rows[int(np.argmax(rows[:, 2]))]
    where_worst = f"largest {worst[2]:.3g} at {worst[0]:.2f} m/s, {worst[1]:.2f} rad/s"
    label = f"{title} over v and omega, {len(rows)} windows; {where_worst}"
    return Chart(name, [data], layout, label, 360)


def worst_and_some(size: FloatArray, most: int, worst: int) -> np.ndarray:
    """Indices of at most ``most`` of sizes (k,): the ``worst`` largest, and of the others evenly many."""
    if len(size) <= most:
        return np.arange(len(size))
    order = np.argsort(size, kind="stable")
    rest = order[: len(size) - worst]
    some = rest[np.linspace(0, len(rest) - 1, most - worst).astype(int)]
    return np.sort(np.concatenate([some, order[len(size) - worst :]]))


# Chi against lambda


def chi_of_model(model: Model, path_curvature: FloatArray, side: float, speed: float, track_width: float) -> FloatArray:
    """ICR coefficient (k,) of Wang 2015, Eqs. (13), (15), that a model has on curves of lambda (k,) to one side.

    Args:
        model: any.
        path_curvature: lambda, at least 0.
        side: 1 to the left, -1 to the right.
        speed: [m/s] of the outer rim.
        track_width: [m].
    """
    apart = 2.0 * speed / (path_curvature + 1.0)
    middle = 0.5 * path_curvature * apart
    left, right = middle - 0.5 * side * apart, middle + 0.5 * side * apart
    return np.asarray((right - left) / (model.twist(left, right)[:, 2] * track_width))


def wang_fit(turns: Turns) -> CoefficientFit | None:
    """Wang's Eq. (44) through the turns that are no straights; None where they cannot tell it."""
    inside = (np.abs(turns.path_curvature) <= MOST_CURVATURE) & (turns.chi > 0.0)
    try:
        found = fit_coefficient(turns.path_curvature[inside], turns.chi[inside])
    except RequestError:
        return None
    return found if found.converged else None


def chi_chart(evidence: Evidence) -> Chart | None:
    """Turns measured, and chi of the models against the size of lambda."""
    calibration, turns = evidence.calibration, evidence.turns
    width, speed = calibration.vehicle.track_width, evidence.speed or 0.5
    x = np.linspace(0.0, MOST_CURVATURE, 97)
    data = [] if turns is None else _turn_traces(turns)
    shown = [trace["y"] for trace in data]
    data.append(_curve(x, np.ones_like(x), "nominal, no slip", "$nominal", "dot"))
    shipped = evidence.models.get("shipped")
    if shipped is not None:
        data.append(_curve(x, chi_of_model(shipped, x, 1.0, speed, width), "as shipped", "$shipped", "dash"))
    data += _model_curves("calibrated", calibration.model, x, speed, width, "$calibrated", ("solid", "dashdot"))
    for i, (name, profile) in enumerate(calibration.profiles.items()):
        dash = DASHES[i % len(DASHES)]
        data += _model_curves(name, profile.model, x, speed, width, "$profile", (dash, dash))
    found = None if turns is None else wang_fit(turns)
    if found is not None:
        limit = ", at a limit" if found.at_bound else ""
        fitted = f"Eq. (44) of Wang 2015 through them: a = {found.a:.2f}, b = {found.b:.2f}{limit}"
        data.append(_curve(x, icr_coefficient(x, found.a, found.b), fitted, "$muted", "longdash", 1.6))
    curves = [trace["y"] for trace in data if trace["mode"] == "lines"]
    high = max(float(np.max(curve)) for curve in curves)
    points = np.concatenate([np.array(trace) for trace in shown] or [np.ones(1)])
    high = max(high, 1.2, float(np.quantile(points, 0.98)))
    low = min(0.9, float(np.quantile(points, 0.02)))
    layout = {
        "xaxis": _axis("|λ| = |v_l + v_r| / |v_r − v_l|   (0: on the spot)", range=[-0.3, MOST_CURVATURE]),
        "yaxis": _axis("χ = ICR distance / track width", range=[max(low - 0.1, 0.0), min(high + 0.15, 6.0)]),
        "legend": {"orientation": "h", "y": -0.22},
    }
    count = 0 if turns is None else len(turns.chi)
    return Chart("chi", data, layout, f"ICR coefficient over path curvature: {count} turns and the models' curves", 430)


def _turn_traces(turns: Turns) -> list[Json]:
    names = list(dict.fromkeys(turns.group))
    group = np.array(turns.group)
    inside = (np.abs(turns.path_curvature) <= MOST_CURVATURE) & (turns.chi > 0.0)
    traces = []
    for i, name in enumerate(names):
        mine = np.flatnonzero((group == name) & inside)
        keep = mine[np.linspace(0, len(mine) - 1, min(len(mine), MOST_WINDOWS)).astype(int)] if len(mine) else mine
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": chart_text(name if len(names) > 1 else turns.found),
                "x": np.round(np.abs(turns.path_curvature[keep]), 4).tolist(),
                "y": np.round(turns.chi[keep], 4).tolist(),
                "marker": {
                    "symbol": SYMBOLS[i % len(SYMBOLS)],
                    "size": 7,
                    "color": "$reference",
                    "opacity": 0.45 if len(turns.chi) > 60 else 0.75,
                },
                "hovertemplate": "λ %{x:.2f}, χ %{y:.3f}<extra></extra>",
            }
        )
    return traces


def _model_curves(
    name: str, model: Model, x: FloatArray, speed: float, width: float, colour: str, dashes: tuple[str, str]
) -> list[Json]:
    """Chi of a model; to the left and to the right where that differs."""
    left, right = (chi_of_model(model, x, side, speed, width) for side in (1.0, -1.0))
    label = chart_text(name) + ("" if isinstance(model, MatrixModel) else f" at {speed:.2g} m/s")
    if np.allclose(left, right, rtol=5e-3):
        return [_curve(x, left, label, colour, dashes[0])]
    return [
        _curve(x, y, f"{label}, to the {side}", colour, dash)
        for y, side, dash in zip((left, right), ("left", "right"), dashes, strict=True)
    ]


def _curve(x: FloatArray, y: FloatArray, name: str, colour: str, dash: str, width: float = 2.4) -> Json:
    line = {"color": colour, "dash": dash, "width": width}
    values = {"x": np.round(x, 3).tolist(), "y": np.round(y, 4).tolist()}
    return {"type": "scatter", "mode": "lines", "name": name, **values, "line": line, "hoverinfo": "skip"}


# Correlations


def correlation_chart(calibration: Calibration) -> Chart | None:
    """Correlation of the errors of all that was estimated; None where there is none."""
    sigma = np.sqrt(np.diag(calibration.covariance))
    free = np.flatnonzero(sigma > 0.0)
    if len(free) < 2:
        return None
    R = calibration.covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    if np.abs(R - np.eye(len(R))).max() < 0.005:
        return None
    names = [chart_text(calibration.names[i]) for i in free]
    below = np.tril(np.ones_like(R, bool), -1)
    z = np.where(below, np.round(R, 2), np.nan)[1:, :-1]
    size = len(names)
    data = {
        "type": "heatmap",
        "x": names[:-1],
        "y": names[1:],
        "z": [[None if np.isnan(v) else float(v) for v in row] for row in z],
        "zmin": -1.0,
        "zmax": 1.0,
        "colorscale": "$diverging",
        "xgap": 2,
        "ygap": 2,
        "hoverongaps": False,
        "colorbar": _colour_bar("correlation"),
        "hovertemplate": "%{y} and %{x}: %{z:.2f}<extra></extra>",
        "texttemplate": "%{z:.2f}" if size <= 12 else "",
    }
    layout = {
        "xaxis": {"showgrid": False, "tickangle": -45, "automargin": True, "type": "category"},
        "yaxis": {"showgrid": False, "automargin": True, "autorange": "reversed", "type": "category"},
    }
    i, j = np.unravel_index(int(np.argmax(np.abs(np.where(below, R, 0.0)))), R.shape)
    label = f"Correlations of {size} numbers; the largest is {R[i, j]:.2f}, of {names[i]} and {names[j]}"
    return Chart("correlation", [data], layout, label, max(320, 110 + 30 * size))


# Consistency


def coverage_chart(evidence: Evidence) -> Chart | None:
    """Share of end poses inside the predicted regions against the share that these claim."""
    squared = np.concatenate([j.calibrated.squared for j in evidence.judged] or [np.zeros(0)])
    squared = squared[np.isfinite(squared)]
    if len(squared) < 5:
        return None
    claimed = np.linspace(0.02, 0.99, 98)
    band = 1.96 * np.sqrt(claimed * (1.0 - claimed) / len(squared))
    data = [
        _band(claimed, band),
        _share("claim kept", claimed, claimed, "$muted", "dot"),
        _share("noise and parameters alone", claimed, _shares(squared, chi2.ppf(claimed, 3)), "$ink", "dash"),
    ]
    regions = evidence.calibration.regions
    if regions is not None:
        limits = np.array([regions.limit(float(share)) for share in claimed])
        data.append(_share("regions of the calibration", claimed, _shares(squared, limits), "$calibrated", "solid"))
    layout = {
        "xaxis": _axis("claimed share [%]", range=[0, 100]),
        "yaxis": _axis("end poses inside [%]", range=[0, 101]),
        "legend": {"orientation": "h", "y": -0.22},
    }
    label = f"Share of {len(squared)} end poses inside regions against the share that they claim"
    return Chart("coverage", data, layout, label, 400)


def _shares(squared: FloatArray, limits: FloatArray) -> FloatArray:
    return np.asarray(np.searchsorted(np.sort(squared), limits, side="right") / len(squared))


def _share(name: str, claimed: FloatArray, held: FloatArray, colour: str, dash: str) -> Json:
    trace = _curve(100.0 * claimed, 100.0 * held, name, colour, dash)
    return {**trace, "hoverinfo": "all", "hovertemplate": "claims %{x:.0f} %, holds %{y:.0f} %<extra></extra>"}


def _band(claimed: FloatArray, band: FloatArray) -> Json:
    x = np.concatenate([claimed, claimed[::-1]])
    y = np.concatenate([claimed - band, (claimed + band)[::-1]])
    return {
        "type": "scatter",
        "mode": "lines",
        "name": "95 % scatter of so many windows",
        "x": np.round(100.0 * x, 2).tolist(),
        "y": np.round(100.0 * np.clip(y, 0.0, 1.0), 2).tolist(),
        "fill": "toself",
        "fillcolor": "$band",
        "line": {"width": 0, "color": "$band"},
        "hoverinfo": "skip",
    }


def charts(parts: Sequence[Chart | None]) -> Mapping[str, Json]:
    """The figures of charts by name."""
    return {chart.name: chart.figure for chart in parts if chart is not None}
