"""Bare ping-pong of the two tick messages between two processes on real DDS: what the lock-step is compared with.

A process sends its bytes as soon as the other's have come in: once with what rclpy offers, raw messages and a wait set
held by hand, and once through the channel that the nodes use. Both take turns.
"""

from __future__ import annotations

import multiprocessing
import os
import statistics
import threading
import time
from typing import Any

import numpy as np

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.ros_start import prepare
from rx90_common.exchange.topics import motor_names

_READY_TIMEOUT = 60.0
_SILENCE = 5.0
_BARE = ("ping", "pong")
_CHANNEL = ("channel_ping", "channel_pong")


def ping_pong(exchanges: int = 8000, rounds: int = 5) -> tuple[float, float]:
    """Return exchanges per s with a wait set and through the nodes' channel, medians of the rounds.

    Raises:
        ExchangeError: if the other process does not answer.
    """
    prepare()
    # Spawned, not forked: a fork would inherit the middleware's state without its threads.
    spawn = multiprocessing.get_context("spawn")
    end = spawn.Event()
    other = spawn.Process(target=_answer, args=(end, os.getpid()), daemon=True)
    other.start()
    try:
        return _ask(exchanges, rounds)
    finally:
        end.set()
        other.join(10.0)
        if other.is_alive():
            other.kill()


class _WaitSet:
    """Raw messages and a wait set held by hand: the least that rclpy itself allows."""

    def __init__(self, node: Any, publish_topic: str, subscribe_topic: str, qos: Any) -> None:
        from rclpy.impl.implementation_singleton import rclpy_implementation
        from sensor_msgs.msg import JointState

        self._kind, self.subscribe_topic = JointState, subscribe_topic
        self.publisher = node.create_publisher(JointState, publish_topic, qos)
        self.subscription = node.create_subscription(
            JointState, subscribe_topic, lambda _: None, qos, raw=True
        )
        self._wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, node.context.handle)
        self.publish = self.publisher.handle.publish_raw

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message, or None after `timeout_s`."""
        self._wait_set.clear_entities()
        self._wait_set.add_subscription(self.subscription.handle)
        self._wait_set.wait(int(timeout_s * 1e9))
        message = self.subscription.handle.take_message(self._kind, True)
        return None if message is None else message[0]

    def matches(self) -> tuple[int, int]:
        """Count what is connected."""
        return self.publisher.get_subscription_count(), self.subscription.get_publisher_count()


def _ends(name: str, direction: int) -> list[Any]:
    """Return both kinds of ends, of a node of this name; -1 turns the topics round."""
    import rclpy  # after `prepare`
    from rclpy.signals import SignalHandlerOptions

    from rx90_common.exchange.channel import Channel
    from rx90_common.exchange.endpoints import TICK_QOS

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name)
    topics = zip((_WaitSet, Channel), (_BARE[::direction], _CHANNEL[::direction]), strict=True)
    return [kind(node, *names, TICK_QOS) for kind, names in topics]


def _ask(exchanges: int, rounds: int) -> tuple[float, float]:
    from rclpy.utilities import try_shutdown

    from rx90_common.exchange.cdr import JointStateCodec

    try:
        ends = _ends("ping_pong_simulation", 1)
        for end in ends:
            deadline = time.monotonic() + _READY_TIMEOUT
            while min(end.matches()) < 1:
                if time.monotonic() > deadline:
                    raise ExchangeError(f"{end.subscribe_topic}: no peer within {_READY_TIMEOUT} s")
                time.sleep(0.01)
        message = JointStateCodec(motor_names(6)).encoder(
            *np.linspace(-1.0, 1.0, 18).reshape(3, 6)
        )(0)

        def rate(end: Any, count: int) -> float:
            began = time.perf_counter()
            for _ in range(count):
                end.publish(message)
                if end.receive(_SILENCE) is None:
                    raise ExchangeError(f"{end.subscribe_topic}: no answer within {_SILENCE} s")
            return count / (time.perf_counter() - began)

        for end in ends:
            rate(end, exchanges // 4)
        rates = [[rate(end, exchanges) for end in ends] for _ in range(rounds)]
        bare, channel = (statistics.median(column) for column in zip(*rates, strict=True))
        return bare, channel
    finally:
        try_shutdown()


def _answer(end: Any, parent: int) -> None:
    """Answer both kinds, in the second process, each on a thread of its own."""
    from rclpy.utilities import try_shutdown

    from rx90_common.exchange.cdr import JointStateCodec

    message = JointStateCodec(motor_names(6)).encode(0, effort=np.zeros(6))

    def pong(channel: Any) -> None:
        while not end.is_set() and os.getppid() == parent:
            while channel.receive(0.2) is not None:
                channel.publish(message)

    threads = [
        threading.Thread(target=pong, args=(one,), daemon=True)
        for one in _ends("ping_pong_controller", -1)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    try_shutdown()
