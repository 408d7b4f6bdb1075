"""Run the benchmarks and write out/bench.json: all of them, or those named.

    python -m benchmarks [name ...]

Each runs in a process of its own, prints its table and merges its figures as soon as it has them. `python -m
benchmarks.figures` brings them into README.md and docs/.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
from pathlib import Path

from benchmarks.report import BENCH_FILE, ROOT
from rx90_common.base.errors import INTERRUPTED

COMMANDS = {
    "closed_loop": "closed_loop",
    "any_arm": "any_arm",
    "control_law": "control_law",
    "compensation": "compensation",
    "command_delay": "command_delay",
    "accuracy": "accuracy",
    "mujoco_lugre": "mujoco_lugre",
    "exported_arm": "exported_arm",
    "friction_parts": "friction_parts",
    "lockstep": "nodes lockstep",
    "composition": "nodes composition",
    "speed": "nodes speed",
    "own_controller": "nodes own_controller",
    "view": "view",
    "sweep": "sweep",
    "friction_ramp": "friction_ramp grid",
    "friction_ramp_coverage": "friction_ramp random",
    "identification": "identification sliding",
    "identification_presliding": "identification presliding",
    "identification_time": "identification_time bags",
    "excitation_coverage": "excitation_coverage",
    "excitation_time": "identification_time excitation",
    "wrong_zeros": "wrong_zeros",
    "poor_logs": "poor_logs",
    "identification_guards": "identification_guards --short",
    "transmission": "transmission",
    "published_friction": "published_friction",
    "bristles": "bristles",
    "correction": "correction",
    "vplus_pallet": "vplus_pallet",
}
"""The module of each benchmark, and what it is asked for."""


def main() -> int:
    """Run what is asked for; return 1 if a benchmark failed, 130 if it was interrupted."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "names",
        nargs="*",
        metavar="name",
        help=f"of {', '.join(COMMANDS)}; all of them if none is given",
    )
    names = parser.parse_args().names or list(COMMANDS)
    for name in names:
        if name not in COMMANDS:
            parser.error(f"the benchmark is {name!r}; accepted: {', '.join(COMMANDS)}")
    failed = []
    pressed: list[int] = []
    # the benchmark ends by itself
    signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    for name in names:
        print(f"\n{name}", flush=True)
        command = [sys.executable, "-m", *f"benchmarks.{COMMANDS[name]}".split()]
        code = subprocess.run(command, cwd=ROOT, check=False).returncode
        if pressed or code == INTERRUPTED:
            print(f"\ninterrupted in {name}", file=sys.stderr)
            return INTERRUPTED
        if code:
            failed.append(name)
    if BENCH_FILE.is_file():
        print(f"\nfigures in {_relative(BENCH_FILE)}")
    for name in failed:
        print(f"{name} failed", file=sys.stderr)
    return 1 if failed else 0


def _relative(file: Path) -> Path:
    return file.relative_to(Path.cwd()) if file.is_relative_to(Path.cwd()) else file


if __name__ == "__main__":
    sys.exit(main())
