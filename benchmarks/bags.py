"""Reading bags: messages a second against the library's own deserialiser, and what images in a bag cost.

Usage: python benchmarks/bags.py [--messages N] [--gigabytes G] [--folder DIR]

Prints two tables in Markdown. Every reading is a process of its own, timed without the imports; the peak memory is
that of the whole process.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

VEHICLE = {"name": "benchmark", "track_width": 0.6, "wheel_radius": 0.15}
START = 1_700_000_000 * 10**9
KINDS = ("rosbag1", "rosbag2 sqlite3", "MCAP", "MCAP zstd")
IMAGE = (1280, 720, 3)
REPEATS = 2
ROUNDS = 4


def main() -> None:
    options = _options()
    if options.child:
        print(json.dumps(_child(options.child, Path(options.path))))
        return
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        print(f"Python {platform.python_version()}, rosbags {version('rosbags')}, {platform.machine()}\n")
        print(speed_table(Path(folder), options.messages))
        print()
        print(image_table(Path(folder), options.gigabytes))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=200_000, help="in the bags of the first table")
    parser.add_argument("--gigabytes", type=float, default=2.0, help="of images in the second")
    parser.add_argument("--folder", type=Path, default=None, help="for the bags; they are deleted afterwards")
    parser.add_argument("--child", choices=("ours", "library", "raw"), help=argparse.SUPPRESS)
    parser.add_argument("path", nargs="?", default="", help=argparse.SUPPRESS)
    return parser.parse_args()


# --- what is measured, each in a process of its own


def _child(what: str, path: Path) -> dict[str, float]:
    read = {"ours": _ours, "library": _library, "raw": _raw}[what](path)
    best = float("inf")
    for _ in range(REPEATS):
        start = time.perf_counter()
        messages = read()
        best = min(best, time.perf_counter() - start)
    return {"seconds": best, "messages": messages, "peak_mb": _peak_megabytes()}


def _ours(path: Path) -> Callable[[], int]:
    from skidsteer.io.bag import read_bag_noted
    from skidsteer.vehicle import Vehicle

    vehicle = Vehicle(**VEHICLE)

    def read() -> int:
        _, contents = read_bag_noted(path, vehicle)
        return sum(topic.count for topic in contents.topics if topic.used_as)

    return read


def _library(path: Path) -> Callable[[], int]:
    return lambda: sum(1 for reader, connection, raw in _wanted(path) if reader.deserialize(raw, connection.msgtype))


def _raw(path: Path) -> Callable[[], int]:
    return lambda: sum(1 for _ in _wanted(path))


def _wanted(path: Path) -> Iterator[tuple[Any, Any, bytes]]:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        connections = [connection for connection in reader.connections if connection.topic != "/camera/image"]
        for connection, _, raw in reader.messages(connections=connections):
            yield reader, connection, raw


def _peak_megabytes() -> float:
    # VmHWM rather than ru_maxrss, which a child takes over from its parent.
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    return float("nan")


def _measure(what: str, path: Path) -> dict[str, float]:
    command = [sys.executable, __file__, "--child", what, str(path)]
    return json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


# --- the tables


def speed_table(folder: Path, messages: int) -> str:
    """Messages a second of joint states, odometry and IMU: ours from file to drive, the library's to objects."""
    lines = [
        f"| {messages} messages | bytes only | library's deserialiser | ours, to a drive | ratio |",
        "|---|---|---|---|---|",
    ]
    for kind in KINDS:
        path = _write(folder / kind.replace(" ", "-"), kind, messages, 0)
        # In turns, and the best of each: what else the machine does hits all of them.
        results = [[_measure(what, path) for what in ("raw", "library", "ours")] for _ in range(ROUNDS)]
        rates = [max(one["messages"] / one["seconds"] for one in of_kind) for of_kind in zip(*results, strict=True)]
        shown = " | ".join(f"{rate / 1000:.0f} k/s" for rate in rates)
        lines.append(f"| {kind} | {shown} | {rates[2] / rates[1]:.1f} |")
    return "\n".join(lines)


def image_table(folder: Path, gigabytes: float) -> str:
    """Time and peak memory of reading a drive of ten minutes, with and without a camera in the same bag."""
    images = int(gigabytes * 1e9 / np.prod(IMAGE))
    lines = ["| 10 min drive as MCAP | size | time | peak memory | library's deserialiser |", "|---|---|---|---|---|"]
    for name, count in (("without images", 0), (f"with {images} images", images)):
        path = _write(folder / name.replace(" ", "-"), "MCAP", 120_000, count)
        size = sum(file.stat().st_size for file in path.iterdir()) / 1e6
        ours, library = _measure("ours", path), _measure("library", path)
        theirs = f"{library['seconds']:.2f} s, {library['peak_mb']:.0f} MB"
        lines.append(f"| {name} | {size:.0f} MB | {ours['seconds']:.2f} s | {ours['peak_mb']:.0f} MB | {theirs} |")
    return "\n".join(lines)


# --- the bags


def _write(path: Path, kind: str, messages: int, images: int) -> Path:
    """A drive of two parts IMU, two parts joint states and one part odometry, images spread among them."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    if kind == "rosbag1":
        path = path.with_suffix(".bag")
        store, writer = get_typestore(Stores.ROS1_NOETIC), Writer1(path)
        encode = store.serialize_ros1
    else:
        plugin = StoragePlugin.SQLITE3 if "sqlite3" in kind else StoragePlugin.MCAP
        store, writer = get_typestore(Stores.ROS2_HUMBLE), Writer2(path, version=9, storage_plugin=plugin)
        if kind.endswith("zstd"):
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        encode = store.serialize_cdr
    pixels = np.random.default_rng(0).integers(0, 256, IMAGE, dtype=np.uint8).tobytes()
    with writer:
        topics = {
            "/imu/data": "sensor_msgs/msg/Imu",
            "/joint_states": "sensor_msgs/msg/JointState",
            "/ground_truth/odom": "nav_msgs/msg/Odometry",
            "/camera/image": "sensor_msgs/msg/Image",
        }
        connections = {name: writer.add_connection(name, type_, typestore=store) for name, type_ in topics.items()}
        every = max(messages // images, 1) if images else 0
        for index in range(messages):
            ns = START + index * 5_000_000
            name = ("/imu/data", "/joint_states", "/imu/data", "/joint_states", "/ground_truth/odom")[index % 5]
            writer.write(connections[name], ns, encode(_message(store, topics[name], ns, index), topics[name]))
            if images and index % every == 0:
                image = _message(store, topics["/camera/image"], ns, index, pixels)
                writer.write(connections["/camera/image"], ns, encode(image, topics["/camera/image"]))
    return path


def _message(store: Any, name: str, ns: int, index: int, pixels: bytes = b"") -> Any:
    types = {key.rsplit("/", 1)[-1]: value for key, value in store.types.items() if key in _USED}
    stamp = types["Time"](ns // 10**9, ns % 10**9)
    sequence = {"seq": index} if "seq" in types["Header"].__dataclass_fields__ else {}
    header = types["Header"](stamp=stamp, frame_id="odom", **sequence)
    zero = types["Vector3"](0.0, 0.0, 0.0)
    if name.endswith("Imu"):
        turn, unknown = types["Quaternion"](0.0, 0.0, 0.0, 1.0), np.zeros(9)
        return types["Imu"](header, turn, unknown, types["Vector3"](0.0, 0.0, np.sin(index)), unknown, zero, unknown)
    if name.endswith("JointState"):
        names = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]
        return types["JointState"](header, names, np.full(4, 0.01 * index), np.full(4, 2.0), np.zeros(4))
    if name.endswith("Image"):
        height, width = IMAGE[1], IMAGE[0]
        return types["Image"](header, height, width, "rgb8", 0, 3 * width, np.frombuffer(pixels, dtype=np.uint8))
    pose = types["Pose"](types["Point"](0.001 * index, 0.0, 0.0), types["Quaternion"](0.0, 0.0, 0.0, 1.0))
    with_covariance = types["PoseWithCovariance"](pose, np.zeros(36))
    twist = types["TwistWithCovariance"](types["Twist"](zero, zero), np.zeros(36))
    return types["Odometry"](header, "base_link", with_covariance, twist)


_USED = {
    "builtin_interfaces/msg/Time",
    "std_msgs/msg/Header",
    "geometry_msgs/msg/Vector3",
    "geometry_msgs/msg/Quaternion",
    "geometry_msgs/msg/Point",
    "geometry_msgs/msg/Pose",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/PoseWithCovariance",
    "geometry_msgs/msg/TwistWithCovariance",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Image",
    "nav_msgs/msg/Odometry",
}


if __name__ == "__main__":
    main()
