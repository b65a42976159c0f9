"""Sides exchanged, signs wrong: what the hypotheses that fit best say about wheels, gyro and reference."""

from __future__ import annotations

import numpy as np

from skidsteer.doctor.evidence import Evidence, Pair
from skidsteer.doctor.findings import Finding

WHAT = {
    "swapped_sides": "The columns of the left and the right side are exchanged.",
    "left_negated": "The speed of the left side has the wrong sign.",
    "right_negated": "The speed of the right side has the wrong sign.",
    "both_negated": "The speeds of both sides have the wrong sign.",
    "backwards": "By its wheels the robot drives backwards where the reference sees it drive forwards, and turns the"
    " same way: sides exchanged and negated, or a reference sensor that looks backwards.",
    "turn_sign": "Wheels and {other} turn opposite ways: the sides are exchanged, both are negated, or the {other}"
    " counts clockwise; nothing in this log tells which.",
    "gyro_sign": "The gyro counts clockwise; wheels and reference agree against it.",
    "reference_yaw_sign": "The yaw of the reference counts clockwise, against {against}.",
}
EFFECT = {
    "swapped_sides": "Every turn goes the wrong way: the track width comes out negative or at its bound.",
    "left_negated": "Straights look like turns and turns like straights: no model fits.",
    "right_negated": "Straights look like turns and turns like straights: no model fits.",
    "both_negated": "The robot drives backwards and turns the wrong way: no model fits.",
    "backwards": "Distances have the wrong sign: no model fits.",
    "turn_sign": "Every turn goes the wrong way: the track width comes out negative or at its bound.",
    "gyro_sign": "Whatever uses the gyro fights the wheels and the reference.",
    "reference_yaw_sign": "The direction of travel does not follow the heading: no model fits.",
}
CURE = {
    "swapped_sides": "Exchange the columns v_left and v_right.",
    "left_negated": "Negate v_left; mirrored motors count the other way.",
    "right_negated": "Negate v_right; mirrored motors count the other way.",
    "both_negated": "Negate v_left and v_right.",
    "backwards": "Check which end of the robot is the front; turn the reference by 180 degrees or exchange and negate"
    " the sides.",
    "turn_sign": "Drive one turn to the left by hand and look at each of them; then exchange the sides or negate one.",
    "gyro_sign": "Negate gyro_z: REP-103 counts counter-clockwise, seen from above.",
    "reference_yaw_sign": "Negate the yaw (y and yaw, where the frame is left-handed): REP-103 counts"
    " counter-clockwise.",
}
FIXABLE = ("swapped_sides", "left_negated", "right_negated", "both_negated", "gyro_sign", "reference_yaw_sign")
PART = {"gyro_sign": "gyro", "reference_yaw_sign": "pose"}


def sign_findings(evidence: Evidence) -> list[Finding]:
    """Findings about exchanged sides and wrong signs."""
    reference = _known(evidence.by_reference)
    gyro = evidence.by_gyro if evidence.by_gyro is not None and evidence.by_gyro.turns else None
    if reference is None:
        return [] if gyro is None else _of_pair(gyro, "gyro", fixable=False)
    opposed = _known(evidence.reference_by_gyro)
    if opposed is None or not opposed.margin:
        found = _of_pair(reference, "reference")
    elif gyro is not None and not gyro.margin and reference.best.hypothesis.name == "swapped_sides":
        found = [_finding("reference_yaw_sign", opposed.margin, against="wheels and gyro", fixable=False)]
    else:
        found = [*_of_pair(reference, "reference"), _finding("gyro_sign", opposed.margin)]
    if "reference_yaw_sign" in evidence.yaw_fault:
        found.append(_finding("reference_yaw_sign", reference.best.score, against="its own direction of travel"))
    return found


def _known(pair: Pair | None) -> Pair | None:
    return pair if pair is not None and pair.known else None


def _of_pair(pair: Pair, other: str, fixable: bool = True) -> list[Finding]:
    kinds = pair.best.hypothesis.name.split()
    return [_finding(kind, pair.margin, other=other, fixable=fixable) for kind in kinds]


def _finding(kind: str, margin: float, other: str = "", against: str = "", fixable: bool = True) -> Finding:
    return Finding(
        kind,
        WHAT[kind].format(other=other, against=against),
        (),
        0.5 if kind in ("turn_sign", "backwards") else confidence(margin),
        "error",
        EFFECT[kind],
        CURE[kind],
        fixable and kind in FIXABLE,
        PART.get(kind, "wheels"),
        -1.0,
    )


def confidence(margin: float) -> float:
    """How sure, in [0, 0.99], for a lead of that many nats: half of the odds, as the noise is not quite known."""
    return float(min(1.0 - 0.5 * np.exp(-0.25 * max(margin, 0.0)), 0.99))
