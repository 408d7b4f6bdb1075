"""The options of a page, and Ctrl-C while the page comes up."""

from __future__ import annotations

import signal
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
from processes import Processes, wait_until

from rx90_emulator.cli.frame import run
from rx90_emulator.demo import demonstration


def test_the_demonstration_hands_the_options_of_its_page_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """`rx90_demo --view` takes the options of a page that `rx90_view` takes, and starts it with them."""
    monkeypatch.chdir(tmp_path)
    given = []

    def make(*arguments: object) -> SimpleNamespace:
        given.append(arguments[-1])
        return SimpleNamespace(run=lambda _folder: True)

    monkeypatch.setattr(demonstration, "Demonstration", make)
    monkeypatch.setenv("ROS_DOMAIN_ID", "1")
    words = ["--host", "localhost", "--port", "8099", "--no-browser"]
    assert [run("rx90_demo", [*view, *extra]) for view, extra in (([], []), (["--view"], []), (["--view"], words))] == [
        0
    ] * 3
    none, usual, chosen = given
    assert none is None
    assert usual == ["--port", 0]
    assert chosen[-len(words) :] == words
    assert run("rx90_view", [*words, "--task", "nowhere"]) == 2  # of all these, the task alone is refused


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
    view = processes.start("rx90_view", "--demo", "--port", 0, "--no-browser")
    view.wait_for(said)
    wait_until(lambda: bool(_children(view.pid)), "the nodes' process")
    children = _children(view.pid)
    view.signal(signal.SIGINT)
    assert view.wait() == 130
    assert "Traceback" not in view.output
    assert view.lines[-1] == "rx90_view: interrupted"
    for child in children:
        wait_until(lambda child=child: not Path(f"/proc/{child}").exists(), "the end of the nodes")  # type: ignore[misc]
