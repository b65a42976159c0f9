"""Mandow et al. 2007, "Experimental kinematics for wheeled skid-steer mobile robots", IROS: Tables I-III, Fig. 6."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from skidsteer.drive import Drive
from skidsteer.identify.genetic import search_drives
from skidsteer.models import Icr, Model
from skidsteer.reproduce import mandow2007_printed as printed
from skidsteer.reproduce.figure import Curve, Figure
from skidsteer.reproduce.mandow2007_printed import (
    ASPHALT_20,
    ASYMMETRIC,
    DEFAULT,
    ERRORS,
    GROUND,
    NAMES,
    NOTES,
    P3AT,
    PLACES,
    PRINTED_SYMMETRIC,
    SYMMETRIC,
    TABLE_3,
    Column,
)
from skidsteer.reproduce.mandow2007_trial import (
    OURS,
    Identified,
    Score,
    halves,
    identify,
    score,
    training_drive,
    validation_drive,
)
from skidsteer.reproduce.rows import Reproduction, Row, Table, stands_in
from skidsteer.se2 import FloatArray, compose, invert
from skidsteer.simulate import controller
from skidsteer.windows import Timing, increment_windows

SEED = 2007


def reproduction(drive: Drive | None = None) -> Reproduction:
    """Everything; with a real drive, Table III and Fig. 6 on it, too.

    Args:
        drive: continuous, with reference poses: its second half identifies, its first half is the validation path.

    Raises:
        RequestError: a drive of another kind.
    """
    training, path = training_drive(ASPHALT_20, SEED), validation_drive(ASPHALT_20, SEED + 1)
    found = identify(training, printed.FACTORY, "icr", Timing())
    scores = {name: score(model, path, found.timing) for name, model in found.models.items()}
    rows = (*printed.rows(), *table_rows(), *symmetric_rows(found), *score_rows(scores))
    figure = _path_figure("figure-6", "Validation path of the simulated P3-AT, asphalt, 20 psi", path, scores)
    simulated = Reproduction(rows, (figure,), (_table_3(scores, None, ""),), PLACES, NOTES)
    return simulated if drive is None else _beside(simulated, scores, drive)


def _beside(simulated: Reproduction, scores: dict[str, Score], drive: Drive) -> Reproduction:
    """The same with a real drive beside it."""
    path, training = halves(drive)
    found = identify(training, controller(drive.vehicle), "auto")
    real = {name: score(model, path, found.timing) for name, model in found.models.items()}
    title = f"First half of the real drive {drive.name}, models identified on the second"
    figure = _path_figure("figure-6-real", title, path, real)
    table = _table_3(scores, real, _real_note(drive, found))
    return Reproduction(simulated.rows, (*simulated.figures, figure), (table,), PLACES, NOTES)


def table_rows() -> tuple[Row, ...]:
    """The five parameters of each column, found again by the genetic search on a simulated drive with that truth."""
    return tuple(
        row for i, (table, tyre, column) in enumerate(printed.columns()) for row in _found_again(i, table, tyre, column)
    )


def _found_again(i: int, table: str, tyre: str, column: Column) -> Iterator[Row]:
    drive = training_drive(printed.model_of(column), SEED + 10 + i)
    found, _ = search_drives(Icr.nominal(P3AT), [drive], [increment_windows(drive)], [Timing()])
    left, right, x, alpha_left, alpha_right = found.model.theta.tolist()
    steps = (found.resolution[2], found.resolution[1], found.resolution[0], found.resolution[4], found.resolution[3])
    ours = (x, -right, -left, alpha_right, alpha_left)
    for name, paper, value, step in zip(NAMES[:5], column[:5], ours, steps, strict=True):
        why = "genetic search, 40 bits, on a simulated drive whose truth is the printed column; one step of 8 bits is"
        yield stands_in(f"{name} {GROUND[table]}, {tyre}, {table}", paper, value, f"{why} {step:.4f}")


def symmetric_rows(found: Identified) -> tuple[Row, ...]:
    """Eqs. (11), (12) on the simulated drive."""
    assert found.turns is not None
    icr_y, alpha = found.turns.icr_y, found.turns.alpha
    tests = (
        f"{icr_y.stretches} turns on the spot and {alpha.stretches} straight runs of a simulated drive, truth: Table I;"
        " with the alpha that Eq. (11) lacks"
    )
    return (
        stands_in("x_ICR [m] by Eqs. (11), (12), section IV.D", PRINTED_SYMMETRIC.icr_y, icr_y.value, tests),
        stands_in("alpha by Eq. (12), section IV.D", PRINTED_SYMMETRIC.alpha, alpha.value, tests),
    )


def score_rows(scores: dict[str, Score]) -> tuple[Row, ...]:
    """Table III on the simulated path, and which reading of it is meant."""
    why = (
        "simulated: another minute at 0.45 m/s, GPS of 7 mm at 5 Hz, headings from the track; increments of one dead"
        " reckoning along the path; grows with the length of the path, which the paper does not print"
    )
    rows = [
        stands_in(f"mean squared error of {error}, {name} model, Table III", paper, ours, why)
        for name, values in TABLE_3.items()
        for error, paper, ours in zip(ERRORS, values, _with_sum(scores[name].along), strict=True)
    ]
    return (_reading_row(scores), *rows)


def _reading_row(scores: dict[str, Score]) -> Row:
    paper = sum(TABLE_3[DEFAULT][:2]) / sum(TABLE_3[ASYMMETRIC][:2])
    segments, along = (
        float(sum(getattr(scores[DEFAULT], way)[:2]) / sum(getattr(scores[ASYMMETRIC], way)[:2]))
        for way in ("segments", "along")
    )
    reason = (
        f"by Eq. (13) each segment begins at the reference: in 0.2 s at most 0.69 m/s make {0.2 * 0.69:.2f} m, of which"
        f" the symmetric model, whose alpha is right, cannot err by the {math.sqrt(TABLE_3[SYMMETRIC][1]):.3f} m that"
        f" Table III has. Along one dead reckoning of the whole path the same models give {along:.1f}: of that"
        " size is Table III. Its error of heading, the same for all three models, is that of a direction between"
        " neighbouring GPS positions"
    )
    what = "squared position errors, default over asymmetric model, by Eq. (13), Table III"
    return Row(what, paper, segments, "cannot be reproduced", reason)


def _with_sum(squares: FloatArray) -> tuple[float, ...]:
    return (*squares.tolist(), float(squares.sum()))


def _table_3(scores: dict[str, Score], real: dict[str, Score] | None, note: str) -> Table:
    """Paper, simulated path and real drive, side by side."""
    nan = float("nan")
    lines: list[tuple[str, tuple[float, ...]]] = []
    for name in (DEFAULT, SYMMETRIC, ASYMMETRIC, OURS):
        sides = [scores.get(name), None if real is None else real.get(name)]
        columns: list[tuple[float, ...]] = [TABLE_3.get(name, (nan,) * 4)]
        for side in sides:
            columns += [(nan,) * 4] * 2 if side is None else [_with_sum(side.along), _with_sum(side.segments)]
        lines += [(f"{name}: {e}", cells) for e, cells in zip(ERRORS, zip(*columns, strict=True), strict=True)]
        ends = [v for side in sides for v in (nan if side is None else side.off, nan)]
        lines.append((f"{name}: end off by [m]", (nan, *ends)))
    head = ("mean squared error", "paper", "simulated, along", "simulated, segments", "real, along", "real, segments")
    absent = (
        "No real drive: `warthog-asphalt` is looked for in the folder that SKIDSTEER_DATA names (../shared/data);"
        " `--drive DRIVE` takes another."
    )
    both = (
        "*along*: increments of one dead reckoning of the whole path; *segments*: each begins at the reference,"
        " Eq. (13). Simulated: *asymmetric* is the genetic search, *symmetric* the turn and straight tests, *ours* the"
        " least squares of `calibrate`, all on the same other drive."
    )
    return Table("Table III and Fig. 6, simulated and real", head, tuple(lines), f"{both} {note or absent}")


def _real_note(drive: Drive, found: Identified) -> str:
    tests = "has no turn on the spot for the symmetric model"
    if found.turns is not None:
        turn, run = found.turns.icr_y, found.turns.alpha
        tests = (
            f"the turn test has {turn.stretches} turns of {np.degrees(turn.length):.0f} deg together (sides that differ"
            f" by up to {found.pivot:g} count as a turn on the spot), the straight test {run.stretches} runs of"
            f" {run.length:.1f} m"
        )
    models = "; ".join(f"{name}: {_words(model)}" for name, model in found.models.items())
    return (
        f"Real: {drive.name} ({drive.vehicle.name}), identified on its second half, where {tests}, and judged on its"
        f" first half, all with the time offset {found.timing.time_offset:.3f} s and lag {found.timing.lag:.3f} s that"
        f" ours found. {models}."
    )


def _words(model: Model) -> str:
    values = (f"{p.name} {value:.3f}" for p, value in zip(model.PARAMETERS, model.theta, strict=True))
    return f"{model.NAME} ({', '.join(values)})" if model.PARAMETERS else "nominal"


def _path_figure(name: str, title: str, path: Drive, scores: dict[str, Score]) -> Figure:
    assert path.pose is not None
    home = invert(path.pose.values[0])
    reckoned = [Curve(model, *_track(compose(home, found.line))) for model, found in scores.items()]
    x, y = _track(compose(home, path.pose.values))
    reference = Curve("reference", x, y, measured=True)
    return Figure(name, title, "x [m]", "y [m]", (*reckoned, reference), to_scale=True)


def _track(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    return poses[:, 0], poses[:, 1]
