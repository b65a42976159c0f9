"""How the ICRs move: chi over the path's lambda, and ICRs over the speed, measured and by the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from skidsteer.figures.material import Material
from skidsteer.figures.observed import Observed, binned, coefficient, icrs, observe
from skidsteer.figures.sheet import BLUE, COLUMN, GREEN, GREY, VERMILION, blank
from skidsteer.identify.circle_test import fit_coefficient
from skidsteer.models.curvature import icr_coefficient
from skidsteer.se2 import FloatArray
from skidsteer.terramechanics.steady_turn import rims_on_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Sheet

WIDEST = 8.0  # lambda, beyond which the turn is too little to tell chi
LEAST_RUNS = 20  # windows, for the curve of Wang 2015, Eq. (44)
NAMES = ("icr_x", "icr_y_left", "icr_y_right")


def draw_chi_lambda(material: Material) -> Sheet:
    """Chi of the windows that turn over lambda, with quartiles, the model, and Wang's curve fitted to them."""
    seen = observe(material.reckoners("chi-lambda"), material, turning=True)
    ratio = np.abs(seen.path_curvature)
    seen, ratio = seen.where(ratio <= WIDEST), ratio[ratio <= WIDEST]
    model, width = material.calibration.model, material.calibration.vehicle.track_width
    chi = coefficient(seen.rims, seen.measured[:, 2], model, width)
    sheet = blank()
    axes = sheet.add_subplot()
    _points(axes, ratio, chi, "windows")
    x = np.linspace(0.0, float(ratio.max()), 101)
    axes.plot(x, _model_chi(material, seen, x), color=BLUE, label=f"model {model.NAME}")
    if len(chi) >= LEAST_RUNS:
        typical = binned(ratio, chi)
        fit = fit_coefficient(typical.x, typical.median)
        axes.plot(x, icr_coefficient(x, fit.a, fit.b), color=GREEN, linestyle=(0, (1.2, 1.2)), label="Wang, Eq. (44)")
    axes.axhline(1.0, color=GREY, linewidth=0.8, linestyle=(0, (2, 2)))
    axes.annotate("no slip", (0.0, 1.0), (0, 2), textcoords="offset points", color=GREY)
    axes.set(
        xlabel=r"$|\lambda|$: path radius over half the ICR distance [-]", ylabel=r"$\chi$: ICR distance over track [-]"
    )
    axes.set_ylim(*_frame(chi, 1.0))
    axes.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return sheet


def _model_chi(material: Material, seen: Observed, ratio: FloatArray) -> FloatArray:
    """Chi of the model in steady turns at the median speed of the faster rim."""
    rims = rims_on_path(ratio, 1.0)
    rims *= np.median(np.abs(seen.rims).max(axis=1)) / np.abs(rims).max(axis=1, keepdims=True)
    model, width = material.calibration.model, material.calibration.vehicle.track_width
    return coefficient(rims, model.twist(rims[:, 0], rims[:, 1])[:, 2], model, width)


def draw_icr_speed(material: Material) -> Sheet:
    """The three coordinates of the ICRs over the speed: of the windows that turn, and as the model has them there."""
    seen = observe(material.reckoners("icr-speed"), material, turning=True)
    model = material.calibration.model
    measured, predicted = (icrs(seen.rims, twist, model) for twist in (seen.measured, seen.predicted))
    speed = seen.rims.mean(axis=1)
    sheet = blank(COLUMN, 96.0)
    for i, (axes, name) in enumerate(zip(sheet.subplots(3, 1, sharex=True), NAMES, strict=True)):
        _points(axes, speed, measured[:, i], "windows")
        there = binned(speed, predicted[:, i])
        axes.plot(there.x, there.median, color=BLUE, marker="s", label=f"model {model.NAME}")
        axes.set(ylabel=f"{name} [m]", ylim=_frame(measured[:, i], float(np.median(predicted[:, i]))))
    axes.set(xlabel="mean rim speed [m/s]")
    sheet.axes[0].legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return sheet


def _points(axes: Axes, x: FloatArray, y: FloatArray, label: str) -> None:
    axes.plot(x, y, ".", color="#bbbbbb", markersize=3, zorder=1.5)
    there = binned(x, y)
    bars = [there.median - there.low, there.high - there.median]
    axes.errorbar(there.x, there.median, yerr=bars, color=VERMILION, fmt="o", capsize=2, label=f"{label}, quartiles")


def _frame(y: FloatArray, also: float) -> tuple[float, float]:
    """Limits around the middle 80 % of y (n,), and another value: noise divided by a small turn goes far."""
    low, high = np.quantile(y, [0.1, 0.9])
    low, high = min(low, also), max(high, also)
    margin = 0.25 * (high - low)
    return float(low - margin), float(high + margin)
