"""The monitor behind a pseudo-terminal or a TCP port of this machine, on the wall clock."""

from __future__ import annotations

import os
import select
import socket
import time
import tty
from collections.abc import Callable
from pathlib import Path

from rx90_emulator.loop.setup import Setup
from rx90_emulator.vplus.arm import ProgrammedArm
from rx90_emulator.vplus.cell import Cell, Engine
from rx90_emulator.vplus.monitor import Monitor
from rx90_emulator.vplus.motion import MotionQueue

_LONGEST_LINE = 1000
_MOST_BEATS = 20
"""Beats that are made up for at once; a machine that is slower than that is slower than the wall clock."""
_INTERRUPT = 3


class Lines:
    """Makes lines of what comes in, echoes it, and holds it while a command runs."""

    def __init__(self, monitor: Monitor, send: Callable[[str], None]) -> None:
        self._monitor = monitor
        self._send = send
        self._text = ""
        self._waiting: list[str] = []
        self._returned = False

    def take(self, data: bytes) -> None:
        """Take bytes."""
        for code in data:
            character = chr(code)
            if code == _INTERRUPT:
                self._monitor.abort()
            elif character == "\r" or (character == "\n" and not self._returned):
                self._waiting.append(self._text)
                self._text = ""
            elif character in "\b\x7f":
                self._text = self._text[:-1]
            elif character != "\n" and len(self._text) < _LONGEST_LINE:
                self._text += character
            self._returned = character == "\r"
        self.go_on()

    def go_on(self) -> None:
        """Give the monitor the lines that it can take."""
        while self._waiting and not self._monitor.is_busy:
            line = self._waiting.pop(0)
            self._send(f"{line}\r\n")
            self._monitor.take(line)


def serve(setup: Setup, folder: Path, port: int | None, announce: Callable[[str], None]) -> None:
    """Serve the monitor until an interrupt.

    Args:
        setup: robot, drives, friction, controller, rates.
        folder: where LOAD and STORE find files.
        port: of TCP on this machine; None for a pseudo-terminal.
        announce: gets the name of the line, once it is there.
    """
    arm = ProgrammedArm(setup)
    cell = Cell(arm, Engine(setup, arm.ready, keep=False), MotionQueue(arm, arm.ready))
    output = bytearray()

    def send(text: str) -> None:
        output.extend(text.encode("latin-1", "replace"))

    monitor = Monitor(cell, folder, send)
    lines = Lines(monitor, send)
    if port is None:
        own, other = os.openpty()
        tty.setraw(other)
        announce(os.ttyname(other))
        monitor.begin()
        _exchange(own, cell, monitor, lines, output)
    else:
        with socket.create_server(("127.0.0.1", port)) as server:
            announce(f"socket://127.0.0.1:{server.getsockname()[1]}")
            while True:
                client, _ = server.accept()
                with client:
                    monitor.begin()
                    _exchange(client.fileno(), cell, monitor, lines, output)


def _exchange(line: int, cell: Cell, monitor: Monitor, lines: Lines, output: bytearray) -> None:
    """Exchange bytes with a terminal, and let the time of the cell pass with the wall clock, until it has gone."""
    began = time.monotonic() - cell.time
    while True:
        if output:
            written = os.write(line, output)
            del output[:written]
        late = time.monotonic() - began - cell.time
        ready, _, _ = select.select([line], [], [], max(-late, 0.0))
        if ready:
            try:
                data = os.read(line, 4096)
            except OSError:
                data = b""
            if not data:
                return
            lines.take(data)
        for _ in range(min(int(late / cell.period), _MOST_BEATS)):
            monitor.beat()
            lines.go_on()
        if late > _MOST_BEATS * cell.period:
            began = time.monotonic() - cell.time
