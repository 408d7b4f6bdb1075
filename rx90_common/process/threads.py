"""Where threads are: what a program says of those that do not end."""

from __future__ import annotations

import sys
import threading
import traceback
from pathlib import PurePath


def calls_of(thread: threading.Thread) -> list[traceback.FrameSummary]:
    """Return the calls that a thread is in, the innermost last; none of one that has not begun or has ended."""
    frame = sys._current_frames().get(thread.ident or 0)
    return [] if frame is None else list(traceback.extract_stack(frame))


def place_of(call: traceback.FrameSummary) -> str:
    """Return the file's name and the line that a call is at."""
    return f"{PurePath(call.filename).name}:{call.lineno}"


def where_threads_are() -> list[str]:
    """Return a line for each thread but the one that asks: its name, and the calls it is in, the innermost last."""
    others = (thread for thread in threading.enumerate() if thread is not threading.current_thread())
    told = [(thread.name, calls) for thread in others if (calls := calls_of(thread))]
    return [f"{name}: " + " > ".join(f"{place_of(one)} {one.name}" for one in calls) for name, calls in told]
