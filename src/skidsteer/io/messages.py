"""What the decoded messages mean: each message type as a table of the numbers that matter here."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from skidsteer.errors import DataError, RequestError
from skidsteer.io.layout import Block, Decoder, LayoutError
from skidsteer.io.raw import BagTopic, Definitions, IntArray, RawMessages, Source, in_batches, shown
from skidsteer.se2 import FloatArray

JOINT_STATE = "sensor_msgs/msg/JointState"
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TF = "tf2_msgs/msg/TFMessage"
TF_TYPES = (TF, "tf/msg/tfMessage")  # the second before ROS Hydro
POINT = "geometry_msgs/msg/PointStamped"
TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
IMU = "sensor_msgs/msg/Imu"
NAVSAT = "sensor_msgs/msg/NavSatFix"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
COUNTERS = tuple(f"std_msgs/msg/{kind}" for kind in ("Int16", "Int32", "Int64", "UInt16", "UInt32", "UInt64"))
FLOATS = ("std_msgs/msg/Float32", "std_msgs/msg/Float64")

_XYZ = ("x", "y", "z")
_XYZW = ("x", "y", "z", "w")


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Numbers of messages that share a label (frame names, or joint names), in the order of the file."""

    label: tuple[str, ...]
    bag_ns: IntArray  # (n,) time of recording [ns]
    header_ns: IntArray  # (n,) time in the message's header [ns], 0 where it has none
    values: FloatArray  # (n, k)


def _under(prefix: str, names: Iterable[str]) -> tuple[str, ...]:
    return tuple(prefix + name for name in names)


def _header_ns(block: Block, prefix: str = "") -> IntArray:
    seconds = block.column(prefix + "header.stamp.sec").astype(np.int64)
    return seconds * 1_000_000_000 + block.column(prefix + "header.stamp.nanosec").astype(np.int64)


def _stamped(block: Block, bag_ns: IntArray, names: tuple[str, ...], *texts: str) -> list[Samples]:
    label = tuple(block.text(text).lstrip("/") for text in ("header.frame_id", *texts))
    return [Samples(label, bag_ns, _header_ns(block), block.numbers(names))]


def _joint_state(block: Block, bag_ns: IntArray) -> list[Samples]:
    """Values (n, 2 k): the positions [rad] of all joints, then their velocities [rad/s]; NaN where there are none."""
    names = tuple(text for path, text in block.layout.texts.items() if path.startswith("name["))
    parts = []
    for quantity in ("position", "velocity"):
        values = block.column(quantity).astype(np.float64)
        parts.append(values if values.shape[1] == len(names) else np.full((len(bag_ns), len(names)), np.nan))
    return [Samples(names, bag_ns, _header_ns(block), np.concatenate(parts, axis=1))]


def _odometry(block: Block, bag_ns: IntArray) -> list[Samples]:
    pose = _under("pose.pose.position.", _XYZ) + _under("pose.pose.orientation.", _XYZW)
    return _stamped(block, bag_ns, (*pose, "twist.twist.linear.x", "twist.twist.angular.z"), "child_frame_id")


def _pose(block: Block, bag_ns: IntArray) -> list[Samples]:
    return _stamped(block, bag_ns, _under("pose.position.", _XYZ) + _under("pose.orientation.", _XYZW))


def _pose_covariance(block: Block, bag_ns: IntArray) -> list[Samples]:
    return _stamped(block, bag_ns, _under("pose.pose.position.", _XYZ) + _under("pose.pose.orientation.", _XYZW))


def _transform(block: Block, bag_ns: IntArray, prefix: str = "") -> list[Samples]:
    names = _under(prefix + "transform.translation.", _XYZ) + _under(prefix + "transform.rotation.", _XYZW)
    label = (block.text(prefix + "header.frame_id").lstrip("/"), block.text(prefix + "child_frame_id").lstrip("/"))
    return [Samples(label, bag_ns, _header_ns(block, prefix), block.numbers(names))]


def _transforms(block: Block, bag_ns: IntArray) -> list[Samples]:
    paths = [path[: -len("child_frame_id")] for path in block.layout.texts if path.endswith("].child_frame_id")]
    return [samples for path in paths for samples in _transform(block, bag_ns, path)]


def _point(block: Block, bag_ns: IntArray) -> list[Samples]:
    return _stamped(block, bag_ns, _under("point.", _XYZ))


def _twist(block: Block, bag_ns: IntArray) -> list[Samples]:
    return [Samples(("",), bag_ns, np.zeros_like(bag_ns), block.numbers(("linear.x", "angular.z")))]


def _twist_stamped(block: Block, bag_ns: IntArray) -> list[Samples]:
    return _stamped(block, bag_ns, ("twist.linear.x", "twist.angular.z"))


def _imu(block: Block, bag_ns: IntArray) -> list[Samples]:
    return _stamped(block, bag_ns, _under("angular_velocity.", _XYZ))


def _navsat(block: Block, bag_ns: IntArray) -> list[Samples]:
    """Values (n, 6): latitude, longitude [deg], altitude [m], fix status, horizontal variance [m2], covariance type."""
    variance = block.column("position_covariance").astype(np.float64)
    names = ("latitude", "longitude", "altitude", "status.status", "position_covariance_type")
    values = np.insert(block.numbers(names), 4, 0.5 * (variance[:, 0] + variance[:, 4]), axis=1)
    values[:, [2, 4]] = np.nan_to_num(values[:, [2, 4]], posinf=0.0, neginf=0.0)  # receivers say "unknown" so
    return [Samples((block.text("header.frame_id").lstrip("/"),), bag_ns, _header_ns(block), values)]


def _laser_scan(block: Block, bag_ns: IntArray) -> list[Samples]:
    """Values (n, 3 + m): first bearing, step [rad], time from ray to ray [s], m ranges [m], 0 where none came back."""
    ranges = block.column("ranges").astype(np.float64)
    nearest, farthest = np.split(block.numbers(("range_min", "range_max")), 2, axis=1)
    ranges[~((ranges >= nearest) & (ranges <= farthest) & (ranges < np.inf))] = 0.0
    head = block.numbers(("angle_min", "angle_increment", "time_increment"))
    label = (block.text("header.frame_id").lstrip("/"),)
    return [Samples(label, bag_ns, _header_ns(block), np.concatenate([head, ranges], axis=1))]


def _number(block: Block, bag_ns: IntArray) -> list[Samples]:
    return [Samples(("",), bag_ns, np.zeros_like(bag_ns), block.numbers(("data",)))]


TABLES: dict[str, Callable[[Block, IntArray], list[Samples]]] = {
    JOINT_STATE: _joint_state,
    ODOMETRY: _odometry,
    POSE: _pose,
    POSE_COVARIANCE: _pose_covariance,
    TRANSFORM: _transform,
    **dict.fromkeys(TF_TYPES, _transforms),
    POINT: _point,
    TWIST: _twist,
    TWIST_STAMPED: _twist_stamped,
    IMU: _imu,
    NAVSAT: _navsat,
    LASER_SCAN: _laser_scan,
    **dict.fromkeys((*COUNTERS, *FLOATS), _number),
}


def gather(
    source: Source, topics: Iterable[BagTopic], notes: list[str], limit: int | None = None
) -> dict[BagTopic, list[Samples]]:
    """Read and decode topics: for each a list of samples with different labels, [] where there is no message.

    Messages that do not fit their definition are left out and counted in ``notes``.
    """
    found: dict[BagTopic, list[Samples]] = {topic: [] for topic in topics}
    decoders = {topic: decoder for topic in found if (decoder := _decoder(topic, notes))}
    for topic, raw in in_batches(source.read(list(decoders), limit)):
        found[topic] += _tables(decoders[topic], raw)
    for topic, decoder in decoders.items():
        if decoder.undecoded:
            what = f"{decoder.undecoded} messages do not fit {shown(topic.type)} ({shown(decoder.problem)})"
            notes.append(f"{shown(topic.name)}: {what}; left out")
    return {topic: _merged(samples) for topic, samples in found.items()}


def _decoder(topic: BagTopic, notes: list[str]) -> Decoder | None:
    try:
        return Decoder(definitions_of(topic), topic.type, topic.encoding)
    except DataError as error:
        notes.append(f"{shown(topic.name)}: {error}")
        return None


def _tables(decoder: Decoder, raw: RawMessages) -> list[Samples]:
    tables: list[Samples] = []
    for block in decoder.blocks(raw):
        try:
            tables += TABLES[decoder.type_name](block, raw.bag_ns[block.rows])
        except LayoutError as error:  # a custom definition under a standard name
            decoder.undecoded += len(block.rows)
            decoder.problem = decoder.problem or str(error)
    return tables


def _merged(samples: list[Samples]) -> list[Samples]:
    groups: dict[tuple[tuple[str, ...], int], list[Samples]] = {}
    for part in samples:
        groups.setdefault((part.label, part.values.shape[1]), []).append(part)
    return [
        Samples(
            label,
            np.concatenate([part.bag_ns for part in parts]),
            np.concatenate([part.header_ns for part in parts]),
            np.concatenate([part.values for part in parts]),
        )
        for (label, _), parts in groups.items()
    ]


def definitions_of(topic: BagTopic) -> Definitions:
    """The definitions a topic is decoded with: the bag's own, and where it has none those of ROS.

    Raises:
        DataError: the bag's definition cannot be parsed.
    """
    standard = standard_definitions(1 if topic.encoding == "ros1" else 2)
    if topic.definition is None or not topic.definition.text.strip():
        return standard
    return {**standard, **_parsed(topic.definition.kind, topic.definition.text, topic.type)}


_IDL_RULE = "=" * 80 + "\n"
_MAX_DEFINITION = 1 << 20


@lru_cache(maxsize=256)
def _parsed(kind: str, text: str, type_name: str) -> Definitions:
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if len(text) > _MAX_DEFINITION:
        raise DataError(f"the definition of {shown(type_name)} in the bag has {len(text)} characters; it is damaged")
    try:
        if kind == "msg":
            return dict(get_types_from_msg(text, type_name))
        found: Definitions = {}
        parts = [part.split("\n", 1)[1] for part in text.split(_IDL_RULE) if part.startswith("IDL: ")]
        for part in parts or [text]:
            found.update(get_types_from_idl(part))
    except Exception as error:  # the parser fails in many ways on damaged text
        raise DataError(f"the definition of {shown(type_name)} in the bag cannot be parsed: {shown(error)}") from error
    return found


@lru_cache(maxsize=2)
def standard_definitions(ros_version: int) -> Definitions:
    """The message definitions of ROS 1 Noetic or ROS 2 Humble; the types read here are the same in all of ROS 2."""
    transforms: Any = ([], [("transforms", (4, ((2, TRANSFORM), 0)))])  # absent from the ROS 1 store
    return {**dict.fromkeys(TF_TYPES, transforms), **type_store(ros_version).fielddefs}


def type_store(ros_version: int) -> Any:
    """The type store of ``rosbags`` for ROS 1 or ROS 2.

    Raises:
        RequestError: ``rosbags`` is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise RequestError("reading and writing bags needs more packages: pip install 'skidsteer[bags]'") from error
    return get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)
