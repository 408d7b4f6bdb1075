"""Turn the joint states of one topic into series, thousands of equal layout at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.topics import FIELDS
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import counted
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.cdr_stamps import ENCAPSULATION, HEAD, LITTLE_ENDIAN, cdr_stamps_ns

Deserialize = Callable[[bytes], Any]

_BLOCK = 8192  # messages; a few MB at a time, whatever the bag's size
_MAX_LAYOUTS = 8  # of one topic; messages of further ones are deserialised one by one
_MAX_SLACK = 15  # unused bytes that serialisers may leave at the end


class _Content(NamedTuple):
    """Which joints messages name, in their order, and which of FIELDS they carry."""

    names: tuple[str, ...]
    fields: tuple[str, ...]


class _Layout:
    """Where the parts of little-endian CDR messages lie that have the content of a given one.

    Each part is aligned to its size, counted behind the encapsulation; the padding between them may hold anything.
    """

    def __init__(self, content: _Content, frame_id: str, sample: bytes) -> None:
        fixed = list(range(ENCAPSULATION))
        numbers: list[int] = []
        texts = [len(text.encode()) + 5 for text in (frame_id, *content.names)]  # a length before, a NUL behind
        parts = [(size, 4, fixed) for size in (texts[0], 4, *texts[1:])]
        for field in FIELDS:
            parts.append((4, 4, fixed))
            if field in content.fields:
                parts.append((8 * len(content.names), 8, numbers))
        end = HEAD
        for size, alignment, places in parts:
            end += -(end - ENCAPSULATION) % alignment
            places.extend(range(end, end + size))
            end += size
        self.content = content
        self.end = end
        self._fixed = np.array(fixed)
        self._numbers = np.array(numbers, dtype=np.intp)
        self.fits_sample = sample[:ENCAPSULATION] == LITTLE_ENDIAN and 0 <= len(sample) - end <= _MAX_SLACK
        if self.fits_sample:
            self._expected = np.frombuffer(sample, np.uint8)[self._fixed]

    def fits(self, block: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return for each message of `block`, shape (n, end), whether it has this layout."""
        return np.asarray((block[:, self._fixed] == self._expected).all(axis=1))

    def values(self, block: NDArray[np.uint8]) -> Array:
        """Return the numbers of messages of this layout, shape (n, fields, joints)."""
        numbers = np.take(block, self._numbers, axis=1).view("<f8").astype(np.float64, copy=False)
        return numbers.reshape(len(block), len(self.content.fields), len(self.content.names))


class _Rows(NamedTuple):
    """Messages of one content: places among the topic's messages, stamps, and values (n, fields, joints)."""

    place: NDArray[np.intp]
    stamp_ns: Int64Array
    values: Array


class SeriesBuilder:
    """Collects the messages of one topic and builds one JointSeries for each set of joints that occurs in it.

    Args:
        topic: absolute topic name.
        deserialize: the general path, by rosbags; returns an object with the message's fields.
        cdr: whether the messages are CDR, so that the fast path may be tried.
        effort_unit: as in JointSeries.
    """

    def __init__(self, topic: str, deserialize: Deserialize, *, cdr: bool, effort_unit: str = "") -> None:
        self._topic = topic
        self._effort_unit = effort_unit
        self._deserialize = deserialize
        self._cdr = cdr
        self._pending: list[bytes] = []
        self._times: list[int] = []
        self._layouts: list[_Layout] = []
        self._rows: dict[_Content, list[_Rows]] = {}
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
        sets: dict[frozenset[str], list[_Content]] = {}
        for content in sorted(self._rows, key=lambda content: min(rows.place[0] for rows in self._rows[content])):
            sets.setdefault(frozenset(content.names), []).append(content)
        return [self._merge(contents) for contents in sets.values()]

    def _merge(self, contents: list[_Content]) -> JointSeries:
        names, fields = contents[0]
        rows: list[_Rows] = []
        for content in contents:
            if content.fields != fields:
                start = min(int(rows.stamp_ns[0]) for rows in self._rows[content])
                raise BagError(
                    f"{self._topic}: carries {', '.join(fields) or 'no arrays'} in some messages "
                    f"and {', '.join(content.fields) or 'no arrays'} in others (from t = {start / NANOSECONDS:.9f} s)"
                )
            columns = [content.names.index(name) for name in names]
            same = content.names == names
            rows += [part if same else part._replace(values=part.values[:, :, columns]) for part in self._rows[content]]
        place = np.concatenate([part.place for part in rows])
        order = np.argsort(place)
        stamp = np.concatenate([part.stamp_ns for part in rows])
        if self._times:
            stamp = np.array(self._times, dtype=np.int64)[place]
        arrays = {  # one after the other: of a long bag all of them twice would be a lot of memory
            field: np.concatenate([part.values[:, k] for part in rows])[order] for k, field in enumerate(fields)
        }
        return JointSeries(self._topic, names, stamp[order], **arrays, effort_unit=self._effort_unit)

    def _decode_pending(self) -> None:
        messages = self._pending
        start = self._decoded
        self._pending = []
        self._decoded += len(messages)
        size = np.array([len(message) for message in messages])
        remaining = np.arange(len(messages))
        tried = 0
        while len(remaining):
            if tried == len(self._layouts):  # of this message a new layout may be learnt
                self._decode_one(messages[remaining[0]], remaining[:1] + start)
                remaining = remaining[1:]
                continue
            layout = self._layouts[tried]
            tried += 1
            slack = size[remaining] - layout.end
            rows = remaining[(slack >= 0) & (slack <= _MAX_SLACK)]
            joined = b"".join([messages[row][: layout.end] for row in rows.tolist()])
            block = np.frombuffer(joined, np.uint8).reshape(len(rows), layout.end)
            fits = layout.fits(block)
            if fits.any():
                fitting = block[fits]
                self._keep(layout.content, rows[fits] + start, cdr_stamps_ns(fitting), layout.values(fitting))
                remaining = np.setdiff1d(remaining, rows[fits], assume_unique=True)

    def _keep(self, content: _Content, place: NDArray[np.intp], stamp_ns: Int64Array, values: Array) -> None:
        self._rows.setdefault(content, []).append(_Rows(place, stamp_ns, values))

    def _decode_one(self, raw: bytes, place: NDArray[np.intp]) -> None:
        """Decode a message by the general path, and learn its layout."""
        message = self._message(raw)
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
        content = _Content(names, tuple(field for field, array in arrays.items() if len(array)))
        values = np.array([array for array in arrays.values() if len(array)]).reshape(1, -1, len(names))
        self._keep(content, place, np.array([stamp_ns], dtype=np.int64), values)
        if self._cdr and len(self._layouts) < _MAX_LAYOUTS:
            layout = _Layout(content, message.header.frame_id, raw)
            if layout.fits_sample:
                block = np.frombuffer(raw[: layout.end], np.uint8).reshape(1, -1)
                if layout.values(block).tobytes() == values.tobytes():
                    self._layouts.append(layout)

    def _message(self, raw: bytes) -> Any:
        """Return the message as rosbags builds it, which tolerates 3 unused bytes at its end."""
        slack = 0
        while True:
            try:
                return self._deserialize(raw[: len(raw) - slack])
            except BagError:
                slack += 4
                if slack > _MAX_SLACK or not self._cdr:
                    raise
