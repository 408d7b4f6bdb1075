"""The run of a recorder: find the topics, read, order and write their messages, and count each."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np
import rclpy
from rclpy.context import Context

from rx90_common.bags.ordering import Dated, LogOrder
from rx90_common.bags.recorder.stream import Stream, Streams, TopicCount
from rx90_common.bags.writing import BagWriter
from rx90_common.base.quoting import counted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.ros_start import start_ros
from rx90_common.process.interrupts import StopRequest

_CYCLE_S = 0.1  # gathers some thousand messages: a round has a cost of its own, whatever it brings
_ANNOUNCE_WAIT_S = 1.0
_SETTLE_S = 0.3  # a publisher learns of its match a moment after the recorder does
_MAX_HELD_BYTES = 64 << 20  # while topics are still missing
_LEAST_DRAIN_S = 0.2
# without a message after the stop request: a lost one is sent again after some heartbeats
_QUIET_S = 1.0
_MAX_DRAIN_S = 5.0


def record(
    topics: Sequence[str],
    ros_args: Sequence[str],
    make_writer: Callable[[], BagWriter],
    stop: StopRequest,
) -> list[TopicCount]:
    """Record topics to a new bag until `stop` is set; return what was recorded of each.

    Args:
        topics: names, relative or absolute, each once.
        ros_args: --ros-args and what follows it (namespace, remappings), or nothing.
        make_writer: makes the bag, once the topics' names are known to be good.
        stop: ends the recording.

    Raises:
        BagWriteError: if the bag cannot be written on.
    """
    context = Context()
    try:
        start_ros(ros_args, context)
        node = rclpy.create_node(
            "rx90_bag_recorder",
            context=context,
            enable_rosout=False,
            start_parameter_services=False,
        )
        streams = Streams(node, topics)
        try:
            with make_writer() as writer:
                order = LogOrder()
                _record(streams, order, writer, stop)
                drain(streams, order)
                _write(streams, writer, order.release_all())
            return streams.counts()
        finally:
            streams.clear()
            node.destroy_node()
    finally:
        context.try_shutdown()


def _record(streams: Streams, order: LogOrder, writer: BagWriter, stop: StopRequest) -> None:
    start = time.monotonic()
    matched_at = math.inf
    ready = False
    announced = False
    while not stop.wait(_CYCLE_S):
        now = time.monotonic()
        if math.isinf(matched_at) and streams.discover():
            matched_at = now
        if not ready and now > matched_at + _SETTLE_S:
            ready = True
            for stream in streams:
                stream.counter.start()  # from now on nothing may be missing that anybody sends
            if not any(stream.source.gives_time for stream in streams):
                order.date_by_reception()
            topics = counted(len(list(streams)), "topic")
            print(f"ready: all topics are matched, recording {topics} to {writer.path}", flush=True)
        if not announced and math.isinf(matched_at) and now > start + _ANNOUNCE_WAIT_S:
            announced = True
            print(f"waiting for {', '.join(streams.missing())}", flush=True)
        read(streams, order)
        is_full = order.held_bytes > _MAX_HELD_BYTES
        if is_full:
            order.date_by_reception()
        if ready or is_full:
            _write(streams, writer, order.release(time.monotonic_ns()))


def _write(streams: Iterable[Stream], writer: BagWriter, dated: Dated | None) -> None:
    """Announce to the bag the topics found since the last call, in their order, and write messages."""
    numbers: dict[int, int] = {}
    for stream in streams:
        if stream.number is None:
            stream.number = writer.add_topic(stream.topic, stream.msgtype, stream.qos, stream.types)
        numbers[stream.source.topic] = stream.number
    if dated is not None:
        number = np.array([numbers[place] for place in dated.topic.tolist()])
        writer.write_many(number, dated.log_ns, dated.messages.tolist())


def read(streams: Iterable[Stream], order: LogOrder) -> None:
    """Take the messages that have arrived; say where their stamps went back."""
    order.add([stream.take() for stream in streams])
    while order.set_backs:
        before, after = order.set_backs.pop(0)
        print(
            f"time goes back from {before / NANOSECONDS:.6g} s to {after / NANOSECONDS:.6g} s: "
            "the bag holds more than one run, and its log time goes on",
            flush=True,
        )


def drain(streams: Iterable[Stream], order: LogOrder) -> None:
    """Read until each topic is quiet, or until a message that was sent after this call.

    Messages of a publisher arrive in the order in which they were sent: all its earlier ones have then arrived.
    """
    asked_ns = time.time_ns()
    begin = now = time.monotonic()
    complete = False
    while not complete and now < begin + _MAX_DRAIN_S:
        time.sleep(_CYCLE_S)
        now = time.monotonic()
        read(streams, order)
        # Not at once: the clock of another machine may be ahead.
        complete = now > begin + _LEAST_DRAIN_S and all(
            stream.sent_ns > asked_ns or now > max(begin, stream.taken_at) + _QUIET_S
            for stream in streams
        )
