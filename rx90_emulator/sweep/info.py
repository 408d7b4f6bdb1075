"""What a file of results holds, in lines for a reader."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rx90_common.base.quoting import counted
from rx90_emulator.sweep.store import about, parts_folder, read_results


def describe_results(file: Path) -> list[str]:
    """Describe a sweep's results: state, plan, versions, failures, and each column with unit and range.

    Raises:
        SweepError: if there are none, or they cannot be read.
    """
    table = read_results(file)
    found = about(table.schema, file)
    files = {role: entry for role, entry in found["plan"]["files"].items() if entry}
    width = max(len(role) for role in files)
    return [
        f"{file}: {_state(file, table, found['runs'])}",
        f"plan {found['identity'][:16]}, seed {found['seed']}, sources {found['sources']}",
        "versions: " + ", ".join(f"{name} {version}" for name, version in found["versions"].items()),
        *(f"  {role:{width}}  {entry['sha256'][:16]}  {entry['name']}" for role, entry in files.items()),
        *_failures(table),
        *_columns(table),
    ]


def _state(file: Path, table: pa.Table, runs: int) -> str:
    if len(table) < runs:
        return f"{len(table)} of {runs} runs; go on with --resume"
    return f"all {runs} runs" + (", not yet gathered" if parts_folder(file).exists() else "")


def _failures(table: pa.Table) -> list[str]:
    texts = [text for text in table["error"].to_pylist() if text is not None]
    if not texts:
        return ["no run failed"]
    kinds = Counter(text.split(":")[0] for text in texts)
    by_kind = ", ".join(f"{kind} {count}" for kind, count in kinds.most_common())
    return [f"{counted(len(texts), 'run')} failed ({by_kind}), for example: {texts[0]}"]


def _columns(table: pa.Table) -> list[str]:
    """Return a line for each parameter and metric: its unit, lowest, median and highest value."""
    shown = [field for field in table.schema if field.metadata[b"kind"] in (b"parameter", b"metric")]
    width = max(len(field.name) for field in shown)
    lines = [f"{'column':{width}}  {'unit':8}  {'min':>11}  {'median':>11}  {'max':>11}"]
    for field in shown:
        values = pc.drop_null(pc.cast(table[field.name], pa.float64())).to_numpy()
        ends = (values.min(), np.median(values), values.max()) if len(values) else ()
        text = "  ".join(f"{value:11.5g}" for value in ends)
        lines.append(f"{field.name:{width}}  {field.metadata[b'unit'].decode():8}  {text}")
    return lines
