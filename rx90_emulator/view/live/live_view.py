"""The part of the page that shows running nodes."""

from __future__ import annotations

import numpy as np
import viser

from rx90_common.description.kinematics import forward
from rx90_common.description.robot import RobotModel
from rx90_controller.lines.task import LineTask
from rx90_emulator.view.arm import ArmScene
from rx90_emulator.view.line import LineScene, legend_html
from rx90_emulator.view.live.live_plots import LivePlots
from rx90_emulator.view.live.source import LiveSource
from rx90_emulator.view.live.status import diagnostics_html, status_html
from rx90_emulator.view.page import Page
from rx90_emulator.view.state import ArmState

_POSE_PERIOD = 1.0 / 30.0  # s
_PLOT_PERIOD = 0.2
_STATUS_PERIOD = 0.25
_MAGNIFIED = ("1", "10", "100")


class LiveView:
    """Arm, spot, trace and plots that follow running nodes.

    Args:
        page: to show it on.
        source: where the states come from.
        robot: the arm.
        line: the reference line, if the robot has one.

    Attributes:
        state: the newest; None before the first.
    """

    def __init__(self, page: Page, source: LiveSource, robot: RobotModel, line: LineTask | None) -> None:
        self._source, self._robot = source, robot
        self.state: ArmState | None = None
        self.arm = ArmScene(page, "/arm", robot)
        self._line = None if line is None else LineScene(page, "/reference", np.array(line.start), np.array(line.end))
        self._plots = LivePlots(page, robot)
        page.look_at_arm(robot)
        with page.tab("Live"):
            self._status = page.gui.add_html("")
            if self._line is not None:
                page.gui.add_html(legend_html())
                self._add_trace_choice(page, self._line)
            self._plots.add_choice()
            with page.gui.add_folder("Diagnostics", expand_by_default=False):
                self._diagnostics = page.gui.add_html("")
        page.every(_POSE_PERIOD, self._update)
        page.every(_PLOT_PERIOD, self._draw)
        page.every(_STATUS_PERIOD, self._tell)

    def _add_trace_choice(self, page: Page, line: LineScene) -> None:
        magnified = page.gui.add_button_group(
            "error \u00d7", _MAGNIFIED, hint="magnify the trace's distance from the line"
        )
        clear = page.gui.add_button("Clear the trace")
        magnified.on_click(lambda event: page.later(lambda: line.magnify(float(event.target.value))))
        clear.on_click(lambda _: page.later(line.clear))

    def _update(self, now: float) -> None:
        state = self._source.take(now)
        if state is None:
            return
        if self.state is not None and state.time < self.state.time and self._line is not None:
            self._line.clear()
        self.state = state
        self.arm.show(state.position)
        error = None
        if self._line is not None:
            error = self._line.add(forward(self._robot.chain, state.position).position)
        self._plots.add(state, error)

    def _draw(self, _now: float) -> None:
        self._plots.draw()
        if self._line is not None:
            self._line.draw()

    def _tell(self, now: float) -> None:
        self._source.watch.look_around()
        error = "no line" if self._line is None else self._line.words()
        self._set(self._status, status_html(self._source, self.state, error, now))
        self._set(self._diagnostics, diagnostics_html(self._source.watch.diagnostics))

    @staticmethod
    def _set(shown: viser.GuiHtmlHandle, content: str) -> None:
        if shown.content != content:
            shown.content = content
