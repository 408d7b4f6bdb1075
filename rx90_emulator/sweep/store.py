"""Where results are kept while a sweep runs, so that an end at any moment leaves what is done readable.

Finished runs go to small Parquet files in a folder `FILE.parts`, each renamed into its place when complete.
The end of a sweep, also by Ctrl-C, gathers them into the one file. A killed sweep leaves the folder, which
pandas and pyarrow read as it is (`pandas.read_parquet("FILE.parts")`) and which a resumed sweep takes up.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rx90_common.base.arrays import Mask
from rx90_common.base.errors import SweepError, write_error
from rx90_common.base.quoting import aligned, counted
from rx90_emulator.loop.parameters import SWITCH
from rx90_emulator.sweep.sweep import RUN_COLUMNS, RunOutcome, Sweep

# A part is written after this long, s, or after this share of the time so far: never more is lost, and the
# number of parts grows with the logarithm of the time.
_FLUSH_AFTER = 1.0
_FLUSH_SHARE = 0.01


KEY = b"rx90_sweep"
"""Under which the file's metadata hold JSON: plan, runs, identity, versions, sources."""

_NAMES = {"identity": "plan and files", "sources": "sources", "versions": "versions"}
_PANDAS = b"PANDAS_ATTRS"  # pandas puts what it finds here into DataFrame.attrs


def schema_of(sweep: Sweep) -> pa.Schema:
    """Return the columns of a sweep's results, with unit, kind and meaning in the metadata of each."""
    index, block, seed, error = RUN_COLUMNS
    rows = [
        (index, pa.int64(), "1", "run", "number of the run in the sweep"),
        (block, pa.string(), "", "run", "block of the plan"),
        (seed, pa.uint64(), "1", "run", "seed of the run's random draws"),
    ]
    for column in sweep.runs.columns:
        meaning = f"{'factor' if column.factor else 'value'} of {', '.join(column.paths)}; null where the run leaves it"
        kind, unit = (pa.bool_(), "") if column.unit == SWITCH else (pa.float64(), column.unit)
        rows.append((column.title, kind, unit, "parameter", f"{meaning} as in the files"))
    rows += [
        (m.name, pa.int64() if m.whole else pa.float64(), m.unit, "metric", m.meaning)
        for m in sweep.metrics
    ]
    rows.append((error, pa.string(), "", "run", "what ended the run; null if nothing did"))
    about = {
        "format": 1, "runs": len(sweep), "seed": sweep.plan.seed, "plan": sweep.description,
        **{name: getattr(sweep, name) for name in ("identity", "versions", "sources", "provenance")},
    }  # fmt: skip
    attributes = {
        "units": {row[0]: row[2] for row in rows},
        "meanings": {row[0]: row[4] for row in rows},
    }
    fields = [
        pa.field(name, kind, metadata={"unit": unit, "kind": role, "meaning": meaning})
        for name, kind, unit, role, meaning in rows
    ]
    return pa.schema(fields, {KEY: json.dumps(about), _PANDAS: json.dumps(attributes)})


def table_of(sweep: Sweep, schema: pa.Schema, outcomes: Iterable[RunOutcome]) -> pa.Table:
    """Return the rows of some runs."""
    titles = {column.name: column.title for column in sweep.runs.columns}
    metrics = [metric.name for metric in sweep.metrics]
    rows = [
        {
            **dict(zip(RUN_COLUMNS, (run.index, run.block, run.seed, error), strict=True)),
            **{titles[name]: value for name, value in run.values},
            **dict(zip(metrics, measured or (), strict=False)),
        }
        for run, measured, error in outcomes
    ]
    return pa.Table.from_pylist(rows, schema=schema)


def about(schema: pa.Schema, file: Path) -> dict[str, Any]:
    """Return what a result's metadata say of it."""
    try:
        found: dict[str, Any] = json.loads(schema.metadata[KEY])
        written = list(json.loads(schema.metadata[_PANDAS])["units"])
    except (TypeError, KeyError, ValueError) as error:
        raise SweepError(
            f"{file} is not a result of rx90 sweep; accepted: a file that it wrote"
        ) from error
    if schema.names != written:
        raise SweepError(
            f"{file} has other columns than rx90 sweep wrote; accepted: the file as it was"
        )
    return found


def parts_folder(file: Path) -> Path:
    """Return the folder in which an unfinished sweep keeps its results."""
    return file.with_name(file.name + ".parts")


def read_sweep(file: Path | str) -> pa.Table:
    """Return the results of a sweep, finished or not, as a pyarrow.Table sorted by the run's index.

    Raises:
        SweepError: if there are none, or they cannot be read.
    """
    file = Path(file)
    sources = _sources(file)
    if not sources:
        raise SweepError(f"{file} does not exist; accepted: a result of rx90 sweep run")
    tables = []
    for source in sources:
        try:
            # Arrow's own file, and nothing read ahead: after a bad page, a thread that still reads a Python file would
            # meet an interpreter that is shutting down.
            with pa.OSFile(str(source)) as stream:
                tables.append(
                    pq.read_table(
                        stream, use_threads=False, pre_buffer=False, page_checksum_verification=True
                    )
                )
        except (OSError, pa.ArrowException) as error:
            accepted = "a result of rx90 sweep run"
            if source != file:
                accepted = "remove this part, resume (--resume) computes its runs again"
            reason = " ".join(str(error).split())
            raise SweepError(
                f"{source}: cannot be read as Parquet ({reason}); accepted: {accepted}"
            ) from error
        about(tables[-1].schema, source)
    table = pa.concat_tables(tables)
    # A kill between gathering the parts and removing them leaves runs twice.
    _, first = np.unique(table["index"].to_numpy(), return_index=True)
    return table.take(pa.array(first)).combine_chunks()


def _sources(file: Path) -> list[Path]:
    if not file.name:
        raise SweepError(f"{file} is a folder; accepted: a file that rx90 sweep run wrote")
    parts = sorted(parts_folder(file).glob("part-*.parquet"))
    return [file, *parts] if file.is_file() else parts


class ResultStore:
    """The results of a sweep that is running.

    Attributes:
        file: the Parquet file that the end of the sweep writes.
        done: for each run whether its result is there, shape (runs,).
    """

    def __init__(self, file: Path, sweep: Sweep, *, resume: bool = False) -> None:
        """Take up a result, or begin one."""
        if not file.name or file.is_dir():
            raise SweepError(f"{file} is a folder; accepted: a file")
        self.file = file
        self.done: Mask = np.zeros(len(sweep), dtype=np.bool_)
        self._sweep = sweep
        self._schema = schema_of(sweep)
        self._parts = parts_folder(file)
        if _sources(file):
            if not resume:
                found = file if file.exists() else self._parts
                accepted = "another output, or resume (--resume) to compute what it lacks"
                raise SweepError(f"{found} exists; accepted: {accepted}")
            self._take_up()
        self._lock = self._open_folder()
        self._waiting: list[RunOutcome] = []
        numbers = [
            int(part.stem.removeprefix("part-")) for part in self._parts.glob("part-*.parquet")
        ]
        self._number = max(numbers, default=-1) + 1
        self._began = self._flushed = time.monotonic()

    def _take_up(self) -> None:
        table = read_sweep(self.file)
        written = about(table.schema, self.file)
        for key, name in _NAMES.items():
            own = getattr(self._sweep, key)
            if written[key] != own:
                what = f"{self.file} has other {name}: {written[key]}, not {own}"
                raise SweepError(f"{what}; accepted: the same, or another output")
        self.done[table["index"].to_numpy()] = True

    def _open_folder(self) -> int:
        path = self._parts / ".lock"
        try:
            self._parts.mkdir(exist_ok=True)
            lock = os.open(path, os.O_CREAT | os.O_RDWR)
        except OSError as error:
            raise write_error(self._parts, error) from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # A sweep that ended between the two calls has taken the folder away, and this lock with it.
            if not os.path.samestat(path.stat(), os.fstat(lock)):
                raise FileNotFoundError(path)
        except (BlockingIOError, FileNotFoundError) as error:
            os.close(lock)
            raise SweepError(
                f"another sweep is writing to {self.file}; accepted: one at a time"
            ) from error
        return lock

    def __enter__(self) -> ResultStore:
        return self

    def __exit__(self, *_: object) -> None:
        """Gather what is done into the file, whatever ended the sweep."""
        try:
            self.flush()
            self._gather()
        finally:
            os.close(self._lock)

    def add(self, outcomes: Iterable[RunOutcome]) -> None:
        """Keep the outcomes of some runs; they are on disk after a second or so."""
        for outcome in outcomes:
            self._waiting.append(outcome)
            self.done[outcome.run.index] = True
        now = time.monotonic()
        if now - self._flushed >= max(_FLUSH_AFTER, _FLUSH_SHARE * (now - self._began)):
            self.flush()
            self._flushed = now

    def flush(self) -> None:
        """Write what was added since the last time."""
        if self._waiting:
            table = table_of(self._sweep, self._schema, self._waiting)
            self._write(table, self._parts / f"part-{self._number:06d}.parquet")
            self._number += 1
            self._waiting = []

    def _gather(self) -> None:
        if any(self._parts.glob("part-*.parquet")):
            self._write(
                read_sweep(self.file).replace_schema_metadata(self._schema.metadata), self.file
            )
        try:
            shutil.rmtree(self._parts)
        except OSError as error:
            raise SweepError(
                f"{self._parts} cannot be removed ({error.strerror}); its runs are in {self.file}"
            ) from error

    def _write(self, table: pa.Table, target: Path) -> None:
        # Readers of the folder overlook names that begin with a dot.
        temporary = self._parts / f".{target.name}"
        try:
            pq.write_table(table, temporary, compression="zstd", write_page_checksum=True)
            with temporary.open("rb") as stream:
                os.fsync(stream.fileno())
            temporary.replace(target)
        except OSError as error:
            raise write_error(target, error) from error


def describe_results(file: Path) -> list[str]:
    """Describe a sweep's results: state, plan, versions, failures, and each column with unit and range."""
    table = read_sweep(file)
    origin = about(table.schema, file)
    state = f"complete, {counted(origin['runs'], 'run')}"
    if len(table) < origin["runs"]:
        state = f"{len(table)} of {counted(origin['runs'], 'run')}; go on with --resume"
    errors = pc.drop_null(table["error"]).to_pylist()
    failure = "no run failed"
    if errors:
        kinds = Counter(error.partition(":")[0] for error in errors).most_common()
        shares = ", ".join(f"{kind} {count}" for kind, count in kinds)
        failure = f"{counted(len(errors), 'run')} failed ({shares}), for example: {errors[0]}"
    files = [(role, file) for role, file in origin["plan"]["files"].items() if file]
    return [
        f"{file}: {state}",
        f"plan {origin['identity'][:16]}, seed {origin['seed']}, sources {origin['sources']}",
        "versions: "
        + ", ".join(f"{name} {version}" for name, version in origin["versions"].items()),
        *(f"  {role:10}  {entry['sha256'][:16]}  {entry['name']}" for role, entry in files),
        failure,
        *_columns(table),
    ]


def _columns(table: pa.Table) -> list[str]:
    """Return a line for each parameter and metric: its unit, lowest, median and highest value."""
    shown = [
        field for field in table.schema if field.metadata[b"kind"] in (b"parameter", b"metric")
    ]
    rows = [["column", "unit", "min", "median", "max"]]
    for field in shown:
        values = pc.drop_null(pc.cast(table[field.name], pa.float64())).to_numpy()
        ends = np.quantile(values, [0.0, 0.5, 1.0]) if len(values) else [np.nan] * 3
        unit = field.metadata[b"unit"].decode()
        rows.append([field.name, unit, *(f"{value:.5g}" for value in ends)])
    return aligned(rows, right=range(2, 5))
