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
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.exchange.qos import TICK_QOS


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
    messages, numbers, received, sent_ns = [], [], [], []
    while len(messages) < count:
        taken = found[0].take()
        assert len(taken.messages) <= 512
        messages += taken.messages
        numbers += taken.numbers.tolist()
        received += taken.received_ns.tolist()
        sent_ns += taken.sent_ns.tolist()
    assert messages == sent
    assert numbers == list(range(1, count + 1))
    assert received == sorted(received)
    assert sent_ns == sorted(sent_ns)
    assert began <= sent_ns[0]
    assert all(before <= after for before, after in zip(sent_ns, received, strict=True))
    assert 0 < streams._gathering.pauses < count / 10
