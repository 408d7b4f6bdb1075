"""Running nodes on the page: their newest states, arm, spot and trace, plots, and what they say of themselves."""

from __future__ import annotations

import html
import math
import time
from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from rx90_common.base.quoting import plain
from rx90_common.description.kinematics import forward
from rx90_common.description.robot import RobotModel
from rx90_common.exchange.arm_watch import ArmWatch, JointSample, NodeStatus, Trajectory
from rx90_common.exchange.client_node import ClientNode
from rx90_common.exchange.topics import MAX_DISPLAY_RTF
from rx90_controller.lines.task import TipTask
from rx90_emulator.view.page import Page, block, from_user
from rx90_emulator.view.plots import LoopPlot, RollingPlot, RunComparison
from rx90_emulator.view.scene import ArmScene, LineScene, legend_html

_STALE = 2.5  # s; the samples of a simulation come again four times a second while time stands still
_PACE_WINDOW = 2.0  # s


_POSE_PERIOD = 1.0 / 30.0  # s
_PLOT_PERIOD = 0.2
_STATUS_PERIOD = 0.25
_REAL_TIME_FACTOR = 1.05  # simulated s in one of the wall clock, of a simulation that keeps to it
_MAGNIFICATIONS = ("1", "10", "100")  # the first is what is drawn at first
_SHOWN_FIRST = 3  # joints; all seven at once are hard to tell apart
_MAX_GAPS = 5  # in 10 s; more are drawn across
_MAX_SAMPLE_STEP = 0.01  # s; a line across so many ticks would be none of friction
_NONE = "none"


class LiveView:
    """Arm, spot, trace, plots and words that follow running nodes, which may come and go.

    Args:
        page: to show them on.
        client: whose node listens; nothing waits for it.
        robot: the arm that is expected.
        elements: names of its friction elements.
        controller: name of the controller node, relative or absolute; the arm is in its namespace.
        line: the reference line, or another path, if there is one.

    Attributes:
        watch: what the nodes publish.
        state: the newest of the arm; None before the first.

    Raises:
        ConfigError: if that cannot be a node's name.
    """

    def __init__(
        self,
        page: Page,
        client: ClientNode,
        robot: RobotModel,
        elements: tuple[str, ...],
        controller: str,
        line: TipTask | None,
    ) -> None:
        self._page, self._model, gui, self._robot = page, robot, page.gui, str(robot.model.name)
        self._names, joints = elements, robot.joint_names
        self.watch = ArmWatch(client.node, controller, joints, self._names)
        self._elements: JointSample | None = None  # the newest: deflection, velocity, torque
        self._heard = -math.inf  # when a state came last
        self._times: deque[tuple[float, float]] = deque()  # steady clock, simulated
        self._followed: Trajectory | None = None
        self.state: JointSample | None = None
        self.arm = ArmScene(page, "/arm", robot)
        self._line = None if line is None else LineScene(page, "/reference", robot, line)
        with page.plot_tab("Friction"):
            self._friction = RollingPlot(page, "friction torque [Nm]", self._names, (-1.0, 1.0))
            self._deflection = RollingPlot(page, "bristle deflection [\u00b5rad]", self._names, (-10.0, 10.0))
            axes = ("velocity [rad/s]", "friction torque [Nm]")
            self._loop = LoopPlot(page, "friction against velocity", *axes, (0.01, 1.0))
            self._looped = gui.add_dropdown("joint of the loop", (*self._names, _NONE))
        with page.plot_tab("Motion"):
            self._velocity = RollingPlot(page, "joint velocity [rad/s]", joints, (-0.01, 0.01))
            self._torque = RollingPlot(page, "drive torque [Nm]", joints, (-5.0, 5.0))
            title = "path error of the laser spot [mm]"
            self._error = RollingPlot(page, title, ("laser spot",), (0.0, 0.01), gaps=_MAX_GAPS)
        self._looped.on_update(from_user(self._loop.clear, page))
        self._loop_time = -1.0
        with page.plot_tab("Path"):
            self._runs = RunComparison(page)
        page.look_at_arm(robot)
        with page.tab("Live"):
            self._status = gui.add_html("")
            if self._line is not None:
                gui.add_html(legend_html("line and approach of the form"))
                hint = "the trace is drawn so many times as far from the line as it was"
                magnified = gui.add_dropdown("error drawn \u00d7", _MAGNIFICATIONS, hint=hint)
                trace = self._line
                magnified.on_update(from_user(lambda: trace.magnify(float(magnified.value)), page))
                gui.add_button("Clear the trace").on_click(from_user(trace.clear, page))
            with gui.add_folder("Joints in the plots", expand_by_default=False):
                self._boxes = {name: gui.add_checkbox(name, k < _SHOWN_FIRST) for k, name in enumerate(self._names)}
            with gui.add_folder("Diagnostics", expand_by_default=False):
                self._diagnostics = gui.add_html("")
        for box in self._boxes.values():
            box.on_update(from_user(self._choose_joints, page))
        self._choose_joints()
        # A simulation that hurries needs the processors more than the eye needs smoothness.
        periods = {self._update: _POSE_PERIOD, self._draw: _PLOT_PERIOD, self._show_status: _STATUS_PERIOD}
        for show, period in periods.items():
            page.every(period, show, busy=lambda now: self.pace(now) > MAX_DISPLAY_RTF)

    def lay_line(self, task: TipTask) -> None:
        """Show a line that was sent; from now on the spot's path error is its distance from this one."""
        if self._line is None:
            self._line = LineScene(self._page, "/reference", self._model, task)
        self._line.place(task)
        self._followed = None

    def newest(self) -> JointSample | None:
        """Return the newest state; None where there is none, or its simulation has gone."""
        return None if self._problem(time.monotonic()) else self.state

    def rests(self, seconds: float) -> bool:
        """Tell whether the last trajectory has been over for so long, in simulated time; from any thread."""
        state, span = self.state, self.watch.trajectory
        return state is not None and (span is None or not span.begin <= state.time < span.end + seconds)

    def _choose_joints(self) -> None:
        shown = {name for name, box in self._boxes.items() if box.value}
        for plot in (self._friction, self._deflection, self._velocity, self._torque):
            plot.choose(shown)

    def pace(self, now: float) -> float:
        """Return simulated time per time of the wall clock over the last seconds; `now` is the steady clock's, s."""
        while self._times and self._times[0][0] < now - _PACE_WINDOW:
            self._times.popleft()
        if len(self._times) < 2:
            return 0.0
        (began, first), (ended, last) = self._times[0], self._times[-1]
        return (last - first) / (ended - began)

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
        friction, states, before = self.watch.elements(), self.watch.joints(), self.state
        if friction:
            self._elements = friction[-1]
        elif states and now - self._heard > _STALE:
            self._elements = None  # of a simulation that has gone
        friction = self.watch.elements_at_ticks() if self.watch.listens_at_ticks else friction
        if not states:
            return
        back = np.flatnonzero(np.diff([0.0 if before is None else before.time, *(one.time for one in states)]) < 0.0)
        if len(back):  # another simulation, or reset: nothing that was accepted before is followed
            states = states[back[-1] :]
            self._times.clear()
            self.watch.trajectory = None
        newest, error, self._heard = states[-1], math.nan, now
        self.state, trajectory = newest, self.watch.trajectory
        self._times.append((now, newest.time))
        self.arm.show(newest.position)
        if self._line is not None:
            if len(back):
                self._line.begin_again()
            if trajectory is not self._followed:  # which the line does not know yet
                self._followed = trajectory
                if trajectory is None:
                    none = np.empty((0, len(newest.position)))
                    trajectory = Trajectory(0.0, np.empty(0), none, np.empty(0, dtype=np.bool_))
                tips = forward(self._model.chain, trajectory.position).position
                self._line.follow(trajectory.times, tips, trajectory.at_rest)
            pose = forward(self._model.chain, np.array([state.position for state in states]))
            error = self._line.add(np.array([state.time for state in states]), *pose)[-1]
        if before is None or newest.time != before.time:  # else it stands still
            self._velocity.add(newest.time, newest.velocity)
            self._torque.add(newest.time, newest.effort)
            self._error.add(newest.time, [error * 1e3])
            if self._elements is not None:
                self._friction.add(newest.time, self._elements.effort)
                self._deflection.add(newest.time, self._elements.position * 1e6)
        self._lengthen_loop(friction)

    def _lengthen_loop(self, samples: Sequence[JointSample]) -> None:
        """Add the newest samples of a friction element to its loop; after missing ticks the loop begins anew."""
        if not samples or self._looped.value == _NONE:
            return
        steps = np.diff([self._loop_time, *(sample.time for sample in samples)])
        breaks = np.flatnonzero((steps < 0.0) | (self.watch.listens_at_ticks & (steps > _MAX_SAMPLE_STEP)))
        if len(breaks):
            self._loop.clear()
            samples = samples[breaks[-1] :]
        self._loop_time = samples[-1].time
        column = self._names.index(self._looped.value)
        self._loop.add(*np.array([(sample.velocity[column], sample.effort[column]) for sample in samples]).T)

    def _draw(self, _now: float) -> None:
        for plot in (self._friction, self._deflection, self._loop, self._velocity, self._torque, self._error):
            plot.draw()
        if self._line is not None:
            self._line.draw()
            self._runs.draw(self._line)

    def _show_status(self, now: float) -> None:
        watch = self.watch
        watch.look_around()
        # Friction at every tick costs the simulation a twentieth: where somebody sees it, and time is not in a hurry.
        fastest = MAX_DISPLAY_RTF if watch.listens_at_ticks else _REAL_TIME_FACTOR
        seen = self._looped.value != _NONE and bool(self._page.server.get_clients())
        watch.at_ticks(wanted=seen and self.pace(now) < fastest)
        problem = self._problem(now)
        rows = [("", _colored(problem, 1))]
        if self.state is not None and not problem:
            nodes, time_s, span = watch.diagnostics.values(), self.state.time, watch.trajectory
            # Values that only this node has.
            simulation, controller = (
                next((node for node in nodes if key in node.values), None) for key in ("brakes", "enabled")
            )
            trajectory = "none"
            if span is not None and time_s < span.begin:
                trajectory = f"begins in {span.begin - time_s:.1f} s"
            elif span is not None and time_s <= span.end:
                trajectory = f"{time_s - span.begin:.1f} of {span.end - span.begin:.1f} s"
            rows = [
                ("simulation", _word(simulation)),
                ("time", f"{time_s:.2f} s, {self.pace(now):.2f} &times; real time"),
                ("brakes", html.escape(simulation.values["brakes"]) if simulation else "unknown"),
                ("controller", _word(controller)),
                ("trajectory", trajectory),
                ("path error", "no line" if self._line is None else self._line.words()),
            ]
        self._status.content = _table(rows)
        parts = []
        for name, status in sorted(watch.diagnostics.items()):
            values = _table((html.escape(key), html.escape(value)) for key, value in status.values.items())
            parts.append(block(f"<b>{html.escape(name)}</b>: {_word(status)}{values}"))
        self._diagnostics.content = "".join(parts) or _table([("", "nothing on /diagnostics yet")])


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
