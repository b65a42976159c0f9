"""A live filter that takes late measurements at their own time: it remembers, goes back, and steps forward again."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, zip_longest

from skidsteer.errors import DataError
from skidsteer.odometry.log import Event, Step
from skidsteer.odometry.state import SAME_TIME, Filter, FilterState, Innovation, Measurement, YawRate
from skidsteer.windows import MAX_GAP

Past = tuple[FilterState, Event]  # what happened, and the state before it


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """A filter, its newest state, and the events of the last seconds. Immutable, as the states are.

    The order of arrival does not matter, up to rounding: a measurement is taken into the state of its own time, and all
    later events are repeated.
    """

    filter: Filter
    now: FilterState
    horizon: float = 2.0  # [s] that it can go back; more costs memory and, for late measurements, time
    past: tuple[Past, ...] = ()

    def predict(self, wheels: tuple[float, float] | None, dt: float) -> Timeline:
        """The timeline after rim speeds v_left, v_right [m/s] were held for dt [s]; see ``Filter.predict``."""
        after = self.filter.predict(self.now, wheels, dt)
        return self if after is self.now else self._with(((self.now, Step(wheels, dt)),), after)

    def update(self, measurement: Measurement) -> tuple[Timeline, Innovation]:
        """Take a measurement at its own time, now or earlier.

        A yaw rate with a ``duration`` is divided among its steps, each with its share of the information; the
        innovation is the sum over them.

        Raises:
            DataError: it lies ahead of the newest state, or further back than the horizon; or see ``Filter.update``.
        """
        span = measurement.duration if isinstance(measurement, YawRate) else 0.0
        start = self._back_to(measurement.time - span, measurement.time)
        before = self.past[start][0] if start < len(self.past) else self.now
        events = _inserted([event for _, event in self.past[start:]], before.time, measurement, span)
        past, state, innovations = list(self.past[:start]), before, []
        for event, new in events:
            past.append((state, event))
            if isinstance(event, Step):
                state = event.taken(self.filter, state)
                continue
            state, innovation = self.filter.update(state, event)
            if new:
                innovations.append(innovation)
        return replace(self, now=state, past=tuple(past)), _total(innovations)

    def _with(self, more: tuple[Past, ...], now: FilterState) -> Timeline:
        past = self.past
        if past and past[0][0].time < now.time - 2.0 * self.horizon:  # trimmed seldom, since it costs a copy
            past = past[self._last_before(now.time - self.horizon) :]
        return Timeline(self.filter, now, self.horizon, past + more)

    def _last_before(self, time: float) -> int:
        return max(bisect_right(self.past, time, key=lambda past: past[0].time) - 1, 0)

    def _back_to(self, begin: float, end: float) -> int:
        """Index of the first event that is repeated."""
        if not end <= self.now.time + SAME_TIME:
            raise DataError(
                f"a measurement at {end:.3f} s lies ahead of the state at {self.now.time:.3f} s;"
                " predict up to it first, with the speeds that the wheels have now"
            )
        if begin >= self.now.time - SAME_TIME:
            return len(self.past)
        if not self.past or begin < self.past[0][0].time - SAME_TIME:
            raise DataError(
                f"a measurement at {begin:.3f} s is {self.now.time - begin:.3f} s late, and only {self.horizon:g} s are"
                " kept; give the timeline a longer horizon"
            )
        return self._last_before(begin + SAME_TIME)


def _inserted(
    events: Sequence[Event], clock: float, measurement: Measurement, span: float
) -> Iterator[tuple[Event, bool]]:
    """The events from ``clock`` on with a measurement inserted; True marks it, or a part of it.

    Steps are cut where it begins and ends, and so are their yaw rates. It comes after earlier measurements of its time;
    a yaw rate comes right after each of its steps that has none.
    """
    begin, end = measurement.time - span, measurement.time
    rate = measurement if isinstance(measurement, YawRate) and span > 0.0 else None
    placed = rate is not None
    for event, rated in _with_rates(events):
        if not isinstance(event, Step):
            yield event, False
            continue
        for piece in _cut(event, [begin - clock, end - clock]):
            if not placed and clock >= end - SAME_TIME:
                yield measurement, True
                placed = True
            inside = begin - SAME_TIME <= clock and clock + piece.dt <= end + SAME_TIME
            clock += piece.dt
            yield piece, False
            if rated is not None:
                yield YawRate(clock, rated.rate, rated.variance * (event.dt / piece.dt)), False
            elif rate is not None and inside:
                yield YawRate(clock, rate.rate, rate.variance * (span / piece.dt)), True
    if not placed:
        yield measurement, True


def _with_rates(events: Sequence[Event]) -> Iterator[tuple[Event, YawRate | None]]:
    """Each event other than a yaw rate, with the yaw rate of its step."""
    for event, following in zip_longest(events, events[1:]):
        if not isinstance(event, YawRate):
            yield event, following if isinstance(event, Step) and isinstance(following, YawRate) else None


def _cut(step: Step, cuts: list[float]) -> Iterator[Step]:
    """The step in pieces, cut at times [s] after its beginning that lie inside it."""
    inside = sorted({c for c in cuts if SAME_TIME < c < step.dt - SAME_TIME})
    if not inside:
        yield step
        return
    wheels = step.wheels if step.dt <= MAX_GAP else None
    edges = [0.0, *inside, step.dt]
    for a, b in pairwise(edges):
        yield Step(wheels, b - a, step.sampled and a == 0.0)


def _total(parts: Sequence[Innovation]) -> Innovation:
    accepted, anchored = all(i.accepted for i in parts), any(i.anchored for i in parts)
    return Innovation(sum(i.squared for i in parts), sum(i.dof for i in parts), bool(parts) and accepted, anchored)
