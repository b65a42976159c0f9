"""Study of the test whether grounds differ, in simulation and on real grounds; writes docs/terrains.md."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import binom

from skidsteer.drive import Drive
from skidsteer.identify.least_squares import fit
from skidsteer.identify.terrain import Terrains, compare_terrains, wald_test
from skidsteer.io.drives import load_drive
from skidsteer.models import Differential, Icr
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import preset
from skidsteer.windows import increment_windows

VEHICLE = preset("pioneer-p3at")
TRUTH = Icr(0.2553, -0.3071, -0.0120, 0.9271, 0.9049)  # Mandow 2007, Table I, asphalt
SENSORS = Sensors(position_sigma=0.01, yaw_sigma=float(np.radians(0.5)), reference_delay=0.15)
MOTION_NOISE = (0.004, 0.008)
SEEDS, POWER_SEEDS = 200, 60
LEVEL = 0.05
WIDER = (0.005, 0.01, 0.02, 0.05)  # shares by which the ICR distance of the other ground is larger
REAL = ("warthog-asphalt-windows", "warthog-gravel-windows", "warthog-sand-windows")
SAME = ("warthog-grass-a", "warthog-grass-b")


def plan(seed: int) -> np.ndarray:
    """Half a minute of legs of random speeds and turns: rows of duration, v, omega."""
    rng = np.random.default_rng(seed)
    rows = [[2.0, rng.uniform(-0.4, 0.6), rng.uniform(-0.8, 0.8)] for _ in range(16)]
    return np.array([[1.0, 0.0, 0.0], *rows, [1.0, 0.0, 0.0]])


def simulated(truth: Icr, seed: int) -> Drive:
    """A drive of its own plan and noise."""
    rims = rims_from_manoeuvres(plan(seed), Differential(VEHICLE.track_width), rate=50.0)
    return kinematic_drive(f"drive-{seed}", VEHICLE, truth, rims, SENSORS, 0.08, MOTION_NOISE, seed)


def p_values(wider: float, seeds: int) -> np.ndarray:
    """Of the test on two drives each, the second on a ground where the ICR distance is larger by a share."""
    other = replace(TRUTH, icr_y_left=TRUTH.icr_y_left * (1.0 + wider), icr_y_right=TRUTH.icr_y_right * (1.0 + wider))
    out = []
    for seed in range(seeds):
        drives = simulated(TRUTH, 2 * seed), simulated(other, 2 * seed + 1)
        fits = [fit(Icr.nominal(VEHICLE), [d], [increment_windows(d)]) for d in drives]
        out.append(wald_test(fits).p)
    return np.array(out)


def simulation() -> list[str]:
    """Table of alarms at 5 %."""
    low, high = binom.interval(0.95, SEEDS, LEVEL)
    lines = [
        "Two simulated drives of 34 s each, of plans of their own; reference 5 Hz, 1 cm, 0.5 deg, 0.15 s late. On the",
        f"same ground {int(low)} to {int(high)} alarms of {SEEDS} lie within binomial error (95 %) of the nominal 5 %.",
        "",
        "| ICR distance of the other ground | alarms at 5 % |",
        "|---|---|",
    ]
    for wider in (0.0, *WIDER):
        p = p_values(wider, POWER_SEEDS if wider else SEEDS)
        label = f"{100 * wider:g} % larger" if wider else "the same"
        lines.append(f"| {label} | {int((p < LEVEL).sum())} of {len(p)} ({100 * (p < LEVEL).mean():.1f} %) |")
    return lines


def table(found: Terrains) -> list[str]:
    """The pairs of grounds, and the verdict."""
    lines = ["| a | b | p | a's calibration on b, against b's own | b's on a |", "|---|---|---|---|---|"]
    for pair in found.pairs:
        cells = (pair.a, pair.b, f"{pair.difference.p:.2g}", str(pair.a_on_b), str(pair.b_on_a))
        lines.append(f"| {' | '.join(cells)} |")
    return [*lines, "", f"Verdict, model {found.model}: {found.because}."]


def halves(drive: Drive) -> dict[str, list[Drive]]:
    """The first and the second half of a drive, as if of two grounds."""
    if drive.segments is not None:
        middle = len(drive.segments) // 2
        parts = [drive.with_segments(np.arange(middle)), drive.with_segments(np.arange(middle, len(drive.segments)))]
    else:
        middle_time = 0.5 * sum(drive.span)
        parts = [drive.between(drive.span[0], middle_time), drive.between(middle_time, drive.span[1])]
    return {name: [part] for name, part in zip(("first half", "second half"), parts, strict=True)}


def real(root: Path) -> Iterator[list[str]]:
    """Grounds of real drives, halves of one drive, which lie on one ground, and two drives on grass."""
    for model in ("icr", "scheduled_icr"):
        studies = {f"{model}: the Warthog on three grounds": {n.split("-")[1]: [load_drive(root / n)] for n in REAL}}
        studies[f"{model}: halves of {REAL[0]}"] = halves(load_drive(root / REAL[0]))
        studies[f"{model}: the Warthog twice on grass"] = {n: [load_drive(root / n)] for n in SAME}
        for title, grounds in studies.items():
            yield ["", f"### {title}", "", *table(compare_terrains(grounds, model))]


def main() -> None:
    """Run the study and write its page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "terrains.md")
    words = parser.parse_args()
    made = "Written by `make studies` (`benchmarks/terrain.py`); nothing here is edited by hand."
    lines = ["# Do two grounds need two models?", "", made, "", "## Simulation", ""]
    lines += simulation()
    print("\n".join(lines), flush=True)
    if words.drives.is_dir():
        lines += ["", "## Real drives", "", "Fitted and judged as `skidsteer terrains` does."]
        for part in real(words.drives):
            lines += part
            print("\n".join(part), flush=True)
    words.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
