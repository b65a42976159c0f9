"""How reference and gyro are built in: an angle of the one, a bias of the other that drifts."""

from __future__ import annotations

import numpy as np

from skidsteer.doctor.drift import Drift
from skidsteer.doctor.evidence import Evidence
from skidsteer.doctor.findings import Finding


def mounting_findings(evidence: Evidence) -> list[Finding]:
    """Findings about a reference that is turned on the robot, and a gyro whose bias drifts."""
    reference = evidence.by_reference
    turned = evidence.turned and reference is not None and reference.known
    return [
        *([_turned(evidence.turned)] if turned else []),
        *([_drifting(evidence.drift)] if evidence.drift.matters else []),
    ]


def _turned(angle: float) -> Finding:
    return Finding(
        "turned_reference",
        f"The sensor of the reference is turned by {np.degrees(angle):.1f} deg against the way the robot drives, or its"
        " yaw counts from another axis (north for east).",
        (),
        0.9,
        "info",
        "Where the angle is not known the robot seems to drive sideways; `skidsteer calibrate` finds it by itself.",
        f"Nothing has to be done to calibrate; if the angle is known, give it as --mount X,Y,{angle:.4f}.",
        False,
        "pose",
        angle,
    )


def _drifting(drift: Drift) -> Finding:
    return Finding(
        "gyro_drift",
        f"What the gyro reads at rest drifts by {60.0 * drift.slope:+.2g} each minute, {drift.slope * drift.span:+.2g}"
        " over the drive (rad/s, if that is its unit).",
        (),
        0.9,
        "warning",
        "A calibration takes the bias of a gyro as one number a drive: turns at its beginning and its end disagree.",
        "Let the gyro warm up before recording; for this log take that line off gyro_z.",
        True,
        "gyro",
        drift.slope,
    )
