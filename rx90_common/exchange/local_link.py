"""The exchange within one process: the same bytes as over DDS, handed over in memory.

What is sent is also published while somebody listens, so that recorders and plots see no difference. Nothing is taken
from DDS: who else publishes on these topics is not heard, and is announced.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from rx90_common.base.errors import ConfigError
from rx90_common.exchange.channel import Matches, lock_publisher

_LOOK = 1.0  # s between two looks at the graph
_LOOKS = 8  # that others must be seen in a row: a process that was killed stays in the graph for 5 s


class LocalChannel:
    """One end, a `TickChannel`; made by `LocalLink.end`, with the arguments of `Channel`.

    The other end does not subscribe: `answering` is 0.
    """

    def __init__(self, link: LocalLink, node: Node, publish_topic: str, subscribe_topic: str, qos: QoSProfile) -> None:
        self._link, self._node = link, node
        self.answering = 0
        self._lock = lock_publisher(node.context.get_domain_id(), node.resolve_topic_name(publish_topic))
        self.publisher = node.create_publisher(JointState, publish_topic, qos)
        self.subscribe_topic = node.resolve_topic_name(subscribe_topic)
        # Looked up once, as in `Channel`.
        self._publish_raw = self.publisher.handle.publish_raw
        self._listeners = self.publisher.handle.get_subscription_count
        self._inbox: deque[bytes] = deque(maxlen=qos.depth)
        self._arrived = threading.Event()
        self._waiting = self._woken = False
        self._peer: LocalChannel | None = None
        self._serve = link.serve if publish_topic == link.served else None
        self._others_seen = 0
        self._timer = node.create_timer(_LOOK, self.look_for_others)

    def connect(self, peer: LocalChannel | None) -> None:
        """Send to `peer` from now on; without one, forget what nobody will answer.

        Raises:
            ConfigError: if it receives another topic.
        """
        if peer is None:
            self._inbox.clear()
        elif self.publisher.topic_name != peer.subscribe_topic:
            raise ConfigError(
                f"{self._node.get_name()} publishes {self.publisher.topic_name}, {peer._node.get_name()} receives "
                f"{peer.subscribe_topic}; accepted: the same topic, with remaps and namespaces alike for both nodes"
            )
        self._peer = peer

    def close(self) -> None:
        """Let another end take this one's place, once nobody calls the others any more."""
        self._lock.close()
        self._link.remove(self)

    def publish(self, raw: bytes) -> None:
        """Hand a serialised JointState over, and publish it if somebody listens."""
        # Publishing costs more than computing a tick. A listener gets all that is sent from its match on.
        if self._listeners():
            self._publish_raw(raw)
        peer = self._peer
        if peer is not None:
            peer._inbox.append(raw)
            if peer._waiting:
                peer._arrived.set()

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message in the order of sending, or None after `timeout_s` or a `wake`."""
        inbox = self._inbox
        if not inbox and self._serve is not None:
            self._serve()
        if not inbox and timeout_s > 0.0:
            deadline = time.monotonic() + timeout_s
            # In this order: what comes in between is found, or announced.
            self._waiting = True
            # The announcement of a message that was taken before may come now: it ends no wait.
            while not inbox and not self._woken and self._arrived.wait(deadline - time.monotonic()):
                self._arrived.clear()
            self._waiting = self._woken = False
        return inbox.popleft() if inbox else None

    def wake(self) -> None:
        """Make the current or the next `receive` that waits return at once; callable from every thread."""
        self._woken = True
        self._arrived.set()

    def matches(self) -> Matches:
        """Return one of each while the peer is there: nobody else is heard."""
        there = int(self._peer is not None)
        return Matches(there, there)

    def look_for_others(self) -> None:
        """Warn, each time that they appear, of other publishers of the topic on which only the peer is heard."""
        others = self._node.count_publishers(self.subscribe_topic) - 1
        self._others_seen = self._others_seen + 1 if others > 0 and self._peer is not None else 0
        if self._others_seen == _LOOKS and self._peer is not None:
            self._node.get_logger().warning(
                f"{others} other{'s publish' if others > 1 else ' publishes'} on {self.subscribe_topic}: not heard, "
                f"because {self._peer._node.get_name()} runs in this process"
            )


class LocalLink:
    """Two ends that are connected while both are there.

    Attributes:
        served: topic whose publishing end lets `serve` answer, on its own thread, when there is nothing to receive.
        serve: to receive and publish at the other end; looked at when an end is made.
    """

    def __init__(self) -> None:
        self.served = ""
        self.serve: Callable[[], None] | None = None
        self._ends: list[LocalChannel] = []

    def end(self, node: Node, publish_topic: str, subscribe_topic: str, qos: QoSProfile) -> LocalChannel:
        """Make an end, as the constructor of `Channel` does.

        Raises:
            ExchangeError: if another process on this machine publishes `publish_topic`.
            ConfigError: if the two ends do not fit each other.
        """
        channel = LocalChannel(self, node, publish_topic, subscribe_topic, qos)
        self._ends.append(channel)
        try:
            if len(self._ends) == 2:
                for one, other in (self._ends, self._ends[::-1]):
                    one.connect(other)
        except ConfigError:
            channel.close()
            raise
        return channel

    def remove(self, closed: LocalChannel) -> None:
        """Part the ends: one of them is closed."""
        self._ends.remove(closed)
        for left in (*self._ends, closed):
            left.connect(None)
