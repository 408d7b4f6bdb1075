"""Read logs in columns, CSV, Parquet and NPZ, with a signal map that describes the columns; make bags of them.

A text file is split line by line, for comments and torn rows; its times stay text until they are whole nanoseconds.
"""

from __future__ import annotations

import csv
import math
import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal, DecimalException
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
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import counted, listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_BLOCK: Final = 8192  # lines that are split at once
_LAST_NS: Final = 2**31 * NANOSECONDS  # stamps of ROS end there
_LARGEST: Final = 1e9  # rad, rad/s, Nm or A: beyond any joint, while a damaged number may be as large
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_COMMENTS = ("#", "%")
_LOOKED_AT = 200  # lines, by which delimiter and decimal sign are found out
_DECIMAL_COMMA = re.compile(r'(^|;)[\s"]*[+-]?\d*,\d+[\s"]*(;|$)')
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
        for series in self.series:
            read = f"{len(series.stamp_ns)} of {counted(self.rows, 'row')}"
            lines.append(f"{plain(series.topic)}: {counted(len(series.names), 'joint')}, {read}")
        if self.corrupt:
            lines.append(f"left out: {_corrupt_text(self.corrupt)}")
        return "\n".join(lines)


def _corrupt_text(corrupt: Mapping[int, str]) -> str:
    line = min(corrupt)
    return f"{counted(len(corrupt), 'corrupt row')}, line {listed(sorted(corrupt))} (line {line}: {corrupt[line]})"


class _Table(NamedTuple):
    """The columns of a log that are mapped, arrow's of texts or NumPy's of numbers.

    `dialect` says how it was read, `lines` are the numbers of the rows' lines, `faults` what is wrong with torn rows.
    """

    dialect: str
    decimal: str
    lines: Int64Array
    columns: Mapping[int | str, Any]
    faults: dict[int, str]


def read_log(path: Path, mapping: LogMapping | None = None, *, skip_corrupt: bool = False) -> ReadLog:
    """Read a log.

    Args:
        path: of the log.
        mapping: of its columns; by default the file beside it.
        skip_corrupt: whether damaged rows are skipped; otherwise they are refused.
    """
    mapping = mapping_of(path, mapping)
    table = _array_table(path, mapping) if path.suffix.lower() in ARRAYS else _text_table(path, mapping)
    faults = table.faults
    arrays: dict[str, dict[str, Any]] = {topic: {} for topic in mapping.by_topic}
    for topic, mapped in mapping.by_topic.items():
        for name, field in mapped.fields.items():
            numbers = [_numbers(table.columns[column], table.decimal) for column in field.columns]
            values = np.column_stack(numbers) * np.array(field.factors)  # a factor of 1 changes no bit
            arrays[topic][name] = values
            for row, k in np.argwhere(~(np.abs(values) <= _LARGEST)).tolist():  # a NaN, too
                column = field.columns[k]
                cell = table.columns[column][row]
                if not mapping.exact or _is_no_number(cell, values[row, k]):
                    faults.setdefault(row, f"column {plain(column)} is {_cell(cell)}")
    rows, stamps = _rows_in_time(table, mapping)
    corrupt = {int(table.lines[row]): fault for row, fault in faults.items()}
    if corrupt and not (skip_corrupt and len(rows)):
        none = "" if len(rows) else "every row is corrupt: "
        accepted = "columns as in the signal map, or rx90 bag import --skip-corrupt, to leave out some rows"
        raise BagError(f"{plain(path)}: {none}{_corrupt_text(corrupt)}; accepted: {accepted}")
    series = []
    for topic, mapped in mapping.by_topic.items():
        unit = mapped.effort_unit(topic)
        fields = {name: values[rows] for name, values in arrays[topic].items()}
        series.append(JointSeries(absolute(topic), mapped.names or (), stamps[rows], **fields, effort_unit=unit))
    return ReadLog(path, table.dialect, tuple(series), len(table.lines), corrupt)


def _rows_in_time(table: _Table, mapping: LogMapping) -> tuple[NDArray[np.intp], Int64Array]:
    """Return the rows without faults, in the order of time, and the times of all, ns; note the faults of times."""
    faults = table.faults
    count = len(table.lines)
    if mapping.time is None:
        stamps = np.rint(np.arange(count) * (NANOSECONDS / (mapping.rate or 1.0))).astype(np.int64)
        return np.setdiff1d(np.arange(count), list(faults)), stamps
    column = table.columns[mapping.time.column]
    stamps = _stamps_ns(column, table.decimal, int(SECONDS[mapping.time.unit] * NANOSECONDS))
    for row in np.flatnonzero(stamps < 0).tolist():
        accepted = f"0 to {_LAST_NS // NANOSECONDS} s, or ISO 8601"
        faults.setdefault(row, f"time {_cell(column[row])}; accepted: {accepted}")
    rows = np.setdiff1d(np.arange(count), list(faults))
    if mapping.exact:
        return rows[np.argsort(stamps[rows], kind="stable")], stamps
    increasing = rows[_increasing(stamps[rows])]
    for row in np.setdiff1d(rows, increasing).tolist():
        faults[row] = f"time {_cell(column[row])} does not lie between those around it"
    return increasing, stamps


def _is_no_number(cell: Any, value: float) -> bool:
    """Return whether what an exact log holds is no number, while the text for a NaN or an infinity is one."""
    return not (np.isfinite(value) or str(cell).strip("' ").lower().lstrip("+-") in _NOT_FINITE)


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


def _places(path: Path, mapping: LogMapping, names: Sequence[str], width: int) -> dict[int | str, int]:
    """Return the place of each column that is mapped."""
    used = [
        column for topic in mapping.by_topic.values() for field in topic.fields.values() for column in field.columns
    ]
    if mapping.time is not None:
        used.append(mapping.time.column)
    places: dict[int | str, int] = {}
    for column in used:
        if isinstance(column, int):
            if column > width:
                raise BagError(f"{plain(path)}: no column {column}; accepted: 1 to {width}")
            places[column] = column - 1
            continue
        if names.count(column) != 1:
            fault = "more than one column" if column in names else "no column"
            raise BagError(f"{plain(path)}: {fault} {quoted(column)}; there are {listed(names) or 'no names'}")
        places[column] = names.index(column)
    return places


def _array_table(path: Path, mapping: LogMapping) -> _Table:
    """Read a log of arrays: columns of Parquet; of NPZ those of shape (n,), and each column of (n, k), as `q[0]`."""
    is_parquet = path.suffix.lower() == ".parquet"
    try:
        with library_errors():
            if is_parquet:
                file = pq.ParquetFile(path, page_checksum_verification=True)
                names = [field.name for field in file.schema_arrow if _is_mapped(field.type)]
            else:
                arrays = _npz_columns(path)
                names = list(arrays)
            places = _places(path, mapping, names, len(names))
            if is_parquet:
                arrays = _parquet_columns(path, file, {names[place] for place in places.values()})
    except DamagedError as error:
        raise BagError(
            f"{plain(path)}: is no {'Parquet' if is_parquet else 'NPZ'} file, or damaged ({error})"
        ) from error
    columns = {column: arrays[names[place]] for column, place in places.items()}
    counts = {len(values) for values in columns.values()}
    if len(counts) != 1 or 0 in counts:
        lengths = ", ".join(f"{plain(column)} {len(values)}" for column, values in columns.items())
        raise BagError(f"{plain(path)}: rows: {lengths}; accepted: columns of as many rows each, one or more")
    dialect = f"{counted(len(names), 'column')} {listed(names)}"
    return _Table(dialect, ".", np.arange(1, counts.pop() + 1), columns, {})


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


def _parquet_columns(path: Path, file: pq.ParquetFile, names: set[str]) -> dict[str, NDArray[Any]]:
    """Return these columns of a Parquet file: others may be of texts of any length."""
    groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
    parts = [group.column(k) for group in groups for k in range(group.num_columns)]
    pages = sum(part.total_uncompressed_size for part in parts if part.path_in_schema in names)
    check_whole(path, "arrays", max(_NUMBER_BYTES * file.metadata.num_rows * len(names), pages))
    columns = {name: file.read([name])[name] for name in names}
    stamp = pa.timestamp("ns")
    return {
        name: (part.cast(stamp) if pa.types.is_timestamp(part.type) else part).to_numpy()
        for name, part in columns.items()
    }


def _text_table(path: Path, mapping: LogMapping) -> _Table:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise BagError(f"{plain(path)}: cannot be read ({error.strerror})") from error
    # Bytes of a damaged log that are no text make a corrupt row, not an unreadable file.
    text = raw.decode("utf-16" if raw.startswith(_UTF16) else "utf-8-sig", errors="replace")
    comments: list[str] = []
    lines: list[str] = []
    numbers: list[int] = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith(_COMMENTS):
            comments.append(line.lstrip("#% "))
        elif line.strip():
            lines.append(line)
            numbers.append(number)
    delimiter, decimal = _dialect(lines[:_LOOKED_AT], mapping)
    beginning = [_split(line, delimiter) for line in lines[:_BLOCK]]
    head = mapping.header
    if head is None:  # the lines before the first one that holds a number
        numeric = (k for k, row in enumerate(beginning) if any(not math.isnan(_number(cell, decimal)) for cell in row))
        head = next(numeric, len(beginning))
    widths = Counter(map(len, beginning[head:]))
    if not widths:
        raise BagError(f"{plain(path)}: holds no row of numbers; accepted: one or more behind the header")
    width = widths.most_common(1)[0][0]
    # NumPy and Matlab write the names into a comment; rows may end in a delimiter more than their header.
    named = [*beginning[:head], *(_split(line, delimiter) for line in comments[:_LOOKED_AT])]
    header = next((names for count in (width, width - 1) for names in named if len(names) == count), [])
    places = _places(path, mapping, header, width)
    faults: dict[int, str] = {}
    parts: dict[int | str, list[pa.Array]] = {column: [] for column in places}
    for begin in range(head, len(lines), _BLOCK):
        rows = [_split(line, delimiter) for line in lines[begin : begin + _BLOCK]]
        for k, row in enumerate(rows):
            if len(row) != width:
                faults[begin - head + k] = f"{counted(len(row), 'field')}, others have {width}"
                rows[k] = [""] * width
        for column, place in places.items():
            parts[column].append(pa.array([row[place] for row in rows], pa.string()))
    columns = {column: pa.chunked_array(part) for column, part in parts.items()}
    names = f"header {listed(header)}" if header else "no header"
    dialect = f"{counted(width, 'column')}, delimiter {delimiter!r}, decimal {decimal!r}, {names}"
    return _Table(dialect, decimal, np.array(numbers[head:], dtype=np.int64), columns, faults)


def _dialect(lines: Sequence[str], mapping: LogMapping) -> tuple[str, str]:
    """Return the delimiter, the first one that most lines have, and the decimal sign, a comma only beside ;."""
    if mapping.delimiter is None:
        delimiter = max(DELIMITERS.values(), key=lambda sign: sum(sign in line for line in lines))
    else:
        delimiter = DELIMITERS[mapping.delimiter]
    has_commas = delimiter == ";" and any(map(_DECIMAL_COMMA.search, lines))
    return delimiter, mapping.decimal or ("," if has_commas else ".")


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        line = " ".join(line.split())
    try:
        if '"' in line:
            cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
        else:
            cells = line.split(delimiter)
    except csv.Error:  # what damage has put there
        return [line]
    return [cell.strip() for cell in cells]


def _numbers(column: Any, decimal: str) -> NDArray[np.float64]:
    """Return the numbers of a column of texts, NaN where there is none, or of an array."""
    if isinstance(column, np.ndarray):
        return column.astype(np.float64)
    if decimal == ".":
        with suppress(pa.ArrowInvalid):  # of one text; and of a plus sign
            return np.asarray(pc.cast(column, pa.float64()).to_numpy())
    return np.array([_number(cell, decimal) for cell in column.to_pylist()])


def _number(cell: str, decimal: str) -> float:
    """Return the number that a cell holds; NaN if it holds none."""
    try:
        return float(_with_point(cell, decimal))
    except ValueError:
        return math.nan


def _with_point(cell: str, decimal: str) -> str:
    """Return the text of a number with a decimal point; nothing for text that only Python accepts as a number."""
    if "_" in cell or (decimal == "," and "." in cell):
        return ""
    return cell.replace(decimal, ".")


def _stamps_ns(column: Any, decimal: str, unit_ns: int) -> Int64Array:
    """Return times in ns, exactly if they are texts or whole numbers; -1 for times that are no valid stamps."""
    if not isinstance(column, np.ndarray):
        stamps = []
        for cell in column.to_pylist():
            try:  # floating point spoils ns of the wall clock
                stamp = round(Decimal(_with_point(cell, decimal)) * unit_ns)
            except (DecimalException, OverflowError, ValueError):
                stamp = _iso_ns(cell)
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


def _cell(cell: Any) -> str:
    if not isinstance(cell, pa.StringScalar):
        return str(cell)
    text = str(cell)
    return quoted(text.replace('"', " "), 30) if text.strip() else "empty"


def import_logs(
    logs: Sequence[tuple[Path, LogMapping | None]], bag: Path, *, skip_corrupt: bool = False
) -> list[ReadLog]:
    """Write a bag with the joint states of logs in columns.

    Args:
        logs: files with their mappings; None for the file beside one.
        bag: folder to make; must not exist.
        skip_corrupt: whether damaged rows are skipped; otherwise they are refused.

    Raises:
        BagWriteError: if the bag cannot be written.
    """
    read = [read_log(path, mapping, skip_corrupt=skip_corrupt) for path, mapping in logs]
    write_joint_states(bag, [series for log in read for series in log.series])
    return read
