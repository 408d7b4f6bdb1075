"""The page in a real browser: the arm where Pinocchio says, plots that move, nothing from another machine."""

from __future__ import annotations

import io
import logging
import socket
import threading
import webbrowser
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pinocchio as pin
import pytest
from browser import BrowserPage, served
from PIL import Image
from processes import wait_until

from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.errors import ConfigError
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.bag_plots import CurvesPlot, RecordedCurve
from rx90_emulator.view.page import Page, reached_by_others
from rx90_emulator.view.plots import LoopPlot, RollingPlot
from rx90_emulator.view.scene import ArmScene, LineScene, error_colors
from rx90_emulator.view.track import Track

Open = Callable[..., BrowserPage]
POSE = np.array([0.4, -0.7, 1.9, 0.8, -0.9, 2.5])
JOINTS = [f"joint_{k}" for k in range(1, 7)]
PLACES = """() => [...document.querySelectorAll('.uplot')].map(plot => plot.getBoundingClientRect())
    .filter(({width}) => width > 0).map(({left, top, right, bottom}) => [left, top, right, bottom].map(Math.round))"""
TICKS = """() => Object.values(window.__viserTestpoints?.uplots ?? {}).map(({chart}) =>
    [(chart.axes[1]._values ?? []).filter(text => text), [chart.scales.y.min, chart.scales.y.max]])"""
PIXEL = 1e-6  # m; positions go to the page as single precision


@pytest.fixture
def page() -> Iterator[Page]:
    """Serve a page on any free port."""
    with served(Page("test", port=0)) as page:
        yield page


def tip(setup: Setup, position: np.ndarray) -> np.ndarray:
    """Return the pose (4, 4) of the tool centre point by Pinocchio, from the URDF's text."""
    model = pin.buildModelFromXML(setup.robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, position)
    return np.asarray(data.oMf[model.getFrameId(setup.robot.tcp_frame)].homogeneous)


def test_arms_are_drawn_where_pinocchio_says(shipped: Setup, tx40: Setup, page: Page, open_page: Open) -> None:
    """The tips' poses in the browser's own scene are those of the forward kinematics, and follow them."""
    arms = [(setup, ArmScene(page, f"/{setup.robot.model.name}", setup.robot)) for setup in (shipped, tx40)]
    shown = open_page(page.address)

    def at(setup: Setup, arm: ArmScene, position: np.ndarray) -> bool:
        return bool(np.allclose(shown.pose(arm.tip), tip(setup, position), atol=PIXEL))

    for position in (np.zeros(6), POSE):
        page.later(lambda position=position: [arm.show(position) for _, arm in arms])  # type: ignore[misc]
        for setup, arm in arms:
            shown.wait_until(partial(at, setup, arm, position), "the tip where it is by Pinocchio")
    assert (shown.complaints, shown.foreign_requests) == ([], [])


def test_plots_show_what_they_were_given(page: Page, open_page: Open) -> None:
    """A rolling plot holds the samples of its window; a loop is drawn whole though its abscissa goes back."""
    with page.plot_tab("Plots"):
        rolling = RollingPlot(page, "speed [rad/s]", ("joint_1", "joint_2"), window=2.0)
        broken = RollingPlot(page, "broken", ("error",), legend=False, gaps=1)
        loop = LoopPlot(page, "loop", "x [rad]", "y [Nm]", least=(0.01, 0.01))
    angle = np.linspace(0.0, 4.0 * np.pi, 100)

    def feed() -> None:
        for time in np.arange(0.0, 5.0, 0.1):
            rolling.add(time, np.array([time, -time]))
            broken.add(time, [np.nan if time < 0.25 or 1.95 < time < 3.05 else 1.0 + time])
        for a in angle:
            loop.add(np.cos([a]), np.sin([a]))
        rolling.draw()
        broken.draw()
        loop.draw()

    shown = open_page(page.address)
    titles = {"speed [rad/s]": "time [s]", "broken": "time [s]", "loop": "x [rad]"}
    shown.wait_until(lambda: set(titles) == set(shown.plots()), "the plots")
    assert {title: plot["axes"][0] for title, plot in shown.plots().items()} == titles
    assert not np.isfinite([column for plot in empty(shown) for column in plot]).any()  # no line at 0
    page.later(feed)
    # The page may get one plot's samples before another's.
    shown.wait_until(lambda: all(len(plot["data"][0]) > 2 for plot in shown.plots().values()), "samples")
    times, first, second = shown.plots()["speed [rad/s]"]["data"]
    np.testing.assert_allclose(times, np.arange(2.9, 4.95, 0.1))
    np.testing.assert_allclose([first, second], [times, np.negative(times)])
    # What is unknown is not drawn across: before the gap one curve, after it another.
    _, extent, early, late = (np.array(column, float) for column in shown.plots()["broken"]["data"])
    assert [np.isfinite(part).sum() for part in (early, late)] == [17, 19]
    assert (extent.min(), extent.max()) == (np.nanmin(early), np.nanmax(late))
    x, y = np.array(shown.plots()["loop"]["data"])
    assert x[0] == x.min()
    assert x[-1] == x.max()
    assert (x[:-1] < x[-1]).all()  # so that halving finds the two ends
    # Every sample is in it, and it never leaves the curve: steps are those of the circle.
    assert {(round(a, 9), round(b, 9)) for a, b in zip(np.cos(angle), np.sin(angle), strict=True)} <= {
        (round(a, 9), round(b, 9)) for a, b in zip(x, y, strict=True)
    }
    assert np.hypot(np.diff(x), np.diff(y)).max() < 1.01 * 2.0 * np.sin(2.0 * np.pi / 99)
    page.later(loop.clear)
    shown.wait_until(lambda: not np.isfinite(np.array(shown.plots()["loop"]["data"][1], float)).any(), "an empty loop")


def test_noise_at_rest_reads_as_noise(page: Page, open_page: Open) -> None:
    """Each tick of an ordinate has a text of its own, without -0, and noise far below what is measured stays flat."""
    noise = 1e-7 * np.sin(np.arange(100.0) * 7.0)
    track, _ = Track.of(JointSeries("/joint_states", JOINTS[:1], np.arange(100) * 10**7, 1.57 + noise[:, None]))
    with page.plot_tab("Plots"):
        rolling = RollingPlot(page, "rest", ("joint_1",), least=0.01)
        known = RollingPlot(page, "seldom known", ("error",), least=0.01, low=0.0, gaps=1)
        loop = LoopPlot(page, "loop", "x [rad]", "y [Nm]", least=(0.01, 1.0))
        curves = CurvesPlot(page, "recorded", [RecordedCurve("", track, "position", 0, 1.0, "#000000")], 0, least=0.01)
    for k, value in enumerate(noise):
        rolling.add(k * 0.01, [value])
        known.add(k * 0.01, [abs(value) if k > 50 else np.nan])
        loop.add(np.array([0.01 * k]), np.array([value]))
    for plot in (rolling, known, loop):
        plot.draw()
    curves.draw(0, 10**9, 0)
    shown = open_page(page.address)
    shown.wait_until(lambda: len(shown.page.evaluate(TICKS)) == 4, "the plots")

    def ticks() -> list[list[str]]:
        return [texts for texts, _ in shown.page.evaluate(TICKS) if texts]

    shown.wait_until(lambda: len(ticks()) == 4, "their ticks")
    for texts in ticks():
        assert len(set(texts)) == len(texts) > 2
        assert not {"-0", "-0.00", "-0.000"} & set(texts)
    assert all(high - low >= 0.01 for _, (low, high) in shown.page.evaluate(TICKS))


def empty(shown: BrowserPage) -> list[list[np.ndarray]]:
    """Return the ordinates of all plots."""
    return [[np.array(column, float) for column in plot["data"][1:]] for plot in shown.plots().values()]


def test_the_trace_is_drawn_beside_the_line(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    """Magnified, the trace is so many times as far from the line as it was, blue to red; off it grey, in place."""
    made = {}
    add = page.scene.add_line_segments
    monkeypatch.setattr(
        page.scene, "add_line_segments", lambda name, *a, **k: made.setdefault(name, add(name, *a, **k))
    )
    start, end = np.array([0.5, 0.0, 0.2]), np.array([0.9, 0.0, 0.2])
    line = LineScene(page, "/line", start, end)
    tips = np.array([[0.5, 0.02, 0.2], [0.5, 0.0, 0.2], [0.6, 0.0, 0.2], [0.7, 1e-4, 0.2], [0.8, 0.0, 0.2]])
    line.meter.follow(np.array([1.5, 9.0]), np.stack([start, end]), np.array([True, True]))
    line.add(np.arange(5.0), tips)
    line.magnify(100.0)
    line.draw()
    np.testing.assert_allclose(made["/line/line"].points, [[start, end]], rtol=1e-6)
    trace = made["/line/trace"]
    drawn = np.concatenate([trace.points[:, 0], trace.points[-1:, 1]])
    np.testing.assert_allclose(drawn, [*tips[:3], [0.7, 1e-2, 0.2], tips[4]], atol=1e-6)
    colors = np.concatenate([trace.colors[:, 0], trace.colors[-1:, 1]]).astype(int)
    assert len(set(colors[0])) == 1  # grey
    assert colors[2][2] > colors[2][0]  # blue
    assert colors[3][0] > colors[3][2]  # red


def test_a_trace_has_its_colours_on_a_page_that_was_there_before_it(page: Page, open_page: Open) -> None:
    """On a page that is opened before the arm moves, the trace is drawn in the colour of its path error."""
    start, end = np.array([-0.4, 0.0, 0.0]), np.array([0.4, 0.0, 0.0])
    camera = page.server.initial_camera
    camera.position, camera.look_at, camera.up = (0.0, -0.5, 0.5), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    line = LineScene(page, "/line", start, end)
    shown = open_page(page.address, (900, 200), every_picture=True)
    times = np.arange(100) * 0.1

    def run() -> None:
        line.meter.follow(times[[0, -1]], np.stack([start, end]), np.array([True, True]))
        line.add(times, start + times[:, None] / times[-1] * (end - start) + [0.0, 1e-3, 0.0])
        line.magnify(20.0)
        line.draw()

    page.later(run)
    red = np.array(error_colors(np.array([1.0]))[0], dtype=int)

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
    assert f"page: {page.address}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("host", "open_to_others"),
    [("127.0.0.1", False), ("localhost", False), ("::1", False), ("0.0.0.0", True), ("::", True), ("192.0.2.1", True)],
)
def test_a_page_that_others_can_open_is_told(host: str, open_to_others: bool) -> None:
    """Addresses of this machine alone are told from those that others reach."""
    assert reached_by_others(host) is open_to_others


def check_drawer(shown: BrowserPage) -> None:
    """Fail unless a tap opens the plots of a telephone, below each other, within its width, each as a whole."""
    assert shown.page.evaluate(PLACES) == []
    shown.page.get_by_text("Friction", exact=True).click()

    def below_each_other() -> bool:
        places = shown.page.evaluate(PLACES)
        if len(places) != 2:
            return False
        (left, top, right, bottom), below = places
        as_wide = 0 <= left < right - 200 < right <= 390 and [below[0], below[2]] == [left, right]
        return bool(as_wide and top + 150 < bottom <= below[1])

    shown.wait_until(below_each_other, "two plots as wide as the panel")  # they grow to its width

    def beside_the_arm() -> bool:
        shown.page.locator(".uplot").nth(1).scroll_into_view_if_needed()
        *_, (_, top, _, bottom) = shown.page.evaluate(PLACES)
        return bool(844 // 3 < top < bottom <= 844)

    shown.wait_until(beside_the_arm, "the plots beside the arm, not over it")
    names = shown.page.locator(".u-legend .u-label")
    shown.wait_until(lambda: set(names.all_inner_texts()) >= set(JOINTS), "the joints' names")


def test_on_a_telephone_the_arm_is_above_the_panels(shipped: Setup, page: Page, open_page: Open) -> None:
    """In an upright window the camera is farther away and looks below the arm; in a wide one it is where it was.

    The plots are a drawer of the panel there, closed at first.
    """
    page.look_at_arm(shipped.robot)
    first = page.server.initial_camera
    length = float(np.linalg.norm(first.position - first.look_at))
    seen: list[Any] = []
    page.server.on_client_connect(seen.append)
    with page.plot_tab("Friction"):
        for title in ("torque", "deflection"):
            RollingPlot(page, title, JOINTS)
    for size, away, lower in (((390, 844), 0.9 * 844 / 390, True), ((900, 600), 1.0, False)):
        shown = open_page(page.address, size)

        def looks(away: float, lower: bool) -> bool:
            camera = seen[-1].camera
            distance = float(np.linalg.norm(camera.position - camera.look_at))
            return abs(distance / length / away - 1.0) < 0.02 and bool(camera.look_at[2] < 0.0) is lower

        count = 1 if lower else 2
        wait_until(partial(lambda *of: len(seen) == of[0] and looks(*of[1:]), count, away, lower), "the page's camera")
        if lower:
            check_drawer(shown)
