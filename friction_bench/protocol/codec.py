"""Frames on the line: COBS(type, sequence, payload, CRC-16/CCITT-FALSE), closed by 0x00."""

from __future__ import annotations

import binascii
from dataclasses import dataclass

MAX_DECODED = 32
"""Longest frame before COBS, in bytes; what is longer is noise."""


@dataclass(frozen=True)
class Frame:
    """One intact frame: type and sequence in 0..255, payload without CRC."""

    type: int
    sequence: int
    payload: bytes


def crc16(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE of `data` (polynomial 0x1021, start 0xFFFF, not reflected)."""
    return binascii.crc_hqx(data, 0xFFFF)


def cobs_encode(data: bytes) -> bytes:
    """Replace the zeros of `data` (shorter than 254 bytes), so that 0x00 can delimit frames."""
    if len(data) >= 254:
        raise ValueError(f"{len(data)} bytes; accepted: at most 253")
    return b"".join(bytes([len(block) + 1]) + block for block in data.split(b"\0"))


def cobs_decode(data: bytes) -> bytes | None:
    """Invert `cobs_encode`; None where `data` cannot come from it."""
    blocks = []
    at = 0
    while at < len(data):
        code = data[at]
        block = data[at + 1 : at + code]
        if code == 0 or len(block) != code - 1 or 0 in block:
            return None
        blocks.append(block)
        at += code
    return b"\0".join(blocks) if blocks else None


def encode(frame: Frame) -> bytes:
    """Return the bytes of `frame` on the line, delimiter included."""
    body = bytes([frame.type, frame.sequence]) + frame.payload
    if len(body) + 2 > MAX_DECODED:
        raise ValueError(f"payload of {len(frame.payload)} bytes; accepted: at most {MAX_DECODED - 4}")
    return cobs_encode(body + crc16(body).to_bytes(2, "little")) + b"\0"


def decode(encoded: bytes) -> Frame | None:
    """Return the frame between two delimiters, None unless it is intact."""
    data = cobs_decode(encoded)
    if data is None or not 4 <= len(data) <= MAX_DECODED:
        return None
    body = data[:-2]
    if crc16(body) != int.from_bytes(data[-2:], "little"):
        return None
    return Frame(body[0], body[1], body[2:])


class FrameDecoder:
    """Cuts a byte stream into frames; damage costs the frames it hit and nothing else.

    Attributes:
        bad: refused frames so far.
    """

    def __init__(self) -> None:
        self.bad = 0
        self._buffer = bytearray()
        self._overlong = False

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that `data` completes, in order."""
        frames = []
        for byte in data:
            if byte:
                self._append(byte)
                continue
            frame = None if self._overlong else decode(bytes(self._buffer))
            if frame is not None:
                frames.append(frame)
            elif self._buffer or self._overlong:
                self.bad += 1
            self._buffer.clear()
            self._overlong = False
        return frames

    def _append(self, byte: int) -> None:
        # COBS adds one byte; noise without a zero must not fill the memory.
        if len(self._buffer) > MAX_DECODED:
            self._overlong = True
        else:
            self._buffer.append(byte)
