"""Give recorded messages their log time and their order, both of simulated time alone.

In which order messages of different topics arrive depends on the load of the machine. They are held back for a moment
and sorted by their stamps, so that equal runs make equal bags.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from enum import Enum, auto
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.batch import Int64Array, MessageBatch
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION, cdr_stamp_ns

_HOLD_NS = 500_000_000  # of simulated time; far above what topics run apart
_MAX_UNDATED_BYTES = 16 << 20
_UNKNOWN = -1  # in place of a log time
OTHER_CLOCK_NS: Final = 86_400 * NANOSECONDS
"""A stamp this far from the newest one is not of the same clock: wall-clock time beside simulated time, for example."""
_COUNT = slice(ENCAPSULATION, ENCAPSULATION + 4)  # where a list has its length


class TimeSource(Enum):
    """Where the messages of a topic have their log time from."""

    CLOCK = auto()
    """Their stamp, which is the sample time, and the time of messages that have none."""
    STAMP = auto()
    """Their stamp; where that is 0 ("now") or of another clock, the newest one of a clock topic."""
    LIST = auto()
    """As STAMP, the stamp of the first of those that they are a list of: transforms."""
    NEWEST = auto()
    """The newest stamp of a clock topic, as they have none."""


class Dated(NamedTuple):
    """n messages with log times.

    Attributes:
        log_ns: log time, ns, int64 (n,).
        topic: index of the topic, int64 (n,).
        messages: what was received.
    """

    log_ns: Int64Array
    topic: Int64Array
    messages: MessageBatch

    def take(self, rows: Int64Array) -> Dated:
        """Return these messages."""
        return Dated(self.log_ns[rows], self.topic[rows], self.messages.take(rows))


class Arrived(NamedTuple):
    """n messages of a topic in the order of arrival.

    Attributes:
        topic: index of the topic.
        source: where their log time comes from.
        messages: what was received.
        received_ns: the wall clock's times of reception, ns, int64 (n,).
    """

    topic: int
    source: TimeSource
    messages: MessageBatch
    received_ns: Int64Array


class _Clock:
    """The newest log time at any time of reception, and how far it is ahead of the stamps.

    Args:
        newest: the log time before all these messages, None if there was none.
        offset: by how much it was ahead.
        received_ns: times of reception of messages that give the time, int64 (n,).
        stamps: theirs, int64 (n,).
        log_ns: their log times, int64 (n,).
    """

    def __init__(
        self, newest: int | None, offset: int, received_ns: Int64Array, stamps: Int64Array, log_ns: Int64Array
    ) -> None:
        order = np.argsort(received_ns, kind="stable")
        self._received = received_ns[order]
        first = _UNKNOWN if newest is None else newest
        self._newest = np.maximum.accumulate(np.concatenate([[first], log_ns[order]]))
        self._offset = np.maximum.accumulate(np.concatenate([[offset], (log_ns - stamps)[order]]))

    def date(self, stamps: Int64Array, received_ns: Int64Array) -> Int64Array:
        """Return log times for stamps; for 0, and for another clock's, the newest one before the time of reception.

        That is _UNKNOWN before the first one.
        """
        at = np.searchsorted(self._received, received_ns)
        log_ns, newest = stamps + self._offset[at], self._newest[at]
        return np.where(_same_clock(stamps, log_ns, newest), log_ns, newest)


class LogOrder:
    """Dates messages and releases them in the order of log time, then of their topics, then of arrival.

    All log times are of one clock: that of the first topic that gives the time. Messages with stamps of another clock
    are dated by their reception, as messages without a stamp are. Those that come before the first one that gives the
    time get that one's. Where no topic gives the time, it is the clock of the first stamp, or the wall clock's time of
    reception.

    Log time never goes back, or a reader, which sorts by it, would mix two runs. Where stamps go back, after a reset of
    the simulation, log time goes on from where it was, and runs ahead of the stamps from then on.

    Attributes:
        set_backs: for each time that the stamps went back, the newest one before and the first one after, ns.
        held_bytes: bytes of the messages that are held.
        other_clock: number of messages of each topic whose stamps are of another clock.
    """

    def __init__(self) -> None:
        self._by_reception = False
        self._newest: int | None = None
        self._first: int | None = None
        self._stamps: dict[int, int] = {}  # newest of each clock topic
        self._epochs: dict[int, int] = {}  # of each clock topic: how often its stamps went back
        self._offsets = [0]  # log time less stamp, for each epoch
        self.set_backs: list[tuple[int, int]] = []
        self._held: list[Dated] = []
        self._undated: list[Arrived] = []
        self._undated_bytes = 0
        self._next_release = 0
        self.held_bytes = 0
        self.other_clock: Counter[int] = Counter()
        self._started: tuple[int, int] | None = None  # without a topic that gives the time: a log time, its reception

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp seen, None before the first."""
        return None if self._newest is None else self._newest - self._offsets[-1]

    def expect_no_clock(self) -> None:
        """Date by reception: none of the topics will give the time."""
        self._by_reception = True

    def add(self, arrived: Sequence[Arrived]) -> None:
        """Take the messages that have arrived since the last call."""
        newest, offset = self._newest, self._offsets[-1]
        clocks: list[Arrived] = []
        dated: list[tuple[Int64Array, Int64Array]] = []
        others: list[Arrived] = []
        for each in arrived:
            if each.source is TimeSource.CLOCK and self._gives_time(each):
                clocks.append(each)
                dated.append(self._add_clock(each))
            else:
                others.append(each)
        if others:
            fields = zip(*((each.received_ns, *times) for each, times in zip(clocks, dated, strict=True)), strict=True)
            columns = [np.concatenate(field) for field in fields] or [np.zeros(0, dtype=np.int64)] * 3
            clock = _Clock(newest, offset, *columns)
            for each in others:
                self._add_other(each, clock)
        self.held_bytes += sum(each.messages.total for each in arrived)
        if newest is None and self._newest is not None:
            self._date(self._first)

    def release(self) -> Dated | None:
        """Return what is old enough that nothing older can be expected, if there is any."""
        newest = self._newest
        if newest is None:
            return self.release_all() if self._by_reception else None
        if newest < self._next_release:
            return None
        self._next_release = newest + _HOLD_NS // 2
        return self._cut(newest - _HOLD_NS)

    def release_all(self) -> Dated | None:
        """Return all that is held, if there is any."""
        self._date(self._newest)
        return self._cut(None)

    def _cut(self, last: int | None) -> Dated | None:
        """Return what is dated up to `last`, in order, and hold the rest."""
        if not self._held:
            return None
        log_ns, topic, messages = zip(*self._held, strict=True)
        held = Dated(np.concatenate(log_ns), np.concatenate(topic), MessageBatch.join(messages))
        order = np.lexsort((held.topic, held.log_ns))  # stable: the rest is in order of arrival
        end = len(order) if last is None else int(np.searchsorted(held.log_ns[order], last, side="right"))
        released, rest = held.take(order[:end]), held.take(order[end:])
        self._held = [rest] if len(rest.log_ns) else []
        self.held_bytes -= released.messages.total
        return released if end else None

    def _gives_time(self, arrived: Arrived) -> bool:
        """Return whether the messages of a topic that has the time are stamped by the clock of this log."""
        topic, newest = arrived.topic, self.newest_ns
        if topic in self._stamps or topic in self.other_clock or newest is None or not len(arrived.messages):
            return topic not in self.other_clock
        return abs(int(arrived.messages.stamps_ns()[0]) - newest) < OTHER_CLOCK_NS

    def _hold(self, topic: int, log_ns: Int64Array, messages: MessageBatch) -> None:
        if len(messages):
            self._held.append(Dated(log_ns, np.full(len(messages), topic, dtype=np.int64), messages))

    def _add_other(self, arrived: Arrived, clock: _Clock) -> None:
        """Take messages of a topic that does not give the time."""
        topic, source, messages, received_ns = arrived
        stamps = _stamps_ns(messages, source)
        log_ns = clock.date(stamps, received_ns)
        dated = log_ns != _UNKNOWN
        if self._newest is None and self._by_reception:
            log_ns = self._since_start(stamps, received_ns)
            dated[:] = True
        self._note_other_clock(topic, stamps[dated], log_ns[dated])
        if dated.all():
            self._hold(topic, log_ns, messages)
            return
        self._hold(topic, log_ns[dated], messages.take(np.flatnonzero(dated)))
        undated = np.flatnonzero(~dated)
        self._undated.append(Arrived(topic, source, messages.take(undated), received_ns[undated]))
        self._undated_bytes += self._undated[-1].messages.total
        if self._undated_bytes > _MAX_UNDATED_BYTES:
            self._date(None)

    def _add_clock(self, arrived: Arrived) -> tuple[Int64Array, Int64Array]:
        """Take messages of a topic that gives the time, from one set-back to the next; return stamps and log times."""
        topic, _, messages, _ = arrived
        stamps = messages.stamps_ns()
        log_ns = np.empty_like(stamps)
        begin = 0
        for end in [*(np.flatnonzero(np.diff(stamps) < 0) + 1).tolist(), len(stamps)]:
            if end > begin:
                offset = self._offset(topic, int(stamps[begin]), int(stamps[end - 1]))
                log_ns[begin:end] = stamps[begin:end] + offset
                self._advance(int(log_ns[begin]), int(log_ns[end - 1]))
            begin = end
        self._hold(topic, log_ns, messages)
        return stamps, log_ns

    def _offset(self, topic: int, first: int, last: int) -> int:
        """Return log time less stamp; topics go back one after the other, each with its own next message."""
        before = self._stamps.get(topic)
        self._stamps[topic] = last
        if before is None:
            self._epochs[topic] = len(self._offsets) - 1
        elif first < before:
            self._epochs[topic] += 1
            if self._epochs[topic] == len(self._offsets):
                newest = self._newest or 0
                self.set_backs.append((newest - self._offsets[-1], first))
                self._offsets.append(newest + 1 - first)
        return self._offsets[self._epochs[topic]]

    def _advance(self, first: int, last: int) -> None:
        if self._newest is None:
            self._first = self._newest = self._next_release = first
        self._newest = max(self._newest, last)

    def _date(self, log_ns: int | None) -> None:
        """Date what is undated, by its time of reception when `log_ns` is None."""
        undated, self._undated, self._undated_bytes = self._undated, [], 0
        for topic, source, messages, received_ns in undated:
            stamps = _stamps_ns(messages, source)
            if log_ns is None:
                found = self._since_start(stamps, received_ns)
            else:
                newest = np.full(len(messages), log_ns)
                found = np.where(_same_clock(stamps, stamps, newest), stamps, newest)
            self._note_other_clock(topic, stamps, found)
            self._hold(topic, found, messages)

    def _since_start(self, stamps: Int64Array, received_ns: Int64Array) -> Int64Array:
        """Return log times where no topic gives the time: stamps, and receptions by the clock of the first message."""
        if self._started is None and len(stamps):
            self._started = int(stamps[0]) or int(received_ns[0]), int(received_ns[0])
        begin, reception = self._started or (0, 0)
        log_ns = begin + received_ns - reception
        return np.where(_same_clock(stamps, stamps, log_ns), stamps, log_ns)

    def _note_other_clock(self, topic: int, stamps: Int64Array, log_ns: Int64Array) -> None:
        """Count the stamps that were not taken because they are of another clock."""
        count = int(((stamps > 0) & (np.abs(stamps + self._offsets[-1] - log_ns) >= OTHER_CLOCK_NS)).sum())
        if count:
            self.other_clock[topic] += count


def _same_clock(stamps: Int64Array, log_ns: Int64Array, newest: Int64Array) -> NDArray[np.bool_]:
    """Return whether there are stamps, and their log times of the clock that tells the newest one."""
    same: NDArray[np.bool_] = (stamps > 0) & (newest != _UNKNOWN) & (np.abs(log_ns - newest) < OTHER_CLOCK_NS)
    return same


def _stamps_ns(messages: MessageBatch, source: TimeSource) -> Int64Array:
    """Return the stamps of messages that do not give the time, ns, int64 (n,); 0 where there is none."""
    if source in (TimeSource.STAMP, TimeSource.CLOCK):
        return messages.stamps_ns()
    stamps = np.zeros(len(messages), dtype=np.int64)
    if source is TimeSource.LIST:
        for i, message in enumerate(messages):
            if any(message[_COUNT]):
                stamps[i] = max(0, cdr_stamp_ns(message[: _COUNT.start] + message[_COUNT.stop :]))
    return stamps
