"""Read CSV files as `rx90_bag export` writes them: block by block, every number and time as it stands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal, DecimalException
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.bags.importing.mapping import SECONDS, UNITS, Column, LogMapping
from rx90_common.bags.importing.table import fields_of
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.topics import absolute
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_BLOCK = 8192  # lines
_LAST_NS = 2**31 * NANOSECONDS  # stamps of ROS end there


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


def import_exact(
    logs: Sequence[tuple[Path, LogMapping]],
    bag: Path,
    storage: str = "mcap",
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[JointSeries]:
    """Write a bag with what the logs hold, every bit of it, and return that.

    Args:
        logs: with their mappings, exact ones.
        bag: folder to make; must not exist.
        storage: "mcap" or "sqlite3".
        progress: called with the numbers of bytes that are read and that there are.

    Raises:
        BagError: if a log cannot be read, or a topic comes twice.
        BagWriteError: if the bag cannot be written on.
    """
    total = sum(log.stat().st_size for log, _ in logs)
    series: list[JointSeries] = []
    done = 0

    def told(count: int) -> None:
        nonlocal done
        done += count
        progress(done, total)

    for log, mapping in logs:
        series += read_exact(log, mapping, told)
    write_joint_states(bag, series, storage=storage)
    return series


def read_exact(path: Path, mapping: LogMapping, progress: Callable[[int], None]) -> list[JointSeries]:
    """Return the series that a log holds, in the order of its lines.

    Args:
        path: of the log.
        mapping: what its columns hold; an exact one.
        progress: called with the number of bytes that were read since the call before.

    Raises:
        BagError: naming the line that cannot be read.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            heads = list(islice(file, mapping.header))
            plan = _Plan(path, mapping, fields_of(heads[-1], ",") if heads else [])
            stamps: list[Any] = []
            numbers: list[Any] = []
            line = len(heads)
            while lines := list(islice(file, _BLOCK)):
                stamps.append(plan.stamps(lines, line + 1))
                numbers.append(plan.numbers(lines, line + 1))
                line += len(lines)
                progress(sum(map(len, lines)))
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"{plain(path)}: cannot be read ({getattr(error, 'strerror', None) or 'no UTF-8'})") from error
    if not stamps:
        raise BagError(f"{plain(path)}: holds no row of numbers; accepted: one or more behind the header")
    return list(plan.series(np.concatenate(stamps), np.concatenate(numbers)))


class _Plan:
    """Where the fields of a line belong."""

    def __init__(self, path: Path, mapping: LogMapping, names: Sequence[str]) -> None:
        assert mapping.time is not None
        self._path, self._mapping, self._names = path, mapping, [name.strip() for name in names]
        self._time = self._place(mapping.time[1])
        fields = [field for topic in mapping.topics.values() for field in topic.fields.values()]
        self._columns = [self._place(column) for field in fields for column in field.columns]
        self._factor = np.array([factor for field in fields for factor in field.factor])
        self._width = 0  # columns of the first line
        self._compare_units()

    def stamps(self, lines: Sequence[str], first: int) -> Any:
        """Return the stamps of lines, ns; `first` is the number of the first one."""
        seconds = Decimal(self._mapping.seconds.numerator) / self._mapping.seconds.denominator * NANOSECONDS
        found = np.zeros(len(lines), dtype=np.int64)
        for k, line in enumerate(lines):
            text = line.split(",", self._time + 1)[self._time :][:1]
            try:
                stamp = round(Decimal(text[0].strip()) * seconds)
            except (DecimalException, OverflowError, ValueError, IndexError):
                stamp = -1
            if not 0 <= stamp < _LAST_NS:
                raise self._refusal(first + k, "".join(text), f"a time, 0 to {_LAST_NS // NANOSECONDS} s")
            found[k] = stamp
        return found

    def numbers(self, lines: Sequence[str], first: int) -> Any:
        """Return the numbers of lines in SI units, shape (lines, columns)."""
        rows = []
        for k, line in enumerate(lines):
            fields = line.split(",")
            self._width = self._width or len(fields)
            if len(fields) != self._width:
                raise self._refusal(first + k, f"{len(fields)} columns", f"{self._width}, as in the first row")
            try:
                rows.append([float(fields[column]) for column in self._columns])
            except (ValueError, IndexError):
                raise self._no_number(first + k, fields) from None
        # Where the factor is 1 the product is the number, bit for bit.
        return np.array(rows, dtype=np.float64) * self._factor

    def series(self, stamps: Any, numbers: Any) -> Iterator[JointSeries]:
        """Yield the series of each topic."""
        begin = 0
        for topic, mapped in self._mapping.topics.items():
            fields = {}
            for field in mapped.fields:
                fields[field] = np.ascontiguousarray(numbers[:, begin : begin + len(mapped.names)])
                begin += len(mapped.names)
            yield JointSeries(absolute(topic), mapped.names, stamps, **fields)

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
        return BagError(f"{plain(self._path)}:{line}: {quoted(text, 60)}; accepted: {accepted}")
