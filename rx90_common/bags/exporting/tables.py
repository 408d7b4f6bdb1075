"""Files that take blocks of series: CSV and Parquet for one topic each, NPZ for any number of them."""

from __future__ import annotations

import csv
import io
import math
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.exporting.columns import STAMP, TIME, array_name, columns, mapping_text
from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain
from rx90_common.base.rates import NANOSECONDS

_LONGEST_NAME = 63  # of a variable in MATLAB
_CHUNK = 1 << 20  # bytes


class TableFile(Protocol):
    """A file that is being written."""

    def __init__(self, path: Path) -> None: ...

    def add(self, series: JointSeries) -> None:
        """Append a block; all of a topic have the same joints and arrays."""

    def close(self) -> None:
        """Complete the file."""


class CsvFile:
    """Times in s with nine decimals, which are exact, and numbers with all digits that they need to be read back equal.

    Beside it a mapping file, by which `rx90_bag import` makes the bag again.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = path.open("w", encoding="utf-8", newline="")
        self._begun = False

    def add(self, series: JointSeries) -> None:
        """Append a block."""
        if not self._begun:
            self._begun = True
            head = io.StringIO()
            names = [plain(name) for _, _, name in columns(series)]  # in one line, whatever a joint is called
            csv.writer(head, lineterminator="\n").writerow([TIME, *names])
            self._file.write(head.getvalue())
            self._path.with_suffix(".yaml").write_text(mapping_text(series), encoding="utf-8")
        values = np.concatenate(list(series.fields.values()), axis=1)
        words = repr if np.isfinite(values).all() else _word
        lines = [
            f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS:09d},{','.join(map(words, row))}\n"
            for stamp, row in zip(series.stamp_ns.tolist(), values.tolist(), strict=True)
        ]
        self._file.writelines(lines)

    def close(self) -> None:
        """Complete the file."""
        self._file.close()


def _word(value: float) -> str:
    return "-nan" if math.isnan(value) and math.copysign(1.0, value) < 0.0 else repr(value)


class ParquetFile:
    """Columns as in CSV, with the stamps in ns besides; unit, joint and field of each column in its metadata."""

    def __init__(self, path: Path) -> None:
        import pyarrow  # what not everyone has
        import pyarrow.parquet

        self._pyarrow, self._path = pyarrow, path
        self._writer: Any = None

    def add(self, series: JointSeries) -> None:
        """Append a block, which becomes a row group."""
        pa = self._pyarrow
        if self._writer is None:
            float64 = pa.float64()
            fields = [pa.field(STAMP, pa.int64(), False, {"unit": "ns"}), pa.field(TIME, float64, False, {"unit": "s"})]
            for joint, field, name in columns(series):
                told = {"unit": series.units[field], "joint": joint, "field": field}
                fields.append(pa.field(name, float64, False, told))
            schema = pa.schema(fields, {"topic": series.topic})
            self._writer = pa.parquet.ParquetWriter(self._path, schema)
        numbers = [
            np.ascontiguousarray(values[:, k]) for values in series.fields.values() for k in range(values.shape[1])
        ]
        arrays = [series.stamp_ns, series.time, *numbers]
        self._writer.write_table(pa.Table.from_arrays([pa.array(one) for one in arrays], schema=self._writer.schema))

    def close(self) -> None:
        """Complete the file."""
        if self._writer is not None:
            self._writer.close()


class NpzFile:
    """Arrays named by topic, quantity and unit, (n,) or (n, joints), and the names of the joints.

    The arrays are written to files beside the target, which are put together at the end, when their lengths are known.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._parts = path.with_name(f"{path.name}.parts")
        self._parts.mkdir()
        self._rows: dict[str, int] = {}  # of each array
        self._layouts: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {}  # shape of a row, type
        self._begun: set[str] = set()

    def add(self, series: JointSeries) -> None:
        """Append a block."""
        blocks = {STAMP: series.stamp_ns, TIME: series.time}
        blocks |= {series.quantities[field]: values for field, values in series.fields.items()}
        begun = series.topic in self._begun
        self._begun.add(series.topic)
        for quantity, values in blocks.items():
            name = array_name(series.topic, quantity)
            if not begun:
                self._begin(name, values)
            self._append(name, values)
        if not begun:
            names = np.array(series.names)
            name = array_name(series.topic, "names")
            self._begin(name, names)
            self._append(name, names)

    def _begin(self, name: str, values: NDArray[Any]) -> None:
        if len(name) > _LONGEST_NAME:
            raise BagError(
                f"array {name} has {len(name)} characters; accepted: up to {_LONGEST_NAME}, by a shorter topic"
            )
        if name in self._rows:
            raise BagError(f"two topics would be arrays {name}; accepted: one of them, with --topic")
        self._rows[name] = 0
        self._layouts[name] = values.shape[1:], values.dtype

    def _append(self, name: str, values: NDArray[Any]) -> None:
        with self._part(name).open("ab") as file:
            file.write(np.ascontiguousarray(values).tobytes())
        self._rows[name] += len(values)

    def _part(self, name: str) -> Path:
        return self._parts / f"{name}.npy"

    def close(self) -> None:
        """Complete the file."""
        with zipfile.ZipFile(self._path, "w", zipfile.ZIP_STORED, allowZip64=True) as together:
            for name, rows in self._rows.items():
                part, (shape, dtype) = self._part(name), self._layouts[name]
                about = {
                    "descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": (rows, *shape),
                }  # fmt: skip
                with together.open(part.name, "w", force_zip64=True) as array, part.open("rb") as data:
                    np.lib.format.write_array_header_1_0(array, about)
                    shutil.copyfileobj(data, array, _CHUNK)
                part.unlink()
        self._parts.rmdir()


FORMATS: Final[Mapping[str, type[TableFile]]] = {".csv": CsvFile, ".parquet": ParquetFile, ".npz": NpzFile}
