"""The run of a recorder: find the topics, take, order and write their messages, and account for every one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import Event
from typing import Final

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rosbags.interfaces import Connection

from rx90_common.bags.ordering import Entry, LogOrder, TimeSource
from rx90_common.bags.recorder.message_reader import Taker
from rx90_common.bags.recorder.sequence import WriterCount
from rx90_common.bags.recorder.stream import Stream
from rx90_common.bags.writing import BagWriter
from rx90_common.base.errors import BagError, ConfigError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.ros_start import reason, start_ros

READY: Final = "ready: all"
"""How the line begins that says that every topic is matched."""

_CYCLE_S = 0.02
_ANNOUNCE_WAIT_S = 1.0
_SETTLE_S = 0.3  # a publisher learns of its match a moment after the recorder does
_LONGEST_STALL_S = 4.0  # below the lease in config/dds, after which a publisher forgets this process
_MAX_HELD_BYTES = 64 << 20  # while topics are still missing


@dataclass(frozen=True)
class TopicCount:
    """What was recorded of a topic."""

    topic: str
    received: int
    lost: int
    refused: int
    writers: tuple[WriterCount, ...]


@dataclass(frozen=True)
class Progress:
    """Where a recording stands."""

    received: int
    newest_ns: int | None


class Recorder:
    """Records topics to a new bag until it is told to stop.

    Args:
        topics: names, relative or absolute, each once.
        ros_args: arguments after --ros-args (namespace, remappings).
        say: prints a line for the user.
        show: shows the progress, called some times per second.

    Attributes:
        stalls: times, s, in which this process did not run and which publishers may have taken for its end: what they
            sent then, and how much, is not known here.
    """

    def __init__(
        self,
        topics: Sequence[str],
        ros_args: Sequence[str],
        say: Callable[[str], None],
        show: Callable[[Progress], None],
    ) -> None:
        self._names = topics
        self._topics: list[str] = []
        self._ros_args = ros_args
        self._say = say
        self._show = show
        self._streams: dict[str, Stream] = {}
        self._connections: dict[int, Connection] = {}
        self._order = LogOrder()
        self._received = 0
        self._told = 0
        self.stalls: list[float] = []

    def run(self, make_writer: Callable[[], BagWriter], stop: Event) -> list[TopicCount]:
        """Record until `stop` is set; the bag is made once the topics' names are known to be good.

        Raises:
            BagError: if a topic cannot be recorded or the bag cannot be written.
        """
        context = Context()
        try:
            node = self._make_node(context)
            taker = Taker(context)
            taker.start()
            try:
                with make_writer() as writer:
                    self._record(node, taker, writer, stop)
                return self._count()
            finally:
                taker.finish()
                self._streams.clear()
                node.destroy_node()
        finally:
            context.try_shutdown()

    def _make_node(self, context: Context) -> Node:
        try:
            start_ros(["--ros-args", *self._ros_args] if self._ros_args else [], context)
        except ConfigError as error:
            raise BagError(str(error)) from error
        node = rclpy.create_node(
            "rx90_bag_recorder", context=context, enable_rosout=False, start_parameter_services=False
        )
        for topic in self._names:
            try:
                self._topics.append(node.resolve_topic_name(topic))
            except RuntimeError as error:
                raise BagError(f"topic {topic!r}: no name that ROS accepts ({reason(error)})") from error
        repeated = [topic for topic in self._topics if self._topics.count(topic) > 1]
        if repeated:
            raise BagError(f"topic {repeated[0]} stands twice; accepted: each topic once")
        return node

    def _record(self, node: Node, taker: Taker, writer: BagWriter, stop: Event) -> None:
        start = last = time.monotonic()
        matched_at = math.inf
        ready = said = False
        while not stop.is_set():
            now = time.monotonic()
            last = self._note_stall(last)
            if math.isinf(matched_at) and self._discover(node, taker):
                matched_at = now
            if not ready and now > matched_at + _SETTLE_S:
                ready = True
                self._announce(writer)
            if not said and math.isinf(matched_at) and now > start + _ANNOUNCE_WAIT_S:
                said = True
                self._say(f"waiting for {', '.join(self._missing(node))}")
            self._order_all(taker)
            if ready or self._order.held_bytes > _MAX_HELD_BYTES:
                self._write(writer, self._order.release())
            self._tell_set_backs()
            self._show(Progress(self._received, self._order.newest_ns))
            stop.wait(_CYCLE_S)
        self._note_stall(last)
        taker.finish()
        self._order_all(taker)
        self._connect(writer)
        self._write(writer, self._order.release_all())

    def _discover(self, node: Node, taker: Taker) -> bool:
        """Subscribe to the topics that have appeared; return whether all are matched."""
        for index, topic in enumerate(self._topics):
            if topic in self._streams:
                continue
            # A topic that is only listened to, such as a controller's trajectories, has a type too; its
            # publishers come and go, and the first message must not be missed.
            endpoints = node.get_publishers_info_by_topic(topic) or node.get_subscriptions_info_by_topic(topic)
            if endpoints:
                self._streams[topic] = Stream(node, topic, index, endpoints)
                taker.add(self._streams[topic])
        return not self._missing(node)

    def _missing(self, node: Node) -> list[str]:
        """Return the topics that are not there, or whose publishers are not there or not matched yet."""
        streams = {topic: self._streams.get(topic) for topic in self._topics}
        return [
            topic
            for topic, stream in streams.items()
            if stream is None or (not stream.matched() and (stream.needs_publisher or node.count_publishers(topic) > 0))
        ]

    def _announce(self, writer: BagWriter) -> None:
        for stream in self._streams.values():
            stream.counter.start()
        if all(stream.time_source is not TimeSource.CLOCK for stream in self._streams.values()):
            self._order.expect_no_clock()
        self._say(f"{READY} {len(self._topics)} topics are matched, recording to {writer.path}")

    def _order_all(self, taker: Taker) -> None:
        taken = taker.collect()
        self._received += len(taken)
        for stream, cdr, received_ns in taken:
            self._order.add(stream.index, stream.time_source, cdr, received_ns)

    def _note_stall(self, last: float) -> float:
        """Note a long time since `last` on the steady clock; return the time now."""
        now = time.monotonic()
        if now - last > _LONGEST_STALL_S:
            self.stalls.append(now - last)
        return now

    def _tell_set_backs(self) -> None:
        for before, after in self._order.set_backs[self._told :]:
            self._told += 1
            self._say(
                f"time goes back from {before / NANOSECONDS:.6g} s to {after / NANOSECONDS:.6g} s: the bag holds more than "
                "one run, and its log time goes on"
            )

    def _connect(self, writer: BagWriter) -> None:
        """Announce to the bag the topics found since the last call, in their order."""
        for stream in sorted(self._streams.values(), key=lambda stream: stream.index):
            if stream.index not in self._connections:
                self._connections[stream.index] = writer.add_topic(stream.topic, stream.msgtype, [stream.qos])

    def _write(self, writer: BagWriter, entries: Sequence[Entry]) -> None:
        if len(self._connections) < len(self._streams) and entries:
            self._connect(writer)
        for log_ns, index, _, cdr in entries:
            writer.write(self._connections[index], log_ns, cdr)

    def _count(self) -> list[TopicCount]:
        return [
            TopicCount(
                stream.topic,
                stream.counter.received,
                stream.lost(),
                stream.refused(),
                tuple(stream.counter.writers),
            )
            for stream in self._streams.values()
        ]
