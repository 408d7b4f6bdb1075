"""Parts of the recorder: counts by sequence numbers, takes from the middleware, and the end of a recording."""

import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import wait_until
from rclpy.node import Node
from ros_client import own_node
from sensor_msgs.msg import JointState

from rx90_common.bags.ordering import Arrived, LogOrder, Source
from rx90_common.bags.recorder import recording
from rx90_common.bags.recorder.stream import SequenceCounter, Streams
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.endpoints import TICK_QOS

SENT_BEFORE = 9  # one a round: these take longer than a topic that is quiet is waited for
LONG = 120.0


class Publisher:
    """Stands for a stream: a publisher that sends on and on, and whose messages come late, one in each round."""

    source = Source(0)

    def __init__(self, resent_after: float) -> None:
        self.sent_ns = 0
        self.taken_at = 0.0
        self.taken = 0
        self._resent = time.monotonic() + resent_after
        self._begin_ns = time.time_ns()

    def take(self) -> Arrived:
        if self.taken == SENT_BEFORE // 2 and time.monotonic() < self._resent:
            return Arrived(self.source, [], np.empty(0, dtype=np.int64))
        self.taken += 1
        self.taken_at = time.monotonic()
        self.sent_ns = self._begin_ns if self.taken <= SENT_BEFORE else time.time_ns()
        return Arrived(self.source, [b"%d" % self.taken], np.array([self.taken]))


@pytest.mark.slow
@pytest.mark.parametrize("resent_after", [0.0, 1.2])
def test_a_busy_publisher_is_read_up_to_the_end(monkeypatch: pytest.MonkeyPatch, resent_after: float) -> None:
    """All that was sent before the end is read, however late it comes or comes again; busy topics hold no end up."""
    monkeypatch.setattr(recording, "_MAX_DRAIN_S", LONG)
    publisher: Any = Publisher(resent_after)
    order = LogOrder()
    begin = time.monotonic()
    recording.drain([publisher], order)
    assert time.monotonic() - begin < LONG / 2.0
    read = order.release_all()
    assert read.messages.tolist() == [b"%d" % number for number in range(1, publisher.taken + 1)]
    assert publisher.taken > SENT_BEFORE


def lost(counter: SequenceCounter) -> int:
    return sum(writer.lost for writer in counter.writers)


def count(counter: SequenceCounter, *numbers: int) -> SequenceCounter:
    for number in numbers:
        counter.add(np.array([number]))
    return counter


@given(st.sets(st.integers(1, 300), min_size=1))
def test_single_writer_is_counted_exactly(numbers: set[int]) -> None:
    """Of one writer every number missing between its first and last message is counted as lost."""
    counter = SequenceCounter(lambda: 1, transient_local=False)
    counter.add(np.array(sorted(numbers)))
    assert [writer.received for writer in counter.writers] == [len(numbers)]
    assert lost(counter) == max(numbers) - min(numbers) + 1 - len(numbers)


@given(st.lists(st.integers(1, 40), min_size=1, max_size=4), st.randoms(use_true_random=False), st.integers(1, 9))
def test_interleaved_writers_lose_nothing(counts: list[int], random: Any, batches: int) -> None:
    """Several complete writers, in any interleaving and any batches of messages, count as no loss and as that many."""
    counter = SequenceCounter(lambda: len(counts), transient_local=False)
    counter.start()
    numbers = [0] * len(counts)
    order = [writer for writer, number in enumerate(counts) for _ in range(number)]
    random.shuffle(order)
    sent = []
    for writer in order:
        numbers[writer] += 1
        sent.append(numbers[writer])
    for batch in np.array_split(sent, min(batches, len(sent))):
        counter.add(batch)
    assert lost(counter) == 0
    assert sorted(writer.received for writer in counter.writers) == sorted(counts)


def test_writers_that_come_later() -> None:
    """One that appears while recording must be heard from its first message on, unless latched, or has restarted."""
    for transient_local, expected in ((False, 3), (True, 0)):
        matches = [1]
        counter = count(SequenceCounter(partial(max, matches), transient_local=transient_local), 5, 6)
        counter.start()
        matches.append(2)
        count(counter, 7, 4, 5, 8)
        assert lost(counter) == expected
        assert [writer.received for writer in counter.writers] == [4, 2]
    for end in (4, 40, 4000):
        counter = SequenceCounter(lambda: 2, transient_local=False)
        count(counter, *range(1, end), *range(1, 101), *range(104, 200))
        assert [writer.lost for writer in counter.writers] == [0, 3]


@pytest.fixture
def node(ros_domain: int) -> Iterator[Node]:
    with own_node("taking", ros_domain) as node:
        yield node


@pytest.mark.ros
def test_what_is_sent_is_taken_whole(node: Node) -> None:
    """Messages come in order, to the bit, numbered and with their times, while the receiving thread seldom wakes."""
    count = 1500
    publisher = node.create_publisher(JointState, "numbers", TICK_QOS)
    streams = Streams(node, ["numbers"])
    wait_until(streams.discover, "the subscription")
    (stream,) = streams
    wait_until(lambda: publisher.get_subscription_count() == 1, "the publisher")
    codec = JointStateCodec(["a", "b"])
    sent = [codec.encode(stamp, np.array([stamp, 1.0])) for stamp in range(count)]
    began = time.time_ns()
    for raw in sent:
        publisher.publish(raw)
    messages, times = [], []
    while len(messages) < count:
        arrived = stream.take()
        messages += arrived.messages
        times += arrived.received_ns.tolist()
    assert messages == sent
    received = sum(writer.received for writer in stream.counter.writers)
    assert (received, lost(stream.counter), stream.repeated) == (count, 0, 0)
    assert times == sorted(times)
    assert began <= stream.sent_ns <= times[-1]
    assert 0 < streams._batching._state[1] < count / 10
