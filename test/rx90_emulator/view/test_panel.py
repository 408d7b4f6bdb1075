"""The panel that moves the arm: who may, what a locked or foreign client cannot, and what its sliders send."""

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import msgspec
import numpy as np
import pytest
import viser
from browser import BrowserPage, served
from hostile_texts import TEXTS, check_harmless, hostile_robot
from pinocchio_chain import tip_place
from processes import Processes, wait_until
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

import rx90_emulator as rx
from rx90_common.exchange.arm_watch import ArmWatch, JointSample, NodeStatus
from rx90_common.exchange.client_node import client_node
from rx90_controller.lines.plan import APPROACH_ACCELERATION, LinePlan
from rx90_controller.lines.task import TOOL_DOWN, LineTask
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_emulator.view import live as live_module
from rx90_emulator.view import panel as panel_module
from rx90_emulator.view.live import LiveView
from rx90_emulator.view.page import Page
from rx90_emulator.view.panel import TRIES, ControlPanel, Jogs, Lock, jog

Open = Callable[..., BrowserPage]
START, END = np.array([0.6, -0.05, 0.2]), np.array([0.62, 0.05, 0.19])
LINE = LineTask(tuple(START), tuple(END), 0.25, 2.0, TOOL_DOWN, TOOL_DOWN)
FIELD = "//*[starts-with(normalize-space(text()), \"{}\")]/following::input[not(@type='hidden')][1]"
SIZE = (420, 640)  # a small scene, because it is drawn in software
VISER = Subprotocol(f"viser-v{viser.__version__}")
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [0, 0, 1], "fov": 1, "near": 0.1, "far": 10,
    "image_height": 100, "image_width": 100, "look_at": [0, 0, 0], "up_direction": [0, 0, 1],
}  # fmt: skip
"""With its first camera a client is there for viser."""


@pytest.fixture(scope="module")
def plan(shipped: rx.Setup) -> LinePlan:
    return rx.plan_path(shipped, LINE)


class Stranger:
    """A page of another origin: its own web socket to the page, on which it may send whatever it likes."""

    def __init__(self, page: Page) -> None:
        address = f"ws://{urlsplit(page.address).netloc}"
        origin = Origin("http://evil.example")
        self._socket: ClientConnection = connect(
            address, origin=origin, subprotocols=[VISER], compression=None, max_size=None
        )
        self.send(**CAMERA)

    def send(self, **message: object) -> None:
        self._socket.send(msgspec.msgpack.encode(message))

    def change(self, field: Any, value: object) -> None:
        """Send what viser's own client sends when a user has changed a field, or pressed a button."""
        self.send(type="GuiUpdateMessage", uuid=field._impl.uuid, updates={"value": value})

    def give(self, form: Any, code: str) -> None:
        _, field, button = form
        self.change(field, code)
        self.change(button, True)

    def close(self) -> None:
        self._socket.close()


@pytest.mark.ros
def test_who_has_the_code_moves_the_arm_and_nobody_else(
    processes: Processes, shipped: rx.Setup, plan: LinePlan, open_page: Open, capfd: pytest.CaptureFixture[str]
) -> None:
    """In Chromium, with real nodes: code, slider, line, torque; five wrong codes of another page lock for good."""
    pose = (plan.start_pose + 0.03).round(4).tolist()
    processes.start("rx90_cell", "--ros-args", "-p", f"rx90_sim:initial_position:={pose}")
    with client_node("test_view", 5.0, print) as client:
        page = Page("test", port=0)
        watch = ArmWatch(client.node, "/rx90_controller", shipped.robot.joint_names)
        states: list[JointSample] = []
        page.every(0.05, lambda _: states.extend(watch.joints()))
        newest = lambda: states[-1] if states else None  # noqa: E731
        panel = ControlPanel(page, client, shipped, plan, newest, "/rx90_controller")
        with served(page):
            first = open_page(page.address, SIZE)
            first.wait_until(lambda: bool(states), "states of the arm")
            unlock(first, panel.lock.code)
            first.wait_until(lambda: first.button("Send the line").is_visible(), "the inputs")
            _a_slider_moves_its_joint(first, panel, states)
            _a_stranger_does_not(page, panel, states)
            second = open_page(page.address, SIZE)
            assert not second.button("Send the line").is_visible()
            for left in reversed(range(TRIES)):
                unlock(second, f"WRONG{left}")
                said = f"left for all pages together: {left}" if left else "no further page is unlocked"
                second.wait_until(lambda said=said: said in second.text(), said)  # type: ignore[misc]
            second.wait_until(lambda: not second.button("Unlock").is_visible(), "no form")
            assert not panel.lock.opens(panel.lock.code)
            assert f"rx90 view: {panel_module._SHUT}\n" in capfd.readouterr().err
            first.button("Send the line").click()
            tip = lambda: tip_place(shipped.robot, states[-1].position)  # noqa: E731
            first.wait_until(lambda: bool(np.linalg.norm(tip() - END) < 1e-4), "the end of the line")
            first.button("Torque off").click()
            first.wait_until(lambda: "torque off, brakes closed" in first.text().split("deg")[-1], "the answer")
            third = open_page(page.address, SIZE)
            third.wait_until(lambda: "no further page is unlocked" in third.text(), "that it is locked")
            assert not third.button("Unlock").is_visible()
            assert [(shown.complaints, shown.foreign_requests) for shown in (first, second, third)] == [([], [])] * 3


def unlock(shown: BrowserPage, code: str) -> None:
    shown.page.locator(FIELD.format("code")).first.fill(code)
    shown.page.wait_for_timeout(1000)  # of what is changed within 50 ms viser's client sends the last later
    shown.button("Unlock").click()


def _a_slider_moves_its_joint(shown: BrowserPage, panel: ControlPanel, states: list[JointSample]) -> None:
    before = np.degrees(states[-1].position)
    asked = round(float(before[0]) + 5.0, 1)
    shown.page.locator(FIELD.format("joint")).first.fill(f"{asked}")
    shown.wait_until(lambda: bool(abs(np.degrees(states[-1].position[0]) - asked) < 0.02), "joint 1 at its slider")
    np.testing.assert_allclose(np.degrees(states[-1].position)[1:], before[1:], atol=0.05)
    ((slider, *_),) = panel._sliders.values()
    wait_until(lambda: bool(slider.value == asked), "the slider where its joint is")


def _a_stranger_does_not(page: Page, panel: ControlPanel, states: list[JointSample]) -> None:
    """It knows what the inputs are called, and sends what they would send; its own form is asked without a code."""
    ((slider, *_),) = panel._sliders.values()
    wait_until(lambda: float(np.abs(states[-1].position - states[-50].position).max()) < 5e-5, "the arm to rest")
    before = states[-1].position
    value = slider.value
    stranger = Stranger(page)
    wait_until(lambda: bool(panel._forms), "the stranger's form")
    ((_, code, button),) = panel._forms.values()
    stranger.change(button, True)
    for field in (slider, code):
        stranger.change(field, 30.0)
    seen = len(states)
    wait_until(lambda: len(states) > seen + 50, "half a second")
    np.testing.assert_allclose(states[-1].position, before, atol=2e-4)
    assert (slider.value, panel.lock.left) == (value, TRIES)
    stranger.close()
    wait_until(lambda: not panel._forms, "that it is forgotten")


class Bench:
    """A panel without nodes: an arm that stands still, and what is sent to a controller."""

    def __init__(self, setup: rx.Setup, plan: LinePlan, monkeypatch: pytest.MonkeyPatch) -> None:
        self.offered: list[TrajectoryPoints | None] = []
        self.asked: list[Any] = []
        self.hear: Callable[[str, str, bool], None] = lambda *_: None
        self.arm: JointSample | None = JointSample(0.0, plan.start_pose, np.zeros(6), np.zeros(6))
        calls = SimpleNamespace(ask=lambda request, _: self.asked.append(request), look=lambda: None)
        trajectories = SimpleNamespace(offer=lambda _, points: self.offered.append(points))
        monkeypatch.setattr(panel_module, "ServiceCalls", lambda _: calls)
        monkeypatch.setattr(panel_module, "TrajectoryClient", lambda *_: trajectories)
        monkeypatch.setattr(panel_module, "subscribe_log", lambda _, __, hear: setattr(self, "hear", hear))
        self.page = Page("test", port=0)
        client: Any = SimpleNamespace(spin=lambda _: None)
        self.panel = ControlPanel(self.page, client, setup, plan, lambda: self.arm, "rx90_controller")

    def stranger(self) -> tuple[Stranger, Any]:
        before = set(self.panel._forms)
        stranger = Stranger(self.page)
        wait_until(lambda: set(self.panel._forms) > before, "its form")
        return stranger, self.panel._forms[max(self.panel._forms)]


@pytest.fixture
def bench(shipped: rx.Setup, plan: LinePlan, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    bench = Bench(shipped, plan, monkeypatch)
    with served(bench.page):
        yield bench


def test_what_no_input_offers_does_nothing(bench: Bench) -> None:
    """Of an unlocked client, too: no number, none of the slider's; viser's tunnel is made for nobody."""
    known, form = bench.stranger()
    known.give(form, bench.panel.lock.code)
    wait_until(lambda: bool(bench.panel._sliders), "its inputs")
    ((slider, *_),) = bench.panel._sliders.values()
    known.send(type="ShareUrlRequest")
    for value in (float("nan"), float("inf"), 1e9, -1e9, "x", [1.0], None):
        known.change(slider, value)
    known.change(slider, 12.3)
    wait_until(lambda: bool(bench.offered), "the value that can be")
    (points,) = bench.offered
    assert np.degrees(points.position[-1][0]) == pytest.approx(12.3)
    assert bench.page.server.request_share_url() is None
    assert bench.page.server._share_tunnel is None
    known.close()


def test_a_code_has_eight_characters_that_cannot_be_mistaken() -> None:
    """Each start makes another; small letters and blanks around it do not matter; after five wrong ones none opens."""
    codes = {Lock().code for _ in range(50)}
    assert len(codes) == 50
    assert {len(code) for code in codes} == {8}
    assert not set("01OIL") & set("".join(codes))
    lock = Lock()
    assert lock.opens(f" {lock.code.lower()}\n")
    assert [lock.opens(f"{lock.code}X") for _ in range(TRIES)] == [False] * TRIES
    assert not lock.opens(lock.code)


def test_texts_of_files_and_nodes_are_texts_on_the_page(
    plan: LinePlan, task_file: Path, tmp_path: Path, open_page: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In Chromium: names of joints at sliders, of nodes and robots, what these say of themselves, and lines of logs."""
    setup = rx.Setup.load(hostile_robot(tmp_path, task_file))
    bench = Bench(setup, plan, monkeypatch)
    watch = SimpleNamespace(
        trajectory=None, publishers=1, robot=TEXTS[5], problem="", topic="", look_around=lambda: None, joints=list,
        diagnostics={text: NodeStatus(2, text, {"brakes": text, text: text}) for text in TEXTS},
    )  # fmt: skip
    monkeypatch.setattr(live_module, "ArmWatch", lambda *_: watch)
    client: Any = SimpleNamespace(node=None)
    LiveView(bench.page, client, setup.robot, "rx90_controller", None)
    with served(bench.page):
        shown = open_page(bench.page.address, SIZE)
        unlock(shown, bench.panel.lock.code)
        shown.wait_until(lambda: f"{TEXTS[5]}, deg" in shown.text(), "the sliders")
        for text in TEXTS:
            bench.hear(text, text, True)
        shown.wait_until(lambda: f"{TEXTS[0]} {TEXTS[0]}" in shown.text(), "the lines")
        check_harmless(shown, *(f"{text} {text}" for text in TEXTS), *(f"{text}, deg" for text in TEXTS))
        shown.page.get_by_role("tab", name="Live").click()
        shown.wait_until(lambda: TEXTS[5] in shown.text(), "what nodes say")
        check_harmless(shown, f"The simulation's robot is {TEXTS[5]}")
        assert (shown.complaints, shown.foreign_requests) == ([], [])


ZERO = np.zeros(6)
ARM = np.radians([0.0, 5.0, 10.0, 15.0, 20.0, 25.0])


def test_a_jog_is_as_short_as_speed_and_acceleration_allow(shipped: rx.Setup) -> None:
    """From rest it lasts what a quintic needs, 15/8 d/v or sqrt(10/sqrt(3) d/a), and at most 16 % more."""
    limits = shipped.controller.limits(shipped.robot)
    for joint, way in ((0, 0.01), (1, -1.0), (5, 4.0)):
        target = ZERO.copy()
        target[joint] = way
        points = jog(ZERO, ZERO, target, limits)
        needed = max(15 / 8 * abs(way) / (0.25 * limits.velocity[joint]), np.sqrt(10 / np.sqrt(3) * abs(way) / 2.0))
        assert needed * 0.99 <= points.times[0] <= needed * 1.16
        np.testing.assert_array_equal(points.position, [target])


def test_a_jog_in_mid_motion_is_as_gentle(shipped: rx.Setup) -> None:
    """Targets that are dragged to and fro, every 0.2 s, are taken, and accelerate the set-points like one move."""
    limits = shipped.controller.limits(shipped.robot)
    generator = TrajectoryGenerator(limits, 1e-3, ZERO)
    rng = np.random.default_rng(7)
    last, peak = 0, 0.0
    for tick in range(0, 6000, 200):
        # What the page knows is some time old.
        position, velocity, _ = generator.setpoints(max(tick - 1, 0), 1)[0]
        target = position + rng.choice([-1.0, 1.0], 6) * rng.uniform(0.02, 0.3, 6)
        last = generator.accept(jog(position, velocity, target, limits), tick, None).end
        peak = max(peak, float(np.abs(generator.setpoints(tick, 200)[:, 2]).max()))
    # A move begins with the acceleration that the last one has there, which the page does not know.
    assert 0.9 * APPROACH_ACCELERATION < peak < 1.3 * APPROACH_ACCELERATION
    np.testing.assert_allclose(generator.setpoints(last, 1)[0, 0], target, atol=1e-12)


class Drags:
    """Sliders' targets, and what they send; the clock stands unless it is moved."""

    def __init__(self, setup: rx.Setup, monkeypatch: pytest.MonkeyPatch) -> None:
        self.sent: list[TrajectoryPoints] = []
        self.limits = setup.controller.limits(setup.robot)
        self.jogs = Jogs(self.limits, self.sent.append)
        self.now = 100.0
        monkeypatch.setattr(panel_module, "time", SimpleNamespace(monotonic=lambda: self.now))

    def shown(self, position: np.ndarray, now: float, velocity: np.ndarray = ZERO) -> list[float] | None:
        self.now = 100.0 + now
        return self.jogs.follow(JointSample(0.0, position, velocity, ZERO), self.now)

    def drag(self, joint: int, angle: float, arm: np.ndarray, now: float) -> np.ndarray:
        """Return where all joints are sent when a user moves one to an angle, deg."""
        self.now = 100.0 + now
        self.jogs.drag(JointSample(0.0, arm, ZERO, ZERO), joint, angle)
        assert self.shown(arm, now + 0.2) is None  # nothing is put back that somebody moves
        return np.degrees(self.sent[-1].position[-1])


@pytest.fixture
def drags(shipped: rx.Setup, monkeypatch: pytest.MonkeyPatch) -> Drags:
    return Drags(shipped, monkeypatch)


def test_sliders_end_within_the_limits(drags: Drags) -> None:
    """Both ends are within the joint's limits, less than a step away from them."""
    low, high = np.radians(drags.jogs.ranges).T
    step = np.radians(0.1)
    assert ((drags.limits.lower - 1e-9 <= low) & (low < drags.limits.lower + step)).all()
    assert ((drags.limits.upper - step < high) & (high <= drags.limits.upper + 1e-9)).all()


def test_the_sliders_show_where_the_arm_goes_and_then_where_it_is(drags: Drags) -> None:
    """A second joint that is dragged leaves the first one's target; an arm that rests elsewhere is shown."""
    there = np.degrees(ARM).round(1).tolist()
    assert drags.shown(ARM, 0.0) == there
    drags.drag(1, 40.0, ARM, 1.0)
    both = drags.drag(4, -30.0, ARM + 0.01, 2.0)
    np.testing.assert_allclose([both[1], both[4], both[0]], [40.0, -30.0, 0.0], atol=1e-9)
    moving = np.full(6, 0.1)
    assert drags.shown(ARM + 0.02, 4.0, moving) == both.round(1).tolist()
    held = np.radians(both) + 1e-3  # where friction holds it
    assert drags.shown(held, 5.0) == both.round(1).tolist()
    np.testing.assert_allclose(drags.drag(0, 12.0, held, 6.0), [12.0, *both[1:]], atol=1e-9)
    assert drags.shown(ARM, 9.0) == there  # others have moved it, or it was refused
    np.testing.assert_allclose(drags.drag(0, 12.0, ARM, 10.0), [12.0, *np.degrees(ARM)[1:]], atol=1e-9)


def test_a_slider_that_is_dragged_sends_five_trajectories_a_second_the_last_one_whole(drags: Drags) -> None:
    """Of targets every 20 ms the newest is sent every 0.2 s, and the last one in any case."""
    for k in range(100):
        drags.jogs.drag(JointSample(0.0, ARM, ZERO, ZERO), 0, 0.1 * k)
        drags.shown(ARM, 0.02 * k)
    drags.shown(ARM, 3.0)
    assert 10 <= len(drags.sent) <= 11
    assert np.degrees(drags.sent[-1].position[-1][0]) == pytest.approx(9.9)
