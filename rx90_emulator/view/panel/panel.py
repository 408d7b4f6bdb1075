"""The tabs that do something, put together."""

from __future__ import annotations

from collections.abc import Callable

from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.friction.friction_file import FrictionFile
from rx90_controller.law.parameters import load_controller
from rx90_controller.lines.task import TOOL_DOWN, USUAL_ACCELERATION, USUAL_SPEED, LineTask, load_task
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.view.changes import from_user
from rx90_emulator.view.page import Page
from rx90_emulator.view.panel.element_form import ElementForm
from rx90_emulator.view.panel.jog_sliders import JogSliders
from rx90_emulator.view.panel.line_form import LineForm
from rx90_emulator.view.panel.node_controls import NodeControls, NodeLog
from rx90_emulator.view.panel.operator import Heard, NodeNames, Operator
from rx90_emulator.view.panel.typed_line import LineChecker, LinePreview
from rx90_emulator.view.state import ArmState

_PERIOD = 0.2  # s
_SET_POINT = 1e-3  # s, from one set-point of the controller to the next
_REFUSED = "rejected"


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
