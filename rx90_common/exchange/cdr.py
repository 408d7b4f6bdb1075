"""Messages as CDR bytes: written into frames laid out once, read field by field, JointState at 4 kHz in Python.

A JointState codec is made for the joint names of its topic. The bytes around the numbers are then constant, a frame,
which compiled code reads and writes in one call. Messages of other publishers (another order of names, a frame_id, big
endian, uninitialised padding) are read field by field.

Alignment padding is written as zeros, so that equal values give equal bytes. The serialiser of rclpy leaves what
was in memory there and up to 15 unused bytes at the end; apart from those, both write the same.

A message with a header begins with four bytes of encapsulation, the second of which is the byte order, int32 seconds
and uint32 nanoseconds.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]  # numba exports without saying so
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.quoting import counted, quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr_stamps import (
    ENCAPSULATION,
    HEAD,
    LITTLE_ENDIAN,
    STAMP,
    STAMP_BYTES,
    cdr_stamp,
)
from rx90_common.kernels.compiled import c_function

_COUNT = struct.Struct("<I")
_TRANSLATION = struct.Struct("<3d")
_ROTATION = struct.Struct("<4d")
_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # the two plain encodings of CDR
_MAX_SLACK = 15  # serialisers reserve alignment and counts that they then do not need
_MAX_STAMP_NS = (1 << 31) * NANOSECONDS - 1

# A frame in memory begins at byte 4, so that the numbers, aligned from byte 4 of the message on, are aligned. Its
# shape: bytes of the message, numbers in a block, and for each of three blocks where it begins in memory, or -1.
_MARGIN = 4
_BODY = _MARGIN + ENCAPSULATION
_BLOCKS = 3
_SHAPE_LENGTH = 2 + _BLOCKS
_NO_MATCH = -1

Arrays = tuple[Array | None, Array | None, Array | None]
"""Position, velocity and effort in a codec's order, shape (n,), None when empty."""


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


class CdrReader:
    """Walk through the body of a CDR message; alignment counts from the body's start.

    Args:
        raw: the message, with its encapsulation.

    Raises:
        ExchangeError: here and from every method, naming the field in which the bytes are no message.
    """

    def __init__(self, raw: bytes) -> None:
        if len(raw) < ENCAPSULATION:
            raise ExchangeError(
                f"message is cut off: {counted(len(raw), 'byte')}, no CDR encapsulation"
            )
        order = _BYTE_ORDERS.get(bytes(raw[:2]))
        if order is None:
            encapsulation = bytes(raw[:2]).hex()
            raise ExchangeError(
                f"message has the encapsulation 0x{encapsulation}; accepted: plain CDR, 0x0000 or 0x0001"
            )
        self._order = order
        self._body = raw[ENCAPSULATION:]
        self._at = 0

    def take(self, field: str, size: int, alignment: int = 1) -> bytes:
        """Return so many bytes, aligned."""
        start = self._at + -self._at % alignment
        self._at = start + size
        if self._at > len(self._body):
            raise ExchangeError(
                f"message is cut off in {field}: {counted(len(self._body), 'byte')} of body, {self._at} needed"
            )
        return self._body[start : self._at]

    def length(self, field: str, least_bytes: int = 1) -> int:
        """Return the length of a sequence; refuse one that the rest cannot hold before anything is built."""
        (length,) = struct.unpack(f"{self._order}I", self.take(field, 4, 4))
        left = len(self._body) - self._at
        if length * least_bytes > left:
            raise ExchangeError(
                f"message is cut off in {field}: {counted(length, 'element')} announced, {counted(left, 'byte')} left"
            )
        return int(length)

    def string(self, field: str) -> str:
        """Return a string."""
        content = self.take(field, self.length(field))
        try:
            return content.rstrip(b"\0").decode()
        except UnicodeDecodeError as error:
            raise ExchangeError(f"{field} is {quoted(content)}; accepted: UTF-8") from error

    def doubles(self, field: str) -> Array:
        """Return a sequence of float64, shape (n,)."""
        length = self.length(field, 8)
        content = self.take(field, 8 * length, 8 if length else 1)
        return np.frombuffer(content, dtype=f"{self._order}f8").astype(np.float64)

    def finish(self) -> None:
        """Expect the end of the message."""
        remaining = len(self._body) - self._at
        if remaining > _MAX_SLACK:
            raise ExchangeError(
                f"message has {remaining} bytes behind its end; it is no sensor_msgs/JointState"
            )


def transform_encoder(
    links: Sequence[tuple[str, str]], translation: Array
) -> Callable[[int, Array], bytes]:
    """Return a function that encodes tf2_msgs/TFMessage between given frames: frames and translations stay.

    Its arguments are the stamp, ns, of all transforms and their rotations, (n, 4) quaternions, scalar last.

    Args:
        links: names of parent and child frame.
        translation: (n, 3) m.
    """
    body = CdrBody()
    body.count(len(links))
    stamps = []
    rotations = []
    for (parent, child), shift in zip(links, translation, strict=True):
        body.align(4)
        stamps.append(ENCAPSULATION + body.zeros(STAMP.size))
        body.string(parent)
        body.string(child)
        body.align(8)
        body.raw += _TRANSLATION.pack(*shift)
        rotations.append(ENCAPSULATION + body.zeros(_ROTATION.size))
    message = body.message()

    def encode(stamp_ns: int, rotation: Array) -> bytes:
        stamp = divmod(stamp_ns, NANOSECONDS)
        for at in stamps:
            STAMP.pack_into(message, at, *stamp)
        for at, quaternion in zip(rotations, rotation.tolist(), strict=True):
            _ROTATION.pack_into(message, at, *quaternion)
        return bytes(message)

    return encode


@c_function(types.int64(types.voidptr, types.voidptr, types.voidptr, types.voidptr, types.voidptr))
def _read_frame(raw_at, expected_at, mask_at, memory_at, shape_at):  # type: ignore[no-untyped-def]  # addresses
    """Copy a message to `memory` and return its stamp, ns, or _NO_MATCH if it is not of the expected form.

    Args:
        raw_at: the message, as long as the frame.
        expected_at: the frame's constant bytes.
        mask_at: 255 where a byte must be the expected one, else 0.
        memory_at: where to copy it, _MARGIN bytes further.
        shape_at: the frame's shape, int64.
    """
    shape = carray(shape_at, (_SHAPE_LENGTH,), np.int64)
    size = shape[0]
    raw = carray(raw_at, (size,), np.uint8)
    expected = carray(expected_at, (size,), np.uint8)
    mask = carray(mask_at, (size,), np.uint8)
    memory = carray(memory_at, (_MARGIN + size,), np.uint8)
    different = np.uint8(0)
    for i in range(size):
        different |= (raw[i] ^ expected[i]) & mask[i]
        memory[_MARGIN + i] = raw[i]
    if different != 0:
        return _NO_MATCH
    stamp = carray(memory_at, (_BODY // 4 + 2,), np.uint32)
    seconds = np.int64(stamp[_BODY // 4])
    nanoseconds = np.int64(stamp[_BODY // 4 + 1])
    if seconds > 0x7FFFFFFF or nanoseconds >= NANOSECONDS:
        return _NO_MATCH
    numbers = carray(memory_at, ((_MARGIN + size) // 8,), np.float64)
    for block in range(_BLOCKS):
        at = shape[2 + block]
        if at >= 0:
            for i in range(at // 8, at // 8 + shape[1]):
                if not math.isfinite(numbers[i]):
                    return _NO_MATCH
    return seconds * NANOSECONDS + nanoseconds


@c_function(
    types.int64(
        types.int64, types.voidptr, types.voidptr, types.voidptr, types.voidptr, types.voidptr
    )
)
def _write_frame(stamp_ns, memory_at, first_at, second_at, third_at, shape_at):  # type: ignore[no-untyped-def]
    """Write stamp, ns, and numbers into a frame in `memory`; the address of an absent block is not looked at."""
    shape = carray(shape_at, (_SHAPE_LENGTH,), np.int64)
    size = shape[0]
    count = shape[1]
    stamp = carray(memory_at, (_BODY // 4 + 2,), np.uint32)
    stamp[_BODY // 4] = stamp_ns // NANOSECONDS
    stamp[_BODY // 4 + 1] = stamp_ns % NANOSECONDS
    numbers = carray(memory_at, ((_MARGIN + size) // 8,), np.float64)
    for block in range(_BLOCKS):
        at = shape[2 + block] // 8
        if shape[2 + block] >= 0:
            address = first_at if block == 0 else second_at if block == 1 else third_at
            values = carray(address, (count,), np.float64)
            for i in range(count):
                numbers[at + i] = values[i]
    return 0


class _Layout:
    """The bytes of a JointState with a given set of the three arrays, without the numbers.

    Attributes:
        size: bytes of the message.
        blocks: where the numbers of each array begin in the message; below 0 for an absent one.
        expected: its constant bytes, shape (size,).
        views: the numbers of the message read last, None for an absent array.
        reading: the arguments of `_read_frame` besides the message.
        outgoing: memory of a message to write, its constant bytes filled in.
    """

    def __init__(self, names: tuple[str, ...], present: tuple[bool, ...]) -> None:
        numbers = 8 * len(names)
        body = CdrBody()
        body.zeros(STAMP_BYTES)
        body.string("")  # frame_id
        body.strings(names)
        blocks = []
        for there in present:
            body.count(len(names) if there else 0)
            if there:
                body.align(8)
            blocks.append(_BODY + body.zeros(numbers) if there else -1)
        self.size = ENCAPSULATION + len(body.raw)
        self._shape = np.array([self.size, len(names), *blocks], dtype=np.int64)
        self.blocks = [at - _MARGIN for at in blocks]
        self.expected = np.frombuffer(bytes(body.message()), dtype=np.uint8)
        self._mask = np.full(self.size, 255, dtype=np.uint8)
        self._mask[ENCAPSULATION:HEAD] = 0
        for at in self.blocks:
            if at >= 0:
                self._mask[at : at + numbers] = 0
        self._incoming = incoming = np.zeros(_MARGIN + self.size, dtype=np.uint8)
        self.outgoing = np.concatenate([np.zeros(_MARGIN, dtype=np.uint8), self.expected])

        def view(block: int) -> Array | None:
            at = blocks[block]
            return None if at < 0 else incoming[at : at + numbers].view(np.float64)

        self.views: Arrays = (view(0), view(1), view(2))
        # Looked up once: asking an array for its address takes longer than to read a message.
        self.shape_at = self._shape.ctypes.data
        self.outgoing_at = self.outgoing.ctypes.data
        self.reading = (
            self.expected.ctypes.data,
            self._mask.ctypes.data,
            incoming.ctypes.data,
            self.shape_at,
        )


class JointStateCodec:
    """Encode and decode sensor_msgs/JointState for a fixed list of joint names.

    One codec belongs to one thread: `decode` returns views of a buffer that its next call writes again. It writes no
    frame_id, and accepts any.

    Args:
        names: joint names in the order of the arrays, each once.

    Raises:
        ExchangeError: if a name is empty, repeated or holds a NUL.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        if not self.names:
            raise ExchangeError("no joint names given; accepted: one or more")
        for name in self.names:
            if not name or "\0" in name or self.names.count(name) > 1:
                raise ExchangeError(
                    f"joint name {quoted(name)}; accepted: a text without NUL, each name once"
                )
        self._layouts = {
            present: _Layout(self.names, present)
            for present in product((True, False), repeat=_BLOCKS)
        }
        self._expected = self._layouts[True, True, True]
        self._read_frame = _read_frame()

    def encode(
        self,
        stamp_ns: int,
        position: Array | None = None,
        velocity: Array | None = None,
        effort: Array | None = None,
    ) -> bytes:
        """Return the message as CDR, little endian.

        Args:
            stamp_ns: header.stamp in nanoseconds, 0 up to 2^31 seconds.
            position: float64 array of shape (n,) or None for an empty array.
            velocity: as position.
            effort: as position.

        Raises:
            ExchangeError: as `encoder`.
        """
        return self.encoder(position, velocity, effort)(stamp_ns)

    def encoder(
        self,
        position: Array | None = None,
        velocity: Array | None = None,
        effort: Array | None = None,
    ) -> Callable[[int], bytes]:
        """Return a function from header.stamp in ns to the message with the contents of these arrays at the call.

        For arrays that stay where they are in memory and are sent again and again.

        Raises:
            ExchangeError: if an array is not contiguous float64 of shape (n,); from the function, if the stamp is
                out of range.
        """
        arrays = (position, velocity, effort)
        shape = (len(self.names),)
        for array in arrays:
            if array is not None and not (
                array.shape == shape and array.dtype == np.float64 and array.flags.c_contiguous
            ):
                accepted = f"contiguous float64 of shape {shape}"
                raise ExchangeError(
                    f"array to send is {array.dtype} of shape {array.shape}; accepted: {accepted}"
                )
        layout = self._layout(arrays)
        first = _address(position)
        second = _address(velocity)
        third = _address(effort)
        message = layout.outgoing[_MARGIN:]
        outgoing_at = layout.outgoing_at
        shape_at = layout.shape_at
        write_frame = _write_frame()

        # A default argument, so that the owners of the addresses live as long as these are used, also without this
        # codec.
        def encode(stamp_ns: int, _kept: object = (arrays, layout)) -> bytes:
            if not 0 <= stamp_ns <= _MAX_STAMP_NS:
                raise ExchangeError(f"stamp is {stamp_ns} ns; accepted: 0 to {_MAX_STAMP_NS}")
            write_frame(stamp_ns, outgoing_at, first, second, third, shape_at)
            return message.tobytes()

        return encode

    def encode_many(
        self,
        stamp_ns: NDArray[np.int64],
        position: Array | None = None,
        velocity: Array | None = None,
        effort: Array | None = None,
    ) -> NDArray[np.uint8]:
        """Return n messages, uint8 of shape (n, size), with the bytes that `encode` gives for each.

        Args:
            stamp_ns: header.stamp in nanoseconds, shape (n,).
            position: float64 array of shape (n, number of names) or None for empty arrays.
            velocity: as position.
            effort: as position.

        Raises:
            ExchangeError: if a stamp is out of range.
        """
        for wrong in stamp_ns[(stamp_ns < 0) | (stamp_ns > _MAX_STAMP_NS)]:
            raise ExchangeError(f"stamp is {wrong} ns; accepted: 0 to {_MAX_STAMP_NS}")
        layout = self._layout((position, velocity, effort))
        messages = np.tile(layout.expected, (len(stamp_ns), 1))
        stamp = np.stack(np.divmod(stamp_ns, NANOSECONDS), axis=1).astype("<u4")
        messages[:, ENCAPSULATION:HEAD] = stamp.view(np.uint8)
        for at, block in zip(layout.blocks, (position, velocity, effort), strict=True):
            if block is not None:
                numbers = np.ascontiguousarray(block, dtype="<f8").view(np.uint8)
                messages[:, at : at + numbers.shape[1]] = numbers
        return messages

    def decode(self, raw: bytes) -> tuple[int, Array | None, Array | None, Array | None]:
        """Return stamp, ns, and the arrays of a message, shape (n,), None for an empty one.

        The arrays are views of this codec's buffer, valid until its next `decode`: copy values to keep.
        (Fresh arrays cost twice the time.)

        Raises:
            ExchangeError: if the bytes are no complete JointState, a name is missing, unknown or repeated, an
                array has neither n nor 0 elements, or a number is not finite.
        """
        layout = self._expected
        if len(raw) == layout.size:
            stamp_ns = self._read_frame(raw, *layout.reading)
            if stamp_ns != _NO_MATCH:
                position, velocity, effort = layout.views  # faster than `*layout.views`
                return stamp_ns, position, velocity, effort
        # A message of any layout; the next one is expected to have the same set of arrays.
        stamp_ns, arrays = _parse_joint_state(raw, self.names)
        self._expected = layout = self._layout(arrays)
        for view, array in zip(layout.views, arrays, strict=True):
            if view is not None and array is not None:
                view[:] = array
        return stamp_ns, *layout.views

    def _layout(self, arrays: Arrays) -> _Layout:
        first, second, third = arrays
        return self._layouts[first is not None, second is not None, third is not None]


def _address(array: Array | None) -> int:
    return 0 if array is None else array.ctypes.data


def _parse_joint_state(raw: bytes, names: Sequence[str]) -> tuple[int, Arrays]:
    """Return stamp, ns, and (position, velocity, effort) in the order of `names`, None for an empty array."""
    reader = CdrReader(raw)
    reader.take("header.stamp", STAMP_BYTES)
    seconds, nanoseconds = cdr_stamp(raw)
    if nanoseconds >= NANOSECONDS:
        raise ExchangeError(
            f"header.stamp.nanosec is {nanoseconds}; accepted: 0 to {NANOSECONDS - 1}"
        )
    reader.string("header.frame_id")
    given = [reader.string(f"name[{i}]") for i in range(reader.length("name", 4))]
    accepted = ", ".join(names)
    for name in (*given, *names):
        if name not in names or given.count(name) != 1:
            fault = "missing" if name not in given else "repeated" if name in names else "unknown"
            raise ExchangeError(
                f"joint name {quoted(name)} is {fault}; accepted: {accepted}, each once"
            )
    order = [given.index(name) for name in names]
    arrays: list[Array | None] = []
    for field in ("position", "velocity", "effort"):
        values = reader.doubles(field)
        if values.size not in (0, len(names)):
            raise ExchangeError(
                f"{field} has {counted(values.size, 'element')}; accepted: {len(names)} or none"
            )
        ordered = values[order] if values.size else values
        arrays.append(ordered if values.size else None)
        for name, value in zip(names, ordered, strict=False):
            if not math.isfinite(value):
                raise ExchangeError(f"{field} of {name} is {value}; accepted: a finite number")
    reader.finish()
    position, velocity, effort = arrays
    return seconds * NANOSECONDS + nanoseconds, (position, velocity, effort)
