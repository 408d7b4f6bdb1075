"""Log time and order of recorded messages."""

from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rx90_common.bags.ordering import HEADER_STAMP, LIST_STAMP, Arrived, Dated, LogOrder, Source, stamps_ns
from rx90_common.exchange.cdr_stamps import cdr_stamp_ns

MS = 1_000_000
LIST_OF_ONE = b"\x00\x01\x00\x00\x01\x00\x00\x00"  # encapsulation and length


def message(stamp: int) -> bytes:
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    return b"\x00\x01\x00\x00" + seconds.to_bytes(4, "little") + nanoseconds.to_bytes(4, "little")


class Entry(NamedTuple):
    log_ns: int
    topic: int
    message: bytes


def entries(dated: Dated | None) -> list[Entry]:
    if dated is None:
        return []
    return [Entry(*each) for each in zip(*(column.tolist() for column in dated), strict=True)]


def clock(topic: int) -> Source:
    return Source(topic, HEADER_STAMP, gives_time=True)


def stamped(topic: int) -> Source:
    return Source(topic, HEADER_STAMP)


def add(order: LogOrder, source: Source, messages: list[bytes], received_ns: int = 0) -> None:
    order.add([Arrived(source, messages, received_ns + np.arange(len(messages)))])


def run(order: LogOrder, arrivals: list[tuple[Source, bytes]], every: int = 7) -> list[Entry]:
    """Pass messages through and return all that is released; those of a topic that come in a row, as one batch."""
    released: list[Entry] = []
    for i in range(0, len(arrivals), every):
        received_ns = 10**18 + i
        for source, batch in groupby(arrivals[i : i + every], key=lambda arrival: arrival[0]):
            messages = [cdr for _, cdr in batch]
            add(order, source, messages, received_ns)
            received_ns += len(messages)
        released += entries(order.release(received_ns))
    return released + entries(order.release_all())


@given(st.lists(st.binary(min_size=8, max_size=8), min_size=1))
def test_stamps_of_many_messages_are_those_of_each(times: list[bytes]) -> None:
    """At the head, or in the first message of a list; those before 0, and of an empty list, are 0."""
    expected = [max(0, cdr_stamp_ns(LIST_OF_ONE[:4] + time)) for time in times]
    assert stamps_ns([LIST_OF_ONE[:4] + time + b"more" for time in times], HEADER_STAMP).tolist() == expected
    lists = [LIST_OF_ONE + time for time in times]
    assert stamps_ns([*lists, LIST_OF_ONE[:4] + bytes(4)], LIST_STAMP).tolist() == [*expected, 0]


@settings(max_examples=40)
@given(st.data())
def test_order_does_not_depend_on_the_interleaving(data: Any) -> None:
    """However three topics arrive interleaved within 0.4 s, they are released sorted by stamp, then topic."""
    sent = [(stamp * MS, topic) for stamp in range(0, 3000, 50) for topic in range(3)]
    delays = data.draw(st.lists(st.integers(0, 400), min_size=3, max_size=3))
    arrivals = sorted(sent, key=lambda m: m[0] + delays[m[1]] * MS)
    released = run(LogOrder(), [(clock(t), message(s)) for s, t in arrivals], data.draw(st.integers(1, 50)))
    assert [(e.log_ns, e.topic) for e in released] == sent


def test_a_latched_message_has_the_first_time() -> None:
    """However late it arrives, unless messages have been released; without a clock it has that of its reception."""
    order = LogOrder()
    for stamp in range(0, 1000, 50):
        add(order, clock(0), [message(stamp * MS)], (5000 + stamp) * MS)
    add(order, Source(1, latched=True), [b"early"], 6000 * MS)
    assert not entries(order.release(7000 * MS))
    add(order, Source(1, latched=True), [b"late"], 7500 * MS)
    released = entries(order.release(8000 * MS))
    add(order, Source(1, latched=True), [b"after a release"], 8000 * MS)
    released += entries(order.release_all())
    assert [(e.log_ns, e.message) for e in released if e.topic] == [
        (0, b"early"),
        (0, b"late"),
        (950 * MS, b"after a release"),
    ]
    order = LogOrder()
    order.date_by_reception()
    add(order, Source(0), [b"first"], 9000 * MS)
    add(order, Source(1, latched=True), [b"old"], 9001 * MS)
    assert [(e.log_ns // MS, e.message) for e in entries(order.release(0))] == [(9000, b"first"), (9001, b"old")]


def test_a_topic_that_is_sent_again_late_is_in_its_place() -> None:
    """In a run ten times faster than real time a topic that is 0.8 s of the wall clock late is sorted in."""
    sent = [(stamp * MS, topic) for stamp in range(0, 20_000, 50) for topic in range(2)]
    order, released = LogOrder(), list[Entry]()
    for stamp, topic in sorted(sent, key=lambda each: each[0] // 10 + each[1] * 800 * MS):
        now = stamp // 10 + topic * 800 * MS
        add(order, clock(topic), [message(stamp)], now)
        released += entries(order.release(now))
    before = len(released)
    released += entries(order.release(now + 2000 * MS))  # also where no more messages come
    assert 0 < before < len(released) < len(sent)
    released += entries(order.release_all())
    assert [(e.log_ns, e.topic) for e in released] == sent


def test_messages_without_stamp_get_the_newest() -> None:
    """Without a stamp of its own a message gets the newest one seen, or the first if it comes before that."""
    arrivals = [
        (Source(9), b"early"),
        (clock(0), message(5 * MS)),
        (clock(0), message(6 * MS)),
        (Source(9), b"later"),
        (stamped(8), message(0)),
        (stamped(8), message(50 * MS)),
        (clock(0), message(7 * MS)),
    ]
    times = {e.message: e.log_ns for e in run(LogOrder(), arrivals) if e.topic > 0}
    assert times == {b"early": 5 * MS, b"later": 6 * MS, message(0): 6 * MS, message(50 * MS): 50 * MS}


def test_wall_clock_where_no_topic_gives_the_time() -> None:
    """Without a topic that gives the time, log time is that of reception, also when that is known late or never."""
    for known in (True, False):
        order = LogOrder()
        if known:
            order.date_by_reception()
        released = run(order, [(stamped(0), message(i)) for i in range(5)])
        assert [e.log_ns for e in released] == [10**18 + i for i in range(5)]


def test_time_that_is_set_back_holds_nothing_up() -> None:
    """After a reset of simulated time messages go on being released, two seconds after they came, and none is lost."""
    order = LogOrder()
    held = []
    stamps = [*range(0, 10_000, 10), *range(0, 5_000, 10)]
    released: list[Entry] = []
    for received, stamp in enumerate(stamps):
        add(order, clock(0), [message(stamp * MS)], received * 10 * MS)
        released += entries(order.release(received * 10 * MS))
        held.append(order.held_bytes)
    released += entries(order.release_all())
    assert len(released) == len(stamps)
    assert max(held) <= 12 * 210
    assert order.held_bytes == 0


def test_a_reset_is_reported_and_keeps_the_runs_apart() -> None:
    """Stamps that go back, in one topic after the other, leave both runs whole and one behind the other."""
    order = LogOrder()
    runs = [*range(0, 300, 10)], [*range(0, 200, 10)]
    for topic, stamp in [(0, s) for s in runs[0]] + [(1, s) for s in runs[0][:-3]]:
        add(order, clock(topic), [message(stamp * MS)])
    add(order, clock(0), [message(0)])  # before the other topic's last messages of the first run
    for stamp in runs[0][-3:]:
        add(order, clock(1), [message(stamp * MS)])
    add(order, clock(1), [message(0)])
    for topic, stamp in [(t, s) for t in (0, 1) for s in runs[1][1:]]:
        add(order, clock(topic), [message(stamp * MS)])
    released = entries(order.release_all())
    assert [e.log_ns for e in released] == sorted(e.log_ns for e in released)
    for topic in (0, 1):
        stamps = [cdr_stamp_ns(e.message) for e in released if e.topic == topic]
        assert stamps == [s * MS for run in runs for s in run]
    assert order.set_backs == [(290 * MS, 0)]


WALL = 1_700_000_000 * 1_000 * MS


def test_a_log_has_one_clock() -> None:
    """Stamps of another clock are dated by when they came; those of the log's own keep their times, however far."""
    arrivals = [
        (stamped(5), message(WALL)),
        (stamped(6), message(4 * MS)),
        (clock(0), message(7 * MS)),
        (clock(0), message(8 * MS)),
        (stamped(5), message(WALL + 2 * MS)),
        (Source(7, LIST_STAMP), LIST_OF_ONE + message(WALL + 3 * MS)[4:]),
        (stamped(6), message(3_600_000 * MS)),
        (clock(0), message(9 * MS)),
        (clock(0), message(0)),
        (stamped(5), message(WALL + 5 * MS)),
    ]
    for every in (1, 4, 100):
        order = LogOrder()
        found: dict[int, list[float]] = {}
        for entry in run(order, arrivals, every):
            found.setdefault(entry.topic, []).append(entry.log_ns / MS)
        assert found[0] == [7, 8, 9, 9 + 1 / MS]
        assert found[6] == [4, 3_600_000]
        assert found[5] == [7, 8, 9 + 1 / MS]
        assert found[7] == [8]
        assert len(order.set_backs) == 1
