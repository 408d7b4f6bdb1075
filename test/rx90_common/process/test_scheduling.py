"""Processors and niceness of a process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from rx90_common.base.errors import ConfigError
from rx90_common.process.threads import be_nice, run_on

ROOT = Path(__file__).parents[3]
PROGRAM = """
import json, os, sys, threading
from pathlib import Path
from rx90_common.process.threads import be_nice, run_on
held = threading.Event()
threading.Thread(target=held.wait, daemon=True).start()
run_on(sys.argv[1])
be_nice(7)
threading.Thread(target=held.wait, daemon=True).start()
tasks = [int(task.name) for task in Path("/proc/self/task").iterdir()]
print(json.dumps([[sorted(os.sched_getaffinity(t)), os.getpriority(os.PRIO_PROCESS, t)] for t in tasks]))
"""


def test_all_threads_are_meant() -> None:
    """Threads that are there and threads that begin later run on the processor asked for, with the niceness."""
    last = max(os.sched_getaffinity(0))
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", PROGRAM, f"{last}-{last}"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [[[last], 7]] * 3


@pytest.mark.parametrize("cpus", ["", "a", "1-0", "-1", "0,", "999999", "0-99999999999", "0\n1"])
def test_processors_that_are_not_there_are_refused(cpus: str) -> None:
    """What is no list of usable processors is one line that names those, and nothing changes."""
    before = os.sched_getaffinity(0)
    with pytest.raises(ConfigError, match=r"accepted: numbers and ranges, as in 0,2-3, of \d") as refusal:
        run_on(cpus)
    assert "\n" not in str(refusal.value)
    assert os.sched_getaffinity(0) == before


def test_niceness_that_cannot_be_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A niceness out of range, or one that the system does not permit, is one line with what is accepted."""
    for niceness in (-21, 20):
        with pytest.raises(ConfigError, match=rf"^--nice {niceness}; accepted: a whole number from -20 to 19$"):
            be_nice(niceness)

    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "setpriority", refuse)
    with pytest.raises(ConfigError, match=r"^--nice -5: not permitted to this user; accepted: from -?\d+ to 19$"):
        be_nice(-5)
