"""The end of a recording: what was sent before it is in the bag, and nobody waits for publishers that go on."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest

from rx90_common.bags.batch import MessageBatch
from rx90_common.bags.ordering import Arrived, TimeSource
from rx90_common.bags.recorder import recording
from rx90_common.base.errors import BagWriteError

SENT_BEFORE = 9  # one a round: these take longer than a topic that is quiet is waited for
LONG = 120.0


class Publisher:
    """Stands for a stream: a publisher that sends on and on, and whose messages come late, one in each round."""

    index = 0
    time_source = TimeSource.NEWEST

    def __init__(self) -> None:
        self.sent_ns = 0
        self.taken = 0
        self._calls = 0
        self._begin_ns = time.time_ns()

    def take(self) -> Arrived:
        """Return a message and, in the next call, none."""
        self._calls += 1
        if self._calls % 2 == 0:
            return Arrived(0, self.time_source, MessageBatch.of([]), np.empty(0, dtype=np.int64))
        self.taken += 1
        self.sent_ns = self._begin_ns if self.taken <= SENT_BEFORE else time.time_ns()
        return Arrived(0, self.time_source, MessageBatch.of([b"%d" % self.taken]), np.zeros(1, dtype=np.int64))


def test_a_publisher_that_goes_on_is_read_up_to_the_end_that_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that was sent before the end is read, however late it comes; then the recorder ends, busy topics or not."""
    monkeypatch.setattr(recording, "_MAX_DRAIN_S", LONG)
    publisher: Any = Publisher()
    reader = recording.MessageReader()
    reader.add(publisher)
    reader.start()
    begin = time.monotonic()
    reader.finish()
    assert time.monotonic() - begin < LONG / 2.0
    read = [message for each in reader.collect() for message in each.messages]
    assert read[:SENT_BEFORE] == [b"%d" % number for number in range(1, SENT_BEFORE + 1)]
    assert len(read) == publisher.taken > SENT_BEFORE


class Deadlock(Publisher):
    """A stream whose middleware gives one message and does not return from the next call."""

    def __init__(self) -> None:
        super().__init__()
        self.reached, self.freed = threading.Event(), threading.Event()

    def take(self) -> Arrived:
        """Return a message; then stand still until the test is over."""
        if self.taken:
            self.reached.set()
            self.freed.wait()
        return super().take()


def test_a_reader_that_does_not_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who waits for the end learns where it stands, in one line, after all that it had read; nothing comes twice."""
    monkeypatch.setattr(recording, "_MAX_END_S", 0.01)
    stream: Any = Deadlock()
    reader = recording.MessageReader()
    reader.add(stream)
    reader.start()
    assert stream.reached.wait(LONG)
    for _ in range(2):
        reader.finish()
    read = [message for each in reader.collect() for message in each.messages]
    assert read == [b"1"]
    stream.freed.set()
    reader.join(LONG)
    with pytest.raises(BagWriteError, match=r"did not end within 0\.01 s \(it is in .*\.py:\d+\)") as caught:
        reader.check()
    assert not reader.collect()
    assert "\n" not in str(caught.value)
