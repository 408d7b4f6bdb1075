"""What every benchmark shares: its options, processes and turns, what it prints and where its figures go."""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tqdm import tqdm

from rx90_common.base.errors import INTERRUPTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROOT = Path(__file__).resolve().parent.parent
BENCH_FILE = ROOT / "out" / "bench.json"
_Job = TypeVar("_Job")
_Found = TypeVar("_Found")
PLOT = ("--plot", None, "picture to write")
WIDTH = 8.2
"""Of a picture, inches."""
_FEW_DECADES = 1e3  # on a logarithmic axis: room for 1, 2 and 5 of each


def arguments(description: str | None, *options: tuple[str, Any, str]) -> argparse.Namespace:
    """Read the command line: a name, a default value and a help text for each option.

    A default of False makes a switch, one of None the name of a file, a tuple what is accepted, its first value being
    the default; others give the type of the value.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, value, text in options:
        if value is False:
            parser.add_argument(name, action="store_true", help=text)
            continue
        more: dict[str, Any] = {} if name.startswith("-") else {"nargs": "?"}
        default = value[0] if isinstance(value, tuple) else value
        if isinstance(value, tuple):
            more["choices"] = value
        kind = Path if default is None else type(default)
        shown = "" if default is None else " (default: %(default)s)"
        parser.add_argument(name, type=kind, default=default, help=text + shown, **more)
    return parser.parse_args()


def prepare_ros() -> None:
    """Keep to this machine and to a ROS domain of its own, where none is given, and get ready for rclpy."""
    from rx90_common.exchange.ros_start import prepare

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    prepare()


def in_processes(
    job: Callable[[_Job], _Found], jobs: Sequence[_Job], label: str, chunk: int = 1
) -> dict[_Job, _Found]:
    """Return the results of all jobs, one process for each processor, with the progress on the terminal.

    On Ctrl-C those that are done are returned, in the order of the jobs, and how many they are is said.
    """
    parts = iter([jobs[k : k + chunk] for k in range(0, len(jobs), chunk)])
    count = len(os.sched_getaffinity(0))
    found: dict[_Job, _Found] = {}
    # Not forked: numba and BLAS may hold threads already.
    with ProcessPoolExecutor(count, get_context("spawn")) as pool:
        # as the processes, which start here, keep it
        ours = signal.signal(signal.SIGINT, signal.SIG_IGN)
        # No more than run at once: those that the pool has queued could not be cancelled.
        waiting = {pool.submit(_results, job, part): part for part in islice(parts, count)}
        signal.signal(signal.SIGINT, ours)
        try:
            with tqdm(total=len(jobs), desc=label) as progress:
                while waiting:
                    future = next(as_completed(waiting))
                    found.update(zip(waiting[future], future.result(), strict=True))
                    progress.update(len(waiting.pop(future)))
                    waiting.update(
                        {pool.submit(_results, job, part): part for part in islice(parts, 1)}
                    )
        except KeyboardInterrupt:
            print("interrupted: what runs is finished", file=sys.stderr)
            pool.shutdown(cancel_futures=True)
            for future, part in waiting.items():
                if not future.cancelled():
                    found.update(zip(part, future.result(), strict=True))
            print(f"interrupted: {label}: {len(found)} of {len(jobs)} measured", file=sys.stderr)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return {one: found[one] for one in jobs if one in found}


def _results(job: Callable[[_Job], _Found], jobs: Sequence[_Job]) -> list[_Found]:
    return [job(one) for one in jobs]


def timed(run: Callable[[], object], count: float = 1.0) -> Callable[[], float]:
    """Return a function that runs and gives the processor time by `count`, s."""

    def seconds() -> float:
        began = time.process_time()
        run()
        return (time.process_time() - began) / count

    return seconds


def in_turns(runs: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, list[float]]:
    """Return the times of all rounds by name; runs take turns, so that the machine's load affects all alike.

    A first round, which may compile, does not count.
    """
    for run in runs.values():
        run()
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            times[name].append(run())
    return times


def ratios(times: Mapping[str, Sequence[float]], base: str) -> dict[str, float]:
    """Return how many times longer than the base each takes, the median of the rounds' ratios."""
    return {
        name: statistics.median(
            theirs / own for theirs, own in zip(series, times[base], strict=True)
        )
        for name, series in times.items()
    }


def print_times(
    title: str, times: Mapping[str, Sequence[float]], base: str, period: float
) -> dict[str, float]:
    """Print what a tick of `period`, s, takes, by name; return the medians."""
    median = {name: statistics.median(series) for name, series in times.items()}
    ratio = ratios(times, base)
    rows = [
        (
            name,
            f"{s * 1e6:.3f}",
            f"{min(times[name]) * 1e6:.3f}",
            f"{period / s:.0f}",
            f"{ratio[name]:.2f}",
        )
        for name, s in median.items()
    ]
    print_table((title, "us per tick", "best", "x real time", f"x {base}"), rows)
    return median


def print_table(headers: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print rows under headers; the first column is text, the others are aligned to the right."""
    table = [headers, *rows]
    widths = [max(len(row[k]) for row in table) for k in range(len(headers))]
    for row in table:
        cells = [
            row[0].ljust(widths[0]),
            *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)),
        ]
        print("  ".join(cells).rstrip())


def spread(key: str, values: Sequence[float]) -> dict[str, float]:
    """Return the median of several runs, the lowest and the highest of them, as figures."""
    return {
        key: statistics.median(values),
        f"{key}_lowest": min(values),
        f"{key}_highest": max(values),
    }


def merge(figures: Mapping[str, float], file: Path = BENCH_FILE) -> None:
    """Add figures to those that other benchmarks left, rounded to four digits."""
    known = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    known.update({key: float(f"{value:.4g}") for key, value in figures.items()})
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(known, indent=2, sort_keys=True) + "\n", encoding="utf-8")


def publish(figures: Mapping[str, float]) -> None:
    """Print figures and merge them."""
    print_table(("figure", "value"), [(key, f"{value:.4g}") for key, value in figures.items()])
    merge(figures)


def accepted(wrong: Sequence[str], whole: bool = True) -> int:
    """Name what is not accepted; return the exit code: 1 if there is any, 130 if not all was measured."""
    for name in wrong:
        print(f"{name}: not what is accepted", file=sys.stderr)
    return int(bool(wrong)) if whole else INTERRUPTED


def plain_decades(panel: Axes) -> None:
    """Label logarithmic axes with plain numbers: Matplotlib's own labels are formulas, which are not read here."""
    from matplotlib.ticker import LogLocator  # here, because most benchmarks draw nothing

    for axis in (panel.xaxis, panel.yaxis):
        if axis.get_scale() == "log":
            low, high = axis.get_view_interval()
            if high < _FEW_DECADES * low:
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
