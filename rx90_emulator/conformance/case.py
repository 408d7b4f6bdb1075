"""A case of the battery: an arm, its set-points and its metrics; and the record of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array, interpolated
from rx90_controller.lines.task import LineTask
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.setup import Setup

START = 0.5
"""Start of the trajectory of each case, s: before it the controller takes over the weight of the arm."""


@dataclass(frozen=True)
class Metric:
    """A quantity that a case measures, and its limit: `factor` times the CS7B's value, and an allowance.

    Attributes:
        name: of the quantity.
        unit: of its values.
        about: in words.
        measure: returns the values of a run, one for each joint, or one alone for the tool, shape (n,) or (1,).
        factor: on the CS7B's value.
        allowance: added to that.
    """

    name: str
    unit: str
    about: str
    measure: Callable[[Record], Array]
    factor: float = 0.0
    allowance: float = 0.0


@dataclass(frozen=True, eq=False)
class Case:
    """One run of the battery.

    Attributes:
        name: of the case.
        about: in words.
        setup: the simulated arm, read from its files; the controller is designed for the nominal one.
        points: the trajectory, which starts at START.
        watched: how long the run goes on after the trajectory, s.
        metrics: what is measured.
        task: the line that the tool follows, if any.
    """

    name: str
    about: str
    setup: Setup
    points: TrajectoryPoints
    watched: float
    metrics: Sequence[Metric]
    task: LineTask | None = None

    @property
    def end(self) -> float:
        """Return when the trajectory ends, s."""
        return START + float(self.points.times[-1])

    @property
    def ticks(self) -> int:
        """Return how many base ticks the run takes."""
        return self.setup.rates.ticks_of(self.end + self.watched)

    @cached_property
    def set_points(self) -> Array:
        """Return position, velocity and acceleration, one row for each tick of the position loop, shape (m, 3, n)."""
        trajectory = self.setup.cs7b().trajectory
        trajectory.reset(np.array(self.points.position[0]))
        trajectory.accept(self.points, 0, self.setup.rates.start_tick(START))
        return trajectory.setpoints(0, -(-self.ticks // self.setup.rates.ratio))


class Record:
    """A run of a case, command by command.

    Args:
        case: what is run.
        at_joints: whether efforts at the joints are commanded (`joint_commands`), not torques of the motors.
        ticks_per_command: base ticks from one command to the next.

    Attributes:
        fault: why the run ended early, if it did.
    """

    def __init__(self, case: Case, at_joints: bool = False, ticks_per_command: int = 1) -> None:
        self.case = case
        self.at_joints = at_joints
        self.ticks_per_command = ticks_per_command
        self.period = ticks_per_command * case.setup.rates.period
        self.fault = ""
        self._states: list[Array] = []
        self._sent: list[Array] = []
        self._none = np.full(len(case.setup.robot.joint_names), np.nan)

    def note(self, tick: int, position: Array, command: Array | None) -> None:
        """Keep a command; one more for the same tick takes its place.

        Args:
            tick: of the states.
            position: measured, rad, shape (n,), on the controller's side.
            command: the controller's answer, Nm, shape (n,), None for no torque.
        """
        row = tick // self.ticks_per_command
        self._states[row:] = [position.copy()]
        self._sent[row:] = [self._none if command is None else command.copy()]

    @property
    def complete(self) -> bool:
        """Return whether the run came to its end."""
        return len(self._sent) * self.ticks_per_command >= self.case.ticks

    @cached_property
    def times(self) -> Array:
        """Return the times of the commands, s, shape (t,)."""
        return np.asarray(np.arange(len(self._sent)) * self.period)

    @cached_property
    def sent(self) -> Array:
        """Return what the controller commanded, at motors or joints, Nm, shape (t, n); NaN for no torque."""
        return np.array(self._sent)

    @cached_property
    def torque(self) -> Array:
        """Return the commanded torques at the joints, Nm, shape (t, n)."""
        drives = self.case.setup.drives
        return self.sent if self.at_joints else self.sent * drives.gear @ drives.turning.turns

    @cached_property
    def position(self) -> Array:
        """Return positions of the joints by the encoders, rad, shape (t, n)."""
        states = np.array(self._states)
        drives = self.case.setup.drives
        return states if self.at_joints else states / drives.gear @ drives.turning.joint_turns.T

    @cached_property
    def error(self) -> Array:
        """Return set-points less positions, rad, shape (t, n); between two of them the set-point moves on."""
        points = self.case.set_points[:, 0]
        rates = self.case.setup.rates
        at = np.arange(len(points)) * rates.position_period
        return interpolated(self.times, at, points) - self.position
