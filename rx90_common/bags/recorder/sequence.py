"""Count what was lost, from the sequence numbers that DDS writers give their messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rx90_common.bags.batch import Int64Array


@dataclass
class WriterCount:
    """What came from one writer: its first and last sequence number, messages received and missed."""

    first: int
    last: int
    received: int = 1
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
        self._known_before = 0
        self._must_start_at_one = False
        self._transient_local = transient_local
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
        """From now on a writer that newly appears must be heard from its first message on."""
        self._known_before = self._matched()
        self._must_start_at_one = not self._transient_local

    def add(self, number: int) -> None:
        """Count the message with this sequence number."""
        current = self._current
        if current is None or number != current.last + 1:
            current = self._find(number)
            if current is None:
                return
        current.last = number
        current.received += 1

    def add_many(self, numbers: Int64Array) -> None:
        """Count messages with these sequence numbers, in this order."""
        current = self._current
        count = len(numbers)
        if current is not None and count and numbers[0] == current.last + 1 and bool((np.diff(numbers) == 1).all()):
            current.last += count
            current.received += count
            return
        for number in numbers.tolist():
            self.add(number)

    def _find(self, number: int) -> WriterCount | None:
        """Return the writer whose count `number` continues; None when it opened a new count."""
        for writer in self.writers:
            if writer.last + 1 == number:
                self._current = writer
                return writer
        behind = [writer for writer in self.writers if writer.last < number]
        if number == 1 or not behind or len(self.writers) < self._matched():
            late = self._must_start_at_one and len(self.writers) >= self._known_before
            self._current = WriterCount(number, number, lost=number - 1 if late else 0)
            self.writers.append(self._current)
            return None
        nearest = max(behind, key=lambda writer: writer.last)
        nearest.lost += number - nearest.last - 1
        self._current = nearest
        return nearest
