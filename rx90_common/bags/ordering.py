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

from rx90_common.bags.batch import Int64Array, MessageBatch
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION, cdr_stamp_ns

_HOLD_NS = 500_000_000  # of simulated time; far above what topics run apart
_MAX_UNDATED_BYTES = 16 << 20
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
    """Simulated time, as the stamps of one clock tell it: log times, of which none goes back.

    Where stamps go back, after a reset of the simulation, log time goes on from where it was, and is ahead of them from
    then on.

    Attributes:
        newest: the newest log time, ns, None before the first.
        set_backs: as in `LogOrder`.
    """

    def __init__(self) -> None:
        self.newest: int | None = None
        self.set_backs: list[tuple[int, int]] = []
        self._stamps: dict[int, int] = {}  # newest of each topic
        self._epochs: dict[int, int] = {}  # of each topic: how often its stamps went back
        self._offsets = [0]  # log time less stamp, for each epoch
        self._known: list[Int64Array] = []  # (3, m): times of reception, log times then, by how much these were ahead

    @property
    def newest_stamp(self) -> int | None:
        """Return the newest stamp, ns, None before the first."""
        return None if self.newest is None else self.newest - self._offsets[-1]

    def forget(self) -> None:
        """Let `at` begin with the time as it is now."""
        self._known = [] if self.newest is None else [self._since_ever(self.newest)]

    def take(self, arrived: Arrived) -> Int64Array | None:
        """Go on by messages of a topic; return their log times, int64 (n,), None if they are of another clock."""
        topic, _, messages, received_ns = arrived
        stamps = messages.stamps_ns()
        newest = self.newest_stamp
        if topic not in self._stamps and newest is not None and abs(int(stamps[0]) - newest) >= OTHER_CLOCK_NS:
            return None
        if newest is None:
            self._known = [self._since_ever(int(stamps[0]))]
        offsets = np.empty_like(stamps)
        ends = [*(np.flatnonzero(np.diff(stamps) < 0) + 1).tolist(), len(stamps)]
        for begin, end in zip([0, *ends[:-1]], ends, strict=True):  # from one set-back to the next
            offset = self._offset(topic, int(stamps[begin]), int(stamps[end - 1]))
            self.newest = max(self.newest or 0, int(stamps[end - 1]) + offset)
            offsets[begin:end] = offset
        self._known.append(np.stack([received_ns, stamps + offsets, offsets]))
        return stamps + offsets

    def at(self, received_ns: Int64Array) -> tuple[Int64Array, Int64Array]:
        """Return the newest log times before times of reception, and by how much they were ahead of the stamps."""
        known = np.concatenate(self._known, axis=1)
        known = known[:, np.argsort(known[0], kind="stable")]
        at = np.searchsorted(known[0], received_ns) - 1
        return np.maximum.accumulate(known[1])[at], np.maximum.accumulate(known[2])[at]

    def _since_ever(self, log_ns: int) -> Int64Array:
        return np.array([[np.iinfo(np.int64).min], [log_ns], [self._offsets[-1]]])

    def _offset(self, topic: int, first: int, last: int) -> int:
        """Return log time less stamp; topics go back one after the other, each with its own next message."""
        before = self._stamps.get(topic)
        self._stamps[topic] = last
        if before is None:
            self._epochs[topic] = len(self._offsets) - 1
        elif first < before:
            self._epochs[topic] += 1
            if self._epochs[topic] == len(self._offsets):
                newest = self.newest or 0
                self.set_backs.append((newest - self._offsets[-1], first))
                self._offsets.append(newest + 1 - first)
        return self._offsets[self._epochs[topic]]


class LogOrder:
    """Dates messages and releases them in the order of log time, then of their topics, then of arrival.

    All log times are of one clock: that of the first topic that gives the time. Messages with stamps of another clock
    are dated by their reception, as messages without a stamp are. Those that come before the first one that gives the
    time get that one's. Where no topic gives the time, it is the clock of the first stamp, or the wall clock's time of
    reception. Log time never goes back, or a reader, which sorts by it, would mix two runs.

    Attributes:
        set_backs: for each time that the stamps went back, the newest one before and the first one after, ns.
        held_bytes: bytes of the messages that are held.
        other_clock: number of messages of each topic whose stamps are of another clock.
    """

    def __init__(self) -> None:
        self._clock = _Clock()
        self._by_reception = False
        self._ahead: int | None = None  # of the wall clock, where no topic gives the time
        self._held: list[Dated] = []
        self._undated: list[Arrived] = []
        self._next_release = 0
        self.set_backs = self._clock.set_backs
        self.held_bytes = 0
        self.other_clock: Counter[int] = Counter()

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp seen, None before the first."""
        return self._clock.newest_stamp

    def expect_no_clock(self) -> None:
        """Date by reception: none of the topics will give the time."""
        self._by_reception = True

    def add(self, arrived: Sequence[Arrived]) -> None:
        """Take the messages that have arrived since the last call."""
        self._clock.forget()
        for each in (each for each in arrived if len(each.messages)):
            self.held_bytes += each.messages.total
            gives_time = each.source is TimeSource.CLOCK and each.topic not in self.other_clock
            log_ns = self._clock.take(each) if gives_time else None
            if log_ns is None:
                self._undated.append(each)
            else:
                self._hold(each, log_ns)
        undated_bytes = sum(each.messages.total for each in self._undated)
        if self._clock.newest is not None or self._by_reception or undated_bytes > _MAX_UNDATED_BYTES:
            self._date()

    def release(self) -> Dated | None:
        """Return what is old enough that nothing older can be expected, if there is any."""
        newest = self._clock.newest
        if newest is None:
            return self.release_all() if self._by_reception else None
        if newest < self._next_release:
            return None
        self._next_release = newest + _HOLD_NS // 2
        return self._cut(newest - _HOLD_NS)

    def release_all(self) -> Dated | None:
        """Return all that is held, if there is any."""
        self._date()
        return self._cut(None)

    def _cut(self, last: int | None) -> Dated | None:
        """Return what is dated up to `last`, in order, and hold the rest."""
        if not self._held:
            return None
        log_ns, topic, messages = zip(*self._held, strict=True)
        held = Dated(np.concatenate(log_ns), np.concatenate(topic), MessageBatch.join(messages))
        order = np.lexsort((held.topic, held.log_ns))  # stable: the rest is in order of arrival
        end = len(order) if last is None else int(np.searchsorted(held.log_ns[order], last, side="right"))
        released, rest = order[:end], order[end:]
        # A copy, or what is released stays in memory with the rest.
        kept = Dated(held.log_ns[rest], held.topic[rest], held.messages.take(rest).copy())
        self._held = [kept] if len(rest) else []
        self.held_bytes = kept.messages.total
        return Dated(held.log_ns[released], held.topic[released], held.messages.take(released)) if end else None

    def _hold(self, arrived: Arrived, log_ns: Int64Array) -> None:
        topics = np.full(len(log_ns), arrived.topic, dtype=np.int64)
        self._held.append(Dated(log_ns, topics, arrived.messages))

    def _date(self) -> None:
        """Date what is undated: by its stamps, where they are of the clock of this log, else by its reception."""
        undated, self._undated = self._undated, []
        for each in undated:
            stamps = _stamps_ns(each.messages, each.source)
            now, ahead = self._at(each.received_ns, stamps)
            stamped = stamps > 0
            other = stamped & (np.abs(stamps + ahead - now) >= OTHER_CLOCK_NS)
            if other.any():
                self.other_clock[each.topic] += int(other.sum())
            self._hold(each, np.where(stamped & ~other, stamps + ahead, now))

    def _at(self, received_ns: Int64Array, stamps: Int64Array) -> tuple[Int64Array, Int64Array]:
        """Return the log time at each time of reception, and by how much it is ahead of stamps of the same clock."""
        if self._clock.newest is not None:
            return self._clock.at(received_ns)
        if self._ahead is None:
            self._ahead = int(stamps[0] - received_ns[0]) if stamps[0] else 0
        return received_ns + self._ahead, np.zeros_like(stamps)


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
