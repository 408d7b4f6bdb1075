"""The panel in a real browser, with real nodes over DDS: what is typed, dragged and pressed there happens."""

from __future__ import annotations

import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from browser import BrowserPage, served
from pinocchio_chain import tip_place
from processes import Processes, running_processes, wait_until
from rcl_interfaces.srv import GetParameters
from ros_client import JOINTS, Client, own_node, seconds
from rosbags.rosbag2 import Reader as Rosbag2Reader
from std_srvs.srv import SetBool

from rx90_common.base.share import config_path
from rx90_common.description.coupling import RX_WRIST
from rx90_common.exchange.arm_watch import ArmWatch, JointSample
from rx90_common.exchange.client_node import ClientNode, client_node
from rx90_common.friction.friction_file import FrictionFile
from rx90_controller.lines.plan import plan_line
from rx90_controller.lines.task import TOOL_DOWN, LineTask, load_task
from rx90_controller.node.trajectory_client import enable_request
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view import forms
from rx90_emulator.view.forms import ElementForm, changed
from rx90_emulator.view.page import Page, put
from rx90_emulator.view.panel import DoPanel, Operator
from rx90_emulator.view.processes import RecordButton
from rx90_sim.node.simulation_client import pause_request, reset_request, step_request

Open = Callable[..., BrowserPage]
START, END, SPEED = np.array([0.6, -0.05, 0.2]), np.array([0.62, 0.05, 0.19]), 0.25
SIZE = (420, 640)  # a small scene, because it is drawn in software
FIELD = "//*[starts-with(normalize-space(text()), \"{}\")]/following::input[not(@type='hidden')][1]"


@pytest.fixture
def panel(processes: Processes, shipped: Setup, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Any]:
    """Serve a page with the panel alone, beside a cell that stands near the start of the line; give page and cell."""
    monkeypatch.chdir(tmp_path)  # where friction files are written
    line = LineTask(tuple(START), tuple(END), SPEED, 2.0, TOOL_DOWN, TOOL_DOWN)
    pose = (plan_line(shipped.robot, line).start_pose + 0.03).round(4).tolist()
    cell = processes.start("rx90_cell", "--ros-args", "-p", f"rx90_sim:initial_position:={pose}")
    assert shipped.files is not None
    sent: list[LineTask] = []
    with client_node("test_view", 1.0, print) as client:
        page = Page("test", port=0)
        names = shipped.robot.joint_names
        watch = ArmWatch(client.node, "rx90_controller", names, RX_WRIST.element_names(names))
        states: list[JointSample] = []
        page.every(0.05, lambda _: states.extend(watch.joints()))
        newest = lambda: states[-1] if states else None  # noqa: E731
        parts = DoPanel(page, client, shipped, load_task(), newest, "/rx90_controller", sent.append)
        with served(page):
            yield page, cell, sent
        parts.close()


def test_what_is_done_on_the_page_happens(
    panel: Any, open_page: Open, shipped: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line is refused or followed, a joint jogged, time stopped, an element changed; the nodes' end is told."""
    page, cell, sent = panel
    shown = open_page(page.address, SIZE)
    _the_line_is_followed(shown, page, shipped, sent)
    _a_slider_moves_its_joint(shown, page)
    press(shown, "Pause")
    shown.wait_until(lambda: "time stands still" in shown.text(), "the simulation's answer")
    _an_element_is_changed(shown, page, monkeypatch)
    cell.signal(signal.SIGINT)
    press(shown, "Move")
    shown.wait_until(lambda: "cannot be sent: there is no /rx90_controller" in shown.text(), "the reason")
    shown.wait_until(lambda: not shown.page.get_by_role("button", name="Pause").is_enabled(), "no pause")
    assert (shown.complaints, shown.foreign_requests) == ([], [])


def _the_line_is_followed(shown: BrowserPage, page: Page, setup: Setup, sent: list[LineTask]) -> None:
    press(shown, "Move")
    send = shown.page.get_by_role("button", name="Send the line")
    fill(shown, page, "start, m", "{} {} {}".format(*START))
    fill(shown, page, "end, m", "{} {} {}".format(*END))
    fill(shown, page, "acceleration", "2")
    fill(shown, page, "speed", "0.25 fast")
    shown.wait_until(lambda: "speed is '0.25 fast'; accepted: a number, m/s" in shown.text(), "the refusal")
    shown.wait_until(lambda: not send.is_enabled(), "no line to send")
    fill(shown, page, "speed", f"{SPEED}")
    length = float(np.linalg.norm(END - START))
    said = f"{length:.3f} m in {length / SPEED + SPEED / 2.0:.2f} s, after an approach of"
    shown.wait_until(lambda: said in shown.text() and send.is_enabled(), "the line with its approach")
    client = Client()
    heard = client.listen("joint_states", depth=20_000)  # nobody spins while the page is used
    client.spin_until(lambda: bool(heard), "the arm")
    press(shown, "Send the line")
    wait_until(lambda: bool(sent), "the line on its way")

    def arrived() -> bool:
        return bool(np.linalg.norm(tip_place(setup.robot, heard[-1].position) - END) < 1e-4)

    client.spin_until(arrived, "the end of the line")
    client.close()
    assert {tuple(m.name) for m in heard} == {tuple(JOINTS)}
    times = np.array([seconds(m) for m in heard])
    path = np.array([tip_place(setup.robot, m.position) for m in heard])
    along = (path - START) @ (END - START) / length
    beside = np.linalg.norm(path - START - along[:, None] * (END - START) / length, axis=1)
    begun = int(np.flatnonzero(along < 1e-4)[-1])
    assert np.abs(along[begun]) < 2e-4
    assert beside[begun:].max() < 3e-4
    speed = np.diff(along[begun:]) / np.diff(times[begun:])
    assert np.median(speed[speed > 0.1]) == pytest.approx(SPEED, rel=0.02)


class _RestsAt:
    """Whether an arm has been where it is, within 0.001 deg, for half a second of its time."""

    def __init__(self, heard: Sequence[Any]) -> None:
        self._heard, self._place, self._since = heard, np.full(6, np.nan), 0.0

    def __call__(self) -> bool:
        """Look at the newest state."""
        newest = self._heard[-1]
        if not np.abs(np.degrees(newest.position) - self._place).max() < 1e-3:
            self._place, self._since = np.degrees(newest.position), seconds(newest)
        return seconds(newest) >= self._since + 0.5


def _a_slider_moves_its_joint(shown: BrowserPage, page: Page) -> None:
    client = Client()
    heard = client.listen("joint_states", depth=1)
    client.spin_until(lambda: bool(heard), "the arm")
    rests = _RestsAt(heard)
    client.spin_until(rests, "the arm at rest after the line")
    before = np.degrees(heard[-1].position)
    asked = round(float(before[0]) + 5.0, 1)
    fill(shown, page, "joint", f"{asked}")
    client.spin_until(
        lambda: bool(abs(np.degrees(heard[-1].position[0]) - asked) < 0.01) and rests(), "joint 1 where its slider is"
    )
    field = shown.page.locator(FIELD.format("joint")).first
    shown.wait_until(lambda: field.input_value() == f"{asked}", "the slider where its joint is")
    # A joint that was not touched goes to where its slider stood, a tenth of a degree at most from it.
    np.testing.assert_allclose(np.degrees(heard[-1].position)[1:], before[1:], atol=0.02)
    client.close()


def _an_element_is_changed(shown: BrowserPage, page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    press(shown, "Element")
    title = "steady torque [Nm]"
    shown.wait_until(lambda: title in shown.plots() and len(shown.plots()[title]["data"][0]) > 2, "the curve")
    fill(shown, page, "tau", "40")
    text = "tau_s_positive is 32.0; accepted: a number >= tau_c_positive = 40.0 Nm"
    shown.wait_until(lambda: text in shown.text(), "the element's refusal")
    shown.wait_until(lambda: not shown.page.get_by_role("button", name="Write the file").is_enabled(), "no file")
    fill(shown, page, "tau", "20 28")
    shown.wait_until(lambda: "changed by hand: joint_1.tau_c_positive from 25 to 20 Nm" in shown.text(), "the change")
    shown.wait_until(lambda: "tau_c: {positive: 20.0, negative: 28.0}" in shown.text(), "the YAML")
    shown.wait_until(lambda: not np.equal(*shown.plots()[title]["data"][1:]).all(), "the other curve")
    velocity, before, after = map(np.array, shown.plots()[title]["data"])
    # Half a radian per second is ten Stribeck velocities: what is left is Coulomb and viscous friction.
    for at, coulomb in ((0.5, 20.0), (-0.5, -28.0)):
        assert np.interp(at, velocity, after) == pytest.approx(coulomb + 14.0 * at, abs=0.02)
        assert np.interp(at, velocity, before) == pytest.approx(np.sign(at) * 25.0 + 14.0 * at, abs=0.02)
    may_end, curve = threading.Event(), forms.stribeck_curve
    monkeypatch.setattr(forms, "stribeck_curve", lambda *given: (may_end.wait(60.0), curve(*given))[1])
    fill(shown, page, "tau", "20 27")
    shown.wait_until(lambda: "checking ..." in shown.text(), "the form at work")
    write = shown.page.get_by_role("button", name="Write the file")
    shown.wait_until(lambda: not write.is_enabled(), "no file of other values")
    assert "changed by hand" not in shown.text().split("tau_c, Nm")[0]
    may_end.set()
    shown.wait_until(lambda: "tau_c: {positive: 20.0, negative: 27.0}" in shown.text(), "the other YAML")
    press(shown, "Write the file")
    shown.wait_until(Path("friction_changed.yaml").is_file, "the file")
    monkeypatch.setattr(forms, "stribeck_curve", curve)
    _another_element_is_chosen(shown, page, title)


def _another_element_is_chosen(shown: BrowserPage, page: Page, title: str) -> None:
    """The fields, the curves and the file are of the element that is chosen, and the slider changes what it names."""
    file = FrictionFile.read(config_path("robots/rx90b/friction.yaml"))
    viscous = file.elements["joint_3"].c2
    choose(shown, "element", "joint_3")
    tau = shown.page.locator(FIELD.format("tau")).first
    shown.wait_until(lambda: tau.input_value() == f"{file.elements['joint_3'].tau_c_positive:g}", "its Coulomb torque")
    choose(shown, "slide", "c2")
    fill(shown, page, "times the file's", "2")
    said = f"changed by hand: joint_3.c2 from {viscous:g} to {2.0 * viscous:g} "
    shown.wait_until(lambda: said in shown.text(), "the change of the third joint")

    def doubled() -> bool:
        velocity, before, after = map(np.array, shown.plots()[title]["data"])
        return bool(np.allclose(after - before, viscous * velocity, atol=1e-6) and np.ptp(velocity) > 1.0)

    shown.wait_until(doubled, "its curves")


def use(page: Page, *fields: Any) -> None:
    """Do on the page's thread what follows when a user has changed these fields, or pressed these buttons."""
    for field in fields:
        for callback in field._impl.update_cb:
            with suppress(StopIteration):  # a coroutine that waits for nothing
                callback(SimpleNamespace(client_id=1)).send(None)
    while not page._handed_over.empty():
        page._handed_over.get()()


def test_what_is_given_right_after_a_choice_is_kept() -> None:
    """The factor goes back to 1 with another parameter, and the fields to the file's values with another element.

    But not what a user gave before the page took the choice.
    """
    page = Page("test", port=0)
    file = FrictionFile.read(config_path("robots/rx90b/friction.yaml"))
    form = ElementForm(page, file, lambda _: None)
    inputs = {field.label: field for field in page.gui._gui_input_handle_from_uuid.values() if hasattr(field, "label")}

    def give(**changes: object) -> None:
        fields = [next(inputs[label] for label in inputs if label.startswith(key)) for key in changes]
        for field, given in zip(fields, changes.values(), strict=True):
            put(field, given)
        use(page, *fields)

    give(slide="c2", times=2.0)
    assert inputs["times the file's"].value == 2.0
    give(slide="c1")
    assert inputs["times the file's"].value == 1.0
    give(element="joint_3", tau_c="31")
    assert inputs["tau_c, Nm"].value == "31"
    assert inputs["tau_s, Nm"].value == f"{file.elements['joint_3'].tau_s_positive:g}"
    form.close()
    page.close()


def test_a_file_that_is_there_is_replaced_only_when_confirmed(tmp_path: Path) -> None:
    """An existing name is refused with a button that replaces this one file; what leads elsewhere has none."""
    file = FrictionFile.read(config_path("robots/rx90b/friction.yaml"))
    started: list[str] = []
    page = Page("test", port=0, output=tmp_path / "page")
    form = ElementForm(page, file, started.append)
    there, other, outside = (tmp_path / name for name in ("page/there.yaml", "page/other.yaml", "outside.yaml"))
    for path in (there, other, outside):
        path.write_text("mine")

    def press(button: Any, name: str) -> str:
        put(form._files.name, name)
        use(page, button)
        return form._files.said.content

    assert "exists; accepted: a new name beneath" in press(form._start, "there.yaml")
    assert form._files.replace.visible
    assert "other.yaml exists" in press(form._files.replace, "other.yaml")  # another one than was refused
    assert [path.read_text() for path in (there, other)] == ["mine"] * 2
    assert "written" in press(form._files.replace, "other.yaml")
    assert (FrictionFile.read(other), started, form._files.replace.visible) == (file, [str(other)], False)
    for name in (str(outside), "../outside.yaml"):
        assert "; accepted: a new name beneath" in press(form._write, name)
        assert not form._files.replace.visible
        press(form._files.replace, name)
    assert [path.read_text() for path in (there, outside)] == ["mine"] * 2
    assert "written" in press(form._write, "new.yaml")
    assert FrictionFile.read(tmp_path / "page/new.yaml") == file
    form.close()
    page.close()


def choose(shown: BrowserPage, label: str, option: str) -> None:
    """Choose in the list whose label begins so."""
    shown.page.locator(FIELD.format(label)).first.click()
    shown.page.get_by_role("option", name=option, exact=True).click()


def fill(shown: BrowserPage, page: Page, label: str, text: str) -> None:
    """Type into the field whose label begins so, until the server has it; the page breaks labels at _ and /.

    Of what is changed within 50 ms the page sends the first and the last alone, and nobody types as fast as this.
    """
    shown.page.locator(FIELD.format(label)).first.fill(text)
    fields = page.gui._gui_input_handle_from_uuid.values()
    field = next(field for field in fields if getattr(field, "label", "").startswith(label))
    shown.wait_until(lambda: field.value == type(field.value)(text), f"{text!r} as {label}")


def press(shown: BrowserPage, name: str) -> None:
    """Press a button or a tab, wherever it is on the page."""
    wanted = shown.page.get_by_role("button", name=name).or_(shown.page.get_by_role("tab", name=name))
    wanted.first.click()


REST = np.zeros((1, 6))


class Listener:
    """Keeps what an operator hears."""

    def __init__(self, client: ClientNode, timeout: float = 30.0) -> None:
        self.said: list[tuple[str, str, bool]] = []
        self.operator = Operator(client, "rx90_controller", lambda *line: self.said.append(line), timeout)

    def until(self, ready: Callable[[], bool], what: str) -> None:
        """Let the operator take in what comes until something is so."""

        def step() -> bool:
            self.operator.step(time.monotonic())
            return ready()

        try:
            wait_until(step, what)
        except pytest.fail.Exception:
            pytest.fail(f"waited in vain for {what}; said: {self.said}")

    def wait_for(self, node: str, text: str, *, wrong: bool = False) -> str:
        """Wait for a line that has a text in it; return it."""

        def found() -> list[str]:
            return [line for who, line, bad in self.said if (who, bad) == (node, wrong) and text in line]

        self.until(lambda: bool(found()), f"{text!r} of {node}")
        return found()[0]


@pytest.fixture
def listener(ros_domain: int, warm: None) -> Iterator[Listener]:  # noqa: ARG001 - what they do is done
    """Give an operator of a cell that runs, in a namespace, with time standing still."""
    space = ("--ros-args", "-r", "__ns:=/cell")
    with running_processes() as processes, client_node("test", 30.0, print, space) as client:
        processes.start("rx90_cell", *space, "-p", "rx90_sim:paused:=true").wait_for("paused")
        listening = Listener(client)
        listening.until(lambda: [*listening.operator.states.values()] == ["active", "active"], "both nodes")
        yield listening


@contextmanager
def recorded(listener: Listener, folder: Path) -> Iterator[None]:
    """Record by the page's button what happens within the block; it is in the bag that the page names."""
    page = Page("test", port=0, output=folder)
    button = RecordButton(page, "/cell", ())

    def says(words: str) -> bool:
        button._follow(time.monotonic())
        return words in button._said.content

    try:
        use(page, button._button)
        listener.until(lambda: says("recording to bag: "), "the recorder")
        yield
        use(page, button._button)
        listener.until(lambda: says("messages of"), "the end of the recording")
        told = re.search(r"recorded (\d+) messages", button._said.content)
        assert told is not None
        with Rosbag2Reader(folder / "bag") as bag:
            assert bag.message_count == int(told[1]) > 0
            assert {f"/cell/{topic}_states" for topic in ("joint", "friction", "motor")} <= set(bag.topics)
    finally:
        try:
            button.close()
        finally:
            page.close()


def test_both_nodes_do_what_they_are_asked(listener: Listener, shipped: Setup, tmp_path: Path) -> None:
    """Services and trajectories are answered with the nodes' own words; another friction file is loaded.

    What is recorded meanwhile is in a bag.
    """
    with recorded(listener, tmp_path):
        _both_nodes_are_asked(listener, shipped, tmp_path)


def _both_nodes_are_asked(listener: Listener, shipped: Setup, tmp_path: Path) -> None:
    operator = listener.operator
    simulation, controller = operator.simulation, operator.controller
    operator.ask(step_request(simulation))
    assert listener.wait_for(simulation, "done, at") == "1 ticks done, at 0.00025 s"
    operator.ask(pause_request(simulation, paused=False))
    listener.wait_for(simulation, "time runs")
    operator.ask(enable_request(controller, on=False))
    listener.wait_for(controller, "torque off, brakes closed")
    operator.send(tuple(JOINTS), TrajectoryPoints(np.array([1.0]), REST, REST, None))
    assert "the controller is disabled" in listener.wait_for(controller, "trajectory rejected", wrong=True)
    operator.ask(enable_request(controller, on=True))
    listener.wait_for(controller, "torque on")
    operator.send(tuple(JOINTS), TrajectoryPoints(np.array([1.0]), REST + 0.1, REST, None))
    listener.wait_for(controller, "trajectory accepted: 1 points, 1.000 s")
    operator.send(tuple(JOINTS), None)
    listener.wait_for(controller, "empty trajectory: stopping")
    operator.ask(reset_request(simulation))
    listener.wait_for(simulation, "reset done, at 0 s")
    assert shipped.friction.file is not None
    file = changed(FrictionFile.read(shipped.friction.file), "joint_1", {"tau_c_positive": 20.0})
    path = tmp_path / "friction.yaml"
    path.write_text(file.text(), encoding="utf-8")
    ended: list[tuple[str, bool]] = []
    operator.start_again_with("friction", str(path), lambda *how: ended.append(how))
    listener.wait_for(simulation, "activate: done")
    listener.until(lambda: bool(ended), "how it ended")
    assert ended == [(f"{simulation} runs again, from time 0: activate: done", False)]
    client = Client("/cell")
    asked = GetParameters.Request(names=["friction"])
    assert client.asking.call(GetParameters, "rx90_sim/get_parameters", asked).values[0].string_value == str(path)
    client.close()
    listener.until(lambda: operator.states[simulation] == "active", "the simulation again")
    operator.start_again_with("friction", str(tmp_path / "none.yaml"), lambda *how: ended.append(how))
    listener.wait_for(simulation, "none.yaml", wrong=True)
    listener.until(lambda: len(ended) == 2, "how it ended")
    assert (ended[1][0].startswith(f"{simulation} is not started again: "), ended[1][1]) == (True, True)


def test_silence_is_told(ros_domain: int) -> None:
    """A service that does not answer is told after the time-out, one that is not there at once, and others go on."""
    with own_node("silent", ros_domain) as node, client_node("test", 30.0, print) as client:
        node.create_service(SetBool, "rx90_sim/pause", lambda _request, response: response)  # nobody spins it
        listening = Listener(client, timeout=1.0)
        operator, said = listening.operator, listening.said
        operator.send(tuple(JOINTS), None)
        operator.start_again_with("friction", "x.yaml", lambda *_: None)
        operator.ask(reset_request("rx90_sim"))
        absent = "there is no service rx90_sim/{}; accepted: while its node runs"
        assert [(node, line) for node, line, wrong in said if wrong] == [
            ("rx90_controller",
             "there is no controller on /rx90_controller/joint_trajectory; accepted: while one runs"),
            ("rx90_sim", absent.format("get_state")),
            ("rx90_sim", absent.format("reset")),
        ]  # fmt: skip

        def unanswered() -> bool:
            operator.ask(pause_request("rx90_sim", paused=True))
            return any("no answer of rx90_sim/pause within 1 s" in line for _, line, _ in said)

        listening.until(unanswered, "a complaint")
        assert [*operator.states.values()] == ["", ""]
