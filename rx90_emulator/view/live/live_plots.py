"""Plots of the running arm: friction, its loop against velocity, and the motion of chosen joints."""

from __future__ import annotations

from rx90_common.description.robot import RobotModel
from rx90_common.friction.friction_set import element_names
from rx90_emulator.view.page import Page
from rx90_emulator.view.plots import LoopPlot, RollingPlot
from rx90_emulator.view.state import ArmState

_FIRST_SHOWN = 3  # joints; all seven at once are hard to tell apart
_GAPS = 5  # in 10 s; more are drawn across
_RESTS = 1e-4  # rad/s; a joint that creeps would fill the loop with rounding


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
            self._friction = RollingPlot(page, "friction torque [Nm]", self._names)
            self._deflection = RollingPlot(page, "bristle deflection [\u00b5rad]", self._names)
            self._loop = LoopPlot(page, "friction against velocity", "velocity [rad/s]", "friction torque [Nm]")
            self._looped = page.gui.add_dropdown("joint of the loop", self._names)
        with page.plot_tab("Motion"):
            self._velocity = RollingPlot(page, "joint velocity [rad/s]", joints)
            self._torque = RollingPlot(page, "drive torque [Nm]", joints)
            self._error = RollingPlot(
                page, "path error of the laser spot [mm]", ("laser spot",), legend=False, gaps=_GAPS
            )
        self._looped.on_update(lambda _: page.later(self._loop.clear))
        self._time = -1.0

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

    def add(self, state: ArmState, error: float | None) -> None:
        """Add a state, and the distance of the spot from the line, m, while it is on it."""
        if state.time == self._time:
            return  # it stands still
        if state.time < self._time:
            self._loop.clear()
        self._time = state.time
        self._velocity.add(state.time, state.velocity)
        self._torque.add(state.time, state.torque)
        self._error.add(state.time, [float("nan") if error is None else error * 1e3])
        if state.friction is not None:
            self._friction.add(state.time, state.friction.torque)
            self._deflection.add(state.time, state.friction.deflection * 1e6)
            index = self._names.index(self._looped.value)
            velocity = float(state.friction.velocity[index])
            if abs(velocity) > _RESTS:
                self._loop.add(velocity, float(state.friction.torque[index]))

    def draw(self) -> None:
        """Send what is new."""
        for plot in (self._friction, self._deflection, self._loop, self._velocity, self._torque, self._error):
            plot.draw()
