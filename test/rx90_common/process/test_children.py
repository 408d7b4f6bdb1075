"""Child processes and the fixture that starts them: what is started is also ended."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from pathlib import Path

import processes as module
import pytest
from processes import Processes, own_domain, wait_until

from rx90_common.base.errors import ProcessError
from rx90_common.process.children import ProcessGroup

STUBBORN = """
import os, signal, time
signal.signal(signal.SIGINT, signal.SIG_IGN)
child = os.fork()
print("child", child if child else os.getpid(), flush=True)
time.sleep(600)
"""


def ended(pid: int) -> bool:
    """Return whether a process is gone or only waits for its parent's or init's look."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return True
    return state == "Z"


def test_a_process_that_ignores_ctrl_c_is_killed_with_its_children() -> None:
    """A process that ignores Ctrl-C is named and killed, and so is what it started."""
    started = Processes(grace=0.5)
    stubborn = started.start(sys.executable, "-c", STUBBORN)
    child = int(stubborn.wait_for(r"child (\d+)")[1])
    assert started.end() == [stubborn.name]
    wait_until(lambda: ended(child) and ended(stubborn.pid), "both processes to be gone", 10.0)


def test_more_interrupts_leave_no_child_behind() -> None:
    """Where Ctrl-C and SIGTERM come again while the children end, these are ended all the same."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    group = ProcessGroup(grace=0.5)
    stubborn = group.start("stubborn", [sys.executable, "-c", STUBBORN])

    def leave() -> None:
        with group:
            stubborn.wait_for("child")
            for number in (signal.SIGINT, signal.SIGTERM):
                threading.Timer(0.2, os.kill, (os.getpid(), number)).start()

    try:
        with pytest.raises(KeyboardInterrupt):
            leave()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert stubborn.returncode == -signal.SIGTERM


def test_a_line_is_waited_for_once(processes: Processes) -> None:
    """Each wait goes on after the line that the wait before it found."""
    printing = processes.start(sys.executable, "-c", "for i in range(3): print('line', i)")
    assert [printing.wait_for(r"line (\d)")[1] for _ in range(3)] == ["0", "1", "2"]
    with pytest.raises(ProcessError, match="ended early: line 2"):
        printing.wait_for("line")
    assert printing.wait() == 0


def test_a_domain_in_use_is_not_given(ros_domain: int, processes: Processes) -> None:
    """A DDS domain with a participant in it is never given to another test."""
    node = "import rclpy, time; rclpy.init(); n = rclpy.create_node('n'); print('up'); time.sleep(600)"
    processes.start(sys.executable, "-c", node).wait_for("up")
    assert os.environ["ROS_DOMAIN_ID"] == str(ros_domain)
    given = set()
    for _ in range(2 * module.LAST_DOMAIN):
        with own_domain() as domain:
            given.add(domain)
    assert len(given) > module.LAST_DOMAIN // 2
    assert ros_domain not in given


def test_two_tests_never_share_a_domain() -> None:
    """A domain is given to one test at a time, before any participant is in it."""
    with contextlib.ExitStack() as tests:
        given = [tests.enter_context(own_domain()) for _ in range(10)]
    assert len(set(given)) == 10
