"""The options of a page, and Ctrl-C while the page comes up."""

from __future__ import annotations

import signal
from contextlib import suppress
from pathlib import Path

import pytest
from processes import Processes, wait_until


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # a thread that has just ended
            found += map(int, (task / "children").read_text().split())
    return found


@pytest.mark.ros
@pytest.mark.parametrize("said", ["starting simulation", "page: "])
def test_ctrl_c_while_the_nodes_come_up(processes: Processes, said: str) -> None:
    """Ctrl-C before the arm is seen ends page and nodes with 130, one line, and no process left behind."""
    view = processes.start("rx90 view", "--demo", "--port", 0, "--no-browser")
    view.wait_for(said)
    wait_until(lambda: bool(_children(view.pid)), "the nodes' process")
    children = _children(view.pid)
    view.signal(signal.SIGINT)
    assert view.wait() == 130
    assert "Traceback" not in view.output
    assert view.lines[-1] == "rx90 view: interrupted"
    for child in children:
        wait_until(lambda child=child: not Path(f"/proc/{child}").exists(), "the end of the nodes")  # type: ignore[misc]
