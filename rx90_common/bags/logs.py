"""Read logs in columns, CSV, Parquet and NPZ, with a signal map that describes the columns; make bags of them.

For text files encoding, header, delimiter and decimal sign are detected unless they are given. Lines are checked
one by one, for comments and torn rows; times stay text until they are whole nanoseconds. Memory: the text of the
columns that are mapped, 8 bytes for each number, and as many again for the series.
"""

from __future__ import annotations

import csv
import io
import math
import re
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal, DecimalException
from itertools import groupby, islice
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.limits import DamagedError, check_whole, library_errors, load_arrays
from rx90_common.bags.mapping import ARRAYS, DELIMITERS, SECONDS, UNITS, Column, LogMapping, mapping_of
from rx90_common.bags.topics import absolute
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import counted, listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_BLOCK: Final = 8192  # rows that are read, or encoded, at once
_LAST_NS: Final = 2**31 * NANOSECONDS  # stamps of ROS end there
_LARGEST: Final = 1e9  # rad, rad/s, Nm or A: beyond any joint, while a damaged number may be as large
_MOST: Final = np.finfo(np.float64).max
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_LONGEST = 1 << 20  # characters of a line; a file that is no text may have no end of line at all
_BASIC_DATE = re.compile(r"^(\d{4})(\d\d)(\d\d)[T ](\d\d)(\d\d)(\d\d)")
_LEAP_SECOND = re.compile(r"[T ]\d\d:?[0-5]\d:?60([.,]\d+)?(Z|[+-][\d:]+)?$")
_THOUSANDS = {
    ".": re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?"),
    ",": re.compile(r"[+-]?[1-9]\d{0,2}(\.\d{3})+(,\d*)?"),
}
_ALMOST = 0.9  # of a number: what would be one without the signs of thousands
_COMMENTS = ("#", "%", "//")
_LOOKED_AT = 200  # lines, by which delimiter and decimal sign are found out
_DIALECTS = ((",", "."), (";", "."), ("tab", "."), ("|", "."), ("space", "."), (";", ","), ("tab", ","), ("|", ","),
             (",", ","), ("space", ","))  # fmt: skip
_NOT_FINITE = {"nan", "inf", "infinity"}
_NUMBER_BYTES = 8
_MAX_RANGES = 40  # of corrupt lines that are named


@dataclass(frozen=True, eq=False)
class ReadLog:
    """What was read of logs whose rows belong together.

    Attributes:
        paths: of the logs.
        dialects: how each of them was read.
        series: of each topic.
        rows: how many there were.
        corrupt: number of the line of each row that was left out, and why.
    """

    paths: tuple[Path, ...]
    dialects: tuple[str, ...]
    series: tuple[JointSeries, ...]
    rows: int
    corrupt: tuple[tuple[int, str], ...]

    @property
    def text(self) -> str:
        """Return it as lines for the terminal."""
        good = self.rows - len(self.corrupt)
        steps = np.diff(self.series[0].stamp_ns)
        seconds = int(steps.sum()) / NANOSECONDS
        gap = int(steps.max(initial=0)) / NANOSECONDS
        rate = f", {(good - 1) / seconds:.6g} Hz, longest gap {gap:.6g} s" if seconds else ""
        lines = [
            *(f"{plain(path)}: {dialect}" for path, dialect in zip(self.paths, self.dialects, strict=True)),
            f"{good} of {counted(self.rows, 'row')} in {seconds:.6g} s{rate}",
            *(f"{series.topic}: {counted(len(series.names), 'joint')}" for series in self.series),
        ]
        return "\n".join([*lines, *([f"left out: {corrupt_text(self.corrupt)}"] if self.corrupt else [])])


def corrupt_text(corrupt: Sequence[tuple[int, str]]) -> str:
    """Return count and numbers of the lines, those that follow each other together, and what the first one has."""
    lines = [line for line, _ in corrupt]
    places = []
    for _, run in groupby(enumerate(lines), key=lambda pair: pair[1] - pair[0]):
        first, *later = [line for _, line in run]
        places.append(f"{first}-{later[-1]}" if later else f"{first}")
    more = f" and {counted(len(places) - _MAX_RANGES, 'more place')}" if len(places) > _MAX_RANGES else ""
    rows = counted(len(lines), "corrupt row")
    return f"{rows}, line {', '.join(places[:_MAX_RANGES])}{more} (line {lines[0]}: {corrupt[0][1]})"


def read_logs(
    paths: Sequence[Path],
    mapping: LogMapping | None = None,
    more: Callable[[int], object] = int,
    *,
    skip_corrupt: bool = False,
) -> ReadLog:
    """Read logs whose rows belong together.

    Args:
        paths: of the logs.
        mapping: of their columns; by default the file beside the first log.
        more: called now and then with the number of bytes read since the last call.
        skip_corrupt: whether damaged rows are skipped; otherwise they are refused.
    """
    mapping = mapping_of(paths[0], mapping)
    if len(paths) != mapping.files:
        given = counted(len(paths), "log")
        raise BagError(f"{given}; accepted: {mapping.files}, those that {plain(mapping.path)} takes columns from")
    logs = [_read_log(path, mapping, number, more) for number, path in enumerate(paths, 1)]
    counts = [len(log.lines) for log in logs]
    if len(set(counts)) > 1:
        each = ", ".join(f"{plain(path)} {count}" for path, count in zip(paths, counts, strict=True))
        raise BagError(f"rows: {each}; accepted: logs of as many rows each")
    if mapping.time is None:
        assert mapping.rate is not None
        stamps: Int64Array = np.asarray(np.rint(np.arange(counts[0]) * (NANOSECONDS / mapping.rate)), dtype=np.int64)
    else:
        stamps = logs[mapping.time.file - 1].stamp_ns
    faults = dict(logs[0].faults)
    for path, log in zip(paths[1:], logs[1:], strict=True):
        for row, reason in log.faults.items():
            faults.setdefault(row, f"{plain(path)}:{log.lines[row]}: {reason}")
    rows = _good_rows(stamps, mapping, faults)
    corrupt = tuple((int(logs[0].lines[row]), faults[row]) for row in sorted(faults))
    if corrupt and not (skip_corrupt and len(rows)):
        what = "every row is corrupt: "
        accepted = "columns as the signal map says"
        if len(rows):
            what = ""
            accepted = "whole rows, or rx90_bag import --skip-corrupt, to leave these out"
        raise BagError(f"{plain(paths[0])}: {what}{corrupt_text(corrupt)}; accepted: {accepted}")
    series = []
    for topic, mapped in mapping.by_topic.items():
        fields: dict[str, Any] = {}
        for name, field in mapped.fields.items():
            columns = logs[field.file - 1].columns
            values = np.column_stack([columns[column] for column in field.columns])
            fields[name] = (values * np.array(field.factors))[rows]  # a factor of 1 changes no bit
        unit = mapped.effort_unit(topic)
        series.append(JointSeries(absolute(topic), mapped.names or (), stamps[rows], **fields, effort_unit=unit))
    return ReadLog(tuple(paths), tuple(log.dialect for log in logs), tuple(series), counts[0], corrupt)


def _good_rows(stamps: Int64Array, mapping: LogMapping, faults: dict[int, str]) -> Int64Array:
    """Return the rows without a fault, in the order of time; note those whose time does not fit the others."""
    rows = np.setdiff1d(np.arange(len(stamps)), list(faults))
    if mapping.exact:
        return np.asarray(rows[np.argsort(stamps[rows], kind="stable")])
    if mapping.time is None:
        return rows
    increasing = rows[_increasing(stamps[rows])]
    for row in np.setdiff1d(rows, increasing).tolist():
        time = Decimal(int(stamps[row])) * mapping.seconds.denominator / (NANOSECONDS * mapping.seconds.numerator)
        faults[row] = f"time {quoted(f'{time:f}')} does not lie between those around it"
    return increasing


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


class _Rows(NamedTuple):
    """The rows of a log: numbers of their lines, columns by place, and what is wrong with torn rows, by row."""

    lines: Int64Array
    columns: Mapping[int, Any]
    torn: dict[int, str]


class _Source(NamedTuple):
    """A log that is open: names and number of its columns, how it is read, and its decimal sign.

    `rows` returns the columns at these places, arrow's of texts or NumPy's of numbers.
    """

    names: Sequence[str]
    width: int
    dialect: str
    decimal: str
    rows: Callable[[Sequence[int]], _Rows]


class _Log(NamedTuple):
    """The data of a mapping from one log: lines and stamps of rows, numbers by column, and faults of rows."""

    dialect: str
    lines: Int64Array
    stamp_ns: Int64Array
    columns: dict[Column, Array]
    faults: dict[int, str]


def _read_log(path: Path, mapping: LogMapping, number: int, more: Callable[[int], object]) -> _Log:
    """Read the log of this number, from 1 on, in a mapping."""
    source = _open_arrays(path, more) if path.suffix.lower() in ARRAYS else _open_text(path, mapping, more)
    time, used = _places(path, source, mapping, number)
    lines, columns, faults = source.rows([*{*used.values()}, *([] if time is None else [time])])
    values = {column: _numbers(columns[place], source.decimal) for column, place in used.items()}
    fields = [field for topic in mapping.by_topic.values() for field in topic.fields.values() if field.file == number]
    for column, factor in (pair for field in fields for pair in zip(field.columns, field.factors, strict=True)):
        texts = columns[used[column]]
        absurd = ~(np.abs(values[column] * factor) <= (_MOST if mapping.exact else _LARGEST))  # a NaN, too
        for row in np.flatnonzero(absurd).tolist():
            # In an exact log the text for a NaN or an infinity is a number.
            if not mapping.exact or str(texts[row]).strip("' ").lower().lstrip("+-") not in _NOT_FINITE:
                about = f"column {plain(column)} is {_cell(texts[row])}"
                if _likeness(str(texts[row]), source.decimal) == _ALMOST:
                    about += f"; accepted: decimal {source.decimal!r}, no signs of thousands"
                faults.setdefault(row, about)
    stamps = np.zeros(len(lines), dtype=np.int64)
    if time is not None:
        stamps = _stamps_ns(columns[time], source.decimal, int(mapping.seconds * NANOSECONDS))
        for row in np.flatnonzero(stamps < 0).tolist():
            accepted = f"0 to {_LAST_NS // NANOSECONDS} s, or ISO 8601"
            if _LEAP_SECOND.search(str(columns[time][row]).strip()):
                accepted = "seconds below 60, no leap second"
            faults.setdefault(row, f"time {_cell(columns[time][row])}; accepted: {accepted}")
    return _Log(source.dialect, lines, stamps, values, faults)


def _places(path: Path, source: _Source, mapping: LogMapping, number: int) -> tuple[int | None, dict[Column, int]]:
    """Return the places of the times and of the mapped columns of a log.

    Refuses a column that is mapped to two joints, or to the times and a joint, and in an exact log a header whose
    units, as in `joint_1 velocity [deg/s]`, are not those of the mapping.
    """

    def place_of(column: Column) -> int:
        if isinstance(column, int):
            if column > source.width:
                raise BagError(f"{plain(path)}: no column {column}; accepted: 1 to {source.width}")
            return column - 1
        if source.names.count(column) != 1:
            what = "more than one column" if column in source.names else "no column"
            named = listed(source.names) or "no names"
            raise BagError(f"{plain(path)}: {what} {quoted(column)}; there are {named}")
        return source.names.index(column)

    def compare_unit(place: int, known: Mapping[str, Any], mapped: str) -> None:
        heading = source.names[place] if mapping.exact and source.names else ""
        unit = heading.rpartition("[")[2].rstrip("]") if heading.endswith("]") else ""
        if unit in known and unit != mapped:
            raise BagError(
                f"{plain(path)}:{mapping.header}: {quoted(heading)}, but {mapped} in {plain(mapping.path)}; "
                "accepted: the same unit in both"
            )

    time = None
    used = dict[Column, int]()
    if mapping.time is not None and mapping.time.file == number:
        time = place_of(mapping.time.column)
        compare_unit(time, SECONDS, next(name for name, size in SECONDS.items() if size == mapping.seconds))
    for topic, mapped in mapping.by_topic.items():
        for name, field in mapped.fields.items():
            taken = {time}
            for column in field.columns if field.file == number else ():
                place = used[column] = place_of(column)
                if place in taken:
                    owner = "the times" if place == time else "another joint"
                    raise BagError(
                        f"{plain(path)}: column {plain(column)} in {plain(topic)}.{name} is that of {owner}; "
                        "accepted: a column of its own for each"
                    )
                taken.add(place)
                compare_unit(place, UNITS[name], field.unit)
    return time, used


def _open_arrays(path: Path, more: Callable[[int], object]) -> _Source:
    """Open a log of arrays: columns of Parquet; of NPZ those of shape (n,), and each column of (n, k), as `q[0]`."""
    parquet = path.suffix.lower() == ".parquet"
    try:
        with library_errors():
            names, columns_of = _open_parquet(path) if parquet else _open_npz(path)
    except DamagedError as error:
        raise _damaged(path, error) from error

    def rows(places: Sequence[int]) -> _Rows:
        try:
            with library_errors():
                columns = columns_of(places)
        except DamagedError as error:
            raise _damaged(path, error) from error
        counts = {len(column) for column in columns.values()}
        if len(counts) != 1 or 0 in counts:
            each = ", ".join(f"{plain(names[place])} {len(column)}" for place, column in columns.items())
            raise BagError(f"{plain(path)}: rows: {each}; accepted: columns of as many rows each, one or more")
        more(path.stat().st_size)
        return _Rows(np.arange(1, counts.pop() + 1), columns, {})

    return _Source(names, len(names), f"{counted(len(names), 'column')} {listed(names)}", ".", rows)


def _damaged(path: Path, error: DamagedError) -> BagError:
    kind = "Parquet" if path.suffix.lower() == ".parquet" else "NPZ"
    return BagError(f"{plain(path)}: is no {kind} file, or damaged ({error})")


_Columns: TypeAlias = Callable[[Sequence[int]], dict[int, NDArray[Any]]]


def _open_npz(path: Path) -> tuple[list[str], _Columns]:
    """Return the names of columns, and what returns those at some places."""
    arrays: dict[str, NDArray[Any]] = {}
    for name, values in load_arrays(path).items():
        if values.dtype.kind in "fiuM" and values.ndim == 1:
            arrays[name] = values
        elif values.dtype.kind in "fiu" and values.ndim == 2:
            arrays |= {f"{name}[{k}]": column for k, column in enumerate(values.T)}
    names = list(arrays)
    return names, lambda places: {place: arrays[names[place]] for place in places}


def _open_parquet(path: Path) -> tuple[list[str], _Columns]:
    """Return the names of columns, and what reads those at some places: others may be of texts of any length."""
    file = pq.ParquetFile(path, page_checksum_verification=True)
    names = [field.name for field in file.schema_arrow if _is_number(field.type) or pa.types.is_timestamp(field.type)]

    def columns_of(places: Sequence[int]) -> dict[int, NDArray[Any]]:
        used = [names[place] for place in places]
        check_whole(path, "arrays", max(_NUMBER_BYTES * file.metadata.num_rows * len(used), _unpacked(file, used)))
        table = file.read(used)
        columns = {}
        for place, name in zip(places, used, strict=True):
            column = table[name]
            columns[place] = (column if _is_number(column.type) else column.cast(pa.timestamp("ns"))).to_numpy()
        return columns

    return names, columns_of


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


def _unpacked(file: pq.ParquetFile, names: Sequence[str]) -> int:
    """Return the length of the pages of some columns of a Parquet file."""
    groups = (file.metadata.row_group(k) for k in range(file.metadata.num_row_groups))
    parts = (group.column(k) for group in groups for k in range(group.num_columns))
    return sum(part.total_uncompressed_size for part in parts if part.path_in_schema in names)


def _open_text(path: Path, mapping: LogMapping, more: Callable[[int], object]) -> _Source:
    """Open a log of text, which may be a pipe."""
    comments: list[str] = []
    lines = _lines_of(path, more, None if mapping.exact else comments)
    beginning = [*islice(lines, _BLOCK)]
    delimiter, decimal = _dialect([line for _, line in beginning[:_LOOKED_AT]], mapping)
    split = [_fields_of(line, delimiter) for _, line in beginning]
    head = mapping.header
    if head is None:  # the lines before the first one that holds a number
        numeric = (k for k, row in enumerate(split) if any(not math.isnan(_number(text, decimal)) for text in row))
        head = next(numeric, len(split))
    widths = Counter(map(len, split[head:]))
    if not widths:
        raise BagError(f"{plain(path)}: holds no row of numbers; accepted: one or more behind the header")
    width = widths.most_common(1)[0][0]
    wider = Counter(len(_fields_of(line, delimiter, width + 1)) for _, line in beginning[head:]).most_common(1)[0][0]
    if any(len(names) == wider for names in split[:head]):  # the last column is empty, and has a name
        width = wider
    # NumPy and Matlab write the names into a comment.
    texts = split[:head] + [_fields_of(line.lstrip("#%/ "), delimiter) for line in comments]
    header = next(([name.strip() for name in texts] for texts in texts if len(texts) == width), [])
    named = f"header {listed(header)}" if header else "no header"
    named += f" in {head} lines before the first row" if head > 1 else ""

    def rows(places: Sequence[int]) -> _Rows:
        numbers: list[int] = []
        torn: dict[int, str] = {}
        parts: dict[int, list[pa.Array]] = {place: [] for place in places}
        block = beginning[head:]
        while block:
            split = [_fields_of(line, delimiter, width) for _, line in block]
            for row, fields in enumerate(split):
                if len(fields) != width:
                    torn[len(numbers) + row] = f"{counted(len(fields), 'field')}, others have {width}"
                    split[row] = [""] * width
            numbers += [number for number, _ in block]
            for place, part in parts.items():
                part.append(pa.array([fields[place] for fields in split], pa.string()))
            block = [*islice(lines, _BLOCK)]
        columns = {place: pa.chunked_array(part) for place, part in parts.items()}
        return _Rows(np.array(numbers, dtype=np.int64), columns, torn)

    dialect = f"{counted(width, 'column')}, delimiter {delimiter!r}, decimal {decimal!r}, {named}"
    return _Source(header, width, dialect, decimal, rows)


def _lines_of(path: Path, more: Callable[[int], object], comments: list[str] | None) -> Iterator[tuple[int, str]]:
    """Yield lines with their numbers, from 1 on; without blank ones and comments, the first of which go into the list.

    Bytes of a damaged log that are no text make a corrupt row, not an unreadable file. Without a list all lines are
    rows.
    """
    try:
        with path.open("rb") as raw:
            encoding = "utf-16" if raw.peek(2)[:2] in _UTF16 else "utf-8-sig"
            with io.TextIOWrapper(raw, encoding=encoding, errors="replace") as file:
                number = before = 0
                while text := file.readline(_LONGEST):
                    number += 1
                    if len(text) == _LONGEST and not text.endswith("\n"):
                        where = f"{plain(path)}:{number}"
                        raise BagError(f"{where}: more than {_LONGEST} characters in a line; accepted: text in lines")
                    if not number % _BLOCK and raw.seekable():
                        more(-before + (before := raw.tell()))
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


def _fields_of(line: str, delimiter: str, width: int = 0) -> list[str]:
    """Return the fields of a line; behind a delimiter at its end there is none, but where it makes the width full."""
    sign = DELIMITERS[delimiter]
    if sign is None:
        return line.replace('"', " ").split()
    line = line.strip(" \r\n")
    try:
        fields = next(csv.reader([line], delimiter=sign)) if '"' in line else line.split(sign)
    except csv.Error:  # a quotation mark that damage or a slip has put there
        return [line]
    return fields[:-1] if 1 < len(fields) != width and not fields[-1].strip() else fields


def _numbers(column: Any, decimal: str) -> Array:
    """Return the numbers of a column of texts, NaN where there is none, or of an array."""
    if isinstance(column, np.ndarray):
        return column.astype(np.float64)
    if decimal == ".":
        with suppress(pa.ArrowInvalid):  # of one text; and of a plus sign
            return np.asarray(pc.cast(pc.utf8_trim_whitespace(column), pa.float64()).to_numpy())
    return np.array([_number(text, decimal) for text in column.to_pylist()])


def _number(text: str, decimal: str) -> float:
    """Return the number that a field holds; NaN if it holds none."""
    try:
        return float(_with_point(text, decimal))
    except ValueError:
        return math.nan


def _with_point(text: str, decimal: str) -> str:
    """Return the text of a number with a decimal point; nothing for text that only Python accepts as a number."""
    if "_" in text or (decimal == "," and "." in text):
        return ""
    return text.strip().replace(",", ".") if decimal == "," else text.strip()


def _stamps_ns(column: Any, decimal: str, unit_ns: int) -> Int64Array:
    """Return times in ns, exactly if they are texts or whole numbers; -1 for times that are no valid stamps."""
    if not isinstance(column, np.ndarray):
        stamps = []
        for text in column.to_pylist():
            try:  # floating point spoils ns of the wall clock
                stamp = round(Decimal(_with_point(text, decimal)) * unit_ns)
            except (DecimalException, OverflowError, ValueError):
                stamp = _iso_ns(text.strip())
            stamps.append(stamp if 0 <= stamp < _LAST_NS else -1)
        return np.array(stamps, dtype=np.int64)
    if column.dtype.kind == "M":  # it has a unit of its own
        column = column.astype("datetime64[ns]").astype(np.int64)
        unit_ns = 1
    inside = (column >= 0) & (column < _LAST_NS / unit_ns)  # a NaN is not
    stamps_ns = np.full(len(column), -1, dtype=np.int64)
    whole = np.issubdtype(column.dtype, np.integer)
    stamps_ns[inside] = column[inside] * unit_ns if whole else np.rint(column[inside] * float(unit_ns))
    return stamps_ns


def _iso_ns(text: str) -> int:
    """Return an ISO 8601 time in ns since 1970, UTC without a zone of its own; -1 for another text."""
    text = _BASIC_DATE.sub(r"\1-\2-\3T\4:\5:\6", text.replace(",", "."))
    for kind in (pa.timestamp("ns"), pa.timestamp("ns", "UTC")):
        with suppress(pa.ArrowInvalid):
            return int(pa.scalar(text).cast(kind).value)
    return -1


def _cell(value: Any) -> str:
    if not isinstance(value, pa.StringScalar):
        return str(value)
    text = str(value)
    return quoted(text.replace('"', " "), 30) if text.strip() else "empty"


def _dialect(lines: Sequence[str], mapping: LogMapping) -> tuple[str, str]:
    """Return delimiter and decimal sign by which most fields are numbers and fewest others are not."""
    choice = [
        pair for pair in _DIALECTS if mapping.delimiter in (None, pair[0]) and mapping.decimal in (None, pair[1])
    ] or [(mapping.delimiter or ",", mapping.decimal or ".")]

    def score(pair: tuple[str, str]) -> float:
        total = 0.0
        for line in lines:
            texts = [text for text in _fields_of(line, pair[0]) if text.strip()]
            numbers = sum(_likeness(text, pair[1]) for text in texts)
            total += 2.0 * numbers - len(texts) if numbers else -1.0  # a header tells nothing
        return total

    return max(choice, key=score)


def _likeness(text: str, decimal: str) -> float:
    """Return how much a field is like a number, 0 to 1."""
    if not math.isnan(_number(text, decimal)):
        return 1.0
    return _ALMOST if _THOUSANDS[decimal].fullmatch(text.strip()) else 0.0


def exported_logs(folder: Path) -> list[tuple[list[Path], LogMapping]]:
    """Return the CSV files of a folder with the signal maps of the same names, as an export writes them."""
    pairs = [([log], mapping_of(log)) for log in sorted(folder.glob("*.csv"))]
    if not pairs:
        accepted = "a folder that rx90_bag export has written, as CSV"
        raise BagError(f"{plain(folder)}: no CSV file in it; accepted: {accepted}")
    for _, mapping in pairs:
        if not mapping.exact:
            raise BagError(
                f"{plain(mapping.path)}: exact is not true; accepted in a folder: what rx90_bag export has written"
            )
    return pairs


def import_logs(
    logs: Sequence[tuple[Sequence[Path], LogMapping]],
    bag: Path,
    *,
    skip_corrupt: bool = False,
    storage: str = "mcap",
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[ReadLog]:
    """Write a bag with the joint states of logs in columns.

    Args:
        logs: files with their mappings; the rows of several files of one mapping belong together, one by one.
        bag: folder to make; must not exist.
        skip_corrupt: whether damaged rows are skipped; otherwise they are refused.
        storage: "mcap" or "sqlite3".
        progress: called with the number of bytes read so far, and the total.

    Raises:
        BagWriteError: if the bag cannot be written.
    """
    total = sum(path.stat().st_size for paths, _ in logs for path in paths if path.is_file())
    done = 0

    def more(count: int) -> None:
        nonlocal done
        done = min(done + count, total)
        progress(done, total)

    read = [read_logs(paths, mapping, more, skip_corrupt=skip_corrupt) for paths, mapping in logs]
    write_joint_states(bag, [series for log in read for series in log.series], storage=storage)
    return read
