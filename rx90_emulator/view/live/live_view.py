"""The part of the page that shows running nodes."""

from __future__ import annotations

import numpy as np

from rx90_common.description.kinematics import forward
from rx90_common.description.robot import RobotModel
from rx90_common.friction.friction_set import element_names
from rx90_controller.lines.task import LineTask
from rx90_emulator.view.arm import ArmScene
from rx90_emulator.view.line import LineScene, legend_html
from rx90_emulator.view.live.source import LiveSource
from rx90_emulator.view.page import Page
from rx90_emulator.view.plots import LoopPlot, RollingPlot
from rx90_emulator.view.state import ArmState

_POSE_PERIOD = 1.0 / 30.0  # s
_PLOT_PERIOD = 0.2


class LiveView:
    """Arm, spot, trace and plots that follow running nodes.

    Args:
        page: to show it on.
        source: where the states come from.
        robot: the arm.
        line: the reference line, if the robot has one.
    """

    def __init__(self, page: Page, source: LiveSource, robot: RobotModel, line: LineTask | None) -> None:
        self._source, self._robot = source, robot
        self.arm = ArmScene(page, "/arm", robot)
        self._line = None if line is None else LineScene(page, "/reference", np.array(line.start), np.array(line.end))
        reach = float(np.linalg.norm(robot.chain.origin, axis=1).sum())
        page.look_at((0.3 * reach, 0.0, 0.35 * reach), 1.7 * reach)
        with page.tab("Live"):
            self._status = page.gui.add_markdown("")
            if self._line is not None:
                page.gui.add_html(legend_html())
        names = element_names(robot.joint_names)
        with page.plot_tab("Friction"):
            self._friction = RollingPlot(page, "friction torque [Nm]", names)
            self._loop = LoopPlot(page, f"friction of {names[0]}", "velocity [rad/s]", "friction torque [Nm]")
        self._said = ""
        page.every(_POSE_PERIOD, self._update)
        page.every(_PLOT_PERIOD, self._draw)

    def _update(self, now: float) -> None:
        state = self._source.take(now)
        if state is not None:
            self._show(state)
        self._say(self._source.problem(now) or "Connected")

    def _show(self, state: ArmState) -> None:
        self.arm.show(state.position)
        if self._line is not None:
            self._line.add(forward(self._robot.chain, state.position).position)
        if state.friction is not None:
            self._friction.add(state.time, state.friction.torque)
            self._loop.add(float(state.friction.velocity[0]), float(state.friction.torque[0]))

    def _draw(self, _now: float) -> None:
        self._friction.draw()
        self._loop.draw()
        if self._line is not None:
            self._line.draw()

    def _say(self, text: str) -> None:
        if text != self._said:
            self._said = self._status.content = text
