"""Many serialised messages as a few arrays, also those of a series."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr import ENCAPSULATION, HEAD, JointStateCodec

Int64Array = NDArray[np.int64]
Bytes = NDArray[np.uint8]


class MessageBatch:
    """n serialised messages.

    Attributes:
        data: bytes that hold the messages, uint8 (m,).
        start: where in them each message begins, int64 (n,).
        size: bytes of each message, int64 (n,).
    """

    def __init__(self, data: Bytes, start: Int64Array, size: Int64Array) -> None:
        self.data = data
        self.start = start
        self.size = size

    @classmethod
    def of(cls, messages: Sequence[bytes]) -> MessageBatch:
        """Return a batch of these messages."""
        size = np.array([len(message) for message in messages], dtype=np.int64)
        return cls(np.frombuffer(b"".join(messages), dtype=np.uint8), np.cumsum(size) - size, size)

    @classmethod
    def join(cls, batches: Sequence[MessageBatch]) -> MessageBatch:
        """Return one batch with the messages of all, in this order."""
        if len(batches) == 1:
            return batches[0]
        batches = [cls.of([]), *batches]
        before = np.cumsum([len(batch.data) for batch in batches])
        starts = [batch.start + end - len(batch.data) for batch, end in zip(batches, before, strict=True)]
        data = [batch.data for batch in batches]
        sizes = [batch.size for batch in batches]
        return cls(np.concatenate(data), np.concatenate(starts), np.concatenate(sizes))

    def __len__(self) -> int:
        return len(self.size)

    def __iter__(self) -> Iterator[bytes]:
        """Yield each message."""
        for start, size in zip(self.start.tolist(), self.size.tolist(), strict=True):
            yield self.data[start : start + size].tobytes()

    def __getitem__(self, row: int) -> bytes:
        """Return a message."""
        return self.data[self.start[row] : self.start[row] + self.size[row]].tobytes()

    @property
    def total(self) -> int:
        """Return the bytes of all messages."""
        return int(self.size.sum())

    def repeats(self, before: bytes) -> NDArray[np.bool_]:
        """Return whether each message is, to the bit, the one before it, bool (n,); `before` is that of the first."""
        again = np.zeros(len(self), dtype=np.bool_)
        # Almost always the stamps differ.
        alike = np.flatnonzero((np.diff(self.stamps_ns()) == 0) & (np.diff(self.size) == 0)) + 1
        again[alike] = [self[row] == self[row - 1] for row in alike.tolist()]
        again[:1] = [message == before for message in self.take(slice(0, 1))]
        return again

    def stamps_ns(self) -> Int64Array:
        """Return the time at the head of each message, ns, int64 (n,); 0 before 0 and where a message is cut off."""
        stamps = np.zeros(len(self), dtype=np.int64)
        rows = np.flatnonzero(self.size >= HEAD)
        heads = self.data[self.start[rows, np.newaxis] + np.arange(HEAD)]
        times = np.ascontiguousarray(heads[:, ENCAPSULATION:HEAD])
        little = heads[:, 1:2] & 1 == 1
        seconds, nanoseconds = np.where(little, times.view("<u4"), times.view(">u4")).astype(np.int64).T
        stamps[rows] = np.where(seconds < 1 << 31, seconds * NANOSECONDS + nanoseconds, 0)
        return stamps

    def take(self, rows: NDArray[np.intp] | slice) -> MessageBatch:
        """Return these messages (an index or a slice), in the same bytes."""
        return MessageBatch(self.data, self.start[rows], self.size[rows])


def series_encoder(series: JointSeries) -> Callable[[Int64Array], MessageBatch]:
    """Return a function that returns the messages of some rows of a series.

    The function raises ExchangeError for a name or a stamp that a message cannot contain.
    """
    codec = JointStateCodec(series.names)
    arrays = (series.position, series.velocity, series.effort)

    def joint_states(rows: Int64Array) -> MessageBatch:
        fields = (None if array is None else array[rows] for array in arrays)
        data = codec.encode_many(series.stamp_ns[rows], *fields)
        count, size = data.shape
        return MessageBatch(data.reshape(-1), np.arange(count) * size, np.full(count, size))

    return joint_states
