"""Time stamps of a bag: from integer nanoseconds on several clocks to seconds on one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skidsteer.drive import Series
from skidsteer.errors import DataError
from skidsteer.io.messages import Samples
from skidsteer.io.raw import IntArray
from skidsteer.se2 import FloatArray

SECOND = 1_000_000_000
_APART = 10 * SECOND  # clocks further apart than this are different clocks, not a delay
_LATEST = 2**62  # stamps beyond are damage; keeps differences inside 64 bits
_LARGEST = 1e15  # numbers beyond are damage, in any unit
_A_DAY = 86_400 * SECOND
_BOOT_TIME = 1_000_000 * SECOND  # stamps below count from the start of a robot or a simulation: kept as they are


@dataclass(frozen=True, slots=True, eq=False)
class Timed:
    """Numbers with one time each, in the order of that time, without two at the same time."""

    ns: IntArray  # (n,)
    values: FloatArray  # (n, k)

    def with_values(self, values: FloatArray) -> Timed:
        """Other numbers at the same times."""
        return replace(self, values=values)

    def where(self, keep: np.typing.NDArray[np.bool_]) -> Timed:
        """Those samples that a mask (n,) chooses."""
        return Timed(self.ns[keep], self.values[keep])


@dataclass(frozen=True, slots=True)
class Clock:
    """The clock that the wheel messages are stamped with: ``offset_ns`` ahead of the time of recording.

    Zero where headers and recorder use one clock; large in a simulation, or where a controller stamps its messages
    with the time since it was switched on. Messages without a stamp, or on yet another clock, are brought onto it by
    the time at which they were recorded.
    """

    offset_ns: int = 0

    def timed(self, samples: Samples, name: str, notes: list[str]) -> Timed:
        """Samples in order of time; those that are not finite or repeat a time are dropped and counted in ``notes``.

        Raises:
            DataError: nothing is left.
        """
        ns = self._stamps(samples, name, notes)
        finite = (np.abs(samples.values) < _LARGEST).all(axis=1) & (np.abs(ns) < _LATEST)
        order = np.flatnonzero(finite)[np.argsort(ns[finite], kind="stable")]
        first = np.diff(ns[order], prepend=np.int64(-_LATEST)) > 0
        _count(
            notes, name, len(ns) - len(order), "are NaN, infinite, absurdly large or without a sensible time", len(ns)
        )
        _count(notes, name, int((~first).sum()), "repeat a time stamp", len(ns))
        if not len(order):
            raise DataError(f"{name}: none of its {len(ns)} messages holds finite numbers")
        keep = order[first]
        return Timed(ns[keep], samples.values[keep])

    def _stamps(self, samples: Samples, name: str, notes: list[str]) -> IntArray:
        recorded = samples.bag_ns + self.offset_ns
        stamped = samples.header_ns != 0
        if not stamped.any():
            return recorded
        if _goes_back(samples):
            notes.append(f"{name}: its time stamps jump back; the time of recording is used")
            return recorded
        if abs(header_offset(samples) - self.offset_ns) > _APART:
            notes.append(f"{name}: is stamped by another clock than the wheels; the time of recording is used")
            return recorded
        return np.where(stamped, samples.header_ns, recorded)


def clock_of(samples: Samples) -> Clock:
    """The clock of the wheel messages."""
    if _goes_back(samples) or abs(offset := header_offset(samples)) <= _APART:
        return Clock()
    return Clock(offset)


def header_offset(samples: Samples) -> int:
    """Median lead of header stamps over the time of recording [ns]; 0 where there are no stamps."""
    stamped = samples.header_ns != 0
    if not stamped.any():
        return 0
    # Clipped, since a damaged stamp minus another can leave 64 bits.
    header, bag = (np.clip(ns[stamped], -_LATEST, _LATEST) for ns in (samples.header_ns, samples.bag_ns))
    return int(np.median((header - bag).astype(np.float64)))


def _goes_back(samples: Samples) -> bool:
    stamped = samples.header_ns != 0
    header = samples.header_ns[stamped][np.argsort(samples.bag_ns[stamped], kind="stable")]
    back = np.diff(np.clip(header, -_LATEST, _LATEST)) < -SECOND
    return bool(back.any())


def _count(notes: list[str], name: str, number: int, what: str, total: int) -> None:
    if number:
        notes.append(f"{name}: {number} of {total} samples {what}; dropped")


def concatenated(samples: Sequence[Samples]) -> Samples:
    """Samples with different labels, but the same columns, as one."""
    return Samples(
        samples[0].label,
        np.concatenate([part.bag_ns for part in samples]),
        np.concatenate([part.header_ns for part in samples]),
        np.concatenate([part.values for part in samples]),
    )


def common_start(parts: Sequence[Timed]) -> int:
    """Time [ns] to count from: the whole second before the earliest sample, or 0 for stamps that are small as it is.

    A part that begins a day or more before or after the first one is damaged and has no say.
    Seconds since 1970 would leave a float64 only 0.2 microseconds; whole seconds keep the fractions readable.
    """
    first = int(parts[0].ns[0])
    earliest = min(start for part in parts if abs((start := int(part.ns[0])) - first) < _A_DAY)
    return earliest // SECOND * SECOND if earliest >= _BOOT_TIME else 0


def to_series(timed: Timed, start_ns: int, name: str) -> Series:
    """Seconds since ``start_ns``."""
    return Series((timed.ns - start_ns) / SECOND, timed.values, name)
