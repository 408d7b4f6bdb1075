"""sensor_msgs/JointState as CDR bytes, fast enough for 4 kHz in Python.

A codec knows the joint names of its topic. The bytes around the numbers are then constant, a frame, which compiled
code reads and writes in one call. Messages of other publishers (another order of names, a frame_id, big endian,
uninitialised padding) take the general path of `joint_state_parser`.

Alignment padding is written as zeros, so that equal values give equal bytes. The serialiser of rclpy leaves
whatever was in memory there and up to 15 unused bytes at the end; apart from those, both write the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]  # numba exports without saying so
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION, HEAD, STAMP_BYTES
from rx90_common.exchange.cdr_body import CdrBody
from rx90_common.exchange.cdr_reader import CdrReader
from rx90_common.kernels.compiled import c_function

_MAX_STAMP_NS = (1 << 31) * NANOSECONDS - 1
_FLOAT64 = np.dtype("<f8")


# stamp in ns and three arrays of shape (n,) in the codec's order, None when empty
JointStateValues = tuple[int, Array | None, Array | None, Array | None]
# shape: bytes of the message, numbers in a block, and for each of three blocks where it begins in memory, or -1.
# The message begins at byte 4 of its memory, so that the numbers, aligned from byte 4 of the message on, are aligned.
MARGIN = 4
_BODY = MARGIN + ENCAPSULATION  # where a message's body begins in memory
SHAPE_LENGTH = 5
NO_MATCH = -1

_BLOCKS = 3
_STAMP_AT = MARGIN + ENCAPSULATION
Arrays = tuple[NDArray[np.float64] | None, NDArray[np.float64] | None, NDArray[np.float64] | None]


def parse_joint_state(raw: bytes, names: Sequence[str]) -> tuple[int, Arrays]:
    """Return stamp_ns and (position, velocity, effort) in the order of `names`, None for an empty array.

    Raises:
        ExchangeError: see `JointStateCodec.decode`.
    """
    reader = CdrReader(raw)
    stamp_ns = reader.stamp_ns()
    reader.string("header.frame_id")
    found = [reader.string(f"name[{i}]") for i in range(reader.count("name", least_bytes=4))]
    order = _order(found, names)
    position, velocity, effort = (
        _pick(reader.doubles(field), order, field, names) for field in ("position", "velocity", "effort")
    )
    reader.finish()
    return stamp_ns, (position, velocity, effort)


def _order(found: list[str], names: Sequence[str]) -> list[int]:
    """Return where each of `names` stands in the message."""
    for name in found:
        if name not in names:
            raise ExchangeError(f"joint name {quoted(name)} is unknown; accepted: {', '.join(names)}")
        if found.count(name) > 1:
            raise ExchangeError(f"joint name {quoted(name)} is repeated; accepted: {', '.join(names)}, each once")
    missing = [name for name in names if name not in found]
    if missing:
        raise ExchangeError(f"joint name {quoted(missing[0])} is missing; accepted: {', '.join(names)}, each once")
    return [found.index(name) for name in names]


def _pick(
    values: NDArray[np.float64], order: list[int], field: str, names: Sequence[str]
) -> NDArray[np.float64] | None:
    if not values.size:
        return None
    if values.size != len(names):
        raise ExchangeError(f"{field} has {values.size} elements; accepted: {len(names)} or none")
    picked = values[order]
    finite = np.isfinite(picked)
    if not finite.all():
        bad = int(np.argmin(finite))
        raise ExchangeError(f"{field} of {names[bad]} is {picked[bad]}; accepted: a finite number")
    return picked


@c_function(types.int64(types.voidptr, types.voidptr, types.voidptr, types.voidptr, types.voidptr))
def read_frame(raw_at, expected_at, mask_at, memory_at, shape_at):  # type: ignore[no-untyped-def]  # addresses
    """Copy a message to `memory` and return its stamp, ns, or NO_MATCH if it is not of the expected form.

    Args:
        raw_at: the message, as long as the frame.
        expected_at: the frame's constant bytes.
        mask_at: 255 where a byte must be the expected one, else 0.
        memory_at: where to copy it, MARGIN bytes further.
        shape_at: the frame's shape, int64.
    """
    shape = carray(shape_at, (SHAPE_LENGTH,), np.int64)
    size = shape[0]
    raw = carray(raw_at, (size,), np.uint8)
    expected, mask = carray(expected_at, (size,), np.uint8), carray(mask_at, (size,), np.uint8)
    memory = carray(memory_at, (MARGIN + size,), np.uint8)
    different = np.uint8(0)
    for i in range(size):
        different |= (raw[i] ^ expected[i]) & mask[i]
        memory[MARGIN + i] = raw[i]
    if different != 0:
        return NO_MATCH
    stamp = carray(memory_at, (_STAMP_AT // 4 + 2,), np.uint32)
    seconds, nanoseconds = np.int64(stamp[_STAMP_AT // 4]), np.int64(stamp[_STAMP_AT // 4 + 1])
    if seconds > 0x7FFFFFFF or nanoseconds >= NANOSECONDS:
        return NO_MATCH
    numbers = carray(memory_at, ((MARGIN + size) // 8,), np.float64)
    for block in range(_BLOCKS):
        at = shape[2 + block]
        if at >= 0:
            for i in range(at // 8, at // 8 + shape[1]):
                if not math.isfinite(numbers[i]):
                    return NO_MATCH
    return seconds * NANOSECONDS + nanoseconds


@c_function(types.int64(types.int64, types.voidptr, types.voidptr, types.voidptr, types.voidptr, types.voidptr))
def write_frame(stamp_ns, memory_at, first_at, second_at, third_at, shape_at):  # type: ignore[no-untyped-def]  # addresses
    """Write stamp and numbers into a frame whose constant bytes are in `memory` already.

    Args:
        stamp_ns: the stamp, ns.
        memory_at: the frame, MARGIN bytes before it.
        first_at: numbers of the first block; not looked at if the frame has none.
        second_at: of the second.
        third_at: of the third.
        shape_at: the frame's shape, int64.
    """
    shape = carray(shape_at, (SHAPE_LENGTH,), np.int64)
    size, count = shape[0], shape[1]
    stamp = carray(memory_at, (_STAMP_AT // 4 + 2,), np.uint32)
    stamp[_STAMP_AT // 4] = stamp_ns // NANOSECONDS
    stamp[_STAMP_AT // 4 + 1] = stamp_ns % NANOSECONDS
    numbers = carray(memory_at, ((MARGIN + size) // 8,), np.float64)
    for block in range(_BLOCKS):
        at = shape[2 + block] // 8
        if shape[2 + block] >= 0:
            address = first_at if block == 0 else second_at if block == 1 else third_at
            values = carray(address, (count,), np.float64)
            for i in range(count):
                numbers[at + i] = values[i]
    return 0


class _Layout:
    """The bytes of a message in which a given set of the three arrays is present, numbers left out.

    Attributes:
        size: bytes of the message.
        shape: what `frame` needs to know of it.
        expected: its constant bytes, shape (size,).
        mask: 255 for each of these, 0 for stamp and numbers.
        incoming: memory of a message that was read.
        outgoing: memory of a message to write, its constant bytes filled in.
        views: the numbers in `incoming`, None for an absent array.
    """

    def __init__(self, names: tuple[str, ...], frame_id: str, present: tuple[bool, ...]) -> None:
        numbers = 8 * len(names)
        body = CdrBody()
        body.zeros(STAMP_BYTES)
        body.string(frame_id)
        body.strings(names)
        blocks = []
        for there in present:
            body.count(len(names) if there else 0)
            if there:
                body.align(8)
            blocks.append(_BODY + body.zeros(numbers) if there else -1)
        self.size = ENCAPSULATION + len(body.raw)
        self.shape = np.array([self.size, len(names), *blocks], dtype=np.int64)
        self.expected = np.frombuffer(bytes(body.message()), dtype=np.uint8)
        self.mask = np.full(self.size, 255, dtype=np.uint8)
        self.mask[ENCAPSULATION:HEAD] = 0
        for at in blocks:
            if at >= 0:
                self.mask[at - MARGIN : at - MARGIN + numbers] = 0
        self.incoming = np.zeros(MARGIN + self.size, dtype=np.uint8)
        self.outgoing = np.concatenate([np.zeros(MARGIN, dtype=np.uint8), self.expected])
        self.views: tuple[Array | None, ...] = tuple(
            None if at < 0 else self.incoming[at : at + numbers].view(np.float64) for at in blocks
        )
        self.position, self.velocity, self.effort = self.views
        # Looked up once: asking an array for its address takes longer than to read a message.
        self.shape_at = self.shape.ctypes.data
        self.reading = (self.expected.ctypes.data, self.mask.ctypes.data, self.incoming.ctypes.data, self.shape_at)
        self.outgoing_at = self.outgoing.ctypes.data


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
            ExchangeError: if the stamp is out of range, or an array is not float64 of shape (n,).
        """
        return self.encoder(position, velocity, effort)(stamp_ns)

    def encoder(
        self,
        position: Array | None = None,
        velocity: Array | None = None,
        effort: Array | None = None,
    ) -> Callable[[int], bytes]:
        """Return a function from header.stamp in ns to the message with what these arrays hold when it is called.

        For arrays that stay where they are in memory and are sent again and again.

        Raises:
            ExchangeError: if an array is not contiguous float64 of shape (n,); from the function, if the stamp is
                out of range.
        """
        arrays = (position, velocity, effort)
        for array in arrays:
            self._check_array(array)
        layout = self._layouts[position is not None, velocity is not None, effort is not None]
        first, second, third = (0 if array is None else array.ctypes.data for array in arrays)
        message = layout.outgoing[MARGIN:]
        outgoing_at, shape_at = layout.outgoing_at, layout.shape_at

        # A default, so that what the addresses belong to lives as long as they are used, also without this codec.
        def encode(stamp_ns: int, _kept: object = (arrays, layout)) -> bytes:
            if not 0 <= stamp_ns <= _MAX_STAMP_NS:
                raise ExchangeError(_stamp_text(stamp_ns))
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
        wrong = (stamp_ns < 0) | (stamp_ns > _MAX_STAMP_NS)
        if wrong.any():
            raise ExchangeError(_stamp_text(int(stamp_ns[np.argmax(wrong)])))
        layout = self._layouts[position is not None, velocity is not None, effort is not None]
        messages = np.tile(layout.expected, (len(stamp_ns), 1))
        stamp = np.stack(np.divmod(stamp_ns, NANOSECONDS), axis=1).astype("<u4")
        messages[:, ENCAPSULATION:HEAD] = stamp.view(np.uint8)
        for at, block in zip(layout.shape[2:] - MARGIN, (position, velocity, effort), strict=True):
            if block is not None:
                numbers = np.ascontiguousarray(block, dtype=_FLOAT64).view(np.uint8)
                messages[:, at : at + numbers.shape[1]] = numbers
        return messages

    def _check_array(self, array: Array | None) -> None:
        if array is None:
            return
        count = len(self.names)
        if array.shape != (count,) or array.dtype != _FLOAT64 or not array.flags.c_contiguous:
            accepted = f"contiguous float64 of shape ({count},)"
            raise ExchangeError(f"array to send is {array.dtype} of shape {array.shape}; accepted: {accepted}")

    def decode(self, raw: bytes) -> JointStateValues:
        """Return stamp and arrays of a message.

        The arrays are views of this codec's buffer, valid until its next `decode`: copy what is kept longer.
        (Fresh arrays cost twice the time.)

        Raises:
            ExchangeError: if the bytes are no complete JointState, a name is missing, unknown or repeated, an
                array has neither n nor 0 elements, or a number is not finite.
        """
        layout = self._expected
        if len(raw) == layout.size:
            stamp_ns = read_frame(raw, *layout.reading)
            if stamp_ns != NO_MATCH:
                return stamp_ns, layout.position, layout.velocity, layout.effort
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


def _stamp_text(stamp_ns: int) -> str:
    return f"stamp is {stamp_ns} ns; accepted: 0 to {_MAX_STAMP_NS}"


def _check_names(names: tuple[str, ...], frame_id: str) -> None:
    if not names:
        raise ExchangeError("no joint names given; accepted: one or more")
    for name in names:
        if not name or "\0" in name or names.count(name) > 1:
            raise ExchangeError(f"joint name {quoted(name)}; accepted: a text without NUL, each name once")
    if "\0" in frame_id:
        raise ExchangeError(f"frame_id {quoted(frame_id)}; accepted: a text without NUL")
