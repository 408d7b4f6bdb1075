"""Running nodes on the page: their arm, the spot's trace, and what they say of themselves."""

from __future__ import annotations

import html
import math
import time
from collections import deque
from collections.abc import Iterable

import numpy as np

from rx90_common.base.quoting import plain
from rx90_common.description.kinematics import tip_position
from rx90_common.description.robot import RobotModel
from rx90_common.exchange.arm_watch import ArmWatch, JointSample, NodeStatus, Trajectory
from rx90_common.exchange.client_node import ClientNode
from rx90_common.exchange.topics import MAX_DISPLAY_RTF
from rx90_controller.lines.task import TipTask
from rx90_emulator.view.page import Page
from rx90_emulator.view.scene import ArmScene, LineScene, legend_html

# s; the samples of a simulation come again four times a second while time stands still
_STALE = 2.5
_PACE_WINDOW = 2.0  # s
_LEAST_WINDOW = 0.5  # s, of a pace: messages that waited come together
_POSE_PERIOD = 1.0 / 30.0  # s
_TRACE_PERIOD = 0.2
_STATUS_PERIOD = 0.25


class LiveView:
    """Arm, spot, trace and words that follow running nodes, which may come and go.

    Args:
        page: to show them on.
        client: whose node listens; nothing waits for it.
        robot: the arm that is expected.
        controller: name of the controller node, relative or absolute; the arm is in its namespace.
        line: the reference line, or another path, if there is one.

    Attributes:
        watch: what the nodes publish.
        state: the newest of the arm; None before the first.
        trace: the line with the trace of the spot, if there is one.
    """

    def __init__(
        self,
        page: Page,
        client: ClientNode,
        robot: RobotModel,
        controller: str,
        line: TipTask | None,
    ) -> None:
        self._model = robot
        self._robot = str(robot.model.name)
        self.watch = ArmWatch(client.node, controller, robot.joint_names)
        self._heard = -math.inf  # when a state came last
        self._times: deque[tuple[float, float]] = deque()  # steady clock, simulated
        self._followed: Trajectory | None = None
        self.state: JointSample | None = None
        self.arm = ArmScene(page, "/arm", robot)
        self.trace = None if line is None else LineScene(page, "/reference", line)
        page.look_at_arm(robot)
        with page.tab("Live"):
            self._status = page.gui.add_html("")
            if self.trace is not None:
                page.gui.add_html(legend_html())
        # A simulation that hurries needs the processors more than the eye needs smoothness.
        periods = {
            self._update: _POSE_PERIOD,
            self._draw: _TRACE_PERIOD,
            self._show_status: _STATUS_PERIOD,
        }
        for show, period in periods.items():
            page.every(period, show, busy=lambda now: self.pace(now) > MAX_DISPLAY_RTF)

    def newest(self) -> JointSample | None:
        """Return the newest state; None where there is none, or its simulation has gone."""
        return None if self._problem(time.monotonic()) else self.state

    def rests(self, seconds: float) -> bool:
        """Tell whether the last trajectory has been over for so long, in simulated time; from any thread."""
        state = self.state
        span = self.watch.trajectory
        return state is not None and (
            span is None or not span.begin <= state.time < span.end + seconds
        )

    def pace(self, now: float) -> float:
        """Return simulated time per time of the wall clock over the last seconds, NaN while these are too few.

        Args:
            now: of the steady clock, s.
        """
        while self._times and self._times[0][0] < now - _PACE_WINDOW:
            self._times.popleft()
        if len(self._times) < 2:
            return math.nan
        (began, first) = self._times[0]
        (ended, last) = self._times[-1]
        return (last - first) / (ended - began) if ended - began > _LEAST_WINDOW else math.nan

    def _problem(self, now: float) -> str:
        """Return why there are no states to show, as a sentence for the user; empty if there are some."""
        theirs = self.watch.robot
        if self.watch.publishers and theirs not in {None, self._robot}:
            return f"The simulation's robot is {plain(theirs)}, this page shows {self._robot}: start it with --robot"
        if now - self._heard <= _STALE:
            return ""
        if self.watch.problem:
            return f"Another robot? {self.watch.problem}"
        if self._heard == -math.inf:
            return f"Waiting for a simulation: nothing on {self.watch.topic} yet"
        return f"The simulation has gone: nothing on {self.watch.topic} any more; waiting for the next one"

    def _update(self, now: float) -> None:
        states = self.watch.joints()
        if not states:
            return
        before = 0.0 if self.state is None else self.state.time
        back = np.flatnonzero(np.diff([before, *(state.time for state in states)]) < 0.0)
        if len(back):  # another simulation, or reset: nothing that was accepted before is followed
            states = states[back[-1] :]
            self._times.clear()
            self.watch.trajectory = None
            if self.trace is not None:
                self.trace.begin_again()
        self.state = states[-1]
        self._heard = now
        self._times.append((now, self.state.time))
        self.arm.show(self.state.position)
        if self.trace is not None:
            self._follow_trajectory(self.trace)
            tips = tip_position(self._model.chain, np.array([state.position for state in states]))
            self.trace.add(np.array([state.time for state in states]), tips)

    def _follow_trajectory(self, trace: LineScene) -> None:
        """Hand a trajectory on that the line does not know yet."""
        trajectory = self.watch.trajectory
        if trajectory is self._followed:
            return
        self._followed = trajectory
        if trajectory is None:
            trace.follow(np.empty(0), np.empty((0, 3)), np.empty(0, dtype=np.bool_))
        else:
            tips = tip_position(self._model.chain, trajectory.position)
            trace.follow(trajectory.times, tips, trajectory.at_rest)

    def _draw(self, _now: float) -> None:
        if self.trace is not None:
            self.trace.draw()

    def _show_status(self, now: float) -> None:
        watch = self.watch
        watch.look_around()
        problem = self._problem(now)
        rows = [("", _colored(problem, 1))]
        if self.state is not None and not problem:
            nodes = watch.diagnostics.values()
            time_s = self.state.time
            span = watch.trajectory
            # Values that only this node has.
            simulation = next((node for node in nodes if "brakes" in node.values), None)
            controller = next((node for node in nodes if "enabled" in node.values), None)
            trajectory = "none"
            if span is not None and time_s < span.begin:
                trajectory = f"begins in {span.begin - time_s:.1f} s"
            elif span is not None and time_s <= span.end:
                trajectory = f"{time_s - span.begin:.1f} of {span.end - span.begin:.1f} s"
            elif span is not None:  # the controller's own word may be a second old
                trajectory = f"ended at {span.end:.1f} s"
            pace = self.pace(now)
            paced = "" if math.isnan(pace) else f", {pace:.2f} &times; real time"
            rows = [
                ("simulation", _word(simulation)),
                ("time", f"{time_s:.2f} s{paced}"),
                ("brakes", html.escape(simulation.values["brakes"]) if simulation else "unknown"),
                ("controller", _word(controller)),
                ("trajectory", trajectory),
                ("path error", "no line" if self.trace is None else self.trace.words()),
            ]
        self._status.content = _table(rows)


_COLORS = ("#2b8a3e", "#e67700", "#c92a2a", "#868e96")  # good, warning, error, stale
_CELL = "padding:1px 0.6em 1px 0"


def _table(rows: Iterable[tuple[str, str]]) -> str:
    cells = "".join(
        f'<tr><td style="{_CELL};color:#868e96;white-space:nowrap;vertical-align:top">{name}</td>'
        f'<td style="{_CELL}">{value}</td></tr>'
        for name, value in rows
    )
    return f'<table style="font-size:0.85em;padding:0.2em 0.6em;border-spacing:0">{cells}</table>'


def _word(status: NodeStatus | None) -> str:
    return "not heard yet" if status is None else _colored(status.message, status.level)


def _colored(text: str, level: int) -> str:
    color = _COLORS[min(level, len(_COLORS) - 1)]
    return f'<span style="color:{color};font-weight:600">{html.escape(text)}</span>'
