"""The tabs that do something, put together."""

from __future__ import annotations

import html
from collections import deque
from collections.abc import Callable

import numpy as np
from viser import GuiButtonHandle

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.client_node import ServiceRequest
from rx90_common.friction.friction_file import FrictionFile
from rx90_controller.law.parameters import load_controller
from rx90_controller.lines.task import TOOL_DOWN, USUAL_ACCELERATION, USUAL_SPEED, LineTask, load_task
from rx90_controller.node.trajectory_client import enable_request
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.view.changes import from_user, on_change
from rx90_emulator.view.line import PLANNED
from rx90_emulator.view.page import Page
from rx90_emulator.view.panel.element_form import ElementForm
from rx90_emulator.view.panel.jog_sliders import JogSliders
from rx90_emulator.view.panel.newest import NewestOnly
from rx90_emulator.view.panel.operator import Heard, NodeNames, Operator
from rx90_emulator.view.panel.typed_line import LineChecker, LinePreview, TypedLine
from rx90_emulator.view.state import ArmState
from rx90_emulator.view.widgets import block, sentence
from rx90_sim.node.simulation_client import pause_request, reset_request, step_request

_PERIOD = 0.2  # s
_SET_POINT = 1e-3  # s, from one set-point of the controller to the next
_REFUSED = "rejected"
_LINES = 6
_ACTIVE = ("active",)
_CONFIGURED = ("active", "inactive")
_INTERVAL = 0.1  # s from one check to the next while somebody types
_STANDS, _ELSEWHERE = 1e-4, 1e-2  # rad, from one look to the next; from where it was checked


class LineForm:
    """Fields for start, end, speed, acceleration and tool; a line that says what comes of them; a button to send it.

    Args:
        page: to build in, within a tab.
        checker: checks.
        task: what stands in the fields at first.
        send: takes a line that was checked, when the button is pressed.
    """

    def __init__(self, page: Page, checker: LineChecker, task: LineTask, send: Callable[[LinePreview], None]) -> None:
        self._page, self._checker, self._send = page, checker, send
        self._here: Array | None = None
        self._checked_from: Array | None = None
        self._missing = ""
        self._number = 0  # of the newest check
        self._wanted = False
        self.preview: LinePreview | None = None
        first = TypedLine.of(task)
        self._fields = [
            page.gui.add_text(label, text)
            for label, text in (
                ("start, m", first.start),
                ("end, m", first.end),
                ("speed, m/s", first.speed),
                ("acceleration, m/s²", first.acceleration),
                ("tool rpy, deg", first.tool_rpy),
            )
        ]
        self._verdict = page.gui.add_html("")
        self._button = page.gui.add_button("Send the line", disabled=True)
        self._reason = page.gui.add_html("")
        self._drawn = [
            page.scene.add_line_segments(
                f"/panel/{name}",
                np.zeros((1, 2, 3), dtype=np.float32),
                PLANNED,
                thickness=thickness,
                thickness_units="screen",
                visible=False,
            )
            for name, thickness in (("line", 3.0), ("approach", 1.5))
        ]
        self._checking: NewestOnly[tuple[int, TypedLine, Array | None]] = NewestOnly(self._check, _INTERVAL)
        for field in self._fields:
            on_change(field, self._typed, page)
        self._button.on_click(from_user(self._pressed, page))
        self._typed()

    def close(self) -> None:
        """End the thread that checks."""
        self._checking.close()

    def follow(self, here: Array | None, missing: str) -> None:
        """Take where the arm is, rad, shape (6,), None for unknown, and what is missing to send a line, if anything.

        Where the arm has come to rest elsewhere, the approach is another one.
        """
        stands = here is not None and self._here is not None and np.abs(here - self._here).max() < _STANDS
        self._here, self._missing = here, missing
        before = self._checked_from
        if stands and here is not None and (before is None or np.abs(here - before).max() > _ELSEWHERE):
            self._give()
        self._enable()

    def _typed(self) -> None:
        self._wanted = False
        self._give()

    def _pressed(self) -> None:
        # The arm may have moved since the line was checked.
        self._wanted = True
        self._give()

    def _give(self) -> None:
        self.preview = None
        self._verdict.content = sentence("checking ...")
        self._enable()
        self._checked_from = self._here
        self._number += 1
        self._checking.give((self._number, TypedLine(*(field.value for field in self._fields)), self._here))

    def _check(self, item: tuple[int, TypedLine, Array | None]) -> None:
        """Check on a thread of its own."""
        number, typed, here = item
        try:
            found: LinePreview | LineError = self._checker.preview(typed, here)
        except LineError as error:
            found = error
        self._page.later(lambda: self._found(number, found))

    def _found(self, number: int, found: LinePreview | LineError) -> None:
        if number != self._number:
            return  # of other values than those in the fields, or of an arm that has moved
        wanted, self._wanted = self._wanted, False
        line, approach = self._drawn
        if isinstance(found, LineError):
            self._verdict.content = sentence(str(found), wrong=True)
            line.visible = approach.visible = False
            return
        self.preview = found
        self._verdict.content = sentence(found.text())
        task = found.plan.task
        line.points = np.array([[task.start, task.end]], dtype=np.float32)
        line.visible, approach.visible = True, len(found.approach) > 0
        if len(found.approach):
            way = found.approach.astype(np.float32)
            approach.points = np.stack([way[:-1], way[1:]], axis=1)
        if wanted and not self._missing:
            self._send(found)
        self._enable()

    def _enable(self) -> None:
        disabled = self.preview is None or bool(self._missing)
        if self._button.disabled != disabled:
            self._button.disabled = disabled
        reason = sentence(f"cannot be sent: {self._missing}") if self._missing else ""
        if self._reason.content != reason:
            self._reason.content = reason


class NodeControls:
    """Buttons that are enabled while their node can do what they ask for; a line says why the others are not.

    Args:
        page: to build in, within a tab.
        operator: asks the nodes.

    Attributes:
        simulation, controller: the lifecycle states; empty for a node that is not there.
    """

    def __init__(self, page: Page, operator: Operator) -> None:
        self._page, self._operator = page, operator
        self.simulation = self.controller = ""
        self._buttons: list[tuple[GuiButtonHandle, bool, tuple[str, ...]]] = []
        self._state = page.gui.add_html("")
        node = operator.names.simulation
        self._button("Pause", pause_request(node, paused=True), _CONFIGURED)
        self._button("Run", pause_request(node, paused=False), _CONFIGURED)
        self._button("Step", step_request(node), _ACTIVE)
        self._button("Reset to time 0", reset_request(node), _CONFIGURED)
        node = operator.names.controller
        self._button("Torque on", enable_request(node, on=True), _ACTIVE)
        self._button("Torque off, brakes closed", enable_request(node, on=False), _ACTIVE)
        self.states("", "")

    def states(self, simulation: str, controller: str) -> None:
        """Take the lifecycle states."""
        self.simulation, self.controller = simulation, controller
        for button, of_simulation, accepted in self._buttons:
            button.disabled = (simulation if of_simulation else controller) not in accepted
        names = self._operator.names
        lines = [_state_line(names.simulation, simulation), _state_line(names.controller, controller)]
        self._state.content = block("<br>".join(lines))

    def _button(self, label: str, asked: ServiceRequest, accepted: tuple[str, ...]) -> None:
        button = self._page.gui.add_button(label)
        button.on_click(lambda _: self._operator.ask(asked))
        of_simulation = asked.service.startswith(f"{self._operator.names.simulation}/")
        self._buttons.append((button, of_simulation, accepted))


class NodeLog:
    """The newest lines of what the nodes say and of what was refused here."""

    def __init__(self, page: Page) -> None:
        self._lines: deque[str] = deque(maxlen=_LINES)
        self._shown = page.gui.add_html(block("nothing yet"))

    def say(self, who: str, text: str, wrong: bool) -> None:
        """Show a line."""
        colour = "color:#c92a2a" if wrong else ""
        self._lines.appendleft(f'<div style="{colour}"><b>{html.escape(who)}</b> {html.escape(text)}</div>')
        self._shown.content = block("".join(self._lines))


def _state_line(node: str, state: str) -> str:
    said = html.escape(state) if state else f"not there: its buttons wait for <code>{html.escape(node)}</code> to start"
    return f"<b>{html.escape(node)}</b> {said}"


class DoPanel:
    """Tabs "Move" and "Element": jogging, lines, services, a friction element.

    Args:
        page: to build in.
        files: of the robot that the nodes have.
        arm: returns the newest state of the arm; None before the first one, or when it comes no more.
        names: of the nodes.
        on_line: takes a line that was sent.
    """

    def __init__(
        self,
        page: Page,
        files: RobotFiles,
        arm: Callable[[], ArmState | None],
        names: NodeNames,
        on_line: Callable[[LineTask], None],
    ) -> None:
        self._page, self._arm, self._on_line, self._names = page, arm, on_line, names
        robot = load_robot(files.urdf, files.tool)
        limits = load_controller(files.controller).limits(robot)
        task = load_task(files.task) if files.task is not None else _usual_line(robot)
        heard = Heard(
            lambda *line: page.later(lambda: self._said(*line)), lambda *both: page.later(lambda: self._states(*both))
        )
        self._joints = limits.names
        self._operator = Operator(names, heard)
        gui = page.gui
        with page.tab("Move"):
            with gui.add_folder("Straight line"):
                self._line = LineForm(page, LineChecker(robot, limits, _SET_POINT, task.branch), task, self._send_line)
            with gui.add_folder("Joints"):
                self._sliders = JogSliders(page, limits, lambda points: self._operator.send(self._joints, points))
            self._stop = gui.add_button("Stop the arm", color="red")
            self._stop.on_click(from_user(lambda: self._send(None), page))
            with gui.add_folder("What the nodes say"):
                self._log = NodeLog(page)
            with gui.add_folder("Nodes"):
                self._nodes = NodeControls(page, self._operator)
        with page.tab("Element"):
            self._form = ElementForm(page, FrictionFile.read(files.friction), self._start_with)
        page.every(_PERIOD, self._follow)

    def close(self) -> None:
        """End all threads."""
        for part in (self._line, self._sliders, self._form, self._operator):
            part.close()

    def _follow(self, _now: float) -> None:
        arm = self._arm()
        missing = self._missing(self._names.controller, self._nodes.controller)
        self._stop.disabled = bool(missing)
        if arm is None and not missing:
            missing = "no joint_states come"
        self._line.follow(None if arm is None else arm.position, missing)
        self._sliders.follow(arm, ready=not missing)
        self._form.follow(self._missing(self._names.simulation, self._nodes.simulation))

    @staticmethod
    def _missing(node: str, state: str) -> str:
        if state == "active":
            return ""
        return f"{node} is {state}; accepted: in state active" if state else f"there is no {node}"

    def _send(self, points: TrajectoryPoints | None) -> None:
        self._sliders.forget()
        self._operator.send(self._joints, points)

    def _send_line(self, preview: LinePreview) -> None:
        self._on_line(preview.plan.task)
        self._send(preview.line.points)

    def _start_with(self, path: str) -> None:
        self._sliders.forget()

        def ended(text: str, wrong: bool) -> None:
            self._page.later(lambda: self._form.tell(text, wrong))

        self._operator.configure_again("friction", path, ended)

    def _said(self, node: str, line: str, wrong: bool) -> None:
        self._log.say(node, line, wrong)
        if wrong and _REFUSED in line:
            self._sliders.forget()

    def _states(self, simulation: str, controller: str) -> None:
        self._nodes.states(simulation, controller)


def _usual_line(robot: RobotModel) -> LineTask:
    """Return a line for a robot that has none of its own, as far out as half its reach."""
    reach = 0.5 * float(abs(robot.chain.origin).sum(axis=0)[2])
    start, end = (reach, -0.1 * reach, 0.3 * reach), (reach, 0.1 * reach, 0.3 * reach)
    return LineTask(start, end, USUAL_SPEED, USUAL_ACCELERATION, TOOL_DOWN, TOOL_DOWN)
