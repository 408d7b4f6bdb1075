"""Run the benchmarks and write out/bench.json: all of them, or those named.

    python -m benchmarks [closed_loop] [control_law] [compensation] [command_delay] [accuracy] [mujoco_lugre]
                         [friction_parts] [perturbation] [lockstep] [composition] [speed] [view] [sweep]
                         [friction_ramp] [friction_ramp_coverage] [friction_presliding] [identification]
                         [identification_presliding] [identification_time] [excitation_coverage] [excitation_time]
                         [wrong_zeros] [load_parts] [transmission] [published_friction] [bristles] [bristle_kinds]

Each runs in a process of its own, prints its table and merges its figures as soon as it has them. `python -m
benchmarks.figures` brings them into README.md and docs/.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from benchmarks.report import BENCH_FILE, ROOT

NAMES = (
    "closed_loop",
    "control_law",
    "compensation",
    "command_delay",
    "accuracy",
    "mujoco_lugre",
    "friction_parts",
    "perturbation",
    "lockstep",
    "composition",
    "speed",
    "view",
    "sweep",
    "friction_ramp",
    "friction_ramp_coverage",
    "friction_presliding",
    "identification",
    "identification_presliding",
    "identification_time",
    "excitation_coverage",
    "excitation_time",
    "wrong_zeros",
    "load_parts",
    "transmission",
    "published_friction",
    "bristles",
    "bristle_kinds",
)


def main() -> int:
    """Run what is asked for; return 1 if a benchmark failed, 130 if it was interrupted."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="name", help=f"of {', '.join(NAMES)}; all of them if none is given")
    names = parser.parse_args().names or list(NAMES)
    for name in names:
        if name not in NAMES:
            parser.error(f"the benchmark is {name!r}; accepted: {', '.join(NAMES)}")
    failed = []
    for name in names:
        print(f"\n{name}", flush=True)
        try:
            if subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], cwd=ROOT, check=False).returncode:
                failed.append(name)
        except KeyboardInterrupt:
            print(f"\ninterrupted in {name}", file=sys.stderr)
            return 130
    if BENCH_FILE.is_file():
        print(f"\nfigures in {_relative(BENCH_FILE)}")
    for name in failed:
        print(f"{name} failed", file=sys.stderr)
    return 1 if failed else 0


def _relative(file: Path) -> Path:
    return file.relative_to(Path.cwd()) if file.is_relative_to(Path.cwd()) else file


if __name__ == "__main__":
    sys.exit(main())
