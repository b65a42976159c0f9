"""All tests of the doctor on one drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skidsteer.doctor.clocks import clock_findings
from skidsteer.doctor.evidence import gather
from skidsteer.doctor.excitation import excitation_findings
from skidsteer.doctor.findings import SEVERITIES, Finding
from skidsteer.doctor.limits import limit_findings
from skidsteer.doctor.mounting import mounting_findings
from skidsteer.doctor.pauses import pause_findings
from skidsteer.doctor.sampling import sampling_findings
from skidsteer.doctor.signals import BREAK, sampling_period
from skidsteer.doctor.signs import sign_findings
from skidsteer.doctor.units import unit_findings
from skidsteer.drive import Drive

TESTS = (
    sign_findings,
    unit_findings,
    mounting_findings,
    clock_findings,
    pause_findings,
    sampling_findings,
    limit_findings,
    excitation_findings,
)


MILLI = (500.0, 2000.0)  # times as long as the wheels: no part goes on for that long without them
SEEN_OF_A_DEAD_SIDE = ("clock_jump", "clock_drift", "clock_offset", "wheel_radius", "circle_only")


def examine(drive: Drive) -> tuple[Finding, ...]:
    """What is wrong with a drive, or worth knowing, the worst first; empty where nothing is.

    Where the wheels are logged too seldom to tell motion, or another part's time is in milliseconds, that is all there
    is to say.
    """
    if (period := sampling_period(drive.wheels.t)) > BREAK:
        return (_seldom(period),)
    slow = [_in_milliseconds(part, ratio) for part, ratio in _spans(drive).items() if MILLI[0] < ratio < MILLI[1]]
    if slow:
        return tuple(slow)
    evidence = gather(drive)
    unfold = evidence.folding.unfold
    found = _unexplained([finding for test in TESTS for finding in test(evidence)])
    found = [replace(f, where=tuple((unfold(start), unfold(end)) for start, end in f.where)) for f in found]
    return tuple(sorted(found, key=lambda finding: -SEVERITIES.index(finding.severity)))


def _seldom(period: float) -> Finding:
    """The finding about wheel samples that far apart [s]; milliseconds taken for seconds are the usual cause."""
    return Finding(
        "time_unit",
        f"Wheel samples are {period:.3g} s apart: is the time in milliseconds?",
        (),
        0.9,
        "error",
        f"Beyond {BREAK:g} s the motion between two samples is unknown; nothing else can be judged.",
        "Write t in seconds (milliseconds divided by 1000); else log the wheels at 10 Hz or more.",
        False,
    )


def _spans(drive: Drive) -> dict[str, float]:
    """How long pose, position and gyro go on by their own stamps, over how long the wheels do."""
    parts = {part: getattr(drive, part) for part in ("pose", "position", "gyro")}
    rolled = float(np.ptp(drive.wheels.t))
    return {part: float(np.ptp(s.t)) / rolled for part, s in parts.items() if s is not None and rolled > 0.0}


def _in_milliseconds(part: str, ratio: float) -> Finding:
    return Finding(
        "time_unit",
        f"The time of the {part} is in milliseconds: it goes on {ratio:.4g} times as long as that of the wheels.",
        (),
        0.9,
        "error",
        f"Wheels and {part} share no motion; nothing else can be judged.",
        f"Write t of the {part} in seconds (milliseconds divided by 1000).",
        False,
        part,
    )


def _unexplained(found: list[Finding]) -> list[Finding]:
    """The findings without what others explain.

    Gaps that a clock set forward left in the stamps of the same part; what a dead side makes of clocks and sizes.
    """
    if any(f.kind == "frozen_wheels" for f in found):
        found = [f for f in found if f.kind not in SEEN_OF_A_DEAD_SIDE]
    jumps = [(f.part, start, end) for f in found if f.kind == "clock_jump" for start, end in f.where]
    out = []
    for f in found:
        if f.kind == "gap":
            part = f.part
            where = tuple(w for w in f.where if not any(j[0] == part and j[1] <= w[1] and j[2] >= w[0] for j in jumps))
            f = replace(f, where=where)
        if f.kind != "gap" or f.where:
            out.append(f)
    return out
