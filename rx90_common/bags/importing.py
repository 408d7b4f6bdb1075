"""Make a bag from logs in columns: CSV, or separated by blanks, with a file that says what the columns hold.

In memory are 8 bytes for each number, and as many again for the series that the bag is written from.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np

from rx90_common.bags.batch import Int64Array
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.log_table import LogTable
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.topics import absolute
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import counted, plain, quoted
from rx90_common.base.rates import NANOSECONDS

Progress = Callable[[int, int], None]

_MOST_RANGES = 40  # of corrupt lines that are named


def _silent(_done: int, _total: int) -> None:
    """Report nothing."""


@dataclass(frozen=True)
class ImportedLog:
    """What an import has done with logs whose rows belong together.

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


def exported_logs(folder: Path) -> list[tuple[Path, LogMapping]]:
    """Return the CSV files of a folder with the mapping files of the same names beside them, as an export writes them.

    Raises:
        BagError: if there is none, or one without a mapping.
        ConfigError: for a mapping that is not acceptable.
    """
    logs = sorted(folder.glob("*.csv"))
    if not logs:
        raise BagError(
            f"{plain(folder)}: no CSV file in it; accepted: a folder that rx90_bag export has written, as CSV"
        )
    for log in logs:
        if not log.with_suffix(".yaml").is_file():
            raise BagError(
                f"{plain(log)}: no {plain(log.with_suffix('.yaml').name)} beside it, which says what it holds"
            )
    pairs = [(log, LogMapping.load(log.with_suffix(".yaml"))) for log in logs]
    for _, mapping in pairs:
        if not mapping.exact:
            raise BagError(
                f"{plain(mapping.file)}: exact is not true; accepted in a folder: what rx90_bag export has written"
            )
    return pairs


def import_logs(
    logs: Sequence[tuple[Sequence[Path], LogMapping]],
    bag: Path,
    *,
    skip_corrupt: bool = False,
    storage: str = "mcap",
    progress: Progress = _silent,
) -> list[ImportedLog]:
    """Write a bag with the joint states and temperatures that logs in columns hold.

    Args:
        logs: files with what their columns hold; of several files of one mapping the rows belong together, one by one.
        bag: folder to make; must not exist.
        skip_corrupt: whether rows that are damaged are left out; otherwise they are refused.
        storage: "mcap" or "sqlite3".
        progress: called with the numbers of bytes that are read and that there are.

    Raises:
        BagError: if a log cannot be read, does not fit its mapping or holds damaged rows, or a topic comes twice.
        BagWriteError: if the bag cannot be written.
    """
    total = sum(path.stat().st_size for paths, _ in logs for path in paths if path.is_file())
    done = 0

    def more(count: int) -> None:
        nonlocal done
        done = min(done + count, total)
        progress(done, total)

    read = [_import(paths, mapping, more, skip_corrupt=skip_corrupt) for paths, mapping in logs]
    write_joint_states(bag, [series for _, found in read for series in found], storage=storage)
    return [done_with for done_with, _ in read]


def _import(
    paths: Sequence[Path], mapping: LogMapping, more: Callable[[int], None], *, skip_corrupt: bool
) -> tuple[ImportedLog, list[JointSeries]]:
    """Read logs whose rows belong together; return what was read, and a series for each topic."""
    if len(paths) != mapping.files:
        given = f"{len(paths)} log{'s' * (len(paths) != 1)}"
        raise BagError(f"{given}; accepted: {mapping.files}, those that {plain(mapping.file)} takes columns from")
    tables = [LogTable(path, mapping, number, more) for number, path in enumerate(paths, 1)]
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
    rows = np.setdiff1d(np.arange(counts[0]), list(faults))
    if mapping.exact:
        rows = rows[np.argsort(stamps[rows], kind="stable")]
    elif mapping.time is not None:
        kept = rows[_increasing(stamps[rows])]
        for row in np.setdiff1d(rows, kept).tolist():
            time = Decimal(int(stamps[row])) * mapping.seconds.denominator / (NANOSECONDS * mapping.seconds.numerator)
            faults[row] = f"time {quoted(f'{time:f}')} does not lie between those around it"
        rows = kept
    corrupt = tuple((int(tables[0].lines[row]), faults[row]) for row in sorted(faults))
    if corrupt and not len(rows):
        text = corrupt_text(corrupt)
        raise BagError(f"{plain(paths[0])}: every row is corrupt: {text}; accepted: columns as the mapping says")
    if corrupt and not skip_corrupt:
        text = corrupt_text(corrupt)
        raise BagError(f"{plain(paths[0])}: {text}; accepted: whole rows, or --skip-corrupt to leave these out")
    found = []
    for topic, mapped in mapping.topics.items():
        fields = {name: tables[one.file - 1].numbers_of(one)[rows] for name, one in mapped.fields.items()}
        unit = mapped.effort_unit(topic)
        found.append(JointSeries(absolute(topic), mapped.names, stamps[rows], **fields, effort_unit=unit))
    steps = np.diff(stamps[rows])
    return ImportedLog(
        paths=tuple(paths),
        dialects=tuple(table.dialect for table in tables),
        topics=tuple((one.topic, len(one.names), one.messages) for one in found),
        rows=counts[0],
        corrupt=corrupt,
        seconds=int(steps.sum()) / NANOSECONDS,
        gap=int(steps.max(initial=0)) / NANOSECONDS,
    ), found


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
