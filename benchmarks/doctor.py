"""The injection study of the log doctor: known faults put into real drives, and how many of them it finds.

Run as ``python benchmarks/doctor.py [DATA]``; DATA holds drive folders. Every variant takes one untouched drive, puts
in one fault of a random size at a random time of motion, and counts as found when the doctor names that fault (and,
where it is local, its time). What is physically invisible is not injected: see the notes at each group of faults.
"""

from __future__ import annotations

import platform
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from skidsteer.doctor import Finding, examine
from skidsteer.doctor.evidence import gather
from skidsteer.doctor.excitation import motion_of
from skidsteer.drive import Drive, Series
from skidsteer.io.folder import read_folder
from skidsteer.models import Differential, Icr
from skidsteer.se2 import FloatArray, chain, compose, exp, wrap
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import Vehicle

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SENSORS = ("wheels", "pose", "gyro")
RECORDED = (*SENSORS, "command", "wheel_command")
KNOWN = {  # defects of the real drives that their README lists: naming them is no false alarm
    ("held_samples", "wheels"),
    ("quantised_wheels", "wheels"),
    ("commanded_wheels", "wheels"),
    ("frozen_reference", "pose"),
}
KNOWN_WITHOUT_POSE = {("clock_offset", "gyro"), ("clock_drift", "gyro"), ("clock_jump", "gyro")}


@dataclass(frozen=True)
class Variant:
    """A drive with one fault put in: what of it the doctor has to say."""

    label: str
    drive: Drive
    kinds: tuple[str, ...]  # any of these
    where: tuple[float, float] | None = None  # [s] a finding has to touch this


Injection = Callable[[Drive, np.random.Generator], Iterator[Variant]]


def found_in(variant: Variant, findings: tuple[Finding, ...]) -> bool:
    """Whether one of the findings names the fault, where it is."""
    for finding in findings:
        if finding.kind not in variant.kinds:
            continue
        if variant.where is None or not finding.where:
            return True
        if any(start <= variant.where[1] and end >= variant.where[0] for start, end in finding.where):
            return True
    return False


def parts(drive: Drive, *names: str) -> list[str]:
    return [name for name in names if getattr(drive, name) is not None]


def with_series(drive: Drive, part: str, t: FloatArray, values: FloatArray) -> Drive:
    changes: dict[str, Any] = {part: Series(t, values, part)}
    return replace(drive, **changes)


def with_values(drive: Drive, part: str, values: FloatArray) -> Drive:
    return with_series(drive, part, getattr(drive, part).t, values)


def with_times(drive: Drive, part: str, t: FloatArray) -> Drive:
    return with_series(drive, part, t, getattr(drive, part).values)


def where_true(drive: Drive, part: str, keep: np.ndarray) -> Drive:
    series = getattr(drive, part)
    return with_series(drive, part, series.t[keep], series.values[keep])


def moment(drive: Drive, share: float) -> float:
    """Time [s] at which the wheels have rolled that share of the way."""
    t, v = drive.wheels.t, np.abs(drive.wheels.values).max(axis=1)
    dt = np.diff(t, append=t[-1])
    way = np.cumsum(np.where(dt < 1.0, dt, 0.0) * v)
    return float(t[np.searchsorted(way, share * way[-1])])


def way_between(drive: Drive, start: float, end: float) -> float:
    """Way of the faster side [m] between two times."""
    part = drive.wheels.between(start, end)
    return 0.0 if part is None or len(part) < 2 else float(np.abs(part.values[:-1]).max(axis=1) @ np.diff(part.t))


def only(drive: Drive, index: np.ndarray) -> Drive:
    """The drive with only some of its segments, and nothing recorded outside of them."""
    kept = drive.with_segments(index)
    assert kept.segments is not None
    for part in parts(kept, *RECORDED):
        t = getattr(kept, part).t
        inside = np.zeros(len(t), bool)
        for start, end in kept.segments:
            inside |= (t >= start - 0.01) & (t <= end + 0.01)
        kept = where_true(kept, part, inside)
    return kept


def in_segments(drive: Drive, part: str) -> list[Series | None]:
    assert drive.segments is not None
    return [getattr(drive, part).between(start, end) for start, end in drive.segments]


def halves(drive: Drive) -> list[Drive]:
    """Both halves of a drive, by way rolled."""
    if drive.segments is not None:
        k = np.arange(len(drive.segments))
        return [only(drive, k[: len(k) // 2]), only(drive, k[len(k) // 2 :])]
    middle, (start, end) = moment(drive, 0.5), drive.span
    return [drive.between(start, middle), drive.between(middle, end)]


def portions(drive: Drive) -> list[Drive]:
    """The drive and those of its halves in which the robot turns by 180 degrees or more: else signs are invisible."""
    return [drive, *(half for half in halves(drive) if motion_of(gather(half)).turned > np.pi)]


# Sides and signs. A gyro alone cannot tell exchanged sides from its own sign: both are the finding turn_sign there.


def swapped(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for i, d in enumerate(portions(drive)):
        kinds = ("swapped_sides",) if d.pose is not None else ("turn_sign",)
        yield Variant(f"part {i}", with_values(d, "wheels", d.wheels.values[:, ::-1]), kinds)


def one_negated(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for i, d in enumerate(portions(drive)):
        yield Variant(f"left, part {i}", with_values(d, "wheels", d.wheels.values * [-1, 1]), ("left_negated",))
        yield Variant(f"right, part {i}", with_values(d, "wheels", d.wheels.values * [1, -1]), ("right_negated",))


def both_negated(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for i, d in enumerate(portions(drive)):
        kinds = ("both_negated",) if d.pose is not None else ("turn_sign",)
        yield Variant(f"part {i}", with_values(d, "wheels", -d.wheels.values), kinds)


def gyro_sign(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for i, d in enumerate(portions(drive)):
        if d.gyro is not None:
            kinds = ("gyro_sign",) if d.pose is not None else ("turn_sign",)
            yield Variant(f"part {i}", with_values(d, "gyro", -d.gyro.values), kinds)


# How sensors are built in.


def turned_reference(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for yaw in (90.0, -90.0, *rng.uniform(-150.0, 150.0, 3)) if drive.pose is not None else ():
        if abs(yaw) > 20.0:
            turned = compose(drive.pose.values, [*rng.uniform(-0.5, 0.5, 2), np.radians(yaw)])
            yield Variant(f"by {yaw:.0f} deg", with_values(drive, "pose", turned), ("turned_reference",))


def gyro_drift(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for total in (0.06, -0.12, 0.25) if drive.gyro is not None else ():
        t = drive.gyro.t
        drifting = drive.gyro.values + (total * (t - t[0]) / (t[-1] - t[0]))[:, None]
        yield Variant(f"{total:+g} rad/s", with_values(drive, "gyro", drifting), ("gyro_drift",))


# Units. With a gyro alone, rad/s and a wrong radius look like another track width: they are not injected there.


def gyro_degrees(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for i, d in enumerate(portions(drive)):
        if d.gyro is not None:
            yield Variant(f"part {i}", with_values(d, "gyro", np.degrees(d.gyro.values)), ("gyro_degrees",))


def yaw_degrees(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for i, d in enumerate(portions(drive)):
        for low in (-180.0, 0.0) if d.pose is not None else ():
            values = d.pose.values.copy()
            values[:, 2] = (np.degrees(values[:, 2]) - low) % 360.0 + low
            yield Variant(f"from {low:.0f}, part {i}", with_values(d, "pose", values), ("reference_yaw_degrees",))


def rad_per_second(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for i, d in enumerate(portions(drive)):
        if d.pose is not None:
            wrong = with_values(d, "wheels", d.wheels.values / d.vehicle.wheel_radius)
            yield Variant(f"part {i}", wrong, ("wheels_in_rad_s",))


def millimetres(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for i, d in enumerate(portions(drive)):
        yield Variant(f"part {i}", with_values(d, "wheels", 1e3 * d.wheels.values), ("wheels_in_mm_s",))


def ticks(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for per_turn in (78_000.0, 20_000.0, 8_192.0):
        counts = np.round(drive.wheels.values * per_turn / (2.0 * np.pi * drive.vehicle.wheel_radius))
        wrong = with_values(drive, "wheels", counts)
        yield Variant(f"{per_turn:.0f} a turn", wrong, ("wheels_in_ticks",))
        known = replace(wrong, vehicle=replace(drive.vehicle, ticks_per_revolution=per_turn))
        yield Variant(f"{per_turn:.0f} a turn, known", known, ("wheels_in_ticks",))


def wheel_radius(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for factor in (0.2, 0.3, 0.45, 2.2, 3.3, 6.0, 12.0) if drive.pose is not None else ():
        # A factor near 1 / radius is what rad/s for m/s looks like, too.
        kinds = ("wheel_radius", "wheels_in_rad_s")
        yield Variant(f"x {factor}", with_values(drive, "wheels", factor * drive.wheels.values), kinds)


# Clocks. In a drive of segments offsets stay below half the distance of segments. Drifts and jumps are put only into
# drives in which the sensors follow each other clearly, and whose clocks have no fault of their own.


def clock_offset(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    far = (30.0, -100.0, 1e3, 1.7e9) if drive.segments is None else ()
    for part in parts(drive, *SENSORS):
        t = getattr(drive, part).t
        for shift in (1.8, -1.8, 2.5, -3.0, 4.0, *far):
            yield Variant(f"{part} {shift:+g} s", with_times(drive, part, t + shift), ("clock_offset",))


def clear_clocks(drive: Drive) -> bool:
    evidence = gather(drive)
    pair = evidence.by_reference if evidence.by_reference is not None else evidence.by_gyro
    return pair is not None and pair.best.score > 50.0 and not any(f.kind.startswith("clock") for f in examine(drive))


def clock_drift(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    start, end = moment(drive, 0.02), moment(drive, 0.98)
    for part in parts(drive, *SENSORS) if clear_clocks(drive) else ():
        t = getattr(drive, part).t
        for total in rng.choice([-1, 1], 4) * [1.8, 2.5, 3.2, 4.0]:
            drifting = with_times(drive, part, t + total / (end - start) * (t - start))
            yield Variant(f"{part} {total:+.1f} s", drifting, ("clock_drift",))


def clock_jump(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for part in parts(drive, *SENSORS) if clear_clocks(drive) else ():
        for size in (1.8, 2.5, 4.0) if drive.segments is not None else (1.8, 4.0, 12.0, 25.0, 3600.0):
            when, signed = moment(drive, rng.uniform(0.3, 0.7)), size * (rng.choice([-1, 1]) if size < 100.0 else 1)
            tolerance = 10.0 if drive.segments is None else 60.0
            where = (when - size - tolerance, when + size + tolerance)
            wrong = jumped(drive, part, when, signed, rng)
            yield Variant(f"{part} {signed:+g} s at {when:.0f} s", wrong, ("clock_jump",), where)


def jumped(drive: Drive, part: str, when: float, size: float, rng: np.random.Generator) -> Drive:
    """A part with its clock set forward, or back: then the reader kept the samples before, after, or sorted them."""
    series = getattr(drive, part)
    late = series.t > when
    t = series.t + size * late
    keep = np.ones(len(t), bool)
    if size < 0.0:
        keep = [late | (t < when + size), ~late | (t > when), keep][rng.integers(3)]
    order = np.argsort(t[keep], kind="stable")
    t, values = t[keep][order], series.values[keep][order]
    first = np.r_[True, np.diff(t) > 0]
    return with_series(drive, part, t[first], values[first])


def whole_log_jump(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for size in (5.0, 20.0, 100.0, 3600.0, 1e9) if drive.segments is None and drive.pose is not None else ():
        when, wrong = fast_moment(drive, rng), drive
        for part in parts(drive, *RECORDED):
            t = getattr(drive, part).t
            wrong = with_times(wrong, part, t + size * (t > when))
        yield Variant(f"{size:g} s at {when:.0f} s", wrong, ("clock_jump",), (when - 2.0, when + size + 2.0))


def fast_moment(drive: Drive, rng: np.random.Generator) -> float:
    """A time at which the robot drives forward or back at more than half of its typical speed, for two seconds."""
    t, v = drive.wheels.t, np.abs(drive.wheels.values.mean(axis=1))
    fast = v > 0.5 * np.quantile(v[v > 0.02], 0.7)
    width = max(int(2.5 / np.median(np.diff(t))), 1)
    steady = np.flatnonzero(np.convolve(fast, np.ones(width) / width, "same") > 0.99)
    return float(t[rng.choice(steady)])


# Sampling. The wheels of the Warthog and of husky-windows are held already.


def frozen(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for length in (1.5, 2.0, 3.0, 5.0, 8.0) if drive.pose is not None else ():
        start = moment(drive, rng.uniform(0.1, 0.9))
        while drive.segments is None and way_between(drive, start, start + length - 0.8) < 0.2:
            start = moment(drive, rng.uniform(0.1, 0.9))
        length = length if drive.segments is None else 10.0 * length  # some windows of ten seconds each
        lost = (drive.pose.t >= start) & (drive.pose.t < start + length)
        wrong = with_values(
            drive, "pose", np.where(lost[:, None], drive.pose.values[np.argmax(lost)], drive.pose.values)
        )
        yield Variant(f"{length:g} s", wrong, ("frozen_reference",), (start - 0.1, start + length + 0.1))


def held(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    already = "wheels" if drive.name.startswith(("warthog", "husky-windows")) else ""
    for part in parts(drive, *SENSORS):
        series = getattr(drive, part)
        for count in (2, 3, 5, 8) if part != already else ():
            index = np.arange(len(series)) // count * count
            if rng.random() < 0.5:  # by time: an update falls on the first sample after it
                period = count * float(np.median(np.diff(series.t)))
                index = np.searchsorted(series.t, np.floor(series.t / period) * period)
            yield Variant(f"{part} x {count}", with_values(drive, part, series.values[index]), ("held_samples",))


def quantised(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    v, t = drive.wheels.values, drive.wheels.t
    typical = float(np.quantile(np.abs(v)[np.abs(v) > 0.1 * np.abs(v).max()], 0.6))
    dt = np.minimum(np.diff(t, append=t[-1] + 0.05), 1.0)[:, None]
    for share in (0.04, 0.1, 0.2):
        step = share * typical
        rounded = with_values(drive, "wheels", np.round(v / step) * step)
        yield Variant(f"speeds, {100 * share:.0f} %", rounded, ("quantised_wheels",))
        tick = step * float(np.median(dt))
        counts = np.round(np.cumsum(np.r_[np.zeros((1, 2)), v * dt], axis=0) / tick)
        counted = with_values(drive, "wheels", np.diff(counts * tick, axis=0) / dt)
        yield Variant(f"ticks, {100 * share:.0f} %", counted, ("quantised_wheels",))


def gap(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    # Segments are shorter than a gap that matters.
    for part in parts(drive, *SENSORS) if drive.segments is None else ():
        for length in (2.0, 4.0, 8.0):
            start = moment(drive, rng.uniform(0.1, 0.9))
            t = getattr(drive, part).t
            wrong = where_true(drive, part, (t < start) | (t > start + length))
            yield Variant(f"{part} {length:g} s at {start:.0f} s", wrong, ("gap",), (start, start + length))


def saturated_gyro(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for share in (0.8, 0.65, 0.5) if drive.gyro is not None else ():
        size = np.abs(drive.gyro.values)
        limit = share * np.quantile(size[size > 0.2 * size.max()], 0.9)
        clipped = with_values(drive, "gyro", np.clip(drive.gyro.values, -limit, limit))
        yield Variant(f"{limit:.2f} rad/s", clipped, ("saturated",))


def saturated_wheels(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    # With a gyro alone, a limit on both sides looks like a slower steady drive: not injected there.
    for share in (0.85, 0.75, 0.65, 0.5) if drive.pose is not None else ():
        size = np.abs(drive.wheels.values)
        limit = share * np.quantile(size[size > 0.2 * size.max()], 0.95)
        clipped = with_values(drive, "wheels", np.clip(drive.wheels.values, -limit, limit))
        yield Variant(f"{limit:.2f} m/s", clipped, ("saturated",))


# Motion: window drives are reduced to fitting windows of theirs; in the others motion is taken away from all sensors.


def standing(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    for _ in range(3):
        if drive.segments is not None:
            few = np.sort(rng.choice(len(drive.segments), 3, replace=False))
            yield Variant("three windows", only(drive, few), ("standing_still",))
        else:
            start = moment(drive, rng.uniform(0.0, 0.9))
            yield Variant(f"moves from {start:.0f} s", at_rest(drive, start, start + 6.0), ("standing_still",))


def at_rest(drive: Drive, start: float, end: float) -> Drive:
    """The drive with the robot at rest but for a time: what the sensors then say, with a little noise."""
    inside = {part: _within(getattr(drive, part).t, start, end)[:, None] for part in parts(drive, *SENSORS)}
    still = with_values(drive, "wheels", drive.wheels.values * inside["wheels"])
    if drive.gyro is not None:
        still = with_values(still, "gyro", drive.gyro.values * np.where(inside["gyro"], 1.0, 0.02))
    if drive.pose is not None:
        t = drive.pose.t
        index = np.searchsorted(t, np.clip(t, start, end)).clip(0, len(t) - 1)
        noise = np.random.default_rng(0).normal(0.0, 1e-3, (len(t), 3))
        still = with_values(still, "pose", drive.pose.values[index] + noise)
    return still


def _within(t: FloatArray, start: float, end: float) -> np.ndarray:
    return (t >= start) & (t < end)


def straight(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    kinds = ("straight_only", "little_turning")
    if drive.segments is None:
        for share in (0.02, 0.05):
            yield Variant(f"{share:.2f} of the turns", less_turning(drive, share, 0.0), kinds)
        return
    turn = np.array([np.ptp(s.values[:, 2]) if s else 9.0 for s in in_segments(drive, "pose")])
    for _ in range(3):
        some = np.sort(rng.choice(np.argsort(turn)[:12], 9, replace=False))
        yield Variant("the straightest windows", only(drive, some), kinds)


def circle(drive: Drive, rng: np.random.Generator) -> Iterator[Variant]:
    if drive.segments is None:
        for curve in rng.uniform(0.3, 1.5, 3) * rng.choice([-1, 1], 3):
            yield Variant(f"radius {1.0 / curve:.1f} m", less_turning(drive, 0.03, curve), ("circle_only",))
        return
    for target in rng.uniform(0.3, 0.8, 3) * rng.choice([-1, 1], 3):
        index = np.flatnonzero(curve_error(drive, target) < 0.15)
        if len(index) >= 6:
            yield Variant(f"windows near {target:.2f}", only(drive, index[:12]), ("circle_only",))


def less_turning(drive: Drive, share: float, curve: float) -> Drive:
    """The drive with a share of its turning, and a curve of that many rad/m in its place."""
    width = 2.0 * drive.vehicle.track_width
    speed = drive.wheels.values.mean(axis=1)
    turn = share * np.diff(drive.wheels.values, axis=1)[:, 0] + curve * width * speed
    wrong = with_values(drive, "wheels", np.stack([speed - 0.5 * turn, speed + 0.5 * turn], axis=-1))
    if drive.gyro is not None:
        v = wrong.wheels.hold(drive.gyro.t).mean(axis=1, keepdims=True)
        wrong = with_values(wrong, "gyro", share * drive.gyro.values + curve * v)
    if drive.pose is not None:
        step, heading = np.diff(drive.pose.values, axis=0), drive.pose.values[:-1, 2]
        forward = step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading)
        turned = share * wrap(step[:, 2]) + curve * forward
        wrong = with_values(wrong, "pose", chain(exp(np.stack([forward, 0.0 * forward, turned], axis=-1))))
    return wrong


def curve_error(drive: Drive, curve: float) -> FloatArray:
    """How far each segment's right minus left differs from curve times the mean of both sides, RMS over RMS."""
    rows = [s.values for s in in_segments(drive, "wheels") if s is not None]
    pairs = [(r.mean(axis=1), r[:, 1] - r[:, 0]) for r in rows]
    return np.array([np.sqrt(np.mean((w - curve * v) ** 2) / max(np.mean(w**2), 1e-3)) for v, w in pairs])


FAULTS: dict[str, Injection] = {
    "swapped sides": swapped,
    "one side negated": one_negated,
    "both sides negated": both_negated,
    "gyro sign": gyro_sign,
    "reference turned": turned_reference,
    "gyro drift": gyro_drift,
    "gyro in deg/s": gyro_degrees,
    "reference yaw in degrees": yaw_degrees,
    "wheels in rad/s": rad_per_second,
    "wheels in mm/s": millimetres,
    "wheels in ticks/s": ticks,
    "wheel radius": wheel_radius,
    "clock offset": clock_offset,
    "clock drift": clock_drift,
    "clock jump of one sensor": clock_jump,
    "clock jump of the whole log": whole_log_jump,
    "frozen reference": frozen,
    "held samples": held,
    "quantised wheels": quantised,
    "gap": gap,
    "saturated gyro": saturated_gyro,
    "saturated wheels": saturated_wheels,
    "standing still": standing,
    "straight, little turning": straight,
    "one circle only": circle,
}


def variants(fault: str, drive: Drive) -> list[Variant]:
    """All variants of a fault in a drive, the same ones each time."""
    rng = np.random.default_rng(zlib.crc32(f"{fault} {drive.name}".encode()))
    return [replace(v, label=f"{drive.name}: {v.label}") for v in FAULTS[fault](drive, rng)]


def false_alarms(drive: Drive, findings: tuple[Finding, ...]) -> list[Finding]:
    """Findings about an untouched real drive that its README does not list."""
    known = KNOWN if drive.pose is not None else KNOWN | KNOWN_WITHOUT_POSE
    return [finding for finding in findings if (finding.kind, finding.part) not in known]


def read_drives(folder: Path) -> list[Drive]:
    return [read_folder(path) for path in sorted(folder.iterdir()) if (path / "wheels.csv").exists()]


def simulated(seed: int) -> Drive:
    """A faultless drive of a random robot: width, slip, delay, speed and noise within what skid-steer robots do."""
    rng = np.random.default_rng(seed)
    track, top = rng.uniform(0.3, 1.5), rng.uniform(0.3, 5.0)
    width = track * (rng.uniform(1.2, 2.5) if rng.random() < 0.85 else rng.uniform(2.5, 6.0))
    shift = rng.uniform(-0.15, 0.15) * width
    truth = Icr(0.5 * width + shift, shift - 0.5 * width, rng.uniform(-0.2, 0.2), *rng.uniform(0.75, 1.1, 2))
    rows = []
    for _ in range(rng.integers(15, 60)):
        v = rng.uniform(-0.4, 1.0) * top if rng.random() < 0.8 else 0.0
        rows.append([rng.uniform(1.0, 8.0), v, rng.uniform(-1.0, 1.0) * min(1.2, top / track)])
    rims = rims_from_manoeuvres(np.array(rows), Differential(track), rate=100.0, acceleration=top)
    sensors = Sensors(
        reference_rate=float(rng.choice([1.0, 5.0, 10.0, 50.0])),
        position_sigma=float(rng.uniform(0.002, 0.03)),
        yaw_sigma=float(np.radians(rng.uniform(0.1, 1.5))),
        reference_delay=float(rng.uniform(-0.1, 0.8)),
        encoder_step=float(rng.choice([1e-6, 1e-5])),
    )
    vehicle = Vehicle("simulated", track_width=track, wheel_radius=float(rng.uniform(0.06, 0.35)))
    return kinematic_drive(f"simulated-{seed}", vehicle, truth, rims, sensors, 0.1, (0.01, 0.02), seed)


def study_faults(drives: list[Drive]) -> None:
    """Print how many variants of each fault are found, and which are not."""
    usual = {d.name: {f.kind for f in examine(d)} for d in drives}
    print(f"{'fault':28} {'variants':>8} {'found':>6} {'share':>8}   {'other kinds, too':>16}")
    missed, total, hits = [], 0, 0
    for fault in FAULTS:
        some = [(d, v) for d in drives for v in variants(fault, d)]
        found = others = 0
        for drive, variant in some:
            findings = examine(variant.drive)
            named, hit = {f.kind for f in findings}, found_in(variant, findings)
            found, others = found + hit, others + bool(named - set(variant.kinds) - usual[drive.name])
            missed += [] if hit else [f"{fault}: {variant.label} -> {', '.join(sorted(named)) or 'nothing'}"]
        total, hits = total + len(some), hits + found
        print(f"{fault:28} {len(some):8d} {found:6d} {100.0 * found / max(len(some), 1):6.1f} %   {others:16d}")
    print(f"{'all':28} {total:8d} {hits:6d} {100.0 * hits / max(total, 1):6.1f} %")
    print("not found:", *missed, sep="\n  ")


def study_alarms(drives: list[Drive]) -> None:
    """Print what is found in untouched drives, in their halves, and in simulated drives."""
    print("untouched drives (false alarms are marked with !):")
    for drive in drives:
        findings, started = examine(drive), time.perf_counter()
        findings = examine(drive)
        false = false_alarms(drive, findings)
        text = ", ".join(("! " if f in false else "") + f.kind for f in findings) or "nothing"
        print(f"  {drive.name:26} {time.perf_counter() - started:5.2f} s  {text}")
    others = [("half", half) for drive in drives for half in halves(drive)]
    others += [("without pose", replace(d, pose=None)) for d in drives if d.pose is not None and d.gyro is not None]
    others += [("without gyro", replace(d, gyro=None)) for d in drives if d.pose is not None and d.gyro is not None]
    others += [("position only", position_only(d)) for d in drives if d.pose is not None]
    others += [("simulated", simulated(seed)) for seed in range(60)]
    print(f"{len(others)} other faultless drives (halves, with fewer sensors, simulated):")
    for label, drive in others:
        for finding in false_alarms(drive, examine(drive)):
            print(f"  {label} {drive.name}: {finding.kind}: {finding.what}")


def position_only(drive: Drive) -> Drive:
    assert drive.pose is not None
    return replace(drive, pose=None, gyro=None, position=Series(drive.pose.t, drive.pose.values[:, :2], "position"))


def main() -> None:
    drives = read_drives(Path(sys.argv[1]) if len(sys.argv) > 1 else DATA)
    machine = f"Python {platform.python_version()}, {platform.machine()}"
    print(f"skidsteer {version('skidsteer')}, {machine}, {len(drives)} drives\n")
    study_faults(drives)
    study_alarms(drives)


if __name__ == "__main__":
    main()
