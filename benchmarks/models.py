"""Every model on the real window drives, fitted on one half of the command steps and judged on the other.

Writes docs/models.md; the rivals are in ``rivals.py``.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rivals import SlipRegression, gaussian_process
from skidsteer.calibration import Calibration, HeldOut
from skidsteer.drive import Drive
from skidsteer.gyro import GyroErrors, Turn
from skidsteer.identify.calibrate import CalibrateOptions, calibrate
from skidsteer.identify.least_squares import FitOptions, fit
from skidsteer.identify.select import Excess, excess
from skidsteer.io.drives import load_drive
from skidsteer.metrics import WindowErrors, window_errors
from skidsteer.models import MODELS, Icr, Model
from skidsteer.se2 import wrap
from skidsteer.windows import Timing, increment_windows, judging_windows

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("SKIDSTEER_DATA", ROOT.parent / "shared" / "data"))
DRIVES = ("warthog-asphalt-windows", "warthog-gravel-windows", "warthog-sand-windows", "husky-windows")
TEXT = """# Models on real drives at speed

Written by `make studies` (`benchmarks/models.py`); nothing here is edited by hand.

Each model is fitted on one half of the command steps of a drive of 2 s windows and judged on the other: median (RMS)
error of the end position and of the yaw against the reference, median yaw error against the integrated gyro, share of
end poses inside the predicted 68 % and 95 % regions. *auto* is what `skidsteer calibrate` chooses by the fitted half
alone. Below each table: error of the rivals over that of *auto*, both halves together, with 95 % intervals of a paired
test over windows.

*slip regression* is the form that DRIVE (Baril et al. 2023) fits by linear regression: five weights of v, omega and
v omega on the twist of the nominal differential drive, here with our lag, time offset and outlier weights, which it
lacks. *Gaussian process* learns what the constant ICR leaves as a function of v and omega (scikit-learn, squared
exponential kernel, length scales and noise by marginal likelihood). *gyro itself* is no model: it is the yaw that the
integrated gyro tells, with the time offset that suits the judged half best. The stamps of these references scatter:
no model can be expected to come much nearer to the reference's yaw than the gyro does.
"""


@dataclass(frozen=True, slots=True)
class Judged:
    """Errors on the odd and on the even half, and the regions that were claimed."""

    odd: WindowErrors
    even: WindowErrors
    figures: tuple[HeldOut, HeldOut]

    @property
    def both(self) -> WindowErrors:
        return WindowErrors.join([self.odd, self.even])


def halves(drive: Drive) -> tuple[Drive, Drive]:
    """Even and odd command steps."""
    odd = np.asarray(drive.labels["calib_step"]) % 2 == 1
    return drive.with_segments(~odd), drive.with_segments(odd)


def ours(name: str, fitted: Drive, judged: Drive) -> tuple[Calibration, WindowErrors, HeldOut]:
    calibration = calibrate(fitted, options=CalibrateOptions(model=name))
    known = (calibration.model, judged, calibration.timing)
    errors = window_errors(*known, mount=calibration.mount, uncertainty=calibration.uncertainty)
    return calibration, errors, HeldOut.of(errors, calibration.regions)


def rivals(fitted: Drive) -> dict[str, tuple[Model, Timing]]:
    """Models of others, fitted to a drive."""
    windows = [increment_windows(fitted)]
    regression = fit(SlipRegression.nominal(fitted.vehicle), [fitted], windows, FitOptions())
    constant = fit(Icr.nominal(fitted.vehicle), [fitted], windows, FitOptions())
    return {
        "slip regression": (regression.model, regression.timings[0]),
        "Gaussian process": (gaussian_process(constant, fitted), constant.timings[0]),
    }


def gyro_itself(drive: Drive) -> float:
    """Median error [deg] of the gyro's turn against the reference's, at the best of all time offsets."""
    assert drive.gyro is not None
    windows, turn = judging_windows(drive), Turn.of(drive.gyro)
    told = [turn.between(windows.start, windows.end, GyroErrors(offset)) for offset in np.arange(-1.5, 1.0, 0.02)]
    return float(np.degrees(min(np.median(np.abs(wrap(t - windows.motion[:, 2]))) for t in told)))


def cells(figures: HeldOut) -> str:
    gyro = "-" if figures.yaw_gyro_deg is None else f"{figures.yaw_gyro_deg.median:.2f}"
    cover = "-"
    if figures.coverage_68 is not None and figures.coverage_95 is not None:
        cover = f"{100 * figures.coverage_68:.0f} / {100 * figures.coverage_95:.0f}"
    t, y = figures.translation_m, figures.yaw_deg
    return f"{t.median:.3f} ({t.rms:.2f}) | {y.median:.2f} ({y.rms:.1f}) | {gyro} | {cover}"


def against(name: str, rival: Judged, own: Judged) -> str:
    """One line: errors of a rival over ours."""
    a, b = rival.both, own.both
    number = np.arange(len(a))
    pairs = (("translation", a.translation, b.translation), ("yaw", a.yaw, b.yaw), ("gyro", a.yaw_gyro, b.yaw_gyro))
    told = [f"{what} {_interval(excess(x, y, number))}" for what, x, y in pairs]
    return f"- {name} over auto: {', '.join(told)}"


def _interval(found: Excess | None) -> str:
    if found is None:
        return "-"
    return f"{1.0 + found.share:.2f} [{1.0 + found.low:.2f}, {1.0 + found.high:.2f}]"


def study(name: str) -> list[str]:
    """The section of one drive."""
    even, odd = halves(load_drive(DATA / name))
    results: dict[str, Judged] = {}
    rows, terms = {}, ""
    for model in [*MODELS, "auto"]:
        forward, on_odd, figures_odd = ours(model, even, odd)
        back, on_even, figures_even = ours(model, odd, even)
        results[model] = Judged(on_odd, on_even, (figures_odd, figures_even))
        rows[model] = model
        if model == "auto":
            rows[model] = f"auto: {forward.model.NAME}, {back.model.NAME}"
        if model == "scheduled_icr":
            estimates = forward.parameters.items()
            terms = ", ".join(f"{n} {e.value:.3f} +- {e.sigma:.3f} {e.unit}".strip() for n, e in estimates)
        print(name, model, cells(figures_odd), "//", cells(figures_even), flush=True)
    on_odd_by, on_even_by = rivals(even), rivals(odd)
    for rival in on_odd_by:
        parts = [window_errors(on_odd_by[rival][0], odd, on_odd_by[rival][1])]
        parts.append(window_errors(on_even_by[rival][0], even, on_even_by[rival][1]))
        results[rival] = Judged(*parts, (HeldOut.of(parts[0]), HeldOut.of(parts[1])))
        rows[rival] = f"*{rival}*"
        print(name, rival, *map(cells, results[rival].figures), flush=True)
    head = "| model | translation [m] | yaw [deg] | yaw, gyro [deg] | regions [%] |"
    lines = ["", f"## {name}"]
    for i, title in enumerate(("fitted on even, judged on odd steps", "fitted on odd, judged on even steps")):
        lines += ["", f"{title}:", "", head, "|---|---|---|---|---|"]
        lines += [f"| {rows[key]} | {cells(results[key].figures[i])} |" for key in results]
        lines += [f"| *gyro itself* | - | {gyro_itself((odd, even)[i]):.2f} | - | - |"]
    compared = [against(key, results[key], results["auto"]) for key in ("icr", *on_odd_by)]
    return [*lines, "", *compared, "", f"scheduled_icr of the even steps: {terms}."]


def main() -> None:
    lines = [TEXT.rstrip()]
    for name in DRIVES:
        lines += study(name)
    (ROOT / "docs" / "models.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
