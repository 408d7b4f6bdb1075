"""The messages of a Temperature topic as a series: a row for those of one moment, a column for each frame_id.

A message holds one temperature, of the joint or winding that its frame_id names. What has no message in a row is NaN
there, and a NaN becomes no message. The variance of a message is not kept.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from rx90_common.bags.batch import Int64Array, MessageBatch
from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.errors import ExchangeError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import LITTLE_ENDIAN, message_time_ns

_HEAD = struct.Struct("<4siII")  # encapsulation, stamp, bytes of the frame_id
_END_NS = (1 << 31) * NANOSECONDS  # stamps are int32 seconds
_VALUES = struct.Struct("<dd")  # temperature, variance


class TemperatureBuilder:
    """Collects the messages of one topic and builds its series.

    Args:
        topic: absolute topic name.
        deserialize: by rosbags; gives an object with the message's fields.
    """

    def __init__(self, topic: str, deserialize: Callable[[bytes], Any]) -> None:
        self._topic, self._deserialize = topic, deserialize
        self._names: dict[str, None] = {}  # in the order of their first messages
        self._stamps: list[int] = []
        self._rows: list[dict[str, float]] = []
        self._moment: int | None = None  # of the last row, by the header

    def add(self, message: bytes, stamp_ns: int | None = None) -> None:
        """Add the next message.

        Args:
            message: as the bag holds it.
            stamp_ns: time to take for the stamp of a row that it begins; None for that in its header.

        Raises:
            BagError: if it is no Temperature.
        """
        read = self._deserialize(message)
        moment, name = message_time_ns(read.header.stamp), str(read.header.frame_id)
        if moment != self._moment or name in self._rows[-1]:
            self._moment = moment
            self._stamps.append(moment if stamp_ns is None else stamp_ns)
            self._rows.append({})
        self._names.setdefault(name)
        self._rows[-1][name] = float(read.temperature)

    def build(self) -> list[JointSeries]:
        """Return the series; none without messages."""
        if not self._rows:
            return []
        values = [[row.get(name, math.nan) for name in self._names] for row in self._rows]
        stamps = np.array(self._stamps, dtype=np.int64)
        return [JointSeries(self._topic, tuple(self._names), stamps, temperature=np.array(values, dtype=np.float64))]


class TemperatureEncoder:
    """Gives the messages of a series of temperatures.

    Attributes:
        stamp_ns: of each message, int64 (n,).
    """

    def __init__(self, series: JointSeries) -> None:
        assert series.temperature is not None
        row, self._column = np.nonzero(~np.isnan(series.temperature))
        self._names = series.names
        self._values = series.temperature[row, self._column]
        self.stamp_ns = series.stamp_ns[row]

    def encode(self, rows: Int64Array) -> MessageBatch:
        """Return these messages.

        Raises:
            ExchangeError: if a name or a stamp cannot stand in a message.
        """
        told = zip(self.stamp_ns[rows].tolist(), self._column[rows].tolist(), self._values[rows].tolist(), strict=True)
        return MessageBatch.of([temperature_cdr(stamp, self._names[column], value) for stamp, column, value in told])


def temperature_cdr(stamp_ns: int, name: str, temperature: float) -> bytes:
    """Return a sensor_msgs/Temperature as CDR, little endian, with variance 0, which stands for an exact value.

    Args:
        stamp_ns: 0 up to 2^31 seconds.
        name: of a joint or motor, for the frame_id.
        temperature: degrees Celsius.

    Raises:
        ExchangeError: if the name or the stamp cannot stand in a message.
    """
    if not 0 <= stamp_ns < _END_NS:
        raise ExchangeError(f"stamp is {stamp_ns} ns; accepted: 0 to {_END_NS - 1}")
    if "\0" in name:
        raise ExchangeError(f"name {quoted(name)}; accepted: text without NUL")
    text = name.encode() + b"\0"
    head = _HEAD.pack(LITTLE_ENDIAN, *divmod(stamp_ns, NANOSECONDS), len(text)) + text
    padding = -(len(head) - len(LITTLE_ENDIAN)) % 8
    return head + bytes(padding) + _VALUES.pack(temperature, 0.0)
