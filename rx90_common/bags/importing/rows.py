"""Rows of texts as stamps and numbers, and which of them are damaged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal, DecimalException

import numpy as np

from rx90_common.bags.batch import Int64Array
from rx90_common.bags.importing.mapping import FieldMapping, LogMapping
from rx90_common.bags.importing.table import LogTable, RowBlock, number
from rx90_common.base.arrays import Array
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.rates import NANOSECONDS

LAST_NS = 2**31 * NANOSECONDS
"""Stamps of ROS end there."""
_LARGEST = 1e9  # rad, rad/s, Nm or A: no joint goes there, and a damaged number may


class RowReader:
    """Some rows of logs that belong together.

    Attributes:
        stamp_ns: int64 (rows,).
        numbers: of all topics and fields in SI units, (rows, columns).
        faults: what is wrong with a row, by its place.
    """

    def __init__(self, tables: Sequence[LogTable], blocks: Sequence[RowBlock], mapping: LogMapping, first: int) -> None:
        """Read them; `first` is how many rows of the logs came before."""
        self._tables, self._blocks = tables, blocks
        self._count = len(blocks[0].rows)
        self.faults: dict[int, str] = {}
        self._find_torn()
        fields = [field for mapped in mapping.topics.values() for field in mapped.fields.values()]
        self.numbers: Array = np.concatenate([self._values(field) for field in fields], axis=1)
        self.stamp_ns = self._stamps(mapping, first)

    def _at(self, number_: int, row: int) -> str:
        """Return file and line of a row."""
        return f"{plain(self._tables[number_].path)}:{self._blocks[number_].lines[row]}"

    def _find_torn(self) -> None:
        for file, (table, block) in enumerate(zip(self._tables, self._blocks, strict=True)):
            for k, row in enumerate(block.rows):
                if len(row) != table.width:
                    there = f"in {self._at(file, k)} " if file else ""
                    self.faults.setdefault(k, f"{there}{len(row)} fields, others have {table.width}")

    def _values(self, field: FieldMapping) -> Array:
        """Return the numbers of a field, shape (rows, joints)."""
        file = field.file - 1
        table, rows = self._tables[file], self._blocks[file].rows
        found = np.zeros((self._count, len(field.columns)))
        for joint, (column, factor) in enumerate(zip(field.columns, field.factor, strict=True)):
            place = table.place(column)
            for k, row in enumerate(rows):
                if k in self.faults:
                    continue
                value = factor * number(row[place], table.decimal)
                if abs(value) <= _LARGEST:  # False for a NaN
                    found[k, joint] = value
                else:
                    there = f" in {self._at(file, k)}" if file else ""
                    self.faults[k] = f"column {column}{there} is {quoted(row[place], 30)}"
        return found

    def _stamps(self, mapping: LogMapping, first: int) -> Int64Array:
        if mapping.time is None:
            assert mapping.rate is not None
            rows = np.arange(first, first + self._count)
            return np.asarray(np.rint(rows * (NANOSECONDS / mapping.rate)), dtype=np.int64)
        file, column = mapping.time
        table, rows_of_file = self._tables[file - 1], self._blocks[file - 1].rows
        place = table.place(column)
        stamps = np.zeros(self._count, dtype=np.int64)
        for k in range(self._count):
            if k in self.faults:
                continue
            text = rows_of_file[k][place]
            if not math.isfinite(number(text, table.decimal)):
                self.faults[k] = f"time {quoted(text, 30)}"
                continue
            try:  # exactly: floating point spoils ns of the wall clock
                time = Decimal(text.strip().replace(",", ".")) * mapping.seconds.numerator / mapping.seconds.denominator
                stamp = round(time * NANOSECONDS)
            except (DecimalException, OverflowError):
                stamp = -1
            if 0 <= stamp < LAST_NS:
                stamps[k] = stamp
            else:
                self.faults[k] = f"time {quoted(text, 30)}; accepted: 0 to {LAST_NS // NANOSECONDS} s"
        return stamps
