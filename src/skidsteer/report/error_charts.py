"""Charts of errors: held out, of every model; over speed and yaw rate; and against the predicted regions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from skidsteer.calibration import Calibration, HeldOut
from skidsteer.metrics import Spread, WindowErrors
from skidsteer.report.chart import Chart, Json, axis, colour_bar, curve
from skidsteer.report.evidence import Evidence, Judged
from skidsteer.report.markup import chart_text
from skidsteer.se2 import FloatArray

MOST_WINDOWS = 2000  # shown
WORST = 400  # of them, whatever the rest


# Held-out errors


def held_out_charts(calibration: Calibration) -> list[Chart]:
    """Median error of every model with its 95 % interval, and the RMS error: of the end position, and of the yaw."""
    window = calibration.provenance.options.get("window")
    titles = {
        "translation_m": f"end position after {window} s [m]",
        "yaw_deg": f"yaw after {window} s [°]",
        "yaw_gyro_deg": f"turn in {window} s against the gyro [°]",
    }
    wanted = [name for name in titles if any(spread_of(h, name) for h in calibration.held_out.values())]
    wanted = wanted[:2]  # the gyro where the reference has no yaw
    return [_held_out_chart(calibration, name, titles[name]) for name in wanted]


def spread_of(figures: HeldOut, name: str) -> Spread | None:
    """The errors of that name; None where unknown."""
    known: Spread | None = getattr(figures, name)
    return known if known is not None and np.isfinite(known.median) else None


def _held_out_chart(calibration: Calibration, name: str, title: str) -> Chart:
    names = list(calibration.held_out)[::-1]
    found = [
        (n, s, (calibration.held_out[n].median_95 or {}).get(name))
        for n in names
        if (s := spread_of(calibration.held_out[n], name))
    ]
    colours = [_colour(n, calibration.model.NAME) for n, _, _ in found]
    middle = [s.median for _, s, _ in found]
    ends = [(ci or (s.median, s.median)) for _, s, ci in found]
    bars = {
        "type": "data",
        "symmetric": False,
        "array": [high - m for m, (_, high) in zip(middle, ends, strict=True)],
        "arrayminus": [m - low for m, (low, _) in zip(middle, ends, strict=True)],
        "thickness": 2.5,
        "width": 0,
        "color": "$muted",
    }
    rows = [n for n, _, _ in found]
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": "RMS",
            "x": [s.rms for _, s, _ in found],
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
        "xaxis": axis(title, type="log", **_ticks([v for _, s, _ in found for v in (s.median, s.rms)])),
        "yaxis": {"automargin": True, "type": "category", "showgrid": False},
        "showlegend": False,
    }
    label = "; ".join(f"{n}: median {s.median:.3g}, RMS {s.rms:.3g}" for n, s, _ in found[::-1])
    return Chart(f"held-{name.replace('_', '-')}", data, layout, f"Error of the {title}. {label}", 90 + 34 * len(found))


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
    known = np.isfinite(size)
    table = np.stack([judged.v, judged.omega, size, judged.calibrated.start], axis=1)
    return np.asarray(table[known])


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
        "colorbar": colour_bar(title),
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
    layout = {"xaxis": axis("v [m/s]"), "yaxis": axis("ω [rad/s]"), "showlegend": False}
    worst = rows[int(np.argmax(rows[:, 2]))]
    where_worst = f"largest {worst[2]:.3g} at {worst[0]:.2f} m/s, {worst[1]:.2f} rad/s"
    label = f"{title} over v and omega, {len(rows)} windows; {where_worst}"
    return Chart(name, [data], layout, label, 360)


def worst_and_some(size: FloatArray, most: int, worst: int) -> np.ndarray:
    """Indices of at most ``most`` of sizes (k,): the ``worst`` largest, and an even choice of the others."""
    if len(size) <= most:
        return np.arange(len(size))
    order = np.argsort(size, kind="stable")
    rest = order[: len(size) - worst]
    some = rest[np.linspace(0, len(rest) - 1, most - worst).astype(int)]
    return np.sort(np.concatenate([some, order[len(size) - worst :]]))


# Consistency


def coverage_chart(evidence: Evidence) -> Chart | None:
    """Share of end poses inside the predicted regions against the share that these claim."""
    found = WindowErrors.join([j.calibrated for j in evidence.judged]).distances.told()
    squared = found.squared
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
        held = _shares(found.allowing(regions.turning), limits)
        data.append(_share("regions of the calibration", claimed, held, "$calibrated", "solid"))
    layout = {
        "xaxis": axis("claimed share [%]", range=[0, 100]),
        "yaxis": axis("end poses inside [%]", range=[0, 101]),
        "legend": {"orientation": "h", "y": -0.22},
    }
    label = f"Share of {len(squared)} end poses inside regions against the share that they claim"
    return Chart("coverage", data, layout, label, 400)


def _shares(squared: FloatArray, limits: FloatArray) -> FloatArray:
    return np.asarray(np.searchsorted(np.sort(squared), limits, side="right") / len(squared))


def _share(name: str, claimed: FloatArray, held: FloatArray, colour: str, dash: str) -> Json:
    trace = curve(100.0 * claimed, 100.0 * held, name, colour, dash)
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
