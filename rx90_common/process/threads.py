"""The threads of this process: their call stacks, and their priority."""

from __future__ import annotations

import os
import sys
import threading
import traceback
from pathlib import Path, PurePath


def calls_of(thread: threading.Thread) -> list[traceback.FrameSummary]:
    """Return the call stack of a thread, the innermost call last; empty before its start and after its end."""
    frame = sys._current_frames().get(thread.ident or 0)
    return [] if frame is None else list(traceback.extract_stack(frame))


def place_of(call: traceback.FrameSummary) -> str:
    """Return the file's name and the line that a call is at."""
    return f"{PurePath(call.filename).name}:{call.lineno}"


def where_threads_are() -> list[str]:
    """Return a line for each thread but the calling one: its name, and its call stack, the innermost call last."""
    others = (
        thread for thread in threading.enumerate() if thread is not threading.current_thread()
    )
    found = [(thread.name, calls) for thread in others if (calls := calls_of(thread))]
    return [
        f"{name}: " + " > ".join(f"{place_of(one)} {one.name}" for one in calls)
        for name, calls in found
    ]


def be_nicer(least: int) -> None:
    """Give this process, with all its threads, at least this niceness, so that others come first.

    Args:
        least: from 0 to 19; a process that is nicer already stays so.
    """
    for thread in Path("/proc/self/task").iterdir():
        number = int(thread.name)
        niceness = os.getpriority(os.PRIO_PROCESS, number)
        os.setpriority(os.PRIO_PROCESS, number, max(niceness, least))
