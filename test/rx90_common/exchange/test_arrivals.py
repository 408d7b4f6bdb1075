"""What arrives on a channel's subscription is counted, and nothing is left lying."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Iterator

import pytest
from rclpy.node import Node
from ros_client import own_node
from sensor_msgs.msg import JointState

from rx90_common.exchange.arrivals import count_arrivals
from rx90_common.exchange.channel import Channel
from rx90_common.exchange.qos import TICK_QOS

PATIENCE = 60.0


@pytest.fixture
def node(ros_domain: int) -> Iterator[Node]:
    """Return a node in a domain of its own."""
    with own_node("arrivals", ros_domain) as node:
        yield node


def _until(done) -> None:
    deadline = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def _receive_until(channel: Channel, received: list[bytes], count: int, timeout: float) -> None:
    def take() -> bool:
        raw = channel.receive(timeout)
        if raw is not None:
            received.append(raw)
        return len(received) >= count

    _until(take)


@pytest.mark.ros
def test_every_message_is_counted(node: Node) -> None:
    """The counter goes up by one with each message, though nobody takes any."""
    publisher = node.create_publisher(JointState, "numbers", TICK_QOS.profile)
    subscription = node.create_subscription(JointState, "numbers", lambda _message: None, TICK_QOS.profile, raw=True)
    counter = ctypes.c_int64(0)
    assert count_arrivals(subscription, counter)
    _until(lambda: publisher.get_subscription_count() == 1)
    for _ in range(20):
        publisher.publish(JointState())
    _until(lambda: counter.value >= 20)
    assert counter.value == 20


@pytest.mark.ros
@pytest.mark.parametrize("timeout", [0.0, 0.001])
def test_a_burst_is_received_to_its_last_message(node: Node, timeout: float) -> None:
    """Messages that came while nobody looked are all received, in order, and then there are none."""
    channel = Channel(node, "out", "in", TICK_QOS.profile)
    publisher = node.create_publisher(JointState, "in", TICK_QOS.profile)
    _until(lambda: publisher.get_subscription_count() == 1)
    received: list[bytes] = []
    for burst in (1, 7, 3):
        sent = len(received) + burst
        for number in range(len(received), sent):
            publisher.publish(JointState(name=[str(number)]))
        _receive_until(channel, received, sent, timeout)
        assert channel.receive(timeout) is None
    assert [raw for number, raw in enumerate(received) if str(number).encode() + b"\0" not in raw] == []


@pytest.mark.ros
def test_a_channel_works_where_nothing_is_counted(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the middleware does not tell of new messages, the channel finds them by asking."""
    monkeypatch.setattr("rx90_common.exchange.channel.count_arrivals", lambda *_: False)
    channel = Channel(node, "out", "in", TICK_QOS.profile)
    publisher = node.create_publisher(JointState, "in", TICK_QOS.profile)
    _until(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(JointState(name=["one"]))
    received: list[bytes] = []
    _receive_until(channel, received, 1, 0.01)
    assert channel.receive(0.001) is None
