"""What a mapping takes from a log of arrays, Parquet or NPZ, in the way LogTable takes it from text."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rx90_common.bags.batch import Int64Array
from rx90_common.bags.log_table import LARGEST, LAST_NS
from rx90_common.bags.mapping import Column, FieldMapping, LogMapping
from rx90_common.bags.storage_files import DamagedError, library_errors
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS


class ArrayTable:
    """What a mapping takes from a log of arrays.

    Columns are those of Parquet; of NPZ the arrays of shape (n,), and of shape (n, k) each column, such as `q[0]`.

    Attributes:
        path: of the log.
        dialect: how it was read, for the user.
        lines: number of each row, from 1 on, int64 (rows,).
        stamp_ns: times of the rows, if they are in this log, int64 (rows,).
        faults: what is wrong with a row, by its number from 0 on.

    Args:
        path: of the log.
        mapping: what its columns hold.
        file: its number in the mapping.
        more: called with how many bytes were read.

    Raises:
        BagError: if it cannot be read, holds no row, or has not the columns of the mapping.
    """

    def __init__(self, path: Path, mapping: LogMapping, file: int, more: Callable[[int], None]) -> None:
        self.path, self._mapping = path, mapping
        self.faults: dict[int, str] = {}
        self._columns = _columns(path)
        time = mapping.time if mapping.time is not None and mapping.time[0] == file else None
        fields = [one for topic in mapping.topics.values() for one in topic.fields.values() if one.file == file]
        used = [self._name(column) for one in fields for column in one.columns]
        used += [] if time is None else [self._name(time[1])]
        lengths = {name: len(self._columns[name]) for name in used}
        if len(set(lengths.values())) != 1 or 0 in lengths.values():
            each = ", ".join(f"{plain(name)} {length}" for name, length in lengths.items())
            raise BagError(f"{plain(path)}: rows: {each}; accepted: columns of as many rows each, one or more")
        (count,) = set(lengths.values())
        self.lines = np.arange(1, count + 1)
        self.stamp_ns: Int64Array = np.zeros(count, dtype=np.int64)
        if time is not None:
            self._read_times(self._columns[self._name(time[1])])
        for one in fields if not mapping.exact else ():
            self._note_faults(one)
        self.dialect = f"{len(self._columns)} columns {listed(self._columns)}"
        more(path.stat().st_size)

    def numbers_of(self, mapped: FieldMapping) -> Array:
        """Return the numbers of a field in SI units, shape (rows, joints)."""
        columns = [self._columns[self._name(column)].astype(np.float64) for column in mapped.columns]
        return np.asarray(np.column_stack(columns) * np.array(mapped.factor))

    def _note_faults(self, mapped: FieldMapping) -> None:
        for column, values in zip(mapped.columns, self.numbers_of(mapped).T, strict=True):
            for row in np.flatnonzero(~(np.abs(values) <= LARGEST)).tolist():  # a NaN is neither
                self.faults.setdefault(row, f"column {plain(column)} is {self._columns[self._name(column)][row]}")

    def _name(self, column: Column) -> str:
        there = list(self._columns)
        if isinstance(column, int) and column <= len(there):
            return there[column - 1]
        if column in self._columns:
            return str(column)
        raise BagError(f"{plain(self.path)}: no column {quoted(column)}; there are {listed(there)}")

    def _read_times(self, times: NDArray[Any]) -> None:
        """Take stamps: whole numbers exactly, others to the nearest ns; note those that no stamp can be."""
        unit_ns = int(self._mapping.seconds * NANOSECONDS)
        if times.dtype.kind == "M":  # it has a unit of its own
            times, unit_ns = times.astype("datetime64[ns]").astype(np.int64), 1
        inside = (times >= 0) & (times < LAST_NS / unit_ns)  # a NaN is not
        whole = np.issubdtype(times.dtype, np.integer)
        self.stamp_ns[inside] = times[inside] * unit_ns if whole else np.rint(times[inside] * float(unit_ns))
        for row in np.flatnonzero(~inside).tolist():
            self.faults[row] = f"time {times[row]}; accepted: 0 to {LAST_NS // NANOSECONDS} s"


def _columns(path: Path) -> dict[str, NDArray[Any]]:
    """Return the columns of numbers and times by their names."""
    found: dict[str, NDArray[Any]] = {}
    parquet = path.suffix.lower() == ".parquet"
    try:
        with library_errors():
            if parquet:
                table = pq.read_table(path, page_checksum_verification=True)
                for name, column in zip(table.column_names, table.columns, strict=True):
                    if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
                        found[name] = column.to_numpy()
                    elif pa.types.is_timestamp(column.type):
                        found[name] = column.cast(pa.timestamp("ns")).to_numpy()
                return found
            with np.load(path, allow_pickle=False) as arrays:
                for name in arrays.files:
                    values = arrays[name]
                    if values.dtype.kind in "fiuM" and values.ndim == 1:
                        found[name] = values
                    elif values.dtype.kind in "fiu" and values.ndim == 2:
                        found |= {f"{name}[{k}]": values[:, k] for k in range(values.shape[1])}
            return found
    except DamagedError as error:
        raise BagError(f"{plain(path)}: is no {'Parquet' if parquet else 'NPZ'} file, or damaged ({error})") from error
