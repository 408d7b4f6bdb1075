"""One recorded topic: its subscription, and the counts that prove nothing was lost."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos

from rx90_common.bags.ordering import TimeSource
from rx90_common.bags.recorder.sequence import SequenceCounter
from rx90_common.bags.topics import JOINT_STATE
from rx90_common.bags.writing import offered_qos, typestore
from rx90_common.base.errors import BagError

_DEPTH = 20_000  # messages that DDS keeps while this process does not run: 5 s at 4 kHz
_HEADER = "std_msgs/msg/Header"


class Stream:
    """A topic while it is recorded.

    Args:
        node: owner of the subscription.
        topic: absolute name.
        index: place in the list of topics.
        endpoints: what the graph says of the publishers or, where there are none yet, of the subscriptions.

    Raises:
        BagError: if the publishers disagree on the type, or it is not installed.
    """

    def __init__(self, node: Node, topic: str, index: int, endpoints: Sequence[Any]) -> None:
        self.topic = topic
        self.index = index
        self.msgtype = _one_type(topic, endpoints)
        self.time_source = time_source(self.msgtype)
        self.message_class = _message_class(topic, self.msgtype)
        profiles = [endpoint.qos_profile for endpoint in endpoints]
        reliable = all(p.reliability != ReliabilityPolicy.BEST_EFFORT for p in profiles)
        transient_local = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
        self._latched = transient_local
        self.qos: Qos = offered_qos(reliable=reliable, transient_local=transient_local)
        self.subscription = node.create_subscription(
            self.message_class,
            topic,
            _never_called,
            QoSProfile(
                depth=_DEPTH,
                reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if transient_local else DurabilityPolicy.VOLATILE,
            ),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        kinds = QoSSubscriptionEventType
        self._matched = self._event(kinds.RCL_SUBSCRIPTION_MATCHED)
        self._message_lost = self._event(kinds.RCL_SUBSCRIPTION_MESSAGE_LOST)
        self._incompatible = self._event(kinds.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS)
        self.counter = SequenceCounter(self.matched, transient_local=transient_local)

    @property
    def needs_publisher(self) -> bool:
        """Return whether the topic is the steady output of a node, not a command that somebody sends at times."""
        return self.time_source is TimeSource.CLOCK or self._latched

    def matched(self) -> int:
        """Return how many publishers were ever matched."""
        return self._total(self._matched)

    def refused(self) -> int:
        """Return how many publishers offer a quality of service that does not fit the first one's."""
        return self._total(self._incompatible)

    def lost(self) -> int:
        """Return how many messages were lost, by their sequence numbers and by what the middleware noticed.

        The first also sees what this side dropped, the second also sees the end of a topic.
        """
        return max(self.counter.lost, self._total(self._message_lost))

    def _event(self, kind: Any) -> Any:
        return rclpy_implementation.EventHandle(self.subscription.handle, kind)

    @staticmethod
    def _total(event: Any) -> int:
        with event:
            return int(event.take_event().total_count)


def time_source(msgtype: str) -> TimeSource:
    """Return where messages of this type have their log time from."""
    if msgtype == JOINT_STATE:
        return TimeSource.CLOCK
    _, fields = typestore().fielddefs.get(msgtype, ((), ()))
    first = fields[0][1][1] if fields else None
    return TimeSource.STAMP if first == _HEADER else TimeSource.NEWEST


def _one_type(topic: str, endpoints: Sequence[Any]) -> str:
    types = sorted({str(endpoint.topic_type) for endpoint in endpoints})
    if len(types) > 1:
        raise BagError(f"{topic} is published with the types {', '.join(types)}; accepted: one type")
    return types[0]


def _message_class(topic: str, msgtype: str) -> Any:
    package, _, name = msgtype.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise BagError(f"{topic} has type {msgtype}, which is not installed ({error})") from error


def _never_called(_: bytes) -> None:
    """Stand where rclpy wants a callback; messages are taken by hand."""
