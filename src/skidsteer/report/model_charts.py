"""Charts of the model: where its ICRs lie on curves, and how the errors of its parameters correlate."""

from __future__ import annotations

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.errors import RequestError
from skidsteer.identify.circle_test import CoefficientFit, fit_coefficient
from skidsteer.models import MatrixModel, Model
from skidsteer.models.curvature import icr_coefficient
from skidsteer.report.chart import Chart, Json, axis, colour_bar, curve
from skidsteer.report.evidence import Evidence, Turns
from skidsteer.report.markup import chart_text
from skidsteer.se2 import FloatArray

MOST_TURNS = 2000  # shown
MOST_CURVATURE = 12.0  # lambda, above which a turn is nearly straight
DASHES = ("solid", "dash", "dot", "longdashdot")
SYMBOLS = ("circle", "square", "diamond", "cross", "triangle-up", "x")


def chi_of_model(model: Model, path_curvature: FloatArray, side: float, speed: float, track_width: float) -> FloatArray:
    """ICR coefficient (k,) of a model, Wang 2015, Eqs. (13), (15), on curves of lambda (k,) to one side.

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
    """Wang's Eq. (44) fitted to the turns; None where they do not determine it."""
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
    data.append(curve(x, np.ones_like(x), "nominal, no slip", "$nominal", "dot"))
    shipped = evidence.models.get("shipped")
    if shipped is not None:
        data.append(curve(x, chi_of_model(shipped, x, 1.0, speed, width), "as shipped", "$shipped", "dash"))
    data += _model_curves("calibrated", calibration.model, x, speed, width, "$calibrated", ("solid", "dashdot"))
    for i, (name, profile) in enumerate(calibration.profiles.items()):
        dash = DASHES[i % len(DASHES)]
        data += _model_curves(name, profile.model, x, speed, width, "$profile", (dash, dash))
    found = None if turns is None else wang_fit(turns)
    if found is not None:
        limit = ", at a limit" if found.at_bound else ""
        fitted = f"Wang 2015, Eq. (44): a = {found.a:.2f}, b = {found.b:.2f}{limit}"
        data.append(curve(x, icr_coefficient(x, found.a, found.b), fitted, "$muted", "longdash", 1.6))
    curves = [trace["y"] for trace in data if trace["mode"] == "lines"]
    high = max(float(np.max(curve)) for curve in curves)
    points = np.concatenate([np.array(trace) for trace in shown] or [np.ones(1)])
    high = max(high, 1.2, float(np.quantile(points, 0.98)))
    low = min(0.9, float(np.quantile(points, 0.02)))
    layout = {
        "xaxis": axis("|λ| = |v_l + v_r| / |v_r − v_l|   (0: on the spot)", range=[-0.3, MOST_CURVATURE]),
        "yaxis": axis("χ = ICR distance / track width", range=[max(low - 0.1, 0.0), min(high + 0.15, 6.0)]),
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
        keep = mine[np.linspace(0, len(mine) - 1, min(len(mine), MOST_TURNS)).astype(int)] if len(mine) else mine
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
        return [curve(x, left, label, colour, dashes[0])]
    return [
        curve(x, y, f"{label}, to the {side}", colour, dash)
        for y, side, dash in zip((left, right), ("left", "right"), dashes, strict=True)
    ]


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
        "colorbar": colour_bar("correlation"),
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
