"""Plots of the running arm: friction, its loop against velocity, and the motion of chosen joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rx90_common.description.robot import RobotModel
from rx90_common.exchange.arm_watch import JointSample
from rx90_common.friction.friction_set import element_names
from rx90_emulator.view.page import Page
from rx90_emulator.view.plots import LoopPlot, RollingPlot
from rx90_emulator.view.state import ArmState

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

    def add(self, state: ArmState, error: float) -> None:
        """Add a state, and the path error of the spot, m, NaN where none counts."""
        if state.time == self._time:
            return  # it stands still
        self._time = state.time
        self._velocity.add(state.time, state.velocity)
        self._torque.add(state.time, state.torque)
        self._error.add(state.time, [error * 1e3])
        if state.friction is not None:
            self._friction.add(state.time, state.friction.torque)
            self._deflection.add(state.time, state.friction.deflection * 1e6)

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
