"""Read CDR bytes field by field, and say in which field they are broken."""

from __future__ import annotations

import struct

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION, STAMP_BYTES, cdr_stamp

_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # the two plain encodings of CDR
_MAX_SLACK = 15  # serialisers reserve alignment and counts that they then do not need


class CdrReader:
    """Walk through the body of a CDR message; alignment counts from the body's start.

    Args:
        raw: the message, with its encapsulation.

    Raises:
        ExchangeError: here and from every method, naming the field in which the bytes are no message.
    """

    def __init__(self, raw: bytes) -> None:
        if len(raw) < ENCAPSULATION:
            raise ExchangeError(f"message is cut off: {len(raw)} bytes, no CDR encapsulation")
        order = _BYTE_ORDERS.get(bytes(raw[:2]))
        if order is None:
            found = bytes(raw[:2]).hex()
            raise ExchangeError(f"message has the encapsulation 0x{found}; accepted: plain CDR, 0x0000 or 0x0001")
        self._order = order
        self._raw, self._body = raw, raw[ENCAPSULATION:]
        self._at = 0

    def _take(self, size: int, alignment: int, what: str) -> bytes:
        start = self._at + -self._at % alignment
        if start + size > len(self._body):
            raise ExchangeError(f"message is cut off in {what}: {len(self._body)} bytes of body, {start + size} needed")
        self._at = start + size
        return self._body[start : self._at]

    def stamp_ns(self) -> int:
        """Return the stamp, with which the body begins."""
        self._take(STAMP_BYTES, 4, "header.stamp")
        seconds, nanoseconds = cdr_stamp(self._raw)
        if nanoseconds >= NANOSECONDS:
            raise ExchangeError(f"header.stamp.nanosec is {nanoseconds}; accepted: 0 to {NANOSECONDS - 1}")
        return seconds * NANOSECONDS + nanoseconds

    def count(self, what: str, least_bytes: int) -> int:
        """Return a length; refuse one that the rest of the message cannot hold before anything is built."""
        (count,) = struct.unpack(f"{self._order}I", self._take(4, 4, what))
        left = len(self._body) - self._at
        if count * least_bytes > left:
            raise ExchangeError(f"message is cut off in {what}: {count} elements announced, {left} bytes left")
        return int(count)

    def string(self, what: str) -> str:
        """Return a string."""
        content = self._take(self.count(what, least_bytes=1), 1, what)
        try:
            return content.rstrip(b"\0").decode()
        except UnicodeDecodeError as error:
            raise ExchangeError(f"{what} is {quoted(content)}; accepted: UTF-8") from error

    def doubles(self, what: str) -> Array:
        """Return a sequence of float64, shape (n,)."""
        count = self.count(what, least_bytes=8)
        content = self._take(8 * count, 8, what) if count else b""
        return np.frombuffer(content, dtype=f"{self._order}f8").astype(np.float64)

    def duration(self, what: str) -> None:
        """Skip a builtin_interfaces/Duration."""
        self._take(STAMP_BYTES, 4, what)

    def finish(self) -> None:
        """Expect the end of the message."""
        left = len(self._body) - self._at
        if left > _MAX_SLACK:
            raise ExchangeError(f"message has {left} bytes behind its end; it is no sensor_msgs/JointState")
