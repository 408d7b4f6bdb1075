"""A run of a case: what happens to commands on their way, what is kept, and the CS7B on the compiled loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import DivergenceError
from rx90_emulator.conformance.battery import START, Case
from rx90_emulator.loop.setup import Setup


@dataclass(frozen=True, eq=False)
class Interface:
    """What the controller commands, and how often.

    Attributes:
        at_joints: efforts at the joints (`joint_commands`), not torques of the motors (`motor_commands`).
        ticks: base ticks from one command to the next.
    """

    at_joints: bool = False
    ticks: int = 1


@dataclass(frozen=True, eq=False)
class Record:
    """What is kept of a run, command by command, as far as it came.

    Attributes:
        case: what was run.
        interface: what was commanded.
        position: of the joints by the encoders, rad, shape (t, n).
        torque: what the controller asked for, at the joints, Nm, shape (t, n); NaN where it asked for none.
        sent: the same as it was sent, at the motors or at the joints.
        added: the torques that were added to it.
        fault: why the run ended early, if it did.
    """

    case: Case
    interface: Interface
    position: Array
    torque: Array
    sent: Array
    added: Array
    fault: str | None = None

    @property
    def period(self) -> float:
        """Return the time from one command to the next, s."""
        return self.interface.ticks * self.case.setup.rates.period

    @property
    def times(self) -> Array:
        """Return the times of the commands, s, shape (n,)."""
        return np.asarray(np.arange(len(self.position)) * self.period)


class Wire:
    """The way of the commands to the drives in one case, and its record.

    Args:
        case: the case.
        interface: of the controller.
    """

    def __init__(self, case: Case, interface: Interface | None = None) -> None:
        self.case, self.interface = case, interface or Interface()
        rows = -(-case.ticks // self.interface.ticks)
        joints = len(case.setup.robot.joint_names)
        self._added = np.zeros((rows, joints))
        if case.sines is not None:
            scale = np.abs(case.setup.drives.gear) if self.interface.at_joints else 1.0
            times = case.setup.rates.period * self.interface.ticks * np.arange(rows, dtype=np.float64)
            self._added = case.sines.torques(times) * scale
        self._states, self._sent = np.full((rows, joints), np.nan), np.full((rows, joints), np.nan)
        self._held: Array | None = None
        self.done = 0

    def note_states(self, tick: int, position: Array) -> None:
        """Keep the measured positions of a tick, rad, shape (n,), on the controller's side."""
        self._states[tick // self.interface.ticks] = position

    def carry(self, tick: int, command: Array | None) -> Array | None:
        """Return what the drives get of a command, Nm, shape (n,), None for no torque; the same when it comes again."""
        row, case = tick // self.interface.ticks, self.case
        if command is not None:
            self._sent[row] = command
        self.done = row + 1
        if case.lost is not None and case.lost[tick]:
            return self._held
        self._held = None if command is None else command + self._added[row]
        return self._held

    def record(self, fault: str | None = None) -> Record:
        """Return the record so far."""
        states, sent = self._states[: self.done], self._sent[: self.done]
        position, torque, drives = states.copy(), sent.copy(), self.case.setup.drives
        if not self.interface.at_joints:
            position = states / drives.gear @ drives.turning.joint_turns.T
            torque = sent * drives.gear @ drives.turning.turns
        return Record(self.case, self.interface, position, torque, sent, self._added[: self.done], fault)


def run_cs7b(case: Case, nominal: Setup) -> Record:
    """Run a case with the CS7B of the nominal arm, without ROS: the numbers that its node gives, bit for bit."""
    plant, law, wire = case.setup.plant(), nominal.cs7b(), Wire(case)
    plant.reset(case.points.position[0])
    states = plant.motor_states()
    law.reset(states[0])
    law.trajectory.accept(case.points, 0, case.setup.rates.start_tick(START))
    for tick in range(case.ticks):
        wire.note_states(tick, states[0])
        command = law.step(*states)
        try:
            plant.step(wire.carry(tick, None if law.fault else command))
        except DivergenceError as error:
            return wire.record(str(error))
    return wire.record()


def set_points(case: Case, nominal: Setup) -> Array:
    """Return position, velocity and acceleration of the set-points, one in each tick of the position loop, (m, 3, 6).

    Before the trajectory the arm is to stay where it is, after it at its end.
    """
    law, rates = nominal.cs7b(), case.setup.rates
    law.trajectory.reset(np.array(case.points.position[0]))
    law.trajectory.accept(case.points, 0, rates.start_tick(START))
    return law.trajectory.setpoints(0, -(-case.ticks // rates.ratio))
