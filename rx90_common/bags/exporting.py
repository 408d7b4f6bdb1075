"""Write the joint states and temperatures of a bag as tables for other programs.

CSV and Parquet hold one topic each, NPZ any number of them.
"""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import picked_with_messages, read_joint_bag
from rx90_common.bags.storage import BagReader
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import BagError, write_error
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.process.files import hidden_beside

TIME: Final = "time [s]"
STAMP: Final = "stamp [ns]"

_ROWS_AT_ONCE = 8192  # of a CSV file
_OTHERS = (".mat", ".xls", ".xlsx", ".txt", ".tsv", ".json", ".gz", ".zip", ".h5", ".feather")  # no folder's name
_ONE_TOPIC = (".csv", ".parquet")
_LONGEST_NAME = 63  # of a variable in MATLAB


@dataclass(frozen=True)
class ExportedBag:
    """What an export has done.

    Attributes:
        files: that were written.
        topics: names and numbers of messages.
        left_out: topics that hold no joint states or temperatures, or no messages.
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
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> ExportedBag:
    """Write JointState and Temperature topics of a bag as tables. An interrupted export leaves no files.

    Args:
        path: a bag.
        output: file, whose suffix says the format, or a folder, which gets a file for each topic; new.
        topics: topic names; by default all that hold messages.
        kind: suffix of the files in a folder.
        progress: called with the numbers of messages that are read or written, and of both.

    Raises:
        BagError: if the bag cannot be read, has no such topic, or a topic that no table can hold.
        Rx90Error: if the files cannot be written.
    """
    single = output.suffix.lower() in FORMATS
    if single:
        kind = output.suffix.lower()
    elif output.suffix.lower() in _OTHERS:
        raise BagError(f"{plain(output)}: the suffix says the format; accepted: {listed(FORMATS)}, or none")
    with BagReader(path) as bag:
        chosen = picked_with_messages(bag, topics)
        left_out = tuple(topic.name for topic in bag.topics if topics is None and topic not in chosen)
    counts = {topic.name: topic.count for topic in chosen}
    if single and kind in _ONE_TOPIC and len(chosen) > 1:
        what = f"{plain(output)} would hold {len(chosen)} topics, {listed(counts)}"
        raise BagError(f"{what}; accepted: one, with --topic, or the name of a folder")
    total = done = sum(counts.values())

    def written(count: int) -> None:
        nonlocal done
        done += count
        progress(done, 2 * total)

    with named_when_done(output, single=single) as folder:
        found = read_joint_bag(path, counts, lambda count, _: progress(count, 2 * total)).series
        tables = [_table_of(path, found[name]) for name in counts]
        if single:
            FORMATS[kind](folder / output.name, tables, written)
        else:
            for series in tables:
                FORMATS[kind](folder / f"{series.topic.removeprefix('/').replace('/', '.')}{kind}", [series], written)
        names = sorted(file.name for file in folder.iterdir())
    place = output.parent if single else output
    return ExportedBag(tuple(place / name for name in names), tuple(counts.items()), left_out)


def _table_of(path: Path, found: Sequence[JointSeries]) -> JointSeries:
    if len(found) > 1:
        sets = "; ".join(", ".join(map(plain, one.names)) for one in found)
        raise BagError(
            f"{plain(path)}: {plain(found[0].topic)} carries several sets of joints: {sets}; accepted for a table: the "
            "same in all messages; leave the topic out with --topic"
        )
    return found[0]


@contextmanager
def named_when_done(output: Path, *, single: bool) -> Iterator[Path]:
    """Yield a new folder beside the output; at the end it gets the output's name, or its files go where that stands."""
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with hidden_beside(output) as hidden:
            folder = hidden / "files"
            folder.mkdir()
            yield folder
            if not single:
                folder.rename(output)
            else:
                for file in folder.iterdir():
                    _give_free_name(file, output.parent / file.name)
    except OSError as error:
        if os.path.lexists(output):  # somebody else was faster
            raise BagError(f"{plain(output)} exists already, not overwriting.") from error
        raise write_error(output, error) from error


def _give_free_name(file: Path, name: Path) -> None:
    """Give a file a name that nothing has; a rename would replace what another process has written meanwhile."""
    try:
        os.link(file, name)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        if name.exists():
            raise
        file.rename(name)


def columns(series: JointSeries) -> list[tuple[str, str, str]]:
    """Return joint, field and name of each column, such as `joint_1 position [rad]`, in the order of a message."""
    return [(joint, field, f"{joint} {series.quantities[field]}") for field in series.fields for joint in series.names]


def array_name(topic: str, quantity: str) -> str:
    """Return the name of an array: letters, digits and _, such as `joint_states_velocity_rad_s`.

    Args:
        topic: with or without the leading slash.
        quantity: with its unit, such as `velocity [rad/s]`, or any other word.
    """
    words = f"{topic.removeprefix('/')} {quantity}".replace("^", "")
    name = re.sub(r"[^A-Za-z0-9]+", "_", words).strip("_")
    return name if name[:1].isalpha() else f"topic_{name}"


def mapping_text(series: JointSeries) -> str:
    """Return the mapping file by which the CSV file of a series becomes a bag again."""
    content: dict[str, Any] = {"names": list(series.names)}
    count = len(series.names)
    for k, field in enumerate(series.fields):
        first = 2 + k * count
        content[field] = {"columns": list(range(first, first + count)), "unit": series.units[field]}
    document = {
        "exact": True,
        "delimiter": ",",
        "decimal": ".",
        "header": 1,
        "time": {"column": 1, "unit": "s"},
        "topics": {series.topic: content},
    }
    return yaml_text(document)


def _write_csv(path: Path, tables: Sequence[JointSeries], written: Callable[[int], None]) -> None:
    """Write times in s with nine decimals, which are exact, and numbers with all digits that keep them.

    Beside it goes a mapping file, by which `rx90_bag import` makes the bag again.
    """
    (series,) = tables
    path.with_suffix(".yaml").write_text(mapping_text(series), encoding="utf-8")
    with path.open("w", encoding="utf-8", newline="") as file:
        names = [plain(name) for _, _, name in columns(series)]  # in one line, whatever a joint is called
        csv.writer(file, lineterminator="\n").writerow([TIME, *names])
        for begin in range(0, len(series.stamp_ns), _ROWS_AT_ONCE):
            block = series.take(slice(begin, begin + _ROWS_AT_ONCE))
            values = np.concatenate(list(block.fields.values()), axis=1)
            words = repr if np.isfinite(values).all() else _word
            file.writelines(
                f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS:09d},{','.join(map(words, row))}\n"
                for stamp, row in zip(block.stamp_ns.tolist(), values.tolist(), strict=True)
            )
            written(block.messages)


def _word(value: float) -> str:
    return "-nan" if math.isnan(value) and math.copysign(1.0, value) < 0.0 else repr(value)


def _write_parquet(path: Path, tables: Sequence[JointSeries], written: Callable[[int], None]) -> None:
    """Write columns as in CSV, with the stamps in ns besides; unit, joint and field of each column in its metadata."""
    import pyarrow as pa  # both take a while
    import pyarrow.parquet as pq

    (series,) = tables
    fields = [pa.field(STAMP, pa.int64(), False, {"unit": "ns"}), pa.field(TIME, pa.float64(), False, {"unit": "s"})]
    arrays = [series.stamp_ns, series.time]
    for joint, field, name in columns(series):
        about = {"unit": series.units[field], "joint": joint, "field": field}
        fields.append(pa.field(name, pa.float64(), False, about))
        arrays.append(np.ascontiguousarray(series.fields[field][:, series.names.index(joint)]))
    schema = pa.schema(fields, {"topic": series.topic})
    table = pa.Table.from_arrays([pa.array(one) for one in arrays], schema=schema)
    pq.write_table(table, path, write_page_checksum=True)
    written(series.messages)


def _write_npz(path: Path, tables: Sequence[JointSeries], written: Callable[[int], None]) -> None:
    """Write arrays named by topic, quantity and unit, (n,) or (n, joints), and the names of the joints."""
    arrays: dict[str, NDArray[Any]] = {}
    for series in tables:
        held: dict[str, NDArray[Any]] = {STAMP: series.stamp_ns, TIME: series.time}
        held |= {series.quantities[field]: values for field, values in series.fields.items()}
        for quantity, values in (held | {"names": np.array(series.names)}).items():
            name = array_name(series.topic, quantity)
            if len(name) > _LONGEST_NAME:
                raise BagError(
                    f"array {name} has {len(name)} characters; accepted: up to {_LONGEST_NAME}, by a shorter topic"
                )
            if name in arrays:
                raise BagError(f"two topics would be arrays {name}; accepted: one of them, with --topic")
            arrays[name] = values
    with path.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub takes them for its own options
    written(sum(series.messages for series in tables))


TableWriter = Callable[[Path, Sequence[JointSeries], Callable[[int], None]], None]
FORMATS: Final[Mapping[str, TableWriter]] = {".csv": _write_csv, ".parquet": _write_parquet, ".npz": _write_npz}
