"""Write the joint states of a bag as tables for other programs.

CSV and Parquet hold one topic each, NPZ any number of them.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
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
_LONGEST_NAME = 63  # of a variable in MATLAB


@dataclass(frozen=True)
class ExportedBag:
    """What an export has done.

    Attributes:
        files: that were written.
        topics: names and numbers of messages.
        left_out: topics that hold no joint states, or no messages.
    """

    files: tuple[Path, ...]
    topics: tuple[tuple[str, int], ...]
    left_out: tuple[str, ...]


def export_bag(
    path: Path,
    output: Path,
    *,
    topics: Sequence[str] | None = None,
    kind: str = ".csv",
    progress: Progress = silent,
    mapping: LogMapping | None = None,
) -> ExportedBag:
    """Write JointState topics of a bag as tables. An interrupted export leaves no files.

    Args:
        path: a bag.
        output: file, whose suffix is the format, or a folder, which gets a file for each topic; new.
        topics: topic names; by default all topics with messages.
        kind: suffix of the files in a folder.
        progress: called with the number of messages read and written so far, and the total.
        mapping: of the columns of a table; by default the file beside it.

    Raises:
        BagWriteError: if the disk is full.
    """
    single = output.suffix.lower() in FORMATS
    if single:
        kind = output.suffix.lower()
    elif output.suffix.lower() in _UNSUPPORTED:
        raise BagError(f"{plain(output)}: the suffix says the format; accepted: {listed(FORMATS)}, or none")
    done = 0

    def written(count: int) -> None:
        nonlocal done
        done += count
        progress(total + done, 2 * total)

    with BagReader(path, mapping) as bag:
        chosen = bag.series_topics(topics)
        counts = {topic.name: topic.count for topic in chosen}
        left_out = tuple(topic.name for topic in bag.topics if topics is None and topic not in chosen)
        if single and kind in _ONE_TOPIC and len(chosen) > 1:
            what = f"{plain(output)} would hold {len(chosen)} topics, {listed(counts)}"
            raise BagError(f"{what}; accepted: one, with --topic, or the name of a folder")
        total = sum(counts.values())
        with named_at_the_end(output) as folder:
            read = bag.joint_states(chosen, lambda count, _: progress(count, 2 * total))
            remedy = "accepted for a table: the same in all messages; leave the topic out with --topic"
            tables = [read.one(topic, remedy=remedy) for topic in counts]
            if single:
                FORMATS[kind](folder / output.name, tables, written)
                files = sorted(output.parent / file.name for file in folder.iterdir())
            else:
                (folder / output.name).mkdir()
                for series in tables:
                    name = f"{series.topic.removeprefix('/').replace('/', '.')}{kind}"
                    FORMATS[kind](folder / output.name / name, [series], written)
                files = sorted(output / file.name for file in (folder / output.name).iterdir())
    return ExportedBag(tuple(files), tuple(counts.items()), left_out)


def _columns(series: JointSeries) -> list[tuple[str, str, str]]:
    """Return joint, field and name of each column, such as `joint_1 position [rad]`, in the order of a message."""
    return [(joint, field, f"{joint} {series.quantities[field]}") for field in series.fields for joint in series.names]


def _write_csv(path: Path, tables: Sequence[JointSeries], written: Callable[[int], None]) -> None:
    """Write times in s with nine decimals, which are exact, and numbers with all digits needed to restore them.

    A signal map is written beside it, with which `rx90_bag import` makes the bag again.
    """
    (series,) = tables
    path.with_suffix(".yaml").write_text(exported_mapping(series), encoding="utf-8")

    def word(value: float) -> str:
        return "-nan" if math.isnan(value) and math.copysign(1.0, value) < 0.0 else repr(value)

    with path.open("w", encoding="utf-8", newline="") as file:
        names = [plain(name) for _, _, name in _columns(series)]  # in one line, whatever a joint is called
        csv.writer(file, lineterminator="\n").writerow([_TIME, *names])
        for begin in range(0, len(series.stamp_ns), _ROWS_AT_ONCE):
            block = series.take(slice(begin, begin + _ROWS_AT_ONCE))
            values = np.concatenate(list(block.fields.values()), axis=1)
            words = repr if np.isfinite(values).all() else word
            file.writelines(
                f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS:09d},{','.join(map(words, row))}\n"
                for stamp, row in zip(block.stamp_ns.tolist(), values.tolist(), strict=True)
            )
            written(len(block.stamp_ns))


def _write_parquet(path: Path, tables: Sequence[JointSeries], written: Callable[[int], None]) -> None:
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
    written(len(series.stamp_ns))


def _write_npz(path: Path, tables: Sequence[JointSeries], written: Callable[[int], None]) -> None:
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
            if len(name) > _LONGEST_NAME:
                raise BagError(
                    f"array {name} has {len(name)} characters; accepted: up to {_LONGEST_NAME}, by a shorter topic"
                )
            if name in arrays:
                raise BagError(f"two topics would be arrays {name}; accepted: one of them, with --topic")
            arrays[name] = values
    with path.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub takes them for its own options
    written(sum(len(series.stamp_ns) for series in tables))


FORMATS: Final[Mapping[str, Callable[[Path, Sequence[JointSeries], Callable[[int], None]], None]]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".npz": _write_npz,
}
