"""Child processes and the fixture that starts them: what is started is ended, gives way, leaves nothing behind."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from processes import Processes, wait_until
from warm_start import COLD

from rx90_common.base.share import ROOT, config_path
from rx90_common.process.children import ChildProcess, ProcessGroup, executable

pytestmark = pytest.mark.slow

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


def test_the_last_lines_of_a_process_are_there_once_it_has_ended(tmp_path: Path) -> None:
    """Where this process is late at reading them, too: here its log cannot be opened for a second."""
    os.mkfifo(tmp_path / "log")
    child = ChildProcess("late", [sys.executable, "-c", "print('first'); print('last')"], tmp_path / "log")
    opened = threading.Timer(1.0, (tmp_path / "log").read_text)
    opened.start()
    assert (child.wait(), child.output) == (0, "first\nlast")
    opened.join()


def test_an_end_does_not_wait_for_who_holds_the_stream_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a process has started may live on with its output; what the process itself had said is there."""
    monkeypatch.setattr("rx90_common.process.children._LAST_LINES_S", 1.0)
    child = ChildProcess("parent", ["sh", "-c", "echo last; sleep 600 & exit 3"])
    assert (child.wait(), child.output) == (3, "last")
    os.killpg(child.pid, signal.SIGKILL)


PARENT = """
import sys, time
from rx90_common.process.children import ChildProcess, executable
child = ChildProcess("child", COMMAND)
child.wait_for("UP")
print("child", child.pid, flush=True)
time.sleep(600)
"""
DEAF = """
import signal, time
import rx90_common.process.children as module
signal.signal(signal.SIGINT, signal.SIG_IGN)
module._ORPHAN_GRACE_S = 0.2
module.end_with_parent()
print("up", flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize(
    ("command", "up"),
    [
        pytest.param("executable('rx90 bag', 'record', '--output', 'bag', 'none')", "waiting for", id="command"),
        pytest.param(f"[sys.executable, '-c', {DEAF!r}]", "up", id="deaf to SIGINT"),
    ],
)
def test_a_child_ends_with_a_parent_that_is_killed(
    command: str, up: str, processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kill -9 of a command leaves none of the package's processes behind."""
    monkeypatch.chdir(tmp_path)
    parent = processes.start(sys.executable, "-c", PARENT.replace("COMMAND", command).replace("UP", up))
    child = int(parent.wait_for(r"child (\d+)")[1])
    parent.signal(signal.SIGKILL)
    assert parent.wait() == -signal.SIGKILL
    wait_until(lambda: ended(child), "the child to be gone", 20.0)


def test_more_interrupts_leave_no_child_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Ctrl-C and SIGTERM come again while the children end, these are ended all the same."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    group = ProcessGroup(grace=0.5)
    stubborn = group.start("stubborn", [sys.executable, "-c", STUBBORN])
    wait = stubborn.wait

    def interrupted(timeout: float) -> int:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.raise_signal(number)
        return wait(timeout)

    def leave() -> None:
        with group:
            stubborn.wait_for("child")
            monkeypatch.setattr(stubborn, "wait", interrupted)

    with pytest.raises(KeyboardInterrupt):
        leave()
    assert stubborn.returncode == -signal.SIGTERM


def test_children_run_no_module_of_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither in place of the package, nor of a library, nor of what Python itself begins with."""
    monkeypatch.setattr(subprocess, "Popen", COLD)  # a warm process has imported them
    names = ("rx90_emulator", "rx90_common", "queue", "numpy", "runpy", "pkgutil", "pathlib", "yaml", "argparse")
    for name in (*names, "sitecustomize", "usercustomize", "signal", "threading"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('hostile')\n", encoding="ascii")
    monkeypatch.chdir(tmp_path)
    child = ChildProcess("check", executable("rx90 config", "check", config_path("robots/rx90b/friction.yaml")))
    assert (child.wait(), "hostile" in child.output) == (0, False), child.output


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
