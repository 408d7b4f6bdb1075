"""The exchange within one process, on real DDS."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import closing

import pytest
from ros_client import Client
from sensor_msgs.msg import JointState

from rx90_common.base.errors import ConfigError, ExchangeError
from rx90_common.exchange import local_link
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.exchange.qos import TICK_QOS

pytestmark = pytest.mark.ros
QOS = TICK_QOS.profile
RAW = [JointStateCodec(["a"]).encode(tick) for tick in range(3)]


@pytest.fixture
def client(ros_domain: int) -> Iterator[Client]:  # noqa: ARG001 - a domain of its own
    """Give a client on a domain of its own."""
    with closing(Client()) as started:
        yield started


def test_messages_come_in_order_and_from_the_peer_alone(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """The peer's messages arrive in order, published from the first match on; others are announced, not heard."""
    link = local_link.LocalLink()
    first = link.end(client.node, "states", "commands", QOS)
    second = link.end(client.node, "commands", "states", QOS)
    first.publish(RAW[0])  # nobody listens yet
    heard = client.listen("states")
    foreign = client.node.create_publisher(JointState, "commands", QOS)
    client.spin_until(lambda: first.publisher.get_subscription_count() == 1, "the listener")
    client.spin_until(lambda: client.node.count_publishers("commands") == 2, "the other publisher")
    foreign.publish(RAW[2])
    first.publish(RAW[1])
    first.publish(RAW[2])
    client.spin_until(lambda: len(heard) == 2, "what was sent since")
    assert [second.receive(0.0) for _ in range(4)] == [*RAW, None]
    assert first.receive(0.05) is None
    said: list[str] = []
    monkeypatch.setattr(type(client.node.get_logger()), "warning", lambda _, text: said.append(text))
    for _ in range(20):
        first.look_for_others()
        second.look_for_others()
    assert len(said) == 1
    assert said[0].startswith("1 other publishes on /commands: not heard")


def test_a_wait_ends_with_a_message_or_a_wake(client: Client) -> None:
    """Who waits gets the message that another thread sends, and comes back empty-handed when woken.

    The announcement of a message that has been taken already, by a sender that was held up, ends no wait.
    """
    link = local_link.LocalLink()
    first = link.end(client.node, "states", "commands", QOS)
    second = link.end(client.node, "commands", "states", QOS)
    got: list[bytes | None] = []
    for act in (lambda: first.publish(RAW[0]), second.wake):
        thread = threading.Thread(target=lambda: got.append(second.receive(30.0)))
        thread.start()
        act()
        thread.join(20.0)
    assert got == [RAW[0], None]
    second._arrived.set()
    began = time.monotonic()
    assert second.receive(0.05) is None
    assert time.monotonic() - began >= 0.05


def test_ends_that_do_not_meet_are_refused(client: Client) -> None:
    """A remap or a namespace of one node alone is named with both topics; a second pair on the same ones is refused."""
    link = local_link.LocalLink()
    link.end(client.node, "states", "commands", QOS)
    with pytest.raises(ConfigError, match=r"publishes /states, .* receives /other; accepted: the same"):
        link.end(client.node, "commands", "other", QOS)
    with pytest.raises(ExchangeError, match=f"/states in ROS_DOMAIN_ID .* by process {os.getpid()}; accepted: one"):
        local_link.LocalLink().end(client.node, "states", "commands", QOS)
