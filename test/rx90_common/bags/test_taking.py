"""Messages taken from the middleware many at a time."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from processes import wait_until
from rclpy.node import Node
from ros_client import own_node
from sensor_msgs.msg import JointState

from rx90_common.bags.recorder import taking
from rx90_common.bags.recorder.taking import BulkTaker, SingleTaker, Taken, bulk_taker
from rx90_common.base.errors import BagError
from rx90_common.exchange.arrivals import Gathering
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.exchange.qos import TICK_QOS

SIZES = [0, 1, 300, 65_536, 65_537, 1_000_000, *range(2000), 65_000, 700, 0]


class Middleware:
    """Stands for rcl: messages of these sizes, the k-th with number 7 + k, sent at 400 + k ns, received 600 ns on."""

    def __init__(self, sizes: list[int], end: int) -> None:
        self.messages = [bytes([k % 256]) * size for k, size in enumerate(sizes)]
        self.given = 0
        kind = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_void_p] * 4)
        self.function = kind(self._take)
        self.end = end

    def _take(self, subscription: int, message: int, info: int, allocation: int | None) -> int:
        assert (subscription, allocation) == (4711, None)
        if self.given == len(self.messages):
            return self.end
        content = self.messages[self.given]
        place = ctypes.cast(message, ctypes.POINTER(taking._SerializedMessage)).contents
        self._kept = ctypes.create_string_buffer(content, len(content) + 1)
        place.buffer, place.size = ctypes.addressof(self._kept), len(content)
        ctypes.cast(info, ctypes.POINTER(ctypes.c_int64))[0] = 400 + self.given
        ctypes.cast(info, ctypes.POINTER(ctypes.c_int64))[1] = 1000 + self.given
        ctypes.cast(info, ctypes.POINTER(ctypes.c_int64))[2] = 7 + self.given
        self.given += 1
        return 0


class Handle(nullcontext[None]):
    """Stands for rclpy's handle of a subscription."""

    pointer = 4711


def _all(take: Callable[[], Taken]) -> tuple[list[bytes], list[int], list[int], list[int]]:
    """Take until nothing is there."""
    messages: list[bytes] = []
    numbers: list[int] = []
    received: list[int] = []
    sent: list[int] = []
    while len((taken := take()).messages):
        assert len(taken.messages) <= 512
        messages += taken.messages
        numbers += taken.numbers.tolist()
        received += taken.received_ns.tolist()
        sent += taken.sent_ns.tolist()
    return messages, numbers, received, sent


def test_a_burst_is_taken_whole() -> None:
    """Messages of any size, more than a call takes and larger than its memory, come in order, whole and numbered."""
    rcl = Middleware(SIZES, end=401)
    subscription: Any = SimpleNamespace(handle=Handle())
    taker = BulkTaker(subscription, "/topic", rcl.function, taking._SerializedMessage())
    messages, numbers, received, sent = _all(taker.take)
    assert messages == rcl.messages
    assert numbers == list(range(7, 7 + len(SIZES)))
    assert received == list(range(1000, 1000 + len(SIZES)))
    assert sent == list(range(400, 400 + len(SIZES)))


def test_a_middleware_that_refuses_is_one_line() -> None:
    """What was taken before an error code is not handed out as if nothing were wrong."""
    rcl = Middleware([5], end=11)
    subscription: Any = SimpleNamespace(handle=Handle())
    taker = BulkTaker(subscription, "/topic", rcl.function, taking._SerializedMessage())
    with pytest.raises(BagError, match=r"^/topic: no message can be taken \(rcl says 11\)$"):
        taker.take()


@pytest.fixture
def node(ros_domain: int) -> Iterator[Node]:
    """Return a node in a domain of its own."""
    with own_node("taking", ros_domain) as node:
        yield node


@pytest.mark.ros
def test_all_ways_give_the_same(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    """From real subscriptions both ways give what was sent, gathered or not; a library that is missing is found out."""
    count = 1500
    publisher = node.create_publisher(JointState, "numbers", TICK_QOS.profile)
    subscriptions = [
        node.create_subscription(JointState, "numbers", lambda _: None, TICK_QOS.profile, raw=True) for _ in range(2)
    ]
    gathering = Gathering(0.002)
    assert all(gathering.include(subscription) for subscription in subscriptions)
    bulk, single = bulk_taker(subscriptions[0], "/numbers"), SingleTaker(subscriptions[1], JointState)
    assert bulk is not None
    wait_until(lambda: publisher.get_subscription_count() == 2, "the subscriptions")
    codec = JointStateCodec(["a", "b"])
    sent = [codec.encode(stamp, np.array([stamp, 1.0])) for stamp in range(count)]
    began = time.time_ns()
    for raw in sent:
        publisher.publish(raw)
    for take in (bulk.take, single.take):
        messages, numbers, received, sent_ns = [], [], [], []
        while len(messages) < count:
            more = _all(take)
            messages += more[0]
            numbers += more[1]
            received += more[2]
            sent_ns += more[3]
        assert messages == sent
        assert numbers == list(range(1, count + 1))
        assert received == sorted(received)
        assert sent_ns == sorted(sent_ns)
        assert began <= sent_ns[0]
        assert all(before <= after for before, after in zip(sent_ns, received, strict=True))
    assert 0 < gathering.pauses < count / 10

    def missing(_name: str) -> None:
        raise OSError

    monkeypatch.setattr(taking.ctypes, "CDLL", missing)
    assert bulk_taker(subscriptions[0], "/numbers") is None
