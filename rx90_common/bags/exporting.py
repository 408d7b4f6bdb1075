"""Write the joint states of a bag as tables for other programs, one topic each."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping, exported_mapping
from rx90_common.bags.reading import Progress, read_joint_bag, silent
from rx90_common.bags.writing import named_at_the_end
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS

if TYPE_CHECKING:
    import pyarrow as pa

_STAMP = "stamp [ns]"


def export_bag(
    path: Path,
    output: Path,
    *,
    topics: Sequence[str] | None = None,
    progress: Progress = silent,
    mapping: LogMapping | None = None,
) -> dict[str, int]:
    """Write JointState topics of a bag as tables; return their numbers of messages. An interrupt leaves no files.

    Args:
        path: a bag.
        output: file, whose suffix is the format, or a folder, which gets a CSV file for each topic; new.
        topics: topic names; by default all topics with messages.
        progress: called with the number of messages read so far, and the total.
        mapping: of the columns of a table; by default the file beside it.

    Raises:
        BagWriteError: if the disk is full.
    """
    single = output.suffix != ""
    kind = output.suffix.lower() or ".csv"
    if kind not in FORMATS:
        raise BagError(
            f"{plain(output)}: the suffix says the format; accepted: {listed(FORMATS)}, or none"
        )
    write = FORMATS[kind]
    read = read_joint_bag(path, topics, progress, mapping, all_there=True)
    tables = [read.one(topic) for topic, sets in read.series.items() if sets or topics is not None]
    if single and len(tables) > 1:
        topics = [series.topic for series in tables]
        raise BagError(
            f"{plain(output)} would hold {listed(topics)}; accepted: one topic in a file, more in a folder"
        )
    with named_at_the_end(output) as folder:
        target = folder / output.name
        if single:
            write(target, tables[0])
        else:
            target.mkdir()
            for series in tables:
                write(target / f"{series.topic.removeprefix('/').replace('/', '.')}{kind}", series)
    return {series.topic: len(series.stamp_ns) for series in tables}


def _write_csv(path: Path, series: JointSeries) -> None:
    """Write times in s with nine decimals, which are exact, and numbers with all digits needed to restore them.

    A signal map is written beside it, with which the table is read again.
    """
    from pyarrow.csv import WriteOptions, write_csv  # takes a while

    times = [
        f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS:09d}" for stamp in series.stamp_ns.tolist()
    ]
    table = _table(series, {"time [s]": times})
    path.with_suffix(".yaml").write_text(exported_mapping(series), encoding="utf-8")
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(table.column_names)
    with path.open("ab") as file:
        write_csv(table, file, WriteOptions(include_header=False, quoting_style="none"))


def _write_parquet(path: Path, series: JointSeries) -> None:
    from pyarrow.parquet import write_table  # takes a while

    write_table(
        _table(series, {_STAMP: series.stamp_ns, "time [s]": series.time}),
        path,
        write_page_checksum=True,
    )


def _table(series: JointSeries, columns: dict[str, Any]) -> pa.Table:
    """Return these columns and those of the joints, such as `joint_1 position [rad]`, in the order of a message."""
    import pyarrow as pa  # takes a while

    for field, values in series.fields.items():
        for joint, column in zip(series.names, values.T, strict=True):
            # Each name in one line, whatever a joint is called.
            columns[plain(f"{joint} {series.quantities[field]}")] = np.ascontiguousarray(column)
    return pa.table(columns)


def _write_npz(path: Path, series: JointSeries) -> None:
    """Write arrays of names that MATLAB takes, too, such as velocity_rad_s (n, joints); and the names of the joints."""
    arrays: dict[str, Any] = {}
    for field, values in series.fields.items():
        arrays[re.sub(r"\W+", "_", series.quantities[field]).strip("_")] = values
    with path.open("wb") as file:
        np.savez(file, names=series.names, stamp_ns=series.stamp_ns, time_s=series.time, **arrays)


FORMATS: Final[Mapping[str, Callable[[Path, JointSeries], None]]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".npz": _write_npz,
}
