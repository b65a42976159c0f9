"""Windows: stretches of a drive over which the reference tells the motion, and a model's prediction of that motion."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.kernels import roll
from skidsteer.kernels import rollout as kernels
from skidsteer.models import MatrixModel, Model
from skidsteer.se2 import FloatArray, between, compose, invert, rotate, wrap

MAX_GAP = 1.0  # [s] without a wheel sample; over a longer gap nothing is known of the motion
LEAP, LEAP_TURN = 0.5, np.radians(45.0)  # [m], [rad]; smaller steps of a reference may be noise
FASTER, SCATTER = 3.0, 0.3  # times the fastest wheel speed; [s] that stamps may be off by. Beyond, no robot moves
FROZEN, CATCH_UP = 1e-3, 2.0  # [m] smaller steps are none; [s] for which a reference may freeze
RARE = 0.05  # share of the steps that may be leaps
FAR = 1000.0  # [m] a single wrong sample this far off is cut out: it would spoil every figure
LATEST = 1.5  # [s] by which the reference may be late or early
USUAL = 3.0  # times the median increment: longer ones are gaps
WARM_UP = 1.0  # [s] the first sample after a gap is held backwards, for windows that a delay moves before it
TURN_SPACING = 0.5  # [s] of windows over which a gyro alone is compared
CHUNK = 200_000  # steps handled at once for models that are not linear in the speeds: bounds the memory


@dataclass(frozen=True, slots=True)
class Timing:
    """Timing of reference and body relative to the wheels, [s].

    ``time_offset``: the reference's stamps are late by this (negative: early). ``lag``: time constant with which the
    body follows the measured rim speeds.
    """

    time_offset: float = 0.0
    lag: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.time_offset) and np.isfinite(self.lag) and self.lag >= 0.0):
            raise ValueError(f"need a finite time_offset and lag >= 0 [s], got {self.time_offset}, {self.lag}")


@dataclass(frozen=True, slots=True)
class Mount:
    """Pose of the reference's sensor (antenna, scanner, marker) in base_link: x, y [m], yaw [rad]."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite([self.x, self.y, self.yaw]).all():
            raise ValueError(f"a mount needs finite x, y [m] and yaw [rad], got {self.x}, {self.y}, {self.yaw}")

    def seen(self, motion: FloatArray) -> FloatArray:
        """Motions (k, 3) of the body as its sensor sees them."""
        here = np.array([self.x, self.y, self.yaw])
        return between(np.broadcast_to(here, motion.shape), compose(motion, here))

    def body(self, motion: FloatArray) -> FloatArray:
        """Motions (k, 3) of the body, from those of its sensor: undoes ``seen``."""
        here = np.array([self.x, self.y, self.yaw])
        return compose(compose(here, motion), invert(here))


Sees = Literal["pose", "position", "turn"]


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Measured motions between two reference stamps of one drive.

    ``joined[i]`` tells that window i begins with the very pose that window i - 1 ends with, so that they share its
    noise.
    """

    start: FloatArray  # (k,) [s] reference clock
    end: FloatArray  # (k,)
    motion: FloatArray  # (k, 3) pose at the end seen from the pose at the start
    joined: np.ndarray  # (k,) bool
    sees: Sees = "pose"  # position: the yaw of ``motion`` is a guess; turn: ``motion`` tells nothing, a gyro may

    def __len__(self) -> int:
        return len(self.start)

    def where(self, keep: np.ndarray) -> Windows:
        """The windows chosen by a mask (k,); a window whose predecessor is dropped is no longer joined."""
        index = np.flatnonzero(keep)
        joined = self.joined[index] & np.concatenate([[False], np.diff(index) == 1])
        return Windows(self.start[index], self.end[index], self.motion[index], joined, self.sees)


def pieces(drive: Drive) -> FloatArray:
    """Stretches (k, 2) of reference time [s] in which wheels and reference are both there: the segments, or the whole.

    They are cut where no wheel sample came for ``MAX_GAP``, and where the reference leaps.
    """
    both = stretches(drive.wheels.t)
    cuts = leaps(drive)
    if len(cuts):
        both = _common(both, np.stack([np.r_[-np.inf, cuts[:, 1]], np.r_[cuts[:, 0], np.inf]], axis=1))
    return both if drive.segments is None else _common(both, drive.segments)


def _common(spans: FloatArray, others: FloatArray) -> FloatArray:
    """What lies in one of the spans (k, 2) and one of the others (m, 2), each of them in order."""
    low = np.searchsorted(spans[:, 1], others[:, 0], side="right")
    high = np.searchsorted(spans[:, 0], others[:, 1], side="left")
    cut = [np.clip(spans[a:b], *other) for a, b, other in zip(low, high, others, strict=True)]
    return np.concatenate([np.zeros((0, 2)), *cut])


def leaps(drive: Drive) -> FloatArray:
    """Times (k, 2) [s] of the samples before and after each step of the reference that is no motion of the robot.

    A localization that restarts, another fix: a step above ``LEAP`` plus ``FASTER`` times what the wheels at their
    fastest around then roll in that time (or since the reference last moved: one that froze catches up); in yaw, more
    than they turn without slip. Two in a row are one wrong sample, which an estimator weighs down, unless it is ``FAR``
    off: a fix at (0, 0) among map coordinates. Where leaps are not rare, none is returned: a unit is wrong instead.
    """
    reference, wheels = drive.reference, drive.wheels
    if reference is None or len(reference) < 2:
        return np.zeros((0, 2))
    t, step = reference.t, np.diff(reference.values, axis=0)
    way = np.hypot(step[:, 0], step[:, 1])
    turn = np.abs(wrap(step[:, 2])) if step.shape[1] > 2 else np.zeros(len(step))
    large = np.flatnonzero((way > LEAP) | (turn > LEAP_TURN))
    rolled = _time_to_move(t, way > FROZEN)[large]
    speed, spin = _fastest(wheels, t[large + 1] - rolled - LATEST, t[large + 1] + LATEST)
    leap = way[large] > LEAP + FASTER * rolled * speed
    leap |= turn[large] > LEAP_TURN + rolled * spin / drive.vehicle.track_width
    at = large[leap]
    alone = ~(np.isin(at - 1, at) | np.isin(at + 1, at))
    cut = (alone | (way[at] > FAR)) & (len(at) <= RARE * len(step))
    return np.stack([t[at], t[at + 1]], axis=1)[cut]


def _fastest(wheels: Series, start: FloatArray, end: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Highest speed of a side, and largest difference of both (k,) [m/s], in the wheel log between times (k,) [s]."""
    sizes = np.stack([np.abs(wheels.values).max(axis=1), np.abs(np.diff(wheels.values, axis=1)[:, 0])], axis=-1)
    first, last = np.searchsorted(wheels.t, start), np.searchsorted(wheels.t, end)
    top = np.array([sizes[max(a - 1, 0) : b + 1].max(axis=0) for a, b in zip(first, last, strict=True)])
    speed, difference = top.reshape(-1, 2).T
    return speed, difference


def _time_to_move(t: FloatArray, moves: np.ndarray) -> FloatArray:
    """Time (n - 1,) [s] from the last sample that moved to the end of each step, plus what the stamps may be off by."""
    last = np.maximum.accumulate(np.where(moves, np.arange(1, len(t)), 0))
    since = t[1:] - t[np.r_[0, last[:-1]]]
    return np.asarray(np.minimum(since, np.diff(t) + CATCH_UP) + SCATTER)


def stretches(t: FloatArray) -> FloatArray:
    """First and last time (k, 2) [s] of the stretches of a clock t (n,) without a gap of more than ``MAX_GAP``."""
    gaps = np.flatnonzero(np.diff(t) > MAX_GAP)
    return np.stack([np.r_[t[0], t[gaps + 1]], np.r_[t[gaps], t[-1]]], axis=1)


def covered(t: FloatArray, start: FloatArray, end: FloatArray) -> np.ndarray:
    """Whether a clock t (n,) has samples, without a gap, throughout each of the times start to end (k,)."""
    stretch = stretches(t)
    index = np.clip(np.searchsorted(stretch[:, 0], start, side="right") - 1, 0, None)
    return np.asarray((stretch[index, 0] <= start) & (end <= stretch[index, 1]))


def increment_windows(drive: Drive, spacing: float = 0.0, longest: float = 5.0) -> Windows:
    """Windows between neighbouring samples of the reference at least ``spacing`` [s] apart, none above ``longest``.

    Where the reference is so sparse that most would be longer, none above ``USUAL`` times their median.
    Where the reference tells no heading, the yaw of the motions is zero and their positions are along the axes of the
    reference. Where a gyro is all there is, windows of ``TURN_SPACING`` or more follow each other on its clock.
    """
    sees, reference = _reference(drive, spacing)
    index = [_thinned(reference.t, _inside(reference.t, piece), spacing) for piece in pieces(drive)]
    pairs = np.concatenate([np.stack([i[:-1], i[1:]], axis=1) for i in index if len(i) > 1] or [np.zeros((0, 2), int)])
    windows = _windows(reference, pairs, sees)
    lasted = windows.end - windows.start
    return windows.where(lasted <= max(longest, USUAL * float(np.median(lasted))) if len(windows) else lasted > 0.0)


def _reference(drive: Drive, spacing: float = 0.0) -> tuple[Sees, Series]:
    """What the reference sees, and its samples as poses, zero where unknown."""
    if drive.pose is not None:
        return "pose", drive.pose
    if drive.position is not None:
        yaw = np.zeros((len(drive.position), 1))
        return "position", Series(drive.position.t, np.hstack([drive.position.values, yaw]), "position")
    if drive.gyro is None:
        raise ValueError(f"{drive.name} has no reference")
    first, last = max(drive.span[0], drive.gyro.t[0]), min(drive.span[1], drive.gyro.t[-1])
    t = np.arange(first, max(last, first + 1e-3), max(spacing, TURN_SPACING))
    return "turn", Series(t, np.zeros((len(t), 3)), "gyro")


def judging_windows(
    drive: Drive, length: float = 2.0, shortest: float = 1.0, least_move: tuple[float, float] = (0.1, np.radians(5.0))
) -> Windows:
    """Windows that the errors of a model are counted on.

    A window starts at a reference pose and ends at the last one no more than ``length`` [s] later; they do not
    overlap. It counts when it is at least ``shortest`` long (half of ``length`` where that is less) and the reference
    moved by ``least_move`` [m, rad]. In a drive with segments each segment is one window, whatever its length. Where a
    gyro is all there is, every window counts.
    """
    sees, reference = _reference(drive)
    windows = _windows(reference, judging_pairs(drive, reference.t, length), sees)
    span, moved = windows.end - windows.start, np.abs(windows.motion)
    moves = (np.hypot(moved[:, 0], moved[:, 1]) >= least_move[0]) | (moved[:, 2] >= least_move[1]) | (sees == "turn")
    return windows.where(moves & (span >= min(shortest, 0.5 * length)))


def judging_pairs(drive: Drive, t: FloatArray, length: float) -> np.ndarray:
    """First and last index (k, 2) into the reference stamps t (n,) of windows no longer than ``length`` [s]."""
    pairs: list[tuple[int, int]] = []
    for piece in pieces(drive):
        index = _inside(t, piece)
        if len(index) < 2:
            continue
        i, last = int(index[0]), int(index[-1])
        if drive.segments is not None:
            pairs.append((i, last))
            continue
        while i < last:
            j = min(int(np.searchsorted(t, t[i] + length + 1e-9, side="right")) - 1, last)
            if j > i:
                pairs.append((i, j))
            i = max(j, i + 1)
    return np.array(pairs, dtype=int).reshape(-1, 2)


def _inside(t: FloatArray, piece: FloatArray) -> np.ndarray:
    first, last = np.searchsorted(t, [piece[0], np.nextafter(piece[1], np.inf)])
    return np.arange(first, last)


def _thinned(t: FloatArray, index: np.ndarray, spacing: float) -> np.ndarray:
    """Every index whose time is at least ``spacing`` after the last one kept; the very last is kept if it fits."""
    if spacing <= 0.0 or len(index) < 2:
        return index
    kept, clock = [int(index[0])], t[index]
    while True:
        following = int(np.searchsorted(clock, t[kept[-1]] + spacing - 1e-9))
        if following >= len(index):
            break
        kept.append(int(index[following]))
    return np.array(kept)


def _windows(pose: Series, pairs: np.ndarray, sees: Sees) -> Windows:
    i, j = pairs[:, 0], pairs[:, 1]
    joined = np.concatenate([[False], i[1:] == j[:-1]]) if len(pairs) else np.zeros(0, bool)
    return Windows(pose.t[i], pose.t[j], between(pose.values[i], pose.values[j]), joined, sees)


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """The wheel samples of windows: what each side rolled in each step, for one ``Timing``."""

    distance: FloatArray  # (s, 2) [m]
    by_lag: FloatArray  # (s, 2) [m/s] derivative by the lag
    duration: FloatArray  # (s,) [s]
    offsets: np.ndarray  # (k + 1,) steps offsets[i]:offsets[i + 1] belong to window i
    start_speeds: FloatArray  # (k, 2) [m/s]
    end_speeds: FloatArray  # (k, 2) [m/s]


def steps(wheels: Series, windows: Windows, timing: Timing, slopes: bool = True) -> Steps:
    """Cut the wheel log (held speeds, lagged) at the ends of windows shifted by the time offset.

    Without ``slopes``, ``by_lag`` is (0, 2): it costs as much memory as the distances, and only ``linearize`` needs it.
    """
    t, v, restart = _warmed_up(wheels)
    start, end = windows.start - timing.time_offset, windows.end - timing.time_offset
    first, offsets = roll.count_steps(t, start, end)
    # NumPy allocates large arrays in huge pages; the compiler's np.empty does not, and would wait for the page faults.
    count, k = int(offsets[-1]), len(start)
    cut = Steps(
        distance=np.empty((count, 2)),
        by_lag=np.empty((count if slopes else 0, 2)),
        duration=np.empty(count),
        offsets=offsets,
        start_speeds=np.empty((k, 2)),
        end_speeds=np.empty((k, 2)),
    )
    out = (cut.distance, cut.by_lag, cut.duration, cut.start_speeds, cut.end_speeds)
    if timing.lag > 0.0:
        roll.roll_lagged(t, v, restart, timing.lag, start, end, first, offsets, *out)
    else:
        roll.roll_held(t, v, restart, start, end, first, offsets, *out)
    return cut


def _warmed_up(wheels: Series) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Wheel samples, the first after each gap held backwards too, and whether the time before each is unknown."""
    t, v = wheels.t, np.ascontiguousarray(wheels.values)
    if roll.count_gaps(t, MAX_GAP) == 0:
        return t, v, np.zeros(len(t), bool)
    after = np.flatnonzero(np.diff(t) > MAX_GAP) + 1
    early = t[after] - np.minimum(WARM_UP, 0.5 * np.diff(t)[after - 1])
    restart = np.insert(np.zeros(len(t), bool), after, True)
    t, v = np.insert(t, after, early), np.insert(v, after, v[after], axis=0)
    for array in (t, v):  # as those of a Series: the loops are compiled once
        array.setflags(write=False)
    return t, v, restart


def predict(model: Model, wheels: Series, windows: Windows, timing: Timing) -> FloatArray:
    """Motion (k, 3) that the model predicts for each window."""
    cut = steps(wheels, windows, timing, slopes=False)
    if isinstance(model, MatrixModel):
        motion = np.empty((len(windows), 3))
        kernels.rollout_matrix(model.matrix(), cut.distance, cut.by_lag, cut.offsets, motion, np.empty((0, 3, 7)))
        return motion
    return kernels.rollout(_increments(model, cut.distance, cut.duration), cut.offsets)


def linearize(model: Model, cut: Steps) -> tuple[FloatArray, FloatArray]:
    """Motion (k, 3) of cut windows, and its derivative (k, 3, p + 2): parameters, time offset, lag."""
    start = model.twist(cut.start_speeds[:, 0], cut.start_speeds[:, 1])
    end = model.twist(cut.end_speeds[:, 0], cut.end_speeds[:, 1])
    if isinstance(model, MatrixModel):
        A, C = model.matrix(), model.matrix_jacobian().reshape(6, -1)
        motion, out = np.empty((len(start), 3)), np.empty((len(start), 3, C.shape[1] + 2))
        kernels.linearize_matrix(A, C, cut.distance, cut.by_lag, cut.offsets, start, end, motion, out)
        return motion, out
    motion, jacobian = _rollout_in_chunks(model, cut)
    by_offset = kernels.slide(motion, start, end)[..., None]
    return motion, np.concatenate([jacobian[..., :-1], by_offset, jacobian[..., -1:]], axis=-1)


def _increments(model: Model, distance: FloatArray, duration: FloatArray) -> FloatArray:
    dt = duration[:, None]
    speed = np.divide(distance, dt, out=np.zeros_like(distance), where=dt > 0)
    return np.ascontiguousarray(model.twist(speed[:, 0], speed[:, 1]) * dt)


def _rollout_in_chunks(model: Model, cut: Steps) -> tuple[FloatArray, FloatArray]:
    cuts = np.searchsorted(cut.offsets, np.arange(CHUNK, cut.offsets[-1], CHUNK))
    edges = np.unique(np.r_[0, cuts, len(cut.offsets) - 1])
    parts = [_rollout_part(model, cut, a, b) for a, b in itertools.pairwise(edges)]
    if not parts:
        return np.zeros((0, 3)), np.zeros((0, 3, len(model.theta) + 1))
    motion, jacobian = zip(*parts, strict=True)
    return np.concatenate(motion), np.concatenate(jacobian)


def _rollout_part(model: Model, cut: Steps, a: int, b: int) -> tuple[FloatArray, FloatArray]:
    part = slice(cut.offsets[a], cut.offsets[b])
    dt = cut.duration[part, None]
    speed = np.divide(cut.distance[part], dt, out=np.zeros_like(cut.distance[part]), where=dt > 0)
    left, right = speed[:, 0], speed[:, 1]
    by_parameter = model.parameter_jacobian(left, right) * dt[..., None]
    by_lag = model.speed_jacobian(left, right) @ cut.by_lag[part, :, None]
    increments = np.ascontiguousarray(model.twist(left, right) * dt)
    jacobian = np.ascontiguousarray(np.concatenate([by_parameter, by_lag], axis=-1))
    return kernels.rollout_sensitivities(increments, jacobian, cut.offsets[a : b + 1] - cut.offsets[a])


def seen_by(mount: Mount, motion: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Motions (k, 3) of the body and their derivative (k, 3, p) as a sensor sees them.

    Returns:
        motion (k, 3) and derivative (k, 3, p + 3); the last three columns: x, y and yaw of the mount.
    """
    lever, back = np.array([mount.x, mount.y]), np.full(len(motion), -mount.yaw)
    yaw = motion[:, 2]
    seen = motion.copy()
    seen[:, :2] = rotate(back, motion[:, :2] + rotate(yaw, lever) - lever)
    swung = rotate(yaw + 0.5 * np.pi, lever)  # d (R lever) / d yaw
    out = np.zeros((len(motion), 3, jacobian.shape[2] + 3))
    out[:, 2, :-3] = jacobian[:, 2]
    moved = jacobian[:, :2] + swung[:, :, None] * jacobian[:, 2:3]
    out[:, :2, :-3] = np.moveaxis(rotate(back[:, None], np.moveaxis(moved, 1, 2)), 1, 2)
    for i in range(2):
        unit = np.eye(2)[i]
        out[:, :2, -3 + i] = rotate(back, rotate(yaw, unit) - unit)
    out[:, :2, -1] = rotate(np.full(len(motion), -0.5 * np.pi), seen[:, :2])
    return seen, out
