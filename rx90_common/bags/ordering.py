"""Give recorded messages their log time and their order, both of simulated time alone.

In which order messages of different topics arrive depends on the load of the machine. They are held back for a moment
and sorted by their stamps, so that equal runs make equal bags.
"""

from __future__ import annotations

from bisect import bisect_right
from enum import Enum, auto
from typing import NamedTuple

from rx90_common.base.stamps import cdr_stamp_ns

_HOLD_NS = 500_000_000  # of simulated time; far above what topics run apart
_MAX_UNDATED_BYTES = 16 << 20


class TimeSource(Enum):
    """Where the messages of a topic have their log time from."""

    CLOCK = auto()
    """Their stamp, which is the sample time, and the time of messages that have none."""
    STAMP = auto()
    """Their stamp; where that is 0 ("now"), the newest one of a clock topic."""
    NEWEST = auto()
    """The newest stamp of a clock topic, as they have none."""


class Entry(NamedTuple):
    """A message with its log time in ns; sorts by time, topic, arrival."""

    log_ns: int
    topic: int
    arrival: int
    cdr: bytes


class _Undated(NamedTuple):
    topic: int
    arrival: int
    cdr: bytes
    received_ns: int


class LogOrder:
    """Dates messages and releases them in the order of log time.

    Messages without a stamp that come before the first one with a stamp get that first stamp. Where no topic
    gives the time, log time is the wall clock's time of reception.

    Log time never goes back, or a reader, which sorts by it, would mix two runs. Where stamps go back, after a reset of
    the simulation, log time goes on from where it was, and runs ahead of the stamps from then on.

    Attributes:
        set_backs: for each time that the stamps went back, the newest one before and the first one after, ns.
    """

    def __init__(self) -> None:
        self._by_reception = False
        self._newest: int | None = None
        self._stamps: dict[int, int] = {}  # newest of each clock topic
        self._epochs: dict[int, int] = {}  # of each clock topic: how often its stamps went back
        self._offsets = [0]  # log time less stamp, for each epoch
        self.set_backs: list[tuple[int, int]] = []
        self._arrivals = 0
        self._entries: list[Entry] = []
        self._undated: list[_Undated] = []
        self._undated_bytes = 0
        self._next_release = 0
        self.held_bytes = 0

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp seen, None before the first."""
        return None if self._newest is None else self._newest - self._offsets[-1]

    def expect_no_clock(self) -> None:
        """Date by reception: none of the topics will give the time."""
        self._by_reception = True

    def add(self, topic: int, source: TimeSource, cdr: bytes, received_ns: int) -> None:
        """Take a message; `received_ns` is the wall clock's time of reception."""
        self._arrivals += 1
        self.held_bytes += len(cdr)
        log_ns = self._newest
        if source is not TimeSource.NEWEST:
            stamp = max(0, cdr_stamp_ns(cdr))
            if source is TimeSource.CLOCK:
                log_ns = stamp + self._offset(topic, stamp)
                self._advance(log_ns)
            elif stamp:
                log_ns = stamp + self._offsets[-1]
        if log_ns is None and self._by_reception:
            log_ns = received_ns
        if log_ns is None:
            self._undated.append(_Undated(topic, self._arrivals, cdr, received_ns))
            self._undated_bytes += len(cdr)
            if self._undated_bytes > _MAX_UNDATED_BYTES:
                self._date(None)
        else:
            self._entries.append(Entry(log_ns, topic, self._arrivals, cdr))

    def release(self) -> list[Entry]:
        """Return what is old enough that nothing older can be expected."""
        newest = self._newest
        if newest is None:
            return self.release_all() if self._by_reception else []
        if newest < self._next_release:
            return []
        self._next_release = newest + _HOLD_NS // 2
        self._entries.sort()
        end = bisect_right(self._entries, newest - _HOLD_NS, key=lambda entry: entry.log_ns)
        return self._cut(end)

    def release_all(self) -> list[Entry]:
        """Return all that is held."""
        self._date(self._newest)
        self._entries.sort()
        return self._cut(len(self._entries))

    def _cut(self, end: int) -> list[Entry]:
        released, self._entries = self._entries[:end], self._entries[end:]
        self.held_bytes -= sum(len(entry.cdr) for entry in released)
        return released

    def _offset(self, topic: int, stamp: int) -> int:
        """Return log time less stamp; topics go back one after the other, each with its own next message."""
        before = self._stamps.get(topic)
        self._stamps[topic] = stamp
        if before is None:
            self._epochs[topic] = len(self._offsets) - 1
        elif stamp < before:
            self._epochs[topic] += 1
            if self._epochs[topic] == len(self._offsets):
                newest = self._newest or 0
                self.set_backs.append((newest - self._offsets[-1], stamp))
                self._offsets.append(newest + 1 - stamp)
        return self._offsets[self._epochs[topic]]

    def _advance(self, log_ns: int) -> None:
        newest = self._newest
        if newest is None:
            self._newest = self._next_release = log_ns
            self._date(log_ns)
        elif log_ns > newest:
            self._newest = log_ns

    def _date(self, log_ns: int | None) -> None:
        """Date what is undated, by its time of reception when `log_ns` is None."""
        undated, self._undated, self._undated_bytes = self._undated, [], 0
        for topic, arrival, cdr, received_ns in undated:
            self._entries.append(Entry(received_ns if log_ns is None else log_ns, topic, arrival, cdr))
