"""Units and large factors: what the sizes of speeds and yaw rates say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.doctor.evidence import SPEED, TURN, Evidence, Pair
from skidsteer.doctor.findings import Finding
from skidsteer.doctor.signals import typical
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle

DEGREES = 180.0 / np.pi
SLIP = (0.6, 1.4)  # true over nominal speed that slip, tyre pressure and load explain
BEST_GRIP = 0.75  # what the better moments, one in five, reach at least: slip is not always at work, a wrong unit is
UNIT = (0.55, 1.2)  # true speed over that by a unit, for which the unit is taken for the cause
WIDTHS = (0.35, 7.0)  # effective over nominal track width that skid-steering explains
USUAL_WIDTH = 1.8
FASTEST = 12.0  # [m/s] no skid-steer robot
FEW = 20  # samples
REFERENCE_UNITS = {"mm": 1e-3, "cm": 1e-2}  # [m]


@dataclass(frozen=True, slots=True)
class _Unit:
    kind: str
    factor: float  # m/s for one of it
    text: str
    fixable: bool


def unit_findings(evidence: Evidence) -> list[Finding]:
    """Findings about degrees for radians and wheel speeds in other units."""
    reference = evidence.by_reference
    found = [_yaw_finding()] if "reference_yaw_degrees" in evidence.yaw_fault else []
    gyro = _gyro_against_reference(evidence)
    if reference is not None and reference.known:
        part = "pose" if evidence.drive.pose is not None else "position"
        return [*found, *gyro, *_wheels_against_reference(evidence.drive.vehicle, reference, part)]
    return [*found, *gyro, *_without_reference(evidence)]


def _yaw_finding() -> Finding:
    return Finding(
        "reference_yaw_degrees",
        "The yaw of the reference is in degrees: read as degrees it fits the motion, read as radians it does not.",
        (),
        0.99,
        "error",
        "The heading is meaningless: no model fits.",
        "Multiply the yaw by pi / 180.",
        True,
        "pose",
        1.0 / DEGREES,
    )


def _gyro_finding(ratio: float, against: str, sure: float) -> Finding:
    return Finding(
        "gyro_degrees",
        f"The gyro is in deg/s: it reads {ratio:.1f} times what {against}.",
        (),
        sure,
        "error",
        "The yaw rate is 57 times too large; the track width from it is 57 times too small.",
        "Multiply gyro_z by pi / 180.",
        True,
        "gyro",
        1.0 / DEGREES,
    )


def _gyro_against_reference(evidence: Evidence) -> list[Finding]:
    pair = evidence.reference_by_gyro
    if pair is None or not pair.known:
        return []
    ratio = _middle_ratio(*pair.samples(0)) * DEGREES  # of true to recorded, if in degrees
    return [_gyro_finding(DEGREES / ratio, "the reference sees", 0.99)] if UNIT[0] < ratio < UNIT[1] else []


def ratios(x: FloatArray, y: FloatArray) -> FloatArray:
    """Quotients x / y where y is not small, (n,)."""
    large = np.abs(y) > 0.3 * typical(y)
    return np.asarray(x[large] / y[large])


def _middle_ratio(x: FloatArray, y: FloatArray) -> float:
    found = ratios(x, y)
    return float(np.median(found)) if len(found) >= FEW else np.nan


def _wheels_against_reference(vehicle: Vehicle, pair: Pair, part: str) -> list[Finding]:
    # With one side negated the difference of the columns, twice the speed, stands for the speed.
    crossed = pair.best.hypothesis.links[SPEED].b % 2 == TURN
    twice = 2.0 if crossed else 1.0
    found = ratios(*pair.samples(SPEED)) * twice
    if len(found) < FEW:
        return []
    middle, grip = float(np.median(found)), float(np.quantile(found, 0.8))
    if not 0.5 < middle / (twice * abs(pair.best.scales[SPEED])) < 2.0:
        return []  # moments at rest or misaligned, no unit
    if SLIP[0] <= middle <= SLIP[1] or (middle < SLIP[0] and grip > BEST_GRIP):
        return []
    for name, factor in REFERENCE_UNITS.items():
        if UNIT[0] < middle * factor < UNIT[1] and typical(pair.a.values[:, SPEED]) > FASTEST:
            return [_reference_finding(name, factor, middle, part)]
    return [_wheel_finding(_unit(vehicle, middle), f"the reference moves {middle:.3g} m", 0.98)]


def _reference_finding(name: str, factor: float, ratio: float, part: str) -> Finding:
    return Finding(
        "reference_unit",
        f"The positions of the reference are in {name}: for one metre by the wheels it moves {ratio:.3g} m, as fast as"
        " no robot drives.",
        (),
        0.98,
        "error",
        "The scale factors run into their bounds and every distance is wrong.",
        f"Multiply x and y by {factor:g}.",
        True,
        part,
        factor,
    )


def _wheel_finding(unit: _Unit, seen: str, sure: float) -> Finding:
    return Finding(
        unit.kind,
        f"{unit.text}: for one metre by the wheels {seen}.",
        (),
        sure,
        "error",
        "The scale factors run into their bounds and every distance is wrong.",
        f"Multiply both wheel speeds by {unit.factor:.4g}."
        if unit.fixable
        else "Check wheel radius, gear ratio and unit of the wheel speeds (and the unit of the reference).",
        unit.fixable and sure >= 0.9,
        "wheels",
        float(unit.factor),
    )


def _unit(vehicle: Vehicle, ratio: float, near: tuple[float, float] = UNIT) -> _Unit:
    """The unit nearest to the ratio of true to recorded speed, if near enough."""
    credible = [unit for unit in _units(vehicle) if near[0] < ratio / unit.factor < near[1]]
    if credible:
        return min(credible, key=lambda unit: abs(np.log(ratio / unit.factor)))
    if ratio < 1.0 / 150.0:
        return _Unit("wheels_in_ticks", ratio, "Wheel speeds are in encoder ticks a second", False)
    return _Unit("wheel_radius", ratio, "Wheel radius, gear ratio or unit of the wheel speeds is far off", False)


def _units(vehicle: Vehicle) -> list[_Unit]:
    radius, ticks = vehicle.wheel_radius, vehicle.ticks_per_revolution
    units = [
        _Unit("wheels_in_mm_s", 1e-3, "Wheel speeds are in mm/s", True),
        _Unit("wheel_radius", np.pi / 30.0 * radius, "Wheel speeds are far off, perhaps wheel turns a minute", False),
    ]
    # A radius near 1 m makes rad/s and m/s the same to within slip.
    if not SLIP[0] < radius < SLIP[1]:
        units.append(_Unit("wheels_in_rad_s", radius, "Wheel speeds are in rad/s", True))
    if ticks is not None:
        factor = 2.0 * np.pi * radius / ticks
        units.append(_Unit("wheels_in_ticks", factor, "Wheel speeds are in encoder ticks a second", True))
    return units


def _without_reference(evidence: Evidence) -> list[Finding]:
    """With a gyro alone only the ratio of both is seen, which the effective track width makes uncertain, too."""
    vehicle, pair = evidence.drive.vehicle, evidence.by_gyro
    if pair is None or not pair.turns:
        return _too_fast(evidence)
    narrow, width = widths(vehicle, pair)
    if narrow < WIDTHS[0] and WIDTHS[0] < narrow * DEGREES < UNIT[1] * WIDTHS[1]:
        return [_gyro_finding(USUAL_WIDTH / narrow, "the wheels explain", 0.9)]
    if width > WIDTHS[1]:
        unit = _unit(vehicle, USUAL_WIDTH / width, (USUAL_WIDTH / WIDTHS[1], USUAL_WIDTH / WIDTHS[0]))
        seen = f"the robot turns as if its track were {width:.3g} times as wide"
        return [_wheel_finding(unit, seen, 0.7 if width < 2.0 * WIDTHS[1] else 0.9)]
    return []


def widths(vehicle: Vehicle, pair: Pair) -> tuple[float, float]:
    """Effective over nominal track width by all turns, and by the fifth of them with the best grip."""
    crossed = pair.best.hypothesis.links[0].b == SPEED
    found = ratios(*pair.samples(0)) * (0.5 if crossed else 1.0) * vehicle.track_width
    if len(found) < FEW:
        return USUAL_WIDTH, USUAL_WIDTH
    middle, grip = np.median(found), np.quantile(found, 0.8)
    return 1.0 / middle if middle > 0 else np.inf, 1.0 / grip if grip > 0 else USUAL_WIDTH


def _too_fast(evidence: Evidence) -> list[Finding]:
    speed = typical(evidence.wheels.values[:, SPEED])
    if speed < FASTEST:
        return []
    unit = _unit(evidence.drive.vehicle, 1.0 / speed, (0.1, 10.0))
    return [_wheel_finding(unit, f"no robot drives at {speed:.3g} m/s, so that", 0.6)]
