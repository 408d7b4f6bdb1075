"""Recorded topics: their subscriptions, their types, and the counts that show whether messages were lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import compress, pairwise
from typing import Any, NamedTuple

import numpy as np
from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import QosDurability, QosReliability

from rx90_common.bags.joint_series import Int64Array
from rx90_common.bags.ordering import HEADER_STAMP, LIST_STAMP, Arrived, Source
from rx90_common.bags.topics import CLOCK, JOINT_STATE, TRANSFORMS, reports_changes
from rx90_common.bags.writing import offered_qos
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import quoted
from rx90_common.exchange.arrivals import ReceiveBatching
from rx90_common.exchange.message_types import message_class, types_with
from rx90_common.exchange.ros_start import reason

_DEPTH = 20_000  # messages that DDS keeps while this process does not run: 5 s at 4 kHz
# s; the messages in it at 30,000 per second fit into a socket with Linux' default size
_PAUSE = 0.002
_HEADER = "std_msgs/Header"


@dataclass
class WriterCount:
    """What came from one writer: its last sequence number, messages received and missed."""

    last: int
    received: int = 0
    lost: int = 0


class TopicCount(NamedTuple):
    """What was recorded of a topic.

    Attributes:
        topic: absolute name.
        writers: messages by publisher.
        repeated: messages received that are not in the bag, as they repeat the one before.
        refused: publishers whose quality of service does not fit the first one's.
    """

    topic: str
    writers: tuple[WriterCount, ...] = ()
    repeated: int = 0
    refused: int = 0

    @property
    def received(self) -> int:
        """Return how many messages were received."""
        return sum(writer.received for writer in self.writers)

    @property
    def lost(self) -> int:
        """Return how many messages were sent and not received."""
        return sum(writer.lost for writer in self.writers)


class SequenceCounter:
    """Counts the messages of one topic per writer.

    A message names its sequence number but not its writer. Every writer counts its own messages from 1 and
    leaves no gap. A number that continues no writer's count is therefore the first one received of a new writer, as
    long as fewer writers are known than were matched, or else proof of a loss.

    Args:
        matched: returns how many writers were ever matched.
        transient_local: a writer's first message may have any number, as it keeps only the newest ones.
    """

    def __init__(self, matched: Callable[[], int], *, transient_local: bool) -> None:
        self.writers: list[WriterCount] = []
        self._matched = matched
        self._transient_local = transient_local
        self._known_before: int | None = None  # writers at the start

    def start(self) -> None:
        """From now on all messages of a new writer must be received, from its first on."""
        self._known_before = None if self._transient_local else self._matched()

    def add(self, numbers: Int64Array) -> None:
        """Count messages with these sequence numbers, in this order, at least one."""
        for run in np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1):
            writer = self._writer_before(int(run[0]))
            writer.lost += int(run[0]) - writer.last - 1
            writer.last = int(run[-1])
            writer.received += len(run)

    def _writer_before(self, number: int) -> WriterCount:
        """Return the writer whose count `number` continues, a new one or, after a loss, the one nearest to it."""
        # the latest may be a restart
        behind = [writer for writer in reversed(self.writers) if writer.last < number]
        nearest = max(behind, key=lambda writer: writer.last, default=None)
        if nearest is not None and (
            nearest.last + 1 == number or (number > 1 and len(self.writers) >= self._matched())
        ):
            return nearest
        late = self._known_before is not None and len(self.writers) >= self._known_before
        self.writers.append(WriterCount(0 if late else number - 1))
        return self.writers[-1]


class Streams:
    """The topics of a recording, in their order: those found so far, and the names of those still missing.

    Args:
        node: owner of the subscriptions.
        topics: names, relative or absolute.
    """

    def __init__(self, node: Node, topics: Sequence[str]) -> None:
        self._node = node
        self._batching = ReceiveBatching(_PAUSE)
        self._found: dict[str, Stream | None] = {}
        for topic in topics:
            try:
                name = node.resolve_topic_name(topic)
            except RuntimeError as error:
                raise BagError(
                    f"topic {quoted(topic)}: no name that ROS accepts ({reason(error)})"
                ) from error
            if name in self._found:
                raise BagError(f"topic {name} stands twice; accepted: each topic once")
            self._found[name] = None

    def __iter__(self) -> Iterator[Stream]:
        return (stream for stream in self._found.values() if stream is not None)

    def discover(self) -> bool:
        """Subscribe to the topics that have appeared; return whether all are matched."""
        for place, (topic, stream) in enumerate(self._found.items()):
            if stream is not None:
                continue
            # A topic that is only listened to, such as a controller's trajectories, has a type too; its
            # publishers come and go, and the first message must not be missed.
            publishers = self._node.get_publishers_info_by_topic(topic)
            endpoints = publishers or self._node.get_subscriptions_info_by_topic(topic)
            if endpoints:
                added = Stream(self._node, topic, place, endpoints, published=bool(publishers))
                self._batching.include(added.subscription)
                self._found[topic] = added
        return not self.missing()

    def missing(self) -> list[str]:
        """Return the topics that are not there, or whose publishers are not there or not matched yet."""
        return [
            topic
            for topic, stream in self._found.items()
            if stream is None
            or (
                not stream.matched()
                and (stream.needs_publisher or self._node.count_publishers(topic) > 0)
            )
        ]

    def counts(self) -> list[TopicCount]:
        """Return what was recorded of each topic."""
        return [
            TopicCount(topic) if stream is None else stream.count()
            for topic, stream in self._found.items()
        ]

    def clear(self) -> None:
        """Give the subscriptions back."""
        self._found.clear()


class Stream:
    """A topic while it is recorded.

    Args:
        node: owner of the subscription.
        topic: absolute name.
        place: in the list of topics.
        endpoints: the publishers in the ROS graph or, where there are none yet, the subscriptions.
        published: `endpoints` are publishers. Of a topic that is only listened to, every message is asked for: a
            listener that may miss some says nothing about the publisher, which may only not be known yet.

    Attributes:
        msgtype: name of the type of its messages.
        types: knows this type.
        source: of the log time of its messages.
        qos: quality of service that its publishers offer.
        counter: of its messages.
        number: in the bag, once it is announced there.
        repeated: messages that repeated the one before.
        sent_ns: time at which the newest message was sent, by its publisher's wall clock.
        taken_at: when messages were taken last, s, by a clock that is never set.
    """

    def __init__(
        self, node: Node, topic: str, place: int, endpoints: Sequence[Any], *, published: bool
    ) -> None:
        self.topic = topic
        types = sorted({str(endpoint.topic_type) for endpoint in endpoints})
        if len(types) > 1:
            raise BagError(
                f"{topic} is published with the types {', '.join(types)}; accepted: one type"
            )
        self.msgtype = types[0]
        self._kind = message_class(topic, self.msgtype)
        self.types = types_with(self.msgtype)
        qos = QoSProfile(depth=_DEPTH)  # reliable and volatile
        profiles = [endpoint.qos_profile for endpoint in endpoints]
        if published and any(p.reliability == ReliabilityPolicy.BEST_EFFORT for p in profiles):
            qos.reliability = ReliabilityPolicy.BEST_EFFORT
        latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self.source = Source(place, self._stamp_at(), self.msgtype == JOINT_STATE, latched)
        # rosbags has the numbers of rmw, as rclpy.
        self.qos = offered_qos(QosReliability(qos.reliability), QosDurability(qos.durability))
        self.subscription = node.create_subscription(
            self._kind,
            topic,
            lambda _: None,  # the recorder takes the messages by itself
            qos,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        self._matched = self._event(QoSSubscriptionEventType.RCL_SUBSCRIPTION_MATCHED)
        self._incompatible = self._event(
            QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS
        )
        self.counter = SequenceCounter(self.matched, transient_local=latched)
        self.number: int | None = None
        self.repeated = 0
        self.sent_ns = 0
        self.taken_at = 0.0
        self._newest = b""

    def _stamp_at(self) -> int | None:
        fields = [*self._kind.get_fields_and_field_types().values()]
        if self.msgtype == TRANSFORMS:
            return LIST_STAMP
        if reports_changes(self.topic, self.msgtype) or fields[:1] == [_HEADER]:
            return HEADER_STAMP
        return None

    def _event(self, kind: QoSSubscriptionEventType) -> Any:
        return rclpy_implementation.EventHandle(self.subscription.handle, kind)

    @property
    def needs_publisher(self) -> bool:
        """Return whether the topic is the steady output of a node, not a command that somebody sends at times."""
        return self.source.gives_time or self.source.latched

    def take(self) -> Arrived:
        """Return the messages that have come, counted."""
        taken: list[tuple[bytes, dict[str, int]]] = []
        handle: Any = self.subscription.handle
        with handle:
            while (
                len(taken) < _DEPTH
                and (message := handle.take_message(self._kind, True)) is not None
            ):
                taken.append(message)
        received_ns = np.array([info["received_timestamp"] for _, info in taken], dtype=np.int64)
        messages = [raw for raw, _ in taken]
        if taken:
            self.taken_at = time.monotonic()
            self.sent_ns = taken[-1][1]["source_timestamp"]
            self.counter.add(np.array([info["publication_sequence_number"] for _, info in taken]))
        if self.msgtype in (JOINT_STATE, CLOCK) and taken:
            # Nodes repeat a message while time stands still, and when it may have been lost: it is no second sample.
            new = [before != message for before, message in pairwise([self._newest, *messages])]
            self._newest = messages[-1]
            self.repeated += new.count(False)
            messages = [*compress(messages, new)]
            received_ns = received_ns[new]
        return Arrived(self.source, messages, received_ns)

    def matched(self) -> int:
        """Return how many publishers were ever matched."""
        return _total(self._matched)

    def count(self) -> TopicCount:
        """Return what was recorded."""
        return TopicCount(
            self.topic, tuple(self.counter.writers), self.repeated, _total(self._incompatible)
        )


def _total(event: Any) -> int:
    with event:
        return int(event.take_event().total_count)
