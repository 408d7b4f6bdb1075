"""Niceness of a process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PROGRAM = """
import json, os, sys, threading
from pathlib import Path
from rx90_common.process.threads import be_nicer
held = threading.Event()
threading.Thread(target=held.wait, daemon=True).start()
os.nice(int(sys.argv[1]))
be_nicer(7)
threading.Thread(target=held.wait, daemon=True).start()
tasks = [int(task.name) for task in Path("/proc/self/task").iterdir()]
print(json.dumps([os.getpriority(os.PRIO_PROCESS, task) for task in tasks]))
"""


@pytest.mark.parametrize("before", [0, 9])
def test_all_threads_give_way(before: int) -> None:
    """Threads that are there and threads that begin later are nice enough; one that is nicer already stays so."""
    start = os.getpriority(os.PRIO_PROCESS, 0)
    command = [sys.executable, "-c", PROGRAM, str(before)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [max(start + before, 7), max(start, 7), max(start + before, 7)]
