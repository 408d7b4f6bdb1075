"""How long the identification of seven elements takes from bags, on this machine: at most 40 s on two cores."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.report import merge
from rx90_common.process.children import executable

LIMIT = 40.0


def main() -> int:
    """Write a series on the engine, identify it twice (the first time may compile), print and merge the time."""
    with tempfile.TemporaryDirectory() as folder:
        series = Path(folder) / "series"
        _run("rx90_experiment", "run", "--engine", "--output", str(series))
        elapsed = 0.0
        for _ in range(2):
            began = time.perf_counter()
            output = str(Path(folder) / "friction.yaml")
            _run("rx90_identify", str(series), "--output", output, "--force")
            elapsed = time.perf_counter() - began
    print(f"identification of seven elements from bags: {elapsed:.1f} s (asked for: at most {LIMIT:g} s)")
    merge({"identification_bags_s": elapsed})
    return 0 if elapsed <= LIMIT else 1


def _run(name: str, *arguments: str) -> None:
    subprocess.run(executable(name, *arguments), check=True)


if __name__ == "__main__":
    sys.exit(main())
