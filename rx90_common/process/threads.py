"""The threads of this process: their call stacks, their processors, and their priority."""

from __future__ import annotations

import os
import sys
import threading
import traceback
from pathlib import Path, PurePath

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted

_MAX_CPUS = 8192  # Linux has no more
NICEST = 19
"""The largest niceness: a thread with it yields to everything else."""


def calls_of(thread: threading.Thread) -> list[traceback.FrameSummary]:
    """Return the call stack of a thread, the innermost call last; empty before its start and after its end."""
    frame = sys._current_frames().get(thread.ident or 0)
    return [] if frame is None else list(traceback.extract_stack(frame))


def place_of(call: traceback.FrameSummary) -> str:
    """Return the file's name and the line that a call is at."""
    return f"{PurePath(call.filename).name}:{call.lineno}"


def where_threads_are() -> list[str]:
    """Return a line for each thread but the calling one: its name, and its call stack, the innermost call last."""
    others = (thread for thread in threading.enumerate() if thread is not threading.current_thread())
    found = [(thread.name, calls) for thread in others if (calls := calls_of(thread))]
    return [f"{name}: " + " > ".join(f"{place_of(one)} {one.name}" for one in calls) for name, calls in found]


def run_on(cpus: str) -> None:
    """Let this process, with all its threads, run on these processors alone.

    Args:
        cpus: numbers and ranges, as in `0,2-3`.
    """
    usable = os.sched_getaffinity(0)
    try:
        requested = {number for part in cpus.split(",") for number in _numbers(part)}
    except ValueError:
        requested = set()
    if not requested or not requested <= usable:
        accepted = ", ".join(map(str, sorted(usable)))
        raise ConfigError(f"--cpus {quoted(cpus)}; accepted: numbers and ranges, as in 0,2-3, of {accepted}")
    for thread in _threads():
        os.sched_setaffinity(thread, requested)


def _numbers(part: str) -> range:
    first, dash, last = part.partition("-")
    numbers = range(int(first), int(last if dash else first) + 1)
    if not 0 < len(numbers) <= _MAX_CPUS:  # a range of millions would fill the memory
        raise ValueError(part)
    return numbers


def be_nice(niceness: int) -> None:
    """Give this process, with all its threads, a niceness: 19 gives way to all others, below 0 needs permission."""
    if not -NICEST - 1 <= niceness <= NICEST:
        raise ConfigError(f"--nice {niceness}; accepted: a whole number from {-NICEST - 1} to {NICEST}")
    try:
        for thread in _threads():
            os.setpriority(os.PRIO_PROCESS, thread, niceness)
    except PermissionError:
        current = os.getpriority(os.PRIO_PROCESS, 0)
        raise ConfigError(
            f"--nice {niceness}: not permitted to this user; accepted: from {current} to {NICEST}"
        ) from None


def _threads() -> list[int]:
    """Return the ids of this process's threads; threads that begin later inherit the affinity of their parent."""
    return [int(task.name) for task in Path("/proc/self/task").iterdir()]
