"""Run a sweep from start, or from where it was left, to its file of results."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from tqdm import tqdm

from rx90_common.base.errors import ConfigError
from rx90_emulator.sweep.execution import Pool, available_cores, dask_pool, local_pool, run_all
from rx90_emulator.sweep.store import ResultStore
from rx90_emulator.sweep.sweep import Sweep

MOST_WORKERS = 1024


class SweepCounts(NamedTuple):
    """What a call of `run_sweep` did: runs it computed, and how many of them ended in an error."""

    computed: int
    failed: int


def run_sweep(
    sweep: Sweep,
    output: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    quiet: bool = False,
) -> SweepCounts:
    """Compute the runs that `output` lacks and write them there.

    Whatever ends it, KeyboardInterrupt included, what is done by then is in the file.

    Args:
        sweep: what to run.
        output: a Parquet file.
        workers: processes on this machine; all of its cores if None. Of no meaning with a scheduler.
        scheduler: address of a Dask scheduler whose workers are to do it.
        resume: take up a file, or the parts that a killed sweep left.
        quiet: show no progress bar.

    Raises:
        SweepError: if the output is in the way or belongs to another sweep, or workers are lost.
        LineError: if the arm cannot travel the line of the plan's own task.
    """
    if workers is not None and not 1 <= workers <= MOST_WORKERS:
        raise ConfigError(f"workers is {workers}; accepted: an integer in [1, {MOST_WORKERS}]")
    failed = computed = 0
    with ResultStore(output, sweep, resume=resume) as store:
        missing = np.flatnonzero(~store.done).tolist()
        if not missing:
            return SweepCounts(0, 0)
        with _pool(sweep, workers, scheduler) as pool, _bar(len(sweep), len(missing), quiet) as bar:
            for outcomes in run_all(pool, missing):
                store.add(outcomes)
                computed += len(outcomes)
                failed += sum(outcome.error is not None for outcome in outcomes)
                bar.set_postfix(failed=failed, refresh=False)
                bar.update(len(outcomes))
    return SweepCounts(computed, failed)


def _pool(sweep: Sweep, workers: int | None, scheduler: str | None) -> AbstractContextManager[Pool]:
    if scheduler is not None:
        return dask_pool(sweep, scheduler)
    return local_pool(sweep, workers or available_cores())


def _bar(runs: int, missing: int, quiet: bool) -> tqdm[NoReturn]:
    disable = True if quiet else None  # None: shown on a terminal only
    return tqdm(total=runs, initial=runs - missing, desc="sweep", unit="run", disable=disable, smoothing=0.05)
