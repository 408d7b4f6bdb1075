"""Recorded topics: their subscriptions, and the counts that prove nothing was lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos

from rx90_common.bags.ordering import TimeSource
from rx90_common.bags.recorder.definition import begins_with_header, definition, message_class
from rx90_common.bags.recorder.sequence import SequenceCounter
from rx90_common.bags.recorder.taking import SingleTaker, Taken, Taker, bulk_taker
from rx90_common.bags.topics import CLOCK, JOINT_STATE, JOINT_TRAJECTORY, TRANSFORMS, tells_changes
from rx90_common.bags.trajectories import TrajectoryCount
from rx90_common.bags.writing import offered_qos, typestore
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import quoted
from rx90_common.exchange.arrivals import Gathering
from rx90_common.exchange.ros_start import reason

_DEPTH = 20_000  # messages that DDS keeps while this process does not run: 5 s at 4 kHz
_NEVER = 1 << 63  # ns
_PAUSE = 0.002  # s; what comes meanwhile at 30,000 messages a second fits into a socket as Linux makes it by default


class Streams:
    """The topics of a recording, in their order: those found so far, and the names of those still missing.

    Args:
        node: owner of the subscriptions.
        topics: names, relative or absolute.

    Attributes:
        trajectories: those that came, and those that controllers have accepted since all was ready.

    Raises:
        BagError: if ROS does not accept a name, or two are the same topic.
    """

    def __init__(self, node: Node, topics: Sequence[str]) -> None:
        self._node = node
        self._gathering = Gathering(_PAUSE)
        self._found: dict[str, Stream | None] = {}
        self.trajectories = TrajectoryCount()
        for topic in topics:
            try:
                name = node.resolve_topic_name(topic)
            except RuntimeError as error:
                raise BagError(f"topic {quoted(topic)}: no name that ROS accepts ({reason(error)})") from error
            if name in self._found:
                raise BagError(f"topic {name} stands twice; accepted: each topic once")
            self._found[name] = None

    def __iter__(self) -> Iterator[Stream]:
        return (stream for stream in self._found.values() if stream is not None)

    def discover(self, on_found: Callable[[Stream], None]) -> bool:
        """Subscribe to the topics that have appeared; return whether all are matched."""
        for index, (topic, stream) in enumerate(self._found.items()):
            if stream is None:
                # A topic that is only listened to, such as a controller's trajectories, has a type too; its
                # publishers come and go, and the first message must not be missed.
                endpoints = self._node.get_publishers_info_by_topic(topic)
                endpoints = endpoints or self._node.get_subscriptions_info_by_topic(topic)
                if endpoints:
                    found = self._found[topic] = Stream(
                        self._node, topic, index, endpoints, self._gathering, self.trajectories
                    )
                    on_found(found)
        return not self.missing()

    def missing(self) -> list[str]:
        """Return the topics that are not there, or whose publishers are not there or not matched yet."""
        return [
            topic
            for topic, stream in self._found.items()
            if stream is None
            or (not stream.matched() and (stream.needs_publisher or self._node.count_publishers(topic) > 0))
        ]

    def clear(self) -> None:
        """Give the subscriptions back."""
        self._found.clear()


class Stream:
    """A topic while it is recorded.

    Args:
        node: owner of the subscription.
        topic: absolute name.
        index: place in the list of topics.
        endpoints: the publishers in the ROS graph or, where there are none yet, the subscriptions.
        gathering: of all topics of the node.
        trajectories: counts those that come.

    Attributes:
        definition: the text of its type, if bags of this project do not know it; else empty.
        in_bulk: whether messages are taken many at a time.
        repeated: messages that were the one before them once more.
        sent_ns: when the message taken last was sent, by its publisher's wall clock.

    Raises:
        BagError: if the publishers disagree on the type, or it is not installed.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        index: int,
        endpoints: Sequence[Any],
        gathering: Gathering,
        trajectories: TrajectoryCount,
    ) -> None:
        self.topic = topic
        self._trajectories = trajectories
        self._ready_ns = _NEVER
        self.index = index
        self.msgtype = _one_type(topic, endpoints)
        kind = message_class(topic, self.msgtype)
        self.time_source = time_source(topic, self.msgtype, kind)
        known = typestore().fielddefs
        self.definition = "" if self.msgtype in known else definition(kind, known)
        profiles = [endpoint.qos_profile for endpoint in endpoints]
        reliable = all(p.reliability != ReliabilityPolicy.BEST_EFFORT for p in profiles)
        transient_local = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
        self._latched = transient_local
        self.qos: Qos = offered_qos(reliable=reliable, transient_local=transient_local)
        self.subscription = node.create_subscription(
            kind,
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
        gathering.include(self.subscription)
        bulk = bulk_taker(self.subscription, topic)
        self.in_bulk = bulk is not None
        self._taker: Taker = bulk or SingleTaker(self.subscription, kind)
        kinds = QoSSubscriptionEventType
        self._matched = self._event(kinds.RCL_SUBSCRIPTION_MATCHED)
        self._message_lost = self._event(kinds.RCL_SUBSCRIPTION_MESSAGE_LOST)
        self._incompatible = self._event(kinds.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS)
        self.counter = SequenceCounter(self.matched, transient_local=transient_local)
        self.repeated = 0
        self.sent_ns = 0
        self._dated = self.msgtype in (JOINT_STATE, CLOCK)
        self._newest = b""

    @property
    def needs_publisher(self) -> bool:
        """Return whether the topic is the steady output of a node, not a command that somebody sends at times."""
        return self.time_source is TimeSource.CLOCK or self._latched

    def start(self) -> None:
        """From now on nothing may be missing that anybody sends."""
        self.counter.start()
        self._ready_ns = time.time_ns()

    def take(self) -> Taken:
        """Return messages that have come, counted, not more than some hundred; none if there are none.

        Raises:
            BagError: if the middleware refuses.
        """
        taken = self._taker.take()
        self.counter.add_many(taken.numbers)
        if len(taken.sent_ns):
            self.sent_ns = int(taken.sent_ns[-1])
        if self.msgtype == JOINT_TRAJECTORY:
            self._count_trajectories(taken)
        return self._without_repetitions(taken) if self._dated and len(taken.messages) else taken

    def _count_trajectories(self, taken: Taken) -> None:
        for message, sent_ns in zip(taken.messages, taken.sent_ns.tolist(), strict=True):
            if not self._latched or sent_ns >= self._ready_ns:  # else it was accepted before the recording
                with suppress(Exception):  # rosbags has no error of its own for bytes that are no message
                    self._trajectories.add(self.topic, typestore().deserialize_cdr(message, self.msgtype))

    def _without_repetitions(self, taken: Taken) -> Taken:
        """Leave out, and count, messages that are the one before them once more, to the bit, stamp included.

        Nodes send one again while time stands still, and where it may have been lost: it is no second sample.
        """
        messages = taken.messages
        again = messages.repeats(self._newest)
        self._newest = messages[len(messages) - 1]
        if not again.any():
            return taken
        self.repeated += int(again.sum())
        kept = np.flatnonzero(~again)
        return Taken(messages.take(kept), taken.numbers[kept], taken.received_ns[kept], taken.sent_ns[kept])

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


def time_source(topic: str, msgtype: str, kind: Any) -> TimeSource:
    """Return where a topic's messages, of a class, have their log time from."""
    if msgtype == JOINT_STATE:
        return TimeSource.CLOCK
    if tells_changes(topic, msgtype) or begins_with_header(kind):
        return TimeSource.STAMP
    return TimeSource.LIST if msgtype == TRANSFORMS else TimeSource.NEWEST


def _one_type(topic: str, endpoints: Sequence[Any]) -> str:
    types = sorted({str(endpoint.topic_type) for endpoint in endpoints})
    if len(types) > 1:
        raise BagError(f"{topic} is published with the types {', '.join(types)}; accepted: one type")
    return types[0]


def _never_called(_: bytes) -> None:
    """Stand where rclpy wants a callback; the message reader reads by itself."""
