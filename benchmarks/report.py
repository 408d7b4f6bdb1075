"""What every benchmark prints and where its figures go."""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BENCH_FILE = ROOT / "out" / "bench.json"


def print_table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows under headers; the first column is text, the others are aligned to the right."""
    table = [headers, *rows]
    widths = [max(len(row[k]) for row in table) for k in range(len(headers))]
    for row in table:
        cells = [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        print("  ".join(cells).rstrip())


def spread(key: str, values: Sequence[float]) -> dict[str, float]:
    """Return the median of several runs, the lowest and the highest of them, as figures."""
    return {key: statistics.median(values), f"{key}_lowest": min(values), f"{key}_highest": max(values)}


def merge(figures: Mapping[str, float], file: Path = BENCH_FILE) -> None:
    """Add figures to those that other benchmarks left, rounded to four digits."""
    known = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    known.update({key: float(f"{value:.4g}") for key, value in figures.items()})
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(known, indent=2, sort_keys=True) + "\n", encoding="utf-8")
