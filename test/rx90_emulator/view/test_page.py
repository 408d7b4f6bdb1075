"""The page in a real browser: arms where Pinocchio says, plots, its loop, and what it writes."""

from __future__ import annotations

import csv
import io
import logging
import queue
import signal
import socket
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from browser import BrowserPage, served
from PIL import Image
from pinocchio_chain import tip_pose
from processes import wait_until

from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.errors import ConfigError
from rx90_common.report.plot import Curve, Panel
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view import page as page_module
from rx90_emulator.view import plots
from rx90_emulator.view.page import ExistingFileError, Page, output_folder, output_path
from rx90_emulator.view.player import TrackPlot
from rx90_emulator.view.plots import LoopPlot, RollingPlot, RunComparison, add_plot_export, table
from rx90_emulator.view.recording import Track
from rx90_emulator.view.scene import ArmScene, LineScene

Open = Callable[..., BrowserPage]
POSE = np.array([0.4, -0.7, 1.9, 0.8, -0.9, 2.5])
JOINTS = [f"joint_{k}" for k in range(1, 7)]
PLACES = """() => [...document.querySelectorAll('.uplot')].map(plot => plot.getBoundingClientRect())
    .filter(({width}) => width > 0).map(({left, top, right, bottom}) => [left, top, right, bottom].map(Math.round))"""
TICKS = """() => Object.values(window.__viserTestpoints?.uplots ?? {}).map(({chart}) =>
    [chart.root.querySelector('.u-title')?.textContent ?? '', (chart.axes[1]._values ?? []).filter(text => text),
     [chart.scales.y.min, chart.scales.y.max]])"""
PIXEL = 1e-6  # m; positions go to the page as single precision
NOISE = 1e-7 * np.sin(np.arange(100.0) * 7.0)
NOISY = {"rest", "seldom known", "noisy loop", "recorded [rad]"}
START, END = np.array([0.5, 0.0, 0.2]), np.array([0.7, 0.0, 0.2])
LINE = LineTask(tuple(START), tuple(END))
SHARE = np.linspace(0.0, 1.0, 401)
ALONG = "path error along the line [mm]"
UNITS = "torque [Nm]"


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """Serve a page on any free port, which writes beneath a new folder."""
    with served(Page("test", port=0, output=tmp_path)) as page:
        yield page


@dataclass
class Shown:
    """A page as a browser has it, and what stands on it."""

    page: Page
    browser: BrowserPage
    arms: list[tuple[Setup, ArmScene]]
    rolling: RollingPlot
    broken: RollingPlot
    loop: LoopPlot
    noisy: tuple[RollingPlot, RollingPlot, LoopPlot, TrackPlot]
    line: LineScene
    runs: RunComparison


def test_what_the_page_was_given_is_what_the_browser_shows(
    shipped: Setup, tx40: Setup, page: Page, open_page: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Arms stand where Pinocchio says, plots hold their samples, noise reads as noise, and two runs are compared."""
    arms = [(setup, ArmScene(page, f"/{setup.robot.model.name}", setup.robot)) for setup in (shipped, tx40)]
    track, _ = Track.of(JointSeries("/joint_states", JOINTS[:1], np.arange(100) * 10**7, 1.57 + NOISE[:, None]))
    line = LineScene(page, "/line", shipped.robot, LINE)
    with page.plot_tab("Plots"):
        rolling = RollingPlot(page, "speed [rad/s]", ("joint_1", "joint_2"), (-1.0, 1.0))
        broken = RollingPlot(page, "broken", ("error",), (-1.0, 1.0), gaps=1)
        loop = LoopPlot(page, "loop", "x [rad]", "y [Nm]", (0.01, 0.01))
        noisy = (
            RollingPlot(page, "rest", ("joint_1",), (-0.01, 0.01)),
            RollingPlot(page, "seldom known", ("error",), (0.0, 0.01), gaps=1),
            LoopPlot(page, "noisy loop", "x [rad]", "y [Nm]", (0.01, 1.0)),
            TrackPlot(page, "recorded [rad]", [track], "position", 0),
        )
        runs = RunComparison(page)
    page.every(0.05, lambda _: runs.draw(line))
    browser = open_page(page.address, (1000, 700), pictures="few")
    shown = Shown(page, browser, arms, rolling, broken, loop, noisy, line, runs)
    _arms_are_drawn_where_pinocchio_says(shown)
    _plots_show_what_they_were_given(shown, monkeypatch)
    _noise_at_rest_reads_as_noise(shown)
    _two_runs_are_compared_along_the_line(shown)
    assert (shown.browser.complaints, shown.browser.foreign_requests) == ([], [])


def _arms_are_drawn_where_pinocchio_says(shown: Shown) -> None:
    """The tips' poses in the browser's own scene are those of the forward kinematics, and follow them."""

    def at(setup: Setup, arm: ArmScene, position: np.ndarray) -> bool:
        return bool(np.allclose(shown.browser.pose(arm.tip), tip_pose(setup.robot, position), atol=PIXEL))

    for position in (np.zeros(6), POSE):
        shown.page.later(lambda position=position: [arm.show(position) for _, arm in shown.arms])  # type: ignore[misc]
        for setup, arm in shown.arms:
            shown.browser.wait_until(partial(at, setup, arm, position), "the tip where it is by Pinocchio")


def _plots_show_what_they_were_given(shown: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rolling plot holds the samples of its window; a loop is drawn whole though its abscissa goes back."""
    browser, angle = shown.browser, np.linspace(0.0, 4.0 * np.pi, 100)

    def feed() -> None:
        for at in np.arange(0.0, 5.0, 0.1):
            shown.rolling.add(at, np.array([at, -at]))
            shown.broken.add(at, [np.nan if at < 0.25 or 1.95 < at < 3.05 else 1.0 + at])
        for a in angle:
            shown.loop.add(np.cos([a]), np.sin([a]))
        shown.broken.draw()
        with monkeypatch.context() as patch:
            patch.setattr(plots, "WINDOW", 2.0)
            shown.rolling.draw()
        shown.loop.draw()

    titles = {"speed [rad/s]": "time [s]", "broken": "time [s]", "loop": "x [rad]"}
    browser.wait_until(lambda: titles.keys() <= browser.plots().keys(), "the plots")
    assert {title: browser.plots()[title]["axes"][0] for title in titles} == titles
    empty = [np.array(column, float) for title in titles for column in browser.plots()[title]["data"][1:]]
    assert not any(np.isfinite(column).any() for column in empty)  # no line at 0
    shown.page.later(feed)
    # The page may get one plot's samples before another's.
    browser.wait_until(lambda: all(len(browser.plots()[title]["data"][0]) > 2 for title in titles), "samples")
    times, first, second = browser.plots()["speed [rad/s]"]["data"]
    np.testing.assert_allclose(times, np.arange(2.9, 4.95, 0.1))
    np.testing.assert_allclose([first, second], [times, np.negative(times)])
    # What is unknown is not drawn across: before the gap one curve, after it another.
    _, extent, early, late = (np.array(column, float) for column in browser.plots()["broken"]["data"])
    assert [np.isfinite(part).sum() for part in (early, late)] == [17, 19]
    assert (extent.min(), extent.max()) == (np.nanmin(early), np.nanmax(late))
    x, y = np.array(browser.plots()["loop"]["data"])
    assert x[0] == x.min()
    assert x[-1] == x.max()
    assert (x[:-1] < x[-1]).all()  # so that halving finds the two ends
    # Every sample is in it, and it never leaves the curve: steps are those of the circle.
    assert {(round(a, 9), round(b, 9)) for a, b in zip(np.cos(angle), np.sin(angle), strict=True)} <= {
        (round(a, 9), round(b, 9)) for a, b in zip(x, y, strict=True)
    }
    assert np.hypot(np.diff(x), np.diff(y)).max() < 1.01 * 2.0 * np.sin(2.0 * np.pi / 99)
    shown.page.later(shown.loop.clear)
    browser.wait_until(lambda: not np.isfinite(np.array(browser.plots()["loop"]["data"][1], float)).any(), "no loop")


def _noise_at_rest_reads_as_noise(shown: Shown) -> None:
    """Each tick of an ordinate has a text of its own, without -0, and noise far below what is measured stays flat."""
    rolling, known, loop, curves = shown.noisy

    def feed() -> None:
        for k, value in enumerate(NOISE):
            rolling.add(k * 0.01, [value])
            known.add(k * 0.01, [abs(value) if k > 50 else np.nan])
            loop.add(np.array([0.01 * k]), np.array([value]))
        for plot in (rolling, known, loop):
            plot.draw()
        curves.draw(0, 10**9, 0)

    shown.page.later(feed)

    def ticks() -> dict[str, Any]:
        found = shown.browser.page.evaluate(TICKS)
        return {title: (texts, ends) for title, texts, ends in found if title in NOISY and texts}

    shown.browser.wait_until(lambda: len(ticks()) == len(NOISY), "their ticks")
    for texts, (low, high) in ticks().values():
        assert len(set(texts)) == len(texts) > 2
        assert not {"-0", "-0.00", "-0.000"} & set(texts)
        assert high - low >= 0.01


def _two_runs_are_compared_along_the_line(shown: Shown) -> None:
    """The run that is held stays while others come: curves, largest, place, RMS and ratio; another line lets it go."""
    browser, page = shown.browser, shown.page
    hold, release = (browser.page.get_by_role("button", name=words) for words in ("Hold the", "Let the held"))
    assert hold.is_disabled()
    page.later(lambda: run(shown.line, 1.0, 1e-4))
    # A half sine of 0.1 mm: RMS of 0.1 / sqrt(2), the largest in the middle of 200 mm.
    browser.wait_until(lambda: "newest\t0.1000\t100\t0.0706" in browser.text(), "the first run")
    hold.click()
    browser.wait_until(release.is_visible, "that it is held")
    page.later(lambda: run(shown.line, 10.0, 2.5e-5))
    browser.wait_until(lambda: "newest\t0.0250\t100\t0.0177" in browser.text(), "the second run")
    assert "held\t0.1000\t100\t0.0706" in browser.text()
    assert "newest / held\t0.250\t\t0.250" in browser.text()
    way, _, held, newest = (np.array(column, float) for column in browser.plots()[ALONG]["data"])
    half = np.sin(np.pi * way / 200.0)
    np.testing.assert_allclose(held, 0.1 * half, atol=1e-3)
    np.testing.assert_allclose(newest, 0.025 * half, atol=3e-4)
    files = {curve.label: curve for curve in shown.runs.panel().marks if isinstance(curve, Curve)}
    np.testing.assert_allclose(files["held"].y, 0.1 * np.sin(np.pi * files["held"].x / 200.0), atol=1e-6)
    assert list(files) == ["held", "newest"]
    page.later(lambda: shown.line.place(replace(LINE, end=(0.8, 0.1, 0.3))))
    browser.wait_until(lambda: not release.is_visible(), "that it was let go")
    assert "0.1000" not in browser.text()


def run(line: LineScene, begin: float, largest: float) -> None:
    """Lead the tip along the line within 4 s, half a sine beside it, `largest` m in the middle."""
    times = begin + 4.0 * SHARE
    line.follow(times[[0, -1]], np.stack([START, END]), np.array([True, True]))
    line.add(times, START + SHARE[:, None] * (END - START) + np.outer(largest * np.sin(np.pi * SHARE), [0, 1.0, 0]))


def test_the_trace_is_drawn_beside_the_line(shipped: Setup, page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    """Magnified, the trace is so many times as far from the line as it was, blue to red; off it grey, in place."""
    made: dict[str, Any] = {}
    add = page.add_lines
    monkeypatch.setattr(page, "add_lines", lambda name, *a, **k: made.setdefault(name, add(name, *a, **k)))
    start, end = np.array([0.5, 0.0, 0.2]), np.array([0.9, 0.0, 0.2])
    line = LineScene(page, "/line", shipped.robot, LineTask(tuple(start), tuple(end)))
    tips = np.array([[0.5, 0.02, 0.2], [0.5, 0.0, 0.2], [0.6, 0.0, 0.2], [0.7, 1e-4, 0.2], [0.8, 0.0, 0.2]])
    line.follow(np.array([1.5, 9.0]), np.stack([start, end]), np.array([True, True]))
    line.add(np.arange(5.0), tips)
    line.magnify(100.0)
    line.draw()
    np.testing.assert_allclose(made["/line/line"].points[[0, -1], [0, 1]], [start, end], rtol=1e-6)
    trace = made["/line/trace"]
    drawn = np.concatenate([trace.points[:, 0], trace.points[-1:, 1]])
    np.testing.assert_allclose(drawn, [*tips[:3], [0.7, 1e-2, 0.2], tips[4]], atol=1e-6)
    colors = np.concatenate([trace.colors[:, 0], trace.colors[-1:, 1]]).astype(int)
    assert len(set(colors[0])) == 1  # grey
    assert colors[2][2] > colors[2][0]  # blue
    assert colors[3][0] > colors[3][2]  # red


def test_a_trace_has_its_colours_on_a_page_that_was_there_before_it(
    shipped: Setup, page: Page, open_page: Open
) -> None:
    """On a page that is opened before the arm moves, the trace is drawn in the colour of its path error."""
    start, end = np.array([-0.4, 0.0, 0.0]), np.array([0.4, 0.0, 0.0])
    camera = page.server.initial_camera
    camera.position, camera.look_at, camera.up = (0.0, -0.5, 0.5), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    line = LineScene(page, "/line", shipped.robot, LineTask(tuple(start), tuple(end)))
    shown = open_page(page.address, (900, 200), pictures="every")
    times = np.arange(100) * 0.1

    def run() -> None:
        line.follow(times[[0, -1]], np.stack([start, end]), np.array([True, True]))
        line.add(times, start + times[:, None] / times[-1] * (end - start) + [0.0, 1e-3, 0.0])
        line.magnify(20.0)
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


def test_a_connection_that_is_closed_early_is_no_traceback(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Who connects and leaves before anything is asked for is not told of, also as the first of all."""
    monkeypatch.setattr(logging.getLogger("websockets.server"), "filters", [])  # those of other pages
    with served(Page("test", port=0)) as page:
        place = urlsplit(page.address)
        for words in (b"", b"GET / HTTP/1.1\r\n"):
            with socket.create_connection((place.hostname, place.port)) as early:
                early.sendall(words)
                early.shutdown(socket.SHUT_WR)
                early.settimeout(10.0)
                while early.recv(4096):  # until the server has let it go, and said what it has to say
                    pass
    assert caplog.records == []


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


def test_on_a_telephone_the_arm_is_above_the_panels(shipped: Setup, page: Page, open_page: Open) -> None:
    """In an upright window the camera is farther away and looks below the arm; in a wide one it is where it was.

    The plots are a drawer of the panel there, closed at first; a tap opens them, below each other and beside the arm.
    """
    page.look_at_arm(shipped.robot)
    first = page.server.initial_camera
    length = float(np.linalg.norm(first.position - first.look_at))
    seen: list[Any] = []
    page.server.on_client_connect(seen.append)
    with page.plot_tab("Friction"):
        for title in ("torque", "deflection"):
            RollingPlot(page, title, JOINTS, (-1.0, 1.0))

    def looks(count: int, away: float, lower: bool) -> bool:
        if len(seen) < count:
            return False
        camera = seen[-1].camera
        distance = float(np.linalg.norm(camera.position - camera.look_at))
        return abs(distance / length / away - 1.0) < 0.02 and bool(camera.look_at[2] < 0.0) is lower

    shown = open_page(page.address, (390, 844))
    wait_until(lambda: looks(1, 0.9 * 844 / 390, True), "the page's camera")
    assert shown.page.evaluate(PLACES) == []
    shown.page.get_by_text("Friction", exact=True).click()

    def as_wide_as_the_panel() -> bool:  # they grow to its width
        places = shown.page.evaluate(PLACES)
        if len(places) != 2:
            return False
        (left, top, right, bottom), below = places
        as_wide = 0 <= left < right - 200 < right <= 390 and [below[0], below[2]] == [left, right]
        return bool(as_wide and top + 150 < bottom <= below[1])

    def beside_the_arm() -> bool:
        shown.page.locator(".uplot").nth(1).scroll_into_view_if_needed()
        *_, (_, top, _, bottom) = shown.page.evaluate(PLACES)
        return bool(844 // 3 < top < bottom <= 844)

    shown.wait_until(as_wide_as_the_panel, "two plots below each other")
    shown.wait_until(beside_the_arm, "the plots beside the arm, not over it")
    names = shown.page.locator(".u-legend .u-label")
    shown.wait_until(lambda: set(names.all_inner_texts()) >= set(JOINTS), "the joints' names")
    open_page(page.address, (900, 600))
    wait_until(lambda: looks(2, 1.0, False), "the other page's camera")


class Clock:
    """Time that goes on by what is waited for, s; stands for the queue of what is handed over, too."""

    def __init__(self) -> None:
        self.now = 100.0

    def get(self, timeout: float) -> None:
        """Wait in vain."""
        self.now += timeout
        raise queue.Empty


@pytest.fixture
def idle() -> Iterator[Page]:
    """Give a page that no thread runs."""
    page = Page("test", port=0)
    yield page
    page.close()


def test_while_time_hurries_calls_come_a_third_as_often(idle: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of calls every 0.1 s, in 6 s of a hurry every third is made, and later all, on time."""
    clock, made = Clock(), list[float]()
    monkeypatch.setattr(page_module, "time", SimpleNamespace(monotonic=lambda: clock.now))
    monkeypatch.setattr(idle, "_handed_over", clock)
    idle.every(0.1, made.append, busy=lambda now: now < 105.95)
    idle.run(until=lambda: clock.now >= 110.02)
    expected = np.concatenate([np.arange(100.0, 106.1, 0.3), np.arange(106.1, 110.05, 0.1)])
    np.testing.assert_allclose(made, expected, atol=1e-6)


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
        idle.run(until=lambda: bool(handled) and time.monotonic() > handled[0] + 0.5)
    finally:
        signal.signal(signal.SIGALRM, before)
        rescue.cancel()
    assert not helped.is_set()


def test_a_plot_is_written_as_picture_and_table(
    page: Page, open_page: Open, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What stands on the page stands in the files to the bit; a file that is there is replaced once that is said."""
    monkeypatch.setattr(plots, "WINDOW", 1.0)
    plot = RollingPlot(page, UNITS, ["joint_1", "joint_2"], (-1.0, 1.0))
    rows = np.array([[0.1 * k, np.sin(k), 1.0 / (k + 1)] for k in range(40)])
    with page.tab("Files"):
        add_plot_export(page)
    shown = open_page(page.address, (1000, 700))

    def press(words: str) -> None:
        shown.page.get_by_role("button", name=words).click()

    def add() -> None:
        for row in rows:
            plot.add(row[0], row[1:])

    press("Write the CSV")
    shown.wait_until(lambda: "plot.csv" in shown.text(), "an empty table")
    assert (tmp_path / "plot.csv").read_text() == f"time [s],joint_1: {UNITS},joint_2: {UNITS}\n"
    page.later(add)
    page.later(plot.draw)
    press("Write the CSV")
    shown.wait_until(lambda: "plot.csv exists" in shown.text(), "the refusal")
    assert len((tmp_path / "plot.csv").read_text().splitlines()) == 1
    press("Replace the file")
    shown.wait_until(lambda: len((tmp_path / "plot.csv").read_text().splitlines()) > 1, "the table")
    head, *body = csv.reader((tmp_path / "plot.csv").read_text().splitlines())
    window = rows[rows[:, 0] >= rows[-1, 0] - 1.0]
    assert head == ["time [s]", f"joint_1: {UNITS}", f"joint_2: {UNITS}"]
    assert np.array(body, float).tolist() == window.tolist()
    press("Write the PNG")
    shown.wait_until((tmp_path / "plot.png").exists, "the picture")
    shown.wait_until(lambda: "written: " in shown.text(), "the word")
    with Image.open(tmp_path / "plot.png") as picture:
        colours = {pixel for _, pixel in picture.convert("RGB").getcolors(1 << 20) or []}
    assert {(0, 0x72, 0xB2), (0xD5, 0x5E, 0)} <= colours  # both curves
    shown.page.locator("input[type=text], input:not([type])").last.fill("../plot")
    press("Write the PNG")
    shown.wait_until(lambda: "../plot.png" in shown.text(), "the refusal of a way out")
    assert not (tmp_path.parent / "plot.png").exists()
    assert shown.complaints == []


def test_curves_with_times_of_their_own_have_columns_of_their_own() -> None:
    """Each abscissa stands before its first curve; where there is no number nothing stands."""
    near, far = np.array([0.0, 0.1]), np.array([0.0, 0.5, 1.0])
    panel = Panel(
        [Curve(near, near + 1.0, "a"), Curve(near, np.array([np.nan, 1 / 3]), "b"), Curve(far, far, "c")], "", "t", "y"
    )
    assert list(csv.reader(table(panel).splitlines())) == [
        ["t", "a: y", "b: y", "c: t", "c: y"],
        ["0.0", "1.0", "", "0.0", "0.0"],
        ["0.1", "1.1", repr(1 / 3), "0.5", "0.5"],
        ["", "", "", "1.0", "1.0"],
    ]


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """Return a folder with files, folders and links in it, and a file beside it."""
    (tmp_path / "beside.yaml").write_text("beside")
    folder = tmp_path / "page"
    (folder / "sub").mkdir(parents=True)
    (folder / "there.yaml").write_text("there")
    (folder / "out").symlink_to(tmp_path)
    (folder / "link.yaml").symlink_to(tmp_path / "beside.yaml")
    (folder / "nowhere.yaml").symlink_to(tmp_path / "nowhere.yaml")
    return output_folder(folder)


@pytest.mark.parametrize("name", ["new.yaml", "sub/new.yaml", "two words.yaml", "~", "sub//new.yaml"])
def test_new_names_beneath_the_folder_are_taken(output: Path, name: str) -> None:
    """A name that is free gives a path beneath the folder, in which nothing is made."""
    path = output_path(output, name)
    assert path.parent in {output, output / "sub"}
    assert not path.exists()


@pytest.mark.parametrize("replace", [False, True])
@pytest.mark.parametrize(
    "name",
    ["", " ", "..", ".", "../beside.yaml", "sub/../../beside.yaml", "sub/../there.yaml", "/etc/passwd", "/", ".bashrc",
     "sub/.git", "out/beside.yaml", "out/new.yaml", "link.yaml", "nowhere.yaml", "sub", "missing/new.yaml",
     "there.yaml/new.yaml", "a\0b", "a\nb", "x" * 300, "x" * 300 + "/y"],
)  # fmt: skip
def test_what_leads_elsewhere_is_refused_also_when_confirmed(output: Path, name: str, replace: bool) -> None:
    """No `..`, absolute path, hidden name, link or folder is taken; the refusal is one line that says what is."""
    with pytest.raises(ConfigError, match="; accepted: a new name beneath") as refusal:
        output_path(output, name, replace=replace)
    assert "\n" not in str(refusal.value)


def test_a_file_that_is_there_is_taken_only_when_confirmed_and_a_folder_is_made_or_refused(output: Path) -> None:
    """Without a confirmation the refusal names the file, and is told from the others; so is a file for a folder."""
    with pytest.raises(ExistingFileError, match=r"there\.yaml exists; accepted: a new name beneath"):
        output_path(output, "there.yaml")
    assert output_path(output, "there.yaml", replace=True).read_text() == "there"
    assert output_folder(output / "a" / "b").is_dir()
    with pytest.raises(ConfigError, match=r"yaml: cannot be written \(.*\); accepted: a folder that exists or can"):
        output_folder(output / "there.yaml")
