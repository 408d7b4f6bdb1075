"""Counting losses from sequence numbers."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rx90_common.bags.recorder.stream import SequenceCounter


@given(st.sets(st.integers(1, 300), min_size=1))
def test_single_writer_is_counted_exactly(numbers: set[int]) -> None:
    """Of one writer every number missing between its first and last message is counted as lost."""
    counter = SequenceCounter(lambda: 1, transient_local=False)
    for number in sorted(numbers):
        counter.add(np.array([number]))
    assert counter.received == len(numbers)
    assert counter.lost == max(numbers) - min(numbers) + 1 - len(numbers)
    assert len(counter.writers) == 1


@given(st.lists(st.lists(st.integers(1, 30), max_size=8)), st.booleans())
def test_batches_count_as_messages_do(batches: list[list[int]], runs: bool) -> None:
    """Numbers counted in batches, in runs without a gap or in any order, give the counts of one after the other."""
    counters = [SequenceCounter(lambda: 2, transient_local=False) for _ in range(2)]
    for batch in batches:
        numbers = list(range(batch[0], batch[0] + len(batch))) if runs and batch else batch
        counters[0].add(np.array(numbers, dtype=np.int64))
        for number in numbers:
            counters[1].add(np.array([number]))
    assert counters[0].writers == counters[1].writers


@given(st.lists(st.integers(1, 40), min_size=1, max_size=4), st.randoms(use_true_random=False))
def test_interleaved_writers_lose_nothing(counts: list[int], random: Any) -> None:
    """Several complete writers, in any interleaving of their messages, count as no loss and as that many."""
    counter = SequenceCounter(lambda: len(counts), transient_local=False)
    counter.start()
    numbers = [0] * len(counts)
    order = [writer for writer, count in enumerate(counts) for _ in range(count)]
    random.shuffle(order)
    for writer in order:
        numbers[writer] += 1
        counter.add(np.array([numbers[writer]]))
    assert counter.lost == 0
    assert sorted(writer.received for writer in counter.writers) == sorted(counts)


def test_writer_that_appears_later() -> None:
    """A writer that appears while recording must be heard from its first message on, unless latched."""
    for transient_local, lost in ((False, 3), (True, 0)):
        matches = [1]
        counter = SequenceCounter(partial(max, matches), transient_local=transient_local)
        for number in (5, 6):
            counter.add(np.array([number]))
        counter.start()
        matches.append(2)
        for number in (7, 4, 5, 8):
            counter.add(np.array([number]))
        assert counter.lost == lost
        assert [writer.received for writer in counter.writers] == [4, 2]


def test_gap_after_a_restart() -> None:
    """A gap of a restarted publisher is counted for it, wherever its predecessor's count ended."""
    for end in (4, 40, 4000):
        counter = SequenceCounter(lambda: 2, transient_local=False)
        for number in (*range(1, end), *range(1, 101), *range(104, 200)):
            counter.add(np.array([number]))
        assert [writer.lost for writer in counter.writers] == [0, 3]
