"""Bags to drives: rosbag1, rosbag2 (sqlite3, MCAP), MCAP files, whole or unfinished."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from skidsteer.drive import Drive
from skidsteer.errors import DataError, RequestError
from skidsteer.io.bag_names import name_of
from skidsteer.io.messages import JOINT_STATE, LASER_SCAN, TF_TYPES, Samples, gather
from skidsteer.io.open_bag import is_bag, open_bag
from skidsteer.io.options import AUTOMATIC, BagOptions
from skidsteer.io.raw import BagTopic, Source, shown
from skidsteer.io.reference import Frames, antenna_place, read_gyro, read_reference
from skidsteer.io.scans import plate_poses
from skidsteer.io.stamps import Clock, Timed, common_start, concatenated, to_series
from skidsteer.io.topics import ROLES, Choice, Looks, candidates, choose, namespace_of, offer
from skidsteer.io.wheels import joint_wheels, joints_in, pair_wheels, sides_in, twist_wheels
from skidsteer.vehicle import Vehicle

__all__ = ["AUTOMATIC", "BagContents", "BagOptions", "TopicEntry", "is_bag", "list_bag", "read_bag", "read_bag_noted"]

_LOOK = 50  # messages of a joint-state topic that are looked at to find its wheels
_LOOK_TF = 2000


@dataclass(frozen=True, slots=True)
class TopicEntry:
    """One topic of a bag: what it could serve as, and what it was or would be used as ("" for nothing)."""

    name: str
    type: str
    count: int
    serves: tuple[str, ...]
    used_as: str


@dataclass(frozen=True, slots=True)
class BagContents:
    """What a bag offers. ``chosen`` maps each role to its topic; ``notes`` are lines to show to the user.

    ``antenna`` is where the GNSS antenna sits in the base, x ahead and y left [m], if static transforms tell; the
    position reference is that of the antenna all the same, and ``Drive.antenna`` tells where it sits. Known only when
    the messages have been read.
    """

    path: str
    kind: str
    topics: tuple[TopicEntry, ...]
    chosen: Mapping[str, str]
    notes: tuple[str, ...]
    antenna: tuple[float, float] | None = None


def list_bag(path: str | os.PathLike[str], options: BagOptions = AUTOMATIC) -> BagContents:
    """What a bag holds, and what each topic would be used as. Reads little of the messages.

    Raises:
        DataError: the bag cannot be read.
        RequestError: a topic that the options name is not there.
    """
    with open_bag(path) as source:
        looks = _look(source, options)
        choice = choose(source.topics, options, looks)
        return _contents(path, source, choice, looks, choice.notes())


def read_bag(path: str | os.PathLike[str], vehicle: Vehicle, options: BagOptions = AUTOMATIC) -> Drive:
    """Read a bag as a drive; ``read_bag_noted`` also tells which topics were used and what was left out.

    Times are header stamps where there are any, else times of recording, in seconds from a whole second before the
    first sample. Topics that are not needed are not read. ``sha256`` is that of the numbers used.

    Args:
        path: a ``.mcap``, ``.db3`` or ``.bag`` file, or a folder of a rosbag2 recording.
        vehicle: gives wheel radius, track width and factory multiplier.
        options: which topics, joints and frames to use where the automatic choice does not fit.

    Raises:
        DataError: the bag, or what it holds, cannot be used.
        RequestError: nothing in it serves as wheels, or the options ask for something that is not there.
    """
    return read_bag_noted(path, vehicle, options)[0]


def read_bag_noted(
    path: str | os.PathLike[str], vehicle: Vehicle, options: BagOptions = AUTOMATIC
) -> tuple[Drive, BagContents]:
    """As ``read_bag``, with what the bag holds, which topics were chosen, and what was dropped or undone on the way."""
    with open_bag(path) as source:
        notes: list[str] = []
        looks = _look(source, options)
        choice = choose(source.topics, options, looks)
        _refuse_without_wheels(path, source, choice)
        _refuse_plate_without_scans(path, source, choice, options)
        notes += choice.notes()
        tables = _tables(source, choice, notes)
        parts = _parts(tables, choice, vehicle, options, notes)
        antenna = _antenna(choice, tables, options, notes)
        contents = replace(_contents(path, source, choice, looks, notes), antenna=antenna)
    start = common_start(list(parts.values()))
    series: dict[str, Any] = {part: to_series(timed, start, part) for part, timed in parts.items()}
    drive = Drive(
        name_of(Path(path).resolve()), vehicle, source=os.fspath(path), sha256=_digest(parts), antenna=antenna, **series
    )
    return drive, contents


def _antenna(
    choice: Choice, tables: Mapping[BagTopic, list[Samples]], options: BagOptions, notes: list[str]
) -> tuple[float, float] | None:
    if "reference" not in choice.chosen:
        return None
    topic = choice.chosen["reference"].topics[0]
    place = antenna_place(topic, tables[topic], Frames.of(tables, options))
    if place is not None:
        x, y = place
        notes.append(
            f"{shown(topic.name)}: the static transforms put the antenna {x:.3f} m ahead and {y:.3f} m left of the"
            " base; that is taken for --mount where none is given (--mount free: estimated)"
        )
    return place


def _look(source: Source, options: BagOptions) -> Looks:
    """Look at a few messages: names alone do not tell an arm's joints from wheels, nor what frames /tf connects."""
    joints = [topic for topic in source.topics if topic.type == JOINT_STATE]
    with_sides = [topic.name for topic in joints if _has_sides(_peek(source, topic, _LOOK), options)]
    transforms = [topic for topic in source.topics if topic.type in TF_TYPES]
    frames = Frames.of({topic: _peek(source, topic, _LOOK_TF) for topic in transforms}, options)
    return Looks(frozenset(with_sides), frames.chain is not None, options.plate is not None)


def _peek(source: Source, topic: BagTopic, limit: int) -> list[Samples]:
    """The first messages of a topic; what is damaged in them is told when they are read for use."""
    return gather(source, [topic], [], limit)[topic] if topic.count else []


def _has_sides(tables: Sequence[Samples], options: BagOptions) -> bool:
    sides = sides_in(tables, options)
    return sides is not None and {*sides.left, *sides.right} <= set(joints_in(tables))


def _refuse_without_wheels(path: str | os.PathLike[str], source: Source, choice: Choice) -> None:
    if "wheels" in choice.chosen:
        return
    if not any(topic.count for topic in source.topics):
        why = f" ({'; '.join(source.notes)})" if source.notes else ""
        raise DataError(f"{path}: holds no messages{why}")
    if source.notes:
        raise DataError(f"{path}: no topic serves as wheel speeds, and it is damaged: {'; '.join(source.notes)}")
    joints = [topic.name for topic in source.topics if topic.type == JOINT_STATE and topic.count]
    hint = f"; name the wheels of {joints[0]} with --left-joints and --right-joints" if joints else ""
    raise RequestError(f"{path}: no topic serves as wheel speeds{hint}; {offer(source.topics)}")


def _refuse_plate_without_scans(
    path: str | os.PathLike[str], source: Source, choice: Choice, options: BagOptions
) -> None:
    chosen = choice.chosen.get("reference")
    if options.plate is not None and (chosen is None or chosen.topics[0].type != LASER_SCAN):
        raise RequestError(f"{path}: no laser scans to see a plate in were chosen; {offer(source.topics)}")


def _tables(source: Source, choice: Choice, notes: list[str]) -> dict[BagTopic, list[Samples]]:
    """All messages of the chosen topics, and all static transforms; of the other transforms only if chosen."""
    wanted = [topic for candidate in choice.chosen.values() for topic in candidate.topics]
    wanted += [topic for topic in _transforms(source, choice) if _needs(topic, wanted)]
    return gather(source, wanted, notes)


def _transforms(source: Source, choice: Choice) -> list[BagTopic]:
    """Topics of transforms, without those of other robots: their frames may have the same names."""
    topics = [topic for topic in source.topics if topic.type in TF_TYPES]
    robot = namespace_of(choice.chosen["wheels"].topics[0])
    if not robot or robot not in map(namespace_of, topics):
        return topics
    return [topic for topic in topics if namespace_of(topic) in (robot, "")]


def _needs(topic: BagTopic, wanted: Sequence[BagTopic]) -> bool:
    if topic.name.endswith("_static"):
        return topic.count > 0
    # A chain can run through several topics of transforms.
    return topic.count > 0 and any(other.type in TF_TYPES for other in wanted)


def _parts(
    tables: Mapping[BagTopic, list[Samples]], choice: Choice, vehicle: Vehicle, options: BagOptions, notes: list[str]
) -> dict[str, Timed]:
    """The parts of the drive, by the names of its fields.

    Of the wheels, and of what the user asked for, faults are raised; of the rest they are noted, and it is left out.
    """
    for topic in (topic for candidate in choice.chosen.values() for topic in candidate.topics):
        if not tables[topic] and not any(note.startswith(f"{shown(topic.name)}: ") for note in notes):
            notes.append(f"{shown(topic.name)}: none of its {topic.count} messages can be read")
    wheels, clock = _wheels(choice.chosen["wheels"].topics, tables, vehicle, options, notes)
    parts = {"wheels": wheels}
    reader = _Reader(tables, Frames.of(tables, options), vehicle, wheels, options, clock, notes)
    asked = {
        "reference": options.reference_topic or options.plate,
        "imu": options.imu_topic,
        "command": options.command_topic,
    }
    for role, candidate in choice.chosen.items():
        try:
            parts.update(reader.part(role, candidate.topics[0]))
        except DataError as error:
            if asked.get(role):
                raise
            notes.append(f"{role} left out: {error}")
    if "pose" not in parts and "position" not in parts:
        notes.append("no reference; only what a gyro tells can be calibrated")
    return parts


@dataclass(frozen=True, slots=True)
class _Reader:
    """Makes parts of a drive out of the messages of the topics chosen for them."""

    tables: Mapping[BagTopic, list[Samples]]
    frames: Frames
    vehicle: Vehicle
    wheels: Timed
    options: BagOptions
    clock: Clock
    notes: list[str]

    def part(self, role: str, topic: BagTopic) -> dict[str, Timed]:
        """The part of this role by its name; nothing for the wheels, which were read before."""
        if role == "wheels":
            return {}
        found = _usable(self.tables, topic, self.notes)
        if topic.type == LASER_SCAN:
            return {"pose": plate_poses(topic, found, self.wheels, self.options.plate, self.clock, self.notes)}
        if role == "reference":
            return read_reference(topic, found, self.frames, self.clock, self.notes)
        if role == "imu":
            return {"gyro": read_gyro(topic, found, self.frames, self.clock, self.notes)}
        if role == "command":
            return {"command": self.clock.timed(concatenated(found), shown(topic.name), self.notes)}
        return {role: joint_wheels(shown(topic.name), found, self.vehicle, self.options, self.notes)[0]}


def _usable(tables: Mapping[BagTopic, list[Samples]], topic: BagTopic, notes: list[str]) -> list[Samples]:
    """The messages of a topic.

    Raises:
        DataError: there are none; with what is noted of them.
    """
    if not tables[topic]:
        raise DataError(next(note for note in notes if note.startswith(f"{shown(topic.name)}: ")))
    return tables[topic]


def _wheels(
    topics: Sequence[BagTopic],
    tables: Mapping[BagTopic, list[Samples]],
    vehicle: Vehicle,
    options: BagOptions,
    notes: list[str],
) -> tuple[Timed, Clock]:
    found = [_usable(tables, topic, notes) for topic in topics]
    name = shown(",".join(topic.name for topic in topics))
    if topics[0].type == JOINT_STATE:
        return joint_wheels(name, [table for tables in found for table in tables], vehicle, options, notes)
    if len(topics) == 2:
        return pair_wheels(topics, [concatenated(samples) for samples in found], vehicle, options, notes)
    return twist_wheels(name, concatenated(found[0]), vehicle, options, notes)


def _contents(
    path: str | os.PathLike[str], source: Source, choice: Choice, looks: Looks, notes: Iterable[str]
) -> BagContents:
    serves: dict[BagTopic, list[str]] = {}
    for role in ROLES:
        for candidate in candidates(role, source.topics, looks):
            for topic in candidate.topics:
                serves.setdefault(topic, []).append(role)
    used = {topic: role for role, candidate in choice.chosen.items() for topic in candidate.topics}
    entries = tuple(
        TopicEntry(topic.name, topic.type, topic.count, tuple(serves.get(topic, ())), used.get(topic, ""))
        for topic in sorted(source.topics, key=lambda topic: topic.name)
    )
    chosen = MappingProxyType({role: candidate.name for role, candidate in choice.chosen.items()})
    return BagContents(os.fspath(path), source.kind, entries, chosen, (*source.notes, *notes))


def _digest(parts: Mapping[str, Timed]) -> str:
    """SHA-256 over times and numbers: the same for the same recording in any container."""
    digest = hashlib.sha256()
    for name, timed in sorted(parts.items()):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(timed.ns, dtype="<i8").tobytes())
        digest.update(np.ascontiguousarray(timed.values, dtype="<f8").tobytes())
    return digest.hexdigest()
