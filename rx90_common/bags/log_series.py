"""The series that logs in columns hold: text, Parquet and NPZ, with a mapping file that says what the columns are."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np

from rx90_common.bags.array_table import ArrayTable
from rx90_common.bags.batch import Int64Array
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.log_table import LogTable
from rx90_common.bags.mapping import ARRAYS, LogMapping, mapping_of
from rx90_common.bags.topics import absolute
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import counted, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_MOST_RANGES = 40  # of corrupt lines that are named


@dataclass(frozen=True)
class ReadLog:
    """What was read of logs whose rows belong together.

    Attributes:
        paths: of the logs.
        dialects: how each of them was read.
        topics: name, number of joints and number of messages of each.
        rows: how many there were.
        corrupt: number of the line of each row that was left out, and why.
        seconds: from the first to the last row that was kept.
        gap: longest time between two of these, s.
    """

    paths: tuple[Path, ...]
    dialects: tuple[str, ...]
    topics: tuple[tuple[str, int, int], ...]
    rows: int
    corrupt: tuple[tuple[int, str], ...]
    seconds: float
    gap: float

    @property
    def text(self) -> str:
        """Return it as lines for the terminal."""
        good = self.rows - len(self.corrupt)
        lines = [
            *(f"{plain(path)}: {dialect}" for path, dialect in zip(self.paths, self.dialects, strict=True)),
            f"{good} of {self.rows} rows in {self.seconds:.6g} s"
            + (f", {(good - 1) / self.seconds:.6g} Hz, longest gap {self.gap:.6g} s" if self.seconds else ""),
            *(f"{name}: {counted(joints, 'joint')}" for name, joints, _ in self.topics),
        ]
        if self.corrupt:
            lines.append(f"left out: {corrupt_text(self.corrupt)}")
        return "\n".join(lines)


def corrupt_text(corrupt: Sequence[tuple[int, str]]) -> str:
    """Return count and numbers of the lines, those that follow each other together, and what the first one has."""
    lines = [line for line, _ in corrupt]
    starts = [0, *(k + 1 for k, (a, b) in enumerate(pairwise(lines)) if b != a + 1), len(lines)]
    parts = [f"{lines[a]}" if b - a == 1 else f"{lines[a]}-{lines[b - 1]}" for a, b in pairwise(starts)]
    more = f" and {len(parts) - _MOST_RANGES} more places" if len(parts) > _MOST_RANGES else ""
    rows = f"{len(corrupt)} corrupt row{'s' * (len(corrupt) > 1)}"
    return f"{rows}, line {', '.join(parts[:_MOST_RANGES])}{more} (line {lines[0]}: {corrupt[0][1]})"


def read_logs(
    paths: Sequence[Path], mapping: LogMapping, more: Callable[[int], None], *, skip_corrupt: bool
) -> tuple[ReadLog, list[JointSeries]]:
    """Read logs whose rows belong together; return what was read, and a series for each topic.

    Args:
        paths: of the logs.
        mapping: what their columns hold.
        more: called now and then with how many bytes were read since the call before.
        skip_corrupt: whether rows that are damaged are left out; otherwise they are refused.

    Raises:
        BagError: if a log cannot be read, does not fit its mapping or holds damaged rows.
    """
    mapping = mapping_of(paths[0], mapping)
    if len(paths) != mapping.files:
        given = f"{len(paths)} log{'s' * (len(paths) != 1)}"
        raise BagError(f"{given}; accepted: {mapping.files}, those that {plain(mapping.file)} takes columns from")
    tables = [
        (ArrayTable if path.suffix.lower() in ARRAYS else LogTable)(path, mapping, number, more)
        for number, path in enumerate(paths, 1)
    ]
    counts = [len(table.lines) for table in tables]
    if len(set(counts)) > 1:
        each = ", ".join(f"{plain(table.path)} {count}" for table, count in zip(tables, counts, strict=True))
        raise BagError(f"rows: {each}; accepted: logs of as many rows each")
    if mapping.time is None:
        assert mapping.rate is not None
        stamps: Int64Array = np.asarray(np.rint(np.arange(counts[0]) * (NANOSECONDS / mapping.rate)), dtype=np.int64)
    else:
        stamps = tables[mapping.time[0] - 1].stamp_ns
    faults: dict[int, str] = {}
    for file, table in enumerate(tables):
        there = f"{plain(table.path)}:{{}}: " if file else ""
        for row, reason in table.faults.items():
            faults.setdefault(row, there.format(table.lines[row]) + reason)
    rows = _good_rows(stamps, mapping, faults)
    corrupt = tuple((int(tables[0].lines[row]), faults[row]) for row in sorted(faults))
    if corrupt and not len(rows):
        text = corrupt_text(corrupt)
        raise BagError(f"{plain(paths[0])}: every row is corrupt: {text}; accepted: columns as the mapping says")
    if corrupt and not skip_corrupt:
        text = corrupt_text(corrupt)
        raise BagError(
            f"{plain(paths[0])}: {text}; accepted: whole rows, or rx90_bag import --skip-corrupt, to leave these out"
        )
    found = []
    for topic, mapped in mapping.topics.items():
        fields = {name: tables[one.file - 1].numbers_of(one)[rows] for name, one in mapped.fields.items()}
        unit = mapped.effort_unit(topic)
        found.append(JointSeries(absolute(topic), mapped.names, stamps[rows], **fields, effort_unit=unit))
    steps = np.diff(stamps[rows])
    return ReadLog(
        paths=tuple(paths),
        dialects=tuple(table.dialect for table in tables),
        topics=tuple((one.topic, len(one.names), one.messages) for one in found),
        rows=counts[0],
        corrupt=corrupt,
        seconds=int(steps.sum()) / NANOSECONDS,
        gap=int(steps.max(initial=0)) / NANOSECONDS,
    ), found


def _good_rows(stamps: Int64Array, mapping: LogMapping, faults: dict[int, str]) -> Int64Array:
    """Return the rows without a fault, in the order of time; note those whose time does not fit the others."""
    rows = np.setdiff1d(np.arange(len(stamps)), list(faults))
    if mapping.exact:
        return np.asarray(rows[np.argsort(stamps[rows], kind="stable")])
    if mapping.time is None:
        return rows
    kept = rows[_increasing(stamps[rows])]
    for row in np.setdiff1d(rows, kept).tolist():
        time = Decimal(int(stamps[row])) * mapping.seconds.denominator / (NANOSECONDS * mapping.seconds.numerator)
        faults[row] = f"time {quoted(f'{time:f}')} does not lie between those around it"
    return kept


def _increasing(stamps: Int64Array) -> Int64Array:
    """Return the indices of the longest strictly increasing subsequence, of several the one with the shortest steps."""
    if bool((np.diff(stamps) > 0).all()):
        return np.arange(len(stamps))
    values = stamps.tolist()
    piles: list[list[int]] = []  # of indices; in a pile the values decrease
    smallest: list[int] = []  # last value of each pile
    for k, value in enumerate(values):
        pile = bisect_left(smallest, value)
        if pile == len(piles):
            piles.append([])
            smallest.append(value)
        piles[pile].append(k)
        smallest[pile] = value
    chosen: list[int] = [piles[-1][-1]]
    for members in reversed(piles[:-1]):
        # Of those that come before the one behind, the largest smaller value: the first such in the pile.
        before = members[: bisect_left(members, chosen[-1])]
        chosen.append(before[bisect_right(before, -values[chosen[-1]], key=lambda k: -values[k])])
    return np.array(chosen[::-1], dtype=np.int64)
