"""Whether the robot moved enough, and in enough different ways, to tell the parameters of a model apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.doctor.evidence import SPEED, STRAIGHT, TURN, Evidence
from skidsteer.doctor.findings import Finding
from skidsteer.doctor.signals import turned_by, typical
from skidsteer.se2 import FloatArray

AT_REST = 0.1  # share of the typical speed below which the robot stands, at least
SLOWEST = 0.02  # [m/s]
MOVING_TIME = 10.0  # [s] less is too little
MOVING_SHARE = 0.05
NOTHING = 3.0  # [s] of motion say nothing about its kind
TURNED = np.radians(180.0)  # less is too little
SAME_CURVE = 0.1  # share of the turning that the speed does not explain where all is one curve


@dataclass(frozen=True, slots=True)
class Motion:
    """How a drive excites the model."""

    moving: float  # [s]
    share: float  # of the drive
    turned: float  # [rad] all turns, unsigned
    varied: float  # share of the turning (or of the speed, if less) that is not proportional to the other
    radius: float  # [m] of the curve that fits best, by the nominal track width; 0: on the spot


def motion_of(evidence: Evidence) -> Motion:
    """Time in motion, angle turned, and how far speed and turning vary apart from each other."""
    values = evidence.wheels.values[np.isfinite(evidence.wheels.values).all(axis=1)]
    speed, turn = _righted(evidence, values)
    fastest = np.abs(speed) + 0.5 * np.abs(turn)
    moves = fastest > max(AT_REST * typical(fastest), SLOWEST)
    if not moves.any():
        return Motion(0.0, 0.0, 0.0, 0.0, 0.0)
    speeds, turns, both = float(speed @ speed), float(turn @ turn), float(speed @ turn)
    common = both**2 / (speeds * turns) if speeds > 0 and turns > 0 else 1.0
    track = evidence.drive.vehicle.track_width
    return Motion(
        moving=float(moves.sum() * evidence.wheels.step),
        share=float(moves.mean()),
        turned=_turned(evidence, turn),
        varied=min(1.0 - common, 4.0 * speeds / turns if turns > 0 else 1.0),
        radius=track * np.sqrt(speeds / turns) if turns > 0 else np.inf,
    )


def _righted(evidence: Evidence, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Speed and turn (n,) of both sides; with one side negated they have changed places."""
    speed, turn = values[:, SPEED], values[:, TURN]
    for pair in (evidence.by_reference, evidence.by_gyro):
        if pair is not None and pair.known:
            crossed = pair.best.hypothesis.links[-1].b == SPEED
            return (0.5 * turn, 2.0 * speed) if crossed else (speed, turn)
    return speed, turn


def _turned(evidence: Evidence, turn: FloatArray) -> float:
    """Angle turned [rad] by the best witness; by the wheels alone as of a track twice as wide as nominal."""
    step = evidence.wheels.step
    if evidence.reference is not None and evidence.drive.pose is not None:
        return turned_by(evidence.reference.values[:, TURN], step)
    if evidence.gyro is not None:
        return turned_by(evidence.gyro.values[:, 0], step)
    return turned_by(turn / (2.0 * evidence.drive.vehicle.track_width), step)


def excitation_findings(evidence: Evidence) -> list[Finding]:
    """Findings about drives that move or turn too little, or always in the same way."""
    motion = motion_of(evidence)
    found = [_standing(motion)] if motion.moving < MOVING_TIME or motion.share < MOVING_SHARE else []
    if motion.moving < NOTHING:
        return found
    if motion.turned < STRAIGHT:
        return [*found, _straight(motion)]
    if motion.turned < TURNED:
        found.append(_little_turning(motion))
    return [*found, _one_curve(motion)] if motion.varied < SAME_CURVE else found


def _standing(motion: Motion) -> Finding:
    return Finding(
        "standing_still",
        f"The wheels turn for {motion.moving:.0f} s only, {100.0 * motion.share:.0f} % of the drive.",
        (),
        0.95,
        "error" if motion.moving < MOVING_TIME else "info",
        "There is little to calibrate on; the uncertainties will be large.",
        "Drive for two minutes or more: straights, curves to both sides, turns on the spot, at several speeds.",
        False,
    )


def _straight(motion: Motion) -> Finding:
    return Finding(
        "straight_only",
        f"The robot drives straight: it turns by {np.degrees(motion.turned):.0f} deg in all.",
        (),
        0.95,
        "error",
        "The effective track width and the ICRs are not observable; only the mean scale factor is.",
        "Add curves to both sides and turns on the spot.",
        False,
    )


def _little_turning(motion: Motion) -> Finding:
    return Finding(
        "little_turning",
        f"The robot turns by {np.degrees(motion.turned):.0f} deg in all.",
        (),
        0.9,
        "warning",
        "The effective track width and the ICRs will be uncertain.",
        "Add curves to both sides and turns on the spot, a full turn each at least.",
        False,
    )


def _one_curve(motion: Motion) -> Finding:
    curve = "turns on the spot" if motion.radius < 0.1 else f"drives one curve of about {motion.radius:.1f} m radius"
    return Finding(
        "circle_only",
        f"The robot {curve} all the time: {100.0 * motion.varied:.1f} % of its motion is anything else.",
        (),
        0.9,
        "error",
        "Scale factors and track width cannot be told apart: only one combination of them is observable.",
        "Add straights, curves of other radii to both sides, and turns on the spot.",
        False,
    )
