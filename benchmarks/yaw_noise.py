"""Along what the error of the yaw grows: the likelihood of real drives. Writes docs/yaw-noise.md."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from models import DATA
from skidsteer.drive import Drive
from skidsteer.identify.calibrate import CalibrateOptions, settled
from skidsteer.identify.least_squares import fit_supported
from skidsteer.io.drives import load_drive
from skidsteer.kernels import roll
from skidsteer.models import ScheduledIcr
from skidsteer.noise import Noise, Residuals, Weights, deviance, fit_noise, residuals
from skidsteer.outliers import reweigh
from skidsteer.windows import increment_windows, linearize, steps

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "yaw-noise.md"
DRIVES = (
    *("warthog-asphalt-windows", "warthog-gravel-windows", "warthog-sand-windows", "husky-windows"),
    *("warthog-asphalt", "warthog-grass-a", "warthog-grass-b", "husky-mocap"),
)
SHARES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
TAKEN = roll.STRAIGHT
ROUNDS = 3  # of noise and weights in turn
TEXT = """# Along what the error of the yaw grows

Written by `make studies` (`benchmarks/yaw_noise.py`); nothing here is edited by hand.

The motion noise of the yaw grows along how far the sides roll apart, and a share of what they roll together
(`skidsteer.noise`). For shares from next to nothing to all of it: -2 ln likelihood of the increments of each drive less
that with the share taken, {taken:g}; scheduled_icr fitted with that share, the noise and the weights of outliers found
anew for each. Lower is likelier. In brackets: all weights one.

| drive | increments | {shares} |
|---|---|{rules}"""


def apart(drive: Drive) -> tuple[Residuals, np.ndarray, np.ndarray]:
    """Residuals of a fitted drive, and what the sides roll together and apart (k,) [m]."""
    options = settled([drive], CalibrateOptions())
    windows = increment_windows(drive, options.spacing or 0.0)
    found = fit_supported(ScheduledIcr.nominal(drive.vehicle), [drive], [windows], options.fit)
    cut = steps(drive.wheels, windows, found.timings[0])
    part = residuals(found.model, windows, cut, linearize(found.model, cut)[0])
    rolled = part.paths[:, 0]
    return part, rolled, (part.paths[:, 2] - TAKEN * rolled) / (1.0 - TAKEN)


def deviances(part: Residuals) -> tuple[float, float]:
    """-2 ln likelihood with outliers weighed down, and with all weights one."""
    noise, weights = Noise(), [Weights.ones(len(part.residual))]
    for _ in range(ROUNDS):
        noise = fit_noise([part], noise, weights)
        weights = reweigh([part], noise)
    return deviance([part], noise, weights), deviance([part], noise, [Weights.ones(len(part.residual))])


def main() -> None:
    lines = [TEXT.format(taken=TAKEN, shares=" | ".join(f"{s:g}" for s in SHARES), rules="---|" * len(SHARES))]
    for name in DRIVES:
        part, rolled, turned = apart(load_drive(DATA / name))
        told = []
        for share in SHARES:
            yaw = turned + share * (rolled - turned)
            told.append(deviances(replace(part, paths=np.stack([rolled, rolled, yaw], axis=1))))
        found = np.array(told) - told[SHARES.index(TAKEN)]
        cells = [f"{weighted:+.0f} ({plain:+.0f})" for weighted, plain in found]
        lines.append(f"| {name} | {len(rolled)} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    DOCUMENT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
