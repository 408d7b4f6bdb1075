"""Running nodes on the page: their newest states, arm, spot and trace, plots, and what they say of themselves."""

from __future__ import annotations

import html
import math
import time
from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from rx90_common.base.quoting import plain
from rx90_common.description.kinematics import tip_position
from rx90_common.description.robot import RobotModel
from rx90_common.exchange.arm_watch import ArmWatch, JointSample, NodeStatus, Trajectory
from rx90_common.exchange.client_node import ClientNode
from rx90_common.exchange.topics import MAX_DISPLAY_RTF
from rx90_common.friction.friction_set import element_names
from rx90_controller.lines.task import LineTask
from rx90_emulator.view.page import Page
from rx90_emulator.view.plots import LoopPlot, RollingPlot, RunComparison
from rx90_emulator.view.scene import ArmScene, LineScene, legend_html

_STALE = 2.5  # s; the samples of a simulation come again four times a second while time stands still
_PACE_WINDOW = 2.0  # s


class LiveSource:
    """The newest state of the arm of running nodes, which may come and go.

    Args:
        client: whose node listens; nothing waits for it.
        robot: the arm that is expected.
        controller: name of the controller node, relative or absolute; the arm is in its namespace.

    Attributes:
        watch: what the nodes publish beside the arm's state.
        elements: the newest state of the friction elements: deflection, velocity, torque; None where it is not known.
        friction: their samples that came with the newest states; at ticks, if it listens there.

    Raises:
        ConfigError: if that cannot be a node's name.
    """

    def __init__(self, client: ClientNode, robot: RobotModel, controller: str) -> None:
        self._robot = str(robot.model.name)
        self.watch = ArmWatch(client.node, controller, robot.joint_names, element_names(robot.joint_names))
        self.friction: list[JointSample] = []
        self.elements: JointSample | None = None
        self._heard: float | None = None
        self._time = 0.0  # simulated, of the newest state
        self._times: deque[tuple[float, float]] = deque()  # steady clock, simulated

    def take(self, now: float) -> list[JointSample]:
        """Return the states that came since the last call.

        Of several runs they are those of the last one alone; `now` is the steady clock's time, s.
        """
        friction, joints = self.watch.elements(), self.watch.joints()
        self.friction = self.watch.elements_at_ticks() if self.watch.listens_at_ticks else friction
        if friction:
            self.elements = friction[-1]
        if not joints:
            return []
        if self._heard is not None and now - self._heard > _STALE:
            self.elements = None  # of a simulation that has gone
        self._heard = now
        times = [self._time, *(sample.time for sample in joints)]
        back = max((k for k in range(len(joints)) if times[k + 1] < times[k]), default=None)
        if back is not None:  # another simulation, or reset: nothing that was accepted before is followed
            joints = joints[back:]
            self._times.clear()
            self.watch.trajectory = None
        self._time = joints[-1].time
        self._times.append((now, self._time))
        return joints

    def problem(self, now: float) -> str:
        """Return why there is nothing to be seen, as a sentence for the user; empty if there is."""
        theirs = self.watch.robot
        if self.watch.publishers and theirs not in {None, self._robot}:
            return f"The simulation's robot is {plain(theirs)}, this page shows {self._robot}: start it with --robot"
        if self._heard is not None and now - self._heard <= _STALE:
            return ""
        if self.watch.problem:
            return f"Another robot? {self.watch.problem}"
        if self._heard is None:
            return f"Waiting for a simulation: nothing on {self.watch.topic} yet"
        return f"The simulation has gone: nothing on {self.watch.topic} any more; waiting for the next one"

    def pace(self, now: float) -> float:
        """Return simulated time per time of the wall clock over the last seconds."""
        while self._times and self._times[0][0] < now - _PACE_WINDOW:
            self._times.popleft()
        if len(self._times) < 2:
            return 0.0
        (began, first), (ended, last) = self._times[0], self._times[-1]
        return (last - first) / (ended - began)

    def node(self, key: str) -> NodeStatus | None:
        """Return what the node says of itself whose values have `key`; None if there is no such node."""
        return next((status for status in self.watch.diagnostics.values() if key in status.values), None)


_POSE_PERIOD = 1.0 / 30.0  # s
_PLOT_PERIOD = 0.2
_STATUS_PERIOD = 0.25
_PACED = 1.05  # simulated s in one of the wall clock, of a simulation that keeps to it
_NO_TRAJECTORY = Trajectory(0.0, np.empty(0), np.empty((0, 6)), np.empty(0, dtype=np.bool_))
_MAGNIFIED = ("1", "10", "100")  # the first is what is drawn at first
_COLORS = ("#2b8a3e", "#e67700", "#c92a2a", "#868e96")  # good, warning, error, stale
_SIMULATION, _CONTROLLER = "brakes", "enabled"  # values that only this node has
_CELL = "padding:1px 0.6em 1px 0"
_FIRST_SHOWN = 3  # joints; all seven at once are hard to tell apart
_GAPS = 5  # in 10 s; more are drawn across
_MISSING = 0.01  # s; a line across so many ticks would be none of friction
_NONE = "none"


class LivePlots:
    """Rolling plots in two tabs, and a choice of joints.

    Args:
        page: to show them on.
        robot: whose joints they are of.
    """

    def __init__(self, page: Page, robot: RobotModel) -> None:
        self._page = page
        joints = robot.joint_names
        self._names = element_names(joints)
        with page.plot_tab("Friction"):
            self._friction = RollingPlot(page, "friction torque [Nm]", self._names, least=1.0)
            self._deflection = RollingPlot(page, "bristle deflection [\u00b5rad]", self._names, least=10.0)
            self._loop = LoopPlot(
                page, "friction against velocity", "velocity [rad/s]", "friction torque [Nm]", least=(0.01, 1.0)
            )
            self._looped = page.gui.add_dropdown("joint of the loop", (*self._names, _NONE))
        with page.plot_tab("Motion"):
            self._velocity = RollingPlot(page, "joint velocity [rad/s]", joints, least=0.01)
            self._torque = RollingPlot(page, "drive torque [Nm]", joints, least=5.0)
            self._error = RollingPlot(
                page,
                "path error of the laser spot [mm]",
                ("laser spot",),
                legend=False,
                gaps=_GAPS,
                least=0.01,
                low=0.0,
            )
        self._looped.on_update(lambda _: page.later(self._loop.clear))
        self._time = self._loop_time = -1.0

    @property
    def shows_loop(self) -> bool:
        """Return whether there is a loop to be drawn."""
        return self._looped.value != _NONE

    def add_choice(self) -> None:
        """Add the choice of joints, in the container that is being filled."""
        with self._page.gui.add_folder("Joints in the plots", expand_by_default=False):
            boxes = [self._page.gui.add_checkbox(name, index < _FIRST_SHOWN) for index, name in enumerate(self._names)]

        def choose() -> None:
            shown = [index for index, box in enumerate(boxes) if box.value]
            for plot in (self._friction, self._deflection, self._velocity, self._torque):
                plot.choose(shown)

        for box in boxes:
            box.on_update(lambda _: self._page.later(choose))
        choose()

    def add(self, state: JointSample, elements: JointSample | None, error: float) -> None:
        """Add a state, that of the friction elements, and the path error of the spot, m, NaN where none counts."""
        if state.time == self._time:
            return  # it stands still
        self._time = state.time
        self._velocity.add(state.time, state.velocity)
        self._torque.add(state.time, state.effort)
        self._error.add(state.time, [error * 1e3])
        if elements is not None:
            self._friction.add(state.time, elements.effort)
            self._deflection.add(state.time, elements.position * 1e6)

    def add_to_loop(self, samples: Sequence[JointSample], *, at_ticks: bool) -> None:
        """Add what came of the friction elements; where ticks are missing the loop begins anew."""
        if not samples or not self.shows_loop:
            return
        times = np.array([self._loop_time, *(sample.time for sample in samples)])
        steps = np.diff(times)
        breaks = np.flatnonzero((steps < 0.0) | (at_ticks & (steps > _MISSING)))
        if len(breaks):
            self._loop.clear()
            samples = samples[breaks[-1] :]
        self._loop_time = samples[-1].time
        column = self._names.index(self._looped.value)
        states = np.array([(sample.velocity[column], sample.effort[column]) for sample in samples])
        self._loop.add(*states.T)

    def draw(self) -> None:
        """Send what is new."""
        for plot in (self._friction, self._deflection, self._loop, self._velocity, self._torque, self._error):
            plot.draw()


def status_html(source: LiveSource, state: JointSample | None, error: str, now: float) -> str:
    """Return a table: what is connected, time and pace, brakes, controller, trajectory, path error.

    Args:
        source: of the nodes.
        state: the newest; None before the first.
        error: path error in words.
        now: the steady clock's time, s.
    """
    problem = source.problem(now)
    if state is None or problem:
        return _table([("", _colored(problem, 1))])
    simulation, controller = source.node(_SIMULATION), source.node(_CONTROLLER)
    rows = [
        ("simulation", _word(simulation)),
        ("time", f"{state.time:.2f} s, {source.pace(now):.2f} &times; real time"),
        ("brakes", html.escape(simulation.values[_SIMULATION]) if simulation else "unknown"),
        ("controller", _word(controller)),
        ("trajectory", _trajectory(source, state)),
        ("path error", error),
    ]
    return _table(rows)


def diagnostics_html(nodes: dict[str, NodeStatus]) -> str:
    """Return all that the nodes have said of themselves."""
    if not nodes:
        return _table([("", "nothing on /diagnostics yet")])
    parts = []
    for name, status in sorted(nodes.items()):
        values = [(html.escape(key), html.escape(value)) for key, value in status.values.items()]
        parts.append(f"<b>{html.escape(name)}</b>: {_word(status)}{_table(values)}")
    return "".join(f'<div style="padding:0.2em 0.6em;font-size:0.8em">{part}</div>' for part in parts)


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


def _trajectory(source: LiveSource, state: JointSample) -> str:
    span = source.watch.trajectory
    if span is None or state.time > span.end:
        return "none"
    if state.time < span.begin:
        return f"begins in {span.begin - state.time:.1f} s"
    return f"{state.time - span.begin:.1f} of {span.end - span.begin:.1f} s"


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
        self.state: JointSample | None = None
        self.arm = ArmScene(page, "/arm", robot)
        self._line = None if line is None else LineScene(page, "/reference", np.array(line.start), np.array(line.end))
        self._plots = LivePlots(page, robot)
        self._runs = RunComparison(page)
        page.look_at_arm(robot)
        with page.tab("Live"):
            self._status = page.gui.add_html("")
            if self._line is not None:
                page.gui.add_html(legend_html("line and approach of the form"))
                magnified = page.gui.add_dropdown(
                    "error drawn \u00d7",
                    _MAGNIFIED,
                    hint="the trace is drawn so many times as far from the line as it was",
                )
                clear = page.gui.add_button("Clear the trace")
                trace = self._line
                magnified.on_update(lambda _: page.later(lambda: trace.magnify(float(magnified.value))))
                clear.on_click(lambda _: page.later(trace.clear))
            self._plots.add_choice()
            with page.gui.add_folder("Diagnostics", expand_by_default=False):
                self._diagnostics = page.gui.add_html("")
        # A simulation that hurries needs the processors more than the eye needs smoothness.
        for period, show in ((_POSE_PERIOD, self._update), (_PLOT_PERIOD, self._draw), (_STATUS_PERIOD, self._tell)):
            page.every(period, show, hurries=lambda now: source.pace(now) > MAX_DISPLAY_RTF)

    def lay_line(self, task: LineTask) -> None:
        """Show a line that was sent; from now on the spot's path error is its distance from this one."""
        start, end = np.array(task.start), np.array(task.end)
        if self._line is None:
            self._line = LineScene(self._page, "/reference", start, end)
        self._line.place(start, end)
        self._followed = None

    def newest(self) -> JointSample | None:
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
            trajectory = self._source.watch.trajectory
            if trajectory is not self._followed:  # which the line does not know yet
                self._followed = trajectory
                _, times, position, at_rest = trajectory or _NO_TRAJECTORY
                self._line.meter.follow(times, tip_position(self._chain, position), at_rest)
            tips = tip_position(self._chain, np.array([state.position for state in states]))
            error = self._line.add(np.array([state.time for state in states]), tips)
        self.state = newest
        self._plots.add(newest, self._source.elements, error)
        self._plots.add_to_loop(self._source.friction, at_ticks=self._source.watch.listens_at_ticks)

    def _draw(self, _now: float) -> None:
        self._plots.draw()
        if self._line is not None:
            self._line.draw()
            self._runs.draw(self._line)

    def _tell(self, now: float) -> None:
        watch = self._source.watch
        watch.look_around()
        # Friction at every tick costs the simulation a twentieth: where somebody sees it, and time is not in a hurry.
        fastest = MAX_DISPLAY_RTF if watch.listens_at_ticks else _PACED
        seen = self._plots.shows_loop and bool(self._page.server.get_clients())
        watch.at_ticks(wanted=seen and self._source.pace(now) < fastest)
        error = "no line" if self._line is None else self._line.meter.words()
        for shown, content in (
            (self._status, status_html(self._source, self.state, error, now)),
            (self._diagnostics, diagnostics_html(watch.diagnostics)),
        ):
            if shown.content != content:
                shown.content = content
