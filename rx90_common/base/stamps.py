"""Times of messages in nanoseconds: at the head of CDR bytes, and in message objects.

A message with a header begins with four bytes of encapsulation, the second of which is the byte order, int32 seconds
and uint32 nanoseconds.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.rates import NANOSECONDS

LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # the encapsulation
ENCAPSULATION, STAMP_BYTES = 4, 8
HEAD = ENCAPSULATION + STAMP_BYTES
_LITTLE, _BIG = struct.Struct("<iI"), struct.Struct(">iI")


def cdr_stamp(cdr: bytes) -> tuple[int, int]:
    """Return seconds and nanoseconds from the head of a CDR message, at least HEAD bytes, unchecked."""
    seconds, nanoseconds = (_LITTLE if cdr[1] & 1 else _BIG).unpack_from(cdr, ENCAPSULATION)
    return seconds, nanoseconds


def cdr_stamp_ns(cdr: bytes) -> int:
    """Return the time at the head of a CDR message, ns; -1 if it is cut off."""
    if len(cdr) < HEAD:
        return -1
    seconds, nanoseconds = cdr_stamp(cdr)
    return seconds * NANOSECONDS + nanoseconds


def cdr_stamps_ns(messages: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the times of equally long little-endian messages, shape (n, length), ns, shape (n,)."""
    seconds = messages[:, ENCAPSULATION : ENCAPSULATION + 4].copy().view("<i4")[:, 0].astype(np.int64)
    nanoseconds = messages[:, ENCAPSULATION + 4 : HEAD].copy().view("<u4")[:, 0].astype(np.int64)
    return np.asarray(seconds * NANOSECONDS + nanoseconds)


def message_time_ns(time: Any) -> int:
    """Return a builtin_interfaces Time or Duration in ns."""
    return int(time.sec) * NANOSECONDS + int(time.nanosec)
