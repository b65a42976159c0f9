"""Fit on even command steps, judge on odd ones: every model on the real window drives. Writes docs/models.md."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from skidsteer.calibration import Calibration, HeldOut
from skidsteer.drive import Drive
from skidsteer.evaluate import evaluate
from skidsteer.identify.calibrate import CalibrateOptions, calibrate
from skidsteer.io.drives import load_drive
from skidsteer.models import MODELS

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("SKIDSTEER_DATA", ROOT.parent / "shared" / "data"))
DRIVES = ("warthog-asphalt-windows", "warthog-gravel-windows", "warthog-sand-windows", "husky-windows")


def halves(drive: Drive) -> tuple[Drive, Drive]:
    """Even and odd command steps."""
    odd = np.asarray(drive.labels["calib_step"]) % 2 == 1
    return drive.with_segments(~odd), drive.with_segments(odd)


def judged(drive: Drive, model: str) -> tuple[Calibration, HeldOut]:
    even, odd = halves(drive)
    calibration = calibrate(even, options=CalibrateOptions(model=model))
    return calibration, evaluate(calibration, [odd]).total


def row(name: str, figures: HeldOut) -> str:
    gyro = "-" if figures.yaw_gyro_deg is None else f"{figures.yaw_gyro_deg.median:.2f}"
    cover = "-"
    if figures.coverage_68 is not None and figures.coverage_95 is not None:
        cover = f"{100 * figures.coverage_68:.0f} / {100 * figures.coverage_95:.0f}"
    t, y = figures.translation_m, figures.yaw_deg
    return f"| {name} | {t.median:.3f} ({t.rms:.2f}) | {y.median:.2f} ({y.rms:.1f}) | {gyro} | {cover} |"


def main() -> None:
    lines = [
        "# Models on real drives at speed",
        "",
        "Written by `make studies` (`benchmarks/models.py`); nothing here is edited by hand.",
        "",
        "Each model is calibrated on the even command steps of a window drive and judged on the odd ones, windows of",
        "2 s: median (RMS) error of the end position and of the yaw against the reference, median yaw error against",
        "the integrated gyro, and the share of end poses inside the predicted 68 % and 95 % regions. The stamps of",
        "the Warthog drives' reference scatter: that is the floor of the yaw column, not of the gyro's.",
    ]
    for name in DRIVES:
        drive = load_drive(DATA / name)
        lines += [
            "",
            f"## {name}",
            "",
            "| model | translation [m] | yaw [deg] | yaw, gyro [deg] | regions [%] |",
            "|---|---|---|---|---|",
        ]
        for model in [*MODELS, "auto"]:
            calibration, figures = judged(drive, model)
            lines.append(row(model if model != "auto" else f"auto: {calibration.model.NAME}", figures))
            print(name, lines[-1], flush=True)
            if model == "scheduled_icr":
                terms = ", ".join(
                    f"{n} {e.value:.3f} +- {e.sigma:.3f} {e.unit}".strip() for n, e in calibration.parameters.items()
                )
        lines += ["", f"scheduled_icr: {terms}."]
    (ROOT / "docs" / "models.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
