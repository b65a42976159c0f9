"""Which topic serves as what: by type, by name, and by what the user says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from skidsteer.errors import RequestError
from skidsteer.io.messages import (
    COUNTERS,
    FLOATS,
    IMU,
    JOINT_STATE,
    LASER_SCAN,
    NAVSAT,
    ODOMETRY,
    POINT,
    POSE,
    POSE_COVARIANCE,
    TABLES,
    TF_TYPES,
    TRANSFORM,
    TWIST,
    TWIST_STAMPED,
)
from skidsteer.io.options import BagOptions
from skidsteer.io.raw import BagTopic, shown
from skidsteer.io.wheels import side_of, words

ROLES = ("wheels", "reference", "imu", "command", "wheel_command")
_TYPES = {
    "wheels": (JOINT_STATE, ODOMETRY, TWIST_STAMPED, *COUNTERS, *FLOATS),
    "reference": (ODOMETRY, POSE, POSE_COVARIANCE, TRANSFORM, POINT, NAVSAT, LASER_SCAN, *TF_TYPES),
    "imu": (IMU,),
    "command": (TWIST, TWIST_STAMPED),
    "wheel_command": (JOINT_STATE,),
}
_OPTION = {
    "wheels": "--wheels-topic",
    "reference": "--reference-topic",
    "imu": "--imu-topic",
    "command": "--command-topic",
    "wheel_command": "",
}

_GOALS = {"goal", "target", "initialpose", "setpoint", "plan", "waypoint", "clicked", "desired", "skidsteer"}
_TRUTH = {"ground", "truth", "groundtruth", "gt", "reference", "mocap", "vicon", "optitrack", "qualisys", "vrpn"}
_TRUTH |= {"natnet", "icp", "slam", "lidar", "laser", "scan", "ndt", "lio", "loam", "liosam", "amcl", "localization"}
_TRUTH |= {"leica", "prism", "station", "rtk", "gnss", "gps", "world", "map"}
_FUSED = {"filtered", "ekf", "ukf", "fused", "combined", "global", "local"}
_WHEEL_ODOMETRY = {"odom", "wheel", "wheels", "controller", "diff", "drive", "encoder", "base", "raw", "platform"}
_COMMAND = {"cmd", "command", "commands", "cmds"}
_NEAR_BASE = {"out", "controller", "platform", "base", "mux"}
_FAR_FROM_BASE = {"joy", "teleop", "nav", "key", "keyboard", "web", "smooth", "raw", "marker", "external"}
_MEASURED = {"odom", "wheel", "wheels", "measured", "feedback", "actual", "status", "encoder"}
_FEW, _FEW_COST = 10, 10
_ITS_OWN = 6  # what the namespace of the robot counts, more than words like raw, less than a camera's IMU costs
_CAMERA = {"camera", "realsense", "zed", "ouster", "os", "velodyne", "livox", "d435i", "t265", "hand"}


@dataclass(frozen=True, slots=True)
class Candidate:
    """A topic (or a pair of them) that could serve, the better the higher its score; below zero only if asked for."""

    topics: tuple[BagTopic, ...]
    score: int

    @property
    def name(self) -> str:
        """Name of the topic, or the names joined by a comma."""
        return ",".join(topic.name for topic in self.topics)


@dataclass(frozen=True, slots=True)
class Looks:
    """What is known before: which joint states have wheels, whether /tf has a usable chain, of a plate to be seen."""

    with_sides: frozenset[str]  # names of JointState topics with wheels on both sides
    has_chain: bool
    has_plate: bool = False


def candidates(role: str, topics: Sequence[BagTopic], looks: Looks) -> list[Candidate]:
    """All that could serve in a role, the best first."""
    score = {
        "wheels": _score_wheels,
        "reference": _score_reference,
        "imu": _score_imu,
        "command": _score_command,
        "wheel_command": _score_wheel_command,
    }[role]
    found = [
        # A handful of poses is a goal or a start, hardly a reference.
        Candidate((topic,), value - _FEW_COST * (topic.count < _FEW))
        for topic in topics
        if _readable(topic) and topic.type in _TYPES[role] and (value := score(topic, looks)) is not None
    ]
    if role == "wheels":
        found += _counter_pairs(topics)
    return sorted(found, key=lambda item: (-item.score, -item.topics[0].count, item.name))


def _readable(topic: BagTopic) -> bool:
    return topic.count > 0 and topic.type in TABLES and topic.encoding in ("cdr", "ros1")


def _score_wheels(topic: BagTopic, looks: Looks) -> int | None:
    name = set(words(topic.name))
    if topic.type == JOINT_STATE:
        if topic.name not in looks.with_sides or name & _COMMAND:
            return None
        return 45 if "joint" in name else 40
    if topic.type == ODOMETRY:
        if name & (_GOALS | _TRUTH):
            return None
        if name & _FUSED:
            return -1
        return 20 + 2 * len(name & {"wheel", "wheels", "raw", "controller"}) if name & _WHEEL_ODOMETRY else 10
    if topic.type == TWIST_STAMPED:
        return 15 if name & _MEASURED and not name & _COMMAND else None
    return None


def _score_reference(topic: BagTopic, looks: Looks) -> int | None:
    name = set(words(topic.name))
    if name & _GOALS:
        return None
    if topic.type in TF_TYPES:
        return 25 if looks.has_chain and not topic.name.endswith("_static") else None
    if topic.type == LASER_SCAN:
        return 40 if looks.has_plate else None
    if topic.type == NAVSAT:
        return 15 + 2 * bool(name & {"rtk"}) - 3 * bool(name & {"filtered"})
    if topic.type == POINT:
        return 18 if name & (_TRUTH | {"position", "pose", "total"}) else -1
    if topic.type == ODOMETRY:
        if name & _TRUTH:
            return 32
        return -1 if _is_of_wheels(topic) else 10
    return 35 if name & _TRUTH else 30


def _is_of_wheels(topic: BagTopic) -> bool:
    """Whether an odometry is by its name what came of the wheels, or was fused of them: no reference for the wheels."""
    name = set(words(topic.name))
    return topic.type == ODOMETRY and bool(name & (_FUSED | _WHEEL_ODOMETRY)) and not name & _TRUTH


def _score_imu(topic: BagTopic, looks: Looks) -> int | None:
    del looks
    name = set(words(topic.name))
    return 20 + 2 * bool(name & {"data"}) - bool(name & {"raw"}) - 10 * bool(name & _CAMERA)


def _score_command(topic: BagTopic, looks: Looks) -> int | None:
    del looks
    name = set(words(topic.name))
    if not name & _COMMAND:
        return None
    return 20 + 3 * len(name & _NEAR_BASE) - 3 * len(name & _FAR_FROM_BASE)


def _score_wheel_command(topic: BagTopic, looks: Looks) -> int | None:
    return 20 if topic.name in looks.with_sides and set(words(topic.name)) & _COMMAND else None


def _counter_pairs(topics: Sequence[BagTopic]) -> list[Candidate]:
    """Pairs of counter topics whose names differ only in the side."""
    sides: dict[str, dict[tuple[str, ...], BagTopic]] = {"left": {}, "right": {}}
    for topic in topics:
        side = side_of(topic.name)
        if topic.type in COUNTERS and _readable(topic) and side:
            sides[side][_without_side(topic.name)] = topic
    return [Candidate((left, sides["right"][key]), 30) for key, left in sides["left"].items() if key in sides["right"]]


def _without_side(name: str) -> tuple[str, ...]:
    stripped = name.lower().replace("left", "").replace("right", "")
    return tuple(word for word in words(stripped) if word not in ("l", "r"))


@dataclass(frozen=True, slots=True)
class Choice:
    """What was chosen for each role, and what else could have served."""

    chosen: Mapping[str, Candidate]
    others: Mapping[str, tuple[Candidate, ...]]

    def notes(self) -> list[str]:
        """One line for each role in which there was a choice, and on a reference that is none."""
        lines = []
        for role, candidate in self.chosen.items():
            rest = [other.name for other in self.others[role] if other.score >= 0]
            if rest:
                option = f"; {_OPTION[role]} decides" if _OPTION[role] else ""
                lines.append(f"{role}: {shown(candidate.name)} chosen over {shown(', '.join(rest))}{option}")
            if role == "reference" and _is_of_wheels(candidate.topics[0]):
                lines.append(
                    f"reference: {shown(candidate.name)} came from the wheels, by its name; held against that, a"
                    " calibration finds the robot's own settings again"
                )
        return lines


def choose(topics: Sequence[BagTopic], options: BagOptions, looks: Looks) -> Choice:
    """Choose a topic for each role; none serves in two.

    Raises:
        RequestError: a topic that the user names is not in the bag or is of a type that cannot serve.
    """
    asked = {
        "wheels": options.wheels_topic,
        "reference": options.reference_topic,
        "imu": options.imu_topic,
        "command": options.command_topic,
    }
    chosen: dict[str, Candidate] = {}
    others: dict[str, tuple[Candidate, ...]] = {}
    named = {name for names in asked.values() if names for name in names.split(",")}
    for role in ROLES:
        found = candidates(role, topics, looks)
        if "wheels" in chosen:
            found = _same_robot_first(role, found, chosen["wheels"])
        wanted = asked.get(role)
        taken = {topic for candidate in chosen.values() for topic in candidate.topics}
        if wanted:
            pick: Candidate | None = _asked_for(role, wanted, topics)
        else:
            free = (item for item in found if item.score >= 0 and not _is_taken(item, taken, named))
            pick = next(free, None)
        if pick is not None:
            chosen[role] = pick
            others[role] = tuple(item for item in found if item.name != pick.name and not set(item.topics) & taken)
    return Choice(chosen, others)


def namespace_of(topic: BagTopic) -> str:
    """The first of the names that a topic's name is made of, "" where it is the only one."""
    first, *rest = topic.name.strip("/").split("/")
    return first if rest else ""


def _same_robot_first(role: str, found: Sequence[Candidate], wheels: Candidate) -> list[Candidate]:
    """Candidates in order, those ahead that are of the robot of the wheels by their namespace.

    Of several robots, one's IMU must not go with another's wheels. What sees them all has its own namespace: for a
    reference, the robot only decides between equals.
    """
    robot = namespace_of(wheels.topics[0])

    def key(item: Candidate) -> float:
        is_its = bool(robot) and robot in item.topics[0].name.split("/")
        return -(item.score + is_its * (item.score >= 0) * (0.5 if role == "reference" else _ITS_OWN))

    return sorted(found, key=key)


def _is_taken(candidate: Candidate, taken: set[BagTopic], named: set[str]) -> bool:
    return any(topic in taken or topic.name in named for topic in candidate.topics)


def _asked_for(role: str, wanted: str, topics: Sequence[BagTopic]) -> Candidate:
    found = []
    names = [name.strip() for name in wanted.split(",")]
    for name in names:
        same = [topic for topic in topics if topic.name == name]
        if not same:
            raise RequestError(f"no topic {shown(name)} for the {role}; {offer(topics)}")
        fit = [topic for topic in same if topic.type in _TYPES[role] and _readable(topic)]
        if not fit:
            what = f"is {shown(same[0].type)} with {same[0].count} messages, encoded as {shown(same[0].encoding)}"
            raise RequestError(f"topic {shown(name)} {what}: cannot serve as {role}; {offer(topics)}")
        found.append(max(fit, key=lambda topic: topic.count))
    numbers = role == "wheels" and all(topic.type in (*COUNTERS, *FLOATS) for topic in found)
    by_side = role == "wheels" and len(found) == 2 and all(topic.type == JOINT_STATE for topic in found)
    if len(found) != (2 if numbers else 1) and not by_side:
        need = "a left and a right topic, joined by a comma" if numbers else "one topic"
        raise RequestError(f"{shown(wanted)} for the {role}: need {need}")
    return Candidate(tuple(found), 100)


def offer(topics: Sequence[BagTopic]) -> str:
    """What a bag holds, in a line."""
    if not topics:
        return "the bag holds no topics"
    ordered = sorted(topics, key=lambda topic: topic.name)
    listed = ", ".join(f"{shown(topic.name, 60)} ({shown(topic.type.split('/')[-1], 40)})" for topic in ordered)
    return f"the bag holds {shown(listed, 600)}"
