"""The run of a recorder: find the topics, read, order and write their messages, and account for every one."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import rclpy
from rclpy.context import Context
from rosbags.interfaces import Connection
from tqdm import tqdm

from rx90_common.bags.ordering import Dated, LogOrder, TimeSource
from rx90_common.bags.recorder.message_reader import MessageReader
from rx90_common.bags.recorder.sequence import WriterCount
from rx90_common.bags.recorder.stream import Streams
from rx90_common.bags.writing import BagWriter
from rx90_common.base.errors import FAILED
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.ros_start import start_ros
from rx90_common.process.exit_code import end_with
from rx90_common.process.interrupts import StopRequest

READY: Final = "ready: all"
"""Beginning of the line that reports that all topics are matched."""

_CYCLE_S = 0.1
_ANNOUNCE_WAIT_S = 1.0
_SETTLE_S = 0.3  # a publisher learns of its match a moment after the recorder does
_LONGEST_STALL_S = 4.0  # below the lease in config/dds, after which a publisher forgets this process
_MAX_HELD_BYTES = 64 << 20  # while topics are still missing
_SHOW_PERIOD_S = 0.5


@dataclass(frozen=True)
class TopicCount:
    """What was recorded of a topic; `repeated` of the messages received are not in the bag.

    `missing` trajectories did not come, although the controller that they were sent to has accepted them; `other_clock`
    messages have stamps of another clock than the bag, and are dated by their reception.
    """

    topic: str
    received: int
    repeated: int
    lost: int
    refused: int
    missing: int
    other_clock: int
    writers: tuple[WriterCount, ...]


class StatusLine:
    """Shows count, rate and simulated time on a terminal and nothing elsewhere; messages stand above it."""

    def __init__(self) -> None:
        self._bar = tqdm(unit=" msgs", unit_scale=True, disable=None, mininterval=0.0, miniters=0)
        self._next = 0.0

    def __enter__(self) -> StatusLine:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def say(self, line: str) -> None:
        """Print a line."""
        self._bar.write(line, file=sys.stdout)
        sys.stdout.flush()

    def show(self, received: int, newest_ns: int | None) -> None:
        """Show the messages received so far and the newest stamp, at most twice a second."""
        now = time.monotonic()
        if self._bar.disable or now < self._next:
            return
        self._next = now + _SHOW_PERIOD_S
        if newest_ns is not None:
            self._bar.set_postfix_str(f"t = {newest_ns / NANOSECONDS:.3f} s", refresh=False)
        self._bar.update(received - self._bar.n)


class Recorder:
    """Records topics to a new bag until it is stopped.

    Args:
        topics: names, relative or absolute, each once.
        ros_args: --ros-args and what follows it (namespace, remappings), or nothing.
        status: shows the user how the recording goes.

    Attributes:
        stalls: times, s, in which this process did not run and which publishers may have taken for its end: what they
            sent then, and how much, is not known here.
    """

    def __init__(self, topics: Sequence[str], ros_args: Sequence[str], status: StatusLine) -> None:
        self._names = topics
        self._ros_args = ros_args
        self._status = status
        self._connections: dict[int, Connection] = {}
        self._order = LogOrder()
        self._received = 0
        self._reported = 0  # set-backs of the stamps
        self.stalls: list[float] = []

    def run(self, make_writer: Callable[[], BagWriter], stop: StopRequest) -> list[TopicCount]:
        """Record until `stop` is set; the bag is made once the topics' names are known to be good.

        Raises:
            BagError: if a topic cannot be recorded or the bag cannot be made.
            BagWriteError: if the bag cannot be written on, or no message can be read from the middleware any more.
            ConfigError: if ROS refuses its arguments.
        """
        context = Context()
        try:
            start_ros(self._ros_args, context)
            node = rclpy.create_node(
                "rx90_bag_recorder", context=context, enable_rosout=False, start_parameter_services=False
            )
            streams = Streams(node, self._names)
            reader = MessageReader()
            reader.start()
            try:
                with make_writer() as writer:
                    self._record(streams, reader, writer, stop)
                reader.check()
                return _count(streams, self._order.other_clock)
            finally:
                reader.finish()
                if reader.is_alive():
                    end_with(FAILED)  # the middleware could wait for the lock that keeps the reader, and so for ever
                else:
                    streams.clear()
                    node.destroy_node()
        finally:
            context.try_shutdown()

    def _record(self, streams: Streams, reader: MessageReader, writer: BagWriter, stop: StopRequest) -> None:
        start = last = time.monotonic()
        matched_at = math.inf
        ready = reported = False
        while not (stop.is_set() or reader.has_failed):
            now = time.monotonic()
            last = self._note_stall(last)
            if math.isinf(matched_at) and streams.discover(reader.add):
                matched_at = now
            if not ready and now > matched_at + _SETTLE_S:
                ready = True
                self._announce(streams, writer)
            if not reported and math.isinf(matched_at) and now > start + _ANNOUNCE_WAIT_S:
                reported = True
                self._status.say(f"waiting for {', '.join(streams.missing())}")
            self._order_all(reader)
            if ready or self._order.held_bytes > _MAX_HELD_BYTES:
                self._write(streams, writer, self._order.release())
            self._report_set_backs()
            self._status.show(self._received, self._order.newest_ns)
            stop.wait(_CYCLE_S)
        self._note_stall(last)
        reader.finish()
        self._order_all(reader)
        self._connect(streams, writer)
        self._write(streams, writer, self._order.release_all())

    def _announce(self, streams: Streams, writer: BagWriter) -> None:
        for stream in streams:
            stream.start()
        if all(stream.time_source is not TimeSource.CLOCK for stream in streams):
            self._order.expect_no_clock()
        if not all(stream.in_bulk for stream in streams):
            self._status.say("rcl's functions are not to be found: messages are taken one by one, which costs more")
        self._status.say(f"{READY} {len(self._names)} topics are matched, recording to {writer.path}")

    def _order_all(self, reader: MessageReader) -> None:
        arrived = reader.collect()
        self._received += sum(len(each.messages) for each in arrived)
        self._order.add(arrived)

    def _note_stall(self, last: float) -> float:
        """Note a long time since `last` on the steady clock; return the time now."""
        now = time.monotonic()
        if now - last > _LONGEST_STALL_S:
            self.stalls.append(now - last)
        return now

    def _report_set_backs(self) -> None:
        for before, after in self._order.set_backs[self._reported :]:
            self._reported += 1
            self._status.say(
                f"time goes back from {before / NANOSECONDS:.6g} s to {after / NANOSECONDS:.6g} s: "
                "the bag holds more than one run, and its log time goes on"
            )

    def _connect(self, streams: Streams, writer: BagWriter) -> None:
        """Announce to the bag the topics found since the last call, in their order."""
        for stream in streams:
            if stream.index not in self._connections:
                self._connections[stream.index] = writer.add_topic(
                    stream.topic, stream.msgtype, [stream.qos], stream.definition
                )

    def _write(self, streams: Streams, writer: BagWriter, dated: Dated | None) -> None:
        if dated is None:
            return
        if len(self._connections) < len(self._names):
            self._connect(streams, writer)
        numbers = np.zeros(len(self._names), dtype=np.int64)
        for index, connection in self._connections.items():
            numbers[index] = connection.id
        writer.write_many(numbers[dated.topic], dated.log_ns, dated.messages)


def _count(streams: Streams, other_clock: Mapping[int, int]) -> list[TopicCount]:
    missing = streams.trajectories.missing([stream.topic for stream in streams])
    return [
        TopicCount(
            stream.topic,
            stream.counter.received,
            stream.repeated,
            stream.lost(),
            stream.refused(),
            missing.get(stream.topic, 0),
            other_clock.get(stream.index, 0),
            tuple(stream.counter.writers),
        )
        for stream in streams
    ]
