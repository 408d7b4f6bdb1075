"""Make series of logs in columns, CSV, Parquet and NPZ, with a signal map that describes the columns."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from decimal import Decimal, DecimalException
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.limits import DamagedError, check_arrays, library_errors, load_arrays
from rx90_common.bags.mapping import DELIMITERS, TIME_UNITS, LogMapping, mapping_of
from rx90_common.bags.topics import absolute
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_LAST_NS: Final = 2**31 * NANOSECONDS  # stamps of ROS end there
_LARGEST: Final = 1e9  # rad, rad/s, Nm or A: beyond any joint, while a damaged number may be as large
_COMMENT_OR_BLANK = re.compile(r"^[ \t]*([#%].*)?$", re.MULTILINE)
_NUMBER_BYTES = 8
_Columns = Mapping[int | str, Any]


def read_log(path: Path, mapping: LogMapping | None = None) -> JointSeries:
    """Read a log; its times are exact, and increase.

    Args:
        path: of the log.
        mapping: of its columns; by default the file beside it.

    Raises:
        BagError: naming the first column and row that hold no number, or no later time than the row before.
    """
    mapping = mapping_of(path, mapping)
    read = {".parquet": _parquet_columns, ".npz": _npz_columns}.get(path.suffix.lower(), _text_columns)
    try:
        with library_errors():
            return _series(path, mapping, read(path, mapping))
    except DamagedError as error:
        raise BagError(f"{plain(path)}: is damaged, or no such table as its suffix says ({error})") from error


def _series(path: Path, mapping: LogMapping, columns: _Columns) -> JointSeries:
    counts = {len(values) for values in columns.values()}
    if len(counts) != 1 or 0 in counts:
        lengths = ", ".join(f"{plain(column)} {len(values)}" for column, values in columns.items())
        raise BagError(f"{plain(path)}: rows: {lengths}; accepted: columns of as many rows each, one or more")
    count = counts.pop()
    fields: dict[str, Any] = {}
    for name, field in mapping.fields.items():
        fields[name] = np.empty((count, len(field.columns)))
        for k, column in enumerate(field.columns):
            values = columns[column].astype(np.float64)
            values *= field.factors[k]
            _check_rows(path, column, columns[column], np.abs(values) <= _LARGEST, "numbers of joints, up to 1e9")
            fields[name][:, k] = values
    stamps = _stamps_ns(path, mapping, columns, count)
    topic = absolute(mapping.table_topic)
    return JointSeries(topic, mapping.names or (), stamps, **fields, effort_unit=mapping.effort_unit(topic))


def _check_rows(path: Path, column: int | str, cells: Any, accepted: NDArray[np.bool_], words: str) -> None:
    """Refuse the first cell that is not accepted."""
    if not accepted.all():
        row = int(accepted.argmin())
        where = f"{plain(path)}: column {plain(column)}, row {row + 1}"
        raise BagError(f"{where}: {quoted(str(cells[row]))}; accepted: {words}")


def _check_names(path: Path, mapping: LogMapping, known: Sequence[int | str]) -> None:
    """Refuse a column that is not there once."""
    for column in mapping.columns:
        if known.count(column) != 1:
            fault = "more than one column" if column in known else "no column"
            raise BagError(f"{plain(path)}: {fault} {quoted(column)}; there are {listed(known)}")


def _npz_columns(path: Path, mapping: LogMapping) -> _Columns:
    """Return arrays of shape (n,), and each column of arrays (n, k), as `q[0]`."""
    columns: dict[str, Any] = {}
    for name, values in load_arrays(path).items():
        if values.ndim == 1:
            columns[name] = values
        elif values.ndim == 2:
            columns |= {f"{name}[{k}]": column for k, column in enumerate(values.T)}
    _check_names(path, mapping, list(columns))
    return {column: columns[str(column)] for column in mapping.columns}


def _parquet_columns(path: Path, mapping: LogMapping) -> _Columns:
    """Return the columns that are mapped: others may be of texts of any length."""
    file = pq.ParquetFile(path, page_checksum_verification=True)
    _check_names(path, mapping, file.schema_arrow.names)
    groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
    parts = [group.column(k) for group in groups for k in range(group.num_columns)]
    pages = sum(part.total_uncompressed_size for part in parts if part.path_in_schema in mapping.columns)
    check_arrays(path, max(_NUMBER_BYTES * file.metadata.num_rows * len(mapping.columns), pages))
    return {column: file.read([column])[column].to_numpy() for column in mapping.columns}


def _text_columns(path: Path, mapping: LogMapping) -> _Columns:
    """Return columns of numbers, and the texts of the times."""
    # Bytes of a damaged log that are no text make a cell that is no number, not an unreadable file.
    text = path.read_text("utf-8-sig", errors="replace").replace("\0", "\ufffd")
    delimiter = DELIMITERS[mapping.delimiter]
    if delimiter == " ":
        text = re.sub(r"(?m)^[ \t]+|[ \t]+$", "", text)
        text = re.sub(r"[ \t]+", " ", text)
    *head, body = text.split("\n", mapping.header)
    body = _COMMENT_OR_BLANK.sub("", body)
    first = head[-1].lstrip("#% \t") if head else body.lstrip("\n").partition("\n")[0]
    cells = next(csv.reader([first], delimiter=delimiter, skipinitialspace=True), [])
    names = [cell.strip() for cell in cells] if head else []
    if names and not re.search("[^-+0-9.,;eE \t]", first):
        raise BagError(f"{plain(path)}: no names in line {len(head)}; accepted: header, their line, or 0 for none")
    places = range(len(cells))
    _check_names(path, mapping, [*names, *(place + 1 for place in places)])
    wanted = {column: str(column - 1 if isinstance(column, int) else names.index(column)) for column in mapping.columns}
    types = dict.fromkeys(wanted.values(), pa.float64())
    if mapping.time is not None:
        types[wanted[mapping.time.column]] = pa.string()
    try:
        table = pa_csv.read_csv(
            pa.BufferReader(body.encode()),
            pa_csv.ReadOptions(use_threads=False, column_names=list(map(str, places))),
            pa_csv.ParseOptions(delimiter=delimiter),
            pa_csv.ConvertOptions(
                column_types=types, include_columns=list(types), null_values=[], decimal_point=mapping.decimal
            ),
        )
    except pa.ArrowInvalid as error:  # arrow counts columns from 0 on
        fault = re.sub(r"In CSV column #(\d+)", lambda found: f"column {int(found[1]) + 1}", str(error))
        raise BagError(f"{plain(path)}: {plain(fault, 300)}; accepted: columns as in the signal map") from error
    if table.num_rows != len(re.findall(r"(?m)^[ \t]*\S", body)):
        raise BagError(f"{plain(path)}: a quotation mark without a second one in its line; accepted: pairs of them")
    return {column: _cells(table[place]) for column, place in wanted.items()}


def _cells(column: pa.ChunkedArray) -> Any:
    return pc.utf8_trim_whitespace(column) if pa.types.is_string(column.type) else column.to_numpy()


def _stamps_ns(path: Path, mapping: LogMapping, columns: Mapping[int | str, Any], count: int) -> Int64Array:
    """Return the times in ns, exactly if they are texts or whole numbers."""
    time = mapping.time
    if time is None:
        return np.asarray(np.rint(np.arange(count) * (NANOSECONDS / (mapping.rate or 1.0))), dtype=np.int64)
    stamps: Int64Array
    cells = columns[time.column]
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
    else:
        stamps = np.array([_stamp_ns(cell, mapping.decimal, unit_ns) for cell in cells.to_pylist()], dtype=np.int64)
        inside = stamps >= 0
    _check_rows(path, time.column, cells, inside, f"times of 0 to {_LAST_NS // NANOSECONDS} s, or ISO 8601")
    _check_rows(path, time.column, cells, np.diff(stamps, prepend=-1) > 0, "times that increase")
    return stamps


def _stamp_ns(cell: str, decimal: str, unit_ns: int) -> int:
    """Return the time that a text says: a number, exactly, or ISO 8601, UTC without a zone of its own; -1 for none."""
    stamp: Decimal | int = -1
    if re.fullmatch(r"[0-9.,eE+-]+", cell):
        with suppress(DecimalException):
            stamp = Decimal(cell.replace(decimal, ".")) * unit_ns  # floating point spoils ns of the wall clock
    else:
        for kind in (pa.timestamp("ns"), pa.timestamp("ns", "UTC")):
            with suppress(pa.ArrowInvalid):
                stamp = pa.scalar(cell.replace(",", ".")).cast(kind).value
    return round(stamp) if 0 <= stamp < _LAST_NS else -1
