"""Log time and order of recorded messages."""

from __future__ import annotations

from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rx90_common.bags.ordering import Arrived, Dated, LogOrder, TimeSource, head_stamps_ns
from rx90_common.exchange.cdr_stamps import cdr_stamp_ns

MS = 1_000_000
LIST_OF_ONE = b"\x00\x01\x00\x00\x01\x00\x00\x00"  # encapsulation and length


def message(stamp: int) -> bytes:
    """Return a CDR message that begins with a stamp."""
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    return b"\x00\x01\x00\x00" + seconds.to_bytes(4, "little") + nanoseconds.to_bytes(4, "little")


class Entry(NamedTuple):
    """A message that was released."""

    log_ns: int
    topic: int
    cdr: bytes


def entries(dated: Dated | None) -> list[Entry]:
    """Return what was released, message by message."""
    if dated is None:
        return []
    return [Entry(*each) for each in zip(dated.log_ns.tolist(), dated.topic.tolist(), dated.messages, strict=True)]


def add(order: LogOrder, topic: int, source: TimeSource, messages: list[bytes], received_ns: int = 0) -> None:
    """Pass messages on, received one nanosecond after the other."""
    order.add([Arrived(topic, source, messages, received_ns + np.arange(len(messages)))])


def run(order: LogOrder, arrivals: list[tuple[int, TimeSource, bytes]], every: int = 7) -> list[Entry]:
    """Pass messages through and return all that is released; those of a topic that come in a row, as one batch."""
    released: list[Entry] = []
    for i in range(0, len(arrivals), every):
        received_ns = 10**18 + i
        for (topic, source), batch in groupby(arrivals[i : i + every], key=lambda arrival: arrival[:2]):
            messages = [cdr for _, _, cdr in batch]
            add(order, topic, source, messages, received_ns)
            received_ns += len(messages)
        released += entries(order.release(received_ns))
    return released + entries(order.release_all())


@given(st.lists(st.binary(max_size=20)))
def test_stamps_of_many_messages_are_those_of_each(messages: list[bytes]) -> None:
    """Of messages of any length, also 0; those before 0 and of a message that is cut off are 0."""
    # cdr_stamp_ns looks at the last bit of the second byte alone, too, and leaves negative times to its caller.
    assert head_stamps_ns(messages).tolist() == [max(0, cdr_stamp_ns(message)) for message in messages]


@settings(max_examples=40)
@given(st.data())
def test_order_does_not_depend_on_the_interleaving(data: Any) -> None:
    """However three topics arrive interleaved within 0.4 s, they are released sorted by stamp, then topic."""
    sent = [(stamp * MS, topic) for stamp in range(0, 3000, 50) for topic in range(3)]
    delays = data.draw(st.lists(st.integers(0, 400), min_size=3, max_size=3))
    arrivals = sorted(sent, key=lambda m: m[0] + delays[m[1]] * MS)
    released = run(LogOrder(), [(t, TimeSource.CLOCK, message(s)) for s, t in arrivals], data.draw(st.integers(1, 50)))
    assert [(e.log_ns, e.topic) for e in released] == sent


def test_a_latched_message_sent_before_the_clock_began_has_the_first_time() -> None:
    """It may arrive late, unless messages have been released; one that is sent later has the time of its reception."""

    def latched(topic: int, text: bytes, sent: int, received: int) -> None:
        order.add([Arrived(topic, TimeSource.NEWEST, [text], *np.array([[received], [sent]]) * MS)])

    order = LogOrder()
    for stamp in range(0, 1000, 50):
        add(order, 0, TimeSource.CLOCK, [message(stamp * MS)], (5000 + stamp) * MS)
    latched(1, b"sent before", 4990, 6000)
    latched(2, b"sent later", 5500, 6000)
    assert not entries(order.release(7000 * MS))
    released = entries(order.release(8000 * MS))
    latched(1, b"after a release", 4990, 8000)
    released += entries(order.release_all())
    assert [(e.log_ns, e.cdr) for e in released if e.topic] == [
        (0, b"sent before"),
        (950 * MS, b"after a release"),
        (950 * MS, b"sent later"),
    ]


def test_without_a_clock_latched_messages_are_dated_by_their_reception() -> None:
    """A description of a node that has run for hours does not make the bag begin hours ago."""
    order = LogOrder()
    order.expect_no_clock()
    add(order, 0, TimeSource.NEWEST, [b"first"], 9000 * MS)
    order.add([Arrived(1, TimeSource.NEWEST, [b"old"], *np.array([[9001], [1]]) * MS)])
    assert [(e.log_ns // MS, e.cdr) for e in entries(order.release(10**9))] == [(9000, b"first"), (9001, b"old")]


def test_a_topic_that_is_sent_again_late_is_in_its_place() -> None:
    """In a run ten times faster than real time a topic that is 0.8 s of the wall clock late is sorted in."""
    sent = [(stamp * MS, topic) for stamp in range(0, 20_000, 50) for topic in range(2)]
    order, released = LogOrder(), list[Entry]()
    for stamp, topic in sorted(sent, key=lambda each: each[0] // 10 + each[1] * 800 * MS):
        now = stamp // 10 + topic * 800 * MS
        add(order, topic, TimeSource.CLOCK, [message(stamp)], now)
        released += entries(order.release(now))
    before = len(released)
    released += entries(order.release(now + 1000 * MS))  # also where no more messages come
    assert 0 < before < len(released) < len(sent)
    released += entries(order.release_all())
    assert [(e.log_ns, e.topic) for e in released] == sent


def test_messages_without_stamp_get_the_newest() -> None:
    """Without a stamp of its own a message gets the newest one seen, or the first if it comes before that."""
    arrivals = [
        (9, TimeSource.NEWEST, b"early"),
        (0, TimeSource.CLOCK, message(5 * MS)),
        (0, TimeSource.CLOCK, message(6 * MS)),
        (9, TimeSource.NEWEST, b"later"),
        (8, TimeSource.STAMP, message(0)),
        (8, TimeSource.STAMP, message(50 * MS)),
        (0, TimeSource.CLOCK, message(7 * MS)),
    ]
    times = {e.cdr: e.log_ns for e in run(LogOrder(), arrivals) if e.topic > 0}
    assert times == {b"early": 5 * MS, b"later": 6 * MS, message(0): 6 * MS, message(50 * MS): 50 * MS}


def test_wall_clock_where_no_topic_gives_the_time() -> None:
    """Without a topic that gives the time, log time is that of reception, also when that is known late or never."""
    for known in (True, False):
        order = LogOrder()
        if known:
            order.expect_no_clock()
        released = run(order, [(0, TimeSource.NEWEST, bytes([i])) for i in range(5)])
        assert [e.log_ns for e in released] == [10**18 + i for i in range(5)]
    order = LogOrder()  # messages that wait for a first stamp are released before they fill the memory
    for i in range(40):
        add(order, 0, TimeSource.NEWEST, [bytes(1 << 20)], i + 1)
    assert {e.log_ns for e in entries(order.release_all())} == set(range(1, 41))


def test_time_that_is_set_back_holds_nothing_up() -> None:
    """After a reset of simulated time messages go on being released, a second after they came, and none is lost."""
    order = LogOrder()
    held = []
    stamps = [*range(0, 10_000, 10), *range(0, 5_000, 10)]
    released: list[Entry] = []
    for received, stamp in enumerate(stamps):
        add(order, 0, TimeSource.CLOCK, [message(stamp * MS)], received * 10 * MS)
        released += entries(order.release(received * 10 * MS))
        held.append(order.held_bytes)
    released += entries(order.release_all())
    assert len(released) == len(stamps)
    assert max(held) <= 12 * 160
    assert order.held_bytes == 0


def test_a_reset_is_reported_and_keeps_the_runs_apart() -> None:
    """Stamps that go back, in one topic after the other, leave both runs whole and one behind the other."""
    order = LogOrder()
    runs = [*range(0, 300, 10)], [*range(0, 200, 10)]
    for topic, stamp in [(0, s) for s in runs[0]] + [(1, s) for s in runs[0][:-3]]:
        add(order, topic, TimeSource.CLOCK, [message(stamp * MS)])
    add(order, 0, TimeSource.CLOCK, [message(0)])  # before the other topic's last messages of the first run
    for stamp in runs[0][-3:]:
        add(order, 1, TimeSource.CLOCK, [message(stamp * MS)])
    add(order, 1, TimeSource.CLOCK, [message(0)])
    for topic, stamp in [(t, s) for t in (0, 1) for s in runs[1][1:]]:
        add(order, topic, TimeSource.CLOCK, [message(stamp * MS)])
    released = entries(order.release_all())
    assert [e.log_ns for e in released] == sorted(e.log_ns for e in released)
    for topic in (0, 1):
        stamps = [cdr_stamp_ns(e.cdr) for e in released if e.topic == topic]
        assert stamps == [s * MS for run in runs for s in run]
    assert order.set_backs == [(290 * MS, 0)]
    assert order.newest_ns == 190 * MS


WALL = 1_700_000_000 * 1_000 * MS


def test_a_log_has_one_clock() -> None:
    """Stamps of another clock are dated by when they came, before the first sample too, whatever their topic is.

    Stamps of the log's own clock keep their times: an hour ahead, long past, and before the first sample.
    """
    arrivals = [
        (5, TimeSource.STAMP, message(WALL)),
        (6, TimeSource.STAMP, message(4 * MS)),
        (0, TimeSource.CLOCK, message(7 * MS)),
        (1, TimeSource.CLOCK, message(WALL + MS)),
        (0, TimeSource.CLOCK, message(8 * MS)),
        (5, TimeSource.STAMP, message(WALL + 2 * MS)),
        (7, TimeSource.LIST, LIST_OF_ONE + message(WALL + 3 * MS)[4:]),
        (6, TimeSource.STAMP, message(3_600_000 * MS)),
        (1, TimeSource.CLOCK, message(WALL + 4 * MS)),
        (0, TimeSource.CLOCK, message(9 * MS)),
        (0, TimeSource.CLOCK, message(0)),
        (5, TimeSource.STAMP, message(WALL + 5 * MS)),
    ]
    for every in (1, 4, 100):
        order = LogOrder()
        found: dict[int, list[float]] = {}
        for entry in run(order, arrivals, every):
            found.setdefault(entry.topic, []).append(entry.log_ns / MS)
        assert found[0] == [7, 8, 9, 9 + 1 / MS]
        assert found[6] == [4, 3_600_000]
        assert found[5] == [7, 8, 9 + 1 / MS]
        assert found[1] == [7, 8]
        assert found[7] == [8]
        assert order.other_clock == {5: 3, 1: 2, 7: 1}
        assert len(order.set_backs) == 1


def test_a_log_without_a_topic_that_gives_the_time_has_one_clock() -> None:
    """The first message says which: that of its stamp, or, where it has none, the wall clock."""
    order = LogOrder()
    order.expect_no_clock()
    stamped = [(0, TimeSource.STAMP, message(s)) for s in (5 * MS, WALL, 0, 6 * MS)]
    assert [e.log_ns for e in sorted(run(order, stamped, 1), key=lambda e: e.cdr)] == [
        5 * MS + 2, 5 * MS, 6 * MS, 5 * MS + 1,
    ]  # fmt: skip
    order = LogOrder()
    order.expect_no_clock()
    unstamped = [(0, TimeSource.STAMP, message(s)) for s in (0, 5 * MS)]
    assert [e.log_ns for e in run(order, unstamped, 1)] == [10**18, 10**18 + 1]
    assert order.other_clock == {0: 1}
