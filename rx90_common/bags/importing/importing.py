"""Make a bag of joint states from logs in columns."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, DecimalException
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.importing.mapping import FieldMapping, LogMapping
from rx90_common.bags.importing.table import LogTable, number
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.topics import absolute
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.rates import NANOSECONDS

_LAST_NS = 2**31 * NANOSECONDS  # stamps of ROS end there
_LARGEST = 1e9  # rad, rad/s, Nm or A: no joint goes there, and a damaged number may
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
            *(f"{name}: {joints} joints" for name, joints in self.topics),
        ]
        if self.corrupt:
            lines.append(f"left out: {corrupt_text(self.corrupt)}")
        return "\n".join(lines)


def import_logs(
    logs: Sequence[Path], bag: Path, mapping: LogMapping, *, skip_corrupt: bool = False, storage: str = "mcap"
) -> ImportedLog:
    """Write a bag with the joint states that logs in columns hold.

    Args:
        logs: files; of several the rows belong together, one by one.
        bag: folder to make; must not exist.
        mapping: what the columns hold.
        skip_corrupt: whether rows that are damaged are left out; otherwise they are refused.
        storage: "mcap" or "sqlite3".

    Raises:
        BagError: if a log cannot be read, does not fit the mapping or holds damaged rows.
        BagWriteError: if the bag cannot be written on.
    """
    if len(logs) != mapping.files:
        given = f"{len(logs)} log{'s' * (len(logs) != 1)}"
        raise BagError(f"{given}; accepted: {mapping.files}, those that {plain(mapping.file)} takes columns from")
    tables = [LogTable.read(path, mapping) for path in logs]
    counts = {len(table.rows) for table in tables}
    if len(counts) > 1:
        each = ", ".join(f"{plain(table.path)} {len(table.rows)}" for table in tables)
        raise BagError(f"rows: {each}; accepted: logs of as many rows each")
    _check_columns(tables, mapping)
    faults = _torn(tables)
    columns = {
        (topic, field): _values(tables[one.file - 1], one, faults)
        for topic, mapped in mapping.topics.items()
        for field, one in mapped.fields.items()
    }
    stamps = _stamps(tables, mapping, faults)
    _check_faults(tables[0], faults, skip_corrupt=skip_corrupt)
    good = np.array([k for k in range(counts.pop()) if k not in faults], dtype=np.intp)
    series = [
        JointSeries(
            absolute(topic),
            mapped.names,
            stamps[good],
            **{field: columns[topic, field][good] for field in mapped.fields},
        )
        for topic, mapped in mapping.topics.items()
    ]
    write_joint_states(bag, series, storage=storage)
    steps = np.diff(stamps[good])
    return ImportedLog(
        told=tuple(f"{plain(table.path)}: {table.told}" for table in tables),
        topics=tuple((one.topic, len(one.names)) for one in series),
        rows=len(stamps),
        corrupt=tuple((tables[0].lines[k], faults[k]) for k in sorted(faults)),
        seconds=float(stamps[good[-1]] - stamps[good[0]]) / NANOSECONDS,
        gap=float(steps.max(initial=0)) / NANOSECONDS,
    )


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


def _torn(tables: Sequence[LogTable]) -> dict[int, str]:
    """Return rows that have not as many fields as the others, with what is wrong with them."""
    faults: dict[int, str] = {}
    for table in tables:
        for k, row in enumerate(table.rows):
            if len(row) != table.width:
                there = "" if table is tables[0] else f"in {table.at(k)} "
                faults.setdefault(k, f"{there}{len(row)} fields, others have {table.width}")
    return faults


def _values(table: LogTable, field: FieldMapping, faults: dict[int, str]) -> Array:
    """Return the numbers of a field in SI units, shape (rows, joints); add rows without such numbers to `faults`."""
    found = np.zeros((len(table.rows), len(field.columns)))
    for joint, (column, factor) in enumerate(zip(field.columns, field.factor, strict=True)):
        place = table.place(column)
        for k, row in enumerate(table.rows):
            if k in faults:
                continue
            value = factor * number(row[place], table.decimal)
            if abs(value) <= _LARGEST:  # False for a NaN
                found[k, joint] = value
            else:
                there = "" if field.file == 1 else f" in {table.at(k)}"
                faults[k] = f"column {column}{there} is {quoted(row[place], 30)}"
    return found


def _stamps(tables: Sequence[LogTable], mapping: LogMapping, faults: dict[int, str]) -> NDArray[np.int64]:
    """Return the rows' stamps, ns; add rows without a time, or with one that does not fit the others, to `faults`."""
    count = len(tables[0].rows)
    if mapping.time is None:
        assert mapping.rate is not None
        return np.asarray(np.rint(np.arange(count) * (NANOSECONDS / mapping.rate)), dtype=np.int64)
    table = tables[mapping.time[0] - 1]
    place = table.place(mapping.time[1])
    stamps = np.zeros(count, dtype=np.int64)
    for k in range(count):
        if k in faults:
            continue
        text = table.rows[k][place]
        if not math.isfinite(number(text, table.decimal)):
            faults[k] = f"time {quoted(text, 30)}"
            continue
        try:  # exactly: floating point spoils ns of the wall clock
            time = Decimal(text.strip().replace(",", ".")) * mapping.seconds.numerator / mapping.seconds.denominator
            stamp = round(time * NANOSECONDS)
        except (DecimalException, OverflowError):
            stamp = -1
        if 0 <= stamp < _LAST_NS:
            stamps[k] = stamp
        else:
            faults[k] = f"time {quoted(text, 30)}; accepted: 0 to {_LAST_NS // NANOSECONDS} s"
    rows = [k for k in range(count) if k not in faults]
    increasing = _increasing([int(stamps[k]) for k in rows])
    for k in set(rows) - {rows[i] for i in increasing}:
        faults[k] = f"time {quoted(table.rows[k][place], 30)} does not lie between those around it"
    return stamps


def _increasing(values: Sequence[int]) -> list[int]:
    """Return the indices of the longest strictly increasing subsequence, of several the one with the shortest steps."""
    piles: list[list[int]] = []  # of indices; in a pile the values decrease
    smallest: list[int] = []  # last value of each pile
    for k, value in enumerate(values):
        pile = bisect_left(smallest, value)
        if pile == len(piles):
            piles.append([])
            smallest.append(value)
        piles[pile].append(k)
        smallest[pile] = value
    chosen: list[int] = []
    for members in reversed(piles):
        if not chosen:
            chosen.append(members[-1])
            continue
        # Of those that come before the one behind, the largest smaller value: the first such in the pile.
        before = members[: bisect_left(members, chosen[-1])]
        chosen.append(before[bisect_right(before, -values[chosen[-1]], key=lambda k: -values[k])])
    return chosen[::-1]


def _check_faults(table: LogTable, faults: dict[int, str], *, skip_corrupt: bool) -> None:
    if not faults:
        return
    corrupt = corrupt_text([(table.lines[k], faults[k]) for k in sorted(faults)])
    if len(faults) == len(table.rows):
        raise BagError(f"{plain(table.path)}: every row is corrupt: {corrupt}; accepted: columns as the mapping says")
    if not skip_corrupt:
        raise BagError(f"{plain(table.path)}: {corrupt}; accepted: whole rows, or --skip-corrupt to leave these out")
