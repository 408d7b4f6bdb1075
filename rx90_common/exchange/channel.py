"""Channels for the exchange of ticks: raw DDS messages between processes, memory within one.

An rclpy executor rebuilds its wait set, makes tasks and deserialises for every message, which allows some
1,400 exchanges a second. A channel does one system call to wait and one to send.

Each tick topic has one publisher: a second simulation or controller is refused before it can interfere. The ROS graph
cannot be used for that: a node that was killed stays in it until its lease expires, and its successor would have to
wait. A name in the abstract socket namespace disappears with its process, however that ends, and identifies it. It
reaches as far as loopback does; publishers elsewhere are recognised by their messages.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from itertools import permutations
from typing import Any, NamedTuple

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from rx90_common.base.errors import ConfigError, ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.arrivals import count_arrivals
from rx90_common.exchange.endpoints import ManualCallbackGroup, never_called

_clock = time.perf_counter_ns
_BUSY_WAIT_NS = 200_000
_BLOCKING_WAITS = 50  # after a busy wait in vain, before the next one
_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid
_PROBE_TIMEOUT = 1.0  # s
_LOOK = 1.0  # s between two looks at the graph
# in which others must be seen in a row: a process that was killed stays in the graph for 5 s
_LOOKS = 8


class Matches(NamedTuple):
    """Endpoints that the middleware has connected: subscriptions of our topic, publishers of the other's."""

    subscriptions: int
    publishers: int


class TickChannel:
    """A node's end of the exchange: publishes on one JointState topic and receives from another, as CDR bytes.

    Owned by one thread; only `wake` may be called from others, and an executor may spin the node in another one. The
    node destroys publisher and subscription.

    Args:
        node: whose publisher and subscription these are.
        publish_topic: relative or absolute name of the topic to publish.
        subscribe_topic: relative or absolute name of the topic to receive.
        qos: of both.

    Attributes:
        publisher: for the check of its matches and acknowledgements.
        subscribe_topic: resolved name of the received topic.
        answering: number of the published topic's subscriptions that belong to the other end, not to other subscribers.

    Raises:
        ExchangeError: if another process on this machine publishes `publish_topic` through a channel.
    """

    answering = 1

    def __init__(
        self, node: Node, publish_topic: str, subscribe_topic: str, qos: QoSProfile
    ) -> None:
        self._lock = lock_publisher(
            node.context.get_domain_id(), node.resolve_topic_name(publish_topic)
        )
        self.publisher: Publisher = node.create_publisher(JointState, publish_topic, qos)
        self.subscribe_topic = str(node.resolve_topic_name(subscribe_topic))
        # Looked up once: each attribute costs as much as a comparison of the whole message.
        self._publish_raw = self.publisher.handle.publish_raw

    def publish(self, raw: bytes) -> None:
        """Send a serialised JointState; returns when it is handed over."""
        self._publish_raw(raw)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message in the order of sending, or None after `timeout_s` or a `wake`."""
        raise NotImplementedError

    def wake(self) -> None:
        """Make the current or the next `receive` that waits return at once; callable from every thread."""
        raise NotImplementedError

    def matches(self) -> Matches:
        """Count who is there to receive, and who to send."""
        raise NotImplementedError

    def close(self) -> None:
        """Let another end take this one's place, once nobody calls the others any more."""
        self._lock.close()


MakeChannel = Callable[[Node, str, str, QoSProfile], TickChannel]
"""Makes a node's end of the exchange, with the arguments of `TickChannel`."""


class Channel(TickChannel):
    """The exchange between processes: a raw publisher and a raw subscription, on a wait set held by hand."""

    def __init__(
        self, node: Node, publish_topic: str, subscribe_topic: str, qos: QoSProfile
    ) -> None:
        super().__init__(node, publish_topic, subscribe_topic, qos)
        self._subscription = node.create_subscription(
            JointState,
            subscribe_topic,
            never_called,
            qos,
            raw=True,
            callback_group=ManualCallbackGroup(),
        )
        self._blocking_waits = 0
        self._guard = rclpy_implementation.GuardCondition(node.context.handle)
        self._wait_set = rclpy_implementation.WaitSet(1, 1, 0, 0, 0, 0, node.context.handle)
        self._raw_subscription = self._subscription.handle
        self._take = self._raw_subscription.take_message
        self._counter = ctypes.c_int64(0)
        self._counted = count_arrivals(self._subscription, self._counter)
        self._count = 0  # of messages taken

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message in the order of sending, or None after `timeout_s` or a `wake`.

        With a timeout of 0 the wait set, which costs some 70 µs even then, is left out.
        """
        message = None
        # To take in vain costs as much as a message. A message that the count has missed is found by the wait set.
        if timeout_s == 0.0 or not self._counted or self._counter.value != self._count:
            message = self._take_next()
        if message is None and timeout_s > 0.0:
            message = self._busy_wait()
            if message is None:
                wait_set = self._wait_set
                wait_set.clear_entities()
                wait_set.add_subscription(self._raw_subscription)
                wait_set.add_guard_condition(self._guard)
                wait_set.wait(int(timeout_s * NANOSECONDS))
                message = self._take_next()
        return None if message is None else message[0]

    def _take_next(self) -> Any:
        """Take a message and update the count of taken messages, to be compared with the count of arrivals."""
        arrived = self._counter.value
        message = self._take(JointState, True)
        # If none remains, as many as arrived have been taken, or were replaced by newer ones.
        self._count = arrived if message is None else self._count + 1
        return message

    def _busy_wait(self) -> Any:
        """Poll for as long as an answer usually takes, unless that was in vain a short while ago.

        A processor that went to sleep in the wait set takes longer to wake than the other side takes to answer.
        """
        if self._blocking_waits > 0:
            self._blocking_waits -= 1
            return None
        counter = self._counter
        clock = _clock
        give_way = os.sched_yield
        deadline = clock() + _BUSY_WAIT_NS
        while clock() < deadline:
            if counter.value != self._count or not self._counted:
                message = self._take_next()
                if message is not None:
                    return message
            give_way()
        self._blocking_waits = _BLOCKING_WAITS
        return None

    def wake(self) -> None:
        """Trigger the guard condition of the wait set."""
        self._guard.trigger_guard_condition()

    def matches(self) -> Matches:
        """Count the present connections of the middleware."""
        return Matches(
            self.publisher.get_subscription_count(), self._subscription.get_publisher_count()
        )


class LocalChannel(TickChannel):
    """The exchange within one process: the same bytes as over DDS, handed over in memory; made by `LocalLink.end`.

    Messages are also published while there are subscribers, so that recorders and plots see no difference. None is
    taken from DDS: other publishers on these topics are ignored, and reported. The other end does not subscribe.

    Attributes:
        peer: the other end, once it is there.
    """

    answering = 0

    def __init__(
        self, link: LocalLink, node: Node, publish_topic: str, subscribe_topic: str, qos: QoSProfile
    ) -> None:
        super().__init__(node, publish_topic, subscribe_topic, qos)
        self._link = link
        self._node = node
        self._listeners = self.publisher.handle.get_subscription_count
        self._inbox: deque[bytes] = deque(maxlen=qos.depth)
        self._arrived = threading.Event()
        self._waiting = self._woken = False
        self.peer: LocalChannel | None = None
        self._serve = link.serve if publish_topic == link.served else None
        self._others_seen = 0
        self._timer = node.create_timer(_LOOK, self.look_for_others)

    def close(self) -> None:
        """Separate the ends, which forget messages that will never be answered."""
        super().close()
        for end in self._link.ends:
            end._inbox.clear()
            end.peer = None
        self._link.ends.remove(self)

    def publish(self, raw: bytes) -> None:
        """Hand a serialised JointState over, and publish it if somebody listens."""
        # Publishing costs more than computing a tick. A listener gets all that is sent from its match on.
        if self._listeners():
            self._publish_raw(raw)
        peer = self.peer
        if peer is not None:
            peer._inbox.append(raw)
            if peer._waiting:
                peer._arrived.set()

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message that was handed over."""
        inbox = self._inbox
        if not inbox and self._serve is not None:
            self._serve()
        if not inbox and timeout_s > 0.0:
            deadline = time.monotonic() + timeout_s
            # In this order: a message that arrives in between is found, or announced.
            self._waiting = True
            # The announcement of a message that was taken before may arrive now: it ends no wait.
            while not inbox and not self._woken and self._arrived.wait(deadline - time.monotonic()):
                self._arrived.clear()
            self._waiting = self._woken = False
        return inbox.popleft() if inbox else None

    def wake(self) -> None:
        """End a wait."""
        self._woken = True
        self._arrived.set()

    def matches(self) -> Matches:
        """Return one of each while the peer is there: other nodes are ignored."""
        there = int(self.peer is not None)
        return Matches(there, there)

    def look_for_others(self) -> None:
        """Warn of other publishers of the topic, each time that they appear: only the peer's messages are received."""
        others = self._node.count_publishers(self.subscribe_topic) - 1
        self._others_seen = self._others_seen + 1 if others > 0 and self.peer is not None else 0
        if self._others_seen == _LOOKS and self.peer is not None:
            self._node.get_logger().warning(
                f"{others} other{'s publish' if others > 1 else ' publishes'} on {self.subscribe_topic}: not heard, "
                f"because {self.peer._node.get_name()} runs in this process"
            )


class LocalLink:
    """Two ends that are connected while both are there.

    Attributes:
        served: topic whose publishing end lets `serve` answer, on its own thread, when there is nothing to receive.
        serve: to receive and publish at the other end; looked at when an end is made.
        ends: those that are there.
    """

    def __init__(self) -> None:
        self.served = ""
        self.serve: Callable[[], None] | None = None
        self.ends: list[LocalChannel] = []

    def end(
        self, node: Node, publish_topic: str, subscribe_topic: str, qos: QoSProfile
    ) -> LocalChannel:
        """Make an end, as `MakeChannel` does.

        Raises:
            ExchangeError: if another process on this machine publishes `publish_topic`.
        """
        channel = LocalChannel(self, node, publish_topic, subscribe_topic, qos)
        self.ends.append(channel)
        for one, other in permutations(self.ends, 2):
            if one.publisher.topic_name != other.subscribe_topic:
                channel.close()
                raise ConfigError(
                    f"{one._node.get_name()} publishes {one.publisher.topic_name}, {other._node.get_name()} receives "
                    f"{other.subscribe_topic}; accepted: the same topic, with remaps and namespaces alike for both "
                    "nodes"
                )
            one.peer = other
        return channel


def lock_publisher(domain: int, topic: str) -> socket.socket:
    """Lock `topic` in DDS domain `domain` for this process's publisher, for as long as the returned socket is open.

    Raises:
        ExchangeError: if another process on this machine has locked it; the text names its process id.
    """
    # Hashed, because the kernel takes 107 bytes and a namespace may be longer.
    name = "\0rx90_emulator/" + hashlib.sha256(f"{domain} {topic}".encode()).hexdigest()
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        lock.bind(name)
    except OSError:
        lock.close()
        raise ExchangeError(
            f"{topic} in ROS_DOMAIN_ID {domain} is already published by process {_holder(name)}; accepted: one "
            "publisher; end that process, or choose another ROS_DOMAIN_ID or namespace"
        ) from None
    lock.listen(1)
    return lock


def _holder(name: str) -> str:
    """Return the id of the process that holds a lock."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(_PROBE_TIMEOUT)
            probe.connect(name)
            credentials = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
            return str(_CREDENTIALS.unpack(credentials)[0])
    except OSError:
        return "(unknown)"
