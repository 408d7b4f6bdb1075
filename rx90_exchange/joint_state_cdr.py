"""sensor_msgs/JointState as CDR bytes, fast enough for 4 kHz in Python.

A codec knows the joint names of its topic. The bytes around the numbers are then constant: encoding is one
join of prepared pieces, decoding one comparison and one copy. Messages of other publishers (another order of
names, a frame_id, big endian, uninitialised padding) take the general path of `joint_state_parser`.

Alignment padding is written as zeros, so that equal values give equal bytes. The serialiser of rclpy leaves
whatever was in memory there and up to 15 unused bytes at the end; apart from those, both write the same.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from rx90_common.errors import ExchangeError
from rx90_exchange.joint_state_parser import LITTLE_ENDIAN, parse_joint_state

FloatArray = NDArray[np.float64]

_NS_PER_S = 1_000_000_000
_MAX_STAMP_NS = (1 << 31) * _NS_PER_S - 1
_FLOAT64 = np.dtype("<f8")
_STAMP = struct.Struct("<4siI")  # encapsulation, seconds, nanoseconds


# stamp in ns and three arrays of shape (n,) in the codec's order, None when empty
JointStateValues = tuple[int, FloatArray | None, FloatArray | None, FloatArray | None]


class _Layout:
    """The bytes of a message in which a given set of the three arrays is present, numbers left out."""

    def __init__(self, names: tuple[str, ...], frame_id: str, present: tuple[bool, ...]) -> None:
        count = len(names)
        self.pieces: list[bytes] = []
        self.data_offsets: list[int | None] = []
        piece = _names_block(names, frame_id)
        offset = 8  # of `piece` in the body, behind the stamp
        for there in present:
            piece += bytes(-(offset + len(piece)) % 4) + struct.pack("<I", count if there else 0)
            if not there:
                self.pieces.append(b"")
                self.data_offsets.append(None)
                continue
            piece += bytes(-(offset + len(piece)) % 8)
            self.pieces.append(bytes(piece))
            offset += len(piece)
            self.data_offsets.append(offset)
            offset += 8 * count
            piece = bytearray()
        self.tail = bytes(piece)
        self._prepare_decoding(count, offset + len(piece))

    def _prepare_decoding(self, count: int, body_bytes: int) -> None:
        """Compile the two unpackers, and lay views of the numbers over one buffer."""
        blocks = [(piece, at) for piece, at in zip(self.pieces, self.data_offsets, strict=True) if at]
        numbers = 8 * count
        self.unpack_constants = struct.Struct(
            "<4siI" + "".join(f"{len(piece)}s{numbers}x" for piece, _ in blocks) + f"{len(self.tail)}s"
        ).unpack
        self.unpack_numbers = struct.Struct(
            "<12x" + "".join(f"{len(piece)}x{count}d" for piece, _ in blocks) + f"{len(self.tail)}x"
        ).unpack
        self.constants = (*(piece for piece, _ in blocks), self.tail)
        # Numbers are aligned from the body's start; 4 bytes before the encapsulation align them in memory.
        memory = np.zeros(8 + body_bytes, dtype=np.uint8)
        self.buffer = memoryview(memory.data)[4:]
        self.views: tuple[FloatArray | None, ...] = tuple(
            None if at is None else memory[8 + at : 8 + at + numbers].view(np.float64) for at in self.data_offsets
        )
        self.position, self.velocity, self.effort = self.views


def _names_block(names: tuple[str, ...], frame_id: str) -> bytearray:
    """Return frame_id, the number of names and the names; the block starts at a multiple of 4."""
    block = bytearray(_string(frame_id))
    block += bytes(-len(block) % 4) + struct.pack("<I", len(names))
    for name in names:
        block += bytes(-len(block) % 4) + _string(name)
    return block


def _string(text: str) -> bytes:
    encoded = text.encode() + b"\0"
    return struct.pack("<I", len(encoded)) + encoded


class JointStateCodec:
    """Encode and decode sensor_msgs/JointState for a fixed list of joint names.

    One codec belongs to one thread: `decode` returns views of a buffer that its next call writes again.

    Args:
        names: joint names in the order of the arrays, each once.
        frame_id: header.frame_id that is written; any is accepted when reading.

    Raises:
        ExchangeError: if a name is empty, repeated or holds a NUL.
    """

    def __init__(self, names: Sequence[str], frame_id: str = "") -> None:
        self.names = tuple(names)
        self.frame_id = frame_id
        _check_names(self.names, frame_id)
        self._bytes_per_array = 8 * len(self.names)
        self._layouts = {
            (p, v, e): _Layout(self.names, frame_id, (p, v, e))
            for p in (True, False)
            for v in (True, False)
            for e in (True, False)
        }
        self._expected = self._layouts[True, True, True]

    def encode(
        self,
        stamp_ns: int,
        position: FloatArray | None = None,
        velocity: FloatArray | None = None,
        effort: FloatArray | None = None,
    ) -> bytes:
        """Return the message as CDR, little endian.

        Args:
            stamp_ns: header.stamp in nanoseconds, 0 up to 2^31 seconds.
            position: float64 array of shape (n,) or None for an empty array.
            velocity: as position.
            effort: as position.

        Raises:
            ExchangeError: if the stamp is out of range, or an array is not float64 of shape (n,).
        """
        layout = self._layouts[position is not None, velocity is not None, effort is not None]
        before_position, before_velocity, before_effort = layout.pieces
        if not 0 <= stamp_ns <= _MAX_STAMP_NS:
            raise ExchangeError(f"stamp is {stamp_ns} ns; accepted: 0 to {_MAX_STAMP_NS}")
        return b"".join(
            (
                _STAMP.pack(LITTLE_ENDIAN, *divmod(stamp_ns, _NS_PER_S)),
                before_position,
                b"" if position is None else self._array_bytes(position),
                before_velocity,
                b"" if velocity is None else self._array_bytes(velocity),
                before_effort,
                b"" if effort is None else self._array_bytes(effort),
                layout.tail,
            )
        )

    def _array_bytes(self, array: FloatArray) -> bytes:
        data = array.tobytes()
        if len(data) != self._bytes_per_array or array.dtype != _FLOAT64:
            accepted = f"float64 of shape ({len(self.names)},)"
            raise ExchangeError(f"array to send is {array.dtype} of shape {array.shape}; accepted: {accepted}")
        return data

    def decode(self, raw: bytes) -> JointStateValues:
        """Return stamp and arrays of a message.

        The arrays are views of this codec's buffer, valid until its next `decode`: copy what is kept longer.
        (Fresh arrays cost twice the time.)

        Raises:
            ExchangeError: if the bytes are no complete JointState, a name is missing, unknown or repeated, an
                array has neither n nor 0 elements, or a number is not finite.
        """
        layout = self._expected
        try:
            encapsulation, seconds, nanoseconds, *constants = layout.unpack_constants(raw)
            if (
                encapsulation == LITTLE_ENDIAN
                and (*constants,) == layout.constants
                and isfinite(sum(layout.unpack_numbers(raw)))
                and nanoseconds < _NS_PER_S
            ):
                layout.buffer[:] = raw
                return seconds * _NS_PER_S + nanoseconds, layout.position, layout.velocity, layout.effort
        except struct.error:
            pass  # another length: not the layout of the message before
        return self._decode_any(raw)

    def _decode_any(self, raw: bytes) -> JointStateValues:
        """Parse a message of any layout, and expect its set of arrays in the next one."""
        stamp_ns, arrays = parse_joint_state(raw, self.names)
        position, velocity, effort = arrays
        layout = self._layouts[position is not None, velocity is not None, effort is not None]
        self._expected = layout
        for view, array in zip(layout.views, arrays, strict=True):
            if view is not None and array is not None:
                view[:] = array
        return stamp_ns, layout.position, layout.velocity, layout.effort


def _check_names(names: tuple[str, ...], frame_id: str) -> None:
    if not names:
        raise ExchangeError("no joint names given; accepted: one or more")
    for name in names:
        if not name or "\0" in name or names.count(name) > 1:
            raise ExchangeError(f"joint name {name!r}; accepted: a text without NUL, each name once")
    if "\0" in frame_id:
        raise ExchangeError(f"frame_id {frame_id!r}; accepted: a text without NUL")
