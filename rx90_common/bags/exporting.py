"""Write the joint states and temperatures of a bag as tables, block by block, so that a long bag needs no more memory.

CSV and Parquet hold one topic each, NPZ any number of them.
"""

from __future__ import annotations

import csv
import io
import math
import os
import re
import shutil
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import picked_with_messages, series_builder
from rx90_common.bags.storage import BagReader, BagTopic
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import BagError, write_error
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.process.files import hidden_beside

TIME: Final = "time [s]"
STAMP: Final = "stamp [ns]"

_BLOCK = 8192  # messages of a topic
_OTHERS = (".mat", ".xls", ".xlsx", ".txt", ".tsv", ".json", ".gz", ".zip", ".h5", ".feather")  # no folder's name
_ONE_TOPIC = (".csv", ".parquet")
_LONGEST_NAME = 63  # of a variable in MATLAB
_CHUNK = 1 << 20  # bytes


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
    """Write JointState and Temperature topics of a bag as tables. Who interrupts it leaves nothing behind.

    Args:
        path: a bag.
        output: file, whose suffix says the format, or a folder, which gets a file for each topic; new.
        topics: topic names; by default all that hold messages.
        kind: suffix of the files in a folder.
        progress: called with the numbers of messages that are written and that there are.

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
        if not single:
            plan = {f"{_file_name(name)}{kind}": [name] for name in counts}
        elif kind in _ONE_TOPIC and len(chosen) > 1:
            what = f"{plain(output)} would hold {len(chosen)} topics, {listed(counts)}"
            raise BagError(f"{what}; accepted: one, with --topic, or the name of a folder")
        else:
            plan = {output.name: list(counts)}
        with named_when_done(output, single=single) as folder:
            _write(bag, chosen, {folder / name: held for name, held in plan.items()}, progress)
            names = sorted(file.name for file in folder.iterdir())
    place = output.parent if single else output
    return ExportedBag(tuple(place / name for name in names), tuple(counts.items()), left_out)


def _file_name(topic: str) -> str:
    return topic.removeprefix("/").replace("/", ".")


def _write(
    bag: BagReader, topics: Sequence[BagTopic], plan: Mapping[Path, Sequence[str]], progress: Callable[[int, int], None]
) -> None:
    total, done = sum(topic.count for topic in topics), 0
    with ExitStack() as open_files:
        files: dict[str, TableFile] = {}
        for path, held in plan.items():
            file = FORMATS[path.suffix.lower()](path)
            open_files.callback(file.close)
            files |= dict.fromkeys(held, file)
        for series in read_blocks(bag, topics):
            files[series.topic].add(series)
            done += series.messages
            progress(done, total)


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


def read_blocks(bag: BagReader, topics: Sequence[BagTopic]) -> Iterator[JointSeries]:
    """Yield the messages of JointState and Temperature topics in the order of the bag, block by block.

    All blocks of a topic have the same joints in the same order, and the same arrays.

    Raises:
        BagError: if the bag is damaged, or a topic carries several sets of joints or arrays.
    """
    names = temperature_names(bag, topics)
    collected = {topic: _Collector(bag, topic, names.get(topic, ())) for topic in topics}
    for topic, _, data in bag.messages(topics):
        collector = collected[topic]
        if collector.is_full_before(data):
            yield collector.take()
        collector.add(data)
    for collector in collected.values():
        if collector.count:
            yield collector.take()


def temperature_names(bag: BagReader, topics: Sequence[BagTopic]) -> dict[BagTopic, tuple[str, ...]]:
    """Return of what each Temperature topic tells, in the order of the first messages.

    A message holds one name, so the whole topic says which columns its table has.

    Raises:
        BagError: if the bag is damaged.
    """
    warm = [topic for topic in topics if not topic.is_joint_state]
    found: dict[BagTopic, dict[str, None]] = {topic: {} for topic in warm}
    for topic, _, data in bag.messages(warm) if warm else ():
        found[topic].setdefault(str(bag.deserialize(topic, data).header.frame_id))
    return {topic: tuple(names) for topic, names in found.items()}


class _Collector:
    """The messages of a topic that are still to be handed on."""

    def __init__(self, bag: BagReader, topic: BagTopic, names: Sequence[str]) -> None:
        self.count = 0
        self._bag, self._topic = bag, topic
        self._first: JointSeries | None = None
        self._builder = series_builder(bag, topic, names)

    def is_full_before(self, data: bytes) -> bool:
        """Return whether the block is full, and this message belongs to no row of it."""
        return self.count >= _BLOCK and self._builder.begins_row(data)

    def add(self, data: bytes) -> None:
        """Add a message."""
        self._builder.add(data)
        self.count += 1

    def take(self) -> JointSeries:
        """Return the block and begin another."""
        found = self._builder.build()
        first = self._first = self._first or found[0]
        self.count, self._builder = 0, series_builder(self._bag, self._topic, first.names)
        for other in found:
            if set(other.names) != set(first.names):
                sets = "; ".join(", ".join(map(plain, one.names)) for one in (first, other))
                raise self._refusal(f"carries several sets of joints: {sets}")
            if set(other.fields) != set(first.fields):
                sets = " and ".join(", ".join(one.fields) or "nothing" for one in (first, other))
                raise self._refusal(f"carries {sets} in different messages")
        return found[0] if found[0].names == first.names else found[0].select(first.names)

    def _refusal(self, what: str) -> BagError:
        one = "accepted for a table: the same in all messages; leave the topic out with --topic"
        return BagError(f"{plain(self._bag.path)}: {plain(self._topic.name)} {what}; {one}")


def columns(series: JointSeries) -> list[tuple[str, str, str]]:
    """Return joint, field and name of each column, such as `joint_1 position [rad]`, in the order of a message."""
    told = series.quantities
    return [(joint, field, f"{joint} {told[field]}") for field in series.fields for joint in series.names]


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
