"""The rows of a log on their way into a bag, on the disk, so that a long log needs no more memory than a short one."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import DISK_ERRORS, BagError, BagWriteError
from rx90_common.base.quoting import plain

Int64Array = NDArray[np.int64]

BLOCK = 8192
"""Rows that are held in memory."""
_WORD = 8  # bytes


class SpooledRows(NamedTuple):
    """Some rows: the number of the first, stamps, ns, line numbers in the log, and numbers, shape (rows, columns)."""

    first: int
    stamp_ns: Int64Array
    line: Int64Array
    numbers: Array


class RowSpool:
    """Rows in a file without a name beside a bag; it is gone with the process, however that ends.

    Attributes:
        rows: how many there are.
        in_order: whether no stamp is smaller than the one before.

    Args:
        bag: that the rows are for.
        columns: numbers in a row.

    Raises:
        BagError: if the place does not take a file.
        BagWriteError: if the disk is full.
    """

    def __init__(self, bag: Path, columns: int) -> None:
        self._bag, self._width = bag, 2 + columns
        folder = next(parent for parent in bag.absolute().parents if parent.is_dir())
        self.rows, self.in_order = 0, True
        self._last = -1
        try:
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - __exit__ closes it
        except OSError as error:
            raise self._failure(error) from error

    def __enter__(self) -> RowSpool:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        try:
            self._file.close()
        except OSError as failed:  # what is written at last has no room either
            if error is None:
                raise self._failure(failed) from failed

    def add(self, stamp_ns: Int64Array, line: Int64Array, numbers: Array) -> None:
        """Append rows.

        Raises:
            BagWriteError: if the disk is full.
        """
        words = np.column_stack([stamp_ns, line, np.ascontiguousarray(numbers).view(np.int64)])
        if len(stamp_ns):
            self.in_order = self.in_order and self._last <= stamp_ns[0] and bool((np.diff(stamp_ns) >= 0).all())
            self._last = int(stamp_ns[-1])
        try:
            self._file.write(words.tobytes())
            self._file.flush()
        except OSError as error:
            raise self._failure(error) from error
        self.rows += len(words)

    def blocks(self, *, backwards: bool = False) -> Iterator[SpooledRows]:
        """Yield the rows, some at a time; backwards the last ones first, each time in the order of the log."""
        begins = range(0, self.rows, BLOCK)
        for first in reversed(begins) if backwards else begins:
            count = min(BLOCK, self.rows - first)
            self._file.seek(first * self._width * _WORD)
            yield self._of(first, np.frombuffer(self._file.read(count * self._width * _WORD), dtype=np.int64))

    def by_stamp(self) -> Iterator[SpooledRows]:
        """Yield the rows in the order of stamps, equal ones as they came.

        Where `in_order` is false that needs 16 bytes of memory for each row.
        """
        if self.in_order:
            yield from self.blocks()
            return
        words = np.memmap(self._file, dtype=np.int64, mode="r", shape=(self.rows, self._width))
        order = np.argsort(words[:, 0], kind="stable")
        for first in range(0, self.rows, BLOCK):
            yield self._of(first, words[order[first : first + BLOCK]])

    def _of(self, first: int, words: Int64Array) -> SpooledRows:
        table = words.reshape(-1, self._width)
        numbers = np.ascontiguousarray(table[:, 2:]).view(np.float64)
        return SpooledRows(first, table[:, 0].copy(), table[:, 1].copy(), numbers)

    def _failure(self, error: OSError) -> BagError:
        kind = BagWriteError if error.errno in DISK_ERRORS else BagError
        return kind(f"{plain(self._bag)}: cannot be written ({error.strerror})")
