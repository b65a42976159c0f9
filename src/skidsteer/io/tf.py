"""Chains of coordinate transforms: poses of the base from /tf, and where sensors sit from /tf_static."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.io.messages import Samples
from skidsteer.io.raw import shown
from skidsteer.io.stamps import Clock, Timed
from skidsteer.se2 import FloatArray

Edge = tuple[str, str]  # parent frame, child frame
MAP_FRAMES = ("map", "world", "earth", "mocap", "vicon", "optitrack", "global")
BASE_FRAMES = ("base_link", "base_footprint", "base", "chassis_link", "chassis")
_MAX_LINKS = 64
_MAX_WAYS = 256
_UNIT = 3.0  # orders of magnitude by which the length of a quaternion may differ from one


@dataclass(frozen=True, slots=True)
class Chain:
    """Frames from a map frame down to the base, each the parent of the next."""

    frames: tuple[str, ...]

    @property
    def edges(self) -> tuple[Edge, ...]:
        """Parent and child, from the map down."""
        return tuple(pairwise(self.frames))


def compose(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Transform b (..., 7), given in the frame of transform a (..., 7), in a's parent frame.

    A transform is x, y, z [m] and a unit quaternion x, y, z, w.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    position = a[..., :3] + rotate(a[..., 3:], b[..., :3])
    (ax, ay, az, aw), (bx, by, bz, bw) = np.moveaxis(a[..., 3:], -1, 0), np.moveaxis(b[..., 3:], -1, 0)
    turn = np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )
    return np.concatenate([position, turn], axis=-1)


def invert(transform: ArrayLike) -> FloatArray:
    """The inverse of transforms (..., 7)."""
    transform = np.asarray(transform, dtype=float)
    turn = transform[..., 3:] * np.array([-1.0, -1.0, -1.0, 1.0])
    return np.concatenate([-rotate(turn, transform[..., :3]), turn], axis=-1)


def rotate(quaternion: ArrayLike, vector: ArrayLike) -> FloatArray:
    """Rotate vectors (..., 3) by unit quaternions (..., 4) x, y, z, w."""
    quaternion, vector = np.asarray(quaternion, dtype=float), np.asarray(vector, dtype=float)
    axis, w = quaternion[..., :3], quaternion[..., 3:]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * twice + np.cross(axis, twice))


def normalised(transform: FloatArray) -> FloatArray:
    """Transforms (n, 7) with quaternions of length one; NaN where one is zero, or so far from one that it is damage."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        length = np.linalg.norm(transform[:, 3:], axis=1, keepdims=True)
        turn = np.where(np.abs(np.log10(length)) < _UNIT, transform[:, 3:] / length, np.nan)
    return np.concatenate([transform[:, :3], turn], axis=1)


def planar(transform: ArrayLike) -> FloatArray:
    """Transforms (..., 7) as poses (..., 3): x, y and the yaw of the x axis seen from above, unwrapped along time."""
    transform = np.asarray(transform, dtype=float)
    x, y, z, w = np.moveaxis(transform[..., 3:], -1, 0)
    yaw = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    yaw = np.unwrap(yaw) if yaw.ndim else yaw
    return np.concatenate([transform[..., :2], yaw[..., None]], axis=-1)


def from_planar(pose: ArrayLike) -> FloatArray:
    """Poses (..., 3) as transforms (..., 7) in the plane z = 0."""
    pose = np.asarray(pose, dtype=float)
    zero, half = np.zeros_like(pose[..., 2]), 0.5 * pose[..., 2]
    return np.stack([pose[..., 0], pose[..., 1], zero, zero, zero, np.sin(half), np.cos(half)], axis=-1)


def last_name(frame: str) -> str:
    """The frame's name without the robot's prefix: ``husky/base_link`` is ``base_link``."""
    return frame.rsplit("/", 1)[-1]


def find_chain(edges: Sequence[Edge], map_frame: str | None, base_frame: str | None) -> Chain | None:
    """The chain from a map frame to the base; None where there is none.

    Without ``map_frame`` the highest frame with a usual name is taken, never ``odom``: what lies below that comes
    from the wheels. Where several nodes tell of the same frame, as motion capture beside the odometry, the shortest
    chain is taken.
    """
    parents: dict[str, list[str]] = {}
    for above, below in edges:
        parents.setdefault(below, []).append(above)
    bases = [base_frame] if base_frame else sorted({frame for edge in edges for frame in edge}, key=_base_rank)
    for base in bases:
        if not base_frame and last_name(base) not in BASE_FRAMES:
            return None
        chains = []
        for frames in islice(_ways_up(parents, (base,)), _MAX_WAYS):
            tops = [i for i, frame in enumerate(frames) if i and _is_top(frame, map_frame)]
            chains += [tuple(reversed(frames[: tops[-1] + 1]))] if tops else []
        if chains:
            return Chain(min(chains, key=lambda frames: (len(frames), frames)))
    return None


def _ways_up(parents: Mapping[str, Sequence[str]], frames: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Every way that leads on from the last of these frames to one that has no parent."""
    above = [frame for frame in parents.get(frames[-1], ()) if frame not in frames and len(frames) < _MAX_LINKS]
    for frame in above:
        yield from _ways_up(parents, (*frames, frame))
    if not above:
        yield frames


def _base_rank(frame: str) -> tuple[int, str]:
    name = last_name(frame)
    return (BASE_FRAMES.index(name) if name in BASE_FRAMES else len(BASE_FRAMES), frame)


def _is_top(frame: str, map_frame: str | None) -> bool:
    return frame == map_frame if map_frame else last_name(frame) in MAP_FRAMES


def _upwards(parent: Mapping[str, str], frame: str) -> list[str]:
    frames = [frame]
    while frame in parent and len(frames) < _MAX_LINKS and parent[frame] not in frames:
        frame = parent[frame]
        frames.append(frame)
    return frames


def chain_poses(chain: Chain, edges: Mapping[Edge, Samples], clock: Clock, notes: list[str]) -> Timed | None:
    """Transforms (n, 7) of the base in the map, at the times of the moving link nearest to the map.

    That link is what a localisation publishes, each time it has seen where the robot is; between two of them a chain
    only repeats the wheels. The links below are interpolated to its times. None where no link moves.
    """
    links = [_link(edges[edge], f"/tf {shown(' -> '.join(edge))}", clock, notes) for edge in chain.edges]
    moving = [link for link in links if len(link.ns) > 1]
    if not moving:
        return None
    start, end = max(link.ns[0] for link in moving), min(link.ns[-1] for link in moving)
    ns = moving[0].ns[(moving[0].ns >= start) & (moving[0].ns <= end)]
    if len(ns) < 2:
        return None
    total = from_planar(np.zeros((len(ns), 3)))
    for link in links:
        total = compose(total, _at(link, ns))
    return Timed(ns, total)


def _link(samples: Samples, name: str, clock: Clock, notes: list[str]) -> Timed:
    """The transforms of one link over time; a single one where it never changes."""
    kept = Samples(samples.label, samples.bag_ns, samples.header_ns, normalised(samples.values))
    timed = clock.timed(kept, name, notes)
    moves = bool((np.ptp(timed.values, axis=0) > 1e-9).any())
    return timed if moves else Timed(timed.ns[:1], timed.values[:1])


def _at(link: Timed, ns: FloatArray | np.typing.NDArray[np.int64]) -> FloatArray:
    """Transforms (n, 7) of a link at times ``ns``: positions linear, turns along the chord between neighbours."""
    if len(link.ns) == 1:
        return np.broadcast_to(link.values[0], (len(ns), 7))
    after = np.clip(np.searchsorted(link.ns, ns, side="left"), 1, len(link.ns) - 1)
    t0, t1 = link.ns[after - 1], link.ns[after]
    share = ((ns - t0) / (t1 - t0))[:, None]
    a, b = link.values[after - 1], link.values[after].copy()
    # q and -q are the same turn; take the near one.
    b[:, 3:] *= np.where((a[:, 3:] * b[:, 3:]).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    return normalised(a + share * (b - a))


def fixed_transform(edges: Mapping[Edge, Samples], parent: str, child: str) -> FloatArray | None:
    """Transform (7,) of frame ``child`` in frame ``parent`` along static links; None where they are not connected."""
    up = {below: above for above, below in edges}
    above_child, above_parent = _upwards(up, child), _upwards(up, parent)
    shared = next((frame for frame in above_child if frame in above_parent), None)
    if shared is None:
        return None
    return compose(invert(_down(edges, above_parent, shared)), _down(edges, above_child, shared))


def _down(edges: Mapping[Edge, Samples], upwards: Sequence[str], top: str) -> FloatArray:
    total = from_planar(np.zeros(3))
    for child, parent in pairwise(upwards[: upwards.index(top) + 1]):
        total = compose(normalised(edges[parent, child].values[:1])[0], total)
    return total
