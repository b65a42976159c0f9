"""How wrong a model is: held-out errors of all of them, errors over the operating point, regions that should hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import beta, chi2

from skidsteer.errors import RequestError
from skidsteer.figures.material import Material, held_out
from skidsteer.figures.observed import observe
from skidsteer.figures.sheet import BLUE, COLUMN, GREY, PAGE, VERMILION, blank
from skidsteer.metrics import WindowErrors
from skidsteer.se2 import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Sheet

KINDS = {"translation_m": "end position [m]", "yaw_deg": "end yaw [deg]"}
SHARES = np.linspace(0.02, 0.98, 49)


def draw_models(material: Material) -> Sheet:
    """Median, root mean square and 95 % quantile of the held-out errors of every model that was judged.

    Raises:
        RequestError: the calibration holds none.
    """
    from matplotlib.ticker import LogLocator, NullLocator

    held = material.calibration.held_out
    if not held:
        raise RequestError("figure 'models' shows held-out errors; this calibration has none: calibrate a longer drive")
    names = sorted(held, key=lambda name: -held[name].translation_m.rms)
    sheet = blank(COLUMN, 24.0 + 6.5 * len(names))
    panels = sheet.subplots(1, 2, sharey=True)
    for axes, (kind, label) in zip(panels, KINDS.items(), strict=True):
        for row, name in enumerate(names):
            spread = getattr(held[name], kind)
            colour = BLUE if name == material.calibration.model.NAME else GREY
            axes.plot([spread.median, spread.p95], [row, row], color=colour, linewidth=1.0)
            for value, mark in ((spread.median, "o"), (spread.rms, "s"), (spread.p95, "|")):
                axes.plot(value, row, mark, color=colour, markersize=4)
        axes.set(xscale="log", xlabel=label)
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.grid(False, axis="y")
    panels[0].set_yticks(range(len(names)), names)
    for mark, label in (("o", "median"), ("s", "RMS"), ("|", "95 %")):
        panels[0].plot([], [], mark, color=GREY, markersize=4, label=label)
    sheet.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return sheet


def draw_residuals(material: Material) -> Sheet:
    """Errors of the calibrated model over the operating point: where it fails."""
    known = material.reckoners("residuals")
    seen, words = observe(known, material), held_out(known)
    sheet = blank(PAGE, 66.0)
    panels = sheet.subplots(1, 2, sharex=True, sharey=True)
    sizes = (seen.translation, np.degrees(np.abs(seen.yaw)))
    for axes, size, label in zip(panels, sizes, KINDS.values(), strict=True):
        order = np.argsort(size)  # the worst on top
        v, omega = seen.predicted[order, 0], seen.predicted[order, 2]
        top = float(np.quantile(size, 0.95))
        dots = axes.scatter(v, omega, c=size[order], s=9, cmap="viridis_r", vmin=0.0, vmax=top, linewidths=0)
        sheet.colorbar(dots, ax=axes, label=f"error of the {label}{words}", extend="max")
        axes.set(xlabel="v [m/s]")
    panels[0].set(ylabel=r"$\omega$ [rad/s]")
    return sheet


def draw_coverage(material: Material) -> Sheet:
    """Share of end poses inside the predicted regions against the share these claim.

    Raises:
        RequestError: the calibration has no regions, or no window has a pose.
    """
    regions = material.calibration.regions
    if regions is None:
        raise RequestError("figure 'coverage' needs regions; this calibration has none: calibrate a longer drive")
    known = material.reckoners("coverage")
    found = WindowErrors.join([one.errors(material.window) for one in known]).distances.told()
    squared = found.squared
    if not len(squared):
        raise RequestError(f"figure 'coverage': no window of {material.window:g} s has a predicted region")
    sheet = blank(COLUMN, 78.0)
    axes = sheet.add_subplot()
    low, high = _chance(len(squared))
    axes.fill_between(100 * SHARES, 100 * low, 100 * high, color="#dddddd", linewidth=0, label="95 % of chance")
    axes.plot([0, 100], [0, 100], color=GREY, linewidth=0.8)
    gauss = np.array([np.mean(squared <= chi2.ppf(share, 3)) for share in SHARES])
    fitted = np.array([regions.coverage(found, share) for share in SHARES])
    axes.plot(100 * SHARES, 100 * gauss, color=VERMILION, linestyle=(0, (5, 1.5)), label="noise model, Gaussian")
    axes.plot(100 * SHARES, 100 * fitted, color=BLUE, label="regions, Student t")
    axes.set(
        xlabel="share that the region claims [%]",
        ylabel=f"share of {len(squared)} end poses inside{held_out(known)} [%]",
    )
    axes.set(xlim=(0, 100), ylim=(0, 100), aspect="equal")
    axes.legend(loc="upper left")
    return sheet


def _chance(count: int) -> tuple[FloatArray, FloatArray]:
    """Between which shares (k,) the hits of independent windows lie in 95 of 100 cases."""
    hits = count * SHARES
    low, high = (np.asarray(beta.ppf(q, hits + 0.5, count - hits + 0.5)) for q in (0.025, 0.975))
    return low, high
