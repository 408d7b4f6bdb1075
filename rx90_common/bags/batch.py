"""Many serialised messages as a few arrays: what is done to each is done by compiled code, for all in one call."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]  # numba exports without saying so
from numpy.typing import NDArray

from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION, HEAD
from rx90_common.kernels.compiled import c_function

Int64Array = NDArray[np.int64]
Bytes = NDArray[np.uint8]


@c_function(types.int64(types.voidptr, types.voidptr, types.voidptr, types.int64, types.voidptr))
def _read_stamps(data_at, start_at, size_at, count, stamp_at):  # type: ignore[no-untyped-def]  # addresses
    """Write the time at the head of each message, ns; 0 for times before 0 and messages that are cut off."""
    start, size = carray(start_at, (count,), np.int64), carray(size_at, (count,), np.int64)
    stamp = carray(stamp_at, (count,), np.int64)
    for i in range(count):
        stamp[i] = 0
        if size[i] >= HEAD:
            message = carray(data_at, (start[i] + HEAD,), np.uint8)[start[i] :]
            seconds = np.uint32(0)
            nanoseconds = np.uint32(0)
            for k in range(4):
                shift = np.uint32(8 * k if message[1] & 1 else 24 - 8 * k)
                seconds |= np.uint32(message[ENCAPSULATION + k]) << shift
                nanoseconds |= np.uint32(message[ENCAPSULATION + 4 + k]) << shift
            if seconds <= 0x7FFFFFFF:
                stamp[i] = np.int64(seconds) * NANOSECONDS + np.int64(nanoseconds)
    return 0


@c_function(types.int64(types.voidptr, types.voidptr, types.voidptr, types.int64, types.voidptr))
def _copy(data_at, start_at, size_at, count, to_at):  # type: ignore[no-untyped-def]  # addresses
    """Copy messages one behind the other."""
    start, size = carray(start_at, (count,), np.int64), carray(size_at, (count,), np.int64)
    end = 0
    for i in range(count):
        message = carray(data_at, (start[i] + size[i],), np.uint8)[start[i] :]
        to = carray(to_at, (end + size[i],), np.uint8)[end:]
        for k in range(size[i]):
            to[k] = message[k]
        end += size[i]
    return 0


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
        before = np.cumsum([0, *(len(batch.data) for batch in batches)])
        starts = [batch.start + offset for batch, offset in zip(batches, before, strict=False)]
        return cls(
            np.concatenate([np.zeros(0, dtype=np.uint8), *(batch.data for batch in batches)]),
            np.concatenate([np.zeros(0, dtype=np.int64), *starts]),
            np.concatenate([np.zeros(0, dtype=np.int64), *(batch.size for batch in batches)]),
        )

    def __len__(self) -> int:
        return len(self.size)

    def __iter__(self) -> Iterator[bytes]:
        """Yield each message."""
        for start, size in zip(self.start.tolist(), self.size.tolist(), strict=True):
            yield self.data[start : start + size].tobytes()

    def __getitem__(self, row: int) -> bytes:
        """Return a message."""
        return self.data[self.start[row] : self.start[row] + self.size[row]].tobytes()

    def repeats(self, before: bytes) -> NDArray[np.bool_]:
        """Return whether each message is, to the bit, the one before it, bool (n,); `before` is that of the first."""
        again = np.zeros(len(self), dtype=np.bool_)
        # Almost always the stamps differ.
        alike = np.flatnonzero((np.diff(self.stamps_ns()) == 0) & (np.diff(self.size) == 0)) + 1
        again[alike] = [self[row] == self[row - 1] for row in alike.tolist()]
        if len(self):
            again[0] = self[0] == before
        return again

    @property
    def total(self) -> int:
        """Return the bytes of all messages."""
        return int(self.size.sum())

    def stamps_ns(self) -> Int64Array:
        """Return the time at the head of each message, ns, int64 (n,); 0 before 0 and where a message is cut off."""
        stamp = np.empty(len(self), dtype=np.int64)
        _read_stamps(*self._addresses(), len(self), stamp.ctypes.data)
        return stamp

    def take(self, rows: NDArray[np.intp] | slice) -> MessageBatch:
        """Return a copy of these messages (an index or a slice), which holds no others."""
        start = np.ascontiguousarray(self.start[rows])
        size = np.ascontiguousarray(self.size[rows])
        chosen = MessageBatch(np.empty(int(size.sum()), dtype=np.uint8), np.cumsum(size) - size, size)
        _copy(self.data.ctypes.data, start.ctypes.data, size.ctypes.data, len(size), chosen.data.ctypes.data)
        return chosen

    def _addresses(self) -> tuple[Any, Any, Any]:
        return self.data.ctypes.data, self.start.ctypes.data, self.size.ctypes.data
