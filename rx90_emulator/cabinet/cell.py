"""The cell: the arm in its closed loop, its signals and its time, beat by beat.

Outputs are from 1, inputs from 1001, software signals from 2001, the hand's from 3001.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import read_yaml
from rx90_common.base.errors import ConfigError, DivergenceError, ExchangeError, SupervisionError
from rx90_common.base.quoting import plain, quoted
from rx90_emulator.cabinet.arm import ProgrammedArm
from rx90_emulator.cabinet.errors import VplusError
from rx90_emulator.cabinet.queue import MotionQueue

PERIOD = 16e-3
"""Of set-points, s, from one beat to the next."""
_SIGNALS = range(1, 4001)
_INPUTS = frozenset(range(1001, 2001))
_OUTPUTS = frozenset(_SIGNALS) - _INPUTS
_ACCEPTED_INPUTS = (
    "inputs from 1001 to 2000, and times >= 0 at which each goes on, off and so on, s, increasing"
)


class Change(NamedTuple):
    """A signal that went on or off at a simulated time, s."""

    time: float
    signal: int
    on: bool


def load_inputs(file: Path) -> list[Change]:
    """Read the times at which inputs change: `1001: 1.0`, or `1001: [1.0, 2.5]` for on and off in turns.

    Raises:
        ConfigError: naming the value and what is accepted.
    """
    changes: list[Change] = []
    content: dict[Any, Any] = read_yaml(file, _ACCEPTED_INPUTS, numbered=True)
    for signal, value in content.items():
        try:
            times = np.array(value, dtype=np.float64).ravel()
        except (TypeError, ValueError):
            times = np.array([np.nan])
        if signal not in _INPUTS or not (np.diff(times, prepend=-1e-9) > 0.0).all():
            raise ConfigError(
                f"{plain(file)}: {quoted(signal)}: {quoted(value)}; accepted: {_ACCEPTED_INPUTS}"
            )
        changes += [
            Change(float(time), int(signal), turn % 2 == 0) for turn, time in enumerate(times)
        ]
    return sorted(changes)


class Drive(Protocol):
    """What follows the set-points: the closed loop, or running nodes.

    Attributes:
        start: measured joint angles in the beginning, rad, shape (6,).
        outage: why the power has gone, though nobody here has switched it off; empty if it has not.
    """

    start: Array
    outage: str

    def send(self, time: float, position: Array, velocity: Array) -> None:
        """Go to joint angles, rad, with speeds, rad/s, until a time, s, and let that time come."""

    def position(self) -> Array:
        """Return the measured joint angles, rad, shape (6,)."""

    def rest(self, time: float) -> Array:
        """Stand where the arm is from a time, s, on, its power cut; return its joint angles, rad, shape (6,)."""

    def power(self, on: bool) -> None:
        """Switch the power on or off.

        Raises:
            ExchangeError: if a node refuses, or does not answer.
        """


class Cell:
    """The arm, its signals and the time, which goes on by one beat after the other.

    Args:
        arm: its kinematics and limits.
        drive: what moves the arm.
        inputs: changes of inputs, in the order of their times.
        period: of a beat, s.

    Attributes:
        arm: as given.
        queue: its motions.
        changes: of outputs, in their order.
        publish: gets the outputs that are on, at the first beat and where they have changed since the last one.
        show: gets what TYPE shows, with its time, s, and whether a line ends behind it.
        ask: asks for a line of text with a question; gives None while there is none.
        switches: system switches that are on.
        tolerance: of the position errors at the end of a motion, as a share of the arm's.
        beats: that have passed.
    """

    def __init__(
        self,
        arm: ProgrammedArm,
        drive: Drive,
        inputs: Iterable[Change] = (),
        period: float = PERIOD,
    ) -> None:
        self.arm = arm
        self.drive = drive
        self.queue = MotionQueue(arm, drive.start)
        self.period = period
        self.changes: list[Change] = []
        self.publish: Callable[[set[int]], None] = lambda _: None
        self.show: Callable[[str, float, bool], None] = lambda *_: None
        self.ask: Callable[[str], str | None] = input
        self.switches = {"POWER", "CP", "ROBOT", "MESSAGES", "SCALE.ACCEL", "UPPER"}
        self.tolerance = 1.0
        self.beats = 0
        self._planned = list(inputs)
        self._on: set[int] = set()
        self._published: set[int] | None = None
        if drive.outage:
            self._cut()

    @property
    def time(self) -> float:
        """Return the simulated time, s."""
        return self.beats * self.period

    @property
    def settled(self) -> bool:
        """Return whether the arm stands where it should at the end of a motion."""
        error = np.degrees(np.abs(self.drive.position() - self.queue.position))
        return bool(error.max() <= self.tolerance * self.arm.full.null_tolerance)

    def advance(self) -> None:
        """Let one beat pass.

        Raises:
            VplusError: if the arm diverges, or its power is cut; all motions are dropped then.
            ExchangeError: if nodes are silent.
        """
        if self.outputs() != self._published:
            self._published = self.outputs()
            self.publish(self._published)
        if self.drive.outage and self.switches & {"POWER", "DRY.RUN"} == {"POWER"}:
            self._cut()
            raise VplusError("Robot power off", self.drive.outage)
        setpoint = self.queue.advance(self.period, self.time)
        try:
            self.drive.send((self.beats + 1) * self.period, *setpoint)
        except (SupervisionError, DivergenceError) as error:
            self._cut()
            raise VplusError("Soft envelope error", f"at {self.time:.3f} s: {error}") from error
        self.beats += 1
        while self._planned and self._planned[0].time <= self.time:
            _, signal, on = self._planned.pop(0)
            self._on = self._on | {signal} if on else self._on - {signal}
        self.queue.begin_waiting(self.settled, self.time)

    def _cut(self) -> None:
        self.switches.discard("POWER")
        self.queue.drop(self.drive.rest(self.time))

    def power(self, on: bool) -> None:
        """Switch the power on, or off: the motion under way ends then.

        Raises:
            VplusError: if a node refuses, or does not answer; the power is off then.
        """
        if on == ("POWER" in self.switches) and not self.drive.outage:
            return
        self.queue.stop()
        self.switches.discard("POWER")
        try:
            self.drive.power(on)
        except ExchangeError as error:
            raise VplusError("Device not ready", str(error)) from error
        if on:
            self.queue.drop(self.drive.position())
            self.switches.add("POWER")

    def receive(self, on: set[int]) -> None:
        """Take the inputs that are on; the others are off."""
        self._on = self.outputs() | (on & _INPUTS)

    def outputs(self) -> set[int]:
        """Return the outputs that are on."""
        return self._on - _INPUTS

    def is_on(self, signal: int) -> bool:
        """Return whether a signal is as its number says: on, or off for a negative number.

        Raises:
            VplusError: if there is no such signal.
        """
        if abs(signal) not in _SIGNALS:
            raise VplusError("Illegal digital signal", str(signal))
        return (abs(signal) in self._on) == (signal > 0)

    def switch(self, *signals: int) -> None:
        """Switch outputs on, or off for negative numbers.

        Raises:
            VplusError: for what is no output.
        """
        for signal in signals:
            if abs(signal) not in _OUTPUTS:
                raise VplusError("Illegal digital signal", str(signal))
            if not self.is_on(signal):
                self._on ^= {abs(signal)}
                self.changes.append(Change(self.time, abs(signal), signal > 0))
