"""Messages as CDR bytes: written into frames laid out once, and JointState at 4 kHz in Python.

A JointState codec is made for the joint names of its topic. The bytes between the numbers are then constant, and
compared as a whole. Messages of other publishers (another order of names, a frame_id, big endian, uninitialised
padding) are read by rosbags.

Alignment padding is written as zeros, so that equal values give equal bytes. The serialiser of rclpy leaves what
was in memory there; apart from that, both write the same.

A message with a header begins with four bytes of encapsulation, the second of which is the byte order, int32 seconds
and uint32 nanoseconds.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from itertools import chain, cycle, pairwise, product

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.quoting import counted, listed, quoted
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.cdr_stamps import ENCAPSULATION, HEAD, LITTLE_ENDIAN, STAMP_BYTES
from rx90_common.exchange.message_types import read_message

_COUNT = struct.Struct("<I")
_STAMP = struct.Struct("<iI")
_TRANSLATION = struct.Struct("<3d")
_ROTATION = struct.Struct("<4d")
_MAX_STAMP_NS = (1 << 31) * NANOSECONDS - 1
_ARRAYS = ("position", "velocity", "effort")
_MARGIN = 4  # before a message in memory: its numbers, aligned from byte 4 of the message on, are then aligned

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


class TransformCodec:
    """Encode tf2_msgs/TFMessage between given frames: frames and translations stay, stamp and rotations change.

    Args:
        links: names of parent and child frame.
        translation: (n, 3) m.
    """

    def __init__(self, links: Sequence[tuple[str, str]], translation: Array) -> None:
        body = CdrBody()
        body.count(len(links))
        self._stamps = []
        self._rotations = []
        for (parent, child), shift in zip(links, translation, strict=True):
            body.align(4)
            self._stamps.append(ENCAPSULATION + body.zeros(_STAMP.size))
            body.string(parent)
            body.string(child)
            body.align(8)
            body.raw += _TRANSLATION.pack(*shift)
            self._rotations.append(ENCAPSULATION + body.zeros(_ROTATION.size))
        self._message = body.message()

    def encode(self, stamp_ns: int, rotation: Array) -> bytes:
        """Return the message.

        Args:
            stamp_ns: of all transforms.
            rotation: (n, 4) quaternions, scalar last.
        """
        stamp = divmod(stamp_ns, NANOSECONDS)
        for at in self._stamps:
            _STAMP.pack_into(self._message, at, *stamp)
        for at, quaternion in zip(self._rotations, rotation.tolist(), strict=True):
            _ROTATION.pack_into(self._message, at, *quaternion)
        return bytes(self._message)


class _Layout:
    """The bytes of a JointState with a given set of the three arrays.

    Attributes:
        blocks: where the message has its numbers, one for each array that is there.
        message: with zeros for stamp and numbers.
        constant_of: unpacks the bytes of a message of this length between these.
        constant: those bytes.
        incoming: memory for a message that is read.
        views: of its numbers, None for an absent array.
        numbers: all of them at once, with the lengths between them, which are finite numbers, too.
    """

    def __init__(self, names: Sequence[str], present: Sequence[bool]) -> None:
        body = CdrBody()
        body.zeros(STAMP_BYTES)
        body.string("")  # frame_id
        body.strings(names)
        self.blocks: list[slice] = []
        for there in present:
            body.count(len(names) if there else 0)
            if there:
                body.align(8)
                begin = ENCAPSULATION + body.zeros(8 * len(names))
                self.blocks.append(slice(begin, begin + 8 * len(names)))
        self.message = bytes(body.message())
        variable = [slice(ENCAPSULATION, HEAD), *self.blocks]
        edges = [0, *chain.from_iterable((part.start, part.stop) for part in variable)]
        lengths = [end - begin for begin, end in pairwise([*edges, len(self.message)])]
        kinds = cycle("sx")  # bytes, and bytes that are left out
        self.constant_of = struct.Struct(
            "".join(f"{length}{next(kinds)}" for length in lengths)
        ).unpack
        self.constant = self.constant_of(self.message)
        # Numbers are aligned from byte 4 of a message on.
        memory = np.zeros(_MARGIN + len(self.message), dtype=np.uint8)[_MARGIN:]
        self.incoming = memory.data
        blocks = iter([memory[block].view(np.float64) for block in self.blocks])
        first, second, third = (next(blocks) if there else None for there in present)
        self.views: Arrays = (first, second, third)
        self.numbers = memory[(self.blocks or variable)[0].start : variable[-1].stop].view(
            np.float64
        )


class JointStateCodec:
    """Encode and decode sensor_msgs/JointState for a fixed list of joint names.

    One codec belongs to one thread: `decode` returns views of a buffer that its next call writes again.

    Args:
        names: joint names in the order of the arrays, each once.

    Raises:
        ExchangeError: if a name is empty, repeated or holds a NUL.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        for name in self.names or ("",):
            if not name or "\0" in name or self.names.count(name) > 1:
                raise ExchangeError(
                    f"joint name {quoted(name)}; accepted: one or more, texts without NUL, each once"
                )
        self._layouts = {
            present: _Layout(self.names, present)
            for present in product((True, False), repeat=len(_ARRAYS))
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

        Raises:
            ExchangeError: if an array is not float64 of shape (n,); from the function, if the stamp is out of range.
        """
        arrays = [array for array in (position, velocity, effort) if array is not None]
        shape = (len(self.names),)
        for array in arrays:
            if array.shape != shape or array.dtype != np.float64:
                raise ExchangeError(
                    f"array to send is {array.dtype} of shape {array.shape}; accepted: float64 of shape {shape}"
                )
        constant = self._layout((position, velocity, effort)).constant
        message = [b""] * (2 * len(constant) - 1)
        message[::2] = constant

        def encode(stamp_ns: int) -> bytes:
            if not 0 <= stamp_ns <= _MAX_STAMP_NS:
                raise ExchangeError(f"stamp is {stamp_ns} ns; accepted: 0 to {_MAX_STAMP_NS}")
            message[1] = _STAMP.pack(*divmod(stamp_ns, NANOSECONDS))
            message[3::2] = [array.tobytes() for array in arrays]
            return b"".join(message)

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
        arrays = [array for array in (position, velocity, effort) if array is not None]
        layout = self._layout((position, velocity, effort))
        messages = np.tile(np.frombuffer(layout.message, np.uint8), (len(stamp_ns), 1))
        stamp = np.stack(np.divmod(stamp_ns, NANOSECONDS), axis=1).astype("<u4")
        messages[:, ENCAPSULATION:HEAD] = stamp.view(np.uint8)
        for block, array in zip(layout.blocks, arrays, strict=True):
            messages[:, block] = np.ascontiguousarray(array, dtype="<f8").view(np.uint8)
        return messages

    def decode(self, raw: bytes) -> tuple[int, Array | None, Array | None, Array | None]:
        """Return stamp, ns, and the arrays of a message, shape (n,), None for an empty one.

        The arrays are views of this codec's buffer, valid until its next `decode`: copy values to keep.
        (Fresh arrays cost twice the time.)

        Raises:
            ExchangeError: if the bytes are no JointState, its names are others, an array has neither n nor 0
                elements, or a number is not finite.
        """
        layout = self._expected
        if len(raw) == len(layout.message) and layout.constant_of(raw) == layout.constant:
            layout.incoming[:] = raw
            seconds, nanoseconds = _STAMP.unpack_from(raw, ENCAPSULATION)
            # a sum is finite if all numbers are
            if math.isfinite(sum(layout.numbers.tolist())) and nanoseconds < NANOSECONDS:
                position, velocity, effort = layout.views
                return seconds * NANOSECONDS + nanoseconds, position, velocity, effort
        # A message of any layout; the next one is expected to have the same set of arrays.
        stamp_ns, arrays = _read_any(raw, self.names)
        self._expected = layout = self._layout(arrays)
        for view, array in zip(layout.views, arrays, strict=True):
            if view is not None and array is not None:
                view[:] = array
        return stamp_ns, *layout.views

    def _layout(self, arrays: Arrays) -> _Layout:
        first, second, third = arrays
        return self._layouts[first is not None, second is not None, third is not None]


def _read_any(raw: bytes, names: Sequence[str]) -> tuple[int, Arrays]:
    """Return stamp, ns, and (position, velocity, effort) in the order of `names`, None for an empty array."""
    message = read_message(raw, "sensor_msgs/msg/JointState")
    if sorted(message.name) != sorted(names):
        raise ExchangeError(
            f"joint names are {listed(message.name)}; accepted: {listed(names)}, each once, in any order"
        )
    nanoseconds = message.header.stamp.nanosec
    if nanoseconds >= NANOSECONDS:
        raise ExchangeError(
            f"header.stamp.nanosec is {nanoseconds}; accepted: 0 to {NANOSECONDS - 1}"
        )
    order = [message.name.index(name) for name in names]
    arrays: list[Array | None] = []
    for field in _ARRAYS:
        values = getattr(message, field)
        if len(values) not in (0, len(names)):
            raise ExchangeError(
                f"{field} has {counted(len(values), 'element')}; accepted: {len(names)} or none"
            )
        arrays.append(values[order] if len(values) else None)
        for name, value in zip(message.name, values.tolist(), strict=False):
            if not math.isfinite(value):
                raise ExchangeError(f"{field} of {name} is {value}; accepted: a finite number")
    position, velocity, effort = arrays
    return message_time_ns(message.header.stamp), (position, velocity, effort)
