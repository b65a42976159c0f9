from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from bag_files import START, VEHICLE, Message, example_drive, pose, wheel_messages, write_messages
from skidsteer import se2
from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError, RequestError
from skidsteer.identify.calibrate import mounting
from skidsteer.io import tf
from skidsteer.io.bag import BagOptions, list_bag, read_bag, read_bag_noted
from skidsteer.io.navsat import east_north
from skidsteer.windows import Mount

NS = START * 10**9
STEP = 100_000_000
WHEELS = wheel_messages(example_drive(2.0), "velocity")

turns = st.builds(lambda *angles: Rotation.from_euler("ZYX", angles).as_quat(), *[st.floats(-3, 3)] * 3)
transforms = st.builds(lambda p, q: np.concatenate([p, q]), st.tuples(*[st.floats(-10, 10)] * 3).map(np.array), turns)


# --- transforms


@given(transforms, transforms, st.tuples(*[st.floats(-10, 10)] * 3))
def test_transforms_follow_scipy(a: Any, b: Any, point: Any) -> None:
    inner = b[:3] + Rotation.from_quat(b[3:]).apply(point)
    outer = a[:3] + Rotation.from_quat(a[3:]).apply(inner)
    both = tf.compose(a, b)
    assert_allclose(both[:3] + tf.rotate(both[3:], point), outer, atol=1e-9)
    assert_allclose(tf.rotate(tf.invert(a)[3:], outer) + tf.invert(a)[:3], inner, atol=1e-9)


@given(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3.1, 3.1)))
def test_planar_undoes_from_planar(given_pose: Any) -> None:
    assert_allclose(tf.planar(tf.from_planar(given_pose)), given_pose, atol=1e-12)


def test_yaw_is_that_of_the_forward_axis_on_a_slope() -> None:
    tilted = Rotation.from_euler("ZYX", [0.7, 0.3, -0.2])  # yaw, then pitch, then roll
    assert_allclose(tf.planar(np.concatenate([[1.0, 2.0, 3.0], tilted.as_quat()])), [1.0, 2.0, 0.7])


def test_chain_is_found_by_usual_names() -> None:
    edges = [("map", "odom"), ("odom", "base_footprint"), ("base_footprint", "base_link"), ("base_link", "imu")]
    assert tf.find_chain(edges, None, None) == tf.Chain(("map", "odom", "base_footprint", "base_link"))
    assert tf.find_chain(edges, "odom", "base_footprint") == tf.Chain(("odom", "base_footprint"))
    assert tf.find_chain(edges, None, "imu") == tf.Chain(("map", "odom", "base_footprint", "base_link", "imu"))
    assert tf.find_chain([("husky/map", "husky/base_link")], None, None) == tf.Chain(("husky/map", "husky/base_link"))


def test_chain_past_the_odometry_where_two_nodes_tell_of_the_base() -> None:
    """Motion capture beside the odometry, whichever comes first; a frame of two parents, whose one leads nowhere."""
    wheels, mocap = ("odom", "base_link"), ("world", "base_link")
    for edges in ([wheels, mocap], [mocap, wheels], [("map", "odom"), wheels, mocap], [("a", "base_link"), mocap]):
        assert tf.find_chain(edges, None, None) == tf.Chain(("world", "base_link"))
    assert tf.find_chain([("map", "odom"), wheels, mocap], "map", None) == tf.Chain(("map", "odom", "base_link"))
    stray = [("base_footprint", "base_link"), wheels, ("map", "odom")]
    assert tf.find_chain(stray, None, None) == tf.Chain(("map", "odom", "base_link"))


def test_frames_that_all_tell_of_each_other_end() -> None:
    names = [f"f{i}" for i in range(40)] + ["base_link"]
    edges = [(a, b) for a in names for b in names if a != b]
    assert tf.find_chain(edges, None, None) is None


@pytest.mark.parametrize(
    "edges",
    [
        [],
        [("odom", "base_link")],  # from the wheels: no reference
        [("map", "odom")],
        [("base_link", "map"), ("map", "base_link")],
        [("a", "b"), ("b", "a")],
    ],
)
def test_no_chain_where_there_is_none(edges: list[tf.Edge]) -> None:
    found = tf.find_chain(edges, None, None)
    assert found is None or found.frames == ("map", "base_link")


def link(parent: str, child: str, at: tuple[float, float, float], ns: int = NS, turn: Any = None) -> dict[str, Any]:
    planar = pose(*at)
    rotation = planar["orientation"] if turn is None else dict(zip("xyzw", map(float, turn), strict=True))
    return {
        "header": (ns, parent),
        "child_frame_id": child,
        "transform": {"translation": planar["position"], "rotation": rotation},
    }


def tf_message(*links: dict[str, Any], topic: str = "/tf", ns: int = NS) -> Message:
    return Message(topic, "tf2_msgs/msg/TFMessage", ns, {"transforms": list(links)})


def read(tmp_path: Path, messages: list[Message], kind: str = "mcap", **options: Any) -> tuple[Drive, str]:
    drive, contents = read_bag_noted(write_messages(tmp_path / "b", kind, messages), VEHICLE, BagOptions(**options))
    return drive, "\n".join(contents.notes)


@pytest.mark.parametrize("kind", ["mcap", "rosbag1"])
def test_chain_of_transforms_is_the_pose_at_the_localisation(tmp_path: Path, kind: str) -> None:
    # The robot drives 1 m/s along odom's x; the localisation shifts odom in the map by 0.1 m a step, and turns it.
    static = tf_message(link("base_footprint", "base_link", (0.0, 0.0, 0.0)), topic="/tf_static")
    messages = [*WHEELS, static]
    for index in range(41):  # odometry at 20 Hz, between the corrections at 10 Hz
        ns = NS + index * STEP // 2 - STEP // 4
        messages.append(tf_message(link("odom", "base_footprint", (0.05 * index - 0.025, 0.0, 0.0), ns), ns=ns))
    for index in range(1, 20):
        ns = NS + index * STEP
        messages.append(tf_message(link("map", "odom", (5.0, 0.1 * index, np.pi / 2), ns), ns=ns))
    drive, notes = read(tmp_path, messages, kind)
    steps = np.arange(1, 20)
    expected = np.stack([np.full(19, 5.0), 0.1 * steps + 0.1 * steps, np.full(19, np.pi / 2)], axis=1)
    assert drive.pose is not None
    assert_allclose(drive.pose.t, 0.1 * steps, atol=1e-9)
    assert_allclose(drive.pose.values, expected, atol=1e-9)
    assert "map -> odom -> base_footprint -> base_link" in notes


def test_chain_must_be_there_when_asked_for(tmp_path: Path) -> None:
    messages = [*WHEELS, tf_message(link("odom", "base_link", (0, 0, 0)))]
    path = write_messages(tmp_path / "b", "mcap", messages)
    assert "reference" not in list_bag(path).chosen
    with pytest.raises(RequestError, match=r"no chain.*it has odom -> base_link; name the two with --map-frame"):
        read_bag(path, VEHICLE, BagOptions(reference_topic="/tf"))
    with pytest.raises(DataError, match="odom -> base_link never moves"):
        read_bag(path, VEHICLE, BagOptions(reference_topic="/tf", map_frame="odom"))


def test_pose_of_a_sensor_is_brought_to_the_base(tmp_path: Path) -> None:
    # The scanner looks backwards, 0.3 m ahead and 0.1 m to the left of the base.
    mounting, truth = np.array([0.3, 0.1, np.pi]), np.array([2.0, 1.0, 0.5])
    scanner = se2.compose(truth, mounting)
    messages = [*WHEELS, tf_message(link("base_link", "scanner", tuple(mounting)), topic="/tf_static")]
    for index in range(5):
        ns = NS + index * STEP
        value = {"header": (ns, "map"), "child_frame_id": "scanner", "pose": {"pose": pose(*scanner)}}
        messages.append(Message("/icp_odom", "nav_msgs/msg/Odometry", ns, value))
    drive, notes = read(tmp_path, messages)
    assert drive.pose is not None
    difference = drive.pose.values - truth
    assert_allclose(difference[:, :2], 0.0, atol=1e-12)
    assert_allclose(se2.wrap(difference[:, 2]), 0.0, atol=1e-12)
    assert "0.300 m ahead, 0.100 m left, -180.0 deg" in notes or "0.300 m ahead, 0.100 m left, 180.0 deg" in notes


def test_poses_of_two_things_in_one_topic_are_told_apart(tmp_path: Path) -> None:
    messages = list(WHEELS)
    for index in range(6):
        ns = NS + index * STEP
        child = "other" if index == 2 else "robot"
        messages.append(
            Message("/vicon", "geometry_msgs/msg/TransformStamped", ns, link("world", child, (1, 2, 0), ns))
        )
    drive, notes = read(tmp_path, messages)
    assert drive.pose is not None
    assert len(drive.pose) == 5
    assert "1 messages in other frames than world -> robot dropped" in notes


# --- IMU


def imu(rate: tuple[float, float, float], n: int = 5) -> list[Message]:
    value = {"angular_velocity": dict(zip("xyz", rate, strict=True))}
    return [
        Message("/imu/data", "sensor_msgs/msg/Imu", NS + i * STEP, {**value, "header": (NS + i * STEP, "imu")})
        for i in range(n)
    ]


@pytest.mark.parametrize(
    ("roll", "rate", "yaw_rate"),
    [
        (0.0, (0.1, 0.2, 0.3), 0.3),
        (0.1, (0.1, 0.2, 0.3), 0.3),  # slightly tilted: its z as it stands
        (np.pi, (0.1, 0.2, -0.3), 0.3),  # upside down
        (np.pi / 2, (0.1, 0.3, 0.2), 0.3),  # on its side: base z is along the IMU's y
    ],
)
def test_gyro_upside_down_is_turned_back(tmp_path: Path, roll: float, rate: Any, yaw_rate: float) -> None:
    turn = Rotation.from_euler("x", roll).as_quat()
    static = tf_message(link("base_link", "imu", (0, 0, 0), turn=turn), topic="/tf_static")
    drive, notes = read(tmp_path, [*WHEELS, *imu(rate), static])
    assert drive.gyro is not None
    assert_allclose(drive.gyro.values, yaw_rate)
    assert ("deg from up; undone" in notes) == (roll > 1)


def test_gyro_of_one_axis(tmp_path: Path) -> None:
    drive, _ = read(tmp_path, [*WHEELS, *imu((np.nan, np.nan, 0.3))])
    assert drive.gyro is not None
    assert_allclose(drive.gyro.values, 0.3)


def test_gyro_without_transform_is_as_it_stands(tmp_path: Path) -> None:
    drive, _ = read(tmp_path, [*WHEELS, *imu((0.0, 0.0, -0.3))])
    assert drive.gyro is not None
    assert_allclose(drive.gyro.values, -0.3)


# --- GNSS


def fix(index: int, latitude: float, longitude: float, status: int = 2, variance: float = 1e-4) -> Message:
    value = {
        "header": (NS + index * STEP, "gps"),
        "status": {"status": status},
        "latitude": latitude,
        "longitude": longitude,
        "altitude": 100.0,
        "position_covariance": [variance, 0, 0, 0, variance, 0, 0, 0, 9.0],
        "position_covariance_type": 2,
    }
    return Message("/gps/fix", "sensor_msgs/msg/NavSatFix", NS + index * STEP, value)


def test_fixes_become_metres_east_and_north(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    # By hand, WGS 84 at latitude 45 deg: a degree north is 111131.78 m, a degree east 78846.81 m.
    messages = [*WHEELS, fix(0, 45.0, 7.0), fix(1, 45.00001, 7.0), fix(2, 45.0, 7.00001)]
    drive, notes = read(tmp_path, messages)
    assert drive.pose is None
    assert drive.position is not None
    # On the ground at an altitude of 100 m, 1.6e-5 longer than on the ellipsoid.
    expected = np.array([[0.0, 0.0], [0.0, 1.1113178], [0.7884681, 0.0]]) * (1 + 100 / 6.38e6)
    assert_allclose(drive.position.values, expected, atol=2e-6)
    assert "3 fixes, most of them GBAS or RTK" in notes


def test_place_of_the_antenna_is_told_where_transforms_tell(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    fixes = [fix(index, 45.0 + 1e-6 * index, 7.0) for index in range(3)]
    static = tf_message(link("base_link", "gps", (-0.3, 0.2, np.pi / 2)), topic="/tf_static")
    path = write_messages(tmp_path / "b", "mcap", [*WHEELS, *fixes, static])
    assert_allclose(read_bag_noted(path, VEHICLE)[1].antenna, (-0.3, 0.2))
    path = write_messages(tmp_path / "c", "mcap", [*WHEELS, *fixes])
    assert read_bag_noted(path, VEHICLE)[1].antenna is None


def test_poor_fixes_are_dropped_and_counted(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    good = [fix(index, 45.0 + 1e-6 * index, 7.0) for index in range(8)]
    bad = [fix(8, 0.0, 0.0, status=-1), fix(9, 45.1, 7.0, variance=25.0), fix(10, 95.0, 7.0), fix(11, np.nan, 7.0)]
    drive, notes = read(tmp_path, [*WHEELS, *good, *bad])
    assert drive.position is not None
    assert len(drive.position) == 8
    assert "2 of 11 messages without a fix and 1 with a poor one dropped" in notes


def test_topic_of_no_use_is_left_out_and_refused_where_asked_for(tmp_path: Path) -> None:
    path = write_messages(tmp_path / "b", "mcap", [*WHEELS, *(fix(i, 0.0, 0.0, status=-1) for i in range(4))])
    drive, contents = read_bag_noted(path, VEHICLE)
    assert drive.reference is None
    assert "reference left out: /gps/fix: none of its 4 messages holds a GNSS fix" in contents.notes
    with pytest.raises(DataError, match="/gps/fix: none of its 4 messages holds a GNSS fix"):
        read_bag(path, VEHICLE, BagOptions(reference_topic="/gps/fix"))


def test_unknown_altitude_does_not_drop_a_fix(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    messages = [fix(index, 45.0, 7.0) for index in range(3)]
    messages = [replace(message, value={**message.value, "altitude": np.nan}) for message in messages]
    drive, _ = read(tmp_path, [*WHEELS, *messages])
    assert drive.position is not None
    assert len(drive.position) == 3


def test_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(RequestError, match=r"pip install 'skidsteer\[bags\]'"):
        east_north(np.zeros((1, 3)))


def test_the_place_of_the_antenna_is_where_the_sensor_sits(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    fixes = [fix(index, 45.0 + 1e-6 * index, 7.0) for index in range(3)]
    static = tf_message(link("base_link", "gps", (-0.3, 0.2, np.pi / 2)), topic="/tf_static")
    with_place, contents = read_bag_noted(write_messages(tmp_path / "b", "mcap", [*WHEELS, *fixes, static]), VEHICLE)
    told = "antenna -0.300 m ahead and 0.200 m left of the base; that is taken for --mount"
    assert any(told in note for note in contents.notes)
    without = read_bag(write_messages(tmp_path / "c", "mcap", [*WHEELS, *fixes]), VEHICLE)
    place = mounting([with_place], None)
    assert place is not None
    assert_allclose([place.x, place.y, place.yaw], [-0.3, 0.2, 0.0], atol=1e-12)
    assert mounting([with_place], "free") is None
    assert mounting([with_place], Mount(0.1, 0.0, 0.0)) == Mount(0.1, 0.0, 0.0)
    assert mounting([without], None) is None
    assert mounting([with_place, without], None) is None
    posed = Drive("posed", VEHICLE, with_place.wheels, pose=Series(np.array([0.0, 1.0]), np.zeros((2, 3))))
    assert mounting([posed], None) == Mount()
    assert mounting([posed, with_place], None) is None  # sensors at two places
