"""Determine log time and order of recorded messages from simulated time alone.

The order in which messages of different topics arrive depends on the load of the machine. They are held for a moment
and sorted by their stamps, so that equal runs make equal bags. They are held for a time in simulated time, by which
topics differ, and for a time of the wall clock, within which the middleware repeats lost messages: a run may be faster
than real time.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from enum import Enum, auto
from typing import Final, NamedTuple

import numpy as np

from rx90_common.bags.joint_series import Int64Array
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr_stamps import ENCAPSULATION, HEAD, cdr_stamp_ns

_HOLD_NS = 500_000_000  # of simulated time; far above the differences between topics
_RESEND_NS = 1_000_000_000  # of the wall clock; a lost message delays its topic by several heartbeats
_MAX_UNDATED_BYTES = 16 << 20
OTHER_CLOCK_NS: Final = 86_400 * NANOSECONDS
"""A stamp this far from the newest one belongs to another clock: wall-clock time among simulated times, for example."""
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
    """n messages: log times, ns, int64 (n,), indices of their topics, int64 (n,), and the received bytes."""

    log_ns: Int64Array
    topic: Int64Array
    messages: list[bytes]


class Arrived(NamedTuple):
    """n messages of the topic with this index, in the order of arrival.

    `source` is the source of their log time; `received_ns` are the wall clock's times of reception, int64 (n,), and
    `sent_ns`, of latched messages, those of sending by the publisher's wall clock.
    """

    topic: int
    source: TimeSource
    messages: list[bytes]
    received_ns: Int64Array
    sent_ns: Int64Array | None = None

    @property
    def total(self) -> int:
        """Return the bytes of all messages."""
        return sum(map(len, self.messages))


class LogOrder:
    """Assigns log times to messages and releases them in the order of log time, then of their topics, then of arrival.

    All log times are of one clock: that of the first topic that defines the time. Messages with stamps of another clock
    get their time of reception, as messages without a stamp do. Messages before the first one that defines the
    time get that one's. So do latched ones without a stamp that were sent before it and arrive after it, as long as
    nothing has been released. If no topic defines the time, it is the clock of the first stamp, or the wall clock's
    time of reception.

    Log time never goes back, because a reader, which sorts by it, would mix two runs: if stamps go back, after a reset
    of the simulation, log time continues from its last value, and is ahead of them from then on.

    Attributes:
        set_backs: for each time that the stamps went back, the last one before and the first one after, ns.
        held_bytes: bytes of the messages that are held.
        other_clock: number of messages of each topic whose stamps are of another clock.
    """

    def __init__(self) -> None:
        self.set_backs: list[tuple[int, int]] = []
        self.held_bytes = 0
        self.other_clock: Counter[int] = Counter()
        self._newest: int | None = None  # log time
        self._first: tuple[int, int] | None = None  # reception and stamp of the first message that gives the time
        self._stamps: dict[int, int] = {}  # newest of each topic that gives the time
        self._epochs: dict[int, int] = {}  # of each of these: how often its stamps went back
        self._offsets = [0]  # log time less stamp, for each epoch
        # Of the messages of a call of `add` that give the time: reception, log time and its lead on the stamp, (3, n).
        self._known: list[Int64Array] = []
        self._by_reception = False
        self._ahead: int | None = None  # of the wall clock, where no topic gives the time
        self._held: list[Dated] = []
        self._undated: list[Arrived] = []
        self._next_cut = 0  # as `now_ns` of `release`
        # Times of `release` and the newest log time then, ns: those of the last second and the one before them.
        self._progress: deque[tuple[int, int]] = deque()

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp so far, None before the first."""
        return None if self._newest is None else self._newest - self._offsets[-1]

    def expect_no_clock(self) -> None:
        """Date by reception: none of the topics will give the time."""
        self._by_reception = True

    def add(self, arrived: Sequence[Arrived]) -> None:
        """Take the messages that have arrived since the last call."""
        self._known = [] if self._newest is None else [self._since_ever(self._newest)]
        for batch in (batch for batch in arrived if batch.messages):
            self.held_bytes += batch.total
            gives_time = batch.source is TimeSource.CLOCK and batch.topic not in self.other_clock
            if not (gives_time and self._date_by_stamps(batch)):
                self._undated.append(batch)
        undated_bytes = sum(batch.total for batch in self._undated)
        if self._newest is not None or self._by_reception or undated_bytes > _MAX_UNDATED_BYTES:
            self._date_others()

    def release(self, now_ns: int) -> Dated | None:
        """Return the messages that are old enough that no older ones are expected.

        Args:
            now_ns: time of a clock that is never set, ns.
        """
        if self._newest is None:
            return self.release_all() if self._by_reception else None
        progress = self._progress
        progress.append((now_ns, self._newest))
        while len(progress) > 1 and progress[1][0] <= now_ns - _RESEND_NS:
            progress.popleft()
        before, newest_then = progress[0]
        if before > now_ns - _RESEND_NS or now_ns < self._next_cut:
            return None
        self._next_cut = now_ns + _RESEND_NS // 2  # each cut copies what stays
        return self._cut(min(newest_then, self._newest - _HOLD_NS))

    def release_all(self) -> Dated | None:
        """Return all that is held, if there is any."""
        self._date_others()
        return self._cut(None)

    def _cut(self, last: int | None) -> Dated | None:
        """Return the messages with log times up to `last`, in order, and hold the others."""
        if not self._held:
            return None
        log_ns = np.concatenate([held.log_ns for held in self._held])
        topic = np.concatenate([held.topic for held in self._held])
        messages = [message for held in self._held for message in held.messages]
        order = np.lexsort((topic, log_ns))  # stable: the rest is in order of arrival
        end = len(order) if last is None else int(np.searchsorted(log_ns[order], last, side="right"))
        released, kept = (
            Dated(log_ns[rows], topic[rows], [messages[row] for row in rows.tolist()])
            for rows in (order[:end], order[end:])
        )
        self._held = [kept] if kept.messages else []
        self.held_bytes = sum(map(len, kept.messages))
        return released if end else None

    def _hold(self, arrived: Arrived, log_ns: Int64Array) -> None:
        self._held.append(Dated(log_ns, np.full(len(log_ns), arrived.topic, dtype=np.int64), arrived.messages))

    def _since_ever(self, log_ns: int) -> Int64Array:
        return np.array([[np.iinfo(np.int64).min], [log_ns], [self._offsets[-1]]])

    def _date_by_stamps(self, arrived: Arrived) -> bool:
        """Date messages that give the time, and go on by them; return False if they are of another clock."""
        topic = arrived.topic
        stamps = head_stamps_ns(arrived.messages)
        newest = self.newest_ns
        if topic not in self._stamps and newest is not None and abs(int(stamps[0]) - newest) >= OTHER_CLOCK_NS:
            return False
        if newest is None:
            self._first = int(arrived.received_ns[0]), int(stamps[0])
            self._known = [self._since_ever(int(stamps[0]))]
        offsets = np.empty_like(stamps)
        ends = [*(np.flatnonzero(np.diff(stamps) < 0) + 1).tolist(), len(stamps)]
        for begin, end in zip([0, *ends[:-1]], ends, strict=True):  # from one set-back to the next
            first = int(stamps[begin])
            last = int(stamps[end - 1])
            # Topics go back one after the other, each with its own next message.
            epoch = self._epochs.setdefault(topic, len(self._offsets) - 1)
            if first < self._stamps.get(topic, first):
                epoch = self._epochs[topic] = epoch + 1
                if epoch == len(self._offsets):
                    log_ns = self._newest or 0
                    self.set_backs.append((log_ns - self._offsets[-1], first))
                    self._offsets.append(log_ns + 1 - first)
            self._stamps[topic] = last
            offsets[begin:end] = self._offsets[epoch]
            self._newest = max(self._newest or 0, last + self._offsets[epoch])
        self._known.append(np.stack([arrived.received_ns, stamps + offsets, offsets]))
        self._hold(arrived, stamps + offsets)
        return True

    def _date_others(self) -> None:
        """Assign log times: from the stamps, if they are of the clock of this log, else from the reception."""
        undated = self._undated
        self._undated = []
        for batch in undated:
            stamps = _stamps_ns(batch.messages, batch.source)
            if self._newest is not None:
                # The newest log times before reception, and by how much they were ahead of the stamps.
                known = np.concatenate(self._known, axis=1)
                known = known[:, np.argsort(known[0], kind="stable")]
                at = np.searchsorted(known[0], batch.received_ns) - 1
                now, ahead = np.maximum.accumulate(known[1:], axis=1)[:, at]
                if batch.sent_ns is not None and self._first is not None and self._next_cut == 0:
                    began_ns, first = self._first
                    now = np.where((batch.sent_ns < began_ns) & (stamps == 0), first, now)
            else:
                if self._ahead is None:
                    self._ahead = int(stamps[0] - batch.received_ns[0]) if stamps[0] else 0
                now = batch.received_ns + self._ahead
                ahead = np.zeros_like(stamps)
            stamped = stamps > 0
            other = stamped & (np.abs(stamps + ahead - now) >= OTHER_CLOCK_NS)
            if other.any():
                self.other_clock[batch.topic] += int(other.sum())
            self._hold(batch, np.where(stamped & ~other, stamps + ahead, now))


def head_stamps_ns(messages: Sequence[bytes]) -> Int64Array:
    """Return the times at the heads of n messages, ns, int64 (n,); 0 before 0 and where a message is cut off."""
    heads = b"".join([message[:HEAD] if len(message) >= HEAD else bytes(HEAD) for message in messages])
    times = np.frombuffer(heads, np.uint8).reshape(-1, HEAD)
    little = times[:, 1:2] & 1 == 1
    times = np.ascontiguousarray(times[:, ENCAPSULATION:])
    seconds, nanoseconds = np.where(little, times.view("<u4"), times.view(">u4")).astype(np.int64).T
    return np.where(seconds < 1 << 31, seconds * NANOSECONDS + nanoseconds, 0)


def _stamps_ns(messages: Sequence[bytes], source: TimeSource) -> Int64Array:
    """Return the stamps of messages that do not give the time, ns, int64 (n,); 0 where there is none."""
    if source in (TimeSource.STAMP, TimeSource.CLOCK):
        return head_stamps_ns(messages)
    stamps = np.zeros(len(messages), dtype=np.int64)
    if source is TimeSource.LIST:
        for i, message in enumerate(messages):
            if any(message[_COUNT]):
                stamps[i] = max(0, cdr_stamp_ns(message[: _COUNT.start] + message[_COUNT.stop :]))
    return stamps
