"""Clocks that are ahead, run fast, or jump, and which of them: wheels, reference or gyro."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from skidsteer.doctor.course import CREDIBLE, Event, events_of
from skidsteer.doctor.evidence import Evidence
from skidsteer.doctor.findings import Finding
from skidsteer.doctor.pauses import parts_of
from skidsteer.doctor.signs import confidence

Unfold = Callable[[float], float]

LOST = 20.0  # [s] a jump whose moment is less certain is not cured: too much would have to be dropped


def clock_findings(evidence: Evidence) -> list[Finding]:
    """Findings about offsets, drifts and jumps of the clocks of wheels, reference and gyro."""
    reference = "pose" if evidence.drive.pose is not None else "position"
    pairs = {
        (reference, "wheels"): evidence.by_reference,
        ("gyro", "wheels"): evidence.by_gyro,
        (reference, "gyro"): evidence.reference_by_gyro,
    }
    series, unfold = parts_of(evidence.drive), evidence.folding.unfold
    events = {
        (a, b): events_of(pair, series[a].t, series[b].t, unfold)
        for (a, b), pair in pairs.items()
        if pair is not None and pair.known
    }
    found = []
    for kinds in ({"clock_drift", "clock_jump"}, {"clock_offset"}):
        some = {parts: [event for event in all_ if event.kind in kinds] for parts, all_ in events.items()}
        found += [FINDINGS[event.kind](part, other, event, unfold) for part, other, event in _blamed(some)]
    return found


def _blamed(events: dict[tuple[str, str], list[Event]]) -> list[tuple[str, str, Event]]:
    """Part at fault, part it is compared with, event. Two struck pairs tell by the part they share."""
    struck = [parts for parts, some in events.items() if some]
    if len(struck) == 2 and len(events) == 3:
        common = next(iter(set(struck[0]) & set(struck[1])))
        parts = max(struck, key=lambda p: max(e.gain for e in events[p]))
        return [_seen_from(common, parts, event) for event in events[parts]]
    # What neither of two sensors has against the wheels cannot stand between the two.
    by_wheels = [parts for parts in struck if parts[1] == "wheels" or len(events) < 3]
    # The one whose stamps pause was set forward; else a sensor is blamed rather than the wheels.
    return [
        _seen_from(parts[1] if event.paused and event.amount < 0.0 else parts[0], parts, event)
        for parts in by_wheels
        for event in events[parts]
    ]


def _seen_from(part: str, parts: tuple[str, str], event: Event) -> tuple[str, str, Event]:
    """The event by the clock of a part of the pair."""
    if part == parts[0]:
        return parts[0], parts[1], event
    start, end = sorted((event.start - event.lags[0], event.end - event.lags[1]))
    return parts[1], parts[0], replace(event, start=start, end=end, amount=-event.amount)


def _offset_finding(part: str, other: str, event: Event, unfold: Unfold) -> Finding:
    size, side = abs(event.amount), "late" if event.amount > 0 else "early"
    return Finding(
        "clock_offset",
        f"The stamps of the {part} are {size:.2f} s {side} against the {other}; delays explain {CREDIBLE[0]} to"
        f" {CREDIBLE[1]} s.",
        (),
        confidence(event.gain),
        "error",
        "Motion is compared with that of another moment, and the fit looks for offsets near zero only.",
        f"Use one clock for both, or shift the stamps of the {part} by {-event.amount:+.2f} s.",
        True,
        part,
        event.amount,
    )


def _drift_finding(part: str, other: str, event: Event, unfold: Unfold) -> Finding:
    return Finding(
        "clock_drift",
        f"The clock of the {part} gains {1e3 * event.amount:+.2f} ms each second on that of the {other},"
        f" {event.amount * (event.end - event.start):+.2f} s over the drive.",
        ((event.start, event.end),),
        confidence(event.gain),
        "error",
        "No single time offset fits the drive; turns smear into neighbouring straights.",
        f"Synchronise the clocks (NTP, PTP); for this log stretch the stamps of the {part} by {-event.amount:+.5f}.",
        True,
        part,
        event.amount,
    )


def _jump_finding(part: str, other: str, event: Event, unfold: Unfold) -> Finding:
    way = "ahead" if event.amount > 0 else "back"
    start, end = unfold(event.start), unfold(event.end)
    when = f"{start:.1f} s" if event.paused else f"{0.5 * (start + end):.1f} s give or take {0.5 * (end - start):.1f} s"
    return Finding(
        "clock_jump",
        f"The clock of the {part} jumps {way} by {abs(event.amount):.4g} s against that of the {other}, at {when}.",
        ((event.start, event.end),),
        confidence(event.gain),
        "error",
        "No single time offset fits the drive: beyond the jump, motion is compared with that of another moment.",
        f"Find out what set the clock (NTP, GNSS time, a restart); for this log shift the stamps of the {part} after"
        f" the jump by {-event.amount:+.4g} s, or calibrate on one side of it.",
        event.paused or event.end - event.start < LOST,
        part,
        event.amount,
    )


FINDINGS: dict[str, Callable[[str, str, Event, Unfold], Finding]] = {
    "clock_drift": _drift_finding,
    "clock_jump": _jump_finding,
    "clock_offset": _offset_finding,
}
