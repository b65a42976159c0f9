"""Bags for the tests, written by ``rosbags``: an independent peer of our readers and of our MCAP writer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from skidsteer.drive import Drive, Series
from skidsteer.vehicle import Vehicle

KINDS = ("rosbag1", "rosbag1-bz2", "rosbag1-lz4", "sqlite3", "mcap", "mcap-zstd", "mcap-message", "mcap-file")
VEHICLE = Vehicle("test-robot", track_width=0.6, wheel_radius=0.15)
START = 1_700_000_000  # [s] whole, so that a drive that starts within its first second keeps its times
STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
STORES[1].register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))


@dataclass(frozen=True)
class Message:
    topic: str
    type: str
    bag_ns: int
    value: dict[str, Any]  # nested: field -> value; "header" as (stamp_ns, frame)


def build(store: Any, type_name: str, value: Any) -> Any:
    """A message object of the library from nested dictionaries; fields not given are zero, empty or []."""
    arguments = {}
    for name, description in store.fielddefs[type_name][1]:
        given = value.get(name) if isinstance(value, dict) else None
        arguments[name] = _field(store, description, given)
    return store.types[type_name](**arguments)


def _field(store: Any, description: Any, given: Any) -> Any:
    kind, detail = int(description[0]), description[1]
    if kind == 2:
        if detail == "std_msgs/msg/Header":
            ns, frame = given or (0, "")
            given = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": frame}
        return build(store, detail, given or {})
    if kind == 1:
        if given is not None:
            return given
        return "" if detail[0] == "string" else 0
    (inner_kind, inner), count = detail
    if int(inner_kind) == 2:
        return [build(store, inner, item) for item in given or ()]
    if inner[0] == "string":
        return list(given or ())
    return np.array(given if given is not None else [0] * (count if kind == 3 else 0), dtype=inner[0])


def write_messages(path: Path, kind: str, messages: Iterable[Message]) -> Path:
    """Write messages as a bag of this kind; returns what a user would give as DRIVE."""
    ordered = sorted(messages, key=lambda message: message.bag_ns)
    if kind.startswith("rosbag1"):
        return _write1(path.with_suffix(".bag"), kind, ordered)
    return _write2(path, kind, ordered)


def _write1(path: Path, kind: str, messages: Sequence[Message]) -> Path:
    writer = Writer1(path)
    if kind != "rosbag1":
        writer.set_compression(getattr(Writer1.CompressionFormat, kind.split("-")[1].upper()))
    return _fill(writer, path, STORES[1], STORES[1].serialize_ros1, messages)


def _write2(path: Path, kind: str, messages: Sequence[Message]) -> Path:
    plugin = StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP
    writer = Writer2(path, version=9, storage_plugin=plugin)
    modes = {"zstd": CompressionMode.STORAGE, "message": CompressionMode.MESSAGE, "file": CompressionMode.FILE}
    if "-" in kind:
        writer.set_compression(modes[kind.split("-")[1]], CompressionFormat.ZSTD)
    return _fill(writer, path, STORES[2], STORES[2].serialize_cdr, messages)


def _fill(writer: Any, path: Path, store: Any, serialize: Callable[..., Any], messages: Sequence[Message]) -> Path:
    with writer:
        connections: dict[str, Any] = {}
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(message.topic, message.type, typestore=store)
            data = serialize(build(store, message.type, message.value), message.type)
            writer.write(connections[message.topic], message.bag_ns, data)
    return path


def write_bag(drive: Drive, path: Path, kind: str, wheels: str = "velocity", reference: str = "odometry") -> Path:
    """The same drive as a bag of any kind. The vehicle's radius turns rim speeds into wheel rates."""
    return write_messages(path, kind, drive_messages(drive, wheels, reference))


def drive_messages(drive: Drive, wheels: str = "velocity", reference: str = "odometry") -> list[Message]:
    messages = wheel_messages(drive, wheels)
    if drive.pose is not None:
        messages += pose_messages(drive.pose, reference)
    if drive.position is not None:
        messages += [
            Message("/prism/position", "geometry_msgs/msg/PointStamped", ns, {"header": (ns, "map"), "point": xyz(p)})
            for ns, p in samples(drive.position)
        ]
    if drive.gyro is not None:
        messages += [
            Message(
                "/imu/data",
                "sensor_msgs/msg/Imu",
                ns,
                {"header": (ns, "imu_link"), "angular_velocity": {"z": float(rate[0])}},
            )
            for ns, rate in samples(drive.gyro)
        ]
    if drive.command is not None:
        messages += [
            Message("/cmd_vel", "geometry_msgs/msg/Twist", ns, twist(*command))
            for ns, command in samples(drive.command)
        ]
    return messages


def samples(series: Series) -> Iterable[tuple[int, Any]]:
    for t, values in zip(series.t, series.values, strict=True):
        yield START * 10**9 + round(t * 1e9), values


def xyz(point: Any) -> dict[str, float]:
    return dict(zip("xyz", map(float, point), strict=False))


def twist(v: float, omega: float) -> dict[str, Any]:
    return {"linear": {"x": float(v)}, "angular": {"z": float(omega)}}


def pose(x: float, y: float, yaw: float) -> dict[str, Any]:
    turn = {"z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}
    return {"position": {"x": float(x), "y": float(y)}, "orientation": turn}


def wheel_messages(drive: Drive, wheels: str) -> list[Message]:
    radius = drive.vehicle.wheel_radius
    names = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]
    if wheels == "odometry":
        return [
            Message(
                "/wheel/odom",
                "nav_msgs/msg/Odometry",
                ns,
                {
                    "header": (ns, "odom"),
                    "child_frame_id": "base_link",
                    "twist": {"twist": twist((left + right) / 2, (right - left) / drive.vehicle.track_width)},
                },
            )
            for ns, (left, right) in samples(drive.wheels)
        ]
    rates = drive.wheels.values[:, [0, 1, 0, 1]] / radius
    steps = rates[:-1] * np.diff(drive.wheels.t)[:, None]
    angles = np.concatenate([np.zeros((1, 4)), np.cumsum(steps, axis=0)])
    messages = []
    for index, (ns, _) in enumerate(samples(drive.wheels)):
        value: dict[str, Any] = {"header": (ns, ""), "name": names}
        if wheels in ("velocity", "both"):
            value["velocity"] = rates[index]
        if wheels in ("position", "both"):
            value["position"] = angles[index]
        messages.append(Message("/joint_states", "sensor_msgs/msg/JointState", ns, value))
    return messages


def pose_messages(series: Series, reference: str) -> list[Message]:
    """Poses as each of the types that can carry them; "tf" as map -> odom -> base_link."""
    messages = []
    for ns, (x, y, yaw) in samples(series):
        header, at = (ns, "map"), pose(x, y, yaw)
        move = {"translation": at["position"], "rotation": at["orientation"]}
        if reference == "odometry":
            value = {"header": header, "child_frame_id": "base_link", "pose": {"pose": at}}
            messages.append(Message("/ground_truth/odom", "nav_msgs/msg/Odometry", ns, value))
        elif reference == "pose":
            messages.append(Message("/mocap", "geometry_msgs/msg/PoseStamped", ns, {"header": header, "pose": at}))
        elif reference == "pose_covariance":
            value = {"header": header, "pose": {"pose": at}}
            messages.append(Message("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", ns, value))
        elif reference == "transform":
            value = {"header": header, "child_frame_id": "base_link", "transform": move}
            messages.append(Message("/vicon/robot", "geometry_msgs/msg/TransformStamped", ns, value))
        else:
            still = {"translation": {"x": 1.0, "y": -2.0}, "rotation": {"w": 1.0}}
            first = {"header": header, "child_frame_id": "odom", "transform": move}
            second = {"header": (ns, "odom"), "child_frame_id": "base_link", "transform": still}
            messages.append(Message("/tf", "tf2_msgs/msg/TFMessage", ns, {"transforms": [first, second]}))
    return messages


def example_drive(seconds: float = 4.0, seed: int = 0) -> Drive:
    """A short drive with every part a bag can hold. Times are whole microseconds, so that files keep them exactly."""
    rng = np.random.default_rng(seed)

    def clock(rate: float) -> Any:
        return np.round(np.arange(int(seconds * rate)) / rate + 0.2 / rate, 6)

    t, tp, tg = clock(50.0), clock(20.0), clock(100.0)
    speeds = np.stack([0.8 + 0.3 * np.sin(t), 0.9 + 0.2 * np.cos(1.3 * t)], axis=1)
    poses = np.stack([0.7 * tp, 0.2 * np.sin(tp), 0.5 * np.sin(0.7 * tp)], axis=1)
    gyro = 0.3 * np.cos(tg) + 0.01 * rng.standard_normal(len(tg))
    return Drive(
        "example",
        VEHICLE,
        Series(t, speeds, "wheels"),
        pose=Series(tp, poses, "pose"),
        gyro=Series(tg, gyro, "gyro"),
        command=Series(tp, np.stack([np.full(len(tp), 0.8), 0.1 * np.sin(tp)], axis=1), "command"),
    )
