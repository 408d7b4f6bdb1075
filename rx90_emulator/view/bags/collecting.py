"""Read the series of a bag that are looked at, in one pass and in little more memory than they take."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from rx90_common.bags.decoding import SeriesBuilder
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import BagReader, BagTopic
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed

_BLOCK = 1 << 16  # messages


class SeriesCollector:
    """Gathers some arrays of one set of joints of a topic, block by block.

    Args:
        bag: open.
        topic: of it.
        fields: which arrays, where the messages carry them.
        names: the joints, in this order; None for those of the first message.
        record_time: whether the times at which messages were recorded are taken for their stamps.
    """

    def __init__(
        self, bag: BagReader, topic: BagTopic, fields: Sequence[str], names: Sequence[str] | None, record_time: bool
    ) -> None:
        self.topic = topic
        self._make = partial(
            SeriesBuilder, topic.name, partial(bag.deserialize, topic), cdr=not topic.is_ros1,
            effort_unit=bag.effort_units.get(topic.name, ""),
        )  # fmt: skip
        self._builder = self._make()
        self._pending = 0
        self._fields = fields
        self._names = names
        self._record_time = record_time
        self._other_names: tuple[str, ...] = ()
        self._parts: list[JointSeries] = []

    def add(self, log_ns: int, message: bytes) -> None:
        """Add the next message.

        Raises:
            BagError: if it is no JointState whose arrays are of one length.
        """
        self._builder.add(message, log_ns if self._record_time else None)
        self._pending += 1
        if self._pending == _BLOCK:
            self._take_block()

    def series(self) -> JointSeries | None:
        """Return what was gathered; None if there are no messages.

        Raises:
            BagError: if no message names the wanted joints, or an array is there in some messages and not in others.
        """
        self._take_block()
        if not self._parts:
            if self._other_names and self._names is not None:
                other = len(self._other_names) != len(self._names)
                raise BagError(
                    f"{self.topic.name} is of {listed(self._other_names)}; accepted: a bag with "
                    f"{listed(self._names)}, --robot with the bag's, or --names with what it calls these joints"
                    + other
                    * f"; every arm here has {len(self._names)} joints"
                )
            return None
        return self._joined()

    def _take_block(self) -> None:
        found, self._builder, self._pending = self._builder.build(), self._make(), 0
        for series in found:
            if self._names is None:
                self._names = series.names
            if set(self._names) <= set(series.names):
                chosen = series.select(self._names)
                fields = {field: values for field, values in chosen.fields.items() if field in self._fields}
                unit = chosen.effort_unit
                self._parts.append(JointSeries(chosen.topic, chosen.names, chosen.stamp_ns, **fields, effort_unit=unit))
                return
            self._other_names = series.names

    def _joined(self) -> JointSeries:
        """Return one series; each part is let go of as it is copied."""
        fields = tuple(self._parts[0].fields)
        if any(tuple(part.fields) != fields for part in self._parts):
            raise BagError(f"{self.topic.name}: carries {', '.join(fields)} in some messages and not in others")
        count = sum(len(part.stamp_ns) for part in self._parts)
        stamps = np.empty(count, dtype=np.int64)
        names, unit = self._parts[0].names, self._parts[0].effort_unit
        whole = {field: np.empty((count, len(names))) for field in fields}
        end = 0
        self._parts.reverse()
        while self._parts:
            part = self._parts.pop()
            rows = slice(end, end := end + len(part.stamp_ns))
            stamps[rows] = part.stamp_ns
            for field, values in part.fields.items():
                whole[field][rows] = values
        return JointSeries(self.topic.name, names, stamps, **whole, effort_unit=unit)
