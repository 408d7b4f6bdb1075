"""Determine log time and order of recorded messages from simulated time alone.

The order in which messages of different topics arrive depends on the load of the machine. They are held for a moment
and sorted by their stamps, so that equal runs make equal bags. They are held for a time in simulated time, by which
topics differ, and for a time of the wall clock, within which the middleware repeats lost messages: a run may be faster
than real time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array
from rx90_common.base.arrays import Index
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr_stamps import ENCAPSULATION, STAMP_BYTES, cdr_stamps_ns

_HOLD_NS = 500_000_000  # of simulated time; far above the differences between topics
# of the wall clock; a lost message delays its topic by several heartbeats
_RESEND_NS = 1_000_000_000
_OTHER_CLOCK_NS = 86_400 * NANOSECONDS
"""A stamp this far from the newest one belongs to another clock: wall-clock time among simulated times, for example."""

HEADER_STAMP = ENCAPSULATION
"""Where messages that begin with a stamp have it."""
LIST_STAMP = ENCAPSULATION + 4
"""Where a list of messages, behind its length, has that of the first one."""


class Source(NamedTuple):
    """Where the messages of a topic have their log time from.

    Attributes:
        topic: its place among the topics, by which messages of the same time are ordered.
        stamp_at: the place of the stamp in a message; None if there is none.
        gives_time: whether its stamps are the times of the messages of other topics that have none.
        latched: whether a publisher keeps its message for those who come late.
    """

    topic: int
    stamp_at: int | None = None
    gives_time: bool = False
    latched: bool = False


class Arrived(NamedTuple):
    """n messages of a topic, in the order of arrival; wall-clock times of reception, ns, int64 (n,)."""

    source: Source
    messages: list[bytes]
    received_ns: Int64Array


class Dated(NamedTuple):
    """n messages: log times, ns, int64 (n,), the places of their topics, int64 (n,), and bytes, (n,)."""

    log_ns: Int64Array
    topic: Int64Array
    messages: NDArray[Any]

    def take(self, rows: Index) -> Dated:
        """Return the messages of these rows."""
        return Dated(*(column[rows] for column in self))


class LogOrder:
    """Assigns log times to messages and releases them in the order of log time, then of their topics, then of arrival.

    Messages with a stamp get that one, others the newest one of a topic that gives the time. So do messages of topics
    that do not give the time whose stamp is of another clock. Messages before the first one that gives the time get
    that one's, and so do latched ones without a stamp as long as nothing has been released. Without a topic that gives
    the time, log time is that of reception.

    Log time never goes back, because a reader, which sorts by it, would mix two runs: if stamps go back, after a reset
    of the simulation, log time continues from its last value, and is ahead of them from then on.

    Attributes:
        set_backs: for each time that the stamps went back, the last one before and the first one after, ns; whoever
            reports them takes them out.
        held_bytes: bytes of the messages that are held.
    """

    def __init__(self) -> None:
        self.set_backs: list[tuple[int, int]] = []
        self.held_bytes = 0
        # Times of reception and log times of the newest messages, of a topic, that give the time.
        self._clock: tuple[Int64Array, Int64Array] | None = None
        self._first = 0  # log time
        self._newest = 0  # log time
        self._stamps: dict[int, int] = {}  # newest of each topic that gives the time
        self._ahead: dict[int, int] = {}  # of each of these: log time less stamp
        self._newest_ahead = 0  # of the topics that have gone back most often
        self._by_reception = False
        self._held: list[Dated] = []
        self._undated: list[Arrived] = []
        self._next_release_ns = 0  # as `now_ns` of `release`
        self._come = -1  # newest log time at the last call of `release`: messages up to it have come by the next one
        self._released = -1  # log time up to which messages have been released

    def date_by_reception(self) -> None:
        """Use the times of reception from now on, if no topic has given the time."""
        self._by_reception = self._clock is None

    def add(self, arrived: Sequence[Arrived]) -> None:
        """Take the messages that have arrived since the last call."""
        round_clock = None
        for batch in (batch for batch in arrived if batch.messages):
            self.held_bytes += sum(map(len, batch.messages))
            if batch.source.gives_time and not self._by_reception:
                log_ns = self._by_stamps(batch)
                round_clock = round_clock or (batch.received_ns, log_ns)
                self._hold(batch, log_ns)
            else:
                self._undated.append(batch)
        self._clock = round_clock or self._clock
        if self._by_reception or self._clock is not None:
            for batch in self._undated:
                self._hold(batch, self._by_clock(batch))
            self._undated = []

    def release(self, now_ns: int) -> Dated | None:
        """Return the messages that are old enough that no older ones are expected, if there are any.

        Args:
            now_ns: time of a clock that is never set, ns.
        """
        if self._by_reception:
            return self.release_all()
        if self._clock is None or now_ns < self._next_release_ns:
            return None
        self._released = min(self._come, self._newest - _HOLD_NS)
        self._come = self._newest
        self._next_release_ns = now_ns + _RESEND_NS
        return self._cut(self._released)

    def release_all(self) -> Dated | None:
        """Return all that is held, if there is any."""
        self.date_by_reception()
        self.add([])
        return self._cut(np.iinfo(np.int64).max)

    def _cut(self, last: int) -> Dated | None:
        """Return the messages with log times up to `last`, in order, and hold the others."""
        if not self._held:
            return None
        held = Dated(*map(np.concatenate, zip(*self._held, strict=True)))
        order = np.lexsort((held.topic, held.log_ns))  # stable: the rest is in order of arrival
        end = int(np.searchsorted(held.log_ns[order], last, side="right"))
        released = held.take(order[:end])
        self._held = [held.take(order[end:])]
        self.held_bytes -= sum(map(len, released.messages))
        return released if end else None

    def _hold(self, batch: Arrived, log_ns: Int64Array) -> None:
        topic = np.full_like(log_ns, batch.source.topic)
        self._held.append(Dated(log_ns, topic, np.array(batch.messages, dtype=object)))

    def _by_stamps(self, batch: Arrived) -> Int64Array:
        """Return log times of messages of a topic that gives the time, and go on by them."""
        topic = batch.source.topic
        stamps = stamps_ns(batch.messages, batch.source.stamp_at)
        if not self._stamps:
            self._first = self._newest = int(stamps[0])
        log_ns = np.empty_like(stamps)
        set_backs = np.flatnonzero(np.diff(stamps) < 0) + 1
        for rows in np.split(np.arange(len(stamps)), set_backs):
            first = int(stamps[rows[0]])
            if first < self._stamps.get(topic, first):
                # other topics follow, each with its own next message
                if self._ahead[topic] == self._newest_ahead:
                    self.set_backs.append((self._newest - self._newest_ahead, first))
                    self._newest_ahead = self._newest + 1 - first
                self._ahead[topic] = self._newest_ahead
            self._stamps[topic] = int(stamps[rows[-1]])
            log_ns[rows] = stamps[rows] + self._ahead.setdefault(topic, self._newest_ahead)
            self._newest = max(self._newest, int(log_ns[rows[-1]]))
        return log_ns

    def _by_clock(self, batch: Arrived) -> Int64Array:
        """Return log times of messages that do not give the time: their stamps, or the newest time at reception."""
        if self._clock is None:
            return batch.received_ns
        received_ns, log_ns = self._clock
        newest = log_ns[np.maximum(np.searchsorted(received_ns, batch.received_ns) - 1, 0)]
        if batch.source.latched and self._released < 0:
            newest = np.full_like(newest, self._first)
        stamps = stamps_ns(batch.messages, batch.source.stamp_at)
        by_stamp = stamps + self._newest_ahead
        return np.where(
            (stamps > 0) & (np.abs(by_stamp - newest) < _OTHER_CLOCK_NS), by_stamp, newest
        )


def stamps_ns(messages: Sequence[bytes], stamp_at: int | None) -> Int64Array:
    """Return the stamps of n messages, ns, int64 (n,); 0 where there is none, or one before 0."""
    if stamp_at is None:
        return np.zeros(len(messages), dtype=np.int64)
    end = stamp_at + STAMP_BYTES
    heads = b"".join([message[:end].ljust(end, b"\0") for message in messages])
    block = np.frombuffer(heads, np.uint8).reshape(-1, end)
    return np.maximum(0, cdr_stamps_ns(block[:, stamp_at - ENCAPSULATION :]))
