"""A rig at a serial port: a device, a pseudo-terminal, or any URL that pyserial opens."""

from __future__ import annotations

import contextlib
import io
import os
import select
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import serial

from friction_bench.rig.messages import RigInputError, RigLostError

_READ_SLICE = 0.01
WRITE_TIMEOUT = 0.02
"""Longest duration of a write, s. The system's buffer holds two seconds' worth of bytes: a
line without room for a heartbeat in it is dead, and the stop must not wait behind it."""
_FAILURES = (serial.SerialException, OSError, termios.error, ValueError)


class SerialPort:
    """The line to a real rig; time is the computer's monotonic clock.

    `write` may be called from any thread, so that a stop need not wait for a read.

    Args:
        url: /dev/ttyUSB0, a pseudo-terminal, socket://host:port, …
        baud: line rate; a pseudo-terminal ignores it.

    Raises:
        RigLostError: if the port is not there or another program has it.
    """

    def __init__(self, url: str, baud: int) -> None:
        self.url = url
        self._lock = threading.Lock()
        try:
            self._serial = serial.serial_for_url(
                url, baudrate=baud, timeout=_READ_SLICE, do_not_open=True
            )
            if "://" not in url:
                self._serial.exclusive = True
            self._serial.write_timeout = WRITE_TIMEOUT
            self._serial.open()
        except _FAILURES as error:
            # no URL that pyserial knows
            kind = RigInputError if type(error) is ValueError else RigLostError
            raise kind(f"{url}: cannot be opened ({_reason(error)})") from error

    def now(self) -> float:
        """Return the monotonic clock, s."""
        return time.monotonic()

    @contextmanager
    def _lost_while(self, doing: str, *more: type[Exception]) -> Iterator[None]:
        try:
            yield
        except (*_FAILURES, *more) as error:
            raise RigLostError(f"{self.url}: lost while {doing} ({_reason(error)})") from error

    def write(self, data: bytes, *, first: bool = False) -> None:
        """Send bytes, or give up after WRITE_TIMEOUT.

        `first` discards the bytes that still wait in this computer, perhaps in mid-frame.

        pyserial's own `write` reports a successful write as lost if the computer stood still meanwhile for longer
        than its timeout; it is used here only without a file descriptor.

        Raises:
            RigLostError: if the line accepts nothing for WRITE_TIMEOUT.
        """
        with self._lost_while("writing"), self._lock:
            if first:
                self._serial.reset_output_buffer()
            try:
                descriptor = self._serial.fileno()
            except io.UnsupportedOperation:
                self._serial.write(data)
                return
            end = self.now() + WRITE_TIMEOUT
            while True:
                with contextlib.suppress(BlockingIOError):
                    data = data[os.write(descriptor, data) :]
                if not data:
                    return
                if not select.select([], [descriptor], [], max(0.0, end - self.now()))[1]:
                    raise serial.SerialTimeoutException("the line accepts no bytes")

    def read(self, timeout: float) -> bytes:
        """Return the received bytes; wait up to `timeout` seconds, in slices of 10 ms, for the first one.

        Raises:
            RigLostError: if the line is broken.
        """
        end = self.now() + timeout
        # TypeError: closed by another thread meanwhile
        with self._lost_while("reading", TypeError):
            while True:
                data = self._serial.read(max(1, self._serial.in_waiting))
                if data or self.now() >= end:
                    return bytes(data)

    def close(self) -> None:
        """Give the port back."""
        with contextlib.suppress(*_FAILURES):  # an unplugged adapter cannot even be closed
            self._serial.close()


def _reason(error: Exception) -> str:
    text = str(error)
    if "exclusively lock" in text or getattr(error, "errno", None) in {11, 16}:
        return "another program has it open"
    return " ".join(text.split())
