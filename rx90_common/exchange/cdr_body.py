"""Lay out the bytes of a CDR message once, so that only its numbers have to be written later."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from rx90_common.base.stamps import LITTLE_ENDIAN

_COUNT = struct.Struct("<I")


class CdrBody:
    """The body of a little-endian CDR message, zeros where numbers are to come and in the alignment padding.

    Attributes:
        raw: the body so far; alignment counts from its start.
    """

    def __init__(self) -> None:
        self.raw = bytearray()

    def align(self, size: int) -> None:
        """Pad to a multiple of `size` bytes."""
        self.raw += bytes(-len(self.raw) % size)

    def zeros(self, size: int) -> int:
        """Add zero bytes; return where they begin."""
        self.raw += bytes(size)
        return len(self.raw) - size

    def count(self, count: int) -> None:
        """Add the length of a sequence."""
        self.align(_COUNT.size)
        self.raw += _COUNT.pack(count)

    def string(self, text: str) -> None:
        """Add a string."""
        encoded = text.encode() + b"\0"
        self.count(len(encoded))
        self.raw += encoded

    def strings(self, texts: Sequence[str]) -> None:
        """Add a sequence of strings."""
        self.count(len(texts))
        for text in texts:
            self.string(text)

    def message(self) -> bytearray:
        """Return the body with its encapsulation."""
        return bytearray(LITTLE_ENDIAN) + self.raw
