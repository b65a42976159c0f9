"""What the wheels are judged against: poses, positions and yaw rates, brought to the base where transforms allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skidsteer.errors import DataError, RequestError
from skidsteer.io import tf
from skidsteer.io.messages import NAVSAT, ODOMETRY, POINT, TF_TYPES, TRANSFORM, Samples
from skidsteer.io.navsat import positions
from skidsteer.io.options import BagOptions
from skidsteer.io.raw import BagTopic, shown
from skidsteer.io.stamps import Clock, Timed, concatenated
from skidsteer.se2 import FloatArray

_UPRIGHT = 0.9  # cosine of the tilt of an IMU's z axis up to which it is taken to point up


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """All transforms of a bag by parent and child frame, and the chain from the map to the base if there is one."""

    edges: Mapping[tf.Edge, Samples]
    fixed: Mapping[tf.Edge, Samples]  # those of the static topics
    chain: tf.Chain | None
    options: BagOptions

    @staticmethod
    def of(tables: Mapping[BagTopic, Sequence[Samples]], options: BagOptions) -> Frames:
        """Collect the transforms of all topics of them."""
        edges = _edges(tables)
        chain = tf.find_chain(sorted(edges), options.map_frame, options.base_frame)
        fixed = _edges({topic: group for topic, group in tables.items() if topic.name.endswith("_static")})
        return Frames(edges, fixed, chain, options)

    def base_in(self, frame: str) -> FloatArray | None:
        """Transform (7,) of the base in ``frame`` by static links; None where it is the base or not connected."""
        bases = self._bases()
        if frame in bases:
            return None
        found = [tf.fixed_transform(self.fixed, frame, name) for name in bases]
        return next((each for each in found if each is not None and np.isfinite(each).all()), None)

    def _bases(self) -> list[str]:
        if self.options.base_frame:
            return [self.options.base_frame]
        frames = {name for edge in self.fixed for name in edge}
        return sorted(name for name in frames if tf.last_name(name) in tf.BASE_FRAMES)


def _edges(tables: Mapping[BagTopic, Sequence[Samples]]) -> dict[tf.Edge, Samples]:
    found: dict[tf.Edge, list[Samples]] = {}
    for topic, group in tables.items():
        for samples in group if topic.type in TF_TYPES else ():
            found.setdefault((samples.label[0], samples.label[1]), []).append(samples)
    return {edge: concatenated(group) for edge, group in found.items()}


def read_reference(
    topic: BagTopic, tables: Sequence[Samples], frames: Frames, clock: Clock, notes: list[str]
) -> dict[str, Timed]:
    """The reference as ``{"pose": (n, 3)}`` or, where it has no heading, ``{"position": (n, 2)}``.

    Raises:
        DataError: nothing usable is left of it.
        RequestError: the transforms do not connect a map to the base.
    """
    if topic.type in TF_TYPES:
        return {"pose": _chain_pose(topic, frames, clock, notes)}
    samples, name = _main(topic, tables, notes), shown(topic.name)
    if topic.type == NAVSAT:
        return {"position": positions(clock.timed(samples, name, notes), name, notes)}
    if topic.type == POINT:
        timed = clock.timed(samples, name, notes)
        return {"position": timed.with_values(timed.values[:, :2])}
    return {"pose": _pose(topic, samples, frames, clock, notes)}


def _main(topic: BagTopic, tables: Sequence[Samples], notes: list[str]) -> Samples:
    """The samples of the frames that most messages have: those of others are poses of something else."""
    most = max(tables, key=lambda samples: len(samples.bag_ns))
    rest = sum(len(samples.bag_ns) for samples in tables) - len(most.bag_ns)
    if rest:
        notes.append(
            f"{shown(topic.name)}: {rest} messages in other frames than {shown(' -> '.join(most.label))} dropped"
        )
    return most


def _pose(topic: BagTopic, samples: Samples, frames: Frames, clock: Clock, notes: list[str]) -> Timed:
    samples = replace(samples, values=tf.normalised(samples.values[:, :7]))
    timed = clock.timed(samples, shown(topic.name), notes)
    child = samples.label[1] if topic.type in (ODOMETRY, TRANSFORM) else ""
    mounting = frames.base_in(child) if child else None
    if mounting is None:
        return timed.with_values(tf.planar(timed.values))
    x, y, yaw = tf.planar(tf.invert(mounting))
    if abs(x) + abs(y) + abs(yaw) > 1e-6:
        notes.append(
            f"{shown(topic.name)}: poses of {shown(child)}, brought to the base by the static transform between them"
            f" ({x:.3f} m ahead, {y:.3f} m left, {np.degrees(yaw):.1f} deg)"
        )
    return timed.with_values(tf.planar(tf.compose(timed.values, mounting)))


def _chain_pose(topic: BagTopic, frames: Frames, clock: Clock, notes: list[str]) -> Timed:
    if frames.chain is None:
        known = ", ".join(f"{above} -> {below}" for above, below in frames.edges)
        raise RequestError(
            f"{shown(topic.name)}: no chain of transforms from a map to the base; it has {shown(known)};"
            " name the two with --map-frame and --base-frame"
        )
    timed = tf.chain_poses(frames.chain, frames.edges, clock, notes)
    if timed is None:
        raise DataError(f"{shown(topic.name)}: {shown(' -> '.join(frames.chain.frames))} never moves")
    notes.append(f"{shown(topic.name)}: reference is {shown(' -> '.join(frames.chain.frames))}")
    return timed.with_values(tf.planar(timed.values))


def antenna_place(topic: BagTopic, tables: Sequence[Samples], frames: Frames) -> tuple[float, float] | None:
    """Where the antenna of a GNSS topic sits in the base, x ahead and y left [m], if static transforms tell."""
    if topic.type != NAVSAT or not tables:
        return None
    base_in_antenna = frames.base_in(_main(topic, tables, []).label[0])
    if base_in_antenna is None:
        return None
    x, y, _ = tf.planar(tf.invert(base_in_antenna))
    return float(x), float(y)


def read_gyro(topic: BagTopic, tables: Sequence[Samples], frames: Frames, clock: Clock, notes: list[str]) -> Timed:
    """Yaw rate (n, 1) [rad/s]: the gyro's z, or where a static transform says that z does not point up, the rate
    about the base's z axis.

    Raises:
        DataError: no finite sample.
    """
    samples = _main(topic, tables, notes)
    mounting = frames.base_in(samples.label[0])
    if mounting is not None:
        axis = tf.rotate(mounting[3:], (0.0, 0.0, 1.0))  # the base's z axis in the frame of the IMU
        if axis[2] < _UPRIGHT:
            tilt = float(np.degrees(np.arccos(np.clip(axis[2], -1.0, 1.0))))
            notes.append(
                f"{shown(topic.name)}: the static transform turns the IMU's z axis {tilt:.0f} deg from up; undone"
            )
            return clock.timed(replace(samples, values=samples.values @ axis[:, None]), shown(topic.name), notes)
    # Not a product with (0, 0, 1): IMUs of one axis say NaN for the two others.
    return clock.timed(replace(samples, values=samples.values[:, 2:]), shown(topic.name), notes)
