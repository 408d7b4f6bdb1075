"""Measure a sweep of 1,000 runs of the reference task on two processes, from the command to the finished file.

    python -m benchmarks.sweep

Prints the time by the clock and of the processors, and merges `sweep_1000_runs_s` into out/bench.json. The kernels are
compiled before the clock starts.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.report import ROOT, merge, print_table
from rx90_common.base.share import config_path
from rx90_common.process.children import executable
from rx90_emulator.sweep.plan import load_sweep_plan
from rx90_emulator.sweep.store import describe_results
from rx90_emulator.sweep.sweep import Sweep

PLAN = config_path("sweep/reference_1000.yaml")
WORKERS = 2


def main() -> int:
    """Run the sweep in a process of its own, print the times and merge that by the clock."""
    Sweep(load_sweep_plan(PLAN)).warm_up()
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "sweep.parquet"
        arguments = ["run", str(PLAN), "--output", str(output), "--workers", str(WORKERS)]
        began = time.perf_counter()
        subprocess.run(executable("rx90 sweep", *arguments), cwd=ROOT, check=True)
        elapsed = time.perf_counter() - began
        print(
            "\n".join(
                line for line in describe_results(output) if "runs" in line or "path_error" in line
            )
        )
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    print_table(
        ("1,000 runs of the reference task", "s"),
        [
            ("by the clock (accepted: 60 on two cores)", f"{elapsed:.1f}"),
            ("processor time", f"{usage.ru_utime + usage.ru_stime:.1f}"),
        ],
    )
    merge({"sweep_1000_runs_s": elapsed})
    return 0


if __name__ == "__main__":
    sys.exit(main())
