"""The emulated rig: the real firmware on a board, wired to an emulated plant, in virtual or in real time."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import time
import tty
from pathlib import Path

from friction_bench.protocol.messages import RigInputError
from friction_bench.rig.native import NativeBoard, native_library
from friction_bench.rig.plant import SLICE, RigPlant
from friction_bench.rig.rig_file import CODES, Rig

SLICE_US = round(SLICE * 1e6)
"""Firmware and plant exchange DAC, ADC and encoder this often."""
_LONGEST_STEP = 0.02


class EmulatedRig:
    """Board and plant, advanced together; nothing happens between calls.

    Args:
        rig: the rig file; it must have an `emulation` section.
        seed: of all noise.
        board: where the firmware runs; by default this computer.

    Raises:
        RigInputError: if the rig file describes no plant.
        RigError: if the firmware cannot be built.
    """

    def __init__(self, rig: Rig, seed: int = 0, board: NativeBoard | None = None) -> None:
        self.plant = RigPlant(rig, seed)
        self.rig = rig
        self.board = board or NativeBoard(rig.baud, native_library(rig.firmware_figures))
        self.time = 0.0
        self._edges = 0
        self._adc = 0

    def advance(self, seconds: float) -> None:
        """Let whole slices of virtual time pass, at least one."""
        for _ in range(max(1, round(seconds * 1e6 / SLICE_US))):
            self.board.run(SLICE_US, self._edges, self._adc)
            command = self.rig.torque(self.board.dac) if self.board.stage_on else 0.0
            self._edges = self.plant.advance(command, SLICE)
            self._adc = min(CODES, round(self.plant.current_reading() / self.rig.adc_full_scale * CODES))
            self.time += SLICE


class VirtualPort:
    """A line to an emulated rig on which waiting costs no time."""

    def __init__(self, emulated: EmulatedRig) -> None:
        self.emulated = emulated

    def now(self) -> float:
        """Return virtual time, s."""
        return self.emulated.time

    def write(self, data: bytes, *, first: bool = False) -> None:  # noqa: ARG002 - nothing waits here
        """Send bytes to the rig."""
        self.emulated.board.write(data)

    def read(self, timeout: float) -> bytes:
        """Return the next bytes of the rig; after `timeout` seconds, none."""
        end = self.emulated.time + timeout
        while True:
            data = self.emulated.board.read()
            if data or self.emulated.time >= end:
                return data
            self.emulated.advance(SLICE)

    def close(self) -> None:
        """Leave the rig to itself."""


class PtyRig:
    """Runs an emulated rig on a thread until `close`.

    Time that the computer does not give this program is lost to the rig too: it never runs faster than real
    time to catch up, because its host, starved as well, would seem silent to it.

    Args:
        emulated: the rig.
        link: a path that shall point to the pseudo-terminal, replaced if it is a symbolic link already.

    Attributes:
        path: what a serial program opens.
    """

    def __init__(self, emulated: EmulatedRig, link: Path | None = None) -> None:
        self.emulated = emulated
        self._master, self._slave = pty.openpty()
        # Raw before anybody opens it, and held open here: a line without an opener would echo and lose bytes.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._link = link
        if link is not None:
            try:
                if link.is_symlink():
                    link.unlink()
                link.symlink_to(self.path)
            except OSError as error:
                raise RigInputError(f"{link}: cannot point to the emulated rig ({error.strerror})") from error
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="emulated rig", daemon=True)
        self._thread.start()

    def load(self, loaded: bool) -> None:
        """Couple the revolute joint, or take it off."""
        with self._lock:
            self.emulated.plant.load(loaded)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.is_set():
            behind = time.monotonic() - due
            if behind < SLICE:
                select.select([self._master], [], [], 2 * SLICE)
            if behind > _LONGEST_STEP:
                due += behind - _LONGEST_STEP
                behind = _LONGEST_STEP
            slices = int(behind / SLICE)
            if slices:
                due += slices * SLICE
                with self._lock:
                    self._exchange(slices * SLICE)

    def _exchange(self, seconds: float) -> None:
        """Let time pass, between what has come on the line and what leaves on it."""
        with contextlib.suppress(OSError):
            self.emulated.board.write(os.read(self._master, 4096))
        self.emulated.advance(seconds)
        with contextlib.suppress(OSError):  # nobody reads: a full line loses bytes, as a real one does
            os.write(self._master, self.emulated.board.read())

    def close(self) -> None:
        """End the rig: for its opener, this is an unplugged cable."""
        self._stop.set()
        self._thread.join()  # as late as it may be: it must not write to what has got the descriptor's number since
        # The link first: the name that it points to may soon be another program's pseudo-terminal.
        if self._link is not None and self._link.is_symlink() and str(self._link.readlink()) == self.path:
            self._link.unlink(missing_ok=True)  # unless another rig has taken the name over
        for descriptor in (self._slave, self._master):
            with contextlib.suppress(OSError):
                os.close(descriptor)
