"""The part of the page that shows running nodes."""

from __future__ import annotations

import math
import time

import numpy as np
import viser

from rx90_common.description.robot import RobotModel
from rx90_common.description.tip import tip_position
from rx90_common.exchange.arm_watch import Trajectory
from rx90_common.exchange.topics import HURRIES
from rx90_controller.lines.task import LineTask
from rx90_emulator.view.arm import ArmScene
from rx90_emulator.view.line import LineScene, legend_html
from rx90_emulator.view.live.live_plots import LivePlots
from rx90_emulator.view.live.run_comparison import RunComparison
from rx90_emulator.view.live.source import LiveSource
from rx90_emulator.view.live.status import diagnostics_html, status_html
from rx90_emulator.view.page import Page
from rx90_emulator.view.state import ArmState

_POSE_PERIOD = 1.0 / 30.0  # s
_PLOT_PERIOD = 0.2
_STATUS_PERIOD = 0.25
_PACED = 1.05  # simulated s in one of the wall clock, of a simulation that keeps to it
_NO_TRAJECTORY = Trajectory(0.0, np.empty(0), np.empty((0, 6)), np.empty(0, dtype=np.bool_))
_MAGNIFIED = ("1", "10", "100")  # the first is what is drawn at first


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
        self._page, self._source = page, source
        self._chain = robot.chain
        self._followed: Trajectory | None = None
        self.state: ArmState | None = None
        self.arm = ArmScene(page, "/arm", robot)
        self._line = None if line is None else LineScene(page, "/reference", np.array(line.start), np.array(line.end))
        self._plots = LivePlots(page, robot)
        self._runs = RunComparison(page)
        page.look_at_arm(robot)
        with page.tab("Live"):
            self._status = page.gui.add_html("")
            if self._line is not None:
                page.gui.add_html(legend_html("line and approach of the form"))
                self._add_trace_choice(page, self._line)
            self._plots.add_choice()
            with page.gui.add_folder("Diagnostics", expand_by_default=False):
                self._diagnostics = page.gui.add_html("")
        # A simulation that hurries needs the processors more than the eye needs smoothness.
        for period, show in ((_POSE_PERIOD, self._update), (_PLOT_PERIOD, self._draw), (_STATUS_PERIOD, self._tell)):
            page.every(period, show, hurries=lambda now: source.pace(now) > HURRIES)

    def _add_trace_choice(self, page: Page, line: LineScene) -> None:
        magnified = page.gui.add_dropdown(
            "error drawn \u00d7",
            _MAGNIFIED,
            hint="the trace is drawn so many times as far from the line as it was",
        )
        clear = page.gui.add_button("Clear the trace")
        magnified.on_update(lambda _: page.later(lambda: line.magnify(float(magnified.value))))
        clear.on_click(lambda _: page.later(line.clear))

    def lay_line(self, task: LineTask) -> None:
        """Show a line that was sent; from now on the spot's path error is its distance from this one."""
        start, end = np.array(task.start), np.array(task.end)
        if self._line is None:
            self._line = LineScene(self._page, "/reference", start, end)
        self._line.place(start, end)
        self._followed = None

    def newest(self) -> ArmState | None:
        """Return the newest state; None where there is none, or its simulation has gone."""
        return None if self._source.problem(time.monotonic()) else self.state

    def rests(self, seconds: float) -> bool:
        """Tell whether the last trajectory has been over for so long, in simulated time; from any thread."""
        state, span = self.state, self._source.watch.trajectory
        return state is not None and (span is None or not span.begin <= state.time < span.end + seconds)

    def _update(self, now: float) -> None:
        states = self._source.take(now)
        if not states:
            return
        newest, error = states[-1], math.nan
        self.arm.show(newest.position)
        if self._line is not None:
            if self.state is not None and states[0].time < self.state.time:
                self._line.clear()
                self._line.meter.begin_again()
            self._follow(self._line)
            tips = tip_position(self._chain, np.array([state.position for state in states]))
            error = self._line.add(np.array([state.time for state in states]), tips)
        self.state = newest
        self._plots.add(newest, error)
        self._plots.add_to_loop(self._source.friction, at_ticks=self._source.watch.listens_at_ticks)

    def _follow(self, line: LineScene) -> None:
        """Tell the line of a trajectory that it does not know yet."""
        trajectory = self._source.watch.trajectory
        if trajectory is not self._followed:
            self._followed = trajectory
            _, times, position, at_rest = trajectory or _NO_TRAJECTORY
            line.meter.follow(times, tip_position(self._chain, position), at_rest)

    def _draw(self, _now: float) -> None:
        self._plots.draw()
        if self._line is not None:
            self._line.draw()
            self._runs.draw(self._line)

    def _tell(self, now: float) -> None:
        watch = self._source.watch
        watch.look_around()
        # Friction at every tick costs the simulation a twentieth: where somebody sees it, and time is not in a hurry.
        fastest = HURRIES if watch.listens_at_ticks else _PACED
        seen = self._plots.shows_loop and bool(self._page.server.get_clients())
        watch.at_ticks(wanted=seen and self._source.pace(now) < fastest)
        error = "no line" if self._line is None else self._line.meter.words()
        self._set(self._status, status_html(self._source, self.state, error, now))
        self._set(self._diagnostics, diagnostics_html(self._source.watch.diagnostics))

    @staticmethod
    def _set(shown: viser.GuiHtmlHandle, content: str) -> None:
        if shown.content != content:
            shown.content = content
