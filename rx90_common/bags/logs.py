"""Read logs in columns, CSV, Parquet and NPZ, with a signal map that describes the columns; make bags of them.

For text files encoding, header, delimiter and decimal sign are detected unless they are given. Lines are checked
one by one, for comments and torn rows; times stay text until they are whole nanoseconds. Memory: the text of the
columns that are mapped, 8 bytes for each number, and as many again for the series.
"""

from __future__ import annotations

import csv
import io
import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal, DecimalException
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.limits import DamagedError, check_whole, library_errors, load_arrays
from rx90_common.bags.mapping import ARRAYS, DELIMITERS, SECONDS, LogMapping, mapping_of
from rx90_common.bags.topics import absolute
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import counted, listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_BLOCK: Final = 8192  # rows that are read at once
_LAST_NS: Final = 2**31 * NANOSECONDS  # stamps of ROS end there
_LARGEST: Final = 1e9  # rad, rad/s, Nm or A: beyond any joint, while a damaged number may be as large
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_LONGEST = 1 << 20  # characters of a line; a file that is no text may have no end of line at all
_COMMENTS = ("#", "%", "//")
_LOOKED_AT = 200  # lines, by which delimiter and decimal sign are found out
_NOT_FINITE = {"nan", "inf", "infinity"}
_NUMBER_BYTES = 8


@dataclass(frozen=True, eq=False)
class ReadLog:
    """What was read of a log.

    Attributes:
        path: of the log.
        dialect: how it was read.
        series: of each topic.
        rows: how many there were.
        corrupt: why a row was left out, by the number of its line.
    """

    path: Path
    dialect: str
    series: tuple[JointSeries, ...]
    rows: int
    corrupt: dict[int, str]

    @property
    def text(self) -> str:
        """Return it as lines for the terminal."""
        lines = [f"{plain(self.path)}: {self.dialect}"]
        lines += [f"{plain(series.topic)}: {counted(len(series.names), 'joint')}, "
                  f"{len(series.stamp_ns)} of {counted(self.rows, 'row')}" for series in self.series]  # fmt: skip
        return "\n".join([*lines, *([f"left out: {_corrupt_text(self.corrupt)}"] if self.corrupt else [])])


def _corrupt_text(corrupt: Mapping[int, str]) -> str:
    line = min(corrupt)
    return f"{counted(len(corrupt), 'corrupt row')}, line {listed(sorted(corrupt))} (line {line}: {corrupt[line]})"


class _Rows(NamedTuple):
    """The rows of a log: numbers of their lines, columns by place, and what is wrong with torn rows, by row.

    Columns are arrow's of texts or NumPy's of numbers.
    """

    lines: Int64Array
    columns: Mapping[int, Any]
    torn: dict[int, str]


class _Source(NamedTuple):
    """A log that is open: names and number of its columns, how it is read, its decimal sign, and what reads its rows.

    `rows` returns the columns at these places.
    """

    names: Sequence[str]
    width: int
    dialect: str
    decimal: str
    rows: Callable[[Sequence[int]], _Rows]


def read_log(path: Path, mapping: LogMapping | None = None, *, skip_corrupt: bool = False) -> ReadLog:
    """Read a log.

    Args:
        path: of the log.
        mapping: of its columns; by default the file beside it.
        skip_corrupt: whether damaged rows are skipped; otherwise they are refused.
    """
    mapping = mapping_of(path, mapping)
    source = _open_arrays(path) if path.suffix.lower() in ARRAYS else _open_text(path, mapping)
    used = [field.columns for topic in mapping.by_topic.values() for field in topic.fields.values()]
    places = {column: _place_of(column, path, source) for columns in used for column in columns}
    time = None if mapping.time is None else _place_of(mapping.time.column, path, source)
    lines, columns, faults = source.rows([*{*places.values(), *([] if time is None else [time])}])
    arrays: dict[str, dict[str, Any]] = {topic: {} for topic in mapping.by_topic}
    for topic, mapped in mapping.by_topic.items():
        for name, field in mapped.fields.items():
            texts = [columns[places[column]] for column in field.columns]
            values = np.column_stack([_numbers(text, source.decimal) for text in texts])
            arrays[topic][name] = values = values * np.array(field.factors)  # a factor of 1 changes no bit
            for row, column in np.argwhere(~(np.abs(values) <= _LARGEST)).tolist():  # a NaN, too
                if not mapping.exact or _is_no_number(texts[column][row], values[row, column]):
                    faults.setdefault(row, f"column {plain(field.columns[column])} is {_cell(texts[column][row])}")
    if mapping.time is None or time is None:
        stamps: Int64Array = np.rint(np.arange(len(lines)) * (NANOSECONDS / (mapping.rate or 1.0))).astype(np.int64)
    else:
        stamps = _stamps_ns(columns[time], source.decimal, int(SECONDS[mapping.time.unit] * NANOSECONDS))
        for row in np.flatnonzero(stamps < 0).tolist():
            accepted = f"0 to {_LAST_NS // NANOSECONDS} s, or ISO 8601"
            faults.setdefault(row, f"time {_cell(columns[time][row])}; accepted: {accepted}")
    rows = np.setdiff1d(np.arange(len(lines)), list(faults))
    if mapping.exact:
        rows = rows[np.argsort(stamps[rows], kind="stable")]
    elif time is not None:
        increasing = rows[_increasing(stamps[rows])]
        for row in np.setdiff1d(rows, increasing).tolist():
            faults[row] = f"time {_cell(columns[time][row])} does not lie between those around it"
        rows = increasing
    corrupt = {int(lines[row]): fault for row, fault in faults.items()}
    if corrupt and not (skip_corrupt and len(rows)):
        none = "" if len(rows) else "every row is corrupt: "
        accepted = "columns as in the signal map, or rx90_bag import --skip-corrupt, to leave out some rows"
        raise BagError(f"{plain(path)}: {none}{_corrupt_text(corrupt)}; accepted: {accepted}")
    series = []
    for topic, mapped in mapping.by_topic.items():
        unit = mapped.effort_unit(topic)
        fields = {name: values[rows] for name, values in arrays[topic].items()}
        series.append(JointSeries(absolute(topic), mapped.names or (), stamps[rows], **fields, effort_unit=unit))
    return ReadLog(path, source.dialect, tuple(series), len(lines), corrupt)


def _is_no_number(text: Any, value: float) -> bool:
    """Return whether what an exact log holds is no number, while the text for a NaN or an infinity is one."""
    return not (np.isfinite(value) or str(text).strip("' ").lower().lstrip("+-") in _NOT_FINITE)


def _increasing(stamps: Int64Array) -> list[int]:
    """Return the indices of the longest strictly increasing subsequence, of several the one with the shortest steps."""
    piles: list[list[int]] = []  # of indices; in a pile the values decrease
    smallest: list[int] = []  # last value of each pile
    for k, stamp in enumerate(stamps.tolist()):
        pile = bisect_left(smallest, stamp)
        if pile == len(piles):
            piles.append([])
        piles[pile].append(k)
        smallest[pile : pile + 1] = [stamp]
    chosen = [pile[-1] for pile in piles[-1:]]
    for members in reversed(piles[:-1]):
        # Of those that come before the one behind, the first, which is the largest, with a smaller value.
        first = bisect_left(members, True, key=lambda k: bool(stamps[k] < stamps[chosen[-1]]))
        chosen.append(members[first])
    return chosen[::-1]


def _place_of(column: int | str, path: Path, source: _Source) -> int:
    if isinstance(column, int):
        if column > source.width:
            raise BagError(f"{plain(path)}: no column {column}; accepted: 1 to {source.width}")
        return column - 1
    if source.names.count(column) != 1:
        what = "more than one column" if column in source.names else "no column"
        named = listed(source.names) or "no names"
        raise BagError(f"{plain(path)}: {what} {quoted(column)}; there are {named}")
    return source.names.index(column)


def _open_arrays(path: Path) -> _Source:
    """Open a log of arrays: columns of Parquet; of NPZ those of shape (n,), and each column of (n, k), as `q[0]`."""
    kind = "Parquet" if path.suffix.lower() == ".parquet" else "NPZ"
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with library_errors():
            if kind == "Parquet":
                file = pq.ParquetFile(path, page_checksum_verification=True)
                names = [field.name for field in file.schema_arrow if _is_mapped(field.type)]
            else:
                arrays = _npz_columns(path)
                names = list(arrays)
    except DamagedError as error:
        raise BagError(f"{plain(path)}: is no {kind} file, or damaged ({error})") from error

    def rows(places: Sequence[int]) -> _Rows:
        used = [names[place] for place in places]
        try:
            with library_errors():
                columns = _parquet_columns(path, file, used) if kind == "Parquet" else [arrays[name] for name in used]
        except DamagedError as error:
            raise BagError(f"{plain(path)}: is no {kind} file, or damaged ({error})") from error
        counts = {len(column) for column in columns}
        if len(counts) != 1 or 0 in counts:
            each = ", ".join(f"{plain(name)} {len(column)}" for name, column in zip(used, columns, strict=True))
            raise BagError(f"{plain(path)}: rows: {each}; accepted: columns of as many rows each, one or more")
        return _Rows(np.arange(1, counts.pop() + 1), dict(zip(places, columns, strict=True)), {})

    return _Source(names, len(names), f"{counted(len(names), 'column')} {listed(names)}", ".", rows)


def _npz_columns(path: Path) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {}
    for name, values in load_arrays(path).items():
        if values.dtype.kind in "fiuM" and values.ndim == 1:
            columns[name] = values
        elif values.dtype.kind in "fiu" and values.ndim == 2:
            columns |= {f"{name}[{k}]": column for k, column in enumerate(values.T)}
    return columns


def _is_mapped(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_timestamp(kind))


def _parquet_columns(path: Path, file: pq.ParquetFile, names: Sequence[str]) -> list[NDArray[Any]]:
    """Return these columns of a Parquet file: others may be of texts of any length."""
    groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
    parts = [group.column(k) for group in groups for k in range(group.num_columns)]
    pages = sum(part.total_uncompressed_size for part in parts if part.path_in_schema in names)
    check_whole(path, "arrays", max(_NUMBER_BYTES * file.metadata.num_rows * len(names), pages))
    columns = [file.read([name])[name] for name in names]
    stamp = pa.timestamp("ns")
    return [(part.cast(stamp) if pa.types.is_timestamp(part.type) else part).to_numpy() for part in columns]


def _open_text(path: Path, mapping: LogMapping) -> _Source:
    comments: list[str] = []
    lines = _lines_of(path, None if mapping.exact else comments)
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
    wider = [len(_fields_of(line, delimiter, width + 1)) > width for _, line in beginning[head:]]
    if all(wider) and any(len(names) == width + 1 for names in split[:head]):  # the last column is empty, but named
        width += 1
    # NumPy and Matlab write the names into a comment.
    texts = split[:head] + [_fields_of(line.lstrip("#%/ "), delimiter) for line in comments]
    header = next(([name.strip() for name in names] for names in texts if len(names) == width), [])

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

    named = f"header {listed(header)}" if header else "no header"
    dialect = f"{counted(width, 'column')}, delimiter {delimiter!r}, decimal {decimal!r}, {named}"
    return _Source(header, width, dialect, decimal, rows)


def _lines_of(path: Path, comments: list[str] | None) -> Iterator[tuple[int, str]]:
    """Yield lines with their numbers, from 1 on; without blank ones and comments, the first of which go into the list.

    Bytes of a damaged log that are no text make a corrupt row, not an unreadable file. Without a list all lines are
    rows.
    """
    try:
        with path.open("rb") as raw:
            encoding = "utf-16" if raw.peek(2)[:2] in _UTF16 else "utf-8-sig"
            file = io.TextIOWrapper(raw, encoding=encoding, errors="replace")
            number = 0
            while text := file.readline(_LONGEST):
                number += 1
                if len(text) == _LONGEST and not text.endswith("\n"):
                    where = f"{plain(path)}:{number}"
                    raise BagError(f"{where}: more than {_LONGEST} characters in a line; accepted: text in lines")
                if comments is not None and text.lstrip().startswith(_COMMENTS):
                    comments += [text.strip()][: _LOOKED_AT - len(comments)]
                elif comments is None or text.strip():
                    yield number, text.rstrip("\r\n")
    except (OSError, UnicodeError) as error:  # also a mark of UTF-16 with nothing behind it
        raise BagError(f"{plain(path)}: cannot be read ({plain(error)})") from error


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
    for kind in (pa.timestamp("ns"), pa.timestamp("ns", "UTC")):
        with suppress(pa.ArrowInvalid):
            return int(pa.scalar(text.replace(",", ".")).cast(kind).value)
    return -1


def _cell(value: Any) -> str:
    if not isinstance(value, pa.StringScalar):
        return str(value)
    text = str(value)
    return quoted(text.replace('"', " "), 30) if text.strip() else "empty"


def _dialect(lines: Sequence[str], mapping: LogMapping) -> tuple[str, str]:
    """Return delimiter and decimal sign by which most fields are numbers and fewest others are not."""

    def score(pair: tuple[str, str]) -> float:
        total = 0.0
        for line in lines:
            texts = [text for text in _fields_of(line, pair[0]) if text.strip()]
            numbers = sum(not math.isnan(_number(text, pair[1])) for text in texts)
            total += 2.0 * numbers - len(texts) if numbers else -1.0  # a header tells nothing
        return total

    delimiters = DELIMITERS if mapping.delimiter is None else (mapping.delimiter,)
    decimals = (".", ",") if mapping.decimal is None else (mapping.decimal,)
    return max(((delimiter, decimal) for decimal in decimals for delimiter in delimiters), key=score)


def import_logs(
    logs: Sequence[tuple[Path, LogMapping | None]], bag: Path, *, skip_corrupt: bool = False, storage: str = "mcap"
) -> list[ReadLog]:
    """Write a bag with the joint states of logs in columns.

    Args:
        logs: files with their mappings; None for the file beside one.
        bag: folder to make; must not exist.
        skip_corrupt: whether damaged rows are skipped; otherwise they are refused.
        storage: "mcap" or "sqlite3".

    Raises:
        BagWriteError: if the bag cannot be written.
    """
    read = [read_log(path, mapping, skip_corrupt=skip_corrupt) for path, mapping in logs]
    write_joint_states(bag, [series for log in read for series in log.series], storage=storage)
    return read
