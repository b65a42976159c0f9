"""What the doctor can find, and what a finding says."""

from __future__ import annotations

from dataclasses import dataclass

Interval = tuple[float, float]

KINDS: dict[str, str] = {
    "swapped_sides": "the columns of the left and the right side are exchanged",
    "left_negated": "the speed of the left side has the wrong sign",
    "right_negated": "the speed of the right side has the wrong sign",
    "both_negated": "the speeds of both sides have the wrong sign",
    "backwards": "sides exchanged and negated, or a reference sensor that looks backwards",
    "turn_sign": "wheels and gyro turn opposite ways, and nothing tells which of them is wrong",
    "gyro_sign": "the gyro counts clockwise",
    "reference_yaw_sign": "the yaw of the reference counts clockwise",
    "turned_reference": "the sensor of the reference is turned against the way the robot drives",
    "gyro_degrees": "the gyro is in deg/s",
    "gyro_drift": "the bias of the gyro drifts",
    "reference_yaw_degrees": "the yaw of the reference is in degrees",
    "reference_unit": "the positions of the reference are in mm or cm",
    "wheels_in_rad_s": "wheel speeds are in rad/s",
    "wheels_in_mm_s": "wheel speeds are in mm/s",
    "wheels_in_ticks": "wheel speeds are in encoder ticks a second",
    "wheel_radius": "wheel speeds are wrong by a large factor",
    "time_unit": "time is not in seconds, or the wheels were logged too seldom",
    "clock_offset": "one clock is ahead of another by more than a delay explains",
    "clock_drift": "one clock runs faster than another",
    "clock_jump": "a clock jumped or was reset",
    "leap": "the reference leaps as no robot moves",
    "frozen_reference": "the reference stands still while the wheels turn",
    "frozen_wheels": "the speed of one side stays the same while the other changes",
    "held_samples": "values are repeated between updates at a lower true rate",
    "quantised_wheels": "wheel speeds come in coarse steps",
    "gap": "samples are missing",
    "saturated": "readings are clipped at a limit",
    "standing_still": "the robot hardly moves",
    "little_turning": "the robot hardly turns",
    "straight_only": "the robot drives straight, or nearly so, all the time",
    "circle_only": "the robot drives one and the same curve all the time",
    "commanded_wheels": "wheel speeds are commands, not measurements",
}

EXCITATION = ("standing_still", "little_turning", "straight_only", "circle_only")  # kinds about how it was driven
SEVERITIES = ("info", "warning", "error")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong with a log, or worth knowing, in words for a robotics engineer.

    ``severity``: "error" makes a calibration wrong, "warning" makes it worse, "info" is good to know.

    Raises:
        ValueError: an unknown kind or severity, or a confidence outside [0, 1].
    """

    kind: str  # one of KINDS
    what: str  # what is wrong, in one sentence
    where: tuple[Interval, ...]  # [s] stretches of the drive; empty: all of it
    confidence: float  # in [0, 1]: how sure
    severity: str  # one of SEVERITIES
    effect: str  # what it does to the calibration
    cure: str  # what to do about it
    fixable: bool  # whether ``fix`` does it
    part: str = "wheels"  # series of the drive that is at fault
    amount: float = 0.0  # what ``fix`` needs: factor, seconds that the clock of the part is late by, or its drift

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"finding kind must be one of {', '.join(KINDS)}, got {self.kind}")
        if self.severity not in SEVERITIES:
            raise ValueError(f"finding severity must be one of {', '.join(SEVERITIES)}, got {self.severity}")
        if not 0.0 <= self.confidence <= 1.0:
            raise ValueError(f"finding confidence must lie in [0, 1], got {self.confidence}")
