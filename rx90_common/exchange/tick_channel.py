"""What nodes exchange their ticks through: DDS between processes, memory within one."""

from __future__ import annotations

from typing import Protocol

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from rx90_common.exchange.channel import Matches


class TickChannel(Protocol):
    """Publishes on one JointState topic and receives from another, as CDR bytes; see `Channel`.

    Attributes:
        answering: how many subscriptions of the published topic are the other end's, and not a listener's.
    """

    answering: int

    @property
    def publisher(self) -> Publisher:
        """The publisher, to look at what it is matched with and what has been acknowledged."""

    @property
    def subscribe_topic(self) -> str:
        """Resolved name of the topic that is received."""

    def publish(self, raw: bytes) -> None:
        """Send a serialised JointState."""

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message in the order of sending, or None after `timeout_s` or a `wake`."""

    def wake(self) -> None:
        """Make the current or the next `receive` return at once; callable from every thread."""

    def close(self) -> None:
        """Let another end take this one's place, once nobody calls the others any more."""

    def matches(self) -> Matches:
        """Count who is there to receive, and who to send."""


class MakeChannel(Protocol):
    """Makes a node's end of the exchange, as the constructor of `Channel` does."""

    def __call__(self, node: Node, publish_topic: str, subscribe_topic: str, qos: QoSProfile) -> TickChannel:
        """Return it; topics are relative or absolute names."""


class Ends:
    """Makes a node's ends of the exchange, one after the other, and closes the newest one."""

    def __init__(self, make_channel: MakeChannel) -> None:
        self._make_channel = make_channel
        self._newest: TickChannel | None = None

    def make(self, node: Node, publish_topic: str, subscribe_topic: str, qos: QoSProfile) -> TickChannel:
        """Make an end, as `MakeChannel` does."""
        self._newest = channel = self._make_channel(node, publish_topic, subscribe_topic, qos)
        return channel

    def close(self) -> None:
        """Close it, if there is one."""
        if self._newest is not None:
            self._newest.close()
        self._newest = None
