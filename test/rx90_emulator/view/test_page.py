"""The page in a real browser: arms where Pinocchio says, the trace, and its loop."""

import io
import signal
import socket
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator
from functools import partial
from types import FrameType
from typing import Any

import numpy as np
import pytest
from browser import BrowserPage, served
from PIL import Image
from pinocchio_chain import tip_pose

import rx90_emulator as rx
from rx90_common.base.errors import ConfigError
from rx90_emulator.view.page import Page
from rx90_emulator.view.scene import ArmScene, LineScene

Open = Callable[..., BrowserPage]
POSE = np.array([0.4, -0.7, 1.9, 0.8, -0.9, 2.5])
PIXEL = 1e-6  # m; positions go to the page as single precision


@pytest.fixture
def page() -> Iterator[Page]:
    with served(Page("test", port=0)) as page:
        yield page


def test_arms_are_drawn_where_pinocchio_says(shipped: rx.Setup, tx40: rx.Setup, page: Page, open_page: Open) -> None:
    """The tips' poses in the browser's own scene are those of the forward kinematics, and follow them."""
    arms = [(setup, ArmScene(page, f"/{setup.robot.model.name}", setup.robot)) for setup in (shipped, tx40)]
    shown = open_page(page.address, (1000, 700), pictures="few")

    def at(setup: rx.Setup, arm: ArmScene, position: np.ndarray) -> bool:
        return bool(np.allclose(shown.pose(arm.tip), tip_pose(setup.robot, position), atol=PIXEL))

    for position in (np.zeros(6), POSE):
        page.later(lambda position=position: [arm.show(position) for _, arm in arms])  # type: ignore[misc]
        for setup, arm in arms:
            shown.wait_until(partial(at, setup, arm, position), "the tip where it is by Pinocchio")
    assert (shown.complaints, shown.foreign_requests) == ([], [])


def test_the_trace_has_the_colours_of_the_path_error(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is where the tip was, blue to red by the path error; off the line grey."""
    made: dict[str, Any] = {}
    add = page.add_lines
    monkeypatch.setattr(page, "add_lines", lambda name, *a, **k: made.setdefault(name, add(name, *a, **k)))
    start, end = np.array([0.5, 0.0, 0.2]), np.array([0.9, 0.0, 0.2])
    line = LineScene(page, "/line", rx.LineTask(tuple(start), tuple(end)))
    tips = np.array([[0.5, 0.02, 0.2], [0.5, 0.0, 0.2], [0.6, 0.0, 0.2], [0.7, 1e-4, 0.2], [0.8, 0.0, 0.2]])
    line.follow(np.array([1.5, 9.0]), np.stack([start, end]), np.array([True, True]))
    line.add(np.arange(5.0), tips)
    line.draw()
    np.testing.assert_allclose(made["/line/line"].points[[0, -1], [0, 1]], [start, end], rtol=1e-6)
    trace = made["/line/trace"]
    drawn = np.concatenate([trace.points[:, 0], trace.points[-1:, 1]])
    np.testing.assert_allclose(drawn, tips, atol=1e-6)
    colors = np.concatenate([trace.colors[:, 0], trace.colors[-1:, 1]]).astype(int)
    assert len(set(colors[0])) == 1  # grey
    assert colors[2][2] > colors[2][0]  # blue
    assert colors[3][0] > colors[3][2]  # red


def test_a_trace_has_its_colours_on_a_page_that_was_there_before_it(page: Page, open_page: Open) -> None:
    """On a page that is opened before the arm moves, the trace is drawn in the colour of its path error."""
    start, end = np.array([-0.4, 0.0, 0.0]), np.array([0.4, 0.0, 0.0])
    camera = page.server.initial_camera
    camera.position, camera.look_at, camera.up = (0.0, -0.5, 0.5), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    line = LineScene(page, "/line", rx.LineTask(tuple(start), tuple(end)))
    shown = open_page(page.address, (900, 200), pictures="every")
    times = np.arange(100) * 0.1

    def run() -> None:
        line.follow(times[[0, -1]], np.stack([start, end]), np.array([True, True]))
        line.add(times, start + times[:, None] / times[-1] * (end - start) + [0.0, 1e-3, 0.0])
        line.draw()

    page.later(run)
    red = np.array([213, 60, 0])

    def is_drawn() -> bool:
        pixels = Image.open(io.BytesIO(shown.page.screenshot())).convert("RGB")
        return bool((np.abs(np.asarray(pixels, dtype=int) - red).max(axis=-1) < 25).sum() > 100)

    shown.wait_until(is_drawn, "the trace in red")


def test_a_port_that_is_taken_is_one_line() -> None:
    """A port on which somebody listens is refused by its number, and no other one is taken instead."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ConfigError, match=rf"127\.0\.0\.1 port {port}: .*; accepted: --port with a free one"):
            Page("test", port=port)


def test_a_browser_that_is_waited_for_does_not_hold_the_page(
    page: Page, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page goes on while a browser is opened, which some commands for it do until it is closed."""
    asked, closed = threading.Event(), threading.Event()

    def open_(_address: str) -> None:
        asked.set()
        closed.wait(60.0)

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(webbrowser, "open", open_)
    page.announce(browser=True)
    assert asked.wait(60.0)
    assert not closed.is_set()
    closed.set()
    said = capsys.readouterr().out
    assert f"page: {page.address}" in said
    assert "other machines" not in said  # which is said of a page that they reach


@pytest.fixture
def idle() -> Iterator[Page]:
    page = Page("test", port=0)
    yield page
    page.close()


def test_a_signal_that_is_handled_beyond_the_wait_does_not_stop_the_page(idle: Page) -> None:
    """It waits 50 ms at most for what is handed over, also where a signal takes longer than what is left of them."""
    handled, helped = [], threading.Event()

    def handle(_number: int, _frame: FrameType | None) -> None:
        handled.append(time.monotonic())
        time.sleep(0.1)

    rescue = threading.Timer(10.0, lambda: idle.later(helped.set))
    rescue.start()
    before = signal.signal(signal.SIGALRM, handle)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.02)
        idle.run(lambda: None, until=lambda: bool(handled) and time.monotonic() > handled[0] + 0.5)
    finally:
        signal.signal(signal.SIGALRM, before)
        rescue.cancel()
    assert not helped.is_set()


def test_a_page_outlives_viser_meeting_itself(idle: Page) -> None:
    """What viser raises where two of its threads wake clients at once ends nothing; other errors do."""
    calls: list[str] = []

    def call(error: str) -> None:
        calls.append(error)
        raise RuntimeError(error)

    for error in ("deque mutated during iteration", "something else"):
        idle.later(partial(call, error))
    with pytest.raises(RuntimeError, match="something else"):
        idle.run(lambda: None, until=lambda: len(calls) > 2)
    assert len(calls) == 2
