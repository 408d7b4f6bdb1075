"""Read CSV files as `rx90_bag export` writes them: block by block, every number and time as it stands."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from decimal import Decimal, DecimalException
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.bags.block_writing import write_blocks
from rx90_common.bags.importing.importing import BytesTold, corrupt_text
from rx90_common.bags.importing.lines import Line, lines_of
from rx90_common.bags.importing.mapping import SECONDS, UNITS, Column, LogMapping
from rx90_common.bags.importing.rows import LAST_NS
from rx90_common.bags.importing.spool import BLOCK, RowSpool
from rx90_common.bags.importing.table import fields_of
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.topics import absolute
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS


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


@dataclass(frozen=True)
class ImportedTable:
    """What came of an exported file.

    Attributes:
        path: of the file.
        topics: name, number of joints and number of messages of each.
        corrupt: number of the line of each row that was left out, and why.
    """

    path: Path
    topics: tuple[tuple[str, int, int], ...]
    corrupt: tuple[tuple[int, str], ...]


def import_exact(
    logs: Sequence[tuple[Path, LogMapping]],
    bag: Path,
    storage: str = "mcap",
    progress: Callable[[int, int], None] = lambda _done, _total: None,
    *,
    skip_corrupt: bool = False,
) -> list[ImportedTable]:
    """Write a bag with what the logs hold, every bit of it, in memory that does not grow with them.

    Args:
        logs: with their mappings, exact ones.
        bag: folder to make; must not exist.
        storage: "mcap" or "sqlite3".
        progress: called with the numbers of bytes that are read and that there are.
        skip_corrupt: whether lines that do not hold a time and numbers are left out; otherwise they are refused.

    Raises:
        BagError: if a log cannot be read, or a topic comes twice.
        BagWriteError: if the bag cannot be written.
    """
    told = BytesTold([log for log, _ in logs], progress)
    topics: list[str] = []
    blocks: list[Iterator[JointSeries]] = []
    read: list[tuple[Path, list[tuple[str, int]], tuple[tuple[int, str], ...]]] = []
    with ExitStack() as spools:
        for log, mapping in logs:
            lines = lines_of(log, told.more)
            heads = list(islice(lines, mapping.header))
            plan = _Plan(log, mapping, fields_of(heads[-1].text, ",") if heads else [])
            spool = spools.enter_context(RowSpool(bag, plan.width))
            corrupt = _read(lines, plan, spool, skip_corrupt=skip_corrupt)
            if not spool.rows:
                left = f" ({corrupt_text(corrupt)})" if corrupt else ""
                raise BagError(f"{plain(log)}: holds no row of numbers{left}; accepted: one or more behind the header")
            names = [absolute(topic) for topic in mapping.topics]
            topics += names
            blocks += [plan.series(topic, spool) for topic in mapping.topics]
            counts = [len(topic.names) for topic in mapping.topics.values()]
            read.append((log, list(zip(names, counts, strict=True)), tuple(corrupt)))
        written = iter(write_blocks(bag, topics, blocks, storage))
    return [
        ImportedTable(log, tuple((name, count, next(written)) for name, count in held), corrupt)
        for log, held, corrupt in read
    ]


def _read(lines: Iterator[Line], plan: _Plan, spool: RowSpool, *, skip_corrupt: bool) -> list[tuple[int, str]]:
    """Put lines into a spool; return those that are left out, and why.

    Raises:
        BagError: naming the line that cannot be read.
    """
    corrupt: list[tuple[int, str]] = []
    while some := list(islice(lines, BLOCK)):
        if skip_corrupt and not (spool.rows or corrupt):
            plan.expect_most(some)
        try:
            stamps, numbers = plan.stamps(some), plan.numbers(some)
        except BagError:
            if not skip_corrupt:
                raise
            some = list(_whole(some, plan, corrupt))
            if not some:
                continue
            stamps, numbers = plan.stamps(some), plan.numbers(some)
        spool.add(stamps, np.array([line.number for line in some], dtype=np.int64), numbers)
    return corrupt


def _whole(lines: Sequence[Line], plan: _Plan, corrupt: list[tuple[int, str]]) -> Iterator[Line]:
    """Yield the lines that can be read, and note the others."""
    for line in lines:
        try:
            plan.stamps([line])
            plan.numbers([line])
        except BagError as error:
            corrupt.append((line.number, str(error).partition(f":{line.number}: ")[2].partition("; accepted")[0]))
        else:
            yield line


class _Plan:
    """Where the fields of a line belong."""

    def __init__(self, path: Path, mapping: LogMapping, names: Sequence[str]) -> None:
        assert mapping.time is not None
        self._path, self._mapping, self._names = path, mapping, [name.strip() for name in names]
        self._time = self._place(mapping.time[1])
        fields = [field for topic in mapping.topics.values() for field in topic.fields.values()]
        self._columns = [self._place(column) for field in fields for column in field.columns]
        self._factor = np.array([factor for field in fields for factor in field.factor])
        self.width = len(self._columns)  # of the numbers
        self._fields = 0  # of the first line
        self._compare_units()

    def expect_most(self, lines: Sequence[Line]) -> None:
        """Take as many fields as most of these lines have for those of a whole line, not those of the first."""
        self._fields = Counter(line.text.count(",") + 1 for line in lines).most_common(1)[0][0]

    def stamps(self, lines: Sequence[Line]) -> Any:
        """Return the stamps of lines, ns."""
        seconds = Decimal(self._mapping.seconds.numerator) / self._mapping.seconds.denominator * NANOSECONDS
        found = np.zeros(len(lines), dtype=np.int64)
        for k, line in enumerate(lines):
            text = line.text.split(",", self._time + 1)[self._time :][:1]
            try:
                stamp = round(Decimal(_plain_number(text[0])) * seconds)
            except (DecimalException, OverflowError, ValueError, IndexError):
                stamp = -1
            if not 0 <= stamp < LAST_NS:
                raise self._refusal(line.number, "".join(text), f"a time, 0 to {LAST_NS // NANOSECONDS} s")
            found[k] = stamp
        return found

    def numbers(self, lines: Sequence[Line]) -> Any:
        """Return the numbers of lines in SI units, shape (lines, columns)."""
        rows = []
        for line in lines:
            fields = line.text.split(",")
            self._fields = self._fields or len(fields)
            if len(fields) != self._fields:
                raise self._refusal(line.number, f"{len(fields)} columns", f"{self._fields}, as in other rows")
            try:
                row = [float(fields[column]) for column in self._columns]
            except (ValueError, IndexError):
                raise self._no_number(line.number, fields) from None
            if "_" in line.text or math.inf in map(abs, row):  # as 1_0 and 1e999, which Python takes for 10 and inf
                for column in self._columns:
                    self._check_number(line.number, fields[column])
            rows.append(row)
        # Where the factor is 1 the product is the number, bit for bit.
        return np.array(rows, dtype=np.float64) * self._factor

    def series(self, name: str, spool: RowSpool) -> Iterator[JointSeries]:
        """Yield the series of a topic in the order of stamps, block by block."""
        begin = 0
        for topic, mapped in self._mapping.topics.items():
            count = len(mapped.names)
            if topic == name:
                places = {field: begin + k * count for k, field in enumerate(mapped.fields)}
                for rows in spool.by_stamp():
                    fields = {f: np.ascontiguousarray(rows.numbers[:, at : at + count]) for f, at in places.items()}
                    yield JointSeries(
                        absolute(topic), mapped.names, rows.stamp_ns, **fields, effort_unit=mapped.effort_unit(topic)
                    )
            begin += count * len(mapped.fields)

    def _place(self, column: Column) -> int:
        if isinstance(column, int):
            return column - 1
        if self._names.count(column) == 1:
            return self._names.index(column)
        there = listed(self._names) or "no names"
        raise BagError(f"{plain(self._path)}: {self._names.count(column)} columns {quoted(column)}; there are {there}")

    def _compare_units(self) -> None:
        """Refuse a header whose units, as in `joint_1 velocity [deg/s]`, are not those of the mapping."""
        assert self._mapping.time is not None
        unit_of_time = next(name for name, size in SECONDS.items() if size == self._mapping.seconds)
        self._compare(self._time, SECONDS, unit_of_time)
        for topic in self._mapping.topics.values():
            for name, field in topic.fields.items():
                for column in field.columns:
                    self._compare(self._place(column), UNITS[name], field.unit)

    def _compare(self, place: int, known: Mapping[str, Any], mapped: str) -> None:
        heading = self._names[place] if place < len(self._names) else ""
        unit = heading.rpartition("[")[2].rstrip("]") if heading.endswith("]") else ""
        if unit in known and unit != mapped:
            raise BagError(
                f"{plain(self._path)}:{self._mapping.header}: {quoted(heading)}, but {mapped} in "
                f"{plain(self._mapping.file)}; accepted: the same unit in both"
            )

    def _check_number(self, line: int, text: str) -> None:
        """Refuse what Python reads as another number than stands there."""
        if "_" in text or (math.isinf(float(text)) and any(map(str.isdigit, text))):
            raise self._refusal(line, text.strip(), "a number of double precision")

    def _no_number(self, line: int, fields: Sequence[str]) -> BagError:
        for column in self._columns:
            if column >= len(fields):
                return self._refusal(line, f"{len(fields)} columns", f"{column + 1} or more, by the mapping")
            try:
                float(fields[column])
            except ValueError:
                break
        return self._refusal(line, fields[column].strip(), f"a number in column {column + 1}")

    def _refusal(self, line: int, text: str, accepted: str) -> BagError:
        return BagError(f"{plain(self._path)}:{line}: {quoted(text.strip(), 60)}; accepted: {accepted}")


def _plain_number(text: str) -> str:
    """Return the text of a number without blanks around it; none that Python alone takes for one."""
    return "" if "_" in text else text.strip()
