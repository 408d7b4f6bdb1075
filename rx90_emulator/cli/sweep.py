"""`rx90_sweep`: run a plan of many closed-loop runs, and show what a file of results holds."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from rx90_common.base.errors import Rx90Error


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    options = _parser().parse_args(args)
    if find_spec("pyarrow") is None:
        print("rx90_sweep: pyarrow is missing; install it: pip install 'rx90_emulator[sweep]'", file=sys.stderr)
        return 1
    try:
        options.verb(options)
    except Rx90Error as error:
        print(f"rx90_sweep: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"rx90_sweep: interrupted; {_how_to_go_on(options)}", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="rx90_sweep", description=__doc__)
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    run = verbs.add_parser("run", help="run a plan", description="Run a plan of closed-loop runs.")
    run.add_argument("plan", help="plan file, of your own or shipped, such as sweep/friction.yaml")
    run.add_argument("--output", type=Path, required=True, help="Parquet file to write")
    run.add_argument("--resume", action="store_true", help="compute only the runs that the output lacks")
    where = run.add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, help="processes on this machine (all cores)")
    where.add_argument("--scheduler", help="run on the Dask cluster at this address, such as tcp://host:8786")
    run.set_defaults(verb=_run)
    info = verbs.add_parser("info", help="show what a file of results holds")
    info.add_argument("file", type=Path, help="Parquet file, finished or not")
    info.set_defaults(verb=_info)
    return parser


def _run(options: argparse.Namespace) -> None:
    # What needs pyarrow is imported once it is known to be there.
    from rx90_emulator.sweep.execution import run_sweep
    from rx90_emulator.sweep.plan_file import load_sweep_plan
    from rx90_emulator.sweep.sweep import Sweep

    plan = load_sweep_plan(options.plan)
    sweep = Sweep(plan)
    began = time.perf_counter()
    counts = run_sweep(
        sweep,
        options.output,
        workers=options.workers,
        scheduler=options.scheduler,
        resume=options.resume,
    )
    elapsed = time.perf_counter() - began
    if counts.computed == 0:
        print(f"nothing to do: {options.output} has all {len(sweep)} runs")
        return
    print(f"{counts.computed} of {len(sweep)} runs in {elapsed:.1f} s, {counts.failed} failed; {options.output}")


def _info(options: argparse.Namespace) -> None:
    from rx90_emulator.sweep.info import describe_results

    print("\n".join(describe_results(options.file)))


def _how_to_go_on(options: argparse.Namespace) -> str:
    if options.verb is not _run:
        return "nothing was changed"
    return f"what is done is kept; go on with: rx90_sweep run {options.plan} --output {options.output} --resume"


if __name__ == "__main__":
    sys.exit(main())
