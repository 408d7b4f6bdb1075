"""The run of a recorder: find the topics, read on a thread, order and write their messages, and count each."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import rclpy
from rclpy.context import Context

from rx90_common.bags.ordering import Arrived, Dated, LogOrder, TimeSource
from rx90_common.bags.recorder.stream import Stream, Streams, WriterCount
from rx90_common.bags.writing import BagWriter
from rx90_common.base.errors import FAILED, BagWriteError
from rx90_common.base.quoting import counted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.ros_start import start_ros
from rx90_common.process.interrupts import StopRequest, end_with
from rx90_common.process.threads import calls_of, place_of

_CYCLE_S = 0.1
_ANNOUNCE_WAIT_S = 1.0
_SETTLE_S = 0.3  # a publisher learns of its match a moment after the recorder does
_LONGEST_STALL_S = 4.0  # below the lease in config/dds, after which a publisher forgets this process
_MAX_HELD_BYTES = 64 << 20  # while topics are still missing
_NAP_S = 0.1  # gathers some thousand messages: a round has a cost of its own, whatever it brings
_MAX_PER_ROUND = 4000  # of one topic, so that none keeps the others waiting
_QUEUE_BYTES = 256 << 20
_QUIET_S = 0.2  # without a message of a topic after the stop request: none is under way any more
_STEADY_QUIET_S = 1.0  # the same for a topic with steady messages: a lost one is sent again after some heartbeats
_MAX_DRAIN_S = 5.0
_MAX_END_S = 30.0  # busy machines take up to 10 s; callers that stop a recorder wait longer than this


class MessageReader(threading.Thread):
    """Reads arriving messages, counts them, and keeps them until they are collected.

    Attributes:
        error: the reason why reading has ended: a BagError if the middleware refuses, a BagWriteError if the queue
            became too long for its share of memory or the thread did not end; earlier messages can still be collected.
    """

    def __init__(self) -> None:
        super().__init__(name="message reader", daemon=True)
        self._end = threading.Event()
        self._asked_ns = 0  # time of the stop request, by the wall clock
        self._streams: tuple[Stream, ...] = ()
        self._lock = threading.Lock()
        self._queue: list[Arrived] = []
        self._round_so_far: list[Arrived] = []
        self.error: Exception | None = None

    def add(self, stream: Stream) -> None:
        """Read the messages of this topic too."""
        self._streams = (*self._streams, stream)

    def collect(self) -> list[Arrived]:
        """Return the messages read since the last call."""
        with self._lock:
            queue = self._queue
            self._queue = []
        return queue

    def finish(self) -> None:
        """Read the messages still under way, then end the thread; give up if the middleware does not return."""
        if self._end.is_set():
            return
        self._asked_ns = time.time_ns()
        self._end.set()
        self.join(_MAX_END_S)
        if self.is_alive():
            place = place_of(calls[-1]) if (calls := calls_of(self)) else "no call"
            with self._lock:
                self._queue += self._round_so_far
                self.error = BagWriteError(
                    f"the message reader did not end within {_MAX_END_S:g} s (it is in {place}); "
                    "the bag holds what it had read"
                )

    def run(self) -> None:
        """Read messages until `finish` is called."""
        try:
            while not self._end.wait(_NAP_S):
                self._round(self._streams)
            self._drain()
        except Exception as error:
            self.error = error

    def _drain(self) -> None:
        """Read until each topic is quiet, or until a message that was sent after the stop request.

        Messages of a publisher arrive in the order in which they were sent: all its earlier ones have then arrived.
        """
        begin = now = time.monotonic()
        last_message = dict.fromkeys(self._streams, begin)
        complete = False
        while not complete and now < begin + _MAX_DRAIN_S:
            for stream in last_message:
                if self._round([stream]):
                    last_message[stream] = time.monotonic()
            time.sleep(_NAP_S)
            now = time.monotonic()
            # Not at once: the clock of another machine may be ahead.
            complete = now >= begin + _QUIET_S and all(
                stream.sent_ns > self._asked_ns
                or now >= at + (_STEADY_QUIET_S if stream.needs_publisher and stream.sent_ns else _QUIET_S)
                for stream, at in last_message.items()
            )

    def _round(self, streams: Iterable[Stream]) -> bool:
        """Read the messages that have arrived on each topic; return whether there were any."""
        received: list[Arrived] = []
        self._round_so_far = received
        for stream in streams:
            count = 0
            while count < _MAX_PER_ROUND and len((arrived := stream.take()).messages):
                count += len(arrived.messages)
                received.append(arrived)
        with self._lock:
            self._round_so_far = []
            if self.error is not None:  # given up: these messages are in the queue, or come too late for the bag
                return False
            self._queue += received
            waiting = sum(each.total for each in self._queue)
            if waiting > _QUEUE_BYTES:
                raise BagWriteError(
                    f"the disk is slower than the messages arrive: {waiting >> 20} MiB are waiting; "
                    f"accepted: {_QUEUE_BYTES >> 20} MiB"
                )
        return bool(received)


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


class Recorder:
    """Records topics to a new bag until it is stopped.

    Args:
        topics: names, relative or absolute, each once.
        ros_args: --ros-args and what follows it (namespace, remappings), or nothing.

    Attributes:
        stalls: times, s, in which this process did not run, and which publishers may have taken for its end: whether
            they sent messages then is not known here.
        empty: topics of which no message has come, once the recording has ended.
    """

    def __init__(self, topics: Sequence[str], ros_args: Sequence[str]) -> None:
        self._names = topics
        self._ros_args = ros_args
        self._numbers: dict[int, int] = {}  # of topics in the bag, by their places
        self._order = LogOrder()
        self._reported = 0  # set-backs of the stamps
        self.stalls: list[float] = []
        self.empty: list[str] = []

    def run(self, make_writer: Callable[[], BagWriter], stop: StopRequest) -> list[TopicCount]:
        """Record until `stop` is set; the bag is made once the topics' names are known to be good.

        Raises:
            BagWriteError: if the bag cannot be written on, or no message can be read from the middleware any more.
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
                if reader.error is not None:
                    raise reader.error
                self.empty = streams.empty()
                return self._counts(streams)
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
        while True:
            now = time.monotonic()
            if now - last > _LONGEST_STALL_S:
                self.stalls.append(now - last)
            last = now
            if stop.is_set() or reader.error is not None:
                break
            if math.isinf(matched_at) and streams.discover(reader.add):
                matched_at = now
            if not ready and now > matched_at + _SETTLE_S:
                ready = True
                for stream in streams:
                    stream.start()
                if all(stream.time_source is not TimeSource.CLOCK for stream in streams):
                    self._order.expect_no_clock()
                topics = counted(len(self._names), "topic")
                print(f"ready: all topics are matched, recording {topics} to {writer.path}", flush=True)
            if not reported and math.isinf(matched_at) and now > start + _ANNOUNCE_WAIT_S:
                reported = True
                print(f"waiting for {', '.join(streams.missing())}", flush=True)
            self._order_all(reader)
            if ready or self._order.held_bytes > _MAX_HELD_BYTES:
                self._write(streams, writer, self._order.release(time.monotonic_ns()))
            stop.wait(_CYCLE_S)
        reader.finish()
        self._order_all(reader)
        self._write(streams, writer, self._order.release_all())

    def _order_all(self, reader: MessageReader) -> None:
        arrived = reader.collect()
        self._order.add(arrived)
        for before, after in self._order.set_backs[self._reported :]:
            self._reported += 1
            print(
                f"time goes back from {before / NANOSECONDS:.6g} s to {after / NANOSECONDS:.6g} s: "
                "the bag holds more than one run, and its log time goes on",
                flush=True,
            )

    def _write(self, streams: Streams, writer: BagWriter, dated: Dated | None) -> None:
        """Announce to the bag the topics found since the last call, in their order, and write messages."""
        for stream in streams:
            if stream.index not in self._numbers:
                added = writer.add_topic(stream.topic, stream.msgtype, [stream.qos], stream.definition)
                self._numbers[stream.index] = added.id
        if dated is not None:
            numbers = np.array([self._numbers.get(index, 0) for index in range(len(self._names))], dtype=np.int64)
            writer.write_many(numbers[dated.topic], dated.log_ns, dated.messages)

    def _counts(self, streams: Streams) -> list[TopicCount]:
        missing = streams.trajectories.missing([stream.topic for stream in streams])
        return [
            TopicCount(
                stream.topic,
                stream.counter.received,
                stream.repeated,
                stream.lost(),
                stream.refused(),
                missing.get(stream.topic, 0),
                self._order.other_clock.get(stream.index, 0),
                tuple(stream.counter.writers),
            )
            for stream in streams
        ]
