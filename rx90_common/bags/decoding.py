"""Turn the joint states of one topic into arrays, thousands of equal layout at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.topics import FIELDS
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError, ExchangeError
from rx90_common.base.quoting import counted
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.cdr import (
    ENCAPSULATION,
    LITTLE_ENDIAN,
    STAMP_BYTES,
    JointStateCodec,
    cdr_stamps_ns,
)

Deserialize = Callable[[bytes], Any]

_BLOCK = 8192  # messages; a few MB at a time, whatever the bag's size
_MAX_PATTERNS = 8  # of one topic; messages of further ones are deserialised one by one
_MAX_SLACK = 15  # unused bytes that serialisers may leave at the end


class _Layout(NamedTuple):
    """Which joints messages name, in their order, and which of FIELDS they carry."""

    names: tuple[str, ...]
    fields: tuple[str, ...]


class _MessagePattern:
    """Return the places of the numbers in messages of the same layout as a given one.

    The codec determines them: two encodings that differ in every byte of every number show their places. All
    other bytes (names, counts, frame_id, also the padding) must equal the given message's.
    """

    def __init__(self, sample: bytes, layout: _Layout, frame_id: str) -> None:
        codec = JointStateCodec(layout.names, frame_id)
        low = np.zeros(len(layout.names))
        high = np.frombuffer(b"\x01" * 8 * len(layout.names))
        bytes_low = np.frombuffer(
            codec.encode(0, *(low if field in layout.fields else None for field in FIELDS)), np.uint8
        )
        bytes_high = np.frombuffer(
            codec.encode(16843009 * (NANOSECONDS + 1), *(high if field in layout.fields else None for field in FIELDS)),
            np.uint8,
        )
        variable = bytes_low != bytes_high
        if sample[:ENCAPSULATION] != LITTLE_ENDIAN or not 0 <= len(sample) - len(variable) <= _MAX_SLACK:
            raise ExchangeError("a pattern that the codec does not write")
        self.layout = layout
        self.length = len(sample)
        self._variable = np.flatnonzero(variable)[STAMP_BYTES:]
        self._constant = np.flatnonzero(~variable)
        self._expected = np.frombuffer(sample, dtype=np.uint8)[self._constant]

    def matches(self, block: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return for each message of `block`, shape (n, length), whether it has this pattern."""
        return np.asarray((block[:, self._constant] == self._expected).all(axis=1))

    def values(self, block: NDArray[np.uint8]) -> Array:
        """Return the numbers of messages that have this pattern, shape (n, fields, joints)."""
        numbers = np.ascontiguousarray(block[:, self._variable]).view("<f8").astype(np.float64, copy=False)
        return numbers.reshape(len(block), len(self.layout.fields), len(self.layout.names))


class SeriesBuilder:
    """Collects the messages of one topic and builds one JointSeries for each set of joints that occurs in it.

    Args:
        topic: absolute topic name, for messages.
        deserialize: the general path, by rosbags; returns an object with the message's fields.
        cdr: whether the messages are CDR, so that the fast path may be tried.
        effort_unit: as in JointSeries.
        fields: arrays to keep, if the messages contain them.
    """

    def __init__(
        self, topic: str, deserialize: Deserialize, *, cdr: bool, effort_unit: str = "", fields: Sequence[str] = FIELDS
    ) -> None:
        self._topic = topic
        self._effort_unit = effort_unit
        self._fields = fields
        self._deserialize = deserialize
        self._cdr = cdr
        self._pending: list[bytes] = []
        self._times: list[int] = []
        self._patterns: list[_MessagePattern] = []
        # By layout: places among the topic's messages, stamps, and values (n, kept fields, joints).
        self._rows: dict[_Layout, list[tuple[NDArray[np.intp], Int64Array, Array]]] = {}
        self._decoded = 0

    def add(self, message: bytes, stamp_ns: int | None = None) -> None:
        """Add the next message.

        Args:
            message: as in the bag.
            stamp_ns: time to use as its stamp; None in all messages for the stamps of their headers.
        """
        self._pending.append(message)
        if stamp_ns is not None:
            self._times.append(stamp_ns)
        if len(self._pending) == _BLOCK:
            self._decode_pending()

    def build(self) -> list[JointSeries]:
        """Return one series per set of joints; joints that changed their order come in the first one's."""
        self._decode_pending()
        groups: dict[frozenset[str], list[_Layout]] = {}
        for layout in sorted(self._rows, key=lambda layout: min(place[0] for place, _, _ in self._rows[layout])):
            groups.setdefault(frozenset(layout.names), []).append(layout)
        return [self._merge(layouts) for layouts in groups.values()]

    def _merge(self, layouts: list[_Layout]) -> JointSeries:
        names, fields = layouts[0]
        for other in layouts[1:]:
            if other.fields != fields:
                start = min(int(stamps[0]) for _, stamps, _ in self._rows[other])
                raise BagError(
                    f"{self._topic}: carries {', '.join(fields) or 'no arrays'} in some messages "
                    f"and {', '.join(other.fields) or 'no arrays'} in others (from t = {start / NANOSECONDS:.9f} s)"
                )
        parts = [(*rows, [one.names.index(name) for name in names]) for one in layouts for rows in self._rows[one]]
        place = np.concatenate([part[0] for part in parts])
        order = np.argsort(place)
        stamp = np.concatenate([part[1] for part in parts])
        if self._times:
            stamp = np.array(self._times, dtype=np.int64)[place]
        arrays = {  # one after the other: of a long bag all of them twice would be a lot of memory
            field: np.concatenate([values[:, k][:, columns] for _, _, values, columns in parts])[order]
            for k, field in enumerate(field for field in fields if field in self._fields)
        }
        return JointSeries(self._topic, names, stamp[order], **arrays, effort_unit=self._effort_unit)

    def _decode_pending(self) -> None:
        messages = self._pending
        self._pending = []
        start = self._decoded
        self._decoded = self._decoded + len(messages)
        lengths = np.array([len(message) for message in messages])
        for length in np.unique(lengths):
            remaining = np.flatnonzero(lengths == length)
            block = np.frombuffer(b"".join([messages[i] for i in remaining]), dtype=np.uint8).reshape(
                len(remaining), -1
            )
            tried = 0
            while len(remaining):
                if tried == len(self._patterns):  # a new one may be learnt of this message
                    self._decode_one(messages[remaining[0]], remaining[:1] + start)
                    remaining = remaining[1:]
                    block = block[1:]
                    continue
                pattern = self._patterns[tried]
                tried += 1
                if pattern.length == length and (fits := pattern.matches(block)).any():
                    fitting = block[fits]
                    self._keep(pattern.layout, remaining[fits] + start, cdr_stamps_ns(fitting), pattern.values(fitting))
                    remaining = remaining[~fits]
                    block = block[~fits]

    def _keep(self, layout: _Layout, place: NDArray[np.intp], stamps: Int64Array, values: Array) -> None:
        kept = [k for k, field in enumerate(layout.fields) if field in self._fields]
        values = values[:, kept] if len(kept) < len(layout.fields) else values
        self._rows.setdefault(layout, []).append((place, stamps, values))

    def _decode_one(self, raw: bytes, place: NDArray[np.intp]) -> None:
        """Decode a message by the general path, and learn its pattern."""
        slacks = [0, *(range(4, _MAX_SLACK + 1, 4) if self._cdr else ())]  # unused bytes, of which rosbags tolerates 3
        for slack in slacks:
            try:
                message = self._deserialize(raw[: len(raw) - slack])
                break
            except BagError:
                if slack == slacks[-1]:
                    raise
        names = tuple(message.name)
        arrays = {field: np.asarray(getattr(message, field), dtype=np.float64) for field in FIELDS}
        stamp_ns = message_time_ns(message.header.stamp)
        where = f"{self._topic} at t = {stamp_ns / NANOSECONDS:.9f} s"
        if not names or len(set(names)) != len(names):
            raise BagError(f"{where}: joint names are {list(names)}; accepted: one or more, each once")
        for field, array in arrays.items():
            if len(array) not in (0, len(names)):
                raise BagError(
                    f"{where}: {counted(len(array), 'number')} in {field} for {counted(len(names), 'joint')}"
                )
        layout = _Layout(names, tuple(field for field, array in arrays.items() if len(array)))
        values = np.array([array for array in arrays.values() if len(array)]).reshape(1, -1, len(names))
        self._keep(layout, place, np.array([stamp_ns], dtype=np.int64), values)
        if self._cdr and len(self._patterns) < _MAX_PATTERNS:
            with suppress(ExchangeError):
                self._patterns.append(_MessagePattern(raw, layout, message.header.frame_id))
