"""A recorded drive: wheel speeds and whatever else was logged beside them, on clocks in seconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.errors import DataError
from skidsteer.se2 import FloatArray
from skidsteer.vehicle import Vehicle

LARGEST = 1e9  # of any number of a series: squares of larger ones drown all others


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Samples on a strictly increasing clock: ``t`` (n,) [s], ``values`` (n, k). Immutable and finite.

    Raises:
        DataError: shapes that do not fit, fewer than one sample, NaN, infinity or numbers beyond ``LARGEST``, a clock
            that does not increase.
    """

    t: FloatArray
    values: FloatArray
    name: str = "series"

    def __post_init__(self) -> None:
        t = np.array(self.t, dtype=np.float64)
        values = np.array(self.values, dtype=np.float64)
        if values.ndim == 1:
            values = values[:, None]
        if t.ndim != 1 or values.ndim != 2 or len(t) != len(values):
            raise DataError(f"{self.name}: times {t.shape} and values {values.shape} do not belong together")
        if len(t) == 0:
            raise DataError(f"{self.name}: no samples")
        _refuse_nonfinite(self.name, t, values)
        _refuse_huge(self.name, t, values)
        _refuse_unsorted(self.name, t)
        for array, attribute in ((t, "t"), (values, "values")):
            array.setflags(write=False)
            object.__setattr__(self, attribute, array)

    def __len__(self) -> int:
        return len(self.t)

    def between(self, start: float, end: float) -> Series | None:
        """Samples with start <= t <= end, or None where there is none."""
        keep = slice(*np.searchsorted(self.t, [start, np.nextafter(end, np.inf)]))
        return Series(self.t[keep], self.values[keep], self.name) if self.t[keep].size else None

    def hold(self, t: ArrayLike) -> FloatArray:
        """Values (..., k) of the last sample at or before t (..., ) [s]; before the first sample, the first."""
        index = np.searchsorted(self.t, np.asarray(t, dtype=float), side="right") - 1
        return np.asarray(self.values[np.maximum(index, 0)])


def _refuse_nonfinite(name: str, t: FloatArray, values: FloatArray) -> None:
    bad = np.flatnonzero(~(np.isfinite(t) & np.isfinite(values).all(axis=1)))
    if bad.size:
        raise DataError(
            f"{name}: sample {bad[0] + 1} of {len(t)} (t = {t[bad[0]]:.3f} s) is NaN or infinite"
            f" ({bad.size} in all); remove those rows"
        )


def _refuse_huge(name: str, t: FloatArray, values: FloatArray) -> None:
    bad = np.flatnonzero((np.abs(values) > LARGEST).any(axis=1))
    if bad.size:
        worst = float(np.abs(values[bad[0]]).max())
        raise DataError(
            f"{name}: sample {bad[0] + 1} of {len(t)} (t = {t[bad[0]]:.3f} s) holds {worst:.3g}, which no sensor tells"
            f" ({bad.size} in all); remove those rows"
        )


def _refuse_unsorted(name: str, t: FloatArray) -> None:
    step = np.diff(t)
    if (step > 0).all():
        return
    bad = int(np.argmax(step <= 0)) + 1
    what = "repeats the time of" if step[bad - 1] == 0 else "is earlier than"
    raise DataError(f"{name}: sample {bad + 1} (t = {t[bad]:.3f} s) {what} the one before; sort by time, keep one each")


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What was recorded of one robot in one session. Immutable; every part but the wheels is optional.

    The wheel speeds are held from each sample to the next. The clocks of the parts may be shifted against each other:
    that is estimated, not assumed away.
    """

    name: str
    vehicle: Vehicle
    wheels: Series  # (n, 2) v_left, v_right: rim speeds [m/s]
    pose: Series | None = None  # (m, 3) x, y, yaw of base_link in the reference frame
    position: Series | None = None  # (m, 2) x, y where the reference has no heading
    gyro: Series | None = None  # (g, 1) yaw rate [rad/s]
    command: Series | None = None  # (c, 2) commanded v [m/s], omega [rad/s]
    wheel_command: Series | None = None  # (c, 2) commanded v_left, v_right [m/s]
    segments: FloatArray | None = None  # (k, 2) start, end [s]: separate windows, nothing continuous between them
    labels: Mapping[str, FloatArray] = field(default_factory=dict)  # name -> (k,) further columns of the segments
    source: str = ""  # where it was read from
    sha256: str = ""  # of the files, or for a bag of the numbers read from it
    antenna: tuple[float, float] | None = None  # [m] ahead and left: what ``position`` is of, where the log tells

    def __post_init__(self) -> None:
        widths = {"wheels": 2, "pose": 3, "position": 2, "gyro": 1, "command": 2, "wheel_command": 2}
        for part, width in widths.items():
            series = getattr(self, part)
            if series is not None and series.values.shape[1] != width:
                raise DataError(f"{self.name}: {part} needs {width} columns, got {series.values.shape[1]}")
        if self.segments is not None:
            object.__setattr__(self, "segments", _checked_segments(self.name, self.segments))
        object.__setattr__(self, "labels", MappingProxyType(dict(self.labels)))

    @property
    def reference(self) -> Series | None:
        """The reference poses, or else positions, or None."""
        return self.pose if self.pose is not None else self.position

    @property
    def sees(self) -> str:
        """What the reference tells: pose, or position; turn where there is none but a gyro may be."""
        return "turn" if self.reference is None else "position" if self.pose is None else "pose"

    @property
    def span(self) -> tuple[float, float]:
        """First and last wheel time [s]."""
        return float(self.wheels.t[0]), float(self.wheels.t[-1])

    def between(self, start: float, end: float) -> Drive:
        """The part of the drive with start <= t <= end [s]; segments only where they lie inside.

        Raises:
            DataError: no wheel sample in that time.
        """
        wheels = self.wheels.between(start, end)
        if wheels is None:
            raise DataError(f"{self.name}: no wheel sample between {start:.3f} and {end:.3f} s")
        optional = {
            part: series.between(start, end)
            for part in ("pose", "position", "gyro", "command", "wheel_command")
            if (series := getattr(self, part)) is not None
        }
        if self.segments is None:
            return replace(self, wheels=wheels, **optional)
        inside = (self.segments[:, 0] >= start) & (self.segments[:, 1] <= end)
        return replace(self, wheels=wheels, **optional).with_segments(inside)

    def with_segments(self, keep: ArrayLike) -> Drive:
        """The same drive with only the segments chosen by a mask (k,) of booleans or by indices.

        Raises:
            DataError: the drive has no segments, or none is left.
        """
        if self.segments is None:
            raise DataError(f"{self.name}: has no segments")
        keep = np.asarray(keep)
        labels = {name: values[keep] for name, values in self.labels.items()}
        return replace(self, segments=self.segments[keep], labels=labels)


def _checked_segments(name: str, segments: ArrayLike) -> FloatArray:
    segments = np.array(segments, dtype=np.float64)
    if segments.ndim != 2 or segments.shape[1] != 2 or len(segments) == 0:
        raise DataError(f"{name}: segments need rows of t_start, t_end, got shape {segments.shape}")
    flat = segments.ravel()
    if not np.isfinite(flat).all() or (np.diff(segments, axis=1) <= 0).any() or (np.diff(flat) < 0).any():
        raise DataError(f"{name}: segments must be finite, end after they start, and follow each other without overlap")
    segments.setflags(write=False)
    return segments
