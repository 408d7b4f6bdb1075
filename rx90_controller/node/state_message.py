"""control_msgs/JointTrajectoryControllerState as CDR bytes whose numbers are written in place; needs no rclpy.

To fill and serialise a message in Python takes longer than a tick. Alignment padding is written as zeros, so that equal
values give equal bytes; the serialiser of rclpy leaves there whatever was in memory.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.stamps import ENCAPSULATION, LITTLE_ENDIAN

_FIELDS = ("positions", "velocities", "accelerations", "effort")
_POINTS = {
    "reference": ("positions", "velocities", "accelerations"),
    "feedback": ("positions", "velocities"),
    "error": ("positions", "velocities"),
    "output": ("effort",),
}
"""The points of the message, and what each of them has."""
_OF_SEVERAL_AXES = 4  # points of joints that the arm has not, of three empty sequences and a time each


class StateMessage:
    """The bytes of a message.

    Attributes:
        stamp: seconds and nanoseconds of the header, shape (2,).
        times: time_from_start of reference and feedback, s and ns, shape (2,) each.
        numbers: by point and field, in the order of the joints, shape (n,) each.
        scaling: speed_scaling_factor, shape (1,).
    """

    def __init__(self, names: Sequence[str]) -> None:
        body = _Body()
        stamp = body.zeros(8)
        body.strings([""], counted=False)  # frame_id
        body.strings(names)
        numbers, times = {}, []
        for point, given in _POINTS.items():
            for field in _FIELDS:
                body.count(len(names) if field in given else 0)
                if field in given:
                    body.align(8)
                    numbers[point, field] = body.zeros(8 * len(names))
            times.append(body.zeros(8))
        body.strings([])
        for _ in range(_OF_SEVERAL_AXES):
            for _ in range(3):
                body.count(0)
            body.zeros(8)
        body.align(8)
        scaling = body.zeros(8)

        self._raw = bytearray(LITTLE_ENDIAN) + body.raw

        def part(kind: str, at: int, size: int) -> NDArray[Any]:
            return np.frombuffer(self._raw, kind, size, ENCAPSULATION + at)

        self.stamp = part("<i4", stamp, 2)
        self.times = [part("<i4", at, 2) for at in times[:2]]
        self.numbers = {key: part("<f8", at, len(names)) for key, at in numbers.items()}
        self.scaling = part("<f8", scaling, 1)

    def encode(self) -> bytes:
        """Return the message as it is now."""
        return bytes(self._raw)


class _Body:
    """The body of a CDR message, zeros where numbers are to come."""

    def __init__(self) -> None:
        self.raw = bytearray()

    def align(self, size: int) -> None:
        self.raw += bytes(-len(self.raw) % size)

    def zeros(self, size: int) -> int:
        """Add zero bytes; return where they begin."""
        self.raw += bytes(size)
        return len(self.raw) - size

    def count(self, count: int) -> None:
        self.align(4)
        self.raw += struct.pack("<I", count)

    def strings(self, texts: Sequence[str], *, counted: bool = True) -> None:
        if counted:
            self.count(len(texts))
        for text in texts:
            encoded = text.encode() + b"\0"
            self.count(len(encoded))
            self.raw += encoded
        self.align(4)
