"""Measure a sweep of 1,000 runs of the reference task on two processes, from the command to the finished file.

    python -m benchmarks.sweep

Prints the time, what a run costs beside the closed loop itself, and merges `sweep_1000_runs_s` into
out/bench.json. The kernels are compiled before the clock starts.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.report import ROOT, merge, print_table
from rx90_common.base.share import config_path
from rx90_common.process.children import executable
from rx90_emulator.loop.line import run_line
from rx90_emulator.sweep.plan import load_sweep_plan
from rx90_emulator.sweep.store import describe_results
from rx90_emulator.sweep.sweep import Sweep

PLAN = config_path("sweep/reference_1000.yaml")
SAMPLES = 30
WORKERS = 2


class SweepFigures(NamedTuple):
    """Times in s: of the whole command by the clock and of all its cores, medians of single runs in one process."""

    command: float
    cores: float
    run: float
    closed_loop: float


def measure() -> SweepFigures:
    """Run the sweep once in a process of its own, and single runs in this one."""
    sweep = Sweep(load_sweep_plan(PLAN))
    sweep.warm_up()
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "sweep.parquet"
        arguments = ["run", str(PLAN), "--output", str(output), "--workers", str(WORKERS)]
        before = _children_time()
        began = time.perf_counter()
        subprocess.run(executable("rx90_sweep", *arguments), cwd=ROOT, check=True)
        elapsed, cores = time.perf_counter() - began, _children_time() - before
        print("\n".join(line for line in describe_results(output) if "runs" in line or "path_error" in line))
    single, loop = [], []
    for index in range(SAMPLES):
        began = time.perf_counter()
        sweep.run(index)
        between = time.perf_counter()
        run_line(sweep.setup, sweep.task)
        single.append(between - began)
        loop.append(time.perf_counter() - between)
    return SweepFigures(elapsed, cores, float(np.median(single)), float(np.median(loop)))


def _children_time() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main() -> int:
    """Print the figures and merge them."""
    figures = measure()
    print_table(
        ("sweep of the reference task", "s"),
        [
            ("1,000 runs, by the clock (accepted: 60 on two cores)", f"{figures.command:.1f}"),
            ("1,000 runs, processor time", f"{figures.cores:.1f}"),
            ("one run of the sweep", f"{figures.run:.4f}"),
            ("one run of the task, line planned anew", f"{figures.closed_loop:.4f}"),
        ],
    )
    merge({"sweep_1000_runs_s": figures.command})
    return 0


if __name__ == "__main__":
    sys.exit(main())
