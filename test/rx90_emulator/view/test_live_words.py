"""What the page of running nodes says of them, as a browser shows it: each fact in its row, its unit and its colour."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from browser import BrowserPage, served

from rx90_common.exchange.arm_watch import JointSample, NodeStatus, Trajectory
from rx90_controller.lines.task import load_task
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view import live as live_module
from rx90_emulator.view.live import LiveView
from rx90_emulator.view.page import Page

Open = Callable[..., BrowserPage]
PACE = 0.25
GOOD, WARNING, ERROR = "rgb(43, 138, 62)", "rgb(230, 119, 0)", "rgb(201, 42, 42)"
ROW = (
    "name => [...document.querySelectorAll('tr')].find(row => row.cells[0].innerText == name)?.cells[1].innerText ?? ''"
)
COLOUR = """text => getComputedStyle([...document.querySelectorAll('td span')].find(
    span => span.innerText == text) ?? document.body).color"""


class Nodes:
    """Stand for `ArmWatch`: nodes whose time runs at PACE, and what they say."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self.trajectory: Trajectory | None = None
        self.listens_at_ticks = False
        self.publishers, self.robot, self.problem, self.topic = 1, None, "", "/joint_states"
        self.diagnostics = {
            "rx90_sim": NodeStatus(1, "late", {"brakes": "closed"}),
            "rx90_controller": NodeStatus(0, "holding", {"enabled": "true"}),
        }

    @property
    def time(self) -> float:
        """Return the simulated time, s."""
        return 100.0 + PACE * (time.monotonic() - self._began)

    def joints(self) -> list[JointSample]:
        """Return an arm that stands at the time."""
        return [JointSample(self.time, *np.zeros((3, 6)))]

    def elements(self) -> list[JointSample]:
        """Have no friction."""
        return []

    def look_around(self) -> None:
        """Do nothing."""

    def at_ticks(self, *, wanted: bool) -> None:
        """Take that a page is open."""
        self.wanted = wanted


def followed(begin: float, end: float) -> Trajectory:
    """Return a trajectory from when to when, s."""
    return Trajectory(begin, np.array([end]), np.zeros((1, 6)), np.array([True]))


def test_each_fact_stands_in_its_row(shipped: Setup, open_page: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    """Brakes, controller, pace and trajectory are the nodes' own; a warning and an error have their colours."""
    nodes = Nodes()
    monkeypatch.setattr(live_module, "ArmWatch", lambda *_: nodes)
    # What is drawn in software takes time: an arm is not looked at here.
    monkeypatch.setattr(live_module, "ArmScene", lambda *_: SimpleNamespace(show=lambda _: np.zeros(3)))
    live = live_module.LiveSource(SimpleNamespace(node=None), shipped.robot, "rx90_controller")  # type: ignore[arg-type]
    page = Page("test", port=0)
    LiveView(page, live, shipped.robot, load_task())
    with served(page):
        shown = open_page(page.address, (420, 400))

        def row(name: str, said: str) -> None:
            shown.wait_until(lambda: said == shown.page.evaluate(ROW, name), f"{name}: {said}")

        def colour(text: str, wanted: str) -> None:
            shown.wait_until(lambda: shown.page.evaluate(COLOUR, text) == wanted, f"the colour of {text}")

        row("brakes", "closed")
        row("simulation", "late")
        row("controller", "holding")
        row("trajectory", "none")
        colour("late", WARNING)
        colour("holding", GOOD)

        def pace() -> bool:
            seconds, _, factor = shown.page.evaluate(ROW, "time").partition(" s, ")
            if not factor:  # the page's thread has not run for a while: it says that nothing comes
                return False
            return abs(float(seconds) - nodes.time) < 5.0 and abs(float(factor.split()[0]) - PACE) <= 0.01

        shown.wait_until(pace, "time and pace")
        assert nodes.wanted  # friction at the tick, while a page is open and time does not hurry
        begin = nodes.time - 40.0
        nodes.trajectory = followed(begin, begin + 1000.0)

        def progress() -> bool:
            done, _, length = shown.page.evaluate(ROW, "trajectory").partition(" of ")
            return bool(length == "1000.0 s" and 40.0 <= float(done) <= nodes.time - begin + 0.1)

        shown.wait_until(progress, "the trajectory's progress and length")
        nodes.trajectory = followed(begin, begin + 39.0)
        row("trajectory", "none")
        nodes.diagnostics = {
            "rx90_sim": NodeStatus(0, "running", {"brakes": "open"}),
            "rx90_controller": NodeStatus(2, "joint_2: following error", {"enabled": "false"}),
        }
        row("brakes", "open")
        row("simulation", "running")
        colour("joint_2: following error", ERROR)
        legend = "path error of the laser spot, mm\n0\n0.05\n≥ 0.1"
        shown.wait_until(lambda: shown.text().count(legend) == 1, "the legend")
    assert (shown.complaints, shown.foreign_requests) == ([], [])
