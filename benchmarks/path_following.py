"""Path following: every controller, published and tuned gains, on two dynamic plants. Writes docs/path-following.md.

``--resume`` takes what a study that was broken off left in ``build/path-following``.
"""

from __future__ import annotations

import math
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import path_following_first as first
from path_following_cases import ACCELERATION, RIM_LIMIT, STORE, Case, Gains, Place, Score, scores
from path_following_laws import LAWS, NAMES, STEEPEST
from path_following_text import ASSUMED, DELAYED, ERRED, GRID, HEAD, LEAP, MAIN, MISMATCH, NOISY, SCHEDULED, TUNED, WAY
from path_following_tuning import CANDIDATES, GENERATIONS, SPEEDS, Tuned, tune
from skidsteer.reproduce import huskic_runs as site
from skidsteer.reproduce.figure import Curve, Figure, draw

DOCS = Path(__file__).resolve().parents[1] / "docs"
GRASS, MUJOCO = ("terramechanic", "grass"), ("mujoco", "grass")
PLACES: dict[Place, str] = {
    GRASS: "Terramechanic plant, grass",
    ("terramechanic", "tiles"): "Terramechanic plant, vinyl (`tiles`)",
    ("terramechanic", "gravel"): "Terramechanic plant, macadam (`gravel`)",
    MUJOCO: "MuJoCo, friction of grass",
}
FASTER = (0.5, 1.0, 1.5, 2.0, 2.5)  # [m/s]
FAST = (1.5, 2.0)  # [m/s]
LAGS, DELAYS = (0.0, 0.1, 0.2), (0.0, 0.06, 0.1)  # [s]
WORSE = 1.1  # times the best other, up to which ours is not worse
LOST = 0.5  # [m] that ours must not leave the path by with 0.2 s of lag and 0.1 s of delay
Sets = dict[tuple[str, Place], Tuned]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield from ("", f"| {' | '.join(head)} |", f"|{'---|' * len(head)}")
    yield from (f"| {' | '.join(row)} |" for row in rows)


def home(place: Place) -> Place:
    """Where the gains for a place were tuned."""
    return MUJOCO if place[0] == "mujoco" else GRASS


def tuned_case(law: str, speed: float, place: Place, sets: Sets) -> Case:
    return Case(law, sets[law, home(place)].gains, speed, place)


def published(law: str) -> Gains:
    return LAWS[law].gains("launch")


def cell(found: Score) -> str:
    if found.done:
        return f"{100 * found.mean:.1f} / {100 * found.largest:.1f} ({found.speed:.2f})"
    return f"{found.outcome} at {100 * found.share:.0f} %"


def cells(cases: Sequence[Case]) -> list[str]:
    return [cell(found) for found in scores(cases)]


def tuning(sets: Sets) -> Iterator[str]:
    yield TUNED.format(
        runs=GENERATIONS * CANDIDATES * len(SPEEDS), sets=GENERATIONS * CANDIDATES, speeds=", ".join(map(str, SPEEDS))
    )
    rows = []
    for (law, place), found in sets.items():
        limited = ((name, min(value, STEEPEST) if name == "theta_a" else value) for name, value in found.gains)
        gains = ", ".join(f"{name} {value:.3g}" for name, value in limited)
        rows.append([NAMES[law], place[0], f"{found.before:.1f}", f"{found.cost:.1f}", gains])
    yield from table(["law", "plant", "cost before [cm]", "after [cm]", "tuned gains"], rows)


def main_tables(sets: Sets) -> Iterator[str]:
    yield MAIN
    for place, title in PLACES.items():
        rows = []
        for law in NAMES:
            for name, gains in (("published", published(law)), ("tuned", sets[law, home(place)].gains)):
                rows.append([NAMES[law], name, *cells([Case(law, gains, v, place) for v in FASTER])])
        yield from ("", f"### {title}", *table(["law", "gains", *(f"{v:g} m/s" for v in FASTER)], rows))
        print(title, flush=True)
    yield from effort(sets)


def effort(sets: Sets) -> Iterator[str]:
    yield from ("", "### RMS error, effort and energy", "", WAY)
    rows = []
    for law in NAMES:
        row = [NAMES[law]]
        for place in (GRASS, MUJOCO):
            for found in scores([tuned_case(law, v, place, sets) for v in FAST]):
                energy = "" if found.energy is None else f", {found.energy:.0f} J/m"
                row.append(f"{100 * found.rms:.1f} cm, {found.effort:.2f} m/s^2{energy}" if found.done else "fails")
        rows.append(row)
    yield from table(["law", *(f"{p[0]}, {v:g} m/s" for p in (GRASS, MUJOCO) for v in FAST)], rows)


def course(sets: Sets) -> Iterator[str]:
    yield from ("", "### The way on grass, 159.83 m")
    rows = []
    for law in NAMES:
        for name, gains in (("published", published(law)), ("tuned", sets[law, GRASS].gains)):
            rows.append([NAMES[law], name, *cells([Case(law, gains, v, GRASS, "course") for v in FASTER[1:]])])
    yield from table(["law", "gains", *(f"{v:g} m/s" for v in FASTER[1:])], rows)


def grid(sets: Sets) -> Iterator[str]:
    yield GRID
    points = [(lag, delay) for lag in LAGS for delay in DELAYS]
    head = [f"lag {lag:g} s, {1e3 * delay:.0f} ms" for lag, delay in points]
    worse = []
    for place in (GRASS, MUJOCO):
        for v in FAST:
            bases = {law: tuned_case(law, v, place, sets) for law in NAMES}
            found = {
                law: scores([replace(base, lag=lag, delay=delay, laps=1) for lag, delay in points])
                for law, base in bases.items()
            }
            rows = [[NAMES[law], *map(cell, each)] for law, each in found.items()]
            ratios = [ratio({law: each[i] for law, each in found.items()}) for i in range(len(points))]
            told = [f"{value:.2f} ({name})" if value else f"- ({name})" for value, name in ratios]
            rows.append(["ours over the best other", *told])
            yield from ("", f"### {PLACES[place]}, {v:g} m/s", *table(["law, tuned", *head], rows))
            at = (f"{PLACES[place]}, {v:g} m/s, {where}" for where in head)
            worse += [where for where, (value, _) in zip(at, ratios, strict=True) if not value <= WORSE]
            print("grid", place, v, ratios, flush=True)
    yield ""
    yield f"Ours is worse than the best other by more than 10 %: {'; '.join(worse) or 'nowhere on this grid'}."


def ratio(found: dict[str, Score]) -> tuple[float, str]:
    """Mean error of ours over the least of the others, and whose; 0 where no other arrives, NaN if ours fails."""
    best, name = best_other(found)
    return (found["ours"].mean / best if found["ours"].done else math.nan), name


def best_other(found: dict[str, Score]) -> tuple[float, str]:
    """Least mean error [m] of all laws but ours, and whose it is."""
    done = {law: each.mean for law, each in found.items() if law != "ours" and each.done}
    if not done:
        return math.inf, "no other arrives"
    law = min(done, key=lambda name: done[name])
    return done[law], NAMES[law]


def against(sets: Sets) -> Iterator[str]:
    """What ours promises."""
    yield from ("", "## Ours against the best of the others", "", DELAYED)
    rows = []
    for place, title in PLACES.items():
        for v in FASTER:
            found = {law: scores([tuned_case(law, v, place, sets)])[0] for law in NAMES}
            untuned = {law: scores([Case(law, published(law), v, place)])[0] for law in NAMES}
            ours, (best, name) = found["ours"], min(best_other(found), best_other(untuned))
            less = f"{100 * (1 - ours.mean / best):.0f} %" if ours.done and math.isfinite(best) else "-"
            other = f"{100 * best:.1f} ({name})" if math.isfinite(best) else name
            rows.append([title, f"{v:g}", cell(ours), other, less])
    yield from table(["place", "speed [m/s]", "ours", "best other: mean [cm]", "less by"], rows)
    yield ""
    for place in (GRASS, MUJOCO):
        hard = [replace(tuned_case(law, 2.0, place, sets), lag=0.2, delay=0.1) for law in NAMES]
        told = dict(zip(NAMES, scores(hard), strict=True))
        within = [NAMES[law] for law, each in told.items() if each.done and each.largest <= LOST]
        yield (
            f"- {PLACES[place]}, 2 m/s, 0.2 s of lag, 100 ms of delay, two laps: ours {cell(told['ours'])}; within"
            f" {LOST:g} m of the path stay: {', '.join(within) or 'none'}."
        )


def mismatch(sets: Sets) -> Iterator[str]:
    yield MISMATCH
    rows = []
    for law in NAMES:
        row = [NAMES[law]]
        for other in ("vinyl", "macadam", "grass"):
            base = tuned_case(law, 1.5, ("kinematic", "vinyl"), sets)
            row += cells([replace(base, believed=("published", other, "icr"))])
        for terrain in ("tiles", "gravel", "grass"):
            base = tuned_case(law, 1.5, ("terramechanic", "tiles"), sets)
            row += cells([replace(base, believed=("terramechanic", terrain, "icr"))])
        rows.append(row)
    head = [f"{plant}: {what}" for plant in ("kinematic", "terramechanic") for what in ("its own", "macadam", "grass")]
    yield from table(["law, tuned", *head], rows)


def leap(sets: Sets) -> Iterator[str]:
    yield LEAP
    rows = []
    places: list[tuple[Place, float]] = [(("terramechanic", "gravel"), 1.1), (GRASS, 1.5), (MUJOCO, 1.5)]
    for law in NAMES:
        row = [NAMES[law]]
        for place, v in places:
            (found,) = scores([replace(tuned_case(law, v, place, sets), jump=0.886, off=3.0)])
            back = "not back" if found.settled is None else f"{found.settled:.1f} m"
            row.append(f"{back}, {found.speed:.2f} m/s" if found.done else f"{found.outcome}")
        rows.append(row)
    yield from table(["law, tuned", *(f"{p[0]}, {p[1]}, {v:g} m/s" for p, v in places)], rows)


def erred(sets: Sets) -> Iterator[str]:
    yield ERRED
    rows = []
    for place in (GRASS, MUJOCO):
        for v in FAST:
            for lag, delay in ((0.1, 0.06), (0.2, 0.1)):
                base = replace(tuned_case("ours", v, place, sets), lag=lag, delay=delay)
                told = cells([replace(base, lag_share=share) for share in (0.7, 1.0, 1.3)])
                rows.append([PLACES[place], f"{v:g} m/s, {lag:g} s, {1e3 * delay:.0f} ms", *told])
    yield from table(["place", "true lag and delay", "told 30 % less", "told the truth", "told 30 % more"], rows)


def scheduled(sets: Sets) -> Iterator[str]:
    yield SCHEDULED
    rows = []
    for law in NAMES:
        cases = [tuned_case(law, v, place, sets) for place in (GRASS, MUJOCO) for v in FAST]
        rows.append([NAMES[law], *cells([replace(case, believed=("", "", "scheduled_icr")) for case in cases])])
    yield from table(["law, tuned", *(f"{p[0]}, {v:g} m/s" for p in (GRASS, MUJOCO) for v in FAST)], rows)


def noisy(sets: Sets) -> Iterator[str]:
    yield NOISY
    at = [(place, v) for place in (GRASS, MUJOCO) for v in FAST]
    cases = {NAMES[law]: [tuned_case(law, v, place, sets) for place, v in at] for law in NAMES}
    cases["ours, defaults"] = [Case("ours", published("ours"), v, place) for place, v in at]
    rows = [[name, *cells([replace(case, noisy=True) for case in each])] for name, each in cases.items()]
    yield from table(["law, tuned", *(f"{place[0]}, {v:g} m/s" for place, v in at)], rows)


def figures(sets: Sets) -> Iterator[str]:
    for place, title in PLACES.items():
        curves = []
        for law in NAMES:
            told = [found for found in scores([tuned_case(law, v, place, sets) for v in FASTER]) if found.done]
            speed, mean = np.array([t.speed for t in told]), np.array([100 * t.mean for t in told])
            curves.append(Curve(NAMES[law], speed, mean))
        name = f"path-following-{place[0]}-{place[1]}"
        drawn = Figure(name, title, "speed reached [m/s]", "mean cross-track error [cm]", tuple(curves))
        draw(drawn, DOCS / "figures" / f"{name}.svg")
        yield from ("", f"![{title}: error over speed, tuned gains, as far as the path is kept](figures/{name}.svg)")


def assumed() -> str:
    return ASSUMED.format(mass=site.VEHICLE.mass, rims=RIM_LIMIT, acceleration=ACCELERATION)


def main() -> None:
    if "--resume" not in sys.argv and STORE.exists():
        shutil.rmtree(STORE)
    sets = {(law, place): tune(law, place) for place in (GRASS, MUJOCO) for law in NAMES}
    for key, found in sets.items():
        print(*key, f"{found.before:.1f} -> {found.cost:.1f} cm", flush=True)
    lines = [HEAD.rstrip(), "", assumed()]
    sections = (against, figures, tuning, main_tables, course, grid, mismatch, leap, erred, scheduled, noisy)
    for section in sections:
        print(f"## {section.__name__}", flush=True)
        lines += list(section(sets))
    lines += list(first.lines())
    (DOCS / "path-following.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
