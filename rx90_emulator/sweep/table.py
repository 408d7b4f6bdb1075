"""The results as an Arrow table: a row for each run, units at the columns, the plan in the file's metadata."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rx90_common.base.errors import SweepError
from rx90_emulator.loop.catalogue import SWITCH
from rx90_emulator.sweep.runs import Column
from rx90_emulator.sweep.sweep import RUN_COLUMNS, RunOutcome, Sweep

KEY = b"rx90_sweep"
"""Under which the file's metadata hold JSON: plan, runs, identity, versions, sources."""

_PANDAS = b"PANDAS_ATTRS"  # pandas puts what it finds here into DataFrame.attrs


def schema_of(sweep: Sweep) -> pa.Schema:
    """Return the columns of a sweep's results, with unit, kind and meaning in the metadata of each."""
    index, block, seed, error = RUN_COLUMNS
    fields = [
        _field(index, pa.int64(), "1", "run", "number of the run in the sweep"),
        _field(block, pa.string(), "", "run", "block of the plan"),
        _field(seed, pa.uint64(), "1", "run", "seed of the run's random draws"),
        *(_parameter_field(column) for column in sweep.runs.columns),
        *(_field(m.name, pa.int64() if m.whole else pa.float64(), m.unit, "metric", m.meaning) for m in sweep.metrics),
        _field(error, pa.string(), "", "run", "what ended the run; null if nothing did"),
    ]
    about = {
        "format": 1,
        "runs": len(sweep),
        "seed": sweep.plan.seed,
        "plan": sweep.description,
        "identity": sweep.identity,
        "versions": sweep.versions,
        "sources": sweep.sources,
    }
    units = {field.name: field.metadata[b"unit"].decode() for field in fields}
    return pa.schema(fields, {KEY: json.dumps(about), _PANDAS: json.dumps({"units": units})})


def _field(name: str, kind: pa.DataType, unit: str, role: str, meaning: str) -> pa.Field:
    return pa.field(name, kind, metadata={"unit": unit, "kind": role, "meaning": meaning})


def _parameter_field(column: Column) -> pa.Field:
    what = "factor of" if column.factor else "value of"
    meaning = f"{what} {', '.join(column.paths)}; null where the run leaves it as in the files"
    kind = pa.bool_() if column.unit == SWITCH else pa.float64()
    return _field(column.name, kind, "" if column.unit == SWITCH else column.unit, "parameter", meaning)


def table_of(sweep: Sweep, schema: pa.Schema, outcomes: Iterable[RunOutcome]) -> pa.Table:
    """Return the rows of some runs."""
    nothing = (None,) * len(sweep.metrics)
    rows = [
        (o.run.index, o.run.block, o.run.seed, *sweep.values(o.run), *(o.metrics or nothing), o.error) for o in outcomes
    ]
    columns = zip(*rows, strict=True) if rows else ((),) * len(schema)
    arrays = [pa.array(column, field.type) for column, field in zip(columns, schema, strict=True)]
    return pa.Table.from_arrays(arrays, schema=schema)


def about(schema: pa.Schema, file: Path) -> dict[str, Any]:
    """Return what a result's metadata say of it.

    Raises:
        SweepError: if it is no result of a sweep.
    """
    try:
        found: dict[str, Any] = json.loads(schema.metadata[KEY])
    except (TypeError, KeyError, ValueError) as error:
        raise SweepError(f"{file} is not a result of rx90_sweep; accepted: a file that it wrote") from error
    return found


def read_table(file: Path) -> pa.Table:
    """Read one Parquet file of results.

    Raises:
        SweepError: if it is missing, damaged or something else.
    """
    try:
        # Arrow's own file, and nothing read ahead: after a bad page, a thread that still reads a Python file would
        # meet an interpreter that is shutting down.
        with pa.OSFile(str(file)) as stream:
            table = pq.read_table(stream, use_threads=False, pre_buffer=False, page_checksum_verification=True)
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise SweepError(f"{file}: cannot be read as Parquet ({reason})") from error
    about(table.schema, file)
    return table
