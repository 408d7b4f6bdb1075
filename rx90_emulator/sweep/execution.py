"""Run a sweep, from its start or on from results that are there, on this machine's cores or on a Dask cluster.

In both cases the same chunks of runs are computed.
"""

from __future__ import annotations

import ctypes
import gc
import logging
import multiprocessing as mp
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import lru_cache
from importlib import import_module
from itertools import islice
from multiprocessing.connection import wait as wait_for_any
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from rx90_common.base.errors import ConfigError, FailureError, SweepError
from rx90_common.base.quoting import one_line
from rx90_common.process.requirements import missing_module
from rx90_emulator.sweep.store import ResultStore
from rx90_emulator.sweep.sweep import RunOutcome, Sweep

LARGEST_CHUNK = 8
MOST_WORKERS = 1024
_CHUNKS_PER_WORKER = 32
_QUEUED_PER_WORKER = 3
_CONNECT_TIMEOUT = 10.0
_NOISY_LOGGERS = ("distributed", "distributed.client", "tornado.application")
_HEAP_THRESHOLD = 1 << 30
_RESUME_ADVICE = "what is done is kept, go on with resume (--resume)"

Chunk = Sequence[int]
Outcomes = list[RunOutcome]


class Pool(NamedTuple):
    """Where chunks of runs are computed.

    Attributes:
        workers: how many chunks at a time.
        submit: hands a chunk over.
    """

    workers: int
    submit: Callable[[Chunk], Future[Outcomes]]


class SweepCounts(NamedTuple):
    """What a call of `run_sweep` did: runs it computed, and how many of them ended in an error."""

    computed: int
    failed: int


def run_sweep(
    sweep: Sweep,
    output: Path | str,
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
    with ResultStore(Path(output), sweep, resume=resume) as store:
        missing = np.flatnonzero(~store.done).tolist()
        if not missing:
            return SweepCounts(0, 0)
        if scheduler is None:
            pool_of = local_pool(sweep, workers or len(os.sched_getaffinity(0)))
        else:
            pool_of = dask_pool(sweep, scheduler)
        hidden = True if quiet else None  # None: shown on a terminal only
        bar = tqdm(
            total=len(sweep),
            initial=len(sweep) - len(missing),
            desc="sweep",
            unit="run",
            disable=hidden,
        )
        with pool_of as pool, bar:
            for outcomes in run_all(pool, missing):
                store.add(outcomes)
                computed += len(outcomes)
                failed += sum(outcome.error is not None for outcome in outcomes)
                bar.set_postfix(failed=failed, refresh=False)
                bar.update(len(outcomes))
    return SweepCounts(computed, failed)


def run_all(pool: Pool, indices: Sequence[int]) -> Iterator[Outcomes]:
    """Run runs on a pool; yield the outcomes of a chunk as soon as it is done, in any order.

    Args:
        pool: where they are computed.
        indices: of the runs.
    """
    size = min(LARGEST_CHUNK, max(1, len(indices) // (_CHUNKS_PER_WORKER * pool.workers)))
    chunks = (indices[first : first + size] for first in range(0, len(indices), size))
    running = {pool.submit(chunk) for chunk in islice(chunks, _QUEUED_PER_WORKER * pool.workers)}
    while running:
        ready, running = wait(running, return_when=FIRST_COMPLETED)
        running |= {pool.submit(chunk) for chunk in islice(chunks, len(ready))}
        for future in ready:
            yield future.result()


@contextmanager
def local_pool(sweep: Sweep, workers: int) -> Iterator[Pool]:
    """Offer processes of this machine.

    They are forked from this one, so that they share what it has compiled and planned.
    """
    sweep.warm_up()
    context = mp.get_context("fork")
    stop = context.RawValue("b", 0)  # without a lock, that a killed worker might keep
    processes = ProcessPoolExecutor(workers, context, _start_worker, (sweep, stop))

    def submit(chunk: Chunk) -> Future[Outcomes]:
        # Fork with Ctrl-C and the like blocked: a terminal sends it to the workers too, and they must overlook it.
        before = signal.pthread_sigmask(
            signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
        )
        try:
            return processes.submit(_run_in_worker, chunk)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    try:
        submit([])  # forks before the caller starts any thread
        yield Pool(workers, submit)
    except BrokenProcessPool as error:
        raise SweepError(
            f"a worker process died, killed or out of memory; {_RESUME_ADVICE}"
        ) from error
    finally:
        stop.value = 1
        processes.shutdown(wait=True, cancel_futures=True)


_in_worker: list[Any] = []
"""What a worker process gets from its parent: the sweep, and a shared number that is 1 when it is to stop."""


def _start_worker(sweep: Sweep, stop: Any) -> None:
    gc.freeze()  # what the parent left lying may be threads' and rclpy's, which only the parent can delete
    _in_worker[:] = sweep, stop
    # Let the C library keep memory that is given back: the series of a run are fresh pages otherwise, an eighth of it.
    with suppress(OSError, AttributeError):  # other C libraries than glibc have none of it
        for parameter in (-1, -3):  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD
            ctypes.CDLL("libc.so.6").mallopt(parameter, _HEAP_THRESHOLD)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = mp.parent_process()
    if parent is not None:
        wait_for_any([parent.sentinel])
        os._exit(1)


def _run_in_worker(chunk: Chunk) -> Outcomes:
    sweep: Sweep = _in_worker[0]
    stop = _in_worker[1]
    return [sweep.run(index) for index in chunk if not stop.value]


@contextmanager
def dask_pool(sweep: Sweep, address: str) -> Iterator[Pool]:
    """Offer the workers of a Dask cluster.

    Raises:
        FailureError: if Dask is not installed.
    """
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:  # which most sweeps do without
        raise FailureError(missing_module(error) or str(error)) from error
    for name in _NOISY_LOGGERS:  # the sweep says in one line what is a traceback there
        logging.getLogger(name).setLevel(logging.CRITICAL)
    client = None
    try:
        try:
            client = distributed.Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, ValueError) as error:  # TimeoutError is an OSError
            raise SweepError(
                f"no Dask scheduler answers at {address} ({one_line(error)})"
            ) from error
        workers = sum(client.ncores().values())
        if not workers:
            raise SweepError(
                f"the Dask scheduler at {address} has no workers; accepted: at least one"
            )
        executor = client.get_executor(pure=False)
        payload = pickle.dumps(sweep)
        yield Pool(workers, lambda chunk: executor.submit(_run_on_cluster, payload, chunk))
    except (distributed.KilledWorker, CancelledError, OSError, ImportError) as error:
        raise SweepError(
            f"the Dask cluster at {address} failed ({one_line(error)}); {_RESUME_ADVICE}"
        ) from error
    finally:
        if client is not None:
            client.close()


@lru_cache(maxsize=2)
def _received(payload: bytes) -> Sweep:
    sweep: Sweep = pickle.loads(payload)
    sweep.check_sources()
    sweep.warm_up()
    return sweep


def _run_on_cluster(payload: bytes, chunk: Chunk) -> Outcomes:
    sweep = _received(payload)
    return [sweep.run(index) for index in chunk]
