"""Run a plan of many closed-loop runs, and show what a file of results holds."""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace
from pathlib import Path

import rx90_emulator as rx
from rx90_common.base.errors import FailureError
from rx90_common.base.quoting import counted, one_line, plain
from rx90_emulator.cli.options import (
    add_output,
    add_robot_argument,
    place,
    whole_number,
)


def _add_run(run: ArgumentParser) -> None:
    run.add_argument("plan", metavar="PLAN", help="plan file of your own (docs/howto/sweep.md), or the name of a "
                     "shipped one: sweep/friction_and_feed_forward.yaml, sweep/payload_and_speed.yaml, "
                     "sweep/reference_1000.yaml")  # fmt: skip
    add_output(run, place, "Parquet file to write", metavar="FILE", required=True)
    add_robot_argument(run)
    run.add_argument(
        "--resume", action="store_true", help="compute only the runs that the output lacks"
    )
    run.add_argument("--workers", type=_workers, metavar="N",
                     help="processes on this machine (all cores), or the address of a Dask cluster instead of them, "
                     "such as tcp://host:8786")  # fmt: skip
    kept = "what is done is kept; go on with: rx90 sweep run {plan} --output {output} --resume"
    run.set_defaults(interrupted=kept)


def _workers(text: str) -> float | str:
    """Return a number of processes, or the address of a scheduler, as a type for argparse."""
    return text if "://" in text else whole_number(text)


def _run(options: Namespace) -> None:
    """Run a plan of closed-loop runs."""
    if options.robot is not None:
        options.interrupted += " --robot {robot}"
    sweep = rx.Sweep(rx.load_sweep_plan(options.plan, robot=options.robot))
    began = time.perf_counter()
    counts = rx.run_sweep(
        sweep,
        options.output,
        workers=options.workers if isinstance(options.workers, int) else None,
        scheduler=options.workers if isinstance(options.workers, str) else None,
        resume=options.resume,
    )
    elapsed = time.perf_counter() - began
    if counts.computed == 0:
        print(
            one_line(f"nothing to do: {options.output} is complete, {counted(len(sweep), 'run')}")
        )
    else:
        done = f"{counts.computed} of {counted(len(sweep), 'run')} in {elapsed:.1f} s, {counts.failed} failed"
        why = f" (rx90 sweep info {options.output} says why)" if counts.failed else ""
        print(one_line(f"{done}{why}; {options.output}"))
    # perhaps not one run of the file has results, also of calls before
    if counts.failed == counts.computed:
        errors = rx.read_sweep(options.output)["error"]
        if errors.null_count == 0:
            more = f"rx90 sweep info {plain(options.output)} says more"
            raise FailureError(f"every run failed, for example: {errors[0].as_py()}; {more}")


def _add_info(info: ArgumentParser) -> None:
    info.add_argument("file", type=Path, metavar="FILE", help="Parquet file, finished or not")


def _info(options: Namespace) -> None:
    """Show what a file of results holds."""
    from rx90_emulator.sweep.store import describe_results

    print("\n".join(describe_results(options.file)))


SUBCOMMANDS = (
    (_add_run, _run, "run a plan"),
    (_add_info, _info, "show what a file of results holds"),
)
