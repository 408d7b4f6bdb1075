"""Turn the joint states of one topic into series, thousands of equal layout at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.storage import BagTopic
from rx90_common.bags.topics import FIELDS
from rx90_common.base.arrays import Array, Index
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import counted, listed, quoted
from rx90_common.base.rates import message_time_ns
from rx90_common.exchange.cdr_stamps import ENCAPSULATION, HEAD, LITTLE_ENDIAN, cdr_stamps_ns

_BLOCK = 8192  # messages; a few MB at a time, whatever the bag's size


class _Content(NamedTuple):
    """Which joints messages name, in their order, and which of FIELDS they carry."""

    names: tuple[str, ...]
    fields: tuple[str, ...]


class _Rows(NamedTuple):
    """Messages of one content: places among the topic's messages, stamps, and values (n, fields, joints)."""

    place: Index
    stamp_ns: Int64Array
    values: Array


class SeriesBuilder:
    """Collects the messages of one topic and builds one JointSeries for each set of joints that occurs in it.

    Args:
        topic: of joint states.
        effort_units: of topics whose efforts are not in the usual unit of their names.
        deserialize: the general path, by rosbags; returns an object with the message's fields.
    """

    def __init__(
        self, topic: BagTopic, effort_units: Mapping[str, str], deserialize: Callable[[bytes], Any]
    ) -> None:
        self._topic = topic.name
        self._effort_unit = effort_units.get(topic.name, "")
        self._deserialize = deserialize
        self._beginning = None if topic.is_ros1 else LITTLE_ENDIAN
        self._pending: list[bytes] = []
        self._times: list[int] = []
        self._sets: dict[frozenset[str], tuple[_Content, list[_Rows]]] = {}
        self._decoded = 0

    def add(self, message: bytes, stamp_ns: int | None = None) -> None:
        """Add the next message; with a time to use as its stamp, in all messages or in none."""
        self._pending.append(message)
        if stamp_ns is not None:
            self._times.append(stamp_ns)
        if len(self._pending) == _BLOCK:
            self._decode_pending()

    def build(self) -> list[JointSeries]:
        """Return one series per set of joints; joints that changed their order come in the first one's."""
        self._decode_pending()
        built = []
        for (names, fields), parts in self._sets.values():
            place = np.concatenate([part.place for part in parts])
            order = np.argsort(place)
            stamp = np.concatenate([part.stamp_ns for part in parts])
            if self._times:
                stamp = np.array(self._times, dtype=np.int64)[place]
            arrays = {  # one after the other: of a long bag all of them twice would be a lot of memory
                field: np.concatenate([part.values[:, k] for part in parts])[order]
                for k, field in enumerate(fields)
            }
            built.append(
                JointSeries(
                    self._topic, names, stamp[order], **arrays, effort_unit=self._effort_unit
                )
            )
        return built

    def _keep(self, content: _Content, place: Index, stamp_ns: Int64Array, values: Array) -> None:
        """Keep messages with those of the same joints, in the order of joints of the first one."""
        first, parts = self._sets.setdefault(frozenset(content.names), (content, []))
        if content.fields != first.fields:
            both = f"{listed(first.fields) or 'no arrays'} in some messages and {listed(content.fields) or 'no arrays'}"
            raise BagError(f"{self._topic}: carries {both} in others; accepted: the same in all")
        columns = [content.names.index(name) for name in first.names]
        values = values.reshape(len(place), len(first.fields), len(columns))
        parts.append(_Rows(place, stamp_ns, values if content == first else values[:, :, columns]))

    def _decode_pending(self) -> None:
        """Decode messages of the layout that the first of their length has together, others one by one."""
        messages = self._pending
        start = self._decoded
        self._pending = []
        self._decoded += len(messages)
        sizes = np.array([len(message) for message in messages])
        for size in dict.fromkeys(sizes.tolist()):
            rows = np.flatnonzero(sizes == size)
            if messages[rows[0]][:ENCAPSULATION] == self._beginning:
                message = self._deserialize(messages[rows[0]])
                content = self._content(message)
                joined = b"".join([messages[row] for row in rows])
                block = np.frombuffer(joined, np.uint8).reshape(-1, size)
                fixed, numbers = _places(message.header.frame_id, content)
                fits = (block[:, fixed] == block[0, fixed]).all(axis=1)
                values = np.take(block[fits], numbers, axis=1).view("<f8")
                self._keep(content, rows[fits] + start, cdr_stamps_ns(block[fits]), values)
                rows = rows[~fits]
            for row in rows:
                message = self._deserialize(messages[row])
                content = self._content(message)
                stamp_ns = np.array([message_time_ns(message.header.stamp)])
                values = np.concatenate([getattr(message, field) for field in FIELDS])
                self._keep(content, np.array([row + start]), stamp_ns, values)

    def _content(self, message: Any) -> _Content:
        names = tuple(message.name)
        arrays = {field: getattr(message, field) for field in FIELDS}
        if not names or len(set(names)) != len(names):
            raise BagError(
                f"{self._topic}: joint names are {quoted(list(names))}; accepted: one or more, each once"
            )
        for field, array in arrays.items():
            if len(array) not in (0, len(names)):
                numbers = f"{counted(len(array), 'number')} in {field}"
                raise BagError(
                    f"{self._topic}: {numbers} for {counted(len(names), 'joint')}; accepted: one for each"
                )
        return _Content(names, tuple(field for field, array in arrays.items() if len(array)))


def _places(frame_id: str, content: _Content) -> tuple[list[int], list[int]]:
    """Return where a CDR message has the bytes that are the same in all with its content, and those of its numbers.

    Each part is aligned to its size, counted behind the encapsulation; the padding between them may hold anything.
    """
    fixed = list(range(ENCAPSULATION))
    numbers: list[int] = []
    # a length before, a NUL behind
    texts = [len(text.encode()) + 5 for text in (frame_id, *content.names)]
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
    return fixed, numbers
