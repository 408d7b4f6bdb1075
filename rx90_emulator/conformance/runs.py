"""Runs of a case: what happens to commands on their way, what is kept, and the CS7B on the compiled loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import DivergenceError
from rx90_common.description.drives import to_joint, to_joint_torque
from rx90_emulator.conformance.battery import START, Case
from rx90_emulator.loop.setup import Setup


@dataclass(frozen=True, eq=False)
class Record:
    """What is kept of a run, tick by tick, as far as it came.

    Attributes:
        case: what was run.
        position: of the joints by the encoders, rad, shape (n, 6).
        command: what the controller asked for, at the joints, Nm, shape (n, 6); NaN where it asked for none.
        sent: the same at the motors (or at the joints, for a controller that commands those).
        fault: why the run ended early, if it did.
    """

    case: Case
    position: Array
    command: Array
    sent: Array
    fault: str | None = None

    @property
    def times(self) -> Array:
        """Return the times of the ticks, s, shape (n,)."""
        return self.case.times[: len(self.position)]


class Wire:
    """The way of the commands to the drives in one case, and its record.

    Args:
        case: the case.
        scale: of the added torques: from motors to what is commanded, shape (6,).
    """

    def __init__(self, case: Case, scale: Array | None = None) -> None:
        self.case = case
        scale = np.ones(6) if scale is None else scale
        self._added = None if case.sines is None else case.sines.torques(case.times) * scale
        self.states, self.sent = np.full((case.ticks, 6), np.nan), np.full((case.ticks, 6), np.nan)
        self.done = 0
        self._held: Array | None = None

    def note_states(self, tick: int, position: Array) -> None:
        """Keep positions, rad, shape (6,), of a tick."""
        if tick < len(self.states):
            self.states[tick] = position

    def carry(self, tick: int, command: Array | None) -> Array | None:
        """Return what the drives get of a command, Nm, shape (6,), None for no torque."""
        if command is not None:
            self.sent[tick] = command
        self.done = max(self.done, tick + 1)
        if self.case.lost is not None and self.case.lost[tick]:
            return self._held
        if command is not None and self._added is not None:
            command = command + self._added[tick]
        self._held = None if command is None else command.copy()
        return command

    def record(self, *, at_motors: bool = True, fault: str | None = None) -> Record:
        """Return the record; positions were noted at the motors, commands there or at the joints."""
        gear = self.case.setup.drives.gear
        position, command = np.full((self.done, 6), np.nan), self.sent[: self.done].copy()
        for k in range(self.done):
            to_joint(gear, self.states[k], position[k])
            if at_motors:
                to_joint_torque(gear, self.sent[k], command[k])
        return Record(self.case, position, command, self.sent[: self.done], fault)


def run_cs7b(case: Case, nominal: Setup) -> Record:
    """Run a case with the CS7B of the nominal arm, without ROS: the numbers that its node gives, bit for bit."""
    plant, law, wire = case.setup.plant(), nominal.cs7b(), Wire(case)
    plant.reset(case.points.position[0])
    states = plant.motor_states()
    law.reset(states[0])
    start = case.setup.rates.start_tick(START)
    for tick in range(case.ticks):
        wire.note_states(tick, states[0])
        if law.on_position_tick and law.position_tick == 0:
            law.trajectory.accept(case.points, 0, start)
        command = law.step(*states)
        try:
            plant.step(wire.carry(tick, command if law.fault is None else None))
        except DivergenceError as error:
            return wire.record(fault=str(error))
    return wire.record()


def set_points(case: Case, nominal: Setup) -> Array:
    """Return position, velocity and acceleration of the set-points, one in each tick of the position loop, (m, 3, 6).

    Before the trajectory the arm is to stay where it is, after it at its end.
    """
    law, rates = nominal.cs7b(), case.setup.rates
    law.trajectory.reset(np.array(case.points.position[0]))
    law.trajectory.accept(case.points, 0, rates.start_tick(START))
    return law.trajectory.setpoints(0, -(-case.ticks // rates.ratio))
