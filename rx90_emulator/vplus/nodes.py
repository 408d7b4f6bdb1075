"""Programs of V+ on running nodes: the controller gets set-points one by one, and the arm's position comes back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from rx90_common.base.arrays import Array
from rx90_emulator.loop.setup import Setup
from rx90_emulator.vplus.arm import ProgrammedArm
from rx90_emulator.vplus.cell import Cell
from rx90_emulator.vplus.motion import MotionQueue
from rx90_emulator.vplus.signals import INPUTS, Change, Signals


class Nodes(Protocol):
    """Running nodes, as `rx90_controller.node.program_client.ProgramClient` reaches them."""

    start: Array

    def position(self) -> Array:
        """Return the measured joint angles, rad, shape (6,)."""

    def send(self, time: float, position: Array, velocity: Array) -> None:
        """Send a set-point for a time, s, and let the arm come to it."""

    def signals(self, receive: Callable[[set[int]], None]) -> Callable[[set[int]], None]:
        """Return what publishes the outputs that are on; `receive` gets the inputs that are on."""


class NodesDrive:
    """Running nodes, a beat at a time."""

    def __init__(self, nodes: Nodes, signals: Signals, period: float) -> None:
        self._nodes = nodes
        self._signals = signals
        self._period = period
        self._beats = 0
        self._sent: set[int] | None = None
        self._publish = nodes.signals(self._receive)

    def _receive(self, on: set[int]) -> None:
        for signal in INPUTS:
            self._signals.receive(signal, signal in on)

    def position(self) -> Array:
        """Return the measured joint angles, rad, shape (6,)."""
        return self._nodes.position()

    def follow(self, position: Array, velocity: Array) -> None:
        """Go to joint angles, rad, with speeds, rad/s, within the next beat."""
        outputs = self._signals.outputs()
        if outputs != self._sent:
            self._publish(outputs)
            self._sent = outputs
        self._beats += 1
        self._nodes.send(self._beats * self._period, position, velocity)


def cell_on_nodes(setup: Setup, nodes: Nodes, inputs: Sequence[Change], period: float) -> Cell:
    """Return the cell of running nodes; its programs begin where the arm is."""
    arm = ProgrammedArm(setup)
    signals = Signals([*inputs])
    return Cell(arm, NodesDrive(nodes, signals, period), MotionQueue(arm, nodes.start), period, signals)
