"""What nodes exchange their ticks through: raw DDS messages between processes, for one thread; `local_link` within one.

An rclpy executor rebuilds its wait set, makes tasks and deserialises for every message, which allows some
1,400 exchanges a second. A channel does one system call to wait and one to send.

Each tick topic has one publisher: a second simulation or controller is refused before it can mix in. The graph cannot
say: a node that was killed stays in it until its lease expires, and its successor would have to wait for that. A name
in the abstract socket namespace goes with the process that holds it, however it ends, and names that process. It
reaches as far as loopback does; publishers elsewhere are recognised by what they send.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import socket
import struct
import time
from typing import Any, NamedTuple, Protocol

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.arrivals import count_arrivals
from rx90_common.exchange.endpoints import ManualCallbackGroup, never_called

_clock = time.perf_counter_ns
_BUSY_WAIT_NS = 200_000
_BLOCKING_WAITS = 50  # after a busy wait in vain, before the next one
_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid
_PROBE_TIMEOUT = 1.0  # s


class Matches(NamedTuple):
    """Endpoints that the middleware has connected: subscriptions of our topic, publishers of the other's."""

    subscriptions: int
    publishers: int


class TickChannel(Protocol):
    """Publishes on one JointState topic and receives from another, as CDR bytes.

    Owned by one thread; only `wake` may be called from others.

    Attributes:
        publisher: to look at what it is matched with and what has been acknowledged.
        subscribe_topic: resolved name of the topic that is received.
        answering: how many subscriptions of the published topic are the other end's, and not a listener's.
    """

    publisher: Publisher
    subscribe_topic: str
    answering: int

    def publish(self, raw: bytes) -> None:
        """Send a serialised JointState; returns when it is handed over."""

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message in the order of sending, or None after `timeout_s` or a `wake`."""

    def wake(self) -> None:
        """Make the current or the next `receive` that waits return at once; callable from every thread."""

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


class Channel:
    """A `TickChannel` by a raw publisher and a raw subscription, on a wait set held by hand.

    Args:
        node: the node whose endpoints these are, which destroys them; an executor may spin it in another thread.
        publish_topic: relative or absolute name of the topic to publish.
        subscribe_topic: relative or absolute name of the topic to receive.
        qos: of both.

    Raises:
        ExchangeError: if another process on this machine publishes `publish_topic` through a channel.
    """

    def __init__(self, node: Node, publish_topic: str, subscribe_topic: str, qos: QoSProfile) -> None:
        self._lock = lock_publisher(node.context.get_domain_id(), node.resolve_topic_name(publish_topic))
        self.publisher = node.create_publisher(JointState, publish_topic, qos)
        self._subscription = node.create_subscription(
            JointState, subscribe_topic, never_called, qos, raw=True, callback_group=ManualCallbackGroup()
        )
        self.subscribe_topic = str(self._subscription.topic_name)
        self.answering = 1
        self._blocking_waits = 0
        self._guard = rclpy_implementation.GuardCondition(node.context.handle)
        self._wait_set = rclpy_implementation.WaitSet(1, 1, 0, 0, 0, 0, node.context.handle)
        # Looked up once: each attribute costs as much as a comparison of the whole message.
        self._raw_subscription = self._subscription.handle
        self._take = self._raw_subscription.take_message
        self._publish_raw = self.publisher.handle.publish_raw
        self._counter = ctypes.c_int64(0)
        self._counted = count_arrivals(self._subscription, self._counter)
        self._count = 0  # of messages taken

    def publish(self, raw: bytes) -> None:
        """Send a serialised JointState; returns when it is handed to the network."""
        self._publish_raw(raw)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message in the order of sending, or None after `timeout_s` or a `wake`.

        With a timeout of 0 the wait set, which costs some 70 µs even then, is left out.
        """
        taken = None
        # To take in vain costs as much as a message. A message that the count has missed is found by the wait set.
        if timeout_s == 0.0 or not self._counted or self._counter.value != self._count:
            taken = self._take_next()
        if taken is None and timeout_s > 0.0:
            taken = self._busy_wait()
            if taken is None:
                wait_set = self._wait_set
                wait_set.clear_entities()
                wait_set.add_subscription(self._raw_subscription)
                wait_set.add_guard_condition(self._guard)
                wait_set.wait(int(timeout_s * NANOSECONDS))
                taken = self._take_next()
        return None if taken is None else taken[0]

    def _take_next(self) -> Any:
        """Take a message and keep the count of those taken next to the count of arrivals."""
        arrived = self._counter.value
        taken = self._take(JointState, True)
        # With nothing left, as many as arrived have been taken, or were replaced by newer ones.
        self._count = arrived if taken is None else self._count + 1
        return taken

    def _busy_wait(self) -> Any:
        """Poll for as long as an answer usually takes, unless that was in vain a short while ago.

        A processor that went to sleep in the wait set takes longer to wake than the other side takes to answer.
        """
        if self._blocking_waits > 0:
            self._blocking_waits -= 1
            return None
        counter, clock, give_way = self._counter, _clock, os.sched_yield
        deadline = clock() + _BUSY_WAIT_NS
        while clock() < deadline:
            if counter.value != self._count or not self._counted:
                taken = self._take_next()
                if taken is not None:
                    return taken
            give_way()
        self._blocking_waits = _BLOCKING_WAITS
        return None

    def wake(self) -> None:
        """Make the current or the next `receive` that waits return at once; callable from every thread."""
        self._guard.trigger_guard_condition()

    def close(self) -> None:
        """Let another process publish the topic; the node destroys publisher and subscription."""
        self._lock.close()

    def matches(self) -> Matches:
        """Count what the middleware has connected now."""
        return Matches(self.publisher.get_subscription_count(), self._subscription.get_publisher_count())


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
