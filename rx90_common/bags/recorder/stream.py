"""Recorded topics: their subscriptions, their types, and the counts that show whether messages were lost."""

from __future__ import annotations

import importlib
import re
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import compress, pairwise
from typing import Any

import numpy as np
from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos

from rx90_common.bags.joint_series import Int64Array
from rx90_common.bags.ordering import Arrived, TimeSource
from rx90_common.bags.topics import CLOCK, JOINT_STATE, JOINT_TRAJECTORY, TRANSFORMS, reports_changes
from rx90_common.bags.writing import offered_qos, typestore
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import quoted
from rx90_common.base.requirements import missing_module
from rx90_common.exchange.arrivals import ReceiveBatching
from rx90_common.exchange.ros_start import reason
from rx90_common.exchange.topics import COMMANDED_TRAJECTORY, OF_ACTION, TRAJECTORY_ACCEPTED

_DEPTH = 20_000  # messages that DDS keeps while this process does not run: 5 s at 4 kHz
_NEVER = 1 << 63  # ns
_PAUSE = 0.002  # s; the messages in it at 30,000 per second fit into a socket with Linux' default size
_MAX_BATCH = 512  # messages of a take
_HEADER = "std_msgs/Header"
_INFO = ("publication_sequence_number", "received_timestamp", "source_timestamp")
_BASE = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
"""What .msg files call the types that the classes name as IDL does."""
_SEQUENCE = re.compile(r"sequence<(?P<kind>.+?)(, (?P<most>\d+))?>")
_ARRAY = re.compile(r"(?P<kind>.+)\[(?P<count>\d+)\]")
_STRING = re.compile(r"(?P<kind>w?string)<(?P<most>\d+)>")


@dataclass
class WriterCount:
    """What came from one writer: its last sequence number, messages received and missed."""

    last: int
    received: int = 0
    lost: int = 0


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
        self._current: WriterCount | None = None

    @property
    def received(self) -> int:
        """Return how many messages were received."""
        return sum(writer.received for writer in self.writers)

    @property
    def lost(self) -> int:
        """Return how many messages were sent and not received."""
        return sum(writer.lost for writer in self.writers)

    def start(self) -> None:
        """From now on all messages of a new writer must be received, from its first on."""
        self._known_before = None if self._transient_local else self._matched()

    def add(self, numbers: Int64Array) -> None:
        """Count messages with these sequence numbers, in this order."""
        for run in np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1) if len(numbers) else ():
            first = int(run[0])
            if self._current is None or first != self._current.last + 1:
                self._current = self._writer_of(first)
            self._current.last = int(run[-1])
            self._current.received += len(run)

    def _writer_of(self, number: int) -> WriterCount:
        """Return the writer whose count `number` continues, a new one or, after a loss, the one nearest to it."""
        behind = [writer for writer in self.writers if writer.last < number]
        nearest = max(behind, key=lambda writer: writer.last, default=None)
        if nearest is not None and nearest.last + 1 == number:
            return nearest
        if number == 1 or nearest is None or len(self.writers) < self._matched():
            late = self._known_before is not None and len(self.writers) >= self._known_before
            self.writers.append(WriterCount(number, lost=number - 1 if late else 0))
            return self.writers[-1]
        nearest.lost += number - nearest.last - 1
        return nearest


class TrajectoryCount:
    """Compares the trajectories that controllers accepted with those that arrived on their topics.

    A sender of one trajectory may end before it has discovered the recorder; the controller has received
    the trajectory, publishes it latched, and its copy is used here.
    """

    def __init__(self) -> None:
        self._missing: Counter[tuple[str, bytes]] = Counter()  # accepted less came, by controller and content
        types = typestore().types
        self._no_header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")

    def add(self, topic: str, raw: bytes) -> None:
        """Count a JointTrajectory of any topic."""
        message: Any = typestore().deserialize_cdr(raw, JOINT_TRAJECTORY)
        controller, _, name = topic.rpartition("/")
        accepted = name == TRAJECTORY_ACCEPTED and message.header.frame_id != OF_ACTION
        if accepted or name == COMMANDED_TRAJECTORY:
            content = bytes(typestore().serialize_cdr(replace(message, header=self._no_header), JOINT_TRAJECTORY))
            self._missing[controller, content] += 1 if accepted else -1

    def missing(self, topics: Collection[str]) -> dict[str, int]:
        """Return how many trajectories did not come, by the topic that they were sent on, of those that are given."""
        counts: Counter[str] = Counter()
        for (controller, _), count in (+self._missing).items():
            counts[f"{controller}/{COMMANDED_TRAJECTORY}"] += count
        return {topic: count for topic, count in counts.items() if topic in topics}


class Streams:
    """The topics of a recording, in their order: those found so far, and the names of those still missing.

    Args:
        node: owner of the subscriptions.
        topics: names, relative or absolute.

    Attributes:
        trajectories: those that came, and those that controllers have accepted since all was ready.
    """

    def __init__(self, node: Node, topics: Sequence[str]) -> None:
        self._node = node
        self._batching = ReceiveBatching(_PAUSE)
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
                publishers = self._node.get_publishers_info_by_topic(topic)
                endpoints = publishers or self._node.get_subscriptions_info_by_topic(topic)
                if endpoints:
                    found = self._found[topic] = Stream(
                        self._node, topic, index, endpoints, self.trajectories, published=bool(publishers)
                    )
                    self._batching.include(found.subscription)
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

    def empty(self) -> list[str]:
        """Return the topics of which no message has come."""
        return [topic for topic, stream in self._found.items() if stream is None or not stream.counter.received]

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
        trajectories: counts those that come.
        published: `endpoints` are publishers. Of a topic that is only listened to, every message is asked for: a
            listener that may miss some says nothing about the publisher, which may only not be known yet.

    Attributes:
        definition: the text of its type, if readers of this project do not know it; else empty.
        repeated: messages that repeated the one before.
        sent_ns: time at which the newest message was sent, by its publisher's wall clock.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        index: int,
        endpoints: Sequence[Any],
        trajectories: TrajectoryCount,
        *,
        published: bool,
    ) -> None:
        self.topic = topic
        self.index = index
        self._trajectories = trajectories
        types = sorted({str(endpoint.topic_type) for endpoint in endpoints})
        if len(types) > 1:
            raise BagError(f"{topic} is published with the types {', '.join(types)}; accepted: one type")
        self.msgtype = types[0]
        kind = self._kind = message_class(topic, self.msgtype)
        self.time_source = TimeSource.LIST if self.msgtype == TRANSFORMS else TimeSource.NEWEST
        if self.msgtype == JOINT_STATE:
            self.time_source = TimeSource.CLOCK
        elif reports_changes(topic, self.msgtype) or [*kind.get_fields_and_field_types().values()][:1] == [_HEADER]:
            self.time_source = TimeSource.STAMP
        known = typestore().fielddefs
        self.definition = "" if self.msgtype in known else definition(kind, known)
        profiles = [endpoint.qos_profile for endpoint in endpoints]
        reliable = not published or all(p.reliability != ReliabilityPolicy.BEST_EFFORT for p in profiles)
        self._latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
        self.qos: Qos = offered_qos(reliable=reliable, transient_local=self._latched)
        self.subscription = node.create_subscription(
            kind,
            topic,
            lambda _: None,  # the message reader reads by itself
            QoSProfile(
                depth=_DEPTH,
                reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if self._latched else DurabilityPolicy.VOLATILE,
            ),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        kinds = QoSSubscriptionEventType
        self._matched, self._message_lost, self._incompatible = (
            rclpy_implementation.EventHandle(self.subscription.handle, event)
            for event in (
                kinds.RCL_SUBSCRIPTION_MATCHED,
                kinds.RCL_SUBSCRIPTION_MESSAGE_LOST,
                kinds.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
            )
        )
        self.counter = SequenceCounter(self.matched, transient_local=self._latched)
        self.repeated = self.sent_ns = 0
        self._ready_ns = _NEVER
        self._newest = b""

    @property
    def needs_publisher(self) -> bool:
        """Return whether the topic is the steady output of a node, not a command that somebody sends at times."""
        return self.time_source is TimeSource.CLOCK or self._latched

    def start(self) -> None:
        """From now on nothing may be missing that anybody sends."""
        self.counter.start()
        self._ready_ns = time.time_ns()

    def take(self) -> Arrived:
        """Return messages that have come, counted, not more than some hundred; none if there are none."""
        found: list[tuple[bytes, dict[str, int]]] = []
        handle: Any = self.subscription.handle
        with handle:
            while len(found) < _MAX_BATCH and (message := handle.take_message(self._kind, True)) is not None:
                found.append(message)
        numbers, received_ns, sent_ns = (np.array([info[name] for _, info in found], dtype=np.int64) for name in _INFO)
        self.counter.add(numbers)
        messages = [raw for raw, _ in found]
        if not found:
            return Arrived(self.index, self.time_source, messages, received_ns)
        self.sent_ns = int(sent_ns[-1])
        for message, info in found if self.msgtype == JOINT_TRAJECTORY else ():
            if not self._latched or info["source_timestamp"] >= self._ready_ns:  # else accepted before the recording
                with suppress(Exception):  # rosbags has no error of its own for bytes that are no message
                    self._trajectories.add(self.topic, message)
        if self.msgtype in (JOINT_STATE, CLOCK):
            # Nodes repeat a message while time stands still, and when it may have been lost: it is no second sample.
            new = [before != message for before, message in pairwise([self._newest, *messages])]
            self._newest = messages[-1]
            self.repeated += new.count(False)
            messages = [*compress(messages, new)]
            received_ns = received_ns[new]
            sent_ns = sent_ns[new]
        return Arrived(self.index, self.time_source, messages, received_ns, sent_ns if self._latched else None)

    def matched(self) -> int:
        """Return how many publishers were ever matched."""
        return _total(self._matched)

    def refused(self) -> int:
        """Return how many publishers offer a quality of service that does not fit the first one's."""
        return _total(self._incompatible)

    def lost(self) -> int:
        """Return the number of lost messages, from their sequence numbers and from the middleware's reports.

        The first also contain messages dropped on this side, the second also the end of a topic.
        """
        return max(self.counter.lost, _total(self._message_lost))


def _total(event: Any) -> int:
    with event:
        return int(event.take_event().total_count)


def message_class(topic: str, msgtype: str) -> Any:
    """Return the class of a message type."""
    package, _, name = msgtype.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ImportError as error:
        raise BagError(f"{topic} has type {msgtype}: {missing_module(error) or error}") from error
    except AttributeError as error:
        raise BagError(f"{topic} has type {msgtype}, which the {package} that is installed does not have") from error


def definition(kind: Any, known: Collection[str]) -> str:
    """Return the text of a message class, and of its parts, in the form that rosbag2 writes to bags.

    Constants, defaults and comments are left out: messages do not contain them.

    Args:
        kind: the class.
        known: types whose text is not needed.
    """
    texts: dict[str, str] = {}

    def collect(kind: Any) -> None:
        name = f"{kind.__module__.split('.')[0]}/{kind.__name__}"
        if name in texts:
            return
        fields = kind.get_fields_and_field_types()
        texts[name] = "".join(f"{_field_type(described)} {field}\n" for field, described in fields.items())
        for described in fields.values():
            package, slash, inner = re.split(r"\[|<=", _field_type(described))[0].partition("/")
            if slash and f"{package}/msg/{inner}" not in known:
                collect(message_class(name, f"{package}/msg/{inner}"))

    collect(kind)
    own, *others = texts.items()
    return own[1] + "".join(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in others)


def _field_type(described: str) -> str:
    """Return the type of a field as .msg files have it."""
    if found := _SEQUENCE.fullmatch(described):
        return f"{_field_type(found['kind'])}[{'<=' + found['most'] if found['most'] else ''}]"
    if found := _ARRAY.fullmatch(described):
        return f"{_field_type(found['kind'])}[{found['count']}]"
    if found := _STRING.fullmatch(described):
        return f"{found['kind']}<={found['most']}"
    return _BASE.get(described, described)
