"""The head of a CDR message: encapsulation and stamp; without compiled code, which takes a while to import."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.rates import NANOSECONDS

LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # the encapsulation
ENCAPSULATION = 4
STAMP_BYTES = 8
HEAD = ENCAPSULATION + STAMP_BYTES
STAMP = struct.Struct("<iI")
_BIG = struct.Struct(">iI")


def cdr_stamp(cdr: bytes) -> tuple[int, int]:
    """Return seconds and nanoseconds from the head of a CDR message, at least HEAD bytes, unchecked."""
    seconds, nanoseconds = (STAMP if cdr[1] & 1 else _BIG).unpack_from(cdr, ENCAPSULATION)
    return seconds, nanoseconds


def cdr_stamp_ns(cdr: bytes) -> int:
    """Return the time at the head of a CDR message, ns; -1 if it is cut off."""
    if len(cdr) < HEAD:
        return -1
    seconds, nanoseconds = cdr_stamp(cdr)
    return seconds * NANOSECONDS + nanoseconds


def cdr_stamps_ns(messages: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the times of equally long little-endian messages, shape (n, length), ns, shape (n,)."""
    stamps = messages[:, ENCAPSULATION:HEAD].copy().view([("sec", "<i4"), ("nanosec", "<u4")])[:, 0]
    seconds = stamps["sec"].astype(np.int64)
    return np.asarray(seconds * NANOSECONDS + stamps["nanosec"])
