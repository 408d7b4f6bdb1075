"""control_msgs/JointTrajectoryControllerState as CDR bytes whose numbers are written in place; needs no rclpy.

To fill and serialise a message in Python takes longer than a tick. Alignment padding is written as zeros, so that equal
values give equal bytes; the serialiser of rclpy leaves there whatever was in memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.stamps import ENCAPSULATION
from rx90_common.exchange.cdr_body import CdrBody

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
        body = CdrBody()
        stamp = body.zeros(8)
        body.string("")  # frame_id
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

        self._raw = body.message()

        def part(kind: str, at: int, size: int) -> NDArray[Any]:
            return np.frombuffer(self._raw, kind, size, ENCAPSULATION + at)

        self.stamp = part("<i4", stamp, 2)
        self.times = [part("<i4", at, 2) for at in times[:2]]
        self.numbers = {key: part("<f8", at, len(names)) for key, at in numbers.items()}
        self.scaling = part("<f8", scaling, 1)

    def encode(self) -> bytes:
        """Return the message as it is now."""
        return bytes(self._raw)
