"""A link to an emulated rig behind a pseudo-terminal, both on threads of the test."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from pathlib import Path

from processes import TIMEOUT, wait_until

from friction_bench.protocol.errors import RigError
from friction_bench.protocol.messages import ResetCause, State
from friction_bench.protocol.serial_port import SerialPort
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig
from friction_bench.rig.link import RigLink
from friction_bench.rig.native import NativeBoard
from friction_bench.rig.pty_rig import PtyRig
from friction_bench.rig.rig_file import Rig


class Bench:
    """A rig that can be unplugged, reset and made to talk nonsense, and the link to it.

    Attributes:
        troubles: what the link has reported.
        samples: how many readings it has passed on.
    """

    def __init__(self, rig: Rig, link: Path) -> None:
        self.rig = rig
        self.path = link
        self.troubles: list[str] = []
        self.samples = 0
        self.plug()
        self.link = RigLink(lambda: SerialPort(str(link), rig.baud), rig, self._count, self.troubles.append)
        self._dead = threading.Event()
        self._threads = [threading.Thread(target=self.link.run), threading.Thread(target=self._live)]
        for thread in self._threads:
            thread.start()
        wait_until(lambda: self.link.connected and self.link.last is not None, "a connection")

    def _count(self, _: object) -> None:
        self.samples += 1

    def _live(self) -> None:
        while not self._dead.wait(0.01):
            self.link.alive()

    def plug(self) -> None:
        """Plug a rig in."""
        self.pty = PtyRig(EmulatedRig(self.rig, 1), self.path)

    @property
    def board(self) -> NativeBoard:
        """Return the rig's processor."""
        board = self.pty.emulated.board
        assert isinstance(board, NativeBoard)
        return board

    @property
    def state(self) -> State | None:
        """Return the rig's state as last reported."""
        report = self.link.last
        return None if report is None else report.state

    def reset(self) -> None:
        """Let the rig restart by itself."""
        with self.pty._lock:
            self.board.reset(ResetCause.WATCHDOG)

    def say(self, data: bytes) -> None:
        """Put bytes on the line from the rig's side; of two writers at the same time one would be turned away."""
        with self.pty._lock:
            os.write(self.pty._master, data)

    def listen(self, count: int) -> None:
        """Wait for more readings."""
        heard = self.samples
        wait_until(lambda: self.samples >= heard + count, f"{count} readings")

    def arm(self) -> None:
        """Arm the rig and wait until it says so."""
        self.link.submit(RigClient.arm).result(10.0)
        wait_until(lambda: self.state == State.ARMED, "an armed rig")

    def arm_again(self) -> None:
        """Arm a rig that was switched off, perhaps by its watchdog, which a busy machine may bring to do it again."""
        deadline = time.monotonic() + TIMEOUT
        while time.monotonic() < deadline:
            with contextlib.suppress(RigError):  # what it reported is no more
                if self.state == State.FAULT:
                    self.link.submit(RigClient.clear).result(10.0)
                self.link.submit(RigClient.arm).result(10.0)
            heard = self.samples
            wait_until(lambda heard=heard: self.state == State.ARMED or self.samples > heard + 1, "readings")
            if self.state == State.ARMED:
                return
        raise AssertionError(f"the rig stays {self.state}")

    def abandon(self) -> None:
        """Stop saying that the link's owner is alive."""
        self._dead.set()

    def close(self) -> None:
        """End everything."""
        self.link.close()
        self.abandon()
        for thread in self._threads:
            thread.join(10.0)
        self.pty.close()
