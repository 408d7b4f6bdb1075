"""Messages taken from the middleware many at a time."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from processes import wait_until
from rclpy.node import Node
from ros_client import own_node
from sensor_msgs.msg import JointState

from rx90_common.bags.recorder.stream import Stream, Streams
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.endpoints import TICK_QOS


@pytest.fixture
def node(ros_domain: int) -> Iterator[Node]:
    """Return a node in a domain of its own."""
    with own_node("taking", ros_domain) as node:
        yield node


@pytest.mark.ros
def test_what_is_sent_is_taken_whole(node: Node) -> None:
    """Messages come in order, to the bit, numbered and with their times, while the receiving thread seldom wakes."""
    count = 1500
    publisher = node.create_publisher(JointState, "numbers", TICK_QOS.profile)
    streams, found = Streams(node, ["numbers"]), list[Stream]()
    wait_until(lambda: streams.discover(found.append), "the subscription")
    wait_until(lambda: publisher.get_subscription_count() == 1, "the publisher")
    codec = JointStateCodec(["a", "b"])
    sent = [codec.encode(stamp, np.array([stamp, 1.0])) for stamp in range(count)]
    began = time.time_ns()
    for raw in sent:
        publisher.publish(raw)
    messages, received = [], []
    while len(messages) < count:
        arrived = found[0].take()
        assert len(arrived.messages) <= 512
        messages += arrived.messages
        received += arrived.received_ns.tolist()
    assert messages == sent
    assert (found[0].counter.received, found[0].lost(), found[0].repeated) == (count, 0, 0)
    assert received == sorted(received)
    assert began <= found[0].sent_ns <= received[-1]
    assert 0 < streams._batching.pauses < count / 10
