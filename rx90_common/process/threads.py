"""The priority of this process."""

from __future__ import annotations

import os
from pathlib import Path


def be_nicer(least: int) -> None:
    """Give this process, with all its threads, at least this niceness, so that others come first.

    Args:
        least: from 0 to 19; a process that is nicer already stays so.
    """
    for thread in Path("/proc/self/task").iterdir():
        number = int(thread.name)
        niceness = os.getpriority(os.PRIO_PROCESS, number)
        os.setpriority(os.PRIO_PROCESS, number, max(niceness, least))
