"""The parts of a drive as ROS 2 messages, encoded in bulk: one message of each kind is the mould of all others."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skidsteer import se2
from skidsteer.drive import Drive, Series
from skidsteer.io import tf
from skidsteer.io.layout import fill, read_layout
from skidsteer.io.messages import IMU, JOINT_STATE, ODOMETRY, POINT, TF, TWIST_STAMPED, type_store
from skidsteer.io.raw import ByteArray, IntArray
from skidsteer.io.stamps import SECOND
from skidsteer.se2 import FloatArray

MAP, ODOM, BASE, IMU_FRAME = "map", "odom", "base_link", "imu_link"
_LATEST = 2**31 - 1  # [s] the last second that a ROS 2 stamp can hold
_XYZW = ("x", "y", "z", "w")


@dataclass(frozen=True, slots=True, eq=False)
class Encoded:
    """All messages of one topic, one row of bytes each, with their type and its definition."""

    topic: str
    type: str
    definition: str
    ns: IntArray  # (n,)
    matrix: ByteArray  # (n, size)


def encode_drive(drive: Drive, odometry: Series | None) -> list[Encoded]:
    """Messages of all parts of a drive, and of an odometry (m, 3) beside it.

    Raises:
        ValueError: times beyond the range of ROS stamps.
    """
    parts = (drive.wheels, drive.pose, drive.position, drive.gyro, drive.command, drive.wheel_command, odometry)
    earliest = min(float(part.t[0]) for part in parts if part is not None)
    encoder = _Encoder(max(0, math.ceil(-earliest)))
    topics = [encoder.joints("/joint_states", drive.wheels, drive.vehicle.wheel_radius)]
    if drive.wheel_command is not None:
        topics.append(encoder.joints("/cmd/joint_states", drive.wheel_command, drive.vehicle.wheel_radius))
    if drive.pose is not None:
        topics.append(encoder.odometry("/reference/odom", drive.pose, MAP))
    if drive.position is not None:
        topics.append(encoder.points("/reference/position", drive.position))
    if drive.gyro is not None:
        topics.append(encoder.gyro("/imu/data", drive.gyro))
    if drive.command is not None:
        topics.append(encoder.twists("/cmd_vel", drive.command))
    if odometry is not None:
        topics.append(encoder.odometry("/skidsteer/odom", odometry, ODOM))
        topics.append(encoder.transform("/tf_static", float(odometry.t[0]), _map_to_odom(drive.pose, odometry)))
    return topics


def _map_to_odom(reference: Series | None, odometry: Series) -> FloatArray:
    """Pose (3,) of the odometry's frame in the map that lays its first pose onto the reference at that time."""
    if reference is None:
        return np.zeros(3)
    return se2.compose(reference.hold(odometry.t[0]), se2.invert(odometry.values[0]))


class _Encoder:
    """Encodes series as messages; ``shift`` seconds are added to all times."""

    def __init__(self, shift: int) -> None:
        self.shift = shift
        self.store = type_store(2)

    def joints(self, topic: str, rim_speeds: Series, radius: float) -> Encoded:
        mould = {"name": ["left_wheel", "right_wheel"], "velocity": np.zeros(2)}
        return self._encoded(topic, JOINT_STATE, mould, rim_speeds.t, {"velocity": rim_speeds.values / radius})

    def odometry(self, topic: str, poses: Series, frame: str) -> Encoded:
        mould = {"header": {"frame_id": frame}, "child_frame_id": BASE}
        columns = _pose_columns("pose.pose.position.", "pose.pose.orientation.", poses.values)
        twist = _twists(poses)
        for index, name in enumerate(("linear.x", "linear.y", "angular.z")):
            columns[f"twist.twist.{name}"] = twist[:, index]
        return self._encoded(topic, ODOMETRY, mould, poses.t, columns)

    def points(self, topic: str, positions: Series) -> Encoded:
        columns = {"point.x": positions.values[:, 0], "point.y": positions.values[:, 1]}
        return self._encoded(topic, POINT, {"header": {"frame_id": MAP}}, positions.t, columns)

    def gyro(self, topic: str, rates: Series) -> Encoded:
        # A first covariance of -1 says that there is no such measurement (REP 145).
        unknown = np.array([-1.0] + [0.0] * 8)
        mould = {"header": {"frame_id": IMU_FRAME}, "orientation_covariance": unknown}
        mould["linear_acceleration_covariance"] = unknown
        return self._encoded(topic, IMU, mould, rates.t, {"angular_velocity.z": rates.values[:, 0]})

    def twists(self, topic: str, commands: Series) -> Encoded:
        columns = {"twist.linear.x": commands.values[:, 0], "twist.angular.z": commands.values[:, 1]}
        return self._encoded(topic, TWIST_STAMPED, {"header": {"frame_id": BASE}}, commands.t, columns)

    def transform(self, topic: str, t: float, pose: FloatArray) -> Encoded:
        link = {"header": {"frame_id": MAP}, "child_frame_id": ODOM}
        prefix = "transforms[0]."
        columns = _pose_columns(f"{prefix}transform.translation.", f"{prefix}transform.rotation.", pose[None])
        return self._encoded(topic, TF, {"transforms": [link]}, np.array([t]), columns, prefix)

    def _encoded(
        self,
        topic: str,
        type_name: str,
        mould: Mapping[str, Any],
        t: FloatArray,
        columns: Mapping[str, ArrayLike],
        prefix: str = "",
    ) -> Encoded:
        """Serialise one message, and fill the numbers of all into copies of its bytes."""
        if t[-1] + self.shift > _LATEST:
            raise ValueError(f"{topic}: time {t[-1]:g} s is beyond what a ROS stamp can hold")
        ns = np.rint(t * SECOND).astype(np.int64) + self.shift * SECOND
        definitions = self.store.fielddefs
        message = bytes(self.store.serialize_cdr(_message(self.store, type_name, mould), type_name, little_endian=True))
        layout = read_layout(message, definitions, type_name, "cdr")
        matrix = np.tile(np.frombuffer(message, dtype=np.uint8), (len(ns), 1))
        stamps = {"sec": ns // SECOND, "nanosec": ns % SECOND}
        for name, values in (*columns.items(), *((f"{prefix}header.stamp.{part}", n) for part, n in stamps.items())):
            fill(matrix, layout.fields[name], values)
        definition, _ = self.store.generate_msgdef(type_name, ros_version=2)
        return Encoded(topic, type_name, definition, ns, matrix)


def _pose_columns(position: str, turn: str, poses: FloatArray) -> dict[str, FloatArray]:
    transforms = tf.from_planar(poses)
    columns = {f"{position}{axis}": transforms[:, index] for index, axis in enumerate("xyz")}
    return columns | {f"{turn}{axis}": transforms[:, 3 + index] for index, axis in enumerate(_XYZW)}


def _twists(poses: Series) -> FloatArray:
    """Body twists (m, 3) that lead from each pose to the next; the last is that before it."""
    if len(poses) < 2:
        return np.zeros((1, 3))
    motions = se2.between(poses.values[:-1], poses.values[1:])
    twists = se2.log(motions) / np.diff(poses.t)[:, None]
    return np.concatenate([twists, twists[-1:]])


def _message(store: Any, type_name: str, given: Mapping[str, Any]) -> Any:
    """A message object of the library from nested mappings; fields that are not given are zero or empty."""
    fields = {name: _field(store, kind, given.get(name)) for name, kind in store.fielddefs[type_name][1]}
    return store.types[type_name](**fields)


def _field(store: Any, description: Any, given: Any) -> Any:
    kind, detail = int(description[0]), description[1]
    if kind == 2:  # another message
        return _message(store, detail, given or {})
    if kind == 1:  # a number or a text
        return given if given is not None else ("" if detail[0] == "string" else 0)
    (inner, what), count = detail
    if given is None:
        given = () if kind == 4 else np.zeros(count)
    if int(inner) == 2:
        return [_message(store, what, item) for item in given]
    return list(given) if what[0] == "string" else np.asarray(given, dtype=what[0])
