"""Make series of logs in columns, CSV, Parquet and NPZ, with a signal map that describes the columns."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from decimal import Decimal, DecimalException
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from rx90_common.bags.damage import library_errors, load_arrays
from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.mapping import DELIMITERS, TIME_UNITS, FieldColumns, LogMapping, mapping_of
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import BagError, located
from rx90_common.base.quoting import counted, listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_LAST_NS = 2**31 * NANOSECONDS  # stamps of ROS end there
# rad, rad/s, Nm or A: beyond any joint, while a damaged number may be as large
_LARGEST = 1e9
_LOOKED_AT = 200  # lines, by which delimiter, decimal sign and header are found out
_DECIMAL_COMMA = re.compile(r'(^|;)[\s"]*[+-]?\d*,\d+[\s"]*(;|$)')
_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
_NUMBER_OR_NONE = r"^[+-]?((?i:nan|inf|infinity)|(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?)$"
_Columns = Mapping[int | str, Any]


class _Table:
    """The mapped columns of a log, arrow's of texts or NumPy's of numbers, and the lines of their rows."""

    def __init__(
        self, columns: _Columns, decimal: str = ".", lines: Int64Array | None = None
    ) -> None:
        self.columns = columns
        self.decimal = decimal
        self.count = len(next(iter(columns.values()), ()))
        self.lines = np.arange(1, self.count + 1) if lines is None else lines

    def check(self, column: int | str, accepted: Mask, words: str) -> None:
        """Refuse the rows whose cell in this column is not accepted."""
        corrupt = np.flatnonzero(~accepted)
        if len(corrupt):
            first = corrupt[0]
            cell = quoted(str(self.columns[column][first]), 30)
            raise BagError(
                f"{counted(len(corrupt), 'corrupt row')}, the first in line {self.lines[first]}: "
                f"column {plain(column)} is {cell}; accepted: {words}"
            )


def read_log(path: Path, mapping: LogMapping | None = None) -> list[JointSeries]:
    """Return the series of each topic of a log; its times are exact, and increase.

    Args:
        path: of the log.
        mapping: of its columns; by default the file beside it.

    Raises:
        BagError: naming the first corrupt row, and why it is: no number, or no later time than the row before.
    """
    mapping = mapping_of(path, mapping)
    read = {".parquet": _parquet_columns, ".npz": _npz_columns}.get(
        path.suffix.lower(), _text_columns
    )
    with located(plain(path), BagError):
        with library_errors():
            table = read(path, mapping)
        counts = {len(values) for values in table.columns.values()}
        if len(counts) != 1 or 0 in counts:
            lengths = ", ".join(
                f"{plain(column)} {len(values)}" for column, values in table.columns.items()
            )
            raise BagError(f"rows: {lengths}; accepted: columns of as many rows each, one or more")
        stamps = _stamps_ns(table, mapping)
        rows = np.argsort(stamps, kind="stable")  # of an exact log; the times of others increase
        series = []
        for topic, columns in mapping.by_topic.items():
            arrays: dict[str, Any] = {
                name: _values(table, field, exact=mapping.exact)[rows]
                for name, field in columns.fields.items()
            }
            unit = columns.effort_unit(topic)
            names = columns.names or ()
            series.append(
                JointSeries(absolute(topic), names, stamps[rows], **arrays, effort_unit=unit)
            )
        return series


def _values(table: _Table, field: FieldColumns, *, exact: bool) -> Array:
    values = np.empty((table.count, len(field.columns)))
    for k, column in enumerate(field.columns):
        numbers, accepted = _numbers(table.columns[column], table.decimal, exact=exact)
        numbers = numbers * field.factors[k]  # a factor of 1 changes no bit
        if not exact:
            accepted = accepted & (np.abs(numbers) <= _LARGEST)  # a NaN is not
        table.check(column, accepted, "numbers of joints, up to 1e9")
        values[:, k] = numbers
    return values


def _numbers(cells: Any, decimal: str, *, exact: bool) -> tuple[Array, Mask]:
    """Return the numbers of an array, or of texts, and which cells hold one."""
    if isinstance(cells, np.ndarray):
        return cells.astype(np.float64), np.ones(len(cells), dtype=np.bool_)
    texts = cells
    if decimal == ",":
        texts = pc.if_else(
            pc.match_substring(texts, "."), "", pc.replace_substring(texts, ",", ".")
        )
    is_number = pc.match_substring_regex(texts, _NUMBER_OR_NONE if exact else _NUMBER)
    texts = pc.if_else(is_number, pc.replace_substring_regex(texts, r"^\+", ""), "nan")
    return pc.cast(texts, pa.float64()).to_numpy(), is_number.to_numpy()


def _check_names(mapping: LogMapping, known: Sequence[int | str]) -> None:
    """Refuse a column that is not there once."""
    for column in mapping.columns:
        if known.count(column) != 1:
            fault = "more than one column" if column in known else "no column"
            raise BagError(f"{fault} {quoted(column)}; there are {listed(known)}")


def _npz_columns(path: Path, mapping: LogMapping) -> _Table:
    """Return arrays of shape (n,), and each column of arrays (n, k), as `q[0]`."""
    columns: dict[str, Any] = {}
    for name, values in load_arrays(path).items():
        if values.ndim == 1:
            columns[name] = values
        elif values.ndim == 2:
            columns |= {f"{name}[{k}]": column for k, column in enumerate(values.T)}
    _check_names(mapping, list(columns))
    return _Table({column: columns[str(column)] for column in mapping.columns})


def _parquet_columns(path: Path, mapping: LogMapping) -> _Table:
    """Return the columns that are mapped: others may be of texts of any length."""
    file = pq.ParquetFile(path, page_checksum_verification=True)
    _check_names(mapping, file.schema_arrow.names)
    return _Table({column: file.read([column])[column].to_numpy() for column in mapping.columns})


def _lines_of(path: Path) -> tuple[pa.StringArray, Int64Array, list[str]]:
    """Return the lines of a text that are rows or names, their numbers, and the comments.

    None is an object of Python, which takes many times its bytes.
    """
    with path.open("rb") as stream:
        is_wide = stream.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    # Bytes of a damaged log that are no text make a corrupt row, not an unreadable file.
    text = path.read_text("utf-16" if is_wide else "utf-8-sig", errors="replace")
    text = text.replace("\0", "\ufffd")
    lines = pc.split_pattern(pa.array([text]), "\n").flatten()
    del text
    is_row = pc.match_substring_regex(lines, r"^\s*[^\s#%]")
    is_comment = pc.match_substring_regex(lines, r"^\s*[#%]")
    comments = [line.lstrip("#% \t") for line in lines.filter(is_comment)[:_LOOKED_AT].to_pylist()]
    return lines.filter(is_row), np.flatnonzero(is_row.to_numpy(zero_copy_only=False)) + 1, comments


def _text_columns(path: Path, mapping: LogMapping) -> _Table:
    """Return columns of texts: what is no number is told by row."""
    lines, numbers, comments = _lines_of(path)
    delimiter, decimal = _dialect(lines[:_LOOKED_AT].to_pylist(), mapping)
    if delimiter == " ":
        lines = pc.utf8_trim_whitespace(pc.replace_substring_regex(lines, r"\s+", " "))
    beginning = [_split(line, delimiter) for line in lines[:_LOOKED_AT].to_pylist()]
    head = mapping.header
    if head is None:  # the lines before the first one that holds a number
        head = next(
            (k for k, row in enumerate(beginning) if _has_number(row, decimal)), len(beginning)
        )
    elif 0 < head <= len(beginning) and all(
        _has_number([cell], decimal) for cell in beginning[head - 1]
    ):
        raise BagError(f"no names in line {head}; accepted: header, their line, or 0 for none")
    widths = Counter(map(len, beginning[head:]))
    if not widths:
        raise BagError("holds no row of numbers; accepted: one or more behind the header")
    width = widths.most_common(1)[0][0]
    # NumPy and Matlab write the names into a comment; rows may end in a delimiter more than their header.
    named = [*beginning[:head], *(_split(line, delimiter) for line in comments)]
    header = next(
        (names for count in (width, width - 1) for names in named if len(names) == count), []
    )
    _check_names(mapping, [*header, *range(1, width + 1)])
    places = {
        column: column - 1 if isinstance(column, int) else header.index(column)
        for column in mapping.columns
    }
    torn: list[pa_csv.InvalidRow] = []

    def note_torn(row: pa_csv.InvalidRow) -> str:
        torn.append(row)
        return "error"

    count = len(lines) - head
    rows = pa.ListArray.from_arrays([0, count], lines[head:])
    whole = pc.binary_join(rows, "\n")[0].as_buffer()
    del rows, lines
    fields = [str(place) for place in range(width)]
    try:
        table = pa_csv.read_csv(
            pa.BufferReader(whole),
            pa_csv.ReadOptions(use_threads=False, column_names=fields),
            pa_csv.ParseOptions(delimiter=delimiter, invalid_row_handler=note_torn),
            pa_csv.ConvertOptions(
                column_types=dict.fromkeys(fields, pa.string()),
                include_columns=[fields[place] for place in {*places.values()}],
            ),
        )
    except pa.ArrowInvalid as error:
        fault = plain(error, 300)
        if torn:
            there = counted(torn[0].actual_columns, "field")
            fault = f"{there} in line {numbers[head + torn[0].number - 1]}, others have {width}"
        raise BagError(f"{fault}; accepted: columns as in the signal map") from error
    if table.num_rows != count:
        raise BagError("a quotation mark without a second one in its line; accepted: pairs of them")
    columns = {
        column: pc.utf8_trim_whitespace(table[fields[place]]) for column, place in places.items()
    }
    return _Table(columns, decimal, numbers[head:])


def _dialect(lines: Sequence[str], mapping: LogMapping) -> tuple[str, str]:
    """Return the delimiter, the first one that most lines have, and the decimal sign, a comma only beside ;."""
    if mapping.delimiter is None:
        delimiter = max(DELIMITERS.values(), key=lambda sign: sum(sign in line for line in lines))
    else:
        delimiter = DELIMITERS[mapping.delimiter]
    has_commas = delimiter == ";" and any(map(_DECIMAL_COMMA.search, lines))
    return delimiter, mapping.decimal or ("," if has_commas else ".")


def _split(line: str, delimiter: str) -> list[str]:
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:  # what damage has put there
        cells = [line]
    return [cell.strip() for cell in cells]


def _has_number(cells: Sequence[str], decimal: str) -> bool:
    return any(re.match(_NUMBER, cell.replace(decimal, ".")) for cell in cells)


def _stamps_ns(table: _Table, mapping: LogMapping) -> Int64Array:
    """Return the times in ns, exactly if they are texts or whole numbers; -1 for times that are no valid stamps."""
    time = mapping.time
    if time is None:
        return np.asarray(
            np.rint(np.arange(table.count) * (NANOSECONDS / (mapping.rate or 1.0))), dtype=np.int64
        )
    cells = table.columns[time.column]
    unit_ns = TIME_UNITS[time.unit]
    if isinstance(cells, np.ndarray):
        if cells.dtype.kind == "M":  # it has a unit of its own
            cells = cells.astype("datetime64[ns]").astype(np.int64)
            unit_ns = 1
        inside = (cells >= 0) & (cells < _LAST_NS / unit_ns)  # a NaN is not
        times = np.where(inside, cells, 0)
        if np.issubdtype(cells.dtype, np.integer):
            stamps = times.astype(np.int64) * unit_ns
        else:
            stamps = np.rint(times * float(unit_ns)).astype(np.int64)
        stamps[~inside] = -1
    else:
        texts = (cell for part in cells.chunks for cell in part.to_pylist())
        stamps = np.fromiter(
            (_stamp_ns(cell, table.decimal, unit_ns) for cell in texts), np.int64, table.count
        )
    table.check(time.column, stamps >= 0, f"times of 0 to {_LAST_NS // NANOSECONDS} s, or ISO 8601")
    if not mapping.exact:
        later = np.diff(stamps, prepend=-1) > 0
        table.check(time.column, later, "a later time than in the row before")
    return np.asarray(stamps, dtype=np.int64)


def _stamp_ns(cell: str, decimal: str, unit_ns: int) -> int:
    """Return the time that a text says: a number, exactly, or ISO 8601, UTC without a zone of its own; -1 for none."""
    stamp: Decimal | int = -1
    if re.fullmatch(r"[0-9.,eE+-]+", cell):
        with suppress(DecimalException):
            # floating point spoils ns of the wall clock
            stamp = Decimal(cell.replace(decimal, ".")) * unit_ns
    elif re.match(r"\d{4}-\d", cell):
        for kind in (pa.timestamp("ns"), pa.timestamp("ns", "UTC")):
            with suppress(pa.ArrowInvalid):
                stamp = pa.scalar(cell.replace(",", ".")).cast(kind).value
    return round(stamp) if 0 <= stamp < _LAST_NS else -1
