"""Read messages from DDS on a thread that does nothing else."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

from rclpy.impl.implementation_singleton import rclpy_implementation

from rx90_common.bags.recorder.stream import Stream
from rx90_common.base.errors import BagWriteError

_NAP_S = 0.005  # gathers some dozen messages per wake-up; a wake-up for each message costs three times the time
_WAIT_NS = 50_000_000
_MAX_PER_ROUND = 4000  # of one topic, so that none keeps the others waiting
_QUEUE_BYTES = 256 << 20
_QUIET_S = 0.2  # without a message after the end was asked for: nothing is under way any more
_MAX_DRAIN_S = 2.0


class ReceivedMessage(NamedTuple):
    """A raw message, its topic, and the wall clock's time of reception in ns."""

    stream: Stream
    cdr: bytes
    received_ns: int


class MessageReader(threading.Thread):
    """Reads what arrives, counts it, and keeps it until it is collected.

    Args:
        context: the rclpy context of the subscriptions.
    """

    def __init__(self, context: Any) -> None:
        super().__init__(name="message reader", daemon=True)
        self._context = context
        self._end = threading.Event()
        self._streams: tuple[Stream, ...] = ()
        self._lock = threading.Lock()
        self._queue: list[ReceivedMessage] = []
        self._queued_bytes = 0
        self._error: Exception | None = None

    def add(self, stream: Stream) -> None:
        """Read the messages of this topic too."""
        self._streams = (*self._streams, stream)

    def collect(self) -> list[ReceivedMessage]:
        """Return what was read since the last call.

        Raises:
            BagWriteError: if the queue became too long for the memory it may use.
        """
        with self._lock:
            queue, self._queue = self._queue, []
            self._queued_bytes = 0
        if not queue and self._error is not None:
            raise self._error
        return queue

    def finish(self) -> None:
        """Read what is still under way, then end the thread."""
        self._end.set()
        self.join()

    def run(self) -> None:
        """Read messages until `finish` is called."""
        try:
            while not self._end.is_set():
                streams = self._streams
                if streams and self._wait(streams):
                    self._round(streams)
                self._end.wait(_NAP_S)
            self._drain()
        except Exception as error:
            self._error = error

    def _wait(self, streams: Sequence[Stream]) -> bool:
        """Wait until a message is there, or for a short while; return whether one is."""
        wait_set = rclpy_implementation.WaitSet(len(streams), 0, 0, 0, 0, 0, self._context.handle)
        with wait_set:
            wait_set.clear_entities()
            for stream in streams:
                wait_set.add_subscription(stream.subscription.handle)
            wait_set.wait(_WAIT_NS)
            return bool(wait_set.get_ready_entities("subscription"))

    def _drain(self) -> None:
        streams = self._streams
        now = time.monotonic()
        quiet_since, deadline = now, now + _MAX_DRAIN_S
        while now < min(quiet_since + _QUIET_S, deadline):
            if self._round(streams):
                quiet_since = time.monotonic()
            time.sleep(_NAP_S)
            now = time.monotonic()

    def _round(self, streams: Sequence[Stream]) -> int:
        received: list[ReceivedMessage] = []
        for stream in streams:
            handle = stream.subscription.handle
            count = stream.counter.add
            with handle:
                for _ in range(_MAX_PER_ROUND):
                    message = handle.take_message(stream.message_class, True)
                    if message is None:
                        break
                    cdr, info = message
                    count(info["publication_sequence_number"])
                    received.append(ReceivedMessage(stream, cdr, info["received_timestamp"]))
        size = sum(len(message.cdr) for message in received)
        with self._lock:
            self._queue += received
            self._queued_bytes += size
            if self._queued_bytes > _QUEUE_BYTES:
                raise BagWriteError(
                    f"the disk is slower than the messages arrive: {self._queued_bytes >> 20} MiB are waiting; "
                    f"accepted: {_QUEUE_BYTES >> 20} MiB"
                )
        return len(received)
