"""Cures that are safe to apply: each undoes one finding and is recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from skidsteer.doctor.findings import Finding
from skidsteer.doctor.folding import PARTS
from skidsteer.doctor.sampling import runs_of_equal
from skidsteer.doctor.signals import BoolArray
from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.se2 import FloatArray

Cure = Callable[[Drive, Finding], Drive]
ROUNDING = 1e-3  # [s] of the times in findings
SURE = 0.7  # of a finding: below, the cure might be the fault


def fix(drive: Drive, findings: Sequence[Finding]) -> tuple[Drive, tuple[str, ...]]:
    """Apply the cures of findings that are fixable and sure enough.

    Args:
        drive: as it was examined; it stays as it is.
        findings: of ``examine``; those that cannot be cured are passed over.

    Returns:
        The cured drive, and what was done, in the order in which it was done, for the provenance.

    Raises:
        RequestError: a finding about a part that the drive does not have.
    """
    done = []
    some = [f for f in findings if f.fixable and f.confidence >= SURE and f.kind in CURES]
    for finding in sorted(some, key=lambda f: list(CURES).index(f.kind)):
        if finding.part != "all" and getattr(drive, finding.part, None) is None:
            raise RequestError(f"{drive.name}: cannot cure {finding.kind}: the drive has no {finding.part}")
        cure, text = CURES[finding.kind]
        cured = cure(drive, finding)
        if cured is not drive:
            done.append(text.format(part=finding.part, amount=finding.amount, at=_start(finding)))
        drive = cured
    return drive, tuple(done)


def _start(finding: Finding) -> float:
    return finding.where[0][0] if finding.where else 0.0


def _with(drive: Drive, part: str, t: FloatArray, values: FloatArray) -> Drive:
    changes: dict[str, Any] = {part: Series(t, values, getattr(drive, part).name)}
    return replace(drive, **changes)


def _with_values(drive: Drive, part: str, values: FloatArray) -> Drive:
    return _with(drive, part, getattr(drive, part).t, values)


def _with_samples(drive: Drive, part: str, t: FloatArray, keep: BoolArray) -> Drive:
    """The drive with some samples of a part at other times; as it was, where none would be left."""
    return _with(drive, part, t[keep], getattr(drive, part).values[keep]) if keep.any() else drive


def _scale(*factors: float) -> Cure:
    """Multiply the columns of the wheels by factors."""

    def cure(drive: Drive, finding: Finding) -> Drive:
        return _with_values(drive, "wheels", drive.wheels.values * np.array(factors))

    return cure


def _swap(drive: Drive, finding: Finding) -> Drive:
    return _with_values(drive, "wheels", drive.wheels.values[:, ::-1])


def _scale_part(drive: Drive, finding: Finding) -> Drive:
    """Multiply all columns of the wheels, or the gyro, or the yaw of the reference, by the amount."""
    values = getattr(drive, finding.part).values.copy()
    values[:, 2 if finding.part == "pose" else 0 :] *= finding.amount
    return _with_values(drive, finding.part, values)


def _scale_positions(drive: Drive, finding: Finding) -> Drive:
    values = getattr(drive, finding.part).values.copy()
    values[:, :2] *= finding.amount
    return _with_values(drive, finding.part, values)


def _shift(drive: Drive, finding: Finding) -> Drive:
    t = getattr(drive, finding.part).t
    return _with_samples(drive, finding.part, t - finding.amount, np.ones(len(t), bool))


def _stretch(drive: Drive, finding: Finding) -> Drive:
    t = getattr(drive, finding.part).t
    return _with_samples(drive, finding.part, t - finding.amount * (t - finding.where[0][0]), np.ones(len(t), bool))


def _steady(drive: Drive, finding: Finding) -> Drive:
    """Take a line in time off a part; at its beginning it is 0."""
    series: Series = getattr(drive, finding.part)
    return _with_values(drive, finding.part, series.values - finding.amount * (series.t - series.t[0])[:, None])


def _unjump(drive: Drive, finding: Finding) -> Drive:
    """Shift what follows the jump back; samples of the time in which it may have happened are dropped."""
    (start, end), *_ = finding.where
    parts = [p for p in PARTS if getattr(drive, p) is not None] if finding.part == "all" else [finding.part]
    for part in parts:
        t = getattr(drive, part).t
        late = t >= end if finding.part != "all" else t > 0.5 * (start + end)
        keep = late | (t <= start) if finding.part != "all" else np.ones(len(t), bool)
        moved = t - finding.amount * late
        # Where the amount is a little too large, the first samples behind the jump would overtake the last before it.
        keep &= ~late | (moved > t[~late].max(initial=-np.inf))
        drive = _with_samples(drive, part, moved, keep)
    return drive


def _drop_frozen(drive: Drive, finding: Finding) -> Drive:
    """Keep the first pose of each stretch in which it repeats itself."""
    t = getattr(drive, finding.part).t
    keep = np.ones(len(t), bool)
    for start, end in finding.where:
        keep &= ~((t > start + ROUNDING) & (t <= end + ROUNDING))
    return _with_samples(drive, finding.part, t, keep)


def _drop_repeated(drive: Drive, finding: Finding) -> Drive:
    series: Series = getattr(drive, finding.part)
    first, _ = runs_of_equal(series.values)
    keep = np.zeros(len(series), bool)
    keep[first] = True
    return _with_samples(drive, finding.part, series.t, keep)


# In this order: findings tell recorded times, so jumps come before drifts and offsets; and a side that is negated is
# that of the recorded columns, so it comes before they are exchanged.
CURES: dict[str, tuple[Cure, str]] = {
    "frozen_reference": (_drop_frozen, "dropped repeated samples of the {part}"),
    "held_samples": (_drop_repeated, "dropped repeated samples of the {part}"),
    "clock_jump": (_unjump, "took {amount:.10g} s off the stamps of the {part} after the jump at {at:.1f} s"),
    "clock_drift": (_stretch, "took a drift of {amount:.6f} s/s off the stamps of the {part}"),
    "clock_offset": (_shift, "took {amount:.3f} s off the stamps of the {part}"),
    "left_negated": (_scale(-1.0, 1.0), "negated v_left"),
    "right_negated": (_scale(1.0, -1.0), "negated v_right"),
    "both_negated": (_scale(-1.0, -1.0), "negated v_left and v_right"),
    "swapped_sides": (_swap, "exchanged the sides of the wheels"),
    "gyro_drift": (_steady, "took a drift of {amount:.3g} a second off the {part}"),
    "gyro_sign": (_scale_part, "negated the gyro"),
    "reference_yaw_sign": (_scale_part, "negated the yaw of the pose"),
    "gyro_degrees": (_scale_part, "multiplied the gyro by {amount:.6f} (deg to rad)"),
    "reference_yaw_degrees": (_scale_part, "multiplied the yaw of the pose by {amount:.6f} (deg to rad)"),
    "reference_unit": (_scale_positions, "multiplied the positions of the {part} by {amount:.6g}"),
    "wheels_in_rad_s": (_scale_part, "multiplied the wheel speeds by {amount:.6g} (rad/s to m/s)"),
    "wheels_in_mm_s": (_scale_part, "multiplied the wheel speeds by {amount:.6g} (mm/s to m/s)"),
    "wheels_in_ticks": (_scale_part, "multiplied the wheel speeds by {amount:.6g} (ticks/s to m/s)"),
}
