"""A log in columns, CSV or separated by blanks: what a mapping takes from it, and which rows are damaged.

Encoding, header, delimiter and decimal sign are found out where they are not given. Lines are looked at one by one, for
comments and torn rows; pyarrow splits and reads them, 8192 at a time. Times stay text until they are whole nanoseconds.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal, DecimalException
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv

from rx90_common.bags.batch import Int64Array
from rx90_common.bags.mapping import DELIMITERS, SECONDS, UNITS, Column, FieldMapping, LogMapping
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import counted, listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_BLOCK: Final = 8192  # rows that are read at once
LAST_NS: Final = 2**31 * NANOSECONDS  # stamps of ROS end there
LARGEST: Final = 1e9  # rad, rad/s, Nm or A: no joint goes there, and a damaged number may
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_LONGEST = 1 << 20  # characters of a line; a file that is no text may have no end of line at all
_COMMENTS = ("#", "%", "//")
_LOOKED_AT = 200  # lines, by which delimiter and decimal sign are found out
_DIALECTS = ((",", "."), (";", "."), ("tab", "."), ("|", "."), ("space", "."), (";", ","), ("tab", ","), ("|", ","),
             ("space", ","))  # fmt: skip
_NOT_FINITE = {"nan", "inf", "infinity"}


class LogTable:
    """What a mapping takes from a log.

    Attributes:
        path: of the log.
        dialect: how it was read, for the user.
        lines: number of the line of each row, int64 (rows,).
        stamp_ns: times of the rows, if they are in this log, int64 (rows,).
        faults: what is wrong with a row, by its number.

    Args:
        path: of the log, which may be a pipe.
        mapping: what its columns hold.
        file: its number in the mapping.
        more: called now and then with how many bytes were read since the call before.

    Raises:
        BagError: if it cannot be read, holds no row, or has not the columns of the mapping.
    """

    def __init__(self, path: Path, mapping: LogMapping, file: int, more: Callable[[int], None]) -> None:
        self.path, self._mapping = path, mapping
        self.faults: dict[int, str] = {}
        comments: list[str] = []
        lines = _rows_of(path, more, None if mapping.exact else comments)
        first = list(islice(lines, _BLOCK))
        delimiter, self._decimal = _dialect([line for _, line in first[:_LOOKED_AT]], mapping)
        self._delimiter = delimiter
        split = [fields_of(line, delimiter) for _, line in first]
        head = _header_lines(split, self._decimal) if mapping.header is None else mapping.header
        widths = Counter(map(len, split[head:]))
        if not widths:
            raise BagError(f"{plain(path)}: holds no row of numbers; accepted: one or more behind the header")
        self._width = widths.most_common(1)[0][0]
        names = [names for names in split[:head] if len(names) == self._width]
        if not names:  # as NumPy and Matlab write it
            said = [fields_of(line.lstrip("#%/ "), delimiter) for line in comments]
            names = [names for names in said if len(names) == self._width]
        self._header = [name.strip() for name in names[0]] if names else []
        named = f"header {listed(self._header)}" if self._header else "no header"
        named += f" in {head} lines before the first row" if head > 1 else ""
        self.dialect = f"{self._width} columns, delimiter {delimiter!r}, decimal {self._decimal!r}, {named}"
        self._find_columns(file)
        parts: list[tuple[Int64Array, Int64Array, Array]] = []
        count = 0
        some = first[head:]
        while some:
            parts.append(self._read(some, count))
            count += len(some)
            some = list(islice(lines, _BLOCK))
        self.lines, self.stamp_ns, self._numbers = map(np.concatenate, zip(*parts, strict=True))

    def numbers_of(self, mapped: FieldMapping) -> Array:
        """Return the numbers of a field in SI units, shape (rows, joints)."""
        columns = [self._columns.index(self._place(column)) for column in mapped.columns]
        return np.ascontiguousarray(self._numbers[:, columns])

    def _find_columns(self, file: int) -> None:
        """Find the columns that are used; refuse one that would stand for two joints, or for the times and a joint."""
        self._columns: list[int] = []
        self._factors: list[float] = []
        self._names: list[Column] = []
        time = self._mapping.time
        self._time = self._place(time[1]) if time is not None and time[0] == file else None
        if self._mapping.exact:
            self._compare_units()
        for topic, mapped in self._mapping.topics.items():
            for name, one in mapped.fields.items():
                seen: set[int] = set()
                for column, factor in zip(one.columns, one.factor, strict=True) if one.file == file else ():
                    place = self._place(column)
                    if place in seen or place == self._time:
                        others = "the times" if place == self._time else "another joint"
                        raise BagError(
                            f"{plain(self.path)}: column {plain(column)} in {plain(topic)}.{name} is that of {others}; "
                            "accepted: a column of its own for each"
                        )
                    seen.add(place)
                    self._columns.append(place)
                    self._factors.append(factor)
                    self._names.append(column)

    def _place(self, column: Column) -> int:
        """Return the index of a column."""
        if isinstance(column, str):
            if self._header.count(column) == 1:
                return self._header.index(column)
            found = "more than one column" if column in self._header else "no column"
            there = listed(self._header) or "no names"
            raise BagError(f"{plain(self.path)}: {found} {quoted(column)}; there are {there}")
        if column > self._width:
            raise BagError(f"{plain(self.path)}: no column {column}; accepted: 1 to {self._width}")
        return column - 1

    def _compare_units(self) -> None:
        """Refuse a header whose units, as in `joint_1 velocity [deg/s]`, are not those of the mapping."""
        mapping = self._mapping
        unit_of_time = next(name for name, size in SECONDS.items() if size == mapping.seconds)
        compared: list[tuple[int | None, Mapping[str, Any], str]] = [(self._time, SECONDS, unit_of_time)]
        for topic in mapping.topics.values():
            for name, one in topic.fields.items():
                compared += [(self._place(column), UNITS[name], one.unit) for column in one.columns]
        for place, known, mapped in compared:
            heading = self._header[place] if self._header and place is not None else ""
            unit = heading.rpartition("[")[2].rstrip("]") if heading.endswith("]") else ""
            if unit in known and unit != mapped:
                raise BagError(
                    f"{plain(self.path)}:{mapping.header}: {quoted(heading)}, but {mapped} in {plain(mapping.file)}; "
                    "accepted: the same unit in both"
                )

    def _read(self, rows: Sequence[tuple[int, str]], first: int) -> tuple[Int64Array, Int64Array, Array]:
        """Return lines, stamps and numbers of rows, of which `first` came before; note what is wrong with some."""
        sign = DELIMITERS[self._delimiter] or "\t"
        lines = []
        for k, (_, text) in enumerate(rows):
            line, count = _normalised(text, self._delimiter, sign)
            if count != self._width:
                self.faults[first + k] = f"{counted(count, 'field')}, others have {self._width}"
                line = sign * (self._width - 1)
            lines.append(line)
        texts = _split(lines, sign, self._width, [*self._columns, *([] if self._time is None else [self._time])])
        numbers = np.zeros((len(rows), len(self._columns)))
        for k, (place, factor) in enumerate(zip(self._columns, self._factors, strict=True)):
            # Where the factor is 1 the product is the number, bit for bit.
            numbers[:, k] = _numbers(texts[place], self._decimal) * factor
            if self._mapping.exact:
                wrong = [row for row in np.flatnonzero(~np.isfinite(numbers[:, k])).tolist()
                         if texts[place][row].as_py().strip().lower().lstrip("+-") not in _NOT_FINITE]  # fmt: skip
            else:
                wrong = np.flatnonzero(~(np.abs(numbers[:, k]) <= LARGEST)).tolist()  # a NaN is neither
            for row in wrong:
                text = texts[place][row].as_py()
                self.faults.setdefault(first + row, f"column {self._names[k]} is {quoted(text, 30)}")
        stamps = np.zeros(len(rows), dtype=np.int64)
        for row, text in enumerate(texts[self._time].to_pylist() if self._time is not None else ()):
            stamp = _stamp_ns(text, self._decimal, int(self._mapping.seconds * NANOSECONDS))
            if 0 <= stamp < LAST_NS:
                stamps[row] = stamp
            else:
                reason = f"time {quoted(text, 30)}; accepted: 0 to {LAST_NS // NANOSECONDS} s"
                self.faults.setdefault(first + row, reason)
        return np.array([number for number, _ in rows], dtype=np.int64), stamps, numbers


def _rows_of(path: Path, more: Callable[[int], None], comments: list[str] | None) -> Iterator[tuple[int, str]]:
    """Yield lines with their numbers, from 1 on; without blank ones and comments, of which the first go into the list.

    What is no text in a damaged log makes a corrupt row, not an unreadable file. Without a list all lines are rows.

    Raises:
        BagError: if it cannot be read.
    """
    try:
        with path.open("rb") as raw:
            encoding = "utf-16" if raw.peek(2)[:2] in _UTF16 else "utf-8-sig"
            with io.TextIOWrapper(raw, encoding=encoding, errors="replace") as file:
                number = before = 0
                while text := file.readline(_LONGEST):
                    number += 1
                    if len(text) == _LONGEST and not text.endswith("\n"):
                        raise BagError(
                            f"{plain(path)}:{number}: more than {_LONGEST} characters in a line; accepted: text in "
                            "lines"
                        )
                    if not number % _BLOCK and raw.seekable():
                        at = raw.tell()
                        more(at - before)
                        before = at
                    if comments is not None and text.lstrip().startswith(_COMMENTS):
                        comments += [text.strip()] * (len(comments) < _LOOKED_AT)
                    elif comments is None or text.strip():
                        yield number, text.rstrip("\r\n")
                if raw.seekable():
                    more(raw.tell() - before)
    except OSError as error:
        raise BagError(f"{plain(path)}: cannot be read ({error.strerror})") from error
    except UnicodeError as error:  # a mark of UTF-16 with nothing behind it
        raise BagError(f"{plain(path)}: cannot be read ({error})") from error


def fields_of(line: str, delimiter: str) -> list[str]:
    """Return the fields of a line; behind a delimiter at its end there is none."""
    sign = DELIMITERS[delimiter]
    if sign is None:
        return line.replace('"', " ").split()
    line = line.strip(" \r\n")
    try:
        fields = next(csv.reader([line], delimiter=sign)) if '"' in line else line.split(sign)
    except csv.Error:  # a quotation mark that damage or a slip has put there
        return [line]
    return fields[:-1] if len(fields) > 1 and not fields[-1].strip() else fields


def _normalised(line: str, delimiter: str, sign: str) -> tuple[str, int]:
    """Return a line with this sign between its fields, without quotation marks, and how many fields it has."""
    if delimiter == "space" or '"' in line:
        fields = fields_of(line, delimiter)
        return sign.join(text.replace(sign, " ").replace('"', " ") for text in fields), len(fields)
    line = line.strip(" \r\n").removesuffix(sign)
    return line, line.count(sign) + 1


def _split(lines: Sequence[str], sign: str, width: int, places: Sequence[int]) -> dict[int, pa.ChunkedArray]:
    """Return the texts of some columns of lines, by the columns' places."""
    content = "\n".join(lines).encode() + b"\n"
    names = [str(place) for place in range(width)]
    table = pyarrow.csv.read_csv(
        pa.BufferReader(content),
        pyarrow.csv.ReadOptions(use_threads=False, column_names=names, block_size=len(content) + 1),
        pyarrow.csv.ParseOptions(delimiter=sign, quote_char=False, ignore_empty_lines=False),
        pyarrow.csv.ConvertOptions(
            column_types=dict.fromkeys(names, pa.string()), include_columns=sorted({str(place) for place in places})
        ),
    )
    return {int(name): table.column(name) for name in table.column_names}


def _numbers(texts: pa.ChunkedArray, decimal: str) -> Array:
    """Return the numbers of a column; NaN where there is none."""
    trimmed = pc.utf8_trim_whitespace(texts)
    try:
        if decimal == ",":
            if pc.any(pc.match_substring(trimmed, ".")).as_py():
                raise pa.ArrowInvalid("a decimal point")
            trimmed = pc.replace_substring(trimmed, ",", ".")
        return np.asarray(pc.cast(trimmed, pa.float64()).to_numpy())
    except pa.ArrowInvalid:  # of one text; and of a plus sign
        return np.array([_number(text, decimal) for text in texts.to_pylist()])


def _number(text: str, decimal: str) -> float:
    """Return the number that a field holds; NaN if it holds none."""
    text = text.strip()
    if decimal == ",":
        if "." in text:
            return math.nan
        text = text.replace(",", ".")
    try:
        return math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan


def _stamp_ns(text: str, decimal: str, unit_ns: int) -> int:
    """Return a time in ns, exactly: floating point spoils ns of the wall clock; -1 if it is none."""
    if not math.isfinite(_number(text, decimal)):
        return -1
    try:
        return round(Decimal(text.strip().replace(",", ".")) * unit_ns)
    except (DecimalException, OverflowError):
        return -1


def _dialect(lines: Sequence[str], mapping: LogMapping) -> tuple[str, str]:
    """Return delimiter and decimal sign by which most fields are numbers and fewest others are not."""
    choice = [
        pair for pair in _DIALECTS if mapping.delimiter in (None, pair[0]) and mapping.decimal in (None, pair[1])
    ] or [(mapping.delimiter or ",", mapping.decimal or ".")]

    def score(pair: tuple[str, str]) -> int:
        texts = [text for line in lines for text in fields_of(line, pair[0])]
        good = sum(not math.isnan(_number(text, pair[1])) for text in texts)
        return 2 * good - len(texts)

    return max(choice, key=score)


def _header_lines(rows: Sequence[Sequence[str]], decimal: str) -> int:
    """Return how many lines there are before the first one that holds a number."""
    numeric = (k for k, row in enumerate(rows) if any(not math.isnan(_number(text, decimal)) for text in row))
    return next(numeric, len(rows))
