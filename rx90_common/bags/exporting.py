"""Write the joint states of a bag as tables for other programs.

CSV and Parquet hold one topic each, NPZ any number of them.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping, exported_mapping
from rx90_common.bags.reading import BagReader, Progress, silent
from rx90_common.bags.writing import named_at_the_end
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS

_TIME = "time [s]"
_STAMP = "stamp [ns]"
_ROWS_AT_ONCE = 8192  # of a CSV file
_UNSUPPORTED = (".mat", ".xls", ".xlsx", ".txt", ".tsv", ".json", ".gz", ".zip", ".h5", ".feather")  # no folder's name
_ONE_TOPIC = (".csv", ".parquet")


def export_bag(
    path: Path,
    output: Path,
    *,
    topics: Sequence[str] | None = None,
    kind: str = ".csv",
    progress: Progress = silent,
    mapping: LogMapping | None = None,
) -> dict[str, int]:
    """Write JointState topics of a bag as tables; return their numbers of messages. An interrupt leaves no files.

    Args:
        path: a bag.
        output: file, whose suffix is the format, or a folder, which gets a file for each topic; new.
        topics: topic names; by default all topics with messages.
        kind: suffix of the files in a folder.
        progress: called with the number of messages read so far, and the total.
        mapping: of the columns of a table; by default the file beside it.

    Raises:
        BagWriteError: if the disk is full.
    """
    single = output.suffix.lower() in FORMATS
    if single:
        kind = output.suffix.lower()
    elif output.suffix.lower() in _UNSUPPORTED:
        raise BagError(f"{plain(output)}: the suffix says the format; accepted: {listed(FORMATS)}, or none")
    write = FORMATS[kind]
    with BagReader(path, mapping) as bag:
        chosen = bag.series_topics(topics)
        counts = {topic.name: topic.count for topic in chosen}
        if single and kind in _ONE_TOPIC and len(chosen) > 1:
            what = f"{plain(output)} would hold {len(chosen)} topics, {listed(counts)}"
            raise BagError(f"{what}; accepted: one, with --topic, or the name of a folder")
        with named_at_the_end(output) as folder:
            read = bag.joint_states(chosen, progress)
            remedy = "accepted for a table: the same in all messages; leave the topic out with --topic"
            tables = [read.one(topic, remedy=remedy) for topic in counts]
            if single:
                write(folder / output.name, tables)
            else:
                (folder / output.name).mkdir()
                for series in tables:
                    name = f"{series.topic.removeprefix('/').replace('/', '.')}{kind}"
                    write(folder / output.name / name, [series])
    return counts


def _columns(series: JointSeries) -> list[tuple[str, str, str]]:
    """Return joint, field and name of each column, such as `joint_1 position [rad]`, in the order of a message."""
    return [(joint, field, f"{joint} {series.quantities[field]}") for field in series.fields for joint in series.names]


def _write_csv(path: Path, tables: Sequence[JointSeries]) -> None:
    """Write times in s with nine decimals, which are exact, and numbers with all digits needed to restore them.

    A signal map is written beside it, with which `rx90 bag import` makes the bag again.
    """
    (series,) = tables
    path.with_suffix(".yaml").write_text(exported_mapping(series), encoding="utf-8")

    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        # Each name in one line, whatever a joint is called.
        table.writerow([_TIME, *(plain(name) for _, _, name in _columns(series))])
        for begin in range(0, len(series.stamp_ns), _ROWS_AT_ONCE):
            block = series.take(slice(begin, begin + _ROWS_AT_ONCE))
            values = np.concatenate(list(block.fields.values()), axis=1)
            for stamp, row in zip(block.stamp_ns.tolist(), values.tolist(), strict=True):
                table.writerow([f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS:09d}", *row])


def _write_parquet(path: Path, tables: Sequence[JointSeries]) -> None:
    """Write columns as in CSV, with the stamps in ns besides; unit, joint and field of each column in its metadata."""
    import pyarrow as pa  # both take a while
    import pyarrow.parquet as pq

    (series,) = tables
    fields = [pa.field(_STAMP, pa.int64(), False, {"unit": "ns"}), pa.field(_TIME, pa.float64(), False, {"unit": "s"})]
    arrays = [pa.array(series.stamp_ns), pa.array(series.time)]
    for joint, field, name in _columns(series):
        about = {"unit": series.units[field], "joint": joint, "field": field}
        fields.append(pa.field(name, pa.float64(), False, about))
        arrays.append(pa.array(np.ascontiguousarray(series.fields[field][:, series.names.index(joint)])))
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, {"topic": series.topic}))
    pq.write_table(table, path, write_page_checksum=True)


def _write_npz(path: Path, tables: Sequence[JointSeries]) -> None:
    """Write arrays named by topic, quantity and unit, (n,) or (n, joints), and the names of the joints."""
    arrays: dict[str, NDArray[Any]] = {}
    for series in tables:
        quantities: dict[str, NDArray[Any]] = {_STAMP: series.stamp_ns, _TIME: series.time}
        quantities |= {series.quantities[field]: values for field, values in series.fields.items()}
        for quantity, values in (quantities | {"names": np.array(series.names)}).items():
            # Letters, digits and _ alone, such as joint_states_velocity_rad_s.
            words = f"{series.topic.removeprefix('/')} {quantity}".replace("^", "")
            name = re.sub(r"[^A-Za-z0-9]+", "_", words).strip("_")
            name = name if name[:1].isalpha() else f"topic_{name}"
            if name in arrays:
                raise BagError(f"two topics would be arrays {name}; accepted: one of them, with --topic")
            arrays[name] = values
    with path.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub takes them for its own options


FORMATS: Final[Mapping[str, Callable[[Path, Sequence[JointSeries]], None]]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".npz": _write_npz,
}
