"""Make a bag of joint states from logs in columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from pathlib import Path

import numpy as np

from rx90_common.bags.batch import Int64Array
from rx90_common.bags.block_writing import write_blocks
from rx90_common.bags.importing.mapping import LogMapping, TopicMapping
from rx90_common.bags.importing.order import RowFault, disordered
from rx90_common.bags.importing.rows import RowReader
from rx90_common.bags.importing.spool import RowSpool
from rx90_common.bags.importing.table import LogTable, RowBlock
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.topics import absolute
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import counted, plain
from rx90_common.base.rates import NANOSECONDS

_MOST_RANGES = 40


@dataclass(frozen=True)
class ImportedLog:
    """What an import has done.

    Attributes:
        told: how each log was read.
        topics: names of the topics, with the number of joints.
        rows: how many there were.
        corrupt: number of the line of each row that was left out, and why.
        seconds: from the first to the last row that was taken.
        gap: longest time between two of these, s.
    """

    told: tuple[str, ...]
    topics: tuple[tuple[str, int], ...]
    rows: int
    corrupt: tuple[tuple[int, str], ...]
    seconds: float
    gap: float

    @property
    def text(self) -> str:
        """Return it as lines for the terminal."""
        taken = self.rows - len(self.corrupt)
        lines = [
            *self.told,
            f"{taken} of {self.rows} rows in {self.seconds:.6g} s"
            + (f", {(taken - 1) / self.seconds:.6g} Hz, longest gap {self.gap:.6g} s" if self.seconds else ""),
            *(f"{name}: {counted(joints, 'joint')}" for name, joints in self.topics),
        ]
        if self.corrupt:
            lines.append(f"left out: {corrupt_text(self.corrupt)}")
        return "\n".join(lines)


def import_logs(
    logs: Sequence[Path],
    bag: Path,
    mapping: LogMapping,
    *,
    skip_corrupt: bool = False,
    storage: str = "mcap",
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> ImportedLog:
    """Write a bag with the joint states that logs in columns hold, in memory that does not grow with these.

    Args:
        logs: files; of several the rows belong together, one by one.
        bag: folder to make; must not exist.
        mapping: what the columns hold.
        skip_corrupt: whether rows that are damaged are left out; otherwise they are refused.
        storage: "mcap" or "sqlite3".
        progress: called with the numbers of bytes that are read and that there are.

    Raises:
        BagError: if a log cannot be read, does not fit the mapping or holds damaged rows.
        BagWriteError: if the bag cannot be written.
    """
    if len(logs) != mapping.files:
        given = f"{len(logs)} log{'s' * (len(logs) != 1)}"
        raise BagError(f"{given}; accepted: {mapping.files}, those that {plain(mapping.file)} takes columns from")
    told = BytesTold(logs, progress)
    tables = [LogTable.read(path, mapping, told.more) for path in logs]
    _check_columns(tables, mapping)
    width = sum(len(one.columns) for mapped in mapping.topics.values() for one in mapped.fields.values())
    with RowSpool(bag, width) as spool:
        faults = _read_rows(tables, mapping, spool)
        faults |= disordered(spool, faults, mapping.seconds) if mapping.time is not None else {}
        corrupt = tuple((faults[k].line, faults[k].reason) for k in sorted(faults))
        _check_faults(tables[0], corrupt, spool.rows, skip_corrupt=skip_corrupt)
        good = _GoodRows(spool, np.array(sorted(faults), dtype=np.int64))
        write_blocks(bag, list(mapping.topics), [good.series(topic, mapping) for topic in mapping.topics], storage)
        return ImportedLog(
            told=tuple(f"{plain(table.path)}: {table.told}" for table in tables),
            topics=tuple((absolute(name), len(one.names)) for name, one in mapping.topics.items()),
            rows=spool.rows,
            corrupt=corrupt,
            seconds=good.span_ns / NANOSECONDS,
            gap=good.gap_ns / NANOSECONDS,
        )


class BytesTold:
    """Adds up how many bytes of some logs were read."""

    def __init__(self, logs: Sequence[Path], progress: Callable[[int, int], None]) -> None:
        self._done, self._progress = 0, progress
        self._total = sum(log.stat().st_size for log in logs if log.is_file())

    def more(self, count: int) -> None:
        """Tell that so many more were read."""
        self._done += count
        self._progress(min(self._done, self._total), self._total)


def _read_rows(tables: Sequence[LogTable], mapping: LogMapping, spool: RowSpool) -> dict[int, RowFault]:
    """Put the rows of all tables side by side into the spool; return those that are damaged by themselves.

    Raises:
        BagError: if one has more rows than the others.
    """
    faults: dict[int, RowFault] = {}
    counts = [0] * len(tables)
    for blocks in zip_longest(*(table.blocks for table in tables), fillvalue=RowBlock((), ())):
        counts = [count + len(block.rows) for count, block in zip(counts, blocks, strict=True)]
        if len(set(counts)) > 1:
            continue  # to the end, which tells how many there are
        part = RowReader(tables, blocks, mapping, spool.rows)
        spool.add(part.stamp_ns, np.array(blocks[0].lines, dtype=np.int64), part.numbers)
        faults |= {
            spool.rows - len(blocks[0].rows) + k: RowFault(blocks[0].lines[k], why) for k, why in part.faults.items()
        }
    if len(set(counts)) > 1:
        each = ", ".join(f"{plain(table.path)} {count}" for table, count in zip(tables, counts, strict=True))
        raise BagError(f"rows: {each}; accepted: logs of as many rows each")
    return faults


class _GoodRows:
    """The rows of a spool without those that are left out.

    Attributes:
        span_ns: from the first to the last stamp, once a series was taken.
        gap_ns: longest time between two stamps, as span_ns.
    """

    def __init__(self, spool: RowSpool, left_out: Int64Array) -> None:
        self._spool, self._left_out = spool, left_out
        self.span_ns = self.gap_ns = 0

    def series(self, name: str, mapping: LogMapping) -> Iterator[JointSeries]:
        """Yield the series of a topic, block by block."""
        begin = 0
        for topic, mapped in mapping.topics.items():
            width = len(mapped.names) * len(mapped.fields)
            if topic == name:
                yield from self._series(absolute(topic), mapped, begin)
            begin += width

    def _series(self, topic: str, mapped: TopicMapping, begin: int) -> Iterator[JointSeries]:
        count, previous, start = len(mapped.names), None, None
        for block in self._spool.blocks():
            rows = np.arange(block.first, block.first + len(block.stamp_ns))
            kept = ~np.isin(rows, self._left_out, assume_unique=True)
            stamps = block.stamp_ns[kept]
            if not len(stamps):
                continue
            start = int(stamps[0]) if start is None else start
            steps = np.diff(stamps, prepend=stamps[0] if previous is None else previous)
            previous = int(stamps[-1])
            self.span_ns, self.gap_ns = previous - start, max(self.gap_ns, int(steps.max()))
            numbers = block.numbers[kept]
            places = {field: begin + k * count for k, field in enumerate(mapped.fields)}
            fields = {field: np.ascontiguousarray(numbers[:, at : at + count]) for field, at in places.items()}
            yield JointSeries(topic, mapped.names, stamps, **fields, effort_unit=mapped.effort_unit(topic))


def corrupt_text(corrupt: Sequence[tuple[int, str]]) -> str:
    """Return count and numbers of the lines, those that follow each other together, and what the first one has."""
    lines = [line for line, _ in corrupt]
    starts = [0, *(k + 1 for k, (a, b) in enumerate(pairwise(lines)) if b != a + 1), len(lines)]
    parts = [f"{lines[a]}" if b - a == 1 else f"{lines[a]}-{lines[b - 1]}" for a, b in pairwise(starts)]
    more = f" and {len(parts) - _MOST_RANGES} more places" if len(parts) > _MOST_RANGES else ""
    rows = f"{len(corrupt)} corrupt row{'s' * (len(corrupt) > 1)}"
    return f"{rows}, line {', '.join(parts[:_MOST_RANGES])}{more} (line {lines[0]}: {corrupt[0][1]})"


def _check_columns(tables: Sequence[LogTable], mapping: LogMapping) -> None:
    """Refuse a column that would stand for two joints, or for the time and a joint: a slip that no later check notices.

    Raises:
        BagError: naming log, topic and column; also for a column that is not there.
    """
    time = None if mapping.time is None else (mapping.time[0], tables[mapping.time[0] - 1].place(mapping.time[1]))
    for topic, mapped in mapping.topics.items():
        for field, one in mapped.fields.items():
            table, seen = tables[one.file - 1], set()
            for column in one.columns:
                place = table.place(column)
                if place in seen or (one.file, place) == time:
                    others = "the times" if (one.file, place) == time else "another joint"
                    raise BagError(
                        f"{plain(table.path)}: column {plain(column)} in {plain(topic)}.{field} is that of {others}; "
                        "accepted: a column of its own for each"
                    )
                seen.add(place)


def _check_faults(table: LogTable, corrupt: Sequence[tuple[int, str]], rows: int, *, skip_corrupt: bool) -> None:
    if not corrupt:
        return
    told = corrupt_text(corrupt)
    if len(corrupt) == rows:
        raise BagError(f"{plain(table.path)}: every row is corrupt: {told}; accepted: columns as the mapping says")
    if not skip_corrupt:
        raise BagError(f"{plain(table.path)}: {told}; accepted: whole rows, or --skip-corrupt to leave these out")
