"""Read messages from DDS on a thread that does nothing else."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable

from rx90_common.bags.ordering import Arrived
from rx90_common.bags.recorder.stream import Stream
from rx90_common.base.errors import BagWriteError
from rx90_common.process.threads import calls_of, place_of

_NAP_S = 0.1  # gathers some thousand messages: a round has a cost of its own, whatever it brings
_MAX_PER_ROUND = 4000  # of one topic, so that none keeps the others waiting
_QUEUE_BYTES = 256 << 20
_QUIET_S = 0.2  # without a message of a topic after the end was asked for: nothing is under way any more
_MAX_DRAIN_S = 2.0
_MAX_END_S = 30.0  # busy machines take up to 10 s; callers that stop a recorder wait longer than this


class MessageReader(threading.Thread):
    """Reads what arrives, counts it, and keeps it until it is collected."""

    def __init__(self) -> None:
        super().__init__(name="message reader", daemon=True)
        self._end = threading.Event()
        self._asked_ns = 0  # when the end was asked for, by the wall clock
        self._streams: tuple[Stream, ...] = ()
        self._lock = threading.Lock()
        self._queue: list[Arrived] = []
        self._queued_bytes = 0
        self._round_so_far: list[Arrived] = []
        self._error: Exception | None = None

    def add(self, stream: Stream) -> None:
        """Read the messages of this topic too."""
        self._streams = (*self._streams, stream)

    def collect(self) -> list[Arrived]:
        """Return what was read since the last call."""
        with self._lock:
            queue, self._queue = self._queue, []
            self._queued_bytes = 0
        return queue

    @property
    def has_failed(self) -> bool:
        """Return whether nothing more will be read; `check` says why."""
        return self._error is not None

    def check(self) -> None:
        """Complain if not all could be read; what was read before is there to be collected.

        Raises:
            BagError: if the middleware refuses.
            BagWriteError: if the queue became too long for the memory it may use, or the thread did not end in time.
        """
        if self._error is not None:
            raise self._error

    def finish(self) -> None:
        """Read what is still under way, then end the thread; give up if the middleware does not return from a call."""
        if self._end.is_set():
            return
        self._asked_ns = time.time_ns()
        self._end.set()
        self.join(_MAX_END_S)
        if self.is_alive():
            with self._lock:
                self._queue += self._round_so_far
                self._error = BagWriteError(
                    f"the message reader did not end within {_MAX_END_S:g} s (it is in {self._place()}); "
                    "the bag holds what it had read"
                )

    def _place(self) -> str:
        calls = calls_of(self)
        return place_of(calls[-1]) if calls else "no call"

    def run(self) -> None:
        """Read messages until `finish` is called."""
        try:
            while not self._end.wait(_NAP_S):
                self._round(self._streams)
            self._drain()
        except Exception as error:
            self._error = error

    def _drain(self) -> None:
        """Read until each topic is quiet, or at a message that was sent after the end was asked for.

        Messages of a publisher come in the order in which they were sent: all that it had sent before are there then.
        """
        begin = now = time.monotonic()
        heard = dict.fromkeys(self._streams, begin)
        complete = False
        while not complete and now < begin + _MAX_DRAIN_S:
            for stream in heard:
                if self._round([stream]):
                    heard[stream] = time.monotonic()
            time.sleep(_NAP_S)
            now = time.monotonic()
            # Not at once: the clock of another machine may be ahead.
            complete = now >= begin + _QUIET_S and all(
                stream.sent_ns > self._asked_ns or now >= at + _QUIET_S for stream, at in heard.items()
            )

    def _round(self, streams: Iterable[Stream]) -> int:
        received: list[Arrived] = []
        self._round_so_far = received
        for stream in streams:
            count = 0
            while count < _MAX_PER_ROUND:
                taken = stream.take()
                if not len(taken.messages):
                    break
                count += len(taken.messages)
                received.append(Arrived(stream.index, stream.time_source, taken.messages, taken.received_ns))
        if not received:
            return 0
        with self._lock:
            self._round_so_far = []
            if self.has_failed:  # given up: these messages are in the queue, or come too late for the bag
                return 0
            self._queue += received
            self._queued_bytes += sum(each.messages.total for each in received)
            if self._queued_bytes > _QUEUE_BYTES:
                raise BagWriteError(
                    f"the disk is slower than the messages arrive: {self._queued_bytes >> 20} MiB are waiting; "
                    f"accepted: {_QUEUE_BYTES >> 20} MiB"
                )
        return sum(len(each.messages) for each in received)
