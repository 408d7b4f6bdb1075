"""The emulated rig: the real firmware on a board, wired to an emulated plant, in virtual time."""

from __future__ import annotations

from typing import Protocol

from friction_bench.protocol.errors import RigInputError
from friction_bench.rig.native import NativeBoard, native_library
from friction_bench.rig.plant import PART_PERIOD, RigPlant
from friction_bench.rig.rig_file import CODES, Rig

SLICE_US = round(PART_PERIOD * 1e6)
"""Firmware and plant exchange DAC, ADC and encoder this often."""


class Board(Protocol):
    """What runs the firmware: this computer, or a simulated microcontroller."""

    def write(self, data: bytes) -> None:
        """Put bytes on the line to the board."""

    def read(self) -> bytes:
        """Return what the board has sent."""

    def run(self, slice_us: int, edges: int, adc: int) -> None:
        """Let time pass with these encoder edges, negative where the motor turned back, and this ADC code."""

    @property
    def dac(self) -> int:
        """Return the code on the DAC."""

    @property
    def stage_on(self) -> bool:
        """Return whether the power stage is enabled."""


class EmulatedRig:
    """Board and plant, advanced together; nothing happens between calls.

    Args:
        rig: the rig file; it must have an `emulation` section.
        seed: of all noise.
        board: where the firmware runs; by default natively.

    Raises:
        RigInputError: if the rig file describes no plant.
        RigError: if the firmware cannot be built.
    """

    def __init__(self, rig: Rig, seed: int = 0, board: Board | None = None) -> None:
        if rig.plant is None:
            raise RigInputError(f"{rig.file}: has no section 'emulation', so this rig cannot be emulated")
        self.rig = rig
        self.board: Board = board or NativeBoard(rig.baud, native_library(rig.firmware_figures))
        self.plant = RigPlant(rig.plant, rig.counts_per_revolution, seed, rig.counts_down)
        self.time = 0.0
        self._edges = 0
        self._adc = 0

    def advance(self, seconds: float) -> None:
        """Let whole slices of virtual time pass, at least one."""
        for _ in range(max(1, round(seconds * 1e6 / SLICE_US))):
            self.board.run(SLICE_US, self._edges, self._adc)
            command = self.rig.torque(self.board.dac) if self.board.stage_on else 0.0
            self._edges = self.plant.advance(command, SLICE_US * 1e-6)
            reading = self.plant.current_reading() / self.rig.adc_full_scale * CODES
            self._adc = min(CODES, round(reading))
            self.time += SLICE_US * 1e-6


class VirtualPort:
    """A line to an emulated rig on which waiting costs no time."""

    def __init__(self, emulated: EmulatedRig) -> None:
        self.emulated = emulated

    def now(self) -> float:
        """Return virtual time, s."""
        return self.emulated.time

    def write(self, data: bytes) -> None:
        """Send bytes to the rig."""
        self.emulated.board.write(data)

    def write_first(self, data: bytes) -> None:
        """Send bytes; nothing waits here."""
        self.write(data)

    def read(self, timeout: float) -> bytes:
        """Return the next bytes of the rig; after `timeout` seconds, none."""
        end = self.emulated.time + timeout
        while True:
            data = self.emulated.board.read()
            if data or self.emulated.time >= end:
                return data
            self.emulated.advance(SLICE_US * 1e-6)

    def close(self) -> None:
        """Leave the rig to itself."""
